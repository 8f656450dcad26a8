"""An immutable picture of what the views should show now; the render thread works from it without locks."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, Protocol, cast

import numpy as np

from carina import render
from carina.scopes import ImageField, Mask, PathFrames, Pose, ScopePreset

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carina.render import CancelToken, Hit, Picture, TransferFunction
    from carina.track import LumenOutline

__all__ = ["VIEWS", "Carm", "Orbit", "Reformation", "Renderer", "Scene", "Zoom"]

VIEWS = (
    "airway",
    "cut-plane",
    "tri-plane",
    "xray-axial",
    "xray-coronal",
    "xray-sagittal",
    "drr",
    "axial",
    "coronal",
    "sagittal",
    "straightened",
    "curved",
    "tree",
)
NORMAL_AXIS = {"axial": 2, "coronal": 1, "sagittal": 0}
PLANES = NORMAL_AXIS.keys()
PATH_VIEWS = ("straightened", "curved")
OUTLINED = {*PLANES, "cut-plane"}
"""Views that carry the outline of the lumen."""


class Renderer(Protocol):
    """What a session asks of a renderer: one machine's or a cluster's."""

    def render(self, view: Any, *, stop: CancelToken | None = None) -> Picture:
        """One picture; safe beside the other methods. It may be given up once ``stop`` is cancelled."""

    def pick(self, view: Any, column: int, row: int) -> Hit | None:
        """The first wall under a pixel of an airway view."""

    def set_transfer(self, transfer: TransferFunction) -> None:
        """Show the volume with another transfer function."""

    def set_lumen(self, lumen_zyx: NDArray[np.uint8] | None) -> None:
        """The airway lumen, for the wall and the outside view."""

    def prepare(
        self,
        progress: Callable[[str, float | None], None] | None = None,
        cancel: Callable[[], bool] | None = None,
    ) -> None:
        """Build what makes pictures fast; until then they are slow and the same."""


@dataclass(frozen=True, slots=True)
class Orbit:
    """Camera of an outside view; distance None fits."""

    azimuth_deg: float
    elevation_deg: float
    distance_mm: float | None = None


DEFAULT_ORBIT_TREE = Orbit(azimuth_deg=0.0, elevation_deg=0.0)
DEFAULT_ORBIT_TRI_PLANE = Orbit(azimuth_deg=35.0, elevation_deg=25.0)


@dataclass(frozen=True, slots=True)
class Carm:
    """Angles, scale and tone of the radiograph; see :class:`carina.render.DrrView`."""

    primary_deg: float = 0.0
    secondary_deg: float = 0.0
    mm_per_px: float | None = None
    tone: Literal["radiograph", "fluoroscopy"] = "radiograph"


@dataclass(frozen=True, slots=True)
class Reformation:
    """Turn and scale of the views along the route; a scale of None fits the route, else the tip is in the middle."""

    turn_deg: float = 0.0
    mm_per_px: float | None = None


@dataclass(frozen=True, slots=True)
class Zoom:
    """Scales of the planar views; None fits.

    Centres are where pictures were zoomed or panned to, until the tip moves; None is the point that is shown, and of
    the cut-plane the tip.
    """

    axial_mm_per_px: float | None = None
    coronal_mm_per_px: float | None = None
    sagittal_mm_per_px: float | None = None
    cut_plane_extent_mm: float | None = None
    axial_center_lps: tuple[float, float, float] | None = None
    coronal_center_lps: tuple[float, float, float] | None = None
    sagittal_center_lps: tuple[float, float, float] | None = None
    cut_plane_center_lps: tuple[float, float, float] | None = None

    @property
    def following(self) -> Zoom:
        """The same scales, round the point that is shown."""
        return replace(self.at_tip, axial_center_lps=None, coronal_center_lps=None, sagittal_center_lps=None)

    @property
    def at_tip(self) -> Zoom:
        """The same, with the tip in the middle of the cut-plane, which goes where the tip goes."""
        return replace(self, cut_plane_center_lps=None)


@dataclass(frozen=True, slots=True)
class Outline:
    """The lumen's outline in one picture."""

    data: bytes
    """As :meth:`carina.track.LumenOutline.encoded` gives it."""
    complete: bool
    """False where the lumen is too ragged for an outline."""


@dataclass(frozen=True, slots=True)
class Scene:
    """Everything that the pictures of this moment depend on."""

    case_number: int
    """Grows with each case opened."""
    content_number: int
    """Grows when the transfer function or the lumen that the renderer shows has changed."""
    renderer: Renderer
    pose: Pose
    pose_id: int
    pose_s: float
    """When this pose came to be, on the session's clock."""
    scope: ScopePreset | None
    mask: Mask
    fov_deg: float
    shading: bool
    texture: bool
    method: str
    window_hu: tuple[float, float]
    crosshair_lps: tuple[float, float, float] | None
    orbit_tree: Orbit
    orbit_tri_plane: Orbit
    zoom: Zoom
    has_lumen: bool
    carm: Carm = Carm()
    reformation: Reformation = Reformation()
    slab: render.Slab | None = None
    """Thick slices and views along the route."""
    frames: PathFrames | None = None
    """The route, as the views along it want it."""
    path_mm: float | None = None
    """The tip's place on the route; None in free movement."""
    picture_turned: bool = False
    """See :attr:`carina.navigate.Navigator.picture_turned`."""
    content_is_newest: bool = True
    """The renderer has the transfer function and the lumen that were decided on; else it is being given them."""
    lumen: LumenOutline | None = None
    """The lumen that was decided on, for the outlines in planes: they never wait for the renderer."""

    @property
    def shown_lps(self) -> tuple[float, float, float]:
        """The point that slices and tri-plane show: the crosshair, or the tip."""
        if self.crosshair_lps is not None:
            return self.crosshair_lps
        x, y, z = self.pose.position_lps
        return float(x), float(y), float(z)

    def key(self, view: str) -> Hashable:
        """What this view's picture depends on; equal keys mean equal pictures. None where there is nothing to show."""
        case: tuple[Hashable, ...] = (self.case_number, view)
        if view in OUTLINED:
            # The object: a lumen is known by its identity, and this keeps it from being another's.
            case = (*case, self.lumen)
        if view == "airway":
            seen = (None if self.scope is None else self.scope.name, self.mask, self.fov_deg)
            return (*case, self.content_number, self.pose_id, *seen, self.shading, self.texture, self.method)
        if view == "cut-plane":
            return (*case, self.pose_id, self.window_hu, self.zoom.cut_plane_extent_mm, self.zoom.cut_plane_center_lps)
        if view == "tri-plane":
            return (*case, self._shown_key(), self.orbit_tri_plane, self.window_hu)
        if view in PLANES:
            if self._mm_per_px(view) is None:
                # The whole slice fits: only its depth matters.
                return (*case, self._shown_key()[NORMAL_AXIS[view]], self.window_hu, self.slab)
            center = tuple(round(v, 2) for v in self._slice_center(view))
            return (*case, center, self.window_hu, self._mm_per_px(view), self.slab)
        if view == "drr":
            # Like the other X-rays: the tip is only marked in it.
            return (*case, self.carm)
        if view in PATH_VIEWS:
            if self.frames is None:
                return None
            # The frames themselves: a route is known by its identity, and this keeps it from being another's.
            place = None if self.reformation.mm_per_px is None else round(self._path_place_mm(), 2)
            return (*case, self.frames, self.reformation, place, self.window_hu, self.slab)
        if view == "tree":
            return (*case, self.content_number, self.orbit_tree) if self.has_lumen else None
        return case

    def outline_of(self, view: str, picture: Picture) -> Outline | None:
        """The outline of the lumen in a picture of this scene; None where the view has none, or no lumen is known."""
        if view not in OUTLINED or self.lumen is None or picture.lps_from_pixel is None:
            return None
        if not np.isfinite(picture.lps_from_pixel).all():
            # A fault of the renderer: whoever encodes the picture says so.
            return None
        height, width = picture.rgb.shape[:2]
        data = self.lumen.encoded(picture.lps_from_pixel, width, height)
        return Outline(b"", complete=False) if data is None else Outline(data, complete=True)

    def can_be_final(self, view: str) -> bool:
        """Whether a view's picture shows what was decided on, and will not be made again by itself."""
        return self.content_is_newest or view not in {"airway", "tree"}

    def spec(self, view: str, width: int, height: int, step_vox: float, *, full_width: int | None = None) -> Any:
        """The view as the renderer takes it. ``full_width`` keeps a zoomed slice's extent in a smaller picture."""
        window_hu = self.window_hu
        if view == "airway":
            settings: dict[str, Any] = {
                "fov_deg": self.fov_deg,
                "width": width,
                "height": height,
                "step_vox": step_vox,
                "shading": self.shading,
                "texture": self.texture,
                "method": "brute" if self.method == "brute" else "leap",
            }
            if self.scope is None:
                return render.AirwayView(self.pose, field=ImageField(self.mask), **settings)
            return render.AirwayView.of_scope(
                self.scope,
                self.pose,
                picture_turned=self.picture_turned,
                field=replace(self.scope.field, mask=self.mask),
                **settings,
            )
        if view == "cut-plane":
            extent_mm = self.zoom.cut_plane_extent_mm or 60.0
            return render.CutPlaneView(
                self.pose,
                width=width,
                height=height,
                extent_mm=extent_mm,
                window_hu=window_hu,
                center_lps=self.zoom.cut_plane_center_lps,
            )
        if view == "tri-plane":
            orbit = self.orbit_tri_plane
            return render.TriPlaneView(
                self.shown_lps,
                azimuth_deg=orbit.azimuth_deg,
                elevation_deg=orbit.elevation_deg,
                distance_mm=orbit.distance_mm,
                width=width,
                height=height,
                window_hu=window_hu,
                # A plane that is dragged must not take the camera along.
                look_at="volume",
            )
        if view in PLANES:
            mm_per_px = _in_smaller_picture(self._mm_per_px(view), full_width, width)
            return render.SliceView(
                plane=cast(Any, view),
                center_lps=self.shown_lps if mm_per_px is None else self._slice_center(view),
                width=width,
                height=height,
                mm_per_px=mm_per_px,
                window_hu=window_hu,
                slab=self.slab,
            )
        if view == "drr":
            return render.DrrView(
                self.carm.primary_deg,
                self.carm.secondary_deg,
                width,
                height,
                mm_per_px=_in_smaller_picture(self.carm.mm_per_px, full_width, width),
                tone=self.carm.tone,
            )
        if view in PATH_VIEWS:
            assert self.frames is not None
            return render.PathView(
                cast(Any, view),
                self.frames,
                turn_deg=self.reformation.turn_deg,
                width=width,
                height=height,
                mm_per_px=_in_smaller_picture(self.reformation.mm_per_px, full_width, width),
                center_mm=self._path_place_mm(),
                window_hu=window_hu,
                slab=self.slab,
            )
        if view == "tree":
            orbit = self.orbit_tree
            return render.TreeView(
                azimuth_deg=orbit.azimuth_deg,
                elevation_deg=orbit.elevation_deg,
                distance_mm=orbit.distance_mm,
                width=width,
                height=height,
            )
        return render.XrayView(axis=cast(Any, view.removeprefix("xray-")), width=width, height=height)

    def _mm_per_px(self, view: str) -> float | None:
        scale: float | None = getattr(self.zoom, f"{view}_mm_per_px")
        return scale

    def _slice_center(self, view: str) -> tuple[float, float, float]:
        """The middle of a zoomed slice: where it was zoomed to, at the depth that is shown."""
        shown = self.shown_lps
        center: tuple[float, float, float] | None = getattr(self.zoom, f"{view}_center_lps")
        if center is None:
            return shown
        axis = NORMAL_AXIS[view]
        x, y, z = (shown[n] if n == axis else center[n] for n in range(3))
        return x, y, z

    def _path_place_mm(self) -> float:
        """The tip's place on the route, or the nearest."""
        assert self.frames is not None
        if self.path_mm is not None:
            return self.path_mm
        away = np.linalg.norm(self.frames.points_lps - self.pose.position_lps, axis=1)
        return float(self.frames.path_mm[int(np.argmin(away))])

    def _shown_key(self) -> tuple[float, ...]:
        # A hundredth of a millimetre is far below a pixel: turning on the spot asks for no new slices.
        return tuple(round(v, 2) for v in self.shown_lps)


def _in_smaller_picture(mm_per_px: float | None, full_width: int | None, width: int) -> float | None:
    """A chosen scale, kept in mm across a picture of fewer pixels."""
    return mm_per_px if mm_per_px is None or full_width is None else mm_per_px * full_width / width
