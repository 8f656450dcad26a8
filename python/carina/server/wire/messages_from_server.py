"""Messages from the server to a window, and the header of an image message."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from msgspec import Meta

from carina.case.routes import NeedleLine, RouteSpan
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
    ProcessorName,
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
from carina.server.wire.messages_of_plan import RouteOrigin
from carina.session.scene.layer_lines import LayerName
from carina.session.state.grey_scale import FeatureOff
from carina.session.state.snapshot import BreathingInfo, FlightPlace, MaskQuestion, SavingInfo
from carina.track import DrawnPart
from carina.value import FrozenValue
from carina.volume import Citation

Bytes = Annotated[int, Meta(ge=0, le=2**53)]
VoxelValue = Annotated[int, Meta(ge=-(2**15), le=2**15)]


class ServerHello(ServerMessage, frozen=True, tag="hello"):
    """Answer to the client's ``hello``."""

    wire_version: Annotated[int, Meta(ge=0, le=2**31)]
    carina_version: Words
    watches: bool = False
    """Whether the client is an observer: the server refuses all commands except those for the client's own view."""
    window: Count = 0
    """Number of the client's window. A client names it when it requests pictures of its views as files."""
    at_machine: bool = False
    """Whether the client's browser is on the machine that runs Carina; only there can a PACS be used."""


class CaseListEntry(FrozenValue, frozen=True):
    """An entry of the case list: a case that was opened before, without the name of its CT file."""

    wire_name: ClassVar[str] = "RecentCase"

    recent_id: Identifier
    date: Identifier
    """ISO date of the last use."""
    title: Words
    """Name that the user gave to the case, else its neutral alias, such as *Case K7M4QX*."""
    used_s: float | None = None
    """Time of the last use in seconds since 1970; null if only the day is known."""
    begun_s: float | None = None
    """Time when the case was begun, in seconds since 1970."""
    num_changes: Count | None = None
    """Number of changes; null if only the path of the CT is stored."""
    num_nodules: Count | None = None
    """Number of targets whose size is known; null if this number is not known."""
    num_bytes: Bytes = 0
    """Size of the stored case on the disk, without its CT."""
    picture: Words | None = None
    """URL of the thumbnail, a JPEG of at most 320x240 pixels; null if the case has none."""
    opens: bool = True
    """Whether the CT of the case is available; if not, the user must drop or choose the file."""
    scanned_on: Identifier | None = None
    """ISO date of the scan, if its files contain one; observers receive no case list."""
    named: bool = False
    """Whether the user has given the case a name; otherwise the title is its neutral alias."""


class Storage(FrozenValue, frozen=True):
    """Data stored on the disk besides the cases of the case list."""

    num_cts: Count
    """Number of CTs that are stored in the cache, from which they open faster."""
    ct_bytes: Bytes
    keeps_cts: Literal["on", "off", "never"]
    """State of the CT cache; *never*: Carina was started without the cache."""
    forgotten: tuple[CaseListEntry, ...]
    """Forgotten cases, which the user can restore for one day."""


class Demo(FrozenValue, frozen=True):
    """A demonstration case that is part of Carina."""

    name: DemoName
    title: Words
    words: Words
    citation: Citation | None


class Scope(FrozenValue, frozen=True):
    """An instrument of the library; a field is null if its value is not known."""

    name: Identifier
    title: Words
    tip_mm: float
    """Outer diameter of the tip in mm, as the data sheet states it."""
    fit_mm: float
    """Diameter in mm of the lumen that the scope needs.

    It exceeds the stated diameter: true tips are thicker than stated, and some insertion tubes thicker than their tips.
    """
    channel_mm: float | None
    fov_deg: float | None
    view_up_deg: float
    """Angle in degrees between the direction of view and the shaft, upwards."""


class Start(ServerMessage, frozen=True):
    """Content of the start page: cases, demonstration cases, instruments and storage."""

    notice_accepted: bool
    recent: tuple[CaseListEntry, ...]
    demos: tuple[Demo, ...]
    scopes: tuple[Scope, ...]
    storage: Storage | None = None
    no_video: Words | None = None
    """Reason why this installation saves no videos, with the command that changes it; None if it does."""
    hints_read: bool = True
    """Whether the user has read the hints of the first minute, which a window shows once."""


class OtherSeries(FrozenValue, frozen=True):
    """A series in the folder of the open series: another one, or the open series itself."""

    key: Words
    modality: Words
    description: Words
    num_slices: Count
    refused: Words | None
    """Reason why the series cannot be opened; null if it can."""
    slice_distance_mm: float | None = None
    thickness_mm: float | None = None
    kernel: Words = ""
    phase: Words = ""
    acquired_on: Words | None = None
    """ISO date of the scan; sent only to windows on the machine that runs Carina, else null."""
    likeliest: Words = ""
    """Why this series is the likeliest chest CT of its folder; empty for every other series."""


class SeriesPictureMessage(ServerMessage, frozen=True):
    """Picture of a series of the open CT's folder, or of a folder that is being opened: its middle slice."""

    key: Words
    """Key of the series: that of the open series, ``case.other_series[].key``, or ``opening.series[].key``."""
    picture: Annotated[str, Meta(max_length=100_000)]
    """PNG in base64, at most 96 pixels wide and high."""
    list_id: Identifier | None = None
    """List of the opening that contains the series; null for the folder of the open CT."""


class OpeningSlice(FrozenValue, frozen=True):
    """An axial slice of a CT that is being opened, with the patient's right on the left of the picture."""

    picture: Annotated[str, Meta(max_length=400_000)]
    """Grey PNG in base64, at most 256 pixels wide and high."""
    number: Count
    """Number of the slice, from 1 to ``num_slices``."""
    num_slices: Count
    height_lps_mm: float
    """Position of the centre of the slice along the axis to the head, LPS mm."""
    width_mm: float
    height_mm: float
    is_hu: bool
    """Whether the picture shows HU in the lung window (1500/-600); otherwise the grey range is that of the slice."""


class OpeningMessage(ServerMessage, frozen=True):
    """Preview of the CT that a job is opening; ``job_id`` is null at the end, after an error and after a cancel."""

    job_id: Identifier | None
    list_id: Identifier | None = None
    """ID of the list of series; it stays if another series of the same list is opened instead."""
    series: tuple[OtherSeries, ...] = ()
    """All series of the folder or archive, the likeliest chest CT first; ``open_series`` opens another one."""
    chosen: Words | None = None
    """Key of the series that is being opened."""
    num_patients: Count = 1
    """Number of patients whose images the folder contains."""
    slice: OpeningSlice | None = None
    """A slice near the middle; null if the slices are not axial or the slice cannot be decoded without doubts."""


class CaseNote(FrozenValue, frozen=True):
    """A note to the user about the case, with a code that does not change between versions."""

    code: Identifier
    words: Words
    badge: bool
    """Whether the note is a badge: visible while the case is open."""


class CtPropertyInfo(FrozenValue, frozen=True):
    """A property of the CT that decides which airways can be seen in it, such as noise or coverage."""

    name: Words
    text: Words
    limits: bool
    """Whether the property limits the airway search."""


class CtStatement(FrozenValue, frozen=True):
    """Statement on the CT: its properties, and the generation up to which airways can be trusted."""

    properties: tuple[CtPropertyInfo, ...]
    trusted_generation: Count
    trusted_words: Words


class CaseInfo(FrozenValue, frozen=True):
    """The open volume and its properties."""

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
    """Texts of all notes."""
    notes: tuple[CaseNote, ...]
    quality: tuple[Words, ...]
    other_series: tuple[OtherSeries, ...]
    citation: Citation | None
    off: tuple[FeatureOff, ...]
    number: Count = 0
    """Number that increases with each opened case; it distinguishes two cases of one CT."""
    interpolated_slices: tuple[Count, ...] = ()
    """Indices k of slices that were missing in the files and were interpolated."""
    tilt_deg: float | None = None
    """Gantry tilt in degrees that was corrected; null for a scan without tilt."""
    slice_places: tuple[float, ...] = ()
    """Position of each slice of the files as an index k, which may be a fraction; empty without a correction."""
    statement: CtStatement | None = None
    """What limits the airways that can be seen in the CT; null until it is known, and without HU."""
    series: OtherSeries | None = None
    """The open series; null if the CT is not a DICOM series."""
    ct_name: Words | None = None
    """Name of the CT file or text of its series; sent only to windows on the machine that runs Carina, else null."""


class TargetInfo(AskedPath, frozen=True):
    """A target with the requested point, the point that is used, and the path to that point."""

    wire_name: ClassVar[str] = "Target"

    target_id: Identifier
    name: Words
    lps: PointLps
    """Point that the client requested, LPS mm."""
    used_lps: PointLps | None
    """End point of the path, which may differ from the requested point, LPS mm; null without a path."""
    snapped_mm: float | None
    """Distance in mm between the requested point and the point that is used."""
    length_mm: float | None
    """Length of the path in mm; null without a path."""
    problem: Words | None
    """Reason why there is no path; null if there is one."""
    outside_mm: float | None = None
    """Length in mm of the path outside the lumen; null without a lumen."""
    crossings_mm: tuple[float, ...] | None = None
    """Distances in mm from the start at which the path leaves the lumen or returns into it; null without a lumen."""
    value_range: tuple[VoxelValue, VoxelValue] | None = None
    """Smallest and largest voxel value along the path, in the units of the scan's file."""
    note: TargetNote = ""
    priority: TargetRank = 1
    """Rank of the target; 1 is first."""
    has_size: bool = False
    """Whether the target is a lesion with a boundary; the message ``plans`` contains the boundary and the routes."""
    from_carina_mm: float | None = None
    """Distance in mm of the end of the path from the main carina, as in plans and the path bar.

    Null if the path does not pass the main carina. A path by the cost ``lumen`` is measured along the centrelines, any
    other path along itself.
    """


class State(ServerMessage, frozen=True):
    """State of the session, except for pose, tree, route and the other parts that have their own messages."""

    case: CaseInfo | None
    stage: Literal["empty", "opening", "ready"]
    """``opening``: the server already sends images while it searches for the airways."""
    airways: Literal["none", "waiting", "finding", "found", "failed"]
    airways_words: Words | None
    """Reason why there are no airways and what the user can do, or notes about the airways."""
    mode: Mode
    look: Look
    sight: Sight
    transfer: Words
    """Name of the transfer function that the renderer uses."""
    transfer_document: dict[str, Any] | None
    transfer_presets: tuple[Words, ...]
    targets: tuple[TargetInfo, ...]
    route_id: Words | None
    can_undo: Words | None
    """Label of the change that the next undo reverts; null if there is none."""
    can_redo: Words | None
    """Label of the change that the next redo repeats; null if there is none."""
    root_lps: PointLps | None
    lumen_threshold: float | None
    frame_rate_hz: float
    """Maximum rate of airway images while the tip moves, in images per second."""
    airways_from: Literal["search", "mask"] | None
    """Origin of the airways: the search in the CT, or an imported mask; null without airways."""
    mask_question: MaskQuestion | None
    badges: tuple[CaseNote, ...]
    """Notes on the case and its airways that stay visible while the case is open."""
    saving: SavingInfo = SavingInfo()
    breathing: BreathingInfo = BreathingInfo()


class HistoryStep(FrozenValue, frozen=True):
    """A step of the undo history."""

    label: Words
    """Text that names the change, such as in *undo (text)*."""
    at_s: float
    """Time in seconds since the case was begun (``saving.begun_s``)."""


class HistoryMessage(ServerMessage, frozen=True):
    """Undo history, the oldest step first; sent after each change."""

    steps: tuple[HistoryStep, ...]
    step: int
    """Number of steps in effect; the later steps are undone and can be redone. ``go_to_step`` changes the number."""


class ScopeFit(FrozenValue, frozen=True):
    """Whether an instrument passes the narrowest measured place of a route."""

    scope: Identifier
    fit: Literal["fits", "may fit", "does not fit"]


class RouteInfo(DrawnPart, frozen=True, kw_only=True):
    """The current route; its point lists are parallel and go from the root to the tip."""

    route_id: Identifier
    title: Words
    target_id: Identifier | None
    branch_id: BranchId | None
    points_lps: PointsLps
    cumulative_mm: Numbers
    """Distance in mm of each point from the root, along the route."""
    generation: Annotated[tuple[Annotated[int, Meta(ge=0, le=1000)], ...], Meta(max_length=1_000_000)]
    radius_mm: Numbers
    """Radius in mm of the circle that has the area of the branch's cross-section, at each point."""
    wall_mm: Numbers
    """Radius in mm of the largest ball that fits into the lumen: the space for an instrument."""
    forks_mm: Numbers
    """Positions of the forks, in mm along the route."""
    lookouts_mm: Numbers
    """Positions in mm along the route at which to stop before each fork, with the openings of the fork in view.

    Strictly increasing.
    """
    spans: tuple[RouteSpan, ...]
    lumen_known: bool = True
    """Whether the airways along the route are known; if not, ``radius_mm`` and ``wall_mm`` are 0 without meaning."""
    needle: NeedleLine | None = None
    """Continuation of the route through the wall; null if the route ends in the airways."""
    narrowest_mm: float | None = None
    """Narrowest measured diameter of the route in mm, as in plans; null until the airways are measured.

    Parts of the route that could not be measured are not included.
    """
    narrowest_error_mm: float | None = None
    """Half-width in mm of the interval that should contain the true diameter in 90 of 100 cases."""
    narrowest_at_mm: float | None = None
    """Position of the narrowest place, in mm along the route."""
    scope_fits: tuple[ScopeFit, ...] = ()
    """Whether each instrument passes ``narrowest_mm`` within its error, as in plans; empty until it is measured."""
    origin: RouteOrigin = RouteOrigin("root", 0.0)
    """Origin of the distances that the window shows, as in the plan and its report."""
    centreline_mm: Numbers = ()
    """Distance in mm of each point from the start of the airway tree, along the centrelines.

    ``origin.along_mm`` and the distances of plans are measured in the same way. The route itself is smoothed and
    therefore shorter. For a path that was not searched in the airways, the distances equal ``cumulative_mm``.
    """


class RouteMessage(ServerMessage, frozen=True):
    """The current route; sent after each change."""

    route: RouteInfo | None


class HeldScope(ScopeHold, frozen=True):
    """A scope whose position the lumen limits: controls and contacts."""

    red_out: Part
    """Loss of the view by contact: 0 for a clear view to 1 if the lens touches the wall."""
    limit: Literal["none", "entry", "wall", "narrow", "length", "flexion"]
    """Reason why the scope did not reach the commanded position."""
    needs_mm: float | None
    """Largest diameter in mm that would pass, if the limit is ``narrow``, else null."""
    tip_mm: float | None
    """Outer diameter of the scope's tip in mm."""
    contact_mm: float | None
    """Distance in mm by which the commanded tip exceeds the position that the wall permits; null without contact."""
    num_contacts: Count
    """Number of contacts of the tip with the wall since the scope was placed."""
    contact_s: float
    """Total time of these contacts in s."""


class PoseMessage(ServerMessage, frozen=True):
    """The newest pose; each image names its pose by ``pose_id``."""

    pose_id: Count
    lps_from_camera: Matrix4
    mode: Mode
    path_mm: float | None
    """Position of the tip in mm along the route; null if the tip is not on a route."""
    branch_id: BranchId | None
    branch_name: Words | None
    generation: Annotated[int, Meta(ge=0, le=1000)] | None
    lumen_mm: float | None
    """Diameter of the lumen at the tip, in mm."""
    inside: bool
    """Whether the tip is inside the lumen; without a lumen, whether the tip is inside the volume."""
    scope: HeldScope | None
    """State of the scope in mode ``scope``, else null."""
    key_frames_s: float | None
    """Time in s of the tip in the flight through the key frames; null if another cause moved the tip last."""
    flight: FlightPlace | None
    """Position of the tip in a recorded flight that is replayed; null if another cause moved the tip last."""
    by_device: bool
    """Whether an input device moved the tip last."""
    back_to_route_mm: float | None = None
    """Distance in mm along the centrelines back to the fork where the tip left the route, in mode ``scope``; null
    otherwise."""


class Progress(ServerMessage, frozen=True):
    """Progress of a job; the fraction and the remaining time are null if they are not known."""

    job_id: Identifier
    title: Words
    what: Words
    fraction: Part | None
    seconds_left: float | None


class Done(ServerMessage, frozen=True):
    """Report that a job has ended; after a failure the server also sends ``error``."""

    job_id: Identifier
    outcome: Literal["done", "cancelled", "failed"]


class Error(ServerMessage, frozen=True):
    """Report that an operation failed; the window shows it until the user dismisses it."""

    code: Words
    message: Words
    action: Words | None
    """Advice on what to do next; null if the message contains the advice."""


class Notice(ServerMessage, frozen=True):
    """A short message for the user that reports no error."""

    message: Words


class Watcher(FrozenValue, frozen=True):
    """An observer of the case."""

    number: Count
    address: Words
    since_s: float
    """Start of the connection, in seconds since 1970."""


class WatchPage(NetworkPage, frozen=True, kw_only=True):
    """The observer page, through which people on the local network see the images of the patient."""

    watchers: tuple[Watcher, ...]
    learners: bool = False
    """Whether observers receive the learners of the training."""


class Watching(ServerMessage, frozen=True):
    """State of the observer page; never sent to observers."""

    page: WatchPage | None
    """The observer page; null while the page is closed."""
    problem: Words | None
    """Reason why the page cannot be opened on this machine."""


class ProcessorChoice(ServerMessage, frozen=True):
    """Processor of airway views that the user has chosen; never sent to observers."""

    choice: ProcessorName
    is_forced: bool
    """Whether the environment variable ``CARINA_BACKEND`` decides, so that ``set_processor`` is refused."""
    has_graphics: bool
    """Whether this build can render on a graphics device."""
    problem: Words | None
    """Reason why the CPU renders although a graphics device was in use or is chosen."""


class Handled(ServerMessage, frozen=True):
    """Number of commands of this window that were executed or refused; sent after the state that they changed."""

    number: Count


class Value(ServerMessage, frozen=True):
    """Answer to ``probe``; the server answers only the newest request."""

    lps: PointLps
    """Point for which the measurement was requested, LPS mm."""
    voxel_value: Annotated[int, Meta(ge=-32_768, le=32_767)] | None
    """Value of the voxel at the point: HU, or the file's values if the volume is not in HU; null outside the volume."""


class Picked(ServerMessage, frozen=True):
    """Answer to ``pick``: the wall under a pixel of an airway image; all fields are null if the ray hits no wall."""

    pick_id: Count
    lps: PointLps | None
    depth_mm: float | None
    """Distance in mm from the lens along the ray."""
    voxel_value: Annotated[int, Meta(ge=-32_768, le=32_767)] | None
    branch_id: BranchId | None
    """Branch with the nearest centreline; null without a tree."""
    branch_name: Words | None
    generation: Annotated[int, Meta(ge=0, le=1000)] | None


class Status(Processor, ServerMessage, frozen=True):
    """Performance of the image stream; sent twice a second while the tip moves, and once after it stops."""

    fps: float
    """Airway images per second, over the last second of movement."""
    render_ms: float
    """Rendering time of the last image in ms."""
    age_ms: float
    """Median time in ms from the arrival of a pose until its first image is ready, over the same second."""
    method: Words


class Cluster(ClusterState, ServerMessage, frozen=True):
    """State of the render cluster; sent once a second if there is a cluster."""


class PictureLineRows(FrozenValue, frozen=True):
    """Geometry of an image of a curved surface: parallel lists over selected rows, to be interpolated linearly.

    Pixel (column, row) is at ``start_lps + column * step_lps``, in corner coordinates of *this* image.
    """

    wire_name: ClassVar[str] = "PictureLines"

    row: Numbers
    """Selected rows in corner coordinates, increasing: the middle of the first row of an image is 0.5."""
    start_lps: PointsLps
    step_lps: PointsLps
    path_mm: Numbers
    """Position of each row in mm along the route; the end of the route for a row beyond that end."""
    path_column: Numbers
    """Column at which the route crosses the row."""
    mm_per_px: float


class PictureLens(FrozenValue, frozen=True):
    """Lens model of this image: a direction (x, y, z) in camera space maps to centre + focal * (x', y').

    ``brown``, with k1 k2 p1 p2 k3 k4 k5 k6, distorts (x/z, y/z); ``fisheye``, with k1 to k4, puts the angle a from the
    axis at a distance of a + k1 a^3 + k2 a^5 + k3 a^7 + k4 a^9.
    """

    model: Literal["brown", "fisheye"]
    coefficients: Annotated[tuple[float, ...], Meta(min_length=4, max_length=8)]
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    limit_rad: Annotated[float, Meta(ge=0.0, le=3.1416)]
    """Largest angle from the axis that the image shows, in rad."""


MAX_OUTLINE_BYTES = 4_194_304


class PictureOutline(FrozenValue, frozen=True):
    """The outline of the lumen in this image, encoded in the last bytes of the message, after the image data.

    Each line is encoded as the number of its points (u16), then column and row of each point, u16 little-endian, in
    sixteenths of a pixel of *this* image (corner coordinates). The last point of a closed line equals its first point.
    """

    num_bytes: Annotated[int, Meta(ge=0, le=MAX_OUTLINE_BYTES)]
    complete: bool
    """Whether the outline is sent; false if the lumen is too irregular for an outline."""


class PictureLayer(PictureOutline, frozen=True):
    """The outline of one part of a layer (vessels, fissures, lobes, reach) in this image.

    The bytes of the layers are between the image data and the lumen outline, in the order of the list, and are encoded
    like the outline. Their coordinates are sixteenths of a unit of the layer, which does not depend on the zoom, so
    that every line is closed.
    """

    layer: LayerName
    part: Identifier
    """*sure* or *unsure* (which encloses *sure*) for vessels and reach, *seen* for fissures, or the name of a lobe."""
    pixel_from_line: Annotated[tuple[float, ...], Meta(min_length=6, max_length=6)]
    """Affine map from outline units to columns and rows of this image, in the order of a canvas's ``transform``."""


class PictureHeader(FrozenValue, frozen=True):
    """Header of a binary image message; the payload follows the header."""

    frame_id: Count
    view: ViewName
    """View that the image shows."""
    stands_for: ViewName | None
    """View in whose place the image is shown, else null.

    The cut-plane is the view finder while the airway view is too slow (paper 3.1).
    """
    pose_id: Count
    lps_from_camera: Matrix4 | None
    """Matrix of a perspective view from camera space to the CT at rest, mm, else null.

    It is rigid, except for an airway view whose patient a simulated breathing has moved: it is then affine.
    """
    fov_deg: float | None
    lens: PictureLens | None
    """Lens model; null for a pinhole camera with this field of view."""
    lps_from_pixel: Matrix4 | None
    """Matrix of a planar view from (column, row, 0, 1) to LPS mm, else null.

    Columns and rows are corner coordinates of *this* image (the centre of a pixel is at +0.5).
    """
    lines: PictureLineRows | None
    """Positions of the rows of a curved reformation along the route; null for other views."""
    outline: PictureOutline | None
    """Outline of the current lumen in slices and in the cut-plane (in the middle plane of a thick slice), else null."""
    width: Pixels
    height: Pixels
    step_vox: float | None
    """Ray step of an airway view, in units of the smallest spacing, else null.

    The step is coarser than 0.5 only if a smaller image alone does not make rendering fast enough.
    """
    codec: Literal["jpeg", "png"]
    quality: Annotated[int, Meta(ge=1, le=100)]
    full: bool
    """Whether the image has final quality for the present state.

    False during movement, and while a new lumen or transfer function is being computed.
    """
    empty: bool
    """Whether an airway view is empty, because the tip looks out of the CT."""
    decorated: tuple[DecorationName, ...]
    """Names of the effects in an airway view that are decoration and not data of the patient."""
    render_ms: float
    method: Words
    layers: Annotated[tuple[PictureLayer, ...], Meta(max_length=32)] = ()
    """Layers in slices and in the cut-plane that the window has selected with ``set_layers``."""
    breathes: bool = False
    """Whether an airway view shows a simulated breathing, which the window states in the picture."""
