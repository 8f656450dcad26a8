"""Tests of input devices that fly, are lost and return: simulated browser devices, a serial port, a network tracker."""

from __future__ import annotations

import itertools
import math
import struct
import sys
import time

import numpy as np
import pytest
from playwright.sync_api import expect
from workstation import PICTURE_MS

pytestmark = pytest.mark.browser

# Script that replaces the Gamepad API by a pad that the test moves; vibrations are recorded.
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


def hold(workstation, axes, pressed=()) -> None:
    workstation.page.evaluate("([axes, pressed]) => window.holdPad(axes, pressed)", [list(axes), list(pressed)])


def test_gamepad_moves_the_tip_changes_modes_and_works_after_reconnection(server, workstation):
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

    # Y selects the next steering mode; A flies to the next fork.
    hold(workstation, (0, 0, 0, 0), [3])
    workstation.page.wait_for_function("() => window.__carina.state.pose.mode === 'free'")
    hold(workstation, (0, 0, 0, 0))
    # In free mode the tip moves at full speed sideways into the wall, so the pad vibrates.
    hold(workstation, (0, -1, 1, 0))
    workstation.page.wait_for_function("() => window.testRumble.length > 0")

    workstation.page.evaluate("() => window.pullPad()")
    workstation.page.wait_for_function("() => !window.__carina.state.devices.devices.some(d => d.holds)")
    workstation.wait_still()
    stopped = workstation.state("pose.pose_id")
    workstation.let_pass(300)
    assert workstation.state("pose.pose_id") == stopped

    # After the pad was connected again, buttons that were held at that moment have no effect, and the pad flies.
    hold(workstation, (0, 0, 0, 0), [3])
    workstation.let_pass(200)
    assert workstation.state("pose.mode") == "free"
    hold(workstation, (0, 0, 0, -1))
    workstation.page.wait_for_function(f"() => window.__carina.state.pose.pose_id > {stopped}")
    hold(workstation, (0, 0, 0, 0))
    assert workstation.faults == []


# Script that replaces WebHID by two devices that the test moves; their descriptions are those of real devices.
HID_MOCK = """
class Device extends EventTarget {
  constructor(vendorId, productName, collections) {
    super();
    Object.assign(this, {vendorId, productId: 1, productName, collections, opened: false});
  }
  async open() { this.opened = true; }
  async close() { this.opened = false; }
  report(reportId, bytes) {
    if (!this.opened) return;
    const data = new DataView(Uint8Array.from(bytes).buffer);
    this.dispatchEvent(Object.assign(new Event('inputreport'), {reportId, data}));
  }
}
const item = (usages, reportSize, low, high, more = {}) => ({
  usages, reportSize, reportCount: usages.length, logicalMinimum: low, logicalMaximum: high, isArray: false, ...more,
});
const axes = (first) => item([first, first + 1, first + 2], 16, -350, 350);
const page = 0xff42 * 65536, end = 99999999;
window.testHid = {
  mouse: new Device(0x256f, 'SpaceMouse Test', [{usagePage: 1, usage: 8, children: [], inputReports: [
    {reportId: 1, items: [axes(0x10030)]}, {reportId: 2, items: [axes(0x10033)]}]}]),
  handle: new Device(0x2341, 'Test handle', [{usagePage: 0xff42, usage: 1, children: [], inputReports: [
    {reportId: 1, items: [item([page + 0x21], 32, 0, 2147483647), item([page + 0x22, page + 0x23], 32, -end, end),
      item([page + 0x24], 16, -1000, 1000), item([0x90001, 0x90002], 1, 0, 1), item([], 6, 0, 1)]}]}]),
};
const hid = Object.assign(new EventTarget(), {
  requestDevice: async ({filters}) => [filters[0].usagePage === 0xff42 ? window.testHid.handle : window.testHid.mouse],
});
window.plug = (name, event) => hid.dispatchEvent(Object.assign(new Event(event), {device: window.testHid[name]}));
Object.defineProperty(navigator, 'hid', {value: hid});
"""


def hid_report(workstation, name: str, report_id: int, data: bytes) -> None:
    workstation.page.evaluate("([n, id, b]) => window.testHid[n].report(id, b)", [name, report_id, list(data)])


def test_spacemouse_and_usb_handle_move_the_tip_and_work_after_reconnection(server, workstation):
    page = workstation.page
    page.add_init_script(HID_MOCK)
    workstation.open(server)
    workstation.wait_ready()
    page.keyboard.press(";")
    page.get_by_role("radio", name="Path").click()
    page.wait_for_function("() => window.__carina.state.pose.mode === 'path'")
    page.get_by_text("SpaceMouse", exact=True).click()
    page.wait_for_function("() => window.testHid.mouse.opened")

    def push_the_cap() -> None:
        """Push the cap of the SpaceMouse from far along the route until the tip has moved back."""
        # A push towards the user pulls the tip back, which needs a position beyond the start of the route.
        workstation.go_to(30.0)
        workstation.wait_still()
        # Like a real device the simulated one reports while it is pushed; a device silent for 250 ms counts as
        # released.
        moved = page.evaluate(
            """async ([pushed, fromMm, limitMs]) => {
                const end = performance.now() + limitMs;
                while (window.__carina.state.pose.path_mm > fromMm - 2) {
                    if (performance.now() > end) return false;
                    window.testHid.mouse.report(1, pushed);
                    await new Promise((done) => setTimeout(done, 20));
                }
                return true;
            }""",
            [list(struct.pack("<3h", 0, 350, 0)), workstation.state("pose.path_mm"), PICTURE_MS],
        )
        assert moved, workstation.state("pose")
        hid_report(workstation, "mouse", 1, struct.pack("<3h", 0, 0, 0))
        workstation.wait_still()

    push_the_cap()
    page.evaluate("() => window.plug('mouse', 'disconnect')")
    page.wait_for_function("() => !window.testHid.mouse.opened")
    page.evaluate("() => window.plug('mouse', 'connect')")
    page.wait_for_function("() => window.testHid.mouse.opened")
    push_the_cap()

    page.get_by_test_id("ask-handle").click()
    page.wait_for_function("() => window.testHid.handle.opened")
    clock = itertools.count(1000, 20)

    def push_the_handle(from_mm: float, by_mm: float) -> None:
        """Insert the shaft of the handle by ``by_mm``, and wait until the tip has moved by this length.

        A device that is silent for 250 ms counts as released. So on a busy machine the tip moves less far, never
        farther, and the push is repeated.
        """
        begin_mm = workstation.state("pose.path_mm")
        for attempt in range(30):
            if attempt > 0:
                workstation.go_to(begin_mm)
                workstation.wait_still()
            # The hand returns while the handle sends no samples and its clock continues, as with a real handle. Within
            # 250 ms of this clock the tip would move back as well.
            list(itertools.islice(clock, 50))
            before_mm = workstation.state("pose.path_mm")
            shaft = [round(100 * (from_mm + by_mm * n / 40)) for n in range(41)]
            reports = [list(struct.pack("<Iiihb", next(clock), insertion, 0, 0, 0)) for insertion in shaft]
            page.evaluate(
                """async (reports) => {
                    for (const bytes of reports) {
                        window.testHid.handle.report(1, bytes);
                        await new Promise((done) => setTimeout(done, 20));
                    }
                }""",
                reports,
            )
            workstation.wait_still()
            went_mm = workstation.state("pose.path_mm") - before_mm
            assert -0.25 * by_mm < went_mm < 1.25 * by_mm, "the movement is relative to the present tip and smoothed"
            if went_mm > 0.75 * by_mm:
                return
        raise AssertionError("not in 30 pushes")

    push_the_handle(500.0, 10.0)
    page.evaluate("() => window.plug('handle', 'disconnect')")
    page.wait_for_function("() => !window.__carina.state.devices.devices.some(d => d.holds)")
    page.evaluate("() => window.plug('handle', 'connect')")
    page.wait_for_function("() => window.testHid.handle.opened")
    # Meanwhile the handle was moved by 30 cm, which does not move the tip.
    push_the_handle(200.0, 10.0)
    workstation.picture("devices-hid")
    # Half a report and a lever value beyond its range are reported once, and the handle continues to work.
    hid_report(workstation, "handle", 1, b"\x00\x01")
    hid_report(workstation, "handle", 1, struct.pack("<Iiihb", next(clock), 21000, 0, 9000, 0))
    page.get_by_text("do not match its HID descriptor").wait_for()
    push_the_handle(210.0, 5.0)
    assert workstation.faults == []


def test_network_tracker_moves_the_tip_after_registration_and_after_a_lost_connection(server, workstation):
    from carina.navigate.devices import IgtlServer

    page = workstation.page
    workstation.open(server)
    workstation.wait_ready()
    page.keyboard.press(";")
    page.wait_for_selector("[data-testid=device-panel]")
    # In relative control, whatever earlier tests chose, sideways tremor moves nothing along the path.
    page.get_by_test_id("control-relative").click()
    place = np.eye(4)
    began = time.monotonic()

    def pose() -> np.ndarray:
        # The position trembles, as with every tracker.
        moved = place.copy()
        moved[0, 3] += 0.2 * math.sin(40.0 * (time.monotonic() - began))
        return moved

    tracker = IgtlServer(pose, port=0)
    tracker.start()
    try:
        field = page.locator(".device-panel input")
        field.fill(f"openigtlink:127.0.0.1:{tracker.port}")
        field.press("Enter")
        page.wait_for_function("() => window.__carina.state.devices?.sources[0]?.state === 'live'")
        page.wait_for_selector("[data-testid=device][data-holds]")
        page.get_by_text("Calibrate", exact=True).click()
        expect(page.locator("details.calibration")).to_have_attribute("open", "")
        corners = [(0.0, 0.0, 0.0), (40.0, 0.0, 0.0), (0.0, 40.0, 0.0)]
        for n, corner in enumerate(corners):
            place[:3, 3] = corner
            x, y = -corner[0], -corner[1]  # the window shows LPS or RAS, as the tracker reports
            page.wait_for_function(
                # The list also contains devices of earlier tests.
                "([x, y]) => { const all = window.__carina.state.devices.devices;"
                " const at = all.find((each) => each.position_mm !== null)?.position_mm ?? [9e9, 9e9];"
                " return Math.abs(Math.abs(at[0]) - Math.abs(x)) < 1 && Math.abs(Math.abs(at[1]) - Math.abs(y)) < 1; }",
                arg=[x, y],
            )
            page.get_by_test_id("take-pair").click()
            expect(page.locator(".calibration p.numbers")).to_have_count(n + 1)
        workstation.picture("devices-calibration")
        port = tracker.port
    finally:
        tracker.stop()
    page.wait_for_function("() => window.__carina.state.devices.sources[0].state !== 'live'")
    expect(page.locator("details.calibration")).to_have_count(0)
    workstation.wait_still()
    stopped = workstation.state("pose.pose_id")
    workstation.let_pass(300)
    assert workstation.state("pose.pose_id") == stopped
    tracker = IgtlServer(pose, port=port)
    tracker.start()
    try:
        page.wait_for_function("() => window.__carina.state.devices.sources[0].state === 'live'")
        page.wait_for_function(f"() => window.__carina.state.pose.pose_id > {stopped}")
        # The calibration continues at the same step.
        expect(page.locator("details.calibration")).to_have_attribute("open", "")
        expect(page.locator(".calibration p.numbers")).to_have_count(len(corners))
    finally:
        tracker.stop()
    page.get_by_text("Disconnect").click()
    page.wait_for_function("() => window.__carina.state.devices.sources.length === 0")
    assert workstation.faults == []


def test_mouse_locked_to_the_picture_turns_the_view_until_it_is_released(server, workstation):
    page = workstation.page
    workstation.open(server)
    workstation.wait_ready()
    workstation.wait_still()
    before = workstation.state("pose.lps_from_camera")
    page.keyboard.press("Control+Enter")
    page.wait_for_function("() => window.__carina.state.ui.mouseLocked")
    for n in range(10):
        page.mouse.move(500 + 20 * n, 450)
        workstation.refreshes(2)
    page.wait_for_function(f"() => Math.abs(window.__carina.state.pose.lps_from_camera[2] - {before[2]}) > 0.02")
    page.evaluate("() => document.exitPointerLock()")
    page.wait_for_function("() => !window.__carina.state.ui.mouseLocked")
    workstation.wait_still()
    stopped = workstation.state("pose.pose_id")
    page.mouse.move(300, 600)
    workstation.let_pass(200)
    assert workstation.state("pose.pose_id") == stopped
    page.keyboard.press("Control+Enter")
    page.wait_for_function("() => window.__carina.state.ui.mouseLocked")
    page.evaluate("() => document.exitPointerLock()")
    assert workstation.faults == []


@pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals on Windows")
def test_scope_handle_connected_in_the_devices_panel_moves_the_tip_and_is_recorded(server, workstation):
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
