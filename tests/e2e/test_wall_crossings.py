"""Tests of the marks on the route's ruler where a path by the cost walls crosses the wall of the lumen."""

from __future__ import annotations

import re

import pytest
from page_positions import place_in_slice, show_slices_at
from playwright.sync_api import expect

pytestmark = pytest.mark.browser


def test_ruler_marks_every_place_where_a_path_by_walls_crosses_the_lumens_wall(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    page = workstation.page
    page.get_by_role("button", name="Target", exact=True).click()
    details = page.get_by_test_id("target-details").locator("summary")
    details.click()
    page.get_by_role("radio", name="Walls").click()
    page.keyboard.press("Escape")
    # With closed details the panel still states the selected path search.
    details.click()
    expect(page.get_by_test_id("path-search-cost")).to_contain_text("Path search: Walls")
    root = workstation.state("session.root_lps")
    beside = [root[0] + 30.0, root[1], root[2] - 60.0]
    show_slices_at(workstation, beside)
    page.locator("[data-testid=arm-target]").click()
    page.mouse.click(*place_in_slice(workstation, "axial", beside))
    workstation.wait_for("window.__carina.state.session.targets.length === 1")
    workstation.wait_for("window.__carina.state.route?.target_id !== null")
    crossings = workstation.state("session.targets[0].crossings_mm")
    assert crossings
    marks = page.get_by_test_id("wall-crossing")
    expect(marks).to_have_count(len(crossings))
    track = page.locator(".path-track").bounding_box()
    length = workstation.state("route.length_mm")
    # The path was not searched in the airways, so the ruler measures along the path itself.
    assert workstation.state("route.centreline_mm") == workstation.state("route.cumulative_mm")
    origin_mm = workstation.state("route.origin.along_mm")
    for number, along in enumerate(crossings):
        box = marks.nth(number).bounding_box()
        assert box["x"] + box["width"] / 2 - track["x"] == pytest.approx(along / length * track["width"], abs=1.5)
        # The mark has the origin of the ruler, not the start of the path.
        title = marks.nth(number).get_attribute("title")
        assert title.startswith("Crosses the airway wall, ")
        stated = float(re.search(r"(\d+)\u202fmm", title).group(1))
        assert stated == pytest.approx(abs(along - origin_mm), abs=0.51)
        assert title.endswith(("the main carina", "from the start of the airway tree", "from the start of the route"))
    times = "once" if len(crossings) == 1 else f"{len(crossings)} times"
    expect(page.get_by_label(f"the path crosses the airway wall {times}").first).to_be_attached()
    expect(page.get_by_test_id("target-words")).to_contain_text("crosses the wall")
    workstation.picture("wall-crossings")
    assert workstation.faults == []
