"""Tests of paths to targets with other costs than the lumen: without airways, beside airways, and in a case file."""

from __future__ import annotations

import numpy as np
import pytest

import carina
from carina import commands as c
from carina.commands.tree import PathCost
from carina.errors import NoResultError, UsageError
from carina.track.targets.paper_tracker import COSTS
from carina.volume import write_grid
from vessel_phantom import bent_vessel


@pytest.fixture(scope="module")
def vessel():
    volume, inside, *points = bent_vessel()
    return volume, inside, *(tuple(point.tolist()) for point in points)


@pytest.fixture(scope="module")
def phantom():
    return carina.generate_phantom(spacing_mm=3.0, generations=3)


def targets_of(case):
    return case.state.document.targets


def test_path_costs_accepted_by_commands_are_those_of_the_tracker():
    assert set(PathCost.__args__) == set(COSTS)


def test_paths_in_a_scan_without_airways_are_undone_and_stored_in_a_file(vessel, tmp_path):
    volume, inside, root, corner, end = vessel
    scan = tmp_path / "vessel.nii.gz"
    write_grid(scan, volume.hu_zyx, volume.lps_from_ijk, what="the scan")
    with carina.Case.open(scan) as case:
        case.do(c.AddTarget(end, cost="walls", root_lps=root))
        case.do(c.AddTarget(corner, cost="paper", root_lps=root))
        case.undo()
        (target,) = targets_of(case)
        assert (target.problem, target.cost, target.root_lps) == (None, "walls", root)
        # The target was not moved, and its path has no lumen and no diameter.
        assert (target.used_lps, target.snapped_mm, target.outside_mm) == (end, 0.0, None)
        assert target.value_range[0] > 1100
        route = target.route
        i, j, k = np.rint(volume.to_ijk(route.points_lps)).astype(int).T
        assert inside[k, j, i].mean() > 0.97
        assert not route.lumen_known
        case.do(c.GoTo(path_mm=10.0))
        assert case.state.mode == "path"
        with pytest.raises(NoResultError, match="no airways"):
            _ = case.airways
        saved = case.save(tmp_path / "vessel.carina")
    with carina.Case.open(saved) as again:
        (found,) = targets_of(again)
        assert (found.cost, found.root_lps, found.value_range) == (target.cost, target.root_lps, target.value_range)
        assert not found.route.lumen_known
        np.testing.assert_array_equal(found.route.points_lps, route.points_lps)


def test_path_without_a_start_or_to_an_invalid_target_is_reported(vessel):
    volume, _, root, _, end = vessel
    with carina.Case.open(volume) as case:
        with pytest.raises(UsageError, match="mark the start point") as caught:
            case.do(c.AddTarget(end, cost="walls"))
        assert caught.value.code == "track.no-root"
        with pytest.raises(UsageError, match="outside the scan"):
            case.do(c.AddTarget(end, cost="walls", root_lps=(900.0, 0.0, 0.0)))
        with pytest.raises(UsageError, match="expected the cost walls or paper"):
            case.do(c.AddTarget(end, root_lps=root))
        with pytest.raises(UsageError, match="cost"):
            case.do(c.AddTarget(end, cost="octree", root_lps=root))
        # A target at the start is refused, because its path has no length.
        case.do(c.AddTarget(root, cost="walls", root_lps=root))
        assert targets_of(case)[0].problem is not None
        assert targets_of(case)[0].route is None


def test_path_that_ignores_the_airways_states_its_length_outside_them_and_stays_after_an_edit(phantom, tmp_path):
    scan = tmp_path / "phantom.nii.gz"
    write_grid(scan, phantom.volume.hu_zyx, phantom.volume.lps_from_ijk, what="the scan")
    with carina.Case.open(scan) as case:
        tree = case.airways.tree
        tip = tree.tips()[0]
        case.do(c.AddTarget(tuple(tip.points[-1]), cost="walls"))
        (target,) = targets_of(case)
        assert target.problem is None
        assert target.root_lps == tuple(case.airways.root_lps)
        assert target.outside_mm is not None
        assert target.route.lumen_known
        assert set(target.route.branch_ids) <= {branch.id for branch in tree.branches}
        # The branch at the target is cut; the path stays and is compared with the edited airways.
        case.do(c.EditTree(c.CutBranch(tip.id, 0.0)))
        (after,) = targets_of(case)
        np.testing.assert_array_equal(after.route.points_lps, target.route.points_lps)
        assert tip.id not in after.route.branch_ids
        assert after.outside_mm > target.outside_mm
        # The end of the path is now outside the lumen, so the path leaves it once more than it returns.
        assert len(target.crossings_mm) % 2 == 0
        assert len(after.crossings_mm) % 2 == 1
        assert list(after.crossings_mm) == sorted(after.crossings_mm)
        saved = case.save(tmp_path / "crossing.carina")
    with carina.Case.open(saved) as again:
        assert targets_of(again)[0].crossings_mm == pytest.approx(after.crossings_mm)
