"""Openings of branches in the pictures of a flight: which are in sight, how large, and how far from the middle.

docs/training.md defines *in sight*; its limits are definitions of Carina, not pass marks.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from carina.breathing import ChestDeformation
from carina.display import one_line
from carina.plan.turns.opening_walls import ForkWalls
from carina.scopes import Optics, ScopePreset, WallField
from carina.track import AirwayTree
from carina.training.flight_frames import FlightFrames

PICTURE_PX = 64
"""Width and height in pixels of the pictures in which openings are counted."""
MIN_PICTURE_SHARE = 0.01
"""Share of the picture's pixels below which an unoccluded opening does not count as in sight."""
MIN_CLEAR_SHARE = 0.5
"""Minimum share of an opening's area, in the picture and not hidden by the wall, for the opening to be in sight."""
DISK_POINTS = 200
"""Number of points, spread evenly over an opening, from which its visible share is counted."""
MAX_RED_OUT = 0.5
"""Maximum red-out (share of the picture that touches the wall) at which openings count as in sight; see `red_out`."""
LINE_STEP_MM = 0.5
"""Distance in mm between the points of a line of sight at which the lumen is checked."""
BEFORE_OPENING_MM = 1.0
"""Length in mm of the end of a line of sight that is not checked, because the edge of an opening is in the wall."""
SHORT_MM = 0.5
"""Distance in mm between fork and opening below which the whole branch gives the direction of the opening."""
SMALL_SINE = math.sin(math.radians(3.0))
"""Ratio of radius and distance of an opening below which it covers far less than :data:`MIN_PICTURE_SHARE`."""

Points = NDArray[np.float64]


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class BranchOpening:
    """Opening of a branch: a disk at the start of the branch, perpendicular to it."""

    branch_id: int
    name: str
    middle_lps: Points = field(repr=False)
    """(3,) middle of the disk, LPS mm: where the centreline has left all other branches (`ForkWalls`)."""
    dir_lps: Points = field(repr=False)
    """Unit vector (3,) from the fork to the middle of the opening, LPS."""
    radius_mm: float
    """Radius in mm of the lumen at ``middle_lps`` (`Branch.radius`), or of the largest ball in it if that is larger."""


def branch_openings(
    tree: AirwayTree, branch_ids: Sequence[int], wall: WallField | None = None
) -> tuple[BranchOpening, ...]:
    """Return the opening of each branch; without a wall the radius is that of the tree alone."""
    made = []
    for branch_id in branch_ids:
        branch = tree.branch(branch_id)
        fork = branch.points[0]
        middle = ForkWalls(tree, fork, [branch_id]).own_mouths_lps[0]
        along = middle - fork
        if float(np.linalg.norm(along)) < SHORT_MM:
            along = branch.points[-1] - fork
        nearest = int(np.argmin(np.linalg.norm(branch.points - middle, axis=1)))
        # The radius of the search is too small in places where its threshold cuts a narrow lumen.
        ball_mm = 0.0 if wall is None else float(wall.ball_mm(middle)[0])
        made.append(
            BranchOpening(
                branch_id,
                branch.name or f"branch {branch_id}",
                middle,
                along / max(float(np.linalg.norm(along)), 1e-9),
                max(float(branch.radius[nearest]), ball_mm),
            )
        )
    return tuple(made)


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class OpeningSights:
    """Openings in the frames of a flight."""

    in_sight: NDArray[np.bool_] = field(repr=False)
    """(n, openings) whether the opening is in sight."""
    off_middle: Points = field(repr=False)
    """(n, openings) distance of the opening's visible pixels from the middle of the picture, in radii of the picture.

    Infinite if the opening is not in sight.
    """


def red_out(wall_mm: Points, tip_radius_mm: Points | float) -> Points:
    """Return the red-out, 0 to 1, from the distance of the tip to the wall; as `ScopeState.red_out`."""
    return np.clip((0.6 * tip_radius_mm - wall_mm) / (0.45 * tip_radius_mm), 0.0, 1.0)


def clear_views(frames: FlightFrames, wall: WallField) -> NDArray[np.bool_]:
    """Return (n,) whether the red-out is below :data:`MAX_RED_OUT` at each frame."""
    tip_mm = np.array([one.scope.tip_mm / 2.0 for one in frames.optics])[frames.optics_number]
    clear: NDArray[np.bool_] = red_out(frames.tips_to_wall_mm(wall), tip_mm) < MAX_RED_OUT
    return clear


def openings_in_sight(
    frames: FlightFrames,
    openings: Sequence[BranchOpening],
    wall: WallField,
    *,
    first: int,
    last: int,
    report: Callable[[float], None] | None = None,
) -> OpeningSights:
    """Return which openings are in sight in the frames from ``first`` to ``last``; none are in sight in other frames.

    Parameters
    ----------
    frames
        Frames of the flight.
    openings
        The openings.
    wall
        Wall of the airways.
    first, last
        First and last frame.
    report
        Called with the share of the frames that are done.
    """
    num = len(frames.lps_from_tip)
    in_sight = np.zeros((num, len(openings)), dtype=bool)
    off_middle = np.full((num, len(openings)), np.inf)
    if not openings:
        return OpeningSights(in_sight, off_middle)
    cameras = frames.cameras()
    clear_view = clear_views(frames, wall)
    middles = np.stack([one.middle_lps for one in openings])
    directions = np.stack([one.dir_lps for one in openings])
    for n in range(first, last + 1):
        if n > first and _same(frames, n):
            in_sight[n], off_middle[n] = in_sight[n - 1], off_middle[n - 1]
            continue
        if report is not None and n % 50 == 0:
            report((n - first) / max(last - first, 1))
        if not clear_view[n]:
            continue
        optics = frames.optics[frames.optics_number[n]]
        rays, places, total, lens = _picture(optics.scope, optics.counted_fov_deg)
        camera = shown_in = cameras[n]
        deformation = frames.deformation(n)
        if deformation is not None:
            rays, camera, shown_in = _at_rest(rays, camera, deformation)
        to_middles = middles - camera[:3, 3]
        ahead = (to_middles * directions).sum(axis=1) > 0.0
        for k in np.flatnonzero(ahead).tolist():
            found = _visible_pixels(openings[k], camera, rays, wall, least=MIN_PICTURE_SHARE * total)
            if found is None:
                continue
            if _visible_share(openings[k], shown_in, lens, optics.counted_fov_deg, wall) >= MIN_CLEAR_SHARE:
                in_sight[n, k] = True
                off_middle[n, k] = float(np.linalg.norm(places[found].mean(axis=0)))
    return OpeningSights(in_sight, off_middle)


def _same(frames: FlightFrames, n: int) -> bool:
    """Return whether a frame shows the same picture as the frame before."""
    return bool(
        not frames.motions
        and frames.pose_number[n] == frames.pose_number[n - 1]
        and frames.optics_number[n] == frames.optics_number[n - 1]
    )


def _at_rest(rays: Points, camera: Points, deformation: ChestDeformation) -> tuple[Points, Points, Points]:
    """Return rays, camera and axes of a picture of the moved patient in the CT at rest, where openings and wall are.

    The map is affine, so a line of sight remains a line, and what it meets remains the same.

    Returns
    -------
    tuple
        The rays (m, 3) as unit vectors, LPS; the camera (4, 4) at rest, with the axes of LPS; and the camera (4, 4)
        whose axes map a row vector at rest to camera space of the picture, up to its length.
    """
    stretch = deformation.lps_from_rest[:3, :3]
    ways = rays @ np.linalg.solve(stretch, camera[:3, :3]).T
    seen_from, shown_in = np.eye(4), np.eye(4)
    seen_from[:3, 3] = shown_in[:3, 3] = deformation.rest_points(camera[:3, 3])[0]
    shown_in[:3, :3] = stretch.T @ camera[:3, :3]
    return ways / np.linalg.norm(ways, axis=1)[:, None], seen_from, shown_in


def _visible_pixels(
    opening: BranchOpening, camera: Points, rays: Points, wall: WallField, *, least: float
) -> NDArray[np.int64] | None:
    """Return the indices of the rays that meet an opening before a wall; None if they are fewer than ``least``."""
    eye, lps_from_camera = camera[:3, 3], camera[:3, :3]
    middle = lps_from_camera.T @ (opening.middle_lps - eye)
    away = float(np.linalg.norm(middle))
    # The disk is within this angle of its middle, so only few rays can meet it.
    sine = min(opening.radius_mm / max(away, 1e-9), 1.0)
    if sine < SMALL_SINE:
        return None
    near = np.flatnonzero(rays @ middle >= away * (np.sqrt(1.0 - sine**2) - 1e-6))
    normal = lps_from_camera.T @ opening.dir_lps
    slope = rays[near] @ normal
    near, slope = near[slope > 1e-6], slope[slope > 1e-6]
    depth = float(middle @ normal) / slope
    on_disk = ((depth[:, None] * rays[near] - middle) ** 2).sum(axis=1) <= opening.radius_mm**2
    hit, depth = near[on_disk], depth[on_disk]
    if len(hit) < least or not len(hit):
        return None
    clear: NDArray[np.int64] = hit[_lines_in_lumen(eye, rays[hit] @ lps_from_camera.T, depth, wall)]
    return clear if len(clear) >= least else None


def _visible_share(opening: BranchOpening, camera: Points, lens: Optics, fov_deg: float, wall: WallField) -> float:
    """Return the share of an opening's area that is in the picture and that the wall does not hide.

    The axes of ``camera`` need not be unit vectors.
    """
    eye = camera[:3, 3]
    ways = opening.middle_lps + opening.radius_mm * _spiral() @ _disk_axes(opening.dir_lps) - eye
    depth = np.linalg.norm(ways, axis=1)
    rays = ways / np.maximum(depth, 1e-9)[:, None]
    in_camera = rays @ camera[:3, :3]
    in_camera /= np.maximum(np.linalg.norm(in_camera, axis=1), 1e-9)[:, None]
    with np.errstate(invalid="ignore"):
        off = np.linalg.norm(lens.pixels_of(in_camera) - PICTURE_PX / 2, axis=1)
        shown = (off <= PICTURE_PX / 2) & (in_camera[:, 2] >= np.cos(np.radians(fov_deg / 2.0)) - 1e-9)
    if int(shown.sum()) < MIN_CLEAR_SHARE * DISK_POINTS:
        return 0.0
    return int(_lines_in_lumen(eye, rays[shown], depth[shown], wall).sum()) / DISK_POINTS


def _disk_axes(direction: Points) -> Points:
    """Return the axes (2, 3) of a disk across a direction, as docs/training.md defines them."""
    right = np.cross(direction, (1.0, 0.0, 0.0) if abs(direction[0]) < 0.9 else (0.0, 1.0, 0.0))
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(right, direction)])


@functools.cache
def _spiral() -> Points:
    """Return points (n, 2) that are spread evenly over the unit disk, on a spiral of the golden angle."""
    number = np.arange(DISK_POINTS)
    radius, angle = np.sqrt((number + 0.5) / DISK_POINTS), number * np.pi * (3.0 - np.sqrt(5.0))
    points: Points = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return points


def _lines_in_lumen(eye: Points, rays_lps: Points, depth_mm: Points, wall: WallField) -> NDArray[np.bool_]:
    """Return whether each line of sight stays in the lumen up to :data:`BEFORE_OPENING_MM` before its end."""
    num = int(max(0.0, float(depth_mm.max()) - BEFORE_OPENING_MM) / LINE_STEP_MM) + 1
    steps = LINE_STEP_MM * np.arange(num)
    ray, step = np.nonzero(steps[None] <= depth_mm[:, None] - BEFORE_OPENING_MM)
    inside = np.ones(len(rays_lps), dtype=bool)
    if len(ray):
        outside = wall.distance_mm(eye + steps[step, None] * rays_lps[ray]) <= 0.0
        inside[ray[outside]] = False
    return inside


@functools.lru_cache(maxsize=8)
def _picture(scope: ScopePreset, fov_deg: float) -> tuple[Points, Points, int, Optics]:
    """Return rays (m, 3) and places of the pixels in the field of view, number of pixels in the circle, and optics.

    The picture is the circle that the instrument's picture of :data:`PICTURE_PX` pixels contains. A place is the
    distance to the right and down from the middle, in radii of the picture. Pixels beyond ``fov_deg`` do not count.
    """
    steps = np.arange(PICTURE_PX) + 0.5
    down, right = np.meshgrid(steps, steps, indexing="ij")
    pixels = np.stack([right.ravel(), down.ravel()], axis=1)
    places = (pixels - PICTURE_PX / 2) / (PICTURE_PX / 2)
    inside = np.linalg.norm(places, axis=1) <= 1.0
    pixels, places = pixels[inside], places[inside]
    optics = scope.lens.optics(PICTURE_PX, PICTURE_PX, scope.usual_fov_deg)
    rays = optics.directions_of(pixels)
    with np.errstate(invalid="ignore"):
        counted = rays[:, 2] >= np.cos(np.radians(fov_deg / 2.0)) - 1e-9
    return rays[counted], places[counted], len(pixels), optics
