"""Timing of the force loop while pictures are rendered: lateness, missed ticks, latency, share of a core."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from carina.cli.console import print_json, print_note, progress_printer
from carina.disk import make_folder, write_whole
from carina.navigate import FlightPath
from carina.phantom import lumen_distance_at
from carina.render import Renderer, picture_threads
from carina.scopes import WallField
from carina_bench.cases import open_phantom
from carina_bench.gates import Gate
from carina_bench.machine import load_average, machine_facts, stolen_s
from carina_haptics import FORCE_LIMIT_N, FORCE_SLEW_N_PER_MS, ForceFigures, ForceLoop
from carina_haptics_bench.pictures import PICTURES_HZ, Pictures, full_pictures, moving_pictures

__all__ = ["measure", "report"]

CASE = "phantom-256"
# Aims for an ordinary computer.
MAX_CORE_SHARE = 0.15
MAX_MISSED = 0.001


def report(*, folder: Path, quick: bool, as_json: bool) -> int:
    """Measure, print, write ``haptics.json`` and return 0; a missed limit is a result, not a failure."""
    make_folder(folder, what="the measurements")
    facts = machine_facts()
    print_note(f"{facts['cpu']}, {facts['cores']} cores, load {facts['load_average']}")
    measured = measure(8.0 if quick else 60.0)
    rows = measured["rows"]
    gates = [gate for row in rows for gate in _gates(row)]
    document = {
        "benchmark": "haptics",
        "version": 3,
        "quick": quick,
        "machine": {**facts, "load_average_after": load_average()},
        "render_threads": measured["render_threads"],
        "rows": rows,
        "gates": [gate.to_json() for gate in gates],
    }
    text = json.dumps(document, allow_nan=False, ensure_ascii=False, indent=1) + "\n"
    write_whole(folder / "haptics.json", text.encode(), what="the measurements")
    if as_json:
        print_json(document)
        return 0
    print(f"{facts['cpu']}, {facts['cores']} cores, load {facts['load_average']} to {load_average()}")
    print(f"pictures by {measured['render_threads']} of the machine's threads; forces {_priority(rows[0])}")
    for row in rows:
        print("\n".join(_words(row)))
    print("\n".join(gate.line() for gate in gates))
    return 0


def _gates(row: dict[str, Any]) -> list[Gate]:
    if not row["gated"]:
        return []
    where = row["hand"]
    stolen = (
        "" if row["stolen_share"] is None else f", {100 * row['stolen_share']:.1f} % of the cores taken by the host"
    )
    note = f"load {row['load_average']}, {_priority(row)}{stolen}"
    return [
        Gate(f"share of a core, {where}", row["share_of_a_core"], MAX_CORE_SHARE, "lower", note=note),
        Gate(f"share of deadlines missed, {where}", row["share_missed"], MAX_MISSED, "lower", note=note),
        Gate(f"pictures/s beside it, {where}", row["pictures"]["per_s"], PICTURES_HZ, note=note),
        Gate(f"strongest force (N), {where}", row["max_force_n"], FORCE_LIMIT_N, "lower"),
        # Rounding of a difference of forces.
        Gate(f"largest change (N per ms), {where}", row["max_change_n"], FORCE_SLEW_N_PER_MS + 1e-12, "lower"),
    ]


def _priority(row: dict[str, Any]) -> str:
    return "with real-time priority" if row["real_time"] else "without real-time priority"


def _words(row: dict[str, Any]) -> list[str]:
    stolen = (
        "" if row["stolen_share"] is None else f"; {100 * row['stolen_share']:.2f} % of the cores taken by the host"
    )
    lines = [
        f"\n{row['hand']}, {row['beside']}: {row['num_ticks']} ticks, {row['num_missed']} missed "
        f"({100 * row['share_missed']:.3f} %); {100 * row['share_of_a_core']:.1f} % of a core{stolen}",
        "  ticks begin late by {:.0f} us (median), {:.0f} (99 %), {:.0f} (worst)".format(*row["late_us"])
        + " and take {:.0f}, {:.0f}, {:.0f} us".format(*row["work_us"]),
    ]
    pictures = row["pictures"]
    if pictures is not None:
        lines.append(
            f"  pictures {pictures['per_s']:.1f}/s, {100 * pictures['scale']:.0f} % of the sides, step "
            f"{pictures['step_vox']:.2f} voxels, {pictures['render_ms']:.1f} ms each"
        )
        if pictures["finder_per_s"] > 0.0:
            lines.append(f"  too slow at the coarsest: {pictures['finder_per_s']:.1f}/s of the view finder besides")
    if row["round_trip_us"] is not None:
        lines.append(
            "  over UDP and back {:.0f} us (median), {:.0f} (99 %), {:.0f} (worst), {} of {} lost".format(
                *row["round_trip_us"], row["num_lost"], row["num_sent"]
            )
        )
    return lines


def measure(seconds: float) -> dict[str, Any]:
    """Measure the loop alone, beside moving pictures (simulated hand, UDP bridge) and beside full pictures.

    The first row, without pictures, shows the deadlines that the machine itself misses.
    """
    volume, points = open_phantom(CASE, progress_printer())
    renderer = Renderer(volume)
    renderer.prepare()
    top = points[0]
    place = top + np.array([0.0, 0.0, -40.0])
    path = FlightPath(np.array([top, place]))
    field = _trachea(place)
    centre = (float(place[0]), float(place[1]), float(place[2]))
    circling = (centre, 12.0, 1.5)
    rows = []
    with ForceLoop(field, simulated=circling) as loop, _Watch() as watch:
        time.sleep(0.5 * seconds)
        rows.append(_row("simulated hand", "nothing else", loop.figures(), watch))
    with ForceLoop(field, simulated=circling) as loop, _Watch() as watch:
        moving = moving_pictures(renderer, path, seconds)
        rows.append(_row("simulated hand", "moving pictures", loop.figures(), watch, moving, gated=True))
    with ForceLoop(field, udp_port=0) as loop, _Watch() as watch, _bridged(loop, seconds, centre) as bridged:
        moving = moving_pictures(renderer, path, seconds)
        found = bridged()
        rows.append(_row("bridge over UDP", "moving pictures", loop.figures(), watch, moving, found, gated=True))
    with ForceLoop(field, simulated=circling) as loop, _Watch() as watch:
        full = full_pictures(renderer, path, 0.5 * seconds)
        rows.append(_row("simulated hand", "full pictures", loop.figures(), watch, full))
    with ForceLoop(field):
        return {"rows": rows, "render_threads": picture_threads()}


class _Watch:
    """Share of the processor time that the host of a virtual machine takes, from entry on."""

    def __enter__(self) -> _Watch:
        self._start_s, self._stolen_s = time.monotonic(), stolen_s()
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def stolen_share(self) -> float | None:
        """Return the share of processor time taken since entry, 0 to 1; None if the system does not report it."""
        now_s, cores = stolen_s(), os.cpu_count() or 1
        if now_s is None or self._stolen_s is None:
            return None
        return (now_s - self._stolen_s) / (cores * (time.monotonic() - self._start_s))


@contextmanager
def _bridged(loop: ForceLoop, seconds: float, centre: tuple[float, float, float]) -> Iterator[Any]:
    """Run a bridge in another process; yield a function that waits for the bridge and returns its measurements."""
    command = [sys.executable, "-m", "carina_haptics_bench.udp_bridge"]
    request = json.dumps({"port": loop.port, "seconds": seconds, "center": centre})
    # The benchmarks are installed nowhere: the process needs the import path of this one.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    other = subprocess.Popen([*command, request], stdout=subprocess.PIPE, text=True, env=environment)
    try:
        yield lambda: json.loads(other.communicate(timeout=60)[0])
    finally:
        if other.poll() is None:
            other.kill()
            other.wait()


def _trachea(place: Any) -> WallField:
    """Return the exact wall of the phantom around a point in its trachea."""
    n = np.arange(-30, 31) * 0.8
    offsets = np.stack(np.meshgrid(n, n, n, indexing="ij")[::-1], axis=-1)
    distance = -lumen_distance_at((offsets + place).reshape(-1, 3), generations=7).reshape(offsets.shape[:3])
    matrix = np.diag([0.8, 0.8, 0.8, 1.0])
    matrix[:3, 3] = place + n[0]
    return WallField.from_distances(distance.astype(np.float32), matrix)


def _row(
    hand: str,
    beside: str,
    figures: ForceFigures,
    watch: _Watch,
    pictures: Pictures | None = None,
    bridged: dict[str, Any] | None = None,
    *,
    gated: bool = False,
) -> dict[str, Any]:
    return {
        "hand": hand,
        "beside": beside,
        "gated": gated,
        "num_ticks": figures.num_ticks,
        "num_missed": figures.num_missed,
        "share_missed": figures.num_missed / max(figures.num_ticks, 1),
        "share_of_a_core": figures.cpu_s / max(figures.wall_s, 1e-9),
        "late_us": list(figures.late_us),
        "work_us": list(figures.work_us),
        "latency_us": list(figures.latency_us),
        "max_force_n": figures.max_force_n,
        "max_change_n": figures.max_change_n,
        "real_time": figures.is_real_time,
        "pictures": None if pictures is None else pictures.to_json(),
        "stolen_share": watch.stolen_share(),
        "load_average": load_average(),
        "round_trip_us": None if bridged is None else bridged["round_trip_us"],
        "num_sent": None if bridged is None else bridged["num_sent"],
        "num_lost": None if bridged is None else bridged["num_lost"],
    }
