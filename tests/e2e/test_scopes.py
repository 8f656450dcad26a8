"""Tests of the airway view through other instruments in the browser."""

from __future__ import annotations

import math

import pytest
from workstation import assert_accessible

pytestmark = pytest.mark.browser


def after(workstation, act) -> None:
    """Run ``act``, which changes the airway picture, and wait for the next full picture."""
    workstation.wait_still()
    before = workstation.frame("airway")["frame_id"]
    act()
    workstation.page.wait_for_function(
        """(before) => {
            const c = document.querySelector('canvas[data-view=airway]');
            return c.dataset.full === 'true' && Number(c.dataset.frameId) > before;
        }""",
        arg=before,
    )
    workstation.wait_still()


def choose_scope(workstation, title: str) -> None:
    def act() -> None:
        workstation.page.get_by_test_id("scope").click()
        workstation.page.get_by_role("option").filter(has_text=title).click()

    after(workstation, act)


def middle(locator) -> tuple[float, float]:
    box = locator.bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def press(workstation, key: str) -> None:
    after(workstation, lambda: workstation.page.keyboard.press(key))


def test_selecting_a_scope_changes_the_airway_picture_and_is_undone(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    workstation.wait_still()
    workstation.picture("scope-generic")
    first = {"scope": "generic", "outline": "round", "fov_deg": 120, "operator": "head"}
    assert workstation.state("session.look") == first

    workstation.page.get_by_test_id("scope").click()
    workstation.page.get_by_role("option").first.wait_for()
    workstation.picture("scope-menu")
    assert_accessible(workstation.page, "scope-menu")
    workstation.page.keyboard.press("Escape")
    # Wait until the canvas has its final size.
    workstation.wait_still()
    before = workstation.pixels("airway")

    choose_scope(workstation, "Single-use, slim")
    assert workstation.state("session.look.scope") == "single-use-slim"
    workstation.picture("scope-single-use")
    assert (workstation.state("session.look.outline"), workstation.state("session.look.fov_deg")) == ("octagon", 85)
    assert workstation.pixels("airway") != before

    choose_scope(workstation, "EBUS")
    assert workstation.state("session.look.scope") == "ebus"
    workstation.picture("scope-ebus")
    pose = workstation.state("pose.lps_from_camera")
    shown = workstation.state("frames.airway.lps_from_camera")
    # The camera of the picture looks 35 degrees up from the direction of the tip.
    cosine = sum(pose[4 * row + 2] * shown[4 * row + 2] for row in range(3))
    assert math.degrees(math.acos(cosine)) == pytest.approx(35.0, abs=0.01)

    press(workstation, "o")
    assert workstation.state("session.look.outline") == "none"
    workstation.picture("scope-full-frame")
    press(workstation, "o")
    assert workstation.state("session.look.outline") == "round"

    for _ in range(4):
        press(workstation, "Control+z")
    assert workstation.state("session.look") == first
    off = [abs(a - b) for a, b in zip(workstation.pixels("airway"), before, strict=True)]
    # Both are JPEGs of one picture; the last one may have the size before the canvas changed.
    assert sum(off) / len(off) < 1.0
    assert workstation.faults == []


def test_click_through_a_wide_lens_marks_the_clicked_wall_point(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    workstation.wait_still()
    # The click is far from the middle, where the formula of a pinhole camera would err by a quarter of the picture.
    workstation.click_airway(0.8, 0.5)
    workstation.page.wait_for_function("() => window.__carina.state.picks.length > 0")
    lps = workstation.state("picks.at(-1).lps")
    header = workstation.state("frames.airway")
    workstation.picture("scope-wall-point")
    m = header["lps_from_camera"]
    offset = [lps[a] - m[4 * a + 3] for a in range(3)]
    x, y, z = (sum(m[4 * a + c] * offset[a] for a in range(3)) for c in range(3))
    angle = math.atan2(math.hypot(x, y), z)
    assert header["lens"]["model"] == "fisheye"
    k1 = header["lens"]["coefficients"][0]
    radius = header["lens"]["focal_px"][0] * (angle + k1 * angle**3)
    column = header["width"] / 2 + radius * x / math.hypot(x, y)
    row = header["height"] / 2 + radius * y / math.hypot(x, y)
    # The click is on a whole pixel of the screen, so its fraction of the width is not exact.
    assert column / header["width"] == pytest.approx(0.8, abs=0.01)
    assert row / header["height"] == pytest.approx(0.5, abs=0.01)
    assert workstation.faults == []


def test_fine_texture_is_switched_off_and_on_if_the_appearance_has_one(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    switch = workstation.page.get_by_test_id("texture")
    after(workstation, switch.click)
    workstation.page.wait_for_function("() => window.__carina.state.session.sight.texture === false")
    without = workstation.pixels("airway")
    # A press hides the tooltip until the mouse enters again.
    workstation.page.mouse.move(400, 500)
    switch.hover()
    workstation.page.mouse.move(*(v + 1 for v in middle(switch)))
    workstation.page.get_by_role("tooltip").wait_for()
    assert "only what is in the CT" in workstation.page.get_by_role("tooltip").inner_text()
    workstation.picture("texture-off")

    # The switch is not undone with the undo command, so it is pressed again.
    after(workstation, switch.click)
    workstation.page.wait_for_function("() => window.__carina.state.session.sight.texture === true")
    off = [abs(a - b) for a, b in zip(workstation.pixels("airway"), without, strict=True)]
    assert sum(off) / len(off) > 0.6, "the texture is seen again"

    def grey() -> None:
        workstation.page.get_by_role("button").filter(has_text="Endoscopic").click()
        workstation.page.get_by_role("option").filter(has_text="CT grey").click()

    after(workstation, grey)
    # Grey walls have no texture to switch.
    switch.wait_for(state="detached")
    press(workstation, "Control+z")
    switch.wait_for()
    assert workstation.faults == []


def test_toolbar_of_the_airway_view_is_not_clipped_at_any_window_width(server, workstation):
    workstation.page.set_viewport_size({"width": 1920, "height": 900})
    workstation.open(server)
    workstation.wait_ready()
    workstation.page.get_by_test_id("texture").wait_for()
    tools = workstation.page.get_by_role("toolbar", name="Airway view")
    for width in (1920, 1760, 1600, 1536, 1440, 1280):
        workstation.page.set_viewport_size({"width": width, "height": 900})
        workstation.refreshes(3)
        shown_px, needed_px = tools.evaluate("(bar) => [bar.clientWidth, bar.scrollWidth]")
        workstation.picture(f"tools-{width}")
        assert needed_px <= shown_px, width
