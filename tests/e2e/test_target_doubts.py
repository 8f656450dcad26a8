"""Test of the question whether a doubtful target shall be planned, in the browser."""

from __future__ import annotations

import numpy as np
import pytest
from page_positions import show_slices_at
from test_plan import place_in_slice
from workstation import assert_accessible

import carina
from cached_test_data import cached_phantom
from carina.volume import Volume

pytestmark = pytest.mark.browser

CHEST = {"seed": 4, "spacing_mm": 1.2, "generations": 5, "nodule": True}
DENSE_HU = 280


@pytest.fixture
def opens(tmp_path):
    """Return a chest whose nodule is as dense as bone, as the opened file."""
    made = cached_phantom(**CHEST)
    truth, volume = made.truth["nodule"], made.volume
    hu = np.array(volume.hu_zyx)
    k, j, i = np.indices(volume.shape_zyx)
    points = volume.to_lps(np.stack([i, j, k], axis=-1).astype(float))
    hu[np.linalg.norm(points - np.array(truth["centre_lps"]), axis=-1) < truth["radius_mm"]] = DENSE_HU
    dense = Volume(hu, volume.lps_from_ijk)
    path = tmp_path / "ct.nii.gz"
    carina.volume.write_grid(path, dense.hu_zyx, dense.lps_from_ijk, what="a chest")
    return {"path": str(path)}


def test_doubtful_target_is_planned_only_after_the_user_confirms_it(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    page, centre = workstation.page, cached_phantom(**CHEST).truth["nodule"]["centre_lps"]
    show_slices_at(workstation, centre)
    page.get_by_role("button", name="Target", exact=True).first.click()
    page.get_by_test_id("arm-target").click()
    page.mouse.click(*place_in_slice(workstation, "axial", centre))
    lesion = page.get_by_test_id("lesion")
    lesion.wait_for()
    confirm = page.get_by_role("button", name="Plan it", exact=True)
    confirm.wait_for()
    # The question scrolls into view in the narrow column.
    workstation.wait_for(
        """() => {
            const { top, bottom } = document.querySelector("[data-testid=target-question]").getBoundingClientRect();
            return top >= 0 && bottom <= window.innerHeight;
        }"""
    )
    assert "denser than soft tissue" in lesion.inner_text()
    assert workstation.state("plans.targets[0].routes") == []
    workstation.picture("target-doubt-question")
    assert_accessible(workstation.page, "target-doubt-question")
    confirm.click()
    workstation.wait_for("window.__carina.state.plans.targets[0].routes.length > 0")
    assert confirm.count() == 0
    # The confirmed doubt stays visible.
    assert "denser than soft tissue" in lesion.inner_text()
    workstation.picture("target-doubt-confirmed")
    page.keyboard.press("Control+z")
    confirm.wait_for()
