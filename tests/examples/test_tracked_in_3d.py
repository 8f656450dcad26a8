"""Tests of the pictures of paths in LIDC2 and headsq (paper, figure 14), which ``docs/gallery.md`` shows."""

from __future__ import annotations

import os
import shutil
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk

import carina
from carina_bench.paper import FOLDER
from carina_bench.tracked_in_3d import PATH_RGB, ROOT_RGB, SCENES, TARGET_RGB, pictures_of, tracked
from jpeg_comparison import same, write_jpeg

DOCS = Path(__file__).resolve().parents[2] / "docs"
IN_DOCS = DOCS / "pictures" / "paper"
NAMES = sorted(f"{scene}-{view}" for scene, one in SCENES.items() for view in one.views)

# Values of LIDC2: 115 and more in contrast medium, below 60 in muscle, 0 in lung and fat. Values of headsq: 100 to 150
# in air, 1000 to 1100 in soft tissue; voxels of 3.2 mm blur thin walls.
INSIDE = {"lidc2": (110, 255), "headsq": (0, 900)}


@cache
def found_in(data_dir: Path, scene: str):
    """Return the volume of a scene and its paths."""
    volume = carina.open_volume(data_dir / FOLDER / SCENES[scene].file)
    return volume, tracked(SCENES[scene], volume)


def test_gallery_shows_each_picture_of_paths_in_3d_with_source_and_licence():
    assert {path.stem for path in IN_DOCS.glob("*.jpg")} == set(NAMES)
    page = (DOCS / "gallery.md").read_text(encoding="utf-8")
    assert all(f"(pictures/paper/{name}.jpg)" in page for name in NAMES)
    for part in ("LIDC-IDRI", "10.7937/K9/TCIA.2015.LO9QL9SX", "CC BY 3.0", "vtk.js", "BSD-3-Clause"):
        assert part in page


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES)
def test_paths_of_the_pictures_stay_in_vessel_or_air(data_dir, scene):
    volume, result = found_in(data_dir, scene)
    assert result.search is not None
    low, high = INSIDE[scene]
    for target, row, ijk in zip(result.targets, result.search.targets, SCENES[scene].targets_ijk.values(), strict=True):
        assert target.problem is None
        assert low <= row.value_range[0] <= row.value_range[1] <= high
        assert np.linalg.norm(volume.to_ijk(target.path.points_lps[-1]) - ijk) < 1.0


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES)
def test_golden_pictures_of_paths_in_3d_equal_those_of_the_docs(data_dir, tmp_path, scene):
    volume, result = found_in(data_dir, scene)
    paths = [target.path.points_lps for target in result.targets]
    for view, picture in pictures_of(SCENES[scene], volume, paths).items():
        name = f"{scene}-{view}.jpg"
        for colour, least in ((PATH_RGB, 150), (TARGET_RGB, 60), (ROOT_RGB, 20)):
            assert (picture.rgb == colour).all(axis=2).sum() >= least, "paths, targets and root are visible"
        assert (picture.rgb.max(axis=2) > 60).mean() > 0.15, "the volume is visible"
        write_jpeg(picture.rgb, tmp_path / name)
        if os.environ.get("CARINA_GOLDEN") == "rewrite":
            shutil.copy(tmp_path / name, IN_DOCS / name)
        shown, made = (sitk.GetArrayFromImage(sitk.ReadImage(str(folder / name))) for folder in (IN_DOCS, tmp_path))
        assert same(shown, made), f"docs/pictures/paper/{name} is not what is rendered; `make golden` writes it"
