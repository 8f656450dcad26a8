"""What a session tells about itself: frozen values, without a lock to hold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from carina.commands import DeviceControls
from carina.errors import NoEvidenceError
from carina.navigate import DeviceState
from carina.render import Sight
from carina.scopes import Pose, ScopeState
from carina.session.document import Document

if TYPE_CHECKING:
    from carina.track import TreeMeasures
    from carina.volume import MaskLabel, Volume

__all__ = [
    "AirwayStatus",
    "CaseSnapshot",
    "Changed",
    "DevicesInfo",
    "KeyInfo",
    "KeysInfo",
    "MaskQuestion",
    "NotEvident",
    "PoseInfo",
    "Said",
    "Snapshot",
    "Stage",
    "Trouble",
    "WallPoint",
]

Stage = Literal["empty", "opening", "ready"]
AirwayStatus = Literal["none", "waiting", "finding", "found", "failed"]
Topic = Literal["state", "tree", "route", "pose", "start", "views", "keys"]


@dataclass(frozen=True, slots=True)
class FeatureOff:
    """What this volume cannot do, and why."""

    what: str
    why: str


@dataclass(frozen=True, slots=True)
class CaseSnapshot:
    """The open volume."""

    volume: Volume
    quality: tuple[str, ...]
    off: tuple[FeatureOff, ...]
    value_range: tuple[int, int]


@dataclass(frozen=True, slots=True)
class PoseInfo:
    """The newest pose and where it is."""

    pose_id: int
    pose: Pose
    mode: Literal["free", "path", "scope"]
    path_mm: float | None
    branch_id: int | None
    branch_name: str | None
    generation: int | None
    lumen_mm: float | None
    """Diameter of the lumen at the nearest centreline point."""
    inside: bool
    scope: ScopeState | None = None
    """The scope in the lumen, in mode *scope*."""
    scope_tip_mm: float | None = None
    """Diameter of its tip."""
    keys_s: float | None = None
    """The time in the flight through key frames, while that is what moved the tip."""
    by_device: bool = False
    """A device moved the tip last."""


@dataclass(frozen=True, slots=True)
class WallPoint:
    """A point of the wall, and what the scan and the tree say about it."""

    lps: tuple[float, float, float]
    voxel_value: int | None
    """Of the voxel it lies in; None outside the volume."""
    branch_id: int | None
    """The branch whose centreline is nearest; None without a tree."""
    branch_name: str | None
    generation: int | None


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


@dataclass(frozen=True, slots=True)
class Snapshot:
    """All but the pose."""

    case: CaseSnapshot | None = None
    stage: Stage = "empty"
    airways: AirwayStatus = "none"
    airways_words: str | None = None
    document: Document | None = None
    mode: Literal["free", "path", "scope"] = "free"
    sight: Sight = Sight()
    undo_label: str | None = None
    redo_label: str | None = None
    transfer_presets: tuple[str, ...] = ()
    measures: TreeMeasures | None = None
    """What the document's airways measure; None until it is known."""
    mask_question: MaskQuestion | None = None


@dataclass(frozen=True, slots=True)
class DevicesInfo:
    """Input devices, and how they move the tip."""

    control: Literal["absolute", "relative", "path"]
    controls: DeviceControls
    devices: tuple[DeviceState, ...]


@dataclass(frozen=True, slots=True)
class KeyInfo:
    """A key frame as it is shown."""

    key_id: str
    name: str
    """As a person called it, or its branch."""
    own_name: bool
    branch_id: int | None
    """The branch that it lies in."""
    speed_mm_s: float | None
    """Its own; None takes that of all."""
    time_s: float
    leg_mm: float | None
    """Length of the way here; None for the first, and while there is no flight."""
    through_airways: bool
    """Whether that way follows the airways."""


@dataclass(frozen=True, slots=True)
class KeysInfo:
    """The key frames, and the flight through them."""

    keys: tuple[KeyInfo, ...] = ()
    speed_mm_s: float = 20.0
    through: Literal["airways", "space"] = "airways"
    duration_s: float = 0.0
    problem: str | None = None
    """Why they cannot be flown."""


@dataclass(frozen=True, slots=True)
class Changed:
    """Something changed; ask the session for it."""

    topics: frozenset[Topic]


@dataclass(frozen=True, slots=True)
class Trouble:
    """Something could not be done; stays until read."""

    code: str
    message: str
    action: str | None = None


@dataclass(frozen=True, slots=True)
class NotEvident:
    """An edit was not made, since the CT shows no airway along its whole way; asked for again it can be drawn by hand.

    Comes in the place of :class:`Trouble`.
    """

    job_id: str
    lps: tuple[float, float, float]
    """What was asked for."""
    error: NoEvidenceError


@dataclass(frozen=True, slots=True)
class Said:
    """Something worth a line."""

    message: str
