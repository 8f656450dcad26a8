"""Printable phantom: the airway wall at a chosen thickness as one watertight mesh, with an open trachea and names.

The wall is the set of points outside the printed lumen at a distance of at most its thickness. The printed lumen is the
part of the lumen that samples show as one piece, so that the wall is not thicker at ends that no sample shows.
Cylinders that are cut off open the trachea and, on request, the tips; the walls of other branches stay. Names are dots
on the outer surface.
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
from carina.export.sampled_solid import norms, solid_mesh
from carina.scopes import WallField
from carina.track import Airways, AirwayTree, Branch, wall_field
from carina.track.surface.mesh import Mesh, lumen_mesh
from carina.volume import Volume

Points = NDArray[np.float64]

WALL_MM = (0.6, 2.2)
"""Range of wall thickness in mm; distances to the lumen are stored up to its maximum."""
FIELD_MM = 0.25
"""Distance in mm of the samples of the distance to the printed lumen, between which the distance is interpolated."""
BUILD_MM = (250.0, 210.0, 210.0)
"""Default build volume in mm, that of a common desktop printer (general knowledge)."""
LEAST_WALL_MM = 1.0
"""Default minimum wall thickness in mm that a printer makes reliably (two lines of a 0.4 mm nozzle)."""
CUT_MM = 2.0
"""Length in mm of the end of the trachea, or of a tip, that is cut off."""
NARROW_MM = 2.0
"""Diameter of a lumen in mm below which a print may be blocked; such branches are counted."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class PrintablePhantom:
    """Mesh of the airway wall for a 3D printer."""

    mesh: Mesh
    """Closed mesh of the solid, LPS mm: the inner and outer surface are joined at the open ends."""
    wall_mm: float
    size_mm: tuple[float, float, float]
    """Extent of the printed solid along LPS x, y and z, mm."""
    names: tuple[str, ...]
    """Names of branches that are embossed on the solid."""
    names_left_out: tuple[str, ...]
    """Names of branches that are too short or too thin for their name."""
    num_open_tips: int
    num_closed_tips: int
    """Number of tips that are closed although open tips are wanted: the wall of another branch is before them."""
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
            "num_closed_tips": self.num_closed_tips,
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
    tree = airways.tree
    low, high = extent_of(airways, wall_mm)
    check_size("phantom", tuple(float(v) for v in high - low), build_mm)
    lumen = PrintedLumen.of(volume, airways, report)
    low, high = _box_of(lumen.mesh.vertices_lps, wall_mm)
    field = lumen.field
    cuts = [EndCut.of(tree.root, airways, lumen, at_start=True, wall_mm=wall_mm)]
    tips = [tip for tip in tree.tips() if tip.id != tree.root.id] if open_tips else []
    wanted = [EndCut.of(tip, airways, lumen, at_start=False, wall_mm=wall_mm) for tip in tips]
    opened = [one for one in wanted if one.is_free(field)]
    cuts += opened
    dots, written, left_out = name_dots(airways, field, wall_mm) if names else (np.empty((0, 3)), (), ())
    solid = _Wall(field, wall_mm, tuple(cuts), dots)
    near = [near_surface(lumen.mesh, wall_mm + DOT_MM + 1.5)]
    mesh = solid_mesh(solid, low, high, near, what="computing the wall", report=report)
    size = np.ptp(mesh.vertices_lps, axis=0)
    extent = (float(size[0]), float(size[1]), float(size[2]))
    check_size("phantom", extent, build_mm)
    narrow = sum(2.0 * float(np.median(branch.radius)) < NARROW_MM for branch in tree.branches)
    return PrintablePhantom(mesh, wall_mm, extent, written, left_out, len(opened), len(wanted) - len(opened), narrow)


@dataclass(frozen=True, slots=True, eq=False)
class PrintedLumen:
    """Connected part of the lumen that is printed, as the samples show it."""

    mesh: Mesh
    field: WallField
    """Signed distance field of the lumen's mesh."""

    @classmethod
    def of(
        cls, volume: Volume, airways: Airways, report: Any, *, branches: frozenset[int] | None = None
    ) -> PrintedLumen:
        """Return the printed lumen of airways, or of some branches only."""
        surface = lumen_mesh(volume, airways)
        low, high = _box_of(surface.vertices_lps, 0.0)
        lumen = _Lumen.of(wall_field(volume, airways, progress=report), airways.tree, branches)
        # A lumen that is not round reaches beyond the radii of its centreline.
        near = [*near_branches(airways, 1.5), near_surface(surface, 1.5)]
        mesh = solid_mesh(lumen, low, high, near, what="computing the lumen", report=report)
        return cls(mesh, WallField.from_mesh(mesh.vertices_lps, mesh.triangles, spacing_mm=FIELD_MM, progress=report))


def near_branches(airways: Airways, reach_mm: float) -> list[tuple[Points, NDArray[np.float64]]]:
    """Return the centrelines of all branches, with the radii plus a reach in mm."""
    return [(branch.points, branch.radius + reach_mm) for branch in airways.tree.branches]


def near_surface(mesh: Mesh, reach_mm: float) -> tuple[Points, NDArray[np.float64]]:
    """Return the vertices of a surface, with a reach in mm."""
    return mesh.vertices_lps, np.full(len(mesh.vertices_lps), reach_mm)


def _box_of(points: Points, wall_mm: float) -> tuple[Points, Points]:
    """Return the corners (3,) of a box round points (n, 3) of a surface and the wall around it, LPS mm."""
    margin = wall_mm + 2.0
    return points.min(axis=0) - margin, points.max(axis=0) + margin


def extent_of(airways: Airways, wall_mm: float) -> tuple[Points, Points]:
    """Return the corners (3,) of a box round the airways and their wall, LPS mm."""
    points = np.concatenate([branch.points for branch in airways.tree.branches])
    radii = np.concatenate([branch.radius for branch in airways.tree.branches])[:, None]
    margin = wall_mm + 2.0
    return (points - radii).min(axis=0) - margin, (points + radii).max(axis=0) + margin


def check_size(what: str, size_mm: tuple[float, ...], build_mm: tuple[float, float, float]) -> None:
    """Raise UsageError if a part does not fit into the build volume, even turned by quarters."""
    if any(need > have for need, have in zip(sorted(size_mm), sorted(build_mm), strict=True)):
        need, have = (" x ".join(f"{one:.0f}" for one in sorted(some, reverse=True)) for some in (size_mm, build_mm))
        raise UsageError(
            f"the {what} of {need} mm does not fit into the build volume of {have} mm, even turned by quarters; name "
            "a larger build volume, or cut the airways (edit the tree)",
            code="print.too-large",
        )


@dataclass(frozen=True, slots=True, eq=False)
class EndCut:
    """Cylinder that is removed at an end of a branch, without the walls of other branches."""

    middle_lps: Points
    """(3,) middle of the plane at which the branch is cut, LPS mm."""
    out_lps: Points
    """(3,) unit vector out of the branch."""
    radius_mm: float
    length_mm: float
    wall_mm: float
    others_lps: Points
    """(n, 3) points near the cylinder on the printed lumen of other branches, LPS mm."""

    @classmethod
    def of(cls, branch: Branch, airways: Airways, lumen: PrintedLumen, *, at_start: bool, wall_mm: float) -> EndCut:
        """Return the cut `CUT_MM` before the beginning or the end of the printed lumen of a branch."""
        points = branch.points if not at_start else branch.points[::-1]
        radii = branch.radius if not at_start else branch.radius[::-1]
        printed = np.flatnonzero(lumen.field.distance_mm(points) > 0.0)
        last = max(int(printed[-1]), 1) + 1 if len(printed) else len(points)
        points, radii = points[:last], radii[:last]
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        back = np.concatenate([np.cumsum(steps[::-1])[::-1], [0.0]])
        cut_mm = min(CUT_MM, 0.5 * float(back[0]))
        middle = np.array([np.interp(cut_mm, back[::-1], points[::-1, axis]) for axis in range(3)])
        before = np.array([np.interp(cut_mm + 3.0, back[::-1], points[::-1, axis]) for axis in range(3)])
        out = middle - before
        norm = float(np.linalg.norm(out))
        out = points[-1] - points[0] if norm < 1e-6 else out
        widest = float(radii[-max(3, len(radii) // 4) :].max())
        radius, length = widest + wall_mm + 1.5, 2.0 * widest + cut_mm + wall_mm + 4.0
        reach = math.hypot(radius, length) + wall_mm
        near = lumen.mesh.vertices_lps
        near = near[np.linalg.norm(near - middle, axis=1) < reach]
        others = near[_owners(near, airways) != branch.id]
        return cls(middle, out / np.linalg.norm(out), radius, length, wall_mm, others)

    def is_free(self, field: WallField) -> bool:
        """Return whether the axis leaves the lumen and its wall without meeting the wall of another branch."""
        if float(field.distance_mm(self.middle_lps)[0]) <= 0.0:
            return False
        along = np.arange(0.0, self.length_mm, 0.2)
        axis = self.middle_lps + along[:, None] * self.out_lps
        outside = np.flatnonzero(field.distance_mm(axis) <= -self.wall_mm)
        return bool(len(outside)) and bool((self._from_others_mm(axis[: outside[0] + 1]) > 0.0).all())

    def _from_others_mm(self, points: Points) -> NDArray[np.float64]:
        """Return the distances of points (n, 3) from the walls of other branches, mm; negative in them."""
        if not len(self.others_lps):
            return np.full(len(points), np.inf)
        gaps = [norms(some[:, None] - self.others_lps[None]).min(axis=1) for some in
                np.array_split(points, max(1, len(points) * len(self.others_lps) // 2_000_000))]  # fmt: skip
        found: NDArray[np.float64] = np.concatenate(gaps) - self.wall_mm
        return found

    def inside_mm(self, points: Points) -> NDArray[np.float64]:
        """Return how deep points (n, 3) are inside the part that is removed, mm; negative outside."""
        away = points - self.middle_lps
        along = away @ self.out_lps
        across = norms(away - along[:, None] * self.out_lps)
        found: NDArray[np.float64] = np.minimum(np.minimum(along, self.length_mm - along), self.radius_mm - across)
        # Samples next to the surface need the exact depth on both sides.
        close = found > -1.0
        found[close] = np.minimum(found[close], self._from_others_mm(points[close]))
        return found


def _owners(points: Points, airways: Airways) -> NDArray[np.int64]:
    """Return the IDs of the branches to whose centrelines, less the radius, points (n, 3) are nearest."""
    best = np.full(len(points), np.inf)
    owner = np.full(len(points), -1, dtype=np.int64)
    if not len(points):
        return owner
    middle = points.mean(axis=0)
    spread = float(norms(points - middle).max())
    for branch in airways.tree.branches:
        # A ball that is farther from all points than the nearest ball of any branch cannot win.
        near = norms(branch.points - middle) - branch.radius < 2.0 * spread + 5.0
        if not near.any():
            continue
        gaps = norms(points[:, None] - branch.points[near][None]) - branch.radius[near]
        least = gaps.min(axis=1)
        owner[least < best] = branch.id
        best = np.minimum(best, least)
    return owner


@dataclass(frozen=True, slots=True, eq=False)
class _Lumen:
    """The lumen of the airways, or of some branches, whose forks are cut half-way to the branches that are left out."""

    field: WallField
    ours: _Balls | None
    """Balls of the branches of the lumen; None for all branches."""
    others: _Balls | None
    """Balls of the branches that are left out; None for all branches."""

    @classmethod
    def of(cls, field: WallField, tree: AirwayTree, branches: frozenset[int] | None) -> _Lumen:
        """Return the lumen of the branches with these IDs; None for all branches."""
        if branches is None:
            return cls(field, None, None)
        ours = [one for one in tree.branches if one.id in branches]
        others = [one for one in tree.branches if one.id not in branches]
        return cls(field, _Balls.of(ours), _Balls.of(others))

    def inside_mm(self, groups: Points) -> NDArray[np.float64]:
        """Return how deep points (n, m, 3) are inside the lumen, (n, m) mm; negative outside."""
        found: NDArray[np.float64] = self.field.distance_mm(groups.reshape(-1, 3)).reshape(groups.shape[:2])
        if self.ours is None or self.others is None:
            return found
        for number in np.flatnonzero((found > -1.0).any(axis=1)):
            # Far branches cannot own a point of the lumen.
            chosen = found[number] > -1.0
            some = groups[number][chosen]
            margin = 0.5 * (self.others.distance_mm(some) - self.ours.distance_mm(some))
            found[number, chosen] = np.minimum(found[number, chosen], margin)
        return found


@dataclass(frozen=True, slots=True, eq=False)
class _Balls:
    """Balls along the centrelines of some branches."""

    points: Points
    radius_mm: NDArray[np.float64]

    @classmethod
    def of(cls, branches: list[Branch]) -> _Balls:
        """Return all balls of the branches."""
        if not branches:
            return cls(np.empty((0, 3)), np.empty(0))
        return cls(np.concatenate([one.points for one in branches]), np.concatenate([one.radius for one in branches]))

    def distance_mm(self, points: Points) -> NDArray[np.float64]:
        """Return the distance of neighbouring points (n, 3) to the nearest ball, mm; 5 mm if all are farther."""
        best = np.full(len(points), 5.0)
        middle = points.mean(axis=0)
        spread = float(norms(points - middle).max())
        near = norms(self.points - middle) - self.radius_mm < spread + 5.0
        if near.any():
            gaps = norms(points[:, None] - self.points[near][None]) - self.radius_mm[near]
            best = np.minimum(best, gaps.min(axis=1))
        return best


def boxes_of(groups: Points) -> tuple[Points, Points]:
    """Return the corners (n, 3) of the boxes of groups of points (n, m, 3)."""
    return groups.min(axis=1), groups.max(axis=1)


def boxes_near(boxes: tuple[Points, Points], places: Points, reach_mm: float) -> NDArray[np.int64]:
    """Return which of the boxes of `boxes_of` are within a reach of the box of some places."""
    low, high = boxes
    first, last = places.min(axis=0) - reach_mm, places.max(axis=0) + reach_mm
    return np.flatnonzero(((high >= first) & (low <= last)).all(axis=1))


def with_dots(depth: NDArray[np.float64], away: NDArray[np.float64], groups: Points, dots_lps: Points) -> None:
    """Add dots to a solid outside the lumen, in place.

    Parameters
    ----------
    depth
        (n, m) depths in mm in the solid, which are raised.
    away
        (n, m) distances in mm to the wall of the lumen, positive in the lumen.
    groups
        (n, m, 3) points, LPS mm.
    dots_lps
        (k, 3) middles of the dots, LPS mm; neighbours in the array are neighbours in space.
    """
    boxes = boxes_of(groups)
    for first in range(0, len(dots_lps), 16):
        some = dots_lps[first : first + 16]
        for number in boxes_near(boxes, some, DOT_MM):
            gaps = norms(groups[number][:, None] - some[None]).min(axis=1)
            depth[number] = np.maximum(depth[number], np.minimum(DOT_MM - gaps, -away[number]))


@dataclass(frozen=True, slots=True, eq=False)
class _Wall:
    """Solid wall with the cuts at its ends and the embossed names."""

    field: WallField
    wall_mm: float
    cuts: tuple[EndCut, ...]
    dots_lps: Points

    def inside_mm(self, groups: Points) -> NDArray[np.float64]:
        """Return how deep points (n, m, 3) are inside the solid, (n, m) mm; negative outside, exact near the surface.

        Points of one group are neighbours; cuts and dots far from a group are skipped.
        """
        away = self.field.distance_mm(groups.reshape(-1, 3)).reshape(groups.shape[:2])
        depth: NDArray[np.float64] = np.minimum(-away, away + self.wall_mm)
        with_dots(depth, away, groups, self.dots_lps)
        boxes = boxes_of(groups)
        for cut in self.cuts:
            for number in boxes_near(boxes, cut.middle_lps[None], math.hypot(cut.radius_mm, cut.length_mm)):
                depth[number] = np.minimum(depth[number], -cut.inside_mm(groups[number]))
        return depth
