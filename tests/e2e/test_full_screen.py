"""Tests of the airway view on the whole screen, on screens with one and with several device pixels per CSS pixel."""

from __future__ import annotations

import pytest
from workstation import PICTURE_MS, Workstation

pytestmark = pytest.mark.browser

HIDDEN = ".top-bar, .left-panel, .path-bar, .status-bar, .side-views"


@pytest.fixture(params=[1.0, 2.0], ids=["one-to-one", "two-to-one"])
def screen(request, browser):
    """Return a page of 1280 x 720 CSS pixels, and the number of device pixels per CSS pixel."""
    context = browser.new_context(viewport={"width": 1280, "height": 720}, device_scale_factor=request.param)
    context.set_default_timeout(PICTURE_MS)
    yield Workstation(context.new_page()), request.param
    context.close()


def received_width(workstation) -> int:
    """Return the width in pixels of the last picture of the airway view that is at full size."""
    return workstation.page.evaluate("() => window.__carina.state.frames.airway.width")


def test_airway_view_fills_the_screen_with_its_own_pixels_and_returns(server, screen):
    workstation, ratio = screen
    workstation.open(server)
    workstation.wait_ready()
    page = workstation.page
    page.get_by_test_id("full-screen").click()
    page.wait_for_function("() => document.fullscreenElement !== null")
    page.wait_for_function("() => document.querySelector('.airway-stage').clientWidth === window.innerWidth")
    assert page.locator(HIDDEN).locator("visible=true").count() == 0
    page.keyboard.press("o")  # The picture fills the view instead of a circle.
    width, height = page.evaluate(
        "() => { const e = document.querySelector('.airway-picture'); return [e.clientWidth, e.clientHeight]; }"
    )
    page.wait_for_function(
        "(wanted) => { const { width, height } = window.__carina.state.frames.airway;"
        " return Math.abs(width - wanted[0]) <= 1 && Math.abs(height - wanted[1]) <= 1; }",
        arg=[width * ratio, height * ratio],
    )
    workstation.wait_still()
    workstation.picture(f"full-screen-{ratio:g}")
    assert workstation.brightness("airway") > 5.0
    # Lists of the toolbar and keys work as in the window.
    page.get_by_role("button", name="Endoscopic").click()
    assert page.get_by_role("listbox").is_visible()
    page.keyboard.press("Escape")
    page.keyboard.press("Shift+F")
    page.wait_for_function("() => document.fullscreenElement === null")
    page.wait_for_function("() => document.querySelector('.side-views').checkVisibility()")
    assert page.locator(".left-panel").is_visible()
    assert workstation.faults == []


def test_leaving_the_whole_screen_by_the_key_of_the_browser_restores_the_window(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    page = workstation.page
    page.keyboard.press("Shift+F")
    page.wait_for_function("() => document.fullscreenElement !== null")
    # The browser's own Escape reaches no script in this test; its effect is the same call.
    page.evaluate("() => document.exitFullscreen()")
    page.wait_for_function("() => window.__carina.state.ui.full === null")
    page.wait_for_function("() => document.querySelector('.side-views').checkVisibility()")
    assert workstation.faults == []
