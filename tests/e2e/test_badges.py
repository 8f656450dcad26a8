"""Test of quality warnings of a scan: a badge beside the title, and the first entry of the step Check."""

from __future__ import annotations

import numpy as np
import pytest
import SimpleITK as sitk
from playwright.sync_api import expect

from carina.phantom import demo_phantom

pytestmark = pytest.mark.browser

WORDS = "5 voxels are not finite (NaN or infinite)"


@pytest.fixture
def opens(tmp_path):
    """Return the phantom as a file of floats with coarse voxels, of which five are NaN."""
    volume = demo_phantom().volume
    values = volume.hu_zyx[::2, ::2, ::2].astype(np.float32)
    values[0, 0, :5] = np.nan
    image = sitk.GetImageFromArray(values)
    image.SetSpacing([2.0 * mm for mm in volume.spacing_mm])
    image.SetDirection((volume.lps_from_ijk[:3, :3] / volume.spacing_mm).ravel().tolist())
    image.SetOrigin(volume.lps_from_ijk[:3, 3].tolist())
    sitk.WriteImage(image, str(tmp_path / "ct.nrrd"))
    return {"path": str(tmp_path / "ct.nrrd")}


def test_quality_warning_is_always_shown_beside_the_title_and_leads_to_the_step_check(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    page = workstation.page
    badge = page.get_by_test_id("doubts")
    expect(badge).to_have_text("2 findings")
    page.get_by_role("button", name="Rehearse").click()
    expect(badge).to_be_visible()
    badge.hover()
    expect(page.get_by_role("tooltip")).to_contain_text(WORDS)
    # Voxels of 2.4 mm may hide airways.
    expect(page.get_by_role("tooltip")).to_contain_text("An airway that is not in the tree may still be there")
    workstation.picture("doubt-tooltip")
    badge.click()
    expect(page.locator(".findings li").first).to_contain_text(WORDS)
    expect(page.get_by_test_id("not-hu")).to_have_count(0)
    assert workstation.faults == []
    workstation.picture("doubt-check")
