"""Reach atlas: the parts of the lungs that the tip and the tool of one instrument reach."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.display.progress import ProgressChoice, progress_function, share_function, shows_progress
from carina.errors import CancelledError, UsageError, check_type
from carina.plan.instruments.tools import DEFAULT_TOOL, Tool
from carina.plan.instruments.tools import tool as tool_named
from carina.plan.lungs.lobes import lung_grid
from carina.plan.lungs.tissue_near_needle import lung_box
from carina.plan.routes.ranking import RANK, Judge, Outlook, ScoreWeights, bending_mm
from carina.plan.routes.route_width import matches_tree
from carina.plan.routes.standing_points import Ways
from carina.scopes import ScopePreset, WallField, scope_preset
from carina.track import Airways, TreeMeasures, measure_tree, wall_field
from carina.volume import Volume

__all__ = ["NOT", "REACHES", "ReachAtlas", "reach_atlas"]

Points = NDArray[np.float64]

NOT, MAY, REACHES = 0, 1, 2
"""Values of :attr:`ReachAtlas.reach_zyx`: does not reach, may reach, reaches."""
STEP_MM = 2.0
"""Voxel size of the map in mm, on each axis."""
APART_MM = 2.0
"""Least distance in mm between the centreline points of one branch from which the tool's reach is computed."""
MOST_ANGLE_DEG = 100.0
"""Largest angle in degrees between the airway's axis and the direction of the tool, the same limit as for a needle."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class ReachAtlas:
    """Parts of the lungs that one instrument with one tool reaches.

    The reach follows from the widths and bends of the airways alone; no drive of the scope is simulated.

    Examples
    --------
    >>> import carina
    >>> made = carina.generate_phantom(seed=4, spacing_mm=1.5, generations=4)
    >>> found = carina.find_airways(made.volume)
    >>> thin, thick = (reach_atlas(made.volume, found, scope=name) for name in ("ultrathin", "therapeutic"))
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

    @property
    def lung_ml(self) -> float:
        """Volume of the lungs in ml, including the vessels and airways in them."""
        return float(np.count_nonzero(self.lung_zyx)) * STEP_MM**3 / 1000.0

    @property
    def reached_ml(self) -> float:
        """Volume of lung in ml that the tip of the tool reaches."""
        return float(np.count_nonzero(self.reach_zyx == REACHES)) * STEP_MM**3 / 1000.0

    @property
    def share(self) -> float:
        """Reached volume divided by the volume of the lungs, 0 to 1; 0 if the lungs have no volume."""
        return self.reached_ml / self.lung_ml if self.lung_ml > 0.0 else 0.0

    def at(self, point_lps: Any) -> Outlook | None:
        """Return whether the tool reaches a point in LPS mm; None if the point is outside the lungs."""
        place = np.rint((np.asarray(point_lps, dtype=np.float64) - self.lps_from_ijk[:3, 3]) / STEP_MM).astype(int)
        if (place < 0).any() or (place >= np.array(self.lung_zyx.shape[::-1])).any():
            return None
        i, j, k = place
        if not self.lung_zyx[k, j, i]:
            return None
        names: dict[int, Outlook] = {NOT: "does not reach", MAY: "may reach", REACHES: "reaches"}
        return names[int(self.reach_zyx[k, j, i])]

    def to_json(self) -> dict[str, Any]:
        """Return the atlas as plain JSON types, without the map."""
        return {
            "scope": self.scope.name,
            "tool": self.tool.name,
            "lung_ml": self.lung_ml,
            "reached_ml": self.reached_ml,
            "tip_mm": {str(branch): mm for branch, mm in self.tip_mm.items()},
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
    """Compute the parts of the lungs that an instrument and a tool reach.

    A lung voxel is reached if the scope gets to a centreline point from which the voxel is within the tool's reach
    and at no more than 100 degrees from the airway's axis. Whether the scope gets there is judged by the widths and
    bends of the airways and by the errors of these measures.

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
        False, True or ``f(what, fraction)``. True, as None, shows a bar in a terminal or a notebook. The fraction is
        None where it is unknown.
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

    on_share = share_function(progress_function(progress), "going through all airways")

    def say(share: float) -> None:
        if cancel is not None and cancel():
            raise CancelledError("the atlas was cancelled")
        if on_share is not None:
            on_share(share)

    say(0.0)
    if not math.isfinite(used.reach_mm):
        raise UsageError(f"{used.title}: expected a reach in mm; found {used.reach_mm}", code="plan.tool")
    wall = wall_field(volume, airways, cancel=cancel) if wall is None else wall
    say(0.2)
    box = lung_box(volume)
    lung = np.ascontiguousarray(lung_grid(box)[0])
    matrix = np.array(box.lps_from_ijk, dtype=np.float64)
    matrix[:3, :3] *= STEP_MM / box.step_mm
    say(0.4)
    if measures is None or not matches_tree(measures, airways.tree):
        measures = measure_tree(volume, airways, cancel=cancel)
    ways = Ways(airways.tree, wall, measures=measures, spacing_mm=max(volume.spacing_mm))
    judge = Judge(preset, 0.0, ScoreWeights(), used.reach_mm)
    section_mm = bending_mm(preset)
    reach = np.zeros(lung.shape, dtype=np.uint8)
    tip_mm: dict[int, float] = {branch.id: 0.0 for branch in airways.tree.branches}
    starts = {int(b): float(ways.along_mm[ways.branch == b].min()) for b in np.unique(ways.branch)}
    last: tuple[int, float] | None = None
    for n in range(len(ways.points)):
        branch_id, along_mm = int(ways.branch[n]), float(ways.along_mm[n])
        outlook, _, _ = judge.outlook(ways.asks(n, section_mm))
        if RANK[outlook] == RANK["does not reach"]:
            continue
        tip_mm[branch_id] = max(tip_mm[branch_id], along_mm - starts[branch_id])
        if last is not None and last[0] == branch_id and along_mm - last[1] < APART_MM:
            continue
        last = branch_id, along_mm
        value = REACHES if outlook == "reaches" else MAY
        _reach_from(reach, lung, matrix, ways.points[n], ways.forward[n], reach_mm=used.reach_mm, value=value)
        if n % 64 == 0:
            say(0.4 + 0.6 * n / len(ways.points))
    say(1.0)
    return ReachAtlas(preset, used, reach, lung, matrix, tip_mm)


def _reach_from(
    reach: NDArray[np.uint8],
    lung: NDArray[np.bool_],
    matrix: Points,
    place: Points,
    forward: Points,
    *,
    reach_mm: float,
    value: int,
) -> None:
    """Mark the lung voxels that the tool reaches from one centreline point, in place."""
    middle = (place - matrix[:3, 3]) / STEP_MM
    half = reach_mm / STEP_MM
    size = np.array(reach.shape[::-1])
    low = np.clip(np.floor(middle - half).astype(int), 0, size)
    high = np.clip(np.ceil(middle + half).astype(int) + 1, 0, size)
    if (low >= high).any():
        return
    x, y, z = (STEP_MM * (np.arange(a, b) - m) for a, b, m in zip(low, high, middle, strict=True))
    away = np.sqrt(z[:, None, None] ** 2 + y[None, :, None] ** 2 + x[None, None, :] ** 2)
    ahead = z[:, None, None] * forward[2] + y[None, :, None] * forward[1] + x[None, None, :] * forward[0]
    near = (away <= reach_mm) & (ahead >= away * math.cos(math.radians(MOST_ANGLE_DEG)))
    here = (slice(low[2], high[2]), slice(low[1], high[1]), slice(low[0], high[0]))
    reach[here] = np.maximum(reach[here], np.where(near & lung[here], value, NOT).astype(np.uint8))
