"""Benchmark ``carina bench open``: times to open a CT from its files and from Carina's cache."""

from __future__ import annotations

import json
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from carina.cli.console import print_json, print_note, progress_printer
from carina.disk import make_folder, write_whole
from carina.errors import CarinaError
from carina.phantom import generate_phantom
from carina.volume import CtSource, Volume, VolumeCache, ct_digest, open_volume, quality_gate, write_grid
from carina_bench import opening_limits
from carina_bench.alternating_timer import median_ratio, take_turns
from carina_bench.gates import Gate
from carina_bench.machine import load_average, machine_facts
from carina_bench.opening_peers import SYNTAXES, words
from carina_bench.worker import run_section
from carina_bench.written_series import BOX_LPS, write_slices

__all__ = ["measure", "report"]

WHOLE_MM, QUICK_MM = (0.7, 0.7, 0.5), (1.4, 1.4, 1.0)
"""Spacings in mm (x, y, z): 512 x 512 x 600 voxels in the box, and half as many along each axis."""
QUICK_SLICE_MM = 5.0
"""Distance in mm of the slices that are opened beside other programs with ``--quick``: 60 slices of 512 x 512."""
CACHED, MAPPED, PLAIN = "from the cache", "mapped and touched", "read without a check"
"""Names in the report of the three ways of reading a CT that are timed."""
FIRST_LOOK = "digest, range and quality"
"""Name of the measurement of the time to compute digest, value range and quality."""
NUM_FILES = 100_000
"""Number of files without images in the folder that is listed."""
WARM_MS = 350.0
"""Maximum CPU time to open a CT from the cache when its file is in memory, ms."""


def report(*, folder: Path, quick: bool, as_json: bool) -> int:
    """Measure, print and write ``open.json``; return exit code 0 if measured, even if a limit is missed."""
    make_folder(folder, what="the measurements")
    facts = machine_facts()
    print_note(f"{facts['cpu']}, {facts['cores']} cores, load {facts['load_average']}")
    row = run_section("opening:measure", {"spacing_mm": QUICK_MM if quick else WHOLE_MM, "repeats": 3 if quick else 5})
    beside = {
        "spacing_mm": (*WHOLE_MM[:2], QUICK_SLICE_MM if quick else WHOLE_MM[2]),
        "repeats": 3,
        "syntaxes": SYNTAXES,
    }
    peers = run_section("opening_peers:measure", beside)
    wanted = {
        "slices": 60 if quick else 600,
        "pixel_mm": WHOLE_MM[0],
        "slice_mm": WHOLE_MM[2],
        "files": NUM_FILES,
    }
    limits = run_section("opening_limits:measure", wanted)
    gates = [*_gates(row), *_peer_gates(peers), *opening_limits.gates(limits)]
    document = {
        "benchmark": "open",
        "version": 1,
        "quick": quick,
        "machine": {**facts, "load_average_after": load_average()},
        "row": row,
        "peers": peers,
        "limits": limits,
        "gates": [gate.to_json() for gate in gates],
    }
    text = json.dumps(document, allow_nan=False, ensure_ascii=False, indent=1) + "\n"
    write_whole(folder / "open.json", text.encode(), what="the measurements")
    if as_json:
        print_json(document)
        return 0
    print(f"{facts['cpu']}, {facts['cores']} cores, load {facts['load_average']} to {load_average()}")
    print("\n".join([*_words(row), *words(peers), *(gate.line() for gate in gates)]))
    return 0


def measure(request: dict[str, Any]) -> dict[str, Any]:
    """Measure the opening of a generated chest from DICOM slices, from packed and plain NIfTI, and from the cache.

    All files are in the system's file cache and are deleted afterwards. The results of :func:`open_volume` and of the
    cache are compared voxel by voxel.
    """
    phantom = generate_phantom(spacing_mm=request["spacing_mm"], box_lps=BOX_LPS, progress=progress_printer())
    volume = phantom.volume
    print_note(f"{volume!r}")
    with tempfile.TemporaryDirectory(prefix="carina-bench-") as scratch:
        place = Path(scratch)
        print_note("writing it as DICOM, NIfTI and into the cache")
        slices = write_slices(volume, place / "slices")
        packed = write_grid(place / "ct.nii.gz", volume.hu_zyx, volume.lps_from_ijk, what="the CT", level=1)
        plain = write_grid(place / "ct.nii", volume.hu_zyx, volume.lps_from_ijk, what="the CT")
        # The cache ignores files that were modified a moment ago, so its clock is set one minute ahead.
        cache = VolumeCache(place / "cache", max_bytes=1 << 40, clock=lambda: time.time() + 60.0)
        opened = open_volume(slices)
        source = CtSource.of(slices)
        keeping_s = time.perf_counter()
        if source is None or not cache.put(opened, source):
            raise CarinaError("the cache did not keep the CT", code="machine.benchmark")
        keeping_s = time.perf_counter() - keeping_s
        (voxels,) = (place / "cache").glob("*.voxels")

        def from_cache() -> Volume:
            found = cache.get(slices)
            if found is None:
                raise CarinaError("the cache did not give the CT back", code="machine.benchmark")
            return found

        equal = bool(np.array_equal(from_cache().hu_zyx, opened.hu_zyx))
        functions: dict[str, Callable[[], object]] = {
            "DICOM slices": lambda: open_volume(slices),
            "NIfTI, packed": lambda: open_volume(packed),
            "NIfTI": lambda: open_volume(plain),
            CACHED: from_cache,
            PLAIN: lambda: _read(voxels, volume.shape_zyx),
            MAPPED: lambda: Volume(_mapped(voxels, volume.shape_zyx), volume.lps_from_ijk).value_range,
            FIRST_LOOK: lambda: _look(volume),
        }
        times = take_turns(functions, request["repeats"])
        cold_ms = [_cold_ms(voxels, from_cache) for _ in range(request["repeats"])]
    return {
        "shape_zyx": list(volume.shape_zyx),
        "volume_bytes": volume.hu_zyx.nbytes,
        "equal": equal,
        "cpu_and_wall_ms": {name: taken.to_json() for name, taken in times.items()},
        "ratio": {name: round(median_ratio(times[name], times[CACHED]), 2) for name in functions},
        "keeping_s": round(keeping_s, 3),
        "cache_not_in_memory_ms": None if None in cold_ms else round(statistics.median(filter(None, cold_ms)), 1),
        "load_average": load_average(),
    }


def _look(volume: Volume) -> object:
    """Compute value range, quality and digest of a volume; Carina computes them after a file has been read."""
    fresh = Volume(volume.hu_zyx, volume.lps_from_ijk)
    return fresh.value_range, quality_gate(fresh), ct_digest(fresh)


def _read(voxels: Path, shape_zyx: tuple[int, int, int]) -> object:
    out = np.empty(shape_zyx, dtype=np.int16)
    with voxels.open("rb", buffering=0) as file:
        file.seek(-out.nbytes, os.SEEK_END)
        file.readinto(out.reshape(-1).view(np.uint8).data)
    return out


def _mapped(voxels: Path, shape_zyx: tuple[int, int, int]) -> np.ndarray[Any, np.dtype[np.int16]]:
    begin = voxels.stat().st_size - 2 * int(np.prod(shape_zyx))
    return np.memmap(voxels, dtype=np.int16, mode="r", offset=begin, shape=shape_zyx)


def _cold_ms(voxels: Path, from_cache: Callable[[], Volume]) -> float | None:
    """Return the wall time of opening a volume from the cache after the system dropped its file from memory, ms.

    The result is None if the system cannot drop files.
    """
    if not hasattr(os, "posix_fadvise"):
        return None
    with voxels.open("rb") as file:
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
    began_s = time.perf_counter()
    from_cache()
    return 1000 * (time.perf_counter() - began_s)


def _gates(row: dict[str, Any]) -> list[Gate]:
    taken = row["cpu_and_wall_ms"][CACHED]
    note = f"by the clock {taken['wall_median']:.0f}, least {taken['wall_min']:.0f}, at load {row['load_average']}"
    return [
        Gate("the cache gives the same voxels (1 is yes)", float(row["equal"]), 1.0),
        # The limit applies to the CPU time of one core; on a busy machine wall time is several times as long.
        Gate("a CT from the cache, in memory (CPU time, ms)", taken["median"], WARM_MS, "lower", note=note),
        Gate("the cache over DICOM slices, CPU time", row["ratio"]["DICOM slices"], 5.0, aim=True),
    ]


def _peer_gates(peers: dict[str, Any]) -> list[Gate]:
    """Return the ratio of SimpleITK's wall time to Carina's for each transfer syntax."""
    return [
        Gate(f"SimpleITK over Carina, {syntax}, wall time", one["wall_over_carina"]["SimpleITK"], 2.0, aim=True)
        for syntax, one in peers["rows"].items()
        if "SimpleITK" in one["wall_over_carina"]
    ]


def _words(row: dict[str, Any]) -> list[str]:
    nz, ny, nx = row["shape_zyx"]
    lines = [f"{nx} x {ny} x {nz}; CPU time of all threads in ms, by the clock, and over the cache's (CPU)"]
    for name, taken in row["cpu_and_wall_ms"].items():
        lines.append(f"  {name:26} {taken['median']:8.0f} {taken['wall_median']:8.0f} {row['ratio'][name]:8.2f}")
    lines.append(f"  keeping it took {row['keeping_s']:.1f} s, quality and digest included")
    if row["cache_not_in_memory_ms"] is not None:
        lines.append(f"  from the cache, its file not in memory: {row['cache_not_in_memory_ms']:.0f} ms by the clock")
    return lines
