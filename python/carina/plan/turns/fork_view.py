"""View of a fork from in front of it: the camera, and the middle, clock hour and outline of each opening.

The direction of an opening is that of the middle of its visible pixels in the levelled picture. List, picture, report
and window use the openings of this module.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.plan.turns.opening_walls import FOV_DEG, ForkWalls, opening_pixels, pixel_angles_rad
from carina.render import AirwayView, Renderer
from carina.scopes import Lens, Pose
from carina.track import Branch

Points = NDArray[np.float64]
Operator = Literal["head", "facing"]

AHEAD_DEG, AHEAD_SHARE, AHEAD_TIMES = 6.0, 0.5, 2.0
"""Limits of the angle between the line of sight and the middle of an opening that counts as straight ahead.

The angle must be at most the first number in degrees or, for a large opening, the second number times the opening's
radius. The angles of all other openings must be at least the third number times larger. The centre of the picture is
then inside the opening's outline, so the opening has no clock hour.
"""
MIN_SHARE = 2e-3
"""Minimum share of the picture's pixels that a visible opening occupies."""
HIDDEN_DEG = 2.0
"""Angle in degrees above which an opening counts as hidden: between its visible part and its branch's beginning."""
MIN_CAMERA_DISTANCE_MM = 3.0
"""Minimum distance in mm of the camera from a fork; nearer, single points would determine the line of sight."""


NEIGHBOUR_HOURS = 0.25
"""Minimum difference in hours between the stated hour's distance to the opening to enter and to other openings."""
MAX_HOURS = 2.0
"""Maximum change of an opening's clock hour, in hours, under a small movement of the scope."""
SHIFT_SHARE, SHIFT_MM = 0.3, (0.5, 1.5)
"""Error of the eye's position to each side: share of the airway's radius, with least and largest value in mm."""
TILT_DEG = 5.0
"""Tilt of the line of sight to each side in degrees: error of its direction."""


@one_line
@dataclass(frozen=True, slots=True)
class HourDoubt:
    """Reason why no clock hour is given for an opening."""

    code: Literal["turns.hidden", "turns.neighbour", "turns.eye"]
    """Code of the reason.

    ``turns.hidden``: the opening, or most of it, is not visible from before the fork. ``turns.neighbour``: another
    opening is in nearly the same direction. ``turns.eye``: a small movement of the scope changes the hour by more than
    two hours.
    """
    words: str
    """Reason as a text for the user."""

    def to_json(self) -> dict[str, Any]:
        """Return the reason as plain JSON types."""
        return {"code": self.code, "words": self.words}


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Opening:
    """Opening of a branch at a fork, as seen by a camera."""

    branch: Branch
    middle_lps: Points
    """Point, LPS mm, on the line of sight to the middle of the opening's outline, as far from the camera as the
    opening."""
    hours: float
    """Clock hour of the middle in the picture, 12 at the top, clockwise; 0 < hours <= 12."""
    off_deg: float
    """Angle in degrees between the line of sight and the middle of the opening."""
    in_view: bool
    """Whether the opening is visible; if not, its direction is that of the branch's centreline."""
    axis_hidden_deg: float
    """Angle in degrees between the beginning of the branch's centreline and the nearest pixel of the opening.

    0 if the opening is not in view. A large angle means that most of the opening is hidden.
    """
    ahead_limit_deg: float
    """Largest angle in degrees between the line of sight and the middle at which the opening is straight ahead."""
    straight_ahead: bool
    """Whether the opening is in the middle of the picture and so has no clock hour."""
    outline: NDArray[np.bool_] = field(repr=False)
    """(size, size) pixels of the opening."""
    walls_lps: Points = field(repr=False)
    """(n, 3) visible walls of the opening, LPS mm."""
    dots_lps: Points = field(repr=False)
    """(n, 3) points of the branch's centreline from its beginning on that are seen through the opening, LPS mm."""


def levelled(eye_lps: Points, look_lps: Points, operator: Operator) -> Pose:
    """Return the camera at a place with a level horizon.

    Anterior is up (`carina.scopes.upright`) for an operator at the head; the picture is turned by 180 degrees for an
    operator who faces the patient.

    Parameters
    ----------
    eye_lps, look_lps
        (3,) position in LPS mm and direction of the view.
    operator
        Position of the operator.
    """
    pose = Pose.looking(eye_lps, look_lps)
    if operator == "head":
        return pose
    turned = pose.lps_from_camera.copy()
    turned[:3, :2] *= -1.0
    return Pose(turned)


def turn_view(renderer: Renderer, camera: Pose, size_px: int) -> AirwayView:
    """Return the view of the still pictures and clips from a camera, without artificial texture."""
    return AirwayView(
        camera,
        fov_deg=FOV_DEG,
        width=size_px,
        height=size_px,
        lens=Lens.equidistant(),
        method="leap" if renderer.prepared else "brute",
        texture=False,
    )


def whole_hour(hours: float) -> int:
    """Return the whole clock hour nearest to a clock hour, 1 to 12."""
    return (math.floor(hours + 0.5) + 11) % 12 + 1


def turned_hours(hours: float) -> float:
    """Return the clock hour of the same place in a picture that is turned by 180 degrees."""
    return hours - 6.0 if hours > 6.0 else hours + 6.0


def stand_mm(branch: Branch) -> float:
    """Return the distance in mm before a branch's end from which the camera looks at the fork.

    The distance is one diameter of the branch, at most half the branch and at least `MIN_CAMERA_DISTANCE_MM`, as in
    `carina.case.routes.lookouts_mm`.
    """
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(branch.points, axis=0), axis=1))])
    # The tolerance includes a point exactly in the middle, whatever its rounding.
    first_half = along <= 0.5 * along[-1] + 1e-9
    diameter = 2.0 * float(np.median(branch.radius[first_half]))
    return max(min(diameter, 0.5 * float(along[-1])), MIN_CAMERA_DISTANCE_MM)


def openings_seen(camera: Pose, walls: ForkWalls, branches: Sequence[Branch], walls_lps: Points) -> tuple[Opening, ...]:
    """Return the openings of branches that leave at one place, in the given order.

    Parameters
    ----------
    camera
        Camera before the fork.
    walls
        The walls of the branches.
    branches
        Branches that begin at the fork, in the order of ``walls``.
    walls_lps
        First wall at each pixel of the picture (`first_walls`), (size, size, 3), LPS mm.
    """
    size = walls_lps.shape[0]
    right, down = pixel_angles_rad(size)
    owners = walls.owners(walls_lps)
    outlines = [opening_pixels(owners, n, pixel_at(camera, at, size)) for n, at in enumerate(walls.mouths_lps)]
    found: list[tuple[float, float, bool]] = []
    for outline, mouth in zip(outlines, walls.mouths_lps, strict=True):
        if float(outline.mean()) >= MIN_SHARE:
            found.append((float(right[outline].mean()), float(down[outline].mean()), True))
        else:
            found.append((*picture_angles(camera, mouth), False))
    sizes = [math.hypot(x, y) for x, y, _ in found]
    middle = size // 2
    openings = []
    for n, (branch, outline, (x, y, in_view)) in enumerate(zip(branches, outlines, found, strict=True)):
        others = [size_rad for k, size_rad in enumerate(sizes) if k != n and found[k][2]]
        ahead_limit_deg = max(AHEAD_DEG, AHEAD_SHARE * FOV_DEG * math.sqrt(float(outline.mean()) / math.pi))
        ahead = (
            in_view
            and bool(outline[middle - 1 : middle + 1, middle - 1 : middle + 1].any())
            and math.degrees(sizes[n]) <= ahead_limit_deg
            and all(other >= AHEAD_TIMES * sizes[n] for other in others)
        )
        sine = math.sin(sizes[n]) / max(sizes[n], 1e-12)
        ray = camera.lps_from_camera[:3, :3] @ np.array([sine * x, sine * y, math.cos(sizes[n])])
        away = float(np.linalg.norm(walls.mouths_lps[n] - camera.position_lps))
        wall = walls_lps[outline] if in_view else np.empty((0, 3))
        openings.append(
            Opening(
                branch,
                camera.position_lps + away * ray,
                hours_of(x, y),
                math.degrees(sizes[n]),
                in_view,
                _axis_hidden_deg(outline, pixel_at(camera, walls.mouths_lps[n], size)) if in_view else 0.0,
                ahead_limit_deg,
                ahead,
                outline if in_view else np.zeros_like(outline),
                wall[np.isfinite(wall).all(axis=1)],
                _seen_through(outline, camera, walls.axes_lps[n], walls_lps) if in_view else np.empty((0, 3)),
            )
        )
    return tuple(openings)


def _seen_through(outline: NDArray[np.bool_], camera: Pose, axis_lps: Points, walls_lps: Points) -> Points:
    """Return the first consecutive points of a centreline that are seen in an opening and in front of its wall."""
    inner = np.pad(outline, 1)
    # A dot on the edge could be outside the outline of a finer picture.
    inner = inner[:-2, 1:-1] & inner[2:, 1:-1] & inner[1:-1, :-2] & inner[1:-1, 2:] & outline
    found: list[Points] = []
    for point in axis_lps:
        column, row = (int(v) for v in pixel_at(camera, point, outline.shape[0]))
        depth = float(np.linalg.norm(walls_lps[row, column] - camera.position_lps))
        # The depth is NaN where the ray meets no near wall; a point in front of it counts as seen.
        if inner[row, column] and not float(np.linalg.norm(point - camera.position_lps)) > depth:
            found.append(point)
        elif found:
            break
    return np.array(found).reshape(-1, 3)


def _axis_hidden_deg(outline: NDArray[np.bool_], axis_px: tuple[float, float]) -> float:
    """Return the angle in degrees between a position (column, row) in the picture and the nearest pixel of a mask."""
    rows, columns = np.nonzero(outline)
    nearest_px = float(np.hypot(columns + 0.5 - axis_px[0], rows + 0.5 - axis_px[1]).min())
    # A position inside a pixel is up to .7 pixels from the pixel's centre.
    return float(max(nearest_px - 0.7, 0.0) * FOV_DEG / outline.shape[0])


def hour_doubt(
    camera: Pose, openings: Sequence[Opening], radius_mm: float, title: Callable[[Branch], str]
) -> HourDoubt | None:
    """Return the reason why the clock hour of the first opening is not reliable; None if it is reliable.

    The eye is moved to the sides and the line of sight is tilted by their errors. In each of these views the opening
    must be nearer to its stated direction than every other opening.

    Parameters
    ----------
    camera
        Camera of the openings.
    openings
        Openings of a fork; the first one is the opening to enter.
    radius_mm
        Radius of the airway at the camera.
    title
        Returns the name of a branch.
    """
    taken, others = openings[0], [one for one in openings[1:] if one.in_view]
    if not taken.in_view:
        return HourDoubt(
            "turns.hidden", "no clock hour: the opening is not in view from before the fork; locate it in the slices"
        )
    if taken.axis_hidden_deg > HIDDEN_DEG:
        return HourDoubt(
            "turns.hidden", "no clock hour: most of the opening is hidden before the fork; locate it in the slices"
        )
    for view in (camera, *_moved(camera, radius_mm)):
        x, y = _middle(view, taken)
        off, hours = math.hypot(x, y), hours_of(x, y)
        seen = [(one, *_middle(view, one)) for one in others]
        if taken.straight_ahead:
            rivals = [one for one, x, y in seen if math.hypot(x, y) <= off]
        else:
            margin = _apart(hours, taken.hours) + NEIGHBOUR_HOURS
            rivals = [
                one for one, x, y in seen if not one.straight_ahead and _apart(hours_of(x, y), taken.hours) < margin
            ]
        if rivals:
            return HourDoubt(
                "turns.neighbour",
                f"no clock hour: {title(rivals[0].branch)} opens in nearly the same direction; compare the picture",
            )
        if not taken.straight_ahead and _apart(hours, taken.hours) > MAX_HOURS:
            return HourDoubt(
                "turns.eye",
                f"no clock hour: a small movement of the scope changes it by more than {MAX_HOURS:.0f} hours; compare "
                "the picture",
            )
    return None


def _moved(camera: Pose, radius_mm: float) -> list[Pose]:
    """Return the level cameras with the eye shifted to each side, and with the line of sight tilted to each side."""
    right, down, forward = camera.lps_from_camera[:3, :3].T
    shift = min(max(SHIFT_SHARE * radius_mm, SHIFT_MM[0]), SHIFT_MM[1])
    tilt = math.tan(math.radians(TILT_DEG))
    views = []
    for across in (right, -right, down, -down):
        moved = camera.lps_from_camera.copy()
        moved[:3, 3] += shift * across
        views.append(Pose(moved))
        views.append(levelled(camera.position_lps, forward + tilt * across, "head"))
    return views


def _middle(camera: Pose, opening: Opening) -> tuple[float, float]:
    """Return the angles in rad to the right and down of the middle of an opening's walls from another camera."""
    local = (opening.walls_lps - camera.position_lps) @ camera.lps_from_camera[:3, :3]
    across = np.hypot(local[:, 0], local[:, 1])
    scale = np.arctan2(across, local[:, 2]) / np.maximum(across, 1e-9)
    return float((local[:, 0] * scale).mean()), float((local[:, 1] * scale).mean())


def _apart(one: float, other: float) -> float:
    gap = abs(one - other) % 12.0
    return min(gap, 12.0 - gap)


def pixel_at(camera: Pose, point_lps: Points, size_px: int) -> tuple[float, float]:
    """Return the position (column, row) of a point in the picture of a turn, clamped to the picture."""
    half = size_px / 2.0
    right, down = (half + angle / math.radians(FOV_DEG / 2) * half for angle in picture_angles(camera, point_lps))
    return min(max(right, 0.0), size_px - 1.0), min(max(down, 0.0), size_px - 1.0)


def picture_angles(camera: Pose, point_lps: Points) -> tuple[float, float]:
    """Return the angles in rad to the right and down of a point, in the equidistant picture of a camera."""
    x, y, z = (float(v) for v in camera.lps_from_camera[:3, :3].T @ (point_lps - camera.position_lps))
    across = math.hypot(x, y)
    scale = math.atan2(across, z) / across if across > 0.0 else 0.0
    return x * scale, y * scale


def hours_of(right: float, down: float) -> float:
    """Return the clock hour of a direction from its components to the right and down, 0 < hours <= 12."""
    hours = (math.atan2(right, -down) / math.tau * 12.0) % 12.0
    return 12.0 if hours == 0.0 else hours
