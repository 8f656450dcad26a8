"""Tests of the plan report: page, PDF and JSON agree, the page loads nothing, and doubtful facts are red."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import html
import importlib.util
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from phantom_plan import airways, clip, plan, sheet, still, turns, verdicts, volume, wall, with_drawn_branch

from carina.cli.plan import lines
from carina.errors import CancelledError, CarinaError, UsageError
from carina.export.plan_content import drawn_plans
from carina.plan import STATION_NOTE, ScoreWeights, TargetDoubt, plan_route, route_stations
from carina.plan.hand_moves import Move
from carina.plan.reasons import reasons_against
from carina.plan.report import make_sheet, write_report
from carina.plan.report.blocks import Block, Bullets, Facts, Figure, Figures, ReportTable, Words
from carina.plan.report.drawing import Label
from carina.plan.report.sections import sections
from carina.plan.report.tracing import tracing_drawings
from carina.plan.routes.ct_notes import ct_notes
from carina.plan.routes.last_leg import CrossedTissue, NearVessel
from carina.plan.targets.edits import BRUSHED
from carina.plan.turns.fork_view import HourDoubt
from carina.server.to_wire.plan import _route
from carina.track import assess_ct, measure_tree
from carina.volume import Note, Volume

SAFETY = (
    "Not a medical device.",
    "CT taken at inspiration: in the procedure the target may lie up to 15 mm from where it is shown here.",
)


def page(tmp_path: Path, **more) -> str:
    return write_report(tmp_path / "plan.html", sheet(**more)).read_text()


def words_of(block: Block) -> Iterator[str]:
    """Yield the texts of a block of the report, including the texts in its drawings."""
    match block:
        case Words(text=text):
            yield text
        case Bullets(items=items):
            yield from items
        case Facts(rows=rows):
            yield from (cell for row in rows for cell in row)
        case ReportTable(head=head, rows=rows):
            yield from (cell for row in (head, *rows) for cell in row)
        case Figure(drawing=drawing, caption=caption):
            yield from (caption, *(one.text for one in drawing.shapes if isinstance(one, Label)))
        case Figures(items=items):
            for item in items:
                yield from words_of(item)


def everything() -> list[str]:
    return [text for part in sections(sheet()) for block in part.blocks for text in words_of(block) if text]


def test_json_report_contains_the_plan_and_the_case_data_of_the_report(tmp_path) -> None:
    document = json.loads(write_report(tmp_path / "plan.json", sheet()).read_text())
    own = document.pop("report")
    made = plan().to_json() | {
        "verdicts": [one.to_json() for one in verdicts()],
        "turns": turns(airways(), plan()).to_json(),
        # A CT with voxels of 1.1 mm has no thick slices, so there are no calibrated shares.
        "calibrated_shares": None,
        "assessment": assess_ct(volume(), airways()).to_json(),
        "c_arm": None,
        "ebus": {
            "stations": [one.to_json() for one in route_stations(airways().tree, plan(), plan().routes[0])],
            "note": STATION_NOTE,
        },
    }
    assert document == json.loads(json.dumps(made, allow_nan=False))
    assert own["route"] == 1 and own["patient"] is None
    assert own["provenance"]["made_on"] == "2026-11-25" and own["provenance"]["spacing_mm"] == pytest.approx([1.1] * 3)
    assert own["place"]["lobe"] == "RML"


def test_all_outputs_state_the_same_narrowest_diameter_of_a_route() -> None:
    route = plan().routes[0]
    branches = [branch.id for branch in airways().tree.lineage(route.branch_id)]
    inside = route.along_mm - sum(airways().tree.branch(n).length_mm for n in branches[:-1])
    measures = measure_tree(volume(), airways())
    measured = measures.narrowest_of_route(branches, until_mm=inside)
    assert route.width.source == "sections"
    assert (route.width.mm, route.width.error_mm) == pytest.approx((measured.mm, measured.error_mm))
    diameter_text = f"{route.width.mm:.1f} \u00b1 {route.width.error_mm:.1f} mm"
    stored = plan().to_json()["routes"][0]
    assert (stored["narrowest_mm"], stored["narrowest_error_mm"]) == (route.width.mm, route.width.error_mm)
    assert f"narrowest {diameter_text}" in lines(plan())[1]
    assert any(diameter_text in text for text in everything())
    assert diameter_text in drawn_plans(plan(), airways().tree)[0].routes[0].words
    offer = _route(route)
    assert (offer.narrowest_mm, offer.narrowest_error_mm) == (route.width.mm, route.width.error_mm)
    for verdict in verdicts():
        check = next(one for one in verdict.checks if one.name == "diameter")
        assert diameter_text in check.words and check.share == route.width.chance(verdict.scope)
    assert (offer.fit == "fits") == stored["fits"] == (route.width.chance(plan().scope) >= 0.9)


def test_all_outputs_state_the_same_opening_of_a_turn_which_is_not_narrower_than_the_route() -> None:
    route = plan().routes[0]
    listed = turns(airways(), plan())
    table = next(part for part in sections(sheet()) if part.name == "turns").blocks
    rows = next(block for block in table if isinstance(block, ReportTable)).rows
    drawings = tracing_drawings(sheet())
    sheet_text = " ".join(one.text for drawing in drawings for one in drawing.shapes if isinstance(one, Label))
    for number, turn in enumerate(listed.turns):
        opening = turn.opening
        assert opening.width.source == "sections"
        assert opening.width.mm >= route.width.mm and opening.width.lower_mm >= route.width.lower_mm
        assert opening.fit == opening.width.fit(plan().scope)
        assert route.fit != "fits" or opening.fit == "fits"
        mm = f"{opening.width.mm:.1f} \u00b1 {opening.width.error_mm:.1f}"
        assert opening.words in turn.words("head") and mm in opening.words
        assert mm in rows[number][6] and mm in sheet_text
        stored = turn.to_json()["opening"]
        assert stored == {
            "mm": opening.width.mm,
            "error_mm": opening.width.error_mm,
            "by": "sections",
            "fit": opening.fit,
        }


def test_html_report_makes_no_request_and_its_security_policy_allows_only_its_own_content(tmp_path) -> None:
    text = page(tmp_path)
    assert "http" not in text.replace("http://www.w3.org/2000/svg", "").replace("http-equiv", "")
    assert not re.search(r"<(img|iframe|object|embed|form|base)\b", text) and " style=" not in text
    assert not re.search(r"\son[a-z]+=", text), "no handlers in attributes"
    policy = html.unescape(re.search(r'Content-Security-Policy" content="([^"]*)"', text)[1])
    assert policy.startswith("default-src 'none';") and "unsafe" not in policy
    for element, directive in (("style", "style-src"), ("script", "script-src")):
        (content,) = re.findall(rf"<{element}>(.*?)</{element}>", text, re.DOTALL)
        digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        assert f"{directive} 'sha256-{digest}'" in policy


def test_user_text_in_the_html_report_is_shown_and_never_executed(tmp_path) -> None:
    nasty = "</script><script>alert(1)</script><img src=x>"
    text = page(tmp_path, notes=(nasty,), patient=f"A & B {nasty}")
    assert text.count("alert(1)") >= 2 and "<script>alert" not in text and "<img" not in text
    assert html.escape(f"A & B {nasty}") in text
    data = re.search(r'<script type="application/json" id="tree-data">(.*?)</script>', text, re.DOTALL)[1]
    assert json.loads(data)["needle"] and "<" not in data


def test_branch_name_with_a_closing_script_tag_does_not_end_the_tree_data_of_the_report(tmp_path) -> None:
    first = sheet().shape.branches[0]
    shape = dataclasses.replace(
        sheet().shape, branches=(dataclasses.replace(first, name="</script><b>"), *sheet().shape.branches[1:])
    )
    text = write_report(tmp_path / "plan.html", dataclasses.replace(sheet(), shape=shape)).read_text()
    assert "</script><b>" not in text


def test_report_names_the_patient_only_on_request(tmp_path) -> None:
    scan = volume()
    source = dataclasses.replace(scan.source, title="DOE^JANE.nii.gz", acquired_on="2026-01-02")
    named = dataclasses.replace(scan, source=source)
    for suffix in (".html", ".json"):
        text = write_report(tmp_path / f"plan{suffix}", sheet(volume=named)).read_text()
        # The bytes of a picture may contain three letters of the name by chance.
        text = re.sub(r"base64,[A-Za-z0-9+/=]+", "", text)
        assert "DOE" not in text and "2026-01-02" not in text
    assert "Jane Doe" in page(tmp_path, patient="Jane Doe")


def test_html_report_has_all_sections_in_order_with_all_their_text(tmp_path) -> None:
    text = html.unescape(page(tmp_path))
    places = [text.index(f'<section id="{part.name}"') for part in sections(sheet())]
    assert places == sorted(places)
    names = [part.name for part in sections(sheet())]
    assert names[:4] == ["against", "target", "airways", "route"] and names[-1] == "tracing"
    assert {"turns", "instruments", "routes", "by-hand", "uncertain", "ct", "score", "figures"} <= set(names)
    assert "provenance" in names
    assert [message for message in everything() if message not in text] == []
    assert all(text.count(message) >= 2 for message in SAFETY)


def test_figures_of_the_report_are_those_of_the_plan() -> None:
    route, nodule, text = plan().routes[0], plan().nodule, "\n".join(everything())
    assert f"{nodule.volume_mm3 / 1000:.2f} \u00b1 {nodule.volume_error_mm3 / 1000:.2f} ml" in text
    assert f"{route.leg.to_target_mm:.1f} mm, of which {route.leg.outside_mm:.1f} mm outside the lumen" in text
    # The drive of this plan does not arrive, so the share of hits is not known.
    assert route.hit_share is None and "where the CT shows the target" not in text
    assert "not known without a drive" in text
    for one in verdicts():
        assert one.scope.title in text and all(check.words in text and check.basis in text for check in one.checks)
    for other in plan().routes:
        assert f"{other.score:.2f}" in text
    for turn in sheet().turns.turns:
        assert turn.moves is not None and f"advance {turn.moves[0].advance_mm:.0f} mm" in text
        assert turn.direction("head") in text and all(caution in text for caution in turn.cautions)


def test_parts_drawn_by_hand_are_red_wherever_the_report_describes_the_route(tmp_path) -> None:
    found, drawn_plan = with_drawn_branch()
    (doubt,) = drawn_plan.routes[0].doubts
    report = sheet(airways=found, plan=drawn_plan, turns=turns(found, drawn_plan))
    text = write_report(tmp_path / "plan.html", report).read_text()
    shown = re.search(r'<section id="tracing".*?</section>', text, re.DOTALL)[0]
    assert re.search(rf'fill="#c1001f"[^>]*>{re.escape(doubt[0].upper() + doubt[1:])}', shown)
    for name in ("target", "route", "turns"):
        part = re.search(rf'<section id="{name}".*?</section>', text, re.DOTALL)[0]
        assert re.search(rf'<p class="warning">[^<]*{re.escape(doubt)}', part), name
    by_hand = re.search(r'<section id="by-hand".*?</section>', text, re.DOTALL)[0]
    assert '<ul class="warning">' in by_hand and "This route leads through" in by_hand
    assert re.search(rf'<tr class="warning">.*?{re.escape(doubt)}', text)
    assert any(one.pen.line == "#c1001f" for one in _strokes(report))
    assert doubt[0].upper() + doubt[1:] + "." in report.uncertain


def test_lasting_notes_of_the_ct_are_among_the_uncertainties_of_the_report(tmp_path) -> None:
    note = Note("import.tilt-corrected", "the gantry was tilted by 12.0 degrees", badge=True)
    ct = volume()
    source = dataclasses.replace(ct.source, notes=(*ct.source.notes, note))
    noted = Volume(ct.hu_zyx, ct.lps_from_ijk, is_hu=ct.is_hu, not_hu_reason=ct.not_hu_reason, source=source)
    assert "The gantry was tilted by 12.0 degrees." in sheet(volume=noted).uncertain
    assert "The gantry was tilted" in page(tmp_path, volume=noted)


def test_lasting_notes_of_the_ct_are_reasons_against_each_plan_without_file_names() -> None:
    ct, found = volume(), airways()
    notes = (
        Note("import.tilt-corrected", "the gantry was tilted by 12.0 degrees", badge=True),
        Note("import.files-unread", "SURNAME.dcm could not be used", badge=True),
    )
    source = dataclasses.replace(ct.source, notes=(*ct.source.notes, *notes))
    noted = Volume(ct.hu_zyx, ct.lps_from_ijk, is_hu=ct.is_hu, not_hu_reason=ct.not_hu_reason, source=source)
    words = ct_notes(noted, found)
    assert "the gantry was tilted by 12.0 degrees" in words
    assert any("import.files-unread" in one for one in words) and "SURNAME" not in "".join(words)
    planned = plan_route(noted, found, plan().nodule, wall=wall(), drives=0, confirmed=True, progress=False)
    assert {(one.code, one.words) for one in reasons_against(planned)} >= {
        ("plan.note", "The gantry was tilted by 12.0 degrees.")
    }
    thick = np.diag([ct.spacing_mm[0], ct.spacing_mm[1], 3.0, 1.0])
    coarse = Volume(ct.hu_zyx, thick, is_hu=ct.is_hu, not_hu_reason=ct.not_hu_reason, source=ct.source)
    assert any(one.startswith("slices are 3.0 mm apart") for one in ct_notes(coarse, found))


def _strokes(report) -> list:
    from carina.plan.report.drawing import Stroke
    from carina.plan.report.figures import tree_drawing

    drawing = tree_drawing(report.shape, report.forks, "front", width=255.0, height=160.0)
    return [shape for shape in drawing.shapes if isinstance(shape, Stroke)]


def test_report_of_a_plan_without_a_route_states_the_reason_and_has_no_tracing_sheet(tmp_path) -> None:
    none = dataclasses.replace(
        plan(), routes=(), why="no route: the nearest airway found is RB4, 31 mm from the nodule"
    )
    report = sheet(plan=none, verdicts=())
    text = write_report(tmp_path / "plan.html", report).read_text()
    assert "No route: the nearest airway found is RB4, 31 mm from the nodule." in text
    assert 'id="tracing"' not in text and report.needle_slice is None
    assert json.loads(write_report(tmp_path / "plan.json", report).read_text())["report"]["route"] is None
    with pytest.raises(UsageError, match="no route to trace"):
        write_report(tmp_path / "sheet.html", report, kind="tracing")


def test_tracing_sheet_is_a_separate_page_without_a_script(tmp_path) -> None:
    text = write_report(tmp_path / "sheet.html", sheet(), kind="tracing").read_text()
    assert text.count("<section") == 1 and "<script" not in text and "script-src 'none'" in html.unescape(text)
    for fork in sheet().forks:
        assert f">{fork.to_name}<" in text
    assert all(message in html.unescape(text) for message in SAFETY)


@pytest.mark.parametrize(("num", "is_one"), [(5, True), (9, True), (12, True), (40, False)])
def test_tracing_sheet_omits_the_diagram_before_it_continues_on_another_page(num, is_one) -> None:
    fork = sheet().forks[0]
    many = tuple(dataclasses.replace(fork, number=n, to_name=f"branch {n:03}") for n in range(1, num + 1))
    parts = [part for part in sections(dataclasses.replace(sheet(), forks=many)) if part.name.startswith("tracing")]
    assert (len(parts) == 1) == is_one
    text = " ".join(message for part in parts for block in part.blocks for message in words_of(block))
    assert all(f"branch {n:03}" in text for n in range(1, num + 1))
    assert text.count(fork.turn.direction("head")) >= num
    assert text.count("counterclockwise") >= num, "moves of the hand"


def test_sheet_states_sums_of_moves_if_single_moves_need_more_than_a_page() -> None:
    fork = sheet().forks[0]
    moves = tuple(Move(50.0 * (-1) ** n, 15.0 + 5.0 * (n % 2), 2.0) for n in range(31))
    turn = dataclasses.replace(fork.turn, moves=moves)
    many = tuple(dataclasses.replace(fork, number=n, to_name=f"branch {n:03}", turn=turn) for n in range(1, 13))
    (part,) = (one for one in sections(dataclasses.replace(sheet(), forks=many)) if one.name.startswith("tracing"))
    text = " ".join(words for block in part.blocks for words in words_of(block))
    sums = "rotate 50\u00b0 clockwise, flex up 15\u00b0, advance 62 mm"
    assert "".join(text.split()).count("".join(sums.split())) == 12
    assert "The moves of the hand are sums" in text and "report lists every move" in text


def test_sheet_of_a_long_route_with_many_reasons_is_one_page_with_a_line_for_each_fork() -> None:
    fork = sheet().forks[0]
    turn = dataclasses.replace(fork.turn, moves=tuple(Move(50.0 * (-1) ** n, 15.0, 2.0) for n in range(31)))
    many = tuple(dataclasses.replace(fork, number=n, to_name=f"branch {n:03}", turn=turn) for n in range(1, 14))
    notes = tuple(f"note {n} about the CT, which is as long as two lines of the sheet. " * 2 for n in range(8))
    long = dataclasses.replace(sheet(), forks=many, plan=dataclasses.replace(plan(), notes=notes))
    (part,) = (one for one in sections(long) if one.name.startswith("tracing"))
    text = " ".join(words for block in part.blocks for words in words_of(block))
    assert all(f"{n}. branch {n:03}" in text and f"note {n - 1} about" in text for n in range(1, 9))
    assert text.count(fork.turn.direction("head")) >= 13
    assert "The moves of the hand are in the report." in text and "rotate" not in text


def test_tip_before_the_carina_has_no_negative_distances() -> None:
    short = dataclasses.replace(sheet().turns, park_from_carina_mm=-4.4, park_from_fork_mm=-4.4)
    (part,) = (one for one in sections(dataclasses.replace(sheet(), turns=short)) if one.name == "turns")
    (table,) = (block for block in part.blocks if isinstance(block, ReportTable))
    assert table.rows[-1][1:6] == ("stop: tip of the scope", "", "", "4 above", "4 before it")


def test_plan_without_a_route_names_neither_route_nor_leg_in_its_legends() -> None:
    report = sheet()
    none = dataclasses.replace(report, route_number=None, plan=dataclasses.replace(report.plan, routes=(), why="none"))
    for one, is_named in ((report, True), (none, False)):
        parts = [part for part in sections(one) if part.name in {"target", "airways"}]
        text = " ".join(words for part in parts for block in part.blocks for words in words_of(block))
        assert ("last leg" in text) is is_named
        assert ("the route, with its forks" in text) is is_named


def test_crossed_vessel_is_stated_as_such_and_not_as_a_distance_of_zero() -> None:
    report = sheet()
    route = report.route
    near = (NearVessel(4.0, 0.0, route.leg.tip_lps),)
    leg = dataclasses.replace(route.leg, vessel_mm=0.0, vessels=near)
    crossing = dataclasses.replace(route, leg=leg)
    changed = dataclasses.replace(
        report, plan=dataclasses.replace(report.plan, routes=(crossing, *report.plan.routes[1:]))
    )
    text = " ".join(words for part in sections(changed) for block in part.blocks for words in words_of(block))
    assert "0.0 mm from the needle" not in text and "nearest vessel 0.0" not in text
    for words in ("crosses a vessel", "crossed at 4 mm from the tip", "on the needle's line"):
        assert "".join(words.split()) in "".join(text.split())


def test_report_of_the_second_route_describes_that_route_completely() -> None:
    report = sheet(route_number=2)
    route = plan().routes[1]
    assert report.route is route and report.forks[-1].to_branch_id == route.branch_id
    assert all(fork.turn is None for fork in report.forks)
    assert "Route 2 at a glance" in [part.title for part in sections(report)]
    assert report.forks[0].carina_mm == pytest.approx(0.0, abs=0.5)


def test_forks_in_a_report_without_a_turn_list_have_the_distances_of_the_turns() -> None:
    ridge = plan().carina_ridge_mm
    assert ridge is not None and 3.0 < ridge < 20.0
    distances_mm = [fork.carina_mm for fork in sheet().forks]
    assert distances_mm[0] == 0.0 and distances_mm == [turn.from_carina_mm for turn in turns(airways(), plan()).turns]
    assert [fork.carina_mm for fork in sheet(turns=None).forks] == pytest.approx(distances_mm, abs=1e-6)


def test_report_refuses_a_turn_list_of_another_route() -> None:
    with pytest.raises(UsageError, match="the list of turns is that of another route: it turns into"):
        sheet(route_number=2, turns=sheet().turns)


DOUBT = HourDoubt("turns.neighbour", "no clock hour: RB9 opens in nearly the same direction; compare the picture")


@pytest.mark.parametrize(
    ("changes", "cell", "text", "mark"),
    [
        ({"straight_ahead": True, "hour_doubt": None}, "ahead", "straight ahead", None),
        ({"straight_ahead": False, "hour_doubt": DOUBT}, "not given", "no clock hour", "?"),
    ],
)
def test_opening_without_an_hour_is_reported_in_table_and_tracing_sheet(
    changes: dict[str, Any], cell: str, text: str, mark: str | None
) -> None:
    listed = sheet().turns
    changed_turn = dataclasses.replace(listed.turns[1], clock_head=None, clock_facing=None, sides=(), **changes)
    changed = sheet(turns=dataclasses.replace(listed, turns=(listed.turns[0], changed_turn, *listed.turns[2:])))
    grid = next(
        b for part in sections(changed) for b in part.blocks if part.name == "turns" and isinstance(b, ReportTable)
    )
    assert grid.rows[1][2:4] == (cell, cell)
    (figure,) = [
        b for part in sections(changed) for b in part.blocks if part.name == "tracing" and isinstance(b, Figure)
    ]
    drawn = list(words_of(figure))
    assert text in drawn and (mark is None or mark in drawn)
    if changed_turn.hour_doubt is not None:
        assert changed_turn.hour_doubt.words in grid.rows[1][1] and 1 in grid.warned
        assert changed_turn.hour_doubt.words in changed.forks[1].warnings


def test_clock_hours_in_the_report_depend_on_the_position_of_the_operator(tmp_path) -> None:
    report = sheet(turns=sheet().turns, operator="facing")
    grid = next(
        b for part in sections(report) for b in part.blocks if part.name == "turns" and isinstance(b, ReportTable)
    )
    assert grid.head[2:4] == ("Facing", "Head")
    for row, turn in zip(grid.rows, report.turns.turns, strict=False):
        expected = "ahead" if turn.straight_ahead else "not given" if turn.hour_doubt else str(turn.hour("facing"))
        assert row[2] == expected
    assert "operator facing the patient: posterior at 12" in write_report(tmp_path / "p.html", report).read_text()


def test_pictures_of_turns_are_beside_their_turns_in_the_report(tmp_path) -> None:
    listed = turns(airways(), plan())
    pictures = [still(turn, in_view=n != 1, shade=n) for n, turn in enumerate(listed.turns)]
    text = page(tmp_path, turns=listed, turn_pictures=pictures)
    part = re.search(r'<section id="turns".*?</section>', text, re.DOTALL)[0]
    data = [base64.b64decode(found) for found in re.findall(r"data:image/png;base64,([^\"]+)", part)]
    assert data == [one.png() for one in pictures]
    assert part.count('viewBox="0 0 12 8"') == len(pictures)
    assert f"2. {listed.turns[1].to_branch}" in part and part.count("not in view from here</figcaption>") == 1
    with pytest.raises(UsageError, match=f"a picture for each of {len(pictures)} turns, in their order; found 1"):
        sheet(turns=listed, turn_pictures=pictures[:1])
    with pytest.raises(UsageError, match="in their order"):
        sheet(turns=listed, turn_pictures=pictures[::-1])
    with pytest.raises(UsageError, match="for an operator at 'facing', the report for one at 'head'"):
        sheet(turns=listed, turn_pictures=[still(turn, operator="facing") for turn in listed.turns])


def test_clips_of_turns_are_hidden_beside_their_pictures_and_not_printed(tmp_path) -> None:
    listed = turns(airways(), plan())
    pictures = [still(turn) for turn in listed.turns]
    clips = [None if n == 1 else clip(turn) for n, turn in enumerate(listed.turns)]
    plain = sheet(turns=listed, turn_pictures=pictures)
    filmed = sheet(turns=listed, turn_pictures=pictures, turn_clips=clips)
    text = write_report(tmp_path / "plan.html", filmed).read_text()
    figures = re.findall(r"<figure>.*?</figure>", re.search(r'<section id="turns".*?</section>', text, re.DOTALL)[0])
    assert ["data:image/jpeg" in one for one in figures] == [one is not None for one in clips]
    (strip,) = re.findall(r"data:image/jpeg;base64,([^\"]+)", figures[0])
    assert base64.b64decode(strip) == clips[0].strip()
    assert 'class="clip on-screen" data-seconds="1.50" hidden' in figures[0] and 'max="3" value="3"' in figures[0]
    # The page's policy allows the clip player by its digest; a page without clips has no player.
    policy = html.unescape(re.search(r'Content-Security-Policy" content="([^"]*)"', text)[1])
    scripts = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    digests = [base64.b64encode(hashlib.sha256(one.encode()).digest()).decode() for one in scripts]
    assert len(scripts) == 2 and all(f"'sha256-{digest}'" in policy for digest in digests)
    assert write_report(tmp_path / "plain.html", plain).read_text().count("<script>") == 1
    for suffix in (".pdf", ".json"):
        one, other = (write_report(tmp_path / f"{n}{suffix}", it) for n, it in enumerate((plain, filmed)))
        assert one.read_bytes() == other.read_bytes()
    for wrong in (clips[:1], clips[::-1], [clip(turn, operator="facing") for turn in listed.turns]):
        with pytest.raises(UsageError, match=f"a clip, or None, for each of {len(clips)} pictures"):
            sheet(turns=listed, turn_pictures=pictures, turn_clips=wrong)
    with pytest.raises(UsageError, match="each of 0 pictures"):
        sheet(turns=listed, turn_clips=clips)


def test_slices_of_a_bronchus_sign_have_its_position_in_the_middle(tmp_path) -> None:
    place = plan().routes[0].leg.tip_lps
    signed = dataclasses.replace(plan(), bronchus_sign="into", sign_branch="RB4a", sign_lps=place)
    report = sheet(plan=signed)
    assert [one.title for one in report.sign_slices] == ["Axial", "Coronal", "Sagittal"]
    assert all(one.cross == pytest.approx((one.width_px / 2, one.height_px / 2)) for one in report.sign_slices)
    text = write_report(tmp_path / "plan.html", report).read_text()
    assert "Bronchus sign: an airway leads into the target (RB4a)." in text


def test_report_states_the_route_score_with_the_weights_of_the_plan() -> None:
    weighed = dataclasses.replace(plan(), weights=ScoreWeights(misses=0.0, way=0.0, angle=1.0, narrow=1.0))
    (part,) = [part for part in sections(sheet(plan=weighed)) if part.name == "score"]
    (grid,) = [block for block in part.blocks if isinstance(block, ReportTable)]
    shares = {row[0]: row[2] for row in grid.rows}
    assert shares["needle passes that miss"] == "0 %" and shares["narrowest place"] == f"{100 / 2.25:.0f} %"


def test_report_states_that_a_boundary_was_drawn_by_hand() -> None:
    drawn = dataclasses.replace(plan().nodule, notes=(BRUSHED, "with a cavity of 0.2 ml"))
    report = sheet(plan=dataclasses.replace(plan(), nodule=drawn))
    assert report.by_hand[0] == "Target: boundary edited by hand."
    assert "Target: with a cavity of 0.2 ml." in report.uncertain
    assert "Target: with a cavity of 0.2 ml." not in report.by_hand


def test_obstacles_on_a_route_are_red_in_the_report(tmp_path) -> None:
    route = plan().routes[0]
    leg = dataclasses.replace(route.leg, mediastinum_mm=6.0, vessels=(NearVessel(9.0, 0.4, route.leg.aim_lps),))
    limited = dataclasses.replace(route, limits=("the bend asks 190 degrees", "too narrow"), leg=leg)
    report = sheet(plan=dataclasses.replace(plan(), routes=(limited, *plan().routes[1:])))
    text = write_report(tmp_path / "p.html", report).read_text()
    part = re.search(r'<section id="route".*?</section>', text, re.DOTALL)[0]
    assert '<p class="warning">The bend asks 190 degrees.</p><p class="warning">Too narrow.</p>' in part
    assert re.search(r'<p class="warning">The needle crosses 6 mm of mediastinum or chest wall', part)
    assert "0.4 mm off at 9 mm from the tip" in part


@pytest.mark.parametrize(("change", "text"), [({"route_number": 9}, "expected 1 to"), ({"route_number": 0}, "found 0")])
def test_report_with_an_invalid_route_number_or_option_is_refused(change, text) -> None:
    with pytest.raises(UsageError, match=text):
        sheet(**change)


@pytest.mark.parametrize(
    ("name", "choice", "text"),
    [
        ("plan.docx", {}, r"found \.docx"),
        ("plan", {}, "found no suffix"),
        ("plan.html", {"kind": "poster"}, "expected report or tracing; found 'poster'"),
        ("plan.pdf", {"paper": "A5"}, "expected A4 or Letter; found 'A5'"),
    ],
)
def test_report_file_of_an_unknown_kind_is_refused_with_a_message(tmp_path, name, choice, text) -> None:
    with pytest.raises(UsageError, match=text):
        write_report(tmp_path / name, sheet(), **choice)
    assert list(tmp_path.iterdir()) == []


def test_cancelled_writing_of_a_report_leaves_no_file(tmp_path) -> None:
    shares: list[float] = []
    with pytest.raises(CancelledError):
        make_sheet(
            volume(),
            airways(),
            plan(),
            wall=wall(),
            progress=lambda _what, share: shares.append(share),
            cancel=lambda: len(shares) > 2,
        )
    assert shares == sorted(shares)
    with pytest.raises(CancelledError):
        write_report(tmp_path / "plan.html", sheet(), cancel=lambda: True)
    assert list(tmp_path.iterdir()) == []


def test_pdf_without_its_library_is_refused_with_a_remedy(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(CarinaError, match=r"'reportlab>=") as caught:
        write_report(tmp_path / "plan.pdf", sheet())
    assert caught.value.exit_code == 1 and list(tmp_path.iterdir()) == []


def test_report_of_one_plan_written_twice_is_byte_for_byte_equal(tmp_path) -> None:
    first = page(tmp_path)
    assert write_report(tmp_path / "again.html", sheet()).read_text() == first


def test_target_as_dense_as_contrast_medium_is_reported_in_red(tmp_path) -> None:
    doubt = TargetDoubt("target.density", "at 189 HU it is denser than soft tissue")
    dense = dataclasses.replace(plan(), doubts=(doubt,))
    part = write_report(tmp_path / "p.html", sheet(plan=dense)).read_text()
    assert re.search(r'<section id="target".*?<p class="warning">[^<]*at 189 HU it is denser than soft tissue', part)
    assert "denser than soft tissue" not in page(tmp_path)


def test_tracing_sheet_refers_to_the_report_for_notes_that_do_not_fit() -> None:
    report = sheet(notes=tuple(f"Note number {n}" for n in range(12)))
    texts = {part.name: [w for b in part.blocks for w in words_of(b)] for part in sections(report)}
    assert sum(text.startswith("Note number") for text in texts["tracing"]) == 6
    assert "\u2026 all notes are in the report" in texts["tracing"]
    assert sum(text.startswith("Note number") for text in texts["notes"]) == 12


@pytest.mark.parametrize(
    ("outcomes", "message"),
    [
        (("does not reach",) * 3, "Of 3 instruments none reaches on this route."),
        (("does not reach", "cannot say", "cannot say"), "none is known to reach on this route; 2 cannot be judged."),
        (
            ("may reach", "reaches", "cannot say"),
            "1 reaches, 1 may reach, 1 cannot be judged. First of them: Ultrathin",
        ),
    ],
)
def test_first_sentence_of_the_report_summarises_the_verdicts_of_all_instruments(outcomes, message) -> None:
    changed = tuple(
        dataclasses.replace(one, outcome=outcome) for one, outcome in zip(verdicts(), outcomes, strict=True)
    )
    (_, target, *_) = sections(dataclasses.replace(sheet(), verdicts=changed))
    (lead,) = [block.text for block in target.blocks if isinstance(block, Words) and block.tone == "lead"]
    assert message in lead


@pytest.mark.parametrize(("tissue", "before"), [("vessel", True), ("fissure", True), ("vessel", False)])
def test_report_warns_of_vessel_or_fissure_on_the_needle_path_up_to_the_far_edge_of_the_target(tissue, before) -> None:
    route = plan().routes[0]
    way = [("lumen", 3.0), ("lung", 2.0), (tissue if before else "lung", 1.0), ("target", 9.0), (tissue, 2.0)]
    ends = np.cumsum([length for _, length in way])
    crossed = tuple(CrossedTissue(t, float(end - length), length) for (t, length), end in zip(way, ends, strict=True))
    changed = dataclasses.replace(route, leg=dataclasses.replace(route.leg, crossed=crossed))
    report = dataclasses.replace(sheet(), plan=dataclasses.replace(plan(), routes=(changed, *plan().routes[1:])))
    (part,) = [part for part in sections(report) if part.name == "route"]
    warnings = [block.text for block in part.blocks if isinstance(block, Words) and block.tone == "warning"]
    assert (f"The needle's way crosses a {tissue} 5 mm from the scope's tip." in warnings) == before
    assert sum("crosses a" in text for text in warnings) == before
