"""Tests that pictures saved in the window equal those of ``carina render`` for the same case."""

from __future__ import annotations

import asyncio
import io
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import carina as api
from carina import commands as c
from carina.display.dot_letters import glyph_size, text_height, text_width
from carina.errors import CancelledError, CarinaError, UsageError
from carina.server.files.pictures import Pictures
from carina.track.tree.branch_labels import branch_label

av = pytest.importorskip("av", reason="PyAV is not installed")


def query(**changed):
    """Return the parameters of a request for a picture with all marks."""
    given = {"window": "0", "width": "96", "height": "80", "full_width": "96", "scale": "1"}
    return given | {name: str(value) for name, value in changed.items()}


def window_png(session, view, **changed):
    """Return the bytes of the PNG that the window saves."""
    return asyncio.run(Pictures(session).answer(view, query(**changed)))


def pixels(png):
    with av.open(io.BytesIO(png)) as container:
        return next(container.decode(video=0)).to_ndarray(format="rgb24")


@pytest.fixture
def case(window_case):
    return window_case


VIEWS = ("airway", "axial", "cut-plane", "xray-coronal", "tree", "straightened")


@pytest.mark.parametrize("view", VIEWS)
def test_picture_saved_in_the_window_equals_the_file_of_carina_render(carina, case, tmp_path, view):
    row = api.render.view_row(view)
    marks = ["--letters", "on"] + ["--scale-bar", "on"] * row.scaled + ["--names", "on"] * row.named
    to = ["--to", case.to] if "route" in row.needs else []
    output = tmp_path / "view.png"
    ended = carina("render", case.path, "--view", view, "--size", "96x80", *marks, *to, "-o", output)
    assert ended.code == 0, ended.err
    answer = window_png(case.session, view)
    assert np.array_equal(pixels(answer.body), pixels(output.read_bytes()))
    (tmp_path / "window.png").write_bytes(answer.body)
    assert api.render.read_png_pose(tmp_path / "window.png") == api.render.read_png_pose(output)
    assert answer.headers["content-disposition"] == f'attachment; filename="{view}.png"'
    assert answer.headers["cache-control"] == "no-store"


def test_picture_of_an_operator_who_faces_the_patient_equals_the_file_of_carina_render(carina, case, tmp_path):
    case.opened.do(c.SetOperator("facing"))
    try:
        path = case.opened.save(tmp_path / "facing")
        ended = carina(
            "render", path, "--ct", case.path.parent / "ct.nii.gz", "--size", "96x80", "-o", tmp_path / "a.png"
        )
        assert ended.code == 0, ended.err
        answer = window_png(case.session, "airway", letters="off", names="off", scale_bar="off")
        assert np.array_equal(pixels(answer.body), pixels((tmp_path / "a.png").read_bytes()))
    finally:
        case.opened.undo()
        case.opened.save(case.path, replace=True)


def test_marks_can_be_switched_off_and_the_size_doubled(case):
    plain = pixels(window_png(case.session, "axial", letters="off", scale_bar="off", names="off").body)
    assert plain.shape == (80, 96, 3)
    for mark in ("letters", "scale_bar"):
        others = {name: "off" for name in ("letters", "scale_bar", "names") if name != mark}
        assert not np.array_equal(pixels(window_png(case.session, "axial", **others).body), plain), mark
    assert pixels(window_png(case.session, "axial", scale=2).body).shape == (160, 192, 3)


SIDE = 400


def boxes_of_names(branch, view, picture):
    """Return the pixels, as (left, top, right, bottom), in which the name of a branch can be written in a view."""
    points, size = branch.points, glyph_size(picture.rgb)
    if view == "tree":
        points = points[len(points) // 2][None]
    elif view == "airway":
        along_mm = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        points = points[along_mm <= 15.0]
    else:
        depth_mm = np.linalg.solve(picture.lps_from_pixel[:3, :3], (points - picture.lps_from_pixel[:3, 3]).T)[2]
        crossing = np.flatnonzero(np.diff(np.signbit(depth_mm)))
        points = points[np.union1d(crossing, crossing + 1)]
    wide, high = text_width(branch_label(branch), size), text_height(size) + 2 * size
    for column, row in filter(None, map(picture.pixel_of, points)):
        if 0.0 <= column < SIDE and 0.0 <= row < SIDE:
            # The text begins three glyph pixels right of the point, or ends left of it at the right edge.
            beside = 3 * size if column + wide + 6 * size <= SIDE else -3 * size - wide
            yield column + beside - 2 * size, row - high, column + beside + wide + 2 * size, row + high


@pytest.fixture
def tip_before_the_main_carina(case):
    case.opened.do(c.GoTo(path_mm=90.0))
    yield
    # The other tests compare the session with its file.
    case.opened.do(c.GoTo(path_mm=30.0))


@pytest.mark.usefixtures("tip_before_the_main_carina")
@pytest.mark.parametrize("view", ["tree", "airway", "coronal"])
def test_names_of_the_edited_tree_are_written_where_the_branches_are(case, view):
    named, plain = (
        pixels(
            window_png(
                case.session,
                view,
                width=SIDE,
                height=SIDE,
                full_width=SIDE,
                letters="off",
                scale_bar="off",
                names=names,
            ).body
        )
        for names in ("on", "off")
    )
    marked = (named != plain).any(axis=2)
    left = marked.copy()
    scene = case.session.scene(None)
    picture = scene.renderer.render(scene.spec(view, SIDE, SIDE, 0.5, full_width=SIDE))
    size = glyph_size(picture.rgb)
    title = None
    if view == "airway":
        # The branch of the tip is named in the corner and not beside its points.
        title = case.opened.airways.tree.nearest_branch(scene.pose.position_lps)[0]
        corner = slice(0, text_height(size) + 8 * size), slice(0, text_width(branch_label(title), size) + 4 * size)
        assert left[corner].any()
        left[corner] = False
    written = set()
    for branch in case.opened.airways.tree.branches:
        if not branch.name or (title is not None and branch.name == title.name):
            continue
        for box in boxes_of_names(branch, view, picture):
            first_column, first_row, last_column, last_row = (max(round(edge), 0) for edge in box)
            area = slice(first_row, last_row + 1), slice(first_column, last_column + 1)
            if marked[area].any():
                written.add(branch.name)
                left[area] = False
    assert not left.any(), np.argwhere(left).mean(axis=0)
    assert written >= {"tree": {"Own 1", "Trachea", "LMB"}, "airway": {"Own 1", "LMB"}, "coronal": {"Trachea"}}[view]


def test_decorated_picture_contains_the_word_and_an_undecorated_one_does_not(case):
    off = {"letters": "off", "scale_bar": "off", "names": "off"}
    size = {"width": 240, "height": 200, "full_width": 240}
    scene = case.session.scene(None)
    spec = scene.spec("airway", 240, 200, 0.5)
    rendered = scene.renderer.render(spec)
    assert rendered.decorated
    decorated = pixels(window_png(case.session, "airway", **size, **off).body)
    changed = np.argwhere((decorated != rendered.rgb).any(axis=2))
    assert changed[:, 0].min() > 180
    assert changed[:, 1].min() > 170
    case.opened.do(c.SetTexture(on=False))
    try:
        scene = case.session.scene(None)
        rendered = scene.renderer.render(scene.spec("airway", 240, 200, 0.5))
        assert np.array_equal(pixels(window_png(case.session, "airway", **size, **off).body), rendered.rgb)
    finally:
        case.opened.do(c.SetTexture(on=True))


@pytest.mark.parametrize(
    "wrong", [{"width": 0}, {"width": "x"}, {"height": 9000}, {"scale": 3}, {"width": 8000, "scale": 2}, {"window": -1}]
)
def test_picture_with_an_invalid_size_is_refused(case, wrong):
    with pytest.raises(UsageError):
        window_png(case.session, "axial", **wrong)


def test_unknown_view_and_view_without_its_input_are_refused(case):
    with pytest.raises(UsageError, match="expected one of the views"):
        window_png(case.session, "oblique")
    state = case.session.ask(c.PictureFacts())
    without_route = replace(state, scene=replace(state.scene, frames=None))
    with pytest.raises(CarinaError, match="no image yet"):
        window_png(states(without_route), "curved")


def states(*given):
    """Return a session that answers each query of its state with the next given state, and repeats the last one."""
    left = list(given)
    return SimpleNamespace(ask=lambda _question: left.pop(0) if len(left) > 1 else left[0])


def changed(state, **fields):
    """Return a copy of a state with changed fields of its scene."""
    return replace(state, scene=replace(state.scene, **fields))


def test_picture_of_a_case_that_was_closed_before_its_turn_is_refused(case):
    state = case.session.ask(c.PictureFacts())
    other = changed(state, case_number=state.scene.case_number + 1)
    with pytest.raises(CarinaError, match="another case was opened"):
        window_png(states(state, other), "axial")


def test_picture_waits_until_the_renderer_shows_the_newest_airways(case, monkeypatch):
    state = case.session.ask(c.PictureFacts())
    old = changed(state, content_is_newest=False)
    fails = SimpleNamespace(render=lambda *_, **__: pytest.fail("the old wall was rendered"))
    waiting = changed(old, renderer=fails)
    assert window_png(states(old, waiting, waiting, state), "tree").status_code == 200
    # A slice does not depend on the renderer's airways.
    assert window_png(states(old), "axial").status_code == 200
    monkeypatch.setattr("carina.server.files.pictures.UPDATE_S", 0.1)
    with pytest.raises(CarinaError, match="is being updated"):
        window_png(states(waiting), "tree")


@pytest.mark.parametrize("change", [{"content_number": 99}, {"content_is_newest": False}, {"case_number": 99}])
def test_picture_whose_airways_change_while_it_is_rendered_is_refused(case, change):
    state = case.session.ask(c.PictureFacts())
    with pytest.raises(CarinaError, match="changed while the image was rendered"):
        window_png(states(state, state, changed(state, **change)), "tree")


class SlowRenderer:
    """Renderer whose pictures end only when they are cancelled, and which counts its calls."""

    def __init__(self):
        self.stops = []

    def render(self, _view, *, stop):
        self.stops.append(stop)
        end_s = time.monotonic() + 120.0
        while not stop.cancelled and time.monotonic() < end_s:
            time.sleep(0.01)
        raise CancelledError("given up")


async def until(reached):
    async with asyncio.timeout(120.0):
        while not reached():
            await asyncio.sleep(0.01)


def test_picture_stops_when_its_client_disconnects_and_a_waiting_one_is_not_rendered(case):
    slow = SlowRenderer()
    pictures = Pictures(states(changed(case.session.ask(c.PictureFacts()), renderer=slow)))
    gone = set()

    async def request(client, **given):
        async def is_disconnected():
            return client in gone

        await pictures.answer("axial", query(**given), is_disconnected=is_disconnected)

    async def run():
        first = asyncio.ensure_future(request("first"))
        await until(lambda: slow.stops)
        second = asyncio.ensure_future(request("second"))
        await until(lambda: pictures._waiting)
        with pytest.raises(CarinaError) as refused:
            await request("third")
        assert refused.value.code == "render.busy"
        other_window = asyncio.ensure_future(request("other", window=5))
        await until(lambda: len(pictures._waiting) == 2)
        gone.update({"second", "other"})
        for waiting in (second, other_window):
            with pytest.raises(CancelledError):
                await waiting
        await until(lambda: not pictures._waiting)
        assert not slow.stops[0].cancelled
        gone.add("first")
        with pytest.raises(CancelledError):
            await first
        assert slow.stops[0].cancelled
        await until(lambda: not pictures._one_at_a_time.locked())
        assert len(slow.stops) == 1

    asyncio.run(run())


def test_cancelled_request_stops_its_picture(case):
    slow = SlowRenderer()
    pictures = Pictures(states(changed(case.session.ask(c.PictureFacts()), renderer=slow)))

    async def run():
        request = asyncio.ensure_future(pictures.answer("axial", query()))
        await until(lambda: slow.stops)
        request.cancel()
        with pytest.raises(asyncio.CancelledError):
            await request
        await until(lambda: not pictures._one_at_a_time.locked())

    asyncio.run(run())
    assert slow.stops[0].cancelled


def test_state_of_a_picture_is_read_at_one_time(case):
    state = case.session.ask(c.PictureFacts(window=0))
    assert state.airways is case.opened.airways
    assert state.scene.frames is state.route.frames
    assert state.scene.lumen is not None
    assert state.scene.case_number == case.session.scene(0).case_number


def test_marks_that_a_view_cannot_show_are_refused_by_the_command(carina, ct, tmp_path):
    for view, option in (("drr", "--scale-bar"), ("tri-plane", "--names")):
        ended = carina("render", ct, "--view", view, option, "on", "-o", tmp_path / "a.png")
        assert ended.code == 2
        assert option in ended.err
    assert not (tmp_path / "a.png").exists()
