"""Where a flight begins: at the top of the trachea, looking down it as from the patient's head."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from carina.scopes import Pose

if TYPE_CHECKING:
    from carina.track import Airways
    from carina.volume import Volume

__all__ = ["pose_at_root", "pose_before_airways"]

CAUDAL_LPS = (0.0, 0.0, -1.0)


def pose_before_airways(volume: Volume) -> Pose:
    """A pose for the first pictures, while the trachea is not known: amid the upper chest, looking caudally.

    A fifth of the volume's height below its top. It is replaced by :func:`pose_at_root`, unless a person has moved.
    """
    nz, ny, nx = volume.shape_zyx
    corners = volume.to_lps(
        np.array([[i, j, k] for i in (0, nx - 1) for j in (0, ny - 1) for k in (0, nz - 1)], dtype=float)
    )
    top, bottom = float(corners[:, 2].max()), float(corners[:, 2].min())
    at = volume.center_lps.copy()
    at[2] = top - 0.2 * (top - bottom)
    if not volume.contains_lps(at):
        # Oblique grids: the column through the middle may leave the box below its highest corner.
        at = volume.center_lps
    return Pose.looking([float(v) for v in at], CAUDAL_LPS)


def pose_at_root(airways: Airways) -> Pose:
    """At the root, looking along the first branch; anterior up (operator at the head)."""
    root = airways.tree.root
    look = root.points[-1] - root.points[0]
    at = [float(v) for v in airways.root_lps]
    if float(np.linalg.norm(look)) < 1e-6:
        return Pose.looking(at, CAUDAL_LPS)
    return Pose.looking(at, [float(v) for v in look])
