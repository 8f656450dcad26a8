"""Segmentation of a nodule from one click: boundary, volume, diameters and their errors."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carina.argument_checks import check_arguments, instance, lps_point
from carina.display.progress import ProgressChoice, progress_function, shows_progress
from carina.errors import NoResultError, UsageError, check_type
from carina.plan.cubic_box import Box, component_at, smoothed, uphill
from carina.plan.targets.boundary import CLICK_MM, HALVES_MM, SMOOTH_MM, TISSUE_HU, Boundary, no_boundary
from carina.plan.targets.boundary_measures import measured
from carina.plan.targets.mask_measures import measured_mask
from carina.plan.targets.nodule import Nodule, NoduleKind
from carina.plan.targets.region import is_outside_body
from carina.scopes import WallField
from carina.volume import Volume
from carina.volume.mask_distances import ball_distance, distance_from
from carina.volume.point_check import check_in_volume

__all__ = ["Nodule", "NoduleKind", "endobronchial_lesion", "grow_nodule"]

HALF_MM = 26.0
AIR_HU = -1000.0
CLOSING_MM = 9.0
"""Radius in mm of the closing of the lumen that estimates the lumen as it would be without a lesion."""
THINNEST_MM = 1.0
"""Minimum radius in mm of the largest ball in a lesion; thinner tissue is unevenness of the wall, or mucus."""
MIN_LUMEN_FRACTION = 0.9
"""Minimum share of airway lumen in the air beside a lesion; air beside a nodule outside the airway is partly lung."""
NOTE = "it stands into an airway; where its base lies in the wall the CT does not show"
BASE_OFF_MM = 0.5
"""Additional uncertainty in mm of the boundary, because the lesion is assumed to begin at the reconstructed wall.

The value is common knowledge, not measured.
"""


def endobronchial_lesion(volume: Volume, wall: WallField, point_lps: NDArray[np.float64]) -> Nodule | None:
    """Segment the tissue that protrudes into an airway within 4 mm of a point; return None if there is none.

    The lumen without the lesion is the present lumen, closed by a ball of 9 mm.

    Parameters
    ----------
    volume, wall
        The CT and the wall of its airways.
    point_lps
        (3,) LPS mm.
    """
    box = Box.around(volume, point_lps, HALF_MM)
    step = box.step_mm
    k, j, i = (axis.reshape(-1) for axis in np.indices(box.hu_zyx.shape))
    places = np.stack([i, j, k], axis=1) * step + box.lps_from_ijk[:3, 3]
    to_wall = wall.distance_mm(places).reshape(box.hu_zyx.shape)
    lumen = to_wall > 0.0
    if not lumen.any():
        return None
    smooth = smoothed(box.hu_zyx, SMOOTH_MM / step)
    tissue = (smooth > 0.5 * (AIR_HU + TISSUE_HU)) & ~lumen
    grown = lumen | (distance_from(lumen, step, CLOSING_MM) <= CLOSING_MM)
    closed = lumen | (ball_distance(grown, step, CLOSING_MM) > CLOSING_MM)
    lesion = closed & tissue
    core = ball_distance(lesion, step, THINNEST_MM) >= THINNEST_MM
    off = np.where(core, box.offsets_mm(point_lps), np.inf)
    z, y, x = np.unravel_index(int(box.offsets_mm(point_lps).argmin()), off.shape)
    # A click in the lumen selects a near lesion. A click in tissue selects this tissue only, so that a lymph node
    # below the carina is not treated as a lesion.
    if float(off.min()) > (CLICK_MM if lumen[z, y, x] else 2.0 * step) or not (lumen | lesion)[z, y, x]:
        return None
    z, y, x = np.unravel_index(int(off.argmin()), off.shape)
    core = component_at(core, (int(z), int(y), int(x)))
    inside = lesion & (core | (distance_from(core, step, THINNEST_MM + step) <= THINNEST_MM + 0.5 * step))
    seed = uphill(ball_distance(inside, step), (int(z), int(y), int(x)))
    inside = component_at(inside, seed)
    if any(inside.take(end, axis=axis).any() for axis in range(3) for end in (0, -1)):
        return None
    air = (distance_from(inside, step, 2.6 * step) <= 2.6 * step) & ~inside & ~tissue
    in_lumen = air & (to_wall > -step)
    if not air.any() or float(in_lumen.sum()) < MIN_LUMEN_FRACTION * float(air.sum()):
        return None
    return measured_mask(volume, inside, box.lps_from_ijk, notes=(NOTE,), touches=("airway wall",), off_mm=BASE_OFF_MM)


ASIDE_MM = 1.0
"""Maximum distance in mm of a click from a faint nodule, or of a click in air from any nodule."""
CLEAR_AIR_HU = -950.0
"""Density in HU below which a point is in air: emphysema (the usual limit), a cyst or an airway."""
MAX_STEPS = 60
"""Maximum number of voxels from the centre of a box to its side; large masses get larger voxels."""


@shows_progress
@check_arguments(
    volume=instance(Volume, "open a volume with carina.open_volume"),
    at_lps=lps_point(),
    wall=instance(WallField, "make one with carina.wall_field", optional=True),
)
def grow_nodule(
    volume: Volume,
    at_lps: ArrayLike,
    *,
    wall: WallField | None = None,
    progress: ProgressChoice = None,
) -> Nodule:
    """Segment the nodule at a point in the lung, or the lesion at a point in an airway.

    Parameters
    ----------
    volume
        A chest CT, HU.
    at_lps
        A point in the nodule, LPS mm; within 4 mm of its densest part, or in its cavity.
    wall
        The airways' wall (`carina.wall_field`). With it, tissue that protrudes into an airway is segmented as a
        separate lesion, and a click into a lumen without a lesion is refused.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is None while the progress is unknown. The function may raise CancelledError to stop
        the calculation.

    Returns
    -------
    Nodule
        Its boundary and measures. Spicules and vessels are not part of it.

    Raises
    ------
    UsageError
        If ``at_lps`` is not a point, or is outside the CT.
    NoResultError
        If nothing there is denser than the lung, or the point is in air beside the nodule, or in lung beside a faint
        nodule (code ``plan.no-nodule``); if the dense part does not end within 5 cm,
        as in a consolidation, the chest wall or the heart (``plan.no-boundary``); if the point is in an airway and
        nothing protrudes into it there (``plan.in-airway``); or if it is outside the body (``plan.outside-body``).
    CancelledError
        If ``progress`` raised it.

    Examples
    --------
    >>> import carina
    >>> made = carina.generate_phantom(seed=4, spacing_mm=1.0, nodule=True, box_lps=((-130, 15, -60), (-72, 75, -2)))
    >>> nodule = grow_nodule(made.volume, made.truth["nodule"]["centre_lps"])
    >>> nodule.kind
    'solid'

    References
    ----------
    Opening and partial volumes: Kuhnigk et al., IEEE Trans Med Imaging 2006;25:417 (the idea; the steps are our own).
    """
    check_type("grow_nodule", "volume", volume, Volume, "open a volume with carina.open_volume")
    try:
        point = np.asarray(at_lps, dtype=np.float64).reshape(3)
    except (TypeError, ValueError):
        raise UsageError(f"nodule: expected a point x,y,z in LPS mm; found {at_lps!r}", code="plan.point") from None
    check_in_volume(volume, point, "the point", code="plan.point")
    if is_outside_body(volume, point):
        raise _outside_body()
    if wall is not None:
        lesion = endobronchial_lesion(volume, wall, point)
        if lesion is not None:
            return lesion
        if float(wall.distance_mm(point[None])[0]) > 0.0:
            raise NoResultError(
                "this point lies in the lumen of an airway, and nothing stands into it there; click on the lesion in "
                "its wall, or on the nodule beside it",
                code="plan.in-airway",
            )

    report = progress_function(progress)

    def look() -> None:
        if report is not None:
            report("looking for a nodule", None)

    coarsest_mm = max(volume.spacing_mm)
    problem = no_boundary()
    chord: Boundary | None = None
    for half_mm in HALVES_MM:
        box = Box.around(volume, point, half_mm, least_step_mm=half_mm / MAX_STEPS)
        try:
            grown = Boundary(box, point, coarsest_mm, look)
        except NoResultError as error:
            # A larger box may contain the whole cavity, or lung round a large mass.
            if half_mm == HALVES_MM[0] or problem.code != error.code:
                problem = error
            continue
        problem = no_boundary()
        if grown.is_near_faces or grown.is_film or grown.is_embedded:
            continue
        if not grown.is_chord:
            return _selected(volume, grown, point, coarsest_mm)
        if chord is not None:
            break
        # A larger box may show enough of the lung's surface to fit the wall behind the mass.
        chord = grown
    if chord is None:
        raise problem
    return _selected(volume, chord, point, coarsest_mm)


def _selected(volume: Volume, grown: Boundary, point: NDArray[np.float64], coarsest_mm: float) -> Nodule:
    """Return the nodule inside a boundary; raise an error if it is outside the body, or the point in air beside it.

    Parameters
    ----------
    volume, grown
        The CT, and the boundary in it.
    point
        (3,) clicked point, LPS mm.
    coarsest_mm
        Largest spacing of the CT.
    """
    nodule = _inside_body(volume, measured(grown, coarsest_mm))
    off = grown.box.offsets_mm(point)
    aside_mm = float(off[grown.inside].min()) - 0.5 * grown.box.step_mm
    hu = float(grown.smooth.reshape(-1)[int(off.argmin())])
    # A click beside a dense nodule can only select this nodule; faint tissue beside a click may be any vessel or wall.
    if aside_mm > ASIDE_MM and hu < (CLEAR_AIR_HU if nodule.kind == "solid" else grown.bar_hu):
        what = "in air" if hu < CLEAR_AIR_HU else "in lung"
        raise NoResultError(
            f"there is no nodule at this point: it is {what} ({hu:.0f} HU), and the nearest tissue is "
            f"{aside_mm:.1f} mm away; click in the middle of the nodule",
            code="plan.no-nodule",
        )
    return nodule


def _inside_body(volume: Volume, nodule: Nodule) -> Nodule:
    """Return the nodule; raise an error if it lies outside the body."""
    if is_outside_body(volume, np.array(nodule.centre_lps), radius_mm=0.5 * nodule.long_mm + 2.0):
        raise _outside_body()
    return nodule


def _outside_body() -> NoResultError:
    return NoResultError(
        "this point lies outside the body; click in the middle of the nodule", code="plan.outside-body"
    )
