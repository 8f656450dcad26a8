"""Memory of an opened series, time until a cancelled import stops, and time to list a folder of other files."""

from __future__ import annotations

import contextlib
import resource
import tempfile
import time
from pathlib import Path
from typing import Any

from carina.cli.console import print_note
from carina.errors import CancelledError, CarinaError
from carina.phantom import generate_phantom
from carina.volume import inspect_path, open_volume
from carina_bench.gates import Gate
from carina_bench.written_series import BOX_LPS, write_slices

__all__ = ["gates", "measure"]

NUM_CANCELS = 20
"""Number of instants at which an import is cancelled, evenly spread over its duration."""
FILES_PER_FOLDER = 1000
OTHER = (b"%PDF-1.7 report", b"a;b;c\n1;2;3\n", b"\x89PNG\r\n", b"<html></html>", b"\x00" * 200, b"")
"""Contents of the files that are not images."""


def measure(request: dict[str, Any]) -> dict[str, Any]:
    """Measure memory, cancellation and listing; the memory is that of this process, which must be new."""
    with tempfile.TemporaryDirectory(prefix="carina-bench-") as scratch:
        place = Path(scratch)
        for number in range(request["files"]):
            folder = place / "others" / f"{number // FILES_PER_FOLDER:03d}"
            if number % FILES_PER_FOLDER == 0:
                folder.mkdir(parents=True)
            (folder / f"FILE{number:06d}").write_bytes(OTHER[number % len(OTHER)])
        (x0, y0, _), (x1, y1, _) = BOX_LPS
        box = ((x0, y0, -60.0), (x1, y1, -60.0 + request["slices"] * request["slice_mm"]))
        pixel_mm = request["pixel_mm"]
        volume = generate_phantom(spacing_mm=(pixel_mm, pixel_mm, request["slice_mm"]), box_lps=box).volume
        few = write_slices(type(volume)(volume.hu_zyx[:3], volume.lps_from_ijk), place / "few")
        folder = write_slices(volume, place / "slices")
        num_bytes, shape = volume.hu_zyx.nbytes, volume.shape_zyx
        del volume
        print_note("memory of a series")
        open_volume(few)
        peak = _grown_bytes(folder)
        print_note("cancellation")
        late_s = _late_s(folder)
        print_note(f"listing {request['files']} files")
        began_s, cpu_s = time.perf_counter(), time.process_time()
        try:
            inspect_path(place / "others")
        except CarinaError as error:
            code = error.code
        else:
            code = "opened"
        listed_s, listed_cpu_s = time.perf_counter() - began_s, time.process_time() - cpu_s
    return {
        "shape_zyx": list(shape),
        "volumes_of_memory": round(peak / num_bytes, 2),
        "cancel_ms": round(1000 * max(late_s), 1),
        "files": request["files"],
        "listed_s": round(listed_s, 2),
        "listed_cpu_s": round(listed_cpu_s, 2),
        "listed_code": code,
    }


def _grown_bytes(folder: Path) -> int:
    """Return the peak growth of this process's resident memory while it opens a series, bytes.

    The peak of Linux is reset first (``clear_refs``), because generating the series needs more memory than opening it.
    """
    Path("/proc/self/clear_refs").write_text("5")
    before = _status_bytes("VmRSS")
    opened = open_volume(folder)
    peak = _status_bytes("VmHWM")
    del opened
    return peak - before


def _status_bytes(name: str) -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{name}:"):
            return int(line.split()[1]) * 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _late_s(folder: Path) -> list[float]:
    """Return the times from cancellation to the end of the import, for instants spread over an import.

    An import that ends normally after the moment ignored its cancellation, and counts with the time that it took.
    """
    began = time.perf_counter()
    open_volume(folder)
    whole_s = time.perf_counter() - began
    found = []
    for number in range(NUM_CANCELS):
        at = time.perf_counter() + whole_s * number / NUM_CANCELS
        with contextlib.suppress(CancelledError):
            open_volume(folder, cancel=lambda at=at: time.perf_counter() >= at)  # type: ignore[misc]
        late_s = time.perf_counter() - at
        # An import that ended before the instant of its cancellation was not cancelled, so it is left out.
        if late_s > 0.0:
            found.append(late_s)
    if not found:
        raise CarinaError("no import was cancelled", code="machine.benchmark")
    return found


def gates(row: dict[str, Any]) -> list[Gate]:
    """Return the measured figures with their limits."""
    note = f"CPU time {row['listed_cpu_s']} s; {row['listed_code']}"
    return [
        Gate("memory at the peak while a series is opened, in volumes", row["volumes_of_memory"], 1.5, "lower"),
        Gate("longest time from a cancellation to its end, ms", row["cancel_ms"], 500.0, "lower", aim=True),
        Gate(f"time to list {row['files']} other files, s", row["listed_s"], 20.0, "lower", aim=True, note=note),
    ]
