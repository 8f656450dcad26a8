"""Tests of damaged compressed slices: each damaged slice is reported, and no intact slice."""

from __future__ import annotations

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
from carina.volume.jpeg2000_check import has_second_decoder, j2k_problem

needs_av = pytest.mark.skipif(not has_second_decoder(), reason="PyAV (extra video) is not installed")
NUM = 6


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
def test_same_damage_is_reported_each_time_a_slice_is_checked(compressed):
    frame = _frame(compressed / "IM003")
    damaged = frame[:-400] + bytes([frame[-400] ^ 4]) + frame[-399:]
    reports = [j2k_problem(damaged) for _ in range(3)]
    assert reports[0] is not None
    assert reports == reports[:1] * 3
    assert j2k_problem(frame) is None


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
