"""Tests of the command ``carina track`` in a volume without airways: its path, and the figures that are unknown."""

from __future__ import annotations

import json

import numpy as np
import pytest

from carina.phantom import generate_phantom
from carina.session import Case
from carina.volume import write_grid
from vessel_phantom import bent_vessel


@pytest.fixture(scope="module")
def vessel(tmp_path_factory):
    """Return a scan, and a start and an end as command-line arguments."""
    volume, _, root, _, end = bent_vessel()
    scan = tmp_path_factory.mktemp("vessel") / "vessel.nii.gz"
    write_grid(scan, volume.hu_zyx, volume.lps_from_ijk, what="the scan")
    return scan, *(",".join(f"{v:.3f}" for v in point) for point in (root, end))


def test_path_through_a_vessel_is_written_with_null_for_its_unknown_figures(carina, vessel, tmp_path):
    scan, root, end = vessel
    tree = tmp_path / "tree.json"
    ended = carina("track", scan, "--cost", "walls", f"--root={root}", f"--target={end}", "-o", tree, "--json")
    assert ended.code == 0
    result = ended.json()
    (row,) = result["targets"]
    assert row["problem"] is None
    # An unknown figure is null and never 0.
    assert (row["min_radius_mm"], row["generation"], row["search"]["num_outside"]) == (None, None, None)
    assert row["search"]["value_range"][0] > 1100
    assert "track.no-lumen" in [badge["code"] for badge in result["badges"]]
    assert "track.no-lumen" in [badge["code"] for badge in json.loads(tree.read_text())["badges"]]
    output = carina("track", scan, "--cost", "walls", f"--root={root}", f"--target={end}").err
    assert "values along the path from 11" in output
    assert "without an airway lumen" in output
    assert "generation" not in output


def test_track_command_lists_the_wall_crossings_of_a_path_beside_the_airways(carina, tmp_path):
    phantom = generate_phantom(spacing_mm=3.0, generations=3)
    scan = tmp_path / "phantom.nii.gz"
    write_grid(scan, phantom.volume.hu_zyx, phantom.volume.lps_from_ijk, what="the scan")
    trachea = np.array(phantom.truth["branches"][0]["points"])
    beside = ",".join(f"{v:.2f}" for v in trachea[len(trachea) // 2] + np.array([25.0, 0.0, 0.0]))
    ended = carina("track", scan, "--cost", "walls", f"--target={beside}", "--json")
    assert ended.code == 0, ended.err
    result = ended.json()
    assert result["search"]["relaxed"] is True
    (row,) = result["targets"]
    crossings = row["search"]["crossings"]
    assert len(crossings) % 2 == 1
    assert crossings[0]["enters"] is False
    assert row["length_mm"] <= row["search"]["search_length_mm"]
    assert row["search"]["search_outside_mm"] >= row["search"]["outside_mm"] - 2.0 > 0.0
    assert f"out at {crossings[0]['along_mm']:.1f} mm" in ended.err
    plain = carina("track", scan, "--cost", "walls", f"--target={beside}", "--no-relax", "--json").json()
    assert plain["search"]["relaxed"] is False
    assert plain["targets"][0]["length_mm"] > row["length_mm"]


def test_track_command_without_airways_and_without_a_start_is_refused(carina, vessel):
    scan, _, end = vessel
    ended = carina("track", scan, "--cost", "walls", f"--target={end}")
    assert ended.code == 4
    assert "a start point (root)" in ended.err


def test_track_command_in_a_case_without_airways_needs_a_start(carina, vessel, tmp_path):
    scan, root, end = vessel
    with Case.open(scan) as opened:
        case = opened.save(tmp_path / "vessel.carina")
    tracked = carina("track", case, "--cost", "walls", f"--root={root}", f"--target={end}", "--json")
    assert tracked.code == 0
    assert tracked.json()["targets"][0]["search"]["num_outside"] is None
    ended = carina("track", case, "--cost", "walls", f"--target={end}")
    assert ended.code == 4
    assert "--root" in ended.err


def test_track_command_to_a_target_outside_the_volume_without_airways_is_refused(carina, vessel):
    scan, root, _ = vessel
    ended = carina("track", scan, "--cost", "paper", f"--root={root}", "--target=900,0,0")
    assert ended.code == 2
    assert "outside the scan" in ended.err
