"""Fixtures of the force feedback tests: seeded generators, a straight airway."""

from __future__ import annotations

import random
from collections.abc import Iterator

import numpy as np
import pytest

from carina.scopes import WallField
from carina_haptics import ForceLaw

SEED = 20001
RADIUS_MM = 8.0


@pytest.fixture(autouse=True)
def seeded() -> Iterator[None]:
    """Seed the global generators and turn numpy's floating-point problems into errors."""
    random.seed(SEED)
    np.random.seed(SEED)
    with np.errstate(divide="raise", invalid="raise", over="raise"):
        yield


@pytest.fixture(scope="session")
def tube() -> WallField:
    """Return the wall of a straight airway along z."""
    z, y, x = np.mgrid[0:80, -24:25, -24:25].astype(np.float64)
    matrix = np.diag([0.5, 0.5, 0.5, 1.0])
    matrix[:3, 3] = (-12.0, -12.0, -40.0)
    return WallField.from_distances((RADIUS_MM - 0.5 * np.hypot(x, y) + 0.0 * z).astype(np.float32), matrix)


@pytest.fixture
def reach_mm() -> float:
    """Return the largest distance from the axis at which the tip does not touch the wall."""
    return RADIUS_MM - ForceLaw().tip_radius_mm
