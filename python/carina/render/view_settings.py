"""What a view is asked for with: one value for all views, of which each takes what it needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from carina.display import one_line
from carina.render.views import Slab
from carina.scopes import FULL_FRAME, DepthOfField, ImageField, Lens, PathFrames, Pose, ScopePreset

__all__ = ["Orbit", "ViewSettings"]

Point = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Orbit:
    """Camera of an outside view; distance None fits."""

    azimuth_deg: float
    elevation_deg: float
    distance_mm: float | None = None


@one_line
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViewSettings:
    """What one view of a scene, or of a call, is rendered with."""

    pose: Pose
    """The tip."""
    point_lps: Point
    """Where slices and the tri-plane meet."""
    width: int = 512
    height: int = 512
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
    shading: bool = True
    texture: bool = True
    method: Literal["leap", "brute"] = "leap"
    # Planes and projections.
    window_hu: tuple[float, float] | None = None
    """None is the view's own: that of the lung, or one fitted to the values."""
    slab: Slab | None = None
    mm_per_px: float | None = None
    """None fits."""
    extent_mm: float | None = None
    center_lps: Point | None = None
    """Where the picture was panned or zoomed to."""
    # Cameras.
    orbit: Orbit | None = None
    """None is where the view begins."""
    look_at: Literal["point", "volume"] = "point"
    carm_deg: tuple[float, float] = (0.0, 0.0)
    tone: Literal["radiograph", "fluoroscopy"] = "radiograph"
    # Along the route.
    path: PathFrames | None = None
    turn_deg: float = 0.0
    path_mm: float = 0.0
    """The place on the path that is in the middle of a zoomed view."""
