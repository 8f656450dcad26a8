"""Tests of the lung map: vessels inside the lungs, without mediastinal folds and steps along the pleura."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from carina.plan.cubic_box import Box
from carina.plan.lungs.fissures import FissureBox
from carina.plan.lungs.lobes import LOBE_NAMES
from carina.plan.lungs.lung_map import _amid_lung, _deep_lines, _seen_shares
from carina.plan.lungs.vessels import VesselBranch, VesselTree

MATRIX = np.eye(4)
MATRIX[:3, 3] = (-30.0, -20.0, -40.0)
SHAPE = (50, 40, 60)
"""Shape (z, y, x) of the volume in voxels.

It is as wide as a chest at the trachea: lung on both sides of the middle, which the closing also fills.
"""
MIDDLE = slice(22, 38)
"""Range of voxels along x that contains the mediastinum."""


def box(*, trachea: bool) -> Box:
    hu = np.full(SHAPE, -850.0, dtype=np.float32)
    hu[:, :, MIDDLE] = 40.0
    if trachea:
        hu[:, 12:28, MIDDLE] = -1000.0
    known = np.ones(SHAPE, dtype=bool)
    known[:, :2] = known[:, -2:] = False
    return Box(hu, known, 1.0, MATRIX)


def tree(*, trachea: bool) -> SimpleNamespace:
    z = np.arange(SHAPE[0]) - 40.0
    points = np.stack([np.zeros_like(z), np.zeros_like(z), z], axis=1)
    branch = SimpleNamespace(generation=0, points=points, radius=np.full(len(z), 9.0))
    return SimpleNamespace(branches=(branch,) if trachea else ())


def test_mediastinal_structures_are_not_lung_vessels_and_the_trachea_is_not_lung():
    for trachea in (False, True):
        seen = SimpleNamespace(box=box(trachea=trachea), lung_hu=-850.0)
        amid = _amid_lung(seen, tree(trachea=trachea))
        assert amid.shape == SHAPE
        z, y = 25, 20
        assert amid[z, y, 6:16].all()
        assert not amid[z, y, 24:36].any(), "between the lungs"
        # A vessel beside the mediastinum has lung on one side only.
        assert amid[z, y, 19]
        # The voxels of this block are between trachea and spine.
        assert not amid[z, 30, 24:36].any()


def test_vessels_along_the_lung_edge_are_omitted_and_their_side_branches_become_separate_trees():
    def along_z(x: float, y: float, parent: int | None) -> VesselBranch:
        z = np.arange(10.0) - 20.0
        points = np.stack([np.full_like(z, x), np.full_like(z, y), z], axis=1)
        return VesselBranch(points, np.full(10, 0.7), parent, 1.0)

    lines = VesselTree((along_z(-15.0, -15.0, None), along_z(-15.0, 0.0, 0), along_z(-14.0, 1.0, 1)))
    made = _deep_lines(lines, box(trachea=False))
    assert [branch.parent for branch in made.branches] == [None, 0]
    assert made.branches[0].points_lps is lines.branches[1].points_lps


def test_visible_share_of_fissures_is_stated_for_each_lung_along_the_lobe_borders():
    # The labels have a spacing of 2 mm. The right lung, at low x, has a flat border between two lobes; the left lung
    # has another border.
    label = np.zeros((20, 20, 40), dtype=np.uint8)
    border = np.full(label.shape, np.inf, dtype=np.float32)
    for part, upper, lower in ((slice(0, 18), "RUL", "RLL"), (slice(22, 40), "LUL", "LLL")):
        label[10:, :, part] = LOBE_NAMES.index(upper) + 1
        label[:10, :, part] = LOBE_NAMES.index(lower) + 1
        border[9:11, :, part] = 1.0
    lobes = SimpleNamespace(label_zyx=label, border_mm=border, lps_from_ijk=np.diag([2.0, 2.0, 2.0, 1.0]))
    # The fissures are on a finer grid with another origin: along the front half of the right border, and far from the
    # left one.
    place = np.eye(4)
    place[:3, 3] = (-5.0, -5.0, -5.0)
    mask = np.zeros((50, 50, 90), dtype=bool)
    mask[23:25, 5:25, 5:41] = True
    mask[38:40, 5:45, 49:85] = True
    fissure = FissureBox(mask, Box(np.zeros(mask.shape, dtype=np.float32), np.ones(mask.shape, dtype=bool), 1.0, place))
    right, left = _seen_shares(lobes, fissure)
    assert 0.5 <= right <= 0.6
    assert left == 0.0
    # If a lung is one lobe, its side has no border and no statement on fissures.
    one = SimpleNamespace(**{**vars(lobes), "border_mm": np.where(np.arange(40) < 20, border, np.inf)})
    assert _seen_shares(one, fissure) == (right, None)
