"""Decoration grid: positions on the airway wall for the rings and the membranous wall of the *endoscopic* preset.

The kernel that lights a pixel knows only a point in LPS. This module computes a coarse grid around the wide airways
that gives, for each cell, the number of rings proximal to it, its side of the airway, and the strength of each part of
the decoration. These values change smoothly along and across a tube, so interpolation between coarse cells is
sufficient (docs/decisions/0133). Constants without a stated source are common knowledge or own choices.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.errors import GeometryError

Floats = NDArray[np.float64]

CHANNELS = ("phase", "left", "back", "rings", "proximal", "spur", "membrane", "regular")
"""Names of the anatomical values in a cell of the decoration grid.

``phase`` is the number of rings since the top of the trachea. ``left`` and ``back`` are the position across the airway,
towards the patient's left and back, in units of the airway's radius. The others are strengths 0..1: rings, colour of
the trachea, ridge of a fork, membranous wall, and regularity of the rings.
"""

CELL_MM = 2.5
"""Cell size in mm of the grid for drawn features: below half the distance of two cartilage rings, to follow bends.

The ridge of a fork is one cell wide.
"""
REACH = 1.6
"""Maximum distance from the centreline, in radii, of a wall on which rings are drawn."""
SMOOTH_MM = 3.0
"""Length of the smoothing of the centreline, mm: below the radius of airways with rings, above a voxel."""
BLEND = 0.08
"""Width of the transition between the drawn features of two neighbouring airways, in radii of the airway."""
TAIL_MM = 20.0
"""Length over which the last cartilage plates fade out along a segmental bronchus, mm."""
FORK_MM = 6.0
"""Length after a fork over which drawn features change from the parent's to the branch's, mm."""

LEVELS = {"Trachea": 0.0, "RMB": 1.0, "LMB": 1.0, "BI": 1.5}
LEVELS |= dict.fromkeys(("RUL", "RML", "RLL", "LUL", "LML", "LLL", "Upper division", "Lingula"), 2.0)
LEVELS |= dict.fromkeys(("Right basal trunk", "Left basal trunk"), 2.5)
LAST_LEVEL = 3.0
"""Level of the segmental bronchi in the tables by level: 0 trachea, 1 main, 2 lobar, 3 segmental."""

# Tables by level: 0 trachea, 1 main, 2 lobar, 3 segmental bronchi. Gray, Anatomy of the Human Body (1918), The Trachea
# and Bronchi: 16 to 20 rings of 4 mm with narrow intervals in a trachea of some 11 cm; 6 to 8 along the right bronchus
# (2.5 cm), 9 to 12 along the left (5 cm); irregular plates in the lung. The distance of the plates is not from Gray.
_PITCH_MM = ((0.0, 1.0, 2.0, 3.0), (5.6, 4.4, 4.0, 3.4))
_RINGS = ((0.0, 1.0, 2.0, 3.0, 3.5), (1.0, 0.9, 0.5, 0.25, 0.0))
_REGULAR = ((0.0, 1.0, 1.5, 2.0), (1.0, 0.85, 0.35, 0.0))
_MEMBRANE = ((0.0, 1.0, 1.5, 2.0), (1.0, 0.9, 0.5, 0.0))
_PROXIMAL = ((0.0, 1.0, 2.0, 3.0), (1.0, 0.7, 0.35, 0.0))

# Relative difference of a branch's radius from its smooth course: the rings begin to fade at the first value, and have
# vanished at the second, since such a branch may be diseased.
_OFF_COURSE = (0.14, 0.30)
_OFF_AROUND_MM = 9.0
# Confidence of a branch: no rings are drawn below the first value, and rings have full strength above the second.
_SURE = (0.5, 0.8)


class DecorationBranch(Protocol):
    """Properties of a branch that the decoration reads; :class:`carina.track.Branch` has them."""

    @property
    def id(self) -> int:
        """ID of the branch."""
        ...

    @property
    def parent(self) -> int | None:
        """ID of the parent branch; None for the root."""
        ...

    @property
    def children(self) -> tuple[int, ...]:
        """IDs of the child branches."""
        ...

    @property
    def name(self) -> str | None:
        """Anatomical name, or None."""
        ...

    @property
    def kind(self) -> str:
        """Origin of the branch, such as ``tracked`` (found in the CT) or ``manual`` (drawn by hand)."""
        ...

    @property
    def points(self) -> Floats:
        """Centreline (n, 3), LPS mm."""
        ...

    @property
    def radius(self) -> Floats:
        """Radius of the lumen (n,), mm."""
        ...

    @property
    def confidence(self) -> float | None:
        """Confidence, 0 to 1, that the branch is an airway; None if unknown."""
        ...


class DecorationTree(Protocol):
    """Properties of a tree that the decoration reads; :class:`carina.track.AirwayTree` has them."""

    @property
    def branches(self) -> Sequence[DecorationBranch]:
        """Branches; a parent precedes its children."""
        ...


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Decoration:
    """Anatomy of the walls of wide airways on a coarse grid along the patient's axes."""

    cells: NDArray[np.float32] = field(repr=False)
    """(nz, ny, nx, 8) float32, finite; the last axis is :data:`CHANNELS`. Cells away from such walls are 0."""
    origin_lps: tuple[float, float, float]
    """Position of the centre of the grid's first cell, LPS mm."""
    cell_mm: float

    def __post_init__(self) -> None:
        """Raise an error if a field of this `Decoration` has an invalid value."""
        shape = self.cells.shape
        if len(shape) != 4 or shape[3] != len(CHANNELS) or min(shape) < 2 or self.cells.dtype != np.float32:
            msg = f"a decoration: expected (nz, ny, nx, {len(CHANNELS)}) float32, 2 cells or more; found {shape}"
            raise GeometryError(msg, code="geometry.shape")
        if not (np.isfinite(self.cells).all() and np.isfinite(self.origin_lps).all() and 0.1 <= self.cell_mm <= 100):
            msg = "a decoration: expected finite values and cells of 0.1 to 100 mm; found others"
            raise GeometryError(msg, code="geometry.shape")


@dataclass(frozen=True, slots=True, eq=False)
class _Tube:
    """Branch that is sampled at even distances."""

    points: Floats
    along: Floats
    radius: Floats
    phase: Floats
    per_mm: Floats
    parts: Floats
    """Strengths (n, 4) of the drawn features at each point: rings, proximal, membrane, regular."""
    end: Floats
    """Strengths (4,) of the decoration at the end of the branch, before doubtful branches are faded.

    They are those of rings, of the central airways, of the membranous wall and of regular distances; the child branches
    begin with them.
    """
    id: int
    parent: int | None


def decoration_of(tree: DecorationTree | None) -> Decoration | None:
    """Compute the drawn features (decoration) of a tree's trachea, main, lobar and first segmental bronchi.

    Rings fade where a branch is doubtful, bridged or drawn by hand, and where its measured radius differs from its
    smooth course by 14 to 30 %: a stenosis has no rings.

    Parameters
    ----------
    tree
        An airway tree, LPS mm, or None.

    Returns
    -------
    Decoration or None
        None without a tree, and if the root is not named as trachea: front and back of the airways are then unknown.
    """
    if tree is None or not tree.branches or tree.branches[0].name != "Trachea":
        return None
    tubes = _tubes(tree.branches)
    if not tubes:
        return None
    reach = max(REACH * float(tube.radius.max()) for tube in tubes) + 2 * CELL_MM
    every = np.concatenate([tube.points for tube in tubes])
    first = np.floor((every.min(axis=0) - reach) / CELL_MM) * CELL_MM
    shape = tuple(int(n) for n in np.ceil((every.max(axis=0) + reach - first) / CELL_MM)[::-1] + 1)
    sums = np.zeros((*shape, len(CHANNELS)))
    weights = np.zeros(shape)
    places = {tube.id: _add_tube(tube, first, shape) for tube in tubes}
    for tube in tubes:
        box, near, values, off = places[tube.id]
        weight = np.exp(-off / BLEND)
        weights[box][near] += weight
        sums[box][near] += weight[:, None] * values
    known = weights > 0.0
    sums[known] /= weights[known, None]
    sums[..., CHANNELS.index("spur")] = _fork_ridges(tubes, first, shape)
    return Decoration(np.ascontiguousarray(sums, dtype=np.float32), _point_tuple(first), CELL_MM)


def _point_tuple(v: Floats) -> tuple[float, float, float]:
    x, y, z = (float(a) for a in v)
    return x, y, z


def _smoothstep(x: Floats, low: float, high: float) -> Floats:
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


def _tubes(branches: Iterable[DecorationBranch]) -> list[_Tube]:
    """Return the branches down to the segmental ones as tubes; a parent precedes its children."""
    levels: dict[int, float] = {}
    ends: dict[int, tuple[float, Floats]] = {}
    tubes: list[_Tube] = []
    for branch in branches:
        above = None if branch.parent is None else levels.get(branch.parent)
        if branch.parent is not None and above is None:
            continue
        own = LEVELS.get(branch.name or "")
        if own is None:
            own = 0.0 if above is None else min(above + 1.0, LAST_LEVEL) if above < LAST_LEVEL else above + 1.0
        level = own if above is None else max(own, above)
        if level > LAST_LEVEL or len(branch.points) < 2:
            continue
        phase, parts = ends.get(branch.parent, (0.0, None)) if branch.parent is not None else (0.0, None)
        tube = _tube(branch, level, phase, parts)
        levels[branch.id] = level
        ends[branch.id] = (float(tube.phase[-1]), tube.end)
        tubes.append(tube)
    return tubes


def _tube(branch: DecorationBranch, level: float, phase: float, before: Floats | None) -> _Tube:
    points, radius = _resample_evenly(np.asarray(branch.points, np.float64), np.asarray(branch.radius, np.float64))
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    mm = np.concatenate([[0.0], np.cumsum(steps)])
    along = np.gradient(points, axis=0) if len(points) > 2 else np.repeat(np.diff(points, axis=0), 2, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1), 1e-9)[:, None]
    course = _fit_radius_course(mm, radius)
    own = [float(np.interp(level, *table)) for table in (_RINGS, _PROXIMAL, _MEMBRANE, _REGULAR)]
    parts = np.repeat(np.array([own]), len(points), axis=0)
    if before is not None:
        share = _smoothstep(mm, 0.0, FORK_MM)[:, None]
        parts = share * parts + (1.0 - share) * before
    if level >= LAST_LEVEL:
        tail = min(TAIL_MM, float(mm[-1]))
        parts *= 1.0 - _smoothstep(mm, 0.5 * tail, tail)[:, None]
    end = parts[-1].copy()
    sure = 1.0 if branch.confidence is None else float(_smoothstep(np.array(branch.confidence), *_SURE))
    sure *= branch.kind == "tracked"
    shown = sure * _tube_like(mm, radius, course)
    parts[:, 0] *= shown
    parts[:, 2] *= shown
    per_mm = np.full(len(points), 1.0 / float(np.interp(level, *_PITCH_MM)))
    passed = phase + np.concatenate([[0.0], np.cumsum(0.5 * (per_mm[1:] + per_mm[:-1]) * steps)])
    return _Tube(points, along, course, passed, per_mm, parts, end, branch.id, branch.parent)


def _resample_evenly(points: Floats, radius: Floats) -> tuple[Floats, Floats]:
    """Resample a centreline and its radius at about 1 mm; the line is smoothed between its ends."""
    mm = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    keep = np.concatenate([[True], np.diff(mm) > 1e-9])
    mm, points, radius = mm[keep], points[keep], radius[keep]
    at = np.linspace(0.0, mm[-1], max(2, math.ceil(mm[-1]) + 1))
    line = np.column_stack([np.interp(at, mm, points[:, axis]) for axis in range(3)])
    # The kernels shrink towards the ends, so that the ends stay in the fork.
    sigma = np.minimum(SMOOTH_MM, 0.5 * np.minimum(at, at[-1] - at) + 1e-3)
    share = np.exp(-0.5 * ((at[:, None] - at[None, :]) / sigma[:, None]) ** 2)
    share /= share.sum(axis=1, keepdims=True)
    return share @ line, np.interp(at, mm, radius)


def _fit_radius_course(mm: Floats, radius: Floats) -> Floats:
    """Return the smooth course of the radius along a branch: a straight line fitted with Tukey's weights."""
    line = np.full(len(radius), np.median(radius))
    if len(radius) < 8:
        return line
    x = mm - mm.mean()
    for _ in range(20):
        off = np.abs(radius - line)
        scale = 4.0 * max(float(np.median(off)), 0.02 * float(np.median(radius)))
        weight = np.square(np.clip(1.0 - np.square(off / scale), 0.0, None))
        if weight.sum() < 1e-6:
            break
        centre = (weight * x).sum() / weight.sum()
        middle = (weight * radius).sum() / weight.sum()
        spread = (weight * (x - centre) ** 2).sum()
        slope = (weight * (x - centre) * (radius - middle)).sum() / max(spread, 1e-9)
        line = middle + slope * (x - centre)
    # Without this limit the fit of a short or irregular branch can be far off.
    return np.asarray(np.clip(line, 0.6 * np.median(radius), 1.6 * np.median(radius)))


def _tube_like(mm: Floats, radius: Floats, course: Floats) -> Floats:
    """Return 1 for each point of a branch where the measured radii around it are near the fitted course, else 0."""
    like = 1.0 - _smoothstep(np.abs(radius / course - 1.0), *_OFF_COURSE)
    around = np.abs(mm[:, None] - mm[None, :]) <= _OFF_AROUND_MM
    least = np.where(around, like[None, :], 1.0).min(axis=1)
    share = np.exp(-0.5 * ((mm[:, None] - mm[None, :]) / 2.0) ** 2)
    return np.asarray(np.minimum((share * least).sum(axis=1) / share.sum(axis=1), like))


_Box = tuple[slice, slice, slice]


def _add_tube(tube: _Tube, first: Floats, shape: tuple[int, ...]) -> tuple[_Box, NDArray[np.bool_], Floats, Floats]:
    """Compute the anatomical values of the grid cells near an airway.

    Returns
    -------
    tuple
        Box of the grid; mask (nz, ny, nx) of the cells of the box that are near; their channels (n, 8); and their
        distance from the centreline in radii (n,).
    """
    box, cells = _cells_near(tube, first, shape)
    nearest, away = _nearest(tube, cells.reshape(-1, 3))
    radius = tube.radius[nearest]
    off_mm = np.linalg.norm(away, axis=1)
    near = off_mm <= REACH * radius + 2 * CELL_MM
    nearest, away, radius, off_mm = nearest[near], away[near], radius[near], off_mm[near]
    along = tube.along[nearest]
    ahead = np.einsum("ij,ij->i", away, along)
    back = np.array([0.0, 1.0, 0.0]) - along * along[:, 1:2]
    # An airway that runs straight to the back has no defined back wall; it has no rings, so any direction will do.
    back /= np.maximum(np.linalg.norm(back, axis=1), 1e-3)[:, None]
    left = np.cross(along, back)
    values = np.zeros((len(nearest), len(CHANNELS)))
    values[:, 0] = tube.phase[nearest] + ahead * tube.per_mm[nearest]
    values[:, 1] = np.einsum("ij,ij->i", away, left) / radius
    values[:, 2] = np.einsum("ij,ij->i", away, back) / radius
    values[:, [3, 4, 6, 7]] = tube.parts[nearest]
    # Beyond the start of the trachea the decoration fades out. Cells beyond other ends belong to the child branches.
    beyond = np.where((nearest == 0) & (ahead < 0), -ahead, 0.0) if tube.parent is None else np.zeros(len(nearest))
    values[:, 3] *= 1.0 - _smoothstep(beyond, 2.0, 6.0)
    values[:, 6] *= 1.0 - _smoothstep(beyond, 2.0, 6.0)
    return box, near.reshape(cells.shape[:3]), values, off_mm / radius


def _cells_near(tube: _Tube, first: Floats, shape: tuple[int, ...]) -> tuple[_Box, Floats]:
    margin = REACH * float(tube.radius.max()) + 2 * CELL_MM
    size = np.array(shape[::-1])
    low = np.clip(np.floor((tube.points.min(axis=0) - margin - first) / CELL_MM), 0, size - 1).astype(int)
    high = np.clip(np.ceil((tube.points.max(axis=0) + margin - first) / CELL_MM), 0, size - 1).astype(int) + 1
    axes = [first[a] + CELL_MM * np.arange(low[a], high[a]) for a in range(3)]
    z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
    return (slice(low[2], high[2]), slice(low[1], high[1]), slice(low[0], high[0])), np.stack([x, y, z], axis=-1)


def _nearest(tube: _Tube, cells: Floats) -> tuple[NDArray[np.intp], Floats]:
    """Return the centreline point nearest to each cell, as index (n,), and the vector to the cell (n, 3), mm."""
    nearest = np.empty(len(cells), dtype=np.intp)
    square = np.einsum("ij,ij->i", tube.points, tube.points)
    for at in range(0, len(cells), 4096):
        part = cells[at : at + 4096]
        nearest[at : at + 4096] = np.argmin(square - 2.0 * part @ tube.points.T, axis=1)
    return nearest, cells - tube.points[nearest]


def _fork_ridges(tubes: Sequence[_Tube], first: Floats, shape: tuple[int, ...]) -> Floats:
    """Return the strength (nz, ny, nx) of fork ridges: high in cells on the walls of two siblings and between them."""
    spurs = np.zeros(shape)
    by_parent: dict[int | None, list[_Tube]] = {}
    for tube in tubes:
        by_parent.setdefault(tube.parent, []).append(tube)
    for parent, daughters in by_parent.items():
        for n, one in enumerate(daughters):
            for other in daughters[n + 1 :] if parent is not None else ():
                # Beyond the first few radii two siblings have separate walls.
                near = max(4, int(4.0 * max(float(one.radius[0]), float(other.radius[0]))))
                a, b = (_first_points(tube, near) for tube in (one, other))
                box, cells = _cells_near(a, first, shape)
                flat = cells.reshape(-1, 3)
                sides = []
                for tube in (a, b):
                    nearest, away = _nearest(tube, flat)
                    off = np.linalg.norm(away, axis=1)
                    sides.append((off / tube.radius[nearest], away / np.maximum(off, 1e-9)[:, None], nearest))
                (rho_a, dir_a, at_a), (rho_b, dir_b, at_b) = sides
                # Across the ridge one distance grows as the other falls. The ridge is at least as wide as the grid can
                # represent.
                width = max(0.3, 0.8 * CELL_MM / float(min(a.radius[0], b.radius[0])))
                off = np.square((rho_a - rho_b) / (2.0 * width)) + np.square((0.5 * (rho_a + rho_b) - 1.0) / width)
                ridge = np.minimum(1.3 * np.exp(-off), 1.0)
                # Between two siblings the directions to their walls are opposite (oblique at a wide fork); at the front
                # and back of the fork they are not.
                ridge *= _smoothstep(-np.einsum("ij,ij->i", dir_a, dir_b), -0.6, 0.0)
                # Cells nearest to the end of a shortened tube are excluded.
                ridge *= (at_a < len(a.points) - 1) & (at_b < len(b.points) - 1)
                strength = float(min(1.0, 1.2 - 0.2 * _fork_level(one, other)))
                spurs[box] = np.maximum(spurs[box], strength * ridge.reshape(cells.shape[:3]))
    return spurs


def _fork_level(one: _Tube, other: _Tube) -> float:
    """Return the level at which two sibling branches arise: about 1 at the carina, 2 and 3 farther out."""
    proximal = max(float(one.parts[-1, 1]), float(other.parts[-1, 1]))
    return float(np.interp(-proximal, [-v for v in _PROXIMAL[1]], _PROXIMAL[0]))


def _first_points(tube: _Tube, num_points: int) -> _Tube:
    cut = slice(0, num_points)
    return replace(tube, points=tube.points[cut], along=tube.along[cut], radius=tube.radius[cut], parts=tube.parts[cut])
