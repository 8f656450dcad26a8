"""Tests of the structure of ``carina bench track``: available and missing parts, limits and the report."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import SimpleITK as sitk

from cached_test_data import cached_phantom
from carina.errors import CarinaError
from carina.track import AirwayTree, branch_side_and_lobe, find_airways, name_tree
from carina_bench import track, track_names, track_quality
from carina_bench.app import bench_track
from carina_bench.track_truth import truth_of_phantom

ROW = {"what": "paths", "case": "phantom", "figure": 9.0, "limit": 8.0, "unit": "x", "median": 9.0, "min": 8.5}


def test_figure_of_a_track_benchmark_row_is_compared_with_its_limit_and_printed():
    assert track.gate_of(ROW).passed
    assert not track.gate_of({**ROW, "better": "lower"}).passed
    assert track.gate_of({"what": "memory", "figure": 5.0}) is None
    line = track.line_of(ROW)
    assert "paths, phantom: 9 x" in line and "min 8.5" in line and "limit >= 8: met" in line


def test_missing_figure_of_a_benchmark_counts_as_missed_limit_and_is_printed():
    row = {**ROW, "figure": None, "note": "no data"}
    assert not track.gate_of(row).passed
    assert "not measured" in track.line_of(row) and "MISSED" in track.line_of(row) and "no data" in track.line_of(row)


def test_cases_of_the_quality_benchmark_are_those_that_it_paints():
    assert track.PARTS["quality"].cases == track_quality.CASES


def test_help_of_the_track_benchmark_names_every_part_and_the_parts_that_run_only_if_named():
    text = " ".join(str(bench_track.__doc__).split())
    always, if_named = re.search(r"Parts: (.+?)\. The parts (.+?) take", text).groups()
    assert set(always.split(", ")) == {name for name, part in track.PARTS.items() if not part.needs_name}
    assert set(re.split(", | and ", if_named)) == {name for name, part in track.PARTS.items() if part.needs_name}


def test_unknown_case_of_the_track_benchmark_exits_with_code_2_and_lists_the_known_cases(carina, tmp_path):
    ended = carina("bench", "track", "--only", "quality", "--case", "sharper", "--json", "-o", tmp_path / "out")
    assert ended.code == 2
    assert "sharp-25" in ended.json()["error"]["message"]


def test_found_branch_outside_every_true_lumen_counts_as_false():
    pytest.importorskip("scipy")
    phantom = cached_phantom(seed=1, spacing_mm=1.5, generations=4, noise_hu=0.0)
    truth = truth_of_phantom(phantom.truth, phantom.lumen_zyx, phantom.volume)
    airways = find_airways(phantom.volume, progress=False)
    whole = track_quality.figures(phantom.volume, truth, airways)
    assert whole["false_branches"] == 0 and whole["precision"] > 0.99
    # Without the last generation in the truth, branches that the search found there count as false.
    deepest = max(branch.generation for branch in truth.branches)
    short = replace(truth, branches=tuple(b for b in truth.branches if b.generation < deepest))
    lumen = phantom.lumen_zyx != 0
    for branch in truth.branches:
        if branch.generation == deepest:
            ijk = phantom.volume.to_ijk(branch.points)
            for i, j, k in np.rint(ijk).astype(int):
                lumen[k - 2 : k + 3, j - 2 : j + 3, i - 2 : i + 3] = False
    less = track_quality.figures(phantom.volume, replace(short, lumen_zyx=lumen), airways)
    assert less["false_branches"] >= 1 and less["precision"] < whole["precision"]


def test_unknown_part_of_the_track_benchmark_exits_with_code_2_and_lists_the_known_parts(carina, tmp_path):
    ended = carina("bench", "track", "--only", "everything", "--json", "-o", tmp_path / "out")
    assert ended.code == 2
    assert "speed" in ended.json()["error"]["message"]
    assert not (tmp_path / "out").exists()


def test_benchmark_part_without_its_module_is_omitted_with_a_message(carina, monkeypatch, tmp_path):
    monkeypatch.setattr(track, "built_parts", lambda: ["speed"])
    monkeypatch.setattr(track, "run_section", lambda _function, request, threads: [{**ROW, "what": request["part"]}])
    ended = carina("bench", "track", "--json", "-o", tmp_path / "out")
    assert ended.code == 0
    document = ended.json()
    assert document["parts"]["speed"]["rows"][0]["met"] is True
    assert document["parts"]["names"]["left_out"] == "not in this version"
    assert (document["gates_passed"], document["gates_missed"]) == (1, 0)
    assert json.loads((tmp_path / "out" / "track.json").read_text())["parts"] == document["parts"]
    refused = carina("bench", "track", "--only", "names", "--json", "-o", tmp_path / "other")
    assert refused.code == 2
    assert "names" in refused.json()["error"]["message"]


@pytest.mark.parametrize("named", [False, True])
def test_benchmark_part_without_its_peer_library_is_omitted_unless_named(carina, monkeypatch, tmp_path, named):
    def refuse(*_arguments, **_options):
        error = CarinaError("dijkstra3d is not installed", code="machine.extra")
        raise error

    monkeypatch.setattr(track, "built_parts", lambda: ["speed"])
    monkeypatch.setattr(track, "run_section", refuse)
    ended = carina("bench", "track", *(["--only", "speed"] if named else []), "--json", "-o", tmp_path / "out")
    if named:
        assert ended.code == 1
        assert ended.json()["error"]["code"] == "machine.extra"
    else:
        assert ended.code == 0
        assert "dijkstra3d" in ended.json()["parts"]["speed"]["left_out"]


def test_benchmark_compares_lobes_with_mask_files_including_compressed_nifti(tmp_path):
    phantom = cached_phantom(seed=1, spacing_mm=1.5, generations=4, noise_hu=0.0)
    lumen, truth = phantom.lumen_zyx, AirwayTree.from_json(phantom.truth)
    lobes = branch_side_and_lobe(name_tree(truth))
    points = np.concatenate([branch.points for branch in truth.branches])
    expected_lobes = np.repeat(
        [lobes[branch.id] or "" for branch in truth.branches], [len(b.points) for b in truth.branches]
    )
    voxels = np.argwhere(lumen)
    places = phantom.volume.to_lps(voxels[:, ::-1].astype(float))
    near = np.concatenate(
        [expected_lobes[nearest(part, points)] for part in np.array_split(places, len(places) // 500 + 1)]
    )

    def write(name: str, chosen: np.ndarray) -> None:
        mask = np.zeros(lumen.shape, dtype=np.uint8)
        mask[tuple(voxels[chosen].T)] = 1
        image = sitk.GetImageFromArray(mask)
        matrix = phantom.volume.lps_from_ijk
        spacing = np.linalg.norm(matrix[:3, :3], axis=0)
        image.SetSpacing(spacing.tolist())
        image.SetDirection((matrix[:3, :3] / spacing).ravel().tolist())
        image.SetOrigin(matrix[:3, 3].tolist())
        sitk.WriteImage(image, str(tmp_path / f"{name}.nii.gz"))

    write("BronchialTree", np.ones(len(voxels), dtype=bool))
    (tmp_path / "BronchialTree.nii.gz").rename(tmp_path / "BronchialTree.gz")
    for lobe in track_names.LOBES:
        write(lobe, near == lobe)
    lengths = track_names.lobe_lengths(tmp_path)
    assert lengths["right"] > 500
    assert lengths["wrong"] < 0.05 * lengths["right"]

    # If the masks of both sides are exchanged, correct lobes count as wrong.
    for lobe, other in (("RUL", "LUL"), ("RLL", "LLL")):
        write(lobe, near == other)
        write(other, near == lobe)
    swapped = track_names.lobe_lengths(tmp_path)
    assert swapped["wrong"] > 0.7 * lengths["right"]


def nearest(places: np.ndarray, points: np.ndarray) -> np.ndarray:
    return np.argmin(np.linalg.norm(places[:, None] - points[None], axis=2), axis=1)
