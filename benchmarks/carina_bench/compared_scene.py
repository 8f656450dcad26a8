"""Scene that all compared renderers draw: one transfer function, one light, one ray step, one stop limit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carina.render import Light, TransferFunction

__all__ = ["FOV_DEG", "STEP_VOX", "STOP_TRANSPARENCY", "TRANSFER", "VTK_STOP_TRANSPARENCY", "opacity_table"]

FOV_DEG = 90.0
"""Field of view of every compared picture, degrees."""
STEP_VOX = 0.5
"""Distance in voxels between two samples of a ray, for all compared renderers."""
STOP_TRANSPARENCY = 1 / 512
"""Transparency below which the rays of Carina and of the numba baseline stop."""
VTK_STOP_TRANSPARENCY = 255 / 32767
"""Transparency below which the rays of VTK's mapper stop; VTK cannot change it, so Carina uses it in the comparison."""

TRANSFER = TransferFunction(
    points=np.array(
        [
            [-700.0, 0.90, 0.48, 0.42, 0.0],
            [-350.0, 0.95, 0.58, 0.50, 0.9],
            [200.0, 1.00, 0.82, 0.75, 0.95],
        ]
    ),
    name="bench",
    light=Light(ambient=0.15, diffuse=0.85, specular=0.3, shininess_log2=4),
)
"""Transfer function: clear air, a ramp of 350 HU around the half-maximum, opaque tissue of two colours.

It is not a preset of Carina, so that figures of different versions can be compared.
"""


def opacity_table(transfer: TransferFunction, step_mm: float, lo: int, hi: int) -> NDArray[np.float32]:
    """Return premultiplied colour and opacity of one ray step for each HU from ``lo`` to ``hi``, (hi - lo + 1, 4)."""
    hu = np.arange(lo, hi + 1)
    rgba = np.stack([np.interp(hu, transfer.points[:, 0], transfer.points[:, c]) for c in range(1, 5)], axis=1)
    alpha = 1.0 - (1.0 - rgba[:, 3]) ** (step_mm / transfer.reference_mm)
    return np.concatenate([rgba[:, :3] * alpha[:, None], alpha[:, None]], axis=1).astype(np.float32)
