"""Where a wall lies on its airway: what the rings and the membranous wall of the endoscopic look are drawn by.

The lighting of a pixel knows a point of the patient and nothing of anatomy. A coarse grid round the wide airways tells
it how many rings lie before the point, on which side of the airway it is, and how much of each part belongs there. All
of it changes evenly along and across a tube, so a coarse grid read between its cells is enough (docs/decisions/0105).
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

__all__ = ["CHANNELS", "Decoration", "DecorationBranch", "DecorationTree", "decoration_of"]

Floats = NDArray[np.float64]

CHANNELS = ("phase", "left", "back", "rings", "proximal", "spur", "membrane", "regular")
"""What a cell holds: rings passed since the top of the trachea; the place across the airway as parts of its radius, to
the patient's left and to the back; 0..1 each: rings, trachea's colour, ridge of a fork, membranous wall, evenness."""

CELL_MM = 2.5
"""Less than half a ring's distance, so that a fork's bend is followed; a fork's ridge is as wide (k)."""
REACH = 1.6
"""Walls farther from the middle than so many radii belong to no tube; the kernel leaves rings out before (k)."""
SMOOTH_MM = 3.0
"""Of the middle line: less than the radius of what has rings, more than a voxel (k)."""
BLEND = 0.08
"""Between two tubes, as part of the radius (k)."""
TAIL_MM = 20.0
"""Along a segmental bronchus the last plates fade out (k)."""
FORK_MM = 6.0
"""Past a fork one branch's anatomy turns into the next one's (k)."""

LEVELS = {"Trachea": 0.0, "RMB": 1.0, "LMB": 1.0, "BI": 1.5}
LEVELS |= dict.fromkeys(("RUL", "RML", "RLL", "LUL", "LML", "LLL", "Upper division", "Lingula"), 2.0)
LEVELS |= dict.fromkeys(("Right basal trunk", "Left basal trunk"), 2.5)
LAST_LEVEL = 3.0
"""Segmental bronchi."""

# By level: 0 trachea, 1 main, 2 lobar, 3 segmental bronchi. Gray, Anatomy of the Human Body (1918), The Trachea and
# Bronchi: 16 to 20 rings of 4 mm in a trachea of some 11 cm, narrow intervals between; 6 to 8 along the right bronchus
# (2.5 cm), 9 to 12 along the left (5 cm); s. In the lung irregular plates, s; their distance, k.
_PITCH_MM = ((0.0, 1.0, 2.0, 3.0), (5.6, 4.4, 4.0, 3.4))
_RINGS = ((0.0, 1.0, 2.0, 3.0, 3.5), (1.0, 0.9, 0.5, 0.25, 0.0))
_REGULAR = ((0.0, 1.0, 1.5, 2.0), (1.0, 0.85, 0.35, 0.0))
_MEMBRANE = ((0.0, 1.0, 1.5, 2.0), (1.0, 0.9, 0.5, 0.0))
_PROXIMAL = ((0.0, 1.0, 2.0, 3.0), (1.0, 0.7, 0.35, 0.0))

# A radius off the smooth course by so much is no healthy tube any more; between, rings fade (k).
_OFF_COURSE = (0.14, 0.30)
_OFF_AROUND_MM = 9.0
# How sure a branch must be, none and all of the rings (k).
_SURE = (0.5, 0.8)


class DecorationBranch(Protocol):
    """What is asked of a branch; :class:`carina.track.Branch` has it."""

    @property
    def id(self) -> int: ...
    @property
    def parent(self) -> int | None: ...
    @property
    def children(self) -> tuple[int, ...]: ...
    @property
    def name(self) -> str | None: ...
    @property
    def kind(self) -> str: ...
    @property
    def points(self) -> Floats: ...
    @property
    def radius(self) -> Floats: ...
    @property
    def confidence(self) -> float | None: ...


class DecorationTree(Protocol):
    """What is asked of a tree; :class:`carina.track.AirwayTree` has it."""

    @property
    def branches(self) -> Sequence[DecorationBranch]: ...


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Decoration:
    """Anatomy of the walls of wide airways on a coarse grid along the patient's axes."""

    cells: NDArray[np.float32] = field(repr=False)
    """(nz, ny, nx, 8) float32, finite; the last axis is :data:`CHANNELS`. Zeros where there is no such wall."""
    origin_lps: tuple[float, float, float]
    """Middle of the first cell, LPS mm."""
    cell_mm: float

    def __post_init__(self) -> None:
        shape = self.cells.shape
        if len(shape) != 4 or shape[3] != len(CHANNELS) or min(shape) < 2 or self.cells.dtype != np.float32:
            msg = f"a decoration: expected (nz, ny, nx, {len(CHANNELS)}) float32, 2 cells or more; found {shape}"
            raise GeometryError(msg, code="geometry.shape")
        if not (np.isfinite(self.cells).all() and np.isfinite(self.origin_lps).all() and 0.1 <= self.cell_mm <= 100):
            msg = "a decoration: expected finite values and cells of 0.1 to 100 mm; found others"
            raise GeometryError(msg, code="geometry.shape")


@dataclass(frozen=True, slots=True, eq=False)
class _Tube:
    """One branch, evenly sampled."""

    points: Floats
    along: Floats
    radius: Floats
    phase: Floats
    per_mm: Floats
    parts: Floats
    """(n, 4): rings, proximal, membrane, regular."""
    end: Floats
    """(4,) the last of them, as they were without doubt in this branch: what the next ones begin with."""
    id: int
    parent: int | None


def decoration_of(tree: DecorationTree | None) -> Decoration | None:
    """The decoration of a tree's trachea, main, lobar and first segmental bronchi.

    Rings fade where a branch is doubtful, bridged or drawn by hand, and where its measured radius leaves the smooth
    course along it by 14 to 30 %: a stenosis has none.

    Parameters
    ----------
    tree
        An airway tree, LPS mm; None for none known.

    Returns
    -------
    Decoration or None
        None where the root is not named as trachea: without it front and back of the airways are not told.
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
    places = {tube.id: _place(tube, first, shape) for tube in tubes}
    for tube in tubes:
        box, near, values, off = places[tube.id]
        weight = np.exp(-off / BLEND)
        weights[box][near] += weight
        sums[box][near] += weight[:, None] * values
    known = weights > 0.0
    sums[known] /= weights[known, None]
    sums[..., CHANNELS.index("spur")] = _spurs(tubes, first, shape)
    return Decoration(np.ascontiguousarray(sums, dtype=np.float32), _three(first), CELL_MM)


def _three(v: Floats) -> tuple[float, float, float]:
    x, y, z = (float(a) for a in v)
    return x, y, z


def _smoothstep(x: Floats, low: float, high: float) -> Floats:
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


def _tubes(branches: Iterable[DecorationBranch]) -> list[_Tube]:
    """Branches down to the segmental ones; parents come first."""
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
    points, radius = _even(np.asarray(branch.points, np.float64), np.asarray(branch.radius, np.float64))
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    mm = np.concatenate([[0.0], np.cumsum(steps)])
    along = np.gradient(points, axis=0) if len(points) > 2 else np.repeat(np.diff(points, axis=0), 2, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1), 1e-9)[:, None]
    course = _course(mm, radius)
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


def _even(points: Floats, radius: Floats) -> tuple[Floats, Floats]:
    """About 1 mm apart, the line smoothed between its ends."""
    mm = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    keep = np.concatenate([[True], np.diff(mm) > 1e-9])
    mm, points, radius = mm[keep], points[keep], radius[keep]
    at = np.linspace(0.0, mm[-1], max(2, math.ceil(mm[-1]) + 1))
    line = np.column_stack([np.interp(at, mm, points[:, axis]) for axis in range(3)])
    # Kernels shrink towards the ends, which stay in the fork.
    sigma = np.minimum(SMOOTH_MM, 0.5 * np.minimum(at, at[-1] - at) + 1e-3)
    share = np.exp(-0.5 * ((at[:, None] - at[None, :]) / sigma[:, None]) ** 2)
    share /= share.sum(axis=1, keepdims=True)
    return share @ line, np.interp(at, mm, radius)


def _course(mm: Floats, radius: Floats) -> Floats:
    """A straight course of the radius that narrow and wide places have no part in (Tukey's weights)."""
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
    # A branch that is short or odd may send a line astray.
    return np.asarray(np.clip(line, 0.6 * np.median(radius), 1.6 * np.median(radius)))


def _tube_like(mm: Floats, radius: Floats, course: Floats) -> Floats:
    """1 where the measured radius keeps to its course, 0 where it leaves it or does so nearby."""
    like = 1.0 - _smoothstep(np.abs(radius / course - 1.0), *_OFF_COURSE)
    around = np.abs(mm[:, None] - mm[None, :]) <= _OFF_AROUND_MM
    least = np.where(around, like[None, :], 1.0).min(axis=1)
    share = np.exp(-0.5 * ((mm[:, None] - mm[None, :]) / 2.0) ** 2)
    return np.asarray(np.minimum((share * least).sum(axis=1) / share.sum(axis=1), like))


_Box = tuple[slice, slice, slice]


def _place(tube: _Tube, first: Floats, shape: tuple[int, ...]) -> tuple[_Box, NDArray[np.bool_], Floats, Floats]:
    """Box of the grid, which of its cells are near (nz, ny, nx), their channels (n, 8) and distance in radii (n,)."""
    box, cells = _cells_near(tube, first, shape)
    nearest, away = _nearest(tube, cells.reshape(-1, 3))
    radius = tube.radius[nearest]
    off_mm = np.linalg.norm(away, axis=1)
    near = off_mm <= REACH * radius + 2 * CELL_MM
    nearest, away, radius, off_mm = nearest[near], away[near], radius[near], off_mm[near]
    along = tube.along[nearest]
    ahead = np.einsum("ij,ij->i", away, along)
    back = np.array([0.0, 1.0, 0.0]) - along * along[:, 1:2]
    # An airway that runs straight to the back has no back wall: then any side will do, for it has no rings either.
    back /= np.maximum(np.linalg.norm(back, axis=1), 1e-3)[:, None]
    left = np.cross(along, back)
    values = np.zeros((len(nearest), len(CHANNELS)))
    values[:, 0] = tube.phase[nearest] + ahead * tube.per_mm[nearest]
    values[:, 1] = np.einsum("ij,ij->i", away, left) / radius
    values[:, 2] = np.einsum("ij,ij->i", away, back) / radius
    values[:, [3, 4, 6, 7]] = tube.parts[nearest]
    # Beyond its ends a branch goes on for a little; there its children are nearer.
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
    """The nearest point of the middle line, and the way from there to each cell, mm."""
    nearest = np.empty(len(cells), dtype=np.intp)
    square = np.einsum("ij,ij->i", tube.points, tube.points)
    for at in range(0, len(cells), 4096):
        part = cells[at : at + 4096]
        nearest[at : at + 4096] = np.argmin(square - 2.0 * part @ tube.points.T, axis=1)
    return nearest, cells - tube.points[nearest]


def _spurs(tubes: Sequence[_Tube], first: Floats, shape: tuple[int, ...]) -> Floats:
    """How much of the ridge between two daughters a cell is: on the wall of both, and between them."""
    spurs = np.zeros(shape)
    by_parent: dict[int | None, list[_Tube]] = {}
    for tube in tubes:
        by_parent.setdefault(tube.parent, []).append(tube)
    for parent, daughters in by_parent.items():
        for n, one in enumerate(daughters):
            for other in daughters[n + 1 :] if parent is not None else ():
                # Past the first few radii two daughters have nothing between them.
                near = max(4, int(4.0 * max(float(one.radius[0]), float(other.radius[0]))))
                a, b = (_shortened(tube, near) for tube in (one, other))
                box, cells = _cells_near(a, first, shape)
                flat = cells.reshape(-1, 3)
                sides = []
                for tube in (a, b):
                    nearest, away = _nearest(tube, flat)
                    off = np.linalg.norm(away, axis=1)
                    sides.append((off / tube.radius[nearest], away / np.maximum(off, 1e-9)[:, None], nearest))
                (rho_a, dir_a, at_a), (rho_b, dir_b, at_b) = sides
                # Across the ridge one distance grows as the other falls. No narrower than cells can hold.
                width = max(0.3, 0.8 * CELL_MM / float(min(a.radius[0], b.radius[0])))
                off = np.square((rho_a - rho_b) / (2.0 * width)) + np.square((0.5 * (rho_a + rho_b) - 1.0) / width)
                ridge = np.minimum(1.3 * np.exp(-off), 1.0)
                # Between the two their walls face each other, at a wide fork askew; at its front and back they do not.
                ridge *= _smoothstep(-np.einsum("ij,ij->i", dir_a, dir_b), -0.6, 0.0)
                # Not at the very ends of what was looked at.
                ridge *= (at_a < len(a.points) - 1) & (at_b < len(b.points) - 1)
                strength = float(min(1.0, 1.2 - 0.2 * _level_of(one, other)))
                spurs[box] = np.maximum(spurs[box], strength * ridge.reshape(cells.shape[:3]))
    return spurs


def _level_of(one: _Tube, other: _Tube) -> float:
    """About 1 at the carina, 2 and 3 farther out."""
    proximal = max(float(one.parts[-1, 1]), float(other.parts[-1, 1]))
    return float(np.interp(-proximal, [-v for v in _PROXIMAL[1]], _PROXIMAL[0]))


def _shortened(tube: _Tube, num_points: int) -> _Tube:
    cut = slice(0, num_points)
    return replace(tube, points=tube.points[cut], along=tube.along[cut], radius=tube.radius[cut], parts=tube.parts[cut])
