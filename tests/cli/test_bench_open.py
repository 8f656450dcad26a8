"""Test of the benchmark of opening, on a small chest."""

from __future__ import annotations

import json
from types import SimpleNamespace

import pytest

from carina.errors import CancelledError
from carina_bench import opening, opening_limits, opening_peers


def test_opening_benchmark_opens_a_small_chest_from_slices_and_from_the_cache_with_equal_results(
    monkeypatch, capsys, tmp_path
):
    small = {"spacing_mm": [6.0, 7.0, 5.0], "repeats": 1}
    # The measurement runs in this process on a small chest; the times are not checked.
    beside = {"spacing_mm": (6.0, 6.0, 10.0), "repeats": 1, "syntaxes": opening_peers.SYNTAXES}

    limits = {"slices": 20, "pixel_mm": 6.0, "slice_mm": 5.0, "files": 30}

    def run(name: str, _request: object) -> object:
        match name:
            case "opening:measure":
                return opening.measure(small)
            case "opening_peers:measure":
                return opening_peers.measure(beside)
        return opening_limits.measure(limits)

    monkeypatch.setattr(opening, "run_section", run)
    assert opening.report(folder=tmp_path, quick=True, as_json=False) == 0
    document = json.loads((tmp_path / "open.json").read_text())
    row = document["row"]
    assert row["equal"]
    assert set(row["ratio"]) >= {"DICOM slices", "NIfTI, packed", opening.CACHED}
    assert row["ratio"][opening.CACHED] == 1.0
    same, *_ = document["gates"]
    assert same["passed"]
    assert "from the cache" in capsys.readouterr().out
    peers = document["peers"]["rows"]
    assert set(peers) == set(opening_peers.SYNTAXES)
    for syntax, one in peers.items():
        assert {"Carina", "SimpleITK", "pydicom"} <= set(one["cpu_over_carina"]), (syntax, one["left_out"])
    assert document["limits"]["listed_code"] == "import.no-images"
    assert document["limits"]["cancel_ms"] > 0


class Importer:
    """Simulate an import of 100 steps of 10 ms that checks for a cancellation after each n-th step."""

    def __init__(self, monkeypatch, check_every: int) -> None:
        self.now_s = 0.0
        self.check_every = check_every
        monkeypatch.setattr(opening_limits, "time", SimpleNamespace(perf_counter=lambda: self.now_s))
        monkeypatch.setattr(opening_limits, "open_volume", self.open)

    def open(self, _folder: object, *, cancel=lambda: False) -> None:
        for step in range(100):
            self.now_s += 0.01
            if step % self.check_every == self.check_every - 1 and cancel():
                raise CancelledError("stopped")


@pytest.mark.parametrize(
    ("check_every", "least_s", "most_s"),
    [(1, 0.0, 0.011), (30, 0.2, 0.301), (1000, 0.95, 1.001)],
    ids=["each step", "rarely", "ignored"],
)
def test_time_of_a_cancellation_includes_imports_that_ignore_it(monkeypatch, tmp_path, check_every, least_s, most_s):
    Importer(monkeypatch, check_every)
    assert least_s <= max(opening_limits._late_s(tmp_path)) <= most_s
