"""Tests of a CT with a tilted gantry: the airway tree of the corrected CT equals that of the straight CT."""

from __future__ import annotations

import numpy as np
import pytest

from cached_test_data import SMALL_CHEST, cached_phantom
from carina.track import find_airways
from carina_bench.track_tilt import Scanner, covered_branches, detection, opened

PIXEL_MM = 1.2
"""Pixels of the scans, and voxels of the scanned phantom."""
SLICE_MM = 1.8


def trees(phantom, tilts_deg):
    """Return the shares of tree length (TD) and branches (BD) found in the straight CT and in CTs with these tilts."""
    scanners = [Scanner(tilt, pixel_mm=PIXEL_MM, slice_mm=SLICE_MM, noise_hu=0.0) for tilt in (0.0, *tilts_deg)]
    branches = covered_branches(phantom, scanners)
    assert len(branches) > 20
    found = []
    for scanner in scanners:
        volume = opened(scanner.scan(phantom.volume, seed=4), scanner.lps_from_ijk(phantom.volume))
        assert (volume.source.tilt_deg or 0.0) == pytest.approx(scanner.tilt_deg, abs=0.02)
        columns = volume.lps_from_ijk[:3, :3]
        spacing_mm = (PIXEL_MM, PIXEL_MM, SLICE_MM * np.cos(np.radians(scanner.tilt_deg)))
        np.testing.assert_allclose(columns.T @ columns, np.diag(np.square(spacing_mm)), atol=1e-4)
        airways = find_airways(volume, progress=False)
        assert "track.larynx" not in {note.code for note in airways.badges}
        found.append(detection(airways.lumen_zyx != 0, volume, branches))
    return np.array(found)


@pytest.mark.parametrize("tilts_deg", [(20.0,), pytest.param((5.0, 10.0, 15.0, 25.0, 30.0), marks=pytest.mark.soak)])
def test_tree_of_a_corrected_tilt_equals_that_of_the_straight_ct(tilts_deg):
    straight, *tilted = trees(cached_phantom(**SMALL_CHEST), tilts_deg)
    assert straight[0] > 0.9
    for one in tilted:
        np.testing.assert_allclose(one, straight, atol=0.01)
