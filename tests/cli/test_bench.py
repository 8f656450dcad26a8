"""Tests of the benchmarks without other programs: refusals, timing, limits and the compared scene."""

from __future__ import annotations

import importlib.util
import itertools
import json
import os
import subprocess
import sys
from collections import Counter

import numpy as np
import pytest

import carina.cli.bench as verb
from carina.errors import CarinaError
from carina_bench import machine
from carina_bench.alternating_timer import Times, median_ratio, order_of_round, take_turns
from carina_bench.command import SECTIONS
from carina_bench.compared_scene import STEP_VOX, TRANSFER, opacity_table
from carina_bench.gates import Gate
from carina_bench.pictures import difference, save
from carina_bench.worker import run_section


def test_missing_benchmark_extra_exits_with_code_1_and_the_installation_command(carina, monkeypatch, tmp_path):
    found = importlib.util.find_spec
    missing = {"vtk", "numba"}
    monkeypatch.setattr(machine.importlib.util, "find_spec", lambda name: None if name in missing else found(name))
    ended = carina("bench", "render", "--json", "-o", tmp_path / "out")
    assert ended.code == 1
    assert ended.json()["error"]["code"] == "machine.extra"
    assert "vtk, numba" in ended.err and "vtk>=" in ended.err
    assert not (tmp_path / "out").exists()


def test_unknown_benchmark_exits_with_code_2_and_lists_the_known_ones(carina, tmp_path):
    ended = carina("bench", "render", "--only", "everything", "--json", "-o", tmp_path / "out")
    assert ended.code == 2
    assert "frames" in ended.json()["error"]["message"]


def test_bench_command_of_an_installed_wheel_states_where_the_benchmarks_are(carina, monkeypatch, tmp_path):
    monkeypatch.setattr(verb, "find_spec", lambda _name: None)
    monkeypatch.setattr(verb.carina, "__file__", str(tmp_path / "site-packages" / "carina" / "__init__.py"))
    ended = carina("bench", "render", "--quick", "--json")
    assert ended.code == 1
    assert ended.json()["error"]["code"] == "machine.benchmarks-missing"
    assert "benchmarks/" in ended.err and "checkout" in ended.err


def test_bench_command_in_a_checkout_runs_from_any_folder(tmp_path):
    # The test uses a separate process, because the import path of the test process contains the folder of the
    # benchmarks.
    command = [sys.executable, "-m", "carina.cli", "bench", "isoregion", "--only", "nothing", "--json"]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    ended = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 2, ended.stderr
    assert "map" in json.loads(ended.stdout)["error"]["message"]


def test_compared_functions_are_timed_alternately_and_the_first_round_is_not_counted():
    calls = []
    times = take_turns({name: lambda n=name: calls.append(n) for name in "abc"}, 3)
    assert calls[:3] == ["a", "b", "c"]
    assert calls[3:] == ["a", "b", "c", "a", "c", "b", "c", "a", "b"]
    assert all(len(t.cpu_ms) == 3 for t in times.values())


@pytest.mark.parametrize("names", ["ab", "abc", "abcd", "abcde"])
def test_each_compared_function_follows_each_other_one_equally_often(names):
    rounds = [order_of_round(names, turn) for turn in range(2 * len(names))]
    assert all(sorted(order) == sorted(names) for order in rounds)
    pairs = Counter(pair for order in rounds for pair in itertools.pairwise(order))
    assert len(pairs) == len(names) * (len(names) - 1) and set(pairs.values()) == {2}
    assert set(Counter(order[0] for order in rounds).values()) == {2}


def test_speed_ratio_is_the_median_of_ratios_within_a_round():
    slow, fast = Times((10.0, 100.0, 20.0), (0.0,) * 3), Times((5.0, 50.0, 4.0), (0.0,) * 3)
    assert median_ratio(slow, fast) == 2.0


@pytest.mark.parametrize(
    ("figure", "better", "passed"), [(9.0, "higher", True), (8.99, "higher", False), (9.1, "lower", False)]
)
def test_figure_equal_to_its_limit_counts_as_met(figure, better, passed):
    gate = Gate("frame", figure, 9.0, better)
    assert gate.passed is passed
    assert ("MISSED" in gate.line()) is not passed


def test_difference_of_two_pictures_is_measured_per_pixel(tmp_path):
    a = np.zeros((2, 2, 3), np.uint8)
    b = a.copy()
    b[0, 0, 1], b[1, 1] = 3, 1
    assert difference(a, b) == {"max": 3, "mean": 0.5, "share_of_pixels": 0.5, "share_above_one": 0.25}
    assert (tmp_path / save(tmp_path, "picture", b)).is_file()


def test_opacity_table_of_the_peer_implementation_equals_that_of_the_core():
    # The two implementations are independent and may differ by the rounding of float32.
    from carina import _core

    step_mm = STEP_VOX * 0.7
    core = _core.TransferTable(TRANSFER.points, reference_mm=1.0, step_mm=step_mm, lo=-1024, hi=600)
    expected = opacity_table(TRANSFER, step_mm, -1024, 600)
    found = np.array([core.entry(hu) for hu in range(-1024, 601)], np.float32)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7)


def test_failed_benchmark_section_raises_the_error_of_its_process(tmp_path):
    request = {"cases": [str(tmp_path / "no-such-ct")], "poses": 2, "repeats": 1, "folder": str(tmp_path)}
    with pytest.raises(CarinaError, match="no-such-ct") as caught:
        run_section("render:small_frames", request, threads=1)
    assert caught.value.exit_code == 3


def test_benchmark_section_runs_in_a_separate_process(tmp_path):
    request = {"cases": ["patient"], "poses": 2, "repeats": 1, "folder": str(tmp_path)}
    rows = run_section("render:small_frames", request, threads=2)
    assert rows[0]["case"] == "patient"
    assert rows[0]["frames_per_s"] > 0


def test_benchmark_section_projections_is_measured_and_reported_with_its_limits(tmp_path):
    request = {"cases": ["patient"], "repeats": 2, "folder": str(tmp_path)}
    rows = run_section("isoregion:projections", request, threads=1)
    section = SECTIONS["isoregion"]["projections"]
    ratio, equal = section.gates(rows)
    assert equal.passed
    assert ratio.figure == rows[0]["ratio"]["median"] > 0
    (line,) = section.words(rows)
    assert "patient" in line and "numpy" in line


def test_benchmark_starts_a_server_views_it_and_reads_its_peak_memory(tmp_path):
    (row,) = run_section("memory:server_memory", {"cases": ["patient"], "folder": str(tmp_path)})
    assert set(row["views_seen"]) >= {"airway", "tree", "tri-plane", "xray-axial"}
    if sys.platform == "linux":
        assert row["peak_bytes"] > row["volume_bytes"]
        assert "times the volume" in SECTIONS["isoregion"]["memory"].words([row])[0]


def test_cpu_time_taken_by_the_host_machine_never_decreases():
    first = machine.stolen_s()
    if first is None:
        pytest.skip("this system does not report the time that its host takes")
    again = machine.stolen_s()
    assert again is not None
    assert 0.0 <= first <= again
