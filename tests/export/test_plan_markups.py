"""Tests of the export of a plan as 3D Slicer markups: positions, schema and badges."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np
import pytest
from sample_plan import DOUBT, a_plan, a_tree

from carina.errors import DiskError, UsageError
from carina.export.plan_content import drawn_plans
from carina.export.plan_markups import write_plan_markups
from carina.volume import Note

TEXTS = {
    "type",
    "name",
    "coordinateSystem",
    "labelFormat",
    "id",
    "label",
    "description",
    "associatedNodeID",
    "glyphType",
}
"""Keys of markups-schema-v1.0.3.json whose value is a text."""
BOOLS = {
    "locked",
    "fixedNumberOfControlPoints",
    "selected",
    "visibility",
    "propertiesLabelVisibility",
    "pointLabelsVisibility",
    "useGlyphScale",
    "sliceProjection",
}
"""Keys of the schema whose value is true or false."""
LENGTHS = {"position": 3, "orientation": 9, "color": 3, "selectedColor": 3}
"""Keys of the schema whose value is a list of numbers, with the length of the list."""
NUMBERS = {"opacity", "textScale", "glyphSize", "lineThickness"}
"""Keys of the schema whose value is a number."""
CHOICES: dict[str, set[Any]] = {
    "type": {"Fiducial", "Line", "Angle", "Curve", "ClosedCurve", "Plane", "ROI"},
    "coordinateSystem": {"LPS", "RAS"},
    "coordinateUnits": {"mm", "um"},
    "positionStatus": {"undefined", "preview", "defined"},
    "glyphType": {"Sphere3D", "Diamond3D"},
}
"""Allowed values of the keys of the schema that have a fixed choice."""


def check_schema(value: dict[str, Any]) -> None:
    for key, item in value.items():
        if key in CHOICES:
            assert item in CHOICES[key], key
        elif key in TEXTS:
            assert isinstance(item, str), key
        elif key in BOOLS:
            assert isinstance(item, bool), key
        elif key in LENGTHS:
            assert len(item) == LENGTHS[key], key
            assert all(isinstance(v, float) for v in item), key
        elif key in NUMBERS:
            assert isinstance(item, float), key
            assert item >= 0.0, key
        elif key == "display":
            check_schema(item)
            assert all(0.0 <= v <= 1.0 for v in item["color"])
        elif key == "controlPoints":
            for point in item:
                check_schema(point)
        else:
            assert key in {"lastUsedControlPointNumber", "measurements"}, key


@pytest.fixture
def written(tmp_path) -> dict[str, Any]:
    path = write_plan_markups(tmp_path / "plan.mrk.json", a_plan(), a_tree())
    assert [p.name for p in tmp_path.iterdir()] == ["plan.mrk.json"]
    document: dict[str, Any] = json.loads(path.read_text())
    return document


def named(document: dict[str, Any], name: str) -> dict[str, Any]:
    (found,) = [markup for markup in document["markups"] if markup["name"] == name]
    return found


def places(markup: dict[str, Any]) -> np.ndarray:
    return np.array([point["position"] for point in markup["controlPoints"]])


def test_markups_file_of_a_plan_follows_the_schema_of_slicer(written):
    assert written["@schema"].endswith("markups-schema-v1.0.3.json#")
    assert [markup["type"] for markup in written["markups"]] == [
        *("Fiducial", "Fiducial", "Fiducial", "Curve", "Line", "Curve", "Line"),
    ]
    for markup in written["markups"]:
        check_schema(markup)
        assert markup["coordinateSystem"] == "LPS"
        assert markup["coordinateUnits"] == "mm"


def test_targets_scope_positions_needle_lines_and_entries_in_markups_have_the_positions_of_the_plan(written):
    plan = a_plan()
    assert np.array_equal(places(named(written, "Targets")), [plan.nodule.centre_lps])
    assert np.array_equal(places(named(written, "Scope positions")), [r.leg.tip_lps for r in plan.routes])
    assert np.array_equal(places(named(written, "Needle entries")), [r.leg.entry_lps for r in plan.routes])
    for route, marked in zip(plan.routes, ("Route 1: LB3", "Route 2: branch 9 (DOUBTFUL)"), strict=True):
        line = places(named(written, f"Needle, {marked}"))
        assert np.array_equal(line, [route.leg.tip_lps, route.leg.aim_lps])


def test_exported_route_follows_the_airways_from_the_trachea_to_the_scope_tip(written):
    tree, plan = a_tree(), a_plan()
    for route, marked in zip(plan.routes, ("Route 1: LB3", "Route 2: branch 9 (DOUBTFUL)"), strict=True):
        curve = places(named(written, marked))
        assert np.array_equal(curve[-1], route.leg.tip_lps)
        assert np.array_equal(curve[0], tree.root.points[0])
        steps = np.linalg.norm(np.diff(curve, axis=0), axis=1)
        assert steps.max() < 1.6
        assert steps.min() > 0.0
        whole = tree.route_to(route.branch_id).points_lps
        off = [np.linalg.norm(whole - point, axis=1).min() for point in curve]
        assert max(off) < 1e-9
        # The curve has no step backwards.
        ahead = np.diff(curve, axis=0)
        assert ((ahead[1:] * ahead[:-1]).sum(axis=1) > 0.0).all()


def test_exported_route_ends_at_a_tip_between_two_of_its_points_and_never_turns_back():
    tree, plan = a_tree(), a_plan()
    points = tree.branch(4).points
    for share in (0.1, 0.49, 0.51, 0.9):
        tip = points[70] + share * (points[71] - points[70]) + [0.0, 0.1, 0.0]
        leg = dataclasses.replace(plan.routes[0].leg, tip_lps=(float(tip[0]), float(tip[1]), float(tip[2])))
        moved = dataclasses.replace(plan, routes=(dataclasses.replace(plan.routes[0], leg=leg),))
        ((route,),) = [target.routes for target in drawn_plans(moved, tree)]
        assert np.array_equal(route.way_lps[-1], tip)
        ahead = np.diff(route.way_lps, axis=0)
        ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
        turns = (ahead[1:] * ahead[:-1]).sum(axis=1)
        assert (turns > 0.0).all()
        # The curve has no corner at the tip, which is 0.1 mm beside the line of a 0.7 mm step.
        assert (turns[-3:] > 0.97).all()


@pytest.mark.parametrize(
    ("vessel_mm", "text"),
    [
        (None, "No vessel seen near the needle."),
        (0.0, "The needle crosses a vessel that the CT shows."),
        (3.14, "Nearest vessel seen 3.1 mm from the needle."),
    ],
)
def test_exported_route_states_a_vessel_in_the_needle_path(vessel_mm, text):
    plan = a_plan()
    leg = dataclasses.replace(plan.routes[0].leg, vessel_mm=vessel_mm)
    met = dataclasses.replace(plan, routes=(dataclasses.replace(plan.routes[0], leg=leg),))
    assert text in drawn_plans(met, a_tree())[0].routes[0].words


def test_doubtful_route_is_marked_in_its_name_colour_and_points(written):
    sure, doubtful = named(written, "Route 1: LB3"), named(written, "Route 2: branch 9 (DOUBTFUL)")
    red, green, blue = doubtful["display"]["color"]
    assert red > 3.0 * max(green, blue)
    assert sure["display"]["color"][0] < sure["display"]["color"][1]
    assert f"{DOUBT}." in doubtful["controlPoints"][-1]["description"]
    assert DOUBT not in sure["controlPoints"][-1]["description"]
    for name in ("Scope positions", "Needle entries"):
        first, second = named(written, name)["controlPoints"]
        assert DOUBT in second["description"]
        assert "DOUBTFUL" in second["label"]
        assert "DOUBTFUL" not in first["label"] + first["description"]


def test_best_route_is_red_if_it_is_doubtful(tmp_path):
    plan = a_plan()
    turned = dataclasses.replace(plan, routes=plan.routes[::-1])
    document = json.loads(write_plan_markups(tmp_path / "p.mrk.json", turned, a_tree()).read_text())
    for name in ("Route 1: branch 9 (DOUBTFUL)", "Needle, Route 1: branch 9 (DOUBTFUL)"):
        red, green, blue = named(document, name)["display"]["color"]
        assert red > 3.0 * max(green, blue)


def test_target_in_markups_states_its_size_its_error_and_its_motion(written):
    text = named(written, "Targets")["controlPoints"][0]["description"]
    for part in ("12.0 x 9.0 mm", "0.57 ml", "90 % within", "pleura", "LB3 lies against it", "up to 15 mm from"):
        assert part in text
    assert "Not a medical device." in text


def test_several_targets_have_different_names_in_markups_and_the_file_has_all_badges(tmp_path):
    plans = {"Nodule A": a_plan(), "Nodule B": a_plan(doubts=(), aim_lps=(20.0, -3.0, -70.0))}
    badge = Note("import.lossy", "the slices were compressed with loss", badge=True)
    path = write_plan_markups(tmp_path / "p.mrk.json", plans, a_tree(), badges=[badge])
    document = json.loads(path.read_text())
    points = named(document, "Targets")["controlPoints"]
    assert [point["label"] for point in points] == list(plans)
    assert all("import.lossy" in point["description"] for point in points)
    # A badge that the plan already states is not repeated.
    noted = dataclasses.replace(a_plan(), notes=(badge.words,))
    again = json.loads(write_plan_markups(tmp_path / "q.mrk.json", noted, a_tree(), badges=[badge]).read_text())
    assert json.dumps(named(again, "Targets")).count("compressed with loss") == 1
    assert named(document, "Route 2: branch 9 to Nodule B")["type"] == "Curve"
    assert len({markup["name"] for markup in document["markups"]}) == len(document["markups"])


def test_markups_of_a_plan_without_a_route_state_the_reason(tmp_path):
    plan = dataclasses.replace(a_plan(), routes=(), why="no route: the nearest airway found is LB3, 40 mm away")
    document = json.loads(write_plan_markups(tmp_path / "p.mrk.json", plan, a_tree()).read_text())
    (only,) = document["markups"]
    assert "40 mm away" in only["controlPoints"][0]["description"]


def test_markups_with_the_tree_of_another_plan_a_wrong_suffix_or_no_target_are_refused(tmp_path):
    plan, tree = a_plan(), a_tree()
    moved = tuple(dataclasses.replace(b, points=b.points + np.array([0.0, 6.0, 0.0])) for b in tree.branches)
    with pytest.raises(UsageError, match=r"lies 5\.2 mm from this tree") as caught:
        write_plan_markups(tmp_path / "p.mrk.json", plan, dataclasses.replace(tree, branches=moved))
    assert caught.value.code == "plan.other-tree"
    unknown = dataclasses.replace(plan.routes[0], branch_id=77)
    with pytest.raises(UsageError, match="branch 77"):
        write_plan_markups(tmp_path / "p.mrk.json", dataclasses.replace(plan, routes=(unknown,)), tree)
    with pytest.raises(UsageError, match=r"\.mrk\.json"):
        write_plan_markups(tmp_path / "p.json", plan, tree)
    with pytest.raises(UsageError, match="no target"):
        write_plan_markups(tmp_path / "p.mrk.json", {}, tree)
    with pytest.raises(UsageError, match="one line"):
        write_plan_markups(tmp_path / "p.mrk.json", {"a\nb": plan}, tree)
    assert not list(tmp_path.iterdir())
    with pytest.raises(DiskError):
        write_plan_markups(tmp_path / "missing" / "p.mrk.json", plan, tree)
