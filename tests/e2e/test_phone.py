"""Tests of a phone as a controller in the browser: its page turns the tip, is disconnected and reconnects."""

from __future__ import annotations

import re

import pytest
from workstation import PICTURE_MS, assert_accessible, pass_in, picture_of

pytestmark = pytest.mark.browser
pytest.importorskip("cryptography")


@pytest.fixture
def opens():
    """Return the options: the phone page is closed at first, and only this computer can reach it when it is open."""
    return {"demo": "phantom", "phone_address": "127.0.0.1"}


class Phone:
    """Page with the size of a phone and an orientation sensor that the test turns."""

    def __init__(self, context, url: str) -> None:
        self.context = context
        self.page = context.new_page()
        self.faults: list[str] = []
        self.page.on("pageerror", lambda error: self.faults.append(str(error)))
        self.links: list[object] = []
        self.page.route_web_socket("**/phone", self._linked)
        self._devtools = context.new_cdp_session(self.page)
        self.turn(0.0, 20.0, 0.0)
        self.page.goto(url)

    def _linked(self, link) -> None:
        link.connect_to_server()
        self.links.append(link)

    def lose_network(self) -> None:
        """Cut the connection of the page; a new connection is allowed."""
        self.links[-1].close(code=1001)

    def turn(self, alpha: float, beta: float, gamma: float) -> None:
        angles = {"alpha": alpha % 360.0, "beta": beta, "gamma": gamma}
        self._devtools.send("DeviceOrientation.setDeviceOrientationOverride", angles)

    def says(self, text: str) -> None:
        self.page.wait_for_function("(words) => document.getElementById('state').textContent.includes(words)", arg=text)

    def press(self, what: str) -> None:
        box = self.page.locator(f"#{what}").bounding_box()
        self.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        self.page.mouse.down()

    def let_go(self) -> None:
        self.page.mouse.up()


@pytest.fixture
def phone_of(browser):
    contexts = []

    def made(url: str) -> Phone:
        context = browser.new_context(
            viewport={"width": 390, "height": 844}, device_scale_factor=2, has_touch=True, ignore_https_errors=True
        )
        context.set_default_timeout(PICTURE_MS)
        contexts.append(context)
        return Phone(context, url)

    yield made
    for context in contexts:
        context.close()


def switch_on(workstation) -> str:
    page = workstation.page
    page.keyboard.press(";")
    page.wait_for_selector("[data-testid=device-panel]")
    page.wait_for_function("() => window.__carina.state.devices !== null")
    assert workstation.state("devices.phone") is None, "off until the user switches it on"
    page.get_by_test_id("phone-switch").click()
    page.wait_for_selector("[data-testid=phone-qr]")
    return str(workstation.state("devices.phone.url"))


def test_phone_turns_and_advances_the_tip_also_after_a_lost_connection(server, workstation, phone_of):
    workstation.open(server)
    workstation.wait_ready()
    url = switch_on(workstation)
    assert re.fullmatch(r"https://127\.0\.0\.1:\d+/#[\w-]{22,}", url)
    shown = workstation.page.get_by_test_id("phone-sha256").inner_text()
    assert re.sub(r"\s", ":", shown.strip()).replace("::", ":") == workstation.state("devices.phone.sha256")
    workstation.page.get_by_test_id("phone-qr").scroll_into_view_if_needed()
    workstation.picture("phone-panel")

    phone = phone_of(url)
    phone.says("Connected")
    picture_of(phone.page, "phone-begin")
    phone.page.locator("#use").tap()
    phone.page.wait_for_selector("#control:not([hidden])")
    workstation.page.wait_for_function("() => window.__carina.state.devices.phone.connected")

    # The phone is turned without a pressed button, so nothing moves.
    before = workstation.state("pose.lps_from_camera")
    for n in range(5):
        phone.turn(360.0 - 4.0 * n, 20.0, 0.0)
        pass_in(phone.page, 50)
    assert workstation.state("pose.lps_from_camera") == before
    # With the button held, the tip looks to the right with the phone's upper edge (alpha decreases), and the picture
    # follows.
    pixels = workstation.pixels("airway")
    phone.press("turn")
    for n in range(12):
        phone.turn(344.0 - 2.0 * n, 20.0, 0.0)
        pass_in(phone.page, 60)
    workstation.page.wait_for_selector("[data-testid=device][data-holds]")
    phone.says("moves the tip")
    picture_of(phone.page, "phone-held")
    assert_accessible(phone.page, "phone-held")
    # The direction of the movement is expressed in the axes of the earlier view.
    right = " + ".join(f"{before[4 * n]} * window.__carina.state.pose.lps_from_camera[{4 * n + 2}]" for n in range(3))
    workstation.page.wait_for_function(f"() => {right} > 0.2")
    workstation.settle()
    phone.let_go()
    after = workstation.state("pose.lps_from_camera")
    forward = [after[2], after[6], after[10]]
    right, ahead = (sum(before[4 * row + axis] * forward[row] for row in range(3)) for axis in (0, 2))
    assert right > 0.2, "to the right"
    assert ahead > 0.8, "by less than 40 degrees"
    workstation.wait_still()
    assert workstation.frame_answers("airway", workstation.state("pose.pose_id"))
    assert workstation.pixels("airway") != pixels
    workstation.picture("phone-turned")

    phone.page.locator("#recenter").tap()
    workstation.page.wait_for_function(
        f"() => Math.abs(window.__carina.state.pose.lps_from_camera[2] - {before[2]}) < 0.01"
    )
    at_mm = workstation.state("pose.path_mm")
    phone.press("forward")
    workstation.page.wait_for_function(f"() => window.__carina.state.pose.path_mm > {at_mm + 8}")
    # The connection is cut while the button is pressed: the tip stops, and the page reports it and reconnects. The
    # button, which is still held, does not move the tip.
    phone.lose_network()
    phone.says("Trying again")
    phone.says("Connected")
    assert len(phone.links) == 2
    workstation.wait_still()
    stopped = workstation.state("pose.pose_id")
    workstation.let_pass(300)
    assert workstation.state("pose.pose_id") == stopped
    phone.let_go()
    at_mm = workstation.state("pose.path_mm")
    phone.press("back")
    workstation.page.wait_for_function(f"() => window.__carina.state.pose.path_mm < {at_mm - 4}")
    phone.let_go()
    phone.page.locator("#mode").tap()
    workstation.page.wait_for_function("() => window.__carina.state.pose.mode === 'free'")
    phone.says("relative mode")

    # The page is closed with its button pressed, and opened again with the same link.
    phone.press("forward")
    pass_in(phone.page, 100)
    phone.page.close()
    workstation.page.wait_for_function("() => window.__carina.state.devices.phone.connected === false")
    workstation.wait_still()
    stopped = workstation.state("pose.pose_id")
    workstation.let_pass(300)
    assert workstation.state("pose.pose_id") == stopped
    again = phone_of(url)
    again.says("Connected")
    workstation.page.wait_for_function("() => window.__carina.state.devices.phone.connected")
    other = phone_of(url)
    again.says("has taken over")
    other.says("Connected")

    workstation.page.get_by_test_id("phone-switch").click()
    workstation.page.wait_for_function("() => window.__carina.state.devices.phone === null")
    other.says("not responding")
    assert [*phone.faults, *again.faults, *other.faults, *workstation.faults] == []


def test_phone_page_with_a_wrong_token_is_refused_with_a_message_and_counted(server, workstation, phone_of):
    workstation.open(server)
    workstation.wait_ready()
    url = switch_on(workstation)
    unauthenticated = phone_of(url.partition("#")[0] + "#guessed")
    unauthenticated.says("Scan the code")
    picture_of(unauthenticated.page, "phone-refused")
    workstation.page.wait_for_function("() => window.__carina.state.devices.phone.num_refused === 1")
    assert workstation.state("devices.phone.connected") is False
    workstation.page.get_by_test_id("phone-switch").click()
    workstation.page.wait_for_function("() => window.__carina.state.devices.phone === null")
    assert workstation.faults == []
