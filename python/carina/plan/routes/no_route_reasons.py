"""Messages about a plan: why there is no route, which airways may lead closer, and what would help."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from carina.display import one_line
from carina.errors import UsageError
from carina.plan.instruments.tools import ONLY_BRUSH, Tool, passing_needle
from carina.plan.routes.standing_points import NearestPlace
from carina.plan.targets.grow_nodule import Nodule
from carina.scopes import ScopePreset
from carina.track import Airways
from carina.volume import Volume
from carina.volume.point_check import check_in_volume

LOST_MM = 40.0
"""Maximum distance in mm from the target at which an airway that the search lost may lead closer."""
LOST_KINDS = {"lost", "blocked", "stump", "filled", "leak", "volume"}
LOBES = {"RUL", "RML", "RLL", "LUL", "LML", "LLL"}
LUNG_HU = -860.0
NUM_SAMPLES = 400


@one_line
@dataclass(frozen=True, slots=True)
class LostAirway:
    """Point near a target at which the search lost an airway that may lead to the target."""

    gap_mm: float
    """Distance in mm from the point to the target's edge."""
    reason: str
    """Reason why the search ended at the point."""

    @property
    def words(self) -> str:
        """Lost airway as text, such as *the tree is lost 16 mm short of the target: lost here, 3.3 mm wide*."""
        return f"{self.short_words}: {self.reason}"

    @property
    def short_words(self) -> str:
        """Lost airway as text without the reason."""
        if self.gap_mm < 0.5:
            return "the tree is lost at the target"
        return f"the tree is lost {self.gap_mm:.0f} mm short of the target"

    def to_json(self) -> dict[str, Any]:
        """Return the lost airway as plain JSON types."""
        return {"gap_mm": self.gap_mm, "reason": self.reason, "words": self.words}


def check_target(volume: Volume, airways: Airways, nodule: Nodule) -> None:
    """Raise an error if airways or target belong to another CT.

    Parameters
    ----------
    volume, airways, nodule
        The CT, the airways, and the nodule of the target.

    Raises
    ------
    UsageError
        If the airways have another grid (code ``plan.airways``), or the target is outside the CT (``plan.target``).
    """
    if airways.lumen_zyx.shape != volume.shape_zyx:
        raise UsageError(
            f"plan: the airways belong to another CT: their grid is {airways.lumen_zyx.shape}, this CT's is "
            f"{volume.shape_zyx}; find the airways in this CT",
            code="plan.airways",
        )
    check_in_volume(volume, nodule.centre_lps, "plan: the centre of the target", code="plan.target")


def notes_of_target(volume: Volume, airways: Airways, nodule: Nodule, nearest: NearestPlace | None) -> tuple[str, ...]:
    """Return notes on a target and the airways near it; they apply whether or not there is a route.

    Parameters
    ----------
    volume, airways, nodule
        The CT, the airways, and the nodule of the target.
    nearest
        Place in the airways nearest to the target; None if there is none.
    """
    found = []
    shown_hu = _mean_hu(volume, nodule)
    if shown_hu is not None and shown_hu < 0.5 * (LUNG_HU + nodule.density_hu):
        found.append(
            f"the CT shows no nodule where the target lies ({shown_hu:.0f} HU; the target was {nodule.density_hu:.0f} "
            "HU): check that it was marked in this CT"
        )
    if "edge of the CT" in nodule.touches:
        found.append("the CT ends within the target: the size of the target and what lies beyond it are not known")
    lost = lost_airway(airways, nodule, nearest)
    if lost is not None:
        found.append(lost.words)
    found += _absent_lobes(airways, nodule)
    return tuple(found)


def notes_of_tools(scope: ScopePreset, tool: Tool) -> tuple[str, ...]:
    """Return a note if a tool does not pass the working channel of a scope, or if this is unknown."""
    if scope.channel_mm is None:
        return (f"the working channel of {scope.title} is not known: it cannot be said which tools pass",)
    if tool.passes(scope.channel_mm):
        return ()
    text = (
        f"{tool.title} ({tool.outer_mm:g} mm) does not fit the working channel of {scope.title} "
        f"({scope.channel_mm:g} mm)"
    )
    if not tool.pierces:
        return (text,)
    other = passing_needle(scope, tool)
    return (f"{text}; {ONLY_BRUSH}" if other is None else f"{text}; choose {other.title}",)


def why_none(airways: Airways, nodule: Nodule, nearest: NearestPlace | None, tool: Tool) -> str:
    """Return why there is no route, and what would help, as text.

    Parameters
    ----------
    airways, nodule, tool
        The airways, the nodule of the target, and the tool.
    nearest
        Place in the airways nearest to the target; None if there is none.
    """
    if nearest is None or len(airways.tree.branches) < 2:
        return "no route: the airway tree has no branches; find the airways first"
    place = f"{nearest.branch_name}, {nearest.gap_mm:.0f} mm from the nodule"
    add = "If the CT shows a closer airway, add it to the tree and plan again; "
    if lost_airway(airways, nodule, nearest) is not None or _absent_lobes(airways, nodule):
        add = "Check where the airway was lost, extend or bridge it if the CT allows, and plan again; "
    if not tool.pierces:
        return (
            f"no route: {tool.title} stays in the lumen, and no airway found leads straight to the nodule; the nearest "
            f"is {place}. Choose a needle, which passes through the airway wall. {add}otherwise consider another access"
        )
    if nearest.gap_mm > tool.reach_mm:
        return (
            f"no route: the nearest airway found is {place}; {tool.title} reaches {tool.reach_mm:.0f} mm. {add}"
            "otherwise consider a longer needle or percutaneous access"
        )
    return (
        f"no route: {nearest.branch_name} passes {nearest.gap_mm:.0f} mm from the nodule, but a needle cannot be "
        "advanced forwards into the nodule from any point along it; consider another access"
    )


def lost_airway(airways: Airways, nodule: Nodule, nearest: NearestPlace | None) -> LostAirway | None:
    """Return the point nearest to a target at which the search lost an airway, or None.

    The result is None if another airway comes more than 10 mm closer to the target, or if the point is too far away.

    Parameters
    ----------
    airways, nodule
        The airways, and the nodule of the target.
    nearest
        Place in the airways nearest to the target; None if there is none.
    """
    lost = [one for one in airways.uncertain if one.kind in LOST_KINDS and one.branch_id is not None]
    if not lost:
        return None
    gaps = nodule.distance_mm(np.array([one.lps for one in lost]))
    n = int(np.argmin(gaps))
    # A lost airway does not matter if another airway comes more than 10 mm closer.
    if gaps[n] > LOST_MM or (nearest is not None and gaps[n] > nearest.gap_mm + 10.0):
        return None
    return LostAirway(max(float(gaps[n]), 0.0), lost[n].reason)


def _absent_lobes(airways: Airways, nodule: Nodule) -> list[str]:
    """Return notes on the lobes of the target's side in which the search found no bronchus."""
    is_left = nodule.centre_lps[0] > float(airways.tree.root.points[-1][0])
    return [
        absence.words
        for absence in airways.absent
        if absence.name in LOBES and absence.name.startswith("L" if is_left else "R")
    ]


def _mean_hu(volume: Volume, nodule: Nodule) -> float | None:
    """Return the mean density in HU of the CT in the target; None if the target covers no voxel."""
    kji = np.argwhere(nodule.inside_zyx)
    kji = kji[:: max(len(kji) // NUM_SAMPLES, 1)]
    points = kji[:, ::-1] @ nodule.lps_from_ijk[:3, :3].T + nodule.lps_from_ijk[:3, 3]
    ijk = np.rint(volume.to_ijk(points)).astype(int)
    there = ((ijk >= 0) & (ijk < np.array(volume.shape_zyx[::-1]))).all(axis=1)
    i, j, k = ijk[there].T
    return float(volume.hu_zyx[k, j, i].mean()) if there.any() else None
