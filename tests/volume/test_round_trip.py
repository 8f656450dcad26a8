"""Round trips of grids in 48 orientations and on oblique axes, checked voxel by voxel with three other readers.

Every voxel has a unique value, so that a reader's positions are compared for each voxel: at most 1e-3 mm away.
"""

from __future__ import annotations

import itertools
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from dicom_writer import series
from other_readers import DCM2NIIX, READERS, TOLERANCE_MM, Block

from carina.volume import open_volume, write_grid

SHAPE_ZYX = (9, 11, 13)
SPACING_MM = np.array([0.7, 0.9, 1.3])
ORIGIN_LPS = np.array([-31.25, 12.5, 140.75])
NUMBERS = (np.arange(np.prod(SHAPE_ZYX)).reshape(SHAPE_ZYX) - 400).astype(np.int16)


def directions() -> dict[str, np.ndarray]:
    """Return unit axes as columns: 48 orientations along the patient's axes, and 8 oblique grids with both hands."""
    found = {}
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            letters = "".join(("LR", "PA", "SI")[axis][sign < 0] for axis, sign in zip(order, signs, strict=True))
            found[letters] = np.eye(3)[:, order] * signs
    random = np.random.default_rng(48)
    for number in range(8):
        turned = np.linalg.qr(random.normal(size=(3, 3)))[0]
        if (np.linalg.det(turned) > 0) != (number % 2 == 0):
            turned[:, 2] *= -1
        found[f"oblique {number}"] = turned
    return found


DIRECTIONS = directions()


def matrix_of(name: str) -> np.ndarray:
    """Return the transform from voxels to LPS of a grid."""
    matrix = np.eye(4)
    matrix[:3, :3] = DIRECTIONS[name] * SPACING_MM
    matrix[:3, 3] = ORIGIN_LPS
    return matrix


def placed(values_zyx: np.ndarray, lps_from_ijk: np.ndarray) -> dict[int, np.ndarray]:
    """Return the position of each value of a block in LPS mm."""
    kk, jj, ii = np.indices(values_zyx.shape)
    points = np.stack([ii, jj, kk], axis=-1).reshape(-1, 3) @ lps_from_ijk[:3, :3].T + lps_from_ijk[:3, 3]
    return dict(zip(np.rint(values_zyx).astype(int).ravel().tolist(), points, strict=True))


def largest_error_mm(blocks: list[Block], name: str) -> float:
    """Return the largest distance of a voxel from its true position; infinite if a value is missing or is new."""
    expected = placed(NUMBERS, matrix_of(name))
    found: dict[int, np.ndarray] = {}
    for block in blocks:
        found |= placed(block.values_zyx, block.lps_from_ijk)
    if found.keys() != expected.keys():
        return float("inf")
    return float(max(np.linalg.norm(found[value] - expected[value]) for value in expected))


def by_nifti_header(path: Path) -> Iterator[Block]:
    """Yield the image of an uncompressed NIfTI file by the fields of nifti1.h: the sform, and int16 values."""
    data = path.read_bytes()
    nx, ny, nz = struct.unpack_from("<3h", data, 42)
    begin = int(struct.unpack_from("<f", data, 108)[0])
    matrix = np.eye(4)
    matrix[:3] = np.diag([-1.0, -1.0, 1.0]) @ np.reshape(struct.unpack_from("<12f", data, 280), (3, 4))
    yield Block(np.frombuffer(data, "<i2", nx * ny * nz, begin).reshape(nz, ny, nx), matrix)


@pytest.mark.parametrize("name", DIRECTIONS)
@pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".nrrd", ".mha"])
def test_grid_file_has_every_voxel_at_its_position_in_carina_and_other_readers(tmp_path, suffix, name):
    path = write_grid(tmp_path / f"ct{suffix}", NUMBERS, matrix_of(name), what="the grid")
    volume = open_volume(path)
    assert largest_error_mm([Block(volume.hu_zyx, volume.lps_from_ijk)], name) < TOLERANCE_MM
    assert largest_error_mm(list(READERS["SimpleITK"](path)), name) < TOLERANCE_MM
    if ".nii" in suffix:
        assert largest_error_mm(list(READERS["nibabel"](path)), name) < TOLERANCE_MM
    if suffix == ".nii":
        assert largest_error_mm(list(by_nifti_header(path)), name) < TOLERANCE_MM


@pytest.mark.parametrize("name", DIRECTIONS)
def test_dicom_series_has_every_voxel_at_its_position_in_carina_and_other_readers(tmp_path, name):
    matrix = matrix_of(name)

    def place(dataset, index: int) -> None:
        dataset.PixelSpacing = [float(SPACING_MM[1]), float(SPACING_MM[0])]
        dataset.ImageOrientationPatient = [f"{v:.12f}" for v in DIRECTIONS[name][:, :2].T.ravel()]
        dataset.ImagePositionPatient = [f"{v:.9f}" for v in matrix[:3, 3] + index * matrix[:3, 2]]

    folder = series(tmp_path / "scan", place, hu=NUMBERS)
    volume = open_volume(folder)
    assert largest_error_mm([Block(volume.hu_zyx, volume.lps_from_ijk)], name) < TOLERANCE_MM
    for reader in ("pydicom", "SimpleITK"):
        assert largest_error_mm(list(READERS[reader](folder)), name) < TOLERANCE_MM, reader


@pytest.mark.skipif(DCM2NIIX is None, reason="dcm2niix is not installed (Debian package dcm2niix)")
@pytest.mark.parametrize("name", DIRECTIONS)
def test_dicom_series_has_every_voxel_at_its_position_in_dcm2niix(tmp_path, name):
    matrix = matrix_of(name)

    def place(dataset, index: int) -> None:
        dataset.InstanceNumber = index + 1
        dataset.PixelSpacing = [float(SPACING_MM[1]), float(SPACING_MM[0])]
        dataset.ImageOrientationPatient = [f"{v:.12f}" for v in DIRECTIONS[name][:, :2].T.ravel()]
        dataset.ImagePositionPatient = [f"{v:.9f}" for v in matrix[:3, 3] + index * matrix[:3, 2]]

    folder = series(tmp_path / "scan", place, hu=NUMBERS)
    assert largest_error_mm(list(READERS["dcm2niix"](folder)), name) < TOLERANCE_MM


def test_exchanged_left_and_right_exceeds_the_tolerance(tmp_path):
    path = write_grid(tmp_path / "ct.nii", NUMBERS, matrix_of("LPS"), what="the grid")
    assert largest_error_mm(list(READERS["SimpleITK"](path)), "RPS") > 1.0
