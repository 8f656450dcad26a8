"""Tests of scope verdicts in tubes with known results: which scopes pass, bend far enough, or remain undecided."""

from __future__ import annotations

import dataclasses
import json
import math
import threading
from functools import cache
from typing import Any

import numpy as np
import phantom_plan
import pytest
from nodules import ellipsoid

from carina.errors import CancelledError, UsageError
from carina.plan import Plan, Verdict, judge_pairs, judge_scope, judge_scopes, tool
from carina.plan.movement.target_movement import TargetMovement
from carina.plan.routes.fork_ridges import ForkRidge, RouteRidges
from carina.plan.routes.last_leg import LastLeg, edge_on_needle_mm
from carina.plan.routes.main_carina import ROOT
from carina.plan.routes.measured_lumen import MeasuredLumen
from carina.plan.routes.plan_route import PlannedRoute
from carina.plan.routes.ranking import MIN_SPARE_MM
from carina.plan.routes.route_width import RouteWidth
from carina.plan.verdict import lever
from carina.plan.verdict.checks import bend_check
from carina.plan.verdict.drive_route import DriveWay
from carina.plan.verdict.lever import lever_check
from carina.plan.verdict.route_judge import InstrumentChecks, RouteJudge, SimulatedDrive
from carina.scopes import ScopePreset, WallField, scope_preset, scope_presets
from carina.track import AirwayTree, Branch

RADIUS_MM = 2.0
STRAIGHT_MM = 70.0


def centreline(bend_deg: float, bend_radius_mm: float, straight_mm: float = STRAIGHT_MM) -> np.ndarray:
    """Return points of a centreline: straight down, along a circle towards +x, then straight for 10 mm."""
    down = [np.array([0.0, 0.0, -z]) for z in np.arange(0.0, straight_mm, 0.5)]
    bend = math.radians(bend_deg)
    angles = np.linspace(0.0, bend, int(2.0 * bend * bend_radius_mm) + 2)
    turned = [
        np.array([bend_radius_mm * (1.0 - math.cos(a)), 0.0, -straight_mm - bend_radius_mm * math.sin(a)])
        for a in angles
    ]
    points = [*down, *turned]
    ahead = np.array([math.sin(bend), 0.0, -math.cos(bend)])
    return np.array([*points, *(points[-1] + s * ahead for s in np.arange(0.5, 10.0, 0.5))])


@cache
def tube(
    bend_deg: float, bend_radius_mm: float = 20.0, straight_mm: float = STRAIGHT_MM
) -> tuple[AirwayTree, WallField, np.ndarray]:
    points = centreline(bend_deg, bend_radius_mm, straight_mm)
    lo, hi = points.min(axis=0) - 4.0, points.max(axis=0) + 4.0
    step = 0.5
    num = np.ceil((hi - lo) / step).astype(int) + 1
    axes = [lo[a] + step * np.arange(num[a]) for a in range(3)]
    # No scope moves farther than 8 mm from the centreline, so the wall's samples farther away can all have this value.
    far = 8.0
    off = np.full(num, far, dtype=np.float32)
    at = np.arange(0.0, len(points) - 1.0, 0.25)
    for point in np.stack([np.interp(at, np.arange(len(points)), points[:, axis]) for axis in range(3)], axis=1):
        x, y, z = (slice(*np.searchsorted(axes[a], [point[a] - far, point[a] + far])) for a in range(3))
        ways = [np.square(axis[near] - p) for axis, near, p in zip(axes, (x, y, z), point, strict=True)]
        away = np.sqrt(ways[0][:, None, None] + ways[1][:, None] + ways[2])
        np.minimum(off[x, y, z], away, out=off[x, y, z], casting="same_kind")
    place = np.diag([step, step, step, 1.0])
    place[:3, 3] = lo
    field = WallField.from_distances(np.ascontiguousarray((RADIUS_MM - off).transpose(2, 1, 0)), place)
    half = len(points) // 2
    radius = np.full(len(points), RADIUS_MM)
    trunk = Branch(0, None, (1,), 0, "Trachea", "tracked", points[: half + 1], radius[: half + 1])
    rest = Branch(1, 0, (), 1, None, "tracked", points[half:], radius[half:])
    return AirwayTree((trunk, rest)), field, points


def plan_in(points: np.ndarray, park: int = -8, error_mm: float = 0.2) -> Plan:
    """Return a plan made by hand, whose nodule is straight ahead of the scope's final position."""
    tip = points[park]
    ahead = points[-1] - points[-3]
    ahead /= np.linalg.norm(ahead)
    nodule = ellipsoid((4.0, 4.0, 4.0), tip + 12.0 * ahead)
    along = float(np.linalg.norm(np.diff(points[: len(points) + park + 1], axis=0), axis=1).sum())
    place = (float(tip[0]), float(tip[1]), float(tip[2]))
    leg = LastLeg(place, nodule.centre_lps, place, 8.0, 6.0, 0.0, (), 8.0, 8.0, None, None, None, 1.0, reaches=True)
    width = RouteWidth(2 * RADIUS_MM, error_mm, 0.5 * along)
    route = PlannedRoute(1, "branch 1", along, ROOT, (0.0, 0.0, -1.0), width, "fits", leg, {}, 1.0, ())
    return Plan(
        nodule,
        scope_preset("thin"),
        tool("needle-21g"),
        "none",
        None,
        None,
        TargetMovement("given", 15.0),
        (route,),
        None,
    )


def scope(**changes: Any) -> ScopePreset:
    return dataclasses.replace(scope_preset("thin"), **{"tip_mm": 3.0, "tube_mm": None} | changes)


def check(found: Verdict, name: str):
    return next(one for one in found.checks if one.name == name)


def judged(*args: Any, **options: Any) -> Verdict:
    """Return the verdict on a scope for which one drive is tried, for tests that do not depend on the drive."""
    return judge_scope(*args, **options, effort=1.0)


@pytest.mark.parametrize("tip_mm", [3.0, 3.8, 3.95, 4.05, 4.2, 5.0])
def test_without_errors_a_scope_passes_exactly_if_it_is_thinner_than_the_tube(tip_mm: float) -> None:
    tree, field, points = tube(30.0)
    thick = dataclasses.replace(scope(), tip_mm=tip_mm)
    answer = check(judged(tree, plan_in(points), field, thick, errors=False), "diameter").answer
    assert answer == ("yes" if tip_mm <= 2 * RADIUS_MM else "no")


@pytest.mark.parametrize(("bend_deg", "bend_radius_mm"), [(30.0, 20.0), (60.0, 20.0), (100.0, 20.0), (120.0, 15.0)])
def test_required_bend_angle_of_a_circular_tube_is_exact_to_two_degrees(bend_deg: float, bend_radius_mm: float) -> None:
    tree, field, points = tube(bend_deg, bend_radius_mm)
    section_mm = 40.0 + 10.0
    required_deg = min(bend_deg, math.degrees(section_mm / bend_radius_mm))
    for spare, answer in ((2.0, "yes"), (-2.0, "no")):
        bends = scope(flexion_deg=(required_deg + spare, 10.0), bending_mm=(40.0, 40.0), rigid_tip_mm=10.0)
        # This scope is so thin that its rigid tip fits through the bend.
        bends = dataclasses.replace(bends, tip_mm=1.5)
        found = check(judged(tree, plan_in(points), field, bends, errors=False), "bend")
        assert found.answer == answer, found.words


def test_verdict_of_a_thicker_stiffer_or_shorter_scope_is_never_better() -> None:
    tree, field, points = tube(100.0)
    plan = plan_in(points)

    def shares(name: str, presets: list[ScopePreset]) -> list[float]:
        return [check(judged(tree, plan, field, one), name).share for one in presets]

    wider = shares("diameter", [dataclasses.replace(scope(), tip_mm=tip) for tip in (2.5, 3.2, 3.6, 4.0, 5.0)])
    assert wider == sorted(wider, reverse=True) and wider[0] > 0.99 and wider[-1] < 0.01
    bends = shares("bend", [scope(flexion_deg=(deg, 60.0)) for deg in (160.0, 115.0, 100.0, 90.0, 70.0)])
    assert bends == sorted(bends, reverse=True) and bends[0] > 0.9 and bends[-1] < 0.1
    order = {"yes": 2, "perhaps": 1, "no": 0}
    for origin_depth_mm in (None, 200.0):
        lengths = [
            order[
                check(judged(tree, plan, field, scope(length_mm=mm), origin_depth_mm=origin_depth_mm), "length").answer
            ]
            for mm in (600.0, 300.0, 250.0, 60.0)
        ]
        assert lengths == sorted(lengths, reverse=True) and (lengths[0], lengths[-1]) == (2, 0)


def test_range_of_widths_with_an_undecided_verdict_is_as_wide_as_the_errors() -> None:
    tree, field, points = tube(30.0, 80.0)
    fits = dataclasses.replace(scope(), tip_mm=2 * RADIUS_MM - 0.4)
    coarse = judged(tree, plan_in(points, error_mm=0.7), field, fits)
    assert check(coarse, "diameter").answer == "perhaps" and check(coarse, "diameter").share == pytest.approx(0.5)
    assert coarse.outcome == "may reach" and coarse.words.startswith("may reach: needs 4.0 mm; the narrowest place")


def test_verdict_of_a_scope_that_fits_bends_and_points_straight_ahead_is_reaches() -> None:
    tree, field, points = tube(60.0)
    found = judge_scope(tree, plan_in(points), field, scope())
    assert found.outcome == "reaches", found.words
    assert found.words == "reaches the end of the route and can point at the target" and found.would is None
    assert found.reached_mm == pytest.approx(plan_in(points).routes[0].along_mm, abs=1.5)
    assert check(found, "pointing").share > 0.8 and found.hold is not None
    assert found.driven is not None and found.driven.arrived
    assert found.hold.flexion_rad == found.driven.samples[-1][2]
    assert found.to_json()["drive"]["moves"][0]["ends_mm"] == found.driven.ends_mm[0]
    assert json.loads(json.dumps(found.to_json())) == found.to_json()


def test_undecided_bend_check_is_settled_by_drives_with_less_flexion(monkeypatch: pytest.MonkeyPatch) -> None:
    tree, field, points = tube(60.0)
    near = dataclasses.replace(scope(flexion_deg=(62.0, 62.0)), tip_mm=1.8)
    plan = plan_in(points)
    way = DriveWay(tree, plan.routes[0], field)
    figures = bend_check(way, near, errors=True)
    assert figures.answer == "perhaps" and 0.5 < figures.share < 0.7
    found = judge_scope(tree, plan, field, near)
    bend = check(found, "bend")
    assert (bend.answer, bend.share) == ("yes", 0.95) and found.driven is not None
    assert bend.words == f"{figures.words}; with 13 degrees less flexion, the drive still arrives"

    # If flexion is needed, a drive with the share ``share`` of the scope's flexion arrives, and a drive with less does
    # not.
    for needs_deg, share, text in (
        (62.0, 0.62, "5 degrees less flexion, no drive"),
        (56.5, 0.85, "5 degrees less flexion, the drive"),
    ):

        def arrives(_way, _wall, preset, *_moves, needs_deg=needs_deg, **_options):
            return dataclasses.replace(found.driven, arrived=max(preset.flexion_deg) >= needs_deg)

        monkeypatch.setattr(lever, "arrives_by", lambda *given, arrives=arrives: arrives(*given).arrived)
        monkeypatch.setattr(lever, "search_drive", arrives)
        bend = lever_check(way, field, near, figures, found.driven, effort=1.0)
        assert (bend.answer, bend.share) == ("perhaps", share) and text in bend.words
    held_up = dataclasses.replace(found.driven, arrived=False)
    assert lever_check(way, field, near, figures, held_up, effort=1.0) is figures


def test_verdict_of_a_scope_with_unknown_figures_is_undecided() -> None:
    tree, field, points = tube(60.0)
    robot = dataclasses.replace(scope_preset("ion"), tip_mm=3.0)
    found = judge_scope(tree, plan_in(points), field, robot)
    assert found.outcome == "cannot say" and "is not known" in found.words
    assert found.hold is None and found.would.startswith("could reach only if ")


def test_tool_that_does_not_pass_the_channel_is_reported() -> None:
    tree, field, points = tube(60.0)
    found = judge_scope(tree, plan_in(points), field, scope(channel_mm=1.7))
    assert found.outcome == "does not reach"
    assert found.words.endswith("21 G has a diameter of 1.8 mm; the working channel has 1.7 mm")
    assert found.would is not None and found.would.startswith("no needle of the library passes its channel")
    assert found.driven is not None and found.driven.arrived, "only a drive shows that there is no other obstacle"


def test_thinner_needle_is_proposed_only_if_the_library_has_one() -> None:
    tree, field, points = tube(60.0)
    thick = dataclasses.replace(tool("needle-21g"), name="thick", title="Thick needle", outer_mm=2.4)
    plan = dataclasses.replace(plan_in(points), tool=thick)
    found = judge_scope(tree, plan, field, scope())
    assert found.would == "would reach if Aspiration needle, 21 G were used"
    assert judge_scope(tree, plan_in(points), field, scope()).would is None


def two_routes() -> tuple[AirwayTree, WallField, Plan]:
    """Return a tube with a plan of two routes; the first one is too narrow by its measured width."""
    tree, field, points = tube(60.0)
    plan = plan_in(points)
    good = plan.routes[0]
    narrow = dataclasses.replace(good, along_mm=good.along_mm - 1.0, width=RouteWidth(2.0, 0.1, 20.0))
    return tree, field, dataclasses.replace(plan, routes=(narrow, good))


def test_every_pair_of_route_and_instrument_has_a_verdict_and_the_best_pair_is_first() -> None:
    tree, field, plan = two_routes()
    narrow, good = plan.routes
    presets = [scope(name="wide", tip_mm=6.0), scope(name="fits")]
    reported: list[Verdict] = []
    pairs = judge_pairs(tree, plan, field, scopes=presets, found=reported.append)
    assert [(one.scope.name, one.outcome, one.route_key) for one in pairs] == [
        ("fits", "reaches", good.key),
        ("fits", "does not reach", narrow.key),
        ("wide", "does not reach", narrow.key),
        ("wide", "does not reach", good.key),
    ]
    assert {(one.scope.name, one.route_key) for one in reported} == {(one.scope.name, one.route_key) for one in pairs}
    # The other position was driven, so it may be named.
    assert [one.would for one in pairs[:2]] == [None, "reaches by route 2"]
    alone = judge_pairs(tree, plan, field, scopes=presets, routes=1)
    assert {one.outcome for one in alone} == {"does not reach"} and len(alone) == 2
    assert judge_scope(tree, plan, field, presets[1], route=good).to_json() == pairs[0].to_json()


def test_drives_along_different_routes_are_simulated_at_the_same_time(monkeypatch: pytest.MonkeyPatch) -> None:
    tree, field, plan = two_routes()
    good = plan.routes[1]
    plan = dataclasses.replace(plan, routes=(dataclasses.replace(good, along_mm=good.along_mm - 1.0), good))
    both_started, drive = threading.Barrier(2), RouteJudge.drive

    def waiting(judge: RouteJudge, figures: InstrumentChecks) -> SimulatedDrive:
        both_started.wait(timeout=60.0)
        return drive(judge, figures)

    monkeypatch.setattr(RouteJudge, "drive", waiting)
    pairs = judge_pairs(tree, plan, field, scopes=[scope()], effort=1.0)
    assert {one.route_key for one in pairs} == {route.key for route in plan.routes}


def test_pairs_of_instruments_that_are_not_available_follow_the_others() -> None:
    tree, field, plan = two_routes()
    presets = [scope(name="wide", tip_mm=6.0), scope(name="fits")]
    pairs = judge_pairs(tree, plan, field, scopes=presets, available=["wide"])
    assert [one.scope.name for one in pairs] == ["wide", "wide", "fits", "fits"]
    assert pairs[2].outcome == "reaches"


def test_instrument_is_judged_with_a_needle_that_passes_its_channel() -> None:
    tree, field, points = tube(60.0)
    plan = dataclasses.replace(plan_in(points), tool=tool("needle-19g"))
    slim, slimmest = scope(name="slim", channel_mm=1.9), scope(name="slimmest", channel_mm=1.7)
    pairs = judge_pairs(tree, plan, field, scopes=[slim, slimmest])
    assert [(one.scope.name, one.tool, one.outcome) for one in pairs] == [
        ("slim", "needle-21g", "reaches"),
        ("slimmest", "needle-19g", "does not reach"),
    ]
    assert pairs[1].would is not None and "can only brush" in pairs[1].would


def test_scope_points_at_the_target_only_if_the_smallest_target_within_its_error_is_hit() -> None:
    tree, field, points = tube(60.0)
    plan = plan_in(points)
    # The true diameter may be an eighth of the segmented one, so most needles may pass beside the target.
    uncertain = dataclasses.replace(plan, nodule=dataclasses.replace(plan.nodule, diameter_error_mm=9.0))
    sure, found = (judge_scope(tree, one, field, scope()) for one in (plan, uncertain))
    assert (sure.outcome, found.outcome) == ("reaches", "may reach"), found.words
    pointing = check(found, "pointing")
    assert pointing.share > 0.5 and "as small as its error allows" in pointing.words
    exact = judge_scope(tree, uncertain, field, scope(), errors=False)
    assert check(exact, "pointing").answer == "yes"


def with_lumen(plan: Plan, points: np.ndarray, measured_mm: float, error_mm: float) -> Plan:
    """Return a plan whose lumen is measured with a diameter; the segmented lumen has the radius of the tube."""
    num = len(points)
    lumen = MeasuredLumen(
        points,
        np.full(num, RADIUS_MM),
        np.full(num, 0.5 * measured_mm - RADIUS_MM),
        np.full(num, error_mm),
        np.full(num, RADIUS_MM - 0.5 * measured_mm),
    )
    (route,) = plan.routes
    width = dataclasses.replace(route.width, mm=measured_mm, error_mm=error_mm)
    return dataclasses.replace(plan, routes=(dataclasses.replace(route, lumen=lumen, width=width),))


def test_scope_too_wide_for_a_bend_does_not_reach_by_the_drive_of_a_thinner_one() -> None:
    # A rigid tip of 10 mm in a bend with a radius of 15 mm needs a play of 10^2 / (8 x 15) = 0.83 mm.
    tree, field, points = tube(80.0, 15.0)
    plan = plan_in(points, error_mm=0.05)
    wide = scope(tip_mm=3.4, rigid_tip_mm=10.0, bending_mm=(25.0, 25.0), flexion_deg=(210.0, 130.0))
    assert check(judged(tree, plan, field, wide), "diameter").answer == "yes"
    thin = dataclasses.replace(wide, tip_mm=2.9)
    exact = with_lumen(plan, points, 2.0 * RADIUS_MM, 0.05)
    assert judge_scope(tree, exact, field, thin).outcome == "reaches"
    unknown, known = (judge_scope(tree, one, field, wide) for one in (plan, exact))
    # In a lumen that was not measured, a thinner scope is driven, which shows nothing for this scope.
    assert unknown.outcome == "may reach" and "driven as a scope of 2.7 mm" in check(unknown, "drive").basis
    assert known.outcome in {"may reach", "does not reach"} and check(known, "drive").answer != "yes"


def test_scope_is_driven_with_its_own_width_in_the_measured_lumen() -> None:
    tree, field, points = tube(30.0, 80.0)
    # The segmented lumen is 4.0 mm wide, the measured one 5.0 mm; the scope needs 4.3 mm with its excess.
    wide = scope(tip_mm=3.9)
    plan = with_lumen(plan_in(points), points, 5.0, 0.4)
    found = judge_scope(tree, plan, field, wide)
    assert found.outcome == "reaches", found.words
    assert "driven as" not in check(found, "drive").basis
    alone = judge_scope(tree, plan_in(points), field, wide)
    assert alone.outcome != "reaches"


def test_drive_must_also_arrive_in_the_narrowest_lumen_within_the_error() -> None:
    tree, field, points = tube(80.0, 15.0)
    near = scope(tip_mm=3.3, rigid_tip_mm=10.0, bending_mm=(25.0, 25.0), flexion_deg=(210.0, 130.0))
    sure, unsure = (
        judge_scope(tree, with_lumen(plan_in(points), points, 4.6, error_mm), field, near) for error_mm in (0.1, 0.9)
    )
    assert sure.outcome == "reaches", sure.words
    assert check(unsure, "diameter").answer == "yes" and unsure.outcome == "may reach"
    assert "as narrow as the error of its diameter allows" in check(unsure, "drive").words


def test_drive_must_also_pass_the_ridges_that_the_blur_of_the_ct_may_hide() -> None:
    tree, field, points = tube(30.0, 80.0)
    plan = with_lumen(plan_in(points), points, 2.0 * RADIUS_MM, 0.05)
    (route,) = plan.routes
    # A ridge begins at the wall in the middle of the route and extends into the lumen.
    n = len(points) // 2
    ridge = ForkRidge(
        (1, 2), points[n] + [RADIUS_MM, 0.0, 0.0], np.array([-1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]), 2.0
    )

    def found(hidden_mm: float, lumen: MeasuredLumen | None) -> Verdict:
        ridged = dataclasses.replace(route, lumen=lumen, ridges=RouteRidges((ridge,), hidden_mm))
        return judge_scope(tree, dataclasses.replace(plan, routes=(ridged,)), field, scope(tip_mm=2.4))

    assert found(0.0, route.lumen).outcome == "reaches"
    assert found(0.3, route.lumen).outcome == "reaches"
    # A lumen without a measured width has ridges too.
    assert found(0.3, None).outcome == "reaches"
    for blocked in (found(2.5, route.lumen), found(2.5, None)):
        assert blocked.outcome == "may reach" and "as the blur of the CT may hide" in check(blocked, "drive").words


def test_scope_is_aimed_until_its_tool_surely_reaches_the_target() -> None:
    tree, field, points = tube(60.0)
    plan = plan_in(points, park=-1)
    first = judge_scope(tree, plan, field, scope())
    assert first.outcome == "reaches"

    def spare_mm(found: Verdict, reach_mm: float) -> float:
        tip, end = (np.array(one) for one in found.needle_lps)
        return reach_mm - edge_on_needle_mm(plan.nodule, tip, end, reach_mm)

    # With this tool the pose of the first drive only just reaches the target.
    reach_mm = plan.tool.reach_mm - spare_mm(first, plan.tool.reach_mm) + 0.5
    short = dataclasses.replace(tool("needle-21g"), name="short", reach_mm=reach_mm)
    found = judge_scope(tree, dataclasses.replace(plan, tool=short), field, scope())
    assert found.outcome == "reaches" and spare_mm(found, reach_mm) >= MIN_SPARE_MM


def test_longer_needle_throw_is_proposed_only_if_it_hits_from_the_tip_pose_of_the_drive() -> None:
    tree, field, points = tube(60.0)
    near = plan_in(points)
    short = dataclasses.replace(tool("needle-21g"), name="short", reach_mm=1.0)
    found = judge_scope(tree, dataclasses.replace(near, tool=short), field, scope())
    assert next(one for one in found.checks if one.name == "pointing").answer != "yes"
    assert found.would == "would reach if Aspiration needle, 21 G were used"
    blocked = judge_scope(tree, dataclasses.replace(near, tool=short), field, scope(channel_mm=1.85))
    assert blocked.would is None or "were used" not in blocked.would


def test_scope_that_may_not_fit_is_not_stated_to_reach_with_another_tool() -> None:
    tree, field, points = tube(30.0, 80.0)
    tight = dataclasses.replace(scope(), tip_mm=2 * RADIUS_MM - 0.4, channel_mm=1.2)
    found = judged(tree, plan_in(points), field, tight)
    assert found.outcome == "does not reach"
    assert found.would is not None and found.would.startswith("no needle of the library passes its channel")
    assert all(one.words.startswith("if it fits: ") for one in found.checks[4:] if one.answer == "perhaps")


def test_failed_check_is_listed_first_with_the_position_where_the_scope_stops() -> None:
    tree, field, points = tube(60.0)
    reported: list[Verdict] = []
    presets = [scope(name="fits"), scope(name="wide", title="wide")]
    presets[1] = dataclasses.replace(presets[1], tip_mm=3.6, tube_mm=5.0)
    found = judge_scopes(tree, plan_in(points), field, scopes=presets, found=reported.append)
    assert [one.scope.name for one in found] == ["fits", "wide"]
    assert [one.scope.name for one in reported] == ["wide", "fits"]
    assert reported[0].driven is None and reported[0].words.startswith("stops 0 mm from the start of the airway tree: ")
    assert reported[0].would == "could reach only if the airway were wider or the scope thinner"
    # If the bending section of a scope is unknown, the position of the stop is unknown.
    unknown = dataclasses.replace(presets[1], flexion_deg=None, bending_mm=None)
    (told_of,) = judge_scopes(tree, plan_in(points), field, scopes=[unknown])
    assert told_of.outcome == "does not reach" and told_of.words.startswith("does not reach: needs ")
    assert reported[1].outcome == "reaches"


def test_all_scopes_of_the_library_are_judged_in_a_chest_with_progress_and_cancellation() -> None:
    tree, wall, plan = phantom_plan.airways().tree, phantom_plan.wall(), phantom_plan.plan()
    fractions: list[float] = []
    found = judge_scopes(tree, plan, wall, effort=4000.0, progress=lambda _what, share: fractions.append(share))
    assert [one.scope for one in found] == list(scope_presets())
    assert fractions == sorted(fractions) and fractions[-1] == 1.0
    for one in found:
        assert all(named.basis and named.words for named in one.checks)
        assert (one.outcome == "reaches") == all(named.answer == "yes" for named in one.checks)
    by_name = {one.scope.name: one for one in found}
    assert by_name["ion"].outcome in {"cannot say", "does not reach"}
    assert check(by_name["therapeutic"], "diameter").answer == "no"
    with pytest.raises(CancelledError):
        judge_scopes(tree, plan, wall, cancel=lambda: True)


def test_verdict_without_a_route_or_with_an_invalid_spacing_is_refused() -> None:
    tree, field, points = tube(60.0)
    plan = plan_in(points)
    with pytest.raises(UsageError, match="the plan has no route to judge"):
        judge_scope(tree, dataclasses.replace(plan, routes=()), field, scope())
