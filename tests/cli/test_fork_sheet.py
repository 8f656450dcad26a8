"""Tests of the contact sheet of a route's forks: the window and the command write the same picture."""

from __future__ import annotations

import asyncio
import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from carina import commands as c
from carina.errors import CancelledError, NoResultError
from carina.plan import TurnPicture
from carina.plan.turns.contact_sheet import GAP_PX, contact_sheet
from carina.server.files.fork_sheets import fork_sheet_answer
from carina.session.flights.film_flights import flight_captions
from carina.session.flights.fork_sheet import fork_sheet_png


def test_contact_sheet_of_the_window_equals_the_file_of_carina_render(carina, window_case, tmp_path):
    output = tmp_path / "forks.png"
    ended = carina("render", window_case.path, "--view", "forks", "--to", window_case.to, "-o", output)
    assert ended.code == 0, ended.err
    answer = asyncio.run(fork_sheet_answer(window_case.session))
    assert answer.headers["content-disposition"] == 'attachment; filename="forks.png"'
    assert answer.body == output.read_bytes()


def test_route_without_a_fork_has_no_contact_sheet(window_case):
    state = window_case.session.ask(c.PictureFacts())
    short = SimpleNamespace(spans=state.route.spans, forks_mm=())
    with pytest.raises(NoResultError, match="passes no fork"):
        fork_sheet_png(state.volume, state.airways, short, cost="lumen")


@pytest.fixture
def searched_by_walls(window_case, tmp_path):
    """Return a case file whose chosen route was searched with the cost walls, and which the session also shows."""
    case = window_case.opened
    state = window_case.session.ask(c.PictureFacts())
    airways, route = state.airways, state.route
    end = tuple(float(v) for v in route.points_lps[len(route.points_lps) // 2])
    root = tuple(float(v) for v in airways.tree.root.points[0])
    try:
        case.do(c.AddTarget(end, cost="walls", root_lps=root))
        yield case.save(tmp_path / "walls"), case.state.document
    finally:
        case.undo()
        # The other tests compare the session with its file.
        case.do(c.GoTo(path_mm=30.0))


def test_path_by_walls_has_no_contact_sheet_and_no_turns_in_its_captions(
    carina, window_case, searched_by_walls, tmp_path
):
    path, document = searched_by_walls
    assert document.cost_of(document.route) == "walls"
    assert document.cost_of(dataclasses.replace(document.route, target_id=None)) == "lumen"
    with pytest.raises(NoResultError, match="not searched in the airways"):
        asyncio.run(fork_sheet_answer(window_case.session))
    film = window_case.session.ask(c.FlightToFilm("route", rate_hz=1.0, speed_mm_s=200.0))
    assert film.caption_route.cost == "walls"
    captions = flight_captions(film.volume, film.airways, film.caption_route, None)
    frames = film.frames(lambda *_: None, lambda _note: None)
    assert all(len(captions.lines(frame, 0.0)) == 1 for frame in frames)
    given = ("--to", document.targets[0].name, "--ct", window_case.path.parent / "ct.nii.gz")
    refused = carina("render", path, "--view", "forks", *given, "-o", tmp_path / "forks.png")
    assert refused.code == 4
    assert "not searched in the airways" in refused.err
    assert not (tmp_path / "forks.png").exists()


def test_cancelled_contact_sheet_stops(window_case):
    state = window_case.session.ask(c.PictureFacts())
    with pytest.raises(CancelledError):
        fork_sheet_png(state.volume, state.airways, state.route, cost="lumen", cancel=lambda: True)


def test_command_refuses_options_that_the_sheet_does_not_use(carina, window_case, tmp_path):
    given = ("render", window_case.path, "--view", "forks", "-o", tmp_path / "a.png")
    assert "--to" in carina(*given).err
    refused = carina(*given, "--to", window_case.to, "--window", "400,40")
    assert refused.code == 2
    assert "--window" in refused.err
    assert not (tmp_path / "a.png").exists()


def sheet_of(num, *, doubts=()):
    """Return the contact sheet of pictures of one colour each."""
    pictures = []
    for n in range(num):
        turn = SimpleNamespace(
            from_branch="Trachea", to_branch=f"RB{n}", from_carina_mm=10.0 * n, from_fork_mm=5.0, cautions=doubts,
            direction=lambda _operator: "3 o\u2019clock",
        )  # fmt: skip
        picture = SimpleNamespace(rgb=np.full((200, 200, 3), 40 + 10 * n, dtype=np.uint8))
        pictures.append(TurnPicture(turn, "head", picture, True, np.zeros((200, 200), dtype=bool)))
    return contact_sheet(pictures, title="All forks on the route to RB9", notes=("a note",))


@pytest.mark.parametrize("num", [1, 2, 5, 9])
def test_sheet_contains_every_picture_once_beside_the_others(num):
    sheet = sheet_of(num)
    places = [np.argwhere((sheet == 40 + 10 * n).all(axis=2)) for n in range(num)]
    boxes = [(*found.min(axis=0), *found.max(axis=0)) for found in places]
    for n, (top, left, bottom, right) in enumerate(boxes):
        assert (bottom - top, right - left) == (199, 199)
        assert len(places[n]) == 200 * 200
    # The pictures are in reading order.
    assert boxes == sorted(boxes)
    assert min(left for _, left, _, _ in boxes) == GAP_PX


def test_doubts_of_a_turn_are_written_below_its_picture():
    plain, doubtful = sheet_of(2), sheet_of(2, doubts=("drawn by hand: the CT shows no airway here",))
    assert doubtful.shape[0] > plain.shape[0]
    with pytest.raises(NoResultError):
        contact_sheet([], title="none")
