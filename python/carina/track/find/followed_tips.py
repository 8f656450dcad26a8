"""Search for small airways beyond the flooded lumen, with stricter limits if the search leaks into the lung."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina._core import extend_lumen, extend_thin_lumen
from carina.track.find.kernel_compensation import SoftenedCt
from carina.track.find.kernel_sharpness import edge_undershoot_hu
from carina.track.find.root_checks import LUNG_HU
from carina.track.intensity_levels import AirScale
from carina.track.progress import Stages
from carina.volume.model import Note, Volume

STOPPED = "track.search-stopped"
"""Code of the permanent note (stored with the case) on a search that leaked out of the airways."""

# Minimum rise in HU to the wall of an airway that is followed beyond the flood (docs/decisions/0112).
MIN_RISE_HU = 15.0
# Maximum gap in mm in the wall of a followed airway; mucus or heart motion may cause a gap.
GAP_MM = 2.0
# Length in mm of an extension beyond the flood's end below which the extension is dropped, in thin slices.
MIN_FOLLOWED_MM = 2.0
# Slice thickness in mm up to which the shortest followed branch has :data:`MIN_FOLLOWED_MM`.
THIN_SLICE_MM = 1.0
# Increase of the shortest followed length per mm of slice thickness. Thick slices show a small wall only as partial
# volume, so more sections must agree.
THICK_SECTIONS = 5.0
# Maximum value in HU of a followed voxel: half of the rise from air to wall.
HALF_WALL_HU = -500.0

# Minimum probability that a followed path, and each path from which it continues, is an airway (docs/decisions/0112).
MIN_PROBABILITY = 0.7
# Log odds per section in divided slices, of which only the excess counts as evidence for the path
# (docs/decisions/0114).
MIN_ODDS = 0.3

# Undershoot in HU beside edges above which a kernel counts as sharp; its dark rims look like airways
# (docs/decisions/0113).
SHARP_HU = 4.0
# Increase of SHARP_HU per HU of noise.
NOISE_SHARE = 0.15
# Minimum rise of a wall in CTs with a sharp kernel, as a multiple of the undershoot.
SHARP_BAR = 1.5
# Factors on the least enclosure by walls that a path needs, tried in order after each leak; 1 is the enclosure of this
# CT's lung.
BARS = (1.0, 2.0, 4.0)
# Factors on the least enclosure, as `BARS`, for CTs with a sharp kernel.
SHARP_BARS = (3.0, 5.0)
# Maximum share of the lung that a search reaches without a leak (intact searches: at most 0.4 %).
MAX_REACHED = 0.02
# Maximum length in mm that a search follows without a leak (at most 0.35 m in eight CTs).
MAX_FOLLOWED_MM = 2500.0
# Maximum length in mm that a search follows without a leak in CTs with a sharp kernel.
SHARP_FOLLOWED_MM = 400.0

# Maximum value in HU of the dark middle of the thinnest airways, which are bright threads with a dark middle
# (docs/decisions/0112).
THIN_BRIGHTEST_HU = -400.0
# Minimum value in HU of the wall of such an airway, which is brighter than lung.
THIN_MIN_WALL_HU = -700.0
# Minimum depth in HU of the dark middle, averaged over 5 mm; no such depth occurs in lung.
THIN_MIN_DIP_HU = 22.0
# Mean depth in HU of a path's dark middle below its sides, below which a path of a thin airway is dropped.
THIN_ACCEPTED_DIP_HU = 20.0
# Maximum sigma in mm of the blur of a CT, without the blur by its voxels.
THIN_BLUR_MM = 0.85
# Shortest of the thinnest airways, in mm, slices and voxels: the noise of one voxel also appears in its neighbours.
THIN_MIN_MM, THIN_MIN_SLICES, THIN_MIN_VOXELS = 2.0, 2.5, 3.0
# Shortest of the thinnest airways that leave an airway sideways, in mm, slices and voxels.
THIN_SIDE_MM, THIN_SIDE_SLICES, THIN_SIDE_VOXELS = 5.0, 3.3, 6.0
# Maximum share of the lung that the search for the thinnest airways reaches without a leak.
MAX_REACHED_THIN = 0.1

SOFT_KERNEL = "If available, open a reconstruction with a soft kernel"


@dataclass(frozen=True, slots=True)
class FollowedTips:
    """Result of the search for small airways beyond the flood."""

    notes: tuple[str, ...]
    """Texts for the user about the airways that were followed."""
    badge: Note | None
    """Permanent note that the search leaked, and how the search was limited; None if the search did not leak."""
    threads_lps: NDArray[np.float64]
    """Points (n, 3) along the thinnest airways, LPS in mm, each accepted by the CT values along 5 mm of airway."""
    judged: NDArray[np.float64]
    """Points along airways beyond the flood that were judged by odds, (n, 4): LPS in mm, and probability of the
    airway."""
    has_leaked: bool
    """Whether the search leaked into the lung, or would have leaked along the rims of a sharp kernel."""


NOTHING_BEYOND = FollowedTips((), None, np.empty((0, 3)), np.empty((0, 4)), has_leaked=False)


def follow_small_airways(
    searched: SoftenedCt,
    lumen: NDArray[np.uint8],
    scale: AirScale,
    stage: Stages,
    *,
    air: float,
    noise: float,
    size: float = 1.0,
) -> FollowedTips:
    """Follow the airways beyond the flooded lumen; repeat with stricter limits until the search does not leak.

    Parameters
    ----------
    searched
        CT in which the lumen was flooded.
    lumen
        (nz, ny, nx) uint8, 1 inside; changed in place.
    scale
        Conversion from HU to the values of the volume.
    stage
        Receives progress and cancels the search.
    air, noise
        Mean and standard deviation of the voxel values of air in the trachea.
    size
        Size of the chest relative to an adult one, above 0 and at most 1
        (:func:`carina.track.find.chest_size.search_size`). Every length of the search is multiplied by ``size``, the
        blur of the scanner included: a larger blur would accept strands of lung between vessels.
    """
    stage.begin("tracing the small airways")
    disturbed = searched.disturbed
    clean = searched.volume if disturbed is None else disturbed.with_streaks_as_lung(searched.volume, scale)
    volume = _in_adult_mm(clean, size)
    most_hu = SHARP_HU + NOISE_SHARE * noise / scale.span(1.0)
    is_softened = searched.raised > 0.0
    undershoot_hu = searched.left_hu
    if undershoot_hu is None:
        undershoot_hu = edge_undershoot_hu(searched.volume, scale)
    is_sharp = undershoot_hu is not None and undershoot_hu > most_hu
    least_rise = scale.span(MIN_RISE_HU)
    if undershoot_hu is not None and is_sharp:
        least_rise = max(least_rise, scale.span(SHARP_BAR * undershoot_hu))

    divided = None
    if searched.divided is not None:
        axis, slice_mm = searched.divided
        divided = (axis, slice_mm / size, MIN_ODDS)

    def extend_with(raised: float) -> dict[str, Any]:
        return extend_lumen(
            volume.hu_zyx,
            volume.lps_from_ijk,
            lumen,
            air=air,
            lung=(scale.level(LUNG_HU[0]), scale.level(LUNG_HU[1])),
            brightest=scale.level(HALF_WALL_HU),
            least_rise=least_rise,
            gap_mm=GAP_MM,
            min_length_mm=MIN_FOLLOWED_MM + THICK_SECTIONS * max(max(volume.spacing_mm) - THIN_SLICE_MM, 0.0),
            raised=raised,
            most_reached=MAX_REACHED,
            least_probability=MIN_PROBABILITY,
            divided=divided,
            cancel=stage.cancel,
            progress=stage.share,
        )

    if is_sharp and searched.can_be_softened:
        return FollowedTips((), None, np.empty((0, 3)), np.empty((0, 4)), has_leaked=True)
    followed: list[dict[str, Any]] = []
    ran_out = False
    for raised in SHARP_BARS if is_sharp else BARS:
        found = extend_with(raised)
        if not found["ran_out"] and _length_mm(found["followed"]) <= (
            SHARP_FOLLOWED_MM if is_sharp else MAX_FOLLOWED_MM
        ):
            followed = found["followed"]
            break
        # Interpolation turns noise in divided slices into rows of dark voxels, along which a search with the first
        # factor goes far.
        ran_out = searched.divided is None or is_sharp or raised > BARS[0]
        lumen[lumen > 1] = 0
    np.minimum(lumen, 1, out=lumen)
    has_leaked = is_sharp or ran_out
    threads = [] if is_sharp or is_softened or ran_out else _follow_thin_airways(volume, lumen, scale, stage, air=air)
    threads_lps = size * np.concatenate([np.empty((0, 3)), *(way["points_lps"] for way in threads)])
    judged = _path_probabilities(followed, size)
    followed = followed + threads
    notes = []
    if followed:
        notes.append(
            f"{size * _length_mm(followed):.0f} mm of small airways, in {len(followed)} pieces, were traced by the "
            "shape of their walls where the lumen is no darker than the lung"
        )
    # Depth of the rims in the original CT, before it was softened.
    rims_hu = searched.undershoot_hu if is_softened else undershoot_hu
    rims = f"the sharp kernel of this CT produces dark rims ({rims_hu or 0.0:.0f} HU) next to vessels"
    if searched.smoothed_mm > 0.0:
        words = (
            "noise hides the walls of the airways in this CT; they were searched for in a smoothed copy of it, and "
            f"small airways are missing. {SOFT_KERNEL}"
        )
        return FollowedTips(tuple(notes), Note(STOPPED, words, badge=True), threads_lps, judged, has_leaked)
    if not has_leaked:
        if rims_hu is None or not is_softened:
            return FollowedTips(tuple(notes), None, threads_lps, judged, has_leaked)
        words = f"{rims}; the airways were searched for in a softened copy of it"
        if rims_hu <= most_hu:
            return FollowedTips((*notes, words), None, threads_lps, judged, has_leaked)
        note = Note(STOPPED, f"{words}, and some small airways are missing. {SOFT_KERNEL}", badge=True)
        return FollowedTips(tuple(notes), note, threads_lps, judged, has_leaked)
    what = f"{rims}, which look like airways" if is_sharp else "it leaked from the airways into the lung"
    limit_text = "only the clearest are included, and other small airways" if followed else "small airways"
    words = f"the search for small airways was limited because {what}; {limit_text} are missing. {SOFT_KERNEL}"
    return FollowedTips(tuple(notes), Note(STOPPED, words, badge=True), threads_lps, judged, has_leaked)


def _in_adult_mm(volume: Volume, size: float) -> Volume:
    """Return the volume scaled to an adult chest: distances divided by ``size``.

    Returns the volume itself if ``size`` is 1.
    """
    if size == 1.0:
        return volume
    larger = volume.lps_from_ijk.copy()
    larger[:3] /= size
    return dataclasses.replace(volume, lps_from_ijk=larger)


def _follow_thin_airways(
    volume: Volume, lumen: NDArray[np.uint8], scale: AirScale, stage: Stages, *, air: float
) -> list[dict[str, Any]]:
    """Follow the thinnest airways from a lumen and return them; the lumen (1 inside) is changed in place."""
    _, voxel_mm, slice_mm = sorted(volume.spacing_mm)
    found = extend_thin_lumen(
        volume.hu_zyx,
        volume.lps_from_ijk,
        lumen,
        air=air,
        lung=(scale.level(LUNG_HU[0]), scale.level(LUNG_HU[1])),
        brightest=scale.level(THIN_BRIGHTEST_HU),
        least_wall=scale.level(THIN_MIN_WALL_HU),
        least_dip=scale.span(THIN_MIN_DIP_HU),
        least_mean_dip=scale.span(THIN_ACCEPTED_DIP_HU),
        blur_mm=THIN_BLUR_MM,
        min_length_mm=max(THIN_MIN_MM, THIN_MIN_SLICES * slice_mm, THIN_MIN_VOXELS * voxel_mm),
        min_side_mm=max(THIN_SIDE_MM, THIN_SIDE_SLICES * slice_mm, THIN_SIDE_VOXELS * voxel_mm),
        most_reached=MAX_REACHED_THIN,
        cancel=stage.cancel,
        progress=stage.share,
    )
    np.minimum(lumen, 1, out=lumen)
    followed: list[dict[str, Any]] = found["followed"]
    return followed


def _path_probabilities(followed: Sequence[dict[str, Any]], size: float) -> NDArray[np.float64]:
    """Return the points of followed paths that were judged by odds, with their probabilities: (n, 4), LPS in mm."""
    points = [
        np.column_stack([size * way["points_lps"], np.full(len(way["points_lps"]), way["probability"])])
        for way in followed
        if way["probability"] < 1.0
    ]
    return np.concatenate([np.empty((0, 4)), *points])


def _length_mm(followed: Sequence[dict[str, Any]]) -> float:
    return float(sum(path["length_mm"] for path in followed))
