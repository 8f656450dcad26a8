"""Tests of the command ``carina isoregion``, which writes the IsoRegion map of a scan to a file (paper 4.2)."""

from __future__ import annotations

import gzip
import shutil

import numpy as np
import pytest
import SimpleITK as sitk

import carina as product
from carina.errors import VolumeImportError
from carina.render import AirwayView, build_isoregion_map, isoregion_map, open_isoregion_map, transfer_preset
from carina.scopes import Pose
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


@pytest.mark.parametrize("name", ["map.nrrd", "map.nii.gz", "map.nii", "map.mha"])
@pytest.mark.parametrize("transfer", [None, "endoscopic"])
def test_isoregion_file_is_read_back_with_the_volume_and_the_labels_from_which_it_was_made(
    carina, ct, tmp_path, name, transfer
):
    file = tmp_path / name
    options = [] if transfer is None else ["--transfer", transfer]
    written = carina("isoregion", ct, "-o", file, *options, "--json")
    assert written.code == 0, written.err
    volume = product.open_volume(ct)
    chosen = None if transfer is None else transfer_preset(transfer)
    assert np.array_equal(open_isoregion_map(file, volume, chosen), isoregion_map(volume, chosen))
    read = carina("isoregion", ct, "--map", file, *options, "--json")
    assert read.code == 0, read.err
    assert read.json() == written.json()
    assert "is the map of this scan" in read.err


@pytest.fixture
def map_file(carina, ct, tmp_path):
    """Return the IsoRegion map of the scan, compared by values."""
    file = tmp_path / "map.nrrd"
    assert carina("isoregion", ct, "-o", file).code == 0
    return file


def _refusal(file, volume, transfer=None) -> str:
    with pytest.raises(VolumeImportError) as caught:
        open_isoregion_map(file, volume, transfer)
    assert caught.value.code == "import.isoregion-map"
    options = "" if transfer is None else f" --transfer {transfer.name}"
    assert str(caught.value).endswith(f"compute the map again with: carina isoregion SCAN -o {file.name}{options}")
    return str(caught.value)


def test_isoregion_map_of_another_grid_volume_or_labelling_is_refused_with_the_reason(ct, map_file):
    volume = product.open_volume(ct)
    moved = volume.lps_from_ijk.copy()
    moved[0, 3] += 1.0
    assert "its grid differs from that of the scan" in _refusal(map_file, product.Volume(volume.hu_zyx, moved))
    assert "its grid differs" in _refusal(map_file, product.Volume(volume.hu_zyx[1:], volume.lps_from_ijk))
    other = volume.hu_zyx.copy()
    other[2, 2, 2] += 1
    assert "the IsoRegion map of another volume" in _refusal(map_file, product.Volume(other, volume.lps_from_ijk))
    endoscopic = transfer_preset("endoscopic")
    assert "equal by the transfer function endoscopic" in _refusal(map_file, volume, endoscopic)


def test_file_that_is_not_an_isoregion_map_is_refused(carina, ct, tmp_path, map_file):
    volume = product.open_volume(ct)
    assert "its values are int16" in _refusal(ct, volume)
    plain = tmp_path / "plain.nrrd"
    write_grid(plain, isoregion_map(volume), volume.lps_from_ijk, what="a map")
    assert "it is not an IsoRegion map of Carina" in _refusal(plain, volume)
    text = tmp_path / "map.txt"
    text.write_text("no map")
    assert "it is not a NIfTI, NRRD or MetaImage file" in _refusal(text, volume)
    assert "there is no such file" in _refusal(tmp_path / "missing.nrrd", volume)
    newer = tmp_path / "newer.nrrd"
    newer.write_bytes(map_file.read_bytes().replace(b"carina-isoregion 1 ", b"carina-isoregion 2 "))
    assert "of format 2" in _refusal(newer, volume)
    ended = carina("isoregion", ct, "--map", plain, "--json")
    assert (ended.code, ended.json()["error"]["code"]) == (3, "import.isoregion-map")


def test_damaged_isoregion_map_is_refused(ct, tmp_path, map_file):
    volume = product.open_volume(ct)
    radii = isoregion_map(volume)
    file = tmp_path / "map.nii"
    note = map_file.read_bytes().split(b"note:=", 1)[1].split(b"\n", 1)[0].decode()
    radii[1, 1, 1] += 1
    write_grid(file, radii, volume.lps_from_ijk, what="a map", note=note)
    assert "the file is damaged" in _refusal(file, volume)
    short = tmp_path / "short.nrrd"
    short.write_bytes(map_file.read_bytes()[:-20])
    with pytest.raises(VolumeImportError, match=r"short\.nrrd"):
        open_isoregion_map(short, volume)
    packed = tmp_path / "packed.nii.gz"
    with gzip.open(packed, "wb") as out, file.open("rb") as source:
        shutil.copyfileobj(source, out)
    packed.write_bytes(packed.read_bytes()[:-30])
    with pytest.raises(VolumeImportError, match=r"packed\.nii\.gz"):
        open_isoregion_map(packed, volume)


def test_isoregion_command_needs_exactly_one_of_output_and_map(carina, ct, tmp_path):
    for options in ([], ["-o", tmp_path / "a.nrrd", "--map", tmp_path / "b.nrrd"]):
        ended = carina("isoregion", ct, *options)
        assert ended.code == 2
        assert "-o writes the map, --map reads a map" in ended.err


def test_picture_with_a_map_from_a_file_equals_that_with_a_built_map(ct, map_file, monkeypatch):
    volume = product.open_volume(ct)
    renderer = product.Renderer(volume, transfer=transfer_preset("paper"))
    renderer.use_isoregion_map(map_file)
    calls = []
    monkeypatch.setattr("carina.render.scene._core.build_radius_map", lambda *_, **__: calls.append(1))
    renderer.prepare(progress=False)
    assert not calls
    monkeypatch.undo()
    built = product.Renderer(volume, transfer=transfer_preset("paper"))
    built.prepare(progress=False)
    view = AirwayView(Pose.looking(volume.centre_lps, (0.0, 0.1, -1.0)), width=64, height=64, shading=False)
    assert np.array_equal(renderer.render(view).rgb, built.render(view).rgb)
    renderer.use_isoregion_map(None)


def test_map_by_another_comparison_is_refused_for_a_picture_and_no_map_of_a_file_is_cached(carina, tmp_path):
    grid = np.arange(6 * 24 * 24, dtype=np.int16).reshape(6, 24, 24) % 40
    volume = product.Volume(np.ascontiguousarray(grid), np.diag([1.0, 1.0, 1.0, 1.0]))
    scan, bins, values = (tmp_path / name for name in ("scan.nrrd", "bins.nrrd", "values.nrrd"))
    write_grid(scan, volume.hu_zyx, volume.lps_from_ijk, what="a scan")
    for file, comparison in ((bins, "bins"), (values, "values")):
        assert carina("isoregion", scan, "-o", file, "--equal-by", comparison).code == 0
    renderer = product.Renderer(volume, transfer=transfer_preset("paper"), cache_dir=tmp_path / "cache")
    with pytest.raises(VolumeImportError, match="compared in another way"):
        renderer.use_isoregion_map(bins)
    renderer.use_isoregion_map(values)
    renderer.prepare(progress=False)
    renderer.wait_stored()
    stored = [file.stat().st_size for file in (tmp_path / "cache").rglob("*") if file.is_file()]
    again = product.Renderer(volume, transfer=transfer_preset("paper"), cache_dir=tmp_path / "cache2")
    again.prepare(progress=False)
    again.wait_stored()
    assert len(stored) < len([file for file in (tmp_path / "cache2").rglob("*") if file.is_file()])
