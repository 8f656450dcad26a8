"""Measurements of ``carina bench isoregion``: IsoRegion maps, projections, oblique slices, memory."""

from __future__ import annotations

import contextlib
import importlib
import statistics
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.cli.console import print_note, progress_printer
from carina.render import CutPlaneView, Renderer, build_isoregion_map, project_maximum, sample_plane
from carina.scopes import Pose
from carina_bench.alternating_timer import Times, median_ratio, take_turns
from carina_bench.cases import Case, open_case
from carina_bench.compared_scene import TRANSFER
from carina_bench.pictures import difference, save

__all__ = ["maps", "planes", "prepared_maps", "projections"]

Request = dict[str, Any]
WINDOW_HU = (1500.0, -600.0)
"""Window of the pictures in HU: width and level."""
CLEAR_BELOW_HU = -700
"""CT value in HU below which a voxel counts as clear air."""
BIN_HU = 16
"""Width in HU of the bins of CT values; rays skip regions of equal bins."""


def _case(name: str) -> Case:
    return open_case(name, poses=2, progress=progress_printer())


def _memory(kind: str) -> int | None:
    """Return ``VmRSS`` (memory now) or ``VmHWM`` (peak since ``_forget_peak``) of this process in bytes.

    The result is None if the system does not report the value.
    """
    try:
        lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    except OSError:
        return None
    return next((1024 * int(line.split()[1]) for line in lines if line.startswith(f"{kind}:")), None)


def _forget_peak() -> None:
    """Reset the peak memory that Linux records for this process."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def _labels(hu_zyx: NDArray[np.int16]) -> NDArray[np.uint8]:
    """Return the label of each voxel: 1 for clear air, and one label per bin of 16 HU for the other voxels."""
    bins = np.clip((hu_zyx.astype(np.int32) - CLEAR_BELOW_HU) // BIN_HU, 0, 253) + 2
    return np.where(hu_zyx < CLEAR_BELOW_HU, 1, bins).astype(np.uint8)


def _summary(times: dict[str, Times], slow: str, fast: str) -> dict[str, Any]:
    return {
        "cpu_ms": {key: value.to_json() for key, value in times.items()},
        "ratio": {
            "median": round(median_ratio(times[slow], times[fast]), 3),
            "min": round(times[slow].min_ms / times[fast].min_ms, 3),
        },
    }


def maps(request: Request) -> list[dict[str, Any]]:
    """Compare the IsoRegion map of many labels with scipy's chessboard distance transform of two labels.

    The measurement uses one thread and CPU time.
    """
    ndimage: Any = importlib.import_module("scipy.ndimage")
    rows = []
    for name in request["cases"]:
        case = _case(name)
        labels = _labels(case.volume.hu_zyx)
        before = _memory("VmRSS")
        _forget_peak()
        radius = build_isoregion_map(labels)
        peak = _memory("VmHWM")
        # With only two labels, and the border of the volume as a wall, Carina's and scipy's results must be equal.
        clear = labels == 1
        half = tuple(slice(n // 4, n // 4 + min(n // 2, 160)) for n in clear.shape)
        part = np.ascontiguousarray(clear[half])
        walled = np.pad(part, 1)
        expected = np.maximum(ndimage.distance_transform_cdt(walled, metric="chessboard")[1:-1, 1:-1, 1:-1] - 1, 0)
        found = build_isoregion_map(part.astype(np.uint8))
        equal = bool(np.array_equal(found, np.minimum(expected, 255)))
        times = take_turns(
            {
                "scipy cdt, two labels": lambda c=clear: ndimage.distance_transform_cdt(c, metric="chessboard"),  # type: ignore[misc]
                "carina, many labels": lambda v=labels: build_isoregion_map(v),  # type: ignore[misc]
            },
            request["repeats"],
        )
        voxels = labels.size
        rows.append(
            {
                "case": case.name,
                "shape_zyx": list(labels.shape),
                "labels": len(np.unique(labels)),
                "largest_radius": int(radius.max()),
                **_summary(times, "scipy cdt, two labels", "carina, many labels"),
                "ns_per_voxel": {key: round(1e6 * value.median_ms / voxels, 3) for key, value in times.items()},
                "equal_to_scipy_on_two_labels": equal,
                # Memory in addition to that of the labels; the map itself is included.
                "bytes_per_voxel": None if before is None or peak is None else round((peak - before) / voxels, 2),
            }
        )
        print_note(f"{case.name}: {rows[-1]['ratio']}")
    return rows


def prepared_maps(request: Request) -> list[dict[str, Any]]:
    """Measure the time from CT values to the radius map that rays read to skip regions, on all threads.

    Carina computes this map in the background after a case is opened.
    """
    rows = []
    for name in request["cases"]:
        case = _case(name)
        wall, cpu = [], []
        for _ in range(request["repeats"]):
            renderer = Renderer(case.volume, transfer=TRANSFER)
            started, started_cpu = time.perf_counter(), time.process_time()
            renderer.prepare()
            wall.append(1000 * (time.perf_counter() - started))
            cpu.append(1000 * (time.process_time() - started_cpu))
        rows.append(
            {
                "case": case.name,
                "wall_ms": {"median": round(statistics.median(wall), 2), "min": round(min(wall), 2)},
                "cpu_ms": {"median": round(statistics.median(cpu), 2), "min": round(min(cpu), 2)},
            }
        )
    return rows


def projections(request: Request) -> list[dict[str, Any]]:
    """Compare the times of three maximum intensity projections with numpy: one thread, CPU time."""
    rows = []
    for name in request["cases"]:
        case = _case(name)
        values = np.ascontiguousarray(case.volume.hu_zyx)
        along = project_maximum(case.volume)
        equal = all(np.array_equal(along[axis], values.max(axis=2 - axis)) for axis in range(3))
        times = take_turns(
            {
                "numpy": lambda v=values: [v.max(axis=axis) for axis in range(3)],  # type: ignore[misc]
                "carina": lambda c=case: project_maximum(c.volume),  # type: ignore[misc]
            },
            request["repeats"],
        )
        rows.append({"case": case.name, **_summary(times, "numpy", "carina"), "equal": equal})
    return rows


def planes(request: Request) -> list[dict[str, Any]]:
    """Compare the time of an oblique slice of 256 x 256 with ``vtkImageReslice``: one thread, CPU time."""
    from carina_bench.vtk_reference import vtk_reslice

    size = 256
    rows = []
    for name in request["cases"]:
        case = _case(name)
        pose = Pose.looking(case.volume.centre_lps, (0.5, 0.6, -0.62), (0.1, -0.8, 0.3))
        view = CutPlaneView(pose, width=size, height=size, extent_mm=160.0, window_hu=WINDOW_HU)
        renderer = Renderer(case.volume, transfer=TRANSFER)
        matrix = renderer.render(view).lps_from_pixel
        assert matrix is not None
        reslice = vtk_reslice(case.volume, matrix, size, size)
        slice_of = partial(sample_plane, case.volume, matrix, width=size, height=size, window_hu=WINDOW_HU)
        # Each function runs twice in a round, because its first run may have cold caches and sleeping threads.
        times = take_turns(
            {
                "vtk": reslice,
                "vtk again": reslice,
                "carina": slice_of,
                "carina again": slice_of,
                "carina, as a picture": partial(renderer.render, view),
            },
            max(request["repeats"], 30),
        )
        own = sample_plane(case.volume, matrix, width=size, height=size, window_hu=WINDOW_HU)
        low = WINDOW_HU[1] - WINDOW_HU[0] / 2
        peer = np.clip(np.rint((reslice().astype(np.float64) - low) * 255 / WINDOW_HU[0]), 0, 255).astype(np.uint8)
        rows.append(
            {
                "case": case.name,
                **_summary(times, "vtk", "carina"),
                "ratio_again": _summary(times, "vtk again", "carina again")["ratio"],
                "carina_minus_vtk": difference(own, peer),
                "pictures": [
                    save(request["folder"], f"{case.name}-oblique-{who}", grey)
                    for who, grey in (("carina", own), ("vtk", peer))
                ],
            }
        )
    return rows
