"""The timing benchmark: summaries and gates, which are the same on every machine."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from carina.navigate import FlightPath
from carina.render import Renderer, picture_threads
from carina_haptics_bench import force_timing
from carina_haptics_bench.pictures import full_pictures, moving_pictures, summed
from small_case import small_volume


@dataclass
class Header:
    """The fields of a picture header that the summary reads."""

    width: int
    step_vox: float | None
    render_ms: float = 10.0


def test_summary_of_frame_times_excludes_the_first_second_and_the_cut_plane():
    shown: list[Any] = [
        (0.5, Header(512, 0.5)),
        (1.5, Header(256, 0.5)),
        (2.0, Header(128, 1.0)),
        (2.5, Header(512, None)),
        (3.5, Header(512, 0.5)),
    ]
    found = summed(shown, 0.0, 3.0)
    assert (found.per_s, found.scale, found.step_vox, found.finder_per_s) == (1.0, 0.375, 0.75, 0.5)
    assert summed(shown[3:4], 0.0, 3.0).per_s == 0.0


def test_moving_pictures_have_the_requested_rate_and_pictures_at_rest_full_size():
    volume = small_volume()
    renderer = Renderer(volume)
    centre = volume.centre_lps
    path = FlightPath(np.array([centre, centre + np.array([0.0, 0.0, -40.0])]))
    moving = moving_pictures(renderer, path, 1.5)
    assert 0.0 < moving.per_s + moving.finder_per_s < 60.0
    assert 0.0 <= moving.scale <= 1.0
    full = full_pictures(renderer, path, 0.05)
    assert (full.scale, full.step_vox) == (1.0, 0.5)
    assert full.per_s > 0.0


def test_timing_benchmark_restores_the_threads_and_checks_limits_only_while_pictures_move(
    monkeypatch, capsys, tmp_path
):
    volume = small_volume()
    top = volume.lps_from_ijk[:3, 3] + np.array([0.0, 0.0, 50.0])
    monkeypatch.setattr(force_timing, "open_phantom", lambda *_: (volume, [top]))
    # A short run: the measured values do not matter here.
    monkeypatch.setattr(force_timing, "measure", lambda _seconds, measure=force_timing.measure: measure(1.2))
    all_threads = picture_threads()
    assert force_timing.report(folder=tmp_path, quick=True, as_json=False) == 0
    assert picture_threads() == all_threads
    document = json.loads((tmp_path / "haptics.json").read_text())
    assert document["render_threads"] == max(1, all_threads - 1)
    beside = [(row["hand"], row["beside"], row["gated"]) for row in document["rows"]]
    assert beside == [
        ("simulated hand", "nothing else", False),
        ("simulated hand", "moving pictures", True),
        ("bridge over UDP", "moving pictures", True),
        ("simulated hand", "full pictures", False),
    ]
    for row in document["rows"]:
        assert row["share_missed"] == row["num_missed"] / max(row["num_ticks"], 1)
    missed = [gate for gate in document["gates"] if gate["name"].startswith("share of deadlines missed")]
    assert [gate["limit"] for gate in missed] == [0.001, 0.001]
    assert "missed" in capsys.readouterr().out
