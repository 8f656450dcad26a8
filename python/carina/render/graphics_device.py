"""Airway view of one volume on a graphics device: the copy in device memory, and the choice between device and CPU."""

from __future__ import annotations

import logging
import statistics
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina import _core
from carina.errors import RenderError
from carina.render.processor_choice import MAX_PART_OFF, Adapter, AdapterMeasurement, Backend, differing_share
from carina.render.scene import Scene
from carina.render.views import AirwayView, Picture

log = logging.getLogger(__name__)

# Number of pictures that the CPU renders before any measurement, so that the first pictures are not delayed.
PICTURES_FIRST = 3
# Number of pictures after which a view without a radius map is measured too: such a view does not leap.
PICTURES_WITHOUT_MAP = 30
# Number of timed pairs of pictures (one on the CPU, one on the GPU); the shortest time of each processor counts.
NUM_PAIRS = 5
# Maximum ratio of GPU time to CPU time for which the GPU is chosen: it also costs memory and a copy of every new wall.
WORTH_IT = 0.9
# Maximum ratio of a device's time per pixel to the CPU's measured time per pixel, and number of consecutive slower
# pictures after which the device is given up: another program may use the device, or the driver may have slowed it.
MAX_SLOWNESS = 3.0
SLOW_PICTURES = 10
# Number of consecutive pictures that take longer than the measured picture did on the CPU, after which the CPU renders
# some pictures for a comparison. A single picture proves nothing: another pose or look may cost the CPU more too.
SLOWER_PICTURES = 60
COMPARED_PICTURES = 10
# Error code of a limit of this volume or view, not of the device: another volume may fit.
LIMIT = "render.gpu-limit"
FAILED = "render.gpu"
# Minimum number of pixels of a test picture: a smaller or darker picture shows neither speed nor agreement.
MIN_PIXELS = 96 * 96
MIN_LIGHT = 40

Cast = Callable[[Scene, AirwayView, _core.GpuScene | None], Picture]
Start = Callable[[Callable[[], None]], None]


@dataclass(frozen=True, slots=True, eq=False)
class _DeviceScene:
    """Copy of a scene in the graphics device's memory, with the arrays from which it was copied."""

    adapter: Adapter
    values: NDArray[np.int16]
    radius: NDArray[np.uint8] | None
    bare: _core.GpuScene
    leaping: _core.GpuScene | None


def _start_thread(work: Callable[[], None]) -> None:
    # Not a daemon thread: ending the process while a driver copies data may crash it.
    threading.Thread(target=work, name="carina-gpu").start()


class DeviceCaster:
    """Caster of one volume's airway views on a graphics device, if the user chose it or it was measured to be faster.

    In ``auto`` no picture waits for the device: the CPU renders while a measurement or a copy runs.

    Parameters
    ----------
    backend
        Choice between CPU and GPU of the process.
    cast
        Function that renders a scene and a view, on the CPU or from the copy in device memory.
    start
        Function that runs work in the background; for tests.
    clock
        Function that returns the time in seconds; for tests.
    """

    def __init__(
        self,
        backend: Backend,
        cast: Cast,
        *,
        start: Start = _start_thread,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._backend = backend
        self._cast = cast
        self._start = start
        self._clock = clock
        self._lock = threading.Lock()
        self._resident: _DeviceScene | None = None
        self._is_busy = False
        # Values of the volume that did not fit into the memory of the device; None if all values so far did fit.
        self._unfit: NDArray[np.int16] | None = None
        self._num_seen = 0
        # In auto, three states: not measured; measured without a choice (adapter None); measured, with an adapter.
        self._is_measured = False
        self._adapter: Adapter | None = None
        self._num_choices = backend.num_choices
        # Time of a pixel on the CPU in the view with which the adapter was measured, in seconds.
        self._cpu_s_per_pixel: float | None = None
        self._num_slow = 0
        # Times of a pixel of the device's last pictures that took longer than on the CPU, in seconds, and of the CPU's
        # pictures that are compared with them; None while no comparison is in progress.
        self._slower: list[float] = []
        self._compared: list[float] | None = None
        self._device_s_per_pixel = 0.0
        # Shapes of volumes that were reported not to fit: each edit of the airways makes new values of the same shape.
        self._reported_shapes: set[tuple[int, ...]] = set()

    def try_cast(self, scene: Scene, view: AirwayView, *, leaps: bool, cast: Cast) -> Picture | None:
        """Return the picture from the device, or None if the CPU must render it.

        ``cast`` renders the picture from the copy in device memory; the picture may consist of some rows only.
        """
        on_device = self._find_device_scene(scene, leaps=leaps)
        if on_device is None:
            return None
        started = self._clock()
        try:
            picture = cast(scene, view, on_device)
        except RenderError as error:
            if error.code not in {LIMIT, FAILED}:
                raise
            self._stop_after_error(scene, error)
            return None
        self._backend.clear_unused()
        self._count_device_picture(scene, picture, self._clock() - started)
        return picture

    def _count_device_picture(self, scene: Scene, picture: Picture, seconds: float) -> None:
        """Give up a device that was chosen for its speed and is much slower; compare a slower one with the CPU."""
        num_pixels = picture.rgb.shape[0] * picture.rgb.shape[1]
        if self._backend.mode != "auto" or self._cpu_s_per_pixel is None or num_pixels < MIN_PIXELS:
            return
        if self._compared is not None:
            # Another thread began this picture before the comparison, so its time does not count in the comparison.
            return
        cpu_s = self._cpu_s_per_pixel * num_pixels
        self._num_slow = self._num_slow + 1 if seconds > MAX_SLOWNESS * cpu_s else 0
        self._slower = [*self._slower, seconds / num_pixels] if seconds > cpu_s else []
        if self._num_slow >= SLOW_PICTURES:
            self._num_slow = 0
            words = f"the graphics device has become slow: {1e3 * seconds:.0f} ms per image"
            self._stop_after_error(scene, RenderError(words, code=FAILED))
        elif len(self._slower) >= SLOWER_PICTURES:
            self._device_s_per_pixel = statistics.median(self._slower)
            self._slower, self._compared = [], []

    def _compare_again(self, seconds_per_pixel: float) -> None:
        """Compare one more picture of the CPU with the device's; decide about the device after enough pictures.

        These are pictures of the same flight as the device's. The measurement before the choice repeats one view, in
        which a device has every slope already.
        """
        with self._lock:
            compared = self._compared
            if compared is None:
                return
            compared.append(seconds_per_pixel)
            if len(compared) < COMPARED_PICTURES:
                return
            on_cpu, on_device = statistics.median(compared), self._device_s_per_pixel
            self._compared = None
            if on_device < on_cpu:
                self._cpu_s_per_pixel = on_cpu
                return
            self._adapter = self._resident = None
        self._backend.report_unused(
            "the graphics device is no longer used for this volume, because it has become slower than the CPU: "
            f"{1e9 * on_device:.0f} ms for a million pixels, CPU {1e9 * on_cpu:.0f} ms"
        )

    def count_cpu_picture(self, scene: Scene, view: AirwayView, seconds: float) -> None:
        """Record that the CPU rendered a whole picture in a number of seconds.

        In ``auto``, start the measurement of the adapters after some pictures.
        """
        if self._compared is not None and view.width * view.height >= MIN_PIXELS:
            self._compare_again(seconds / (view.width * view.height))
            return
        if self._backend.mode != "auto" or self._is_measured or view.width * view.height < MIN_PIXELS:
            return
        with self._lock:
            self._num_seen += 1
            waits = self._num_seen < (PICTURES_FIRST if scene.maps is not None else PICTURES_WITHOUT_MAP)
            if waits or self._is_busy:
                return
            self._is_busy = True
        self._start(lambda: self._try_adapters(scene, view))

    def _find_device_scene(self, scene: Scene, *, leaps: bool) -> _core.GpuScene | None:
        mode = self._backend.mode
        if self._num_choices != self._backend.num_choices:
            # The user has chosen anew, which permits a device that was given up.
            self._num_choices = self._backend.num_choices
            self._adapter, self._is_measured, self._num_seen = None, False, 0
            self._compared, self._slower, self._unfit, self._resident = None, [], None, None
            self._reported_shapes.clear()
        if mode == "cpu":
            # The memory of the device is released if the user has just chosen the CPU.
            self._resident = None
            return None
        if mode == "auto" and (self._adapter is None or self._compared is not None):
            return None
        if scene.values is self._unfit:
            return None
        radius = scene.maps.radius if leaps and scene.maps is not None else None
        resident = self._resident
        if resident is None or resident.values is not scene.values or (leaps and resident.radius is not radius):
            if mode == "gpu":
                with self._lock:
                    resident = self._load_on_first_adapter(scene, radius)
            else:
                self._load_in_background(scene, radius)
                resident = None
        if resident is None:
            return None
        return resident.leaping if leaps else resident.bare

    def _load_on_first_adapter(self, scene: Scene, radius: NDArray[np.uint8] | None) -> _DeviceScene | None:
        """Copy the scene to the first adapter that accepts it; return None if no adapter does."""
        for adapter in self._backend.adapters():
            try:
                return self._load_on_adapter(adapter, scene, radius)
            except RenderError as error:
                self._stop_after_error(scene, error, adapter)
        if not self._backend.adapters():
            self._backend.stop_using(None, "no usable graphics adapter")
        return None

    def _load_on_adapter(self, adapter: Adapter, scene: Scene, radius: NDArray[np.uint8] | None) -> _DeviceScene:
        old = self._resident
        if old is not None and old.adapter == adapter and old.values is scene.values:
            bare = old.bare
        else:
            # The old copy is released first, because device memory may not hold two volumes.
            self._resident = None
            bare = self._backend.open(adapter).upload(scene.values)
        leaping = None if radius is None else bare.with_map(radius)
        self._resident = _DeviceScene(adapter, scene.values, radius, bare, leaping)
        return self._resident

    def _load_in_background(self, scene: Scene, radius: NDArray[np.uint8] | None) -> None:
        adapter = self._adapter
        with self._lock:
            if self._is_busy or adapter is None:
                return
            self._is_busy = True

        def work() -> None:
            try:
                self._load_on_adapter(adapter, scene, radius)
            except RenderError as error:
                self._stop_after_error(scene, error, adapter)
            finally:
                self._is_busy = False

        self._start(work)

    def _stop_after_error(self, scene: Scene, error: RenderError, adapter: Adapter | None = None) -> None:
        """Stop using the device after an error, for the current values or for the rest of the process."""
        resident, self._resident = self._resident, None
        if error.code == LIMIT:
            if scene.values.shape not in self._reported_shapes:
                self._reported_shapes.add(scene.values.shape)
                self._backend.report_unused(f"this volume is rendered on the CPU: {error}")
            self._unfit = scene.values
            return
        if adapter is None:
            adapter = self._adapter if resident is None else resident.adapter
        self._adapter = None
        self._backend.stop_using(adapter, str(error))

    def _try_adapters(self, scene: Scene, view: AirwayView) -> None:
        try:
            done = all(self._measure_adapter(adapter, scene, view) for adapter in self._backend.adapters())
            self._is_measured = done or self._adapter is not None
        finally:
            self._is_busy = False

    def _measure_adapter(self, adapter: Adapter, scene: Scene, view: AirwayView) -> bool:
        """Measure the speed of one graphics adapter, and check that its picture agrees with the CPU's.

        Return False to end the search (adapter chosen, or the picture is too dark to measure).
        """
        known = self._backend.measurement(adapter, scene.values.shape)
        if known is not None and not known.chosen:
            return True
        started = self._clock()
        expected = self._cast(scene, view, None)
        cpu_s_per_pixel = (self._clock() - started) / (view.width * view.height)
        if int(expected.rgb.max(initial=0)) < MIN_LIGHT:
            return False
        leaps = expected.stats.method == "leap" and scene.maps is not None
        radius = scene.maps.radius if leaps and scene.maps is not None else None
        cpu_ms = gpu_ms = None
        try:
            resident = self._load_on_adapter(adapter, scene, radius)
            on_device = resident.leaping if leaps else resident.bare
            # The pictures are compared in later runs too, where the times are known: the driver may have changed.
            off = differing_share(expected.rgb, self._cast(scene, view, on_device).rgb)
            if off > MAX_PART_OFF:
                chosen, why = False, f"its image differs from the CPU's in {100 * off:.2g} % of the pixels"
            elif known is not None:
                chosen, why, cpu_ms, gpu_ms = True, known.why, known.cpu_ms, known.gpu_ms
            else:
                cpu_ms, gpu_ms = self._shortest_times(scene, view, on_device)
                chosen = gpu_ms < WORTH_IT * cpu_ms
                words = "measured faster" if chosen else "measured no faster than the CPU"
                why = f"{words}: {gpu_ms:.1f} ms per image, CPU {cpu_ms:.1f} ms"
        except RenderError as error:
            chosen, why = False, str(error)
        self._backend.store_measurement(
            AdapterMeasurement(adapter.name, adapter.driver, scene.values.shape, chosen, why, cpu_ms, gpu_ms),
        )
        log.info("graphics adapter %s: %s", adapter.name, why)
        if chosen:
            self._adapter, self._cpu_s_per_pixel = adapter, cpu_s_per_pixel
        else:
            self._resident = None
        return not chosen

    def _shortest_times(self, scene: Scene, view: AirwayView, on_device: _core.GpuScene | None) -> tuple[float, float]:
        """Return the shortest time of a picture in ms, on the CPU and on the device.

        The turns alternate, so that other load affects both.
        """
        times: tuple[list[float], list[float]] = ([], [])
        for _ in range(NUM_PAIRS):
            for place, taken in zip((None, on_device), times, strict=True):
                started = self._clock()
                self._cast(scene, view, place)
                taken.append(1e3 * (self._clock() - started))
        return min(times[0]), min(times[1])
