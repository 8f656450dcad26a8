"""Tests of DICOM headers with one changed byte: the file is read or refused, without any other exception."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import structure_files as made
from dicom_writer import chest, packed, series

from carina.errors import CarinaError, VolumeImportError
from carina.volume import open_mask, open_volume
from carina.volume.dicom_headers import acquisition_date, read_image_headers
from carina.volume.dicom_segmentation import read_segmentation
from carina.volume.dicom_structures import is_structure_set, read_references, read_structures
from carina.volume.progress import Watch

_VR = re.compile(rb"(?:AE|AS|CS|DA|DS|FD|FL|IS|LO|OB|OW|PN|SH|SQ|SS|TM|UI|UL|US)")
_HEADER_BYTES = 3000


def _ball():
    volume, centre = made.lung_with_ball(4.0)
    return volume, centre, made.ball_voxels(volume, centre, 4.0)


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("whole")
    volume, centre, inside = _ball()
    series(folder / "ct", hu=chest()[:3])
    series(folder / "packed", lambda dataset, index: packed(dataset, folder, "JPEG2000"), hu=chest()[:3])
    return {
        "SEG": made.segmentation(folder / "seg.dcm", volume, inside.astype(int)),
        "RTSTRUCT": made.structure_set(folder / "rs.dcm", [("GTV", made.ball_outlines(volume, centre, 4.0))]),
        "CT": folder / "ct" / "IM001",
        "JPEG 2000": folder / "packed" / "IM001",
    }


def _flips(whole: bytes, rng: np.random.Generator) -> Iterator[bytes]:
    """Yield copies of a file with one changed bit: in each letter of a VR, then at random positions of the header."""
    letters = [at + k for at in (found.start() for found in _VR.finditer(whole)) for k in (0, 1) if at > 132]
    places = [(at, 1 << int(rng.integers(6))) for at in rng.permutation(letters)[:100]]
    places += [(int(rng.integers(132, min(len(whole), _HEADER_BYTES))), 1 << int(rng.integers(8))) for _ in range(100)]
    for at, bit in places:
        yield whole[:at] + bytes([whole[at] ^ bit]) + whole[at + 1 :]


def _read_image(path: Path) -> None:
    try:
        headers, _ = read_image_headers(path)
    except ValueError:
        return  # this is the expected answer for a file that is not DICOM
    for header in headers:
        if header.problem is None and header.rows * header.columns < 1 << 20:
            from carina.volume.dicom_pixels import decode_slice

            decode_slice(header)


READERS: dict[str, Callable[[Path], object]] = {
    "SEG": lambda path: read_segmentation(path, Watch()),
    "RTSTRUCT": lambda path: read_structures(path, Watch()),
    "CT": _read_image,
    "JPEG 2000": _read_image,
}


@pytest.mark.parametrize("kind", READERS)
def test_changed_byte_of_a_dicom_header_gives_a_volume_or_a_refusal(files, tmp_path, rng, kind):
    whole = files[kind].read_bytes()
    path = tmp_path / "damaged.dcm"
    refusals = []
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a warning could contain text of the file
        for data in _flips(whole, rng):
            path.write_bytes(data)
            try:
                READERS[kind](path)
            except VolumeImportError as error:
                refusals.append(error)
            is_structure_set(path)
            read_references(path)
            acquisition_date(path)
    assert refusals
    assert {error.exit_code for error in refusals} == {3}
    assert max(len(str(error)) for error in refusals) <= 600


def test_segmentation_with_a_damaged_value_representation_exits_with_code_3(files, tmp_path):
    """Use the change of the VR US to UQ, by which the bytes of SegmentNumber are read as text."""
    whole = files["SEG"].read_bytes()
    at = whole.index(b"\x62\x00\x04\x00US") + 5
    damaged = tmp_path / "seg.dcm"
    damaged.write_bytes(whole[:at] + b"Q" + whole[at + 1 :])
    with pytest.raises(VolumeImportError) as caught:
        open_mask(damaged, _ball()[0])
    assert caught.value.code == "import.mask"
    assert caught.value.exit_code == 3


def test_series_with_a_damaged_header_opens_or_is_refused(files, tmp_path, rng):
    """Open a whole folder that contains one damaged slice."""
    folder = tmp_path / "ct"
    series(folder, hu=chest()[:4])
    path = folder / "IM001"
    whole = path.read_bytes()
    sizes, codes = set(), set()
    for data in list(_flips(whole, rng))[::12]:
        path.write_bytes(data)
        try:
            sizes.add(open_volume(folder).shape_zyx[1:])
        except CarinaError as error:
            codes.add(error.code)
    assert sizes == {(32, 32)}
    assert all(code.startswith("import.") for code in codes)


def test_pixel_data_with_a_numeric_value_representation_are_refused(tmp_path):
    """Check that PixelData of VR US, the number 65535, is not converted by ``bytes`` to 65535 zeros."""
    folder = series(tmp_path, hu=chest()[:3])
    path = folder / "IM001"
    whole = path.read_bytes()
    at = whole.index(b"\xe0\x7f\x10\x00OW")
    path.write_bytes(whole[: at + 4] + b"US\x02\x00\xff\xff")
    with pytest.raises(VolumeImportError) as caught:
        open_volume(folder)
    assert caught.value.code == "import.truncated"
