"""An immutable picture of what the views should show now; the render thread works from it without locks."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

import msgspec
import numpy as np

from carina import render
from carina.commands import Look
from carina.display import one_line
from carina.render import VIEWS, Sight
from carina.render.sight import THIN
from carina.scopes import ImageField, PathFrames, Pose, scope_preset
from carina.session.layers import LAYERS, LayerLines, LayerName, OutlineLines, ShownLayers
from carina.value import PointLps

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carina.render import CancelToken, Hit, Picture, TransferFunction
    from carina.track import AirwayTree, LumenOutline

__all__ = ["SessionRenderer", "ShownCase"]


class SessionRenderer(Protocol):
    """Methods that a session calls on a renderer, which is that of one machine or of a cluster."""

    def render(self, view: Any, *, stop: CancelToken | None = None) -> Picture:
        """One picture; safe beside the other methods. It may be given up once ``stop`` is cancelled."""

    def pick(self, view: Any, column: int, row: int) -> Hit | None:
        """The first wall under a pixel of an airway view."""

    def set_transfer(self, transfer: TransferFunction) -> None:
        """Show the volume with another transfer function."""

    def set_lumen(self, lumen_zyx: NDArray[np.uint8] | None, tree: AirwayTree | None = None) -> None:
        """The airway lumen, for the wall and the outside view, and its tree, for what is fixed to anatomy."""

    def prepare(
        self,
        progress: Callable[[str, float | None], None] | None = None,
        cancel: Callable[[], bool] | None = None,
    ) -> None:
        """Build what makes pictures fast; until then they are slow and the same."""


@one_line
@dataclass(frozen=True, slots=True)
class ShownCase:
    """Everything that the pictures of this moment depend on."""

    case_number: int
    """Grows with each case opened."""
    content_number: int
    """Grows when the transfer function or the lumen that the renderer shows has changed."""
    renderer: SessionRenderer
    pose: Pose
    pose_id: int
    pose_s: float
    """When this pose came to be, on the session's clock."""
    look: Look
    sight: Sight
    has_lumen: bool
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
    layers: ShownLayers | None = None
    """What lies round the targets, where a person asked for it."""
    wanted_layers: tuple[LayerName, ...] = LAYERS
    """Those of them that the window shows."""

    @property
    def shown_lps(self) -> PointLps:
        """The point that slices and tri-plane show: the crosshair, or the tip."""
        if self.sight.crosshair_lps is not None:
            return self.sight.crosshair_lps
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
            *((self.layers, self.wanted_layers) if row.outlined else ()),
            *row.depends_on(self._settings(row)),
        )

    def has(self, needs: Iterable[render.Need]) -> bool:
        """Whether all that a view needs is there."""
        there = {"airways": self.has_lumen, "route": self.frames is not None}
        return all(there[need] for need in needs)

    def outline_of(self, view: str, picture: Picture) -> OutlineLines | None:
        """The outline of the lumen in a picture of this scene; None where the view has none, or no lumen is known."""
        if not VIEWS[view].outlined or self.lumen is None or picture.lps_from_pixel is None:
            return None
        if not np.isfinite(picture.lps_from_pixel).all():
            # A fault of the renderer: whoever encodes the picture says so.
            return None
        height, width = picture.rgb.shape[:2]
        data = self.lumen.encoded(picture.lps_from_pixel, width, height)
        return OutlineLines(b"", complete=False) if data is None else OutlineLines(data, complete=True)

    def layers_of(self, view: str, picture: Picture) -> tuple[LayerLines, ...]:
        """What lies round the targets in a picture of this scene, as far as it was asked for and is wanted."""
        matrix = picture.lps_from_pixel
        if not VIEWS[view].outlined or self.layers is None or matrix is None or not np.isfinite(matrix).all():
            return ()
        return self.layers.lines(matrix, self.wanted_layers)

    def can_be_final(self, view: str) -> bool:
        """Whether a view's picture shows what was decided on, and will not be made again by itself."""
        return self.content_is_newest or not VIEWS[view].by_transfer

    def spec(self, view: str, width: int, height: int, step_vox: float, *, full_width: int | None = None) -> Any:
        """The view as the renderer takes it. ``full_width`` keeps a zoomed slice's extent in a smaller picture."""
        row = VIEWS[view]
        settings = self._settings(row)
        return row.spec(replace(settings, width=width, height=height, full_width=full_width, step_vox=step_vox))

    def _settings(self, row: render.ViewRow) -> render.ViewSettings:
        """What a view of this scene is looked at with, whatever its size."""
        scope = None if self.look.scope is None else scope_preset(self.look.scope)
        outline = self.look.outline
        # Views of their own window and thickness keep them.
        own: dict[str, Any] = {} if row.windowed else {"window": None}
        own |= {} if row.slab == "window" else {"slab": THIN}
        return render.ViewSettings(
            pose=self.pose,
            pose_id=self.pose_id,
            point_lps=self.shown_lps,
            sight=msgspec.structs.replace(self.sight, **own) if own else self.sight,
            scope=scope,
            picture_turned=self.picture_turned,
            fov_deg=self.look.fov_deg,
            field=ImageField(outline) if scope is None else replace(scope.field, outline=outline),
            # A plane that is dragged must not take the camera along.
            look_at="volume",
            path=self.frames,
            path_mm=self._path_place_mm() if row.zoom == "path" and self.frames is not None else 0.0,
        )

    def _path_place_mm(self) -> float:
        """The tip's place on the route, or the nearest."""
        assert self.frames is not None
        if self.path_mm is not None:
            return self.path_mm
        away = np.linalg.norm(self.frames.points_lps - self.pose.position_lps, axis=1)
        return float(self.frames.path_mm[int(np.argmin(away))])
