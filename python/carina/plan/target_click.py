"""A target from one click."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from carina.plan.nodule import grow_nodule
from carina.plan.target import PlanTarget
from carina.plan.whereabouts import whereabouts
from carina.scopes import WallField
from carina.volume import Volume

__all__ = ["target_from_click"]


def target_from_click(
    volume: Volume,
    at_lps: ArrayLike,
    *,
    target_id: str = "target",
    name: str = "",
    wall: WallField | None = None,
) -> PlanTarget:
    """The target at a place; see `grow_nodule`, also for what is refused.

    Parameters
    ----------
    volume, at_lps
        A chest CT, HU, and a point (3,), LPS mm.
    wall
        The airways' wall where it is at hand (`carina.wall_field`): without it a lesion in an airway is not told.

    Examples
    --------
    >>> import carina
    >>> made = carina.generate_phantom(seed=4, spacing_mm=1.0, nodule=True, box_lps=((-130, 15, -60), (-72, 75, -2)))
    >>> target_from_click(made.volume, made.truth["nodule"]["center_lps"], name="T1").where
    'lung'
    """
    nodule = grow_nodule(volume, at_lps, wall=wall)
    x, y, z = (float(value) for value in np.asarray(at_lps, dtype=np.float64).reshape(3))
    return PlanTarget(
        target_id=target_id,
        name=name,
        nodule=nodule,
        seed_lps=(x, y, z),
        source="click",
        where=whereabouts(volume, nodule, wall=wall),
    )
