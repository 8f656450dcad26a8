"""Tests of the command ``carina isoregion``, which writes the IsoRegion map of a scan to a file (paper 4.2)."""

from __future__ import annotations

import numpy as np
import pytest
import SimpleITK as sitk

import carina as product
from carina.render import build_isoregion_map, isoregion_map, transfer_preset


@pytest.mark.parametrize("name", ["map.nrrd", "map.nii.gz"])
@pytest.mark.parametrize("transfer", [None, "endoscopic"])
def test_isoregion_file_contains_the_map_on_the_grid_of_the_scan(carina, ct, tmp_path, name, transfer):
    output = tmp_path / name
    options = [] if transfer is None else ["--transfer", transfer]
    ended = carina("isoregion", ct, "-o", output, *options, "--json")
    assert ended.code == 0, ended.err
    volume = product.open_volume(ct)
    radii = isoregion_map(volume, None if transfer is None else transfer_preset(transfer))
    image = sitk.ReadImage(str(output))
    assert np.array_equal(sitk.GetArrayFromImage(image), radii)
    place = volume.to_lps(np.array([1.0, 2.0, 3.0])).tolist()
    assert image.TransformIndexToPhysicalPoint((1, 2, 3)) == pytest.approx(place, abs=1e-3)
    result = ended.json()
    assert result["equal_by"] == ("values" if transfer is None else "classes")
    assert result["largest_radius"] == radii.max()
    assert result["share_with_equal_neighbours"] == pytest.approx((radii > 0).mean())


def test_isoregion_file_has_labels_for_bins_of_16_hu(ct):
    volume = product.open_volume(ct)
    bins = (volume.hu_zyx.astype(np.int32) + 32768) // 16
    # Each bin has a label; a CT has at most 255 bins, because more labels would not fit into 8 bits.
    labels = np.unique(bins, return_inverse=True)[1].reshape(bins.shape)
    assert labels.max() < 255
    assert np.array_equal(isoregion_map(volume), build_isoregion_map((labels + 1).astype(np.uint8)))
