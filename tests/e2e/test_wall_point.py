"""Tests of clicks in the airway view: each shows and marks a wall point and moves the slices to it."""

from __future__ import annotations

import math
import re

import pytest

pytestmark = pytest.mark.browser


def wall_point(workstation, num_picks):
    """Wait until ``num_picks`` wall points were shown, and return the newest one."""
    workstation.page.wait_for_function("(n) => window.__carina.state.picks.length === n", arg=num_picks)
    workstation.wait_still()
    return workstation.state("picks.at(-1)")


def test_first_click_on_the_wall_marks_its_point_and_a_second_click_shows_the_distance(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    workstation.go_to(20.0)
    workstation.wait_still()
    unmarked = workstation.overlay("airway")
    workstation.click_airway(0.2, 0.5)
    first = wall_point(workstation, 1)
    tip = workstation.state("pose.lps_from_camera")[3::4][:3]
    lumen_mm = workstation.state("pose.lumen_mm")
    apart = math.dist(first["lps"], tip)
    assert apart == pytest.approx(first["depthMm"], abs=0.02)
    assert 0.3 * lumen_mm < apart < 4.0 * lumen_mm, "the wall beside the tip"
    assert first["branchName"] == "Trachea"
    reading = workstation.page.locator("[data-testid=wall-point]")
    assert re.search(
        r"[LR].\d+\.\d\s+[AP].\d+\.\d\s+[SI].\d+\.\d mm\nTrachea, generation 0\n[\d.]+.mm away when clicked\n.?\d+ HU",
        reading.inner_text(),
    )
    assert workstation.overlay("airway") != unmarked
    # The slices show the wall point, as a clicked point of a slice.
    assert workstation.state("session.sight.crosshair_lps") == pytest.approx(first["lps"], abs=0.01)

    workstation.click_airway(0.8, 0.5)
    second = wall_point(workstation, 2)
    assert f"{math.dist(first['lps'], second['lps']):.1f}" in reading.inner_text()
    workstation.picture("wall-points")

    # The mark is fixed to the wall: after a movement its position in the picture differs, but the point is the same.
    marked = workstation.overlay("airway")
    workstation.hold("w", 500)
    workstation.wait_still()
    workstation.picture("wall-points-after-moving")
    assert workstation.overlay("airway") != marked
    assert workstation.state("picks.at(-1).lps") == second["lps"]
    workstation.page.keyboard.press("Escape")
    workstation.page.wait_for_function("() => window.__carina.state.picks.length === 0")
    assert not reading.count()
    workstation.page.keyboard.press("c")
    assert workstation.faults == []


def test_key_marks_the_wall_point_in_the_middle_and_a_double_click_marks_none(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    workstation.page.keyboard.press("e")
    middle = wall_point(workstation, 1)
    matrix = workstation.state("pose.lps_from_camera")
    ray = [m - t for m, t in zip(middle["lps"], matrix[3::4], strict=False)]
    forward = matrix[2::4]
    along = sum(a * b for a, b in zip(ray, forward, strict=False))
    # The picked pixel is the one nearest to the middle, so the ray differs by at most the angle of a pixel.
    assert along == pytest.approx(math.hypot(*ray), rel=1e-3)
    workstation.page.keyboard.press("Escape")
    workstation.page.keyboard.press("c")
    workstation.page.wait_for_function("() => window.__carina.state.session.sight.crosshair_lps === null")

    workstation.click_airway(0.3, 0.4, twice=True)
    workstation.page.wait_for_function("() => window.__carina.state.ui.full === 'airway'")
    workstation.wait_still()
    assert workstation.state("picks.length") == 0
    assert workstation.state("session.sight.crosshair_lps") is None
    workstation.page.keyboard.press("Escape")

    # A drag still turns the view, and picks no wall point.
    box = workstation.page.locator("canvas[data-view=airway]").bounding_box()
    workstation.page.mouse.move(box["x"] + 200, box["y"] + 200)
    workstation.page.mouse.down()
    workstation.page.mouse.move(box["x"] + 260, box["y"] + 220, steps=4)
    workstation.page.mouse.up()
    workstation.wait_still()
    assert workstation.state("pose.lps_from_camera") != matrix
    assert workstation.state("picks.length") == 0
    assert workstation.faults == []


def test_click_on_the_wall_with_the_target_tool_adds_a_target(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    workstation.page.keyboard.press("n")
    workstation.click_airway(0.5, 0.25)
    workstation.page.wait_for_function("() => window.__carina.state.targets.length === 1")
    assert workstation.state("picks.length") == 0
    assert workstation.state("ui.armed") is None
    assert workstation.faults == []
