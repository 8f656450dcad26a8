"""Tests of edit previews over the wire: they equal the result of a click, and missing evidence needs a confirmation."""

from __future__ import annotations

import queue
from types import SimpleNamespace

import numpy as np
import pytest
from edit_case import edit_case, in_plain_lung, open_ended_airways, open_ended_volume

from carina.commands import EditTree
from carina.server.to_wire.tree import tree_message
from carina.server.windows.pointing import Pointing, no_evidence_message
from carina.server.wire import messages as wire
from carina.session import EvidenceMissing
from carina.track import edit_airways
from small_case import session_fixture

WAIT_S = 120.0


@pytest.fixture
def pointing():
    """Return a session with real airways and real edits, the wall points of picture 5, and the received answers."""
    case = edit_case()
    fixture = session_fixture(
        open_volume=lambda _path, _progress, _cancel: open_ended_volume(),
        find_airways=lambda _volume, **_options: open_ended_airways(),
        edit_airways=edit_airways,
    )
    fixture.open()
    picture = SimpleNamespace(hit=None)
    shown = SimpleNamespace(
        wall_at=lambda _column, _row: picture.hit,
        lens_lps=tuple(float(v) for v in np.array(case.tips[0]) + np.array([0.0, 0.0, 8.0])),
    )
    answers = queue.Queue()
    made = Pointing(fixture.session, {5: shown}.get, answers.put)
    made.start()
    yield SimpleNamespace(pointing=made, session=fixture.session, picture=picture, answers=answers, fixture=fixture)
    made.stop()


def ask(pointing, request_id, tool="add-branch", **place):
    fields = {
        "branch_id": None,
        "with_names": False,
        "lps": None,
        "frame_id": None,
        "column": None,
        "row": None,
    } | place
    pointing.pointing.request_edit_preview(wire.AskEditPreview(request_id=request_id, tool=tool, **fields))
    answer = pointing.answers.get(timeout=WAIT_S)
    return wire.parse_server_message(wire.encode_message(answer))


def edit(pointing, message):
    text = wire.encode_message(wire.EditTree(message))
    pointing.session.do(EditTree(wire.parse_client_message(text).edit))
    pointing.fixture.background.run_all()


def test_points_of_a_preview_equal_those_of_the_added_branch(pointing):
    lps = in_plain_lung()
    preview = ask(pointing, 3, lps=lps)
    assert (preview.request_id, preview.lps, preview.problem) == (3, lps, None)
    assert not preview.has_evidence
    (line,) = preview.lines
    assert len(line.doubtful) == len(line.points_lps) - 1

    edit(pointing, wire.AddBranch(lps))
    (requested,) = pointing.fixture.of_type(EvidenceMissing)
    question = wire.parse_server_message(wire.encode_message(no_evidence_message(requested)))
    assert (question.code, question.lps) == ("track.no-evidence", lps)
    assert question.line == line
    assert question.doubtful_mm == preview.doubtful_mm > 2.0
    assert question.length_mm == preview.length_mm

    edit(pointing, wire.AddBranch(question.lps, even_without_evidence=True))
    airways = pointing.session.snapshot().document.airways
    tree = wire.parse_server_message(wire.encode_message(tree_message(airways))).tree
    drawn = [branch for branch in tree.branches if branch.kind == "manual"]
    assert sum(branch.doubtful_mm for branch in drawn) == pytest.approx(question.doubtful_mm, abs=0.01)
    # Every point of the preview is bit for bit a point of the tree, in the same order up to the clicked end.
    points = {point for branch in tree.branches for point in branch.points}
    assert set(line.points_lps) <= points
    assert drawn[-1].points == line.points_lps[-len(drawn[-1].points) :]


def test_preview_of_a_bridge_and_of_a_fork_equals_the_edit(pointing):
    hidden = tuple(float(v) for v in edit_case().hidden)
    bridge = ask(pointing, 1, "bridge", lps=hidden)
    assert any(all(line.doubtful) for line in bridge.lines)
    edit(pointing, wire.Bridge(hidden))
    made = next(b for b in pointing.session.snapshot().document.airways.tree.branches if b.kind == "bridge")
    assert tuple(map(tuple, made.points.tolist())) in {line.points_lps for line in bridge.lines}

    branch = next(b for b in pointing.session.snapshot().document.airways.tree.branches if b.parent and b.children)
    place = tuple(float(v) for v in branch.points[-1] + 0.3)
    fork = ask(pointing, 2, "move-fork", branch_id=branch.id, lps=place)
    edit(pointing, wire.MoveFork(branch.id, place))
    tree = pointing.session.snapshot().document.airways.tree
    assert {point for line in fork.lines for point in line.points_lps} <= {
        tuple(point) for branch in tree.branches for point in branch.points.tolist()
    }


def test_preview_lists_the_renamed_branches_only_if_they_are_requested(pointing):
    tree = pointing.session.snapshot().document.airways.tree
    wide = max((branch for branch in tree.branches if branch.children), key=lambda branch: branch.length_mm)
    lps = tuple(float(v) for v in wide.points[len(wide.points) // 2])
    assert ask(pointing, 1, lps=in_plain_lung()).renamed is None
    named = ask(pointing, 2, lps=in_plain_lung(), with_names=True)
    assert named.problem is None
    assert named.renamed == (), "a branch drawn without evidence renames no other branch"
    moved = ask(pointing, 3, "move-fork", branch_id=wide.id, lps=lps, with_names=True)
    assert moved.problem is not None or moved.renamed is not None


def test_pixel_in_the_airway_picture_selects_the_lumen_in_front_of_the_wall_for_an_edit(pointing):
    wall = np.array(in_plain_lung())
    pointing.picture.hit = SimpleNamespace(position_lps=wall)
    preview = ask(pointing, 5, frame_id=5, column=12.0, row=7.5)
    assert preview.lps is not None
    again = ask(pointing, 6, lps=preview.lps)
    # A click sends the point in LPS that the preview returned for the pixel; both give the same edit.
    assert (again.lines, again.problem) == (preview.lines, preview.problem)


@pytest.mark.parametrize(
    ("place", "text"),
    [
        ({"frame_id": 99, "column": 1.0, "row": 1.0}, "view has changed"),
        ({"frame_id": 5, "column": 1.0, "row": 1.0}, "no airway wall"),
        ({"lps": (0.0, 0.0, 9000.0)}, "outside the scan"),
    ],
)
def test_pixel_or_point_without_a_possible_edit_is_answered_with_the_reason(pointing, place, text):
    preview = ask(pointing, 6, **place)
    assert text in preview.problem
    assert (preview.lines, preview.length_mm, preview.has_evidence) == ((), None, False)


def test_internal_error_in_an_edit_preview_is_reported_and_the_next_preview_is_answered(pointing, monkeypatch):
    monkeypatch.setattr(pointing.session, "ask", lambda _question: 1 / 0)
    assert "internal error in Carina (ZeroDivisionError)" in ask(pointing, 1, lps=(0.0, 0.0, 0.0)).problem
    monkeypatch.undo()
    assert ask(pointing, 2, lps=in_plain_lung()).problem is None
