"""Tests of double clicks, tools and rows of the list: one action for each gesture, by mouse, finger and pen."""

from __future__ import annotations

import time
from contextlib import ExitStack

import pytest
from page_positions import named, place_in_slice, place_on_tree, show_slices_at, tree_is_shown
from playwright.sync_api import expect
from workstation import open_page, scroll_list_to

pytestmark = pytest.mark.browser

RECORD_ACTIONS = """
window.__actions = [];
window.WebSocket = class extends WebSocket {
  send(data) {
    const { type } = JSON.parse(data);
    if (['edit_tree', 'add_target', 'set_root'].includes(type)) window.__actions.push(data);
    else super.send(data);
  }
};
"""
"""Script that records the actions of tools instead of sending them, so that the tree stays unchanged."""
TOOLS = {
    "target": "n",
    "root": "b",
    "add": "j",
    "bridge": "l",
    "cut": "k",
    "fork": "y",
    "smooth": "u",
    "paint": "q",
    "erase": "Shift+Q",
    "reroot": "Shift+B",
}
"""Key that activates each tool."""
POINT_TOOLS = ("target", "root", "add", "bridge", "reroot")
"""Tools that act at a point; the other tools act on a branch or a fork."""
PICTURES = {
    "airway": "airway",
    "axial": "axial",
    "coronal": "coronal",
    "sagittal": "sagittal",
    "cut-plane": "cut-plane",
    "straightened": "cut-plane",
    "curved": "cut-plane",
    "xray-coronal": "xray",
    "drr": "xray",
    "tree": "outside",
    "tri-plane": "outside",
}
"""Cell of the page that shows each view."""
SWITCHED = {"straightened": "v", "curved": "v", "drr": "x", "tri-plane": "t"}
"""Key that switches the cell of a view until the cell shows this view."""


def prepare(workstation, server) -> None:
    """Open the case, show slices in the middle of the left main bronchus, and intercept the actions."""
    workstation.open(server)
    workstation.wait_ready()
    tree_is_shown(workstation)
    points = workstation.page.evaluate(
        "(id) => window.__carina.state.tree.byId.get(id).branch.points", named(workstation, "LMB")
    )
    show_slices_at(workstation, points[len(points) // 2])


@pytest.fixture
def scripts():
    """Return the script that intercepts the actions in every page of these tests."""
    return (RECORD_ACTIONS,)


@pytest.fixture
def ready(server, workstation):
    """Return a page with the case open and intercepted actions, for one test."""
    prepare(workstation, server)
    yield workstation
    assert workstation.faults == []


class SharedPage:
    """One page for tests that restore its state; if a test did not or failed, the next test gets a new page."""

    def __init__(self) -> None:
        self._open = ExitStack()
        self.workstation = None
        self._first = None

    def at_first(self, browser, host):
        """Return the shared page in its initial state; open it if there is none."""
        if self.workstation is None or not self._is_back():
            self.close()
            server = host.open(demo="phantom")
            self._open.callback(self._end, host, server)
            self.workstation = open_page(browser, (RECORD_ACTIONS,))
            self._open.callback(self.workstation.page.context.close)
            prepare(self.workstation, server)
            self._first = self._seen()
        return self.workstation

    def _end(self, host, server) -> None:
        host.close(server)
        assert server.errors() == []

    def _seen(self):
        return self.workstation.shown_views(), self.workstation.page.evaluate(CHOSEN)

    def _is_back(self) -> bool:
        """Release the tool, show the first pictures again, and return whether the page is in its initial state."""
        page, views = self.workstation.page, self._first[0]
        put_away(self.workstation)
        for view, key in (("cut-plane", "v"), ("xray-coronal", "x"), ("tree", "t")):
            self.workstation.turn_to(view, key)
        page.mouse.move(5, 300)
        self.workstation.settle()
        for view in views:
            self.workstation.wait_picture(view)
        return (
            self.workstation.state("ui.full") is None
            and self._seen() == self._first
            and actions(self.workstation) == []
        )

    def close(self) -> None:
        self.workstation = None
        self._open.close()


@pytest.fixture(scope="module")
def shared_page():
    """Return the holder of the page that the tests of ``undone`` share."""
    holder = SharedPage()
    yield holder
    holder.close()


@pytest.fixture
def undone(shared_page, browser, host, request, has_failed):
    """Return the shared page, for tests that make no lasting change."""
    workstation = shared_page.at_first(browser, host)
    yield workstation
    faults = list(workstation.faults)
    if faults or has_failed():
        workstation.failed(request.node.name)
        shared_page.close()
    assert faults == []


def show(workstation, view) -> None:
    """Press the key that switches the pictures of a cell until the picture is on the screen."""
    if view in SWITCHED:
        workstation.turn_to(view, SWITCHED[view])
    workstation.wait_for("(view) => window.__carina.state.frames[view] !== undefined", view)


def middle_of(workstation, view) -> tuple[float, float]:
    """Return the position of the left main bronchus in a view, else the middle of the picture, in CSS px."""
    if view == "tree":
        return tuple(place_on_tree(workstation, named(workstation, "LMB")))
    if view in {"axial", "coronal", "sagittal"}:
        return tuple(place_in_slice(workstation, view, workstation.state("session.sight.crosshair_lps")))
    box = workstation.page.locator(f"canvas[data-view={view}]").bounding_box()
    return box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]


def arm(workstation, tool) -> None:
    workstation.page.keyboard.press(TOOLS[tool])
    workstation.wait_for("(tool) => window.__carina.state.ui.armed === tool", tool)


def actions(workstation) -> list[str]:
    return workstation.page.evaluate("() => window.__actions.splice(0)")


def put_away(workstation) -> None:
    while workstation.state("ui.armed") is not None:
        workstation.page.keyboard.press("Escape")


CHOSEN = """() => {
    const { ui, route, picks, session, pose } = window.__carina.state;
    return JSON.stringify([ui.selected, route.spans.at(-1).branch_id, picks.length, session.sight.crosshair_lps,
        pose.lps_from_camera, pose.mode, session.can_undo]);
}"""


@pytest.mark.parametrize("view", PICTURES)
def test_double_click_without_an_active_tool_enlarges_the_picture_and_selects_nothing(undone, view):
    show(undone, view)
    undone.settle()
    before = undone.page.evaluate(CHOSEN)
    x, y = middle_of(undone, view)
    undone.page.mouse.dblclick(x, y)
    undone.wait_for("(cell) => window.__carina.state.ui.full === cell", PICTURES[view])
    # The wait is longer than a click waits for a second click, so no later action follows.
    undone.let_pass(400)
    undone.settle()
    assert undone.page.evaluate(CHOSEN) == before
    undone.page.mouse.dblclick(*middle_of(undone, view))
    undone.wait_for("() => window.__carina.state.ui.full === null")
    undone.let_pass(400)
    undone.settle()
    assert undone.page.evaluate(CHOSEN) == before
    assert actions(undone) == []


def does_it(view, tool) -> bool:
    """Return whether the tool certainly finds an object at the place where these tests click in the view."""
    if view in {"axial", "coronal", "sagittal"}:
        return tool != "fork"
    if view == "tree":
        return tool in (*POINT_TOOLS, "cut", "smooth")
    return view == "airway" and tool in POINT_TOOLS


@pytest.mark.parametrize("view", PICTURES)
def test_double_click_with_an_active_tool_applies_it_once_and_does_not_enlarge_the_picture(undone, view):
    show(undone, view)
    for tool in TOOLS:
        arm(undone, tool)
        # A tool may open another step of the work, in whose layout the view is at another place on the screen.
        undone.refreshes(2)
        undone.wait_still()
        x, y = middle_of(undone, view)
        undone.page.mouse.dblclick(x, y)
        if does_it(view, tool):
            # In the airway view the page first requests the wall point from the server.
            undone.wait_for("() => window.__actions.length > 0")
        undone.settle()
        done = actions(undone)
        assert undone.state("ui.full") is None, tool
        assert len(done) <= 1, (tool, done)
        if tool == "fork" and view in {"axial", "tree"}:
            assert done == []
            assert undone.state("ui.forkHeld") is not None, "the second click must not move the fork again"
        if view.startswith("xray") or view == "drr":
            assert done == [], "an X-ray knows no depth"
        put_away(undone)


def test_enter_key_in_a_slice_applies_the_tool_once_at_the_crosshair(ready):
    lmb = named(ready, "LMB")
    picture = ready.page.get_by_role("img", name="Axial")
    for tool, expected in (("cut", f'"branch_id":{lmb}'), ("bridge", '"kind":"bridge"')):
        arm(ready, tool)
        picture.focus()
        # The key is held so that it repeats, which is still one gesture.
        for _ in range(3):
            ready.page.keyboard.down("Enter")
        ready.page.keyboard.up("Enter")
        ready.settle()
        (done,) = actions(ready)
        assert expected in done
        assert ready.state("ui.full") is None
        put_away(ready)


@pytest.mark.parametrize("by", ["touch", "pen"])
def test_double_tap_is_distinguished_from_two_separate_taps_of_finger_and_pen(ready, by):
    client = ready.page.context.new_cdp_session(ready.page)

    def tap(x, y, at_s):
        # The events have timestamps, because on a busy machine two calls may be farther apart than two taps of a hand.
        if by == "touch":
            points = [{"x": x, "y": y}]
            client.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": points, "timestamp": at_s})
            client.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": [], "timestamp": at_s + 0.02})
            return
        for kind, after_s in (("mousePressed", 0.0), ("mouseReleased", 0.02)):
            event = {"type": kind, "x": x, "y": y, "button": "left", "clickCount": 1, "pointerType": "pen"}
            client.send("Input.dispatchMouseEvent", {**event, "timestamp": at_s + after_s})

    def tap_twice(first, second):
        # The browser answers a touch only after the page has drawn a frame. The timestamps of both taps are in the
        # past.
        ready.refreshes(2)
        at_s = time.time() - 0.2
        tap(*first, at_s)
        tap(*second, at_s + 0.1)

    # The tool leaves the step Target, whose slices are larger.
    arm(ready, "add")
    x, y = middle_of(ready, "axial")
    tap_twice((x, y), (x + 5, y))
    ready.settle()
    assert len(actions(ready)) == 1
    assert ready.state("ui.full") is None
    # A tap at another place is a separate click, even if it follows quickly.
    tap(x + 60, y, time.time())
    ready.settle()
    assert len(actions(ready)) == 1
    put_away(ready)
    before = ready.page.evaluate(CHOSEN)
    tap_twice((x, y), (x, y + 5))
    ready.wait_for("() => window.__carina.state.ui.full === 'axial'")
    ready.settle()
    assert ready.page.evaluate(CHOSEN) == before
    ready.page.keyboard.press("Escape")


@pytest.mark.parametrize(("tool", "kind"), [("cut", "cut-branch"), ("smooth", "smooth-branch")])
def test_click_on_a_branch_row_with_an_active_tool_applies_the_tool_to_the_branch(ready, tool, kind):
    lmb = named(ready, "LMB")
    row = ready.page.locator(f".branch-tree [data-branch='{lmb}']")
    route = ready.state("route.spans.at(-1).branch_id")
    tree_before, slice_before = ready.overlay("tree"), ready.overlay("coronal")
    arm(ready, tool)
    scroll_list_to(row).hover()
    ready.wait_for("(id) => window.__carina.state.ui.hovered?.branchId === id", lmb)
    # Before the click, the tree and the slices show the branch on which the tool would act.
    ready.wait_for(
        """([tree, slice]) => document.querySelector('[data-overlay=tree]').toDataURL() !== tree
            && document.querySelector('[data-overlay=coronal]').toDataURL() !== slice""",
        [tree_before, slice_before],
    )
    if tool == "cut":
        colours = row.evaluate("(row) => [getComputedStyle(row).color, getComputedStyle(document.body).color]")
        assert colours[0] != colours[1], "the row is amber"
    ready.picture(f"list-{tool}")
    row.dblclick()
    ready.settle()
    (done,) = actions(ready)
    assert f'"kind":"{kind}"' in done
    assert f'"branch_id":{lmb}' in done
    assert tool != "cut" or '"at_mm":0' in done, "a row means the whole branch"
    assert ready.state("route.spans.at(-1).branch_id") == route, "it chooses no route"

    # Keys work in the list: Enter on a row acts, and Esc releases the tool.
    ready.page.get_by_role("row").filter(has=ready.page.locator(f"[data-branch='{lmb}']")).focus()
    ready.page.keyboard.press("Enter")
    ready.settle()
    assert f'"branch_id":{lmb}' in actions(ready)[0]
    ready.page.keyboard.press("Escape")
    assert ready.state("ui.armed") is None
    # Without a tool a row selects the route.
    row.click()
    ready.wait_for("(id) => window.__carina.state.route.spans.at(-1).branch_id === id", lmb)
    assert actions(ready) == []


def test_click_on_a_branch_row_with_the_move_fork_tool_selects_the_fork_at_the_start_of_the_branch(ready):
    lmb, trachea = named(ready, "LMB"), named(ready, "Trachea")
    arm(ready, "fork")
    scroll_list_to(ready.page.locator(f".branch-tree [data-branch='{lmb}']")).click()
    ready.wait_for("(id) => window.__carina.state.ui.forkHeld === id", trachea)
    # The first Esc releases the fork, the second one the tool.
    ready.page.keyboard.press("Escape")
    assert ready.state("ui.forkHeld") is None
    assert ready.state("ui.armed") == "fork"
    ready.page.keyboard.press("Escape")
    assert ready.state("ui.armed") is None


@pytest.mark.parametrize("tool", TOOLS)
def test_active_tool_is_shown_in_every_picture_with_its_instruction(undone, tool):
    arm(undone, tool)
    page = undone.page
    canvases = page.locator("canvas[data-view]")
    tags = page.locator("[data-testid=tool-tag].corner")
    expect(tags).to_have_count(canvases.count())
    hint = page.locator("[data-testid=tool-hint]")
    expect(hint).to_contain_text("Esc cancels")
    for view in undone.shown_views():
        cursor = page.locator(f"canvas[data-view={view}]").evaluate("(c) => getComputedStyle(c.parentElement).cursor")
        x_ray = view.startswith("xray")
        brush = tool in {"paint", "erase"} and view in {"airway", "tree", "tri-plane"}
        assert ("not-allowed" in cursor) == (x_ray or brush), (view, cursor)
        assert x_ray or brush or "svg" in cursor, (view, cursor)
    undone.picture(f"armed-{tool}")
    # In the full view the first Esc releases the tool, too.
    page.locator("[data-cell=axial] header button").last.click()
    undone.wait_for("() => window.__carina.state.ui.full === 'axial'")
    expect(page.locator("[data-cell=axial] [data-testid=tool-tag]")).to_be_visible()
    expect(hint).to_be_visible()
    undone.wait_picture("axial")
    undone.picture(f"armed-{tool}-full")
    page.keyboard.press("Escape")
    assert (undone.state("ui.armed"), undone.state("ui.full")) == (None, "axial")
    expect(tags).to_have_count(0)
    page.keyboard.press("Escape")
    assert undone.state("ui.full") is None


def test_tool_is_deactivated_by_list_search_right_click_its_tag_and_another_workflow_step(ready):
    page = ready.page
    arm(ready, "cut")
    page.locator(".branch-tree [role=row]").first.focus()
    page.keyboard.press("Escape")
    assert ready.state("ui.armed") is None

    arm(ready, "cut")
    page.keyboard.press("/")
    page.keyboard.type("lm")
    page.keyboard.press("Escape")
    assert ready.state("ui.armed") is None
    assert page.locator(".branch-filter input").input_value() == "lm", "the tool first, then the field"
    page.keyboard.press("Escape")
    page.keyboard.press("Escape")

    for view in ("axial", "airway", "tree", "xray-coronal"):
        arm(ready, "bridge")
        page.mouse.click(*middle_of(ready, view), button="right")
        assert ready.state("ui.armed") is None, view

    # A drag with the right button changes window and level, and leaves the tool active.
    arm(ready, "bridge")
    x, y = middle_of(ready, "axial")
    page.mouse.move(x, y)
    page.mouse.down(button="right")
    page.mouse.move(x + 20, y + 10, steps=3)
    page.mouse.up(button="right")
    assert ready.state("ui.armed") == "bridge"
    page.locator("[data-cell=tree] [data-testid=tool-tag], [data-cell=outside] [data-testid=tool-tag]").first.click()
    assert ready.state("ui.armed") is None

    arm(ready, "add")
    page.locator(".step").filter(has_text="Target").click()
    assert ready.state("ui.armed") is None
    assert actions(ready) == []
