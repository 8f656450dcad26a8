"""Test of the random target positions of the benchmark `carina_bench.plan_movement`, which measures target movement."""

from __future__ import annotations

import numpy as np

from carina.volume import Volume
from carina_bench.plan_movement import lung_places

RADIUS_MM, STEP_MM = 50.0, 3.0
CENTRES = np.array([[-60.0, 0.0, 0.0], [60.0, 0.0, 0.0]])


def chest_on_a_table() -> Volume:
    """Return two balls of lung in soft tissue, above a table of foam whose density is that of lung."""
    z, y, x = np.meshgrid(*(STEP_MM * np.arange(-n, n + 1) for n in (30, 40, 45)), indexing="ij")
    hu = np.full(x.shape, -1000, dtype=np.int16)
    hu[(np.abs(x) < 125.0) & (np.abs(y) < 65.0)] = 40
    hu[(y > 75.0) & (y < 110.0)] = -880
    for centre in CENTRES:
        away = np.linalg.norm(np.stack([x, y, z], axis=-1) - centre, axis=-1)
        hu[away < RADIUS_MM] = -860
    matrix = np.diag([STEP_MM, STEP_MM, STEP_MM, 1.0])
    matrix[:3, 3] = [x.min(), y.min(), z.min()]
    return Volume(hu, matrix)


def test_random_target_positions_are_in_the_lung_and_not_in_the_ct_table() -> None:
    places = lung_places(chest_on_a_table(), np.random.default_rng(1), 60)
    away = np.linalg.norm(places[:, None] - CENTRES[None], axis=2).min(axis=1)
    assert away.max() < RADIUS_MM - 3.0
