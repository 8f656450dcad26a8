"""Choice of the processor that casts the airway view: by the user or by measurement (docs/decisions/0107)."""

from __future__ import annotations

import dataclasses
import json
import logging
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina import _core
from carina.config import BACKENDS
from carina.disk import read_regular_text, write_whole
from carina.display import one_line
from carina.errors import RenderError

log = logging.getLogger(__name__)

# File name of the record of measurements in the cache folder.
RECORD_NAME = "backend.json"
FORMAT = "carina-backend"
VERSION = 2
# Maximum fraction of pixels that may differ by more than one grey level from the CPU's picture.
MAX_PART_OFF = 1e-3


@one_line
@dataclass(frozen=True, slots=True)
class Adapter:
    """Graphics adapter of this machine."""

    index: int
    name: str
    api: str
    """Graphics interface: ``vulkan``, ``metal`` or ``dx12``."""
    driver: str
    kind: str
    """Kind of adapter: ``discrete``, ``integrated``, ``virtual``, ``software`` or ``unknown``."""

    @property
    def is_software(self) -> bool:
        """Whether the adapter is a program that emulates a graphics card on the CPU (lavapipe, WARP)."""
        return self.kind == "software"


def find_adapters() -> tuple[Adapter, ...] | None:
    """Return the adapters of this machine, the likely fastest first; None in a build without GPU support.

    The first call loads the graphics drivers.
    """
    found = _core.gpu_adapters()
    return None if found is None else tuple(Adapter(n, *facts) for n, facts in enumerate(found))


@one_line
@dataclass(frozen=True, slots=True)
class AdapterMeasurement:
    """Times of one adapter and of the CPU for a picture of volumes of one shape, and the resulting choice."""

    adapter: str
    driver: str
    shape_zyx: tuple[int, int, int]
    chosen: bool
    why: str
    """Reason why this processor was chosen, as text for the user."""
    cpu_ms: float | None = None
    gpu_ms: float | None = None
    """Time of a picture in ms, including the transfers to and from the device."""


def differing_share(expected: NDArray[np.uint8], found: NDArray[np.uint8]) -> float:
    """Return the fraction of the pixels (h, w, 3) that differ by more than one grey level in a channel."""
    if expected.shape != found.shape:
        return 1.0
    return float((np.abs(expected.astype(np.int16) - found).max(axis=2) > 1).mean())


class Backend:
    """Choice between CPU and GPU, for all volumes of a process.

    Parameters
    ----------
    mode
        ``cpu``; ``gpu`` for the first adapter that opens, whatever its kind; ``auto`` for an adapter that was measured
        to be faster than the CPU with the same pictures, never a software adapter.
    record
        File of the measurements, for ``auto`` and ``carina doctor``; None keeps them in memory.
    find, open_device
        Functions that find and open the adapters of this machine; replaced in tests.

    Raises
    ------
    RenderError
        If there is no such mode.
    """

    def __init__(
        self,
        mode: str = "cpu",
        *,
        record: Path | None = None,
        find: Callable[[], Sequence[Adapter] | None] = find_adapters,
        open_device: Callable[[int], _core.Gpu] = _core.Gpu,
    ) -> None:
        _check_mode(mode)
        self._mode = mode
        self.num_choices = 0
        """Number of times that the user has selected a processor."""
        self._lost: str | None = None
        self._unused: str | None = None
        self._listeners: list[Callable[[str], None]] = []
        self._record = record
        self._find = find
        self._open = open_device
        self._lock = threading.Lock()
        self._opened: dict[int, _core.Gpu] = {}
        self._unusable: dict[int, str] = {}
        self._measurements: dict[tuple[str, str, tuple[int, int, int]], AdapterMeasurement] = {}
        if record is not None:
            self._measurements = {_measurement_key(v): v for v in _read(record)}

    def __repr__(self) -> str:
        """Return a one-line description of this `Backend` for the Python interpreter."""
        return f"Backend({self.mode!r})"

    @property
    def mode(self) -> str:
        """Selection of the processor: ``cpu``, ``gpu`` or ``auto``."""
        return self._mode

    def set_mode(self, mode: str) -> None:
        """Change the choice of the processor for the next picture of every volume.

        A device that was given up earlier may be used again: the user may have restarted its driver.

        Raises
        ------
        RenderError
            If there is no such mode.
        """
        _check_mode(mode)
        with self._lock:
            self._mode, self._lost, self._unused = mode, None, None
            self.num_choices += 1
            self._unusable.clear()

    @property
    def trouble(self) -> str | None:
        """Reason why the CPU renders although a graphics device was in use or is selected; None without a reason."""
        return self._lost or self._unused

    def subscribe(self, listener: Callable[[str], None]) -> None:
        """Call a function with the reason when a graphics device is given up; from any thread."""
        self._listeners.append(listener)

    def adapters(self) -> tuple[Adapter, ...]:
        """Return the adapters that may be used in this mode, in order of preference."""
        if self.mode == "cpu":
            return ()
        found = tuple(self._find() or ())
        usable = tuple(a for a in found if a.index not in self._unusable)
        return usable if self.mode == "gpu" else tuple(a for a in usable if not a.is_software)

    def open(self, adapter: Adapter) -> _core.Gpu:
        """Return the adapter's device, which is opened once per process."""
        with self._lock:
            device = self._opened.get(adapter.index)
            if device is None:
                device = self._opened[adapter.index] = self._open(adapter.index)
            return device

    def stop_using(self, adapter: Adapter | None, reason: str) -> None:
        """Stop using an adapter until the choice changes; the first reason is reported, see :meth:`report`."""
        with self._lock:
            if adapter is not None:
                self._unusable[adapter.index] = reason
                self._opened.pop(adapter.index, None)
            is_known, self._lost = self._lost is not None, self._lost or reason
        if not is_known:
            self._report(f"rendering on the CPU from now on: {reason}")

    def report_unused(self, reason: str) -> None:
        """Report that the CPU renders one volume although a graphics device was in use or is selected."""
        with self._lock:
            self._unused = reason
        self._report(reason)

    def clear_unused(self) -> None:
        """Forget the reason of `report_unused`, because a graphics device has rendered a picture."""
        self._unused = None

    def _report(self, words: str) -> None:
        log.warning("%s", words)
        for listener in self._listeners:
            listener(words)

    @property
    def measurements(self) -> tuple[AdapterMeasurement, ...]:
        """Measurements of adapters that this process and earlier processes on this machine have made."""
        return tuple(self._measurements.values())

    def measurement(self, adapter: Adapter, shape_zyx: tuple[int, int, int]) -> AdapterMeasurement | None:
        """Return the measurement of an adapter with this driver, on volumes of this shape; None if there is none."""
        return self._measurements.get((adapter.name, adapter.driver, shape_zyx))

    def store_measurement(self, measurement: AdapterMeasurement) -> None:
        """Store a measurement in memory and in the file of measurements."""
        with self._lock:
            self._measurements[_measurement_key(measurement)] = measurement
            measurements = list(self._measurements.values())
        if self._record is not None:
            _write(self._record, measurements)


def _check_mode(mode: str) -> None:
    if mode not in BACKENDS:
        msg = f"the backend must be one of {', '.join(BACKENDS)}; found {mode!r}"
        raise RenderError(msg, code="render.setting")


def _measurement_key(measurement: AdapterMeasurement) -> tuple[str, str, tuple[int, int, int]]:
    return measurement.adapter, measurement.driver, measurement.shape_zyx


def _carina_version() -> str:
    return str(_core.build_info()["version"])


def _read(path: Path) -> list[AdapterMeasurement]:
    """Return the measurements that a file contains; empty if the file is missing or of another version of Carina."""
    try:
        data = json.loads(read_regular_text(path, max_bytes=1 << 20))
        # Another version of Carina has other casters, so its times do not apply.
        if (data["format"], data["version"], data["carina"]) != (FORMAT, VERSION, _carina_version()):
            return []
        return [_measurement(item) for item in data["measured"]]
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return []


def _measurement(item: dict[str, Any]) -> AdapterMeasurement:
    nz, ny, nx = (int(n) for n in item["shape_zyx"])
    cpu_ms, gpu_ms = (None if item[name] is None else float(item[name]) for name in ("cpu_ms", "gpu_ms"))
    return AdapterMeasurement(
        adapter=str(item["adapter"]),
        driver=str(item["driver"]),
        shape_zyx=(nz, ny, nx),
        chosen=bool(item["chosen"]),
        why=str(item["why"]),
        cpu_ms=cpu_ms,
        gpu_ms=gpu_ms,
    )


def _write(path: Path, measurements: list[AdapterMeasurement]) -> None:
    """Replace the file of measurements; without write access the measurements stay in memory only."""
    measured = [dataclasses.asdict(v) for v in measurements]
    data = {"format": FORMAT, "version": VERSION, "carina": _carina_version(), "measured": measured}
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, json.dumps(data, indent=1).encode(), what="the record of measured adapters")
    except OSError as error:
        log.debug("the record of measured adapters could not be written: %s", error.strerror)
