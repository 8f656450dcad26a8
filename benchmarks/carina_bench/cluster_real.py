"""Measurements with a real Ray cluster on this machine: transport, lost renderers, one renderer per core."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from carina.cluster import ClusterRenderer, ClusterSettings, Console
from carina.cluster.console import StripTiming
from carina.cluster.node import Node, make_token
from carina.cluster.ray_backend import RayCluster
from carina.cluster.renderer_host import RendererHost
from carina.errors import ClusterError
from carina.render import AirwayView, Picture, Renderer, View
from carina.scopes import Pose
from carina.volume import Volume
from carina_bench.cluster_sleeping_renderer import SleepingRenderer
from carina_bench.worker import child_environment

__all__ = [
    "Flown",
    "fly",
    "lost_renderers",
    "real_head",
    "renderers_ready",
    "small_renderer",
    "stand_in_view",
    "transport",
    "wait_ready",
]

IP = "127.0.0.2"
"""Address of the head on the loopback interface."""
SIDE = 512
"""Width and height in pixels of the pictures that the cluster renders."""
ROW_S = 0.004 / (SIDE / 8)
"""Time of a sleeping renderer for one row, s: eight equal strips of a picture take 4 ms each."""


@contextlib.contextmanager
def real_head(renderers: int, threads: int | None = None) -> Iterator[tuple[Node, Path]]:
    """Run a cluster's head node on the loopback interface, with ``renderers`` renderers of ``threads`` threads each."""
    folder = Path(tempfile.mkdtemp(prefix="carina-ray-"))
    with socket.socket() as probe:
        probe.bind((IP, 0))
        port = int(probe.getsockname()[1])
    token = make_token(folder / "token")
    # Renderers run in processes of Ray, which import the sleeping renderer from the benchmarks.
    environment = {"PYTHONPATH": child_environment()["PYTHONPATH"]}
    if threads is not None:
        environment["RAYON_NUM_THREADS"] = str(threads)
    node = Node(
        token,
        head=True,
        ip=IP,
        port=port,
        renderers=renderers,
        dedicated=True,
        temp_dir=folder / "ray",
        log=folder / "log",
        environment=environment,
    )
    try:
        node.wait_ready()
        yield node, token
    finally:
        node.stop()
        shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def renderers_ready(
    head: tuple[Node, Path],
    num: int,
    host_class: type[RendererHost],
    settings: ClusterSettings,
    **options: Any,
) -> Iterator[tuple[Console, RayCluster]]:
    """Yield a console with ``num`` ready renderers of a real cluster."""
    console = Console(settings, keep_jobs=True)
    cluster = RayCluster(
        console, head[0].address, head[1], ip=IP, limit=num, host_class=host_class, host_options=options, poll_s=0.2
    )
    try:
        yield console, cluster
    finally:
        cluster.close()
        console.close()


def wait_ready(console: Console, num: int, timeout_s: float = 120.0) -> None:
    """Wait until ``num`` renderers have loaded the displayed case; raise `ClusterError` after ``timeout_s`` seconds."""
    end_s = time.monotonic() + timeout_s
    while True:
        ready = sum(m.state == "ready" and m.name != "console" for m in console.status().members)
        if ready >= num:
            return
        if time.monotonic() > end_s:
            raise ClusterError(
                f"only {ready} of {num} renderers were ready after {timeout_s:g} s", code="cluster.start"
            )
        time.sleep(0.1)


@dataclass(frozen=True, slots=True)
class Flown:
    """Times of the displayed frames of a flight, in the order of their requests, and the rendered strips."""

    wanted_s: tuple[float, ...]
    shown_s: tuple[float, ...]
    overhead_s: tuple[float, ...]
    """Time from the request to the display of each frame, minus the time of its slowest strip, s."""
    jobs: tuple[StripTiming, ...]

    @property
    def response_s(self) -> float:
        """Median time from the request to the display of a frame, s."""
        return statistics.median(b - a for a, b in zip(self.wanted_s, self.shown_s, strict=True))

    @property
    def fps(self) -> float:
        """Frames per second, from the first displayed frame to the last."""
        return (len(self.shown_s) - 1) / max(1e-9, max(self.shown_s) - min(self.shown_s))

    @property
    def rendering_s(self) -> float:
        """Mean of the renderers' total time for one frame, all strips together, s."""
        return sum(job.seconds for job in self.jobs if job.accepted) / max(1, len(self.shown_s))

    @property
    def num_lanes(self) -> int:
        """Median number of renderers that took part in a frame."""
        lanes: dict[int, set[str]] = {}
        for job in self.jobs:
            lanes.setdefault(job.frame_id, set()).add(job.lane)
        return round(statistics.median(len(names) for names in lanes.values()))

    @property
    def gaps_s(self) -> list[float]:
        """Times between two displayed frames, s, in the order of display."""
        return [float(gap) for gap in np.diff(np.sort(self.shown_s))]


def fly(
    renderer: ClusterRenderer,
    console: Console,
    view_of: Callable[[int], View],
    *,
    seconds: float,
    rate_hz: float | None,
    ahead: int = 3,
    during: Callable[[float], None] | None = None,
) -> Flown:
    """Request the frames of a flight; return their times after the last one has arrived.

    Frames are requested at ``rate_hz``. If it is None, they are requested as soon as fewer than ``ahead`` frames, and
    fewer than the console renders at the same time, are open.
    """
    jobs = console.jobs
    assert jobs is not None
    jobs.clear()
    wanted: dict[int, float] = {}
    shown: dict[int, float] = {}
    under_way: list[tuple[int, Future[Picture]]] = []
    began_s = time.monotonic()
    number = 0
    while time.monotonic() < began_s + seconds:
        if during is not None:
            during(time.monotonic() - began_s)
        if rate_hz is not None:
            time.sleep(max(0.0, began_s + number / rate_hz - time.monotonic()))
        under_way = [item for item in under_way if not item[1].done()]
        while len(under_way) >= min(ahead, console.max_open_frames):
            under_way[0][1].result(timeout=60.0)
            under_way = [item for item in under_way if not item[1].done()]
        requested_at_s = time.monotonic()
        frame_id, future = renderer.request(view_of(number))
        wanted[frame_id] = requested_at_s

        def note(done: Future[Picture], frame_id: int = frame_id) -> None:
            if done.exception() is None:
                shown[frame_id] = time.monotonic()

        future.add_done_callback(note)
        under_way.append((frame_id, future))
        number += 1
    for _, future in under_way:
        future.result(timeout=60.0)
    console.status()  # The console answers in order, so all callbacks of the frames have run when this answer arrives.
    slowest: dict[int, float] = {}
    for job in jobs:
        if job.accepted:
            slowest[job.frame_id] = max(slowest.get(job.frame_id, 0.0), job.seconds)
    ids = [frame_id for frame_id in wanted if frame_id in shown]
    return Flown(
        tuple(wanted[n] for n in ids),
        tuple(shown[n] for n in ids),
        tuple(shown[n] - wanted[n] - slowest.get(n, 0.0) for n in ids),
        tuple(jobs),
    )


def stand_in_view(_number: int) -> View:
    """Return the view that sleeping renderers receive, equal for all frames."""
    return AirwayView(Pose.looking((8.0, 8.0, 8.0), (0.0, 0.0, -1.0)), width=SIDE, height=SIDE)


def small_renderer(console: Console) -> ClusterRenderer:
    """Return a cluster renderer with a very small case, which is sent quickly."""
    hu = np.zeros((16, 16, 16), np.int16)
    renderer = ClusterRenderer(Renderer(Volume(hu, np.eye(4))), console, spread_all=True)
    renderer.prepare()
    return renderer


def transport(head: tuple[Node, Path], *, num: int, seconds: float) -> tuple[list[dict[str, Any]], Flown]:
    """Measure the time of scheduling and transport with sleeping renderers, at 30 frames a second and at full rate."""
    rows: list[dict[str, Any]] = []
    with renderers_ready(head, num, SleepingRenderer, ClusterSettings(open_frames=2), row_seconds=ROW_S) as (
        console,
        _,
    ):
        renderer = small_renderer(console)
        wait_ready(console, num)
        fly(renderer, console, stand_in_view, seconds=2.0, rate_hz=30.0)
        cpu_s = time.process_time()
        paced = fly(renderer, console, stand_in_view, seconds=seconds, rate_hz=30.0)
        cpu_s = time.process_time() - cpu_s
        over = np.array(paced.overhead_s) * 1e3
        rows.append(
            {
                "renderers": num,
                "paced_hz": 30.0,
                "fps": round(paced.fps, 2),
                "overhead_ms_p50": round(float(np.median(over)), 2),
                "overhead_ms_p95": round(float(np.percentile(over, 95)), 2),
                "console_cpu_ms_per_frame": round(cpu_s / len(paced.shown_s) * 1e3, 2),
                "load_average": round(os.getloadavg()[0], 1),
            }
        )
        free = fly(renderer, console, stand_in_view, seconds=seconds / 2, rate_hz=None)
        rows.append({"renderers": num, "paced_hz": None, "fps": round(free.fps, 2)})
    return rows, free


def lost_renderers(head: tuple[Node, Path], *, num: int, kills: int) -> dict[str, Any]:
    """Measure the time between displayed frames while renderers are killed one after the other (kill -9)."""
    worst = []
    with renderers_ready(head, num, SleepingRenderer, ClusterSettings(), row_seconds=ROW_S) as (console, _):
        renderer = small_renderer(console)
        for n in range(kills):
            wait_ready(console, num)
            fly(renderer, console, stand_in_view, seconds=1.5, rate_hz=30.0)
            victim = [m.name for m in console.status().members if m.name != "console"][n % num]
            pid = console.facts(victim).pid
            killed = False

            def kill(at_s: float, pid: int | None = pid) -> None:
                nonlocal killed
                if at_s > 0.5 and not killed and pid is not None:
                    killed = True
                    os.kill(pid, signal.SIGKILL)

            flown = fly(renderer, console, stand_in_view, seconds=3.0, rate_hz=30.0, during=kill)
            worst.append(max(flown.gaps_s) * 1e3)
    return {
        "renderers": num,
        "kills": kills,
        "gap_ms_median": round(statistics.median(worst), 1),
        "gap_ms_worst": round(max(worst), 1),
        "load_average": round(os.getloadavg()[0], 1),
    }
