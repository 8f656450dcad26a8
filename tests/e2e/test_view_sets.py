"""Tests of views that the window shows together: tri-plane and tree in a wide window, three X-rays in full view."""

from __future__ import annotations

import pytest

pytestmark = pytest.mark.browser

OUTSIDE = ("tree", "tri-plane")
XRAYS = ("xray-coronal", "xray-sagittal", "xray-axial")


def resize(workstation, width: int, height: int) -> None:
    """Resize the window, and wait until the airway view has its new size."""
    workstation.page.set_viewport_size({"width": width, "height": height})
    workstation.refreshes(3)
    workstation.wait_still()


def shown(workstation, views: tuple[str, ...]) -> list[str]:
    """Return those of the views that have a canvas on the screen."""
    return [view for view in views if view in workstation.shown_views()]


def test_wide_window_shows_the_tri_plane_beside_the_tree_and_a_narrow_one_shows_one_of_them(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    page = workstation.page
    resize(workstation, 1440, 900)
    assert shown(workstation, OUTSIDE) == ["tree"]
    for size in ((1600, 900), (1920, 1080)):
        resize(workstation, *size)
        assert shown(workstation, OUTSIDE) == ["tree", "tri-plane"]
        for view in OUTSIDE:
            workstation.wait_picture(view)
            assert workstation.brightness(view) > 5.0, f"{view} is black"
        tree, planes = (page.locator(f"canvas[data-view={view}]").bounding_box() for view in OUTSIDE)
        assert tree["y"] == planes["y"]
        assert tree["x"] + tree["width"] <= planes["x"]
        workstation.picture(f"wide-{size[0]}")
        page.get_by_role("button", name="Target", exact=True).first.click()
        workstation.wait_still()
        assert shown(workstation, OUTSIDE) == ["tree", "tri-plane"]
        workstation.picture(f"wide-target-{size[0]}")
        page.get_by_role("button", name="Airways", exact=True).first.click()

    # Each of the two has its own full view, between which the key switches.
    page.get_by_role("region", name="Tri-plane").get_by_role("button", name="Full view").click()
    workstation.wait_picture("tri-plane")
    assert workstation.shown_views() == ["tri-plane"]
    page.keyboard.press("t")
    workstation.wait_picture("tree")
    assert workstation.shown_views() == ["tree"]
    page.keyboard.press("Escape")
    workstation.refreshes(2)
    assert shown(workstation, OUTSIDE) == ["tree", "tri-plane"]

    resize(workstation, 1440, 900)
    assert shown(workstation, OUTSIDE) == ["tree"]
    page.keyboard.press("t")
    workstation.wait_picture("tri-plane")
    assert shown(workstation, OUTSIDE) == ["tri-plane"]
    assert workstation.faults == []


def test_xray_in_full_view_shows_three_projections_side_by_side_on_request(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    page = workstation.page
    cell = page.get_by_role("region", name="X-ray")
    assert cell.get_by_role("radio", name="Side by side").count() == 0
    cell.get_by_role("button", name="Full view").click()
    cell.get_by_role("radio", name="Side by side").click()
    for view in XRAYS:
        workstation.wait_picture(view)
        assert workstation.brightness(view) > 20.0, f"{view} is black"
    assert sorted(workstation.shown_views()) == sorted(XRAYS)
    assert cell.locator("figcaption").all_inner_texts() == ["AP", "Lat", "Ax"]
    workstation.picture("xray-set")
    cell.get_by_role("radio", name="Lat", exact=True).click()
    workstation.wait_picture("xray-sagittal")
    assert workstation.shown_views() == ["xray-sagittal"]
    cell.get_by_role("radio", name="Side by side").click()
    page.keyboard.press("Escape")
    workstation.refreshes(2)
    assert shown(workstation, XRAYS) == ["xray-sagittal"]
    assert workstation.faults == []
