"""Every example runs as its first lines say and leaves what it promises."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def load(path: Path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_example_is_tested_here():
    assert sorted(path.name for path in EXAMPLES.glob("*/*.py")) == ["first_airway.py", "gallery.py"]


@pytest.mark.slow
def test_first_airway_saves_a_lit_lumen_in_the_trachea_and_in_a_bronchus(tmp_path):
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
def test_the_gallery_shows_every_place_and_preset(tmp_path):
    saved = load(EXAMPLES / "02_gallery" / "gallery.py").main(None, tmp_path)
    seen = {path.stem: sitk.GetArrayFromImage(sitk.ReadImage(str(path))).astype(float) for path in saved}
    for name in ("trachea", "carina", "main-bronchus", "lobar-fork", "segmental-fork", "small-airway"):
        rgb = seen[name]
        assert rgb[..., 0].mean() > rgb[..., 2].mean() + 15, f"{name}: mucosa is warm"
        assert rgb.max() > 180, f"{name}: lit"
        assert rgb.max(axis=2).min() < 60, f"{name}: the lumen ahead is dark"
        assert (rgb.min(axis=2) > 250).mean() < 0.03, f"{name}: no wall burns out"
    assert not seen["carina-scope"][0, 0].any(), "a round mask"
    assert np.ptp(seen["carina-ct-grey"], axis=2).max() <= 1, "grey"
    assert np.abs(seen["carina"] - seen["carina-no-texture"]).mean() > 0.5
    assert np.abs(seen["carina-see-through"] - seen["carina"]).mean() > 10
    assert np.abs(seen["carina-paper"] - seen["carina"]).mean() > 10
    in_docs = {path.stem for path in (EXAMPLES.parent / "docs" / "pictures" / "gallery").glob("*.jpg")}
    assert in_docs == set(seen), "docs/gallery.md shows all of them"
