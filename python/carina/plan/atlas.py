"""What of the lungs an instrument's tip and tool can get to: a map over the slices and over the tree."""

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
from carina.plan.lobes import lung_grid
from carina.plan.places import Ways
from carina.plan.route_width import matches_tree
from carina.plan.score import RANK, Judge, Outlook, ScoreWeights, bending_mm
from carina.plan.surroundings import lung_box
from carina.plan.tools import DEFAULT_TOOL, Tool
from carina.plan.tools import tool as tool_named
from carina.scopes import ScopePreset, WallField, scope_preset
from carina.track import Airways, TreeMeasures, measure_tree, wall_field
from carina.volume import Volume

__all__ = ["NOT", "REACHES", "ReachAtlas", "reach_atlas"]

Points = NDArray[np.float64]

NOT, MAY, REACHES = 0, 1, 2
"""Values of :attr:`ReachAtlas.reach_zyx`."""
STEP_MM = 2.0
"""Of the map."""
APART_MM = 2.0
"""Places on a centreline nearer to one another are one."""
MOST_ANGLE_DEG = 100.0
"""As of a route's needle."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class ReachAtlas:
    """Where one instrument with one tool gets, by width and bend of the ways; no drive is simulated for it.

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
    """(nz, ny, nx) in the lungs: 2 reaches, 1 may reach, 0 does not; what is not lung is 0."""
    lung_zyx: NDArray[np.bool_]
    lps_from_ijk: NDArray[np.float64]
    """(4, 4) of both; cubic voxels of 2 mm along LPS."""
    tip_mm: dict[int, float]
    """By branch: how far along it the tip gets, mm; 0 where it does not enter."""

    @property
    def lung_ml(self) -> float:
        """Volume of the lungs, with the vessels and airways in them."""
        return float(np.count_nonzero(self.lung_zyx)) * STEP_MM**3 / 1000.0

    @property
    def reached_ml(self) -> float:
        """Of which the tool's tip gets to."""
        return float(np.count_nonzero(self.reach_zyx == REACHES)) * STEP_MM**3 / 1000.0

    @property
    def share(self) -> float:
        """Of the lungs, 0 to 1."""
        return self.reached_ml / self.lung_ml if self.lung_ml > 0.0 else 0.0

    def at(self, point_lps: Any) -> Outlook | None:
        """Whether the tool gets to a point, LPS mm; None outside the lungs."""
        place = np.rint((np.asarray(point_lps, dtype=np.float64) - self.lps_from_ijk[:3, 3]) / STEP_MM).astype(int)
        if (place < 0).any() or (place >= np.array(self.lung_zyx.shape[::-1])).any():
            return None
        i, j, k = place
        if not self.lung_zyx[k, j, i]:
            return None
        names: dict[int, Outlook] = {NOT: "does not reach", MAY: "may reach", REACHES: "reaches"}
        return names[int(self.reach_zyx[k, j, i])]

    def to_json(self) -> dict[str, Any]:
        """Plain JSON types, without the map."""
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
    """What of the lungs an instrument and a tool get to.

    A point of the lung is reached from a place of a centreline to which the scope gets by width and bend, with the
    measures' errors, if it lies within the tool's reach and at no more than 100 degrees from the airway's axis there.

    Parameters
    ----------
    volume, airways
        The CT and its airways.
    scope, tool
        Instruments or their names in the libraries.
    wall
        The airways' wall where it is at hand; else it is made.
    measures
        The airways' measures where they are at hand; else they are made (`plan_route`).
    progress
        False, True or ``f(what, fraction)``. True, as None, shows a bar in a terminal or a notebook. The fraction is
        None where it is unknown.
    cancel
        Called often; the work stops when it returns True.

    Raises
    ------
    UsageError
        If a name is unknown.
    NoResultError
        If there is no lung in the CT.
    CancelledError
        If ``cancel()`` said so.
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
    """Note what the tool gets to from one place."""
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
