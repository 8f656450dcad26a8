"""Devices in the hand, end to end: a gamepad of the browser and a scope handle at a serial port fly the phantom."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import pytest
from server_process import Server, start_server, stop_server

pytestmark = pytest.mark.browser

# The browser's API with a pad that the test moves; what it shakes is noted.
MOCK = """
window.testPad = null; window.testRumble = [];
const pad = (axes, pressed) => ({
  index: 0, id: 'Test pad', connected: true, mapping: 'standard', timestamp: performance.now(), axes,
  buttons: Array.from({length: 17}, (_, n) => ({pressed: pressed.includes(n), value: pressed.includes(n) ? 1 : 0})),
  vibrationActuator: {playEffect: (_, effect) => { window.testRumble.push(effect); return Promise.resolve(); }},
});
window.holdPad = (axes, pressed = []) => { window.testPad = pad(axes, pressed); };
window.pullPad = () => { window.testPad = null; };
navigator.getGamepads = () => [window.testPad, null, null, null];
"""


@pytest.fixture(scope="module")
def server(tmp_path_factory) -> Iterator[Server]:
    """``carina demo phantom``."""
    running = start_server(["demo", "phantom"], tmp_path_factory.mktemp("home"))
    yield running
    code = stop_server(running)
    assert code == 0
    assert running.errors() == []


def hold(workstation, axes, pressed=()) -> None:
    workstation.page.evaluate("([axes, pressed]) => window.holdPad(axes, pressed)", [list(axes), list(pressed)])


def test_a_gamepad_flies_changes_the_mode_is_shown_and_may_be_pulled_out(server, workstation):
    workstation.page.add_init_script(MOCK)
    workstation.open(server)
    workstation.wait_ready()
    workstation.page.click("[data-testid=open-devices]")
    workstation.page.wait_for_selector("[data-testid=device-panel]")
    hold(workstation, (0, 0, 0, 0))
    start_mm, pixels = workstation.state("pose.path_mm"), workstation.pixels("airway")

    hold(workstation, (0, -1, 0, 0))
    workstation.page.wait_for_selector("[data-testid=device][data-holds]")
    workstation.page.wait_for_function(f"() => window.__carina.state.pose.path_mm > {start_mm + 15}")
    workstation.picture("devices-gamepad")
    hold(workstation, (0, 0, 0, 0))
    workstation.wait_still()
    newest = workstation.state("pose.pose_id")
    assert workstation.frame_answers("airway", newest)
    assert workstation.pixels("airway") != pixels

    # Y: the next way to move; A: on to the next fork.
    hold(workstation, (0, 0, 0, 0), [3])
    workstation.page.wait_for_function("() => window.__carina.state.pose.mode === 'free'")
    hold(workstation, (0, 0, 0, 0))
    # Free, and full speed sideways: into the wall, which is felt.
    hold(workstation, (0, -1, 1, 0))
    workstation.page.wait_for_function("() => window.testRumble.length > 0", timeout=20_000)

    workstation.page.evaluate("() => window.pullPad()")
    workstation.page.wait_for_function("() => !window.__carina.state.devices.devices.some(d => d.holds)")
    workstation.wait_still()
    stopped = workstation.state("pose.pose_id")
    workstation.page.wait_for_timeout(300)
    assert workstation.state("pose.pose_id") == stopped
    assert workstation.faults == []


@pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals on Windows")
def test_a_scope_handle_is_connected_in_the_panel_flies_and_is_recorded(server, workstation):
    from carina.navigate.devices.scope_handle import format_line
    from simulated_serial import PseudoPort, sending

    workstation.open(server)
    workstation.wait_ready()
    page = workstation.page
    page.evaluate("() => window.__carina.state.pose.mode")
    page.keyboard.press(";")
    page.wait_for_selector("[data-testid=device-panel]")
    port = PseudoPort()
    try:
        page.click("[data-testid=record]")
        page.wait_for_function("() => window.__carina.state.devices?.recording !== null")
        field = page.locator(".device-panel input")
        field.fill(f"handle:{port.path}")
        field.press("Enter")
        page.wait_for_selector("[data-testid=source]")
        before = workstation.state("pose.pose_id")
        with sending(lambda n: format_line(n, 10 * n, 0.1 * n, roll_deg=0.2 * n), port, rate_hz=100.0):
            page.wait_for_function(f"() => window.__carina.state.pose.pose_id > {before + 20}")
            page.wait_for_function("() => window.__carina.state.devices.sources[0].state === 'live'")
            workstation.picture("devices-handle")
        page.click("[data-testid=record]")
        page.wait_for_function("() => window.__carina.state.devices?.recording === null")
    finally:
        port.unplug()
    page.wait_for_function("() => window.__carina.state.devices.sources[0].state !== 'live'")
    page.get_by_text("Disconnect").click()
    page.wait_for_function("() => window.__carina.state.devices.sources.length === 0")
    assert workstation.faults == []
