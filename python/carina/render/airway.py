"""Caster of the airway view: transfer table of a scene, choice of the casting method, picture."""

from __future__ import annotations

import dataclasses
import math
import threading
import time

import numpy as np
from numpy.typing import NDArray

from carina import _core
from carina.errors import RenderError
from carina.render.appearance import FROM_TREE, Appearance, DecorationName
from carina.render.graphics_device import DeviceCaster
from carina.render.leap_choice import LeapChoice, PrefetchChoice, processor_time_of, timed
from carina.render.processor_choice import Backend
from carina.render.scene import Scene, ValueMaps
from carina.render.surface import Hit, Surface
from carina.render.transfer_function import TransferFunction
from carina.render.views import AirwayView, Picture, RenderStats
from carina.scopes import PINHOLE
from carina.volume import Volume

# Limit of cached transfer tables: one for each ray step of the current transfer function.
TABLES_IN_MEMORY = 8


class AirwayCaster:
    """Caster of the airway view of one volume, which renders pictures and finds first walls; any thread may use it."""

    def __init__(self, volume: Volume, *, simd: str | None = None, backend: Backend | None = None) -> None:
        self._volume = volume
        self._simd = simd
        self._device = DeviceCaster(
            Backend() if backend is None else backend, lambda scene, view, gpu: self._cast(scene, view, gpu=gpu)
        )
        self._swap = threading.Lock()
        self._choice = LeapChoice()
        self._prefetching = PrefetchChoice()
        self._diagonal_mm = float(np.linalg.norm(np.array(volume.shape_zyx[::-1]) * volume.spacing_mm))
        self._bricks: tuple[NDArray[np.int16], _core.Bricks] | None = None
        self._tables: dict[tuple[int, int, float, int], tuple[TransferFunction, _core.TransferTable]] = {}

    def cast(
        self,
        scene: Scene,
        view: AirwayView,
        *,
        rows: tuple[int, int] | None = None,
        stop: _core.CancelToken | None = None,
    ) -> Picture:
        """Return the picture of an airway view, or only its rows ``rows[0]`` to ``rows[1]``."""

        def cast(scene: Scene, view: AirwayView, gpu: _core.GpuScene | None) -> Picture:
            leaps = None if gpu is not None else self.leaps_are_faster(scene, view)
            if method != "leap-all" or leaps is False or not isinstance(scene.class_maps, ValueMaps):
                return self._cast(scene, view, rows=rows, stop=stop, gpu=gpu, leaps=leaps)
            return self._cast_over_values(scene, view, scene.class_maps, rows=rows, stop=stop, leaps=leaps)

        method, _ = _choose_method(scene, view, _needs_shading(scene, view))
        # Method "leap-all" (leaps over all classes) and deformations exist on the CPU only.
        on_device = method != "leap-all" and view.lps_from_rest is None
        picture = None
        if on_device:
            picture = self._device.try_cast(scene, view, leaps=method == "leap", cast=cast)
        if picture is None:
            started = time.perf_counter()
            picture = cast(scene, view, None)
            if rows is None and on_device:
                self._device.count_cpu_picture(scene, view, time.perf_counter() - started)
        return picture

    def leaps_are_faster(self, scene: Scene, view: AirwayView) -> bool | None:
        """Return whether leaps over values are faster in a view, by measurement; None if nothing is to be measured.

        The choice depends on the machine and its load. Pictures by both methods differ by at most one grey level in one
        of 10,000 pixels; where equal bytes matter, choose the method ``leap-always`` or ``brute``.
        """
        maps = scene.class_maps
        if view.method != "leap" or not isinstance(maps, ValueMaps):
            return None

        def cost_of(rows: tuple[int, int], leaps: bool) -> float:
            # Depth of field is added to the whole picture after the cast, so it does not affect the choice.
            sharp = dataclasses.replace(view, depth_of_field=None)

            def cost(prefetch: bool) -> float:
                return processor_time_of(lambda: self._cast(scene, sharp, rows=rows, leaps=leaps, prefetch=prefetch))

            # Leaping pictures prefetch where that is faster, so the faster of both counts as the cost of leaps.
            return min(cost(False), cost(True)) if leaps else cost(False)

        return self._choice.leaps((maps, scene.transfer), view, cost_of, diagonal_mm=self._diagonal_mm)

    def _cast_over_values(
        self,
        scene: Scene,
        view: AirwayView,
        maps: ValueMaps,
        *,
        rows: tuple[int, int] | None,
        stop: _core.CancelToken | None,
        leaps: bool | None,
    ) -> Picture:
        """Cast a picture with leaps over equal values, with prefetching where it was faster in the last pictures."""
        prefetch = self._prefetching.prefetches(maps, view.pose, diagonal_mm=self._diagonal_mm)
        picture, cost_s = timed(lambda: self._cast(scene, view, rows=rows, stop=stop, leaps=leaps, prefetch=prefetch))
        num_steps = picture.stats.num_leaps + picture.stats.num_samples
        if num_steps > 0:
            self._prefetching.add(maps, prefetched=prefetch, cost=cost_s / num_steps)
        return picture

    def _cast(
        self,
        scene: Scene,
        view: AirwayView,
        *,
        rows: tuple[int, int] | None = None,
        stop: _core.CancelToken | None = None,
        gpu: _core.GpuScene | None = None,
        leaps: bool | None = None,
        prefetch: bool = False,
    ) -> Picture:
        """Cast a picture; ``leaps`` selects skipping of uniform regions or brute force; with None, trial rays decide.

        ``prefetch`` changes only the time of leaps over equal values.
        """
        nearest = scene.transfer.sampling == "nearest"
        step_vox = 1.0 if nearest else view.step_vox
        shading = _needs_shading(scene, view)
        appearance = _appearance(scene, view) if shading else None
        method, leap = _choose_method(scene, view, shading, prefetch=prefetch)
        lens = _lens_or_mask_rays(view)
        if rows is not None and view.depth_of_field is not None:
            raise RenderError("depth of field needs the whole image, not only some of its rows", code="render.setting")
        rgb, counts = _core.cast(
            scene.values,
            self._volume.lps_from_ijk,
            self._transfer_table(scene, step_vox * min(self._volume.spacing_mm)),
            view.pose.lps_from_camera,
            fov_rad=math.radians(view.optics.fov_deg),
            width=view.width,
            height=view.height,
            rows=rows,
            light=scene.transfer.light.as_core() if shading and appearance is None else None,
            appearance=appearance,
            decoration=None if appearance is None else scene.decoration,
            nearest=nearest,
            leap=None if leaps is False else leap,
            simd=self._simd,
            stop=stop,
            lens=lens,
            darken=view.depth_of_field is None,
            gpu=gpu,
            stop_transparency=view.stop_transparency,
            always_leap=leaps is True or view.method == "leap-always",
            bricks=self._shared_bricks(scene),
            lps_from_rest=view.lps_from_rest,
        )
        method = method if gpu is None else f"gpu-{method}"
        if view.depth_of_field is not None:
            near_mm, far_mm = view.depth_of_field.near_mm, view.depth_of_field.far_mm
            depth_mm, _, _ = self._first_walls(scene, view)
            rgb = _core.defocus(rgb, depth_mm, near_mm=near_mm, far_mm=far_mm, lens=lens)
        return Picture(
            rgb=rgb,
            view="airway",
            stats=RenderStats(method, view.width, rgb.shape[0], *counts, seconds=0.0),
            lps_from_camera=view.pose.lps_from_camera,
            fov_deg=view.optics.fov_deg,
            optics=None if view.lens == PINHOLE else view.optics,
            decorated=_shown_decorations(scene, appearance),
            lps_from_rest=view.lps_from_rest,
        )

    def surface(self, scene: Scene, view: AirwayView, *, rows: tuple[int, int] | None = None) -> Surface:
        """Return the first wall at every pixel of an airway view, or of its rows ``rows[0]`` to ``rows[1]``."""
        depth, position, normal = self._first_walls(scene, view, rows=rows)
        return Surface(depth, position, normal, pose=view.pose, fov_deg=view.optics.fov_deg)

    def pick(self, scene: Scene, view: AirwayView, column: int, row: int) -> Hit | None:
        """Return the first wall at one pixel of an airway view; None if the ray of the pixel meets no wall."""
        if column < 0 or row < 0:
            raise RenderError(
                f"expected a pixel column and row of 0 or more; found column {column}, row {row}", code="render.setting"
            )
        depth, position, normal = self._first_walls(scene, view, pixel=(column, row))
        if np.isnan(depth[0, 0]):
            return None
        return Hit(float(depth[0, 0]), position[0, 0], normal[0, 0].astype(np.float64))

    def _first_walls(
        self,
        scene: Scene,
        view: AirwayView,
        *,
        rows: tuple[int, int] | None = None,
        pixel: tuple[int, int] | None = None,
    ) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.float32]]:
        nearest = scene.transfer.sampling == "nearest"
        step_vox = 1.0 if nearest else view.step_vox
        radius = scene.maps.radius if view.method == "leap" and scene.maps is not None else None
        return _core.cast_surface(
            scene.values,
            self._volume.lps_from_ijk,
            self._transfer_table(scene, step_vox * min(self._volume.spacing_mm)),
            view.pose.lps_from_camera,
            fov_rad=math.radians(view.optics.fov_deg),
            width=view.width,
            height=view.height,
            rows=rows,
            pixel=pixel,
            nearest=nearest,
            radius_zyx=radius,
            simd=self._simd,
            lens=_lens_or_mask_rays(view),
            lps_from_rest=view.lps_from_rest,
        )

    def _shared_bricks(self, scene: Scene) -> _core.Bricks:
        """Return the cache of voxel cubes (bricks) that all casts of the scene's values share."""
        with self._swap:
            # The entry holds a reference to its values, so no other array can have their identity.
            if self._bricks is None or self._bricks[0] is not scene.values:
                self._bricks = (scene.values, _core.Bricks())
            return self._bricks[1]

    def _transfer_table(self, scene: Scene, step_mm: float) -> _core.TransferTable:
        key = (*scene.range, step_mm, scene.bin_width)
        with self._swap:
            cached = self._tables.get(key)
        # The entry holds a reference to its transfer function, so no other object can have its identity.
        if cached is not None and cached[0] is scene.transfer:
            return cached[1]
        table = _core.TransferTable(
            scene.transfer.points,
            reference_mm=scene.transfer.reference_mm,
            step_mm=step_mm,
            lo=scene.range[0],
            hi=scene.range[1],
            bin_hu=scene.bin_width,
        )
        with self._swap:
            if len(self._tables) >= TABLES_IN_MEMORY:
                self._tables.clear()
            self._tables[key] = (scene.transfer, table)
        return table


def _lens_or_mask_rays(view: AirwayView) -> _core.LensRays | None:
    """Return the rays of a picture through a lens or an outline; None for a plain pinhole, whose formula is faster."""
    if view.lens == PINHOLE and view.field.outline == "none" and view.field.vignette == 0.0:
        return None
    return view.optics.rays(view.field)


def _needs_shading(scene: Scene, view: AirwayView) -> bool:
    return view.shading and scene.transfer.sampling != "nearest"


def _appearance(scene: Scene, view: AirwayView) -> Appearance | None:
    appearance = scene.transfer.appearance
    if appearance is None:
        return None
    guides = appearance.guides_mm if view.guides_mm is None else view.guides_mm
    appearance = dataclasses.replace(appearance, guides_mm=guides)
    return appearance if view.texture else appearance.undecorated()


def _shown_decorations(scene: Scene, appearance: Appearance | None) -> tuple[DecorationName, ...]:
    """Return the names of the drawn features (decorations) that a picture of this scene and appearance shows."""
    parts = () if appearance is None else appearance.decorations
    return parts if scene.decoration is not None else tuple(part for part in parts if part not in FROM_TREE)


def _choose_method(
    scene: Scene, view: AirwayView, shading: bool, *, prefetch: bool = False
) -> tuple[
    str,
    NDArray[np.uint8]
    | tuple[NDArray[np.uint8], NDArray[np.uint8], list[int]]
    | tuple[NDArray[np.uint16], list[int], bool]
    | None,
]:
    """Return the casting method that a scene's present maps allow, and the maps that the method reads.

    With shading only transparent classes are leaped, because shading varies inside the others.
    """
    if view.method == "brute":
        return "brute", None
    if not shading and scene.class_maps is not None:
        maps = scene.class_maps
        if isinstance(maps, ValueMaps):
            return "leap-all", (maps.words, maps.label_values, prefetch)
        return "leap-all", (maps.labels, maps.radius, maps.class_values)
    if scene.maps is not None:
        return "leap", scene.maps.radius
    return "brute", None
