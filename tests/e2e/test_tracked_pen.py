"""Test of a tracked pen in the browser: its point is shown and marked; without registration the scope's tip is used."""

from __future__ import annotations

import itertools

import pytest
from page_positions import named, show_slices_at, tree_is_shown
from playwright.sync_api import expect

pytestmark = pytest.mark.browser

# Script that returns the page's connection, by which the test sends the samples of a pen.
SPEAK = """
window.WebSocket = class extends WebSocket {
  constructor(...options) { super(...options); window.__speak = (text) => super.send(text); }
};
"""


class HeldPen:
    """Pen whose tracker is 100 mm to the left of the patient."""

    def __init__(self, workstation):
        self.workstation, self.now_s = workstation, itertools.count(1)

    def send(self, **message) -> None:
        self.workstation.page.evaluate("(message) => window.__speak(JSON.stringify(message))", message)

    def hold(self, lps, buttons=0) -> None:
        self.send(
            type="device_sample",
            device="test pen",
            time_s=0.05 * next(self.now_s),
            position_mm=[lps[0] - 100.0, lps[1], lps[2]],
            orientation_wxyz=[1.0, 0.0, 0.0, 0.0],
            axes=None,
            buttons=buttons,
            handle=None,
            advance=0.0,
        )

    def register(self, at) -> None:
        patient = [[at[0] + x, at[1] + y, at[2] + z] for x, y, z in ((0, 0, 0), (50, 0, 0), (0, 50, 0))]
        tracker = [[p[0] - 100.0, p[1], p[2]] for p in patient]
        self.send(type="calibrate", device="test pen", tracker_mm=tracker, patient_lps=patient)
        self.workstation.wait_for("() => window.__carina.state.devices?.devices.some((d) => d.registered)")


def test_tip_of_a_registered_pen_is_shown_with_its_path_and_marked_by_its_button(server, workstation):
    page = workstation.page
    page.add_init_script(SPEAK)
    workstation.open(server)
    workstation.wait_ready()
    tree_is_shown(workstation)
    workstation.wait_for("() => ['axial', 'coronal', 'sagittal'].every((v) => window.__carina.state.frames[v])")
    points = page.evaluate("(id) => window.__carina.state.tree.byId.get(id).branch.points", named(workstation, "LMB"))
    middle = points[len(points) // 2]
    show_slices_at(workstation, middle)
    pen = HeldPen(workstation)

    # Without a registration the pen marks the tip of the scope, which the tool's panel and the footer state.
    pen.hold(middle)
    page.keyboard.press("n")
    text = page.locator("[data-testid=pen-words]")
    expect(text).to_have_text("The pen is not registered: its button marks the position of the scope tip.")
    expect(page.locator("[data-testid=tool-hint]")).to_contain_text("its button marks the position of the scope tip")
    workstation.picture("pen-not-registered")

    before = {view: workstation.overlay(view) for view in ("axial", "coronal", "sagittal", "tree")}
    pen.register(middle)
    expect(text).to_contain_text("pen tip")
    pen.hold(middle)
    workstation.wait_for("(x) => Math.abs(window.__carina.state.pen.lps[0] - x) < 0.01", middle[0])
    # The path to the pen is shown even while the mouse rests over a picture.
    workstation.wait_for("() => (window.__carina.state.livePath?.answer.length_mm ?? 0) > 100")
    answer = workstation.state("livePath.answer")
    assert max(abs(a - b) for a, b in zip(answer["lps"], middle, strict=True)) < 3.0
    for view, drawn in before.items():
        workstation.wait_for(
            "([view, drawn]) => document.querySelector(`[data-overlay=${view}]`).toDataURL() !== drawn",
            [view, drawn],
        )
    workstation.picture("pen-registered")
    pen.hold(middle, buttons=1)
    pen.hold(middle)
    workstation.wait_for("() => window.__carina.state.session.targets.length === 1")
    (target,) = workstation.state("session.targets")
    assert max(abs(a - b) for a, b in zip(target["lps"], middle, strict=True)) < 0.1
    # The tool is released after one use, as after a click.
    workstation.wait_for("() => window.__carina.state.ui.armed === null")

    # In absolute mode the remaining distance is shown until it is zero, and a key joins tip and pen.
    pen.send(type="set_control", control="absolute")
    pen.hold([middle[0] + 1.0, middle[1], middle[2]])
    left = page.locator("[data-testid=pen-offset]")
    expect(left).to_contain_text("mm")
    assert workstation.state("pen.off_mm") > 5.0
    page.keyboard.press(";")
    expect(page.locator("[data-testid=join-pen]")).to_be_visible()
    workstation.picture("pen-away-from-the-tip")
    page.keyboard.press("Shift+M")
    expect(left).to_have_count(0)
    expect(page.locator("[data-testid=join-pen]")).to_have_count(0)
    tip = [workstation.state(f"pose.lps_from_camera[{n}]") for n in (3, 7, 11)]
    assert max(abs(a - b) for a, b in zip(tip, [middle[0] + 1.0, *middle[1:]], strict=True)) < 0.1
    workstation.picture("pen-joined")
    assert workstation.faults == []
