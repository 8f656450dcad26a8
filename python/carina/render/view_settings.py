"""Settings from which every view definition is made; each view reads the settings that it needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from carina.display import one_line
from carina.render.view_values import Sight, Slab
from carina.scopes import FULL_FRAME, DepthOfField, ImageField, Lens, PathFrames, Pose, ScopePreset
from carina.value import PointLps


@one_line
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViewSettings:
    """Settings of one picture: pose, point and display settings of a case's window, or arguments of one call."""

    pose: Pose
    """Pose of the scope's tip."""
    point_lps: PointLps
    """Point where the slices and the tri-plane meet, LPS mm."""
    sight: Sight = Sight()
    width: int = 512
    height: int = 512
    full_width: int | None = None
    """Width of the picture to which the scales of ``sight`` apply; a smaller picture shows the same area."""
    pose_id: int = 0
    """Number of the pose, equal for equal poses, so that poses need no comparison."""
    # The next fields are settings of the airway view.
    scope: ScopePreset | None = None
    picture_turned: bool = False
    fov_deg: float | None = None
    lens: Lens | None = None
    field: ImageField = FULL_FRAME
    depth_of_field: DepthOfField | None = None
    step_vox: float = 0.5
    # Object that the camera of the tri-plane view looks at.
    look_at: Literal["point", "volume"] = "point"
    # The next fields are settings of the views along the route.
    path: PathFrames | None = None
    path_mm: float = 0.0
    """Position on the path, in mm from its start, that a zoomed view shows in its centre."""

    @property
    def window_hu(self) -> tuple[float, float] | None:
        """Width and level of the grey window; None selects the view's default (lung window or fitted window)."""
        window = self.sight.window
        return None if window is None else (window.width_hu, window.level_hu)

    @property
    def slab(self) -> Slab | None:
        """Slab of the slices and of the views along the route; None for thin slices."""
        return self.sight.slab if self.sight.slab.thickness_mm > 0.0 else None

    def pixel_mm(self, mm_per_px: float | None) -> float | None:
        """Return a scale of the user's display settings, converted to mm per pixel of this picture.

        None if there is none.
        """
        if mm_per_px is None or self.full_width is None:
            return mm_per_px
        return mm_per_px * self.full_width / self.width
