"""Start pose of a flight, and poses that show a point in the airways."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from carina.scopes import Pose

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carina.track import Airways
    from carina.volume import Volume

CAUDAL_LPS = (0.0, 0.0, -1.0)
# Distances, in mm, of the camera before a point; the largest one with a free line of sight is used.
DISTANCES_MM = (12.0, 10.0, 8.0, 6.0, 4.0, 3.0, 2.0)
# Length of the line of sight before the point, in mm, that is not tested: the point may be in the wall.
WALL_MM = 1.5


def pose_before_airways(volume: Volume) -> Pose:
    """Return a pose for the first images, while the trachea is unknown.

    The camera is in the upper chest, at one fifth of the volume's height below its top, and looks caudally. The pose is
    replaced by :func:`pose_at_root` unless the user has moved the tip.
    """
    nz, ny, nx = volume.shape_zyx
    corners = volume.to_lps(
        np.array([[i, j, k] for i in (0, nx - 1) for j in (0, ny - 1) for k in (0, nz - 1)], dtype=float)
    )
    top, bottom = float(corners[:, 2].max()), float(corners[:, 2].min())
    at = volume.centre_lps.copy()
    at[2] = top - 0.2 * (top - bottom)
    if not volume.contains_lps(at):
        # In oblique grids the vertical line through the centre may be outside the volume at this height.
        at = volume.centre_lps
    return Pose.looking([float(v) for v in at], CAUDAL_LPS)


def pose_at_root(airways: Airways) -> Pose:
    """Return the pose at the root that looks along the first branch; anterior is up (operator at the head)."""
    root = airways.tree.root
    direction = root.points[-1] - root.points[0]
    at = [float(v) for v in airways.root_lps]
    if float(np.linalg.norm(direction)) < 1e-6:
        return Pose.looking(at, CAUDAL_LPS)
    return Pose.looking(at, [float(v) for v in direction])


def pose_before_place(
    airways: Airways, volume: Volume, lps: tuple[float, float, float], branch_id: int | None
) -> Pose | None:
    """Return a pose in the lumen that looks at a point of a branch from the side of the root.

    The camera is on the route from the root, at most 12 mm before the point, where the straight line to the point lies
    in the lumen; if there is no such position, 2 mm before the point.

    Parameters
    ----------
    airways, volume
        The airways, and the CT from which they were segmented.
    lps
        The point, in LPS and mm.
    branch_id
        ID of the branch of the point; None or an unknown ID means the nearest branch.

    Returns
    -------
    Pose or None
        None if the point is the root itself, because the route has no position before it.
    """
    place = np.asarray(lps, dtype=np.float64)
    tree = airways.tree
    if branch_id is None or all(branch.id != branch_id for branch in tree.branches):
        branch_id = tree.nearest_branch(place)[0].id
    way = tree.route_to(branch_id)
    at = int(np.argmin(np.linalg.norm(way.points_lps - place, axis=1)))
    stand = None
    for back_mm in DISTANCES_MM:
        along_mm = way.cumulative_mm[at] - back_mm
        if along_mm < 0.0:
            continue
        stand = np.array([np.interp(along_mm, way.cumulative_mm, way.points_lps[:, axis]) for axis in range(3)])
        if _is_in_view(airways.lumen_zyx, volume, stand, place):
            break
    if stand is None:
        stand = way.points_lps[0]
    direction = place - stand
    return None if float(np.linalg.norm(direction)) < 1e-3 else Pose.looking(stand, direction)


def _is_in_view(
    lumen_zyx: NDArray[np.uint8], volume: Volume, stand: NDArray[np.float64], place: NDArray[np.float64]
) -> bool:
    length_mm = float(np.linalg.norm(place - stand))
    shares = np.linspace(0.0, max(1.0 - WALL_MM / max(length_mm, 1e-9), 0.0), 40)
    ijk = np.rint(volume.to_ijk(stand + shares[:, None] * (place - stand))).astype(np.int64)
    i, j, k = np.clip(ijk, 0, np.array(lumen_zyx.shape[::-1]) - 1).T
    return bool(lumen_zyx[k, j, i].all())
