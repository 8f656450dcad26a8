"""Printable phantom: the airway wall at a chosen thickness as one watertight mesh, with an open trachea and names.

The wall is the set of points outside the lumen at a distance of at most its thickness. Cylinders that are cut off open
the trachea and, on request, the tips. Names are dots on the outer surface. The mesh is that of marching cubes over
samples of the signed distance to this solid; each vertex is at the zero crossing of its grid edge.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.argument_checks import check_arguments, each, flag, instance, number_from
from carina.display import one_line
from carina.display.dot_letters import text_dots
from carina.display.progress import ProgressChoice, progress_function, shows_progress
from carina.errors import NoResultError, UsageError
from carina.scopes import WallField
from carina.track import Airways, Branch, wall_field
from carina.track.surface.mesh import Mesh, mask_mesh
from carina.volume import Volume

Points = NDArray[np.float64]

WALL_MM = (0.6, 2.2)
"""Range of the thickness in mm; beyond it the distance to the lumen is not stored."""
SAMPLE_MM = 0.4
"""Distance in mm between the samples from which the surface of the printed solid is computed."""
BLOCK = 8
"""Number of samples along the side of a block; only blocks near the wall are computed."""
BLOCKS_AT_ONCE, GROUP = 256, 128
"""Number of blocks that are computed together, and number of vertices of a group."""
BUILD_MM = (250.0, 210.0, 210.0)
"""Default build volume in mm, that of a common desktop printer (general knowledge)."""
LEAST_WALL_MM = 1.0
"""Default least thickness in mm that a printer makes reliably (general knowledge: two lines of a 0.4 mm nozzle)."""
CUT_MM = 2.0
"""Length in mm of the end of the trachea, or of a tip, that is cut off."""
DOT_MM, DOT_PITCH_MM = 0.55, 0.75
"""Radius of the embossed dots of names, and distance between them, mm."""
NARROW_MM = 2.0
"""Diameter of a lumen in mm below which a print may be blocked; such branches are counted."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class PrintablePhantom:
    """Mesh of the airway wall for a 3D printer."""

    mesh: Mesh
    """Closed mesh of the solid, LPS mm: the inner and outer surface are joined at the open ends.

    Parts of the lumen that the samples do not join to it are cavities.
    """
    wall_mm: float
    size_mm: tuple[float, float, float]
    """Extent of the printed solid along LPS x, y and z, mm."""
    names: tuple[str, ...]
    """Names of branches that are embossed on the solid."""
    names_left_out: tuple[str, ...]
    """Names of branches that are too short or too thin for their name."""
    num_open_tips: int
    num_narrow: int
    """Number of branches whose lumen is narrower than 2 mm, which a print may block."""

    def to_json(self) -> dict[str, Any]:
        """Return the facts as plain JSON types."""
        return {
            "wall_mm": self.wall_mm,
            "size_mm": [round(one, 1) for one in self.size_mm],
            "volume_ml": round(self.mesh.volume_mm3 / 1000.0, 2),
            "num_triangles": len(self.mesh.triangles),
            "names": list(self.names),
            "names_left_out": list(self.names_left_out),
            "num_open_tips": self.num_open_tips,
            "num_narrow": self.num_narrow,
        }


@shows_progress
@check_arguments(
    volume=instance(Volume, "open a volume with carina.open_volume"),
    airways=instance(Airways, "get airways from carina.find_airways"),
    wall_mm=number_from(*WALL_MM, unit="mm"),
    open_tips=flag,
    names=flag,
    build_mm=each(number_from(10.0, 5000.0, unit="mm"), least=3, most=3),
    least_wall_mm=number_from(0.1, 10.0, unit="mm"),
)
def printable_phantom(
    volume: Volume,
    airways: Airways,
    *,
    wall_mm: float = 2.0,
    open_tips: bool = False,
    names: bool = True,
    build_mm: tuple[float, float, float] = BUILD_MM,
    least_wall_mm: float = LEAST_WALL_MM,
    progress: ProgressChoice = None,
) -> PrintablePhantom:
    """Return the airway wall as a solid for a 3D printer, open at the trachea.

    Parameters
    ----------
    volume, airways
        The CT and its airways.
    wall_mm
        Thickness of the wall, 0.6 to 2.2 mm: the distance of the outer surface from the lumen.
    open_tips
        Whether the tips are open, too.
    names
        Whether the names of branches are embossed where they fit.
    build_mm
        Sides of the printer's build volume; the phantom may be turned by quarters to fit.
    least_wall_mm
        Least thickness that the printer makes.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is None while the progress is unknown.

    Raises
    ------
    UsageError
        ``print.wall`` for a wall thinner than the printer makes, ``print.too-large`` for a phantom that does not fit
        into the build volume.
    NoResultError
        If the lumen is empty.
    """
    if wall_mm < least_wall_mm:
        raise UsageError(
            f"the wall of {wall_mm:g} mm is thinner than the {least_wall_mm:g} mm that the printer makes; choose a "
            "thicker wall",
            code="print.wall",
        )
    report = progress_function(progress)
    wall = wall_field(volume, airways, progress=report)
    tree = airways.tree
    low, high = _extent(airways, wall_mm)
    _check_size(tuple(float(v) for v in high - low), build_mm)
    cuts = [_Cut.of(tree.root, at_start=True, wall_mm=wall_mm)]
    tips = [tip for tip in tree.tips() if tip.id != tree.root.id]
    if open_tips:
        cuts += [_Cut.of(tip, at_start=False, wall_mm=wall_mm) for tip in tips]
    dots, written, left_out = _name_dots(airways, wall, wall_mm) if names else (np.empty((0, 3)), (), ())
    solid = _Solid(wall, wall_mm, tuple(cuts), dots)
    mesh = _largest_piece(_mesh_of(solid, airways, low, high, report))
    size = np.ptp(mesh.vertices_lps, axis=0)
    extent = (float(size[0]), float(size[1]), float(size[2]))
    _check_size(extent, build_mm)
    narrow = sum(2.0 * float(np.median(branch.radius)) < NARROW_MM for branch in tree.branches)
    return PrintablePhantom(mesh, wall_mm, extent, written, left_out, len(cuts) - 1, narrow)


def _extent(airways: Airways, wall_mm: float) -> tuple[Points, Points]:
    points = np.concatenate([branch.points for branch in airways.tree.branches])
    radii = np.concatenate([branch.radius for branch in airways.tree.branches])[:, None]
    margin = wall_mm + 2.0
    return (points - radii).min(axis=0) - margin, (points + radii).max(axis=0) + margin


def _check_size(size_mm: tuple[float, ...], build_mm: tuple[float, float, float]) -> None:
    if any(need > have for need, have in zip(sorted(size_mm), sorted(build_mm), strict=True)):
        need, have = (" x ".join(f"{one:.0f}" for one in sorted(some, reverse=True)) for some in (size_mm, build_mm))
        raise UsageError(
            f"the phantom of {need} mm does not fit into the build volume of {have} mm, even turned by quarters; name "
            "a larger build volume, or cut the airways (edit the tree)",
            code="print.too-large",
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Cut:
    """Cylinder that is removed at an end of a branch."""

    middle_lps: Points
    """(3,) middle of the plane at which the branch is cut, LPS mm."""
    out_lps: Points
    """(3,) unit vector out of the branch."""
    radius_mm: float
    length_mm: float

    @classmethod
    def of(cls, branch: Branch, *, at_start: bool, wall_mm: float) -> _Cut:
        """Return the cut of the beginning or the end of a branch, `CUT_MM` before it."""
        points = branch.points if not at_start else branch.points[::-1]
        radii = branch.radius if not at_start else branch.radius[::-1]
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        back = np.concatenate([np.cumsum(steps[::-1])[::-1], [0.0]])
        cut_mm = min(CUT_MM, 0.5 * float(back[0]))
        middle = np.array([np.interp(cut_mm, back[::-1], points[::-1, axis]) for axis in range(3)])
        before = np.array([np.interp(cut_mm + 3.0, back[::-1], points[::-1, axis]) for axis in range(3)])
        out = middle - before
        norm = float(np.linalg.norm(out))
        out = points[-1] - points[0] if norm < 1e-6 else out
        widest = float(radii[-max(3, len(radii) // 4) :].max())
        return cls(middle, out / np.linalg.norm(out), widest + wall_mm + 1.5, 2.0 * widest + cut_mm + wall_mm + 4.0)

    def inside_mm(self, points: Points) -> NDArray[np.float64]:
        """Return how deep points are inside the cylinder, mm; negative outside."""
        away = points - self.middle_lps
        along = away @ self.out_lps
        across = np.linalg.norm(away - along[:, None] * self.out_lps, axis=1)
        found: NDArray[np.float64] = np.minimum(np.minimum(along, self.length_mm - along), self.radius_mm - across)
        return found


@dataclass(frozen=True, slots=True, eq=False)
class _Solid:
    """The wall with its cuts and its names, as a function that is positive inside."""

    wall: WallField
    wall_mm: float
    cuts: tuple[_Cut, ...]
    dots_lps: Points

    def inside_mm(self, groups: Points) -> NDArray[np.float64]:
        """Return how deep points (n, m, 3) are inside the solid, (n, m) mm; negative outside, exact near the surface.

        Points of one group are neighbours; cuts and dots far from a group are skipped.
        """
        shape = groups.shape[:2]
        away = self.wall.distance_mm(groups.reshape(-1, 3)).reshape(shape)
        depth: NDArray[np.float64] = np.minimum(-away, away + self.wall_mm)
        low, high = groups.min(axis=1), groups.max(axis=1)

        def near(places: Points, reach_mm: float) -> NDArray[np.int64]:
            first, last = places.min(axis=0) - reach_mm, places.max(axis=0) + reach_mm
            return np.flatnonzero(((high >= first) & (low <= last)).all(axis=1))

        for first in range(0, len(self.dots_lps), 16):
            some = self.dots_lps[first : first + 16]
            for number in near(some, DOT_MM):
                gaps = np.linalg.norm(groups[number][:, None] - some[None], axis=2).min(axis=1)
                raised = np.minimum(DOT_MM - gaps, -away[number])
                depth[number] = np.maximum(depth[number], raised)
        for cut in self.cuts:
            for number in near(cut.middle_lps[None], math.hypot(cut.radius_mm, cut.length_mm)):
                depth[number] = np.minimum(depth[number], -cut.inside_mm(groups[number]))
        return depth


def _mesh_of(solid: _Solid, airways: Airways, low: Points, high: Points, report: Any) -> Mesh:
    """Return the closed mesh of a solid."""
    num = np.ceil((high - low) / (SAMPLE_MM * BLOCK)).astype(int)
    active = np.zeros(num[::-1], dtype=np.bool_)
    block_mm = SAMPLE_MM * BLOCK
    for branch in airways.tree.branches:
        for point, radius in zip(branch.points, branch.radius, strict=True):
            reach = radius + solid.wall_mm + DOT_MM + 1.5
            first = np.maximum(np.floor((point - reach - low) / block_mm).astype(int), 0)
            last = np.minimum(np.floor((point + reach - low) / block_mm).astype(int) + 1, num)
            active[first[2] : last[2], first[1] : last[1], first[0] : last[0]] = True
    inside = np.zeros(tuple(num[::-1] * BLOCK), dtype=np.bool_)
    cell = np.stack(np.meshgrid(*(np.arange(BLOCK),) * 3, indexing="ij")[::-1], axis=-1).reshape(-1, 3)
    blocks = np.argwhere(active)
    for n in range(0, len(blocks), BLOCKS_AT_ONCE):
        if report is not None:
            report("computing the wall", n / len(blocks))
        some = blocks[n : n + BLOCKS_AT_ONCE]
        points = low + SAMPLE_MM * (some[:, None, ::-1] * BLOCK + cell)
        part = (solid.inside_mm(points) > 0.0).reshape(-1, BLOCK, BLOCK, BLOCK)
        for (k, j, i), one in zip(some * BLOCK, part, strict=True):
            inside[k : k + BLOCK, j : j + BLOCK, i : i + BLOCK] = one
    if not inside.any():
        raise NoResultError("the airway lumen is empty", code="print.no-lumen")
    matrix = np.diag([SAMPLE_MM] * 3 + [1.0])
    matrix[:3, 3] = low
    rough = mask_mesh(inside, matrix)
    return Mesh(_at_the_surface(rough, solid, low), rough.triangles)


def _at_the_surface(rough: Mesh, solid: _Solid, low: Points) -> Points:
    """Return the vertices of a mesh of samples, each moved along its grid edge to the surface of the solid."""
    ijk = (rough.vertices_lps - low) / SAMPLE_MM
    halves = np.abs(ijk - np.rint(ijk)) > 0.25
    on_edge = halves.sum(axis=1) == 1
    lower, upper = np.floor(ijk + 1e-6), np.ceil(ijk - 1e-6)
    a, b = np.where(halves, lower, np.rint(ijk)), np.where(halves, upper, np.rint(ijk))
    moved = rough.vertices_lps.copy()
    # Neighbouring vertices form groups, so that few groups are near a cut or a name.
    cell = np.floor(ijk / BLOCK).astype(np.int64)
    edges = np.flatnonzero(on_edge)
    edges = edges[np.lexsort(cell[edges].T)]
    for first in range(0, len(edges), GROUP * BLOCKS_AT_ONCE):
        part = edges[first : first + GROUP * BLOCKS_AT_ONCE]
        # The last group is filled with its last vertex.
        whole = np.concatenate([part, np.repeat(part[-1:], -len(part) % GROUP)]).reshape(-1, GROUP)
        at_a, at_b = low + SAMPLE_MM * a[part], low + SAMPLE_MM * b[part]
        deep_a, deep_b = (solid.inside_mm(low + SAMPLE_MM * ends[whole]).reshape(-1)[: len(part)] for ends in (a, b))
        share = deep_a / np.where(np.abs(deep_a - deep_b) < 1e-9, 1.0, deep_a - deep_b)
        # The depth bends where two branches meet, so one step of regula falsi follows the linear estimate.
        middle = at_a + share[:, None] * (at_b - at_a)
        filled = np.concatenate([middle, np.repeat(middle[-1:], -len(part) % GROUP, axis=0)]).reshape(-1, GROUP, 3)
        deep = solid.inside_mm(filled).reshape(-1)[: len(part)]
        same = (deep > 0.0) == (deep_a > 0.0)
        begin, end = np.where(same, share, 0.0), np.where(same, 1.0, share)
        deep_begin, deep_end = np.where(same, deep, deep_a), np.where(same, deep_b, deep)
        change = deep_begin - deep_end
        share = begin + (end - begin) * deep_begin / np.where(np.abs(change) < 1e-9, 1.0, change)
        # The limits keep neighbouring vertices apart, so that no triangle has an area of 0.
        share = np.clip(share, 0.04, 0.96)
        moved[part] = at_a + share[:, None] * (at_b - at_a)
    rest = np.flatnonzero(~on_edge)
    if len(rest):
        # Middles of rings: the mean of the neighbours, which have moved.
        total, count = np.zeros((len(moved), 3)), np.zeros(len(moved))
        for first, second in itertools.permutations(range(3), 2):
            to, of = rough.triangles[:, first], rough.triangles[:, second]
            chosen = ~on_edge[to] & on_edge[of]
            np.add.at(total, to[chosen], moved[of[chosen]])
            np.add.at(count, to[chosen], 1.0)
        known = rest[count[rest] > 0]
        moved[known] = total[known] / count[known, None]
    return moved


def _largest_piece(mesh: Mesh) -> Mesh:
    """Return the largest solid of a mesh with its cavities; solids that no airway joins are left out."""
    labels = np.arange(len(mesh.vertices_lps))
    while True:
        least = labels[mesh.triangles].min(axis=1)
        before = labels.copy()
        for corner in range(3):
            np.minimum.at(labels, mesh.triangles[:, corner], least)
        labels = labels[labels]
        if np.array_equal(labels, before):
            break
    owner = labels[mesh.triangles[:, 0]]
    corners = (mesh.vertices_lps - mesh.vertices_lps.mean(axis=0))[mesh.triangles]
    parts = np.einsum("na,na->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    volumes = np.bincount(owner, weights=parts, minlength=len(labels))
    largest = int(np.argmax(volumes))
    # A narrow part of a lumen may be a separate cavity, whose surface encloses a negative volume.
    solids = [one for one in np.unique(owner).tolist() if volumes[one] > 0.0 and one != largest]
    boxes = [(mesh.vertices_lps[labels == one].min(axis=0), mesh.vertices_lps[labels == one].max(axis=0))
             for one in solids]  # fmt: skip
    kept_pieces = {largest}
    for one in np.unique(owner).tolist():
        point = mesh.vertices_lps[one]
        if volumes[one] < 0.0 and not any(((point >= low) & (point <= high)).all() for low, high in boxes):
            kept_pieces.add(one)
    kept = mesh.triangles[np.isin(owner, list(kept_pieces))]
    used = np.unique(kept)
    number = np.zeros(len(labels), dtype=np.uint32)
    number[used] = np.arange(len(used), dtype=np.uint32)
    return Mesh(mesh.vertices_lps[used], number[kept])


def _name_dots(airways: Airways, wall: WallField, wall_mm: float) -> tuple[Points, tuple[str, ...], tuple[str, ...]]:
    """Return the dots (n, 3) of all names that fit, the names, and the names that do not fit."""
    found: list[Points] = []
    written: list[str] = []
    left_out: list[str] = []
    for branch in airways.tree.branches:
        if branch.name is None or branch.name in written:
            continue
        dots = _dots_on(branch, wall, wall_mm)
        if dots is None:
            left_out.append(branch.name)
        else:
            found.append(dots)
            written.append(branch.name)
    every = np.concatenate(found) if found else np.empty((0, 3))
    return every, tuple(written), tuple(dict.fromkeys(one for one in left_out if one not in written))


def _dots_on(branch: Branch, wall: WallField, wall_mm: float) -> Points | None:
    """Return the dots of a branch's name on its outer surface, (n, 3) LPS mm; None if the name does not fit."""
    dots = text_dots(str(branch.name))
    rows, columns = np.nonzero(dots)
    length = dots.shape[1] * DOT_PITCH_MM
    steps = np.linalg.norm(np.diff(branch.points, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    middle_mm = 0.5 * float(along[-1])
    outer = float(np.median(branch.radius)) + wall_mm
    # Half of the circumference is visible from one side.
    if length > along[-1] - 2.0 or dots.shape[0] * DOT_PITCH_MM > 2.0 * outer:
        return None
    at = middle_mm - 0.5 * length + (columns + 0.5) * DOT_PITCH_MM
    line = np.stack([np.interp(at, along, branch.points[:, axis]) for axis in range(3)], axis=1)
    ahead = np.stack([np.interp(at + 1.0, along, branch.points[:, axis]) for axis in range(3)], axis=1)
    behind = np.stack([np.interp(at - 1.0, along, branch.points[:, axis]) for axis in range(3)], axis=1)
    tangent = ahead - behind
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    for turn in range(12):
        # The first choice is the front, as a person looks at the model.
        side = np.array([math.sin(turn * math.pi / 6.0), -math.cos(turn * math.pi / 6.0), 0.0])
        out = side - (tangent @ side)[:, None] * tangent
        lengths = np.linalg.norm(out, axis=1, keepdims=True)
        if lengths.min() < 0.3:
            continue
        out /= lengths
        up = np.cross(out, tangent)
        angle = (rows - 0.5 * (dots.shape[0] - 1)) * DOT_PITCH_MM / outer
        ray = np.cos(angle)[:, None] * out + np.sin(angle)[:, None] * up
        placed = _outer_points(line, ray, wall, wall_mm, outer)
        if placed is not None:
            return placed
    return None


def _outer_points(line: Points, ray: Points, wall: WallField, wall_mm: float, outer_mm: float) -> Points | None:
    """Return where rays from a centreline leave the wall; None if one does not, near the expected distance."""
    reach = np.arange(0.0, outer_mm + 3.0, 0.1)
    points = line[:, None] + reach[None, :, None] * ray[:, None]
    away = wall.distance_mm(points.reshape(-1, 3)).reshape(len(line), len(reach))
    beyond = away < -wall_mm
    if not beyond.any(axis=1).all():
        return None
    first = np.argmax(beyond, axis=1)
    places = reach[first]
    if np.abs(places - np.median(places)).max() > 1.5:
        return None
    # Nothing else may be close behind the surface, because the letters would merge with it.
    free = wall.distance_mm(line + (places + 1.0)[:, None] * ray)
    if (free > -min(2.45, wall_mm + 0.2)).any():
        return None
    found: Points = line + places[:, None] * ray
    return found
