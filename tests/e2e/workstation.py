"""Page object of the workstation: actions and observations of a user, so that tests contain no selectors."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from accessibility import violations
from playwright.sync_api import Error as PlaywrightError
from playwright.sync_api import TimeoutError as PlaywrightTimeout
from server_process import Server

READY_MS = 600_000
"""Limit for opening a case with its airways, ms; far above the time on a busy machine."""
PICTURE_MS = 120_000
"""Limit for the arrival of a picture, ms; far above the time on a busy machine."""
SIZE = {"width": 1600, "height": 900}
"""Width and height of the page, CSS px: the smallest window that shows the list and the panel of the step together.

Tests of the layout of smaller windows set their size.
"""
POLL_MS = 20
"""Time between two evaluations of a condition, ms.

By default Playwright evaluates a condition at each frame, and so makes the browser draw 60 frames per second while a
test waits for the server: 6 % of a core for a page at rest, and 1 % with a timer.
"""
FRAME = "() => new Promise((done) => { requestAnimationFrame(() => done()); setTimeout(done, 1000); })"
"""Script that waits for the next frame, for at most a second."""
EMPTY = "icon.svg"
"""File of the site that is opened as an empty page."""
# Background network traffic, updates and synchronisation would disturb tests. The sandbox does not work for root in a
# container.
FLAGS = [
    "--no-sandbox",
    "--disable-quic",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


# Script that waits until the page is at rest. The server handles messages in order, so the answer to a probe, which the
# page ignores, shows that all earlier messages were handled. If the pose has not changed meanwhile, no message is
# pending.
SETTLE = """
window.WebSocket = class extends WebSocket {
  constructor(...options) {
    super(...options);
    const place = [0.1234567, 0, 0];
    this.addEventListener('message', (event) => {
      if (typeof event.data !== 'string' || !/^.{0,9}"value"/.test(event.data)) return;
      if (JSON.parse(event.data).lps[0] !== place[0]) return;
      event.stopImmediatePropagation();
      window.__answered();
    });
    window.__socket = this;
    window.__ask = () => this.send(JSON.stringify({type: 'probe', lps: place}));
  }
};
window.__settled = async (limitMs) => {
  const end = performance.now() + limitMs;
  const refresh = () => new Promise((done, fail) => {
    const late = setTimeout(() => fail(new Error('the browser does not draw the page')), end - performance.now());
    requestAnimationFrame(() => { clearTimeout(late); done(); });
  });
  const answer = () => new Promise((done, fail) => {
    // The answer to a moving cursor may replace this answer: send the request again.
    const again = setInterval(() => window.__ask(), 1000);
    const late = setTimeout(() => fail(new Error('the server does not answer')), end - performance.now());
    window.__answered = () => { clearInterval(again); clearTimeout(late); done(); };
    window.__ask();
  });
  let pose = null, since = performance.now();
  while (pose === null || performance.now() < since + 200) {
    await refresh();
    await refresh();
    await answer();
    const newest = window.__carina.state.pose.pose_id;
    if (newest !== pose) since = performance.now();
    pose = newest;
    if (performance.now() > end) throw new Error('the tip does not come to rest');
  }
};
"""
STATE = """() => {
  const { stage, route, pose, session, frames, jobs, messages, ui, targets, can_undo, picks } = window.__carina.state;
  return JSON.stringify({ stage, pose, session, frames, jobs, messages, ui, targets, can_undo, picks,
    branch: route?.branch_id });
}"""
"""Script that returns the state of the page, for the report about a page that hangs."""
SHOWN_VIEWS = """() => [...document.querySelectorAll('canvas[data-view]')]
    .filter((canvas) => canvas.offsetParent).map((canvas) => canvas.dataset.view)"""
"""Script that returns the names of the views whose canvas is visible."""
PIXELS = """
window.__pixels = (view) => {
  const canvas = document.querySelector(`canvas[data-view=${view}]`);
  const small = document.createElement('canvas');
  small.width = small.height = 32;
  const context = small.getContext('2d');
  context.drawImage(canvas, 0, 0, 32, 32);
  return [...context.getImageData(0, 0, 32, 32).data];
};
"""
"""Script that defines a function which returns a coarse grid of pixel values of a view."""


HELD_OR_NO_PROGRESS = """
(limitMs) => {
  if (%s) return 'held';
  const jobs = JSON.stringify(window.__carina.state.jobs);
  const now = performance.now();
  if (jobs !== window.__jobs?.shown) window.__jobs = {shown: jobs, sinceMs: now};
  return now - window.__jobs.sinceMs > limitMs && `no progress: ${jobs}`;
}
"""
AS_YET_MISSING = """(arg) => {
  try { return (%s)(arg); }
  catch (error) { if (error instanceof TypeError) return false; throw error; }
}"""


OUT = Path(__file__).resolve().parents[1] / "out" / "e2e"
FUNCTION = re.compile(r"\(?[\[\w, \]]*\)? =>")


def scroll_list_to(row: Any) -> Any:
    """Scroll the list of branches to a row (a locator), wait until the page has handled the scroll, and return the row.

    When the list gets the focus before it has handled a scroll, React Aria restores the earlier position, and a click
    ends on another row than it began.
    """
    row.scroll_into_view_if_needed()
    row.page.evaluate(FRAME)
    return row


class Workstation:
    """Open page of the workstation, with the actions and observations of a user."""

    def __init__(self, page: Any, scripts: tuple[str, ...] = ()) -> None:
        self.page = page
        self.faults: list[str] = []
        self._origin = ""
        self._is_as_made = True
        for script in (SETTLE, PIXELS, *scripts):
            page.add_init_script(script)
        self._wait_by_timer()
        for name in ("add_init_script", "route", "route_web_socket"):
            self._watch(name)
        page.on("console", self._on_console)
        page.on("pageerror", lambda error: self.faults.append(str(error)))

    def _on_console(self, message: Any) -> None:
        # The browser requests an icon for a picture that it shows as a page; the client's page defines its icon.
        if message.type == "error" and not message.location["url"].endswith("/favicon.ico"):
            self.faults.append(message.text)

    def _wait_by_timer(self) -> None:
        """Let the page evaluate conditions by a timer; when one is true, wait for a frame, so that it is drawn, too."""
        plain = self.page.wait_for_function

        def wait(*given: Any, **options: Any) -> Any:
            held = plain(*given, polling=POLL_MS, **options)
            self.page.evaluate(FRAME)
            return held

        self.page.wait_for_function = wait

    def _watch(self, name: str) -> None:
        """Record calls of a method that changes the page permanently."""
        plain = getattr(self.page, name)

        def noted(*given: Any, **options: Any) -> Any:
            self._is_as_made = False
            return plain(*given, **options)

        setattr(self.page, name, noted)

    def leave(self) -> bool:
        """Leave the workstation for an empty page of the same site, whose warm process the next workstation uses.

        The result is False if the page was changed permanently and cannot be used by another test.
        """
        if not self._is_as_made or not self._origin:
            return False
        if self.page.viewport_size != SIZE:
            self.page.set_viewport_size(SIZE)
        self.page.mouse.move(0, 0)
        try:
            self.page.goto(f"{self._origin}/{EMPTY}")
        except PlaywrightError:  # The workstation has ended, so the page cannot request anything.
            return False
        # The client stores nothing in the browser except its cookie.
        self.page.context.clear_cookies()
        self.faults.clear()
        return True

    def open(self, server: Server) -> None:
        """Open the start URL and accept the safety notice.

        The token in the URL works once; later pages of the same server use the cookie that it was exchanged for.
        """
        context = self.page.context
        self._origin = server.url.partition("/?")[0]
        if server.cookies:
            context.add_cookies(server.cookies)
            self.page.goto(server.url.split("?")[0])
        else:
            self.page.goto(server.url)
            server.cookies = context.cookies()
        self.accept_notice()

    def accept_notice(self) -> None:
        """Close the notice of the first run if the page shows it."""
        self.page.wait_for_selector("[data-testid=notice-accept], [data-testid=start], [data-testid=workstation]")
        button = self.page.locator("[data-testid=notice-accept]")
        if button.count():
            button.first.click()

    def wait_ready(self) -> None:
        """Wait until a case is open, its airways are found, and the airway view shows the final picture.

        Messages arrive one by one. The last of them is the pose on the new route, whose mode is that of the state.
        """
        self.page.wait_for_function(
            """() => {
                const state = window.__carina?.state;
                if (state?.stage !== 'ready' || state.route === null || state.pose === null) return false;
                return state.pose.mode === state.session.mode;
            }""",
            timeout=READY_MS,
        )
        self.wait_still()

    def wait_for(self, condition: str, arg: Any = None) -> None:
        """Wait until an expression of the page, or a function of ``arg``, returns true.

        The condition counts as false while it reads a property of a null or missing value.
        """
        # The content security policy of the page does not allow evaluation of plain text.
        function = condition if FUNCTION.match(condition) else f"() => {condition}"
        self.page.wait_for_function(AS_YET_MISSING % function, arg=arg, timeout=PICTURE_MS)

    def wait_while_working(self, condition: str) -> None:
        """Wait until an expression of the page is true, as long as a job reports progress.

        A fixed limit would fail on a machine that does other work at the same time. Here the limit applies to the time
        between two changes of the listed jobs.
        """
        self.page.evaluate("() => { window.__jobs = null; }")
        held = self.page.wait_for_function(HELD_OR_NO_PROGRESS % condition, arg=PICTURE_MS, timeout=0)
        outcome = held.json_value()
        assert outcome == "held", outcome

    def state(self, expression: str) -> Any:
        """Return a value of the client's state, such as ``pose.path_mm``."""
        return self.page.evaluate(f"() => window.__carina.state.{expression}")

    def frame(self, view: str) -> dict[str, int]:
        """Return the frame and the pose that a view shows now."""
        data = self.page.evaluate(f"() => ({{...document.querySelector('canvas[data-view={view}]').dataset}})")
        return {"frame_id": int(data["frameId"]), "pose_id": int(data["poseId"])}

    def frame_answers(self, view: str, pose_id: int) -> bool:
        """Wait until the picture of the view shows the pose; return False if the picture does not arrive in time."""
        try:
            self.page.wait_for_function(
                "([view, pose]) => Number(document.querySelector(`canvas[data-view=${view}]`).dataset.poseId) >= pose",
                arg=[view, pose_id],
                timeout=PICTURE_MS,
            )
        except PlaywrightTimeout:
            return False
        return True

    def overlay(self, view: str) -> str:
        """Return the marks drawn over a view (tip, path, targets), as the browser would save them."""
        return self.page.evaluate(
            """(view) => {
                const layer = document.querySelector(`[data-overlay=${view}]`);
                return layer instanceof HTMLCanvasElement ? layer.toDataURL() : layer.innerHTML;
            }""",
            view,
        )

    def watch_pose_ids(self, view: str) -> None:
        """Record every pose that the view shows from now on."""
        self.page.evaluate(
            """(view) => {
                const canvas = document.querySelector(`canvas[data-view=${view}]`);
                window.__poses = [Number(canvas.dataset.poseId)];
                new MutationObserver(() => window.__poses.push(Number(canvas.dataset.poseId)))
                    .observe(canvas, {attributes: true, attributeFilter: ['data-pose-id']});
            }""",
            view,
        )

    def watched_pose_ids(self) -> list[int]:
        """Return the poses that ``watch_pose_ids`` recorded."""
        return self.page.evaluate("() => window.__poses")

    def watch_stand_ins(self) -> None:
        """From now on record which view is shown in place of the airway view while it is slow."""
        self.page.evaluate(
            """() => {
                const canvas = document.querySelector('canvas[data-view=airway]');
                window.__shown = [];
                new MutationObserver(() => window.__shown.push(canvas.dataset.shows || 'airway'))
                    .observe(canvas, {attributes: true, attributeFilter: ['data-frame-id']});
            }"""
        )

    def watched_stand_ins(self) -> list[str]:
        """Return the views that ``watch_stand_ins`` recorded."""
        return self.page.evaluate("() => window.__shown")

    def fly_until(self, condition: str, seconds: float) -> None:
        """Move forwards and backwards until an expression of the page is true; fail after ``seconds``."""
        for _ in range(int(seconds / 1.2) + 1):
            for key in ("w", "s"):
                self.page.keyboard.down(key)
                try:
                    self.page.wait_for_function(f"() => Boolean({condition})", timeout=600)
                except PlaywrightTimeout:
                    continue
                else:
                    return
                finally:
                    self.page.keyboard.up(key)
        raise AssertionError(f"not within {seconds} s of flight: {condition}")

    def click_airway(self, right: float, down: float, *, twice: bool = False) -> None:
        """Click in the airway picture at fractions of its width and height."""
        canvas = self.page.locator("canvas[data-view=airway]")
        box = canvas.bounding_box()
        at = {"x": right * box["width"], "y": down * box["height"]}
        (canvas.dblclick if twice else canvas.click)(position=at, force=True)

    def wanted_width(self) -> int:
        """Return the width in pixels of a full airway picture."""
        return self.page.evaluate("() => document.querySelector('canvas[data-view=airway]').width")

    def pixels(self, view: str) -> list[int]:
        """Return a coarse grid of pixel values of a view, to detect changes."""
        return self.page.evaluate("(view) => window.__pixels(view)", view)

    def once(self, condition: str, expression: str) -> Any:
        """Wait for a condition of the page, and return the value of ``expression`` at the same moment."""
        handle = self.page.wait_for_function(f"() => ({condition}) ? [{expression}] : false", timeout=PICTURE_MS)
        return handle.json_value()[0]

    def shown_views(self) -> list[str]:
        """Return the views that have a canvas on the screen."""
        return self.page.evaluate(SHOWN_VIEWS)

    def turn_to(self, view: str, key: str) -> None:
        """Press the key that switches the pictures of a cell until this picture is on the screen."""
        for _ in range(4):
            shown = self.shown_views()
            if view in shown:
                return
            self.page.keyboard.press(key)
            self.page.wait_for_function(f"(before) => ({SHOWN_VIEWS})().join() !== before", arg=",".join(shown))
        raise AssertionError(f"{key} does not lead to {view}: {self.shown_views()}")

    def show_tab(self, name: str) -> None:
        """Show ``airways``, ``history`` or ``step`` in the left column, whichever panel is open in a narrow window."""
        self.page.locator(f"[data-testid=list-{name}]:visible, [data-testid=panel-{name}]:visible").first.click()

    def settle(self) -> None:
        """Wait until no message between page and server is pending."""
        self.page.evaluate("(limit) => window.__settled(limit)", PICTURE_MS)

    def let_pass(self, milliseconds: int) -> None:
        """Let time pass in the page, to show that something does not happen.

        Timers of the page fire in order, so that all actions that the page delayed for a shorter time are done, however
        busy the machine is.
        """
        pass_in(self.page, milliseconds)

    def refreshes(self, number: int) -> None:
        """Wait until the page was drawn ``number`` times, so that code of a refresh has run."""
        self.page.evaluate(
            """async ([number, limitMs]) => {
                const late = new Promise((_, fail) =>
                    setTimeout(() => fail(new Error('the browser does not draw the page')), limitMs));
                for (let n = 0; n < number; n += 1)
                    await Promise.race([late, new Promise((done) => requestAnimationFrame(done))]);
            }""",
            [number, PICTURE_MS],
        )

    def hold_until(self, key: str, condition: str, arg: Any = None) -> None:
        """Hold a key until a condition of the page is true."""
        self.page.keyboard.down(key)
        self.page.wait_for_function(condition, arg=arg, timeout=PICTURE_MS)
        self.page.keyboard.up(key)

    def wait_still(self) -> None:
        """Wait until the tip is at rest and the airway view shows its pose in full quality."""
        self.settle()
        self.page.wait_for_function(
            """() => {
                const c = document.querySelector('canvas[data-view=airway]');
                return c.dataset.full === 'true' && Number(c.dataset.poseId) === window.__carina.state.pose.pose_id;
            }""",
            timeout=PICTURE_MS,
        )

    def deepest_tip(self, sign: float) -> dict[str, Any]:
        """Return the tip of the highest generation on one side.

        ``sign`` is that of x in LPS (the patient's right is negative).
        """
        return self.page.evaluate(
            """(sign) => {
                const branches = [...window.__carina.state.tree.byId.values()].map((node) => node.branch);
                const tips = branches.filter((b) => b.children.length === 0 && sign * b.points.at(-1)[0] > 20);
                const best = tips.reduce((a, b) => (b.generation > a.generation ? b : a));
                return {id: best.id, generation: best.generation, end_lps: best.points.at(-1)};
            }""",
            sign,
        )

    def choose_branch(self, branch_id: int) -> None:
        """Make a branch the route through the list: open closed rows, then click the row of the branch.

        A bronchus in several pieces is one row, and a click leads to the end of the last piece: ``branch_id`` must be
        that piece.
        """
        rows = self.page.evaluate(
            """(id) => {
                const byId = window.__carina.state.tree.byId;
                const rows = [];
                for (let at = byId.get(id); at !== undefined; at = byId.get(at.branch.parent)) {
                    const row = at.row[0].branch.id;
                    if (rows[0] !== row) rows.unshift(row);
                }
                return rows;
            }""",
            branch_id,
        )
        for ancestor in rows[:-1]:
            row = self.page.get_by_role("row").filter(has=self.page.locator(f"[data-branch='{ancestor}']"))
            if row.get_attribute("aria-expanded") == "false":
                scroll_list_to(row.locator("button.chevron")).click()
        scroll_list_to(self.page.locator(f"[data-branch='{rows[-1]}']")).click()
        self.page.wait_for_function(
            "(id) => window.__carina.state.route?.spans.at(-1).branch_id === id", arg=branch_id, timeout=PICTURE_MS
        )

    def wait_picture(self, view: str, *, unlike: list[int] | None = None, like: list[int] | None = None) -> None:
        """Wait until a view shows a full picture that differs from, or equals, earlier ``pixels``."""
        self.page.wait_for_function(
            """([view, unlike, like]) => {
                const canvas = document.querySelector(`canvas[data-view=${view}]`);
                if (canvas?.dataset.full !== 'true') return false;
                const shown = window.__pixels(view);
                const same = (others) => others.every((value, n) => value === shown[n]);
                return (unlike === null || !same(unlike)) && (like === null || same(like));
            }""",
            arg=[view, unlike, like],
            timeout=PICTURE_MS,
        )

    def brightness(self, view: str) -> float:
        """Return the mean of the red channel of a view, 0 to 255."""
        red = self.pixels(view)[::4]
        return sum(red) / len(red)

    def go_to(self, path_mm: float) -> None:
        """Set the path slider, whose steps are 0.1 mm and whose values count from the origin of the route."""
        slider = self.page.get_by_role("slider", name="Position on the route in mm")
        slider.evaluate(
            """(input, pathMm) => {
                const { cumulative_mm: from, centreline_mm: to, origin } = window.__carina.state.route;
                const after = from.findIndex((mm) => mm >= pathMm);
                const n = after < 0 ? from.length - 1 : Math.max(after, 1);
                const part = (pathMm - from[n - 1]) / (from[n] - from[n - 1]);
                const value = to[n - 1] + part * (to[n] - to[n - 1]) - origin.along_mm;
                const set = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set;
                set.call(input, String(value));
                input.dispatchEvent(new Event('input', {bubbles: true}));
                input.dispatchEvent(new Event('change', {bubbles: true}));
            }""",
            path_mm,
        )
        self.page.wait_for_function(
            "(mm) => Math.abs(window.__carina.state.pose.path_mm - mm) < 1.0", arg=path_mm, timeout=PICTURE_MS
        )

    def hold(self, key: str, milliseconds: int) -> float:
        """Hold a key; return the seconds for which it was down by the clock of the page."""
        began_ms = self.page.evaluate("() => performance.now()")
        self.page.keyboard.down(key)
        self.let_pass(milliseconds)
        self.page.keyboard.up(key)
        return (self.page.evaluate("() => performance.now()") - began_ms) / 1e3

    def picture(self, name: str) -> None:
        """Save a screenshot if pictures were requested."""
        picture_of(self.page, name)

    def pictures(self, name: str, sizes: Iterable[tuple[int, int]]) -> None:
        """Save a screenshot at each size of the window if pictures were requested; then restore the size.

        Without this request the window is not resized: each size makes the server render all views again.
        """
        if not os.environ.get("CARINA_PICTURES"):
            return
        before = self.page.viewport_size
        for width, height in sizes:
            self.page.set_viewport_size({"width": width, "height": height})
            self.let_pass(300)
            self.picture(f"{name}-{width}")
        self.page.set_viewport_size(before)

    def failed(self, name: str) -> None:
        """Save data for the analysis of a failure: a screenshot, the log, and the state of the page."""
        save_page(self.page, f"{name}-failed")
        try:
            state = self.page.evaluate(STATE)
        except PlaywrightError as error:
            state = str(error)
        print("faults of the page:", self.faults, "state:", state, sep="\n")


def open_page(browser: Any, scripts: tuple[str, ...] = ()) -> Workstation:
    """Return a page with the fixed size and pixel ratio, in a new browser context."""
    context = browser.new_context(viewport=SIZE, device_scale_factor=1)
    context.set_default_timeout(PICTURE_MS)
    return Workstation(context.new_page(), scripts)


def pass_in(page: Any, milliseconds: int) -> None:
    """Let time pass in any page, as ``Workstation.let_pass`` does."""
    page.evaluate("(ms) => new Promise((done) => setTimeout(done, ms))", milliseconds)


def picture_of(page: Any, name: str) -> None:
    """Save a screenshot and check the rules of accessibility if ``CARINA_PICTURES`` is set.

    Both take a second of a core. ``assert_accessible`` checks the most important states in every run.
    """
    if os.environ.get("CARINA_PICTURES"):
        save_page(page, name)
        assert_accessible(page, name)


def assert_accessible(page: Any, state: str) -> None:
    """Check a page against the rules of accessibility; ``state`` is part of the message."""
    found = violations(page)
    assert not found, "\n".join((state, *found))


def save_page(page: Any, name: str) -> None:
    """Save a screenshot of the page in ``tests/out/e2e``."""
    OUT.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=str(OUT / f"{name}.png"))
