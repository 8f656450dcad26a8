"""Tests of ``carina isoregion --with-scan``, which writes a scan and its IsoRegion map to one file (paper 4.2)."""

from __future__ import annotations

import gzip
import itertools

import numpy as np
import pytest
import SimpleITK as sitk

import carina as product
from carina.errors import VolumeImportError
from carina.render import isoregion_labels, isoregion_map, isoregion_note, open_isoregion_map, transfer_preset
from carina.volume import write_grid


@pytest.fixture
def bundle(carina, ct, tmp_path):
    """Return the scan with its map by values in one file."""
    file = tmp_path / "bundle.nrrd"
    ended = carina("isoregion", ct, "-o", file, "--with-scan")
    assert ended.code == 0, ended.err
    assert "scan and map written" in ended.err
    return file


def _edit_stream(file, change):
    """Change the decompressed bytes (map, then voxels) of a file; its header stays."""
    head, stream = file.read_bytes().split(b"\n\n", 1)
    content = bytearray(gzip.decompress(stream))
    change(content)
    file.write_bytes(head + b"\n\n" + gzip.compress(bytes(content)))


def _edit_header(file, old, new):
    content = file.read_bytes()
    assert old in content
    file.write_bytes(content.replace(old, new, 1))


def _refusal(call) -> str:
    with pytest.raises(VolumeImportError) as caught:
        call()
    assert caught.value.code == "import.isoregion-map"
    return str(caught.value)


def test_scan_with_its_map_opens_as_the_scan(ct, bundle):
    scan, opened = product.open_volume(ct), product.open_volume(bundle)
    assert np.array_equal(opened.hu_zyx, scan.hu_zyx)
    assert np.array_equal(opened.lps_from_ijk, scan.lps_from_ijk)
    assert (opened.is_hu, opened.not_hu_reason) == (scan.is_hu, scan.not_hu_reason)
    assert opened.source.notes == ()


def test_bright_corners_of_a_scan_with_its_map_stay(ct, tmp_path):
    volume, file = product.open_volume(ct), tmp_path / "bundle.nrrd"
    bright = volume.hu_zyx.copy()
    ends = [slice(0, 16), slice(-16, None)]
    for corner in itertools.product(ends, ends, ends):
        bright[corner] = 3000
    plain = write_grid(tmp_path / "plain.nrrd", bright, volume.lps_from_ijk, what="the scan")
    # Without a map, such corners are padding that the file does not state.
    assert not np.array_equal(product.open_volume(plain).hu_zyx, bright)
    scan = product.Volume(bright, volume.lps_from_ijk)
    radii = isoregion_map(scan)
    note = isoregion_note(scan, isoregion_labels(scan, None), radii)
    write_grid(file, bright, volume.lps_from_ijk, what="the scan", note=note, before=radii)
    assert np.array_equal(product.open_volume(file).hu_zyx, bright)


def test_other_programs_open_a_scan_with_its_map_as_the_scan(ct, bundle):
    scan, image = product.open_volume(ct), sitk.ReadImage(str(bundle))
    assert np.array_equal(sitk.GetArrayFromImage(image), scan.hu_zyx)
    place = scan.to_lps(np.array([1.0, 2.0, 3.0])).tolist()
    assert image.TransformIndexToPhysicalPoint((1, 2, 3)) == pytest.approx(place, abs=1e-6)


@pytest.mark.parametrize("options", [[], ["--transfer", "endoscopic"], ["--equal-by", "bins"]])
def test_map_is_read_from_the_file_of_its_scan(carina, ct, tmp_path, options):
    file = tmp_path / "bundle.nrrd"
    written = carina("isoregion", ct, "-o", file, "--with-scan", *options, "--json")
    assert written.code == 0, written.err
    chosen = transfer_preset("endoscopic") if "--transfer" in options else None
    comparison = "bins" if "bins" in options else "auto"
    for scan in (ct, file):
        volume = product.open_volume(scan)
        radii = open_isoregion_map(file, volume, chosen, equal_by=comparison)
        assert np.array_equal(radii, isoregion_map(volume, chosen, equal_by=comparison))
        read = carina("isoregion", scan, "--map", file, *options, "--json")
        assert read.code == 0, read.err
        assert read.json() == written.json()


def test_commands_open_a_scan_with_its_map(carina, ct, bundle, tmp_path):
    pictures = []
    for name, scan in (("scan", ct), ("bundle", bundle)):
        output = tmp_path / f"{name}.png"
        ended = carina("render", scan, "--view", "xray-coronal", "--size", "80x80", "-o", output)
        assert ended.code == 0, ended.err
        pictures.append(sitk.GetArrayFromImage(sitk.ReadImage(str(output))))
    assert np.array_equal(*pictures)
    found = [carina("info", scan, "--json").json() for scan in (ct, bundle)]
    assert found[0]["shape_zyx"] == found[1]["shape_zyx"]
    # The map of a scan with a map is computed again like that of every other scan.
    again = tmp_path / "again.nrrd"
    assert carina("isoregion", bundle, "-o", again, "--with-scan").code == 0
    assert again.read_bytes() == bundle.read_bytes()


def test_paper_mode_uses_the_map_in_the_file_of_the_scan(bundle, monkeypatch):
    volume = product.open_volume(bundle)
    renderer = product.Renderer(volume, transfer=transfer_preset("paper"))
    renderer.use_isoregion_map(bundle)
    calls = []
    monkeypatch.setattr("carina.render.scene._core.build_radius_map", lambda *_, **__: calls.append(1))
    renderer.prepare(progress=False)
    assert not calls


def test_changed_voxels_or_a_changed_map_are_refused_when_the_scan_is_opened(carina, ct, bundle):
    volume = product.open_volume(ct)
    num_voxels = volume.hu_zyx.size
    good = bundle.read_bytes()

    def raise_byte(at):
        def change(content):
            content[at] = (content[at] + 1) % 256

        return change

    for at, problem in (
        (num_voxels // 2, "its IsoRegion map was changed after it was written"),
        (num_voxels, "its voxels are not those from which its IsoRegion map was computed"),
        (3 * num_voxels - 2, "its voxels are not those from which its IsoRegion map was computed"),
    ):
        bundle.write_bytes(good)
        _edit_stream(bundle, raise_byte(at))
        message = _refusal(lambda: product.open_volume(bundle))
        assert problem in message
        assert message.endswith("carina isoregion SCAN -o bundle.nrrd --with-scan")
        ended = carina("info", bundle, "--json")
        assert (ended.code, ended.json()["error"]["code"]) == (3, "import.isoregion-map")


def test_truncated_scan_with_its_map_is_refused(ct, bundle):
    volume = product.open_volume(ct)
    good = bundle.read_bytes()
    begin = good.index(b"\n\n") + 2
    for size in (len(good) - 20, begin + 40, begin):
        bundle.write_bytes(good[:size])
        with pytest.raises(VolumeImportError, match=r"bundle\.nrrd"):
            product.open_volume(bundle)
    # The map precedes the voxels, so only a file that ends within the map has none.
    for size in (begin + 40, begin):
        bundle.write_bytes(good[:size])
        with pytest.raises(VolumeImportError, match=r"bundle\.nrrd"):
            open_isoregion_map(bundle, volume)


def test_map_of_another_scan_or_comparison_is_refused_with_an_advice_that_keeps_the_scan(ct, bundle):
    volume = product.open_volume(ct)
    advice = "carina isoregion SCAN -o bundle.nrrd --with-scan"
    moved = volume.lps_from_ijk.copy()
    moved[0, 3] += 1.0
    other = volume.hu_zyx.copy()
    other[2, 2, 2] += 1
    for requested, transfer, problem, options in (
        (product.Volume(volume.hu_zyx, moved), None, "its grid differs from that of the scan", ""),
        (product.Volume(other, volume.lps_from_ijk), None, "the IsoRegion map of another volume", ""),
        (volume, transfer_preset("endoscopic"), "voxels were compared in another way", " --transfer endoscopic"),
    ):
        message = _refusal(
            lambda requested=requested, transfer=transfer: open_isoregion_map(bundle, requested, transfer)
        )
        assert problem in message
        assert advice in message
        assert message.endswith(options)


def test_scan_with_a_map_of_a_later_format_opens_and_its_map_is_refused(ct, bundle):
    _edit_header(bundle, b"carina-isoregion 1 ", b"carina-isoregion 2 ")
    volume = product.open_volume(bundle)
    assert np.array_equal(volume.hu_zyx, product.open_volume(ct).hu_zyx)
    assert "of format 2" in _refusal(lambda: open_isoregion_map(bundle, volume))


def test_nrrd_with_skipped_bytes_and_no_map_opens_as_the_scan(ct, tmp_path):
    volume, file = product.open_volume(ct), tmp_path / "skipped.nrrd"
    before = np.arange(1000, dtype=np.uint8)
    write_grid(file, volume.hu_zyx, volume.lps_from_ijk, what="the scan", before=before)
    assert np.array_equal(product.open_volume(file).hu_zyx, volume.hu_zyx)
    assert "values are int16" in _refusal(lambda: open_isoregion_map(file, volume))


def test_map_does_not_replace_its_scan(carina, bundle):
    before = bundle.read_bytes()
    ended = carina("isoregion", bundle, "-o", bundle)
    assert ended.code == 2
    assert "would be replaced" in ended.err
    assert bundle.read_bytes() == before
    assert carina("isoregion", bundle, "-o", bundle, "--with-scan").code == 0
    assert bundle.read_bytes() == before


def test_writing_a_scan_with_its_map_to_the_file_of_the_scan_is_refused(carina, ct, tmp_path):
    scan = tmp_path / "scan.nrrd"
    volume = product.open_volume(ct)
    write_grid(scan, volume.hu_zyx, volume.lps_from_ijk, what="the scan", note="written by another program")
    before = scan.read_bytes()
    ended = carina("isoregion", scan, "-o", scan, "--with-scan")
    assert ended.code == 2
    assert "would be replaced" in ended.err
    assert scan.read_bytes() == before


def test_scan_with_its_map_needs_an_output_in_nrrd(carina, ct, bundle, tmp_path):
    for name in ("bundle.nii.gz", "bundle.mha"):
        ended = carina("isoregion", ct, "-o", tmp_path / name, "--with-scan")
        assert ended.code == 2
        assert ".nrrd" in ended.err
        assert not (tmp_path / name).exists()
    ended = carina("isoregion", ct, "--map", bundle, "--with-scan")
    assert ended.code == 2
    assert "-o FILE.nrrd" in ended.err
    volume = product.open_volume(ct)
    with pytest.raises(product.errors.UsageError, match=r"must be written as \.nrrd"):
        write_grid(
            tmp_path / "a.mha", volume.hu_zyx, volume.lps_from_ijk, what="the scan", before=np.zeros(3, dtype=np.uint8)
        )
