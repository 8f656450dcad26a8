"""Tests of the automatic airway search in a synthetic chest with any storage order."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from carina.errors import CancelledError, GeometryError, NoResultError, UsageError
from carina.track import find_airways, lumen_threshold_from_histogram, track_paths
from carina.track.find.root_checks import refuse_a_root_below_the_carina
from carina.volume.model import Volume

STORED = [
    ((0, 1, 2), (False, False, False)),
    ((0, 1, 2), (True, False, False)),
    ((0, 1, 2), (False, True, True)),
    ((1, 2, 0), (False, False, True)),
    ((2, 0, 1), (True, False, True)),
    ((1, 0, 2), (True, True, True)),
]


@pytest.mark.parametrize(("axes", "flips"), STORED)
def test_branches_and_their_sides_are_found_correctly_for_any_storage_order(draw_chest, axes, flips):
    chest = draw_chest(axes=axes, flips=flips)
    airways = find_airways(chest.volume)
    tree = airways.tree
    assert len(tree) == 7
    assert sorted(branch.generation for branch in tree.branches) == [0, 1, 1, 2, 2, 2, 2]
    trachea, right, left = (tree.named(name) for name in ("Trachea", "RMB", "LMB"))
    assert trachea is tree.root
    # In LPS the patient's right is at lower x, whatever the axes of the grid are.
    assert right.tip_lps[0] < trachea.tip_lps[0] - 5.0
    assert left.tip_lps[0] > trachea.tip_lps[0] + 5.0
    # Tolerance 4 mm: the top of the drawn trachea is rounded, and a tilted slice shows only a part of it.
    assert np.linalg.norm(airways.root_lps[:2] - chest.tubes[0][0][:2]) < 4.0
    assert airways.root_lps[2] > chest.tubes[0][1][2] + 40.0


def test_found_lumen_is_the_drawn_lumen_and_excludes_the_lung(chest, found):
    nz, ny, nx = chest.volume.shape_zyx
    k, j, i = np.meshgrid(np.arange(nz), np.arange(ny), np.arange(nx), indexing="ij")
    depth = chest.depth_mm(chest.volume.to_lps(np.stack([i, j, k], axis=-1)))
    lumen = found.lumen_zyx.astype(bool)
    assert found.lumen_zyx.dtype == np.uint8
    assert not found.lumen_zyx.flags.writeable
    assert not (lumen & (depth > 0.8)).any()
    assert not (~lumen & (depth < -0.8)).any()


def test_centreline_points_are_inside_the_lumen_and_children_start_at_the_end_of_their_parent(found):
    for branch in found.tree.branches:
        assert found.tracker.inside(branch.points).all()
        assert branch.points.shape == (len(branch.radius), 3)
        if branch.parent is not None:
            assert branch.points[0].tobytes() == found.tree.branch(branch.parent).points[-1].tobytes()


def test_routes_are_smooth_and_list_their_forks(chest, found):
    for tip in found.tree.tips():
        route = found.tree.route_to(tip.id)
        assert len(route.forks_mm) == tip.generation == 2
        assert route.forks_mm == sorted(route.forks_mm)
        assert route.generation[0] == 0
        assert route.generation[-1] == 2
        assert (np.diff(route.generation) >= 0).all()
        assert route.branch_ids[-1] == tip.id
        assert chest.depth_mm(route.points_lps).max() < 0.0
        # The generation of the route's points changes at the forks, to within one point.
        changes = route.cumulative_mm[:-1][np.diff(route.generation) > 0]
        assert np.abs(changes - route.forks_mm).max() <= np.diff(route.cumulative_mm).max()
        steps = np.diff(route.points_lps, axis=0)
        steps /= np.linalg.norm(steps, axis=1, keepdims=True)
        turns = np.degrees(np.arccos(np.clip((steps[1:] * steps[:-1]).sum(axis=1), -1.0, 1.0)))
        # Without smoothing, a path of voxels turns by 20 to 45 degrees at every step; the drawn forks bend by 45
        # degrees over about 10 mm.
        assert turns.max() < 9.0


def test_given_root_outside_the_lumen_is_moved_within_5_mm_or_refused(chest):
    start, end, _ = chest.tubes[0]
    middle = 0.5 * (start + end)
    beside = find_airways(chest.volume, root_lps=middle + np.array([8.5, 0.0, 0.0]))
    assert any("moved" in note for note in beside.notes)
    assert chest.depth_mm(beside.root_lps) < 0.0
    with pytest.raises(NoResultError, match="not in an airway"):
        find_airways(chest.volume, root_lps=middle + np.array([16.0, 0.0, 0.0]))
    with pytest.raises(UsageError, match="outside the scan"):
        find_airways(chest.volume, root_lps=middle + np.array([500.0, 0.0, 0.0]))
    with pytest.raises(UsageError, match="expected a point"):
        find_airways(chest.volume, root_lps=[1.0, 2.0])


def test_given_root_in_a_crop_without_trachea_gives_a_tree(draw_chest):
    chest = draw_chest()
    # The volume contains only the right main bronchus and its branches.
    half = draw_chest(num_tubes=5)
    values = np.array(half.volume.hu_zyx)
    carina = chest.tubes[0][1]
    k, j, i = np.meshgrid(*(np.arange(n) for n in values.shape), indexing="ij")
    points = half.volume.to_lps(np.stack([i, j, k], axis=-1))
    values[(points[..., 2] > carina[2] - 4.0) | (points[..., 0] > carina[0] - 2.0)] = 30
    volume = Volume(values, half.volume.lps_from_ijk)
    with pytest.raises(NoResultError, match="no trachea"):
        find_airways(volume)
    start, end, _ = chest.tubes[1]
    airways = find_airways(volume, root_lps=0.5 * start + 0.5 * end)
    assert len(airways.tree.tips()) == 2
    assert all(branch.name is None for branch in airways.tree.branches)


def test_given_root_in_emphysematous_lung_is_refused_as_not_an_airway(chest):
    values = np.array(chest.volume.hu_zyx)
    # The values are those of emphysema: lung as dark as air.
    values[values < -700] = -950
    volume = Volume(values, chest.volume.lps_from_ijk)
    lung = 0.5 * (chest.tubes[1][0] + chest.tubes[1][1]) + [-20.0, 10.0, -6.0]
    with pytest.raises(NoResultError, match="merges with the lung"):
        find_airways(volume, root_lps=lung)


def test_chest_whose_trachea_does_not_divide_is_refused_with_a_message(draw_chest):
    with pytest.raises(NoResultError, match="trachea") as caught:
        find_airways(draw_chest(num_tubes=1).volume)
    assert caught.value.exit_code == 4
    assert "root" in str(caught.value)


def test_trachea_with_one_main_bronchus_is_reported_with_a_note(draw_chest, found):
    assert not any("may not have been identified" in note for note in found.notes)
    one = find_airways(draw_chest(num_tubes=2).volume)
    assert any("only one main bronchus" in note for note in one.notes)
    # The roots of both searches agree to within one slice.
    assert np.linalg.norm(one.root_lps - found.root_lps) < 3.0


def test_automatically_found_root_in_a_lower_bronchus_is_refused(chest, found):
    # From a root in a segmental bronchus the paths to three ends in the lung first lead up, as from a wrongly detected
    # trachea.
    start, end, _ = chest.tubes[3]
    lower = find_airways(chest.volume, lumen_zyx=found.lumen_zyx, root_lps=0.2 * start + 0.8 * end)
    assert lower.root_lps[2] < chest.tubes[0][1][2] - 20.0
    with pytest.raises(NoResultError, match="more distal bronchus"):
        refuse_a_root_below_the_carina(chest.volume, lower.tree.branches)


def test_volume_of_one_value_is_refused(rng):
    for fill in (40, -1000):
        flat = Volume(np.full((20, 20, 20), fill, np.int16), np.eye(4))
        with pytest.raises(NoResultError, match="no trachea"):
            find_airways(flat)
    noise = Volume(rng.integers(-1024, 400, (30, 40, 50)).astype(np.int16), np.eye(4))
    with pytest.raises(NoResultError, match="no trachea"):
        find_airways(noise)


def test_search_with_an_imported_mask_uses_its_voxels_as_the_lumen(chest, found):
    given = find_airways(chest.volume, lumen_zyx=found.lumen_zyx * np.uint8(7))
    assert len(given.tree) == len(found.tree)
    assert "RMB" in given.tree.names
    assert set(np.unique(given.lumen_zyx)) == {0, 1}
    with pytest.raises(GeometryError, match="shape"):
        find_airways(chest.volume, lumen_zyx=found.lumen_zyx[1:])
    with pytest.raises(NoResultError):
        find_airways(chest.volume, lumen_zyx=np.zeros_like(found.lumen_zyx))


def test_lumen_threshold_of_an_8_bit_volume_is_derived_from_its_histogram(chest):
    # The values of a lung window, -1050 to 450 HU, are mapped to 0 to 255.
    grey = np.clip((chest.volume.hu_zyx.astype(np.float64) + 1050.0) / 1500.0 * 255.0, 0, 255)
    volume = Volume(np.rint(grey).astype(np.int16), chest.volume.lps_from_ijk, is_hu=False, not_hu_reason="8 bit")
    threshold = lumen_threshold_from_histogram(volume)
    # In this window -800 HU is 42.5; the threshold from the histogram may differ by 60 HU (10 grey levels).
    assert abs(threshold - 42.5) < 10.0
    airways = find_airways(volume)
    assert airways.threshold == threshold
    assert len(airways.tree) == 7
    higher = find_airways(volume, lumen_threshold=threshold + 20)
    assert higher.lumen_zyx.sum() > airways.lumen_zyx.sum()


def test_lumen_threshold_below_the_values_of_air_in_the_trachea_is_refused(chest):
    with pytest.raises(UsageError, match="choose at least"):
        find_airways(chest.volume, lumen_threshold=-1100)


def test_airway_search_can_be_cancelled_and_reports_its_stages(chest):
    stages = []
    find_airways(chest.volume, progress=lambda what, fraction: stages.append((what, fraction)))
    names = list(dict.fromkeys(what for what, _ in stages))
    assert names[0] == "finding the trachea"
    assert names[-1] == "airways segmented"
    assert all(fraction is None or 0.0 <= fraction <= 1.0 for _, fraction in stages)
    for number in range(len(names) - 1):
        calls = itertools.count()
        with pytest.raises(CancelledError):
            find_airways(chest.volume, cancel=lambda calls=calls, number=number: next(calls) >= number)


def test_error_in_a_progress_callback_is_raised_to_the_caller(chest):
    def broken(what, fraction):
        raise ZeroDivisionError(what)

    with pytest.raises(ZeroDivisionError):
        find_airways(chest.volume, progress=broken)


def test_each_target_is_tracked_moved_into_the_lumen_or_refused_separately(chest):
    tip = chest.tubes[3][1]
    inside = tip + 0.3 * (chest.tubes[3][0] - tip)
    result = track_paths(
        chest.volume,
        targets=[inside, tip + np.array([-5.0, 0.0, -3.0]), tip + np.array([-14.0, 0.0, 0.0]), chest.tubes[6][1]],
    )
    first, snapped, refused, last = result.targets
    assert first.snapped_mm == 0.0
    assert first.problem is None
    assert list(first.path.generation[[0, -1]]) == [0, 2]
    # The tolerance is half of a voxel's diagonal.
    assert np.linalg.norm(first.path.points_lps[-1] - inside) < 1.1
    assert 0.0 < snapped.snapped_mm <= 5.0
    assert np.linalg.norm(snapped.used_lps - snapped.requested_lps) == pytest.approx(snapped.snapped_mm)
    assert refused.path is None
    assert "mm from the segmented lumen" in refused.problem
    for target in (first, snapped, last):
        assert result.airways.tracker.inside(target.path.points_lps).all()
        assert result.airways.tracker.inside(target.path.voxel_path_lps).all()
        assert chest.depth_mm(target.path.points_lps).max() < 0.8
    # The tree of both paths has a trachea, two main bronchi, and a branch on each side.
    assert sorted(branch.generation for branch in result.tree.branches)[:3] == [0, 1, 1]
    assert {branch.name for branch in result.tree.branches if branch.generation < 2} == {"Trachea", "RMB", "LMB"}


def test_paths_begin_at_a_given_start_in_the_trachea_or_a_bronchus(chest, found):
    """Compare paths from three starts with the search, whose tree begins at the top of the trachea."""
    (top, end, _), tip = chest.tubes[0], chest.tubes[3][1]
    middle = 0.5 * (top + end)
    np.testing.assert_array_equal(find_airways(chest.volume, root_lps=middle).root_lps, found.root_lps)
    in_bronchus = 0.5 * (chest.tubes[1][0] + chest.tubes[1][1])
    lengths = [track_paths(chest.volume, targets=[tip]).targets[0].path.length_mm]
    for start in (middle, in_bronchus):
        path = track_paths(chest.volume, root=start, targets=[tip]).targets[0].path
        assert np.linalg.norm(path.points_lps[0] - start) <= 3.0
        lengths.append(path.length_mm)
    assert lengths[0] - lengths[1] == pytest.approx(np.linalg.norm(middle - found.root_lps), abs=3.0)
    assert lengths[1] - lengths[2] > 0.4 * np.linalg.norm(end - top)


def test_target_in_a_lumen_separated_from_the_root_has_no_path(chest, found):
    lumen = np.array(found.lumen_zyx)
    # A gap cuts the left main bronchus in two.
    start, end, _ = chest.tubes[2]
    k, j, i = np.nonzero(lumen)
    points = chest.volume.to_lps(np.stack([i, j, k], axis=-1))
    share = (points - start) @ (end - start) / ((end - start) @ (end - start))
    cut = (share > 0.5) & (share < 0.75) & (points[:, 0] > start[0] + 3.0)
    lumen[k[cut], j[cut], i[cut]] = 0
    result = track_paths(chest.volume, targets=[chest.tubes[5][1]], airways=find_airways(chest.volume, lumen_zyx=lumen))
    assert result.targets[0].path is None
    assert "no path" in result.targets[0].problem
    assert any("not connected" in note for note in result.airways.notes)


def test_paths_with_invalid_targets_or_an_unknown_cost_are_refused(chest):
    with pytest.raises(UsageError, match="outside the scan"):
        track_paths(chest.volume, targets=[[0.0, 0.0, 9999.0]])
    with pytest.raises(UsageError, match="targets: expected 1 to 10000 entries"):
        track_paths(chest.volume, targets=[])
    with pytest.raises(UsageError, match="cost"):
        track_paths(chest.volume, targets=[[0, 0, 0]], cost="straight")
    with pytest.raises(UsageError, match="point"):
        track_paths(chest.volume, targets=[[0.0, 0.0, float("nan")]])
