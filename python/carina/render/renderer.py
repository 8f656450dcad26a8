"""The single-machine renderer: one volume, one transfer function, all views."""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carina import _core
from carina.errors import CancelledError, GeometryError, RenderError
from carina.render import geometry
from carina.render.mapcache import MapCache, content_key
from carina.render.transfer import TransferFunction, transfer_from_histogram, transfer_preset
from carina.render.tree import TreeField, build_tree_field, cast_tree
from carina.render.views import (
    AirwayView,
    CutPlaneView,
    Picture,
    RenderStats,
    SliceView,
    TreeView,
    TriPlaneView,
    View,
    XrayView,
)
from carina.render.wall import wall_levels, with_wall
from carina.volume import Volume

__all__ = ["Renderer"]

Progress = Callable[[str, float | None], None]
Cancel = Callable[[], bool]

# Brightness of the sagittal, coronal and axial plane of the tri-plane view, so that the eye finds their edges.
PLANE_BRIGHTNESS = (0.8, 0.9, 1.0)
BEHIND_PLANES = (16, 18, 21)
# Radius maps kept in memory: going back and forth between two transfer functions costs nothing.
MAPS_IN_MEMORY = 2


@dataclass(frozen=True, slots=True, eq=False)
class _Maps:
    """What leaping needs for one set of values and one transfer function."""

    values: NDArray[np.int16]
    runs: tuple[tuple[int, int], ...]
    radius: NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class _ClassMaps:
    """Labels of all classes, their radii, and one value of each class; for leaps by the step table."""

    values: NDArray[np.int16]
    points: NDArray[np.float64]
    labels: NDArray[np.uint8]
    radius: NDArray[np.uint8]
    class_values: list[int]


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """What pictures are made from; never changed, only replaced."""

    transfer: TransferFunction
    lumen: NDArray[np.uint8] | None
    values: NDArray[np.int16]
    """Values of the airway view: the volume's, or a copy with the wall."""
    range: tuple[int, int]
    tree: TreeField | None
    maps: _Maps | None
    class_maps: _ClassMaps | None


class Renderer:
    """Renders all views of one volume.

    Pictures can be rendered in one thread while another prepares maps or sets the lumen or the transfer function: a
    picture sees the state before or after a change, never between.

    Parameters
    ----------
    volume
        The volume; not copied.
    transfer
        Transfer function of the airway view; the *endoscopic* preset, or one from the histogram where the volume is not
        in HU.
    cache_dir
        Folder for radius maps; None keeps them in memory only.
    simd
        Instruction set of the kernels (``portable``, ``avx2``, ``avx512``) for tests; unless told, what ``CARINA_SIMD``
        names, or the fastest of this machine. The pictures are the same.
    """

    def __init__(
        self,
        volume: Volume,
        *,
        transfer: TransferFunction | None = None,
        cache_dir: Path | None = None,
        simd: str | None = None,
    ) -> None:
        if transfer is None:
            transfer = transfer_preset("endoscopic") if volume.is_hu else transfer_from_histogram(volume)[0]
        self._volume = volume
        self._cache = None if cache_dir is None else MapCache(cache_dir)
        self._simd = simd
        self._range = (int(volume.hu_zyx.min()), int(volume.hu_zyx.max()))
        self._scene = _Scene(transfer, None, volume.hu_zyx, self._range, None, None, None)
        self._swap = threading.Lock()
        self._change = threading.Lock()
        self._projecting = threading.Lock()
        self._kept: list[_Maps] = []
        self._tables: dict[tuple[int, float], tuple[TransferFunction, _core.TransferTable]] = {}
        self._projections: dict[str, tuple[NDArray[np.int16], NDArray[np.float64]]] | None = None

    @property
    def volume(self) -> Volume:
        """The volume."""
        return self._volume

    @property
    def transfer(self) -> TransferFunction:
        """The transfer function of the airway view."""
        return self._scene.transfer

    @property
    def prepared(self) -> bool:
        """True if ``leap`` leaps; else it renders the same picture by brute force."""
        return self._scene.maps is not None

    def set_transfer(self, transfer: TransferFunction) -> None:
        """Show the volume with another transfer function; call ``prepare`` again, unless its map is still in memory."""
        with self._change:
            self._replace(transfer, self._scene.lumen, self._scene.tree)

    def set_lumen(self, lumen_zyx: NDArray[np.uint8] | None) -> None:
        """The airway lumen ``(nz, ny, nx)`` on the volume's grid, for the wall and the tree view; None for none known.

        Raises
        ------
        GeometryError
            If the mask has another shape than the volume.
        """
        if lumen_zyx is not None:
            lumen_zyx = np.ascontiguousarray(lumen_zyx, dtype=np.uint8)
            if lumen_zyx.shape != self._volume.shape_zyx:
                msg = f"the lumen has shape {lumen_zyx.shape}, the volume {self._volume.shape_zyx}"
                raise GeometryError(msg, code="geometry.shape")
        tree = None if lumen_zyx is None else build_tree_field(lumen_zyx, self._volume.lps_from_ijk)
        with self._change:
            self._replace(self._scene.transfer, lumen_zyx, tree)

    def _replace(self, transfer: TransferFunction, lumen: NDArray[np.uint8] | None, tree: TreeField | None) -> None:
        old = self._scene
        walled = transfer.wall and lumen is not None
        levels = wall_levels(transfer)
        was_walled = old.transfer.wall and old.lumen is not None
        if not walled:
            values, value_range = self._volume.hu_zyx, self._range
        elif was_walled and old.lumen is lumen and wall_levels(old.transfer) == levels:
            values, value_range = old.values, old.range
        else:
            assert lumen is not None
            values = with_wall(self._volume.hu_zyx, lumen, levels)
            value_range = (self._range[0], max(self._range[1], int(values.max())))
        maps = self._find_kept(values, _runs(transfer))
        with self._swap:
            self._scene = _Scene(transfer, lumen, values, value_range, tree, maps, None)
            self._tables.clear()

    def _find_kept(self, values: NDArray[np.int16], runs: tuple[tuple[int, int], ...]) -> _Maps | None:
        return next((m for m in self._kept if m.values is values and m.runs == runs), None)

    def prepare(
        self, progress: Progress | None = None, cancel: Cancel | None = None, *, all_classes: bool | None = None
    ) -> None:
        """Build the IsoRegion map for the present transfer function and lumen, or take it from the cache.

        Parameters
        ----------
        progress
            Called with what is being done and the fraction done.
        cancel
            Asked between steps.
        all_classes
            Also build labels and radii of opaque classes, for leaps by the step table with shading off (paper 4.3).
            Unless told, only for transfer functions of sampling ``nearest``, which are the paper's. Twice the memory.

        Raises
        ------
        CancelledError
            If ``cancel`` said so; what was ready before stays in use.
        """

        def step(what: str, fraction: float | None) -> None:
            if cancel is not None and cancel():
                raise CancelledError("stopped while preparing the volume for fast pictures")
            if progress is not None:
                progress(what, fraction)

        what = "preparing fast pictures"
        while True:
            scene = self._scene
            wants_classes = scene.transfer.sampling == "nearest" if all_classes is None else all_classes
            step(what, 0.0)
            maps = scene.maps or self._build_maps(scene)
            step(what, 0.6)
            class_maps = scene.class_maps
            if wants_classes and class_maps is None:
                class_maps = _build_class_maps(scene)
            step(what, 1.0)
            with self._swap:
                # The transfer function or the lumen may have changed meanwhile: then these maps are of the past.
                if self._scene is scene:
                    self._scene = dataclasses.replace(scene, maps=maps, class_maps=class_maps)
                    self._kept = [maps, *(m for m in self._kept if m is not maps)][:MAPS_IN_MEMORY]
                    return

    def _build_maps(self, scene: _Scene) -> _Maps:
        runs = _runs(scene.transfer)
        key = None if self._cache is None else content_key(scene.values, list(runs))
        if self._cache is not None and key is not None:
            found = self._cache.load(key, self._volume.shape_zyx)
            if found is not None:
                return _Maps(scene.values, runs, found)
        radius = _core.build_transparent_map(
            scene.values, scene.transfer.points, reference_mm=scene.transfer.reference_mm, bin_hu=scene.transfer.bin_hu
        )
        if self._cache is not None and key is not None:
            self._cache.store(key, radius)
        return _Maps(scene.values, runs, radius)

    def render(self, view: View, *, rows: tuple[int, int] | None = None) -> Picture:
        """Render one view.

        Parameters
        ----------
        view
            What to render.
        rows
            Only for the airway view: first row and the row after the last. Strips put together are the whole picture,
            bit for bit.

        Raises
        ------
        RenderError
            If the view cannot be rendered: a tree without a lumen, a setting out of range.
        """
        started = time.perf_counter()
        if rows is not None and not isinstance(view, AirwayView):
            raise RenderError("only the airway view is rendered in strips", code="render.setting")
        match view:
            case AirwayView():
                picture = self._airway(view, rows)
            case CutPlaneView():
                right, down, forward = view.pose.lps_from_camera[:3, :3].T
                matrix = geometry.plane_matrix(
                    view.pose.position_lps,
                    (right, down, forward),
                    view.extent_mm / view.width,
                    view.width,
                    view.height,
                )
                picture = self._plane("cut-plane", matrix, view.width, view.height, view.window_hu)
            case SliceView():
                picture = self._plane(view.plane, self._slice_matrix(view), view.width, view.height, view.window_hu)
            case XrayView():
                picture = self._xray(view)
            case TriPlaneView():
                picture = self._tri_plane(view)
            case TreeView():
                picture = self._tree(view)
        return dataclasses.replace(
            picture, stats=dataclasses.replace(picture.stats, seconds=time.perf_counter() - started)
        )

    def _table(self, scene: _Scene, step_mm: float) -> _core.TransferTable:
        key = (id(scene.values), step_mm)
        with self._swap:
            kept = self._tables.get(key)
        # The entry keeps its transfer function alive, so the identity cannot be another's.
        if kept is not None and kept[0] is scene.transfer:
            return kept[1]
        table = _core.TransferTable(
            scene.transfer.points,
            reference_mm=scene.transfer.reference_mm,
            step_mm=step_mm,
            lo=scene.range[0],
            hi=scene.range[1],
            bin_hu=scene.transfer.bin_hu,
        )
        with self._swap:
            if len(self._tables) > 8:
                self._tables.clear()
            self._tables[key] = (scene.transfer, table)
        return table

    def _airway(self, view: AirwayView, rows: tuple[int, int] | None) -> Picture:
        scene = self._scene
        nearest = scene.transfer.sampling == "nearest"
        step_vox = 1.0 if nearest else view.step_vox
        shading = view.shading and not nearest
        method, leap = _choose_method(scene, view, shading)
        rgb, counts = _core.cast(
            scene.values,
            self._volume.lps_from_ijk,
            self._table(scene, step_vox * min(self._volume.spacing_mm)),
            view.pose.lps_from_camera,
            fov_rad=float(np.deg2rad(view.fov_deg)),
            width=view.width,
            height=view.height,
            rows=rows,
            light=scene.transfer.light.as_core() if shading else None,
            nearest=nearest,
            leap=leap,
            simd=self._simd,
        )
        return Picture(
            rgb=rgb,
            view="airway",
            stats=RenderStats(method, view.width, rgb.shape[0], *counts, seconds=0.0),
            lps_from_camera=view.pose.lps_from_camera,
            fov_deg=view.fov_deg,
        )

    def _plane(
        self, name: str, matrix: NDArray[np.float64], width: int, height: int, window_hu: tuple[float, float]
    ) -> Picture:
        grey, _ = _core.cut_plane(
            self._volume.hu_zyx,
            self._volume.lps_from_ijk,
            matrix,
            width=width,
            height=height,
            window_hu=window_hu,
        )
        return _planar_picture(name, "plane", grey, matrix)

    def _slice_matrix(self, view: SliceView) -> NDArray[np.float64]:
        right, down, depth = geometry.plane_axes(view.plane)
        center = np.asarray(view.center_lps, dtype=np.float64)
        if view.mm_per_px is not None:
            return geometry.plane_matrix(center, (right, down, depth), view.mm_per_px, view.width, view.height)
        corners = geometry.box_corners_lps(self._volume)
        mm_per_px, middle = geometry.fit_mm_per_px(corners, right, down, view.width, view.height)
        on_plane = middle[0] * right + middle[1] * down + float(center @ depth) * depth
        return geometry.plane_matrix(on_plane, (right, down, depth), mm_per_px, view.width, view.height)

    def _xray(self, view: XrayView) -> Picture:
        with self._projecting:
            if self._projections is None:
                self._projections = _project(self._volume)
            values, place = self._projections[view.axis]
        flat = Volume(values, place)
        right, down = place[:3, 0] / flat.spacing_mm[0], place[:3, 1] / flat.spacing_mm[1]
        depth = place[:3, 2] / flat.spacing_mm[2]
        _, ny, nx = flat.shape_zyx
        mm_per_px = max(nx * flat.spacing_mm[0] / view.width, ny * flat.spacing_mm[1] / view.height)
        matrix = geometry.plane_matrix(flat.center_lps, (right, down, depth), mm_per_px, view.width, view.height)
        window_hu = view.window_hu
        if window_hu is None:
            # From the air beside the patient to dense bone; metal and contrast medium do not count.
            low, high = (float(v) for v in np.percentile(values, (2.0, 98.0)))
            window_hu = (max(high - low, 1.0), (low + high) / 2)
        grey, _ = _core.cut_plane(
            flat.hu_zyx, flat.lps_from_ijk, matrix, width=view.width, height=view.height, window_hu=window_hu
        )
        return _planar_picture(f"xray-{view.axis}", "projection", grey, matrix)

    def _tri_plane(self, view: TriPlaneView) -> Picture:
        center = np.asarray(view.center_lps, dtype=np.float64)
        distance = view.distance_mm
        if distance is None:
            radius = geometry.bounding_radius_mm(geometry.box_corners_lps(self._volume), self._volume.center_lps)
            # Three planes fill a quarter less than the sphere round the box.
            distance = 0.75 * radius / float(np.sin(np.deg2rad(view.fov_deg) / 2))
        pose = geometry.orbit_pose(center, view.azimuth_deg, view.elevation_deg, distance)
        x, y, z = (float(v) for v in center)
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
        )
        count = view.width * view.height
        return Picture(
            rgb=rgb,
            view="tri-plane",
            stats=RenderStats("plane", view.width, view.height, count, count, 0, 0, 0, 0.0),
            lps_from_camera=pose.lps_from_camera,
            fov_deg=view.fov_deg,
        )

    def _tree(self, view: TreeView) -> Picture:
        tree = self._scene.tree
        if tree is None:
            raise RenderError("there is no airway lumen yet, so no tree to show", code="render.no-lumen")
        return cast_tree(tree, view, simd=self._simd)


def _runs(transfer: TransferFunction) -> tuple[tuple[int, int], ...]:
    runs = _core.transparent_runs(transfer.points, reference_mm=transfer.reference_mm, bin_hu=transfer.bin_hu)
    return tuple(runs)


def _build_class_maps(scene: _Scene) -> _ClassMaps:
    transfer = scene.transfer
    if transfer.sampling == "nearest":
        labels, classes = _core.label_values(scene.values)
    else:
        labels, classes = _core.label_classes(scene.values, transfer.points, reference_mm=transfer.reference_mm)
    first = [lo for lo, _, _, _ in classes]
    return _ClassMaps(scene.values, transfer.points, labels, _core.build_radius_map(labels), first)


def _choose_method(
    scene: _Scene, view: AirwayView, shading: bool
) -> tuple[str, NDArray[np.uint8] | tuple[NDArray[np.uint8], NDArray[np.uint8], list[int]] | None]:
    """The caster that can run now. With shading only transparent classes are leaped: it varies inside the others."""
    if view.method == "brute":
        return "brute", None
    if not shading and scene.class_maps is not None:
        maps = scene.class_maps
        return "leap-all", (maps.labels, maps.radius, maps.class_values)
    if scene.maps is not None:
        return "leap", scene.maps.radius
    return "brute", None


def _planar_picture(name: str, method: str, grey: NDArray[np.uint8], matrix: NDArray[np.float64]) -> Picture:
    height, width = grey.shape
    stats = RenderStats(method, width, height, width * height, width * height, 0, 0, 0, 0.0)
    rgb = np.repeat(grey[:, :, None], 3, axis=2)
    return Picture(rgb=rgb, view=name, stats=stats, lps_from_pixel=matrix)


def _project(volume: Volume) -> dict[str, tuple[NDArray[np.int16], NDArray[np.float64]]]:
    """The three projections in display order, each as a volume of one slice with its place."""
    along = _core.project_maximum(volume.hu_zyx)
    # Axes of the projections' arrays (rows, columns) as grid axes: along i is [k, j], along j [k, i], along k [j, i].
    array_axes = ((2, 1), (2, 0), (1, 0))
    shape_ijk = volume.shape_zyx[::-1]
    axes = dict(zip("xyz", geometry.grid_axes(volume), strict=True))
    # Screen right and down, and the axis projected along, as patient axes with a sign.
    display = {"axial": ("x", "y", "z"), "coronal": ("x", "-z", "y"), "sagittal": ("y", "-z", "-x")}
    out = {}
    for name, (right, down, depth) in display.items():
        (column_axis, column_sign), (row_axis, row_sign), (depth_axis, depth_sign) = (
            (axes[a[-1]][0], -axes[a[-1]][1] if a[0] == "-" else axes[a[-1]][1]) for a in (right, down, depth)
        )
        values = along[depth_axis]
        if array_axes[depth_axis] != (row_axis, column_axis):
            values = values.T
        values = values[:: int(row_sign), :: int(column_sign)]
        # The first pixel is the first or the last voxel of each axis; the slice lies in the middle of the axis
        # projected along.
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
