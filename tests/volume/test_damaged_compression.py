"""Tests of damaged compressed slices: each damaged slice is reported, and no intact slice."""

from __future__ import annotations

import base64
import threading
from pathlib import Path

import numpy as np
import pytest
from dicom_writer import chest, packed, repack, series
from pydicom import dcmread

from carina.volume import jpeg2000_check, open_volume
from carina.volume.dicom_headers import read_image_headers
from carina.volume.dicom_pixel_bytes import read_stream_bytes
from carina.volume.dicom_pixels import read_slice
from carina.volume.dicom_streams import read_stream
from carina.volume.jpeg2000_check import has_second_decoder, intact_j2k_words, j2k_problem

needs_av = pytest.mark.skipif(not has_second_decoder(), reason="PyAV (extra video) is not installed")
NUM = 6
STREAMS = {
    (9, False): (
        "|4;u>04V?f0000m0000e00000000000000m0000e0000000000009UA0sm3}3;+NC0RROA1ONg5TmTb5NKjB%P*7M<P*_k<SWr+{|6~9"
        "q00BdCWnpw>WFTUBAWv{*Zc0!^M<8}(a&u{KZXhx)H7+v$kN^q*00000?*IY+li!#y2cu1o>~g?95TJbEfCcXf9KiX*KzxB90w5KVoW`"
        "1;2#(_C3_rkpgCP2a-~vz)XO;;P?->fZ@@DN3P*5k#i=5#KFc9s(%L<gfn2Y~yQhyXWgOfkNe1@R<g}@gnjG$SsYJVjV$vd*y8C?Mh1J"
        "#28AN5M#3?gOe)SRdAkg9a|rWgPK!a=l{Djc7{e1_oqh~NUCA#4>%>elE3cdex~0A-2;8XB>;&GUatJ)^$>)cwH&-Q&B0iJ1TZFp!rj@"
        "BkP{OO}<O3!oM46NW<^8jB<nY~-fWH{bu+"
    ),
    (12, True): (
        "|4;u>04V?f0000m0000e00000000000000m0000e000000000000D~u0sm3}3;+NC0RROA1ONg5TmTb5U}$J?XlQU~XmDs~aA;_7|6~9"
        "q00BdCWnpw>WFTUBAWv{*Zc0!^M<8}(a&u{KZXhx)H7+v$kN^q*00001ZvX-Rli%PV2cu5cFb(x9z&@ZTAAlSH9RvwA2_3%&!2ALrKG1"
        "jo5damEoW}(y&h7|~;_UMfe-6LEeWMV5W3T`u5oeYO67Lxbv_>6FfCLB1R0#<nO$ZQw5l~Pk%!{1zl$ay|goFTpTJHp+;If(>D(hK%Qy"
        ")z%r@(!tkbY+{03{bGjG$SsYRws1ife`E&=8OuzHP8D3e)0ys}U7J(iOCDk_$EsKM$~6&uBaS{XXY&5q}IKW$DzMr|^)fboZth006>4w"
        "3sR!ZAaexq^l870000ma)d!H7r+28kd~}(bxrOk@EDna<5JH(r-*L9z<s1perJ#XCn0PVN$S?<19z@jv_Jp=0fdCVo#Oxi7u(8KRAKU$"
        "l)Qfc)cwH&-Q&B0iJ1TZFp!rj@BkP{OT<dW<VOvAtdV*I5sMsathZSsTa#;bmg_CnNY>=q-DSGVb&@Y(tK*n4D}Vpl"
    ),
    (15, True): (
        "|4;u>04V?f0000m0000e00000000000000m0000e000000000000E8x0sm3}3;+NC0RROA1ONg5TmTb5cz}S2fPjdAfQW#Ah=72I|6~9"
        "q00BdCWnpw>WFTUBAWv{*Zc0!^M<8}(a&u{KZXhx)H7+v$kN^q*00001v;YDBli&DYPzR$<*DwwKD43_fKQK5S$Q%Fx2njKN2`g{|!2U"
        "vDKVXOe0w5KVoW};jkB1cqj^gby`76Hx-@tyv5PyP*00J-(XO;;P?->fTMjcFm1Ut@R11x850bqB?Z}=UA$)CUxP*5k#i=6V5m?Qy&ga"
        "Ch9?*yXYvYI3b68I+AM=PVPbT=+eRgixb1IxgE$Z&s!Ko=>DpjoeK?g@khBnHmF00t5g_!0zRU_T1mubbxizHb~wb239=u-I%i8x4lRK"
        "+NR-2E$>n*lac%4T6E0xf}m~3?gOe)SRdAkg9a|rWgPK!a=l{DjaP`-u$Gi5l{dC05EcdK`s}-05Fi2tZ#KrJ@Y;)000065Dm4q+f|6D"
        "0000ONK39SCE)*35~(Br0002Nz<$OMe}jks0#G4r6-nyW=mU4IS+qa^00D%Azn$X%02oM1kbnRTBqhd(zy=Z$<lw*q2+hjz>c0Tg{lNp"
        "><GX^1nE(JVke4d(02oM1_@3|p0fdCV>EpmF<A7lhN?h23dVYt0A1YVMV8FEVkMATY&DCrF*#"
    ),
}
"""JPEG 2000 streams that OpenJPEG wrote, by bits and sign: 30 numbers from the lowest to the highest, each in 8 x 8
pixels; in base 85."""


def _slices(num: int = NUM) -> np.ndarray:
    """Return HU [z, y, x] of the small chest, six times as wide and with added noise."""
    rng = np.random.default_rng(11)
    wide = np.kron(chest(noise_hu=1e-9)[:num], np.ones((1, 6, 6)))
    return np.clip(wide + rng.normal(0, 12, wide.shape), -1024, 3000).astype(np.int16)


@pytest.fixture(scope="module")
def compressed(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("compressed")
    return series(folder, lambda dataset, index: packed(dataset, folder, "JPEG2000"), hu=_slices())


def _frame(path: Path) -> bytes:
    (header,), _ = read_image_headers(path)
    frame = read_stream_bytes(header)
    assert frame is not None
    return frame


def _damaged(frame: bytes, rng: np.random.Generator, kind: str) -> bytes:
    count = int(rng.integers(1, 41))
    at = int(rng.integers(frame.index(b"\xff\x93") + 2, len(frame) - count - 2))
    new = {
        "noise": rng.integers(0, 256, count, dtype=np.uint8).tobytes(),
        "zeros": bytes(count),
        "ones": b"\xff" * count,
        "bit": bytes([frame[at] ^ 1 << int(rng.integers(8))]),
    }[kind]
    return frame[:at] + new + frame[at + len(new) :]


@needs_av
@pytest.mark.parametrize("kind", ["noise", "zeros", "ones", "bit"])
def test_damage_of_compressed_slices_above_20_hu_is_always_reported(compressed, tmp_path, rng, kind):
    """Check 15 slices of each kind of damage.

    Each is reported in one of three ways: a refusal, a problem of the first decoder, or a difference of the second
    decoder.
    """
    silent = []
    for index in range(15):
        source = compressed / f"IM{index % NUM:03d}"
        clean = read_slice(read_image_headers(source)[0][0])
        dataset = dcmread(source)
        repack(dataset, lambda frame: _damaged(frame, rng, kind))
        path = tmp_path / f"{kind}{index}"
        dataset.save_as(path)
        (header,), _ = read_image_headers(path)
        problem = j2k_problem(_frame(path))
        try:
            worst = np.abs(read_slice(header) - clean).max()
        except OSError:  # a VolumeImportError is a refusal
            continue
        if problem is None and worst > 20:
            silent.append((index, worst))
    assert silent == []


@needs_av
def test_intact_compressed_slices_are_not_reported_as_damaged(compressed):
    assert [j2k_problem(_frame(path)) for path in sorted(compressed.iterdir())] == [None] * NUM
    volume = open_volume(compressed)
    assert (volume.source.notes, volume.is_hu) == ((), True)
    np.testing.assert_array_equal(volume.hu_zyx, _slices())


@needs_av
@pytest.mark.parametrize(("bits", "signed"), STREAMS)
def test_second_decoder_returns_the_words_of_streams_with_fewer_bits(bits, signed):
    frame = base64.b85decode(STREAMS[bits, signed])
    stream = read_stream(frame)
    assert stream is not None
    assert (stream.bits, stream.signed) == (bits, signed)
    lowest = -(1 << (bits - 1)) if signed else 0
    values = lowest + np.linspace(0, (1 << bits) - 1, 30).astype(int).reshape(5, 6).repeat(8, 0).repeat(8, 1)
    np.testing.assert_array_equal(intact_j2k_words(frame, stream), values & ((1 << bits) - 1))
    # A stream that states the irreversible transform is left to the reference.
    at = frame.index(b"\xff\x52") + 13
    assert intact_j2k_words(frame[:at] + b"\0" + frame[at + 1 :], stream) is None


@needs_av
def test_single_changed_bit_of_a_compressed_slice_is_reported_with_the_slice(tmp_path):
    def edit(dataset, index):
        packed(dataset, tmp_path, "JPEG2000")
        if index == 3:
            repack(dataset, lambda frame: frame[:-400] + bytes([frame[-400] ^ 4]) + frame[-399:])

    volume = open_volume(series(tmp_path, edit, hu=_slices()))
    assert not volume.is_hu
    (note,) = (note for note in volume.source.notes if note.code == "import.pixels-damaged")
    assert note.badge
    assert "1 of 6 slices: IM003" in note.words


@needs_av
def test_equal_damage_is_reported_for_each_slice_and_at_each_opening(tmp_path):
    def edit(dataset, index):
        packed(dataset, tmp_path, "JPEG2000")
        if index in (2, 3, 4):
            repack(dataset, lambda frame: frame[:-400] + bytes([frame[-400] ^ 4]) + frame[-399:])

    folder = series(tmp_path, edit, hu=np.repeat(_slices()[:1], 6, axis=0))
    for _ in range(2):
        (note,) = (note for note in open_volume(folder).source.notes if note.code == "import.pixels-damaged")
        assert "3 of 6 slices: IM002" in note.words


@needs_av
def test_compressed_stream_that_the_second_decoder_does_not_support_is_not_reported(compressed, monkeypatch):
    import av

    class Unsupported:
        thread_count = 0

        def decode(self, packet):
            raise av.error.PatchWelcomeError(0, "not supported")

    monkeypatch.setattr(av.CodecContext, "create", lambda *args: Unsupported(), raising=False)
    frame = _frame(compressed / "IM003")
    assert j2k_problem(frame) is None


@needs_av
def test_log_settings_of_the_second_decoder_are_restored_after_the_check(compressed):
    import av.logging

    before = av.logging.get_level(), av.logging.get_skip_repeated()
    j2k_problem(_frame(compressed / "IM000"))
    assert (av.logging.get_level(), av.logging.get_skip_repeated()) == before


def test_note_states_that_damaged_slices_may_be_missed_without_pyav(compressed, monkeypatch):
    monkeypatch.setattr(jpeg2000_check, "has_second_decoder", lambda: False)
    volume = open_volume(compressed)
    assert volume.is_hu
    (note,) = volume.source.notes
    assert (note.code, note.badge) == ("import.not-checked", False)
    assert "carina doctor" in note.words


def test_cancelled_import_does_not_start_further_checks_of_slices(compressed, monkeypatch):
    """A cancelled import waits only for the slices that are being checked."""
    headers = [read_image_headers(path)[0][0] for path in sorted(compressed.iterdir())] * 5
    checked, gate = [], threading.Event()

    def wait(header):
        checked.append(header)
        gate.wait(20)

    monkeypatch.setattr(jpeg2000_check, "is_checkable", lambda header: True)
    monkeypatch.setattr(jpeg2000_check, "_problem", wait)
    with jpeg2000_check.second_decoder() as check:
        check.submit(headers)
        assert len(check) == 5 * NUM
        check.drop_waiting()
        gate.set()
    assert len(checked) <= jpeg2000_check.MAX_WORKERS
