"""Tests of a WebXR headset in its manufacturer's emulation (npm iwer): it shows the airway and its controllers fly."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

pytestmark = pytest.mark.browser

EMULATION = Path(__file__).resolve().parents[2] / "web" / "node_modules" / "iwer" / "build" / "iwer.min.js"
INSTALL = """
window.headset = new IWER.XRDevice(IWER.metaQuest3, {stereoEnabled: true});
window.headset.installRuntime({forceInstall: true});
"""
# Script that returns the picture in the headset (16x8 pixels of both eyes), read in the refresh that drew it.
SHOWN = """() => new Promise((done) => requestAnimationFrame(() => {
  const small = new OffscreenCanvas(16, 8), ink = small.getContext('2d');
  ink.drawImage(document.querySelector('[data-webxr_runtime] canvas'), 0, 0, 16, 8);
  done([...ink.getImageData(0, 0, 16, 8).data]);
}))"""


@pytest.fixture
def emulated(workstation):
    """Return the page with an emulated headset."""
    if not EMULATION.is_file():
        pytest.skip("needs web/node_modules (make test-web)")
    workstation.page.add_init_script(path=EMULATION)
    workstation.page.add_init_script(INSTALL)
    return workstation


def controller(workstation, *, at_mm=(0.0, 0.0, 0.0), yaw_rad=0.0, trigger=False) -> None:
    """Move the right controller to a position relative to 30 cm in front of the head.

    A yaw to the right is positive.
    """
    workstation.page.evaluate(
        """([x, y, z, yaw, trigger]) => {
            const hand = window.headset.controllers.right;
            hand.position.set(x / 1000, 1.2 + y / 1000, -0.3 + z / 1000);
            hand.quaternion.set(0, -Math.sin(yaw / 2), 0, Math.cos(yaw / 2));
            hand.updateButtonValue('trigger', trigger ? 1 : 0);
        }""",
        [*at_mm, yaw_rad, trigger],
    )


def stroke(workstation, until: str, *, ahead_mm: float = 0.0, yaw_rad: float = 0.0) -> None:
    """Move the hand with its trigger held and back with its trigger released, repeatedly, until a condition is true.

    On a busy machine a refresh may take so long that one movement has no effect.
    """
    for _ in range(30):
        controller(workstation)
        workstation.refreshes(3)
        for n in range(13):
            controller(workstation, at_mm=(0, 0, -ahead_mm * n / 12), yaw_rad=yaw_rad * n / 12, trigger=True)
            workstation.refreshes(2)
        controller(workstation, at_mm=(0, 0, -ahead_mm), yaw_rad=yaw_rad)
        workstation.refreshes(3)
        workstation.settle()
        if workstation.page.evaluate(f"() => {until}"):
            return
    raise AssertionError(f"not after 30 strokes: {until}")


def right_and_ahead(before, after) -> tuple[float, float]:
    """Return the angle of the view's turn to the right and the movement ahead, both in the axes of the earlier view."""
    forward = [after[2], after[6], after[10]]
    right, ahead = (sum(before[4 * row + axis] * forward[row] for row in range(3)) for axis in (0, 2))
    return right, ahead


def test_headset_shows_the_airway_and_its_controller_moves_the_tip_also_after_reconnection(server, emulated):
    workstation, page = emulated, emulated.page
    workstation.open(server)
    workstation.wait_ready()
    page.keyboard.press(";")
    page.get_by_test_id("headset").click()
    page.wait_for_function("() => window.__carina.state.ui.headset === 'inside'")
    workstation.wait_still()
    page.wait_for_function("() => document.querySelector('[data-webxr_runtime] canvas') !== null")
    workstation.picture("headset-screen")
    start = page.evaluate(SHOWN)
    left_eye, right_eye = (
        [start[4 * (16 * row + column)] for row in (3, 4) for column in columns] for columns in ((3, 4), (11, 12))
    )
    assert min(max(left_eye), max(right_eye)) > 30, "both eyes see the airway, not an empty room"

    # With the trigger released a movement of the hand has no effect. With the trigger held the tip follows forward and
    # to the right.
    before = workstation.state("pose.lps_from_camera")
    at_mm = workstation.state("pose.path_mm")
    controller(workstation, at_mm=(0, 0, 40))
    workstation.let_pass(200)
    assert workstation.state("pose.lps_from_camera") == before
    controller(workstation, trigger=True)
    page.wait_for_selector("[data-testid=device][data-holds]")
    controller(workstation)
    stroke(workstation, f"window.__carina.state.pose.path_mm > {at_mm + 8}", ahead_mm=12.0)
    workstation.wait_still()
    before = workstation.state("pose.lps_from_camera")
    ahead = [before[2], before[6], before[10]]
    pose = "window.__carina.state.pose.lps_from_camera"
    cosine = " + ".join(f"{pose}[{4 * row + 2}] * {ahead[row]}" for row in range(3))
    stroke(workstation, f"{cosine} < {math.cos(0.15)}", yaw_rad=0.3)
    workstation.wait_still()
    right, ahead = right_and_ahead(before, workstation.state("pose.lps_from_camera"))
    assert 0.1 < math.atan2(right, ahead) < 0.7, "to the right, by one stroke or two"
    workstation.picture("headset-turned")
    turned = page.evaluate(SHOWN)
    assert sum(abs(a - b) for a, b in zip(start, turned, strict=True)) / len(start) > 1.0, "the screen follows"

    # The stick moves back along the path.
    page.evaluate("() => window.headset.controllers.right.updateAxes('thumbstick', 0, 1)")
    page.wait_for_function(f"() => window.__carina.state.pose.path_mm < {at_mm + 5}")
    page.evaluate("() => window.headset.controllers.right.updateAxes('thumbstick', 0, 0)")

    # The controller loses its power, so the tip stops; a new controller flies.
    page.evaluate("() => { window.headset.controllers.right.connected = false; }")
    page.wait_for_function("() => !window.__carina.state.devices.devices.some((d) => d.holds)")
    page.evaluate("() => { window.headset.controllers.right.connected = true; }")
    at_mm = workstation.state("pose.path_mm")
    stroke(workstation, f"window.__carina.state.pose.path_mm > {at_mm + 4}", ahead_mm=12.0)

    # The headset is taken off: the window continues, and the headset can be entered again.
    page.evaluate("() => window.headset.activeSession.end()")
    page.wait_for_function("() => window.__carina.state.ui.headset === 'ready'")
    workstation.hold("w", 300)
    workstation.wait_still()
    page.get_by_test_id("headset").click()
    page.wait_for_function("() => window.__carina.state.ui.headset === 'inside'")
    page.evaluate("() => window.headset.activeSession.end()")
    page.wait_for_function("() => window.__carina.state.ui.headset === 'ready'")
    assert workstation.faults == []


def test_devices_that_the_browser_does_not_support_are_listed(server, workstation):
    page = workstation.page
    page.add_init_script(
        """
        for (const name of ['xr', 'hid']) Object.defineProperty(Navigator.prototype, name, {get: () => undefined});
        delete Navigator.prototype.getGamepads;
        """
    )
    workstation.open(server)
    workstation.wait_ready()
    page.keyboard.press(";")
    text = page.get_by_text("Not supported by this browser").inner_text()
    for missing in ("gamepads", "WebHID", "WebXR"):
        assert missing in text
    assert page.get_by_test_id("headset").count() == 0
    workstation.picture("devices-missing")
    assert workstation.faults == []
