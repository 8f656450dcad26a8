"""Segmentation of a target from one click in the CT."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from carina.plan.targets.grow_nodule import grow_nodule
from carina.plan.targets.region import whereabouts
from carina.plan.targets.target import PlanTarget
from carina.scopes import WallField
from carina.volume import Volume

__all__ = ["is_plain_nodule", "target_from_click"]

PLAIN_MM, DEEP_MM = 8.0, 1.5
"""Least equivalent diameter in mm of a plain nodule, and its least depth in mm round the click.

A vessel beside a bronchus in the lung is hardly as wide.
"""
PLAIN_RATIO = 0.55
"""Least ratio of the shortest to the longest main axis of a plain nodule; a vessel is elongated."""


def target_from_click(
    volume: Volume,
    at_lps: ArrayLike,
    *,
    target_id: str = "target",
    name: str = "",
    wall: WallField | None = None,
) -> PlanTarget:
    """Segment the target at a place; `grow_nodule` lists the errors.

    Parameters
    ----------
    volume, at_lps
        A chest CT, HU, and a point (3,), LPS mm.
    target_id, name
        Identifier and name of the target.
    wall
        Wall of the airways (`carina.wall_field`); without it a lesion in an airway is not recognised.

    Examples
    --------
    >>> import carina
    >>> made = carina.generate_phantom(seed=4, spacing_mm=1.0, nodule=True, box_lps=((-130, 15, -60), (-72, 75, -2)))
    >>> target_from_click(made.volume, made.truth["nodule"]["centre_lps"], name="T1").where
    'lung'
    """
    nodule = grow_nodule(volume, at_lps, wall=wall, progress=False)
    x, y, z = (float(value) for value in np.asarray(at_lps, dtype=np.float64).reshape(3))
    return PlanTarget(
        target_id=target_id,
        name=name,
        nodule=nodule,
        seed_lps=(x, y, z),
        source="click",
        where=whereabouts(volume, nodule, wall=wall),
    )


def is_plain_nodule(target: PlanTarget) -> bool:
    """Return whether a segmented target is clearly a nodule, and not the wall or the vessel beside an airway.

    Such a target is in the lung, at least 8 mm in diameter, about as wide as it is long, and was clicked well inside.
    """
    nodule = target.nodule
    if target.where not in {"lung", "beside pleura"} or nodule.equivalent_mm < PLAIN_MM:
        return False
    inside = np.argwhere(nodule.inside_zyx)[:, ::-1] @ nodule.lps_from_ijk[:3, :3].T + nodule.lps_from_ijk[:3, 3]
    axes = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(inside.T)), 0.0))
    around = np.array(target.seed_lps) + DEEP_MM * np.concatenate([np.eye(3), -np.eye(3)])
    return bool(axes[0] >= PLAIN_RATIO * axes[2] and nodule.contains(around).all())
