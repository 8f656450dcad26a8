"""Tests of slices and plan while a target is marked and its answer is read, in the browser."""

from __future__ import annotations

import pytest
from test_plan import CHEST, place_in_slice

import carina
from made import made_phantom

pytestmark = pytest.mark.browser


@pytest.fixture
def opens(tmp_path):
    """Return a chest with a nodule, as the opened file."""
    carina.write_phantom(made_phantom(**CHEST), tmp_path)
    return {"path": str(tmp_path / "ct.nii.gz")}


def cell(workstation, name: str):
    """Return the cell of the window that shows a slice."""
    return workstation.page.locator(f"[data-cell={name}]")


def test_slices_state_that_they_left_the_tip_and_return_on_click_and_key(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    page = workstation.page
    chips = page.get_by_test_id("follow-tip")
    assert chips.all_inner_texts() == ["following the tip"] * 3
    workstation.picture("follow-on")

    box = page.locator("canvas[data-view=coronal]").bounding_box()
    page.mouse.click(box["x"] + 0.3 * box["width"], box["y"] + 0.7 * box["height"])
    workstation.wait_for("window.__carina.state.session.sight.crosshair_lps !== null")
    assert chips.all_inner_texts() == ["not following the tip"] * 3
    workstation.picture("follow-off")
    cell(workstation, "axial").get_by_role("button", name="Slices are not following the tip").click()
    workstation.wait_for("window.__carina.state.session.sight.crosshair_lps === null")
    assert chips.all_inner_texts() == ["following the tip"] * 3

    page.mouse.click(box["x"] + 0.3 * box["width"], box["y"] + 0.7 * box["height"])
    workstation.wait_for("window.__carina.state.session.sight.crosshair_lps !== null")
    page.keyboard.press("c")
    workstation.wait_for("window.__carina.state.session.sight.crosshair_lps === null")
    assert chips.all_inner_texts() == ["following the tip"] * 3
    assert workstation.faults == []


@pytest.mark.parametrize("size", [(1440, 900), (1920, 1080), (1280, 720)])
def test_follow_chip_covers_no_orientation_letter(server, workstation, size):
    width, height = size
    workstation.page.set_viewport_size({"width": width, "height": height})
    workstation.open(server)
    workstation.wait_ready()
    workstation.page.keyboard.press("t")
    for name in ("axial", "coronal", "sagittal"):
        picture = cell(workstation, name).locator(".cell-picture").bounding_box()
        chip = cell(workstation, name).get_by_test_id("follow-tip").bounding_box()
        letter = picture["x"] + picture["width"] / 2 + 6
        assert chip["x"] > letter
        assert chip["y"] > picture["y"] + picture["height"] / 2 + 8
    workstation.picture(f"follow-{width}")


def test_value_under_a_still_pointer_follows_the_slice(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    page, centre = workstation.page, made_phantom(**CHEST).truth["nodule"]["centre_lps"]
    page.mouse.move(*place_in_slice(workstation, "axial", centre))
    workstation.wait_for("window.__carina.state.probed !== null")
    shown = page.get_by_test_id("cursor")
    for _ in range(400):
        at = workstation.state("frames.axial.lps_from_pixel[11]")
        if abs(at - centre[2]) < 1.0:
            break
        page.mouse.wheel(0, 100 if at > centre[2] else -100)
        workstation.wait_for("(at) => Math.abs(window.__carina.state.frames.axial.lps_from_pixel[11] - at) > 0.01", at)
    # The pointer has not moved since the first slice.
    workstation.wait_for(f"Math.abs(window.__carina.state.probed.lps[2] - {centre[2]}) < 1.2")
    workstation.wait_for("window.__carina.state.probed.voxel_value > -100")
    assert "HU" in shown.inner_text()
    workstation.picture("value-still-pointer")
    assert workstation.faults == []
