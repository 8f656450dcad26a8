"""Tests of fissures that needles cross, and of a CT without fissures."""

from __future__ import annotations

from typing import Any

import numpy as np
from nodules import ellipsoid

from cached_test_data import cached_phantom
from carina.plan import FissureBox, NeedleErrors, NeedleScene, last_leg, lobes, surroundings, tool
from carina.plan.cubic_box import Box
from carina.scopes import WallField
from carina.track import AirwayTree
from carina.volume import Volume

CHEST: dict[str, Any] = {"seed": 4, "spacing_mm": 1.2, "generations": 4}


def plate(at_mm: float) -> FissureBox:
    """Return a fissure plate across x at the position ``at_mm``."""
    box = Box(np.zeros((81, 81, 81), np.float32), np.ones((81, 81, 81), dtype=bool), 1.0, np.eye(4))
    box.lps_from_ijk[:3, 3] = -40.0
    mask = np.zeros(box.known.shape, dtype=bool)
    mask[:, :, round(at_mm + 40.0) : round(at_mm + 40.0) + 2] = True
    return FissureBox(mask, box)


def test_fissure_crossed_by_a_needle_path_is_listed_at_its_position() -> None:
    _, y, x = np.indices((81, 81, 81)) - 40.0
    off = np.hypot(x, y)
    hu = np.where(off < 3.0, -990, np.where(off < 4.2, 20, -860)).astype(np.int16)
    place = np.eye(4)
    place[:3, 3] = -40.0
    volume, wall = Volume(hu, place), WallField.from_distances((3.0 - off).astype(np.float32), place)
    nodule = ellipsoid((5.0, 5.0, 5.0), (24.0, 0.0, 0.0))

    def crossed(fissure: FissureBox | None) -> dict[str, float]:
        around = surroundings(volume, np.array(nodule.centre_lps), 30.0, nodule, wall, fissure=fissure)
        scene = NeedleScene(nodule, wall, around, tool("needle-21g-long"), NeedleErrors())
        leg = last_leg(scene, np.zeros(3), np.array([0.0, 0.0, 1.0]))
        return {one.tissue: one.start_mm for one in leg.crossed}

    found = crossed(plate(12.0))
    assert abs(found["fissure"] - 11.5) < 0.6
    assert found["target"] > found["fissure"]
    assert "fissure" not in crossed(None)
    # The fissure is beyond the target, and farther beyond it than the needle goes.
    assert "fissure" not in crossed(plate(-30.0))


def test_lungs_without_visible_fissures_have_lobes_from_airways_and_almost_no_fissure_voxels() -> None:
    made = cached_phantom(**CHEST)
    found = lobes(made.volume, AirwayTree.from_json(made.truth))
    assert found.missing == ()
    assert found.fissure is not None
    # The limit is in mm3; a fissure has about 20,000 mm3.
    assert found.fissure.mask.sum() < 2000
    total = sum(found.ml(name) for name in ("RUL", "RML", "RLL", "LUL", "LLL"))
    assert 3000.0 < total < 9000.0
    for branch in made.truth["branches"]:
        name, tip = branch["name"], np.array(branch["points"][-1])
        if name in {"RB1", "RB3", "RB10", "LB3", "LB10"}:
            expected = {"RB1": "RUL", "RB3": "RUL", "RB10": "RLL", "LB3": "LUL", "LB10": "LLL"}[name]
            assert found.at(tip)[0] == expected
