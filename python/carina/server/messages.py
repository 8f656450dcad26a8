"""The messages between server and client, as frozen dataclasses (wire version 1; prose in ``protocol/README.md``).

``web/src/wire/messages.ts`` and ``protocol/schema.json`` are generated from this file by
``python -m carina.server.wire_types``; a test fails when they drift apart. World is LPS mm, matrices are 4x4 row-major,
units are in the names. Numbers are bounded so that no client can ask for a picture or a volume of any size.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from carina.errors import ProtocolError
from carina.server.wire_codec import Length, Range, decode_fields, load_json_object, split_picture, to_jsonable

__all__ = [
    "CLIENT_MESSAGES",
    "CLOSE_CODES",
    "SERVER_MESSAGES",
    "WIRE_VERSION",
    "encode_message",
    "parse_client_message",
    "parse_picture",
    "parse_server_message",
]

WIRE_VERSION = 1

CLOSE_CODES: dict[str, int] = {
    "protocol.malformed": 4400,
    "protocol.not-authorised": 4401,
    "protocol.version": 4402,
    "protocol.order": 4403,
    "protocol.taken-over": 4409,
    "protocol.slow-client": 4413,
}
"""Why the server closes a socket; each comes with one sentence."""

Coordinate = Annotated[float, Range(-1e5, 1e5)]
PointLps = Annotated[tuple[Coordinate, ...], Length(3, 3)]
Numbers = Annotated[tuple[float, ...], Length(0, 2_000_000)]
PointsLps = Annotated[tuple[PointLps, ...], Length(0, 1_000_000)]
Matrix4 = Annotated[tuple[float, ...], Length(16, 16)]
"""4x4, row-major."""
Key = Annotated[str, Length(1, 64)]
Words = Annotated[str, Length(0, 4000)]
PathText = Annotated[str, Length(1, 4096)]
Count = Annotated[int, Range(0, 2**53 - 1)]
Pixels = Annotated[int, Range(16, 4096)]
Angle = Annotated[float, Range(-3600.0, 3600.0)]
ViewName = Literal[
    "airway",
    "cut-plane",
    "tri-plane",
    "xray-axial",
    "xray-coronal",
    "xray-sagittal",
    "axial",
    "coronal",
    "sagittal",
    "tree",
]
OrbitView = Literal["tree", "tri-plane"]
Mode = Literal["free", "path"]
Operator = Literal["head", "facing"]
Method = Literal["leap", "brute"]
DemoName = Literal["phantom", "patient"]

# ---------------------------------------------------------------- client to server


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
    views: Annotated[tuple[ViewSize, ...], Length(0, 10)]


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
    branch_id: Annotated[int, Range(0, 2**31)] | None


@dataclass(frozen=True, slots=True)
class SetCrosshair:
    """The point that slices and tri-plane show; null follows the tip."""

    wire_type: ClassVar[str] = "set_crosshair"
    lps: PointLps | None


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
    view: Literal["axial", "coronal", "sagittal", "cut-plane"]
    mm_per_px: Annotated[float, Range(0.01, 20.0)] | None
    extent_mm: Annotated[float, Range(2.0, 1000.0)] | None


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


# ---------------------------------------------------------------- server to client


@dataclass(frozen=True, slots=True)
class ServerHello:
    """Answer to the client's hello."""

    wire_type: ClassVar[str] = "hello"
    wire_version: Annotated[int, Range(0, 2**31)]
    carina_version: Words


@dataclass(frozen=True, slots=True)
class RecentCase:
    """A case opened before, without names."""

    recent_id: Key
    date: Key
    """ISO date of the last opening."""
    title: Words


@dataclass(frozen=True, slots=True)
class Demo:
    """A bundled case."""

    name: DemoName
    title: Words
    words: Words
    citation: Words | None


@dataclass(frozen=True, slots=True)
class Start:
    """What the start page shows."""

    wire_type: ClassVar[str] = "start"
    notice_accepted: bool
    recent: tuple[RecentCase, ...]
    demos: tuple[Demo, ...]


@dataclass(frozen=True, slots=True)
class OtherSeries:
    """Another series of the folder."""

    key: Words
    modality: Words
    description: Words
    num_slices: Count
    refused: Words | None


@dataclass(frozen=True, slots=True)
class FeatureOff:
    """What this volume cannot do, and why."""

    what: Words
    why: Words


@dataclass(frozen=True, slots=True)
class CaseInfo:
    """The open volume."""

    title: Words
    format: Words
    is_hu: bool
    not_hu_reason: Words | None
    shape_zyx: Annotated[tuple[Count, ...], Length(3, 3)]
    spacing_mm: Annotated[tuple[float, ...], Length(3, 3)]
    lps_from_ijk: Matrix4
    value_range: Annotated[tuple[float, ...], Length(2, 2)]
    warnings: tuple[Words, ...]
    quality: tuple[Words, ...]
    other_series: tuple[OtherSeries, ...]
    citation: Words | None
    off: tuple[FeatureOff, ...]


@dataclass(frozen=True, slots=True)
class GreyWindow:
    """Grey window of the slice views."""

    width_hu: float
    level_hu: float


@dataclass(frozen=True, slots=True)
class Orbit:
    """Camera of an outside view; azimuth 0 is from anterior, distance null fits."""

    azimuth_deg: float
    elevation_deg: float
    distance_mm: float | None


@dataclass(frozen=True, slots=True)
class Zoom:
    """Scales of the planar views; null fits."""

    axial_mm_per_px: float | None
    coronal_mm_per_px: float | None
    sagittal_mm_per_px: float | None
    cut_plane_extent_mm: float | None


@dataclass(frozen=True, slots=True)
class Target:
    """A target as asked and as used; ``problem`` says in words why there is no path."""

    target_id: Key
    name: Words
    lps: PointLps
    used_lps: PointLps | None
    snapped_mm: float | None
    length_mm: float | None
    problem: Words | None


@dataclass(frozen=True, slots=True)
class State:
    """All that is shown, but the pose, the tree and the route."""

    wire_type: ClassVar[str] = "state"
    case: CaseInfo | None
    stage: Literal["empty", "opening", "ready"]
    """``opening``: pictures already come, the airways are being found."""
    airways: Literal["none", "waiting", "finding", "found", "failed"]
    airways_words: Words | None
    """Why there are none and what to do, or what was noted about them."""
    mode: Mode
    operator: Operator
    fov_deg: float
    transfer: Words
    """Name of the transfer function."""
    transfer_document: dict[str, Any] | None
    transfer_presets: tuple[Words, ...]
    shading: bool
    method: Method
    window: GreyWindow
    crosshair_lps: PointLps | None
    targets: tuple[Target, ...]
    route_id: Words | None
    can_undo: Words | None
    """Label of the change that undo takes back."""
    can_redo: Words | None
    root_lps: PointLps | None
    lumen_threshold: float | None
    orbit_tree: Orbit
    orbit_tri_plane: Orbit
    zoom: Zoom


@dataclass(frozen=True, slots=True)
class TreeBranch:
    """A branch of a ``carina-tree`` document."""

    extra_keys_allowed: ClassVar[bool] = True
    id: Annotated[int, Range(0, 2**31)]
    parent: Annotated[int, Range(0, 2**31)] | None
    children: tuple[Annotated[int, Range(0, 2**31)], ...]
    generation: Annotated[int, Range(0, 1000)]
    name: Words | None
    kind: Literal["tracked", "bridge", "manual"]
    points: PointsLps
    radius: Numbers
    cost: float | None
    confidence: Annotated[float, Range(0.0, 1.0)] | None


@dataclass(frozen=True, slots=True)
class TreeDocument:
    """A ``carina-tree`` document, version 1."""

    extra_keys_allowed: ClassVar[bool] = True
    format: Literal["carina-tree"]
    version: Literal[1]
    space: Literal["LPS"]
    unit: Literal["mm"]
    root: Annotated[int, Range(0, 2**31)]
    branches: tuple[TreeBranch, ...]


@dataclass(frozen=True, slots=True)
class Tree:
    """The airway tree, when it changed."""

    wire_type: ClassVar[str] = "tree"
    tree: TreeDocument | None


@dataclass(frozen=True, slots=True)
class RouteSpan:
    """A branch along the route."""

    branch_id: Annotated[int, Range(0, 2**31)]
    name: Words | None
    generation: Annotated[int, Range(0, 1000)]
    from_mm: float
    to_mm: float


@dataclass(frozen=True, slots=True)
class RouteInfo:
    """The way that is flown; lists are parallel, root to tip."""

    route_id: Key
    title: Words
    target_id: Key | None
    branch_id: Annotated[int, Range(0, 2**31)] | None
    points_lps: PointsLps
    cumulative_mm: Numbers
    generation: Annotated[tuple[Annotated[int, Range(0, 1000)], ...], Length(0, 1_000_000)]
    radius_mm: Numbers
    forks_mm: Numbers
    spans: tuple[RouteSpan, ...]
    length_mm: float


@dataclass(frozen=True, slots=True)
class Route:
    """The route, when it changed."""

    wire_type: ClassVar[str] = "route"
    route: RouteInfo | None


@dataclass(frozen=True, slots=True)
class Pose:
    """The newest pose; pictures name the one they answer."""

    wire_type: ClassVar[str] = "pose"
    pose_id: Count
    lps_from_camera: Matrix4
    mode: Mode
    path_mm: float | None
    branch_id: Annotated[int, Range(0, 2**31)] | None
    branch_name: Words | None
    generation: Annotated[int, Range(0, 1000)] | None
    lumen_mm: float | None
    """Diameter of the lumen here."""
    inside: bool
    """The tip is in the lumen (in the volume's box while there is no lumen)."""


@dataclass(frozen=True, slots=True)
class Progress:
    """A job's progress; fraction and time left are null where they cannot be known."""

    wire_type: ClassVar[str] = "progress"
    job_id: Key
    title: Words
    what: Words
    fraction: Annotated[float, Range(0.0, 1.0)] | None
    seconds_left: float | None


@dataclass(frozen=True, slots=True)
class Done:
    """A job has ended; a failure comes as ``error`` too."""

    wire_type: ClassVar[str] = "done"
    job_id: Key
    outcome: Literal["done", "cancelled", "failed"]


@dataclass(frozen=True, slots=True)
class Error:
    """Something could not be done; stays until read."""

    wire_type: ClassVar[str] = "error"
    code: Words
    message: Words
    action: Words | None
    """What to do next, or null where the message says it."""


@dataclass(frozen=True, slots=True)
class Notice:
    """Something worth a line."""

    wire_type: ClassVar[str] = "notice"
    message: Words


@dataclass(frozen=True, slots=True)
class Status:
    """How the stream runs; twice a second while pictures go."""

    wire_type: ClassVar[str] = "status"
    fps: float
    """Airway pictures sent per second, over the last second of movement."""
    render_ms: float
    age_ms: float
    """From the newest pose's arrival to its picture being sent."""
    method: Words
    threads: Count
    simd: Words


@dataclass(frozen=True, slots=True)
class PictureHeader:
    """Header of a binary message; the payload follows."""

    frame_id: Count
    view: ViewName
    pose_id: Count
    lps_from_camera: Matrix4 | None
    """Camera of a perspective view."""
    fov_deg: float | None
    lps_from_pixel: Matrix4 | None
    """Planar view: (column, row, 0, 1) in corner coordinates of *this* picture (centre = +0.5) to LPS."""
    width: Pixels
    height: Pixels
    codec: Literal["jpeg", "png"]
    quality: Annotated[int, Range(1, 100)]
    full: bool
    """Final quality for this state; false while moving."""
    render_ms: float
    method: Words


def _by_type(*classes: type[Any]) -> dict[str, type[Any]]:
    return {cls.wire_type: cls for cls in classes}


CLIENT_MESSAGES = _by_type(
    ClientHello, OpenPath, OpenDemo, OpenUpload, OpenRecent, CloseCase, Cancel, Layout, Ack, Steer, SetMode, ToggleMode,
    GoTo, NextFork, PreviousFork, Place, LevelHorizon, ResetLook, SetOperator, SetRoot, AddTarget, RemoveTarget,
    ChooseRoute, SetCrosshair, SetWindow, SetFov, SetTransfer, SetShading, SetMethod, SetLumenThreshold, SetOrbit, SetZoom,
    Undo, Redo, AcceptNotice,
)  # fmt: skip
SERVER_MESSAGES = _by_type(ServerHello, Start, State, Tree, Route, Pose, Progress, Done, Error, Notice, Status)


def _parse(classes: dict[str, type[Any]], text: str | bytes, max_bytes: int) -> Any:
    fields = load_json_object(text, max_bytes=max_bytes)
    name = fields.pop("type", None)
    if not isinstance(name, str) or name not in classes:
        shown = repr(name)[:40] if isinstance(name, str) else "none"
        raise ProtocolError(f"a message has a type that is not known: {shown}", code="protocol.type")
    return decode_fields(classes[name], fields, name)


def parse_client_message(text: str | bytes, *, max_bytes: int = 262_144) -> Any:
    """One message of a client.

    Raises
    ------
    ProtocolError
        With a ``protocol.*`` code and one sentence.
    """
    message = _parse(CLIENT_MESSAGES, text, max_bytes)
    # What the schema cannot express: "exactly one of".
    if isinstance(message, ChooseRoute) and message.target_id is not None and message.branch_id is not None:
        raise ProtocolError("choose_route names a target and a branch; it may name one", code="protocol.choice")
    if isinstance(message, SetTransfer) and (message.preset is None) == (message.document is None):
        raise ProtocolError("set_transfer needs either a preset or a document", code="protocol.choice")
    if isinstance(message, Layout) and len({v.view for v in message.views}) != len(message.views):
        raise ProtocolError("layout names a view twice", code="protocol.choice")
    return message


def parse_server_message(text: str | bytes, *, max_bytes: int = 64 * 1024 * 1024) -> Any:
    """One text message of the server; for programs and tests."""
    return _parse(SERVER_MESSAGES, text, max_bytes)


def parse_picture(data: bytes) -> tuple[PictureHeader, bytes]:
    """One binary message: header and payload. The payload must begin as its codec does."""
    fields, payload = split_picture(data)
    header = decode_fields(PictureHeader, fields, "picture")
    magic = b"\xff\xd8\xff" if header.codec == "jpeg" else b"\x89PNG\r\n\x1a\n"
    if not payload.startswith(magic):
        raise ProtocolError(f"a picture's payload is no {header.codec.upper()}", code="protocol.picture")
    return header, payload


def encode_message(message: Any) -> str:
    """A message dataclass as JSON text."""
    return json.dumps(to_jsonable(message), allow_nan=False, separators=(",", ":"))
