"""Tests of the list of reasons against a plan, and of its equality in all outputs."""

from __future__ import annotations

import dataclasses
import html
import json
import re

import pytest
from phantom_plan import airways, plan, sheet, turns, verdicts, with_drawn_branch

from carina.plan import Check, TargetMovement
from carina.plan.reasons import reasons_against, route_reasons
from carina.plan.report import write_report
from carina.plan.report.drawing import Label
from carina.plan.report.plan_sheet import PlanSheet
from carina.plan.report.sections import sections
from carina.plan.report.tracing import SMALL, TRACING_SIZE, tracing_drawings
from carina.plan.report.wording import text_width
from carina.plan.routes.last_leg import CrossedTissue
from carina.plan.routes.no_route_reasons import LostAirway
from carina.plan.targets.doubts import TargetDoubt
from carina.plan.targets.edits import BRUSHED
from carina.plan.turns.fork_view import HourDoubt

VESSEL = (CrossedTissue("lumen", 0.0, 3.0), CrossedTissue("vessel", 3.0, 2.0), CrossedTissue("target", 5.0, 8.0))


def doubtful() -> PlanSheet:
    """Return a sheet whose plan has a reason of each kind."""
    route = plan().routes[0]
    leg = dataclasses.replace(
        route.leg, crossed=(*VESSEL, CrossedTissue("not examined", 13.0, 1.0)), mediastinum_mm=6.0
    )
    changed = dataclasses.replace(
        route,
        leg=leg,
        limits=("the bend 90 mm past the main carina requires 190 degrees of flexion",),
        doubts=("RB4a was drawn by hand",),
        width=dataclasses.replace(route.width, why="RB4a is thinner than two voxels", mm=2.4),
    )
    changed_plan = dataclasses.replace(
        plan(),
        nodule=dataclasses.replace(plan().nodule, notes=(BRUSHED, "with a cavity of 0.2 ml"), touches=("vessel",)),
        routes=(changed, *plan().routes[1:]),
        doubts=(TargetDoubt("target.density", "at 189 HU it is denser than soft tissue"),),
        lost=LostAirway(16.2, "lost here, 3.1 mm wide"),
        movement=TargetMovement.measured((1.0, 2.0, 9.0), 3.0, ("the target was not recognised in the second CT",)),
        notes=("the tree is lost 16 mm short of the target: lost here, 3.1 mm wide", "the CT has thick slices"),
    )
    listed = turns(airways(), plan())
    first = dataclasses.replace(
        listed.turns[1],
        hour_doubt=HourDoubt("turns.hidden", "no clock hour: the opening is hidden before the fork"),
        clock_head=None,
    )
    listed = dataclasses.replace(listed, turns=(listed.turns[0], first, *listed.turns[2:]))
    return dataclasses.replace(sheet(), plan=changed_plan, turns=listed)


def drawn() -> PlanSheet:
    found, drawn_plan = with_drawn_branch()
    return sheet(airways=found, plan=drawn_plan, turns=turns(found, drawn_plan))


def withdrawn() -> PlanSheet:
    """Return a sheet whose drive leaves the tip 5 mm before the end of the route, and points at the target."""
    route = dataclasses.replace(plan().routes[0], withdrawn_mm=5.0)
    own = [dataclasses.replace(one, withdrawn_mm=5.0) for one in verdicts() if one.scope.name == plan().scope.name]
    others = [one for one in verdicts() if one.scope.name != plan().scope.name]
    return dataclasses.replace(
        sheet(), plan=dataclasses.replace(plan(), routes=(route, *plan().routes[1:])), verdicts=(*own, *others)
    )


SHEETS = {
    "withdrawn": withdrawn,
    "usual": sheet,
    "doubtful": doubtful,
    "drawn": drawn,
    "no verdict": lambda: dataclasses.replace(sheet(), verdicts=()),
}


def plain(text: str) -> str:
    return re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]*>", " ", text)))


def on_sheet(report: PlanSheet) -> str:
    """Return the text of the tracing sheet, whose lines are joined."""
    labels = [
        shape.text for drawing in tracing_drawings(report) for shape in drawing.shapes if isinstance(shape, Label)
    ]
    return " ".join(labels)


@pytest.mark.parametrize("name", SHEETS)
def test_report_sheet_and_json_list_the_same_reasons_against_a_plan_in_the_same_order(name, tmp_path) -> None:
    report = SHEETS[name]()
    reasons = reasons_against(report.plan, route=report.route, verdicts=report.verdicts, turns=report.turns)
    reason_texts = [reason.words for reason in reasons]
    assert reason_texts and [reason.to_json() for reason in reasons] == report.to_json()["report"]["reasons"]
    written = json.loads(write_report(tmp_path / "plan.json", report).read_text())
    assert [one["words"] for one in written["report"]["reasons"]] == reason_texts
    text = write_report(tmp_path / "plan.html", report).read_text()
    part = re.search(r'<section id="against".*?</section>', text, re.DOTALL)[0]
    assert [html.unescape(one) for one in re.findall(r"<li[^>]*>(.*?)</li>", part)] == reason_texts
    (against,) = [part for part in sections(report) if part.name == "against"]
    assert against.blocks[0].items == tuple(reason_texts)
    sheet_text = on_sheet(report)
    places = [sheet_text.index(one) for one in reason_texts]
    assert places == sorted(places)


def test_reasons_against_a_plan_include_every_kind_once_and_in_order() -> None:
    codes = [reason.code for reason in doubtful().reasons]
    assert list(dict.fromkeys(codes)) == [
        "plan.verdict",
        "plan.limit",
        "needle.vessel",
        "needle.near-vessel",
        "needle.mediastinum",
        "needle.unexamined",
        "target.density",
        "target.note",
        "target.touches",
        "route.narrowest",
        "route.doubt",
        "plan.lost",
        "plan.note",
        "plan.movement",
        "turn.hour",
    ]
    words = [reason.words for reason in doubtful().reasons]
    assert sum("lost 16 mm short" in one for one in words) == 1
    red = {reason.code for reason in doubtful().reasons if reason.severity == "stop"}
    assert {"needle.vessel", "target.density", "route.doubt", "plan.verdict"} <= red and "plan.lost" not in red
    assert words[-1].startswith("No clock hour for ") and words[-1].count("clock hour") == 1
    assert any("\u00b1" in reason.words for reason in doubtful().reasons if reason.code == "route.narrowest")


@pytest.mark.parametrize("answer", ["no", "perhaps", "unknown"])
def test_every_failed_check_of_the_planned_scope_is_a_reason_against_the_plan(answer) -> None:
    own = next(one for one in verdicts() if one.scope.name == plan().scope.name)
    checks = tuple(dataclasses.replace(check, answer=answer, words=f"{check.name} fails") for check in own.checks)
    changed = dataclasses.replace(own, outcome="does not reach", checks=checks)
    text = " ".join(one.words.lower() for one in reasons_against(plan(), verdicts=(changed,)))
    assert checks and all(check.words in text for check in checks)


@pytest.mark.parametrize("with_verdicts", [True, False])
def test_withdrawn_tip_is_a_reason_that_states_both_distances_in_all_outputs(with_verdicts) -> None:
    report = withdrawn()
    planned, route = report.plan, report.plan.routes[0]
    given = report.verdicts if with_verdicts else ()
    (found,) = [one for one in reasons_against(planned, verdicts=given) if one.code == "route.withdrawn"]
    past_mm = route.from_carina_mm
    assert found.words == (
        "The drive withdraws the tip by 5 mm from the end of the route, and aims at the target "
        f"{past_mm - 5.0:.0f} mm past the main carina, not {past_mm:.0f} mm past the main carina."
    )
    assert found.words in [one.words for one in route_reasons(planned, route)], "the exports list it"
    assert not [one for one in reasons_against(plan(), verdicts=verdicts()) if one.code == "route.withdrawn"]
    assert route.to_json()["parking"]["withdrawn_mm"] == 5.0


def test_simulated_drive_that_arrives_is_not_a_reason_against_the_plan() -> None:
    own = next(one for one in verdicts() if one.scope.name == plan().scope.name)
    drive = Check("drive", "perhaps", 0.5, "if it fits: arrives at the end of the route by 18 moves", "mechanics")
    changed = dataclasses.replace(own, outcome="may reach", checks=(*own.checks, drive))
    route = dataclasses.replace(plan().routes[0], limits=(drive.words,))
    text = " ".join(one.words for one in reasons_against(plan(), route=route, verdicts=(changed,)))
    assert "arrives" not in text


def test_missing_route_is_the_first_reason_against_a_plan() -> None:
    none = dataclasses.replace(plan(), routes=(), why="no route: too far away")
    first, *_ = reasons_against(none)
    assert (first.code, first.words, first.severity) == ("plan.no-route", "No route: too far away.", "stop")


def test_bronchus_sign_without_an_airway_states_where_the_tree_is_lost() -> None:
    lost = dataclasses.replace(plan(), bronchus_sign="none", sign_branch=None, lost=LostAirway(16.2, "lost here"))
    assert lost.sign_words == "no airway found; the tree is lost 16 mm short of the target"
    assert dataclasses.replace(lost, lost=None).sign_words == "no airway found"
    into = dataclasses.replace(lost, bronchus_sign="into", sign_branch="RB4a")
    assert into.sign_words == "an airway leads into the target (RB4a)"


@pytest.mark.parametrize("name", SHEETS)
def test_text_of_the_printed_sheet_is_inside_the_page_and_large_enough(name) -> None:
    (drawing,) = tracing_drawings(SHEETS[name]())
    for label in drawing.shapes:
        if not isinstance(label, Label):
            continue
        wide = text_width(label.text, label.size, is_bold=label.bold)
        left = label.at[0] - {"start": 0.0, "middle": 0.5 * wide, "end": wide}[label.anchor]
        assert left >= -1.0 and left + wide <= TRACING_SIZE[0] + 1.0, label.text
        assert 0.0 < label.at[1] < TRACING_SIZE[1] and label.size >= SMALL


def test_printed_sheet_has_complete_hand_moves_and_fields_to_fill_in() -> None:
    text = on_sheet(sheet())
    for turn in sheet().turns.turns:
        assert f"advance {turn.moves[0].advance_mm:.0f} mm" in text
    assert all(name in text for name in ("Patient label", "Bronchoscope, serial number", "Date"))
