"""What a view is asked for with: one value for all views, of which each takes what it needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from carina.display import one_line
from carina.render.sight import Sight, Slab
from carina.scopes import FULL_FRAME, DepthOfField, ImageField, Lens, PathFrames, Pose, ScopePreset
from carina.value import PointLps

__all__ = ["ViewSettings"]


@one_line
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViewSettings:
    """What one view of a scene, or of a call, is rendered with."""

    pose: Pose
    """The tip."""
    point_lps: PointLps
    """Where slices and the tri-plane meet."""
    sight: Sight = Sight()
    width: int = 512
    height: int = 512
    full_width: int | None = None
    """Of the picture that the scales of the sight are of: a smaller one shows as much."""
    pose_id: int = 0
    """Known by its number, so that equal poses need no comparison."""
    # What the scope sees.
    scope: ScopePreset | None = None
    picture_turned: bool = False
    fov_deg: float | None = None
    lens: Lens | None = None
    field: ImageField = FULL_FRAME
    depth_of_field: DepthOfField | None = None
    step_vox: float = 0.5
    # From outside.
    look_at: Literal["point", "volume"] = "point"
    # Along the route.
    path: PathFrames | None = None
    path_mm: float = 0.0
    """The place on the path that is in the middle of a zoomed view."""

    @property
    def window_hu(self) -> tuple[float, float] | None:
        """Width and level; None is the view's own: that of the lung, or one fitted to the values."""
        window = self.sight.window
        return None if window is None else (window.width_hu, window.level_hu)

    @property
    def slab(self) -> Slab | None:
        """None for thin slices."""
        return self.sight.slab if self.sight.slab.thickness_mm > 0.0 else None

    def pixel_mm(self, mm_per_px: float | None) -> float | None:
        """A scale of the sight, in this picture's pixels."""
        if mm_per_px is None or self.full_width is None:
            return mm_per_px
        return mm_per_px * self.full_width / self.width
