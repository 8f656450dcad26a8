"""``carina bench cluster``: the paper's Tables 1 and 2 by simulation and with real processes, and the cost of Ray."""

from __future__ import annotations

import datetime
import json
import math
import os
import statistics
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from carina.cli.console import print_json, print_note
from carina.cluster import ClusterRenderer, ClusterSettings
from carina.cluster.renderer_host import RendererHost
from carina.disk import make_folder, write_whole
from carina.errors import UsageError
from carina.installation import extra_command
from carina.phantom import generate_phantom
from carina.render import AirwayView, Renderer, View
from carina.scopes import Pose
from carina.volume import Volume
from carina_bench.cluster_simulation import SimulatedCluster, SimulatedRenderer, SimulationResult
from carina_bench.machine import load_average, machine_facts
from carina_bench.plot_svg import line_plot, timeline

__all__ = ["PAPER_TABLE_1", "PAPER_TABLE_2", "SECTIONS", "report", "serial_share"]

SECTIONS = ("network", "simulation", "sleeping", "real", "transport", "kills")
"""Names of the sections of ``carina bench cluster``, in the order in which they run."""
WITHOUT_RAY = ("network", "simulation")
"""Names of the sections that can run without Ray."""
SIDE = 512
"""Width and height in pixels of the pictures that the cluster renders."""
GRIDS = {"head, 128x128x64": (64, 128, 128), "lung, 256x256x200": (200, 256, 256)}
"""Shapes (nz, ny, nx) of the volumes of the paper's tables, by the name of the table's row."""
CONCURRENCY = (1, 2, 4, 8)
"""Numbers of equal machines with which the cluster benchmarks run."""

PAPER_TABLE_1 = {
    "head, 128x128x64": {1: (1.70, 1.00, 100, 855193), 2: (3.20, 1.88, 94, 452661), 4: (4.64, 2.73, 68, 407028),
                         8: (7.68, 4.52, 56, 313438)},
    "lung, 256x256x200": {1: (1.66, 1.00, 100, 944950), 2: (2.86, 1.72, 86, 526609), 4: (4.34, 2.61, 65, 382623),
                          8: (7.48, 4.51, 56, 315812)},
}  # fmt: skip
"""Paper, Table 1: by volume and number of machines, frames/s, speed-up, efficiency in %, and response time in us."""
PAPER_TABLE_2 = {"head, 128x128x64": (16.91, 9.98, 62, 396048), "lung, 256x256x200": (15.83, 9.54, 60, 338778)}
"""Paper, Table 2 (16 different machines): by volume, frames/s, speed-up, efficiency in %, and response time in us."""
ASSUMED_SPEEDS = (*(0.8,) * 2, *(1.0,) * 2, *(0.7,) * 12)
"""Assumed speeds of the paper's 16 machines relative to the fastest one: 2 Suns, 2 SGIs and 12 PCs.

Paper 5.2 names these machines without their speeds.
"""
CALL_S, CALL_JITTER_S, CONSOLE_S, LINK_BYTES_PER_S = 0.0012, 0.0003, 0.001, 125e6
"""Times and bandwidth of a network of 1 Gbit/s, measured with the same transport (docs/decisions/0109).

In order: time of a call in both directions, s; random variation of this time, s; time in which the console handles an
answer, s; bandwidth of the console's connection, bytes per second.
"""


@dataclass(frozen=True, slots=True)
class Scheme:
    """Named settings of the scheduler that distributes the strips (rows) of a picture to machines."""

    name: str
    settings: ClusterSettings


SCHEMES = (
    Scheme("all", ClusterSettings(in_flight=2, open_frames=3)),
    Scheme("no choice of lanes", ClusterSettings(in_flight=2, open_frames=3, chooses_lanes=False)),
    Scheme("no pre-assignment", ClusterSettings(in_flight=1, open_frames=3, chooses_lanes=False)),
    Scheme("one buffer", ClusterSettings(in_flight=2, open_frames=1, chooses_lanes=False)),
    Scheme("no balancing", ClusterSettings(in_flight=2, open_frames=3, balances=False, chooses_lanes=False)),
    Scheme("none of them", ClusterSettings(in_flight=1, open_frames=1, balances=False, chooses_lanes=False)),
)
"""Compared settings of the scheduler: all features, then without the choice of lanes, without one more feature, and
none."""
TODAY_FRAME_S = {"head, 128x128x64": 0.0141, "lung, 256x256x200": 0.020}
"""Time in s of a picture of 512x512 on two idle cores of an AMD EPYC in 2026-11; the paper's tables are for 0.6 s."""


def report(*, folder: Path, only: Sequence[str], quick: bool, as_json: bool) -> int:
    """Run the sections, print the results, and write plots and ``cluster.json`` to ``folder``; return the exit code.

    A section that fails is reported and listed under ``failed``; the results of the other sections are reported as
    well. The exit code is 1 if a section failed, else 0.
    """
    unknown = [name for name in only if name not in SECTIONS]
    if unknown:
        raise UsageError(f"--only: expected {', '.join(SECTIONS)}; found {', '.join(unknown)}")
    wanted = [name for name in SECTIONS if not only or name in only]
    can_ray = sys.platform.startswith("linux") and find_spec("ray") is not None
    left_out = [] if can_ray else [name for name in wanted if name not in WITHOUT_RAY]
    if left_out:
        print_note(
            f"left out, since Ray is not installed: {', '.join(left_out)}; install Ray with: {extra_command('cluster')}"
        )
    make_folder(folder, what="the measurements")
    result: dict[str, Any] = {
        "format": "carina-bench-cluster",
        "version": 1,
        "date": datetime.datetime.now(tz=datetime.UTC).isoformat(timespec="seconds"),
        "machine": machine_facts(),
        "load_average": load_average(),
        "quick": quick,
        "left_out": left_out,
    }
    failed: dict[str, dict[str, str]] = {}
    result["failed"] = failed
    # Costs are measured only once, when the first section needs them.
    costs = cache(lambda: {name: _measure(name, quick) for name in GRIDS})
    sections: dict[str, Callable[[list[str]], Any]] = {
        "network": _network,
        "simulation": lambda lines: _simulated(costs(), quick, lines),
        "sleeping": lambda lines: _sleeping(costs(), quick, folder, lines),
        "real": lambda lines: _real(quick, folder, lines),
        "transport": lambda lines: _transport(quick, None if "sleeping" in result else folder, lines),
        "kills": lambda lines: _kills(quick, lines),
    }
    for name in wanted:
        if name in left_out:
            continue
        lines: list[str] = []
        try:
            result[name] = sections[name](lines)
        except Exception as error:
            words = f"{type(error).__name__}: {error}"
            failed[name] = {"words": words, "trace": traceback.format_exc()}
            lines.append(f"{name}: failed ({words}); the other sections go on")
        if {"simulation", "sleeping"} & set(result):
            _plot_tables(result, folder)
        text = json.dumps(result, indent=2, allow_nan=False) + "\n"
        write_whole(folder / "cluster.json", text.encode(), what="the measurements")
        if as_json:
            print_note(f"{name}: {'failed' if name in failed else 'done'}")
        else:
            print("\n".join(lines), flush=True)
    if as_json:
        print_json(result)
    return 1 if failed else 0


def serial_share(speedups: Sequence[tuple[float, float]]) -> float:
    """Return the serial share s of Amdahl's law, fitted to pairs (number of machines n, speed-up S).

    The law is 1 / S(n) = s + (1 - s) / n; the fit is by least squares in 1 / S.
    """
    slopes = [(1.0 - 1.0 / n, 1.0 / speedup - 1.0 / n) for n, speedup in speedups]
    return sum(a * b for a, b in slopes) / sum(a * a for a, _ in slopes)


def _network(lines: list[str]) -> list[dict[str, Any]]:
    """Return the paper's values for 4 and 16 machines beside those predicted by Amdahl's law.

    The serial share of the prediction is fitted on the values for 2 and 8 machines.
    """
    rows: list[dict[str, Any]] = []
    lines.append(
        "The paper's network as one serial share (Amdahl), fitted on its 2 and 8 machines, checked on 4 and 16:"
    )
    # In Amdahl's law the 16 machines of different speeds count as the sum of their relative speeds.
    counts = {2: 2.0, 4: 4.0, 8: 8.0, 16: sum(ASSUMED_SPEEDS)}
    for grid, table in PAPER_TABLE_1.items():
        fps, _, _, response_us = zip(*(table[n] for n in CONCURRENCY), strict=True)
        of_16 = PAPER_TABLE_2[grid]
        printed = {
            "speed-up": dict(zip((*CONCURRENCY, 16), (*(one / fps[0] for one in fps), of_16[0] / fps[0]), strict=True)),
            "response": dict(
                zip((*CONCURRENCY, 16), (response_us[0] / one for one in (*response_us, of_16[3])), strict=True)
            ),
        }
        for what, paper in printed.items():
            share = serial_share([(counts[n], paper[n]) for n in (2, 8)])
            words = []
            for n in (2, 4, 8, 16):
                model = 1.0 / (share + (1.0 - share) / counts[n])
                off = 100.0 * (model / paper[n] - 1.0)
                rows.append(
                    {
                        "grid": grid,
                        "of": what,
                        "renderers": n,
                        "serial_share": round(share, 4),
                        "fitted": n in (2, 8),
                        "model": round(model, 2),
                        "paper": round(paper[n], 2),
                        "off_percent": round(off, 1),
                    }
                )
                words.append(
                    f"{n}{'' if n in (2, 8) else ' (checked)'}: x{model:.2f}, paper x{paper[n]:.2f}, {off:+.0f} %"
                )
            lines.append(f"  {grid:<18} paper's network, {what}, serial share {100 * share:.1f} %: {'; '.join(words)}")
    lines.append(f"  16 machines count as {counts[16]:g} of the fastest: assumed speeds, the paper does not give them")
    return rows


@dataclass(frozen=True, slots=True)
class _Cost:
    """Rendering time of a picture on this machine, and the distribution of the time over the picture's rows."""

    frame_s: float
    profile: np.ndarray[Any, np.dtype[np.float64]]
    """Cost of rendering each row, relative to the mean cost of a row."""


def _case(name: str) -> tuple[Volume, Pose, np.ndarray[Any, np.dtype[np.uint8]]]:
    """Return a phantom resampled to the shape ``GRIDS[name]``, a pose in its trachea, and its lumen."""
    found = generate_phantom(spacing_mm=2.0)
    shape = GRIDS[name]
    volume = found.volume
    old = volume.shape_zyx
    picks = [np.minimum((np.arange(n) + 0.5) * m / n, m - 1).astype(np.intp) for n, m in zip(shape, old, strict=True)]
    hu = np.ascontiguousarray(volume.hu_zyx[np.ix_(*picks)])
    lumen = np.ascontiguousarray(found.lumen_zyx[np.ix_(*picks)].astype(np.uint8))
    place = volume.lps_from_ijk.copy()
    for axis in range(3):
        place[:3, axis] *= old[2 - axis] / shape[2 - axis]
    inside = np.argwhere(lumen)
    top = inside[:, 0].max() - 4
    at = inside[inside[:, 0] == top].mean(axis=0)[::-1]
    lps = place[:3, :3] @ at + place[:3, 3]
    return Volume(hu, place), Pose.looking((lps[0], lps[1], lps[2]), (0.0, 0.05, -1.0)), lumen


def _flight_view(pose: Pose) -> Callable[[int], View]:
    """Return a function that gives, for a frame number, a view of a slowly turning camera.

    The relative costs of the rows change between the frames.
    """

    def view(number: int) -> View:
        turn = 0.12 * np.sin(number / 25)
        forward = pose.lps_from_camera[:3, :3] @ np.array([np.sin(turn), 0.0, np.cos(turn)])
        x, y, z = (float(v) for v in pose.position_lps)
        return AirwayView(Pose.looking((x, y, z), (forward[0], forward[1], forward[2])), width=SIDE, height=SIDE)

    return view


def _renderer(name: str) -> tuple[Renderer, Callable[[int], View]]:
    volume, pose, lumen = _case(name)
    renderer = Renderer(volume)
    renderer.set_lumen(lumen)
    renderer.prepare()
    return renderer, _flight_view(pose)


def _measure(name: str, quick: bool) -> _Cost:
    print_note(f"measuring what a picture of {name} costs")
    renderer, view_of = _renderer(name)
    view = view_of(0)
    renderer.render(view)
    times = []
    for _ in range(3 if quick else 9):
        began_s = time.perf_counter()
        renderer.render(view)
        times.append(time.perf_counter() - began_s)
    band = 32
    bands = []
    for first in range(0, SIDE, band):
        tries = []
        for _ in range(2 if quick else 5):
            began_s = time.perf_counter()
            renderer.render(view, rows=(first, first + band))
            tries.append(time.perf_counter() - began_s)
        bands.append(min(tries))
    profile = np.repeat(np.array(bands), band)
    # The shortest of several times is used, because other programs disturbed it least.
    return _Cost(min(times), profile / profile.mean())


def _simulate(
    cost: _Cost, speeds: Sequence[float], settings: ClusterSettings, num: int, settle: int
) -> SimulationResult:
    renderers = [SimulatedRenderer(cost.frame_s / SIDE / speed, CALL_S, CALL_JITTER_S) for speed in speeds]
    cluster = SimulatedCluster(
        renderers,
        settings,
        console_seconds=CONSOLE_S,
        console_row_seconds=3 * SIDE / LINK_BYTES_PER_S,
        row_cost=lambda row: float(cost.profile[row]),
    )
    return cluster.run(num, SIDE, settle=settle)


def _row(fps: float, alone_fps: float, num: int, response_s: float, num_lanes: float) -> dict[str, Any]:
    return {
        "renderers": num,
        "lanes": round(num_lanes),
        "fps": round(fps, 2),
        "speedup": round(fps / alone_fps, 2),
        "efficiency": round(100 * fps / alone_fps / num),
        "response_us": round(response_s * 1e6),
    }


def _simulated(costs: dict[str, _Cost], quick: bool, lines: list[str]) -> dict[str, Any]:
    num, settle = (80, 80) if quick else (400, 200)
    # Three settings: the speed of this machine, that of a quiet machine, where the network is the limit; and the frame
    # time of the paper, where the results can be compared with the paper's rows.
    found: dict[str, Any] = {"cost": {}, "table_1": [], "table_2": []}
    lines.append("Simulation of this scheduler, calibrated with measured costs of rows and calls (not a measurement):")

    def simulate(
        name: str, machine: str, used: _Cost, scheme: Scheme, speeds: tuple[float, ...]
    ) -> tuple[dict[str, Any], str]:
        run = _simulate(used, speeds, scheme.settings, num, settle)
        # The speed-up is relative to one of the fastest machines that renders without interruption: with the rate of
        # one machine in a cluster, which waits for the network, the efficiency of several would exceed 100 %.
        row = _row(
            run.fps,
            1.0 / used.frame_s,
            len(speeds),
            statistics.median(run.response_s),
            statistics.median(run.num_lanes),
        )
        row |= {"grid": name, "machine": machine, "scheme": scheme.name}
        return row, _table_line(row, _paper_row(row))

    for name, cost in costs.items():
        paper = _Cost(1.0 / PAPER_TABLE_1[name][1][0], cost.profile)
        today = _Cost(TODAY_FRAME_S[name], cost.profile)
        found["cost"][name] = {
            "frame_ms_here": round(cost.frame_s * 1e3, 2),
            "frame_ms_today": round(today.frame_s * 1e3, 2),
            "frame_ms_paper": round(paper.frame_s * 1e3),
        }
        for machine, used in (("here", cost), ("today", today), ("paper", paper)):
            for scheme in SCHEMES:
                for n in CONCURRENCY:
                    row, line = simulate(name, machine, used, scheme, (1.0,) * n)
                    found["table_1"].append(row)
                    if scheme.name == "all" or n == CONCURRENCY[-1]:
                        lines.append(line)
            for scheme in SCHEMES[:2]:
                row, line = simulate(name, machine, used, scheme, ASSUMED_SPEEDS)
                found["table_2"].append(row | {"speeds": list(ASSUMED_SPEEDS)})
                lines.append(line)
    lines.append(f"  16 machines: assumed speeds {', '.join(f'{s:g}' for s in ASSUMED_SPEEDS)} of the fastest")
    return found


def _paper_row(row: dict[str, Any]) -> tuple[float, float, int, int] | None:
    """Return the paper's values for a row of the simulation; None if the paper has no such frame time or scheme."""
    if row["machine"] in ("here", "today") or row["scheme"] != "all":
        return None
    return PAPER_TABLE_2[row["grid"]] if row["renderers"] == 16 else PAPER_TABLE_1[row["grid"]][row["renderers"]]


def _sleeping(costs: dict[str, _Cost], quick: bool, folder: Path, lines: list[str]) -> dict[str, Any]:
    from carina_bench.cluster_real import real_head
    from carina_bench.cluster_sleep import sleeping_runs

    found: dict[str, Any] = {"table_1": [], "table_2": []}
    lines.append("A real Ray whose renderers sleep as long as the paper's machine took for the rows:")
    frame_s = {name: 1.0 / PAPER_TABLE_1[name][1][0] for name in costs}
    with real_head(len(ASSUMED_SPEEDS)) as head:
        for run in sleeping_runs(
            head,
            frame_s,
            {name: [float(c) for c in cost.profile] for name, cost in costs.items()},
            [(scheme.name, scheme.settings) for scheme in (SCHEMES[:1] if quick else SCHEMES)],
            concurrency=CONCURRENCY,
            mixed_speeds=ASSUMED_SPEEDS,
            quick=quick,
            say=print_note,
        ):
            num, flown = len(run.speeds), run.flown
            row = _row(flown.fps, 1.0 / frame_s[run.grid], num, flown.response_s, flown.num_lanes)
            row |= {"grid": run.grid, "machine": "asleep", "scheme": run.scheme, "load_average": load_average()}
            found["table_2" if num == len(ASSUMED_SPEEDS) else "table_1"].append(row)
            lines.append(_table_line(row, _paper_row(row)))
            if num == len(ASSUMED_SPEEDS):
                title = "Job assignment (paper, Figure 11), real Ray, 16 sleeping machines"
                write_whole(folder / "timeline.svg", _timeline(flown, title).encode(), what="the plot")
    lines.append(f"  16 machines: assumed speeds {', '.join(f'{s:g}' for s in ASSUMED_SPEEDS)} of the fastest")
    return found


def _plot_tables(result: dict[str, Any], folder: Path) -> None:
    """Plot the paper's Figures 9 and 10 with the simulation and the real scheduler with sleeping renderers."""
    names = {"paper": "simulated", "asleep": "real Ray, asleep"}
    for file, title, value, up in (
        ("frame-rate.svg", "Frame rate (paper, Figure 9)", "fps", "fps"),
        ("speed-up.svg", "Speed-up (paper, Figure 10)", "speedup", ""),
    ):
        lines: dict[str, list[float]] = {}
        for grid in GRIDS:
            short = grid.split(",", maxsplit=1)[0]
            lines[f"{short}, paper"] = [PAPER_TABLE_1[grid][n][0 if value == "fps" else 1] for n in CONCURRENCY]
            for section in ("simulation", "sleeping"):
                rows = result.get(section, {"table_1": []})["table_1"]
                for machine, words in names.items():
                    found = [
                        row[value]
                        for row in rows
                        if (row["grid"], row["machine"], row["scheme"]) == (grid, machine, "all")
                    ]
                    if len(found) == len(CONCURRENCY):
                        lines[f"{short}, {words}"] = found
        if value == "speedup":
            lines["ideal"] = [float(n) for n in CONCURRENCY]
        plot = line_plot(title, CONCURRENCY, lines, across="renderers", up=up)
        write_whole(folder / file, plot.encode(), what="the plot")


def _table_line(row: dict[str, Any], paper: tuple[float, float, int, int] | None) -> str:
    def words(fps: float, speedup: float, efficiency: float, response_us: float) -> str:
        return f"{fps:7.2f} fps  x{speedup:5.2f}  {efficiency:3.0f} %  {response_us:7.0f} us"

    text = f"  {row['grid']:<18} {row['machine']:<6} {row['renderers']:>2} renderers: "
    text += words(row["fps"], row["speedup"], row["efficiency"], row["response_us"])
    text += f"  {row['lanes']} used"
    if row["scheme"] != "all":
        text += f"   {row['scheme']}"
    return text if paper is None else f"{text}   paper {words(*paper)}"


def _real(quick: bool, folder: Path, lines: list[str]) -> list[dict[str, Any]]:
    from carina_bench.cluster_real import fly, real_head, renderers_ready, wait_ready

    rows = []
    most = min(4, os.cpu_count() or 1)
    counts = [n for n in (1, 2, 4) if n <= most]
    schemes = SCHEMES[:1] if quick else SCHEMES
    lines.append(f"Real processes on this machine, one thread each, {os.cpu_count()} cores, load {load_average()}:")
    with real_head(most, threads=1) as head:
        for name in GRIDS:
            local, view_of = _renderer(name)
            alone = 0.0
            for scheme in schemes:
                for n in counts:
                    print_note(f"real: {name}, {scheme.name}, {n} renderers")
                    with renderers_ready(head, n, RendererHost, scheme.settings) as (console, _):
                        renderer = ClusterRenderer(local, console, spread_all=True)
                        renderer.prepare()
                        wait_ready(console, n)
                        fly(renderer, console, view_of, seconds=1.5 if n == 1 else 15.0, rate_hz=None)
                        flown = fly(renderer, console, view_of, seconds=3.0 if quick else 8.0, rate_hz=None)
                    alone = alone or 1.0 / flown.rendering_s
                    row = _row(flown.fps, alone, n, flown.response_s, flown.num_lanes)
                    row |= {"grid": name, "machine": "real", "scheme": scheme.name, "load_average": load_average()}
                    rows.append(row)
                    lines.append(_table_line(row, _paper_row(row)))
    return rows


def _transport(quick: bool, folder: Path | None, lines: list[str]) -> list[dict[str, Any]]:
    """Return the measured times of the transport as rows; write a timeline into ``folder`` if it is not None."""
    from carina_bench.cluster_real import real_head, transport

    print_note("transport: eight renderers that sleep 4 ms a strip, 30 pictures a second")
    with real_head(8) as head:
        rows, flown = transport(head, num=8, seconds=5.0 if quick else 20.0)
    paced, free = rows
    lines.append(
        f"Eight sleeping renderers on a real Ray, paced at 30/s: {paced['fps']} fps, scheduling and transport "
        f"{paced['overhead_ms_p50']} ms p50, {paced['overhead_ms_p95']} ms p95, console "
        f"{paced['console_cpu_ms_per_frame']} ms CPU a frame, load {paced['load_average']}; "
        f"unpaced {free['fps']} fps"
    )
    if folder is not None:
        title = "Job assignment (paper, Figure 11), real Ray, 8 sleeping machines"
        write_whole(folder / "timeline.svg", _timeline(flown, title).encode(), what="the plot")
    return rows


def _kills(quick: bool, lines: list[str]) -> dict[str, Any]:
    from carina_bench.cluster_real import lost_renderers, real_head

    print_note("kill -9 of one renderer after the other")
    with real_head(8) as head:
        lost = lost_renderers(head, num=8, kills=3 if quick else 10)
    lines.append(
        f"kill -9, {lost['kills']} times: gap between shown frames {lost['gap_ms_median']} ms median, "
        f"{lost['gap_ms_worst']} ms worst, load {lost['load_average']}"
    )
    return lost


def _timeline(flown: Any, title: str) -> str:
    """Return a timeline of six frames near the end of a real flight as SVG, like Figure 11 of the paper."""
    frames = sorted({job.frame_id for job in flown.jobs})[-12:-6]
    jobs: dict[str, list[tuple[float, float, int]]] = {}
    for job in flown.jobs:
        if job.frame_id in frames:
            name = job.lane.rpartition(" ")[2]
            # A renderer starts its strip ``seconds`` before its answer arrives, but not before its previous strip ends:
            # the transport, whose time varies, takes place before and after the rendering.
            end_ms = job.answered_s * 1e3
            row = jobs.setdefault(name, [])
            begin_ms = max(end_ms - job.seconds * 1e3, row[-1][1] if row else -math.inf)
            row.append((begin_ms, end_ms, frames.index(job.frame_id) + 1))
    return timeline(title, {name: jobs[name] for name in sorted(jobs, key=lambda name: (len(name), name))})
