"""Reach atlas: the parts of the lungs in which one instrument with one tool reaches a target.

Each voxel is judged as a draft of `carina.plan.routes` judges a target: by width, bends and doubts of the airways, the
directions that the scope can take at each place, the share of needles that hit, and the tool's reach.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.display.progress import ProgressChoice, fraction_callback, progress_function, shows_progress
from carina.errors import CancelledError, UsageError, check_type
from carina.plan.instruments.tools import DEFAULT_TOOL, Tool
from carina.plan.instruments.tools import tool as tool_named
from carina.plan.lungs.lobes import lung_grid
from carina.plan.lungs.tissue_near_needle import lung_box
from carina.plan.routes.attainable_directions import StandingPlace, TipDirections
from carina.plan.routes.last_leg import OPEN_MM
from carina.plan.routes.needle_hits import NeedleErrors, ball_hit_shares, fibonacci_sphere
from carina.plan.routes.plan_route import MAX_ANGLE_DEG
from carina.plan.routes.ranking import (
    OUTLOOKS,
    RANK,
    Judge,
    Outlook,
    ScoreWeights,
    bending_mm,
    depth_rank,
    pointing_rank,
)
from carina.plan.routes.route_width import measures_of
from carina.plan.routes.standing_points import CentrelinePoints
from carina.scopes import ScopePreset, WallField, scope_preset
from carina.track import Airways, TreeMeasures, wall_field
from carina.volume import Volume

Points = NDArray[np.float64]

NOT, MAY, REACHES = 0, 1, 2
"""Values of :attr:`ReachAtlas.reach_zyx`: 0 does not reach, 1 may reach, 2 reaches."""
STEP_MM = 2.0
"""Voxel size of the map in mm, on each axis."""
APART_MM = 2.0
"""Minimum distance in mm between the centreline points of one branch from which the tool's reach is computed."""
TARGET_MM = 10.0
"""Diameter in mm of the ball that represents a target at each voxel."""
NUM_WAYS = 300
"""Number of directions of the tip, evenly spread on the sphere, that are tested at each position of the atlas."""
TABLE_STEP_MM, TABLE_STEP_DEG, TABLE_MAX_DEG = 0.5, 1.0, 60.0
"""Steps of the table of hit shares, and its largest angle; beyond that angle no needle hits."""
NUM_ON_LINE = 12
SIDE_DEG = 35.0
"""Maximum angle in degrees, round the airway's axis, between the tip's side and the target's side."""
MARGIN_DEG = 30.0
"""Angle in degrees by which a needle's direction may exceed that of the target's centre, from the airway's axis."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class ReachAtlas:
    """Parts of the lungs that one instrument with one tool reaches.

    A voxel is reached if a plan without drives (``carina.plan_route(..., drives=0)``) of a ball of 10 mm at the voxel
    has the outlook *reaches*. No drive of the scope is simulated, so a plan of a target there may have a worse outlook.

    Examples
    --------
    >>> import carina
    >>> made = carina.generate_phantom(seed=4, spacing_mm=1.5, generations=4)
    >>> found = carina.find_airways(made.volume)
    >>> thin, thick = (reach_atlas(made.volume, found, scope=name) for name in ("thin", "therapeutic"))
    >>> thin.share > thick.share
    True
    """

    scope: ScopePreset
    tool: Tool
    reach_zyx: NDArray[np.uint8]
    """Map of shape (nz, ny, nx): 2 (reaches), 1 (may reach) or 0 (does not reach). Voxels outside the lungs are 0."""
    lung_zyx: NDArray[np.bool_]
    lps_from_ijk: NDArray[np.float64]
    """(4, 4) transform from voxel indices of both arrays to LPS mm; the voxels are 2 mm cubes along LPS."""
    tip_mm: dict[int, float]
    """Distance in mm that the scope's tip advances into each branch, by branch ID.

    0 if the tip does not enter the branch.
    """
    why: str | None = None
    """Reason why the tool reaches nothing, such as a channel that is too thin; None if the tool passes the channel."""
    target_mm: float = TARGET_MM
    """Diameter in mm of the ball that represents a target at each voxel."""

    @property
    def lung_ml(self) -> float:
        """Volume of the lungs in ml, including the vessels and airways in them."""
        return float(np.count_nonzero(self.lung_zyx)) * STEP_MM**3 / 1000.0

    @property
    def reached_ml(self) -> float:
        """Volume of lung in ml in which a target is reached."""
        return float(np.count_nonzero(self.reach_zyx == REACHES)) * STEP_MM**3 / 1000.0

    @property
    def share(self) -> float:
        """Reached volume divided by the volume of the lungs, 0 to 1; 0 if the lungs have no volume."""
        return self.reached_ml / self.lung_ml if self.lung_ml > 0.0 else 0.0

    def at(self, point_lps: Any) -> Outlook | None:
        """Return whether a target at a point in LPS mm is reached; None if the point is outside the lungs."""
        place = np.rint((np.asarray(point_lps, dtype=np.float64) - self.lps_from_ijk[:3, 3]) / STEP_MM).astype(int)
        if (place < 0).any() or (place >= np.array(self.lung_zyx.shape[::-1])).any():
            return None
        i, j, k = place
        if not self.lung_zyx[k, j, i]:
            return None
        return OUTLOOKS[REACHES - int(self.reach_zyx[k, j, i])]

    def to_json(self) -> dict[str, Any]:
        """Return the atlas as plain JSON types, without the map."""
        return {
            "scope": self.scope.name,
            "tool": self.tool.name,
            "lung_ml": self.lung_ml,
            "reached_ml": self.reached_ml,
            "tip_mm": {str(branch): mm for branch, mm in self.tip_mm.items()},
            "target_mm": self.target_mm,
            "why": self.why,
        }


@shows_progress
def reach_atlas(
    volume: Volume,
    airways: Airways,
    *,
    scope: ScopePreset | str = "thin",
    tool: Tool | str = DEFAULT_TOOL,
    wall: WallField | None = None,
    measures: TreeMeasures | None = None,
    progress: ProgressChoice = None,
    cancel: Callable[[], bool] | None = None,
) -> ReachAtlas:
    """Compute the parts of the lungs in which an instrument and a tool reach a target.

    A lung voxel is reached if the scope gets to a place from which at least half of the needle passes hit a ball of
    10 mm at the voxel, in a direction that the scope can take there, with default errors of the needle
    (`NeedleErrors`). Whether the scope gets there is judged by the widths and bends of the airways and by the errors of
    these measures.

    Parameters
    ----------
    volume, airways
        The CT and its airways.
    scope, tool
        Instruments, or their names in the libraries.
    wall
        Wall of the airways; computed if None.
    measures
        Measures of the airways (see `plan_route`); computed if None or if they belong to another tree.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is None while the progress is unknown.
    cancel
        Called often; the work stops when it returns True.

    Returns
    -------
    ReachAtlas
        Map of the lungs on 2 mm voxels and the reach of the tip in each branch.

    Raises
    ------
    UsageError
        If a name is unknown or the tool's reach is not finite.
    NoResultError
        If there is no lung in the CT.
    CancelledError
        If ``cancel()`` returned True.
    """
    check_type("reach_atlas", "volume", volume, Volume, "open a volume with carina.open_volume")
    check_type("reach_atlas", "airways", airways, Airways, "get airways from carina.find_airways")
    preset = scope_preset(scope) if isinstance(scope, str) else scope
    used = tool_named(tool) if isinstance(tool, str) else tool

    on_progress = fraction_callback(progress_function(progress), "going through all airways")

    def report(fraction: float) -> None:
        if cancel is not None and cancel():
            raise CancelledError("the atlas was cancelled")
        if on_progress is not None:
            on_progress(fraction)

    report(0.0)
    if not math.isfinite(used.reach_mm):
        raise UsageError(f"{used.title}: expected a reach in mm; found {used.reach_mm}", code="plan.tool")
    wall = wall_field(volume, airways, cancel=cancel) if wall is None else wall
    report(0.2)
    box = lung_box(volume)
    lung = np.ascontiguousarray(lung_grid(box)[0])
    matrix = np.array(box.lps_from_ijk, dtype=np.float64)
    matrix[:3, :3] *= STEP_MM / box.step_mm
    report(0.4)
    measures = measures_of(volume, airways, measures, cancel=cancel)
    centreline = CentrelinePoints(airways.tree, wall, measures=measures, spacing_mm=max(volume.spacing_mm))
    judge = Judge(preset, 0.0, ScoreWeights(), used.reach_mm, used)
    why = judge.channel_limit()
    section_mm = bending_mm(preset)
    # A tool that does not pierce needs a target in a lumen or against it.
    allowed = lung if used.pierces else lung & _beside_lumen(lung.shape, matrix, centreline)
    marks = _Marks(allowed, matrix, wall, used, TipDirections(airways.tree, wall, preset))
    tip_mm: dict[int, float] = {branch.id: 0.0 for branch in airways.tree.branches}
    starts = {int(b): float(centreline.along_mm[centreline.branch == b].min()) for b in np.unique(centreline.branch)}
    last: tuple[int, float] | None = None
    for n in range(len(centreline.points)):
        branch_id, along_mm = int(centreline.branch[n]), float(centreline.along_mm[n])
        outlook, _, _ = judge.outlook(centreline.requirements_at(n, section_mm))
        if RANK[outlook] == RANK["does not reach"]:
            continue
        tip_mm[branch_id] = max(tip_mm[branch_id], along_mm - starts[branch_id])
        if why is not None or (last is not None and last[0] == branch_id and along_mm - last[1] < APART_MM):
            continue
        last = branch_id, along_mm
        report(0.4 + 0.6 * n / len(centreline.points))
        marks.add(StandingPlace(branch_id, along_mm, centreline.points[n], centreline.forward[n]), RANK[outlook])
    report(1.0)
    return ReachAtlas(preset, used, marks.reach_zyx, lung, matrix, tip_mm, why)


class _Marks:
    """Voxels at which a target is reached, from the places that were added so far.

    Parameters
    ----------
    lung_zyx, lps_from_ijk
        Voxels that may be marked, and the geometry of the map.
    wall, tool, directions
        Wall of the airways, tool, and attainable directions of the scope.
    """

    def __init__(
        self,
        lung_zyx: NDArray[np.bool_],
        lps_from_ijk: Points,
        wall: WallField,
        tool: Tool,
        directions: TipDirections,
    ) -> None:
        self.reach_zyx = np.zeros(lung_zyx.shape, dtype=np.uint8)
        self._lung_zyx, self._first_lps = lung_zyx, lps_from_ijk[:3, 3]
        self._wall, self._tool, self._directions = wall, tool, directions
        self._radius_mm = 0.5 * TARGET_MM
        self._most_mm = tool.reach_mm + self._radius_mm
        self._sphere = fibonacci_sphere(NUM_WAYS)
        distances = np.arange(0.0, self._most_mm + TABLE_STEP_MM, TABLE_STEP_MM)
        angles = np.radians(np.arange(0.0, TABLE_MAX_DEG + TABLE_STEP_DEG, TABLE_STEP_DEG))
        mm, rad = (grid.ravel() for grid in np.meshgrid(distances, angles, indexing="ij"))
        shares = ball_hit_shares(mm, rad, self._radius_mm, tool.reach_mm, NeedleErrors())
        self._shares = shares.reshape(len(distances), len(angles))

    def add(self, place: StandingPlace, rank: int) -> None:
        """Mark the voxels whose targets the scope reaches from a standing place.

        Parameters
        ----------
        place
            Place of the tip.
        rank
            Rank of the outlook of the way to the place.
        """
        voxels, centres = self._near(place.point_lps, place.forward, REACHES - rank)
        if not self._directions.is_known:
            self._mark(voxels, centres, place.point_lps, None, rank)
            return
        limit = math.cos(math.radians(min(MAX_ANGLE_DEG + MARGIN_DEG, 180.0)))
        directions = self._sphere[self._sphere @ place.forward >= limit]
        for tip, attained in self._directions.around(place, directions):
            # Voxels with an equal or better value from an earlier tip are not tested again.
            left = self.reach_zyx[voxels[:, 2], voxels[:, 1], voxels[:, 0]] < REACHES - rank
            voxels, centres = voxels[left], centres[left]
            if not len(voxels):
                return
            if attained.any():
                # Only targets on the tip's side of the airway count: a plan places the tip on the target's side.
                near = _on_side(centres - place.point_lps, tip - place.point_lps, place.forward)
                self._mark(voxels[near], centres[near], tip, directions[attained], rank)

    def _near(self, place: Points, forward: Points, value: int) -> tuple[NDArray[np.int64], Points]:
        """Return the lung voxels with a value below ``value`` that may be centres of targets within reach.

        The result is their indices (n, 3) and their centres (n, 3), LPS mm.
        """
        middle = (place - self._first_lps) / STEP_MM
        half = self._most_mm / STEP_MM
        size = np.array(self.reach_zyx.shape[::-1])
        low = np.clip(np.floor(middle - half).astype(int), 0, size)
        high = np.clip(np.ceil(middle + half).astype(int) + 1, 0, size)
        here = (slice(low[2], high[2]), slice(low[1], high[1]), slice(low[0], high[0]))
        open_zyx = self._lung_zyx[here] & (self.reach_zyx[here] < value)
        voxels = np.argwhere(open_zyx)[:, ::-1] + low
        centres = self._first_lps + STEP_MM * voxels
        off = centres - place
        away = np.linalg.norm(off, axis=1)
        near = (away <= self._most_mm) & (
            (off @ forward >= away * math.cos(math.radians(MAX_ANGLE_DEG))) | (away <= self._radius_mm)
        )
        return voxels[near], centres[near]

    def _mark(
        self, voxels: NDArray[np.int64], centres: Points, tip: Points, directions: Points | None, rank: int
    ) -> None:
        """Mark the voxels that are reached from a tip by needles in the given directions, or in any direction."""
        off = centres - tip
        away = np.linalg.norm(off, axis=1)
        towards = off / np.maximum(away, 1e-9)[:, None]
        needle, cosine = towards, np.ones(len(off))
        if directions is not None:
            cosines = towards @ directions.T
            nearest = cosines.argmax(axis=1)
            needle, cosine = directions[nearest], np.clip(cosines[np.arange(len(off)), nearest], -1.0, 1.0)
        row = np.minimum(np.rint(away / TABLE_STEP_MM).astype(int), self._shares.shape[0] - 1)
        column = np.rint(np.degrees(np.arccos(cosine)) / TABLE_STEP_DEG).astype(int)
        share = np.where(
            column < self._shares.shape[1], self._shares[row, np.minimum(column, self._shares.shape[1] - 1)], 0.0
        )
        share[away <= self._radius_mm] = 1.0
        beside2 = self._radius_mm**2 - away**2 * (1.0 - cosine**2)
        edge_mm = np.maximum(away * cosine - np.sqrt(np.maximum(beside2, 0.0)), 0.0)
        ranks = np.maximum(pointing_rank(share), depth_rank(self._tool.reach_mm - edge_mm))
        if not self._tool.pierces:
            hits = np.flatnonzero(ranks < RANK["does not reach"])
            if hits.size:
                shut = hits[~self._is_open(tip, needle[hits], edge_mm[hits])]
                ranks[shut] = RANK["does not reach"]
        values = (REACHES - np.maximum(ranks, rank)).astype(np.uint8)
        i, j, k = voxels.T
        self.reach_zyx[k, j, i] = np.maximum(self.reach_zyx[k, j, i], values)

    def _is_open(self, tip: Points, needle: Points, edge_mm: Points) -> NDArray[np.bool_]:
        """Return for each needle whether the lumen extends to the edge of its target."""
        at = np.linspace(0.0, 1.0, NUM_ON_LINE)[None, :] * np.maximum(edge_mm - OPEN_MM, 0.0)[:, None]
        line = tip + at[:, :, None] * needle[:, None, :]
        found: NDArray[np.bool_] = (
            self._wall.distance_mm(line.reshape(-1, 3)).reshape(len(edge_mm), -1).min(axis=1) > 0.0
        )
        return found


def _on_side(off: Points, side: Points, forward: Points) -> NDArray[np.bool_]:
    """Return whether targets (n, 3) are on a tip's side of the airway; both are offsets from a place in mm."""
    length = float(np.linalg.norm(side))
    if length < 1e-6:
        return np.ones(len(off), dtype=bool)
    across = off - (off @ forward)[:, None] * forward
    found: NDArray[np.bool_] = across @ side >= math.cos(math.radians(SIDE_DEG)) * length * np.linalg.norm(
        across, axis=1
    )
    return found


def _beside_lumen(shape_zyx: tuple[int, ...], lps_from_ijk: Points, centreline: CentrelinePoints) -> NDArray[np.bool_]:
    """Return the voxels at which a target may touch a lumen."""
    found = np.zeros(shape_zyx, dtype=bool)
    size = np.array(shape_zyx[::-1])
    for point, radius in zip(centreline.points, centreline.radius, strict=True):
        middle = (point - lps_from_ijk[:3, 3]) / STEP_MM
        half = (float(radius) + 0.5 * TARGET_MM + OPEN_MM) / STEP_MM
        low = np.clip(np.floor(middle - half).astype(int), 0, size)
        high = np.clip(np.ceil(middle + half).astype(int) + 1, 0, size)
        x, y, z = (np.arange(a, b) - m for a, b, m in zip(low, high, middle, strict=True))
        off2 = z[:, None, None] ** 2 + y[None, :, None] ** 2 + x[None, None, :] ** 2
        found[low[2] : high[2], low[1] : high[1], low[0] : high[0]] |= off2 <= half**2
    return found
