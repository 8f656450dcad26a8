"""Tests of the badges of a doubtful scan or tree: every command reports them and stores them in its output files."""

from __future__ import annotations

import json

import numpy as np
import pytest
import SimpleITK as sitk

from carina.export import read_badges
from carina.render import read_png_badges

CODES = ["import.not-numbers"]
FOUND_CODES = [*CODES, "track.thick-slices"]
"""Codes after a search for airways, which adds a badge because the phantom has 2.5 mm slices."""


@pytest.fixture(scope="module")
def doubted(phantom_folder, tmp_path_factory):
    """Return a file of the phantom with three NaN voxels, which causes a badge on import."""
    image = sitk.ReadImage(str(phantom_folder / "ct.nii.gz"))
    values = sitk.GetArrayFromImage(image).astype(np.float32)
    values[0, 0, :3] = np.nan
    other = sitk.GetImageFromArray(values)
    other.CopyInformation(image)
    path = tmp_path_factory.mktemp("doubted") / "ct.nrrd"
    sitk.WriteImage(other, str(path))
    return path


@pytest.fixture(scope="module")
def tree(phantom_folder, tmp_path_factory):
    """Return a file of the phantom's exact tree with a badge of the tree."""
    truth = json.loads((phantom_folder / "truth.json").read_text())
    badge = {"code": "track.search-stopped", "words": "the search was stopped"}
    file = tmp_path_factory.mktemp("tree") / "tree.json"
    file.write_text(json.dumps({**truth, "format": "carina-tree", "badges": [badge]}))
    return file


def check_badges(ended, codes=CODES):
    """Assert that a command reports each badge once on stderr and in its JSON, and return the badges."""
    assert ended.code == 0, ended.err
    badges = ended.json()["badges"]
    assert [badge["code"] for badge in badges] == codes
    for badge in badges:
        assert ended.err.count(f"note: {badge['words']}") == 1
    return badges


def test_info_command_prints_the_quality_badge_and_strict_exits_with_code_3(carina, doubted, ct):
    ended = carina("info", doubted, "--json")
    result = ended.json()
    assert [note["code"] for note in result["notes"]] == CODES
    assert result["notes"][0]["badge"] is True
    assert result["notes"][0]["words"] in result["warnings"]
    assert [badge["code"] for badge in result["badges"]] == CODES
    assert "finding: 3 voxels are not finite" in carina("info", doubted).out
    strict = carina("info", doubted, "--strict")
    assert strict.code == 3
    assert "import.not-numbers" in strict.err


def test_airways_and_export_commands_print_the_quality_badge_and_exit_with_code_3_if_strict(carina, doubted, tmp_path):
    file = tmp_path / "t.json"
    check_badges(carina("airways", doubted, "-o", file, "--mask", tmp_path / "m.nrrd", "--json"), FOUND_CODES)
    assert [note.code for note in read_badges(file)] == FOUND_CODES
    assert CODES[0] in sitk.ReadImage(str(tmp_path / "m.nrrd")).GetMetaData("note")
    check_badges(carina("export", doubted, "--tree", file, "-o", tmp_path / "t.swc", "--json"), FOUND_CODES)
    assert CODES[0] in (tmp_path / "t.swc").read_text()
    for verb in (("airways",), ("export", "-o", tmp_path / "never.swc")):
        ended = carina(verb[0], doubted, *verb[1:], "--strict", "--json")
        assert ended.code == 3
        assert ended.json()["error"]["code"] == "import.strict"
    assert not (tmp_path / "never.swc").exists()


def test_quality_badge_of_a_tree_is_copied_to_its_exports(carina, ct, doubted, tree, tmp_path):
    check_badges(carina("export", ct, "--tree", tree, "-o", tmp_path / "t.vtp", "--json"), ["track.search-stopped"])
    both = carina("export", doubted, "--tree", tree, "-o", tmp_path / "t.json", "--json")
    check_badges(both, [*CODES, "track.search-stopped"])
    assert [note.code for note in read_badges(tmp_path / "t.json")] == [*CODES, "track.search-stopped"]


def test_picture_surface_and_tracked_path_contain_the_quality_badges(carina, doubted, phantom_folder, tmp_path):
    picture = tmp_path / "a.png"
    check_badges(
        carina("render", doubted, "--view", "axial", "--at", "0,0,0", "--size", "64x48", "-o", picture, "--json")
    )
    assert [note.code for note in read_png_badges(picture)] == CODES
    surface = tmp_path / "s.npz"
    at = ("--at", "0,0,0", "--size", "32x32", "--step-vox", "2")
    check_badges(carina("render", doubted, "--surface", surface, *at, "-o", picture, "--json"), FOUND_CODES)
    with np.load(surface) as walls:
        assert walls["badges"][0].startswith("import.not-numbers: 3 voxels")
    tip = json.loads((phantom_folder / "truth.json").read_text())["branches"][1]["points"][-1]
    file = tmp_path / "t.json"
    check_badges(carina("track", doubted, "--target", ",".join(map(str, tip)), "-o", file, "--json"), FOUND_CODES)
    assert [note.code for note in read_badges(file)] == FOUND_CODES


def test_video_contains_the_quality_badges(carina, doubted, tree, tmp_path):
    pytest.importorskip("av", reason="PyAV is not installed")
    ended = carina(
        "fly", doubted, "--tree", tree, "--to", "1", "-o", tmp_path / "a.mp4", "--size", "32x32", "--rate", "4",
        "--speed", "200", "--pause", "0", "--step-vox", "1", "--json",
    )  # fmt: skip
    check_badges(ended, [*CODES, "track.search-stopped", "track.thick-slices"])
