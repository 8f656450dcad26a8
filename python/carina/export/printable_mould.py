"""Mould of the central airways in three printable parts: two halves and a core.

The parts are drawn apart along LPS y (front and back). A branch joins the mould if its wall is not before or behind the
wall of another branch of the mould, so that neither half has to reach behind an airway. The halves meet at the
smoothest surface y(x, z) that passes through the middle of each branch of the mould; a cast fills the space between
halves and core.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.argument_checks import check_arguments, each, flag, instance, number_from
from carina.display import one_line
from carina.display.progress import ProgressChoice, progress_function, shows_progress
from carina.errors import UsageError
from carina.export.embossed_names import DOT_MM, name_dots
from carina.export.printable_phantom import (
    BUILD_MM,
    LEAST_WALL_MM,
    WALL_MM,
    EndCut,
    PrintedLumen,
    boxes_near,
    boxes_of,
    check_size,
    near_branches,
    near_surface,
    with_dots,
)
from carina.export.sampled_solid import norms, solid_mesh
from carina.track import Airways, AirwayTree, Branch
from carina.track.surface.mesh import Mesh
from carina.volume import Volume

Points = NDArray[np.float64]
Floats = NDArray[np.float64]

MOULD_PARTS = ("front", "back", "core")
MARGIN_MM = 10.0
"""Thickness in mm of the mould around the cast."""
PIN_MM, PIN_LENGTH_MM, CLEARANCE_MM = 3.0, 4.0, 0.2
"""Radius and length of the pins of the back half, and their distance from the holes of the front half, mm.

The supports of the core have the same distance from their beds.
"""
SUPPORT_MM, SUPPORT_LENGTH_MM = 1.2, 4.0
"""Maximum radius of the supports of the core at the tips, and their length in the halves, mm."""
HANDLE_MM = 5.0
"""Length in mm of the core outside the halves."""
CHANNEL_MM = 1.5
"""Radius in mm of the two channels to the cast beside the trachea, for the filling and for the air."""
CELL_MM = 1.0
"""Side in mm of the cells of the parting surface, at which the two halves meet."""
MIDDLE_SHARE = 0.4
"""Share of the radius round a branch's axis within which the two halves meet."""
ROUNDS = 3000
"""Number of times that each cell of the parting surface is replaced by the mean of its neighbours, to smooth it."""
FAR_MM = 50.0
"""Distance in mm that replaces distances beyond those that a `WallField` stores."""
OVERLAP_CELLS = 3
"""Number of cells over which neighbouring branches may overlap in front of or behind each other."""
LEAST_RADIUS_MM = 1.0
"""Minimum median radius in mm of a branch of the mould; a thinner core breaks."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class PrintableMould:
    """Two halves and a core for a cast of the airway wall."""

    front: Mesh
    """Front half (towards LPS -y), with the holes for the pins, LPS mm."""
    back: Mesh
    """Back half, with the pins."""
    core: Mesh
    """Lumen with the handle at the trachea and the supports at the tips."""
    wall_mm: float
    names: tuple[str, ...]
    """Names that the cast shows in relief."""
    branches: tuple[int, ...]
    """IDs of the branches in the mould."""
    num_left_out: int
    """Number of branches of the tree that are not in the mould."""

    @property
    def parts(self) -> dict[str, Mesh]:
        """Meshes of the front half, the back half and the core, by name."""
        return dict(zip(MOULD_PARTS, (self.front, self.back, self.core), strict=True))

    def to_json(self) -> dict[str, Any]:
        """Return the facts as plain JSON types."""
        return {
            "wall_mm": self.wall_mm,
            "parts": {
                name: {
                    "size_mm": [round(float(one), 1) for one in np.ptp(mesh.vertices_lps, axis=0)],
                    "volume_ml": round(mesh.volume_mm3 / 1000.0, 2),
                    "num_triangles": len(mesh.triangles),
                }
                for name, mesh in self.parts.items()
            },
            "names": list(self.names),
            "branches": list(self.branches),
            "num_left_out": self.num_left_out,
        }


@shows_progress
@check_arguments(
    volume=instance(Volume, "open a volume with carina.open_volume"),
    airways=instance(Airways, "get airways from carina.find_airways"),
    wall_mm=number_from(*WALL_MM, unit="mm"),
    names=flag,
    build_mm=each(number_from(10.0, 5000.0, unit="mm"), least=3, most=3),
    least_wall_mm=number_from(0.1, 10.0, unit="mm"),
)
def printable_mould(
    volume: Volume,
    airways: Airways,
    *,
    wall_mm: float = 2.0,
    names: bool = True,
    build_mm: tuple[float, float, float] = BUILD_MM,
    least_wall_mm: float = LEAST_WALL_MM,
    progress: ProgressChoice = None,
) -> PrintableMould:
    """Return a mould of the central airways: two halves with pins and holes, and a core.

    Parameters
    ----------
    volume, airways
        The CT and its airways.
    wall_mm
        Thickness of the cast, 0.6 to 2.2 mm: the distance between the core and the halves.
    names
        Whether the cast shows the names of branches in relief where they fit.
    build_mm
        Sides of the printer's build volume; each part may be turned by quarters to fit.
    least_wall_mm
        Least thickness that the printer makes; branches with a thinner lumen are left out of the core.
    progress
        False, True or ``f(what, fraction)``. True, as None, shows a bar in a terminal or a notebook. The fraction is
        None where it is unknown.

    Raises
    ------
    UsageError
        ``print.too-large`` if a part does not fit into the build volume, ``print.wall`` if the trachea itself is
        thinner than the printer makes.
    NoResultError
        If the lumen is empty.
    """
    report = progress_function(progress)
    tree = airways.tree
    chosen = mould_branches(tree, wall_mm, max(2.0 * LEAST_RADIUS_MM, least_wall_mm))
    if not chosen:
        raise UsageError(
            f"the trachea is thinner than the {least_wall_mm:g} mm that the printer makes; name a finer printer",
            code="print.wall",
        )
    box = _box_of([tree.branch(number) for number in chosen], wall_mm)
    lumen = PrintedLumen.of(volume, airways, report, branches=frozenset(chosen))
    rods = _rods(tree, chosen, lumen, box, wall_mm)
    parting = _Parting.of([tree.branch(number) for number in chosen], rods, box)
    x, _, z = (float(one) for one in box[1] - box[0])
    for name, y in (("front", parting.heights.max() - box[0][1]), ("back", box[1][1] - parting.heights.min())):
        check_size(f"{name} half of the mould", (x, float(y), z), build_mm)
    dots: Points = np.empty((0, 3))
    written: tuple[str, ...] = ()
    if names:
        dots, written, _ = name_dots(airways, lumen.field, wall_mm, branches=frozenset(chosen))
    cut = EndCut.of(tree.root, airways, lumen, at_start=True, wall_mm=wall_mm)
    shapes = _Shapes(lumen, wall_mm, cut, tuple(rods), dots, parting, box)
    reach_mm = wall_mm + DOT_MM + 1.5
    near = [*near_branches(airways, reach_mm), near_surface(lumen.mesh, reach_mm)]
    meshes = []
    for part in MOULD_PARTS:
        reach = HANDLE_MM + 3.0 if part == "core" else 1.0
        low, high, what = box[0] - reach, box[1] + reach, f"computing the {part}"
        mesh = solid_mesh(_Part(shapes, part), low, high, near, what=what, report=report, is_large=True)
        size = tuple(float(v) for v in np.ptp(mesh.vertices_lps, axis=0))
        check_size("core" if part == "core" else f"{part} half of the mould", size, build_mm)
        meshes.append(mesh)
    front, back, core = meshes
    return PrintableMould(front, back, core, wall_mm, written, tuple(chosen), len(tree.branches) - len(chosen))


def mould_branches(tree: AirwayTree, wall_mm: float, least_diameter_mm: float) -> list[int]:
    """Return the IDs of the branches of the mould, the trachea first.

    A branch belongs to the mould if its parent does, if it is wide enough, and if its wall is not before or behind the
    wall of another branch of the mould. Wide branches are chosen first in each generation.
    """
    points = np.concatenate([branch.points for branch in tree.branches])
    radii = np.concatenate([branch.radius for branch in tree.branches])
    margin = float(radii.max()) + wall_mm + 2.0
    columns = _Columns.around(points.min(axis=0) - margin, points.max(axis=0) + margin)
    low, high = (np.full(columns.shape, sign * np.inf) for sign in (1.0, -1.0))
    chosen: list[int] = []
    for branch in sorted(tree.branches, key=lambda one: (one.generation, -float(np.median(one.radius)))):
        if branch.parent is not None and branch.parent not in chosen:
            continue
        if 2.0 * float(np.median(branch.radius)) < least_diameter_mm:
            continue
        branch_low, branch_high = columns.heights(branch.points, branch.radius + wall_mm)
        both = np.isfinite(branch_low) & np.isfinite(low)
        if np.count_nonzero(both & ((branch_low > high) | (branch_high < low))) > OVERLAP_CELLS:
            continue
        low, high = np.minimum(low, branch_low), np.maximum(high, branch_high)
        chosen.append(branch.id)
    return chosen


def _box_of(branches: list[Branch], wall_mm: float) -> tuple[Points, Points]:
    """Return the corners (3,) of the block that the two halves form, LPS mm."""
    points = np.concatenate([branch.points for branch in branches])
    radii = np.concatenate([branch.radius for branch in branches])[:, None]
    margin = wall_mm + MARGIN_MM
    return (points - radii).min(axis=0) - margin, (points + radii).max(axis=0) + margin


@dataclass(frozen=True, slots=True, eq=False)
class _Columns:
    """Grid of columns along LPS y, with cells (x, z)."""

    first_xz: Floats
    shape: tuple[int, int]

    @classmethod
    def around(cls, low: Points, high: Points) -> _Columns:
        num = np.ceil((high - low) / CELL_MM).astype(int) + 1
        return cls(low[[0, 2]], (int(num[0]), int(num[2])))

    def heights(self, points: Points, radii: Floats) -> tuple[Floats, Floats]:
        """Return the least and the greatest y (nx, nz) of balls along a line; infinite where there are none."""
        low, high = (np.full(self.shape, sign * np.inf) for sign in (1.0, -1.0))
        for (x, y, z), radius in zip(*_dense(points, radii), strict=True):
            at = (np.array([x, z]) - self.first_xz) / CELL_MM
            reach = radius / CELL_MM
            i0, k0 = np.maximum(np.ceil(at - reach), 0).astype(int)
            i1, k1 = np.minimum(np.floor(at + reach), np.array(self.shape) - 1).astype(int) + 1
            i, k = np.ogrid[i0:i1, k0:k1]
            rest = radius**2 - CELL_MM**2 * ((i - at[0]) ** 2 + (k - at[1]) ** 2)
            half = np.sqrt(np.maximum(rest, 0.0))
            part = (slice(i0, i1), slice(k0, k1))
            low[part] = np.minimum(low[part], np.where(rest > 0.0, y - half, np.inf))
            high[part] = np.maximum(high[part], np.where(rest > 0.0, y + half, -np.inf))
        return low, high


def _dense(points: Points, radii: Floats) -> tuple[Points, Floats]:
    """Return the points and the radii of a line at distances of half a cell."""
    run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0.0, run[-1], max(2, math.ceil(2.0 * float(run[-1]) / CELL_MM) + 1))
    return np.stack([np.interp(at, run, points[:, axis]) for axis in range(3)], axis=1), np.interp(at, run, radii)


@dataclass(frozen=True, slots=True, eq=False)
class _Rod:
    """Handle or support of the core: a straight rod, square or round."""

    start_lps: Points
    way_lps: Points
    length_mm: float
    radius_mm: float
    """Radius, or half the side of a square rod."""
    is_square: bool

    def inside_mm(self, points: Points, grown_mm: float) -> Floats:
        """Return how deep points (n, 3) are inside the rod, grown on all sides, mm; negative outside."""
        away = points - self.start_lps
        along = away @ self.way_lps
        rest = away - along[:, None] * self.way_lps
        if self.is_square:
            # A square rod cannot turn in its bed; two of its faces are parallel to y, along which the halves open.
            side = np.cross(self.way_lps, (0.0, 1.0, 0.0))
            side /= np.linalg.norm(side)
            across = np.maximum(np.abs(rest @ side), np.abs(rest @ np.cross(self.way_lps, side)))
        else:
            across = norms(rest)
        ends = np.minimum(along, self.length_mm - along)
        found: Floats = np.minimum(ends, self.radius_mm - across) + grown_mm
        return found

    @property
    def line_lps(self) -> Points:
        """Both ends, (2, 3)."""
        return np.stack([self.start_lps, self.start_lps + self.length_mm * self.way_lps])

    @property
    def reach_mm(self) -> float:
        """Radius in mm of a ball round the rod's middle that contains the rod."""
        return 0.5 * self.length_mm + 1.5 * self.radius_mm


def _rods(
    tree: AirwayTree, chosen: list[int], lumen: PrintedLumen, box: tuple[Points, Points], wall_mm: float
) -> list[_Rod]:
    """Return the rods: the handle, and supports of the tips that touch no other branch."""
    root = tree.root
    out = root.points[0] - root.points[min(4, len(root.points) - 1)]
    out /= np.linalg.norm(out)
    begin = root.points[0] - 6.0 * out
    exits = [(box[0][a] if out[a] < 0.0 else box[1][a]) - begin[a] for a in range(3)]
    length = min(gap / one for gap, one in zip(exits, out, strict=True) if abs(one) > 1e-6)
    half = 0.65 * float(np.median(root.radius[: max(3, len(root.radius) // 4)]))
    found = [_Rod(begin, out, length + HANDLE_MM, half, is_square=True)]
    parents = {tree.branch(number).parent for number in chosen}
    for number in chosen:
        branch = tree.branch(number)
        if number in parents:
            continue
        inside = np.flatnonzero(lumen.field.distance_mm(branch.points) > 0.0)
        if not len(inside) or inside[-1] < 2:
            continue
        end = branch.points[inside[-1]]
        way = end - branch.points[max(0, inside[-1] - 3)]
        way /= np.linalg.norm(way)
        radius = min(SUPPORT_MM, 0.8 * float(branch.radius[inside[-1]]))
        rod = _Rod(end - 1.5 * way, way, 1.5 + wall_mm + 1.0 + SUPPORT_LENGTH_MM, radius, is_square=False)
        line = rod.start_lps + np.arange(0.0, rod.length_mm, 0.25)[:, None] * way
        beyond = lumen.field.distance_mm(line) <= -wall_mm
        first = int(np.argmax(beyond)) if beyond.any() else len(line)
        if first < len(line) and beyond[first:].all():
            found.append(rod)
    return found


@dataclass(frozen=True, slots=True, eq=False)
class _Parting:
    """Surface y(x, z), LPS mm, at which the two halves meet."""

    columns: _Columns
    heights: Floats
    """(nx, nz) position y of the parting surface in each column, LPS mm."""
    slopes: Floats
    """(nx, nz) lengths of the vector (1, slope along x, slope along z)."""

    @classmethod
    def of(cls, branches: list[Branch], rods: list[_Rod], box: tuple[Points, Points]) -> _Parting:
        """Return the smoothest surface that passes the middle of all branches and rods."""
        columns = _Columns.around(*box)
        low, high = (np.full(columns.shape, sign * np.inf) for sign in (1.0, -1.0))
        lines = [(one.points, one.radius) for one in branches]
        lines += [(one.line_lps, np.full(2, one.radius_mm)) for one in rods]
        for points, radii in lines:
            branch_low, branch_high = columns.heights(points, MIDDLE_SHARE * radii)
            low, high = np.minimum(low, branch_low), np.maximum(high, branch_high)
        fixed = np.isfinite(low)
        mean = float(np.mean([one.points[:, 1].mean() for one in branches]))
        heights = np.where(fixed, 0.5 * (np.where(fixed, low, 0.0) + np.where(fixed, high, 0.0)), mean)
        least, most = np.where(fixed, low, box[0][1] + 4.0), np.where(fixed, high, box[1][1] - 4.0)
        for _ in range(ROUNDS):
            wide = np.pad(heights, 1, mode="edge")
            around = 0.25 * (wide[2:, 1:-1] + wide[:-2, 1:-1] + wide[1:-1, 2:] + wide[1:-1, :-2])
            heights = np.clip(around, least, most)
        along_x, along_z = np.gradient(heights, CELL_MM)
        return cls(columns, heights, np.sqrt(1.0 + along_x**2 + along_z**2))

    def before_mm(self, points: Points) -> Floats:
        """Return how far points (n, 3) are before the surface (towards -y), mm; negative behind it."""
        at = (points[:, [0, 2]] - self.columns.first_xz) / CELL_MM
        at = np.clip(at, 0.0, np.array(self.columns.shape) - 1.001)
        i, k = np.floor(at).astype(int).T
        u, v = (at - np.floor(at)).T
        corners = self.heights[i, k], self.heights[i + 1, k], self.heights[i, k + 1], self.heights[i + 1, k + 1]
        height = (1 - v) * ((1 - u) * corners[0] + u * corners[1]) + v * ((1 - u) * corners[2] + u * corners[3])
        found: Floats = (height - points[:, 1]) / self.slopes[i, k]
        return found


@dataclass(frozen=True, slots=True, eq=False)
class _Shapes:
    """Solids of which the halves and the core consist."""

    lumen: PrintedLumen
    wall_mm: float
    cut: EndCut
    rods: tuple[_Rod, ...]
    """The handle first, then the supports."""
    dots_lps: Points
    parting: _Parting
    box: tuple[Points, Points]

    def pins_mm(self, points: Points, grown_mm: float) -> Floats:
        """Return how deep points (n, 3) are inside the pins at the four corners, grown on all sides, mm."""
        low, high = self.box
        found = np.full(len(points), -FAR_MM)
        for x in (low[0] + 0.5 * MARGIN_MM, high[0] - 0.5 * MARGIN_MM):
            for z in (low[2] + 0.5 * MARGIN_MM, high[2] - 0.5 * MARGIN_MM):
                y = float(points[0, 1] + self.parting.before_mm(np.array([[x, points[0, 1], z]]))[0]
                          * self.parting.slopes[self._cell(x, z)])  # fmt: skip
                across = np.hypot(points[:, 0] - x, points[:, 2] - z)
                along = np.minimum(points[:, 1] - (y - PIN_LENGTH_MM), y + PIN_LENGTH_MM - points[:, 1])
                found = np.maximum(found, np.minimum(PIN_MM - across, along) + grown_mm)
        return found

    def _cell(self, x: float, z: float) -> tuple[int, int]:
        i, k = np.floor((np.array([x, z]) - self.parting.columns.first_xz) / CELL_MM).astype(int)
        return int(i), int(k)

    def rods_mm(self, groups: Points, grown_mm: float) -> Floats:
        """Return how deep points (n, m, 3) are inside the handle and the supports, grown on all sides, (n * m,) mm."""
        found = np.full(groups.shape[:2], -FAR_MM)
        boxes = boxes_of(groups)
        for rod in self.rods:
            middle = rod.line_lps.mean(axis=0)
            numbers = boxes_near(boxes, middle[None], rod.reach_mm + 4.0)
            if not len(numbers):
                continue
            points = groups[numbers].reshape(-1, 3)
            near = norms(points - middle) < rod.reach_mm + 4.0
            if near.any():
                deep = np.full(len(points), -FAR_MM)
                deep[near] = rod.inside_mm(points[near], grown_mm)
                found[numbers] = np.maximum(found[numbers], deep.reshape(len(numbers), -1))
        return found.reshape(-1)

    def channels_mm(self, points: Points) -> Floats:
        """Return how deep points (n, 3) are inside the two channels beside the handle, mm."""
        handle = self.rods[0]
        side = np.cross(handle.way_lps, (0.0, 1.0, 0.0))
        side /= np.linalg.norm(side)
        away = float(self.cut.radius_mm) - 1.5 - 0.5 * self.wall_mm
        found = np.full(len(points), -FAR_MM)
        for sign in (-1.0, 1.0):
            offset = points - (self.cut.middle_lps + sign * away * side)
            along = offset @ handle.way_lps
            across = norms(offset - along[:, None] * handle.way_lps)
            found = np.maximum(found, np.minimum(along + 1.0, CHANNEL_MM - across))
        return found


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Solid of one part: front, back or core."""

    shapes: _Shapes
    name: str

    def inside_mm(self, groups: Points) -> Floats:
        """Return how deep points (n, m, 3) are inside the part, (n, m) mm; negative outside."""
        shapes = self.shapes
        points = groups.reshape(-1, 3)
        away = shapes.lumen.field.distance_mm(points)
        # Beyond the stored distances a point is far, so that blocks there need no samples.
        away = np.where(away < -2.45, -FAR_MM, away)
        if self.name == "core":
            core: Floats = np.maximum(away, shapes.rods_mm(groups, 0.0))
            return core.reshape(groups.shape[:2])
        cast = (away + shapes.wall_mm).reshape(groups.shape[:2])
        with_dots(cast, away.reshape(groups.shape[:2]), groups, shapes.dots_lps)
        hollow = np.minimum(cast.reshape(-1), -shapes.cut.inside_mm(points))
        hollow = np.maximum(hollow, away + CLEARANCE_MM)
        hollow = np.maximum(hollow, np.maximum(shapes.rods_mm(groups, CLEARANCE_MM), shapes.channels_mm(points)))
        low, high = shapes.box
        block = np.minimum(points - low, high - points).min(axis=1)
        before = shapes.parting.before_mm(points)
        if self.name == "front":
            half = np.minimum(before, -shapes.pins_mm(points, CLEARANCE_MM))
        else:
            half = np.maximum(-before, shapes.pins_mm(points, 0.0))
        depth: Floats = np.minimum(np.minimum(block, half), -hollow)
        return depth.reshape(groups.shape[:2])
