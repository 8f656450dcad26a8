"""The user's decisions about a case as one immutable value; undo selects an earlier value."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from carina.commands import KeyFrameFlying
from carina.commands.look import Look
from carina.commands.plan import PlanOptions
from carina.commands.tree import PathCost
from carina.display import one_line
from carina.scopes import Pose

if TYPE_CHECKING:
    from carina.case.routes import ChosenRoute
    from carina.plan import Nodule, PlanTarget
    from carina.render import TransferFunction
    from carina.track import Airways

Point = tuple[float, float, float]


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Lesion:
    """The lesion of a target, with the options for planning a route to it."""

    target: PlanTarget
    """The planned target, with the name, note and priority of the target to which it belongs."""
    options: PlanOptions = field(default_factory=PlanOptions)

    @property
    def nodule(self) -> Nodule:
        """Shape and position of the lesion that the plan aims at."""
        return self.target.nodule


@one_line
@dataclass(frozen=True, slots=True)
class Target:
    """A point to navigate to: the requested point, the point where the path ends, and the path's properties.

    Points are LPS, in mm.
    """

    target_id: str
    name: str
    lps: Point
    used_lps: Point | None = None
    """End of the path, LPS in mm: the requested point, or the nearest lumen voxel within 5 mm."""
    snapped_mm: float | None = None
    length_mm: float | None = None
    problem: str | None = None
    """Reason, as a message for the user, why the target has no path; None if the target has a path."""
    route: ChosenRoute | None = None
    cost: PathCost = "lumen"
    """Name of the edge cost of the path search; see :class:`carina.commands.AddTarget`."""
    root_lps: Point | None = None
    """Start of the path for the costs ``walls`` and ``paper``, LPS in mm; None selects the root of the airways."""
    outside_mm: float | None = None
    """Length of the path outside the lumen in mm; None if no lumen is known."""
    crossings_mm: tuple[float, ...] | None = None
    """Distances from the start in mm at which the path leaves the lumen or returns into it; None without a lumen."""
    value_range: tuple[int, int] | None = None
    """Smallest and largest value of the scan along the path, in the scan's own values."""
    lesion: Lesion | None = None
    """The lesion at the target; None for a target in the airways."""
    note: str = ""
    """Note that the user wrote about the target; empty if there is no note."""
    priority: int = 1
    """Priority of the target; 1 is the highest."""

    def described(self, name: str, note: str, priority: int) -> Target:
        """Return a copy of the target with another name, note and priority, also in its route and its lesion."""
        lesion = self.lesion
        if lesion is not None:
            target = replace(lesion.target, name=name, note=note, priority=priority)
            lesion = replace(lesion, target=target)
        route = None if self.route is None else replace(self.route, title=name)
        return replace(self, name=name, note=note, priority=priority, lesion=lesion, route=route)


@one_line
@dataclass(frozen=True, slots=True)
class ChosenKeyFrame:
    """A camera pose that the user stored for a flight."""

    key_id: str
    pose: Pose
    name: str | None = None
    """Name given by the user; None: the key frame is named after its branch."""
    speed_mm_s: float | None = None
    """Speed from the preceding key frame in mm/s; None uses the common speed of all key frames."""


@one_line
@dataclass(frozen=True, slots=True)
class KeyFrames:
    """The key frames in their order, and the settings of the flight through them."""

    frames: tuple[ChosenKeyFrame, ...] = ()
    flying: KeyFrameFlying = KeyFrameFlying(20.0, "airways")


@one_line
@dataclass(frozen=True, slots=True)
class Document:
    """All content that undo and redo change; poses, mode and :class:`carina.render.Sight` are not part of it."""

    transfer: TransferFunction
    look: Look = Look()
    airways: Airways | None = None
    lumen_threshold: float | None = None
    """Requested threshold of the lumen; None: the tracker chooses it."""
    targets: tuple[Target, ...] = ()
    route: ChosenRoute | None = None
    key_frames: KeyFrames = KeyFrames()

    def cost_of(self, route: ChosenRoute | None) -> PathCost:
        """Return the name of the edge cost by which the path of a route was searched.

        A route to a branch, and a planned route with a needle, follow the airways: their cost is ``lumen``.
        """
        if route is None or route.needle is not None:
            return "lumen"
        return next((target.cost for target in self.targets if target.target_id == route.target_id), "lumen")
