"""Tests of the import of another program's mask: chosen or dropped, with questions, refusals and undo."""

from __future__ import annotations

import numpy as np
import pytest
import SimpleITK as sitk
from playwright.sync_api import expect
from workstation import assert_accessible

from carina.phantom import demo_phantom

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def masks(tmp_path_factory):
    """Return mask files of other programs: with two structures, on a coarser grid, and at another position."""
    made = demo_phantom()
    folder = tmp_path_factory.mktemp("masks")
    spacing = np.array(made.volume.spacing_mm)
    origin = made.volume.lps_from_ijk[:3, 3]

    def write(name, labels, scale=1, shift_mm=0.0):
        image = sitk.GetImageFromArray(labels.astype(np.uint8))
        image.SetSpacing((spacing * scale).tolist())
        image.SetDirection((made.volume.lps_from_ijk[:3, :3] / spacing).ravel().tolist())
        image.SetOrigin((origin + shift_mm).tolist())
        sitk.WriteImage(image, str(folder / name), True)
        return folder / name

    labels = (made.lumen_zyx != 0) * 2
    # The mask contains only the upper airways, while the search finds all branches.
    labels[: len(labels) // 4] = 0
    labels[:3, :3, :3] = 1
    coarse = made.lumen_zyx[::2, ::2, ::2] != 0
    return {
        "several": write("several.nrrd", labels),
        "coarse": write("coarse.nii.gz", coarse, scale=2),
        "elsewhere": write("elsewhere.nii.gz", coarse, scale=2, shift_mm=5000.0),
    }


@pytest.fixture
def ready(server, workstation):
    """Return a page with the case open."""
    workstation.open(server)
    workstation.wait_ready()
    yield workstation
    assert workstation.faults == []


def drop(workstation, path, place):
    """Drag a file from outside over the window, and drop it on one of the two targets."""
    page = workstation.page
    link = page.context.new_cdp_session(page)
    data = {"items": [], "files": [str(path)], "dragOperationsMask": 1}

    def at(kind, x, y):
        link.send("Input.dispatchDragEvent", {"type": kind, "x": x, "y": y, "data": data})

    at("dragEnter", 20, 20)
    at("dragOver", 30, 30)
    box = page.locator(f"[data-testid=drop-{place}]").bounding_box()
    middle = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    at("dragOver", *middle)
    workstation.picture("mask-dragged")
    assert_accessible(workstation.page, "mask-dragged")
    at("drop", *middle)
    link.detach()


def test_import_of_a_mask_with_two_structures_needs_a_selection_and_is_undone(ready, masks):
    page = ready.page
    branches = ready.state("tree.byId.size")
    page.get_by_role("button", name="Open", exact=True).click()
    with page.expect_file_chooser() as chooser:
        page.locator("[data-testid=choose-mask]").first.click()
    chooser.value.set_files(str(masks["several"]))
    page.locator("[data-testid=mask-question]").wait_for()
    expect(page.locator("[data-testid=mask-answer]")).to_be_disabled()
    page.get_by_text("Label 2", exact=True).click()
    ready.picture("mask-labels")
    page.locator("[data-testid=mask-answer]").click()
    ready.wait_for("window.__carina.state.airways_from === 'mask'")
    assert ready.state("can_undo") == "use the segmentation for the airways"
    expect(page.locator("[data-testid=mask-question]")).to_have_count(0)
    ready.wait_for(f"window.__carina.state.tree.byId.size < {branches}")
    page.get_by_role("button", name="Airways", exact=True).click()
    page.locator("details.part > summary").first.click()
    expect(page.get_by_text("Imported segmentation: compare it")).to_be_visible()
    ready.picture("mask-taken")
    page.keyboard.press("Control+z")
    ready.wait_for("window.__carina.state.airways_from === 'search'")
    ready.wait_for(f"window.__carina.state.tree.byId.size === {branches}")


def test_dropped_mask_on_another_grid_is_resampled_only_after_confirmation(ready, masks):
    page = ready.page
    drop(ready, masks["coarse"], "mask")
    page.locator("[data-testid=mask-question]").wait_for()
    ready.picture("mask-grid")
    assert ready.state("airways_from") == "search"
    # A job that measures the airways may still run, and has a button of the same name.
    page.get_by_test_id("mask-question").get_by_role("button", name="Cancel").click()
    ready.wait_for("window.__carina.state.mask_question === null")
    assert (ready.state("airways_from"), ready.state("can_undo")) == ("search", None)
    drop(ready, masks["coarse"], "mask")
    page.locator("[data-testid=mask-answer]").click()
    ready.wait_for("window.__carina.state.airways_from === 'mask'")
    assert "was on a different grid" in ready.state("airways_words")
    page.keyboard.press("Control+z")
    ready.wait_for("window.__carina.state.airways_from === 'search'")


def test_mask_that_does_not_overlap_the_scan_is_refused_with_a_message(ready, masks):
    drop(ready, masks["elsewhere"], "mask")
    ready.page.get_by_text("none of it lies in the scan").wait_for()
    ready.picture("mask-refused")
    assert ready.state("mask_question") is None
    assert ready.state("airways_from") == "search"


def test_mask_is_not_imported_if_another_case_was_opened_during_the_upload(ready, masks, tmp_path):
    page = ready.page
    made = demo_phantom().volume
    image = sitk.GetImageFromArray(np.ascontiguousarray(made.hu_zyx[:40]))
    image.SetSpacing(made.spacing_mm)
    image.SetDirection((made.lps_from_ijk[:3, :3] / np.array(made.spacing_mm)).ravel().tolist())
    image.SetOrigin(made.lps_from_ijk[:3, 3].tolist())
    sitk.WriteImage(image, str(tmp_path / "other.nrrd"))
    # The upload of this file takes long.
    page.evaluate(
        """() => {
            const send = window.fetch;
            window.held = false;
            const freed = new Promise((free) => { window.free = free; });
            window.fetch = async (address, options) => {
                if (options?.method === 'PUT') { window.held = true; await freed; }
                return send(address, options);
            };
        }"""
    )
    page.get_by_role("button", name="Open", exact=True).first.click()
    page.get_by_placeholder("/data/ct/series").fill(str(tmp_path / "other.nrrd"))
    drop(ready, masks["coarse"], "mask")
    ready.wait_for("window.held")
    page.locator(".path-form button[type=submit]").evaluate("button => button.click()")
    ready.wait_for("window.__carina.state.case?.ct_name === 'other.nrrd'")
    page.evaluate("() => window.free()")
    page.get_by_text("Another case was opened during the upload").wait_for()
    assert ready.state("mask_question") is None
