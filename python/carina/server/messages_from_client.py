"""What a client sends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from carina.server.wire_codec import Length, Range
from carina.server.wire_fields import (
    Angle,
    BranchId,
    Count,
    DemoName,
    FlatView,
    Key,
    Mask,
    Method,
    Mode,
    Operator,
    OrbitView,
    PathText,
    Pixels,
    PointLps,
    SlabKind,
    Tone,
    ViewName,
)

__all__ = [
    "AcceptNotice",
    "Ack",
    "AddTarget",
    "AnswerMask",
    "AskBranchDetail",
    "AskLivePath",
    "Cancel",
    "ChooseRoute",
    "ClientHello",
    "CloseCase",
    "DismissMask",
    "GoTo",
    "ImportMask",
    "Layout",
    "LevelHorizon",
    "NextFork",
    "OpenDemo",
    "OpenPath",
    "OpenRecent",
    "OpenUpload",
    "Pick",
    "Place",
    "PreviousFork",
    "Probe",
    "Redo",
    "RemoveTarget",
    "ResetLook",
    "SetCarm",
    "SetCrosshair",
    "SetFov",
    "SetFrameRate",
    "SetLumenThreshold",
    "SetMask",
    "SetMethod",
    "SetMode",
    "SetOperator",
    "SetOrbit",
    "SetReformation",
    "SetRoot",
    "SetScope",
    "SetShading",
    "SetSlab",
    "SetTexture",
    "SetTransfer",
    "SetWindow",
    "SetZoom",
    "ShowPlace",
    "Steer",
    "ToggleMode",
    "Undo",
    "ViewSize",
]


@dataclass(frozen=True, slots=True)
class ClientHello:
    """First message of a client."""

    wire_type: ClassVar[str] = "hello"
    wire_version: Annotated[int, Range(0, 2**31)]


@dataclass(frozen=True, slots=True)
class OpenPath:
    """Open a file or folder of this machine."""

    wire_type: ClassVar[str] = "open_path"
    path: PathText


@dataclass(frozen=True, slots=True)
class OpenDemo:
    """Open a bundled case."""

    wire_type: ClassVar[str] = "open_demo"
    name: DemoName


@dataclass(frozen=True, slots=True)
class OpenUpload:
    """Open the files sent to ``/api/upload``."""

    wire_type: ClassVar[str] = "open_upload"
    upload_id: Key


@dataclass(frozen=True, slots=True)
class OpenRecent:
    """Open a case of ``start.recent``; its path never travels."""

    wire_type: ClassVar[str] = "open_recent"
    recent_id: Key


@dataclass(frozen=True, slots=True)
class ImportMask:
    """Take the mask sent to ``/api/upload`` as the airways of the open case; undoable."""

    wire_type: ClassVar[str] = "import_mask"
    upload_id: Key


@dataclass(frozen=True, slots=True)
class AnswerMask:
    """Answer ``state.mask_question``: which label is the airway; whether to resample."""

    wire_type: ClassVar[str] = "answer_mask"
    label: Annotated[int, Range(-(2**53), 2**53)] | None
    resample: bool


@dataclass(frozen=True, slots=True)
class DismissMask:
    """Forget the mask that ``state.mask_question`` asks about."""

    wire_type: ClassVar[str] = "dismiss_mask"


@dataclass(frozen=True, slots=True)
class CloseCase:
    """Back to the start page."""

    wire_type: ClassVar[str] = "close_case"


@dataclass(frozen=True, slots=True)
class Cancel:
    """Stop a job of ``progress``."""

    wire_type: ClassVar[str] = "cancel"
    job_id: Key


@dataclass(frozen=True, slots=True)
class ViewSize:
    """A visible view and its size in device pixels."""

    view: ViewName
    width: Pixels
    height: Pixels


@dataclass(frozen=True, slots=True)
class Layout:
    """The views on screen; no others are rendered."""

    wire_type: ClassVar[str] = "layout"
    views: Annotated[tuple[ViewSize, ...], Length(0, 13)]


@dataclass(frozen=True, slots=True)
class Ack:
    """A picture was decoded; coalesced acks may be sent one after the other."""

    wire_type: ClassVar[str] = "ack"
    frame_id: Count


@dataclass(frozen=True, slots=True)
class Steer:
    """Movement since the last one, in the camera's axes: forward, to the right, up, clockwise as seen by the camera."""

    wire_type: ClassVar[str] = "steer"
    advance_mm: Annotated[float, Range(-1000.0, 1000.0)]
    yaw_rad: Annotated[float, Range(-7.0, 7.0)]
    pitch_rad: Annotated[float, Range(-7.0, 7.0)]
    roll_rad: Annotated[float, Range(-7.0, 7.0)]


@dataclass(frozen=True, slots=True)
class SetMode:
    """Free movement, or along the path."""

    wire_type: ClassVar[str] = "set_mode"
    mode: Mode


@dataclass(frozen=True, slots=True)
class ToggleMode:
    """The other mode, without a jump."""

    wire_type: ClassVar[str] = "toggle_mode"


@dataclass(frozen=True, slots=True)
class GoTo:
    """To a place on the path; path mode only."""

    wire_type: ClassVar[str] = "go_to"
    path_mm: Annotated[float, Range(0.0, 1e5)]


@dataclass(frozen=True, slots=True)
class NextFork:
    """To the next fork along the path."""

    wire_type: ClassVar[str] = "next_fork"


@dataclass(frozen=True, slots=True)
class PreviousFork:
    """To the fork before."""

    wire_type: ClassVar[str] = "previous_fork"


@dataclass(frozen=True, slots=True)
class Place:
    """Tip to this point, keeping the look; free mode afterwards."""

    wire_type: ClassVar[str] = "place"
    lps: PointLps


@dataclass(frozen=True, slots=True)
class ShowPlace:
    """Tip before a place of the airways, looking at it, and the crosshair on it; free mode afterwards."""

    wire_type: ClassVar[str] = "show_place"
    lps: PointLps
    branch_id: BranchId | None
    """The branch that the place belongs to; null is the nearest."""


@dataclass(frozen=True, slots=True)
class LevelHorizon:
    """Roll so that the operator's up is up."""

    wire_type: ClassVar[str] = "level_horizon"


@dataclass(frozen=True, slots=True)
class ResetLook:
    """Look along the path again."""

    wire_type: ClassVar[str] = "reset_look"


@dataclass(frozen=True, slots=True)
class SetOperator:
    """Where the operator stands."""

    wire_type: ClassVar[str] = "set_operator"
    position: Operator


@dataclass(frozen=True, slots=True)
class SetRoot:
    """Find the airways again from this point."""

    wire_type: ClassVar[str] = "set_root"
    lps: PointLps


@dataclass(frozen=True, slots=True)
class AddTarget:
    """A target; snapped to the lumen within 5 mm, and said."""

    wire_type: ClassVar[str] = "add_target"
    lps: PointLps


@dataclass(frozen=True, slots=True)
class RemoveTarget:
    """Take a target away."""

    wire_type: ClassVar[str] = "remove_target"
    target_id: Key


@dataclass(frozen=True, slots=True)
class ChooseRoute:
    """Route to a target or to the end of a branch; exactly one of both is set, or none for no route."""

    wire_type: ClassVar[str] = "choose_route"
    target_id: Key | None
    branch_id: BranchId | None


@dataclass(frozen=True, slots=True)
class SetCrosshair:
    """The point that slices and tri-plane show; null follows the tip."""

    wire_type: ClassVar[str] = "set_crosshair"
    lps: PointLps | None


@dataclass(frozen=True, slots=True)
class Probe:
    """Ask for the number of the voxel at a point; the answer is ``value``."""

    wire_type: ClassVar[str] = "probe"
    lps: PointLps


@dataclass(frozen=True, slots=True)
class Pick:
    """Ask for the wall under a place in an airway picture; the answer is ``picked``."""

    wire_type: ClassVar[str] = "pick"
    pick_id: Count
    """Named by the answer."""
    frame_id: Count
    """The picture that is on the screen: the tip may have moved on since."""
    column: Annotated[float, Range(0.0, 4096.0)]
    """Corner coordinates of that picture's own pixels (centre of the first = 0.5)."""
    row: Annotated[float, Range(0.0, 4096.0)]


@dataclass(frozen=True, slots=True)
class AskLivePath:
    """Ask for the path from the root to a place under the cursor; only the newest is answered, by ``live_path``.

    Either a point, or a place in an airway picture, as in ``pick``: then the lumen in front of the wall there is meant.
    """

    wire_type: ClassVar[str] = "live_path"
    request_id: Count
    """Named by the answer."""
    lps: PointLps | None
    frame_id: Count | None
    column: Annotated[float, Range(0.0, 4096.0)] | None
    row: Annotated[float, Range(0.0, 4096.0)] | None


@dataclass(frozen=True, slots=True)
class AskBranchDetail:
    """Ask for what was measured along a branch; only the newest is answered, by ``branch_detail``."""

    wire_type: ClassVar[str] = "branch_detail"
    request_id: Count
    branch_id: BranchId


@dataclass(frozen=True, slots=True)
class SetFrameRate:
    """Ask for so many airway pictures per second while moving; resolution gives way to it, then the ray step."""

    wire_type: ClassVar[str] = "set_frame_rate"
    rate_hz: Annotated[float, Range(5.0, 240.0)]


@dataclass(frozen=True, slots=True)
class SetWindow:
    """Grey window of all slice views; numbers of the file where the volume is not HU."""

    wire_type: ClassVar[str] = "set_window"
    width_hu: Annotated[float, Range(1.0, 65_536.0)]
    level_hu: Annotated[float, Range(-32_768.0, 32_768.0)]


@dataclass(frozen=True, slots=True)
class SetFov:
    """Full angle of the airway view over the shorter side."""

    wire_type: ClassVar[str] = "set_fov"
    fov_deg: Annotated[float, Range(60.0, 170.0)]


@dataclass(frozen=True, slots=True)
class SetScope:
    """Look through an instrument of the library, with its field of view and outline; null is a pinhole."""

    wire_type: ClassVar[str] = "set_scope"
    scope: Key | None


@dataclass(frozen=True, slots=True)
class SetMask:
    """Outline of the airway picture."""

    wire_type: ClassVar[str] = "set_mask"
    mask: Mask


@dataclass(frozen=True, slots=True)
class SetTransfer:
    """A preset by name, or a ``carina-transfer`` document; exactly one."""

    wire_type: ClassVar[str] = "set_transfer"
    preset: Key | None
    document: dict[str, Any] | None


@dataclass(frozen=True, slots=True)
class SetShading:
    """Light at the tip on or off."""

    wire_type: ClassVar[str] = "set_shading"
    on: bool


@dataclass(frozen=True, slots=True)
class SetTexture:
    """Fine texture of the mucosa, which is decoration and not the patient's, on or off."""

    wire_type: ClassVar[str] = "set_texture"
    on: bool


@dataclass(frozen=True, slots=True)
class SetMethod:
    """Leaping, or the brute-force reference; the picture is the same."""

    wire_type: ClassVar[str] = "set_method"
    method: Method


@dataclass(frozen=True, slots=True)
class SetLumenThreshold:
    """Find the airways again with this threshold; null lets Carina choose."""

    wire_type: ClassVar[str] = "set_lumen_threshold"
    value: Annotated[float, Range(-32_768.0, 32_767.0)] | None


@dataclass(frozen=True, slots=True)
class SetOrbit:
    """Where an outside view is seen from; distance null fits."""

    wire_type: ClassVar[str] = "set_orbit"
    view: OrbitView
    azimuth_deg: Angle
    elevation_deg: Annotated[float, Range(-90.0, 90.0)]
    distance_mm: Annotated[float, Range(1.0, 5000.0)] | None


@dataclass(frozen=True, slots=True)
class SetZoom:
    """Scale of a slice (mm_per_px) or width of the cut-plane (extent_mm); null fits."""

    wire_type: ClassVar[str] = "set_zoom"
    view: FlatView
    mm_per_px: Annotated[float, Range(0.01, 20.0)] | None
    extent_mm: Annotated[float, Range(2.0, 1000.0)] | None
    center_lps: PointLps | None
    """Middle of a zoomed picture until the tip moves; null is the point that is shown, and in the cut-plane the tip."""


@dataclass(frozen=True, slots=True)
class SetCarm:
    """Where the radiograph's C-arm stands: LAO and cranial above 0; mm_per_px counts at its centre, null fits."""

    wire_type: ClassVar[str] = "set_carm"
    primary_deg: Annotated[float, Range(-180.0, 180.0)]
    secondary_deg: Annotated[float, Range(-90.0, 90.0)]
    mm_per_px: Annotated[float, Range(0.01, 20.0)] | None
    tone: Tone


@dataclass(frozen=True, slots=True)
class SetReformation:
    """Turn of the cutting plane of the views along the route, and their scale; null fits the route."""

    wire_type: ClassVar[str] = "set_reformation"
    turn_deg: Annotated[float, Range(-180.0, 180.0)]
    mm_per_px: Annotated[float, Range(0.01, 20.0)] | None


@dataclass(frozen=True, slots=True)
class SetSlab:
    """Thickness of slices and views along the route, and what they show of it; 0 mm are thin slices."""

    wire_type: ClassVar[str] = "set_slab"
    thickness_mm: Annotated[float, Range(0.0, 100.0)]
    kind: SlabKind


@dataclass(frozen=True, slots=True)
class Undo:
    """Take back the last change."""

    wire_type: ClassVar[str] = "undo"


@dataclass(frozen=True, slots=True)
class Redo:
    """Do it again."""

    wire_type: ClassVar[str] = "redo"


@dataclass(frozen=True, slots=True)
class AcceptNotice:
    """ "Not a medical device" was read."""

    wire_type: ClassVar[str] = "accept_notice"
