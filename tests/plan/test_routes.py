"""Tests of routes to nodules: the scope's final position, tissue on the needle path, and ranking of routes."""

from __future__ import annotations

import dataclasses
import itertools
import json
import re
from functools import cache
from typing import Any

import numpy as np
import pytest
from nodules import ellipsoid
from phantom_plan import CHEST, plan, wall

import carina
from cached_test_data import cached_airways, cached_phantom
from carina.errors import CancelledError, NoResultError, UsageError
from carina.plan import (
    NeedleErrors,
    NeedleScene,
    Nodule,
    Plan,
    ScoreWeights,
    Tool,
    distance_origin,
    grow_nodule,
    judge_scope,
    last_leg,
    plan_route,
    surroundings,
    tool,
    tools,
)
from carina.plan.routes.attainable_directions import StandingPlace, TipDirections
from carina.plan.routes.plan_route import standing_apart
from carina.plan.routes.ranking import RANK, Judge, bending_mm, order
from carina.plan.routes.standing_points import ScopePositions
from carina.scopes import ScopePreset, WallField, scope_preset
from carina.track import Airways, measure_tree
from carina.volume import Volume


def truth() -> dict[str, Any]:
    found: dict[str, Any] = cached_phantom(**CHEST).truth["nodule"]
    return found


def slim() -> ScopePreset:
    """Return a scope that fits through all airways near the nodule."""
    return dataclasses.replace(scope_preset("ultrathin"), tip_mm=1.5, channel_mm=2.0)


@cache
def plan_ahead() -> Plan:
    """Return the plan to a nodule straight ahead of the end of an airway, which a thin scope reaches."""
    airways = cached_airways(**CHEST)
    return plan_route(cached_phantom(**CHEST).volume, airways, nodule_ahead(), wall=wall(), scope=slim())


@cache
def nodule_ahead() -> Nodule:
    end = cached_airways(**CHEST).tree.named("LB3bii")
    ahead = end.points[-1] - end.points[-4]
    return ellipsoid((5.0, 5.0, 5.0), end.points[-1] + 8.0 * ahead / np.linalg.norm(ahead))


def retreed(airways: Airways, branch_id: int, **changes: Any) -> Airways:
    """Return the airways with changed attributes of one branch."""
    branches = tuple(
        dataclasses.replace(one, **changes) if one.id == branch_id else one for one in airways.tree.branches
    )
    return dataclasses.replace(airways, tree=dataclasses.replace(airways.tree, branches=branches))


def off_line_mm(line: np.ndarray, point: np.ndarray) -> float:
    """Return the distance from a point to a polyline, mm."""
    start, step = line[:-1], np.diff(line, axis=0)
    share = np.clip(((point - start) * step).sum(axis=1) / (step * step).sum(axis=1), 0.0, 1.0)
    return float(np.linalg.norm(start + share[:, None] * step - point, axis=1).min())


def test_route_to_a_nodule_beside_an_airway_arrives_there_in_the_ground_truth_airways() -> None:
    best = plan().routes[0]
    tip, aim = np.array(best.leg.tip_lps), np.array(truth()["centre_lps"])
    to_edge = np.linalg.norm(aim - tip) - truth()["radius_mm"]
    assert best.leg.to_target_mm == pytest.approx(to_edge, abs=1.0)
    assert best.leg.reaches
    branch = cached_airways(**CHEST).tree.branch(best.branch_id)
    assert off_line_mm(branch.points, tip) < float(branch.wall_distance.max()), "the tip is in the lumen"
    route = cached_airways(**CHEST).tree.route_to(best.branch_id)
    assert 0.0 < best.from_carina_mm < best.along_mm < 1.02 * route.length_mm


def test_tissue_on_the_needle_path_is_listed_in_order_without_gaps() -> None:
    for route in plan().routes:
        crossed = route.leg.crossed
        assert crossed[0].tissue == "lumen" and crossed[0].start_mm == 0.0
        assert all(one.end_mm == beyond.start_mm for one, beyond in itertools.pairwise(crossed))
        target = next(one for one in crossed if one.tissue == "target")
        assert target.start_mm == pytest.approx(route.leg.to_target_mm, abs=0.51)
        assert route.leg.least_in_target_mm <= route.leg.in_target_mm
        # Without an attainable direction that hits, both shares are 0.
        assert route.leg.hit_share_moved < route.leg.hit_share or route.leg.hit_share == 0.0
        assert (route.leg.hit_share == 0.0) == any("cannot point" in limit for limit in route.limits)
    reached = plan_ahead().routes[0].leg
    assert 0.0 < reached.hit_share_moved < reached.hit_share


def test_first_route_has_the_best_score_of_all_evaluated_positions() -> None:
    volume, airways, found = cached_phantom(**CHEST).volume, cached_airways(**CHEST), plan()
    nodule = found.nodule
    around = surroundings(volume, np.array(nodule.centre_lps), 50.0, nodule, wall())
    scene = NeedleScene(nodule, wall(), around, found.tool, NeedleErrors())
    weights = ScoreWeights()
    best = 0.0
    for branch in airways.tree.branches[1:]:
        diameter_mm = min(2.0 * float(one.wall_distance.min()) for one in airways.tree.lineage(branch.id)[1:])
        for point, forward in zip(branch.points, np.gradient(branch.points, axis=0), strict=True):
            if np.linalg.norm(point - nodule.centre_lps) > 40.0:
                continue
            leg = last_leg(scene, point, forward / np.linalg.norm(forward))
            if not leg.reaches or leg.angle_deg > 100.0:
                continue
            near = 0.0 if leg.vessel_mm is None else max(1.0 - leg.vessel_mm / 3.0, 0.0)
            lost = (
                weights.misses * (1.0 - leg.hit_share)
                + weights.way * leg.outside_mm / found.tool.reach_mm
                + weights.angle * min(leg.angle_deg / 90.0, 1.0)
                + weights.narrow * min(max(4.0 * (1.0 - diameter_mm / found.scope.fit_mm), 0.0), 1.0)
                + weights.vessels * near
                + weights.shallow * max(1.0 - leg.in_target_mm / min(8.0, 0.9 * nodule.short_mm), 0.0)
            )
            total = sum(getattr(weights, name) for name in weights.__slots__)
            best = max(best, 1.0 - lost / total)
    # The narrowest point of a branch may be beyond the scope's tip, so the search here is at least as strict.
    assert {route.outlook for route in plan().routes} == {"does not reach"}, "the score alone ranks them"
    assert plan().routes[0].score >= best - 0.02
    assert [route.score for route in plan().routes] == sorted((route.score for route in plan().routes), reverse=True)


def test_parking_position_of_the_first_route_is_best_also_between_evaluated_positions() -> None:
    airways, found = cached_airways(**CHEST), plan()
    first, nodule = found.routes[0], found.nodule
    around = surroundings(cached_phantom(**CHEST).volume, np.array(nodule.centre_lps), 50.0, nodule, wall())
    scene = NeedleScene(nodule, wall(), around, found.tool, NeedleErrors())
    judge = Judge(found.scope, 3.0, ScoreWeights(), found.tool.reach_mm)
    measures = measure_tree(cached_phantom(**CHEST).volume, airways)
    positions = ScopePositions(airways.tree, nodule, wall(), measures=measures, spacing_mm=1.1)
    directions = TipDirections(airways.tree, wall(), found.scope)
    finer = positions.beside((first.branch_id, first.along_mm + mm) for mm in np.arange(-8.0, 8.0, 0.6))
    scores = []
    for n, (point, forward) in enumerate(zip(finer.points, finer.forward, strict=True)):
        leg = last_leg(scene, point, forward)
        if not leg.reaches or leg.angle_deg > 100.0:
            continue
        standing = StandingPlace(int(finer.branch[n]), float(finer.along_mm[n]), point, forward)
        aim = np.array(nodule.centre_lps)
        tip = directions.towards(standing, aim, 0.5 * nodule.short_mm)
        if tip is None:
            leg = dataclasses.replace(leg, hit_share=0.0)
        else:
            leg = last_leg(scene, tip.tip_lps, forward, tip.tip_lps + np.linalg.norm(aim - tip.tip_lps) * tip.forward)
        required = finer.requirements_at(n, bending_mm(found.scope))
        outlook, chance, _ = judge.outlook(required, leg)
        assert RANK[outlook] >= RANK[first.outlook]
        if outlook == first.outlook:
            score = judge.score(judge.parts(leg, required.width.mm, nodule))
            scores.append(score * (chance if outlook == "may reach" else 1.0))
    assert len(scores) > 5
    lines = [(airways.tree.branch(route.branch_id).points, np.array(route.leg.tip_lps)) for route in found.routes]
    assert any(np.linalg.norm(line - tip, axis=1).min() > 0.05 for line, tip in lines), "between two points"
    assert first.score * (first.chance if first.outlook == "may reach" else 1.0) >= max(scores) - 0.004


def test_at_least_two_routes_with_separate_end_positions_are_listed() -> None:
    tips = [np.array(route.leg.tip_lps) for route in plan().routes]
    assert len(tips) >= 2
    assert min(np.linalg.norm(a - b) for n, a in enumerate(tips) for b in tips[:n]) > 4.0


def test_only_the_better_of_two_routes_that_end_close_together_is_listed() -> None:
    best, other = plan().routes[:2]
    x, y, z = best.leg.tip_lps
    beside = dataclasses.replace(
        best, score=0.5 * best.score, leg=dataclasses.replace(best.leg, tip_lps=(x, y, z + 3.5))
    )
    apart = dataclasses.replace(
        best, score=0.4 * best.score, leg=dataclasses.replace(best.leg, tip_lps=(x, y, z + 4.5))
    )
    assert standing_apart([best, beside, other]) == (best, other)
    assert standing_apart([best, apart]) == (best, apart)


def test_route_that_the_scope_reaches_is_listed_before_an_unreachable_route_with_a_better_score() -> None:
    best, other = plan().routes[:2]
    near = dataclasses.replace(best, outlook="does not reach")
    far = dataclasses.replace(other, outlook="reaches", score=0.1)
    doubtful = dataclasses.replace(other, outlook="may reach", score=0.2)
    assert sorted([near, doubtful, far], key=order) == [far, doubtful, near]
    likelier = dataclasses.replace(doubtful, score=0.15, chance=0.8)
    assert sorted([dataclasses.replace(doubtful, chance=0.5), likelier], key=order)[0] == likelier


def test_limits_of_the_scope_are_reported_with_their_figures() -> None:
    volume, airways, nodule = cached_phantom(**CHEST).volume, cached_airways(**CHEST), plan().nodule
    rigid = dataclasses.replace(slim(), flexion_deg=(40.0, 40.0))
    (stiff, *_) = plan_route(volume, airways, nodule, wall=wall(), scope=rigid).routes
    assert stiff.outlook == "does not reach" and stiff.bend_deg > 60.0
    bend = r"the bend \d+ mm past the main carina requires \d+ degrees of flexion( at a radius of \d+ mm)?; .* has 40"
    assert re.search(bend, stiff.limits[0])
    (undriven, *_) = plan_route(volume, airways, nodule, wall=wall(), scope=rigid, drives=0).routes
    assert any("cannot point at the target there" in limit for limit in undriven.limits)
    free = plan_ahead().routes[0]
    assert (free.outlook, free.limits) == ("reaches", ()), free.limits
    wide = plan().routes[0]
    assert wide.outlook == "does not reach" and not wide.fits
    assert re.search(
        r"needs 4\.6 mm; the narrowest place, \d+ mm past the main carina, is \d\.\d \u00b1 \d\.\d mm wide",
        wide.limits[0],
    )


def test_route_along_a_doubtful_branch_may_reach_even_if_its_simulated_drive_arrives() -> None:
    airways, volume = cached_airways(**CHEST), cached_phantom(**CHEST).volume
    sure = plan_ahead().routes[0]
    doubted = plan_route(
        volume, retreed(airways, sure.branch_id, confidence=0.3), nodule_ahead(), wall=wall(), scope=slim()
    ).routes[0]
    assert (sure.outlook, sure.doubts) == ("reaches", ())
    assert (doubted.branch_id, doubted.outlook) == (sure.branch_id, "may reach") and doubted.doubts != ()
    assert doubted.hold is not None


def test_figures_of_a_route_with_a_simulated_drive_equal_those_of_its_verdict() -> None:
    found = plan_ahead()
    first = found.routes[0]
    verdict = judge_scope(cached_airways(**CHEST).tree, found, wall(), found.scope)
    assert verdict.outcome == first.outlook == "reaches" and verdict.route_key == first.key
    pointing = next(check for check in verdict.checks if check.name == "pointing")
    assert pointing.share == first.leg.hit_share > 0.5 and verdict.hold == first.hold
    # A new simulation without the stored drive finds the same drive.
    again = dataclasses.replace(first)
    assert again is not first
    repeated = judge_scope(cached_airways(**CHEST).tree, found, wall(), found.scope, route=again)
    assert repeated.to_json() == verdict.to_json()


def test_first_route_is_simulated_even_if_no_attainable_direction_hits_the_target(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    volume, airways = cached_phantom(**CHEST).volume, cached_airways(**CHEST)
    monkeypatch.setattr(TipDirections, "towards", lambda *_given: None)
    found = plan_route(volume, airways, nodule_ahead(), wall=wall(), scope=slim(), drives=1)
    first = found.routes[0]
    verdict = judge_scope(airways.tree, found, wall(), found.scope)
    share = next(check.share for check in verdict.checks if check.name == "pointing")
    assert share == first.leg.hit_share > 0.0


def test_route_with_an_estimated_outlook_has_no_tip_pose_of_a_simulated_drive() -> None:
    volume, airways = cached_phantom(**CHEST).volume, cached_airways(**CHEST)
    estimated = plan_route(volume, airways, nodule_ahead(), wall=wall(), scope=slim(), drives=0).routes[0]
    assert (estimated.outlook, estimated.hold) == ("reaches", None), "with drives=0 outlooks are estimated"
    assert plan_ahead().routes[0].hold is not None


def test_outlook_of_a_needle_that_does_not_pass_the_channel_is_does_not_reach() -> None:
    volume, airways = cached_phantom(**CHEST).volume, cached_airways(**CHEST)
    narrow = dataclasses.replace(slim(), channel_mm=1.2)
    route = plan_route(volume, airways, nodule_ahead(), wall=wall(), scope=narrow).routes[0]
    assert route.outlook == "does not reach" and route.chance == 0.0
    assert any("the working channel has 1.2 mm" in limit for limit in route.limits)


def test_best_route_to_each_aim_is_listed_and_states_its_aim() -> None:
    volume, airways, nodule = cached_phantom(**CHEST).volume, cached_airways(**CHEST), plan().nodule
    centre = np.array(nodule.centre_lps)
    aims = [centre, centre - [0.0, 5.0, 0.0], centre - [0.0, 0.0, 5.0]]
    found = plan_route(volume, airways, nodule, aims=aims, wall=wall(), drives=0)
    assert np.allclose(found.aims, aims) and {route.aim for route in found.routes} == {0, 1, 2}
    for route in found.routes:
        aimed = np.allclose(route.leg.aim_lps, aims[route.aim])
        assert aimed or route.leg.in_target_mm > 0.0, "the needle has the attainable direction nearest to the aim"
        assert route.key == f"{route.branch_id}-{route.along_mm:.1f}" + ("", "-2", "-3")[route.aim]
        along = np.array(route.leg.aim_lps) - route.leg.tip_lps
        assert route.leg.angle_deg == pytest.approx(
            np.degrees(np.arccos(along @ route.forward / np.linalg.norm(along))), abs=0.1
        )
    assert len({route.key for route in found.routes}) == len(found.routes)
    alone = plan_route(volume, airways, nodule, aims=aims[1], wall=wall(), drives=0).routes[0]
    assert alone.leg == next(route for route in found.routes if route.aim == 1).leg
    assert plan().routes[0].key == next(route for route in found.routes if route.aim == 0).key
    with pytest.raises(UsageError, match=r"lies \d+\.\d mm outside the target"):
        plan_route(volume, airways, nodule, aims=[centre - [0.0, 30.0, 0.0]], wall=wall())
    with pytest.raises(UsageError, match="aims: expected 1 to 3 points"):
        plan_route(volume, airways, nodule, aims=[centre] * 4, wall=wall())


def test_compared_tools_are_those_that_pass_the_channel_and_reach_the_target() -> None:
    for route in plan().routes:
        reach = {one.name for one in tools() if one.pierces and one.reach_mm >= route.leg.to_target_mm}
        assert set(route.tools) == reach, "all needles pass 2.0 mm; no other tool leaves the lumen"
    narrow = dataclasses.replace(scope_preset("thin"), channel_mm=1.2)
    volume, airways = cached_phantom(**CHEST).volume, cached_airways(**CHEST)
    (first, *_) = plan_route(volume, airways, plan().nodule, scope=narrow, wall=wall(), drives=0).routes
    assert first.tools == ()


def test_forceps_reach_a_target_in_the_lumen_and_not_one_outside_it() -> None:
    volume, airways = cached_phantom(**CHEST).volume, cached_airways(**CHEST)
    bronchus = airways.tree.named("LMB")
    middle = len(bronchus.points) // 2
    inside = ellipsoid((2.5, 2.5, 2.5), bronchus.points[middle])
    found = plan_route(volume, airways, inside, tool="forceps", wall=wall())
    best = found.routes[0]
    assert best.leg.is_open and best.outlook == "reaches" and "forceps" in best.tools and "brush" in best.tools
    assert all(one.tissue in {"lumen", "target"} for one in best.leg.crossed[:2])
    outside = plan_route(volume, airways, plan().nodule, tool="forceps", wall=wall())
    assert outside.routes == () and outside.nearest is not None
    assert "Biopsy forceps, 1.8 mm stays in the lumen" in outside.why and "Choose a needle" in outside.why
    assert outside.nearest.branch_name in outside.why


def test_target_in_the_trachea_is_reached_from_the_trachea() -> None:
    volume, airways = cached_phantom(**CHEST).volume, cached_airways(**CHEST)
    trachea = airways.tree.root
    inside = ellipsoid((3.0, 3.0, 3.0), trachea.points[int(0.7 * len(trachea.points))])
    best = plan_route(volume, airways, inside, tool="forceps", wall=wall()).routes[0]
    assert best.branch_id == trachea.id and best.outlook == "reaches"
    origin = distance_origin(volume, airways)
    assert best.origin == origin and origin.axes_mm == pytest.approx(trachea.length_mm)
    assert best.from_carina_mm < 0.0 and best.from_carina_mm == best.along_mm - origin.along_mm


def test_plan_is_plain_json_and_equal_for_a_click_and_for_the_nodule_segmented_from_it() -> None:
    document = plan().to_json()
    assert json.loads(json.dumps(document)) == document
    assert document["weights"] == {name: getattr(ScoreWeights(), name) for name in ScoreWeights.__slots__}
    assert (document["vessel_margin_mm"], document["aims"]) == (3.0, [list(plan().nodule.centre_lps)])
    assert document["routes"][0]["parking"] == {
        "place_lps": list(plan().routes[0].leg.tip_lps),
        "roll_rad": None,
        "flexion_rad": None,
        "withdrawn_mm": 0.0,
    }
    volume = cached_phantom(**CHEST).volume
    again = plan_route(volume, cached_airways(**CHEST), grow_nodule(volume, truth()["centre_lps"]), wall=wall())
    assert again.to_json() == document


def test_route_along_a_drawn_bridged_or_doubtful_branch_has_a_doubt() -> None:
    airways, best = cached_airways(**CHEST), plan().routes[0]
    parent = airways.tree.branch(best.branch_id).parent
    name = airways.tree.branch(parent).name or f"branch {parent}"
    for change, text in (
        ({"kind": "manual"}, f"{name} was drawn by hand"),
        ({"kind": "bridge"}, f"{name} is a bridge across an obstruction"),
        ({"confidence": 0.31}, f"{name} is doubtful: 31 % confidence"),
    ):
        doubted = retreed(airways, parent, **change)
        changed = plan_route(cached_phantom(**CHEST).volume, doubted, plan().nodule, wall=wall(), drives=0)
        route = next(one for one in changed.routes if one.branch_id == best.branch_id)
        assert any(doubt.startswith(text) for doubt in route.doubts)
    assert best.doubts == ()


def test_plan_without_a_near_airway_reports_it_with_a_remedy() -> None:
    short = Tool("short", "A short needle", 1.8, 1.0, True, None, "k")
    found = plan_route(cached_phantom(**CHEST).volume, cached_airways(**CHEST), plan().nodule, tool=short, wall=wall())
    assert found.routes == ()
    assert found.why.startswith("no route: the nearest airway found is ")
    assert "A short needle reaches 1 mm" in found.why and "percutaneous" in found.why


def test_bronchus_sign_distinguishes_a_bronchus_that_enters_a_nodule_from_one_beside_it() -> None:
    airways, volume = cached_airways(**CHEST), cached_phantom(**CHEST).volume
    tip = next(one for one in airways.tree.tips() if one.generation >= 5 and one.length_mm > 8.0)
    ahead = tip.points[-1] - tip.points[-4]
    ahead /= np.linalg.norm(ahead)
    across = np.cross(ahead, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    middle = tip.points[len(tip.points) // 2]

    def sign(centre):
        return plan_route(volume, airways, ellipsoid((4.0, 4.0, 4.0), centre), wall=wall(), drives=0)

    into = sign(tip.points[-1] + 3.5 * ahead)
    assert (into.bronchus_sign, into.sign_branch) == ("into", tip.name or f"branch {tip.id}")
    beside = sign(middle + (4.0 + 1.0 + float(np.median(tip.wall_distance))) * across)
    assert beside.bronchus_sign in {"beside", "into"}
    far = volume.lps_from_ijk[:3, 3] + volume.lps_from_ijk[:3, :3] @ [4.0, 4.0, 4.0]
    assert sign(far).bronchus_sign == "none"


def test_default_movement_of_a_plan_is_larger_in_the_lower_than_in_the_upper_lobe() -> None:
    airways, volume = cached_airways(**CHEST), cached_phantom(**CHEST).volume
    for name, moved_mm in (("RLL", 20.0), ("RUL", 15.0)):
        place = airways.tree.named(name).points[-1]
        made = plan_route(volume, airways, ellipsoid((3.0, 3.0, 3.0), place), wall=wall(), drives=0)
        assert made.moved_mm == moved_mm


def test_plan_with_an_invalid_argument_is_refused_with_a_message() -> None:
    airways, volume = cached_airways(**CHEST), cached_phantom(**CHEST).volume
    with pytest.raises(UsageError, match="no tool is called 'saw'; expected one of needle-21g"):
        plan_route(volume, airways, plan().nodule, tool="saw", wall=wall())
    with pytest.raises(UsageError, match="vessel_margin_mm: expected a number from 0 to 50 mm; found -1"):
        plan_route(volume, airways, plan().nodule, vessel_margin_mm=-1.0, wall=wall())
    with pytest.raises(UsageError, match="misses: expected a number from 0"):
        ScoreWeights(misses=-0.1)
    with pytest.raises(NoResultError, match="nodule"):
        plan_route(volume, airways, airways.tree.root.points[0] + [0.0, 60.0, 0.0], wall=wall())
    with pytest.raises(CancelledError):
        plan_route(volume, airways, plan().nodule, wall=wall(), cancel=lambda: True)


def test_progress_of_route_planning_never_decreases_and_ends_at_one() -> None:
    fractions: list[float] = []
    plan_route(
        cached_phantom(**CHEST).volume,
        cached_airways(**CHEST),
        plan().nodule,
        wall=wall(),
        progress=lambda _what, share: fractions.append(share),
    )
    assert fractions == sorted(fractions) and fractions[-1] == 1.0


@cache
def tube() -> tuple[Volume, WallField]:
    """Return a straight airway of 3 mm radius along z in lung, with a vessel beside it."""
    z, y, x = np.mgrid[-40:41, -40:41, -40:41].astype(np.float32)
    off = np.hypot(x, y)
    hu = np.where(off < 3.0, -1000.0, np.where(off < 4.0, 0.0, -860.0))
    hu = np.where(np.hypot(x - 12.0, z - 9.0) < 2.0, 40.0, hu)
    place = np.eye(4)
    place[:3, 3] = -40.0
    return Volume(hu.astype(np.int16), place), WallField.from_distances(3.0 - off, place)


def test_needle_path_from_a_straight_tube_has_the_drawn_distances_and_angle() -> None:
    volume, field = tube()
    nodule = ellipsoid((5.0, 5.0, 5.0), (20.0, 0.0, 0.0))
    around = surroundings(volume, np.array(nodule.centre_lps), 30.0, nodule, field)
    leg = last_leg(
        NeedleScene(nodule, field, around, tool("needle-21g-long"), NeedleErrors()), np.zeros(3), np.array([0.0, 0, 1])
    )
    assert leg.angle_deg == pytest.approx(90.0)
    assert leg.entry_lps == pytest.approx((3.0, 0.0, 0.0), abs=0.3)
    assert leg.to_target_mm == pytest.approx(15.0, abs=0.55)
    assert leg.outside_mm == pytest.approx(12.0, abs=0.8)
    assert leg.in_target_mm == pytest.approx(5.0, abs=0.6)
    # The vessel axis is 9 mm from the needle, and the vessel is 2 mm thick.
    assert leg.vessel_mm == pytest.approx(7.0, abs=0.8)
    assert [one.tissue for one in leg.crossed] == ["lumen", "airway wall", "lung", "target", "lung"]


def test_vessels_nearer_to_the_needle_than_the_margin_are_listed_with_their_position() -> None:
    volume, field = tube()
    nodule = ellipsoid((5.0, 5.0, 5.0), (20.0, 0.0, 0.0))
    around = surroundings(volume, np.array(nodule.centre_lps), 30.0, nodule, field)
    scene = NeedleScene(nodule, field, around, tool("needle-21g-long"), NeedleErrors(), 8.0)
    leg = last_leg(scene, np.zeros(3), np.array([0.0, 0.0, 1.0]))
    (vessel,) = leg.vessels
    assert vessel.distance_mm == leg.vessel_mm == pytest.approx(7.0, abs=0.8)
    # Moving 2 mm along the needle changes the distance by 0.2 mm, less than a voxel shows.
    assert vessel.at_mm == pytest.approx(12.0, abs=2.0)
    assert np.allclose(vessel.place_lps, [vessel.at_mm, 0.0, 0.0])
    closer = dataclasses.replace(scene, margin_mm=3.0)
    assert last_leg(closer, np.zeros(3), np.array([0.0, 0.0, 1.0])).vessels == ()


def test_distances_to_vessel_and_chest_wall_behind_the_target_are_measured_from_its_far_edge() -> None:
    z, y, x = np.mgrid[-40:41, -40:41, -40:41].astype(np.float32)
    off = np.hypot(x, y)
    hu = np.where(off < 3.0, -1000.0, np.where(off < 4.0, 0.0, -860.0))
    hu = np.where((np.hypot(x - 19.0, z) < 1.5) | (x > 24.0), 40.0, hu)
    place = np.eye(4)
    place[:3, 3] = -40.0
    volume, field = Volume(hu.astype(np.int16), place), tube()[1]
    nodule = ellipsoid((3.0, 3.0, 3.0), (10.0, 0.0, 0.0))
    around = surroundings(volume, np.array(nodule.centre_lps), 34.0, nodule, field)
    scene = NeedleScene(nodule, field, around, tool("needle-21g"), NeedleErrors())
    leg = last_leg(scene, np.zeros(3), np.array([0.0, 0.0, 1.0]))
    # The far edge of the target is at 13 mm, the vessel begins at 17.5 mm, and the chest wall at 24 mm is more than 10
    # mm away.
    assert leg.vessel_beyond_mm == pytest.approx(4.5, abs=0.9)
    assert leg.beyond_mm is None and leg.vessels == () and leg.mediastinum_mm == 0.0
    nearer = last_leg(scene, np.array([-2.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), aim_lps=np.array([12.5, 0.0, 0.0]))
    assert nearer.aim_lps == (12.5, 0.0, 0.0)
    through = dataclasses.replace(scene, nodule=ellipsoid((2.0, 2.0, 2.0), (32.0, 0.0, 0.0)))
    crossed = last_leg(through, np.zeros(3), np.array([0.0, 0.0, 1.0]))
    assert crossed.mediastinum_mm == pytest.approx(6.0, abs=1.3)


def test_vessel_on_the_needle_path_is_named() -> None:
    volume, field = tube()
    nodule = ellipsoid((5.0, 5.0, 5.0), (20.0, 0.0, 9.0))
    around = surroundings(volume, np.array(nodule.centre_lps), 30.0, nodule, field)
    scene = NeedleScene(nodule, field, around, tool("needle-21g-long"), NeedleErrors())
    leg = last_leg(scene, np.array([0.0, 0.0, 9.0]), np.array([0.0, 0.0, 1.0]))
    assert [one.tissue for one in leg.crossed][:5] == ["lumen", "airway wall", "lung", "vessel", "lung"]
    assert leg.vessel_mm == 0.0


def test_function_plan_route_is_available_from_the_top_level_package() -> None:
    assert carina.plan_route is plan_route


def test_tissue_outside_the_examined_box_is_listed_neither_as_lung_nor_as_vessel() -> None:
    volume, field = tube()
    nodule = ellipsoid((5.0, 5.0, 5.0), (20.0, 0.0, 0.0))
    scene = NeedleScene(
        nodule,
        field,
        surroundings(volume, np.array(nodule.centre_lps), 8.0, nodule, field),
        tool("needle-21g"),
        NeedleErrors(),
    )
    leg = last_leg(scene, np.zeros(3), np.array([0.0, 0.0, 1.0]))
    assert [one.tissue for one in leg.crossed] == [
        "lumen",
        "airway wall",
        "not examined",
        "lung",
        "target",
        "lung",
        "not examined",
    ]


def test_default_movement_of_a_plan_is_equal_in_left_and_right_lower_lobe() -> None:
    airways, volume = cached_airways(**CHEST), cached_phantom(**CHEST).volume
    place = airways.tree.named("LLL").points[-1]
    made = plan_route(volume, airways, ellipsoid((3.0, 3.0, 3.0), place), wall=wall(), drives=0)
    assert made.moved_mm == 20.0


def test_plan_with_a_tool_of_unknown_diameter_is_refused() -> None:
    with pytest.raises(UsageError, match="reach_mm: expected above 0 up to 100; found inf"):
        Tool("endless", "An endless needle", 1.8, float("inf"), True, None, "k")
    with pytest.raises(UsageError, match="outer_mm: expected above 0 up to 10; found 0"):
        Tool("thin", "No needle", 0.0, 10.0, True, None, "k")
