"""Tests of the tolerance of the angles between the axes of a grid, which is equal for every format."""

from __future__ import annotations

import itertools

import grid_writers as grids
import nifti_qform_writer
import numpy as np
import pytest

from carina.errors import VolumeImportError
from carina.volume import open_volume
from carina.volume.axis_angles import has_right_angles, skew_deg, with_orthogonal_axes

SHAPE_IJK = grids.SHAPE_ZYX[::-1]
FORMATS = ["nifti", "nrrd", "metaimage"]


def skewed(degrees: float, pair: tuple[int, int] = (0, 1)) -> np.ndarray:
    """Return the matrix of ``grid_writers`` with the second axis of a pair rotated towards the first axis."""
    matrix = grids.LPS_FROM_IJK.copy()
    directions = grids.DIRECTIONS
    angle = np.radians(degrees)
    one, other = pair
    matrix[:3, other] = (np.sin(angle) * directions[:, one] + np.cos(angle) * directions[:, other]) * (
        grids.SPACING_MM[other]
    )
    return matrix


def write(folder, kind: str, lps_from_ijk: np.ndarray):
    values = grids.chest()
    if kind == "nifti":
        return grids.nifti(folder, values, lps_from_ijk=lps_from_ijk)
    if kind == "nrrd":
        return grids.nrrd(folder, values, lps_from_ijk=lps_from_ijk)
    directions = (lps_from_ijk[:3, :3] / np.linalg.norm(lps_from_ijk[:3, :3], axis=0)).T

    def edit(lines):
        lines[5] = f"TransformMatrix = {' '.join(map(repr, directions.ravel().tolist()))}"

    return grids.metaimage(folder, values, edit=edit)


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("pair", [(0, 1), (1, 2), (2, 0)])
@pytest.mark.parametrize("degrees", [0.001, 0.02, 0.05, 0.1, 0.17, 0.199])
def test_axes_within_the_angle_tolerance_open_with_the_affine_matrix_of_the_file(tmp_path, kind, pair, degrees):
    expected = skewed(degrees, pair)
    volume = open_volume(write(tmp_path, kind, expected))
    np.testing.assert_allclose(volume.lps_from_ijk, expected, rtol=0, atol=2e-5)
    np.testing.assert_array_equal(volume.hu_zyx, grids.chest())
    assert volume.source.notes == ()


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("pair", [(0, 1), (1, 2), (2, 0)])
def test_axes_beyond_both_angle_tolerances_are_refused_in_every_format(tmp_path, kind, pair):
    with pytest.raises(VolumeImportError, match=r"sheared: two of them meet at 8\d\.\d instead of 90") as caught:
        open_volume(write(tmp_path, kind, skewed(0.7, pair)))
    assert caught.value.code == "import.geometry.sheared"


@pytest.mark.parametrize("digits", [3, 4, 5])
def test_oblique_nifti_with_rounded_numbers_opens(tmp_path, digits):
    rounded = grids.LPS_FROM_IJK.copy()
    rounded[:3, :3] = np.round(_turn(0.19) @ rounded[:3, :3], digits)
    assert skew_deg(rounded) < 0.2
    volume = open_volume(grids.nifti(tmp_path, grids.chest(), lps_from_ijk=rounded))
    np.testing.assert_allclose(volume.lps_from_ijk, rounded, rtol=0, atol=2e-5)


def _turn(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


@pytest.mark.parametrize("degrees", [0.02, 0.1, 0.19])
def test_nifti_whose_qform_is_the_nearest_rotation_to_its_sheared_sform_opens(tmp_path, degrees):
    # nibabel and dcm2niix write as qform the rotation that is nearest to the sform.
    expected = skewed(degrees, (1, 2))
    path = nifti_qform_writer.with_both_forms(tmp_path, expected, nifti_qform_writer.nearest_rotation(expected))
    np.testing.assert_allclose(open_volume(path).lps_from_ijk, expected, rtol=0, atol=2e-5)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_nifti_whose_qform_mirrors_its_sform_is_refused(tmp_path, axis):
    mirrored = grids.LPS_FROM_IJK.copy()
    mirrored[:3, axis] *= -1
    path = nifti_qform_writer.with_both_forms(tmp_path, grids.LPS_FROM_IJK, mirrored)
    with pytest.raises(VolumeImportError, match="qform and sform disagree") as caught:
        open_volume(path)
    assert caught.value.code == "import.geometry.ambiguous"


def test_axes_just_below_the_angle_tolerance_are_accepted_and_just_above_refused():
    # With 100 voxels of 1 mm, a shift of 0.1 mm is 0.058 degrees: the limit of 0.2 degrees is larger and applies.
    wide = (100, 100, 100)
    for pair in itertools.combinations(range(3), 2):
        for degrees, accepted in ((0.2, True), (0.1999, True), (0.2001, False), (-0.2, True), (-0.2001, False)):
            matrix = np.eye(4)
            angle = np.radians(degrees)
            matrix[:3, pair[1]] = 0
            matrix[pair[0], pair[1]], matrix[pair[1], pair[1]] = np.sin(angle), np.cos(angle)
            assert has_right_angles(matrix, wide) is accepted, (pair, degrees)
            assert skew_deg(matrix) == pytest.approx(abs(degrees), abs=1e-9)


def test_grid_with_a_short_axis_that_deviates_by_0_1_mm_opens():
    for lean_mm, accepted in ((0.1, True), (0.0999, True), (0.1001, False)):
        matrix = np.eye(4)
        sine = lean_mm / 4  # five slices of 1 mm
        matrix[:3, 2] = sine, 0, np.sqrt(1 - sine**2)
        assert has_right_angles(matrix, (100, 100, 5)) is accepted
        assert not has_right_angles(matrix, (100, 100, 6))


def test_straightened_axes_are_orthogonal_and_have_the_same_spacing_and_origin():
    matrix = skewed(0.2)
    straight = with_orthogonal_axes(matrix)
    assert skew_deg(straight) < 1e-6
    np.testing.assert_allclose(np.linalg.norm(straight[:3, :3], axis=0), np.linalg.norm(matrix[:3, :3], axis=0))
    np.testing.assert_array_equal(straight[:3, 3], matrix[:3, 3])
    # Each of the two axes is rotated by half of the angle.
    cosine = np.sum(straight[:3, :3] * matrix[:3, :3], axis=0) / np.sum(matrix[:3, :3] ** 2, axis=0)
    np.testing.assert_allclose(np.degrees(np.arccos(np.minimum(cosine, 1))), (0.1, 0.1, 0), atol=1e-4)


def test_axis_of_length_zero_has_no_angle():
    assert np.isnan(skew_deg(np.diag([0.0, 1.0, 1.0, 1.0])))
    assert np.isnan(skew_deg(np.diag([np.nan, 1.0, 1.0, 1.0])))
