"""External view of the lumen: a smooth field from its mask, cast like any volume."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina import _core
from carina.render import geometry
from carina.render.transfer_function import Light
from carina.render.views import Picture, RenderStats, TreeView
from carina.render.wall import bounding_box

# The field is 1024 deep inside. A threshold of 512 would give the mask's surface but lose branches one voxel thick,
# whose field is only 256.
SURFACE = np.array([[110.0, 0.86, 0.80, 0.72, 0.0], [190.0, 0.86, 0.80, 0.72, 0.999]])
LIGHT = Light(ambient=0.18, diffuse=0.82, specular=0.15, shininess_log2=4)
BACKGROUND = (0.055, 0.06, 0.07)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LeapedValues:
    """Values of a volume, and for each voxel the number of voxels that a ray may skip there."""

    values: NDArray[np.int16]
    radius: NDArray[np.uint8]
    """Radius, in voxels, of the largest cube of equal labels round each voxel."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TreeField(LeapedValues):
    """Smooth field of a lumen on a grid cropped to the lumen's box, with the map of the field's empty regions."""

    lps_from_ijk: NDArray[np.float64]
    centre_lps: NDArray[np.float64]
    radius_mm: float
    step_mm: float


def build_tree_field(lumen_zyx: NDArray[np.uint8], lps_from_ijk: NDArray[np.float64]) -> TreeField | None:
    """Build the smooth field of a lumen mask for the external view; return None for an empty mask."""
    box = bounding_box(lumen_zyx, 0)
    if box is None:
        return None
    # Two empty voxels on every side, also beyond the volume's edge, close the end of a trachea that the scan cuts off.
    part = np.ascontiguousarray(np.pad(lumen_zyx[box], 2))
    values = _core.smooth_mask(part)
    place = np.array(lps_from_ijk, dtype=np.float64)
    first = np.array([box[2].start - 2, box[1].start - 2, box[0].start - 2], dtype=np.float64)
    place[:3, 3] += place[:3, :3] @ first
    inside = np.argwhere(part != 0)[:, ::-1] @ place[:3, :3].T + place[:3, 3]
    centre = (inside.min(axis=0) + inside.max(axis=0)) / 2
    spacing = np.linalg.norm(place[:3, :3], axis=0)
    return TreeField(
        values=values,
        lps_from_ijk=place,
        radius=_core.build_cell_map(values, _core.transparent_runs(SURFACE)),
        centre_lps=centre,
        radius_mm=geometry.bounding_radius_mm(inside, centre) + float(spacing.max()),
        step_mm=0.4 * float(spacing.min()),
    )


def cast_tree(
    tree: TreeField,
    view: TreeView,
    *,
    rows: tuple[int, int] | None = None,
    simd: str | None = None,
    stop: _core.CancelToken | None = None,
) -> Picture:
    """Return the picture of the tree from outside."""
    distance = view.distance_mm
    if distance is None:
        distance = tree.radius_mm / float(np.sin(np.deg2rad(view.fov_deg) / 2))
    pose = geometry.orbit_pose(tree.centre_lps, view.azimuth_deg, view.elevation_deg, distance)
    table = _core.TransferTable(SURFACE, reference_mm=1.0, step_mm=tree.step_mm, lo=0, hi=1024)
    rgb, counts = _core.cast(
        tree.values,
        tree.lps_from_ijk,
        table,
        pose.lps_from_camera,
        fov_rad=float(np.deg2rad(view.fov_deg)),
        width=view.width,
        height=view.height,
        rows=rows,
        light=LIGHT.as_core(),
        background=BACKGROUND,
        leap=tree.radius,
        simd=simd,
        stop=stop,
    )
    return Picture(
        rgb=rgb,
        view="tree",
        stats=RenderStats("leap", view.width, rgb.shape[0], *counts, seconds=0.0),
        lps_from_camera=pose.lps_from_camera,
        fov_deg=view.fov_deg,
    )
