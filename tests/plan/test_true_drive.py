"""Tests of the true wall and the scope of `carina_bench.plan_true_drive`."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from cached_test_data import cached_phantom
from carina.phantom import lumen_distance_at
from carina.scopes import ScopeDrive, scope_preset
from carina_bench.paint_tubes import OUTSIDE_MM, Tube, covers_of, segments_of
from carina_bench.paint_tubes import lumen_distance_at as painted_distance_at
from carina_bench.plan_cases import Target, TrueTree
from carina_bench.plan_true_drive import needle_hits_from, strikes, wall_along

SCOPE = scope_preset("ultrathin")
OBLIQUE = np.array([0.48, 0.36, -0.8])
PATH = np.linspace(0.0, 60.0, 121)[:, None] * OBLIQUE


def tube(radius_mm: float) -> TrueTree:
    """Return an oblique straight tube, 60 mm long."""
    return TrueTree.of([(PATH, np.full(len(PATH), radius_mm), -1)])


def test_wall_of_a_narrow_true_airway_has_its_exact_radius_on_the_axis() -> None:
    sampled = wall_along(tube(1.7), PATH).distance_mm(PATH[20:-20])
    assert sampled.min() < 1.6
    exact = wall_along(tube(1.7), PATH, lineage=(0,)).distance_mm(PATH[20:-20])
    assert exact == pytest.approx(1.7, abs=0.02)


def test_true_wall_has_the_rounded_carina_of_the_lumen_from_which_the_ct_was_made() -> None:
    seed = 4
    document = cached_phantom(seed=seed, spacing_mm=1.6, generations=4).truth
    rows = sorted(document["branches"], key=lambda row: row["generation"])
    number = {row["id"]: n for n, row in enumerate(rows)}
    truth = TrueTree.of(
        [
            (np.array(row["points"]), np.array(row["radius"]), -1 if row["parent"] is None else number[row["parent"]])
            for row in rows
        ]
    )
    path = np.array(rows[0]["points"])[-12:]
    lumen = partial(lumen_distance_at, seed=seed, generations=4)
    sharp, rounded = wall_along(truth, path), wall_along(truth, path, lumen=lumen)
    around = path[-1] + np.random.default_rng(2).uniform(-9.0, 9.0, (4000, 3))
    exact = -lumen(around)
    near = np.abs(exact) < 0.8
    near &= np.abs(sharp.distance_mm(around)) < 1.2
    assert near.sum() > 200
    # The wall of the balls differs from that of the lumen by the fillets and by the flat back of the trachea.
    assert np.abs(sharp.distance_mm(around) - exact)[near].max() > 0.5
    assert np.quantile(np.abs(rounded.distance_mm(around) - exact)[near], 0.98) < 0.15


def test_exact_lumen_of_a_painted_fork_is_that_of_the_painted_cells() -> None:
    start, half = np.zeros(3), np.array([0.5, 0.0, -0.8])
    at = np.linspace(0.0, 12.0, 30)[:, None]
    tubes = (
        Tube(start + at * [0.0, 0.0, 1.0], np.full(30, 2.2)),
        Tube(start + at * half, np.linspace(1.8, 1.2, 30), id=1, parent=0, generation=1),
        Tube(start + at * half * [-1.0, 1.0, 1.0], np.full(30, 1.6), id=2, parent=0, generation=1),
        Tube(start + at * half, np.full(30, 3.0), id=3, is_artery=True),
    )
    cell_mm = 0.25
    axes = tuple(np.arange(-5.0, 5.0, cell_mm) for _ in range(3))
    share = covers_of(segments_of(tubes, cell_mm), tubes, axes, cell_mm, np.array([0.0, 1.0, 0.0])).lumen
    edge = (share > 0.02) & (share < 0.98)
    z, y, x = np.nonzero(edge)
    points = np.stack([axes[0][x], axes[1][y], axes[2][z]], axis=1)
    assert edge.sum() > 500
    assert painted_distance_at(points, tubes=tubes) == pytest.approx((0.5 - share[edge]) * cell_mm, abs=0.01)
    # The edge between both branches is rounded, so there the lumen is wider than the union of their balls.
    balls = np.min(
        [np.linalg.norm(points[:, None] - one.points, axis=2) - one.radius_mm for one in tubes[:3]], axis=(0, 2)
    )
    assert (balls - (0.5 - share[edge]) * cell_mm).max() > 0.1
    assert (painted_distance_at(np.array([[0.0, 30.0, 0.0]]), tubes=tubes) > OUTSIDE_MM).all()


def test_lumen_far_from_the_path_counts_as_closed() -> None:
    wall = wall_along(tube(1.7), PATH[:40])
    assert wall.distance_mm(PATH[30:31])[0] > 1.0
    assert wall.distance_mm(PATH[100:101])[0] < 0.0


def test_scope_passes_an_airway_that_it_fits_and_stops_in_a_narrower_one() -> None:
    for radius_mm, passes in ((0.5 * SCOPE.tip_mm + 0.1, True), (0.5 * SCOPE.tip_mm - 0.1, False)):
        radius = np.where(np.arange(len(PATH)) < 60, 3.0, radius_mm)
        wall = wall_along(TrueTree.of([(PATH, radius, -1)]), PATH, lineage=(0,))
        drive = ScopeDrive(wall, SCOPE, PATH)
        drive.place(PATH, 20.0)
        for mm in range(21, 51):
            drive.drive(float(mm), 0.0, 0.0, 0.1)
        assert (drive.state.insertion_mm > 48.0) is passes


def test_needle_strikes_a_ball_ahead_and_not_one_beside_or_beyond_its_reach() -> None:
    pose = np.eye(4)
    ahead, beside = Target((0.0, 0.0, 12.0), 4.0), Target((9.0, 0.0, 12.0), 4.0)
    assert needle_hits_from(pose, ahead, 15.0) > 0.9
    assert strikes(pose, ahead, 15.0)
    assert not strikes(pose, beside, 15.0)
    assert not strikes(pose, ahead, 7.0)
