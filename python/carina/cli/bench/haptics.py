"""``carina bench haptics``: how the force loop keeps time while pictures are rendered."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from carina.cli.bench.cases import open_phantom
from carina.cli.bench.gates import Gate
from carina.cli.bench.machine import load_average, machine_facts
from carina.cli.bench.worker import run_section
from carina.cli.console import print_json, progress_printer, say
from carina.navigate import FlightPath
from carina.phantom import lumen_distance_at
from carina.render import AirwayView, Renderer
from carina.scopes import FORCE_LIMIT_N, FORCE_SLEW_N_PER_MS, ForceFigures, ForceLoop, WallField
from carina.scopes.haptic_packets import decode_force, encode_sample

__all__ = ["bridge", "measure", "report"]

CASE = "phantom-256"
PICTURES_HZ = 30.0
BRIDGE_HZ = 500.0
# The limits of the plan.
MOST_OF_A_CORE = 0.15
MOST_MISSED = 0.001


def report(*, folder: Path, quick: bool, as_json: bool) -> int:
    """Measure, print, and write ``haptics.json``; always 0 when it could be measured: a missed limit is a result."""
    folder.mkdir(parents=True, exist_ok=True)
    facts = machine_facts()
    say(f"{facts['cpu']}, {facts['cores']} cores, load {facts['load_average']}")
    # While a force device is on, the renderer leaves it one thread.
    threads = max(1, (os.cpu_count() or 2) - 1)
    rows = run_section("haptics:measure", {"seconds": 8.0 if quick else 60.0}, threads=threads)
    gates = [gate for row in rows for gate in _gates(row)]
    document = {
        "benchmark": "haptics",
        "version": 1,
        "quick": quick,
        "machine": {**facts, "load_average_after": load_average()},
        "render_threads": threads,
        "rows": rows,
        "gates": [gate.to_json() for gate in gates],
    }
    (folder / "haptics.json").write_text(
        json.dumps(document, allow_nan=False, ensure_ascii=False, indent=1) + "\n", encoding="utf-8"
    )
    if as_json:
        print_json(document)
        return 0
    print(f"{facts['cpu']}, {facts['cores']} cores, load {facts['load_average']} to {load_average()}")
    for row in rows:
        print("\n".join(_words(row)))
    print("\n".join(gate.line() for gate in gates))
    return 0


def _gates(row: dict[str, Any]) -> list[Gate]:
    where = row["hand"]
    priority = "before all others" if row["realtime"] else "no right to go before others"
    note = f"load {row['load_average']}, {priority}"
    return [
        Gate(f"share of a core, {where}", row["share_of_a_core"], MOST_OF_A_CORE, "lower", note=note),
        Gate(f"share of deadlines missed, {where}", row["share_missed"], MOST_MISSED, "lower", note=note),
        Gate(f"strongest force (N), {where}", row["max_force_n"], FORCE_LIMIT_N, "lower"),
        # Rounding of a difference of forces.
        Gate(f"largest change (N per ms), {where}", row["max_change_n"], FORCE_SLEW_N_PER_MS + 1e-12, "lower"),
    ]


def _words(row: dict[str, Any]) -> list[str]:
    lines = [
        f"\n{row['hand']}: {row['num_ticks']} ticks, {row['num_missed']} missed; "
        f"{100 * row['share_of_a_core']:.1f} % of a core; pictures {row['pictures_per_s']:.1f}/s of {PICTURES_HZ:.0f}",
        "  ticks begin late by {:.0f} us (median), {:.0f} (99 %), {:.0f} (worst)".format(*row["late_us"]),
    ]
    if row["round_trip_us"] is not None:
        lines.append(
            "  over UDP and back {:.0f} us (median), {:.0f} (99 %), {:.0f} (worst), {} of {} lost".format(
                *row["round_trip_us"], row["num_lost"], row["num_sent"]
            )
        )
    return lines


def measure(request: dict[str, Any]) -> list[dict[str, Any]]:
    """The loop with a simulated hand, then with a bridge in another process, while pictures are rendered."""
    volume, points = open_phantom(CASE, progress_printer())
    renderer = Renderer(volume)
    renderer.prepare()
    top = points[0]
    place = top + np.array([0.0, 0.0, -40.0])
    path = FlightPath(np.array([top, place]))
    view = AirwayView(path.pose_at(20.0))
    field = _trachea(place)
    rows = []
    center = (float(place[0]), float(place[1]), float(place[2]))
    with ForceLoop(field, simulated=(center, 12.0, 1.5)) as loop:
        rate = _render(renderer, view, request["seconds"])
        rows.append(_row("simulated hand", loop.figures(), rate, None))
    with ForceLoop(field, udp_port=0) as loop:
        command = [sys.executable, "-m", "carina.cli.bench.haptics_bridge"]
        asked = json.dumps({"port": loop.port, "seconds": request["seconds"], "center": center})
        other = subprocess.Popen([*command, asked], stdout=subprocess.PIPE, text=True)
        try:
            rate = _render(renderer, view, request["seconds"])
            found, _ = other.communicate(timeout=60)
        finally:
            if other.poll() is None:
                other.kill()
                other.wait()
        rows.append(_row("bridge over UDP", loop.figures(), rate, json.loads(found)))
    return rows


def _trachea(place: Any) -> WallField:
    """The exact wall round a place."""
    n = np.arange(-30, 31) * 0.8
    offsets = np.stack(np.meshgrid(n, n, n, indexing="ij")[::-1], axis=-1)
    distance = -lumen_distance_at((offsets + place).reshape(-1, 3), generations=7).reshape(offsets.shape[:3])
    matrix = np.diag([0.8, 0.8, 0.8, 1.0])
    matrix[:3, 3] = place + n[0]
    return WallField.from_distances(distance.astype(np.float32), matrix)


def _render(renderer: Renderer, view: AirwayView, seconds: float) -> float:
    """Pictures at their rate for a time; how many a second there were."""
    start, num = time.monotonic(), 0
    while time.monotonic() - start < seconds:
        renderer.render(view)
        num += 1
        time.sleep(max(0.0, start + num / PICTURES_HZ - time.monotonic()))
    return num / (time.monotonic() - start)


def _row(hand: str, figures: ForceFigures, pictures_per_s: float, bridged: dict[str, Any] | None) -> dict[str, Any]:
    return {
        "hand": hand,
        "num_ticks": figures.num_ticks,
        "num_missed": figures.num_missed,
        "share_missed": figures.num_missed / max(figures.num_ticks, 1),
        "share_of_a_core": figures.cpu_s / max(figures.wall_s, 1e-9),
        "late_us": list(figures.late_us),
        "latency_us": list(figures.latency_us),
        "max_force_n": figures.max_force_n,
        "max_change_n": figures.max_change_n,
        "realtime": figures.realtime,
        "pictures_per_s": pictures_per_s,
        "load_average": load_average(),
        "round_trip_us": None if bridged is None else bridged["round_trip_us"],
        "num_sent": None if bridged is None else bridged["num_sent"],
        "num_lost": None if bridged is None else bridged["num_lost"],
    }


def bridge(request: dict[str, Any]) -> dict[str, Any]:
    """A bridge's other end: samples at a steady rate, and how long each force took."""
    trips: list[float] = []
    num_sent = 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.connect(("127.0.0.1", request["port"]))
        link.settimeout(0.05)
        x, y, z = request["center"]
        start = time.perf_counter()
        while (now := time.perf_counter()) - start < request["seconds"]:
            turn = 9.0 * (now - start)
            at = (x + 11.0 * np.cos(turn), y + 11.0 * np.sin(turn), z)
            num_sent += 1
            link.send(encode_sample(num_sent, int(now * 1e6), at, (0.0, 0.0, 0.0), (0.0, 0.0, -1.0)))
            try:
                reply = decode_force(link.recv(256))
            except TimeoutError:
                reply = None
            if reply is not None and reply.number == num_sent:
                trips.append(1e6 * (time.perf_counter() - now))
            time.sleep(max(0.0, start + num_sent / BRIDGE_HZ - time.perf_counter()))
    found = np.percentile(trips, [50, 99, 100]).tolist() if trips else [0.0, 0.0, 0.0]
    return {"round_trip_us": found, "num_sent": num_sent, "num_lost": num_sent - len(trips)}
