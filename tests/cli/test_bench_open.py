"""Test of the benchmark of opening, on a small chest."""

from __future__ import annotations

import json

from carina_bench import opening


def test_opening_benchmark_opens_a_small_chest_from_slices_and_from_the_cache_with_equal_results(
    monkeypatch, capsys, tmp_path
):
    small = {"spacing_mm": [6.0, 7.0, 5.0], "repeats": 1}
    # The measurement runs in this process on a small chest; the times are not checked.
    monkeypatch.setattr(opening, "run_section", lambda _name, _request: opening.measure(small))
    assert opening.report(folder=tmp_path, quick=True, as_json=False) == 0
    document = json.loads((tmp_path / "open.json").read_text())
    row = document["row"]
    assert row["equal"]
    assert set(row["ratio"]) >= {"DICOM slices", "NIfTI, packed", opening.CACHED}
    assert row["ratio"][opening.CACHED] == 1.0
    same, *_ = document["gates"]
    assert same["passed"]
    assert "from the cache" in capsys.readouterr().out
