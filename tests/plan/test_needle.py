"""Tests of the probability that a needle hits, against an independent Monte Carlo simulation."""

from __future__ import annotations

import numpy as np
import pytest
from nodules import ellipsoid

from carina.errors import UsageError
from carina.plan import NeedleErrors, hit_share


def drawn_share(nodule, tip, aim, reach_mm, errors, *, moved_mm, num, rng):
    """Return the share of random needles that hit a nodule.

    Random are the lateral error of the tip, the error of the direction, and the movement of the nodule.
    """
    along = (aim - tip) / np.linalg.norm(aim - tip)
    across = np.linalg.svd(along[None])[2][1:]
    tips = tip + rng.normal(0.0, errors.tip_mm, (num, 2)) @ across
    off = rng.normal(0.0, np.radians(errors.angle_deg), (num, 2))
    size = np.linalg.norm(off, axis=1)
    side = (off / np.maximum(size, 1e-12)[:, None]) @ across
    ways = np.cos(size)[:, None] * along + np.sin(size)[:, None] * side
    shift = rng.normal(size=(num, 3))
    shift *= (moved_mm * rng.random(num) ** (1.0 / 3.0) / np.linalg.norm(shift, axis=1))[:, None]
    at = np.linspace(0.0, reach_mm, 101)
    points = (tips - shift)[:, None] + at[None, :, None] * ways[:, None]
    return nodule.contains(points.reshape(-1, 3)).reshape(num, -1).any(axis=1).mean()


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("moved_mm", [0.0, 12.0])
def test_hit_probability_is_within_two_percentage_points_of_a_monte_carlo_simulation(
    seed: int, moved_mm: float
) -> None:
    rng = np.random.default_rng(seed)
    nodule = ellipsoid(rng.uniform(2.5, 8.0, 3))
    aim = np.array(nodule.centre_lps)
    way = rng.normal(size=3)
    tip = aim - rng.uniform(9.0, 22.0) * way / np.linalg.norm(way)
    errors = NeedleErrors(rng.uniform(2.0, 9.0), rng.uniform(0.2, 1.5))
    reach_mm = rng.uniform(12.0, 30.0)
    computed = hit_share(nodule, tip, aim, reach_mm, errors, moved_mm=moved_mm)
    assert computed == pytest.approx(
        drawn_share(nodule, tip, aim, reach_mm, errors, moved_mm=moved_mm, num=20_000, rng=rng), abs=0.02
    )


def test_needle_without_errors_hits_the_target_and_a_too_short_needle_misses_it() -> None:
    nodule = ellipsoid((4.0, 4.0, 4.0))
    aim = np.array(nodule.centre_lps)
    tip = aim + np.array([0.0, 0.0, 15.0])
    exact = NeedleErrors(0.0, 0.0)
    assert hit_share(nodule, tip, aim, 15.0, exact) == 1.0
    assert hit_share(nodule, tip, aim, 10.0, exact) == 0.0
    shares = [hit_share(nodule, tip, aim, 20.0, NeedleErrors(angle, 0.5)) for angle in (2.0, 6.0, 12.0, 25.0)]
    assert shares == sorted(shares, reverse=True) and shares[-1] < 0.5


def test_needle_with_invalid_errors_is_refused() -> None:
    with pytest.raises(UsageError, match="angle_deg: expected 0 to 45; found -1"):
        NeedleErrors(-1.0)
    with pytest.raises(UsageError, match="tip_mm: expected 0 to 20; found nan"):
        NeedleErrors(1.0, float("nan"))
