"""Tests of the command ``carina render`` for views along a route, X-ray views and thick slices."""

from __future__ import annotations

import json

import numpy as np
import pytest
import SimpleITK as sitk

RMB = "-20.2,3.0,-26.6"  # end of the right main bronchus of the phantom with seed 0 (truth.json)
FAR = "-100,0,20"  # more than 5 mm from every airway


@pytest.fixture(scope="module")
def tree(phantom_folder, tmp_path_factory):
    """Write the phantom's exact tree to a file and return its path."""
    file = tmp_path_factory.mktemp("tree") / "tree.json"
    truth = json.loads((phantom_folder / "truth.json").read_text())
    file.write_text(json.dumps({**truth, "format": "carina-tree"}))
    return file


def picture(path):
    return sitk.GetArrayFromImage(sitk.ReadImage(str(path)))


@pytest.mark.parametrize("view", ["straightened", "curved"])
def test_render_command_writes_a_view_along_the_route_to_a_branch_or_a_point(carina, ct, tree, tmp_path, view):
    branches = json.loads(tree.read_text())["branches"]
    deepest = max(branches, key=lambda b: b["generation"])
    for to in (branches[1]["name"] or "1", str(deepest["id"]), RMB):
        output = tmp_path / "x.png"
        ended = carina(
            "render", ct, "--view", view, "--tree", tree, f"--to={to}", "--size", "300x400", "-o", output, "--json"
        )
        assert ended.code == 0, ended.err
        found = ended.json()
        assert found["path_mm"] > 20
        rgb = picture(output)
        assert rgb.shape == (400, 300, 3)
        # The axis is at the left edge, in the accent colour.
        assert (rgb[:, 3:12] == (79, 211, 230)).all(axis=2).sum() > 200
        # In a straightened picture, the airway is the dark column in the middle.
        if view == "straightened":
            assert np.median(rgb[100:300, 148:152]) < 110


def test_render_command_along_a_route_searches_for_airways_if_no_tree_is_given(carina, ct, tmp_path):
    output = tmp_path / "x.png"
    ended = carina("render", ct, "--view", "straightened", f"--to={RMB}", "--turn", "90", "-o", output)
    assert ended.code == 0, ended.err
    assert picture(output).std() > 20


def test_render_command_along_a_route_to_an_unreachable_target_is_refused(carina, ct, tree, tmp_path):
    output = tmp_path / "x.png"
    for more in ([], ["--tree", tree]):
        ended = carina("render", ct, "--view", "straightened", *more, f"--to={FAR}", "-o", output)
        assert ended.code == 4
        assert "mm" in ended.err
    missing = carina("render", ct, "--view", "straightened", "-o", output)
    assert missing.code == 2
    assert "no route" in missing.err or "view follows a route" in missing.err
    no_tree = carina(
        "render", ct, "--view", "straightened", "--tree", tmp_path / "none.json", "--to", "1", "-o", output
    )
    assert no_tree.code == 3
    assert not output.exists()


def test_radiographs_from_two_c_arm_directions_differ(carina, ct, tmp_path):
    frontal, lateral = tmp_path / "a.png", tmp_path / "b.png"
    assert carina("render", ct, "--view", "drr", "--size", "200x200", "-o", frontal).code == 0
    turned = ["--carm-primary", "-90", "--carm-secondary", "10", "--tone", "fluoroscopy"]
    assert carina("render", ct, "--view", "drr", *turned, "--size", "200x200", "-o", lateral).code == 0
    first, second = picture(frontal), picture(lateral)
    assert first.std() > 30
    assert (first != second).mean() > 0.5


def test_minimum_intensity_slab_shows_airways_in_thick_slices(carina, ct, tmp_path):
    means = {}
    for slab in ("0", "20,max", "20,min", "20"):
        output = tmp_path / "x.png"
        ended = carina("render", ct, "--view", "coronal", "--at", "0,0,0", "--slab", slab, "-o", output)
        assert ended.code == 0, ended.err
        means[slab] = picture(output).mean()
    assert means["20,min"] < means["20"] < means["20,max"]
    assert means["20,min"] < means["0"] < means["20,max"]
