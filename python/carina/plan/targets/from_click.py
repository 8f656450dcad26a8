"""Target from a point in the CT: the one function that window, command line and Python use."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from carina.argument_checks import check_arguments, instance, lps_point
from carina.display.progress import ProgressChoice, shows_progress
from carina.plan.targets.doubts import Confirmed, confirmed_codes, target_doubts
from carina.plan.targets.grow_nodule import grow_nodule
from carina.plan.targets.region import whereabouts
from carina.plan.targets.target import PlanTarget
from carina.scopes import WallField
from carina.track import Airways, wall_field
from carina.volume import Volume


@shows_progress
@check_arguments(
    volume=instance(Volume, "open a volume with carina.open_volume"),
    at_lps=lps_point(),
    airways=instance(Airways, "get airways from carina.find_airways", optional=True),
    wall=instance(WallField, "make one with carina.wall_field", optional=True),
)
def target_from_click(
    volume: Volume,
    at_lps: ArrayLike,
    *,
    target_id: str = "target",
    name: str = "",
    airways: Airways | None = None,
    wall: WallField | None = None,
    confirmed: Confirmed = False,
    progress: ProgressChoice = None,
) -> PlanTarget:
    """Segment the target at a point, with the doubts whether it is a nodule; `grow_nodule` lists the errors.

    Window, command line and Python use this function, so that a point gives the same target in all of them.

    Parameters
    ----------
    volume, at_lps
        A chest CT, HU, and a point (3,), LPS mm.
    target_id, name
        Identifier and name of the target.
    airways
        The airways. Without them neither a lesion in an airway nor an airway's wall is recognised.
    wall
        Wall of the airways (`carina.wall_field`); computed from the airways if None.
    confirmed
        Doubts that the user has confirmed: True for all, or their codes.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is None while the progress is unknown. The function may raise CancelledError to stop
        the calculation.

    Examples
    --------
    >>> import carina
    >>> made = carina.generate_phantom(seed=4, spacing_mm=1.0, nodule=True, box_lps=((-130, 15, -60), (-72, 75, -2)))
    >>> target = target_from_click(made.volume, made.truth["nodule"]["centre_lps"], name="T1")
    >>> target.where, target.doubts
    ('lung', ())
    """
    if wall is None and airways is not None:
        wall = wall_field(volume, airways)
    nodule = grow_nodule(volume, at_lps, wall=wall, progress=progress)
    x, y, z = (float(value) for value in np.asarray(at_lps, dtype=np.float64).reshape(3))
    return PlanTarget(
        target_id=target_id,
        name=name,
        nodule=nodule,
        seed_lps=(x, y, z),
        source="click",
        where=whereabouts(volume, nodule, wall=wall),
        doubts=target_doubts(volume, nodule, airways=airways, wall=wall, clicked_lps=(x, y, z)),
        confirmed=confirmed_codes(confirmed),
    )
