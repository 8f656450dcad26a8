"""One volume's airway view on a graphics device: what lies there, and whether it is used."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina import _core
from carina.errors import RenderError
from carina.render.backend import MAX_PART_OFF, Adapter, AdapterMeasurement, Backend, part_off
from carina.render.scene import Scene
from carina.render.views import AirwayView, Picture

__all__ = ["DeviceCaster"]

log = logging.getLogger(__name__)

# Pictures from the CPU before anything is measured: the first ones are what the person waits for.
PICTURES_FIRST = 3
# Without a radius map by then, the view is one that does not leap.
PICTURES_WITHOUT_MAP = 30
# Pairs of pictures timed; of each the least disturbed one counts.
NUM_PAIRS = 5
# The GPU must be faster by this much: it also costs memory and a copy of every new wall.
WORTH_IT = 0.9
# Of this volume or view, and not of the device: the next one may do.
LIMIT = "render.gpu-limit"
FAILED = "render.gpu"
# A test picture smaller or darker than this shows neither speed nor agreement.
LEAST_PIXELS = 96 * 96
LEAST_LIGHT = 40

Cast = Callable[[Scene, AirwayView, _core.GpuScene | None], Picture]
Start = Callable[[Callable[[], None]], None]


@dataclass(frozen=True, slots=True, eq=False)
class _Resident:
    """What lies on the device, and of which arrays it is the copy."""

    adapter: Adapter
    values: NDArray[np.int16]
    radius: NDArray[np.uint8] | None
    bare: _core.GpuScene
    leaping: _core.GpuScene | None


def _in_thread(work: Callable[[], None]) -> None:
    # Not a daemon: a driver that is in the middle of a copy when the process ends may crash it.
    threading.Thread(target=work, name="carina-gpu").start()


class DeviceCaster:
    """Casts one volume's airway views on a graphics device where that was asked for, or measured to be faster.

    Never makes a picture wait in ``auto``: while something is measured or copied, the CPU goes on.

    Parameters
    ----------
    backend
        The choice for the process.
    cast
        Makes the picture of a scene and a view, on the CPU or with what lies on the device.
    start
        Runs work in the background; for tests.
    clock
        Seconds; for tests.
    """

    def __init__(
        self, backend: Backend, cast: Cast, *, start: Start = _in_thread, clock: Callable[[], float] = time.perf_counter
    ) -> None:
        self._backend = backend
        self._cast = cast
        self._start = start
        self._clock = clock
        self._lock = threading.Lock()
        self._resident: _Resident | None = None
        self._is_busy = False
        # Values that the device did not take.
        self._unfit: NDArray[np.int16] | None = None
        self._num_seen = 0
        # In auto: not measured yet, measured and not taken, or the adapter.
        self._is_decided = backend.mode != "auto"
        self._adapter: Adapter | None = None

    def try_cast(self, scene: Scene, view: AirwayView, *, leaps: bool, cast: Cast) -> Picture | None:
        """The picture from the device, or None where the CPU is to make it.

        ``cast`` makes this picture from what lies on the device; it may be of some rows only.
        """
        on_device = self._find(scene, leaps=leaps)
        if on_device is None:
            return None
        try:
            return cast(scene, view, on_device)
        except RenderError as error:
            if error.code not in {LIMIT, FAILED}:
                raise
            self._refused(scene, error)
            return None

    def seen(self, scene: Scene, view: AirwayView) -> None:
        """A whole picture came from the CPU: in ``auto``, after some of them, adapters are measured beside it."""
        if self._is_decided or view.width * view.height < LEAST_PIXELS:
            return
        with self._lock:
            self._num_seen += 1
            waits = self._num_seen < (PICTURES_FIRST if scene.maps is not None else PICTURES_WITHOUT_MAP)
            if waits or self._is_busy:
                return
            self._is_busy = True
        self._start(lambda: self._decide(scene, view))

    def _find(self, scene: Scene, *, leaps: bool) -> _core.GpuScene | None:
        mode = self._backend.mode
        if mode == "cpu" or not self._is_decided or (mode == "auto" and self._adapter is None):
            return None
        if scene.values is self._unfit:
            return None
        radius = scene.maps.radius if leaps and scene.maps is not None else None
        resident = self._resident
        if resident is None or resident.values is not scene.values or (leaps and resident.radius is not radius):
            if mode == "gpu":
                with self._lock:
                    resident = self._load_first(scene, radius)
            else:
                self._load_behind(scene, radius)
                resident = None
        if resident is None:
            return None
        return resident.leaping if leaps else resident.bare

    def _load_first(self, scene: Scene, radius: NDArray[np.uint8] | None) -> _Resident | None:
        """Copy to the first adapter that takes it; the CPU renders where none does."""
        for adapter in self._backend.adapters():
            try:
                return self._load(adapter, scene, radius)
            except RenderError as error:
                self._refused(scene, error, adapter)
        if not self._backend.adapters():
            self._backend.give_up(None, "no usable graphics adapter")
        return None

    def _load(self, adapter: Adapter, scene: Scene, radius: NDArray[np.uint8] | None) -> _Resident:
        old = self._resident
        if old is not None and old.adapter == adapter and old.values is scene.values:
            bare = old.bare
        else:
            # The old copy goes first: two volumes may not fit.
            self._resident = None
            bare = self._backend.open(adapter).upload(scene.values)
        leaping = None if radius is None else bare.with_map(radius)
        self._resident = _Resident(adapter, scene.values, radius, bare, leaping)
        return self._resident

    def _load_behind(self, scene: Scene, radius: NDArray[np.uint8] | None) -> None:
        adapter = self._adapter
        with self._lock:
            if self._is_busy or adapter is None:
                return
            self._is_busy = True

        def work() -> None:
            try:
                self._load(adapter, scene, radius)
            except RenderError as error:
                self._refused(scene, error, adapter)
            finally:
                self._is_busy = False

        self._start(work)

    def _refused(self, scene: Scene, error: RenderError, adapter: Adapter | None = None) -> None:
        """Go on without the device: for these values, or for good."""
        resident, self._resident = self._resident, None
        if error.code == LIMIT:
            if self._unfit is not scene.values:
                log.warning("this volume is rendered on the CPU: %s", error)
            self._unfit = scene.values
            return
        if adapter is None:
            adapter = self._adapter if resident is None else resident.adapter
        self._adapter = None
        self._backend.give_up(adapter, str(error))

    def _decide(self, scene: Scene, view: AirwayView) -> None:
        try:
            done = all(self._try(adapter, scene, view) for adapter in self._backend.adapters())
            self._is_decided = done or self._adapter is not None
        finally:
            self._is_busy = False

    def _try(self, adapter: Adapter, scene: Scene, view: AirwayView) -> bool:
        """Measure one adapter; False ends the search: it was taken, or this view shows nothing to measure."""
        known = self._backend.measurement(adapter, scene.values.shape)
        if known is not None and not known.chosen:
            return True
        expected = self._cast(scene, view, None)
        if int(expected.rgb.max(initial=0)) < LEAST_LIGHT:
            return False
        leaps = expected.stats.method == "leap" and scene.maps is not None
        radius = scene.maps.radius if leaps and scene.maps is not None else None
        cpu_ms = gpu_ms = None
        try:
            resident = self._load(adapter, scene, radius)
            on_device = resident.leaping if leaps else resident.bare
            # Also in later runs, where the times are known: a driver may have changed under its name.
            off = part_off(expected.rgb, self._cast(scene, view, on_device).rgb)
            if off > MAX_PART_OFF:
                chosen, why = False, f"its image differs from the CPU's in {100 * off:.2g} % of the pixels"
            elif known is not None:
                chosen, why, cpu_ms, gpu_ms = True, known.why, known.cpu_ms, known.gpu_ms
            else:
                cpu_ms, gpu_ms = self._race(scene, view, on_device)
                chosen = gpu_ms < WORTH_IT * cpu_ms
                words = "measured faster" if chosen else "measured no faster than the CPU"
                why = f"{words}: {gpu_ms:.1f} ms per image, CPU {cpu_ms:.1f} ms"
        except RenderError as error:
            chosen, why = False, str(error)
        self._backend.remember(
            AdapterMeasurement(adapter.name, adapter.driver, scene.values.shape, chosen, why, cpu_ms, gpu_ms),
        )
        log.info("graphics adapter %s: %s", adapter.name, why)
        if chosen:
            self._adapter = adapter
        else:
            self._resident = None
        return not chosen

    def _race(self, scene: Scene, view: AirwayView, on_device: _core.GpuScene | None) -> tuple[float, float]:
        """Least time of a picture in ms, CPU and device, taken in turn so that both meet the same other work."""
        times: tuple[list[float], list[float]] = ([], [])
        for _ in range(NUM_PAIRS):
            for place, taken in zip((None, on_device), times, strict=True):
                started = self._clock()
                self._cast(scene, view, place)
                taken.append(1e3 * (self._clock() - started))
        return min(times[0]), min(times[1])
