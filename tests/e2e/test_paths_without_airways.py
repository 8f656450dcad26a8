"""Tests of a scan without airways in the browser: start and target by click, a path, and a flight."""

from __future__ import annotations

import numpy as np
import pytest
from page_positions import place_in_slice, place_in_tri_plane, show_slices_at
from playwright.sync_api import expect

from carina.volume import write_grid
from vessel_phantom import bent_vessel

pytestmark = pytest.mark.browser

FAILED_SEARCH = "window.__carina.state.session?.airways === 'failed' && window.__carina.state.pose !== null"


@pytest.fixture(scope="module")
def vessel(tmp_path_factory):
    """Return the file of a scan with a bent vessel, and the start, the corner and the end of the vessel, LPS mm."""
    volume, inside, root, corner, end = bent_vessel()
    scan = tmp_path_factory.mktemp("vessel") / "vessel.nii.gz"
    write_grid(scan, volume.hu_zyx, volume.lps_from_ijk, what="the scan")
    return scan, volume, inside, *(point.tolist() for point in (root, corner, end))


@pytest.fixture
def opens(vessel):
    return {"demo": None, "path": str(vessel[0])}


@pytest.fixture
def opened(server, workstation):
    """Return a page with the scan open, in which no airways were found."""
    workstation.open(server)
    workstation.wait_for(FAILED_SEARCH)
    workstation.page.get_by_role("button", name="Target", exact=True).click()
    yield workstation
    assert workstation.faults == []


def mark(workstation, tool, lps):
    show_slices_at(workstation, lps)
    workstation.page.locator(f"[data-testid=arm-{tool}]").click()
    workstation.page.mouse.click(*place_in_slice(workstation, "axial", lps))


def test_path_between_clicked_start_and_target_can_be_flown(opened, vessel):
    _, volume, inside, root, _, end = vessel
    page = opened.page
    page.get_by_role("radio", name="Walls").click()
    # The tool that sets the missing start is active at once.
    assert opened.state("ui.armed") == "start"
    page.keyboard.press("Escape")
    mark(opened, "start", root)
    opened.wait_for("window.__carina.state.ui.pathStart !== null")
    mark(opened, "target", end)
    opened.wait_for("window.__carina.state.route !== null")
    text = page.locator("[data-testid=target-words]")
    expect(text).to_contain_text("cost walls")
    expect(text).to_contain_text("not compared with a lumen")
    route = opened.state("route")
    assert route["lumen_known"] is False
    points = np.array(route["points_lps"])
    i, j, k = np.rint(volume.to_ijk(points)).astype(int).T
    assert inside[k, j, i].mean() > 0.97
    # The error of a click is at most half a pixel of the slice.
    assert np.linalg.norm(points[0] - root) < 1.5
    assert np.linalg.norm(points[-1] - end) < 1.5
    opened.picture("any-scan-target")
    page.get_by_role("button", name="Route", exact=True).click()
    expect(page.locator("[data-testid=lumen-unknown]")).to_be_visible()
    expect(page.get_by_text("Narrowest")).to_have_count(0)
    page.get_by_role("button", name="Fly from the start").click()
    opened.wait_for("window.__carina.state.pose.mode === 'path'")
    opened.go_to(route["length_mm"] / 2)
    opened.wait_still()
    assert opened.state("pose.lumen_mm") is None
    expect(page.locator(".ruler-spans")).not_to_contain_text("generation")
    opened.picture("any-scan-flown")


def test_missing_start_is_reported_and_undo_removes_a_path(opened, vessel):
    _, _, _, root, corner, _ = vessel
    page = opened.page
    page.get_by_role("button", name="Target", exact=True).first.click()
    assert page.get_by_text("Paper", exact=True).is_hidden(), "in the details only"
    page.get_by_test_id("target-details").locator("summary").click()
    page.get_by_test_id("cost-paper").click()
    page.keyboard.press("Escape")
    mark(opened, "target", corner)
    expect(page.get_by_text("Mark the start point first")).to_be_visible()
    assert opened.state("session.targets") == []
    mark(opened, "start", root)
    mark(opened, "target", corner)
    opened.wait_for("window.__carina.state.session.targets.length === 1")
    assert opened.state("session.targets[0].cost") == "paper"
    page.keyboard.press("Control+z")
    opened.wait_for("window.__carina.state.session.targets.length === 0 && window.__carina.state.route === null")


def test_start_and_target_are_set_by_clicks_in_tri_plane_and_airway_view(opened, vessel):
    _, _, _, root, _, _ = vessel
    page = opened.page
    page.get_by_role("radio", name="Walls").click()
    page.keyboard.press("Escape")
    # The planes of the tri-plane view meet at the crosshair.
    show_slices_at(opened, root)
    page.keyboard.press("t")
    opened.wait_for("() => document.querySelector('canvas[data-view=tri-plane]')?.dataset.full === 'true'")
    page.locator("[data-testid=arm-start]").click()
    page.mouse.click(*place_in_tri_plane(opened, root))
    opened.wait_for("window.__carina.state.ui.pathStart !== null")
    assert np.linalg.norm(np.subtract(opened.state("ui.pathStart"), root)) < 1.5
    page.locator("[data-testid=arm-target]").click()
    # The point in the airway view is a voxel in front of the visible wall of the vessel.
    opened.click_airway(0.72, 0.5)
    opened.wait_for("window.__carina.state.session.targets.length === 1")
    assert opened.state("session.targets[0].problem") is None
    assert opened.state("ui.armed") is None
    opened.wait_for("window.__carina.state.route !== null")
    opened.picture("any-scan-airway-click")


@pytest.mark.data
class TestTheHead:
    """Path in the CT headsq: an oblique grid with voxels of 3.2 mm, and values that are not HU."""

    @pytest.fixture
    def vessel(self, data_dir):
        return (data_dir / "ct" / "head_and_lidc2_8bit" / "headsq_64x64x93_int16.mha",)

    def test_path_through_the_nose_is_drawn_and_flown(self, opened):
        page = opened.page
        page.get_by_role("radio", name="Walls").click()
        page.keyboard.press("Escape")
        # The points, checked by eye, are in the nasopharynx and in air in front of it.
        mark(opened, "start", [18.822, 140.192, 48.0])
        mark(opened, "target", [-6.234, 151.590, 48.0])
        opened.wait_for("window.__carina.state.route !== null")
        expect(page.locator("[data-testid=target-words]")).to_contain_text("values ")
        assert opened.state("session.targets[0].value_range")[1] < 900
        page.get_by_role("button", name="Route", exact=True).click()
        page.get_by_role("button", name="Fly from the start").click()
        opened.wait_for("window.__carina.state.pose.mode === 'path'")
        opened.go_to(10.0)
        opened.wait_still()
        opened.picture("any-scan-head")
