"""Tests of the badges of a doubtful case in every file that is exported from it."""

from __future__ import annotations

import dataclasses
import json
import xml.etree.ElementTree as ET

import numpy as np
import pytest
import SimpleITK as sitk

import carina
from cached_test_data import cached_airways, cached_phantom
from carina.export import EXPORT_SUFFIXES, export_airways, export_tree, read_badges
from carina.render import Picture, read_png_badges
from carina.scopes import Pose
from carina.volume import Note, Volume, VolumeSource, badges_of

CLIPPED = Note("import.clipped", "9 voxels lie outside; \u201cof\u201d\nthis scan", badge=True)
PLAIN = Note("import.several-series", "another series was left out")
STOPPED = Note("track.search-stopped", "the search was stopped", badge=True)


@pytest.fixture(scope="module")
def case():
    options = {"seed": 4, "spacing_mm": 1.5, "generations": 3}
    volume = cached_phantom(**options).volume
    doubted = Volume(
        volume.hu_zyx, volume.lps_from_ijk, source=VolumeSource(format="array", title="t", notes=(PLAIN, CLIPPED))
    )
    return doubted, cached_airways(**options)


def text_of(path) -> str:
    """Return all text of a file, which may be compressed."""
    if path.suffix == ".vtp":
        found = ET.parse(path).getroot().find(".//FieldData/Array[@Name='Badges']")
        return "" if found is None else bytes(int(code) for code in found.text.split()).decode()
    if path.name.endswith((".nii.gz", ".nii", ".nrrd", ".mha")):
        image = sitk.ReadImage(str(path))
        return " ".join(image.GetMetaData(key) for key in image.GetMetaDataKeys())
    return path.read_bytes().decode("latin-1")


@pytest.mark.parametrize("suffix", EXPORT_SUFFIXES)
def test_every_export_of_a_case_with_a_quality_badge_contains_the_badge(case, tmp_path, suffix):
    volume, airways = case
    healthy = dataclasses.replace(volume, source=VolumeSource(format="array", title="t", notes=(PLAIN,)))
    wanted = "IN DOUBT" if suffix == ".stl" else "import.clipped"
    assert wanted in text_of(export_airways(tmp_path / f"a{suffix}", volume, airways))
    assert wanted not in text_of(export_airways(tmp_path / f"b{suffix}", healthy, airways))


def test_exports_that_contain_a_quality_badge_are_valid_files(case, tmp_path):
    volume, airways = case
    stl = export_airways(tmp_path / "a.stl", volume, airways).read_bytes()
    assert stl[:80].rstrip().endswith(b"IN DOUBT")
    assert b"SPACE=LPS" in stl[:80]
    assert int.from_bytes(stl[80:84], "little") * 50 + 84 == len(stl)
    ply = export_airways(tmp_path / "a.ply", volume, airways).read_bytes()
    assert b"comment badge import.clipped: 9 voxels lie outside; ?of? this scan\n" in ply
    tree = export_tree(tmp_path / "t.json", airways.tree, badges=badges_of(volume))
    assert carina.read_tree(tree).branches[0].name == airways.tree.branches[0].name
    assert read_badges(tree) == (CLIPPED,)
    assert read_badges(export_tree(tmp_path / "u.json", airways.tree)) == ()


def test_badges_of_a_case_are_those_of_its_volume_and_of_its_airways(case):
    class Found:
        badges = (STOPPED, CLIPPED)

    volume, _ = case
    assert badges_of(volume) == (CLIPPED,)
    assert badges_of(volume, Found()) == (CLIPPED, STOPPED)
    grey = dataclasses.replace(volume, is_hu=False, not_hu_reason="it is MR")
    assert [note.code for note in badges_of(grey)] == ["import.not-hu", "import.clipped"]
    assert badges_of(grey)[0].words == "not HU: it is MR"


def test_tree_file_with_invalid_badges_is_refused(case, tmp_path):
    path = export_tree(tmp_path / "t.json", case[1].tree)
    for broken in ([{"code": "x"}], ["x"], 3):
        path.write_text(json.dumps({**json.loads(path.read_text()), "badges": broken}))
        with pytest.raises(carina.CarinaError) as caught:
            carina.read_tree(path)
        assert caught.value.code == "track.tree-format"


def test_saved_picture_contains_the_quality_badges(demo_picture: Picture, tmp_path):
    path = demo_picture.save(tmp_path / "p.png", badges=(CLIPPED, STOPPED))
    assert read_png_badges(path) == (CLIPPED, STOPPED)
    assert carina.render.read_png_pose(path) == demo_picture.place()
    assert read_png_badges(demo_picture.save(tmp_path / "q.png")) == ()
    np.testing.assert_array_equal(sitk.GetArrayFromImage(sitk.ReadImage(str(path))), demo_picture.rgb)


@pytest.fixture(scope="module")
def demo_picture(case) -> Picture:
    pose = Pose.looking(case[0].centre_lps, (0.0, 0.0, -1.0))
    return carina.render_view(case[0], pose=pose, view="axial", width=64, height=48)
