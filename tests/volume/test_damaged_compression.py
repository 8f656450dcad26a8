"""Tests of damaged compressed slices: each damaged slice is reported, and no intact slice."""

from __future__ import annotations

import base64
import threading
from pathlib import Path

import numpy as np
import pytest
from dicom_writer import chest, packed, repack, series
from pydicom import dcmread

from carina.errors import VolumeImportError
from carina.volume import jpeg2000_check, open_volume
from carina.volume.dicom_headers import read_image_headers
from carina.volume.dicom_pixel_bytes import read_stream_bytes
from carina.volume.dicom_pixels import read_slice
from carina.volume.dicom_streams import read_stream
from carina.volume.jpeg2000_check import has_second_decoder, intact_j2k_words, j2k_problem

needs_av = pytest.mark.skipif(not has_second_decoder(), reason="PyAV (extra video) is not installed")
NUM = 6
SIZE = b"\xff\x51"
"""Marker of the size of the picture in a JPEG 2000 stream."""
STREAMS = {
    (9, False): (
        "/0//UQApAAAAAAAwAAAAKAAAAAAAAAAAAAAAMAAAACgAAAAAAAAAAAABCAEB/1IADAAAAAEABQQEAAH/XAATQEhQUFhQUFhQ"
        "UFhQUFhQUFj/ZAAlAAFDcmVhdGVkIGJ5IE9wZW5KUEVHIHZlcnNpb24gMi41LjL/kAAKAAAAAADvAAH/k9+YMAejTY/scsA+"
        "EKB84IAF7wkcwPnDQHyBIAIgFZKcxpqfCI7i5ww/wHyDIPqF4AJQEWeWCRLvGQq68mbtEVBQJ8yLnOEKMBDtv8sKlL6Yi/9t"
        "Un8UOoOTP8B8hqD6hcAXKYygWa9qfyUQyTuy2RldAQkD1YMBH/VK3wwiZenUnKfwkKp096YYAADCQbSYKhyfwHyG4PqI4AKg"
        "IWwVSerW6AN3raU0AGWKAxoasbfN839LPaO/ANT9wQPd47uCiZkAADCQlyrwABhIS5aVoAugFe0ThkMcGoskEmzkptI33//Z"
    ),
    (12, True): (
        "/0//UQApAAAAAAAwAAAAKAAAAAAAAAAAAAAAMAAAACgAAAAAAAAAAAABiwEB/1IADAAAAAEABQQEAAH/XAATQGBoaHBoaH"
        "BoaHBoaHBoaHD/ZAAlAAFDcmVhdGVkIGJ5IE9wZW5KUEVHIHZlcnNpb24gMi41LjL/kAAKAAAAAAFvAAH/k9/gIAejTtcw"
        "DfUrwD6gKB+AHAAdBAk1CR2/B8D8AiA+0HgAEQAVkpzHBSjO7giO4uzzEH8Ov8B9oxB+Y7AAJBFnlgkS7xkKtEYdTIAEB8"
        "pUCQkgTQgQfxFQUCfMi5zylJgkAYSEAH9a7wSi4LKaHSrrWXxTH00sp8B9ppB+ZzAAJRcpjKBZr2rNGVqKa4Xn0BCQHL5t"
        "sDAK0+J7qxEVQdIVtHCSCzYNPw+wXM9oO/39PudzEX8MImXp1Jyn8JCqdPemGAAAwkG0mCocbUfe/KSrEVAAAAAwcoRBLh"
        "fAADCQlqxvdU3uJ/AYmYHjUs89p4huv8B9pFB+Z5AAJyFsFUnq1ugDd65ZtEAAAAGEhL+d4wAAF9vKVlRh8peUvH8A1P3B"
        "A93ju4KJmQAAMJCXKvAAGEhLxErF5EcNe6yRegQRixxrrLdZI1uTa3WW6y3WSNbk2t1lust1ki9hq+OYMSt//9k="
    ),
    (15, True): (
        "/0//UQApAAAAAAAwAAAAKAAAAAAAAAAAAAAAMAAAACgAAAAAAAAAAAABjgEB/1IADAAAAAEABQQEAAH/XAATQHiAgIiAg"
        "IiAgIiAgIiAgIj/ZAAlAAFDcmVhdGVkIGJ5IE9wZW5KUEVHIHZlcnNpb24gMi41LjL/kAAKAAAAAAG0AAH/k9/4YFAHo0"
        "7XMA3+KJinwD8wOB/IHAABCAkxfwkrcAPA/kJgP2CIAAIgFZKcxwbCj4cVCI7i7TL5K78B38B+xBB/gogAAjARZ5YJEu8"
        "ZCrRGHUyABDvOYgMsZ24BYHfIb/gdhMmfwBFQUCfMi5zylJgkAYSEAH9a7wSi4LKaJAkS+CbYRyujrXQ3Lk5VkH8VA8vA"
        "fshwf4VAFymMoFmvau4JhAQkBs7AAAYSEvgSBGFgPwrbr5vm+b5vHEVzMkNhsNhsNhsNhsFAzOT/BsNhsNhsNhsNgoGZu"
        "Rv/fwwiZenUnKfwkKp096YYAADCQbSYKhxtR978pKsRUAAAADByhEEuF8AAMJCWrG91Tj3zPioAAAAGEA21tttViKgAAA"
        "AYSEuuLyXg/1ISqSQAAAAAwcB+xhB/g4gAAlAhbBVJ6tboA3euWbRAAAABhIS/neMAABhIS5CAAAwkJcaIwAYSEuTgwAM"
        "Izcrx6r8A1P3BA93ju4KJmQAAMJCXKvAAGEhL+J7wAAGEhL/p48Ar44BhEEpc2IN6fod/HypXymDAtPOP7yQpzdVr/9k="
    ),
}
"""JPEG 2000 streams that OpenJPEG wrote, by bits and sign: 30 numbers from the lowest to the highest, each in 8 x 8
pixels; in base 64."""


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


def _width(frame: bytes) -> int:
    """Return the width that the main header of a JPEG 2000 stream states."""
    at = frame.index(SIZE) + 6
    return int.from_bytes(frame[at : at + 4], "big")


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
    frame = base64.b64decode(STREAMS[bits, signed])
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
def test_stream_that_claims_another_size_than_the_tags_is_refused_without_decoding(tmp_path, monkeypatch):
    def edit(dataset, index):
        packed(dataset, tmp_path, "JPEG2000")
        if index == 3:
            # Width and height of the picture in the main header (ITU-T T.800 A.5.1): 30,000 x 30,000 pixels.
            large = (30_000).to_bytes(4, "big") * 2
            repack(dataset, lambda frame: frame[: frame.index(SIZE) + 6] + large + frame[frame.index(SIZE) + 14 :])

    decoded = []
    decode = jpeg2000_check._decoded
    monkeypatch.setattr(jpeg2000_check, "_decoded", lambda frame: decoded.append(_width(frame)) or decode(frame))
    with pytest.raises(VolumeImportError, match="IM003"):
        open_volume(series(tmp_path, edit, hu=_slices()))
    assert decoded
    assert max(decoded) < 1000


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
