"""Table of the views: one row for each view, read by the renderer, the command line and the web client.

To add a view, add a row to this table and the code that renders the view. Window layout, key card, overlays, gestures,
frame rates, command line and web client (``web/src/wire/views.ts`` is generated from this table) read the row; see
docs/decisions/0102.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

import msgspec

from carina.display import one_line
from carina.errors import UsageError
from carina.render.view_settings import ViewSettings
from carina.render.view_values import Orbit
from carina.render.views import (
    WINDOW_HU,
    AirwayView,
    CutPlaneView,
    DrrView,
    PathView,
    SliceView,
    TreeView,
    TriPlaneView,
    View,
    XrayView,
)
from carina.volume.anatomical_planes import PLANES, Plane

ViewName = Literal[
    "airway",
    "cut-plane",
    "tri-plane",
    "xray-axial",
    "xray-coronal",
    "xray-sagittal",
    "drr",
    Plane,
    "straightened",
    "curved",
    "tree",
]
FlatViewName = Literal[Plane, "cut-plane"]
"""Names of the views that are zoomed and panned in their own plane."""
OrbitViewName = Literal["tree", "tri-plane"]
"""Names of the views whose camera orbits the displayed object."""
LEAD_VIEW: Literal["airway"] = "airway"
"""Name of the view from the scope's tip, which keeps its frame rate; other views share the remaining time."""
FINDER_VIEW: Literal["cut-plane"] = "cut-plane"
"""Name of the view that replaces :data:`LEAD_VIEW` where the airway view cannot be rendered in time."""
CellName = Literal["airway", Plane, "cut-plane", "xray", "outside"]
Need = Literal["airways", "route"]
ON_ITS_WAY = "Rendering this view…"


@one_line
@dataclass(frozen=True, slots=True)
class Cell:
    """A cell of the window's layout; it shows one of the views whose row names this cell, in the table's order."""

    name: CellName
    chosen_by: Literal["none", "step", "list"] = "none"
    """Control that chooses the cell's view: none, a button for the next view, or one button for each view."""
    next_action: str = ""
    """Keyboard action that switches the cell to its next view."""
    list_name: str = ""
    all_when_wide: bool = False
    """Whether a wide window shows all views of the cell at once, each in a separate cell."""
    side_by_side: tuple[ViewName, ...] = ()
    """Views that the cell can show together in full view, from left to right; empty without such a set."""


CELLS: Mapping[CellName, Cell] = MappingProxyType(
    {
        cell.name: cell
        for cell in (
            Cell("airway"),
            *(Cell(plane) for plane in PLANES),
            Cell("cut-plane", "step", "next_cut"),
            Cell(
                "xray",
                "list",
                "next_xray",
                "X-ray projection",
                side_by_side=("xray-coronal", "xray-sagittal", "xray-axial"),
            ),
            Cell("outside", "step", "swap_outside", all_when_wide=True),
        )
    }
)


@one_line
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViewRow:
    """Properties of one view: title, need of a path or a lumen, overlays, and reaction to the mouse."""

    name: ViewName
    title: str
    """Title above the picture."""
    short: str = ""
    """Label of the view's button in a cell that lists its views."""
    words: str
    """Short description of the view, worded for use in the middle of a sentence."""
    empty: str = ON_ITS_WAY
    """Text that the cell shows instead of a picture: the view's missing input, or that rendering is in progress."""
    cell: CellName
    spec: Callable[[ViewSettings], View]
    """Function that makes the renderer's view definition from the settings."""
    depends_on: Callable[[ViewSettings], tuple[Hashable, ...]]
    """Function that returns the settings on which the picture depends; equal values give equal pictures."""
    needs: frozenset[Need] = frozenset()
    """Data without which the view cannot be rendered."""
    overlay: Literal["airway", "flat", "seen", "lines"]
    """Projection of overlays: through the lens, in a plane, through an orbit camera, or along a path."""
    pick: Literal["wall", "plane", "planes", "branch", "path"] | None = None
    """Object that a click in the view selects, or None for a view whose picture has no depth.

    It is a point of the wall, of the plane, of the plane under the cursor, of a branch, or of the surface through the
    path. The brush works only in a plane.
    """
    zoom: Literal["tip", "slice", "extent", "path", "carm", "orbit"] | None = None
    """Object that the wheel, dragging and the keys move in this view (tip, slice or camera, for example), or None.

    It is the tip, the slice stack (with its scale in mm per pixel), the extent of the plane, the reformation, the C-arm
    or the orbit camera.
    """
    plane: Plane | None = None
    """Anatomical plane that the view shows; None for a view in no anatomical plane."""
    slab: Literal["window", "call"] | None = None
    """Source of the slab thickness: the window's setting, or only a call's argument; None for views without a slab."""
    windowed: bool = False
    """Whether the grey window of the slices (width and level in HU) applies to the view."""
    outlined: bool = False
    """Whether the outline of the lumen is drawn over the view."""
    by_transfer: bool = False
    """Whether the picture depends on the renderer's transfer function and lumen."""
    costly: bool = False
    """Whether the view casts perspective rays (first picture coarse); other views take milliseconds."""
    at_tip: bool = False
    """Whether the view moves with the tip even while a crosshair fixes the slices."""
    inside: bool = False
    """Whether the view is a plane through the tip, which shows nothing while the tip is outside the volume."""
    wants_tip: bool = True
    """Whether the view needs a pose (default: the top of the trachea) or shows the whole volume or path."""
    marks_tip: bool = False
    """Whether the command line marks the tip in pictures of this view."""
    lettered: bool = False
    """Whether the command line writes orientation letters at the edges of pictures of this view."""
    scaled: bool = False
    """Whether the picture has one scale in mm, which a scale bar or the axis of the path can show."""
    named: bool = False
    """Whether names of branches can be written into saved pictures of this view."""
    straight: bool = False
    """Whether the path is a straight vertical line, with the radius of the lumen marked on both sides."""
    orbit: Orbit | None = None
    """Initial position of the orbit camera."""
    max_px: int = 768
    """Longest side of a picture in the window, pixels; smaller views gain nothing visible from more."""


def _grey_settings(s: ViewSettings) -> tuple[float, float]:
    return WINDOW_HU if s.window_hu is None else s.window_hu


def _in_hundredths_mm(point: tuple[float, float, float]) -> tuple[float, ...]:
    # Rounding to far less than a pixel: a mere rotation of the scope does not render new slices.
    return tuple(round(v, 2) for v in point)


# ------------------------------------------------------------------ airway view


def _airway(s: ViewSettings) -> View:
    settings: dict[str, Any] = {
        "fov_deg": s.fov_deg,
        "width": s.width,
        "height": s.height,
        "step_vox": s.step_vox,
        "shading": s.sight.shading,
        "texture": s.sight.texture,
        "method": s.sight.method,
        "field": s.field,
        "depth_of_field": s.depth_of_field,
        **({} if s.lens is None else {"lens": s.lens}),
    }
    if s.scope is None:
        return AirwayView(s.pose, **settings)
    return AirwayView.of_scope(s.scope, s.pose, picture_turned=s.picture_turned, **settings)


def _airway_depends(s: ViewSettings) -> tuple[Hashable, ...]:
    scope = None if s.scope is None else s.scope.name
    return (s.pose_id, scope, s.field.outline, s.fov_deg, s.sight.shading, s.sight.texture, s.sight.method)


# ------------------------------------------------------------------ planes


def _cut_plane(s: ViewSettings) -> View:
    place = s.sight.place("cut-plane")
    return CutPlaneView(
        s.pose,
        width=s.width,
        height=s.height,
        extent_mm=60.0 if place.extent_mm is None else place.extent_mm,
        window_hu=_grey_settings(s),
        slab=s.slab,
        centre_lps=place.centre_lps,
    )


def _slice_row(plane: Plane) -> ViewRow:
    axis = PLANES[plane].normal_axis

    def centre(s: ViewSettings) -> tuple[float, float, float]:
        """Return the centre of a zoomed slice, moved along the slice's normal to the displayed point's depth."""
        place = s.sight.place(plane)
        if place.mm_per_px is None or place.centre_lps is None:
            return s.point_lps
        x, y, z = (s.point_lps[n] if n == axis else place.centre_lps[n] for n in range(3))
        return x, y, z

    def depends(s: ViewSettings) -> tuple[Hashable, ...]:
        mm_per_px = s.sight.place(plane).mm_per_px
        if mm_per_px is None:
            # An unzoomed slice shows the whole plane, so only its depth matters.
            return (_in_hundredths_mm(s.point_lps)[axis], s.window_hu, s.slab)
        return (_in_hundredths_mm(centre(s)), s.window_hu, mm_per_px, s.slab)

    return ViewRow(
        name=plane,
        title=plane.capitalize(),
        words=f"{plane} slice",
        empty=f"The {plane} slice through the tip appears here when a CT is open.",
        cell=plane,
        spec=lambda s: SliceView(
            plane=plane,
            centre_lps=centre(s),
            width=s.width,
            height=s.height,
            mm_per_px=s.pixel_mm(s.sight.place(plane).mm_per_px),
            window_hu=_grey_settings(s),
            slab=s.slab,
        ),
        depends_on=depends,
        overlay="flat",
        pick="plane",
        zoom="slice",
        plane=plane,
        slab="window",
        windowed=True,
        outlined=True,
        inside=True,
        marks_tip=True,
        scaled=True,
        named=True,
    )


# ------------------------------------------------------------------ X-ray projections and radiographs


def _xray_row(name: ViewName, axis: Plane, short: str, words: str) -> ViewRow:
    return ViewRow(
        name=name,
        title="X-ray",
        short=short,
        words=words,
        empty="The simulated X-ray with the scope tip appears here when a CT is open.",
        cell="xray",
        spec=lambda s: XrayView(axis=axis, width=s.width, height=s.height, window_hu=s.window_hu),
        depends_on=lambda _: (),
        overlay="flat",
        wants_tip=False,
        marks_tip=True,
        scaled=True,
    )


def _drr(s: ViewSettings) -> View:
    arm = s.sight.carm
    size = (s.width, s.height)
    scale = s.pixel_mm(arm.mm_per_px)
    return DrrView(arm.primary_deg, arm.secondary_deg, *size, mm_per_px=scale, tone=arm.tone, window_mm=s.window_hu)


# ------------------------------------------------------------------ views along the route, and external views


def _path_row(kind: Literal["straightened", "curved"], title: str, words: str, *, straight: bool) -> ViewRow:
    def spec(s: ViewSettings) -> View:
        if s.path is None:
            raise UsageError(f"the {kind} view needs a path", code="render.no-path")
        return PathView(
            kind,
            s.path,
            turn_deg=s.sight.reformation.turn_deg,
            width=s.width,
            height=s.height,
            mm_per_px=s.pixel_mm(s.sight.reformation.mm_per_px),
            centre_mm=s.path_mm,
            window_hu=_grey_settings(s),
            slab=s.slab,
        )

    def depends(s: ViewSettings) -> tuple[Hashable, ...]:
        # The frames themselves are part of the key: the reference keeps them alive, so no other route can have their
        # identity.
        reformation = s.sight.reformation
        place = None if reformation.mm_per_px is None else round(s.path_mm, 2)
        return (s.path, reformation, place, s.window_hu, s.slab)

    return ViewRow(
        name=kind,
        title=title,
        words=words,
        empty=(
            "There is no route yet. Choose a branch in the list, or mark a target; the airway along the route then "
            "appears here."
        ),
        cell="cut-plane",
        spec=spec,
        depends_on=depends,
        needs=frozenset({"route"}),
        overlay="lines",
        pick="path",
        zoom="path",
        slab="window",
        windowed=True,
        wants_tip=False,
        lettered=True,
        scaled=True,
        named=True,
        straight=straight,
    )


def _orbit_view(s: ViewSettings, view: OrbitViewName) -> dict[str, Any]:
    orbit = s.sight.orbits.get(view, VIEWS[view].orbit)
    assert orbit is not None
    return {**msgspec.structs.asdict(orbit), "width": s.width, "height": s.height}


VIEWS: Mapping[str, ViewRow] = MappingProxyType(
    {
        row.name: row
        for row in (
            ViewRow(
                name="airway",
                title="Airway",
                words="airway view",
                cell="airway",
                spec=_airway,
                depends_on=_airway_depends,
                overlay="airway",
                pick="wall",
                zoom="tip",
                by_transfer=True,
                costly=True,
                at_tip=True,
                named=True,
                max_px=3840,
            ),
            *(_slice_row(plane) for plane in PLANES),
            ViewRow(
                name="cut-plane",
                title="Cut-plane",
                words="cut-plane",
                empty="The plane through the tip, perpendicular to the scope, appears here when a CT is open.",
                cell="cut-plane",
                spec=_cut_plane,
                depends_on=lambda s: (s.pose_id, s.window_hu, s.sight.place("cut-plane")),
                overlay="flat",
                pick="plane",
                zoom="extent",
                slab="call",
                windowed=True,
                outlined=True,
                at_tip=True,
                inside=True,
                scaled=True,
                named=True,
            ),
            _path_row("straightened", "Straightened", "straightened airway", straight=True),
            _path_row("curved", "Curved", "curved reformation", straight=False),
            _xray_row("xray-coronal", "coronal", "AP", "Simulated X-ray, AP"),
            _xray_row("xray-sagittal", "sagittal", "Lat", "Simulated X-ray, lateral"),
            _xray_row("xray-axial", "axial", "Ax", "Simulated X-ray, axial"),
            ViewRow(
                name="drr",
                title="X-ray",
                short="DRR",
                words="Simulated X-ray from the C-arm; drag to rotate the arm",
                empty="The simulated X-ray with the scope tip appears here when a CT is open.",
                cell="xray",
                spec=_drr,
                # The tip is only marked in the picture, so the picture does not depend on it.
                depends_on=lambda s: (s.sight.carm,),
                overlay="seen",
                zoom="carm",
                costly=True,
                wants_tip=False,
                marks_tip=True,
                lettered=True,
            ),
            ViewRow(
                name="tree",
                title="Airway tree",
                words="airway tree",
                empty="The airway tree, seen from outside, appears here once the airways have been segmented.",
                cell="outside",
                spec=lambda s: TreeView(**_orbit_view(s, "tree")),
                depends_on=lambda s: (s.sight.orbits.get("tree"),),
                needs=frozenset({"airways"}),
                overlay="seen",
                pick="branch",
                zoom="orbit",
                orbit=Orbit(0.0, 0.0),
                by_transfer=True,
                costly=True,
                marks_tip=True,
                named=True,
            ),
            ViewRow(
                name="tri-plane",
                title="Tri-plane",
                words="tri-plane",
                cell="outside",
                spec=lambda s: TriPlaneView(
                    s.point_lps, window_hu=_grey_settings(s), look_at=s.look_at, **_orbit_view(s, "tri-plane")
                ),
                depends_on=lambda s: (_in_hundredths_mm(s.point_lps), s.sight.orbits.get("tri-plane"), s.window_hu),
                overlay="seen",
                pick="planes",
                zoom="orbit",
                orbit=Orbit(35.0, 25.0),
                windowed=True,
                costly=True,
                inside=True,
            ),
        )
    }
)
VIEW_NAMES: tuple[ViewName, ...] = tuple(row.name for row in VIEWS.values())


def view_row(name: str) -> ViewRow:
    """Return the row of the view table for a view's name.

    Raises
    ------
    UsageError
        If there is no view of this name.
    """
    row = VIEWS.get(name)
    if row is None:
        raise UsageError(f"expected one of the views {', '.join(VIEW_NAMES)}; found {name!r}")
    return row
