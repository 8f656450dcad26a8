"""What the automatic airways could not follow, and how sure each branch is."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from carina.commands.fields import AirwayPlace, Count, Part, PointLps
from carina.track.tree.airway_tree import AirwayTree, Branch
from carina.volume.model import Volume

__all__ = ["THREAD_SHARE", "Uncertainty", "UncertaintyKind", "filled_place", "find_uncertain", "with_confidence"]

UncertaintyKind = Literal["blocked", "filled", "leak", "volume", "faint", "fine"]
Points = NDArray[np.float64]

FAINT = 0.5
"""A branch whose confidence is lower is more likely no airway, and listed as uncertain."""
# How often branches whose walls score so are true airways: (score, share), rising. Isotonic, on phantoms of the seeds
# 101 to 114, good and degraded, with strands beside the airways; judged on the seeds 201 to 214 (docs/decisions/0063;
# carina_bench.track_confidence makes it).
AIRWAY_SHARE = (
    *((0.0, 0.0), (0.260, 0.001), (0.619, 0.010), (0.798, 0.066), (0.874, 0.161), (0.913, 0.275), (0.936, 0.620)),
    *((0.962, 0.675), (0.975, 0.817), (0.986, 0.944), (0.992, 0.969), (0.997, 0.981), (1.0, 0.999)),
)
# The thinnest airways, whose walls rise by less than the noise of a voxel, were judged along 5 mm of them (0060): of
# 131 such ways that were found in four CTs one was none. A branch is one where half its points lie so near to one.
THREAD_SHARE = 0.95
NEAR_THREAD_MM = 1.5
# Airways thinner than this are at the end of what a CT shows; one that ends wider has been lost on the way.
FINE_MM = 2.5
FINE_VOX = 3.0
# The ball that the flood closes round a breach.
NEAR_LEAK_MM = 10.0
# The lumen's end and the filling that it ends at.
AT_END_MM = 4.0
# The last stretch of a branch runs into its blind end: its calibre is read before it.
BLUNT_MM = 2.0
CALIBRE_MM = 8.0
NUM_SECTIONS = 12
NUM_SIDES = 16


class Uncertainty(AirwayPlace, frozen=True, kw_only=True):
    """A place where the automatic airways stop short, or should be looked at; the window is sent it as it is.

    Its branch is the one that ends there, or is meant; None for the whole tree.
    """

    kind: UncertaintyKind
    """``blocked`` (the lumen ends though its calibre says that it goes on), ``filled`` (secretions or something else
    narrow or fill the lumen, and the bronchus goes on: the place is the middle of that stretch), ``leak`` (following it
    would have run out into the lung), ``volume`` (the volume ends there), ``faint`` (the branch may be no airway),
    ``fine`` (from here on the CT is too coarse; once for the whole tree)."""
    width_mm: float
    """Diameter of the airway where it was last seen; of ``fine`` the median of the ends that are that thin; of
    ``filled`` that of the circle with the area of the air that is left, 0 where there is none."""
    confidence: Part | None
    """Of the branch, where it is ``faint``."""
    num_ends: Count | None
    """How many ends are that thin, where it is ``fine``."""
    voxel_mm: float | None
    """Mean edge of a voxel, where it is ``fine``."""
    length_mm: float | None = None
    """Over how long it is ``filled``."""
    calibre_mm: float | None = None
    """From inner wall to inner wall through what fills it, where it is ``filled``; None where it cannot be measured."""
    calibre_error_mm: float | None = None
    """Half of the interval that should hold it."""
    beyond_lps: PointLps | None = None
    """A place in the air beyond, where it is ``filled`` and no path leads there: what a bridge leads to."""

    @property
    def reason(self) -> str:
        """Why, in words."""
        match self.kind:
            case "volume":
                return f"the scan ends here, but the airway ({self.width_mm:.1f} mm wide) continues"
            case "leak":
                return (
                    f"the airway was lost where its lumen is {self.width_mm:.1f} mm wide: its wall is too thin here, "
                    "and the search would have leaked into the lung"
                )
            case "blocked":
                return (
                    f"the lumen ends where it is {self.width_mm:.1f} mm wide: possibly mucus, a collapsed or narrowed "
                    "airway, or a wall that the CT does not show"
                )
            case "filled":
                return _filled_words(self)
            case "faint":
                return f"its wall is barely visible (confidence {self.confidence:.2f}): it may not be an airway"
            case "fine":
                ends = "the thinnest branch end" if self.num_ends == 1 else f"the {self.num_ends} thinnest branch ends"
                return (
                    f"this CT ({self.voxel_mm:.2f} mm voxels) does not reliably show airways narrower than "
                    f"{self.width_mm:.1f} mm, the median width at {ends}: there are smaller airways that are not shown"
                )


def _filled_words(place: Uncertainty) -> str:
    """Return the text of a place that is narrowed or filled."""
    if place.calibre_mm is None:
        bronchus = "; its calibre from wall to wall cannot be measured here"
    else:
        width = f"{place.calibre_mm:.1f} \u00b1 {place.calibre_error_mm or 0.0:.1f} mm"
        bronchus = f" in a bronchus {width} wide from wall to wall"
    air = "no air is visible" if place.width_mm == 0.0 else f"the air is {place.width_mm:.1f} mm wide"
    beyond = "" if place.beyond_lps is None else "; there is an airway beyond it, which a bridge can reach"
    return (
        f"narrowed or filled here over {place.length_mm or 0.0:.0f} mm: {air}{bronchus}{beyond}. Possibly secretions "
        "or a mucus plug; a CT cannot distinguish these from a tumour or a collapsed airway"
    )


def filled_place(
    at: Points,
    branch_id: int,
    *,
    air_mm: float,
    length_mm: float,
    calibre_mm: float | None,
    calibre_error_mm: float | None,
    beyond_lps: Points | None,
) -> Uncertainty:
    """Where a lumen is narrowed or filled; see the fields of :class:`Uncertainty`."""
    return Uncertainty(
        lps=(float(at[0]), float(at[1]), float(at[2])),
        kind="filled",
        branch_id=branch_id,
        width_mm=air_mm,
        confidence=None,
        num_ends=None,
        voxel_mm=None,
        length_mm=length_mm,
        calibre_mm=calibre_mm,
        calibre_error_mm=calibre_error_mm,
        beyond_lps=None if beyond_lps is None else (float(beyond_lps[0]), float(beyond_lps[1]), float(beyond_lps[2])),
    )


def _uncertain(
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


def find_uncertain(
    volume: Volume, tree: AirwayTree, leaks_lps: Points, filled: Sequence[Uncertainty] = ()
) -> tuple[Uncertainty, ...]:
    """Say of each end of the tree why it ends there, unless it is as thin as the CT can show.

    Parameters
    ----------
    leaks_lps
        (n, 3) LPS mm, where the growth was stopped because it would have run out into the lung.
    filled
        Places where something fills or narrows a lumen, found before. Those that the tree still has are told, of the
        branch that is there now; an end at such a place has that reason.

    Returns
    -------
    tuple of Uncertainty
        The widest first; last, where the CT stops being trustworthy.
    """
    voxel_mm = float(np.cbrt(np.prod(volume.spacing_mm)))
    fine_mm = max(FINE_MM, FINE_VOX * voxel_mm)
    told = [place for one in filled if (place := _still_filled(tree, one)) is not None]
    listed: list[tuple[float, Uncertainty]] = [(one.calibre_mm or one.width_mm, one) for one in told]
    ends_mm = []
    for branch in tree.tips():
        calibre_mm = _calibre_mm(branch)
        if branch.parent is None or any(_ends_at(branch, one) for one in told):
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
            kind = "blocked"
        listed.append((calibre_mm, _uncertain(branch.tip_lps, kind, branch.id, calibre_mm)))
    for branch in tree.branches:
        if branch.confidence is not None and branch.confidence < FAINT:
            middle = branch.points[len(branch.points) // 2]
            calibre_mm = _calibre_mm(branch)
            faint = _uncertain(middle, "faint", branch.id, calibre_mm, confidence=branch.confidence)
            listed.append((calibre_mm, faint))
    listed.sort(key=lambda entry: (-entry[0], entry[1].branch_id))
    found = [entry for _, entry in listed]
    if ends_mm:
        median_mm = float(np.median(ends_mm))
        at = tree.root.points[0]
        found.append(_uncertain(at, "fine", None, median_mm, num_ends=len(ends_mm), voxel_mm=voxel_mm))
    return tuple(found)


def _still_filled(tree: AirwayTree, place: Uncertainty) -> Uncertainty | None:
    """Return the place with its nearest branch; None if the bronchus was removed or an edit leads beyond the place."""
    at = np.array(place.lps)
    branch, index, away_mm = tree.nearest_branch(at)
    if place.beyond_lps is not None:
        other, nearest, beyond_mm = tree.nearest_branch(np.array(place.beyond_lps))
        if beyond_mm <= max(float(other.radius[nearest]), 1.0):
            # A path leads there now: what is in the way stays told, without a bridge to make.
            return msgspec.structs.replace(place, branch_id=branch.id, beyond_lps=None)
    reach_mm = float(branch.radius[index]) + 0.5 * (place.calibre_mm or 0.0)
    if place.beyond_lps is not None:
        # The lumen ends where the filling begins.
        reach_mm += 0.5 * (place.length_mm or 0.0) + AT_END_MM
    return msgspec.structs.replace(place, branch_id=branch.id) if away_mm <= reach_mm else None


def _ends_at(branch: Branch, place: Uncertainty) -> bool:
    """Whether a branch ends in what fills a place."""
    off_mm = float(np.linalg.norm(branch.tip_lps - np.array(place.lps)))
    return off_mm <= 0.5 * (place.length_mm or 0.0) + AT_END_MM


def with_confidence(
    volume: Volume,
    tree: AirwayTree,
    noise: float,
    threads_lps: Points | None = None,
    *,
    thread_share: float = THREAD_SHARE,
) -> AirwayTree:
    """Fill each branch's confidence that it is airway, from what the CT shows across it.

    Three things count, each from 0 to 1: the share of sides with wall; how far the wall rises above the lumen, over the
    noise (``1 - exp(-rise / 3 noise)``); and the diameter in voxels (a lumen below 2 voxels is a blur: half of it is
    taken on trust). They are multiplied; a branch has the median of its sections. That score becomes a probability: how
    often branches of phantoms that score so are true airways.

    Parameters
    ----------
    noise
        Standard deviation of the values in the air of the trachea.
    threads_lps
        (n, 3) LPS mm, points along airways that were judged by more than this: the thinnest.
    thread_share
        Confidence of a branch along ``threads_lps`` whose own score is lower.
    """
    return dataclasses.replace(
        tree, branches=tuple(_judged_with(volume, branch, noise, threads_lps, thread_share) for branch in tree.branches)
    )


def _judged_with(
    volume: Volume, branch: Branch, noise: float, threads_lps: Points | None, thread_share: float
) -> Branch:
    own = judged(volume, branch, noise)
    if threads_lps is None or own.confidence is None or own.confidence >= thread_share:
        return own
    low, high = branch.points.min(axis=0) - NEAR_THREAD_MM, branch.points.max(axis=0) + NEAR_THREAD_MM
    near = threads_lps[((threads_lps >= low) & (threads_lps <= high)).all(axis=1)]
    if not len(near):
        return own
    apart_mm = np.linalg.norm(branch.points[:, None] - near[None], axis=2).min(axis=1)
    is_thread = float((apart_mm <= NEAR_THREAD_MM).mean()) >= 0.5
    return dataclasses.replace(own, confidence=thread_share) if is_thread else own


def judged(volume: Volume, branch: Branch, noise: float) -> Branch:
    """One branch with its confidence, see :func:`with_confidence`."""
    share = np.interp(_wall_score(volume, branch, noise), *np.array(AIRWAY_SHARE).T)
    return dataclasses.replace(branch, confidence=round(float(share), 3))


def _wall_score(volume: Volume, branch: Branch, noise: float) -> float:
    steps = np.linalg.norm(np.diff(branch.points, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    # Not at the forks, where a side is open.
    from_mm = min(float(branch.radius[0]), 0.3 * along[-1])
    at = np.linspace(from_mm, max(along[-1] - min(BLUNT_MM, 0.2 * along[-1]), from_mm), NUM_SECTIONS)
    place = np.stack([np.interp(at, along, branch.points[:, axis]) for axis in range(3)], axis=1)
    ahead = np.stack([np.interp(at + 1.0, along, branch.points[:, axis]) for axis in range(3)], axis=1)
    behind = np.stack([np.interp(at - 1.0, along, branch.points[:, axis]) for axis in range(3)], axis=1)
    tangent = ahead - behind
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    helper = np.eye(3)[np.argmin(np.abs(tangent), axis=1)]
    across = np.cross(tangent, helper)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    up = np.cross(tangent, across)
    angle = 2.0 * np.pi * np.arange(NUM_SIDES) / NUM_SIDES
    sides = np.cos(angle)[None, :, None] * across[:, None, :] + np.sin(angle)[None, :, None] * up[:, None, :]
    radius = np.interp(at, along, branch.radius)
    spacing = np.array(volume.spacing_mm)
    step_mm = 0.5 * float(spacing.min())
    # The wall of an airway is thinner than its radius; blur and slices add to it.
    reach_mm = 2.0 * radius.max() + 1.5 + float(spacing.max())
    off = np.arange(0.0, reach_mm, step_mm)
    points = place[:, None, None, :] + sides[:, :, None, :] * off[None, None, :, None]
    values = _values_at(volume, points.reshape(-1, 3)).reshape(NUM_SECTIONS, NUM_SIDES, len(off))
    # Three sections together, and neighbouring steps: a single noisy voxel is no wall.
    values = (values + np.roll(values, 1, axis=0) + np.roll(values, -1, axis=0)) / 3.0
    lumen = values[:, :, 0].mean(axis=1)
    rise = values.max(axis=2) - lumen[:, None]
    walled = (rise > 3.0 * noise).mean(axis=1)
    contrast = 1.0 - np.exp(-np.maximum(np.median(rise, axis=1), 0.0) / (3.0 * max(noise, 1e-6)))
    calibre = np.clip(0.5 + 0.25 * 2.0 * radius / float(np.cbrt(np.prod(spacing))), 0.5, 1.0)
    return float(np.clip(np.median(walled * contrast * calibre), 0.0, 1.0))


def _values_at(volume: Volume, points: Points) -> Points:
    """Nearest voxel's value at (n, 3) LPS points, the edge's beyond it."""
    shape = np.array(volume.shape_zyx[::-1])
    i, j, k = np.clip(np.floor(volume.to_ijk(points) + 0.5).astype(int), 0, shape - 1).T
    values: Points = volume.hu_zyx[k, j, i].astype(np.float64)
    return values


def _calibre_mm(branch: Branch) -> float:
    """Diameter of the last stretch of a branch before its blind end."""
    steps = np.linalg.norm(np.diff(branch.points, axis=0), axis=1)
    to_tip = float(steps.sum()) - np.concatenate([[0.0], np.cumsum(steps)])
    stretch = (to_tip >= min(BLUNT_MM, 0.5 * to_tip[0])) & (to_tip <= CALIBRE_MM)
    chosen: Sequence[float] | NDArray[np.float64] = branch.radius[stretch] if stretch.any() else branch.radius
    return 2.0 * float(np.median(chosen))


def _leaves_volume(volume: Volume, branch: Branch, calibre_mm: float) -> bool:
    """Return whether the tip is nearer to a face of the volume than its own radius and a voxel."""
    ijk = volume.to_ijk(branch.tip_lps)
    last = np.array(volume.shape_zyx[::-1]) - 1
    spacing = np.array(volume.spacing_mm)
    return bool((np.minimum(ijk, last - ijk) * spacing <= 0.5 * calibre_mm + spacing).any())


def _is_near(leaks_lps: Points, tip: Points) -> bool:
    return len(leaks_lps) > 0 and bool((np.linalg.norm(leaks_lps - tip, axis=1) <= NEAR_LEAK_MM).any())
