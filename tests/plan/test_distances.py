"""Tests of the origin of distances: every output of a plan states the same distances from the main carina's ridge."""

from __future__ import annotations

import dataclasses
import itertools
import json
import re
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import numpy as np
import pytest
from fork_trees import made_tree, random_tree, route_in, turn_list_with_small_views
from hypothesis import given, settings
from hypothesis import strategies as st
from phantom_plan import airways, plan, sheet, turns, verdicts, volume
from test_report import words_of

import carina
from carina.case.routes import back_to_route_mm, centreline_mm, route_along_points, route_to_branch, route_to_point
from carina.cli.plan import lines
from carina.commands.plan import PlanOptions
from carina.errors import UsageError
from carina.export.plan_content import drawn_plans
from carina.plan import DistanceOrigin, Plan, Turn, distance_origin, judge_scopes, plan_route, turn_list
from carina.plan.reasons import reasons_against
from carina.plan.report import PlanSheet, write_report
from carina.plan.report.sections import sections, tracing_sections
from carina.plan.routes.main_carina import (
    ROOT,
    axes_origin,
    carina_words,
    origins_of_branches,
)
from carina.plan.routes.standing_points import CentrelinePoints
from carina.server.to_wire.plan import _route, _turns, _verdict
from carina.session import PlanningInfo
from carina.session.derived.plans import carina_depth_mm, origin_depth_mm
from carina.track import Airways, AirwayTree

PLACE = re.compile(r"(\d+) mm (past|above) the main carina")
BEND = re.compile(r"the bend \d+ mm (past|above) the main carina")
ENDS_MM = 1.5
"""Distance in mm from the end of the route at which a drive counts as arrived."""


def spoken_mm(text: str) -> set[int]:
    """Return the distances from the main carina that a text states, in whole mm; those of bends are left out."""
    return {int(mm) * (1 if side == "past" else -1) for mm, side in PLACE.findall(BEND.sub("", text))}


def texts(sheet: PlanSheet, *, tracing: bool = False) -> list[str]:
    chosen = tracing_sections(sheet) if tracing else sections(sheet)
    return [text for part in chosen for block in part.blocks for text in words_of(block) if text]


def wire_turns(found: Airways, made: Any) -> tuple[Any, ...]:
    return _turns(cast(PlanningInfo, SimpleNamespace(document=SimpleNamespace(airways=found))), made)


def test_json_wire_report_sheet_and_texts_of_a_plan_state_the_same_distances(tmp_path) -> None:
    stored = json.loads(write_report(tmp_path / "plan.json", sheet()).read_text())
    origin = distance_origin(volume(), airways())
    assert origin.kind == "ridge"
    expected: set[int] = set()
    for route, listed_row in zip(plan().routes, stored["routes"], strict=True):
        assert listed_row["origin"] == {"kind": "ridge", "along_mm": origin.along_mm}
        assert listed_row["from_carina_mm"] == listed_row["past_carina_mm"] == listed_row["along_mm"] - origin.along_mm
        offer = _route(route)
        for name in ("from_carina_mm", "narrowest_mm", "narrowest_at_mm"):
            assert getattr(offer, name) == listed_row[name]
        assert offer.leg.to_target_mm == listed_row["leg"]["to_target_mm"]
        expected |= {round(listed_row["from_carina_mm"]), round(listed_row["narrowest_at_mm"])}
    for verdict, listed_row in zip(verdicts(), stored["verdicts"], strict=True):
        sent = _verdict(verdict)
        assert (sent.reached_mm, sent.words, sent.title) == (
            listed_row["reached_mm"],
            listed_row["words"],
            listed_row["title"],
        )
        assert [check.words for check in sent.checks] == [check["words"] for check in listed_row["checks"]]
        expected |= set() if listed_row["reached_mm"] is None else {round(listed_row["reached_mm"])}
    expected |= {round(station["from_carina_mm"]) for station in stored["ebus"]["stations"]}
    listed = stored["turns"]
    sent_turns = wire_turns(airways(), turns(airways(), plan()))
    for sent, listed_row in zip(sent_turns, listed["turns"], strict=True):
        assert (sent.from_carina_mm, sent.from_fork_mm) == (listed_row["from_carina_mm"], listed_row["from_fork_mm"])
        expected.add(round(listed_row["from_carina_mm"]))
    assert listed["park_from_carina_mm"] == stored["routes"][0]["from_carina_mm"]
    tip = plan().routes[0].place_words
    assert tip == carina_words(listed["park_from_carina_mm"])
    # Each text states only distances of plan.json, and each output states the place of the tip.
    outputs = {
        "command line": lines(plan()),
        "export": [route.words for target in drawn_plans(plan(), airways().tree) for route in target.routes],
        "turns": [*listed["words"]["head"], *listed["words"]["facing"]],
        "window": [sent.head for sent in sent_turns] + [one.words for one in verdicts()],
        "report": texts(sheet()),
        "sheet": texts(sheet(), tracing=True),
    }
    for output, parts in outputs.items():
        text = "\n".join(parts)
        assert spoken_mm(text) <= expected, output
        assert tip in text or output == "window", output
        assert not re.search(r"\d mm (along the route|beyond the (main )?carina|from the start)", text), output
    # The sheet states the distance of each turn, and the table of the report the same number.
    (table,) = [
        block for part in sections(sheet()) if part.name == "turns" for block in part.blocks if hasattr(block, "rows")
    ]
    later = [listed_row["from_carina_mm"] for listed_row in listed["turns"][1:]]
    assert [row[4] for row in table.rows] == [
        "carina",
        *(f"{mm:.0f}" for mm in [*later, listed["park_from_carina_mm"]]),
    ]
    for listed_row in listed["turns"]:
        assert carina_words(listed_row["from_carina_mm"]) in "\n".join(outputs["sheet"])
    assert list(plan().to_columns()["from_carina_mm"]) == [
        listed_row["from_carina_mm"] for listed_row in stored["routes"]
    ]


def assert_consistent(found: Airways, made: Plan, judged: Any = ()) -> None:
    """Assert that the distances of each route lie within the route, in the order of its places."""
    for route in made.routes:
        start_mm, tip_mm = route.origin.past_mm(0.0), route.origin.past_mm(route.along_mm)
        assert start_mm <= route.width.at_mm <= tip_mm, route.key
        assert route.width.origin == route.origin
        listed = turn_list(found.tree, route)
        places = [start_mm, *(turn.from_carina_mm for turn in listed.turns), tip_mm]
        if route.origin.is_carina:
            assert listed.park_from_carina_mm == route.from_carina_mm == tip_mm
            assert places == sorted(places)
            # Each turn is as far from the previous one as the text states.
            steps = [*(turn.from_fork_mm for turn in listed.turns), listed.park_from_fork_mm]
            assert steps == pytest.approx(np.diff(places).tolist(), abs=1e-9)
            for turn in listed.turns:
                assert (turn.from_carina_mm == 0.0) or not turn.at_main_carina
    for verdict in judged:
        route = made.routes[0]
        start_mm, tip_mm = route.origin.past_mm(0.0), route.origin.past_mm(route.along_mm)
        if verdict.reached_mm is not None:
            assert start_mm <= verdict.reached_mm <= tip_mm + ENDS_MM, verdict.words
        if verdict.driven is not None:
            ends = verdict.driven.ends_along_mm
            assert all(before <= after for before, after in itertools.pairwise(ends))
            assert all(start_mm <= mm <= tip_mm + ENDS_MM for mm in (*ends, verdict.driven.stopped_mm))
    for place in (one for one in [made.nearest] if one is not None and one.from_carina_mm is not None):
        assert place.from_carina_mm == pytest.approx(place.along_mm - made.routes[0].origin.along_mm)


def test_distances_along_each_route_increase_and_do_not_exceed_its_length() -> None:
    assert_consistent(airways(), plan(), verdicts())


@pytest.mark.soak
@pytest.mark.parametrize("seed", [4, 7, 11])
def test_distances_along_routes_of_other_phantoms_increase_and_do_not_exceed_their_length(seed: int) -> None:
    made = carina.generate_phantom(seed=seed, spacing_mm=1.3, nodule=True)
    found = carina.find_airways(made.volume)
    wall = carina.wall_field(made.volume, found)
    planned = plan_route(made.volume, found, made.truth["nodule"]["centre_lps"], wall=wall)
    scopes = [carina.scopes.scope_preset(name) for name in ("thin", "ultrathin")]
    assert_consistent(found, planned, judge_scopes(found.tree, planned, wall, scopes=scopes) if planned.routes else ())


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.0, 14.0))
def test_distances_of_turns_from_the_carina_ridge_increase_and_add_up_in_random_trees(
    seed: int, ridge_mm: float
) -> None:
    tree = random_tree(seed)
    for tip in tree.tips()[::4]:
        route = route_in(tree, tip.id, ridge_mm=ridge_mm)
        found = turn_list_with_small_views(tree, route, carina_depth_mm=260.0)
        first = found.turns[0]
        assert first.at_main_carina and first.from_carina_mm == 0.0 and found.depth_mm(0.0) == 260.0
        assert first.words("head", first=True).startswith("At the main carina, enter ")
        places = [turn.from_carina_mm for turn in found.turns] + [found.park_from_carina_mm]
        assert places == sorted(places)
        steps = [turn.from_fork_mm for turn in found.turns[1:]] + [found.park_from_fork_mm]
        assert steps == pytest.approx(np.diff(places).tolist(), abs=1e-9)
        assert sum(steps) + first.from_fork_mm == pytest.approx(route.along_mm, abs=1e-9)
        assert first.from_fork_mm == pytest.approx(tree.root.length_mm + ridge_mm)


def row(
    number: int, parent: int | None, children: list[int], ends: list[list[float]], name: str | None
) -> dict[str, Any]:
    """Return a straight branch of `made_tree` from the first to the last point of ``ends``."""
    points = np.linspace(*np.array(ends, float), 9)
    return {"id": number, "parent": parent, "children": children, "name": name, "points": points, "radius": np.ones(9)}


def with_tracheal_bronchus() -> AirwayTree:
    """Return a tree with a bronchus that leaves the trachea 20 mm above the main carina."""
    return made_tree(
        [
            row(0, None, [1, 2], [[0, 0, 0], [0, 0, -60]], "Trachea"),
            row(1, 0, [], [[0, 0, -60], [-40, 0, -60]], "RB1"),
            row(2, 0, [3, 4], [[0, 0, -60], [0, 0, -80]], "Trachea"),
            row(3, 2, [], [[0, 0, -80], [-20, 0, -100]], "RMB"),
            row(4, 2, [], [[0, 0, -80], [20, 0, -100]], "LMB"),
        ]
    )


def test_distances_in_a_branch_above_the_carina_are_measured_from_the_start_of_the_tree() -> None:
    tree = with_tracheal_bronchus()
    origin = dataclasses.replace(axes_origin(tree), kind="ridge", along_mm=89.0)
    assert origin.axes_mm == pytest.approx(80.0)
    origins = origins_of_branches(tree, origin)
    assert origins[1] == ROOT and all(origins[n] == origin for n in (0, 2, 3, 4))
    centreline = CentrelinePoints(tree, origin=origin)
    for n in range(len(centreline.points)):
        required = centreline.requirements_at(n, 12.0)
        own = origins[int(centreline.branch[n])]
        assert required.width.origin == own
        start_mm, here_mm = own.past_mm(0.0), own.past_mm(float(centreline.along_mm[n]))
        assert start_mm <= required.width.at_mm <= here_mm and start_mm <= required.bend_deg.at_mm <= here_mm
    route = dataclasses.replace(route_in(tree, 1), origin=origins[1])
    assert route.from_carina_mm is None and route.place_words.endswith("mm from the start of the airway tree")
    assert turn_list(tree, route).zero is None


def test_distances_along_a_smoothed_route_are_measured_along_the_centrelines() -> None:
    tree = with_tracheal_bronchus()
    whole = route_to_branch(tree, 3)
    along = centreline_mm(tree, whole)
    assert along[0] == pytest.approx(0.0, abs=0.1)
    assert along[-1] == pytest.approx(sum(branch.length_mm for branch in tree.lineage(3)), abs=0.1)
    assert (np.diff(along) > 0.0).all()
    forks = np.interp(whole.forks_mm, whole.cumulative_mm, along)
    np.testing.assert_allclose(forks, [60.0, 80.0], atol=1e-6)
    # The cases are a route that ends within a branch, and one that begins within the trachea.
    middle = tree.branch(3).points[4]
    ends = centreline_mm(tree, route_to_point(tree, middle))[-1]
    assert ends == pytest.approx(80.0 + np.linalg.norm(middle - tree.branch(3).points[0]), abs=1.0)
    airways = SimpleNamespace(tree=tree, tracker=SimpleNamespace(calibres=lambda points, _ids: np.ones(len(points))))
    searched = route_along_points(airways, np.array([[0, 1.0, -30.0], [0, 1.0, -80.0], [-18.0, 0, -98.0]]), "t", "T")
    begun = centreline_mm(tree, searched)
    assert begun[0] == pytest.approx(30.0, abs=1.0)
    assert begun[-1] == pytest.approx(80.0 + 18.0 * np.sqrt(2.0), abs=1.0)


def test_distance_back_from_a_wrong_branch_is_measured_along_the_centrelines() -> None:
    tree = with_tracheal_bronchus()
    tips = [branch for branch in tree.branches if not branch.children]
    for goal, other in itertools.permutations(tips, 2):
        route = route_to_branch(tree, goal.id)
        lineage = [branch.id for branch in tree.lineage(goal.id)]
        left = [branch for branch in tree.lineage(other.id) if branch.id not in lineage]
        expected = sum(branch.length_mm for branch in left)
        assert back_to_route_mm(tree, route, other.id, other.points[-1]) == pytest.approx(expected)
        # The function returns None on the route, and in the opening of the wrong branch, which is inside the lumen of
        # its parent.
        assert back_to_route_mm(tree, route, goal.id, goal.points[-1]) is None
        first = left[0]
        along = first.points[1] - first.points[0]
        inside = 0.9 * float(tree.branch(first.parent or 0).radius[-1])
        opening = first.points[0] + along / np.linalg.norm(along) * inside
        assert back_to_route_mm(tree, route, first.id, opening) is None
    # A branch beyond the end of the route is not a wrong branch.
    parent = tree.branch(tips[-1].parent or 0)
    assert back_to_route_mm(tree, route_to_branch(tree, parent.id), tips[-1].id, tips[-1].points[-1]) is None


def test_main_carina_is_the_fork_at_which_both_main_bronchi_begin() -> None:
    rows = [
        row(0, None, [1, 2], [[0, 0, 0], [0, 0, -50]], None),
        row(1, 0, [], [[0, 0, -50], [-20, 0, -70]], "RMB"),
        row(2, 0, [3, 4], [[0, 0, -50], [3, 0, -53]], None),
        row(3, 2, [], [[3, 0, -53], [20, 0, -70]], "LMB"),
        row(4, 2, [], [[3, 0, -53], [3, 0, -70]], None),
    ]
    assert axes_origin(made_tree(rows)).along_mm == pytest.approx(50.0)
    rows[1]["name"] = None
    assert axes_origin(made_tree(rows)).along_mm == pytest.approx(50.0 + np.hypot(3, 3))
    rows[3]["name"] = None
    assert axes_origin(made_tree(rows)) == ROOT
    # A CT that begins in a main bronchus shows no carina.
    assert axes_origin(made_tree([row(0, None, [], [[0, 0, 0], [0, 0, -50]], "RMB")])) == ROOT


def test_fork_between_the_centreline_fork_and_the_ridge_is_at_distance_zero_from_the_carina() -> None:
    origin = DistanceOrigin("ridge", along_mm=110.0, axes_mm=100.0)
    assert [origin.fork_mm(mm) for mm in (95.0, 100.0, 104.0, 110.0, 125.0)] == [-15.0, 0.0, 0.0, 0.0, 15.0]
    assert origin.words(origin.past_mm(98.0)) == "12 mm above the main carina"
    assert DistanceOrigin("axes", 100.0, 100.0).from_carina_mm(130.0) == 30.0
    assert ROOT.from_carina_mm(130.0) is None and ROOT.words(130.0) == "130 mm from the start of the airway tree"
    with pytest.raises(UsageError):
        DistanceOrigin("ridge", along_mm=-1.0)


def test_distances_without_a_visible_ridge_are_measured_from_the_centreline_fork_with_a_note() -> None:
    found = airways()
    solid = dataclasses.replace(found, lumen_zyx=np.ones_like(found.lumen_zyx))
    origin = distance_origin(volume(), solid)
    assert origin.kind == "axes" and origin.along_mm == origin.axes_mm
    route = dataclasses.replace(plan().routes[0], origin=origin)
    listed = turn_list(found.tree, route)
    assert listed.zero == "axes" and listed.notes[0] == origin.note and listed.turns[0].from_carina_mm == 0.0
    axes = dataclasses.replace(plan(), routes=(route,))
    (reason,) = [one.words for one in reasons_against(axes) if one.code == "route.origin"]
    assert origin.note is not None and reason.casefold() == f"{origin.note}.".casefold()


def test_distances_of_lymph_node_stations_are_measured_from_the_ridge_if_it_is_known() -> None:
    origin = distance_origin(volume(), airways())
    tree = airways().tree
    for axes, ridge in zip(
        carina.plan.ebus_landmarks(tree), carina.plan.ebus_landmarks(tree, origin=origin), strict=True
    ):
        if axes.from_carina_mm is None:
            continue
        assert ridge.from_carina_mm == pytest.approx(axes.from_carina_mm - origin.ridge_beyond_axes_mm)
        assert carina_words(ridge.from_carina_mm) in ridge.words


def test_older_case_options_state_the_carina_depth_from_the_start_of_the_tree() -> None:
    older = msgspec.convert({"scope": "thin", "tool": "needle-21g", "entry_mm": 150.0}, PlanOptions)
    newer = PlanOptions(carina_depth_mm=265.0)
    beyond, beside = DistanceOrigin("ridge", along_mm=120.0, axes_mm=110.0), ROOT
    assert [origin_depth_mm(older, origin) for origin in (beyond, beside)] == [270.0, 150.0]
    assert [origin_depth_mm(newer, origin) for origin in (beyond, beside)] == [265.0, None]
    assert origin_depth_mm(PlanOptions(), beyond) is None
    route = plan().routes[0]
    assert carina_depth_mm(older, route) == 150.0 + route.origin.along_mm
    assert carina_depth_mm(older, dataclasses.replace(route, origin=ROOT)) is None
    # The list of turns accepts the largest depth that an older case can state.
    depth_mm = carina_depth_mm(PlanOptions(entry_mm=500.0), route)
    assert turn_list(airways().tree, route, carina_depth_mm=depth_mm).carina_depth_mm == 500.0 + route.origin.along_mm


def test_depth_at_the_mouth_is_the_depth_of_the_carina_plus_the_distance_from_it() -> None:
    route = plan().routes[0]
    made = turn_list(airways().tree, route, carina_depth_mm=265.0)
    assert made.park_depth_estimate_mm == 265.0 + route.from_carina_mm
    wire: tuple[Turn, ...] = wire_turns(airways(), made)
    assert [one.depth_estimate_mm for one in wire] == [265.0 + turn.from_carina_mm for turn in made.turns]
    assert f"about {round(made.park_depth_estimate_mm / 5.0) / 2.0:g} cm on the scope" in made.words("head")[-1]
