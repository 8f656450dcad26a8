"""Snapshots of a session's state: frozen values that are read without a lock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec

from carina.case.document import Document
from carina.case.history import Step
from carina.commands import DeviceControls, KeyFrameFlying
from carina.commands.fields import BranchId, FlightNumber, Identifier, Words
from carina.display import one_line
from carina.errors import NoEvidenceError
from carina.navigate import DeviceState
from carina.render import Sight
from carina.scopes import Pose, ScopeState
from carina.session.grey_scale import FeatureOff, GreyScale
from carina.value import FrozenValue

if TYPE_CHECKING:
    from carina.track import Branch, TreeMeasures
    from carina.volume import MaskLabel, Volume

__all__ = [
    "AirwayStatus",
    "CaseSnapshot",
    "Changed",
    "DevicesInfo",
    "FlightInfo",
    "FlightPlace",
    "KeyFramesInfo",
    "MaskQuestion",
    "NotEvident",
    "PoseInfo",
    "Said",
    "SavingInfo",
    "ShownKeyFrame",
    "Snapshot",
    "Stage",
    "StartMarked",
    "Trouble",
    "WallPoint",
]

Stage = Literal["empty", "opening", "ready"]
AirwayStatus = Literal["none", "waiting", "finding", "found", "failed"]
Topic = Literal["state", "tree", "route", "pose", "start", "views", "key_frames", "flights", "history", "plan", "lungs"]


@one_line
@dataclass(frozen=True, slots=True)
class CaseSnapshot:
    """The open volume."""

    volume: Volume
    quality: tuple[str, ...]
    scale: GreyScale
    value_range: tuple[int, int]
    case_id: str = ""
    """Random id of the case, equal to the id of its record once the case is stored."""

    @property
    def off(self) -> tuple[FeatureOff, ...]:
        """What this volume cannot do."""
        return self.scale.off


class FlightPlace(FrozenValue, frozen=True):
    """A time of a recorded flight that is flown again."""

    number: FlightNumber
    time_s: float


@one_line
@dataclass(frozen=True, slots=True)
class PoseInfo:
    """The newest pose and where it is."""

    pose_id: int
    pose: Pose
    mode: Literal["free", "path", "scope"]
    path_mm: float | None
    branch: Branch | None
    """The branch that it lies in; None outside the airways."""
    lumen_mm: float | None
    """Diameter of the nearest section of the branch away from its forks; None until the airways are measured."""
    inside: bool
    scope: ScopeState | None = None
    """The scope in the lumen, in mode *scope*."""
    scope_tip_mm: float | None = None
    """Diameter of its tip."""
    key_frames_s: float | None = None
    """The time in the flight through key frames, while that is what moved the tip."""
    flight: FlightPlace | None = None
    """The time in a recorded flight, while that is what moved the tip."""
    by_device: bool = False
    """A device moved the tip last."""


@one_line
@dataclass(frozen=True, slots=True)
class WallPoint:
    """A point of the wall, and what the scan and the tree say about it."""

    lps: tuple[float, float, float]
    voxel_value: int | None
    """Of the voxel it lies in; None outside the volume."""
    branch: Branch | None
    """The branch whose centreline is nearest; None without a tree."""


@one_line
@dataclass(frozen=True, slots=True)
class MaskQuestion:
    """What must be said of a mask of another tool before it can be taken as the airways."""

    title: str
    """The file's name."""
    problem: Literal["label", "grid"]
    labels: tuple[MaskLabel, ...] = ()
    """It holds these structures: which is the airway?"""
    suggested: int | None = None
    """The label whose name says so."""
    expected: str | None = None
    """The scan's grid, where the mask is on another one: is it to be resampled?"""
    found: str | None = None
    share_inside: float | None = None
    """How much of the structure lies in the scan, 0 to 1."""


class SavingInfo(FrozenValue, frozen=True):
    """What of the case is on the disk. Times are seconds since 1970."""

    keeps: bool = False
    """The case is kept; false for one that nobody could find again, and where nothing is kept."""
    saved_s: float | None = None
    """When it was written last."""
    begun_s: float | None = None
    """When the case was begun."""
    problem: Words | None = None
    """Why nothing can be written at present."""
    copied_s: float | None = None
    """When the copy was written that a person asked for."""
    copy_name: Words | None = None
    copy_folder: Words | None = None
    copy_problem: Words | None = None
    """Why the named file was not written at the last attempt."""
    copy_conflict: Literal["changed", "other-case", "not-a-case", "missing", "open-elsewhere"] | None = None
    """Kind of the conflict if the named file has content that this window did not write; the user decides."""
    beside: Words | None = None
    """Free path beside the named file during a conflict; None without a conflict."""
    suggested: Words | None = None
    """A place for the copy, where it has none."""
    title: Words | None = None
    """What its person calls it."""
    continued_s: float | None = None
    """The case was continued: when it had been used before."""
    continued_changes: Annotated[int, msgspec.Meta(ge=0, le=2**31)] = 0
    """How many changes it had then."""

    def with_(self, **values: Any) -> SavingInfo:
        """Return a copy with other values in some fields."""
        return msgspec.structs.replace(self, **values)

    @property
    def shown(self) -> tuple[Any, ...]:
        """The values that a window shows, with times in minutes."""
        minutes = [None if s is None else int(s // 60.0) for s in (self.saved_s, self.copied_s)]
        named = (self.copy_name, self.copy_folder, self.copy_problem, self.copy_conflict)
        return (*minutes, self.keeps, self.title, self.problem, *named)


class FlightInfo(FrozenValue, frozen=True):
    """A flight that was recorded into the case."""

    number: FlightNumber
    """By which commands name it."""
    name: Words
    words: Words
    """What a person says about it."""
    begun_s: float | None
    """Seconds since 1970."""
    length_s: float
    """0 while it is being recorded."""
    state: Literal["recording", "complete", "cut-off"]
    """*cut-off*: Carina was stopped while it recorded; it goes as far as it came."""


@one_line
@dataclass(frozen=True, slots=True)
class Snapshot:
    """All but the pose."""

    case: CaseSnapshot | None = None
    case_number: int = 0
    """Grows with each case opened."""
    neutral_title: str = ""
    """Neutral alias of the case; ``saving.title`` is the name that the user gave."""
    stage: Stage = "empty"
    airways: AirwayStatus = "none"
    airways_words: str | None = None
    document: Document | None = None
    mode: Literal["free", "path", "scope"] = "free"
    sight: Sight = Sight()
    undo_label: str | None = None
    redo_label: str | None = None
    steps: tuple[Step[Document], ...] = ()
    """All that was done and can be taken back, or done again."""
    position: int = 0
    """How many of them hold."""
    transfer_presets: tuple[str, ...] = ()
    measures: TreeMeasures | None = None
    """What the document's airways measure; None until it is known."""
    mask_question: MaskQuestion | None = None
    saving: SavingInfo = SavingInfo()
    flights: tuple[FlightInfo, ...] = ()
    """What was recorded into the case, in its order."""


@one_line
@dataclass(frozen=True, slots=True)
class DevicesInfo:
    """Input devices, and how they move the tip."""

    control: Literal["absolute", "relative", "path"]
    controls: DeviceControls
    devices: tuple[DeviceState, ...]


class ShownKeyFrame(FrozenValue, frozen=True):
    """A pose to fly through."""

    key_id: Identifier
    name: Words
    """As a person called it, or its branch."""
    own_name: bool
    branch_id: BranchId | None
    """The branch that it lies in."""
    speed_mm_s: float | None
    """On the way here; null takes that of all."""
    time_s: float
    """When the flight passes it, to the last bit: there it is at the key frame itself."""
    leg_mm: float | None
    """Length of the way here; null for the first, and while there is no flight."""
    through_airways: bool
    """Whether that way follows the airways."""


class KeyFramesInfo(KeyFrameFlying, frozen=True):
    """The key frames, and the flight through them."""

    frames: tuple[ShownKeyFrame, ...]
    duration_s: float
    """0 while there are fewer than two."""
    problem: Words | None
    """Why they cannot be flown."""


@one_line
@dataclass(frozen=True, slots=True)
class Changed:
    """Something changed; ask the session for it."""

    topics: frozenset[Topic]


@one_line
@dataclass(frozen=True, slots=True)
class Trouble:
    """Something could not be done; stays until read."""

    code: str
    message: str
    action: str | None = None


@one_line
@dataclass(frozen=True, slots=True)
class NotEvident:
    """An edit was not made, since the CT shows no airway along its whole way; asked for again it can be drawn by hand.

    Comes in the place of :class:`Trouble`.
    """

    job_id: str
    lps: tuple[float, float, float]
    """What was asked for."""
    error: NoEvidenceError


@one_line
@dataclass(frozen=True, slots=True)
class StartMarked:
    """The pen's button marked where a path is to begin; whoever adds targets says so with them."""

    lps: tuple[float, float, float]


@one_line
@dataclass(frozen=True, slots=True)
class Said:
    """Something worth a line."""

    message: str
