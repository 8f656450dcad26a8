"""What a person decides about a case: one immutable value, so that undo is taking an older one."""

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

__all__ = ["ChosenKeyFrame", "Document", "KeyFrames", "Lesion", "Target"]

Point = tuple[float, float, float]


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Lesion:
    """A target with a size, and how the way to it is planned."""

    target: PlanTarget
    """With the words of the target that it belongs to (:meth:`Target.described`)."""
    options: PlanOptions = field(default_factory=PlanOptions)

    @property
    def nodule(self) -> Nodule:
        """What is to be reached."""
        return self.target.nodule


@one_line
@dataclass(frozen=True, slots=True)
class Target:
    """A place to go to, as asked and as used."""

    target_id: str
    name: str
    lps: Point
    used_lps: Point | None = None
    """Where the path ends: the point itself, or the nearest lumen voxel within 5 mm."""
    snapped_mm: float | None = None
    length_mm: float | None = None
    problem: str | None = None
    """Why there is no path, in words."""
    route: ChosenRoute | None = None
    cost: PathCost = "lumen"
    """What its path was searched with; see :class:`carina.commands.AddTarget`."""
    root_lps: Point | None = None
    """Where the path begins, with the costs ``walls`` and ``paper``."""
    outside_mm: float | None = None
    """Length of that path outside the lumen; None where there is no lumen to compare with."""
    value_range: tuple[int, int] | None = None
    """Least and greatest value along that path, in the scan's own numbers."""
    lesion: Lesion | None = None
    """What is to be reached there; None for a place in the airways."""
    note: str = ""
    """What a person says about it."""
    priority: int = 1
    """1 comes first."""

    def described(self, name: str, note: str, priority: int) -> Target:
        """The same target with other words, its route's and its lesion's among them."""
        lesion = self.lesion
        if lesion is not None:
            told = replace(lesion.target, name=name, note=note, priority=priority)
            lesion = replace(lesion, target=told)
        route = None if self.route is None else replace(self.route, title=name)
        return replace(self, name=name, note=note, priority=priority, lesion=lesion, route=route)


@one_line
@dataclass(frozen=True, slots=True)
class ChosenKeyFrame:
    """A key frame."""

    key_id: str
    pose: Pose
    name: str | None = None
    """As a person called it; None is called by its branch."""
    speed_mm_s: float | None = None
    """On the way here; None takes that of all."""


@one_line
@dataclass(frozen=True, slots=True)
class KeyFrames:
    """The key frames in their order, and how they are flown through."""

    frames: tuple[ChosenKeyFrame, ...] = ()
    flying: KeyFrameFlying = KeyFrameFlying(20.0, "airways")


@one_line
@dataclass(frozen=True, slots=True)
class Document:
    """All that undo and redo move between; poses, mode and :class:`carina.render.Sight` are not in it."""

    transfer: TransferFunction
    look: Look = Look()
    airways: Airways | None = None
    lumen_threshold: float | None = None
    """As asked; None lets the tracker choose."""
    targets: tuple[Target, ...] = ()
    route: ChosenRoute | None = None
    key_frames: KeyFrames = KeyFrames()
