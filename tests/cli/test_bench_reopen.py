"""Test of the benchmark of reopening, on a small case: each stage is reached with warm caches and from the disk."""

from __future__ import annotations

import json

from carina_bench import reopening


def test_reopening_benchmark_reaches_the_final_picture_of_a_small_case(monkeypatch, capsys, tmp_path):
    small = {"spacing_mm": [3.0, 3.0, 3.0], "ct": None, "repeats": 1}
    monkeypatch.setattr(reopening, "run_section", lambda _name, _request: reopening.measure(small))
    assert reopening.report(folder=tmp_path, ct=None, quick=True, as_json=False) == 0
    row = json.loads((tmp_path / "reopen.json").read_text())["row"]
    assert row["num_branches"] > 20
    assert set(row["warm"]) == set(reopening.STAGES)
    assert "reopened warm" in capsys.readouterr().out
