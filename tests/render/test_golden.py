"""Tests of golden images: small pictures of the phantom, compared exactly.

Look at every image that ``make golden`` has written before you commit it.
"""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk
from render_trees import forked

from carina.navigate import FlightPath
from carina.render import (
    AirwayView,
    CutPlaneView,
    DrrView,
    PathView,
    Renderer,
    SliceView,
    TreeView,
    TriPlaneView,
    XrayView,
    transfer_preset,
)
from carina.render.appearance import DECORATIONS
from carina.scopes import Pose

TESTS = Path(__file__).resolve().parents[1]
GOLDEN = TESTS / "golden" / "render"
OUT = TESTS / "out" / "golden"
SIZE = {"width": 96, "height": 96}
AT = (0.5, -1.0, 26.0)
WAY = FlightPath([(0.0, 0.0, 40.0), (0.0, 0.0, 0.0), (-22.0, 4.0, -34.0)])

# By name: view of the phantom, transfer function, and what a person must see in the image.
CASES = {
    "airway-endoscopic": (
        lambda pose: AirwayView(pose, fov_deg=100.0, **SIZE),
        "endoscopic",
        "a pink tube that forks at a sharp carina: the wide right bronchus is on the right",
    ),
    "airway-ct-grey": (
        lambda pose: AirwayView(pose, fov_deg=100.0, **SIZE),
        "ct-grey",
        "the same fork in grey, without loss of light",
    ),
    "airway-flat": (
        lambda pose: AirwayView(pose, fov_deg=100.0, shading=False, **SIZE),
        "endoscopic",
        "the fork as nearly one flat pink: without shading only the depth of the wall's blur shows",
    ),
    "airway-paper": (
        lambda pose: AirwayView(pose, fov_deg=100.0, **SIZE),
        "paper",
        "the fork in blocks of voxels, without shading",
    ),
    "cut-plane": (
        lambda pose: CutPlaneView(pose, **SIZE),
        "endoscopic",
        "the trachea as a dark disc in the middle of 60 mm of tissue",
    ),
    "tri-plane": (
        lambda _: TriPlaneView((1.0, 1.0, 5.0), **SIZE),
        "endoscopic",
        "three planes that meet in the lumen, on a tilted grid; a dark Y on the coronal one",
    ),
    "xray-coronal": (
        lambda _: XrayView(axis="coronal", **SIZE),
        "endoscopic",
        "a bright spine and a rib on its right (patient left) on dark ground; tissue hides the airways",
    ),
    "slice-coronal": (
        lambda _: SliceView(plane="coronal", centre_lps=AT, **SIZE),
        "endoscopic",
        "a dark Y: trachea from the top, the wide right bronchus goes to the lower left",
    ),
    "drr-oblique": (
        lambda _: DrrView(-30.0, 15.0, **SIZE),
        "endoscopic",
        "a radiograph turned to the right: a bright spine left of the middle, and the airways as a darker Y",
    ),
    "straightened": (
        lambda _: PathView("straightened", WAY.frames(), **SIZE),
        "endoscopic",
        "one straight dark tube from top to bottom; the left bronchus leaves it to the right",
    ),
    "curved": (
        lambda _: PathView("curved", WAY.frames(), **SIZE),
        "endoscopic",
        "a dark Y whose right bronchus runs to the end of the picture at the lower left",
    ),
    "tree": (
        lambda _: TreeView(azimuth_deg=20.0, elevation_deg=10.0, **SIZE),
        "endoscopic",
        "a light Y on dark ground: the narrow left bronchus on the right",
    ),
}

DOWN_THE_TRACHEA = Pose.looking((0.0, 0.5, 40.0), (0.0, 0.0, -1.0), (0.0, -1.0, 0.0))
"""Camera in the trachea that looks down, with anterior up."""
AT_THE_CARINA = Pose.looking((0.0, 0.0, 12.0), (0.0, 0.0, -1.0), (0.0, -1.0, 0.0))
"""Camera before the carina that looks down, with anterior up."""
DECORATED = {
    "decorated-trachea": (
        DOWN_THE_TRACHEA,
        DECORATIONS,
        "rings over front (above) and sides, pale between redder grooves; below a flat back wall with folds along it",
    ),
    "decorated-carina": (
        AT_THE_CARINA,
        DECORATIONS,
        "a pale ridge between two bronchi, from front to back; rings go on into both of them",
    ),
    "decorated-rings": (DOWN_THE_TRACHEA, ("rings",), "rings alone, none on the back wall below, which is smooth"),
    "decorated-membrane": (DOWN_THE_TRACHEA, ("membrane",), "folds along a redder back wall below, no rings"),
    "decorated-hue": (AT_THE_CARINA, ("hue",), "a paler trachea, bronchi that get redder; no ring, no line"),
    "decorated-spurs": (AT_THE_CARINA, ("spurs",), "a pale ridge between the two bronchi, and nothing else"),
    "decorated-vessels": (DOWN_THE_TRACHEA, ("vessels",), "a few thin red lines that branch"),
}
"""Golden images of drawn features (decoration) by name: pose, features that need the tree, and what a person must
see."""


def compare(name: str, found: np.ndarray, seen: str) -> None:
    """Fail unless the picture equals the golden image; store the expected, the actual and the difference image."""
    path = GOLDEN / f"{name}.png"
    if os.environ.get("CARINA_GOLDEN") == "rewrite":
        GOLDEN.mkdir(parents=True, exist_ok=True)
        sitk.WriteImage(sitk.GetImageFromArray(found, isVector=True), str(path))
        return
    if not path.exists():
        pytest.fail(f"the golden image {path.name} is missing; it must show {seen}. `make golden` writes it")
    expected = sitk.GetArrayFromImage(sitk.ReadImage(str(path)))
    if expected.shape == found.shape and (expected == found).all():
        return
    OUT.mkdir(parents=True, exist_ok=True)
    parts = {"expected": expected, "found": found}
    if expected.shape == found.shape:
        difference = np.abs(expected.astype(int) - found)
        # Scaled by 32, so that a difference of one grey level is visible.
        parts["difference"] = np.minimum(difference * 32, 255).astype(np.uint8)
    for part, rgb in parts.items():
        sitk.WriteImage(sitk.GetImageFromArray(rgb, isVector=True), str(OUT / f"{name}.{part}.png"))
    pytest.fail(f"{name} differs from its golden image, which must show {seen}; see {OUT}")


@pytest.mark.parametrize("name", sorted(CASES))
def test_pictures_of_the_phantom_equal_the_golden_images(name, airway):
    view, transfer, seen = CASES[name]
    renderer = Renderer(airway.volume, transfer=transfer_preset(transfer))
    renderer.set_lumen(airway.lumen_zyx)
    renderer.prepare()
    compare(name, renderer.render(view(airway.pose)).rgb, seen)


@pytest.mark.parametrize("name", sorted(DECORATED))
def test_pictures_of_the_wall_decoration_equal_the_golden_images(name, airway):
    pose, parts, seen = DECORATED[name]
    preset = transfer_preset("endoscopic")
    on = {part: getattr(preset.appearance, part) for part in parts}
    look = dataclasses.replace(preset.appearance.undecorated(), **on)
    renderer = Renderer(airway.volume, transfer=dataclasses.replace(preset, appearance=look))
    renderer.set_lumen(airway.lumen_zyx, forked())
    compare(name, renderer.render(AirwayView(pose, fov_deg=110.0, width=128, height=128)).rgb, seen)


def test_every_golden_image_has_a_case_that_renders_it():
    assert {path.stem for path in GOLDEN.glob("*.png")} == {*CASES, *DECORATED}
