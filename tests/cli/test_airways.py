"""``carina airways`` and ``carina export``, as a person runs them."""

from __future__ import annotations

import json

import numpy as np
import pytest
import SimpleITK as sitk

from carina.phantom import generate_phantom, write_phantom


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    folder = tmp_path_factory.mktemp("phantom")
    write_phantom(generate_phantom(seed=4, spacing_mm=1.5, generations=3), folder)
    return folder


def test_airways_says_what_it_found_and_writes_tree_and_lumen(carina, case, tmp_path):
    tree, lumen = tmp_path / "t.json", tmp_path / "lumen.nii.gz"
    found = carina("airways", case / "ct.nii.gz", "-o", tree, "--mask", lumen, "--json")
    assert found.code == 0
    report = found.json()
    assert report["num_branches"] == len(report["branches"]) == len(json.loads(tree.read_text())["branches"])
    assert report["branches"][0]["name"] == "Trachea"
    inside = sitk.GetArrayFromImage(sitk.ReadImage(str(lumen)))
    truth = sitk.GetArrayFromImage(sitk.ReadImage(str(case / "lumen.nii.gz")))
    assert 2.0 * (inside * truth).sum() / (inside.sum() + truth.sum()) > 0.85
    words = carina("airways", case / "ct.nii.gz")
    assert "Trachea" in words.out
    assert "mm wide" in words.out


def test_a_lumen_from_another_tool_takes_the_place_of_the_automatic_one(carina, case, tmp_path):
    written = tmp_path / "lumen.nrrd"
    found = carina("airways", case / "ct.nii.gz", "--from-mask", case / "lumen.nii.gz", "--mask", written, "--json")
    assert found.code == 0
    inside = sitk.GetArrayFromImage(sitk.ReadImage(str(written)))
    truth = sitk.GetArrayFromImage(sitk.ReadImage(str(case / "lumen.nii.gz")))
    assert np.array_equal(inside, truth != 0)


def test_a_mask_on_another_grid_is_refused_before_the_search(carina, case, tmp_path):
    other = sitk.ReadImage(str(case / "lumen.nii.gz"))
    other.SetSpacing((1.0, 1.0, 1.0))
    sitk.WriteImage(other, str(tmp_path / "other.nii.gz"))
    ended = carina("airways", case / "ct.nii.gz", "--from-mask", tmp_path / "other.nii.gz", "--json")
    assert ended.code == 3
    assert ended.json()["error"]["code"] == "import.mask-grid"
    assert carina("airways", case / "ct.nii.gz", "--label", "2").code == 2


def test_no_airway_is_exit_4_with_the_reason_and_what_to_do(carina, tmp_path):
    image = sitk.GetImageFromArray(np.random.default_rng(0).integers(-100, 100, (20, 40, 40), dtype=np.int16))
    sitk.WriteImage(image, str(tmp_path / "block.nrrd"))
    ended = carina("airways", tmp_path / "block.nrrd", "-o", tmp_path / "t.json", "--json")
    assert ended.code == 4
    assert "trachea" in ended.json()["error"]["message"]
    assert not (tmp_path / "t.json").exists()


@pytest.mark.parametrize("name", ["a.json", "a.vtp", "a.swc", "a.mrk.json", "a.nii.gz", "a.stl", "a.glb"])
def test_export_writes_every_format(carina, case, tmp_path, name):
    ended = carina("export", case / "ct.nii.gz", "-o", tmp_path / name, "--json")
    assert ended.code == 0
    assert ended.json()["output"] == str(tmp_path / name)
    assert (tmp_path / name).stat().st_size > 500


def test_export_of_a_given_tree_does_not_search_again(carina, case, tmp_path):
    truth = case / "truth.json"
    ended = carina("export", case / "ct.nii.gz", "--tree", truth, "-o", tmp_path / "t.swc", "--json")
    assert ended.code == 0
    assert ended.json()["num_branches"] == len(json.loads(truth.read_text())["branches"])
    far = json.loads(truth.read_text())
    for branch in far["branches"]:
        branch["points"] = [[x + 5000.0, y, z] for x, y, z in branch["points"]]
    (tmp_path / "far.json").write_text(json.dumps(far))
    ended = carina("export", case / "ct.nii.gz", "--tree", tmp_path / "far.json", "-o", tmp_path / "far.vtp", "--json")
    assert ended.code == 2
    assert "another patient" in ended.json()["error"]["message"]


def test_an_unknown_suffix_is_refused_with_those_that_are_known(carina, case, tmp_path):
    ended = carina("export", case / "ct.nii.gz", "-o", tmp_path / "a.txt", "--json")
    assert ended.code == 2
    assert ".glb" in ended.json()["error"]["message"]
