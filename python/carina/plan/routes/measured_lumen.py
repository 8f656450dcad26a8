"""Lumen of a route as wide as the measured diameters, for simulated drives (docs/decisions/0142).

The wall of a lumen is a mesh of the segmented voxels. In a narrow airway it is narrower than the airway that was
measured (docs/decisions/0130), and a field of samples cuts off its middle line too. A tube with the measured diameters
is therefore added to the lumen, so that an instrument is driven with its own width.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.plan.routes.clearance import middle_line
from carina.scopes import WallField
from carina.track import Branch, BranchMeasures, TreeMeasures
from carina.track.measures.diameter import Passage

Points = NDArray[np.float64]

SMOOTH_MM = 1.5
"""Half the length in mm over which the axis of the lumen is averaged: measured centres scatter by some 0.1 mm."""
WIDE_MM = 4.2
"""Radius in mm up to which the lumen is widened; a wall field stores no larger distances than 4.5 mm."""
MIN_RADIUS_MM = 0.1


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class MeasuredLumen:
    """Axis of the lumen along a route, and by how much the measured lumen is wider than the segmented one."""

    axis_lps: Points
    """Points (n, 3) of the axis, LPS mm, from the place at which the lumen becomes narrow."""
    ball_mm: Points
    """Radius (n,) of the largest ball on the axis in the segmented lumen, mm."""
    lack_mm: Points
    """Measured radius less the radius of the ball (n,), mm; negative where the segmented lumen is wider."""
    error_mm: Points
    """Half (n,) of the interval in mm that contains the true diameter with 90 % probability."""

    def widened(self, wall: WallField, *, error_share: float = 0.0) -> WallField:
        """Return a wall with the measured lumen.

        Parameters
        ----------
        wall
            Wall of the segmented lumen.
        error_share
            Share of each diameter's error by which the measured lumen is narrower.
        """
        more = self.lack_mm - 0.5 * error_share * self.error_mm
        if not (more > 0.0).any():
            return wall
        return wall.with_tube(self.axis_lps, np.maximum(self.ball_mm + more, MIN_RADIUS_MM))


def measured_lumen(lineage: Sequence[Branch], wall: WallField, measures: TreeMeasures) -> MeasuredLumen | None:
    """Return the measured lumen along a route; None if the lumen is nowhere narrow or was not measured.

    Between two measured places, as at the start of a branch, the difference of measured and segmented radius is
    interpolated. Where the lumen cannot be measured (drawn branches, bridges), the difference is 0.

    Parameters
    ----------
    lineage
        Branches of the route from the root.
    wall
        Wall of the segmented lumen.
    measures
        Measures of the tree.
    """
    parts = [_branch_lumen(branch, wall, measures.of(branch.id), measures.passage(branch.id)) for branch in lineage]
    points = np.concatenate([part[0] for part in parts])
    radius, error, is_open = (np.concatenate([part[n] for part in parts]) for n in (1, 2, 3))
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    near = np.abs(along[:, None] - along) <= SMOOTH_MM
    axis = (near @ points) / near.sum(axis=1, keepdims=True)
    ball = wall.ball_mm(axis)
    lack = np.where(is_open, 0.0, radius - ball)
    known = np.flatnonzero(np.isfinite(lack))
    narrow = np.flatnonzero((ball < WIDE_MM) & (ball > 0.0))
    if not len(known) or not len(narrow):
        return None
    lack, error = (np.interp(along, along[known], values[known]) for values in (lack, error))
    own = slice(int(narrow[0]), len(axis))
    if own.stop - own.start < 2:
        return None
    wide = np.minimum(ball[own], WIDE_MM)
    return MeasuredLumen(axis[own], wide, np.where(ball[own] < WIDE_MM, lack[own], 0.0), error[own])


def _branch_lumen(
    branch: Branch, wall: WallField, measured: BranchMeasures, passage: Passage
) -> tuple[Points, Points, Points, NDArray[np.bool_]]:
    """Return for each point of a branch: middle of the lumen, radius and error (NaN if unknown), whether unmeasured."""
    middle = middle_line(branch, wall)
    radius, error = np.full((2, len(middle)), np.nan)
    is_open = np.zeros(len(middle), dtype=bool)
    is_open[passage.unmeasured] = True
    error[is_open] = 0.0
    at = np.searchsorted(measured.at_mm, passage.at_mm - 1e-6)
    radius[at], error[at] = 0.5 * passage.diameter_mm, passage.error_mm
    own = at[~measured.at_junction[at] & np.isfinite(measured.centre_lps[at]).all(axis=1)]
    middle[own] = measured.centre_lps[own]
    return middle, radius, error, is_open
