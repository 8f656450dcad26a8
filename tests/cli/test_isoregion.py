"""Tests of the command ``carina isoregion``, which writes the IsoRegion map of a scan to a file (paper 4.2)."""

from __future__ import annotations

import numpy as np
import pytest
import SimpleITK as sitk

import carina as product
from carina.render import build_isoregion_map, isoregion_map, transfer_preset
from carina.volume import write_grid


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
    assert result["equal_by"] == ("bins of 16" if transfer is None else "classes")
    assert f"compared by {'bins of 16' if transfer is None else 'the transfer function endoscopic'}" in ended.err
    assert result["largest_radius"] == radii.max()
    assert result["share_with_equal_neighbours"] == pytest.approx((radii > 0).mean())


@pytest.fixture
def scan_in_8_bits(ct, tmp_path):
    """Return a scan with the 256 values of 8 bits, and its volume."""
    volume = product.open_volume(ct)
    values = np.clip((volume.hu_zyx.astype(np.int32) + 1000) // 5, 0, 255).astype(np.int16)
    values.reshape(-1)[:256] = np.arange(256)
    path = tmp_path / "in-8-bits.nii.gz"
    write_grid(path, values, volume.lps_from_ijk, what="the scan")
    return path, product.open_volume(path)


def test_isoregion_map_of_at_most_256_values_compares_values(carina, scan_in_8_bits, tmp_path):
    path, volume = scan_in_8_bits
    ended = carina("isoregion", path, "-o", tmp_path / "map.nrrd", "--json")
    assert ended.code == 0, ended.err
    assert ended.json()["equal_by"] == "values"
    radii = isoregion_map(volume)
    assert np.array_equal(sitk.GetArrayFromImage(sitk.ReadImage(str(tmp_path / "map.nrrd"))), radii)
    # A radius of 1 or more means 26 neighbours of the same value.
    inner = volume.hu_zyx[1:-1, 1:-1, 1:-1]
    equal = np.ones(inner.shape, dtype=bool)
    nz, ny, nx = volume.shape_zyx
    for dz, dy, dx in np.ndindex(3, 3, 3):
        equal &= volume.hu_zyx[dz : nz - 2 + dz, dy : ny - 2 + dy, dx : nx - 2 + dx] == inner
    assert np.array_equal(radii[1:-1, 1:-1, 1:-1] > 0, equal)
    assert np.array_equal(isoregion_map(volume, equal_by="values"), radii)
    bins = carina("isoregion", path, "-o", tmp_path / "bins.nrrd", "--equal-by", "bins", "--json")
    assert bins.json()["equal_by"] == "bins of 16"
    assert bins.json()["share_with_equal_neighbours"] >= ended.json()["share_with_equal_neighbours"]


def test_rarest_of_256_values_has_regions(rng):
    values = rng.permutation(np.arange(6**3 * 2) % 255).reshape(12, 6, 6).astype(np.int16)
    values = np.repeat(values, 5, axis=2)
    values[:3, :3, :3] = 255
    volume = product.Volume(values, np.eye(4))
    assert len(np.unique(values)) <= 256
    assert isoregion_map(volume)[1, 1, 1] == 1


def test_more_than_256_values_and_a_wrong_comparison_are_refused(carina, ct, tmp_path):
    output = tmp_path / "map.nrrd"
    ended = carina("isoregion", ct, "-o", output, "--equal-by", "values")
    assert ended.code == 2
    assert "at most 256 different values" in ended.err
    assert "bins of 16" in ended.err
    assert carina("isoregion", ct, "-o", output, "--equal-by", "classes").code == 2
    assert carina("isoregion", ct, "-o", output, "--equal-by", "bins", "--transfer", "paper").code == 2
    assert not output.exists()


def test_isoregion_file_has_labels_for_bins_of_16_hu(ct):
    volume = product.open_volume(ct)
    bins = (volume.hu_zyx.astype(np.int32) + 32768) // 16
    # Each bin has a label; a CT has at most 255 bins, because more labels would not fit into 8 bits.
    labels = np.unique(bins, return_inverse=True)[1].reshape(bins.shape)
    assert labels.max() < 255
    assert np.array_equal(isoregion_map(volume), build_isoregion_map((labels + 1).astype(np.uint8)))
