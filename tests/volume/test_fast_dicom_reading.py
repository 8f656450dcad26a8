"""Tests that the fast readers of headers and pixels give the same answers as the reference readers."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from corpus import Input, all_inputs
from dicom_writer import chest, packed, repack, series
from hypothesis import given, reject, settings
from hypothesis import strategies as st
from pydicom.uid import (
    DeflatedExplicitVRLittleEndian,
    ExplicitVRBigEndian,
    ExplicitVRLittleEndian,
    ImplicitVRLittleEndian,
    JPEG2000Lossless,
    JPEGLosslessSV1,
    JPEGLSLossless,
    JPEGLSNearLossless,
    RLELossless,
)

from carina import _core
from carina.errors import CancelledError, CarinaError, VolumeImportError
from carina.volume import dicom, dicom_header_batches, open_volume
from carina.volume.dicom import find_series
from carina.volume.dicom_checks import is_odd, odd_slices
from carina.volume.dicom_files import read_folder
from carina.volume.dicom_headers import read_image_headers
from carina.volume.dicom_pixels import decode_slice
from carina.volume.dicom_slice_batches import read_plain_slices
from carina.volume.progress import Watch

ODD = Path("odd") / "dicom"
INPUTS = [entry for entry in all_inputs() if entry.expected != "import.too-large"]
SYNTAXES = {
    "implicit": ImplicitVRLittleEndian,
    "explicit": ExplicitVRLittleEndian,
    "big endian": ExplicitVRBigEndian,
    "deflated": DeflatedExplicitVRLittleEndian,
    "RLE": RLELossless,
    "lossless JPEG": JPEGLosslessSV1,
    "JPEG-LS": JPEGLSLossless,
    "near-lossless JPEG-LS": JPEGLSNearLossless,
    "JPEG 2000": JPEG2000Lossless,
}
PACKED = {"lossless JPEG": "JPEG", "JPEG 2000": "JPEG2000"}
"""Name by which ITK compresses in a transfer syntax."""
NEAR = {"JPEG-LS": 0, "near-lossless JPEG-LS": 2}
"""Largest error of the pixels in a transfer syntax that pyjpegls writes."""


def _syntax(dataset, kind: str) -> None:
    """Convert a slice in explicit little-endian order to another transfer syntax."""
    syntax = SYNTAXES[kind]
    if kind == "RLE":
        # GDCM's encoder of RLE aborts the process for some small pictures.
        dataset.compress(syntax, encoding_plugin="pydicom")
    elif kind in NEAR:
        dataset.compress(syntax, encoding_plugin="pyjpegls", jls_error=NEAR[kind])
    elif kind in PACKED:
        with tempfile.TemporaryDirectory() as folder:
            packed(dataset, Path(folder), PACKED[kind])
        assert dataset.file_meta.TransferSyntaxUID == syntax
    else:
        if syntax == ExplicitVRBigEndian:
            dataset.PixelData = np.frombuffer(dataset.PixelData, "<u2").astype(">u2").tobytes()
        dataset.file_meta.TransferSyntaxUID = syntax


def _answer(path: Path) -> tuple:
    """Return everything that an import gives: the volume and its notes, or the error."""
    try:
        volume = open_volume(path)
    except CarinaError as error:
        return type(error), error.code, str(error)
    return volume.hu_zyx.tobytes(), volume.lps_from_ijk.tobytes(), volume.is_hu, volume.not_hu_reason, volume.source


def _by_reference(monkeypatch: pytest.MonkeyPatch, path: Path) -> tuple:
    """Return the answer without the fast readers."""
    with monkeypatch.context() as patch:
        patch.setattr(_core, "scan_dicom_headers", lambda paths, **_: [None] * len(paths))
        patch.setattr(_core, "decode_dicom_slices", lambda sources, _values, **_options: [False] * len(sources))
        patch.setattr(_core, "place_dicom_words", lambda *_words, **_options: False)
        return _answer(path)


def _check_alike(monkeypatch: pytest.MonkeyPatch, path: Path) -> None:
    assert _answer(path) == _by_reference(monkeypatch, path)


def _headers(folder: Path) -> tuple:
    return read_folder(folder, recursive=True, watch=Watch()).headers


@pytest.mark.soak
@pytest.mark.parametrize("entry", INPUTS, ids=[f"{entry.family}: {entry.name}" for entry in INPUTS])
def test_each_input_of_the_corpus_has_the_answer_of_the_reference(tmp_path, monkeypatch, entry: Input):
    _check_alike(monkeypatch, entry.make(tmp_path))


@pytest.mark.parametrize("entry", INPUTS[::16], ids=[entry.name for entry in INPUTS[::16]])
def test_sample_of_the_corpus_has_the_answer_of_the_reference(tmp_path, monkeypatch, entry: Input):
    _check_alike(monkeypatch, entry.make(tmp_path))


@pytest.mark.data
def test_published_odd_files_have_the_headers_and_pixels_of_the_reference(data_dir):
    num_read = 0
    for path in sorted((data_dir / ODD).rglob("*")):
        if not path.is_file():
            continue
        ((_, fast),) = dicom_header_batches.headers_in_batches([path])
        if fast is None:
            continue
        headers, _ = read_image_headers(path)
        assert [fast] == headers
        num_read += 1
    assert num_read > 20


@pytest.mark.parametrize("kind", SYNTAXES)
def test_fast_readers_read_ordinary_series_of_each_transfer_syntax_like_the_reference(tmp_path, monkeypatch, kind):
    folder = series(tmp_path / "ct", lambda dataset, _index: _syntax(dataset, kind), hu=chest(8))
    found = dict(dicom_header_batches.headers_in_batches(sorted(folder.iterdir())))
    assert all(read_image_headers(path)[0] == [header] for path, header in found.items())
    with monkeypatch.context() as patch:
        patch.setattr(
            dicom, "decode_slice", lambda header: pytest.fail(f"{header.path.name} was read by the reference")
        )
        fast = _answer(folder)
    assert fast == _by_reference(monkeypatch, folder)
    found_hu = np.frombuffer(fast[0], np.int16).reshape(chest(8).shape)
    assert np.abs(found_hu - chest(8)).max() == NEAR.get(kind, 0)


@pytest.mark.parametrize("kind", ["explicit", "RLE", "deflated", "JPEG-LS", *PACKED])
@pytest.mark.parametrize("damage", ["cut", "byte", "padding", "clipped"])
def test_damaged_and_remarkable_slices_have_the_answer_of_the_reference(tmp_path, monkeypatch, kind, damage):
    def edit(dataset, index):
        if damage == "padding" and index == 3:
            dataset.PixelPaddingValue = 4000
            values = np.frombuffer(dataset.PixelData, "<u2").reshape(32, 32).copy()
            values[:6] = 4000
            dataset.PixelData = values.tobytes()
        if damage == "clipped":
            dataset.RescaleIntercept = 32000
        _syntax(dataset, kind)

    folder = series(tmp_path / "ct", edit, hu=chest(6))
    victim = folder / "IM002"
    stored = bytearray(victim.read_bytes())
    if damage == "cut":
        victim.write_bytes(stored[:-40])
    elif damage == "byte":
        stored[-300] ^= 0x5A
        victim.write_bytes(stored)
    _check_alike(monkeypatch, folder)


def _read_by_the_compiled_module(headers: tuple, out_zyx: np.ndarray, coding: str) -> list[bool]:
    return _core.decode_dicom_slices(
        [(header.path, header.pixels_at, number) for number, header in enumerate(headers)],
        out_zyx,
        coding=coding,
        bits_allocated=headers[0].bits_allocated,
        bits_stored=headers[0].bits_stored,
        high_bit=headers[0].high_bit,
        signed=False,
        intercept=-1024,
        padding=None,
        max_inflated=1 << 20,
    )


@pytest.mark.parametrize(
    ("kind", "coding"), [("RLE", "rle"), ("lossless JPEG", "lossless jpeg"), ("JPEG-LS", "jpeg ls")]
)
@settings(max_examples=12, deadline=None)
@given(data=st.data())
def test_any_compressed_picture_is_decoded_like_the_reference(tmp_path_factory, kind, coding, data):
    least = 12 if kind == "JPEG-LS" else 2  # pyjpegls cannot write many smaller pictures
    rows, columns = data.draw(st.integers(least, 24)), data.draw(st.integers(least, 24))
    bits = data.draw(st.sampled_from([10, 12, 16]))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    noise = data.draw(st.sampled_from([0, 1, 30, 1 << bits]))
    ramp = np.add.outer(np.arange(rows), np.arange(columns)) * data.draw(st.integers(0, 1 << (bits - 4)))
    flat = rng.random((3, rows, columns)) < data.draw(st.sampled_from([0.0, 0.5, 1.0]))
    values = np.where(flat, 7, ramp + rng.integers(0, noise + 1, (3, rows, columns))) % (1 << bits)
    folder = tmp_path_factory.mktemp("coded")

    def edit(dataset, index):
        dataset.PixelData = values[index].astype("<u2").tobytes()
        dataset.BitsStored, dataset.HighBit = (bits, bits - 1)
        _syntax(dataset, kind)

    try:
        series(folder / "ct", edit, hu=values.astype(np.int16))
    except RuntimeError:
        reject()  # pyjpegls cannot write pictures that its compression enlarges
    headers = _headers(folder / "ct")
    found = np.empty((3, rows, columns), np.int16)
    is_read = _read_by_the_compiled_module(headers, found, coding)
    for header, own, written, one_is_read in zip(headers, found, values, is_read, strict=True):
        if not one_is_read:
            # Noise is left to the reference, because swapped bytes look like noise.
            assert np.abs(np.diff(written, axis=1)).mean() > 100
            continue
        np.testing.assert_array_equal(own, written - 1024)
        try:
            pixels = decode_slice(header)
        except VolumeImportError:
            continue  # GDCM refuses RLE of very small pictures
        assert not pixels.doubts
        np.testing.assert_array_equal(own, pixels.numbers)


def _grey_pictures(rng: np.random.Generator, bits: int, rows: int, columns: int) -> np.ndarray:
    """Return pictures [z, y, x]: flat, stepped, with a few other pixels, smooth, noisy, with a few high pixels."""
    most = min((1 << bits) - 1, 32000)
    ramp = np.add.outer(np.arange(rows), np.arange(columns))
    single = np.where(rng.random((rows, columns)) < 0.05, 90, 7)
    smooth = 60 + ramp + rng.integers(0, 4, ramp.shape)
    noisy = rng.integers(0, 100, ramp.shape)
    high = np.where(rng.random(ramp.shape) < 0.001, most, 0)
    return np.stack([np.full_like(ramp, 9), ramp // 5 * 9, single, smooth, noisy, high])


@pytest.mark.parametrize(("bits", "near"), [(8, 0), (12, 0), (16, 0), (8, 9), (13, 1), (16, 3)])
def test_jpeg_ls_of_each_depth_is_decoded_like_gdcm_and_no_damage_is_read_otherwise(tmp_path, rng, bits, near):
    """Check intact pictures, then a cut, a changed bit, an inserted byte and a removed byte in each picture."""
    rows, columns = int(rng.integers(20, 40)), int(rng.integers(20, 40))
    values = _grey_pictures(rng, bits, rows, columns)
    syntax = JPEGLSNearLossless if near else JPEGLSLossless
    damages = {
        "none": lambda frame, at: frame,
        "cut": lambda frame, at: frame[:at],
        "bit": lambda frame, at: frame[:at] + bytes([frame[at] ^ 1 << at % 8]) + frame[at + 1 :],
        "inserted": lambda frame, at: frame[:at] + b"\x5a" + frame[at:],
        "removed": lambda frame, at: frame[:at] + frame[at + 1 :],
    }
    num_left_to_gdcm = 0
    for name, damage in damages.items():

        def edit(dataset, index, damage=damage):
            dataset.BitsAllocated = 8 if bits == 8 else 16
            dataset.BitsStored, dataset.HighBit = bits, bits - 1
            dataset.PixelData = values[index].astype("u1" if bits == 8 else "<u2").tobytes()
            dataset.compress(syntax, encoding_plugin="pyjpegls", jls_error=near)
            repack(dataset, lambda frame: damage(frame, int(rng.integers(2, len(frame) - 4))))

        headers = _headers(series(tmp_path / name, edit, hu=values.astype(np.int16)))
        found = np.empty(values.shape, np.int16)
        is_read = _read_by_the_compiled_module(headers, found, "jpeg ls")
        assert all(is_read) or name != "none"
        for header, own, written, one_is_read in zip(headers, found, values, is_read, strict=True):
            if not one_is_read:
                num_left_to_gdcm += 1
                continue
            pixels = decode_slice(header)
            assert not pixels.doubts
            np.testing.assert_array_equal(own, pixels.numbers)
            if name == "none":
                assert np.abs(own + 1024 - written).max() <= near
    assert num_left_to_gdcm >= 12


def test_jpeg_ls_with_words_of_another_size_than_the_tags_is_refused(tmp_path, monkeypatch):
    """GDCM would end the process."""

    def edit(dataset, index):
        dataset.BitsAllocated, dataset.BitsStored, dataset.HighBit = 8, 8, 7
        dataset.PixelData = bytes(range(200)) * 5 + bytes(24)
        dataset.compress(JPEGLSLossless, encoding_plugin="pyjpegls")
        dataset.BitsAllocated, dataset.BitsStored, dataset.HighBit = 16, 12, 11

    folder = series(tmp_path / "ct", edit, hu=chest(4))
    with pytest.raises(VolumeImportError, match=r"contains 8-bit numbers, but the tags reserve 16 bits"):
        open_volume(folder)
    _check_alike(monkeypatch, folder)


def test_odd_slices_of_the_compiled_module_are_those_of_the_reference():
    values = np.array(chest(12, noise_hu=40.0))
    values[4] += 300
    values[8, 8:20, 8:20] += 700
    for compressed in (False, True):
        triples = zip(values, values[1:], values[2:], strict=False)
        reference = [at + 1 for at, three in enumerate(triples) if is_odd(*three, compressed=compressed, slice_mm=1.0)]
        assert odd_slices(values, compressed=compressed, slice_mm=1.0) == reference != []


def test_cancelled_reading_of_slices_raises(tmp_path):
    folder = series(tmp_path / "ct")
    (found,) = find_series(read_folder(folder, recursive=True, watch=Watch()), Watch())
    assert found.stack is not None
    with pytest.raises(CancelledError, match="cancelled while reading the slices"):
        read_plain_slices(found.stack, Watch(None, lambda: True))


def test_header_of_a_file_without_a_twin_is_the_one_of_the_reference(tmp_path):
    def edit(dataset, index):
        dataset.KVP = str(100 + index)
        dataset.AcquisitionTime = f"1015{index:02d}.5"
        if index == 2:
            dataset.ImagePositionPatient[2] = "5.0e0"
        if index == 3:
            del dataset.AcquisitionTime

    folder = series(tmp_path / "ct", edit, hu=chest(6))
    assert list(_headers(folder)) == [read_image_headers(path)[0][0] for path in sorted(folder.iterdir())]
