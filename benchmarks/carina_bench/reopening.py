"""``carina bench reopen``: time from the click on a saved case to its state and pictures, in a running Carina."""

from __future__ import annotations

import json
import os
import statistics
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from carina import commands as c
from carina.cli.console import print_json, print_note, progress_printer
from carina.disk import make_folder, write_whole
from carina.phantom import generate_phantom
from carina.render import LEAD_VIEW, Renderer
from carina.server.frames.pump import FramePump
from carina.server.wire.codec import split_picture
from carina.session import CaseRecords, Session
from carina.session.store.disk_storage import case_files
from carina.volume import VolumeCache, write_grid
from carina_bench.gates import Gate
from carina_bench.machine import load_average, machine_facts
from carina_bench.opening import QUICK_MM, WHOLE_MM
from carina_bench.worker import run_section
from carina_bench.written_series import BOX_LPS

__all__ = ["measure", "report"]

LAYOUT = {LEAD_VIEW: (960, 720), "axial": (480, 360), "coronal": (480, 360), "sagittal": (480, 360)}
"""Views of the measured window with width and height in pixels."""
WARM_MS = 1000.0
"""Maximum wall time in ms from the reopening of a case to its first airway picture."""
STAGES = ("state", "first airway picture", "all views", "final airway picture")
"""Stages of opening a saved case, to each of which the time is measured."""


def report(*, folder: Path, ct: str | None, quick: bool, as_json: bool) -> int:
    """Measure, print, and write ``reopen.json``; return the exit code."""
    make_folder(folder, what="the measurements")
    facts = machine_facts()
    row = run_section(
        "reopening:measure", {"spacing_mm": QUICK_MM if quick else WHOLE_MM, "ct": ct, "repeats": 3 if quick else 5}
    )
    warm = row["warm"]["first airway picture"]
    note = f"state {row['warm']['state']['wall_ms']:.0f}; load {row['load_average']}"
    gates = [Gate("reopened warm, first airway picture (ms)", warm["wall_ms"], WARM_MS, "lower", note=note)]
    document = {
        "benchmark": "reopen",
        "version": 1,
        "quick": quick,
        "machine": {**facts, "load_average_after": load_average()},
        "row": row,
        "gates": [gate.to_json() for gate in gates],
    }
    text = json.dumps(document, allow_nan=False, ensure_ascii=False, indent=1) + "\n"
    write_whole(folder / "reopen.json", text.encode(), what="the measurements")
    if as_json:
        print_json(document)
        return 0
    print(f"{facts['cpu']}, {facts['cores']} cores, load {facts['load_average']} to {load_average()}")
    nz, ny, nx = row["shape_zyx"]
    print(f"{nx} x {ny} x {nz}, {row['num_branches']} branches; ms by the clock (CPU time of all threads until then)")
    for name in ("warm", "cold"):
        if row[name] is not None:
            stages = (
                f"{stage} {row[name][stage]['wall_ms']:.0f} ({row[name][stage]['cpu_ms']:.0f})" for stage in STAGES
            )
            print(f"  {name}: {', '.join(stages)}")
    print("\n".join(gate.line() for gate in gates))
    return 0


def measure(request: dict[str, Any]) -> dict[str, Any]:
    """Return the times to open a saved case several times: a generated chest, or a CT, with its airways known."""
    with tempfile.TemporaryDirectory(prefix="carina-bench-") as scratch:
        place = Path(scratch)
        path = request["ct"]
        if path is None:
            volume = generate_phantom(spacing_mm=request["spacing_mm"], box_lps=BOX_LPS, progress=progress_printer())
            path = write_grid(place / "ct.nii", volume.volume.hu_zyx, volume.volume.lps_from_ijk, what="the CT")
            del volume
        # The cache ignores files that were modified a moment ago, so its clock is set one minute ahead.
        cache = VolumeCache(place / "cache", max_bytes=1 << 40, clock=lambda: time.time() + 60.0)
        records = CaseRecords(place / "cases", time.time)
        session = Session(
            lambda volume, transfer: Renderer(volume, transfer=transfer),
            records=records,
            files=case_files(cache, records),
        )
        watched = _Watched(session)
        try:
            print_note("finding the airways once")
            session.do(c.OpenPath(str(path)))
            session.jobs.wait_idle(None)
            cache.wait_stored()
            snapshot = session.snapshot()
            assert snapshot.case is not None
            assert snapshot.document is not None
            facts = {
                "shape_zyx": list(snapshot.case.volume.shape_zyx),
                "num_branches": len(snapshot.document.airways.tree.branches) if snapshot.document.airways else 0,
            }
            session.do(c.CloseCase())
            del snapshot
            times: dict[str, list[dict[str, tuple[float, float]]]] = {"warm": [], "cold": []}
            for _ in range(request["repeats"]):
                for name, found in times.items():
                    if name == "cold" and not _forget_pages(place):
                        continue
                    found.append(watched.reopened(records.all()[0].case_id))
                    session.do(c.CloseCase())
        finally:
            session.close()
            watched.close()
    return {**facts, **{name: _medians(found) for name, found in times.items()}, "load_average": load_average()}


class _Watched:
    """Session with a receiver that records the time of arrival of each picture."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._seen: dict[str, tuple[float, float]] = {}
        self._views: set[str] = set()
        self._began = (0.0, 0.0)
        self._case_number = 0
        self._all_seen = threading.Event()
        self._pump = FramePump(session.scene, self._deliver, lambda _message: None, clock=time.monotonic)
        self._pump.set_layout(LAYOUT)
        session.subscribe(self._hear)
        self._thread = threading.Thread(target=self._pump.run, daemon=True)
        self._thread.start()

    def reopened(self, recent_id: str) -> dict[str, tuple[float, float]]:
        """Open a recent case; return the wall time and the CPU time of all threads, s, until each of :data:`STAGES`."""
        self._seen, self._views = {}, set()
        self._all_seen.clear()
        self._case_number = self._session.snapshot().case_number
        self._began = (time.perf_counter(), time.process_time())
        self._session.do(c.OpenRecent(recent_id))
        self._all_seen.wait(120.0)
        self._session.jobs.wait_idle(None)
        return dict(self._seen)

    def close(self) -> None:
        """Stop receiving the pictures of the session."""
        self._pump.stop()
        self._thread.join()

    def _note(self, stage: str) -> None:
        if stage not in self._seen:
            wall_s, cpu_s = self._began
            self._seen[stage] = (time.perf_counter() - wall_s, time.process_time() - cpu_s)
            if len(self._seen) == len(STAGES):
                self._all_seen.set()

    def _hear(self, _event: object) -> None:
        if self._session.snapshot().case is not None:
            self._note("state")
        self._pump.wake()

    def _deliver(self, data: bytes) -> None:
        header, _ = split_picture(data)
        self._pump.acknowledge(header["frame_id"])
        self._views.add(header.get("stands_for") or header["view"])
        if header["view"] == LEAD_VIEW:
            self._note("first airway picture")
            if header["full"]:
                self._note("final airway picture")
        if len(self._views) == len(LAYOUT):
            self._note("all views")


def _forget_pages(folder: Path) -> bool:
    """Request the system to drop the files of a folder from its file cache; return False if the system cannot."""
    ask: Callable[..., None] | None = getattr(os, "posix_fadvise", None)
    if ask is None:
        return False
    os.sync()
    for path in folder.rglob("*"):
        if path.is_file():
            with path.open("rb") as file:
                ask(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
    return True


def _medians(found: list[dict[str, tuple[float, float]]]) -> dict[str, Any] | None:
    if not found:
        return None
    return {
        stage: {
            "wall_ms": round(1000 * statistics.median(one[stage][0] for one in found), 1),
            "cpu_ms": round(1000 * statistics.median(one[stage][1] for one in found), 1),
            "all_ms": [round(1000 * one[stage][0], 1) for one in found],
        }
        for stage in STAGES
    }
