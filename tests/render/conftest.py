"""Phantom of a branching airway with its lumen, on an oblique, anisotropic grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from render_grids import place, rotation
from render_trees import LEFT, RIGHT, TRACHEA

from carina.scopes import Pose
from carina.volume import Volume


@dataclass(frozen=True)
class Airway:
    """Phantom of a trachea and both main bronchi: volume, lumen, and a pose.

    The trachea runs along -z from (0, 0, 40), the carina is near the origin, and the right bronchus is wider.
    """

    volume: Volume
    lumen_zyx: NDArray[np.uint8]
    pose: Pose


def _distance_mm(points: NDArray[np.float64], a: tuple[float, ...], b: tuple[float, ...]) -> NDArray[np.float64]:
    start, along = np.array(a), np.array(b) - np.array(a)
    t = np.clip((points - start) @ along / (along @ along), 0.0, 1.0)
    return np.linalg.norm(points - start - t[..., None] * along, axis=-1)


@pytest.fixture(scope="session")
def airway() -> Airway:
    """Return the phantom of trachea and main bronchi, which is equal in every run."""
    shape = (48, 62, 70)
    matrix = place(rotation(0.2, -0.15, 0.3), (1.1, 0.9, 1.7), (2.0, 1.0, 5.0), shape)
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1)[..., ::-1].astype(float)
    lps = grid @ matrix[:3, :3].T + matrix[:3, 3]
    # The depth is that inside the lumen, mm; the edge is blurred over about one voxel, as by a scanner.
    depth = np.max([radius - _distance_mm(lps, a, b) for a, b, radius in (TRACHEA, RIGHT, LEFT)], axis=0)
    # For the X-ray views the phantom has bone: a spine behind the airways, and one rib on the patient's left.
    spine = 4.5 - _distance_mm(lps, (0.0, 24.0, 60.0), (0.0, 24.0, -50.0))
    rib = 2.5 - _distance_mm(lps, (6.0, 22.0, 12.0), (34.0, 10.0, 2.0))
    noise = np.random.default_rng(7).normal(0.0, 12.0, shape)
    hu = np.clip(-450.0 - 500.0 * np.clip(depth / 0.8, -1.0, 1.0) + noise, -1024, 3071)
    hu = np.where(np.maximum(spine, rib) > 0, 600.0 + noise, hu)
    volume = Volume(np.ascontiguousarray(np.rint(hu).astype(np.int16)), matrix)
    pose = Pose.looking((0.5, -1.0, 15.0), (0.0, 0.05, -1.0))
    return Airway(volume, np.ascontiguousarray((depth > 0).astype(np.uint8)), pose)
