"""What the server sends, and the header of a picture."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import Meta

from carina.case.routes import NeedleLine
from carina.commands.fields import (
    BranchId,
    Count,
    DemoName,
    Identifier,
    Matrix4,
    Mode,
    Numbers,
    Part,
    Pixels,
    PointLps,
    PointsLps,
    ViewName,
    Words,
)
from carina.commands.look import Look
from carina.commands.plan import TargetNote, TargetRank
from carina.commands.tree import AskedPath
from carina.render import ClusterState, DecorationName, Processor, Sight
from carina.scopes import ScopeHold
from carina.server.wire.codec import ServerMessage
from carina.server.wire.messages_of_devices import NetworkPage
from carina.session.scene.layer_lines import LayerName
from carina.session.state.snapshot import FlightPlace, SavingInfo
from carina.track import DrawnPart
from carina.value import FrozenValue
from carina.volume import Citation

Bytes = Annotated[int, Meta(ge=0, le=2**53)]
VoxelValue = Annotated[int, Meta(ge=-(2**15), le=2**15)]


class ServerHello(ServerMessage, frozen=True, tag="hello"):
    """Answer to the client's hello."""

    wire_version: Annotated[int, Meta(ge=0, le=2**31)]
    carina_version: Words
    watches: bool = False
    """This client may only watch: whatever changes more than its own sight is refused."""


class RecentCase(FrozenValue, frozen=True):
    """A case opened before, without the name of its CT's file."""

    recent_id: Identifier
    date: Identifier
    """ISO date of the last use."""
    title: Words
    """Name that its user gave, else the neutral alias, such as *Case K7M4QX*."""
    used_s: float | None = None
    """The same in seconds since 1970, where more than the day is known."""
    begun_s: float | None = None
    num_changes: Count | None = None
    """Null where nothing was kept of it but the place of its CT."""
    num_bytes: Bytes = 0
    """What it takes on the disk, without its CT."""
    picture: Words | None = None
    """Where its small picture is asked for: a JPEG of at most 320x240."""
    opens: bool = True
    """False where its CT is not to be had: it is to be dropped or chosen."""
    scanned_on: Identifier | None = None
    """ISO date of the scan, where its files say one. Only whoever works here is told it."""
    named: bool = False
    """Its title was given by a person."""


class Storage(FrozenValue, frozen=True):
    """What is kept on the disk beside the cases of the list."""

    num_cts: Count
    """Opened CTs that are kept to open faster."""
    ct_bytes: Bytes
    keeps_cts: Literal["on", "off", "never"]
    """Never: Carina was started so."""
    forgotten: tuple[RecentCase, ...]
    """These can be brought back for a day."""


class Demo(FrozenValue, frozen=True):
    """A bundled case."""

    name: DemoName
    title: Words
    words: Words
    citation: Citation | None


class Scope(FrozenValue, frozen=True):
    """An instrument of the library; null where nothing is known."""

    name: Identifier
    title: Words
    tip_mm: float
    """Outer diameter, as stated."""
    fit_mm: float
    """The lumen that it needs: true tips are thicker than stated, and some insertion tubes thicker than their tips."""
    channel_mm: float | None
    fov_deg: float | None
    view_up_deg: float
    """How far it looks up from its shaft."""


class Start(ServerMessage, frozen=True):
    """What the start page shows, and what there is to choose from."""

    notice_accepted: bool
    recent: tuple[RecentCase, ...]
    demos: tuple[Demo, ...]
    scopes: tuple[Scope, ...]
    storage: Storage | None = None


class OtherSeries(FrozenValue, frozen=True):
    """Another series of the folder."""

    key: Words
    modality: Words
    description: Words
    num_slices: Count
    refused: Words | None


class CaseNote(FrozenValue, frozen=True):
    """One thing that a person should know about the case, with its stable code."""

    code: Identifier
    words: Words
    badge: bool
    """It stays in sight for as long as the case is open."""


class FeatureOff(FrozenValue, frozen=True):
    """What this volume cannot do, and why."""

    what: Words
    why: Words


class CaseInfo(FrozenValue, frozen=True):
    """The open volume."""

    title: Words
    """Neutral alias of the case, such as *Case K7M4QX*; ``saving.title`` is the name that its user gave."""
    format: Words
    is_hu: bool
    not_hu_reason: Words | None
    shape_zyx: tuple[Count, Count, Count]
    spacing_mm: tuple[float, float, float]
    lps_from_ijk: Matrix4
    value_range: tuple[float, float]
    warnings: tuple[Words, ...]
    """The words of all notes."""
    notes: tuple[CaseNote, ...]
    quality: tuple[Words, ...]
    other_series: tuple[OtherSeries, ...]
    citation: Citation | None
    off: tuple[FeatureOff, ...]
    number: Count = 0
    """Grows with each case opened: two cases may be of one CT."""
    ct_name: Words | None = None
    """Name of the CT's file, or the text of its series. Only a window on the machine that runs Carina is sent it."""


class Target(AskedPath, frozen=True):
    """A target as asked and as used; ``problem`` says in words why there is no path."""

    target_id: Identifier
    name: Words
    lps: PointLps
    used_lps: PointLps | None
    snapped_mm: float | None
    length_mm: float | None
    problem: Words | None
    outside_mm: float | None = None
    """How much of that path lies outside the lumen; null where there is no lumen to compare with."""
    value_range: tuple[VoxelValue, VoxelValue] | None = None
    """Least and greatest value along that path, in the scan's own numbers."""
    note: TargetNote = ""
    priority: TargetRank = 1
    """1 comes first."""
    has_size: bool = False
    """It lies outside the airways: ``plans`` has its boundary and the routes to it."""


class MaskLabel(FrozenValue, frozen=True):
    """One structure of a mask of another tool."""

    number: Annotated[int, Meta(ge=-(2**53), le=2**53)]
    name: Words | None
    volume_ml: float


class MaskQuestion(FrozenValue, frozen=True):
    """What must be said of a mask before it can be taken as the airways; answered by ``answer_mask``."""

    title: Words
    """The file's name."""
    problem: Literal["label", "grid"]
    """It holds several structures, or it is on another grid than the scan."""
    labels: tuple[MaskLabel, ...]
    suggested: int | None
    """The label whose name says that it is the airway."""
    expected: Words | None
    """The scan's grid, in words."""
    found: Words | None
    share_inside: Part | None
    """How much of the structure lies in the scan."""


class State(ServerMessage, frozen=True):
    """All that is shown, but the pose, the tree and the route."""

    case: CaseInfo | None
    stage: Literal["empty", "opening", "ready"]
    """``opening``: pictures already come, the airways are being found."""
    airways: Literal["none", "waiting", "finding", "found", "failed"]
    airways_words: Words | None
    """Why there are none and what to do, or what was noted about them."""
    mode: Mode
    look: Look
    sight: Sight
    transfer: Words
    """Name of the transfer function."""
    transfer_document: dict[str, Any] | None
    transfer_presets: tuple[Words, ...]
    targets: tuple[Target, ...]
    route_id: Words | None
    can_undo: Words | None
    """Label of the change that undo takes back."""
    can_redo: Words | None
    root_lps: PointLps | None
    lumen_threshold: float | None
    frame_rate_hz: float
    """Airway pictures per second that are asked for while moving."""
    airways_from: Literal["search", "mask"] | None
    """Found in the CT, or a mask of another tool; null where there are none."""
    mask_question: MaskQuestion | None
    badges: tuple[CaseNote, ...]
    """The lasting notes of the case and of its airways: in sight for as long as it is open."""
    saving: SavingInfo = SavingInfo()


class RouteSpan(FrozenValue, frozen=True):
    """A branch along the route."""

    branch_id: BranchId
    name: Words | None
    generation: Annotated[int, Meta(ge=0, le=1000)]
    from_mm: float
    to_mm: float
    kind: Literal["tracked", "bridge", "manual"]
    """``manual`` was drawn by hand: the CT shows no airway there."""


class HistoryStep(FrozenValue, frozen=True):
    """Something that was done and can be taken back."""

    label: Words
    """What was done, in words."""
    at_s: float
    """When, in seconds since the case was begun (``saving.begun_s``)."""


class History(ServerMessage, frozen=True):
    """What was done, the oldest first, when it changed."""

    steps: tuple[HistoryStep, ...]
    step: int
    """How many of them hold; those after are taken back and can be done again. ``go_to_step`` changes it."""


class RouteInfo(DrawnPart, frozen=True, kw_only=True):
    """The way that is flown; lists are parallel, root to tip."""

    route_id: Identifier
    title: Words
    target_id: Identifier | None
    branch_id: BranchId | None
    points_lps: PointsLps
    cumulative_mm: Numbers
    generation: Annotated[tuple[Annotated[int, Meta(ge=0, le=1000)], ...], Meta(max_length=1_000_000)]
    radius_mm: Numbers
    """Of the circle with the area of the branch's section."""
    wall_mm: Numbers
    """Of the largest ball that fits there: what an instrument has."""
    forks_mm: Numbers
    lookouts_mm: Numbers
    """Where to stop for the forks: in front of them, with their openings in view. Strictly increasing."""
    spans: tuple[RouteSpan, ...]
    lumen_known: bool = True
    """False where there are no airways round it: the radii and walls are 0 and mean nothing."""
    needle: NeedleLine | None = None
    """How the way goes on through the wall; null where it ends in the airways."""


class Route(ServerMessage, frozen=True):
    """The route, when it changed."""

    route: RouteInfo | None


class HeldScope(ScopeHold, frozen=True):
    """A scope that is held by the lumen."""

    red_out: Part
    """0 for a clear view to 1 where the lens lies on the wall."""
    limit: Literal["none", "entry", "wall", "narrow", "length", "flexion"]
    """Why it did not go as far as asked."""
    needs_mm: float | None
    """The largest diameter that would pass, where the limit is ``narrow``."""
    tip_mm: float | None
    """Its own."""
    contact_mm: float | None
    """How much farther than the wall it is pushed; null where it does not touch."""
    num_contacts: Count
    contact_s: float


class Pose(ServerMessage, frozen=True):
    """The newest pose; pictures name the one they answer."""

    pose_id: Count
    lps_from_camera: Matrix4
    mode: Mode
    path_mm: float | None
    branch_id: BranchId | None
    branch_name: Words | None
    generation: Annotated[int, Meta(ge=0, le=1000)] | None
    lumen_mm: float | None
    """Diameter of the lumen here."""
    inside: bool
    """The tip is in the lumen (in the volume's box while there is no lumen)."""
    scope: HeldScope | None
    """In mode ``scope``."""
    key_frames_s: float | None
    """The time in the flight through the key frames; null once anything else has moved the tip."""
    flight: FlightPlace | None
    """The time in a recorded flight that is flown again; null once anything else has moved the tip."""
    by_device: bool
    """An input device moved the tip last."""


class Progress(ServerMessage, frozen=True):
    """A job's progress; fraction and time left are null where they cannot be known."""

    job_id: Identifier
    title: Words
    what: Words
    fraction: Part | None
    seconds_left: float | None


class Done(ServerMessage, frozen=True):
    """A job has ended; a failure comes as ``error`` too."""

    job_id: Identifier
    outcome: Literal["done", "cancelled", "failed"]


class Error(ServerMessage, frozen=True):
    """Something could not be done; stays until read."""

    code: Words
    message: Words
    action: Words | None
    """What to do next, or null where the message says it."""


class Notice(ServerMessage, frozen=True):
    """Something worth a line."""

    message: Words


class Watcher(FrozenValue, frozen=True):
    """Who watches."""

    number: Count
    address: Words
    since_s: float
    """Seconds since 1970."""


class WatchPage(NetworkPage, frozen=True, kw_only=True):
    """The page by which others of the local network watch, while it is open: they see the patient's pictures."""

    watchers: tuple[Watcher, ...]


class Watching(ServerMessage, frozen=True):
    """Who else may see the open case; never told to who watches."""

    page: WatchPage | None
    """Null while nobody may."""
    problem: Words | None
    """Why it cannot be opened on this machine."""


class Handled(ServerMessage, frozen=True):
    """So many of this window's commands have been done or refused, and what came of them at once has been told."""

    number: Count


class Value(ServerMessage, frozen=True):
    """Answer to ``probe``; only the newest is sent."""

    lps: PointLps
    """The point that was asked for."""
    voxel_value: Annotated[int, Meta(ge=-32_768, le=32_767)] | None
    """Of the voxel that it lies in: HU, or the file's numbers where the volume is not HU. Null outside the volume."""


class Picked(ServerMessage, frozen=True):
    """Answer to ``pick``: the wall under a pixel of an airway picture. All null where the ray meets no wall."""

    pick_id: Count
    lps: PointLps | None
    depth_mm: float | None
    """From the lens, along the ray."""
    voxel_value: Annotated[int, Meta(ge=-32_768, le=32_767)] | None
    branch_id: BranchId | None
    """The branch whose centreline is nearest; null without a tree."""
    branch_name: Words | None
    generation: Annotated[int, Meta(ge=0, le=1000)] | None


class Status(Processor, ServerMessage, frozen=True):
    """How the stream runs; twice a second while pictures go."""

    fps: float
    """Airway pictures sent per second, over the last second of movement."""
    render_ms: float
    age_ms: float
    """From a pose's arrival to its first picture being ready: the median of that second."""
    method: Words


class Cluster(ClusterState, ServerMessage, frozen=True):
    """The machines that render beside this one, once a second; only where there is a cluster."""


class PictureLines(FrozenValue, frozen=True):
    """Where the rows of a picture lie whose surface is curved: parallel lists over some of its rows, linear between.

    Pixel (column, row) is at ``start_lps + column * step_lps``, in corner coordinates of *this* picture.
    """

    row: Numbers
    """Corner coordinates, increasing: the middle of a picture's first row is 0.5."""
    start_lps: PointsLps
    step_lps: PointsLps
    path_mm: Numbers
    """Place on the route; where a row lies beyond it, the route's end."""
    path_column: Numbers
    """Where the route crosses the row."""
    mm_per_px: float


class PictureLens(FrozenValue, frozen=True):
    """A lens in front of this picture. A direction (x, y, z) in camera space falls on centre + focal * (x', y').

    ``brown``, with k1 k2 p1 p2 k3 k4 k5 k6, distorts (x/z, y/z); ``fisheye``, with k1 to k4, puts the angle a from the
    axis at a distance of a + k1 a^3 + k2 a^5 + k3 a^7 + k4 a^9.
    """

    model: Literal["brown", "fisheye"]
    coefficients: Annotated[tuple[float, ...], Meta(min_length=4, max_length=8)]
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    limit_rad: Annotated[float, Meta(ge=0.0, le=3.1416)]
    """Directions farther from the axis have no place in the picture."""


MAX_OUTLINE_BYTES = 4_194_304


class PictureOutline(FrozenValue, frozen=True):
    """The outline of the lumen in this picture: the last bytes of the message, after those of the picture.

    Line after line: u16 number of its points, then column and row of each, u16 little-endian, in sixteenths of a pixel
    of *this* picture (corner coordinates). A closed line ends where it begins.
    """

    num_bytes: Annotated[int, Meta(ge=0, le=MAX_OUTLINE_BYTES)]
    complete: bool
    """False where the lumen is so ragged that it is left out."""


class PictureLayer(PictureOutline, frozen=True):
    """The outline of one part of what was mapped round the targets, in this picture.

    Its bytes stand between the picture's and the outline's, in the order of the list, and have the outline's form; but
    their numbers are sixteenths of a unit of its own, so that every line is closed, however far the picture is zoomed.
    """

    layer: LayerName
    part: Identifier
    """*sure* or *unsure* of vessels and of reach, where *unsure* encloses *sure*; *seen*; or the name of a lobe."""
    pixel_from_line: Annotated[tuple[float, ...], Meta(min_length=6, max_length=6)]
    """From these units to columns and rows of this picture, in the order of a canvas's ``transform``."""


class PictureHeader(FrozenValue, frozen=True):
    """Header of a binary message; the payload follows."""

    frame_id: Count
    view: ViewName
    """What it shows."""
    stands_for: ViewName | None
    """Where it is shown instead: the cut-plane is the view finder while the airway view is too slow (paper 3.1)."""
    pose_id: Count
    lps_from_camera: Matrix4 | None
    """Camera of a perspective view."""
    fov_deg: float | None
    lens: PictureLens | None
    """Where the lens is no pinhole of this field of view."""
    lps_from_pixel: Matrix4 | None
    """Planar view: (column, row, 0, 1) in corner coordinates of *this* picture (centre = +0.5) to LPS."""
    lines: PictureLines | None
    """View along the route."""
    outline: PictureOutline | None
    """Slices and the cut-plane, once there is a lumen: the current one. Of a thick slice its middle plane."""
    width: Pixels
    height: Pixels
    step_vox: float | None
    """Ray step of an airway view, in units of the smallest spacing; coarser than 0.5 only where fewer pixels alone do
    not make the picture quick enough."""
    codec: Literal["jpeg", "png"]
    quality: Annotated[int, Meta(ge=1, le=100)]
    full: bool
    """Final quality for this state; false while moving, and while another lumen or transfer function is on its way."""
    empty: bool
    """An airway view without anything in it: the tip looks out of the CT."""
    decorated: tuple[DecorationName, ...]
    """What of an airway view is decoration and not the patient's; empty where nothing is."""
    render_ms: float
    method: Words
    layers: Annotated[tuple[PictureLayer, ...], Meta(max_length=32)] = ()
    """Slices and the cut-plane: what was mapped round the targets, as far as the window wants it (``set_layers``)."""
