"""An immutable snapshot of everything that the views show; the render thread reads it without locks."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

import msgspec
import numpy as np

from carina import render
from carina.breathing import ChestDeformation
from carina.commands import Look
from carina.display import one_line
from carina.render import VIEWS, Sight
from carina.render.view_values import THIN
from carina.scopes import ImageField, PathFrames, Pose, scope_preset
from carina.session.scene.layer_lines import LAYERS, LayerLines, LayerName, OutlineLines, ShownLayers
from carina.value import PointLps

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carina.render import CancelToken, Hit, Picture, TransferFunction
    from carina.track import AirwayTree, LumenOutline


class SessionRenderer(Protocol):
    """Methods of a renderer, on one machine or on a cluster, that a session calls."""

    def render(self, view: Any, *, stop: CancelToken | None = None) -> Picture:
        """Render one image while other methods may run; a cancelled ``stop`` may abort the rendering."""

    def pick(self, view: Any, column: int, row: int) -> Hit | None:
        """Return the first wall under a pixel of an airway view."""

    def set_transfer(self, transfer: TransferFunction) -> None:
        """Set the transfer function (colour and opacity by CT value) that renders the volume in all 3D views."""

    def set_lumen(self, lumen_zyx: NDArray[np.uint8] | None, tree: AirwayTree | None = None) -> None:
        """Set the airway lumen for the wall and the outside view, and its tree for anatomical annotations."""

    def prepare(
        self,
        progress: Callable[[str, float | None], None] | None = None,
        cancel: Callable[[], bool] | None = None,
    ) -> None:
        """Build the data for fast rendering; without these data images are rendered slowly but identically."""


@one_line
@dataclass(frozen=True, slots=True)
class ShownCase:
    """Inputs, valid at one time, from which all images of a case are rendered."""

    case_number: int
    """Number that increases with each opened case."""
    content_number: int
    """Number that increases when the renderer shows another transfer function or another lumen."""
    renderer: SessionRenderer
    pose: Pose
    pose_id: int
    pose_s: float
    """Time at which the tip reached this pose, in s of the session's clock."""
    look: Look
    sight: Sight
    has_lumen: bool
    frames: PathFrames | None = None
    """Camera frames along the route, for the views along the route; None without a route."""
    path_mm: float | None = None
    """Distance of the tip along the route, in mm; None in free movement."""
    picture_turned: bool = False
    """Whether the picture is turned by 180 degrees, for an operator who faces the patient."""
    content_is_newest: bool = True
    """Whether the renderer shows the document's transfer function and lumen; otherwise a job is updating it."""
    lumen: LumenOutline | None = None
    """Outline of the document's lumen for planar views, which does not depend on the renderer's update."""
    layers: ShownLayers | None = None
    """Vessels, fissures and lobes around the targets, if the user requested them; else None."""
    wanted_layers: tuple[LayerName, ...] = LAYERS
    """Layers that the window shows."""
    deformation: ChestDeformation | None = None
    """Deformation of the chest in the airway view while a breathing is simulated, else None; other views show the CT
    at rest."""

    @property
    def shown_lps(self) -> PointLps:
        """The point, in LPS and mm, that slices and tri-plane show: the crosshair, or else the tip."""
        if self.sight.crosshair_lps is not None:
            return self.sight.crosshair_lps
        x, y, z = self.pose.position_lps
        return float(x), float(y), float(z)

    def key(self, view: str) -> Hashable:
        """Return a key of all inputs of a view's image, so that equal keys mean equal images; None without an image."""
        row = VIEWS[view]
        if not self.has(row.needs):
            return None
        moved = self.deformation if self.breathes(view) else None
        return (
            self.case_number,
            view,
            self.content_number if row.by_transfer else None,
            # The key contains the lumen object itself, so that its identity cannot be reused by another object.
            self.lumen if row.outlined else None,
            *((self.layers, self.wanted_layers) if row.outlined else ()),
            None if moved is None else moved.lps_from_rest.tobytes(),
            *row.depends_on(self._settings(row)),
        )

    def key_at_rest(self) -> Hashable:
        """Return the key of the airway view without the simulated breathing; None if no breathing is simulated."""
        return None if self.deformation is None else replace(self, deformation=None).key(render.LEAD_VIEW)

    def breathes(self, view: str) -> bool:
        """Return whether a view shows a simulated breathing."""
        return self.deformation is not None and view == render.LEAD_VIEW

    def has(self, needs: Iterable[render.Need]) -> bool:
        """Return whether the scene has everything that a view requires: the airways, the route, or both."""
        there = {"airways": self.has_lumen, "route": self.frames is not None}
        return all(there[need] for need in needs)

    def outline_of(self, view: str, picture: Picture) -> OutlineLines | None:
        """Return the outline of the lumen in an image of this scene; None if the view has none or no lumen is known."""
        if not VIEWS[view].outlined or self.lumen is None or picture.lps_from_pixel is None:
            return None
        if not np.isfinite(picture.lps_from_pixel).all():
            # The renderer returned an invalid matrix; the encoder of the image reports this fault.
            return None
        height, width = picture.rgb.shape[:2]
        data = self.lumen.encoded(picture.lps_from_pixel, width, height)
        return OutlineLines(b"", complete=False) if data is None else OutlineLines(data, complete=True)

    def layers_of(self, view: str, picture: Picture) -> tuple[LayerLines, ...]:
        """Return the outlines of the requested and visible layers around the targets in an image of this scene."""
        matrix = picture.lps_from_pixel
        if not VIEWS[view].outlined or self.layers is None or matrix is None or not np.isfinite(matrix).all():
            return ()
        return self.layers.lines(matrix, self.wanted_layers)

    def can_be_final(self, view: str) -> bool:
        """Return whether an image of a view, rendered now, stays valid until the next change of the case."""
        return self.content_is_newest or not self.is_by_transfer(view)

    @staticmethod
    def is_by_transfer(view: str) -> bool:
        """Return whether a view depends on the transfer function and the lumen of the renderer."""
        return VIEWS[view].by_transfer

    def spec(self, view: str, width: int, height: int, step_vox: float, *, full_width: int | None = None) -> Any:
        """Return the definition of a view (camera, size, settings) with which the renderer renders this scene.

        Parameters
        ----------
        view
            Name of the view.
        width, height
            Size of the image, in pixels.
        step_vox
            Step along the rays, in voxels.
        full_width
            Width in pixels of the final image, if this image is a smaller preview that must show the same region.
        """
        row = VIEWS[view]
        settings = self._settings(row)
        found = row.spec(replace(settings, width=width, height=height, full_width=full_width, step_vox=step_vox))
        # Only the airway view has this parameter.
        if isinstance(found, render.AirwayView):
            return replace(found, deformation=self.deformation)
        return found

    def _settings(self, row: render.ViewRow) -> render.ViewSettings:
        """Return the settings of a view of this scene, without the image size."""
        scope = None if self.look.scope is None else scope_preset(self.look.scope)
        pose = self.pose
        if self.deformation is not None and self.breathes(row.name):
            pose = pose.carried_by(self.deformation)
        outline = self.look.outline
        # Views with a fixed window or slab thickness ignore those of the sight.
        own: dict[str, Any] = {} if row.windowed else {"window": None}
        own |= {} if row.slab == "window" else {"slab": THIN}
        return render.ViewSettings(
            pose=pose,
            pose_id=self.pose_id,
            point_lps=self.shown_lps,
            sight=msgspec.structs.replace(self.sight, **own) if own else self.sight,
            scope=scope,
            picture_turned=self.picture_turned,
            fov_deg=self.look.fov_deg,
            field=ImageField(outline) if scope is None else replace(scope.field, outline=outline),
            # The camera must not move when the user drags a plane.
            look_at="volume",
            path=self.frames,
            path_mm=self._path_place_mm() if row.zoom == "path" and self.frames is not None else 0.0,
        )

    def _path_place_mm(self) -> float:
        """Return the distance of the tip along the route in mm, or of the route point that is nearest to the tip."""
        assert self.frames is not None
        if self.path_mm is not None:
            return self.path_mm
        away = np.linalg.norm(self.frames.points_lps - self.pose.position_lps, axis=1)
        return float(self.frames.path_mm[int(np.argmin(away))])
