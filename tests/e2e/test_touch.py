"""Journey by fingers on a tablet: branch, slices, flight pad, target and printed plan, in both orientations."""

from __future__ import annotations

import pytest
from page_positions import extent_mm, host, middle_lps, named, place_in_slice, place_on_tree, show_slices_at
from test_control_sizes import SMALL
from workstation import PICTURE_MS, Workstation, assert_accessible, scroll_list_to

from cached_test_data import cached_phantom

pytestmark = pytest.mark.browser

CHEST = {"seed": 4, "spacing_mm": 1.2, "generations": 5, "nodule": True}
PORTRAIT, LANDSCAPE = {"width": 820, "height": 1180}, {"width": 1180, "height": 820}
SCROLLS = (
    "() => document.documentElement.scrollHeight > innerHeight || document.documentElement.scrollWidth > innerWidth"
)
"""Script that returns whether the page itself scrolls, in which case a picture could block scrolling."""


@pytest.fixture
def opens(shared_chest):
    """Return a chest with a nodule, as the opened file."""
    return shared_chest(**CHEST)


@pytest.fixture
def tablet(browser, server, request, has_failed):
    """Return the workstation on a page with a touch screen."""
    context = browser.new_context(viewport=PORTRAIT, has_touch=True)
    context.set_default_timeout(PICTURE_MS)
    station = Workstation(context.new_page())
    station.open(server)
    station.wait_ready()
    yield station
    if has_failed():
        station.failed(request.node.name)
    assert station.faults == []
    context.close()


class Fingers:
    """Fingers on the screen, as the browser reports them."""

    def __init__(self, page) -> None:
        self._client = page.context.new_cdp_session(page)

    def put(self, kind: str, *places) -> None:
        points = [{"x": x, "y": y, "id": n} for n, (x, y) in enumerate(places)]
        self._client.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    def move(self, start, end, steps: int = 8) -> None:
        """Put fingers at ``start``, move them to ``end`` and lift them; both are lists of places."""
        self.put("touchStart", *start)
        for n in range(1, steps + 1):
            places = zip(start, end, strict=True)
            self.put("touchMove", *[(a + (c - a) * n / steps, b + (d - b) * n / steps) for (a, b), (c, d) in places])
        self.put("touchEnd")


def test_journey_by_fingers_reaches_a_printed_plan_on_a_tablet(tablet):
    page, fingers = tablet.page, Fingers(tablet.page)
    handle = page.get_by_test_id("sheet-handle")
    page.get_by_role("button", name="Airways", exact=True).first.tap()
    # A tap chooses a branch in the list, and in the external view of the tree.
    scroll_list_to(page.locator(".branch-tree [data-branch]").nth(1)).tap()
    tablet.wait_for("window.__carina.state.session.can_undo?.startsWith('route to') === true")
    page.get_by_test_id("view-tab-outside").tap()
    branch = named(tablet, "LUL")
    tablet.wait_for(
        "() => document.querySelector('canvas[data-view=tree]').getBoundingClientRect().right <= innerWidth + 1"
    )
    tablet.wait_for("() => document.querySelector('canvas[data-view=tree]').dataset.full === 'true'")
    page.touchscreen.tap(*place_on_tree(tablet, branch))
    tablet.wait_for("(id) => window.__carina.state.route.spans.some((span) => span.branch_id === id)", branch)

    # A swipe and a tap open and close the sheet.
    for moved_px, opened in ((60, False), (-60, True)):
        box = handle.bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        fingers.move([(x, y)], [(x, y + moved_px)])
        tablet.wait_for("(opened) => window.__carina.state.ui.sheetOpen === opened", opened)

    # The left stick advances the tip, the right stick turns the view; both rest when the thumbs leave.
    handle.tap()
    tablet.wait_still()
    left, right = (page.get_by_test_id(f"stick-{side}").bounding_box() for side in ("left", "right"))
    rest = [(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2) for box in (left, right)]
    at_mm = tablet.state("pose.path_mm")
    fingers.put("touchStart", *rest)
    fingers.put("touchMove", (rest[0][0], rest[0][1] - 50), (rest[1][0] + 40, rest[1][1]))
    tablet.wait_for("(mm) => window.__carina.state.pose.path_mm > mm + 5", at_mm)
    fingers.put("touchEnd")
    tablet.settle()
    stopped = tablet.state("pose.pose_id")
    tablet.let_pass(300)
    tablet.settle()
    assert tablet.state("pose.pose_id") == stopped
    tablet.picture("touch-flight")

    # One finger scrolls a slice, two fingers zoom and move it.
    page.get_by_test_id("view-tab-axial").tap()
    tablet.wait_for(
        "() => Math.abs(document.querySelector('canvas[data-view=axial]').getBoundingClientRect().left) < 2"
    )
    box = host(tablet, "axial")
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    before = middle_lps(tablet, "axial")
    fingers.move([(x, y - 40)], [(x, y + 40)])
    tablet.wait_for("(z) => Math.abs(window.__carina.state.frames.axial.lps_from_pixel[11] - z) > 3", before[2])
    wide_mm = extent_mm(tablet, "axial")
    fingers.move([(x - 30, y), (x + 30, y)], [(x - 90, y + 20), (x + 90, y + 20)])
    tablet.wait_for(
        """(most) => {
            const { lps_from_pixel: m, width } = window.__carina.state.frames.axial;
            return Math.hypot(m[0], m[4], m[8]) * width < most;
        }""",
        0.5 * wide_mm,
    )
    assert page.evaluate(SCROLLS) is False

    # Target, answer and report; while the place is chosen, the sheet gives its space to the slices.
    centre = cached_phantom(**CHEST).truth["nodule"]["centre_lps"]
    page.get_by_role("button", name="Target", exact=True).first.tap()
    page.get_by_test_id("fit-axial").tap()
    show_slices_at(tablet, centre)
    page.get_by_test_id("arm-target").tap()
    tablet.wait_for("() => document.querySelector('.left-panel').getBoundingClientRect().height < 50")
    tablet.picture("touch-choosing")
    assert_accessible(tablet.page, "touch-choosing")
    page.touchscreen.tap(*place_in_slice(tablet, "axial", [float(v) for v in centre]))
    page.get_by_test_id("answer-take-route").tap()
    page.get_by_test_id("print-plan").wait_for()
    for size in (PORTRAIT, LANDSCAPE):
        page.set_viewport_size(size)
        for step in ("Airways", "Target", "Route", "Rehearse"):
            page.get_by_role("button", name=step, exact=True).first.tap()
            tablet.refreshes(2)
            assert page.evaluate(SCROLLS) is False, (size, step)
            assert page.evaluate(SMALL, 43.9) == [], (size, step)
            tablet.picture(f"touch-{step}-{size['width']}")
    page.get_by_role("button", name="Route", exact=True).first.tap()
    with page.context.expect_page() as opened:
        page.get_by_test_id("print-plan").tap()
    report = opened.value
    report.wait_for_load_state("load")
    assert "Not a medical device" in report.locator("body").inner_text()


@pytest.mark.parametrize("size", [(720, 450), (640, 360)])
def test_page_at_200_percent_zoom_shows_picture_route_and_panel_without_scrolling(server, workstation, size):
    page = workstation.page
    page.set_viewport_size({"width": size[0], "height": size[1]})
    workstation.open(server)
    workstation.wait_ready()
    assert page.evaluate(SCROLLS) is False
    workstation.picture(f"zoomed-{size[0]}-open")
    page.get_by_test_id("sheet-handle").click()
    workstation.refreshes(2)
    airway, route = (page.locator(place).bounding_box() for place in (".airway-picture", ".path-bar"))
    assert airway["height"] > 0.35 * size[1]
    assert route["y"] + route["height"] <= size[1]
    page.get_by_role("button", name="Target", exact=True).first.click()
    page.get_by_test_id("arm-target").scroll_into_view_if_needed()
    assert page.get_by_test_id("arm-target").is_visible()
    workstation.picture(f"zoomed-{size[0]}-target")
    assert workstation.faults == []
