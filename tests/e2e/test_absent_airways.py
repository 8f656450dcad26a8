"""Test of the list of lobes and segments that were not found: each has a reason and a button that shows the place."""

from __future__ import annotations

import numpy as np
import pytest
from playwright.sync_api import expect
from plugged_chest import CHEST, named, plugged

from cached_test_data import cached_airways, cached_phantom
from carina.volume import write_grid

pytestmark = pytest.mark.browser


LOST = {
    "RML (middle lobe bronchus)",
    "RLL (right lower lobe bronchus)",
    "LB1+2 (apicoposterior segment, LUL)",
    "LB3 (anterior segment, LUL)",
}


@pytest.fixture
def opens(tmp_path):
    """Return the opened file: a chest with mucus in the middle lobe bronchus and a segment of the left upper lobe."""
    volume, whole = cached_phantom(**CHEST).volume, cached_airways(**CHEST)
    for name in ("RML", "LB3"):
        volume = plugged(volume, named(whole, name), 6.0)
    # NIfTI rounds the spacing, which is enough to change the names of bronchi of the left upper lobe.
    path = tmp_path / "ct.nrrd"
    write_grid(path, volume.hu_zyx, volume.lps_from_ijk, what="a chest with mucus")
    return {"path": str(path)}


def test_missing_airway_is_listed_with_its_reason_and_a_click_shows_where_the_airway_ends(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    listed = workstation.page.get_by_test_id("absent")
    absent = workstation.state("tree.absent")
    with_place = [one["lps"] is not None for one in absent]
    assert {one["name"] for one in absent if one["lps"] is not None} == LOST

    rows = listed.locator("li")
    expect(rows.first).to_be_hidden()
    expect(listed.locator("summary")).to_have_text(f"{len(absent)} bronchi not found")
    listed.locator("summary").click()
    expect(rows.first).to_be_visible()
    for one in absent:
        row = rows.filter(has_text=one["name"])
        expect(row).to_contain_text(f": {one['reason'][:1].upper()}{one['reason'][1:]}")
        expect(row.get_by_role("button")).to_have_count(int(one["lps"] is not None))
    expect(rows).to_have_count(len({one["reason"] for one in absent}))
    lefts = {row.locator(".quiet").bounding_box()["x"] for row in rows.all()}
    assert len(lefts) == 1, "the rows are below each other, with or without a position"
    workstation.picture("absent-airways")

    listed.get_by_role("button").first.click()
    workstation.wait_for("window.__carina.state.session.sight.crosshair_lps !== null")
    lost = absent[with_place.index(True)]["lps"]
    assert workstation.state("session.sight.crosshair_lps") == pytest.approx(lost)
    workstation.wait_still()
    pose = np.reshape(workstation.state("pose.lps_from_camera"), (4, 4))
    look = lost - pose[:3, 3]
    assert pose[:3, 2] @ look / np.linalg.norm(look) > 0.999, "the airway view looks at the point"
    workstation.picture("absent-airways-looked-at")
    assert workstation.faults == []
