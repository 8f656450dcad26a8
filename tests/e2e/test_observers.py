"""Test of an observer in another browser: sees the flight, changes nothing, and is disconnected by the user."""

from __future__ import annotations

import pytest
from workstation import PICTURE_MS, SIZE, Workstation, assert_accessible, picture_of

pytestmark = pytest.mark.browser


@pytest.fixture
def opens():
    return {"demo": "phantom", "phone_address": "127.0.0.1"}


@pytest.fixture
def watcher(browser, request, has_failed):
    """Return a page of an observer who accepted the certificate."""
    context = browser.new_context(viewport=SIZE, device_scale_factor=1, ignore_https_errors=True)
    context.set_default_timeout(PICTURE_MS)
    station = Workstation(context.new_page())
    yield station
    if has_failed():
        station.failed(request.node.name)
    assert station.faults == []
    context.close()


def test_observer_sees_the_flight_without_control_until_sharing_ends(server, workstation, watcher):
    workstation.open(server)
    workstation.wait_ready()
    page = workstation.page
    page.get_by_test_id("open-devices").click()
    page.get_by_test_id("watch-switch").click()
    url = page.get_by_test_id("watch-url").inner_text()
    assert url.startswith("https://127.0.0.1:")
    assert "images are on the network" in page.get_by_test_id("device-panel").inner_text()
    assert page.get_by_test_id("on-network").inner_text() == "on the network"

    watcher.page.goto(url)
    watcher.wait_ready()
    page.get_by_test_id("watchers").get_by_text("127.0.0.1").wait_for()
    assert page.get_by_test_id("on-network").inner_text() == "1 person watching"
    page.get_by_test_id("watchers").scroll_into_view_if_needed()
    picture_of(page, "watching-workstation")

    # The observer sees the flight, and keys of the observer have no effect.
    workstation.hold_until("w", "() => window.__carina.state.pose.path_mm > 5")
    workstation.wait_still()
    watcher.wait_still()
    at = workstation.state("pose.path_mm")
    assert watcher.state("pose.path_mm") == at > 5
    for key in ("m", "n", "o", "Space", "Control+z", "Control+s", "PageDown", "w", "d"):
        watcher.page.keyboard.press(key)
    watcher.page.get_by_role("row").nth(3).click()
    watcher.page.keyboard.press("3")
    watcher.wait_for("window.__carina.state.session.sight.window.width_hu === 2000")
    watcher.settle()
    workstation.settle()
    assert workstation.state("pose.path_mm") == at
    assert workstation.state("session.can_undo") is None
    assert workstation.state("session.sight.window.width_hu") != 2000
    assert workstation.state("messages") == watcher.state("messages") == []
    # The observer receives no data of the user such as recent cases.
    assert watcher.state("start.recent") == []
    assert watcher.state("devices") is None
    assert watcher.page.get_by_test_id("watcher-panel").is_visible()
    assert watcher.page.get_by_test_id("open-devices").count() == 0
    picture_of(watcher.page, "watching-watcher")
    assert_accessible(watcher.page, "watching-watcher")

    page.get_by_role("button", name="Disconnect").click()
    watcher.page.get_by_text("has disconnected you").wait_for()
    assert watcher.shown_views() == []
    picture_of(watcher.page, "watching-sent-away")
    page.wait_for_function("(url) => document.querySelector('[data-testid=watch-url]').innerText !== url", arg=url)
    page.get_by_test_id("watch-switch").click()
    page.get_by_test_id("on-network").wait_for(state="detached")
