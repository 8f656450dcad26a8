"""Tests of lobes assigned by the nearest airways, and of fissures that change the borders."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from cached_test_data import cached_phantom
from carina.errors import NoResultError
from carina.plan import FissureBox, Lobes
from carina.plan.cubic_box import Box, smoothed
from carina.plan.lungs.fissures import fissures
from carina.plan.lungs.lobes import LOBE_NAMES, STEP_MM, lung_grid, nearest_lobe
from carina.plan.lungs.tissue_near_needle import lung_box
from carina.track import AirwayTree, branch_side_and_lobe
from carina.volume import Volume

CHEST = {"seed": 4, "spacing_mm": 1.2, "generations": 4}
LOW = np.array([-110.0, -90.0, -140.0])


@cache
def tree() -> AirwayTree:
    return AirwayTree.from_json(cached_phantom(**CHEST).truth)


@cache
def lungs() -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Return a lung mask (one block for each lung, with the mediastinum between) and its matrix."""
    matrix = np.diag([STEP_MM, STEP_MM, STEP_MM, 1.0])
    matrix[:3, 3] = LOW
    inside = np.ones((100, 90, 110), dtype=bool)
    x = LOW[0] + STEP_MM * np.arange(110)
    inside[:, :, np.abs(x) < 6.0] = False
    return inside, matrix


def plate(at_mm: float, seen_share: float = 1.0) -> FissureBox:
    """Return a horizontal fissure across the right lung at a height; its back ``seen_share`` is visible."""
    box = Box(np.zeros((200, 180, 110), np.float32), np.ones((200, 180, 110), dtype=bool), 1.0, np.eye(4))
    box.lps_from_ijk[:3, 3] = LOW
    mask = np.zeros(box.known.shape, dtype=bool)
    k = round(at_mm - LOW[2])
    mask[k - 1 : k + 2, int(180 * (1.0 - seen_share)) :, :104] = True
    return FissureBox(mask, box)


@cache
def by_airways() -> Lobes:
    return nearest_lobe(*lungs(), tree())


def test_lung_mask_ends_at_the_pleura_and_excludes_the_chest_wall() -> None:
    step_mm, shape = 1.5, (150, 130, 200)
    z, y, x = (step_mm * (np.arange(n) - 0.5 * n) for n in shape)
    true_ml = 0.0
    hu = np.full(shape, -1000.0, np.float32)
    hu[:, (x[None] / 140.0) ** 2 + (y[:, None] / 90.0) ** 2 < 1.0] = 40.0
    for side in (-1.0, 1.0):
        radii = np.array([95.0, 65.0, 48.0])
        parts = (z[:, None, None] / radii[0]) ** 2 + (y[:, None] / radii[1]) ** 2 + ((x - 62.0 * side) / radii[2]) ** 2
        hu[parts < 1.0] = -860.0
        true_ml += 4.0 / 3.0 * np.pi * float(radii.prod()) / 1000.0
    blurred = smoothed(hu, 0.8) + np.random.default_rng(3).normal(0.0, 25.0, shape).astype(np.float32)
    volume = Volume(np.rint(blurred).astype(np.int16), np.diag([step_mm, step_mm, step_mm, 1.0]))
    inside, _ = lung_grid(lung_box(volume))
    assert inside.sum() * STEP_MM**3 / 1000.0 == pytest.approx(true_ml, rel=0.04)


def test_airways_are_inside_the_lobe_of_their_name_and_the_lungs_are_separate() -> None:
    lobe_of = branch_side_and_lobe(tree())
    for branch in tree().branches:
        lobe = lobe_of[branch.id]
        if lobe is not None and abs(branch.tip_lps[0]) > 20.0:
            assert by_airways().at(branch.tip_lps)[0] == lobe
    found = by_airways()
    x = LOW[0] + STEP_MM * np.arange(110)
    sides = {"R": x < 0.0, "L": x > 0.0}
    for n, name in enumerate(LOBE_NAMES, 1):
        assert not (found.label_zyx == n)[:, :, sides["L" if name[0] == "R" else "R"]].any()
    assert found.missing == ()
    assert found.ml("LML") == 0.0
    assert sum(found.ml(name) for name in LOBE_NAMES) == pytest.approx(lungs()[0].sum() * 0.008)


def test_lobe_probability_is_lower_at_a_border_and_undefined_outside_the_lungs() -> None:
    found = by_airways()
    inner = found.label_zyx > 0
    near, far = inner & (found.border_mm < 3.0), inner & (found.border_mm > 20.0) & np.isfinite(found.border_mm)
    assert found.sure_zyx[near].max() < 0.75
    # The probability is also lower far from the nearest airway.
    on_airway = max(found.at(branch.tip_lps)[1] for branch in tree().tips())
    assert on_airway > 0.95
    assert found.sure_zyx[far].min() < 0.9 < np.quantile(found.sure_zyx[far], 0.8)
    assert found.at(np.array([0.0, 0.0, 0.0])) == (None, 0.0)
    assert found.at(np.array([900.0, 0.0, 0.0])) == (None, 0.0)


def test_visible_fissure_moves_the_lobe_border_and_raises_the_probability() -> None:
    # The line is at the side of the chest, between the airways of the right upper and lower lobes.
    line = np.stack([np.full(60, -70.0), np.full(60, 40.0), np.linspace(-100.0, 40.0, 60)], axis=1)
    names = [by_airways().at(p)[0] for p in line]
    assert names[0] == "RLL"
    assert names[-1] == "RUL"
    border = line[names.index("RUL"), 2]
    wanted = border + 8.0
    moved = nearest_lobe(*lungs(), tree(), plate(wanted))
    names = [moved.at(p)[0] for p in line]
    assert abs(line[names.index("RUL"), 2] - wanted) < 4.0
    beside = np.array([-70.0, 40.0, wanted - 7.0])
    assert moved.at(beside)[0] == "RLL"
    assert moved.at(beside)[1] > 0.95
    below = np.array([-70.0, 40.0, border - 7.0])
    assert by_airways().at(below)[1] < 0.9


def test_lobe_without_a_bronchus_is_reported_and_a_tree_without_lobes_is_refused() -> None:
    lobe_of = branch_side_and_lobe(tree())
    gone = {one.id for one in tree().branches if lobe_of[one.id] == "RML"}
    remaining = tuple(
        dataclasses.replace(b, children=tuple(c for c in b.children if c not in gone))
        for b in tree().branches
        if b.id not in gone
    )
    assert "RML" in nearest_lobe(*lungs(), AirwayTree(remaining)).missing
    trunk = dataclasses.replace(tree().root, children=())
    with pytest.raises(NoResultError):
        nearest_lobe(*lungs(), AirwayTree((trunk,)))


def scan(thick_mm: float, at_mm: float, noise_hu: float, tube: bool = False) -> Box:
    """Return a scan of 60 mm of lung with a tilted plate, and a vessel through the plate."""
    num = 64
    z, y, x = (np.indices((num, num, num)) - num / 2.0).astype(np.float32)
    off = np.abs(z - 0.4 * y - at_mm)
    share = np.clip(0.5 * thick_mm + 0.5 - off, 0.0, 1.0).astype(np.float32) * min(thick_mm, 1.0)
    if tube:
        share = np.maximum(share, np.clip(2.5 - np.hypot(x - 6.0, y), 0.0, 1.0))
    hu = -860.0 + 900.0 * smoothed(share, 0.6)
    hu = hu + noise_hu * np.random.default_rng(2).standard_normal(hu.shape)
    return Box(hu.astype(np.float32), np.ones(hu.shape, dtype=bool), 1.0, np.eye(4))


def sought(box: Box) -> FissureBox:
    """Return the fissures that the search finds in a whole scan."""
    grid = np.diag([STEP_MM, STEP_MM, STEP_MM, 1.0])
    grid[:3, 3] = -20.0
    label = np.ones((52, 52, 52), np.uint8)
    return fissures(box, label, np.zeros(label.shape, np.float32), grid)


@pytest.mark.parametrize("at_mm", [0.0, 5.3])
def test_thin_bright_plate_in_the_lung_is_found_as_fissure_at_its_position(at_mm: float) -> None:
    found = sought(scan(0.5, at_mm, 20.0, tube=True)).mask
    z, y, x = np.nonzero(found)
    off = np.abs((z - 32.0) - 0.4 * (y - 32.0) - at_mm) / np.hypot(1.0, 0.4)
    assert (off < 2.0).mean() > 0.97
    # Most of the plate's area is found: at least one voxel in 70 % of the columns.
    assert len({(a, b) for a, b in zip(y, x, strict=True)}) > 0.7 * 64 * 64
    crossing = np.stack([np.full(81, 20.0), np.full(81, 32.0), np.linspace(12.0, 52.0, 81)], axis=1)
    hit = crossing[sought(scan(0.5, at_mm, 20.0)).crossed(crossing), 2]
    assert np.median(hit) == pytest.approx(32.0 + at_mm, abs=1.0)


def test_no_fissure_is_found_in_lung_with_vessels_only() -> None:
    assert not sought(scan(0.0, 0.0, 30.0)).mask.any()
    assert not sought(scan(0.0, 0.0, 20.0, tube=True)).mask.any()
