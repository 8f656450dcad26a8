"""Forks of the airways: the carina between two branches, their angles, and the sections that belong to a fork."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.track.tree.airway_tree import AirwayTree, Branch
from carina.volume.model import Volume

Points = NDArray[np.float64]

CHORD_DIAMETERS = 2.0
"""Length of the chords on both sides of a fork between which an angle is measured, in diameters."""
STEP_MM = 0.25
"""Step in mm along two branches of a fork at which their centrelines are compared."""
BEYOND_CARINA_RADII = 0.5
"""Distance beyond the carina, in radii, from which a section contains only the lumen of the branch that it crosses."""
BEFORE_FORK_RADII = 1.0
"""Distance before a fork, in radii, from which the lumen is wider than the branch."""


@one_line
@dataclass(frozen=True, slots=True)
class ForkMeasures:
    """Measurements of the fork at the end of a branch."""

    branch_id: int
    """ID of the branch that ends in the fork."""
    children: tuple[int, ...]
    """IDs of the branches that begin at the fork."""
    fork_lps: tuple[float, float, float]
    """Point at which the centrelines part (LPS, mm): where the axes of the tubes meet."""
    carina_lps: tuple[float, float, float] | None
    """Ridge of the wall between the first two children that part (LPS, mm); None if no wall separates them."""
    fork_to_carina_mm: float | None
    """Distance from ``fork_lps`` to ``carina_lps``, mm; None without a carina."""
    angle_between_deg: float | None
    """Angle in degrees between the chords of the two widest children; None if one has no length."""

    def to_json(self) -> dict[str, Any]:
        """Return the measurements as JSON values."""
        return {
            "branch": self.branch_id,
            "children": list(self.children),
            "fork_lps": list(self.fork_lps),
            "carina_lps": None if self.carina_lps is None else list(self.carina_lps),
            "fork_to_carina_mm": self.fork_to_carina_mm,
            "angle_between_deg": self.angle_between_deg,
        }


def run_mm(points: Points) -> NDArray[np.float64]:
    """Return the (n,) cumulative length along points, in mm."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def point_at(points: Points, at_mm: NDArray[np.float64] | float) -> Points:
    """Return (..., 3) points at given lengths (mm) along a polyline, clamped to its ends."""
    along = run_mm(points)
    return np.stack([np.interp(at_mm, along, points[:, axis]) for axis in range(3)], axis=-1)


def directions(points: Points, radius_mm: NDArray[np.float64], before: Points | None = None) -> Points:
    """Return (n, 3) unit tangents at the points of a branch, each over about one diameter.

    Parameters
    ----------
    points
        (n, 3) centreline, LPS in mm.
    radius_mm
        (n,) radius.
    before
        Point before the first one, on the parent, from which a branch of a single point gets its direction. Without
        it the tangents of such a branch are zero.
    """
    along = run_mm(points)
    reach = np.clip(radius_mm, 1.0, 4.0)
    ends = point_at(points, along + reach) - point_at(points, along - reach)
    if before is not None and along[-1] == 0.0:
        ends = points - before
    lengths = np.linalg.norm(ends, axis=1, keepdims=True)
    tangents: Points = np.divide(ends, lengths, out=np.zeros_like(ends), where=lengths > 1e-9)
    return tangents


def angle_deg(parent: Branch, child: Branch) -> float | None:
    """Return the angle in degrees between a branch and its parent; 0 for a straight continuation.

    The angle is measured between the chord of the parent's last two diameters and that of the child's first two,
    with diameters from the median distance to the wall; shorter branches give shorter chords. Returns None if one of
    them has no length.
    """
    one = _chord(parent, at_end=True)
    other = _chord(child, at_end=False)
    return None if one is None or other is None else _between_deg(one, other)


def _chord(branch: Branch, *, at_end: bool) -> Points | None:
    length = branch.length_mm
    if length <= 0.0:
        return None
    reach = min(CHORD_DIAMETERS * 2.0 * float(np.median(branch.radius)), length)
    first, last = (length - reach, length) if at_end else (0.0, reach)
    chord = point_at(branch.points, last) - point_at(branch.points, first)
    size = float(np.linalg.norm(chord))
    return chord / size if size > 0.0 else None


def _between_deg(one: Points, other: Points) -> float:
    return math.degrees(math.acos(float(np.clip(one @ other, -1.0, 1.0))))


def find_forks(volume: Volume, lumen_zyx: NDArray[np.uint8], tree: AirwayTree) -> tuple[ForkMeasures, ...]:
    """Measure every fork of a tree, in the order of its branches."""
    by_id = {branch.id: branch for branch in tree.branches}
    forks = []
    for branch in tree.branches:
        if not branch.children:
            continue
        children = [by_id[child] for child in branch.children]
        ridge = None
        for number, one in enumerate(children):
            for other in children[number + 1 :]:
                found = _carina(volume, lumen_zyx, one, other)
                if found is not None and (ridge is None or found[0] < ridge[0]):
                    ridge = found
        wide = sorted(children, key=lambda child: (-float(np.median(child.radius)), child.id))
        chords = [_chord(child, at_end=False) for child in wide[:2]]
        between = None
        if len(chords) == 2 and chords[0] is not None and chords[1] is not None:
            between = _between_deg(chords[0], chords[1])
        fork = branch.points[-1]
        forks.append(
            ForkMeasures(
                branch_id=branch.id,
                children=branch.children,
                fork_lps=_as_tuple(fork),
                carina_lps=None if ridge is None else _as_tuple(ridge[1]),
                fork_to_carina_mm=None if ridge is None else float(np.linalg.norm(ridge[1] - fork)),
                angle_between_deg=between,
            )
        )
    return tuple(forks)


def _as_tuple(point: Points) -> tuple[float, float, float]:
    return float(point[0]), float(point[1]), float(point[2])


def _carina(volume: Volume, lumen_zyx: NDArray[np.uint8], one: Branch, other: Branch) -> tuple[float, Points] | None:
    """Return the ridge of wall at which two branches part: distance (mm) from the fork, and a point.

    Points at the same distance from the fork on both branches are joined by straight lines; the first line that
    leaves the lumen crosses the ridge. Returns None if none does.
    """
    length = min(one.length_mm, other.length_mm)
    if length <= 0.0:
        return None
    at: NDArray[np.float64] = np.arange(1.0, int(length / STEP_MM) + 1.0) * STEP_MM
    a, b = point_at(one.points, at), point_at(other.points, at)
    share = np.linspace(0.0, 1.0, 41)
    lines = a[:, None] + share[None, :, None] * (b - a)[:, None]
    inside = _lumen_at(volume, lumen_zyx, lines)
    # Both ends of a line are points of centrelines, which are in the lumen, but interpolation may state the opposite:
    # they are left out.
    walls = inside[:, 1:-1].min(axis=1) < 0.5
    if not walls.any():
        return None
    first = int(np.argmax(walls))
    outside = np.flatnonzero(inside[first, 1:-1] < 0.5) + 1
    middle = int(outside[len(outside) // 2])
    ridge: Points = lines[first, middle]
    return float(at[first]), ridge


def _lumen_at(volume: Volume, lumen_zyx: NDArray[np.uint8], points: Points) -> NDArray[np.float64]:
    """Return the share of lumen (0..1) at each (..., 3) point: linear between voxels, 0 outside the volume."""
    ijk = volume.to_ijk(points)
    base = np.floor(ijk).astype(np.int64)
    share = ijk - base
    nz, ny, nx = lumen_zyx.shape
    found = np.zeros(points.shape[:-1])
    for corner in range(8):
        offset = np.array([corner & 1, corner >> 1 & 1, corner >> 2])
        at = base + offset
        weight = np.prod(np.where(offset == 1, share, 1.0 - share), axis=-1)
        there = ((at >= 0) & (at < np.array([nx, ny, nz]))).all(axis=-1)
        i, j, k = np.moveaxis(np.where(there[..., None], at, 0), -1, 0)
        found += np.where(there, weight * (lumen_zyx[k, j, i] != 0), 0.0)
    return found


def junction_flags(
    branch: Branch,
    tangents: Points,
    fork_before: ForkMeasures | None,
    fork_after: ForkMeasures | None,
    parent_radius_mm: float | None,
) -> NDArray[np.bool_]:
    """Return (n,) flags of the sections of a branch that cut through a fork and so contain another lumen.

    At the start of the branch these are the sections whose plane is not yet half a radius beyond the carina (without
    a carina: within a parent's radius of the fork); at its end those within a radius of the fork.
    """
    points = branch.points
    along = run_mm(points)
    radius = float(np.median(branch.radius))
    flags = np.zeros(len(points), dtype=np.bool_)
    if fork_before is not None:
        if fork_before.carina_lps is None:
            reach = parent_radius_mm if parent_radius_mm is not None else radius
            flags |= along < reach
        else:
            # A plane has passed the carina if the carina is behind it.
            passed = ((points - np.array(fork_before.carina_lps)) * tangents).sum(axis=1)
            beyond = passed >= BEYOND_CARINA_RADII * radius
            first = int(np.argmax(beyond)) if beyond.any() else len(points)
            flags[:first] = True
    if fork_after is not None:
        flags |= along > along[-1] - BEFORE_FORK_RADII * radius
    return flags
