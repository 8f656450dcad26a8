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
    assert sorted(path.name for path in EXAMPLES.glob("*/*.py")) == ["first_airway.py"]


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
