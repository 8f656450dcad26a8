"""Nodules of exact shape without a CT, for tests of plans and drawings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from carina.plan import Nodule


def ellipsoid(
    radii_mm: Sequence[float], centre_lps: Sequence[float] = (3.0, -7.0, 40.0), step_mm: float = 0.5
) -> Nodule:
    """Return a solid ellipsoid nodule whose axes are parallel to those of the patient."""
    radii, centre = np.array(radii_mm, dtype=float), np.array(centre_lps, dtype=float)
    half = np.ceil(radii / step_mm).astype(int) + 2
    z, y, x = (np.arange(-n, n + 1) * step_mm for n in half[::-1])
    inside = (
        (x[None, None] / radii[0]) ** 2 + (y[None, :, None] / radii[1]) ** 2 + (z[:, None, None] / radii[2]) ** 2
    ) < 1.0
    matrix = np.diag([step_mm, step_mm, step_mm, 1.0])
    matrix[:3, 3] = centre - half * step_mm
    mm3 = 4.0 / 3.0 * np.pi * float(np.prod(radii))
    across = sorted(2.0 * radii[:2])
    return Nodule(
        (centre[0], centre[1], centre[2]),
        "solid",
        mm3,
        0.02 * mm3,
        across[1],
        across[0],
        0.3,
        mm3,
        30.0,
        (),
        inside,
        matrix,
    )
