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
"""Maximum radius in mm of the widened lumen: no instrument is wider, and a wall field stores up to 4.5 mm."""
CENTRE_MM = 0.1
"""Distance in mm of the axis from a measured centre that does not count: measured centres scatter by this distance."""
MIN_RADIUS_MM = 1e-3
"""Radius in mm of the tube where there is no lumen; it must be above 0, and no instrument is thinner."""


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
    surplus_mm: Points
    """Radius of the ball less the measured radius (n,) by sections away from forks alone, mm.

    It is -`WIDE_MM` in a wide lumen, whose wall is not moved.
    """

    def widened(self, wall: WallField) -> WallField:
        """Return a wall with the measured lumen where the segmented lumen is narrower.

        Parameters
        ----------
        wall
            Wall of the segmented lumen.
        """
        return self._with_tube(wall, error_share=0.0, excess=np.zeros_like(self.ball_mm))

    def narrowest(self, wall: WallField, *, error_share: float) -> WallField:
        """Return a wall with the narrowest measured lumen within the errors.

        Where the segmented lumen is wider than that, its wall is moved inwards by the difference. In a fork the wall is
        moved as at the nearest sections, because the width of a fork is no width of the airway.

        Parameters
        ----------
        wall
            Wall of the segmented lumen.
        error_share
            Share of each diameter's error by which the measured lumen is narrower.
        """
        excess = np.maximum(self.surplus_mm + 0.5 * error_share * self.error_mm, 0.0)
        excess[self.surplus_mm <= -WIDE_MM] = 0.0
        return self._with_tube(wall, error_share=error_share, excess=excess)

    def _with_tube(self, wall: WallField, *, error_share: float, excess: Points) -> WallField:
        radius = _limited(self.axis_lps, self.ball_mm + self.lack_mm - 0.5 * error_share * self.error_mm)
        changed = np.flatnonzero((radius > self.ball_mm) | (excess > 0.0))
        if not len(changed):
            return wall
        # Each part of a tube takes time in a drive, so the tube extends only from the first to the last changed place.
        rows = slice(max(int(changed[0]) - 1, 0), int(changed[-1]) + 2)
        if rows.stop - rows.start < 2:
            return wall
        return wall.with_tube(self.axis_lps[rows], np.maximum(radius[rows], MIN_RADIUS_MM), excess_mm=excess[rows])


def measured_lumen(lineage: Sequence[Branch], wall: WallField, measures: TreeMeasures) -> MeasuredLumen | None:
    """Return the measured lumen along a route; None if the lumen is nowhere narrow or was not measured.

    Only sections away from forks widen the lumen. Elsewhere, as in a fork, the difference of measured and segmented
    radius is the smaller one of the nearest sections before and behind, and the radius is at most the smaller one of
    these sections, so that the tube does not extend into the carina. Where the lumen cannot be measured (drawn
    branches, bridges), the difference is 0.

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
    points = np.concatenate([part.middle_lps for part in parts])
    radius, error = (np.concatenate([getattr(part, name) for part in parts]) for name in ("radius_mm", "error_mm"))
    is_open, is_sound = (np.concatenate([getattr(part, name) for part in parts]) for name in ("is_open", "is_sound"))
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    near = np.abs(along[:, None] - along) <= SMOOTH_MM
    axis = (near @ points) / near.sum(axis=1, keepdims=True)
    ball = wall.ball_mm(axis)
    narrow = np.flatnonzero((ball < WIDE_MM) & (ball > 0.0))
    known = np.flatnonzero(is_open | is_sound)
    if not len(known) or not len(narrow):
        return None
    # A smoothed axis cuts the corner of a bend, where a ball on the axis has less space than one on the centre.
    off = np.maximum(np.linalg.norm(axis - points, axis=1) - CENTRE_MM, 0.0)
    measured = np.where(is_open, ball, radius - off)
    before = known[np.maximum(np.searchsorted(known, np.arange(len(axis)), side="right") - 1, 0)]
    behind = known[np.minimum(np.searchsorted(known, np.arange(len(axis))), len(known) - 1)]
    lack, most = (np.fmin(values[before], values[behind]) for values in (measured - ball, measured))
    surplus = -lack
    # A section in a fork can show that the fork is narrow, but not that it is wide.
    lack = np.fmin(lack, np.fmin(most, measured) - ball)
    error = np.fmax(error[before], error[behind])
    rows = slice(int(narrow[0]), len(axis))
    if rows.stop - rows.start < 2:
        return None
    is_narrow = np.fmax(ball, most)[rows] < WIDE_MM
    return MeasuredLumen(
        axis[rows],
        np.minimum(ball[rows], WIDE_MM),
        np.where(is_narrow, lack[rows], 0.0),
        error[rows],
        np.where(is_narrow, surplus[rows], -WIDE_MM),
    )


def _limited(axis: Points, radius: Points) -> Points:
    """Return radii limited so that no ball on the axis extends beyond the narrower lumen at another point of the axis.

    Without this limit, the balls beside a short stenosis would fill the stenosis.
    """
    apart = np.linalg.norm(axis[:, None] - axis[None], axis=2)
    limited: Points = (np.maximum(radius, 0.0) + apart).min(axis=1)
    return limited


@dataclass(frozen=True, slots=True, eq=False)
class _BranchLumen:
    """Lumen at the points of a branch; each field has one row for each point."""

    middle_lps: Points
    radius_mm: Points
    """Radius (n,) of the lumen, mm; NaN where it is unknown."""
    error_mm: Points
    """Half (n,) of the 90 % interval of the diameter, mm; NaN where it is unknown."""
    is_open: NDArray[np.bool_]
    """Flags (n,): whether the lumen could not be measured at the point, so that its width is unknown."""
    is_sound: NDArray[np.bool_]
    """Flags (n,): whether a section away from forks was measured near the point."""


def _branch_lumen(branch: Branch, wall: WallField, measured: BranchMeasures, passage: Passage) -> _BranchLumen:
    """Return the lumen at each point of a branch."""
    middle = middle_line(branch, wall)
    radius, error = np.full((2, len(middle)), np.nan)
    is_open = np.zeros(len(middle), dtype=bool)
    is_open[passage.unmeasured] = True
    error[is_open] = 0.0
    at = np.searchsorted(measured.at_mm, passage.at_mm - 1e-6)
    radius[at], error[at] = 0.5 * passage.diameter_mm, passage.error_mm
    is_sound = np.zeros(len(middle), dtype=bool)
    is_sound[at] = ~measured.at_junction[at] & np.isfinite(measured.centre_lps[at]).all(axis=1)
    # A centre behind a wall is that of a neighbouring lumen, or of both lumens beside a wall too thin to be visible.
    to_centre = np.stack([0.5 * (middle + measured.centre_lps), measured.centre_lps])[:, is_sound]
    is_sound[is_sound] = (wall.distance_mm(to_centre.reshape(-1, 3)).reshape(2, -1) > 0.0).all(axis=0)
    middle[is_sound] = measured.centre_lps[is_sound]
    return _BranchLumen(middle, radius, error, is_open, is_sound)
