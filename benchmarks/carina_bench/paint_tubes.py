"""Tubes (airways and arteries) of painted CTs, and the share of each small cell of space that the tubes cover."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

__all__ = ["Covers", "Segment", "Tube", "covers_of", "lumen_distance_at", "segments_of", "wall_mm"]

Floats = NDArray[np.float64]
Cells = NDArray[np.float32]
Box = tuple[slice, slice, slice]

WALL_FACTOR = 0.6
"""Thickness of an airway's wall at a lumen of 1 mm radius, mm.

The thickness grows with the square root of the radius.
"""
MERGE_SHARE = 0.35
"""Width of the rounding of the edge where the lumens of two airways of a fork meet.

The width is a share of the radius of the thinner airway.
"""
FAR_MM = np.float32(50.0)
"""Distance in mm that is stored for cells of the painted grid that are far from every tube."""
OUTSIDE_MM = 3.0
"""Distance in mm from an airway up to which `lumen_distance_at` is exact."""
FULL_LEVEL = 0.99
"""Fluid level, in radii above the axis, from which fluid fills the lumen."""


def wall_mm(radius_mm: Floats) -> Floats:
    """Return the thickness of the wall of an airway with this radius of the lumen, mm.

    For example the trachea (radius 9 mm) has 1.8 mm, a segmental bronchus (3 mm) 1.0 mm, and a twig of 0.5 mm 0.4 mm.
    """
    result: Floats = WALL_FACTOR * np.sqrt(np.maximum(radius_mm, 0.0))
    return result


@dataclass(frozen=True, slots=True, eq=False)
class Tube:
    """Airway, or artery beside an airway, as a centreline with radii."""

    points: Floats
    """Centreline (n, 3), mm; in a scene LPS."""
    radius_mm: Floats
    """Radius (n,) in mm of an airway's lumen, or of an artery's outer wall, at each point."""
    id: int = 0
    parent: int | None = None
    generation: int = 0
    is_artery: bool = False
    filled_from: Floats | None = None
    """Level (n,) of fluid in radii above the axis: 1 fills the lumen, 0 fills half of it, -1 leaves it empty."""
    true_from: int = 0
    """Index of the first point outside the parent's lumen; the true centreline begins there."""
    thickness_mm: float | None = None
    """Thickness of the wall, mm; None computes the thickness from the radius of the lumen (:func:`wall_mm`)."""

    def outer_mm(self) -> Floats:
        """Return the radius (n,) of the outside of an airway's wall or of an artery, mm."""
        if self.is_artery:
            return self.radius_mm
        return self.radius_mm + (wall_mm(self.radius_mm) if self.thickness_mm is None else self.thickness_mm)

    def moved(self, points: Floats) -> Tube:
        """Return a copy of the tube with other centreline points."""
        return replace(self, points=points)


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """Straight piece of a tube whose radii change linearly from its start to its end."""

    start: Floats
    axis: Floats
    """Unit vector (3,) from the start to the end."""
    length: float
    lumen: tuple[float, float]
    outer: tuple[float, float]
    merge: float
    tube: int
    """Index of the tube to which the segment belongs."""
    level: tuple[float, float] | None
    low: Floats
    """Lowest corner (3,) of the box of cells to which the segment can contribute, mm."""
    high: Floats


def segments_of(tubes: Sequence[Tube], cell_mm: float) -> list[Segment]:
    """Divide tubes (mm of any frame) into pieces that are short enough to count as straight, for cells of ``cell_mm``.

    In the cells the edge of the covered area is a ramp one cell wide, which adds pi h^2 / 12 to the area of a disc,
    with h the width of a cell. The radii are reduced by this amount.
    """
    found = []
    for place, tube in enumerate(tubes):
        points, radius, level = _cut(tube)
        inner = np.sqrt(np.maximum(radius**2 - cell_mm**2 / 12.0, 1e-6))
        outside = replace(tube, radius_mm=radius).outer_mm()
        outer = np.sqrt(np.maximum(outside**2 - cell_mm**2 / 12.0, 1e-6))
        merge = 0.0 if tube.is_artery else MERGE_SHARE * float(np.median(radius))
        for n in range(len(points) - 1):
            step = points[n + 1] - points[n]
            length = float(np.linalg.norm(step))
            if length < 1e-9:
                continue
            reach = float(outer[n : n + 2].max()) + max(merge, cell_mm) + cell_mm
            found.append(
                Segment(
                    start=points[n],
                    axis=step / length,
                    length=length,
                    lumen=(float(inner[n]), float(inner[n + 1])),
                    outer=(float(outer[n]), float(outer[n + 1])),
                    merge=merge,
                    tube=place,
                    level=None if level is None or level[n : n + 2].max() <= -1 else (level[n], level[n + 1]),
                    low=np.minimum(points[n], points[n + 1]) - reach,
                    high=np.maximum(points[n], points[n + 1]) + reach,
                )
            )
    return found


def _cut(tube: Tube) -> tuple[Floats, Floats, Floats | None]:
    """Return positions along a tube, and its radii and fluid levels there.

    The distance between two positions is a third of the radius, but 0.4 to 2.5 mm. The levels are None without fluid.
    """
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(tube.points, axis=0), axis=1))])
    at = [0.0]
    while at[-1] < along[-1]:
        at.append(at[-1] + float(np.clip(np.interp(at[-1], along, tube.radius_mm) / 3.0, 0.4, 2.5)))
    places = np.array(at) * (along[-1] / at[-1])
    points = np.stack([np.interp(places, along, tube.points[:, axis]) for axis in range(3)], axis=1)
    level = None if tube.filled_from is None else np.interp(places, along, tube.filled_from)
    return points, np.interp(places, along, tube.radius_mm), level


@dataclass(slots=True, eq=False)
class Covers:
    """Shares of cells ``[z, y, x]``, 0 to 1, that are covered by airways, arteries and fluid."""

    lumen: Cells
    airway: Cells
    """Share of each cell that is inside an airway, lumen or wall."""
    artery: Cells
    fluid: Cells
    """Share of the lumen in each cell that is filled with fluid."""


def covers_of(
    segments: Sequence[Segment],
    tubes: Sequence[Tube],
    axes_xyz: tuple[Floats, Floats, Floats],
    cell_mm: float,
    down: Floats,
) -> Covers:
    """Return the shares of cells that segments cover.

    The centres of the cells are at ``axes_xyz`` (mm, even steps on each axis); fluid sinks in the direction ``down``.
    The union of the lumens of an airway and its children is rounded at its edges; every other union is not.
    """
    shape = (len(axes_xyz[2]), len(axes_xyz[1]), len(axes_xyz[0]))
    lumen, airway, artery = (np.full(shape, FAR_MM, np.float32) for _ in range(3))
    fluid = np.zeros(shape, np.float32)
    for tube, own in _by_tube(segments).items():
        mine = artery if tubes[tube].is_artery else np.full(shape, FAR_MM, np.float32)
        box: Box | None = None
        for segment in own:
            at = _box_of(segment, axes_xyz)
            if at is None:
                continue
            distance, along, height = _distance(segment, axes_xyz, at, down)
            outer = distance - _between(segment.outer, along)
            if tubes[tube].is_artery:
                np.minimum(artery[at], outer, out=artery[at])
                continue
            radius = _between(segment.lumen, along)
            inner = distance - radius
            np.minimum(mine[at], inner, out=mine[at])
            np.minimum(airway[at], outer, out=airway[at])
            if segment.level is not None:
                level = _between(segment.level, along)
                # The level of a full lumen is set far above the lumen's top, so that no film of air remains.
                level = np.where(level >= FULL_LEVEL, np.float32(10.0), level)
                wet = np.clip(0.5 + (height + level * radius) / np.float32(cell_mm), 0.0, 1.0) * (inner < cell_mm)
                np.maximum(fluid[at], wet, out=fluid[at])
            box = at if box is None else _joined(box, at)
        if box is not None:
            lumen[box] = _merged(lumen[box], mine[box], own[0].merge)
    np.minimum(airway, lumen, out=airway)
    return Covers(_cover(lumen, cell_mm), _cover(airway, cell_mm), _cover(artery, cell_mm), fluid)


def lumen_distance_at(points: Floats, *, tubes: Sequence[Tube]) -> Floats:
    """Return the distances (n,) in mm from points to the wall of the lumen that is painted, negative inside.

    The lumen has the rounded edges of `covers_of`. The distance of a point that is farther than `OUTSIDE_MM` from all
    airways is only known to be larger; fluid is ignored.

    Parameters
    ----------
    points
        (n, 3) in the frame of the tubes, mm.
    tubes
        Tubes of the scene, in their order; arteries are ignored.
    """
    found = np.full(len(points), float(FAR_MM))
    for tube in tubes:
        own = [] if tube.is_artery else segments_of([tube], 0.0)
        if not own:
            continue
        low, high = np.min([one.low for one in own], axis=0), np.max([one.high for one in own], axis=0)
        near = np.flatnonzero(_is_within(points, low, high))
        mine = np.full(len(near), float(FAR_MM))
        for segment in own:
            at = np.flatnonzero(_is_within(points[near], segment.low, segment.high))
            off = points[near[at]] - segment.start
            along = np.clip(off @ segment.axis, 0.0, segment.length)
            away = np.linalg.norm(off - along[:, None] * segment.axis, axis=1)
            radius = segment.lumen[0] + along / segment.length * (segment.lumen[1] - segment.lumen[0])
            mine[at] = np.minimum(mine[at], away - radius)
        found[near] = _merged(found[near], mine, own[0].merge)
    return found


def _is_within(points: Floats, low: Floats, high: Floats) -> NDArray[np.bool_]:
    """Return whether points (n, 3) are within `OUTSIDE_MM` of a box."""
    return np.asarray(((points >= low - OUTSIDE_MM) & (points <= high + OUTSIDE_MM)).all(axis=1))


def _by_tube(segments: Sequence[Segment]) -> dict[int, list[Segment]]:
    by_tube: dict[int, list[Segment]] = {}
    for segment in segments:
        by_tube.setdefault(segment.tube, []).append(segment)
    return by_tube


def _box_of(segment: Segment, axes_xyz: tuple[Floats, Floats, Floats]) -> Box | None:
    """Return the box of cells ``[z, y, x]`` to which a segment can contribute; None if it is empty."""
    slices = []
    for axis, (low, high) in enumerate(zip(segment.low, segment.high, strict=True)):
        first, last = np.searchsorted(axes_xyz[axis], [low, high])
        if first >= last:
            return None
        slices.append(slice(int(first), int(last)))
    return slices[2], slices[1], slices[0]


def _joined(one: Box, other: Box) -> Box:
    z, y, x = (slice(min(a.start, b.start), max(a.stop, b.stop)) for a, b in zip(one, other, strict=True))
    return z, y, x


def _between(ends: tuple[float, float], along: Cells) -> Cells:
    result: Cells = np.float32(ends[0]) + along * np.float32(ends[1] - ends[0])
    return result


def _distance(
    segment: Segment, axes_xyz: tuple[Floats, Floats, Floats], box: Box, down: Floats
) -> tuple[Cells, Cells, Cells]:
    """Return each cell's distance from the axis, position along the axis (0 to 1), and depth below the axis."""
    z, y, x = box
    off = [
        (axes_xyz[0][x] - segment.start[0])[None, None, :],
        (axes_xyz[1][y] - segment.start[1])[None, :, None],
        (axes_xyz[2][z] - segment.start[2])[:, None, None],
    ]
    rows = [part.astype(np.float32) for part in off]
    axis = segment.axis.astype(np.float32)
    shadow = rows[0] * axis[0] + rows[1] * axis[1] + rows[2] * axis[2]
    along = np.clip(shadow, np.float32(0.0), np.float32(segment.length))
    square = rows[0] ** 2 + rows[1] ** 2 + rows[2] ** 2
    square = square + along * (along - 2.0 * shadow)
    distance = np.sqrt(np.maximum(square, 0.0))
    if segment.level is None:
        height = distance
    else:
        sunk = [part * np.float32(d) for part, d in zip(rows, down, strict=True)]
        height = sunk[0] + sunk[1] + sunk[2] - along * np.float32(segment.axis @ down)
    return distance, along / np.float32(segment.length), height


def _cover(distance: Cells, cell_mm: float) -> Cells:
    result: Cells = np.clip(np.float32(0.5) - distance / np.float32(cell_mm), 0.0, 1.0)
    return result


def _merged(one: Cells, other: Cells, merge_mm: float) -> Cells:
    """Return a smooth minimum of two distances, below both where they differ by less than about ``merge_mm``."""
    least = np.minimum(one, other)
    if merge_mm <= 0.0:
        return least
    near = np.maximum(np.float32(merge_mm) - np.abs(one - other), 0.0)
    result: Cells = least - near * near * np.float32(0.25 / merge_mm)
    return result
