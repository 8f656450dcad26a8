"""Tests of answers to the cursor (live path, measures along a branch), and of edits converted from the wire."""

from __future__ import annotations

import queue
import threading
from types import SimpleNamespace
from typing import get_args, get_type_hints

import numpy as np
import pytest

from carina.commands import OpenPath
from carina.server.windows.latest_only import LatestTaskRunner
from carina.server.windows.pointing import Pointing, live_path_message
from carina.server.windows.prefetch import PathPrefetcher
from carina.server.wire import messages as wire
from carina.session.view.questions import lumen_before_wall
from carina.track import AddBranch, CutBranch, MoveFork, PaintLumen, RenameBranch, TreeEdit
from small_case import session_fixture, small_lps

WAIT_S = 120.0


@pytest.fixture
def pointing():
    """Return a session with airways, a picture of number 5, and the received answers."""
    fixture = session_fixture()
    fixture.open()
    picture = SimpleNamespace(hit=None, picked=[])

    def wall_at(column, row):
        picture.picked.append((column, row))
        return picture.hit

    shown = SimpleNamespace(wall_at=wall_at, lens_lps=small_lps((16.0, 14.0, 34.0)))
    answers = queue.Queue()
    made = Pointing(fixture.session, {5: shown}.get, answers.put)
    made.start()
    yield SimpleNamespace(pointing=made, session=fixture.session, picture=picture, answers=answers, fixture=fixture)
    made.stop()


def ask(pointing, request_id, **place):
    fields = {"lps": None, "frame_id": None, "column": None, "row": None} | place
    pointing.pointing.request_live_path(wire.AskLivePath(request_id, **fields))
    return pointing.answers.get(timeout=WAIT_S)


def test_path_to_the_point_under_the_cursor_is_sent_as_answer(pointing):
    point = small_lps((8.5, 13.0, 14.5))
    answer = ask(pointing, 3, lps=point)
    assert (answer.request_id, answer.lps, answer.problem) == (3, point, None)
    assert answer.joins_branch_id == 1
    assert answer.confidence == 0.75
    assert answer.points_lps[0] == pytest.approx(small_lps((16.0, 14.0, 37.0)), abs=0.01)
    assert answer.points_lps[-1] == pytest.approx(small_lps((8.0, 13.0, 14.0)), abs=0.01)
    wire.parse_server_message(wire.encode_message(answer))


def test_cursor_point_without_a_path_is_answered_with_the_reason_and_no_error(pointing):
    answer = ask(pointing, 4, lps=small_lps((2.0, 2.0, 30.0)))
    assert answer.points_lps == ()
    assert "mm away" in answer.problem
    wire.parse_server_message(wire.encode_message(answer))


def test_pixel_in_the_airway_picture_selects_the_lumen_in_front_of_the_wall_for_a_path(pointing):
    wall = np.array(small_lps((18.6, 14.0, 30.0)))
    pointing.picture.hit = SimpleNamespace(position_lps=wall)
    answer = ask(pointing, 5, frame_id=5, column=12.0, row=7.5)
    assert pointing.picture.picked == [(12.0, 7.5)]
    lens = np.array(small_lps((16.0, 14.0, 34.0)))
    back = np.linalg.norm(np.array(answer.lps) - wall)
    assert 0.5 < back < np.linalg.norm(lens - wall)
    # The point is on the ray and inside the lumen, which is 3 mm around the centreline in this case.
    assert np.cross(np.array(answer.lps) - wall, lens - wall) == pytest.approx(np.zeros(3), abs=1e-9)
    assert pointing.session.snapshot().document.airways.tree.nearest_branch(answer.lps)[2] <= 3.0
    assert answer.problem is None


@pytest.mark.parametrize(
    ("place", "text"),
    [
        ({"frame_id": 99, "column": 1.0, "row": 1.0}, "view has changed"),
        ({"frame_id": 5, "column": 1.0, "row": 1.0}, "no airway wall"),
    ],
)
def test_pixel_without_a_visible_wall_is_answered_with_the_reason(pointing, place, text):
    answer = ask(pointing, 6, **place)
    assert answer.lps is None
    assert text in answer.problem


def test_live_path_request_without_airways_is_answered_with_the_step_still_needed():
    fixture = session_fixture()
    answers = queue.Queue()
    made = Pointing(fixture.session, lambda _frame: None, answers.put)
    made.start()
    made.request_live_path(wire.AskLivePath(1, (0.0, 0.0, 0.0), None, None, None))
    assert answers.get(timeout=WAIT_S).problem == "no case is open"
    fixture.session.do(OpenPath("case"))
    fixture.background.run_next()
    made.request_live_path(wire.AskLivePath(2, (0.0, 0.0, 0.0), None, None, None))
    assert "not been segmented yet" in answers.get(timeout=WAIT_S).problem
    made.stop()


def test_internal_error_in_a_live_path_is_reported_and_the_next_request_is_answered(pointing, monkeypatch):
    monkeypatch.setattr(pointing.session, "ask", lambda _question: 1 / 0)
    assert "internal error in Carina (ZeroDivisionError)" in ask(pointing, 1, lps=(0.0, 0.0, 0.0)).problem
    monkeypatch.undo()
    assert ask(pointing, 2, lps=small_lps((16.0, 14.0, 30.0))).problem is None


def test_live_paths_are_prefetched_before_the_first_request(pointing, monkeypatch):
    calls = queue.Queue()
    monkeypatch.setattr(pointing.session, "ask", calls.put)
    warming = PathPrefetcher(pointing.session)
    warming.start()
    warming.airways_changed()
    assert calls.get(timeout=WAIT_S).lps == pytest.approx(small_lps((16.0, 14.0, 37.0)))
    # For the same airways the preparation does not run again, and it sends no answer.
    warming.airways_changed()
    warming.stop()
    assert calls.empty()


def test_detail_of_an_unmeasured_or_removed_branch_has_no_measurements(pointing):
    for branch_id in (1, 77):
        pointing.pointing.request_branch_detail(wire.AskBranchDetail(9, branch_id))
        answer = pointing.answers.get(timeout=WAIT_S)
        assert (answer.request_id, answer.branch_id) == (9, branch_id)
        assert (answer.measures, answer.profile) == (None, None)


def test_task_runner_runs_only_the_newest_task_of_each_kind_and_alternates_kinds():
    newest = LatestTaskRunner("test")
    done, gate, last = [], threading.Event(), threading.Event()
    newest.start()
    newest.submit("a", lambda: gate.wait(WAIT_S))
    for n in range(5):
        newest.submit("a", lambda n=n: done.append(("a", n)))
        newest.submit("b", lambda n=n: (done.append(("b", n)), last.set()))
    gate.set()
    assert last.wait(WAIT_S)
    newest.stop()
    # The first task is also dropped if it had not begun when the second came.
    assert done == [("a", 4), ("b", 4)]


def test_long_paths_are_sent_with_fewer_points_and_both_ends():
    along = np.arange(0.0, 300.0, 0.1)
    points = np.column_stack([np.sin(along / 30) * 10, along, -along])
    path = SimpleNamespace(
        points_lps=points,
        length_mm=424.0,
        min_radius_mm=1.25,
        confidence=1.0000001,
        snapped_mm=float("nan"),
        new_mm=None,
        joins_branch_id=None,
        problem=None,
    )
    message = live_path_message(1, (0.0, 0.0, 0.0), path)
    sent = np.array(message.points_lps)
    assert 300 < len(sent) < 600
    np.testing.assert_allclose(sent[[0, -1]], points[[0, -1]], atol=0.01)
    assert np.linalg.norm(np.diff(sent, axis=0), axis=1).max() < 1.0
    assert (message.min_diameter_mm, message.confidence, message.snapped_mm) == (2.5, 1.0, None)


@pytest.mark.parametrize("end", ["lens in the wall", "all outside"])
def test_lumen_point_in_front_of_a_wall_is_on_the_viewing_ray_also_at_its_ends(end):
    wall, lens = np.array([1.0, 2.0, 3.0]), np.array([1.0, 2.0, 13.0])
    if end == "all outside":
        tracker = SimpleNamespace(inside=lambda points: np.zeros(len(points), dtype=bool))
        np.testing.assert_array_equal(lumen_before_wall(tracker, wall, lens, 0.5), wall)
    else:
        np.testing.assert_array_equal(lumen_before_wall(None, wall, wall + 0.1, 0.5), wall + 0.1)


def test_lumen_point_in_front_of_a_wall_is_two_steps_from_it_if_the_lumen_is_wide_enough():
    wall, lens = np.zeros(3), np.array([0.0, 0.0, 10.0])
    wide = SimpleNamespace(inside=lambda points: np.asarray(points)[:, 2] > 0.9)
    assert lumen_before_wall(wide, wall, lens, 0.5)[2] == 2.0
    narrow = SimpleNamespace(inside=lambda points: np.abs(np.asarray(points)[:, 2] - 3.0) < 0.4)
    assert lumen_before_wall(narrow, wall, lens, 0.5)[2] == 3.0


@pytest.mark.parametrize(
    "edit",
    [
        AddBranch((1.0, 2.0, 3.0)),
        CutBranch(4, 2.5),
        MoveFork(4, (1.0, 2.0, 3.0)),
        RenameBranch(4, None),
        PaintLumen(((1.0, 2.0, 3.0),), 1.5, "axial", erase=True),
    ],
)
def test_edit_read_from_the_wire_equals_the_sent_edit(edit):
    assert wire.parse_client_message(wire.encode_message(wire.EditTree(edit))).edit == edit


def test_every_kind_of_edit_has_a_wire_message():
    assert set(get_args(get_type_hints(wire.EditTree)["edit"])) == set(get_args(TreeEdit))
