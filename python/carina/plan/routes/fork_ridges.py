"""Ridges between the branches of a fork, as the wall of the segmented lumen shows them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.scopes import WallField
from carina.track import Branch
from carina.track.measures.forks import point_at

Points = NDArray[np.float64]

STEP_MM = 0.25
"""Distance in mm between two places of a branch that are compared with the other branch of its fork."""
MAX_SEARCH_MM = 25.0
"""Distance in mm from a fork up to which its ridge is searched."""
NUM_ACROSS = 41
"""Number of points on a line between two branches."""
TURN_MM = 1.0
"""Distance in mm before and behind a ridge between which its direction is measured."""
BEFORE_MM = 0.5
"""Distance in mm before a ridge at which the width of the lumen on its sides is measured."""
MAX_HALF_WIDTH_MM = 8.0
BEHIND_MM = 1.0
"""Length in mm of a plate (which extends a ridge) inside the wall behind the edge, so that plate and wall overlap."""
HALF_PLATE_MM = 0.2
"""Half of the thickness in mm of an extending plate: what the blur of a CT hides is thin."""
MAX_RIDGES = 32
"""Maximum number of ridges of a wall field; of a route with more forks, the ridges nearest to its end are used."""
HIDDEN_SHARE = 0.37
"""Length of a ridge that the CT hides in 95 % at most, as a share of the CT's coarsest spacing.

Measured at 206 forks of generated chests (benchmarks/measurements/planning.md).
"""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class ForkRidge:
    """Edge of the wall between two branches of a fork."""

    branch_ids: tuple[int, int]
    """IDs of the two branches."""
    edge_lps: Points
    """Middle (3,) of the edge, LPS mm."""
    into_parent: Points
    """Unit vector (3,) from the edge into the parent, LPS."""
    along_edge: Points
    """Unit vector (3,) along the edge, LPS."""
    half_width_mm: float
    """Half of the length of the edge, mm."""

    def plate_lps(self, longer_mm: float) -> Points:
        """Return the plate (3, 3), for `WallField.with_ridges`, that extends the ridge into the parent, LPS mm.

        Parameters
        ----------
        longer_mm
            Distance of the extended edge from the edge, mm.
        """
        end_mm = max(longer_mm - HALF_PLATE_MM, HALF_PLATE_MM - BEHIND_MM)
        half_mm = 0.5 * (end_mm + BEHIND_MM)
        middle = self.edge_lps + (end_mm - half_mm) * self.into_parent
        return np.stack([middle, half_mm * self.into_parent, self.half_width_mm * self.along_edge])


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class RouteRidges:
    """Ridges at the forks of a route, and the length of each that the blur of the CT may hide."""

    ridges: tuple[ForkRidge, ...] = ()
    """Ridges of the segmented wall, from the root of the tree."""
    hidden_mm: float = 0.0
    """Length in mm by which the true ridges may extend farther into the parents than the segmented ones."""

    def lengthened(self, wall: WallField) -> WallField:
        """Return a wall whose ridges at the forks of the route are as long as the blur of the CT may hide.

        Parameters
        ----------
        wall
            Wall of the segmented lumen, or of a measured lumen.
        """
        if not self.ridges or self.hidden_mm <= 0.0:
            return wall
        plates = np.stack([ridge.plate_lps(self.hidden_mm) for ridge in self.ridges[-MAX_RIDGES:]])
        return wall.with_ridges(plates, half_mm=HALF_PLATE_MM)


def fork_ridges(
    lineage: Sequence[Branch], branches: Sequence[Branch], wall: WallField, *, spacing_mm: float
) -> RouteRidges:
    """Return the ridges at the forks of a route, in their order; forks without a wall between branches have none.

    Parameters
    ----------
    lineage
        Branches of the route from the root.
    branches
        Branches of the whole tree.
    wall
        Wall of the segmented lumen.
    spacing_mm
        Coarsest spacing of the CT, which determines how much of a ridge its blur may hide.
    """
    by_id = {branch.id: branch for branch in branches}
    found = []
    for parent, child in itertools.pairwise(lineage):
        others = [by_id[one] for one in parent.children if one != child.id and one in by_id]
        found += [ridge for other in others if (ridge := _ridge(child, other, wall)) is not None]
    return RouteRidges(tuple(found), HIDDEN_SHARE * spacing_mm)


def _ridge(one: Branch, other: Branch, wall: WallField) -> ForkRidge | None:
    """Return the ridge between two branches of a fork; None if no wall is between them.

    Points at the same distance from the fork are joined by straight lines. The first line with a point in the wall
    crosses the ridge.
    """
    length = min(one.length_mm, other.length_mm, MAX_SEARCH_MM)
    if length < 2.0 * TURN_MM:
        return None
    at: Points = np.arange(TURN_MM, length, STEP_MM)
    a, b = point_at(one.points, at), point_at(other.points, at)
    share = np.linspace(0.0, 1.0, NUM_ACROSS)[1:-1]
    lines = a[:, None] + share[None, :, None] * (b - a)[:, None]
    depth = wall.distance_mm(lines.reshape(-1, 3)).reshape(lines.shape[:2])
    is_wall = (depth < 0.0).any(axis=1)
    if not is_wall.any():
        return None
    first = int(np.argmax(is_wall))
    edge = lines[first, int(np.argmin(depth[first]))]
    ends = at[first] + np.array([-TURN_MM, TURN_MM])
    sides = point_at(one.points, ends), point_at(other.points, ends)
    middles = 0.5 * (sides[0] + sides[1])
    into_parent, apart = middles[0] - middles[1], b[first] - a[first]
    along_edge = np.cross(into_parent, apart)
    sizes = [float(np.linalg.norm(v)) for v in (into_parent, along_edge)]
    if min(sizes) < 1e-6:
        return None
    into_parent, along_edge = into_parent / sizes[0], along_edge / sizes[1]
    return ForkRidge(
        (one.id, other.id),
        edge,
        into_parent,
        along_edge,
        _half_width_mm(wall, edge + BEFORE_MM * into_parent, along_edge),
    )


def _half_width_mm(wall: WallField, middle: Points, along: Points) -> float:
    """Return the larger distance in mm from a point to the wall in the two directions along an edge."""
    far = np.arange(0.0, MAX_HALF_WIDTH_MM, STEP_MM)
    widths = []
    for sign in (-1.0, 1.0):
        outside = np.flatnonzero(wall.distance_mm(middle + sign * far[:, None] * along) <= 0.0)
        widths.append(float(far[outside[0]]) if len(outside) else MAX_HALF_WIDTH_MM)
    return max(widths)
