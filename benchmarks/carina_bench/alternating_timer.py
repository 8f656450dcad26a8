"""Measurement of the times of several functions in alternation, so that other load affects all of them alike."""

from __future__ import annotations

import gc
import resource
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["Times", "median_ratio", "order_of_round", "take_turns"]


@dataclass(frozen=True, slots=True)
class Times:
    """CPU and wall times of one function, one for each round of a measurement, ms."""

    cpu_ms: tuple[float, ...]
    """CPU time of the whole process with all its threads, and of ended child processes, in each round, ms."""
    wall_ms: tuple[float, ...]

    @property
    def median_ms(self) -> float:
        """Median over the rounds of the CPU time that one call of the function takes, ms."""
        return statistics.median(self.cpu_ms)

    @property
    def min_ms(self) -> float:
        """Minimum over the rounds of the CPU time of one call of the function, ms."""
        return min(self.cpu_ms)

    def to_json(self) -> dict[str, Any]:
        """Return the times as JSON values for the benchmark's report."""
        return {
            "median": round(self.median_ms, 3),
            "min": round(self.min_ms, 3),
            "max": round(max(self.cpu_ms), 3),
            "wall_median": round(statistics.median(self.wall_ms), 3),
            "wall_min": round(min(self.wall_ms), 3),
            "repeats": len(self.cpu_ms),
        }


def take_turns(
    functions: Mapping[str, Callable[[], object]], repeats: int, *, warms_up: bool = True
) -> dict[str, Times]:
    """Run each function once in each round and return its times; a first round is not counted.

    The order differs between the rounds (`order_of_round`), so that no function always follows the same one and finds
    the caches that it left. Functions that run for many seconds need no first round: ``warms_up`` is False.
    """
    names = list(functions)
    cpu: dict[str, list[float]] = {name: [] for name in names}
    wall: dict[str, list[float]] = {name: [] for name in names}
    for function in functions.values() if warms_up else ():
        function()
    collecting = gc.isenabled()
    gc.disable()
    try:
        for turn in range(repeats):
            for name in order_of_round(names, turn):
                started_wall, started_ms = time.perf_counter_ns(), _cpu_ms()
                functions[name]()
                cpu[name].append(_cpu_ms() - started_ms)
                wall[name].append((time.perf_counter_ns() - started_wall) / 1e6)
            gc.collect()
    finally:
        if collecting:
            gc.enable()
    return {name: Times(tuple(cpu[name]), tuple(wall[name])) for name in names}


def _cpu_ms() -> float:
    """Return the CPU time of this process and of the processes that it has started and that have ended, ms."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time_ns() / 1e6 + 1000.0 * (ended.ru_utime + ended.ru_stime)


def order_of_round(names: Sequence[str], turn: int) -> list[str]:
    """Return the names in the order of a round, by a Williams design: each name follows every other name equally often.

    The rounds are balanced after as many rounds as there are names, or after twice as many if their number is odd.
    """
    count = len(names)
    zigzag = [(n + 1) // 2 if n % 2 else (count - n // 2) % count for n in range(count)]
    order = [names[(n + turn) % count] for n in zigzag]
    return order[::-1] if count % 2 and turn % 2 else order


def median_ratio(slow: Times, fast: Times) -> float:
    """Return the median over the rounds of the ratio of the CPU times of ``slow`` and ``fast`` within a round.

    Other load of the machine affects both functions of a round alike. The ratio of two medians could compare a busy
    round with a quiet one.
    """
    return statistics.median(a / b for a, b in zip(slow.cpu_ms, fast.cpu_ms, strict=True))
