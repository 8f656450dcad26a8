"""Tests of public functions: wrong types are refused, and a progress bar is shown in terminals and notebooks."""

from __future__ import annotations

import io
import sys
import threading
import types
from collections.abc import Callable

import numpy as np
import pytest

import carina
from carina.display import progress as bars
from carina.display.progress import BarCallback, create_progress_bar, shows_progress
from carina.errors import UsageError
from carina.render import VIEW_NAMES, AirwayView, CutPlaneView, SliceView
from carina.volume import Volume

CT = Volume(np.full((12, 12, 12), 40, dtype=np.int16), np.eye(4))
POSE = carina.Pose.looking((5.5, 5.5, 5.5), (0, 0, -1))


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: carina.open_volume(3), "open_volume: path: expected str or Path; found int; name a folder or a file"),
        (
            lambda: carina.find_airways("scan"),
            "find_airways: volume: expected Volume; found str; open a volume with carina.open_volume",
        ),
        (
            lambda: carina.track_paths(np.zeros(3), targets=[(0, 0, 0)]),
            "track_paths: volume: expected Volume; found ndarray; open a volume with carina.open_volume",
        ),
        (
            lambda: carina.edit_airways(CT, None, None),
            "edit_airways: airways: expected Airways; found NoneType; get airways from carina.find_airways",
        ),
        (
            lambda: carina.wall_field(CT, "tree"),
            "wall_field: airways: expected Airways; found str; get airways from carina.find_airways",
        ),
        (
            lambda: carina.export_airways("a.json", CT, "tree"),
            "export_airways: airways: expected Airways; found str; get airways from carina.find_airways",
        ),
        (
            lambda: carina.write_tree("a.json", []),
            "write_tree: tree: expected AirwayTree; found list; get it from carina.find_airways",
        ),
        (
            lambda: carina.render_view("scan", view="axial", pose=POSE),
            "render_view: volume: expected Volume; found str; open a volume with carina.open_volume",
        ),
        (
            lambda: carina.render_view(CT, view="axial"),
            "render_view: pose: expected Pose; found NoneType; get one from a carina.FlightPath or from "
            "carina.Pose.looking",
        ),
        (
            lambda: carina.render_view(CT, view=AirwayView(POSE), pose=POSE, width=64),
            "render_view: pose, width: expected as fields of the AirwayView, found as separate arguments; set "
            "them in the AirwayView",
        ),
        (
            lambda: carina.write_film("a.mp4", CT, "path"),
            "write_film: flight: expected FlightPath or AutoFlight or KeyFrameFlight; found str; create a "
            "carina.FlightPath from a route",
        ),
        (
            lambda: carina.open_volume("a", progress=3),
            "open_volume: progress: expected True, False, None or a function that takes a string and a fraction; "
            "found int",
        ),
    ],
)
def test_argument_of_a_wrong_type_is_refused_with_expected_type_found_type_and_remedy(
    call: Callable[[], object], text: str
) -> None:
    with pytest.raises(UsageError) as refused:
        call()
    assert str(refused.value) == text
    assert refused.value.code in {"usage", "usage.type"}


def test_render_with_a_view_of_a_wrong_type_is_refused() -> None:
    with pytest.raises(UsageError, match=r"render_view: view: expected AirwayView or .*; found Pose; or pass one of"):
        carina.render_view(CT, view=POSE)


@pytest.mark.parametrize("options", [{"pose": POSE}, {}, {"pose": POSE, "fov_deg": 90.0}])
def test_unknown_view_name_is_refused_with_the_names_of_all_views(options: dict[str, object]) -> None:
    with pytest.raises(UsageError) as refused:
        carina.render_view(CT, view="airwy", **options)
    assert str(refused.value) == f"expected one of the views {', '.join(VIEW_NAMES)}; found 'airwy'"


def test_picture_of_a_view_object_equals_that_of_the_view_name() -> None:
    size = {"width": 40, "height": 32}
    for view, named in (
        (SliceView("axial", (5.5, 5.5, 5.5), **size), {"view": "axial"}),
        (CutPlaneView(POSE, extent_mm=20.0, **size), {"view": "cut-plane", "extent_mm": 20.0}),
        (AirwayView(POSE, fov_deg=80.0, **size), {"view": "airway", "fov_deg": 80.0}),
    ):
        found = carina.render_view(CT, view=view)
        assert np.array_equal(found.rgb, carina.render_view(CT, pose=POSE, **named, **size).rgb)


# Progress bar


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class NotedBar:
    def __init__(self) -> None:
        self.drawn: list[tuple[str, float | None]] = []
        self.closed = False

    def draw(self, text: str, fraction: float | None) -> None:
        self.drawn.append((text, fraction))

    def close(self) -> None:
        self.closed = True


def test_progress_bar_starts_after_half_a_second_is_limited_to_10_hz_and_shows_the_remaining_time() -> None:
    now, bar = [10.0], NotedBar()
    watched = BarCallback(lambda: bar, lambda: now[0])
    for time_s, fraction in ((10.1, 0.1), (10.4, 0.2), (10.6, 0.25), (10.65, 0.3), (11.0, 0.5), (12.0, None)):
        now[0] = time_s
        watched("reading", fraction)
    assert bar.drawn == [("reading, 2 s left", 0.25), ("reading, 1 s left", 0.5), ("reading", None)]
    watched.close()
    assert bar.closed


def test_work_shorter_than_half_a_second_shows_no_progress_bar() -> None:
    made = []
    watched = BarCallback(lambda: made.append(1) or NotedBar(), lambda: 1.0)
    watched("reading", 0.5)
    watched.close()
    assert not made


def test_progress_bar_is_shown_in_a_terminal_or_notebook_and_in_the_main_thread_only(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delitem(sys.modules, "IPython", raising=False)
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    assert create_progress_bar() is None
    monkeypatch.setattr(sys, "stderr", None)
    assert create_progress_bar() is None
    monkeypatch.setattr(sys, "stderr", Terminal())
    assert create_progress_bar() is bars.TerminalBar
    found = []
    thread = threading.Thread(target=lambda: found.append(create_progress_bar()))
    thread.start()
    thread.join()
    assert found == [None]
    shell = types.ModuleType("IPython")
    shell.get_ipython = lambda: None
    monkeypatch.setitem(sys.modules, "IPython", shell)
    assert create_progress_bar() is bars.TerminalBar, "IPython is loaded, and this is no notebook"
    shell.get_ipython = lambda: types.SimpleNamespace(kernel=object())
    assert create_progress_bar() is bars.NotebookBar


def test_notebook_progress_bar_is_updated_in_place_and_removed_at_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    pages = []
    handle = types.SimpleNamespace(update=pages.append)
    module = types.ModuleType("IPython.display")
    module.HTML, module.display = str, lambda _html, display_id: handle
    monkeypatch.setitem(sys.modules, "IPython.display", module)
    bar = bars.NotebookBar()
    bar.draw("reading <1>", 0.25)
    bar.draw("reading", None)
    bar.close()
    assert pages == [
        '<progress max="1" value="0.250"></progress> <small>reading &lt;1&gt;</small>',
        '<progress max="1"></progress> <small>reading</small>',
        "",
    ]


def test_terminal_progress_bar_is_one_line_and_removed_at_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("TERM", "xterm")
    bar = bars.TerminalBar()
    bar.draw("segmenting the airways", 0.5)
    bar.close()
    assert "segmenting the airways" in screen.getvalue()
    assert screen.getvalue().rstrip().endswith("\x1b[2K"), "the line is removed"


@pytest.mark.parametrize(
    ("choice", "is_reported", "bars_made"), [(None, True, 1), (True, True, 1), (False, False, 0), ("callback", True, 0)]
)
def test_progress_bar_is_shown_unless_disabled_or_replaced_by_a_callback(
    choice: object, is_reported: bool, bars_made: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, reported = [], []

    def bar() -> NotedBar:
        made.append(NotedBar())
        return made[-1]

    monkeypatch.setattr(bars, "create_progress_bar", lambda: bar)
    monkeypatch.setattr(bars, "BEGIN_S", 0.0)
    monkeypatch.setattr(bars, "EVERY_S", 0.0)

    @shows_progress
    def work(*, progress: object = None) -> bool:
        if callable(progress):
            progress("working", 0.5)
            return True
        return False

    listener = (lambda what, fraction: reported.append((what, fraction))) if choice == "callback" else choice
    assert work(progress=listener) == is_reported
    assert len(made) == bars_made
    assert all(bar.closed for bar in made)
    assert reported == ([("working", 0.5)] if choice == "callback" else [])


def test_progress_bar_is_removed_if_the_work_raises_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    bar = NotedBar()
    monkeypatch.setattr(bars, "create_progress_bar", lambda: lambda: bar)
    monkeypatch.setattr(bars, "BEGIN_S", 0.0)
    monkeypatch.setattr(bars, "EVERY_S", 0.0)

    @shows_progress
    def work(*, progress: Callable[[str, float | None], None]) -> None:
        progress("working", 0.5)
        raise UsageError("no")

    with pytest.raises(UsageError, match="no"):
        work()
    assert bar.closed


def test_demo_function_prints_nothing_without_a_terminal(capfd: pytest.CaptureFixture[str]) -> None:
    carina.demo_patient()
    shown = capfd.readouterr()
    assert shown.out == shown.err == ""
