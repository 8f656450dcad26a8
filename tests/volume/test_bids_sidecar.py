"""Tests of NIfTI files with JSON files beside them, and of folders that contain one volume."""

from __future__ import annotations

import json

import numpy as np
import pytest
from grid_writers import LPS_FROM_IJK, chest, metaimage, nifti

from carina.errors import VolumeImportError
from carina.volume import inspect_path, open_volume


@pytest.fixture
def bids(tmp_path):
    """Return the folder of a CT as dcm2niix and BIDS write it, and its JSON file."""
    path = nifti(tmp_path, chest())
    named = path.with_name(f"sub-01_ct{''.join(path.suffixes)}")
    path.rename(named)
    sidecar = tmp_path / "sub-01_ct.json"
    sidecar.write_text(json.dumps({"Modality": "CT", "SliceThickness": 1.25, "PatientName": "Secret^One"}))
    return tmp_path, named, sidecar


def test_folder_of_one_volume_with_its_description_opens(bids):
    folder, file, _ = bids
    (folder / "README").write_text("a data set")
    (folder / "sub-01_scans.tsv").write_text("filename\n")
    for path in (folder, file):
        volume = open_volume(path)
        np.testing.assert_array_equal(volume.hu_zyx, chest())
        np.testing.assert_allclose(volume.lps_from_ijk, LPS_FROM_IJK, atol=1e-4)
        assert volume.source.slice_thickness_mm == 1.25
        assert "Secret" not in repr(volume) + str(volume.source)
    assert inspect_path(folder).shape_zyx == chest().shape


@pytest.mark.parametrize("text", ["", "[", "[1]", "{}", '{"SliceThickness": "1.25"}', '{"SliceThickness": true}',
                                  '{"SliceThickness": NaN}', '{"SliceThickness": 0}', '{"SliceThickness": 99}',
                                  '{"SliceThickness": 1' + "0" * 400 + "}", "[" * 100_000,
                                  '{"SliceThickness": 1e999}'])  # fmt: skip
def test_json_file_without_a_plausible_thickness_is_ignored(bids, text):
    _, file, sidecar = bids
    sidecar.write_text(text)
    volume = open_volume(file)
    assert volume.source.slice_thickness_mm is None
    assert volume.source.notes == ()


def test_json_file_of_another_volume_is_not_used(bids):
    _, file, sidecar = bids
    sidecar.rename(sidecar.with_name("sub-02_ct.json"))
    assert open_volume(file).source.slice_thickness_mm is None


def test_folder_of_a_detached_header_opens(tmp_path):
    metaimage(tmp_path, chest())
    np.testing.assert_array_equal(open_volume(tmp_path).hu_zyx, chest())


@pytest.mark.parametrize("other", ["second.nii.gz", "picture.png", "deeper/ct.json"])
def test_folder_with_other_content_is_refused_and_names_the_volume(bids, other):
    folder, file, _ = bids
    (folder / other).parent.mkdir(exist_ok=True)
    (folder / other).write_bytes(b"content")
    with pytest.raises(VolumeImportError, match="open one of these files") as found:
        open_volume(folder)
    assert file.name in str(found.value)
