"""Tests of the command ``carina bench cluster``: tables beside the paper's rows, and plots.

The cost of each row is set by the tests, not measured.
"""

from __future__ import annotations

import json
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from carina_bench import cluster


@pytest.fixture
def measured(monkeypatch):
    """Replace the measured cost by that of a picture of 100 ms whose middle rows cost twice as much as the others."""
    profile = np.ones(cluster.SIDE)
    profile[128:384] = 2.0
    monkeypatch.setattr(cluster, "_measure", lambda *_: cluster._Cost(0.1, profile / profile.mean()))


def test_cluster_simulation_prints_and_draws_its_tables_beside_those_of_the_paper(carina, tmp_path, measured):
    ended = carina("bench", "cluster", "--only", "simulation", "--quick", "-o", tmp_path)
    assert ended.code == 0, ended.err
    assert "not a measurement" in ended.out
    assert "1.70 fps  x 1.00  100 %   855193 us" in ended.out and "15.83 fps  x 9.54   60 %   338778 us" in ended.out
    assert "assumed speeds 0.8, 0.8, 1, 1, 0.7" in ended.out
    found = json.loads((tmp_path / "cluster.json").read_text())["simulation"]
    schemes = {scheme.name for scheme in cluster.SCHEMES}
    assert {(row["grid"], row["machine"], row["scheme"], row["renderers"]) for row in found["table_1"]} == {
        (grid, machine, scheme, num)
        for grid in cluster.GRIDS
        for machine in ("here", "today", "paper")
        for scheme in schemes
        for num in (1, 2, 4, 8)
    }
    assert [row["renderers"] for row in found["table_2"]] == [16] * 12
    # No machine is faster than it renders, and with the choice of lanes more machines are never slower than one.
    assert max(row["efficiency"] for row in found["table_1"] + found["table_2"]) <= 100
    for row in found["table_1"] + found["table_2"]:
        if row["scheme"] == "all":
            key = (row["grid"], row["machine"], "all", 1)
            [alone] = [r for r in found["table_1"] if (r["grid"], r["machine"], r["scheme"], r["renderers"]) == key]
            assert row["fps"] >= alone["fps"]
    for row in found["table_1"] + found["table_2"]:
        if (row["machine"], row["scheme"]) == ("paper", "all"):
            printed = cluster._paper_row(row)
            assert printed is not None
            assert row["response_us"] <= 1.2 * printed[3] and row["fps"] >= 0.98 * printed[0]
            assert row["speedup"] >= {1: 0.98, 2: 1.9, 4: 3.85, 8: 7.5, 16: 10.8}[row["renderers"]]
    rates = {row["scheme"]: row["fps"] for row in found["table_1"] if (row["renderers"], row["machine"]) == (8, "here")}
    # Rows have different costs and the network takes 1 ms, so each feature of the paper's scheduler increases the rate.
    full = rates["no choice of lanes"]
    assert all(full > rates[name] for name in schemes - {"all", "no choice of lanes"})
    # The trials of other numbers of lanes and the smaller number of open frames cost a few frames.
    assert rates["all"] >= 0.9 * full
    assert rates["none of them"] < 0.8 * rates["all"]
    for name in ("frame-rate.svg", "speed-up.svg"):
        text = "".join(ET.parse(tmp_path / name).getroot().itertext())
        assert "head, paper" in text and "lung, simulated" in text


def test_unknown_section_of_the_cluster_benchmark_is_refused(carina, tmp_path):
    ended = carina("bench", "cluster", "--only", "magic", "-o", tmp_path)
    assert ended.code == 2 and "sleeping" in ended.err


def test_network_model_is_fitted_on_2_and_8_machines_and_checked_on_4_and_16(carina, tmp_path):
    ended = carina("bench", "cluster", "--only", "network", "-o", tmp_path)
    assert ended.code == 0, ended.err
    assert ended.out.count("4 (checked)") == ended.out.count("16 (checked)") == 4
    rows = json.loads((tmp_path / "cluster.json").read_text())["network"]
    assert {row["renderers"] for row in rows if row["fitted"]} == {2, 8}
    # The fit recovers the parameter of an exact law. One row of each grid deviates strongly and must be reported.
    assert cluster.serial_share([(2, 1 / 0.55), (8, 1 / 0.2125)]) == pytest.approx(0.1)
    head = {row["renderers"]: row for row in rows if (row["grid"][:4], row["of"]) == ("head", "speed-up")}
    assert head[2]["serial_share"] == pytest.approx(0.098, abs=0.001)
    assert abs(head[4]["off_percent"]) < 15.0
    assert head[16]["off_percent"] < -40.0


def test_cluster_benchmark_runs_its_other_sections_after_a_failed_section(carina, tmp_path, measured, monkeypatch):
    def broken(*_):
        raise RuntimeError("no head answered")

    monkeypatch.setattr(cluster, "_simulated", broken)
    ended = carina("bench", "cluster", "--only", "network", "--only", "simulation", "-o", tmp_path)
    assert ended.code == 1
    assert "serial share" in ended.out
    assert "simulation: failed (RuntimeError: no head answered)" in ended.out
    found = json.loads((tmp_path / "cluster.json").read_text())
    assert found["failed"]["simulation"]["words"] == "RuntimeError: no head answered"
    assert "in broken" in found["failed"]["simulation"]["trace"]
    assert "network" in found and "simulation" not in found


def test_cluster_benchmark_prints_and_writes_each_section_when_it_ends(monkeypatch, tmp_path, capsys):
    seen = []

    def second(*_):
        seen.append((capsys.readouterr().out, json.loads((tmp_path / "cluster.json").read_text())))
        return {"table_1": [], "table_2": []}

    monkeypatch.setattr(cluster, "_simulated", second)
    assert cluster.report(folder=tmp_path, only=["simulation", "network"], quick=True, as_json=False) == 0
    ((printed, written),) = seen
    assert "serial share" in printed
    assert "network" in written
