"""Tests of the path grid: which slices are divided, and conversion of masks and voxels to the CT's grid."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import carina
from cached_test_data import cached_phantom
from carina.errors import NoResultError, UsageError
from carina.track import edit_airways, rebuild_airways
from carina.track.edit.edit_list import CutBranch, PaintLumen
from carina.track.edit.undo_storage import fold_airways
from carina.track.find.growth import grow
from carina.track.paths.path_grid import PathGrid
from carina.track.tree.airway_tree import Branch
from carina.track.tree.uncertainty import with_path_probability
from carina.volume import Volume


def volume(spacing_mm, shape_zyx=(20, 24, 28)):
    values = np.random.default_rng(0).integers(-1000, 100, shape_zyx).astype(np.int16)
    return Volume(values, np.diag([*spacing_mm, 1.0]))


@pytest.mark.parametrize(
    ("spacing_mm", "parts"),
    [
        pytest.param((0.7, 0.7, 0.7), 1, id="voxels of one size"),
        pytest.param((0.55, 0.55, 0.9), 1, id="0.9 mm"),
        pytest.param((0.6, 0.6, 0.95), 2, id="0.95 mm"),
        pytest.param((0.7, 0.7, 1.0), 1, id="1 mm, hardly thicker than the voxels are wide"),
        pytest.param((0.7, 0.7, 1.25), 2, id="1.25 mm"),
        pytest.param((0.7, 0.7, 1.5), 2, id="1.5 mm"),
        pytest.param((0.7, 0.7, 2.26), 2, id="a quarter thicker than two parts"),
        pytest.param((0.7, 0.7, 3.0), 3, id="3 mm"),
        pytest.param((0.7, 0.7, 5.0), 5, id="5 mm"),
        pytest.param((0.7, 3.0, 0.7), 3, id="slices along another axis"),
        pytest.param((1.37, 1.37, 3.0), 3, id="wide voxels"),
        pytest.param((1.0, 1.0000000000000002, 1.5), 2, id="rounding error at the limit"),
        pytest.param((3.0, 3.0, 3.0), 1, id="coarse voxels of one size"),
    ],
)
def test_only_slices_that_are_much_thicker_than_the_voxels_are_wide_are_divided(spacing_mm, parts):
    grid = PathGrid.of(volume(spacing_mm))
    assert grid.parts == parts
    assert grid.is_divided is (parts > 1)
    assert (grid.volume is grid.ct) is (parts == 1)
    assert PathGrid.parts_of(grid.ct, grid.shape_zyx) == parts
    assert PathGrid.parts_of(grid.ct, (20, 24, 29)) is None


def test_grid_of_a_case_file_with_more_divisions_than_needed_is_refused():
    # A damaged or malicious case file must not make Carina interpolate a volume of many times the CT's memory.
    ct = volume((0.7, 0.7, 0.8))
    nz, ny, nx = ct.shape_zyx
    assert PathGrid.parts_of(ct, (nz, ny, nx)) == 1
    assert PathGrid.parts_of(ct, (2 * nz, ny, nx)) is None
    assert PathGrid.parts_of(volume((0.7, 0.7, 50.0)), (17 * nz, ny, nx)) is None


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_ct_grid_and_divided_grid_cover_the_same_region(axis):
    spacing = [0.7, 0.7, 0.7]
    spacing[axis] = 3.0
    ct = volume(spacing)
    grid = PathGrid.of(ct)
    for corner in (-0.5, 0.5):
        at = np.zeros(3) + corner
        ends = [np.where(corner < 0, at, np.array(one.shape_zyx[::-1]) - 1 + at) for one in (ct, grid.volume)]
        np.testing.assert_allclose(ct.to_lps(ends[0]), grid.volume.to_lps(ends[1]), atol=1e-9)
    # The middle part of each divided voxel corresponds to the voxel.
    voxels = np.array([[3, 4, 5], [10, 11, 12]], dtype=np.uint16)
    parts = grid.voxels_in(voxels)
    assert len(parts) == 6
    there = np.unique(np.floor(ct.to_ijk(grid.volume.to_lps(parts.astype(float))) + 0.5), axis=0)
    np.testing.assert_array_equal(there, voxels)


def test_volume_with_permuted_axes_is_interpolated_to_the_same_values():
    ct = volume((0.7, 0.7, 3.0))
    turned = ct.lps_from_ijk.copy()
    turned[:3, 3] += turned[:3, 2] * (ct.shape_zyx[0] - 1)
    turned[:3, 2] *= -1.0
    other = dataclasses.replace(ct, hu_zyx=np.ascontiguousarray(ct.hu_zyx[::-1]), lps_from_ijk=turned)
    np.testing.assert_array_equal(PathGrid.of(other).volume.hu_zyx[::-1], PathGrid.of(ct).volume.hu_zyx)


def test_mask_on_the_ct_grid_includes_each_centreline_and_voxels_that_are_at_least_half_set():
    ct = volume((0.7, 0.7, 3.0))
    grid = PathGrid.of(ct)
    lumen = np.zeros(grid.shape_zyx, dtype=np.uint8)
    lumen[3:5, 8, 9] = 1  # two of the three parts of slice 1
    lumen[8, 8, 4:20] = 1  # one of the three parts of slice 2
    np.testing.assert_array_equal(np.argwhere(grid.mask_on_ct(lumen)), [[1, 8, 9]])
    line = grid.volume.to_lps(np.array([[4.0, 8.0, 8.0], [19.0, 8.0, 8.0]]))
    branch = Branch(0, None, (), 0, None, "tracked", line, np.ones(2))
    found = grid.lumen_on_ct(lumen, [branch])
    assert found[1, 8, 9] == 1
    assert found[2, 8, 4] == found[2, 8, 19] == 1
    assert found.sum() > 4
    assert set(np.argwhere(found)[:, 0]) == {1, 2}


@pytest.fixture(scope="module")
def thick():
    made = cached_phantom(seed=4, spacing_mm=(0.8, 0.8, 3.0), generations=5, noise_hu=15.0)
    return made.volume, carina.find_airways(made.volume)


def test_paths_are_searched_in_the_divided_grid_and_the_lumen_is_stored_on_the_ct_grid(thick):
    ct, airways = thick
    assert airways.tracker.grid.parts == 3
    assert airways.lumen_zyx.shape == ct.shape_zyx
    assert airways.tracker.lumen_zyx.shape == (3 * ct.shape_zyx[0], *ct.shape_zyx[1:])
    for branch in airways.tree.branches:
        i, j, k = np.floor(ct.to_ijk(branch.points) + 0.5).astype(int).T
        assert airways.lumen_zyx[k, j, i].all()
    tip = airways.tree.tips()[0]
    path = airways.tracker.path_to(tip.tip_lps)
    assert airways.tracker.inside(path.points_lps).all()


def test_edits_in_divided_slices_equal_those_from_scratch_and_are_restored_from_undo_storage(thick):
    ct, airways = thick
    tip = airways.tree.tips()[0]
    end = tuple(float(v) for v in tip.points[-1])
    edits = [CutBranch(tip.id), PaintLumen((end,), 2.0, "ball")]
    edited = airways
    for edit in edits:
        edited = edit_airways(ct, edited, edit)
    scratch = rebuild_airways(ct, airways, edits)
    for other in (scratch, fold_airways(edited).unfold()):
        np.testing.assert_array_equal(other.lumen_zyx, edited.lumen_zyx)
        np.testing.assert_array_equal(other.tracker.lumen_zyx, edited.tracker.lumen_zyx)
        assert len(other.tree) == len(edited.tree)
        for one, two in zip(other.tree.branches, edited.tree.branches, strict=True):
            np.testing.assert_array_equal(one.points, two.points)


def test_brush_in_divided_slices_covers_complete_voxels_of_the_ct(thick):
    ct, airways = thick
    tip = airways.tree.tips()[0]
    end = tuple(float(v) for v in tip.points[-1])
    painted = edit_airways(ct, airways, PaintLumen((end,), 2.0, "axial"))
    new = np.argwhere((painted.tracker.lumen_zyx != 0) & (airways.tracker.lumen_zyx == 0))
    assert len(new)
    slices = np.unique(new[:, 0] // 3)
    assert len(slices) == 1, "a disc is one slice of the CT thick"
    i, j, k = np.floor(ct.to_ijk(np.array(end)) + 0.5).astype(int)
    assert slices[0] == k
    assert painted.lumen_zyx[k, j, i] == 1
    rows, columns = new[:, 1], new[:, 2]
    assert painted.tracker.lumen_zyx[3 * k : 3 * k + 3, rows, columns].all()


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 2, 0), (2, 0, 1)])
def test_divided_slices_in_another_storage_order_give_equal_airways(thick, order):
    ct, airways = thick
    values = np.ascontiguousarray(ct.hu_zyx.transpose(order)[::-1])
    matrix = ct.lps_from_ijk.copy()
    matrix[:3, :3] = ct.lps_from_ijk[:3, :3][:, [2 - axis for axis in order[::-1]]]
    # The first axis of the array is reversed.
    matrix[:3, 3] += matrix[:3, 2] * (values.shape[0] - 1)
    matrix[:3, 2] *= -1.0
    other = Volume(values, matrix)
    found = carina.find_airways(other)
    assert found.tracker.grid.parts == 3
    assert found.tracker.lumen_zyx.shape == found.tracker.grid.shape_zyx
    np.testing.assert_array_equal(found.lumen_zyx, airways.lumen_zyx.transpose(order)[::-1])
    np.testing.assert_array_equal(found.tracker.lumen_zyx, airways.tracker.lumen_zyx.transpose(order)[::-1])
    for one, two in zip(found.tree.branches, airways.tree.branches, strict=True):
        np.testing.assert_allclose(one.points, two.points, atol=1e-6)
    root = found.tracker.volume.to_lps(np.array(found.tracker.root_ijk, dtype=float))
    assert np.linalg.norm(root - airways.tree.root.points[0]) < 2.0
    assert found.tracker.path_to(airways.tree.tips()[0].tip_lps).length_mm > 100.0


def test_search_uses_the_slices_of_the_ct_if_divided_slices_show_no_trachea(thick, monkeypatch):
    ct, _ = thick

    def grow_in_own_slices(disturbed, *arguments):
        if disturbed.grid.is_divided:
            raise NoResultError("no trachea was found")
        return grow(disturbed, *arguments)

    monkeypatch.setattr("carina.track.find.airways.grow", grow_in_own_slices)
    found = carina.find_airways(ct)
    assert found.tracker.grid.parts == 1
    assert found.tracker.lumen_zyx.shape == ct.shape_zyx
    assert len(found.tree) > 20


def test_edit_of_airways_found_in_another_ct_is_refused(thick):
    _, airways = thick
    other = volume((0.8, 0.8, 3.0))
    with pytest.raises(UsageError, match="belong to another CT"):
        edit_airways(other, airways, CutBranch(airways.tree.tips()[0].id))


def test_divided_slices_show_airways_not_visible_in_the_ct_slices(thick, monkeypatch):
    ct, airways = thick
    monkeypatch.setattr(PathGrid, "of", classmethod(lambda cls, volume: cls(volume)))
    whole = carina.find_airways(ct)
    lengths = [sum(branch.length_mm for branch in found.tree.branches) for found in (airways, whole)]
    truth = cached_phantom(seed=4, spacing_mm=(0.8, 0.8, 3.0), generations=5, noise_hu=15.0).truth
    lines = [np.array(row["points"]) for row in truth["branches"]]
    total = sum(float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum()) for line in lines)
    assert total - lengths[0] < 0.7 * (total - lengths[1]), "a smaller share is missed"
    axes = np.concatenate([np.array(row["points"]) for row in truth["branches"]])
    for branch in airways.tree.branches:
        off_mm = np.linalg.norm(branch.points[:, None] - axes[None], axis=2).min(axis=1)
        # The truth has a point every few millimetres, so the distance to the nearest point is not 0.
        assert np.median(off_mm) < 3.5


def test_branch_confidence_is_high_only_with_high_path_probability_and_wall_evidence():
    points = np.stack([np.zeros(12), np.zeros(12), -np.arange(12.0)], axis=1)
    branch = Branch(0, None, (), 0, None, "tracked", points, np.ones(12), confidence=0.5)

    def confidence_of(walls, way, off_mm=0.5):
        judged = np.column_stack([points + off_mm, np.full(12, way)])
        return with_path_probability(dataclasses.replace(branch, confidence=walls), judged).confidence

    # Without evidence of walls the probability of the path is the confidence.
    assert confidence_of(0.5, 0.8) == 0.8
    assert 0.5 < confidence_of(0.01, 0.8) < 0.8 < confidence_of(0.99, 0.8) < 0.95
    assert confidence_of(0.0, 0.8) == confidence_of(0.01, 0.8)
    assert confidence_of(1.0, 1.0) < 1.0
    # The confidence is high only if both values are high.
    assert confidence_of(0.999, 0.94) == confidence_of(0.94, 0.99) == 0.94
    assert confidence_of(0.97, 0.98) == 0.97
    # The confidence of a branch farther than 2 mm from a path is not limited by the path.
    assert confidence_of(0.99, 0.8, off_mm=5.0) == 0.99
    assert confidence_of(None, 0.8) is None
