"""Tests that a spur at the upper end of the trachea is removed and does not become a bronchus."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import carina
from carina.track.find.twig_removal import without_twigs
from carina.volume import Volume


def row(parent, generation, *points, radius=8.0):
    """Return a branch as the compiled tracker returns it, with points at most 2 mm apart."""
    ends = np.array(points, dtype=np.float64)
    line = np.concatenate([np.linspace(a, b, 9)[:-1] for a, b in pairwise(ends)] + [ends[-1:]])
    number = int(1000 * abs(ends).sum())
    return {
        "parent": parent,
        "generation": generation,
        "points": line,
        "radius_mm": np.full(len(line), radius),
        "wall_mm": None,
        "cost": 1.0 + generation,
        "nodes": np.arange(number, number + len(line), dtype=np.uint32),
    }


TOP, FORK, CARINA = (-9.3, -183.1, 345.5), (-9.8, -179.3, 341.0), (-16.0, -159.0, 262.0)
"""Upper end of the trachea, a false fork in the trachea, and the carina, LPS mm.

In real CTs the trachea leans, so its end in the top slice is an oval, in which the search may find a false branch.
"""
TRUNK = [
    row(None, 0, TOP, FORK),
    row(0, 1, FORK, (-22.8, -164.3, 297.5), CARINA),
    row(1, 2, CARINA, (-30.0, -158.0, 250.0), radius=6.0),
    row(1, 2, CARINA, (20.0, -155.0, 240.0), radius=6.0),
]
SPUR = row(0, 1, FORK, (-9.3, -188.4, 343.9), (-9.9, -193.0, 345.8), radius=7.0)


@pytest.mark.parametrize("at", [1, 4])
def test_trachea_divided_by_a_short_false_branch_becomes_one_branch_of_generation_0(at):
    rows = [*TRUNK]
    rows.insert(at, SPUR)
    if at == 1:
        rows = [{**one, "parent": 2} if one["parent"] == 1 else one for one in rows]
    before = [one["parent"] for one in rows]
    cleaned = without_twigs(rows)
    assert [one["parent"] for one in cleaned] == [None, 0, 0]
    assert [one["generation"] for one in cleaned] == [0, 1, 1]
    trachea = cleaned[0]
    assert trachea["points"][0] == pytest.approx(TOP)
    assert trachea["points"][-1] == pytest.approx(CARINA)
    assert len(trachea["points"]) == len(trachea["radius_mm"])
    steps = np.linalg.norm(np.diff(trachea["points"], axis=0), axis=1)
    assert steps.min() > 0.0, "the fork is there once"
    assert len(set(trachea["nodes"].tolist())) == len(trachea["nodes"])
    assert [one["parent"] for one in rows] == before, "the input is not modified"


@pytest.mark.parametrize(
    "other",
    [
        pytest.param(row(0, 1, FORK, (-60.0, -180.0, 338.0), radius=3.0), id="a tracheal bronchus of a short trachea"),
        pytest.param(row(1, 2, CARINA, (-16.0, -165.0, 255.0), radius=6.0), id="a stump at the carina"),
    ],
)
def test_true_bronchus_is_not_removed_as_a_short_false_branch(other):
    rows = [*TRUNK, other]
    assert without_twigs(rows) == rows


def test_short_trachea_retains_both_main_bronchi():
    rows = [
        row(None, 0, (0.0, 0.0, 10.0), (0.0, 0.0, 0.0)),
        row(0, 1, (0.0, 0.0, 0.0), (-7.0, 0.0, -8.0), radius=6.0),
        row(0, 1, (0.0, 0.0, 0.0), (30.0, 0.0, -20.0), radius=6.0),
        row(2, 2, (30.0, 0.0, -20.0), (50.0, 0.0, -40.0), radius=4.0),
    ]
    assert without_twigs(rows) == rows


def off_segment(points, a, b):
    """Return the distance of points (n, 3) from the segment between ``a`` and ``b``."""
    along = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    return np.linalg.norm(points - a - along[:, None] * (b - a), axis=1)


def test_air_pouch_beside_the_top_of_the_trachea_adds_no_branch(chest):
    volume = chest.volume
    ijk = np.stack(np.meshgrid(*(np.arange(n) for n in volume.shape_zyx[::-1]), indexing="ij"), axis=-1)
    points = volume.to_lps(ijk.reshape(-1, 3).astype(np.float64))
    top, carina_lps, _ = chest.tubes[0]
    up = (top - carina_lps) / np.linalg.norm(top - carina_lps)
    # The axis is the last part of the tube that is in the scan.
    inside = carina_lps + up * np.arange(0.0, 60.0)[:, None]
    shown = np.array([volume.contains_lps(point) for point in inside])
    end = inside[shown][-1]
    pouch = off_segment(points, end - 6.0 * up, end + np.array([0.0, 8.0, 2.0])) <= 4.5
    values = volume.hu_zyx.copy()
    i, j, k = ijk.reshape(-1, 3)[pouch].T
    values[k, j, i] = -1000
    plain = carina.find_airways(volume)
    found = carina.find_airways(Volume(values, volume.lps_from_ijk))
    assert len(found.tree) == len(plain.tree)
    assert [b.generation for b in found.tree.branches] == [b.generation for b in plain.tree.branches]
    assert found.tree.root.length_mm == pytest.approx(plain.tree.root.length_mm, abs=8.0)
    # The paths of the tracker use the branches of this tree.
    assert found.tracker.path_to(found.tree.branches[-1].tip_lps).length_mm > 20.0


def test_bulge_of_a_wide_airway_does_not_become_a_branch():
    bulge = row(1, 2, CARINA, (-19.0, -158.5, 258.5), radius=5.0)
    cleaned = without_twigs([*TRUNK, bulge])
    assert len(cleaned) == len(TRUNK)
    rows = [*TRUNK, row(2, 3, (-30.0, -158.0, 250.0), (-40.0, -150.0, 240.0), radius=5.0)]
    rows.append(row(2, 3, (-30.0, -158.0, 250.0), (-32.0, -160.0, 247.0), radius=4.0))
    rows.append(row(4, 4, (-40.0, -150.0, 240.0), (-50.0, -140.0, 230.0), radius=3.0))
    cleaned = without_twigs(rows)
    assert [one["parent"] for one in cleaned] == [None, 0, 1, 1, 2]
    assert [one["generation"] for one in cleaned] == [0, 1, 2, 2, 3]
    np.testing.assert_array_equal(cleaned[2]["points"][-1], (-40.0, -150.0, 240.0))
