"""Measurements of the paper's tables on a real Ray cluster whose renderers sleep instead of rendering.

Scheduler, processes and transport are real. Sleeping renderers need no cores, so a machine of two cores runs eight or
sixteen of them. Each renderer sleeps as long as a machine of the paper took for the same rows; the relative cost of the
rows is that of a picture rendered here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from carina.cluster import ClusterRenderer, ClusterSettings, Console
from carina.cluster.node import Node
from carina.cluster.ray_backend import RayLane
from carina_bench.cluster_real import (
    SIDE,
    Flown,
    fly,
    renderers_ready,
    small_renderer,
    stand_in_view,
    wait_ready,
)
from carina_bench.cluster_sleeping_renderer import SleepingRenderer

__all__ = ["SleepingRun", "sleeping_runs"]


@dataclass(frozen=True, slots=True)
class SleepingRun:
    """Result of one flight with simulated renderers: volume, scheduling scheme, speeds, and times of the frames."""

    grid: str
    scheme: str
    speeds: tuple[float, ...]
    flown: Flown


def sleeping_runs(
    head: tuple[Node, Path],
    frame_s: Mapping[str, float],
    row_costs: Mapping[str, Sequence[float]],
    schemes: Sequence[tuple[str, ClusterSettings]],
    *,
    concurrency: Sequence[int],
    mixed_speeds: tuple[float, ...],
    quick: bool,
    say: Callable[[str], None],
) -> Iterator[SleepingRun]:
    """Run flights with sleeping renderers and yield the result of each flight.

    Parameters
    ----------
    head
        A cluster with at least as many renderers as the largest flight uses.
    frame_s, row_costs
        By name of the volume: time of a picture on the fastest machine, s, and cost of each row relative to the mean.
    schemes
        Names and settings of the scheduler. The first is flown on every number of machines, the others on the largest
        number of equal machines.
    concurrency
        Numbers of equal machines.
    mixed_speeds
        Speeds of the machines of a mixed cluster, relative to the fastest.
    quick
        Whether to render fewer pictures.
    say
        Function that receives progress messages.
    """
    plain = schemes[0][0]
    for scheme, settings in schemes:
        for speeds in [(1.0,) * n for n in concurrency] + [mixed_speeds]:
            if scheme != plain and speeds != (1.0,) * concurrency[-1]:
                continue
            say(f"sleeping machines: {scheme}, {len(speeds)} of them")
            with renderers_ready(head, len(speeds), SleepingRenderer, settings) as (console, _):
                renderer = small_renderer(console)
                wait_ready(console, len(speeds), 240.0)
                for grid, seconds in frame_s.items():
                    _set_pace(console, speeds, seconds / SIDE, tuple(row_costs[grid]))
                    ahead = settings.open_frames
                    flown = _flown(renderer, console, seconds / sum(speeds), ahead, len(speeds), quick)
                    yield SleepingRun(grid, scheme, speeds, flown)


def _set_pace(console: Console, speeds: tuple[float, ...], row_s: float, row_costs: tuple[float, ...]) -> None:
    names = sorted(m.name for m in console.status().members if m.name != "console")
    for name, speed in zip(names, speeds, strict=True):
        lane = console.lane(name)
        assert isinstance(lane, RayLane)
        lane.call("pace", row_s / speed, row_costs)


def _flown(renderer: ClusterRenderer, console: Console, frame_s: float, ahead: int, num: int, quick: bool) -> Flown:
    # On one machine no shares need time to settle. On several machines a picture takes less time, so more are measured.
    settle_s, frames = (3 * frame_s, 10) if num == 1 else (max(6.0, 30 * frame_s), 20 if num == 2 or quick else 60)
    fly(renderer, console, stand_in_view, seconds=settle_s, rate_hz=None, ahead=ahead)
    return fly(renderer, console, stand_in_view, seconds=frames * frame_s, rate_hz=None, ahead=ahead)
