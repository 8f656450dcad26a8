"""Tests of two windows of one workstation in the browser: common edits, and separate view settings."""

from __future__ import annotations

import json

import pytest
from server_process import Child, start_server, stop_server
from workstation import open_page, picture_of

from cached_test_data import cached_phantom
from carina.volume import write_grid

pytestmark = pytest.mark.browser


@pytest.fixture
def two(browser, server, workstation, request, has_failed):
    """Return two pages of one workstation, in separate contexts as in two browsers."""
    other = open_page(browser, ())
    for page in (workstation, other):
        page.open(server)
        page.wait_ready()
    yield workstation, other
    if has_failed():
        other.failed(request.node.name)
    assert other.faults == []
    other.page.context.close()


def test_edit_in_one_window_is_shown_and_undone_in_the_other(two):
    first, second = two
    first.page.keyboard.press("o")
    second.wait_for("window.__carina.state.session.can_undo === 'image outline'")
    assert second.state("look.outline") == first.state("look.outline")
    first.page.get_by_test_id("list-airways").click()
    first.page.get_by_role("row").nth(3).click()
    second.wait_for("window.__carina.state.session.can_undo.startsWith('route to')")
    # In each window the state arrives first, and then the route.
    first.wait_for("window.__carina.state.route.route_id === window.__carina.state.session.route_id")
    second.wait_for("window.__carina.state.route.route_id === window.__carina.state.session.route_id")
    assert first.state("route.route_id") == second.state("route.route_id")
    second.page.keyboard.press("Shift+h")
    steps = second.page.get_by_test_id("history").get_by_role("button")
    assert "Route to" in steps.first.inner_text() or "Route to" in steps.last.inner_text()
    picture_of(second.page, "windows-second-with-history")
    second.page.keyboard.press("Control+z")
    first.wait_for("window.__carina.state.session.can_redo?.startsWith('route to') === true")
    second.page.keyboard.press("Control+z")
    for window in two:
        window.wait_for("window.__carina.state.session.can_undo === null")
    assert first.state("look") == second.state("look")


def test_flight_is_shown_in_both_windows_and_slice_settings_are_separate(two):
    first, second = two
    first.hold_until("w", "() => window.__carina.state.pose.path_mm > 5")
    first.wait_still()
    second.wait_still()
    assert second.state("pose.path_mm") == first.state("pose.path_mm") > 5
    pose = first.state("pose.pose_id")
    assert second.state("pose.pose_id") == pose
    assert second.frame_answers("airway", pose)
    # Scrolling and zooming a slice in the first window leave the slice of the second one unchanged.
    before = second.state("sight")
    box = first.page.locator("canvas[data-view=axial]").bounding_box()
    first.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    first.page.mouse.wheel(0, 240)
    first.wait_for("window.__carina.state.session.sight.crosshair_lps !== null")
    first.page.keyboard.press("3")
    first.wait_for("window.__carina.state.session.sight.window.width_hu === 2000")
    first.settle()
    second.settle()
    assert second.state("session.sight") == before
    second.page.keyboard.press("i")
    second.wait_for("window.__carina.state.session.sight.slab.thickness_mm === 10")
    first.settle()
    assert first.state("session.sight.slab.thickness_mm") == 0
    for station, name in zip(two, ("first", "second"), strict=True):
        station.wait_still()
        picture_of(station.page, f"windows-{name}")


def test_reloading_or_closing_a_window_leaves_the_other_window_unchanged(two):
    first, second = two
    first.page.keyboard.press("3")
    first.wait_for("window.__carina.state.session.sight.window.width_hu === 2000")
    second.page.reload()
    second.wait_ready()
    assert second.state("session.sight.window.width_hu") == 2000, "a new window has the latest view settings"
    second.page.goto("about:blank")
    first.hold_until("w", "() => window.__carina.state.pose.path_mm > 5")
    first.wait_still()
    assert first.page.locator(".connection").count() == 0


NOTEBOOK = """
import json, sys
import carina
from carina import commands
case = carina.Case.open(sys.argv[1])
print("ready")
for line in sys.stdin:
    print(json.dumps(eval(line)))
case.close()
"""


class Notebook:
    """Program of the same user, which receives its commands line by line."""

    def __init__(self, scan, home):
        self._child = Child(["-u", "-c", NOTEBOOK, str(scan)], home)
        assert self._child.output.readline() == "ready\n", self._child.log

    def __call__(self, line):
        self._child.input.write(line + "\n")
        self._child.input.flush()
        answer = self._child.output.readline()
        assert answer, self._child.log
        return json.loads(answer)

    def end(self):
        self._child.input.close()
        return self._child.wait()


@pytest.mark.slow
def test_changes_of_two_windows_and_a_notebook_appear_in_all(browser, workstation, tmp_path, request, has_failed):
    scan = tmp_path / "scan.nii.gz"
    chest = cached_phantom(spacing_mm=1.5, generations=3).volume
    write_grid(scan, chest.hu_zyx, chest.lps_from_ijk, what="the phantom")
    running = start_server(["open", str(scan)], tmp_path / "home")
    second = open_page(browser, ())
    notebook = None
    try:
        for page in (workstation, second):
            page.open(running)
            page.wait_ready()
        # A notebook can join only a saved case.
        workstation.page.keyboard.press("o")
        workstation.wait_for("window.__carina.state.session.can_undo === 'image outline'")
        workstation.wait_for("window.__carina.state.session.saving.saved_s !== null")
        notebook = Notebook(scan, tmp_path / "home")
        assert notebook("case.history()[-1]") == "image outline"
        assert notebook("case.airways.tree.branches[0].name") == "Trachea"
        # Both windows show the change of the notebook, and the notebook has the changes of the windows.
        notebook("case.do(commands.EditKeyFrames(commands.KeyFrameAdd()))")
        for page in (workstation, second):
            page.wait_for("window.__carina.state.keyFrames.frames.length === 1")
        second.page.keyboard.press("o")
        workstation.wait_for("window.__carina.state.history.steps.length === 3")
        workstation.settle()
        assert notebook("case.history()[-1]") == "image outline"
        assert notebook("case.state.document.look.outline") == workstation.state("session.look.outline")
        for _ in range(2):
            notebook("case.undo()")
        for page in (workstation, second):
            page.wait_for("window.__carina.state.keyFrames.frames.length === 0")
        workstation.page.keyboard.press("Shift+h")
        picture_of(workstation.page, "windows-and-a-notebook")
    finally:
        if has_failed():
            second.failed(request.node.name)
        ended = None if notebook is None else notebook.end()
        second.page.context.close()
        stop_server(running)
        workstation.faults.clear()
    assert ended == 0
