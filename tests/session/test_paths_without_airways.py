"""Tests of paths to targets with other costs than the lumen: without airways, beside airways, and in a case file."""

from __future__ import annotations

import re

import numpy as np
import pytest

import carina
from carina import commands as c
from carina.commands.tree import PathCost
from carina.errors import NoResultError, UsageError
from carina.navigate.recording import ReplayedPose
from carina.server.to_wire.session import route_message, state_message
from carina.session.flights.film_flights import flight_captions
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


def places_of(case):
    """Return the position of each route point from the origin of the window's ruler, mm, and the kind of the origin."""
    scale = case.state.route_scale
    return scale.along_mm - scale.origin.along_mm, scale.origin.kind


def test_distances_on_a_path_outside_the_airways_are_measured_along_that_path(phantom, tmp_path):
    scan = tmp_path / "phantom.nii.gz"
    write_grid(scan, phantom.volume.hu_zyx, phantom.volume.lps_from_ijk, what="the scan")
    with carina.Case.open(scan) as case:
        root = np.array(case.airways.root_lps)
        tree, tracker = case.airways.tree, case.airways.tracker
        # Beside the middle of the trachea: the path leaves the lumen above the main carina.
        case.do(c.AddTarget(tuple(root + np.array([40.0, 0.0, -20.0])), cost="walls"))
        (target,) = targets_of(case)
        case.do(c.ChooseRoute(target_id=target.target_id))
        route = case.state.document.route
        assert target.outside_mm > 20.0
        places, origin = places_of(case)
        assert origin == "route"
        np.testing.assert_allclose(places, route.cumulative_mm)
        assert target.target_id not in case.state.target_places_mm
        sent = route_message(route, None, case.state.route_scale).route
        assert sent.centreline_mm == pytest.approx(route.cumulative_mm, abs=1e-3)
        assert sent.origin.kind == "route"
        # Through the main carina, then out of the airways: distances count from the carina, along the path.
        tip = next(tip for tip in tree.tips() if len(tree.lineage(tip.id)) > 2)
        out = tip.points[-1] + 40.0 * (tip.points[-1] - tip.points[-2]) / np.linalg.norm(
            tip.points[-1] - tip.points[-2]
        )
        nz, ny, nx = phantom.volume.shape_zyx
        out = phantom.volume.to_lps(np.clip(phantom.volume.to_ijk(out), 1, (nx - 2, ny - 2, nz - 2)))
        case.do(c.AddTarget(tuple(float(v) for v in out), cost="walls"))
        far = targets_of(case)[-1]
        case.do(c.ChooseRoute(target_id=far.target_id))
        route = case.state.document.route
        inside = tracker.inside(route.points_lps)
        assert not inside[-1] and far.outside_mm > 5.0
        places, origin = places_of(case)
        assert origin == "ridge"
        np.testing.assert_allclose(np.diff(places), np.diff(route.cumulative_mm))
        carina_lps = tree.root.points[-1]
        nearest = int(np.argmin(np.linalg.norm(route.points_lps - carina_lps, axis=1)))
        ridge_mm = case.state.route_scale.origin.ridge_beyond_axes_mm
        assert places[nearest] == pytest.approx(-ridge_mm, abs=6.0)
        assert case.state.target_places_mm[far.target_id] == pytest.approx(places[-1])
        assert state_message(case.state, frame_rate_hz=30.0).targets[-1].from_carina_mm == pytest.approx(
            places[-1], abs=0.01
        )


def test_captions_of_a_flight_on_a_path_outside_the_airways_state_distances_along_the_path(phantom, tmp_path):
    scan = tmp_path / "phantom.nii.gz"
    write_grid(scan, phantom.volume.hu_zyx, phantom.volume.lps_from_ijk, what="the scan")
    with carina.Case.open(scan) as case:
        root = np.array(case.airways.root_lps)
        case.do(c.AddTarget(tuple(root + np.array([40.0, 0.0, -20.0])), cost="walls"))
        (target,) = targets_of(case)
        case.do(c.ChooseRoute(target_id=target.target_id))
        film = case.ask(c.FlightToFilm("route", rate_hz=1.0, speed_mm_s=50.0))
        captions = flight_captions(film.volume, film.airways, film.caption_route, None)
        for path_mm in (5.0, 30.0, 0.98 * target.length_mm):
            (line,) = captions.lines(ReplayedPose(0.0, case.state.document.route.path.pose_at(path_mm), {}, False), 0.0)
            stated = float(re.search(r"(\d+) mm from the start of the route$", line).group(1))
            assert stated == pytest.approx(path_mm, abs=1.5)
