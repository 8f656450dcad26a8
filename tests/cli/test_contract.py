"""Tests of the contract with scripts (docs/contracts.md): exit codes, one JSON object, no partial files."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest
import SimpleITK as sitk

import carina

RMB = "-20.2,3.0,-26.6"  # end of the right main bronchus of the phantom with seed 0 (truth.json)
FAR = "-100,0,20"  # in the lung or the chest wall, more than 5 mm from every airway
VIEWS = [
    "airway",
    "cut-plane",
    "tri-plane",
    "xray-axial",
    "xray-coronal",
    "xray-sagittal",
    "drr",
    "axial",
    "coronal",
    "sagittal",
    "tree",
]


def store(path, values, spacing=(1.0, 1.0, 1.0)):
    image = sitk.GetImageFromArray(np.asarray(values))
    image.SetSpacing(spacing)
    sitk.WriteImage(image, str(path))
    return path


# Invalid arguments


@pytest.mark.parametrize(
    "arguments",
    [
        ["fly-away"],
        ["--nonsense"],
        ["info"],
        ["info", "CT", "--nonsense"],
        ["info", "CT", "extra"],
        ["info", "CT", "--series", "no-such-series"],
        ["track", "CT"],
        ["track", "CT", "--target", "1,2"],
        ["track", "CT", "--target", "1,2,nan"],
        ["track", "CT", "--target", "1,2,inf"],
        ["track", "CT", "--target", ""],
        ["track", "CT", "--target", RMB, "--root", "somewhere"],
        ["track", "CT", "--target", RMB, "--cost", "magic"],
        ["track", "CT", "--target", RMB, "--graph", "magic"],
        ["track", "CT", "--target", RMB, "--root", "9999,0,0"],
        ["track", "CT", "--target", RMB, "-o", "no-such-folder/tree.json"],
        ["track", "CT", "--target", RMB, "-o", "."],
        ["render", "CT"],
        ["render", "CT", "-o", "x.jpg"],
        ["render", "CT", "-o", "no-such-folder/x.png"],
        ["render", "CT", "-o", "x.png", "--fov", "0"],
        ["render", "CT", "-o", "x.png", "--fov", "171"],
        ["render", "CT", "-o", "x.png", "--fov", "nan"],
        ["render", "CT", "-o", "x.png", "--fov", "wide"],
        ["render", "CT", "-o", "x.png", "--lens", "equidistant", "--fov", "170.5"],
        ["render", "CT", "-o", "x.png", "--lens", "fisheye"],
        ["render", "CT", "-o", "x.png", "--lens", "lens.txt"],
        ["render", "CT", "-o", "x.png", "--scope", "BF-1000"],
        ["render", "CT", "-o", "x.png", "--outline", "square"],
        ["render", "CT", "-o", "x.png", "--mask", "square"],
        ["render", "CT", "-o", "x.png", "--vignette", "2"],
        ["render", "CT", "-o", "x.png", "--vignette", "nan"],
        ["render", "CT", "-o", "x.png", "--focus", "50,3"],
        ["render", "CT", "-o", "x.png", "--focus", "scope"],
        ["render", "CT", "-o", "x.png", "--focus", "3"],
        ["render", "CT", "-o", "x.png", "--view", "axial", "--scope", "generic"],
        ["render", "CT", "-o", "x.png", "--size", "0x0"],
        ["render", "CT", "-o", "x.png", "--size", "9999x9"],
        ["render", "CT", "-o", "x.png", "--size", "-5x5"],
        ["render", "CT", "-o", "x.png", "--size", "512"],
        ["render", "CT", "-o", "x.png", "--step-vox", "0"],
        ["render", "CT", "-o", "x.png", "--step-vox", "-1"],
        ["render", "CT", "-o", "x.png", "--step-vox", "nan"],
        ["render", "CT", "-o", "x.png", "--size", "8193x512"],
        ["render", "CT", "-o", "x.png", "--at", "nan,0,0"],
        ["render", "CT", "-o", "x.png", "--look", "0,nan,0"],
        ["render", "CT", "-o", "x.png", "--look", "0,0,0"],
        ["render", "CT", "-o", "x.png", "--look", "0,0,1", "--up", "0,0,-2"],
        ["render", "CT", "-o", "x.png", "--up", "0,0,0"],
        ["render", "CT", "-o", "x.png", "--view", "drone"],
        ["render", "CT", "-o", "x.png", "--view", "drr", "--carm-primary", "400"],
        ["render", "CT", "-o", "x.png", "--view", "drr", "--carm-secondary", "-91"],
        ["render", "CT", "-o", "x.png", "--view", "drr", "--tone", "sepia"],
        ["render", "CT", "-o", "x.png", "--view", "straightened"],
        ["render", "CT", "-o", "x.png", "--view", "curved", "--to", "1,2"],
        ["render", "CT", "-o", "x.png", "--view", "curved", "--to", "RMB", "--turn", "nan"],
        ["render", "CT", "-o", "x.png", "--view", "straightened", "--to", "no-such-branch"],
        ["render", "CT", "-o", "x.png", "--view", "axial", "--to", "RMB"],
        ["render", "CT", "-o", "x.png", "--view", "airway", "--slab", "5"],
        ["render", "CT", "-o", "x.png", "--view", "axial", "--slab", "thick"],
        ["render", "CT", "-o", "x.png", "--view", "axial", "--slab", "-5,min"],
        ["render", "CT", "-o", "x.png", "--view", "axial", "--slab", "5,median"],
        ["render", "CT", "-o", "x.png", "--method", "guess"],
        ["render", "CT", "-o", "x.png", "--shading", "maybe"],
        ["render", "CT", "-o", "x.png", "--texture", "maybe"],
        ["render", "CT", "-o", "x.png", "--surface", "x.exr"],
        ["render", "CT", "-o", "x.png", "--surface", "no-such-folder/x.npz"],
        ["render", "CT", "-o", "x.png", "--surface", "x.npz", "--view", "axial"],
        ["render", "CT", "-o", "x.png", "--transfer", "no-such-preset"],
        ["render", "CT", "-o", "x.png", "--view", "axial", "--window", "0,-600"],
        ["render", "CT", "-o", "x.png", "--view", "xray-coronal", "--window", "0,-600"],
        ["render", "CT", "-o", "x.png", "--view", "axial", "--window", "nan,-600"],
        ["render", "CT", "-o", "x.png", "--view", "axial", "--window", "1500"],
        ["render", "CT", "-o", "x.png", "--view", "tree", "--orbit", "1,2,0"],
        ["render", "CT", "-o", "x.png", "--view", "tree", "--orbit", "1,2"],
        ["render", "CT", "-o", "x.png", "--at", "here"],
        ["render", "CT", "-o", "x.png", "--view", "axial", "--at", "9999,0,0"],
        ["render", "CT", "-o", "x.png", "--series", "no-such-series", "--view", "axial"],
        ["isoregion", "CT"],
        ["isoregion", "CT", "-o", "map.png"],
        ["isoregion", "CT", "-o", "no-such-folder/map.nrrd"],
        ["isoregion", "CT", "-o", "map.nrrd", "--transfer", "no-such-preset"],
        ["phantom"],
        ["phantom", "-o", "d", "--seed", "-1"],
        ["phantom", "-o", "d", "--seed", "99999999999999999999999"],
        ["phantom", "-o", "d", "--spacing-mm", "0"],
        ["phantom", "-o", "d", "--spacing-mm", "-1"],
        ["phantom", "-o", "d", "--spacing-mm", "nan"],
        ["phantom", "-o", "d", "--spacing-mm", "100"],
        ["phantom", "-o", "d", "--generations", "-1"],
        ["phantom", "-o", "d", "--generations", "99"],
        ["phantom", "-o", "CT"],
        ["phantom", "-o", "CT/below"],
        ["demo", "ghost"],
        ["open", "CT", "--port", "99999"],
        ["open", "CT", "--port", "-1"],
        ["open", "CT", "more", "paths"],
        ["doctor", "who"],
    ],
    ids=" ".join,
)
def test_invalid_argument_of_any_command_exits_with_code_2_and_writes_nothing(
    carina, ct, tmp_path, monkeypatch, arguments
):
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.iterdir())
    ended = carina(*(word.replace("CT", str(ct)) for word in arguments), "--json")
    assert ended.code == 2, ended.err
    assert ended.json()["error"]["code"]
    assert len(ended.json()["error"]["message"]) > 10
    assert len(ended.err.strip()) > 10
    assert sorted(tmp_path.iterdir()) == before


def test_invalid_log_level_exits_with_code_2_and_a_message(carina, monkeypatch):
    monkeypatch.setenv("CARINA_LOG_LEVEL", "LOUD")
    ended = carina("doctor", "--json")
    assert (ended.code, ended.json()["error"]["code"]) == (2, "usage.log-level")


def test_help_of_every_command_has_an_example_and_exits_with_code_0(carina):
    verbs = ("open", "demo", "info", "track", "render", "isoregion", "phantom", "doctor")
    for verb in (*verbs, "bench render", "bench isoregion", "bench track"):
        ended = carina(*verb.split(), "--help")
        assert ended.code == 0
        assert f"Example: carina {verb}" in " ".join(ended.out.split())
    assert carina("--version").out.startswith("carina ")


# Invalid input files


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("missing.nii.gz", None),
        ("empty.nii.gz", b""),
        ("words.nii.gz", b"this is no image"),
        ("holiday.pdf", b"%PDF-1.7\n%%EOF"),
        ("cut.nrrd", b"NRRD0004\ntype: short\ndimension: 3\nsizes: 100000 100000 100000\nencoding: raw\n\n\0\0"),
        ("folder", "folder"),
    ],
)
def test_invalid_file_exits_with_code_3_and_its_name_in_the_message(carina, tmp_path, name, content):
    path = tmp_path / name
    if content == "folder":
        path.mkdir()
    elif content is not None:
        path.write_bytes(content)
    for arguments in (
        ["info", path],
        ["track", path, "--target", RMB],
        ["render", path, "-o", tmp_path / "x.png"],
        ["isoregion", path, "-o", tmp_path / "x.nrrd"],
        ["open", path, "--no-browser"],
    ):
        ended = carina(*arguments, "--json")
        assert ended.code == 3, ended.err
        assert name in ended.json()["error"]["message"]
    assert not list(tmp_path.glob("x.*"))


@pytest.mark.parametrize(
    "content",
    [
        None,
        b"",
        b"{",
        b"\xff\xfe\x00",
        b"[]",
        b"7",
        b'{"format": "other", "version": 1}',
        b'{"format": "carina-transfer", "version": 2, "points": []}',
        b'{"format": "carina-transfer", "version": 1, "points": []}',
        b'{"format": "carina-transfer", "version": 1, "points": [[NaN, 0, 0, 0, 0]]}',
        b'{"format": "carina-transfer", "version": 1, "points": [[0, 0, 0, 0, 1e999]]}',
        b'{"format": "carina-transfer", "version": 1, "points": [[0, 0, 0, 0]]}',
        b'{"format": "carina-transfer", "version": 1, "points": [["a", 0, 0, 0, 0]]}',
        b'{"format": "carina-transfer", "version": 1, "points": [[0, 2, 0, 0, 0]]}',
        b'{"format": "carina-transfer", "version": 1, "points": [[5, 0, 0, 0, 0], [4, 0, 0, 0, 0]]}',
        b'{"format": "carina-transfer", "version": 1, "points": {"0": 1}}',
        b'{"format": "carina-transfer", "version": 1, "points": [[0, 0, 0, 0, 0]], "reference_mm": "x"}',
        b'{"format": "carina-transfer", "version": 1, "points": [[0, 0, 0, 0, 0]], "reference_mm": 0}',
        b'{"format": "carina-transfer", "version": 1, "points": [[0, 0, 0, 0, 0]], "light": 7}',
        b'{"format": "carina-transfer", "version": 1, "points": [[0, 0, 0, 0, 0]], "unit": []}',
        b'{"format": "carina-transfer", "version": 1, "points": [[0, 0, 0, 0, 0]], "light": {"shininess_log2": 2.5}}',
        b'{"format": "carina-transfer", "version": 1, "points": [[0, 0, 0, 0, 0]], "light": {"reach_mm": "far"}}',
        b'{"format": "carina-transfer", "version": 1, "points": [[0, 0, 0, 0, 0]], "light": {"ambient": "x"}}',
        b"[" * 100_000,
    ],
)
def test_invalid_transfer_function_file_exits_with_code_3_before_the_ct_is_read(carina, tmp_path, content):
    file = tmp_path / "transfer.json"
    if content is not None:
        file.write_bytes(content)
    ended = carina("render", "/no/such/ct", "--transfer", file, "-o", tmp_path / "x.png", "--json")
    assert ended.code == 3, ended.err
    assert "transfer.json" in ended.json()["error"]["message"]


@pytest.mark.parametrize(
    "content",
    [
        None,
        b"",
        b"\xff\xfe",
        b"{",
        b"<a>",
        b"%YAML:1.0\n---\nimage_width: 64\nimage_height: 64\n",
        b'{"image_width": 64, "image_height": 64, "K": [[50, 0, 32], [0, NaN, 32], [0, 0, 1]], "D": [0, 0, 0, 0]}',
        b'{"image_width": 64, "image_height": 64, "K": [[50, 0, 32], [0, 50, 32], [0, 0, 1]], "D": [-3, 0, 0, 0]}',
    ],
)
def test_invalid_camera_calibration_exits_with_code_3_before_the_ct_is_read(carina, tmp_path, content):
    file = tmp_path / "lens.yml"
    if content is not None:
        file.write_bytes(content)
    ended = carina("render", "/no/such/ct", "--lens", file, "-o", tmp_path / "x.png", "--json")
    assert ended.code == 3, ended.err
    assert "lens.yml" in ended.json()["error"]["message"]


def test_rendered_picture_has_the_optics_of_the_given_scope_or_calibration(carina, ct, tmp_path):
    seen = {}
    lens = tmp_path / "lens.json"
    lens.write_text('{"image_size": [96, 72], "K": [[60, 0, 47.5], [0, 60, 35.5], [0, 0, 1]], "D": [-0.1, 0, 0, 0]}')
    for name, options in {
        "scope": ["--scope", "ebus", "--size", "64x64", "--focus", "scope"],
        "calibration": ["--lens", lens, "--size", "96x72", "--outline", "octagon"],
    }.items():
        at = ["--at", "0,0,20", "--look", "0,0,-1", "--transfer", "ct-grey"]
        ended = carina("render", ct, *at, *options, "-o", tmp_path / f"{name}.png", "--json")
        assert ended.code == 0, ended.err
        seen[name] = ended.json()
    assert seen["scope"]["fov_deg"] == 80.0
    # The camera of a forward-oblique scope looks 35 degrees up, to anterior, from the direction of its shaft.
    forward = [row[2] for row in seen["scope"]["lps_from_camera"][:3]]
    assert forward == pytest.approx([0.0, -0.5736, -0.8192], abs=1e-4)
    # The field of view is that of 72 pixels at a focal length of 60 pixels, with barrel distortion.
    assert 62.0 < seen["calibration"]["fov_deg"] < 66.0


# Results of commands


def test_info_and_doctor_commands_print_one_json_object(carina, ct):
    result = carina("info", ct, "--json")
    assert result.code == 0
    assert result.json()["unit"] == "HU"
    assert result.json()["shape_zyx"] == [125, 100, 138]
    facts = carina("doctor", "--json")
    assert facts.code in {0, 1}
    assert facts.code == (1 if facts.json()["problems"] else 0)


def test_target_coordinates_with_a_leading_minus_sign_are_tracked_and_the_tree_is_written(carina, ct, tmp_path):
    ended = carina("track", ct, "--root", "auto", "--target", RMB, "-o", tmp_path / "tree.json", "--json")
    assert ended.code == 0, ended.err
    (row,) = ended.json()["targets"]
    assert row["problem"] is None
    assert row["requested_lps"] == [-20.2, 3.0, -26.6]
    tree = json.loads((tmp_path / "tree.json").read_text(encoding="utf-8"))
    assert tree == ended.json()["tree"]


def test_target_without_a_path_exits_with_code_4_and_paths_to_other_targets_are_written(carina, ct, tmp_path):
    arguments = ["track", ct, "--target", RMB, "--target", FAR, "-o", tmp_path / "tree.json", "--json"]
    ended = carina(*arguments)
    assert ended.code == 4
    found, lost = ended.json()["targets"]
    assert found["problem"] is None
    assert "mm" in lost["problem"]
    assert json.loads((tmp_path / "tree.json").read_text(encoding="utf-8"))["branches"]


def test_other_targets_are_tracked_if_one_target_is_outside_the_volume(carina, ct, tmp_path):
    ended = carina("track", ct, "--target", "9999,0,0", "--target", RMB, "-o", tmp_path / "tree.json", "--json")
    assert ended.code in {2, 4}, ended.err
    if ended.code == 4:
        assert (tmp_path / "tree.json").exists()


def test_track_command_without_any_path_exits_with_code_4_and_leaves_the_old_file(carina, ct, tmp_path):
    (tmp_path / "tree.json").write_text("old", encoding="utf-8")
    ended = carina("track", ct, "--target", FAR, "-o", tmp_path / "tree.json", "--json")
    assert ended.code == 4
    assert ended.json()["tree"] is None
    assert (tmp_path / "tree.json").read_text(encoding="utf-8") == "old"


@pytest.mark.parametrize("view", VIEWS)
def test_every_view_is_rendered_from_the_automatic_pose(carina, ct, tmp_path, view):
    picture = tmp_path / "x.png"
    picture.write_bytes(b"old")
    ended = carina("render", ct, "--view", view, "--at", "auto", "--size", "48x40", "-o", picture, "--json")
    assert ended.code == 0, ended.err
    result = ended.json()
    assert (result["view"], result["size"]) == (view, [48, 40])
    rgb = sitk.GetArrayFromImage(sitk.ReadImage(str(picture)))
    assert rgb.shape == (40, 48, 3)
    assert rgb.std() > 1.0  # the picture is not uniform
    assert [p.name for p in tmp_path.iterdir() if p.name != "home"] == ["x.png"]


def test_xray_view_uses_the_requested_grey_window(carina, ct, tmp_path):
    means = []
    for window in ("4000,-3000", "4000,3000"):
        name = tmp_path / "x.png"
        carina("render", ct, "--view", "xray-coronal", "--window", window, "--size", "32x32", "-o", name)
        means.append(sitk.GetArrayFromImage(sitk.ReadImage(str(name))).mean())
    assert means[0] > means[1] + 20


def test_surface_of_an_airway_view_is_written_beside_the_picture(carina, ct, tmp_path):
    picture, walls = tmp_path / "x.png", tmp_path / "x.npz"
    ended = carina("render", ct, "--size", "24x16", "-o", picture, "--surface", walls, "--json")
    assert (ended.code, ended.json()["surface"]) == (0, str(walls))
    assert picture.exists()
    with np.load(walls) as archive:
        assert archive["depth_mm"].shape == (16, 24)
        assert 0 < np.nanmin(archive["depth_mm"]) < 20


def test_automatic_pose_without_airways_exits_with_code_4(carina, tmp_path):
    values = np.full((20, 20, 20), 40, np.int16)
    values[5:9] = 900  # a part of a bone
    head = store(tmp_path / "tissue.nii.gz", values)
    for view in ("airway", "axial", "tree"):
        ended = carina("render", head, "--view", view, "-o", tmp_path / "x.png", "--json")
        assert ended.code == 4, ended.err
    assert not (tmp_path / "x.png").exists()
    assert carina("render", head, "--view", "xray-axial", "--size", "8x8", "-o", tmp_path / "x.png").code == 0


def test_render_command_reports_a_camera_outside_the_volume(carina, ct, tmp_path):
    ended = carina(
        "render", ct, "--at", "0,-400,0", "--look", "0,1,0", "--size", "16x16", "-o", tmp_path / "x.png", "--json"
    )
    assert ended.code == 0, ended.err
    assert "outside the scan" in ended.err


def test_command_on_a_full_disk_exits_with_code_1_and_leaves_the_old_files(carina, ct, tmp_path, monkeypatch):
    def full(*_arguments, **_options):
        raise OSError(28, "No space left on device")

    (tmp_path / "tree.json").write_text("old", encoding="utf-8")
    (tmp_path / "x.png").write_bytes(b"old")
    monkeypatch.setattr(os, "fsync", full)
    ended = carina("track", ct, "--target", RMB, "-o", tmp_path / "tree.json", "--json")
    assert ended.code == 1, ended.err
    assert "the disk is full" in ended.json()["error"]["message"]
    assert (tmp_path / "tree.json").read_text(encoding="utf-8") == "old"
    ended = carina("render", ct, "--view", "axial", "--size", "16x16", "-o", tmp_path / "x.png", "--json")
    assert ended.code == 1, ended.err
    assert (tmp_path / "x.png").read_bytes() == b"old"
    ended = carina("phantom", "-o", tmp_path / "made", "--spacing-mm", "8", "--json")
    assert ended.code == 1, ended.err
    assert sorted(p.name for p in tmp_path.iterdir() if p.name != "home") in (
        ["made", "tree.json", "x.png"],
        ["tree.json", "x.png"],
    )
    assert not (tmp_path / "made").exists() or not list((tmp_path / "made").iterdir())


def test_internal_error_exits_with_code_1_and_a_message(carina, ct, monkeypatch):
    def broken(*_arguments, **_options):
        raise ZeroDivisionError("x")

    monkeypatch.setattr("carina.cli.info.inspect_path", broken)
    ended = carina("info", ct, "--json")
    assert (ended.code, ended.json()["error"]["code"]) == (1, "carina.fault")


def test_read_only_cache_folder_does_not_prevent_a_command(carina, ct, tmp_path, monkeypatch):
    (tmp_path / "home").write_text("a file in place of the folder", encoding="utf-8")
    assert carina("info", ct).code == 0
    assert carina("render", ct, "--size", "16x16", "-o", tmp_path / "x.png").code == 0


# Volumes of unusual size or content


UNLUCKY = {
    "one slice": (np.linspace(-1000, 400, 64 * 64).reshape(1, 64, 64), (1, 1, 1)),
    "one row": (np.linspace(-1000, 400, 64 * 64).reshape(64, 1, 64), (1, 1, 1)),
    "one voxel": (np.full((1, 1, 1), -1000), (1, 1, 1)),
    "two by two by two": (np.arange(8).reshape(2, 2, 2) * 100 - 1000, (1, 1, 1)),
    "all constant": (np.full((12, 12, 12), 0), (1, 1, 1)),
    "all air": (np.full((40, 40, 40), -1000), (1, 1, 1)),
    "tiny voxels": (np.linspace(-1000, 400, 20**3).reshape(20, 20, 20), (0.01, 0.01, 0.01)),
    "huge voxels": (np.linspace(-1000, 400, 20**3).reshape(20, 20, 20), (50, 50, 50)),
    "needles": (np.linspace(-1000, 400, 20**3).reshape(20, 20, 20), (0.01, 50, 1)),
    "extremes": (np.random.default_rng(1).choice([-32768, 32767, 0, -1000], (16, 16, 16)), (1, 1, 1)),
}


@pytest.mark.parametrize("name", UNLUCKY)
@pytest.mark.parametrize("suffix", [".nii.gz", ".nrrd", ".mha"])
def test_volume_of_unusual_size_or_content_gives_a_result_or_a_message(carina, tmp_path, name, suffix):
    values, spacing = UNLUCKY[name]
    path = store(tmp_path / f"case{suffix}", values.astype(np.int16), [float(s) for s in spacing])
    result = carina("info", path, "--json")
    assert result.code in {0, 3}, result.err
    assert result.json()
    for arguments in (["track", path, "--target", "0,0,0"], ["track", path, "--root", "0,0,0", "--target", "0,0,0"]):
        ended = carina(*arguments, "--json")
        assert ended.code in {0, 2, 3, 4}, ended.err
        assert ended.json()
    # Views do not depend on the file format, so only one format tests all of them.
    for view in VIEWS if suffix == ".mha" else ["airway"]:
        output = tmp_path / "x.png"
        ended = carina("render", path, "--view", view, "--at", "0,0,0", "--size", "16x12", "-o", output, "--json")
        assert ended.code in {0, 3, 4}, (view, ended.err)
        assert ended.json()
        assert output.exists() == (ended.code == 0)
        output.unlink(missing_ok=True)


def test_python_m_carina_is_the_command_carina():
    done = subprocess.run([sys.executable, "-m", "carina", "--version"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"carina {carina.__version__}\n", "")
