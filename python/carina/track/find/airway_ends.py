"""Uncertain ends of airways: where the search lost an airway, with the evidence in the CT there."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from carina.track.find.end_evidence import find_end_evidence, has_clips
from carina.track.find.straight_ends import find_straight_end
from carina.track.find.wall_profile import CrossSampler
from carina.track.tree.airway_tree import AirwayTree, Branch
from carina.track.tree.uncertainty import FAINT, Uncertainty, UncertaintyKind, slice_from_feet
from carina.volume.model import Volume

Points = NDArray[np.float64]

# Diameter in mm below which an airway may simply end, because it is at the limit of a CT; a wider end counts as lost.
FINE_MM = 2.5
# Diameter in voxels below which an airway is at the limit of a CT.
FINE_VOX = 3.0
# Radius in mm of the ball round a leak within which the flood was closed.
NEAR_LEAK_MM = 10.0
# Maximum distance in mm between the end of the lumen and the filling (mucus or tissue in the lumen) at which the lumen
# ends.
AT_END_MM = 4.0
# Distance in mm from the tip at which the measurement of the calibre stops, because the lumen ends bluntly there; it
# starts CALIBRE_MM before the tip.
BLUNT_MM = 2.0
# Distance in mm from the tip at which the last part of a branch starts, in which the width of the end is measured.
CALIBRE_MM = 8.0
# Highest generation in which an end can be a stump of a lobar bronchus; the trachea is generation 0.
LAST_LOBAR_GENERATION = 3


def find_uncertain(
    volume: Volume, tree: AirwayTree, leaks_lps: Points, filled: Sequence[Uncertainty] = ()
) -> tuple[Uncertainty, ...]:
    """List the ends of the tree that are wider than the thinnest airways of the CT, each with its evidence.

    Parameters
    ----------
    volume
        The CT that was searched.
    tree
        The airway tree.
    leaks_lps
        (n, 3) LPS mm, points at which the growth was stopped because it would have leaked into the lung.
    filled
        Filled or narrowed places that were found before. Places that are still at a branch of the tree are returned
        too; an end at such a place is not listed separately.

    Returns
    -------
    tuple of Uncertainty
        The widest first. If some ends are too thin for the CT, the last entry is of kind ``fine`` and states their
        median calibre.
    """
    voxel_mm = float(np.cbrt(np.prod(volume.spacing_mm)))
    fine_mm = max(FINE_MM, FINE_VOX * voxel_mm)
    places = [place for one in filled if (place := _with_nearest_branch(tree, one)) is not None]
    listed: list[tuple[float, Uncertainty]] = [(one.calibre_mm or one.width_mm, one) for one in places]
    ends_mm = []
    look: CrossSampler | None = None
    for branch in tree.tips():
        calibre_mm = _calibre_mm(branch)
        if branch.parent is None or any(_ends_at(branch, one) for one in places):
            continue
        kind: UncertaintyKind
        if _leaves_volume(volume, branch, calibre_mm):
            kind = "volume"
        elif calibre_mm < fine_mm:
            ends_mm.append(calibre_mm)
            continue
        elif _is_near(leaks_lps, branch.tip_lps):
            kind = "leak"
        else:
            look = look or CrossSampler(volume)
            listed.append((calibre_mm, _end_of_branch(volume, look, branch, calibre_mm)))
            continue
        listed.append((calibre_mm, _uncertain_place(branch.tip_lps, kind, branch.id, calibre_mm)))
    for branch in tree.branches:
        if branch.generation > LAST_LOBAR_GENERATION or branch.parent is None:
            continue
        look = look or CrossSampler(volume)
        straight = find_straight_end(look, branch)
        if straight is not None:
            stump = _uncertain_place(straight.lps, "stump", branch.id, straight.width_mm)
            clips = has_clips(volume, straight.lps + 0.5 * straight.width_mm * straight.axis)
            listed.append((straight.width_mm, msgspec.structs.replace(stump, has_clips=clips)))
    for branch in tree.branches:
        if branch.confidence is not None and branch.confidence < FAINT:
            middle = branch.points[len(branch.points) // 2]
            calibre_mm = _calibre_mm(branch)
            faint = _uncertain_place(middle, "faint", branch.id, calibre_mm, confidence=branch.confidence)
            listed.append((calibre_mm, faint))
    listed.sort(key=lambda entry: (-entry[0], entry[1].branch_id))
    found = [entry for _, entry in listed]
    if ends_mm:
        median_mm = float(np.median(ends_mm))
        at = tree.root.points[0]
        found.append(_uncertain_place(at, "fine", None, median_mm, num_ends=len(ends_mm), voxel_mm=voxel_mm))
    return tuple(_with_slice_number(volume, place) for place in found)


def _with_slice_number(volume: Volume, place: Uncertainty) -> Uncertainty:
    if place.branch_id is None:
        return place
    number, count = slice_from_feet(volume, np.array(place.lps))
    return msgspec.structs.replace(place, slice_number=number, num_slices=count)


def _end_of_branch(volume: Volume, look: CrossSampler, branch: Branch, calibre_mm: float) -> Uncertainty:
    """Return the uncertain place (blocked, stump, lost) at the end of a branch that could continue, or None."""
    evidence = find_end_evidence(volume, look, branch, calibre_mm)
    if evidence is None:
        return _uncertain_place(branch.tip_lps, "lost", branch.id, calibre_mm)
    if evidence.kind == "tissue":
        blocked = _uncertain_place(branch.tip_lps, "blocked", branch.id, calibre_mm)
        return msgspec.structs.replace(blocked, length_mm=evidence.length_mm)
    stump = _uncertain_place(branch.tip_lps, "stump", branch.id, calibre_mm)
    return msgspec.structs.replace(stump, has_clips=evidence.has_clips)


def _uncertain_place(
    at: Points,
    kind: UncertaintyKind,
    branch_id: int | None,
    width_mm: float,
    *,
    confidence: float | None = None,
    num_ends: int | None = None,
    voxel_mm: float | None = None,
) -> Uncertainty:
    return Uncertainty(
        lps=(float(at[0]), float(at[1]), float(at[2])),
        kind=kind,
        branch_id=branch_id,
        width_mm=width_mm,
        confidence=confidence,
        num_ends=num_ends,
        voxel_mm=voxel_mm,
    )


def _with_nearest_branch(tree: AirwayTree, place: Uncertainty) -> Uncertainty | None:
    """Return a place with filled lumen together with its nearest branch of the tree.

    None if the bronchus was removed or the tree continues beyond it.
    """
    at = np.array(place.lps)
    branch, index, away_mm = tree.nearest_branch(at)
    if place.beyond_lps is not None:
        other, nearest, beyond_mm = tree.nearest_branch(np.array(place.beyond_lps))
        if beyond_mm <= max(float(other.radius[nearest]), 1.0):
            # A path leads beyond the filling now: the place stays listed, but needs no bridge.
            return msgspec.structs.replace(place, branch_id=branch.id, beyond_lps=None)
    reach_mm = float(branch.radius[index]) + 0.5 * (place.calibre_mm or 0.0)
    if place.beyond_lps is not None:
        # The filling begins at the end of the lumen, so the distance to that end is added.
        reach_mm += 0.5 * (place.length_mm or 0.0) + AT_END_MM
    return msgspec.structs.replace(place, branch_id=branch.id) if away_mm <= reach_mm else None


def _ends_at(branch: Branch, place: Uncertainty) -> bool:
    """Return whether a branch ends at a place where mucus or other material fills the lumen."""
    off_mm = float(np.linalg.norm(branch.tip_lps - np.array(place.lps)))
    return off_mm <= 0.5 * (place.length_mm or 0.0) + AT_END_MM


def _calibre_mm(branch: Branch) -> float:
    """Return the median diameter in mm of the last part of a branch before its blind end."""
    steps = np.linalg.norm(np.diff(branch.points, axis=0), axis=1)
    to_tip = float(steps.sum()) - np.concatenate([[0.0], np.cumsum(steps)])
    stretch = (to_tip >= min(BLUNT_MM, 0.5 * to_tip[0])) & (to_tip <= CALIBRE_MM)
    chosen: Sequence[float] | NDArray[np.float64] = branch.radius[stretch] if stretch.any() else branch.radius
    return 2.0 * float(np.median(chosen))


def _leaves_volume(volume: Volume, branch: Branch, calibre_mm: float) -> bool:
    """Return whether a branch's tip is within its own radius and a voxel of a face of the volume."""
    ijk = volume.to_ijk(branch.tip_lps)
    last = np.array(volume.shape_zyx[::-1]) - 1
    spacing = np.array(volume.spacing_mm)
    return bool((np.minimum(ijk, last - ijk) * spacing <= 0.5 * calibre_mm + spacing).any())


def _is_near(leaks_lps: Points, tip: Points) -> bool:
    return len(leaks_lps) > 0 and bool((np.linalg.norm(leaks_lps - tip, axis=1) <= NEAR_LEAK_MM).any())
