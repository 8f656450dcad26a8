"""Test of the benchmark of saving: flights with and without saving have pictures, and one of them is saved."""

from __future__ import annotations

import json

from carina_bench import saving


def test_saving_benchmark_measures_a_short_flight_with_and_without_saving(monkeypatch, capsys, tmp_path):
    small = {"spacing_mm": 3.0, "seconds": 1.0, "turns": 1}
    monkeypatch.setattr(saving, "run_section", lambda _name, _request: saving.measure(small))
    assert saving.report(folder=tmp_path, quick=True, as_json=False) == 0
    row = json.loads((tmp_path / "saving.json").read_text())["row"]
    assert row["saved"]["num_pictures"] > 0
    assert row["saved"]["num_edits"] == row["not saved"]["num_edits"] == 4
    assert "latest picture while edits are saved" in capsys.readouterr().out
