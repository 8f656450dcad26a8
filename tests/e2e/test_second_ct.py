"""Test of the movement of a target that is measured from a second CT in the browser."""

from __future__ import annotations

import pytest
from page_positions import place_in_slice, show_slices_at

import carina
from cached_test_data import cached_phantom
from second_scan import write_second_ct

pytestmark = pytest.mark.browser

CHEST = {"seed": 4, "spacing_mm": 1.2, "generations": 5, "nodule": True}


@pytest.fixture
def opens(tmp_path, shared_chest):
    """Return a chest with a nodule, as the opened file; its second CT is in the folder of the test."""
    volume = cached_phantom(**CHEST).volume
    write_second_ct(volume, tmp_path / "second.nii.gz")
    half = volume.hu_zyx[: len(volume.hu_zyx) // 4]
    carina.volume.write_grid(tmp_path / "half.nii.gz", half, volume.lps_from_ijk, what="half a chest")
    return shared_chest(**CHEST)


def test_second_ct_replaces_the_default_movement_and_a_ct_of_half_a_chest_is_refused(
    server, opens, workstation, tmp_path
):
    workstation.open(server)
    workstation.wait_ready()
    page, place = workstation.page, cached_phantom(**CHEST).truth["nodule"]["centre_lps"]
    show_slices_at(workstation, place)
    page.get_by_role("button", name="Target", exact=True).first.click()
    page.get_by_test_id("arm-target").click()
    page.mouse.click(*place_in_slice(workstation, "axial", place))
    workstation.wait_while_working("window.__carina.state.plans?.targets[0]?.routes.length > 0")
    page.get_by_test_id("take-route").click()
    page.get_by_test_id("movement").wait_for()
    assert "CT taken at inspiration" in page.get_by_test_id("movement").inner_text()

    page.get_by_text("Measure the movement from a second CT", exact=True).click()
    page.get_by_test_id("second-ct").fill(str(tmp_path / "half.nii.gz"))
    page.keyboard.press("Enter")
    workstation.wait_while_working("window.__carina.state.messages.some((one) => /half/.test(JSON.stringify(one)))")
    workstation.picture("second-ct-refused")
    assert workstation.state("plans.targets[0].options.movement") is None

    page.get_by_test_id("second-ct").fill(opens["path"])
    page.keyboard.press("Enter")
    workstation.wait_while_working("window.__carina.state.messages.some((one) => one.code === 'movement.same-ct')")
    assert workstation.state("plans.targets[0].options.movement") is None

    page.get_by_test_id("second-ct").fill(str(tmp_path / "second.nii.gz"))
    page.keyboard.press("Enter")
    workstation.wait_while_working("window.__carina.state.plans.targets[0].options.movement !== null")
    workstation.wait_while_working("window.__carina.state.plans.standing === 'had'")
    words = page.get_by_test_id("movement").inner_text()
    assert words.startswith("Movement of the target measured from the second CT: ")
    workstation.picture("second-ct-measured")

    # One undo restores the default movement.
    page.evaluate("() => document.activeElement?.blur()")
    page.keyboard.press("Control+z")
    workstation.wait_for("window.__carina.state.plans.targets[0].options.movement === null")


SIZES = [(1280, 720), (1440, 900), (1920, 1080)]


# The layout of the plan changes between 1280 and 1920 px; the test above measures at 1440 px.
@pytest.mark.parametrize("size", [SIZES[0], pytest.param(SIZES[1], marks=pytest.mark.soak), SIZES[2]])
def test_second_ct_is_chosen_as_a_file_or_from_the_recent_cases(server, workstation, tmp_path, size):
    page, place = workstation.page, cached_phantom(**CHEST).truth["nodule"]["centre_lps"]
    page.set_viewport_size({"width": size[0], "height": size[1]})
    workstation.open(server)
    workstation.wait_ready()
    show_slices_at(workstation, place)
    page.get_by_role("button", name="Target", exact=True).first.click()
    page.get_by_test_id("arm-target").click()
    page.mouse.click(*place_in_slice(workstation, "axial", place))
    workstation.wait_while_working("window.__carina.state.plans?.targets[0]?.routes.length > 0")
    page.get_by_test_id("answer-take-route").click()
    options = page.get_by_test_id("second-ct-options")
    page.get_by_text("Measure the movement from a second CT", exact=True).click()
    assert options.get_by_test_id("second-ct-recent").count() == 0, "the list omits the CT of the plan"
    with page.expect_file_chooser() as chooser:
        options.get_by_role("button", name="Choose file").click()
    chooser.value.set_files(str(tmp_path / "half.nii.gz"))
    workstation.wait_while_working("window.__carina.state.messages.some((one) => /half/.test(JSON.stringify(one)))")
    assert workstation.state("plans.targets[0].options.movement") is None
    options.scroll_into_view_if_needed()
    workstation.picture(f"second-ct-choice-{size[0]}")
    if size != SIZES[0]:
        return
    with page.expect_file_chooser() as chooser:
        options.get_by_role("button", name="Choose file").click()
    chooser.value.set_files(str(tmp_path / "second.nii.gz"))
    workstation.wait_while_working("window.__carina.state.plans.targets[0].options.movement !== null")
    page.evaluate("() => document.activeElement?.blur()")
    page.keyboard.press("Control+z")
    workstation.wait_for("window.__carina.state.plans.targets[0].options.movement === null")
