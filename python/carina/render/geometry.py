"""Positions of the pixels of planes and projections, and poses of orbit cameras, in LPS mm."""

from __future__ import annotations

from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from carina.scopes import Pose
from carina.volume import Volume
from carina.volume.anatomical_planes import PLANES, Plane

Matrix = NDArray[np.float64]


def plane_axes(plane: Plane) -> tuple[Matrix, Matrix, Matrix]:
    """Return the unit directions right, down and into the screen of a slice's display, LPS."""
    display = PLANES[plane]
    right, down = _axis_direction(display.right), _axis_direction(display.down)
    return right, down, np.cross(right, down)


def _axis_direction(axis: str) -> Matrix:
    """Return the unit vector, LPS, of a signed patient axis that is given as text such as ``-z``."""
    direction = np.zeros(3)
    direction["xyz".index(axis[-1])] = -1.0 if axis[0] == "-" else 1.0
    return direction


def plane_matrix(
    centre_lps: Matrix, axes: tuple[Matrix, Matrix, Matrix], mm_per_px: float, width: int, height: int
) -> Matrix:
    """Return the matrix ``lps_from_pixel`` of a plane, which maps pixel positions to LPS mm.

    Parameters
    ----------
    centre_lps
        Position of the pixel corner in the middle of the picture, LPS mm.
    axes
        Unit directions right, down and depth.
    mm_per_px
        Size of a pixel.
    width, height
        Size of the picture in pixels.
    """
    right, down, depth = axes
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = right * mm_per_px, down * mm_per_px, depth
    matrix[:3, 3] = centre_lps - matrix[:3, 0] * (width / 2) - matrix[:3, 1] * (height / 2)
    return matrix


def box_corners_lps(volume: Volume) -> Matrix:
    """Return the eight corners of the box that encloses all voxels of a volume, (8, 3), LPS mm."""
    nz, ny, nx = volume.shape_zyx
    ends = [(-0.5, nx - 0.5), (-0.5, ny - 0.5), (-0.5, nz - 0.5)]
    return volume.to_lps(np.array([[x, y, z] for x in ends[0] for y in ends[1] for z in ends[2]]))


def fit_mm_per_px(points_lps: Matrix, right: Matrix, down: Matrix, width: int, height: int) -> tuple[float, Matrix]:
    """Return the pixel size at which points fit a picture, and the offset of their middle along right and down, mm."""
    across, along = points_lps @ right, points_lps @ down
    extents = np.array([np.ptp(across) / width, np.ptp(along) / height])
    middle = np.array([(across.min() + across.max()) / 2, (along.min() + along.max()) / 2])
    return float(max(extents.max(), 1e-6)), middle


def grid_axes(volume: Volume) -> tuple[tuple[int, float], tuple[int, float], tuple[int, float]]:
    """Return for each patient axis x, y, z the nearest grid axis and its sign along the patient axis."""
    directions = volume.lps_from_ijk[:3, :3] / np.array(volume.spacing_mm)
    order = max(permutations(range(3)), key=lambda p: sum(abs(directions[a, p[a]]) for a in range(3)))
    x, y, z = ((order[a], 1.0 if directions[a, order[a]] >= 0 else -1.0) for a in range(3))
    return x, y, z


def bounding_radius_mm(points_lps: Matrix, centre_lps: Matrix) -> float:
    """Return the radius in mm of the smallest sphere round a given centre that contains all points."""
    return float(np.linalg.norm(points_lps - centre_lps, axis=1).max())


def orbit_pose(centre_lps: Matrix, azimuth_deg: float, elevation_deg: float, distance_mm: float) -> Pose:
    """Return the pose of a camera that looks at a point from an orbit.

    Azimuth 0 is anterior of the point, 90 on the patient's left; elevation 90 is above the point.
    """
    azimuth, elevation = np.deg2rad(azimuth_deg), np.deg2rad(elevation_deg)
    out = np.array([np.sin(azimuth) * np.cos(elevation), -np.cos(azimuth) * np.cos(elevation), np.sin(elevation)])
    # The axes have explicit formulas without an up vector, so the poles are not a special case.
    right = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = right, np.cross(-out, right), -out
    matrix[:3, 3] = centre_lps + distance_mm * out
    return Pose(matrix)
