"""Casters of the views without a transfer function: slices, cut-plane, X-ray and tri-plane (paper 3.1)."""

from __future__ import annotations

import threading

import numpy as np
from numpy.typing import NDArray

from carina import _core
from carina.render import geometry
from carina.render.views import CutPlaneView, Picture, RenderStats, SliceView, TriPlaneView, XrayView
from carina.volume import Volume
from carina.volume.anatomical_planes import PLANES

# Brightness of the sagittal, coronal and axial plane of the tri-plane view; the difference makes their edges visible.
PLANE_BRIGHTNESS = (0.8, 0.9, 1.0)
BEHIND_PLANES = (16, 18, 21)
Rows = tuple[int, int] | None


class PlaneCaster:
    """Caster of planes and projections of one volume; any thread may use it. Projections are computed once."""

    def __init__(self, volume: Volume) -> None:
        self._volume = volume
        self._projecting = threading.Lock()
        self._projections: dict[str, tuple[NDArray[np.int16], NDArray[np.float64]]] | None = None

    def render(self, view: CutPlaneView | SliceView | XrayView | TriPlaneView, *, rows: Rows = None) -> Picture:
        """Return the picture of a slice, cut-plane, X-ray or tri-plane view."""
        match view:
            case CutPlaneView():
                return self.cut_plane(view, rows=rows)
            case SliceView():
                return self.slice(view, rows=rows)
            case XrayView():
                return self.xray(view, rows=rows)
            case TriPlaneView():
                return self.tri_plane(view, rows=rows)

    def cut_plane(self, view: CutPlaneView, *, rows: Rows = None) -> Picture:
        """Return the picture of the plane through the tip."""
        right, down, forward = view.pose.lps_from_camera[:3, :3].T
        middle = view.pose.position_lps
        if view.centre_lps is not None:
            aside = np.asarray(view.centre_lps, dtype=np.float64) - middle
            middle = middle + (aside @ right) * right + (aside @ down) * down
        matrix = geometry.plane_matrix(
            middle,
            (right, down, forward),
            view.extent_mm / view.width,
            view.width,
            view.height,
        )
        return self._plane("cut-plane", matrix, view, rows)

    def slice(self, view: SliceView, *, rows: Rows = None) -> Picture:
        """Return the picture of a slice along the patient's axes."""
        return self._plane(view.plane, self._slice_matrix(view), view, rows)

    def xray(self, view: XrayView, *, rows: Rows = None) -> Picture:
        """Return the picture of a maximum intensity projection."""
        with self._projecting:
            if self._projections is None:
                self._projections = _project(self._volume)
            values, place = self._projections[view.axis]
        flat = Volume(values, place)
        right, down = place[:3, 0] / flat.spacing_mm[0], place[:3, 1] / flat.spacing_mm[1]
        depth = place[:3, 2] / flat.spacing_mm[2]
        _, ny, nx = flat.shape_zyx
        mm_per_px = max(nx * flat.spacing_mm[0] / view.width, ny * flat.spacing_mm[1] / view.height)
        matrix = geometry.plane_matrix(flat.centre_lps, (right, down, depth), mm_per_px, view.width, view.height)
        window_hu = view.window_hu
        if window_hu is None:
            # The window reaches from the air beside the patient to dense bone; the percentiles exclude metal and
            # contrast medium.
            low, high = (float(v) for v in np.percentile(values, (2.0, 98.0)))
            window_hu = (max(high - low, 1.0), (low + high) / 2)
        grey, _ = _core.cut_plane(
            flat.hu_zyx,
            flat.lps_from_ijk,
            matrix,
            width=view.width,
            height=view.height,
            window_hu=window_hu,
            rows=rows,
        )
        return _planar_picture(f"xray-{view.axis}", "projection", grey, matrix)

    def tri_plane(self, view: TriPlaneView, *, rows: Rows = None) -> Picture:
        """Return the picture of three planes from an orbit camera."""
        centre = np.asarray(view.centre_lps, dtype=np.float64)
        distance = view.distance_mm
        if distance is None:
            radius = geometry.bounding_radius_mm(geometry.box_corners_lps(self._volume), self._volume.centre_lps)
            # Three planes fill a quarter less of the picture than the bounding sphere of the box.
            distance = 0.75 * radius / float(np.sin(np.deg2rad(view.fov_deg) / 2))
        aim = centre if view.look_at == "point" else self._volume.centre_lps
        pose = geometry.orbit_pose(aim, view.azimuth_deg, view.elevation_deg, distance)
        x, y, z = (float(v) for v in centre)
        rgb = _core.tri_plane(
            self._volume.hu_zyx,
            self._volume.lps_from_ijk,
            (x, y, z),
            pose.lps_from_camera,
            fov_rad=float(np.deg2rad(view.fov_deg)),
            width=view.width,
            height=view.height,
            window_hu=view.window_hu,
            clear_below=view.clear_below,
            background=BEHIND_PLANES,
            brightness=PLANE_BRIGHTNESS,
            rows=rows,
        )
        height = rgb.shape[0]
        count = view.width * height
        return Picture(
            rgb=rgb,
            view="tri-plane",
            stats=RenderStats("plane", view.width, height, count, count, 0, 0, 0, 0, 0, 0.0),
            lps_from_camera=pose.lps_from_camera,
            fov_deg=view.fov_deg,
        )

    def _plane(self, name: str, matrix: NDArray[np.float64], view: CutPlaneView | SliceView, rows: Rows) -> Picture:
        volume = self._volume
        if view.slab is None:
            grey, _ = _core.cut_plane(
                volume.hu_zyx,
                volume.lps_from_ijk,
                matrix,
                width=view.width,
                height=view.height,
                window_hu=view.window_hu,
                rows=rows,
            )
        else:
            starts = matrix[:3, 3] + (np.arange(view.height) + 0.5)[:, None] * matrix[:3, 1]
            lines = np.hstack([starts, np.broadcast_to(matrix[:3, [0, 2]].T.ravel(), (view.height, 6))])
            grey, _ = _core.sample_lines(
                volume.hu_zyx,
                volume.lps_from_ijk,
                np.ascontiguousarray(lines if rows is None else lines[slice(*rows)]),
                width=view.width,
                window_hu=view.window_hu,
                slab=(view.slab.thickness_mm, view.slab.kind),
            )
        return _planar_picture(name, "plane", grey, matrix)

    def _slice_matrix(self, view: SliceView) -> NDArray[np.float64]:
        right, down, depth = geometry.plane_axes(view.plane)
        centre = np.asarray(view.centre_lps, dtype=np.float64)
        if view.mm_per_px is not None:
            return geometry.plane_matrix(centre, (right, down, depth), view.mm_per_px, view.width, view.height)
        corners = geometry.box_corners_lps(self._volume)
        mm_per_px, middle = geometry.fit_mm_per_px(corners, right, down, view.width, view.height)
        on_plane = middle[0] * right + middle[1] * down + float(centre @ depth) * depth
        return geometry.plane_matrix(on_plane, (right, down, depth), mm_per_px, view.width, view.height)


def _planar_picture(name: str, method: str, grey: NDArray[np.uint8], matrix: NDArray[np.float64]) -> Picture:
    height, width = grey.shape
    stats = RenderStats(method, width, height, width * height, width * height, 0, 0, 0, 0, 0, 0.0)
    rgb = np.repeat(grey[:, :, None], 3, axis=2)
    return Picture(rgb=rgb, view=name, stats=stats, lps_from_pixel=matrix)


def _project(volume: Volume) -> dict[str, tuple[NDArray[np.int16], NDArray[np.float64]]]:
    """Compute the three projections in display orientation, each as a volume of one slice with its ``lps_from_ijk``."""
    along = _core.project_maximum(volume.hu_zyx)
    # Axes of the projections' arrays (rows, columns) as grid axes: along i is [k, j], along j [k, i], along k [j, i].
    array_axes = ((2, 1), (2, 0), (1, 0))
    shape_ijk = volume.shape_zyx[::-1]
    axes = dict(zip("xyz", geometry.grid_axes(volume), strict=True))
    out: dict[str, tuple[NDArray[np.int16], NDArray[np.float64]]] = {}
    for name, display in PLANES.items():
        (column_axis, column_sign), (row_axis, row_sign), (depth_axis, depth_sign) = (
            (axes[a[-1]][0], -axes[a[-1]][1] if a[0] == "-" else axes[a[-1]][1])
            for a in (display.right, display.down, display.into)
        )
        values = along[depth_axis]
        if array_axes[depth_axis] != (row_axis, column_axis):
            values = values.T
        values = values[:: int(row_sign), :: int(column_sign)]
        # The first pixel is the first or the last voxel of each axis; the slice lies in the middle of the projected
        # axis.
        first = np.zeros(3)
        first[column_axis] = 0 if column_sign > 0 else shape_ijk[column_axis] - 1
        first[row_axis] = 0 if row_sign > 0 else shape_ijk[row_axis] - 1
        first[depth_axis] = (shape_ijk[depth_axis] - 1) / 2
        steps = volume.lps_from_ijk[:3, :3]
        place = np.eye(4)
        place[:3, 0], place[:3, 1] = column_sign * steps[:, column_axis], row_sign * steps[:, row_axis]
        place[:3, 2], place[:3, 3] = depth_sign * steps[:, depth_axis], volume.to_lps(first)
        out[name] = (np.ascontiguousarray(values)[None], place)
    return out
