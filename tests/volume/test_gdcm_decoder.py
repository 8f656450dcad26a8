"""Tests of the decoder of compressed DICOM pixels against that of SimpleITK, and without a decoder."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import SimpleITK as sitk
from corpus_dicom_files import _depth, _with
from dicom_writer import chest, packed, repack, series

import carina.volume.dicom_pixels as pixels
from carina.errors import VolumeImportError
from carina.volume import dicom_slice_batches, open_volume
from carina.volume.dicom_headers import read_image_headers

BITS_12 = {"BitsStored": 12, "HighBit": 11}
SIGNED = {"PixelRepresentation": 1}


@pytest.mark.parametrize("tags", [{}, BITS_12, SIGNED, {**BITS_12, **SIGNED}])
@pytest.mark.parametrize("depth", [None, b"\x8f", b"\x8b", b"\x0b"])
def test_jpeg_2000_of_any_sign_and_depth_has_the_numbers_of_another_library(tmp_path, monkeypatch, tags, depth):
    def pack(dataset, index):
        packed(dataset, tmp_path, "JPEG2000")
        if depth is not None:
            repack(dataset, _with(_depth, depth))
        for keyword, value in tags.items():
            setattr(dataset, keyword, value)

    series(tmp_path, pack, hu=chest()[:1])
    theirs = []
    whole = pixels.decode

    def also_theirs(path):
        reader = sitk.ImageFileReader()
        reader.SetImageIO("GDCMImageIO")
        reader.SetFileName(str(path))
        theirs.append(sitk.GetArrayFromImage(reader.Execute())[0])
        return whole(path)

    monkeypatch.setattr(pixels, "decode", also_theirs)
    (header,), _ = read_image_headers(next(tmp_path.glob("IM*")))
    assert header is not None
    numbers, _ = pixels._decoded_pixels(header)
    np.testing.assert_array_equal(numbers, theirs[0])


def test_compressed_series_without_a_decoder_is_refused_with_a_command(tmp_path, monkeypatch):
    series(tmp_path, lambda dataset, index: packed(dataset, tmp_path, "JPEG2000"), hu=chest()[:3])
    monkeypatch.setattr(dicom_slice_batches, "has_second_decoder", lambda: False)
    monkeypatch.setitem(sys.modules, "gdcm", None)
    with pytest.raises(VolumeImportError, match=r"decoder \(GDCM\) is missing; run: .*python-gdcm"):
        open_volume(tmp_path)
