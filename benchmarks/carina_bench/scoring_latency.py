"""``python -m carina_bench.scoring_latency``: latency of airway pictures while the score of an attempt is computed.

One attempt at an inspection flies in the bundled phantom. The tip moves at each picture, and blocks with and without
scoring alternate, so that other programs disturb both alike. A latency is the time from the move to the encoded
picture.
The processor time of the whole process includes the scoring; that of the picture's thread does not.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from carina import render
from carina.commands import OpenDemo, StartTask, Steer, StopTask, TrainingOf
from carina.server.frames.pump import encode_jpeg
from carina.session import CaseRecords, Session, case_files

SIDE_PX = 512
STEP_VOX = 1.0
TURN_RAD = 0.02
"""Rotation of the tip before each picture, radians."""
NEVER_S = 1e9


def main(arguments: list[str] | None = None) -> int:
    """Fly one attempt, and print the latencies with and without scoring."""
    parser = argparse.ArgumentParser(prog="python -m carina_bench.scoring_latency", description=__doc__)
    parser.add_argument("--blocks", type=int, default=10, help="number of blocks with and without scoring, each")
    parser.add_argument("--seconds", type=float, default=5.0, help="length of a block, s")
    parser.add_argument("--side-px", type=int, default=SIDE_PX, help="width and height of the pictures")
    parser.add_argument("--json", type=Path, default=None, help="file for all values")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        records = CaseRecords(Path(folder) / "cases", time.time)
        session = Session(
            lambda volume, transfer: render.Renderer(volume, transfer=transfer),
            records=records,
            files=case_files(None, records),
        )
        try:
            rows = _measure(session, options.blocks, options.seconds, options.side_px)
        finally:
            session.close()
    summary = {name: _summary(found) for name, found in rows.items()}
    for name, found in summary.items():
        print(
            f"scoring {name:3}  {found['num']:5.0f} pictures  latency p50 {found['p50_ms']:6.1f} ms  p95 "
            f"{found['p95_ms']:6.1f} ms  processor time per picture {found['thread_ms']:6.1f} ms (picture), "
            f"{found['process_ms']:6.1f} ms (process)"
        )
    ratio = summary["on"]["p95_ms"] / summary["off"]["p95_ms"]
    print(f"p95 with scoring / without: {ratio:.3f}")
    if options.json is not None:
        options.json.write_text(json.dumps({"summary": summary, "ratio": ratio}, indent=1), encoding="utf-8")
    return 0


def _measure(session: Session, blocks: int, seconds: float, side_px: int) -> dict[str, list[tuple[float, ...]]]:
    ended = threading.Event()
    session.subscribe(lambda _event: ended.set())

    def wait(condition: Any) -> None:
        while not condition():
            ended.wait(0.1)
            ended.clear()

    session.do(OpenDemo("phantom"))
    wait(lambda: session.snapshot().airways == "found" and session.snapshot().saving.keeps)
    session.do(StartTask("inspect-all"))
    wait(lambda: session.ask(TrainingOf()).running is not None)
    wait(lambda: not session.jobs.running)
    attempt = session._training._of(session._core.needed_case()).attempt
    assert attempt is not None
    for _ in range(120):
        session.do(Steer(1.0, 0.0, 0.0, 0.0))
        time.sleep(0.01)
    rows: dict[str, list[tuple[float, ...]]] = {"off": [], "on": []}
    for block in range(2 * blocks):
        name = ("off", "on")[block % 2]
        attempt.pause_s = NEVER_S if name == "off" else 0.0
        # A score that began in the block before ends first.
        time.sleep(0.5)
        end_s, turn = time.monotonic() + seconds, TURN_RAD
        while time.monotonic() < end_s:
            began = time.perf_counter(), time.thread_time(), time.process_time()
            turn = -turn
            session.do(Steer(0.2 if turn > 0.0 else -0.2, 0.0, turn, 0.0))
            scene = session.scene()
            assert scene is not None
            view = scene.spec("airway", side_px, side_px, STEP_VOX, full_width=side_px)
            encode_jpeg(scene.renderer.render(view).rgb, full=False)
            now = time.perf_counter(), time.thread_time(), time.process_time()
            rows[name].append(tuple(1e3 * (b - a) for a, b in zip(began, now, strict=True)))
    session.do(StopTask())
    wait(lambda: not session.jobs.running)
    return rows


def _summary(rows: list[tuple[float, ...]]) -> dict[str, float]:
    values = np.array(rows)
    p50, p95 = np.percentile(values[:, 0], [50, 95])
    return {
        "num": len(values),
        "p50_ms": float(p50),
        "p95_ms": float(p95),
        "thread_ms": float(values[:, 1].mean()),
        "process_ms": float(values[:, 2].mean()),
    }


if __name__ == "__main__":
    raise SystemExit(main())
