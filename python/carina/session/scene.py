"""An immutable picture of what the views should show now; the render thread works from it without locks."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np

from carina import render
from carina.render import VIEWS, Orbit
from carina.scopes import ImageField, Mask, PathFrames, Pose, ScopePreset

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carina.render import CancelToken, Hit, Picture, TransferFunction
    from carina.track import LumenOutline

__all__ = ["Carm", "FlatPlace", "Orbit", "Reformation", "Renderer", "Scene", "Zoom"]


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
class FlatPlace:
    """Where a planar view was zoomed or panned to, until the tip moves."""

    scale: float | None = None
    """mm per pixel, or the extent in mm where the view has one; None fits."""
    center_lps: tuple[float, float, float] | None = None
    """None is the point that is shown, and of views that go with the tip the tip."""


FITS = FlatPlace()


@dataclass(frozen=True, slots=True)
class Zoom:
    """Scales and centres of the planar views; those that are not among ``places`` fit."""

    places: Mapping[str, FlatPlace] = field(default_factory=dict)

    def of(self, view: str) -> FlatPlace:
        """A view's own."""
        return self.places.get(view, FITS)

    def placed(self, view: str, place: FlatPlace) -> Zoom:
        """The same with one view elsewhere."""
        return Zoom({**self.places, view: place})

    @property
    def following(self) -> Zoom:
        """The same scales, round the point that is shown."""
        return Zoom({view: FlatPlace(place.scale) for view, place in self.places.items()})

    @property
    def at_tip(self) -> Zoom:
        """The same, with the tip in the middle of what goes where the tip goes."""
        return Zoom({view: FlatPlace(p.scale) if VIEWS[view].at_tip else p for view, p in self.places.items()})


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
        row = VIEWS[view]
        if not self.has(row.needs):
            return None
        return (
            self.case_number,
            view,
            self.content_number if row.by_transfer else None,
            # The object: a lumen is known by its identity, and this keeps it from being another's.
            self.lumen if row.outlined else None,
            *row.depends_on(self._settings(row)),
        )

    def has(self, needs: Iterable[render.Need]) -> bool:
        """Whether all that a view needs is there."""
        there = {"airways": self.has_lumen, "route": self.frames is not None}
        return all(there[need] for need in needs)

    def outline_of(self, view: str, picture: Picture) -> Outline | None:
        """The outline of the lumen in a picture of this scene; None where the view has none, or no lumen is known."""
        if not VIEWS[view].outlined or self.lumen is None or picture.lps_from_pixel is None:
            return None
        if not np.isfinite(picture.lps_from_pixel).all():
            # A fault of the renderer: whoever encodes the picture says so.
            return None
        height, width = picture.rgb.shape[:2]
        data = self.lumen.encoded(picture.lps_from_pixel, width, height)
        return Outline(b"", complete=False) if data is None else Outline(data, complete=True)

    def can_be_final(self, view: str) -> bool:
        """Whether a view's picture shows what was decided on, and will not be made again by itself."""
        return self.content_is_newest or not VIEWS[view].by_transfer

    def spec(self, view: str, width: int, height: int, step_vox: float, *, full_width: int | None = None) -> Any:
        """The view as the renderer takes it. ``full_width`` keeps a zoomed slice's extent in a smaller picture."""
        row = VIEWS[view]
        settings = replace(self._settings(row), width=width, height=height, step_vox=step_vox)
        if settings.mm_per_px is not None and full_width is not None:
            settings = replace(settings, mm_per_px=settings.mm_per_px * full_width / width)
        return row.spec(settings)

    def _settings(self, row: render.ViewRow) -> render.ViewSettings:
        """What a view of this scene is looked at with, whatever its size."""
        place = self.zoom.of(row.name)
        field = ImageField(self.mask) if self.scope is None else replace(self.scope.field, mask=self.mask)
        scales = {"slice": place.scale, "path": self.reformation.mm_per_px, "carm": self.carm.mm_per_px}
        return render.ViewSettings(
            pose=self.pose,
            pose_id=self.pose_id,
            point_lps=self.shown_lps,
            scope=self.scope,
            picture_turned=self.picture_turned,
            fov_deg=self.fov_deg,
            field=field,
            shading=self.shading,
            texture=self.texture,
            method="brute" if self.method == "brute" else "leap",
            window_hu=self.window_hu if row.windowed else None,
            slab=self.slab if row.slab == "window" else None,
            mm_per_px=scales.get(row.zoom or ""),
            extent_mm=place.scale if row.zoom == "extent" else None,
            center_lps=place.center_lps,
            orbit=None if row.camera_field is None else getattr(self, row.camera_field),
            # A plane that is dragged must not take the camera along.
            look_at="volume",
            carm_deg=(self.carm.primary_deg, self.carm.secondary_deg),
            tone=self.carm.tone,
            path=self.frames,
            turn_deg=self.reformation.turn_deg,
            path_mm=self._path_place_mm() if row.zoom == "path" and self.frames is not None else 0.0,
        )

    def _path_place_mm(self) -> float:
        """The tip's place on the route, or the nearest."""
        assert self.frames is not None
        if self.path_mm is not None:
            return self.path_mm
        away = np.linalg.norm(self.frames.points_lps - self.pose.position_lps, axis=1)
        return float(self.frames.path_mm[int(np.argmin(away))])
