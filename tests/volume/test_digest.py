"""Tests of the digest of a CT: equal in every file format and axis order, different for another CT."""

from __future__ import annotations

import gc
import hashlib
import tracemalloc
from itertools import permutations, product
from types import SimpleNamespace

import dicom_writer
import grid_writers
import numpy as np
import pytest
import SimpleITK as sitk
from grid_writers import FORMS, LPS_FROM_IJK

from carina.errors import CancelledError, VolumeImportError
from carina.volume import (
    Volume,
    canonical_geometry,
    ct_digest,
    digest,
    open_volume,
    refuse_other_ct,
    same_geometry,
    write_grid,
)

ORDERS = [(axes, flips) for axes in permutations(range(3)) for flips in product((False, True), repeat=3)]


def turned(volume: Volume, axes_ijk, flips) -> Volume:
    """Return the volume with the order and direction of its array axes changed; voxels keep their positions."""
    values = volume.hu_zyx.transpose([2 - axes_ijk[2 - n] for n in range(3)])
    old_from_new = np.zeros((4, 4))
    old_from_new[3, 3] = 1.0
    for new, (axis, flip) in enumerate(zip(axes_ijk, flips, strict=True)):
        old_from_new[axis, new] = -1.0 if flip else 1.0
        old_from_new[axis, 3] = volume.hu_zyx.shape[2 - axis] - 1.0 if flip else 0.0
    values = values[tuple(slice(None, None, -1 if flip else 1) for flip in reversed(flips))]
    return Volume(np.ascontiguousarray(values), volume.lps_from_ijk @ old_from_new)


def numbered(shape_zyx=(3, 4, 5), lps_from_ijk: np.ndarray = LPS_FROM_IJK) -> Volume:
    """Return a volume with a different value in every voxel."""
    return Volume(np.arange(np.prod(shape_zyx), dtype=np.int16).reshape(shape_zyx), lps_from_ijk)


def about(axis: int, degrees: float) -> np.ndarray:
    """Return the 4x4 rotation about x, y or z, combined with three different spacings."""
    matrix, (a, b) = np.eye(4), [n for n in range(3) if n != axis]
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    matrix[a, a], matrix[a, b], matrix[b, a], matrix[b, b] = cos, -sin, sin, cos
    return matrix @ np.diag([0.7, 0.8, 1.25, 1.0])


@pytest.fixture(scope="module")
def chest() -> Volume:
    """Return the volume that a grid file in any form must give."""
    return Volume(grid_writers.chest(), LPS_FROM_IJK)


@pytest.mark.parametrize("form", FORMS)
def test_every_grid_file_format_gives_the_digest_and_geometry_of_its_array(form, chest, tmp_path):
    opened = open_volume(FORMS[form](tmp_path, grid_writers.chest()))
    assert ct_digest(opened) == ct_digest(chest)
    assert same_geometry(opened, chest)


@pytest.mark.parametrize(("axes", "flips"), [((0, 1, 2), (False,) * 3), ((2, 0, 1), (True, False, True))])
def test_dicom_series_and_its_exports_have_equal_digest_and_geometry(axes, flips, tmp_path):
    series = open_volume(dicom_writer.series(tmp_path / "series"))
    stored = turned(series, axes, flips)
    for suffix in (".nii", ".nii.gz", ".nrrd", ".mha"):
        path = write_grid(tmp_path / f"ct{suffix}", stored.hu_zyx, stored.lps_from_ijk, what="the CT", level=1)
        opened = open_volume(path)
        assert ct_digest(opened) == ct_digest(series)
        assert same_geometry(opened, series)
        refuse_other_ct(opened, ct_digest(series), canonical_geometry(series))


def test_ct_digest_does_not_depend_on_the_file_order_of_the_slices(tmp_path):
    there = open_volume(dicom_writer.series(tmp_path / "a"))
    back = open_volume(dicom_writer.series(tmp_path / "b", name=lambda index: f"{99 - index:03d}"))
    assert ct_digest(there) == ct_digest(back)


def test_ct_values_rounded_on_import_have_one_digest_in_every_format(tmp_path):
    whole = grid_writers.chest()
    broken = (whole + np.float32(0.25)).astype("<f4")
    for write in (grid_writers.nifti, grid_writers.nrrd, grid_writers.metaimage):
        assert ct_digest(open_volume(write(tmp_path, broken))) == ct_digest(Volume(whole, LPS_FROM_IJK))


@pytest.mark.parametrize("lps_from_ijk", [np.diag([0.7, 0.8, 1.25, 1.0]), LPS_FROM_IJK, about(1, -31.0)])
def test_axis_order_and_direction_change_neither_digest_nor_geometry_of_a_ct(lps_from_ijk):
    volume = numbered(lps_from_ijk=lps_from_ijk)
    for axes, flips in ORDERS:
        other = turned(volume, axes, flips)
        assert ct_digest(other) == ct_digest(volume)
        assert same_geometry(other, volume)
        assert canonical_geometry(other).shape_zyx == canonical_geometry(volume).shape_zyx
        assert canonical_geometry(other).lps_from_ijk == pytest.approx(canonical_geometry(volume).lps_from_ijk)


@pytest.mark.parametrize("degrees", [-45.0, 45.0, 135.0])
@pytest.mark.parametrize("axis", range(3))
def test_ct_digest_at_45_degrees_tilt_does_not_depend_on_the_last_bit_of_the_header(axis, degrees):
    volume = numbered(lps_from_ijk=about(axis, degrees))
    nudges = np.random.default_rng(1)
    for axes, flips in ORDERS:
        other = turned(volume, axes, flips)
        header = other.lps_from_ijk.copy()
        header[:3, :3] *= 1 + nudges.uniform(-1e-7, 1e-7, (3, 3))
        assert ct_digest(Volume(other.hu_zyx, header)) == ct_digest(volume)


def test_ct_digest_is_the_sha256_of_the_volume_in_itk_lps_orientation(chest):
    image = sitk.GetImageFromArray(chest.hu_zyx)
    image.SetDirection(grid_writers.DIRECTIONS.ravel())
    values = sitk.GetArrayFromImage(sitk.DICOMOrient(image, "LPS"))
    assert ct_digest(chest) == hashlib.sha256(values.astype("<i2").tobytes()).hexdigest()


def test_volume_in_canonical_orientation_is_returned_unchanged():
    canonical = canonical_geometry(numbered())
    again = canonical_geometry(canonical)
    assert again.shape_zyx == canonical.shape_zyx
    assert np.array_equal(again.lps_from_ijk, canonical.lps_from_ijk)


@pytest.mark.parametrize("shape_zyx", [(1, 4, 5), (3, 1, 5), (3, 4, 1), (1, 1, 5), (1, 1, 1)])
def test_ct_digest_does_not_depend_on_the_position_of_an_axis_of_one_voxel(shape_zyx):
    volume = numbered(shape_zyx)
    for axes, flips in ORDERS:
        assert ct_digest(turned(volume, axes, flips)) == ct_digest(volume)
        assert same_geometry(turned(volume, axes, flips), volume)


def test_one_changed_voxel_changes_the_ct_digest():
    values = numbered().hu_zyx.copy()
    values[-1, -1, -1] += 1
    assert ct_digest(Volume(values, LPS_FROM_IJK)) != ct_digest(numbered())


def test_mirrored_chest_has_another_digest():
    volume = numbered()
    mirrored = Volume(np.ascontiguousarray(volume.hu_zyx[:, :, ::-1]), LPS_FROM_IJK)
    assert ct_digest(mirrored) != ct_digest(volume)


@pytest.mark.parametrize(("moved_mm", "same"), [(0.0009, True), (0.0011, False)])
def test_positions_of_two_cts_are_compared_to_a_thousandth_of_a_millimetre(moved_mm, same):
    moved = LPS_FROM_IJK.copy()
    moved[2, 3] += moved_mm
    assert same_geometry(numbered(), numbered(lps_from_ijk=moved)) is same


def test_positions_of_two_cts_are_also_compared_at_the_far_corner():
    longer = LPS_FROM_IJK.copy()
    longer[:3, 2] *= 1 + 1e-5
    assert same_geometry(numbered((3, 4, 5)), numbered((3, 4, 5), longer))
    assert not same_geometry(numbered((300, 4, 5)), numbered((300, 4, 5), longer))


def test_ct_digest_is_computed_in_parts_without_a_copy_of_the_volume(monkeypatch):
    volume = turned(numbered((40, 60, 50)), (2, 1, 0), (True, False, False))
    expected = ct_digest(volume)
    monkeypatch.setattr(digest, "_SLAB_BYTES", 7000)
    gc.collect()
    tracemalloc.start()
    try:
        assert ct_digest(Volume(volume.hu_zyx, volume.lps_from_ijk)) == expected
        assert tracemalloc.get_traced_memory()[1] < volume.hu_zyx.nbytes / 4
    finally:
        tracemalloc.stop()


def test_computation_of_a_digest_can_be_cancelled():
    with pytest.raises(CancelledError):
        ct_digest(numbered(), cancel=lambda: True)


def case_of(volume: Volume) -> tuple[str, SimpleNamespace]:
    """Return the digest and the geometry of a CT as a case stores them."""
    geometry = canonical_geometry(volume)
    return ct_digest(volume), SimpleNamespace(shape_zyx=geometry.shape_zyx, lps_from_ijk=geometry.lps_from_ijk)


def test_another_ct_than_that_of_the_case_is_refused_with_the_stated_difference():
    values = numbered().hu_zyx.copy()
    values[0, 0, 0] = 7
    with pytest.raises(VolumeImportError, match="its voxel values differ") as caught:
        refuse_other_ct(Volume(values, LPS_FROM_IJK), *case_of(numbered()))
    assert caught.value.code == "import.other-ct"
    with pytest.raises(VolumeImportError, match=r"expected .* voxels, found") as caught:
        refuse_other_ct(numbered((3, 4, 6)), *case_of(numbered()))
    assert caught.value.code == "import.other-ct"
    moved = LPS_FROM_IJK.copy()
    moved[0, 3] += 3.25
    with pytest.raises(VolumeImportError, match=r"by up to 3\.25 mm") as caught:
        refuse_other_ct(numbered(lps_from_ijk=moved), *case_of(numbered()))
    assert caught.value.code == "import.other-geometry"


def test_ct_with_equal_bytes_in_another_shape_is_refused_for_a_case():
    flat = Volume(np.zeros((2, 3, 4), dtype=np.int16), LPS_FROM_IJK)
    tall = Volume(np.zeros((4, 3, 2), dtype=np.int16), LPS_FROM_IJK)
    assert ct_digest(flat) == ct_digest(tall)
    with pytest.raises(VolumeImportError, match="a different CT"):
        refuse_other_ct(tall, *case_of(flat))


def test_ct_digest_of_a_volume_is_computed_only_once(monkeypatch):
    volume = numbered()
    found = ct_digest(volume)
    monkeypatch.setattr(digest, "canonical_axes", None)
    assert ct_digest(volume) == found
