"""The paper's IsoRegion graph beside the voxel graph in whole 8-bit volumes: nodes, edges, time, memory, path lengths.

Both graphs are built and searched in alternation. One root in the middle of the volume and four targets are searched.
The memory of each graph is measured in a new process, because the memory of earlier searches is used again.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import carina
from carina.config import load_settings
from carina.track.targets.paper_tracker import GRAPHS, track_on_graph
from carina.track.targets.results import GraphSearch
from carina.volume import Volume
from carina_bench.alternating_timer import Times, median_ratio, take_turns
from carina_bench.machine import load_average
from carina_bench.worker import run_section

__all__ = ["peak_memory", "run"]

Row = dict[str, Any]

FOLDER = "ct/head_and_lidc2_8bit"
FILES = {"LIDC2": "LIDC2_256x256x133_uint8.mha", "headsq": "headsq_64x64x93_int16.mha"}
"""Files of the volumes below ``FOLDER`` in CARINA_DATA_DIR."""
COSTS = ("walls", "paper")
NUM_ROUNDS = 5
ROOT = (0.5, 0.5, 0.5)
TARGETS = ((0.2, 0.2, 0.2), (0.8, 0.2, 0.8), (0.2, 0.8, 0.8), (0.8, 0.8, 0.2))
"""Root and targets as shares of the volume's size (i, j, k)."""


def run(quick: bool, say: Callable[[str], None], cases: tuple[str, ...] = ()) -> list[Row]:
    """Return rows for each volume, cost and graph, and the ratio of the times of both graphs."""
    rows: list[Row] = []
    for name in FILES:
        if (cases and name not in cases) or (quick and name != "headsq"):
            continue
        volume = _volume(name)
        if volume is None:
            rows.append({"what": "graphs", "case": name, "figure": None, "note": "no data: set CARINA_DATA_DIR"})
            continue
        for cost in COSTS:
            rows += _rows(name, volume, cost, 2 if quick else NUM_ROUNDS, say)
    return rows


def _volume(name: str) -> Volume | None:
    data = load_settings().data_dir
    if data is None or not (data / FOLDER / FILES[name]).is_file():
        return None
    return carina.open_volume(data / FOLDER / FILES[name])


def _search(volume: Volume, cost: str, graph: str) -> GraphSearch:
    """Build a graph, search all targets and return the figures of the search."""
    last = np.array(volume.shape_zyx[::-1]) - 1.0
    points: NDArray[np.float64] = volume.to_lps(np.rint(np.array([ROOT, *TARGETS]) * last))
    result = track_on_graph(volume, None, list(points[1:]), cost=cost, graph=graph, root_lps=points[0], relax=False)
    assert result.search is not None
    return result.search


def _memory_mb(name: str) -> float | None:
    """Return a figure of this process from Linux, such as VmHWM (peak memory), in MB; None on other systems."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    except OSError:
        return None
    return next((int(line.split()[1]) * 1024 / 1e6 for line in lines if line.startswith(f"{name}:")), None)


def _reset_peak() -> None:
    """Set the peak memory of this process to its present memory, where Linux permits it."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="utf-8")


def peak_memory(request: Row) -> list[float]:
    """Return the peak memory in MB of one search beside the volume; empty where the system does not state it.

    The request contains the name of the volume, the cost and the graph.
    """
    volume = _volume(request["case"])
    assert volume is not None
    int(volume.hu_zyx.sum(dtype=np.int64))
    _reset_peak()
    before = _memory_mb("VmRSS")
    _search(volume, request["cost"], request["graph"])
    peak = _memory_mb("VmHWM")
    return [] if before is None or peak is None else [peak - before]


def _rows(name: str, volume: Volume, cost: str, rounds: int, say: Callable[[str], None]) -> list[Row]:
    """Return the report's rows for one volume and one edge cost, and print them."""
    found: dict[str, GraphSearch] = {}
    peaks = {
        graph: run_section("track_graphs:peak_memory", {"case": name, "cost": cost, "graph": graph}) for graph in GRAPHS
    }

    def searching(graph: str) -> Callable[[], None]:
        def search() -> None:
            found[graph] = _search(volume, cost, graph)

        return search

    times = take_turns({graph: searching(graph) for graph in GRAPHS}, rounds, warms_up=False)
    rows = [_row(cost, graph, found[graph], times[graph], peaks[graph]) | {"case": name} for graph in GRAPHS]
    ratio = median_ratio(times["isoregion"], times["voxel"])
    voxel, pruned = (sum(_lengths(found[graph])) for graph in GRAPHS)
    rows.append(
        {
            "what": f"cost {cost}: IsoRegion graph relative to the voxel graph",
            "case": name,
            "figure": round(ratio, 2),
            "unit": "times the time (median of the rounds)",
            "nodes_of_voxel_graph": round(found["isoregion"].num_nodes / found["voxel"].num_nodes, 4),
            "edges_of_voxel_graph": round(found["isoregion"].num_edges / found["voxel"].num_edges, 4),
            "length_of_voxel_paths": round(pruned / voxel, 4),
            "note": f"{rounds} rounds in alternation, load {load_average()}; "
            f"{100 * found['isoregion'].num_nodes / found['voxel'].num_nodes:.1f} % of the nodes, "
            f"{100 * found['isoregion'].num_edges / found['voxel'].num_edges:.1f} % of the edges, paths "
            f"{pruned / voxel:.3f} times as long",
        }
    )
    for row in rows:
        say(f"{name}: {row['what']}: {row['figure']} {row['unit']}; {row['note']}")
    return rows


def _lengths(search: GraphSearch) -> list[float]:
    """Return the lengths in mm of all paths of a search."""
    return [round(target.search_length_mm, 1) for target in search.targets if target is not None]


def _row(cost: str, graph: str, search: GraphSearch, times: Times, peaks: list[float]) -> Row:
    """Return the row of one graph; ``peaks`` contains its peak memory in MB, if the system states it."""
    seconds = [round(ms / 1e3, 2) for ms in times.cpu_ms]
    memory = f"{max(peaks):.0f} MB beside the volume" if peaks else "memory not measured on this system"
    return {
        "what": f"cost {cost}, graph {graph}",
        "figure": search.num_nodes,
        "unit": "nodes",
        "num_edges": search.num_edges,
        "num_centres": search.num_centres,
        "cpu_s": seconds,
        "median_s": round(times.median_ms / 1e3, 2),
        "peak_mb": round(max(peaks), 1) if peaks else None,
        "lengths_mm": _lengths(search),
        "note": f"{search.num_edges} edges, {search.num_centres} centres; {times.median_ms / 1e3:.2f} s of CPU "
        f"({min(seconds)} to {max(seconds)}); {memory}; paths {_lengths(search)} mm",
    }
