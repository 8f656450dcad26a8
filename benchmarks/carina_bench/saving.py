"""``carina bench saving``: times of the pictures of a flight with edits, with and without saving the case."""

from __future__ import annotations

import json
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from carina import commands as c
from carina.cli.console import print_json, print_note
from carina.disk import make_folder, write_whole
from carina.phantom import generate_phantom
from carina.render import LEAD_VIEW, Renderer
from carina.server.frames.pump import FramePump
from carina.server.wire.codec import split_picture
from carina.session import CaseRecords, Session
from carina.session.store.disk_storage import case_files
from carina.track import RenameBranch
from carina.volume import Volume
from carina_bench.gates import Gate
from carina_bench.machine import load_average, machine_facts
from carina_bench.worker import run_section

__all__ = ["measure", "report"]

RATE_HZ = 30
"""Number of pictures per second of the flight during which the case is saved."""
LATE_MS = 50.0
"""Maximum over the pictures of a flight of the delay of a picture while edits are saved, ms."""
EDIT_EVERY = 8
"""Number of pictures between two edits; at 30 pictures a second this is about four edits a second."""
LAYOUT: dict[str, tuple[int, int]] = {LEAD_VIEW: (480, 360)}
"""Views of the measured window with width and height in pixels."""


def report(*, folder: Path, quick: bool, as_json: bool) -> int:
    """Measure, print, and write ``saving.json``; return the exit code."""
    make_folder(folder, what="the measurements")
    facts = machine_facts()
    row = run_section(
        "saving:measure", {"spacing_mm": 3.0 if quick else 0.9, "seconds": 2.0 if quick else 20.0, "turns": 2}
    )
    note = f"not saved: {row['not saved']['late_max_ms']:.0f}; load {row['load_average']}"
    gates = [
        Gate("latest picture while edits are saved (ms late)", row["saved"]["late_max_ms"], LATE_MS, "lower", note=note)
    ]
    document = {
        "benchmark": "saving",
        "version": 1,
        "quick": quick,
        "machine": {**facts, "load_average_after": load_average()},
        "row": row,
        "gates": [gate.to_json() for gate in gates],
    }
    text = json.dumps(document, allow_nan=False, ensure_ascii=False, indent=1) + "\n"
    write_whole(folder / "saving.json", text.encode(), what="the measurements")
    if as_json:
        print_json(document)
        return 0
    print(f"{facts['cpu']}, {facts['cores']} cores, load {facts['load_average']} to {load_average()}")
    for name in ("not saved", "saved"):
        figures = row[name]
        late = ", ".join(f"{what} {figures[f'late_{what}_ms']:.1f}" for what in ("p50", "p95", "max"))
        print(f"  {name}: {figures['num_pictures']} pictures of {figures['num_edits']} edits; ms late: {late}")
    print("\n".join(gate.line() for gate in gates))
    return 0


def measure(request: dict[str, Any]) -> dict[str, Any]:
    """Measure the same flight with the same edits, alternately with and without saving."""
    volume = generate_phantom(spacing_mm=request["spacing_mm"]).volume
    late: dict[str, list[float]] = {"not saved": [], "saved": []}
    edits = dict.fromkeys(late, 0)
    with tempfile.TemporaryDirectory(prefix="carina-bench-") as scratch:
        for turn in range(request["turns"]):
            for name, found in late.items():
                print_note(f"flying: {name}")
                records = None if name == "not saved" else CaseRecords(Path(scratch) / f"cases-{turn}", time.time)
                times_s, num_edits = _flown(volume, records, request["seconds"])
                found += [1000.0 * (gap_s - 1.0 / RATE_HZ) for gap_s in np.diff(times_s)]
                edits[name] += num_edits
    return {
        **{
            name: {
                "num_pictures": len(found),
                "num_edits": edits[name],
                **{f"late_{what}_ms": round(float(np.percentile(found, q)), 2) for what, q in _WHICH},
            }
            for name, found in late.items()
        },
        "load_average": load_average(),
    }


_WHICH = (("p50", 50), ("p95", 95), ("max", 100))


def _flown(volume: Volume, records: CaseRecords | None, seconds: float) -> tuple[list[float], int]:
    """Return the times of arrival of the pictures of a flight, s, and the number of edits.

    The case is not saved if ``records`` is None.
    """
    session = Session(
        lambda shown, transfer: Renderer(shown, transfer=transfer),
        records=records,
        files=None if records is None else case_files(),
    )
    times_s: list[float] = []

    def deliver(data: bytes) -> None:
        header, _ = split_picture(data)
        pump.acknowledge(header["frame_id"])
        if header["view"] == LEAD_VIEW:
            times_s.append(time.perf_counter())

    pump = FramePump(session.scene, deliver, lambda _message: None, clock=time.monotonic)
    pump.set_layout(LAYOUT)
    pump.set_rate(RATE_HZ)
    session.subscribe(lambda _event: pump.content_changed())
    thread = threading.Thread(target=pump.run, daemon=True)
    thread.start()
    num_edits = 0
    try:
        session.do(c.OpenVolume(volume))
        session.jobs.wait_idle(None)
        snapshot = session.snapshot()
        assert snapshot.document is not None
        assert snapshot.document.airways is not None
        branch_id = snapshot.document.airways.tree.tips()[0].id
        began_s = time.perf_counter()
        times_s.clear()
        for n in range(int(seconds * RATE_HZ)):
            time.sleep(max(0.0, began_s + n / RATE_HZ - time.perf_counter()))
            session.do(c.Steer(0.2 if n // 60 % 2 == 0 else -0.2, 0.002, 0.0, 0.0))
            if n % EDIT_EVERY == 0:
                session.do(c.EditTree(RenameBranch(branch_id, f"edit {n}")))
                num_edits += 1
        if records is not None:
            assert records.all(), "nothing was saved"
        return list(times_s), num_edits
    finally:
        pump.stop()
        thread.join()
        session.close()
