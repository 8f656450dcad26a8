"""An immutable picture of what the views should show now; the render thread works from it without locks."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, cast

from carina import render
from carina.scopes import Pose

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from carina.render import CancelToken, Hit, Picture, TransferFunction

__all__ = ["VIEWS", "Orbit", "Renderer", "Scene", "Zoom"]

VIEWS = (
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
)
NORMAL_AXIS = {"axial": 2, "coronal": 1, "sagittal": 0}
PLANES = NORMAL_AXIS.keys()


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
class Zoom:
    """Scales of the planar views; None fits."""

    axial_mm_per_px: float | None = None
    coronal_mm_per_px: float | None = None
    sagittal_mm_per_px: float | None = None
    cut_plane_extent_mm: float | None = None


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
    fov_deg: float
    shading: bool
    method: str
    window_hu: tuple[float, float]
    crosshair_lps: tuple[float, float, float] | None
    orbit_tree: Orbit
    orbit_tri_plane: Orbit
    zoom: Zoom
    has_lumen: bool

    @property
    def shown_lps(self) -> tuple[float, float, float]:
        """The point that slices and tri-plane show: the crosshair, or the tip."""
        if self.crosshair_lps is not None:
            return self.crosshair_lps
        x, y, z = self.pose.position_lps
        return float(x), float(y), float(z)

    def key(self, view: str) -> Hashable:
        """What this view's picture depends on; equal keys mean equal pictures. None where there is nothing to show."""
        case = (self.case_number, view)
        if view == "airway":
            return (*case, self.content_number, self.pose_id, self.fov_deg, self.shading, self.method)
        if view == "cut-plane":
            return (*case, self.pose_id, self.window_hu, self.zoom.cut_plane_extent_mm)
        if view == "tri-plane":
            return (*case, self._shown_key(), self.orbit_tri_plane, self.window_hu)
        if view in PLANES:
            if self._mm_per_px(view) is None:
                # The whole slice fits: only its depth matters.
                return (*case, self._shown_key()[NORMAL_AXIS[view]], self.window_hu)
            return (*case, self._shown_key(), self.window_hu, self._mm_per_px(view))
        if view == "tree":
            return (*case, self.content_number, self.orbit_tree) if self.has_lumen else None
        return case

    def spec(self, view: str, width: int, height: int, step_vox: float, *, full_width: int | None = None) -> Any:
        """The view as the renderer takes it. ``full_width`` keeps a zoomed slice's extent in a smaller picture."""
        window_hu = self.window_hu
        if view == "airway":
            return render.AirwayView(
                self.pose,
                fov_deg=self.fov_deg,
                width=width,
                height=height,
                step_vox=step_vox,
                shading=self.shading,
                method="brute" if self.method == "brute" else "leap",
            )
        if view == "cut-plane":
            extent_mm = self.zoom.cut_plane_extent_mm or 60.0
            return render.CutPlaneView(self.pose, width=width, height=height, extent_mm=extent_mm, window_hu=window_hu)
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
            )
        if view in PLANES:
            mm_per_px = self._mm_per_px(view)
            if mm_per_px is not None and full_width is not None:
                mm_per_px *= full_width / width
            return render.SliceView(
                plane=cast(Any, view),
                center_lps=self.shown_lps,
                width=width,
                height=height,
                mm_per_px=mm_per_px,
                window_hu=window_hu,
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

    def _shown_key(self) -> tuple[float, ...]:
        # A hundredth of a millimetre is far below a pixel: turning on the spot asks for no new slices.
        return tuple(round(v, 2) for v in self.shown_lps)
