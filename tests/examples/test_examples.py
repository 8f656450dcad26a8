"""Tests of the examples: each runs as its first lines state and writes the stated files."""

from __future__ import annotations

import dataclasses
import importlib.util
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk

import carina
from cached_test_data import patient
from carina.render import AirwayView, Renderer
from jpeg_comparison import same, write_jpeg

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
IN_DOCS = EXAMPLES.parent / "docs" / "pictures" / "gallery"


def load(path: Path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_example_folder_has_a_test_in_this_file():
    assert sorted(path.name for path in EXAMPLES.glob("*/*.*")) == [
        "first_airway.py",
        "from_ct_to_film.ipynb",
        "gallery.py",
        "scope_handle.ino",
        "turns.py",
    ]


@pytest.mark.slow
def test_first_airway_example_saves_bright_pictures_of_the_trachea_and_a_bronchus(tmp_path):
    saved = load(EXAMPLES / "01_first_airway" / "first_airway.py").main(None, tmp_path)
    assert [path.name for path in saved] == ["trachea.png", "bronchus.png"]
    for path in saved:
        rgb = sitk.GetArrayFromImage(sitk.ReadImage(str(path)))
        assert rgb.shape == (512, 512, 3)
        red, blue = rgb[..., 0].astype(float), rgb[..., 2].astype(float)
        assert red.mean() > 40, "lit"
        assert red.mean() > blue.mean() + 10, "mucosa is warm"
        assert np.ptp(red) > 100, "a bright near wall and a dark lumen ahead"


@pytest.mark.slow
def test_turns_example_lists_each_bifurcation_and_saves_its_picture(tmp_path, capsys):
    saved = load(EXAMPLES / "05_turns" / "turns.py").main(tmp_path)
    lines = capsys.readouterr().out.splitlines()
    assert len(saved) == len(lines) - 1 >= 2
    assert lines[0].startswith("At the main carina (about 26.5 cm on the scope, an estimate), enter ")
    assert lines[-1].endswith("past the last fork, stop")
    for path in saved:
        assert sitk.GetArrayFromImage(sitk.ReadImage(str(path))).shape == (512, 512, 3)


@pytest.fixture(scope="module")
def gallery(tmp_path_factory):
    """Return the pictures of the gallery by name."""
    saved = load(EXAMPLES / "02_gallery" / "gallery.py").main(None, tmp_path_factory.mktemp("gallery"))
    return {path.stem: sitk.GetArrayFromImage(sitk.ReadImage(str(path))) for path in saved}


@pytest.mark.slow
def test_gallery_example_shows_every_camera_position_and_preset(gallery):
    seen = {name: rgb.astype(float) for name, rgb in gallery.items()}
    for name in ("trachea", "carina", "main-bronchus", "lobar-fork", "segmental-fork", "small-airway"):
        rgb = seen[name]
        assert rgb[..., 0].mean() > rgb[..., 2].mean() + 15, f"{name}: mucosa is warm"
        assert rgb.max() > 180, f"{name}: lit"
        assert rgb.max(axis=2).min() < 60, f"{name}: the lumen ahead is dark"
        assert (rgb.min(axis=2) > 250).mean() < 0.03, f"{name}: no wall is overexposed"
    assert not seen["carina-scope"][0, 0].any(), "a round mask"
    assert np.ptp(seen["carina-ct-grey"], axis=2).max() <= 1, "grey"
    assert np.abs(seen["carina"] - seen["carina-no-texture"]).mean() > 0.5
    assert np.abs(seen["carina-see-through"] - seen["carina"]).mean() > 10
    assert np.abs(seen["carina-paper"] - seen["carina"]).mean() > 10
    radiograph = seen["radiograph"].mean(axis=2)
    assert radiograph[100:220, 140:180].mean() > radiograph[100:220, 70:110].mean() + 50, "spine white, lung dark"
    assert seen["straightened"][60:420, 155:165].mean() < 110, "the lumen runs straight down the middle"


@pytest.mark.slow
def test_golden_pictures_of_the_gallery_example_equal_those_of_the_docs(gallery, tmp_path):
    rewrite = os.environ.get("CARINA_GOLDEN") == "rewrite"
    for name, rgb in gallery.items():
        # Both pictures have been encoded, so the loss of the encoder (2 grey levels in the mean) does not hide a
        # difference.
        write_jpeg(rgb, tmp_path / f"{name}.jpg")
        if rewrite:
            shutil.copy(tmp_path / f"{name}.jpg", IN_DOCS / f"{name}.jpg")
    assert {path.stem for path in IN_DOCS.glob("*.jpg")} == set(gallery), "docs/gallery.md shows all of them"
    page = (IN_DOCS.parents[1] / "gallery.md").read_text(encoding="utf-8")
    assert all(f"(pictures/gallery/{name}.jpg)" in page for name in gallery)
    shown, found = (
        {name: sitk.GetArrayFromImage(sitk.ReadImage(str(folder / f"{name}.jpg"))) for name in gallery}
        for folder in (IN_DOCS, tmp_path)
    )
    for name in gallery:
        # Each picture must match only itself, not the same position with another preset or without texture.
        alike = [other for other in gallery if same(shown[name], found[other])]
        assert alike == [name], f"docs/pictures/gallery/{name}.jpg is not what is rendered; `make golden` writes it"


@pytest.mark.slow
def test_gallery_picture_with_changed_shading_does_not_match_the_docs(tmp_path):
    gallery = load(EXAMPLES / "02_gallery" / "gallery.py")
    volume, airways = patient()
    pose = gallery.places(*gallery.way(airways.tree))["carina"]
    endoscopic = carina.transfer_preset("endoscopic")
    shown = sitk.GetArrayFromImage(sitk.ReadImage(str(IN_DOCS / "carina.jpg")))

    def seen(**changes: float) -> np.ndarray:
        look = dataclasses.replace(endoscopic.appearance, **changes)
        renderer = Renderer(volume, transfer=dataclasses.replace(endoscopic, appearance=look))
        renderer.set_lumen(airways.lumen_zyx, airways.tree)
        picture = renderer.render(AirwayView(pose, fov_deg=100.0, **gallery.SIZE))
        write_jpeg(picture.rgb, tmp_path / "seen.jpg")
        return sitk.GetArrayFromImage(sitk.ReadImage(str(tmp_path / "seen.jpg")))

    assert same(shown, seen())
    for changes in ({"vessels": 1.0}, {"texture": 0.5}, {"paleness": 0.0}, {"wrap": 0.5}, {"shininess_log2": 5}):
        assert not same(shown, seen(**changes)), changes
