"""Tests that odd but honest inputs open with the right voxels and positions.

The voxels are compared with those from which an input was made. Voxels and positions are also compared with those of
other readers: pydicom with a few lines of own code for classic DICOM, and SimpleITK for classic DICOM and grid files.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pydicom
import pytest
import SimpleITK as sitk
from corpus import Input
from honest_inputs import KINDS, REPORTED

from carina.volume import Volume, open_volume

_GRIDS = (".nii", ".nii.gz", ".nrrd", ".nhdr", ".mha", ".mhd")
_TOLERANCE_MM = 1e-3
"""Largest distance of positions that two readers may give; headers with float32 cause about 1e-4 mm."""


def slices_of(folder: Path, volume: Volume) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield position and HU of each classic slice of the opened series, by PS3.3 C.7.6.2.1.1 and C.11.1."""
    for path in sorted(folder.rglob("*")):
        if not path.is_file() or path.read_bytes()[128:132] != b"DICM":
            continue
        data = pydicom.dcmread(path)
        if "PixelData" in data and "NumberOfFrames" not in data and data.get("ImagePositionPatient"):
            hu = data.pixel_array.astype(np.float64) * float(data.get("RescaleSlope") or 1)
            yield np.array(data.ImagePositionPatient, float), hu + float(data.get("RescaleIntercept") or 0)


def agrees_with_pydicom(path: Path, volume: Volume) -> bool | None:
    """Compare every slice of the volume with a slice of the files at its position; None if there are no such files."""
    if not path.is_dir():
        return None
    found = list(slices_of(path, volume))
    is_padded = any(note.code == "import.padding" for note in volume.source.notes)
    if not found:
        return None
    for k, plane in enumerate(volume.hu_zyx):
        corner = volume.lps_from_ijk[:3] @ [0, 0, k, 1]
        here = [hu for at, hu in found if np.linalg.norm(at - corner) < _TOLERANCE_MM]
        # Padding was set to air, the lowest value; a reader without that rule returns the stored value there.
        inside = plane > volume.hu_zyx.min() if is_padded else np.ones(plane.shape, dtype=bool)
        if not any(hu.shape == plane.shape and np.array_equal(np.rint(hu)[inside], plane[inside]) for hu in here):
            return False
    return True


def agrees_with_simpleitk(path: Path, volume: Volume) -> bool | None:
    """Compare grid and voxels with those of SimpleITK; None if SimpleITK does not read the input."""
    if not path.name.lower().endswith(_GRIDS) or not path.name.isprintable():
        return None  # SimpleITK ends the process for a name that is not UTF-8
    try:
        image = sitk.ReadImage(str(path))
    except RuntimeError:
        return None
    if image.GetSize()[3:] == (1,):
        image = image[:, :, :, 0]
    values = sitk.GetArrayFromImage(image)
    if values.shape != volume.shape_zyx:
        return False
    ni, nj, nk = (n - 1 for n in image.GetSize())
    for ijk in ((0, 0, 0), (ni, 0, 0), (0, nj, 0), (0, 0, nk), (ni, nj, nk)):
        expected = image.TransformContinuousIndexToPhysicalPoint([float(v) for v in ijk])
        if np.linalg.norm(volume.lps_from_ijk[:3] @ [*ijk, 1] - expected) > _TOLERANCE_MM:
            return False
    return bool(np.abs(np.rint(values.astype(np.float64)) - volume.hu_zyx).max() <= 1)


# The voxels of these inputs are compared with those from which they were made, as those of all inputs.
OTHERWISE_READ = {
    "one file, compressed": "MetaIO needs CompressedDataSize, which other programs leave out",
    "64-bit floats, compressed": "MetaIO needs CompressedDataSize, which other programs leave out",
    "slope 0: neither slope nor intercept (-1024) is applied": "ITK adds the intercept, nifti1.h forbids it",
    "NIfTI, axes 0.17 degrees off, the nearest rotation as qform": "ITK uses the nearest rotation, 0.03 mm away",
}
"""Inputs that SimpleITK reads otherwise, with the reason."""


@pytest.mark.parametrize("entry", KINDS, ids=[f"{entry.family}: {entry.name}" for entry in KINDS])
def test_honest_input_opens_with_the_right_voxels_and_positions(tmp_path, entry: Input):
    path = entry.make(tmp_path)
    volume = open_volume(path)
    assert volume.is_hu
    assert [note.code for note in volume.source.notes] == list(entry.notes)
    np.testing.assert_array_equal(volume.hu_zyx, entry.voxels())
    assert agrees_with_pydicom(path, volume) in (True, None)
    if entry.name not in OTHERWISE_READ:
        assert agrees_with_simpleitk(path, volume) in (True, None)


def test_table_has_enough_kinds():
    families = Counter(entry.family for entry in KINDS)
    assert len(KINDS) >= 48
    assert len({(entry.family, entry.name) for entry in KINDS}) == len(KINDS)
    assert len(families) >= 10
    assert sum(bool(report) for _, _, report in REPORTED.values()) >= 12
