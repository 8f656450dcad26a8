"""Snapshots of a session's state: frozen values that are read without a lock."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
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
from carina.session.state.grey_scale import FeatureOff, GreyScale
from carina.value import FrozenValue, Part
from carina.volume.mask_files import MaskLabel

if TYPE_CHECKING:
    from carina.plan.routes.main_carina import RouteScale
    from carina.track import Branch, CtAssessment, LivePath, TreeMeasures
    from carina.volume import Volume
    from carina.volume.opening_preview import OpeningPreview

Stage = Literal["empty", "opening", "ready"]
AirwayStatus = Literal["none", "waiting", "finding", "found", "failed"]
Topic = Literal[
    "state",
    "tree",
    "route",
    "pose",
    "start",
    "views",
    "key_frames",
    "flights",
    "history",
    "plan",
    "lungs",
    "training",
    "opening",
]


@one_line
@dataclass(frozen=True, slots=True)
class CaseSnapshot:
    """The open volume and its display settings."""

    volume: Volume
    quality: tuple[str, ...]
    scale: GreyScale
    value_range: tuple[int, int]
    case_id: str = ""
    """Random id of the case, equal to the id of its record once the case is stored."""
    is_assessed: bool = False
    """Whether the CT was assessed for the airway search; the result is cached with the volume."""

    @property
    def off(self) -> tuple[FeatureOff, ...]:
        """Features that are unavailable for this volume, with reasons."""
        return self.scale.off


class FlightPlace(FrozenValue, frozen=True):
    """A recorded flight that is being replayed, and the time in it."""

    number: FlightNumber
    time_s: float
    """Time in s of the replay, from the start of the flight."""


@one_line
@dataclass(frozen=True, slots=True)
class PoseInfo:
    """The newest pose and its position in the airways."""

    pose_id: int
    pose: Pose
    mode: Literal["free", "path", "scope"]
    path_mm: float | None
    branch: Branch | None
    """Branch that contains the pose; None outside the airways."""
    lumen_mm: float | None
    """Diameter, in mm, of the nearest section of the branch away from its forks; None before the measurement."""
    inside: bool
    scope: ScopeState | None = None
    """Scope in the lumen, in mode *scope*."""
    scope_tip_mm: float | None = None
    """Outer diameter of the scope's tip, in mm."""
    key_frames_s: float | None = None
    """Time of the tip in the flight through the key frames, in s; None if another cause moved the tip last."""
    flight: FlightPlace | None = None
    """Position of the tip in a recorded flight; None if another cause moved the tip last."""
    by_device: bool = False
    """Whether a device moved the tip last."""
    back_to_route_mm: float | None = None
    """Distance in mm along the centrelines back to the route, in mode *scope* in a wrong branch; else None."""


@one_line
@dataclass(frozen=True, slots=True)
class WallPoint:
    """A point of the wall with its voxel value and its branch."""

    lps: tuple[float, float, float]
    voxel_value: int | None
    """Value of the voxel that contains the point; None outside the volume."""
    branch: Branch | None
    """Branch whose centreline is nearest to the point; None without a tree."""


class MaskQuestion(FrozenValue, frozen=True):
    """Question to the user about an imported mask before it can define the airways; answered by ``answer_mask``."""

    title: Words
    """Name of the imported file that contains the mask."""
    problem: Literal["label", "grid"]
    """``label``: the mask contains several structures. ``grid``: its grid differs from the grid of the scan."""
    labels: tuple[MaskLabel, ...] = ()
    """Structures in the mask, of which the user must choose the airway; volumes are rounded to 0.001 ml."""
    suggested: int | None = None
    """Label whose name denotes the airway; None if none or several do."""
    expected: Words | None = None
    """Description of the scan's grid, if the mask has another grid and the user must allow resampling."""
    found: Words | None = None
    """Description of the mask's grid; None if it is the grid of the scan."""
    share_inside: Part | None = None
    """Fraction of the structure that is inside the scan, 0 to 1; None if the grids are equal."""


class SavingInfo(FrozenValue, frozen=True):
    """State of the stored case and of its named file on the disk; times are seconds since 1970."""

    keeps: bool = False
    """Whether the case is stored; False for a case that cannot be found again, or if nothing is stored."""
    saved_s: float | None = None
    """Time of the last write in seconds since 1970; null if nothing was written."""
    begun_s: float | None = None
    """Time when the case was begun, in seconds since 1970; null without a case file."""
    problem: Words | None = None
    """Reason why nothing can be written at present; None if writing works."""
    copied_s: float | None = None
    """Time of the last write of the named file, which is the copy of the case at a path of the user's choice."""
    copy_name: Words | None = None
    """Name of the named file; null if the case has none."""
    copy_folder: Words | None = None
    """Folder of the named file."""
    copy_problem: Words | None = None
    """Reason why the named file was not written at the last attempt."""
    copy_conflict: Literal["changed", "other-case", "not-a-case", "missing", "open-elsewhere"] | None = None
    """Kind of the conflict if the named file has content that this window did not write; the user decides."""
    beside: Words | None = None
    """Path without a file, beside the named file, to which the case can be saved during a conflict; else None."""
    suggested: Words | None = None
    """Suggested path of the named file, if the case has none."""
    title: Words | None = None
    """Name that the user gave to the case."""
    continued_s: float | None = None
    """Time of the last use before a stored case was opened again; None for a new case."""
    continued_changes: Annotated[int, msgspec.Meta(ge=0, le=2**31)] = 0
    """Number of stored changes with which a case was opened again, for a message."""

    def with_(self, **values: Any) -> SavingInfo:
        """Return a copy with other values in some fields."""
        return msgspec.structs.replace(self, **values)

    @property
    def shown(self) -> tuple[Any, ...]:
        """Values that a window shows. Times are rounded down to minutes, so values change at most once per minute."""
        minutes = [None if s is None else int(s // 60.0) for s in (self.saved_s, self.copied_s)]
        named = (self.copy_name, self.copy_folder, self.copy_problem, self.copy_conflict)
        return (*minutes, self.keeps, self.title, self.problem, *named)


class FlightInfo(FrozenValue, frozen=True):
    """A flight that was recorded into the case."""

    number: FlightNumber
    """Number by which commands identify the flight."""
    name: Words
    words: Words
    """Description by the user."""
    begun_s: float | None
    """Start of the recording, in seconds since 1970."""
    length_s: float
    """Duration of the recording in s; 0 while the flight is being recorded."""
    is_expert: bool
    """Whether the flight is marked as the expert's, with which other flights are compared."""
    state: Literal["recording", "complete", "cut-off"]
    """*cut-off*: Carina was stopped during the recording; the flight contains what was written until then."""


class BreathingInfo(FrozenValue, frozen=True):
    """Settings of the simulated breathing."""

    on: bool = False
    movement_mm: float = 12.0
    """Movement of the lung bases, mm."""
    period_s: float = 3.6
    """Duration of one breath, s."""


@one_line
@dataclass(frozen=True, slots=True)
class Snapshot:
    """The state of a session without the pose."""

    case: CaseSnapshot | None = None
    case_number: int = 0
    """Number that increases with each opened case."""
    neutral_title: str = ""
    """Neutral alias of the case; ``saving.title`` is the name that the user gave."""
    stage: Stage = "empty"
    airways: AirwayStatus = "none"
    airways_words: str | None = None
    assessment: CtAssessment | None = None
    """What limits the airways that can be seen in the CT; None until it is known, and without HU."""
    document: Document | None = None
    mode: Literal["free", "path", "scope"] = "free"
    sight: Sight = Sight()
    undo_label: str | None = None
    redo_label: str | None = None
    steps: tuple[Step[Document], ...] = ()
    """All steps of the history, those that are undone included."""
    position: int = 0
    """Number of changes in the history that are not undone."""
    transfer_presets: tuple[str, ...] = ()
    measures: TreeMeasures | None = None
    """Measurements of the document's airways; None until they are available."""
    route_scale: RouteScale | None = None
    """Distances along the document's route; None without a route."""
    target_places_mm: Mapping[str, float] = field(default_factory=dict)
    """Distance in mm of the targets in the airways from the main carina, by target ID."""
    mask_question: MaskQuestion | None = None
    saving: SavingInfo = SavingInfo()
    flights: tuple[FlightInfo, ...] = ()
    """Flights recorded into the case, in their order."""
    breathing: BreathingInfo = field(default_factory=BreathingInfo)


@one_line
@dataclass(frozen=True, slots=True)
class PointedPath:
    """Path to the point under the cursor, with the distance of its end as plans state it."""

    path: LivePath
    from_carina_mm: float | None
    """Distance in mm of the end from the main carina along the centrelines; None if the path does not pass it."""


@one_line
@dataclass(frozen=True, slots=True)
class DevicesInfo:
    """Connected input devices, and the way in which they move the tip."""

    control: Literal["absolute", "relative", "path"]
    controls: DeviceControls
    devices: tuple[DeviceState, ...]


class ShownKeyFrame(FrozenValue, frozen=True):
    """A key frame: a pose through which the flight passes."""

    key_id: Identifier
    name: Words
    """Name that the user gave, or else the name of the branch."""
    own_name: bool
    """Whether the user gave the name."""
    branch_id: BranchId | None
    """Branch whose lumen contains the key frame's pose; null outside the airways."""
    speed_mm_s: float | None
    """Speed of the leg to this key frame; null means the speed of the whole flight."""
    time_s: float
    """Exact time, in s, at which the flight passes this key frame; the pose is then exactly that of the key frame."""
    leg_mm: float | None
    """Length of the leg to this key frame; null for the first key frame and without a flight."""
    through_airways: bool
    """Whether the flight from the previous key frame to this one follows the airways."""


class KeyFramesInfo(KeyFrameFlying, frozen=True):
    """The key frames, and the flight through them."""

    frames: tuple[ShownKeyFrame, ...]
    duration_s: float
    """Duration in s; 0 with fewer than two key frames."""
    problem: Words | None
    """Reason why there is no flight; null if there is one."""


@one_line
@dataclass(frozen=True, slots=True)
class OpeningInfo:
    """A CT that a job is opening, until the CT is shown or the job ends."""

    list_id: str
    """ID of the list of series; it stays if another series of the same list is opened instead."""
    job_id: str
    preview: OpeningPreview
    open_series: Callable[[str], str] = field(repr=False)
    """Starts the job that opens the series with this key instead, and returns the ID of the job."""


@one_line
@dataclass(frozen=True, slots=True)
class Changed:
    """Report that parts of the state have changed, which listeners then read from the session."""

    topics: frozenset[Topic]


@one_line
@dataclass(frozen=True, slots=True)
class ChestMoved:
    """Report that the simulated breathing has moved the chest; nothing else has changed."""

    moves_scope: bool
    """Whether a scope is in the lumen, whose contact with the wall may have changed."""


@one_line
@dataclass(frozen=True, slots=True)
class ErrorEvent:
    """Report that an operation failed; the window shows it until the user dismisses it."""

    code: str
    message: str
    action: str | None = None


@one_line
@dataclass(frozen=True, slots=True)
class EvidenceMissing:
    """Report that a branch was not added, because the CT does not show an airway along its whole path.

    This event is sent instead of :class:`ErrorEvent`. The user may request the branch again as drawn by hand.
    """

    job_id: str
    lps: tuple[float, float, float]
    """Requested end point of the branch, in LPS mm."""
    error: NoEvidenceError


@one_line
@dataclass(frozen=True, slots=True)
class StartMarked:
    """Report that the pen's button marked the start point of a path, which the client passes with the next target."""

    lps: tuple[float, float, float]


@one_line
@dataclass(frozen=True, slots=True)
class UserMessage:
    """Report with a short message for the user."""

    message: str
