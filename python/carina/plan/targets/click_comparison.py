"""Comparison of a target from a file with the nodule that a click at its middle gives."""

from __future__ import annotations

from carina.display.progress import Progress
from carina.errors import NoResultError
from carina.plan.targets.grow_nodule import grow_nodule
from carina.plan.targets.nodule import Nodule
from carina.scopes import WallField
from carina.volume import Volume


def click_note(
    volume: Volume, nodule: Nodule, *, wall: WallField | None = None, progress: Progress | None = None
) -> str:
    """Return volume and diameters of the nodule from a click at the middle of a drawn nodule, as a note for the user.

    Parameters
    ----------
    volume, nodule
        The CT and the drawn nodule.
    wall
        Wall of the airways.
    progress
        ``f(what, fraction)``; it may raise CancelledError.
    """
    try:
        clicked = grow_nodule(volume, nodule.middle_lps, wall=wall, progress=progress or False)
    except NoResultError as error:
        return f"for comparison: a click at the middle of the file's boundary gives no nodule ({error.code})"
    drawn, found = _size(nodule), _size(clicked)
    # Two intervals of 90 % that do not meet cannot both be right.
    apart = abs(clicked.volume_mm3 - nodule.volume_mm3) > clicked.volume_error_mm3 + nodule.volume_error_mm3
    rest = "; the difference exceeds both errors, check the boundary" if apart else ""
    return f"for comparison: the file's boundary has {drawn}; a click at its middle gives {found}{rest}"


def _size(nodule: Nodule) -> str:
    ml, error_ml = nodule.volume_mm3 / 1000.0, nodule.volume_error_mm3 / 1000.0
    digits = 1 if ml >= 10.0 else 2 if ml >= 0.1 else 3
    return f"{ml:.{digits}f} \u00b1 {error_ml:.{digits}f} ml and {nodule.long_mm:.1f} x {nodule.short_mm:.1f} mm"
