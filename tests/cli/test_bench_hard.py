"""Tests of the hard cases of ``carina bench track``: kernels, slices, terminal airways, fine vessels, figures."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from carina.track.find.kernel_sharpness import edge_undershoot_hu
from carina.track.intensity_levels import AirScale
from carina_bench import track, track_hard
from carina_bench.paint import PaintOptions, Scanned, Scene, _axes, paint, scanned
from carina_bench.paint_fine_vessels import FineVessel, add_fine_vessels, fine_vessels
from carina_bench.paint_slices import Slices, noisy_slices, slice_weights, sliced
from carina_bench.paint_terminal import MIN_RADIUS_MM, terminal_airways
from carina_bench.paint_tubes import Tube
from carina_bench.track_hard_cases import KERNELS, OPTIONS, cached, imaged
from carina_bench.track_truth import TrueBranch, Truth

VOXEL = 0.6
LUNG = -860
QUIET = PaintOptions(noise_hu=0.0, kernel="rimmed-medium")


class Lung:
    """Scene of unlimited lung without vessels."""

    def in_lung(self, points: np.ndarray, margin_mm: float, *, num: int = 26) -> np.ndarray:
        return np.ones(len(points), np.bool_)

    def at_vessel(self, points: np.ndarray, reach_mm: float) -> np.ndarray:
        return np.zeros(len(points), np.bool_)


def empty(size: int, *tubes: Tube) -> Scene:
    return Scene(np.full((size,) * 3, LUNG, np.int16), np.diag([VOXEL, VOXEL, VOXEL, 1.0]), tubes)


def a_tip(radius_mm: float = 1.1) -> Tube:
    """Return a tube that ends in the middle of a cube of 40 mm."""
    points = np.array([20.0, 20.0, 39.0]) + np.linspace(0.0, -18.0, 37)[:, None] * [0.0, 0.0, 1.0]
    return Tube(points, np.full(37, radius_mm), id=0)


def grown(seed: int, share_per_mm2: float = 10.0) -> list[Tube]:
    return terminal_airways([a_tip()], Lung(), share_per_mm2, np.random.default_rng(seed))


@pytest.mark.parametrize(
    ("name", "least", "most"), [("soft", -60.0, 0.0), ("medium", 3.0, 15.0), ("sharp", 15.0, 200.0)]
)
@pytest.mark.parametrize("voxel", [0.5, 0.6, 0.7])
def test_sharper_kernel_adds_an_edge_of_its_stated_depth_beside_vessels(name, least, most, voxel):
    size = 72
    turns = np.linspace(0.0, 2.0 * math.pi, 9)[:-1]
    middle = 0.5 * size * voxel
    vessels = [
        Tube(
            np.array([[middle + 14 * math.cos(t), middle + 14 * math.sin(t), z] for z in (-2.0, size * voxel)]),
            np.full(2, 2.0),
            is_artery=True,
        )
        for t in turns
    ]
    scene = Scene(np.full((size,) * 3, LUNG, np.int16), np.diag([voxel, voxel, voxel, 1.0]), tuple(vessels))
    made = paint(scene, replace(QUIET, kernel=KERNELS[name]))
    rim = edge_undershoot_hu(made.volume, AirScale(-1000.0, 0.0))
    assert rim is not None and least <= rim <= most


@pytest.mark.parametrize(
    "slices", [Slices(1.0), Slices(1.5), Slices(3.0), Slices(5.0), Slices(3.0, 2.0), Slices(2.0, is_resampled=True)]
)
def test_averaging_to_thick_slices_preserves_a_constant_and_a_linear_slope(slices):
    weights, first_mm, step_mm = slice_weights(100, 0.7, slices)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)
    # The value of a linear slope along z at the middle of a slice is exact.
    at_mm = first_mm + step_mm * np.arange(len(weights))
    np.testing.assert_allclose(weights @ (0.7 * np.arange(100)), at_mm, atol=0.18)
    assert step_mm == slices.distance_mm
    assert at_mm[-1] <= 0.7 * 99.5


def test_reconstructed_thick_slices_keep_the_sum_and_resampled_slices_show_thin_slices():
    thin = np.zeros((60, 2, 2), np.float32)
    thin[23] = 100.0
    weights, _, step = slice_weights(60, 0.5, Slices(3.0))
    thick = sliced(thin, weights)
    assert step == 3.0 and len(thick) == 10
    assert float(thick[:, 0, 0].sum()) * 3.0 == pytest.approx(100.0 * 0.5)
    weights, _, _ = slice_weights(60, 0.5, Slices(1.0, is_resampled=True))
    assert sliced(thin, weights)[:, 0, 0].max() == 0.0  # the bright slice is between two of the resampled slices


def test_overlapping_slices_show_one_structure_in_two_slices():
    thin = np.zeros((60, 1, 1), np.float32)
    thin[30] = 100.0
    apart, _, _ = slice_weights(60, 0.5, Slices(3.0))
    overlapping, _, _ = slice_weights(60, 0.5, Slices(3.0, 1.5))
    assert (sliced(thin, apart) > 0.0).sum() == 1
    assert (sliced(thin, overlapping) > 0.0).sum() == 2


@pytest.mark.parametrize("slices", [Slices(0.7), Slices(2.0), Slices(3.0, 1.0)])
def test_painted_noise_has_the_requested_deviation_and_is_correlated_in_overlapping_slices(slices):
    weights, _, _ = slice_weights(40, 0.7, slices)
    values = np.full((len(weights), 64, 64), -300, np.float32)
    hu = noisy_slices(values, weights, QUIET.scanner(), VOXEL, 30.0, (1, 7)) + 300.0
    assert hu.std() == pytest.approx(30.0, rel=0.05)
    likeness = float((hu[1:] * hu[:-1]).mean() / hu.var())
    assert likeness == pytest.approx(2.0 / 3.0 if slices.increment_mm else 0.0, abs=0.08)


@pytest.mark.parametrize("direction", [(0, 0, 1), (1, 0, 0), (1, 2, 3)])
def test_painted_fine_vessel_has_the_profile_of_a_tube_of_its_radius(direction):
    size, radius = 30, 0.4
    along = np.array(direction) / np.linalg.norm(direction)
    points = (0.5 * (size - 1) + np.array([0.3, 0.1, 0.2])) * VOXEL + np.linspace(-5.0, 5.0, 21)[:, None] * along
    tube = Tube(points, np.full(21, radius), is_artery=True)
    reported: list[str] = []
    as_tube = scanned(empty(size, tube), QUIET, reported.append).values_zyx
    as_line = scanned(
        replace(empty(size), fine_vessels=(FineVessel(points, radius),)), QUIET, reported.append
    ).values_zyx
    # The ends of a tube are hemispheres, which add half a ball each.
    rise = as_tube.max() - LUNG
    assert rise > 200.0
    middle = size // 2
    near = np.s_[middle - 4 : middle + 5, middle - 4 : middle + 5, middle - 4 : middle + 5]
    assert np.abs(as_tube[near] - as_line[near]).max() <= 0.06 * rise
    volume_mm3 = float((as_line - LUNG).sum()) * VOXEL**3 / (QUIET.vessel_hu - LUNG)
    assert volume_mm3 == pytest.approx(math.pi * radius**2 * 10.0, rel=0.02)


def test_fine_vessel_changes_no_voxel_inside_a_vessel_mask():
    scene = empty(20)
    axes = scanned(scene, QUIET, lambda _step: None)
    values = axes.values_zyx.copy()
    hu = np.full(scene.hu_zyx.shape, QUIET.vessel_hu, np.int16)
    line = FineVessel(np.array([[5.0, 6.0, 3.0], [6.0, 6.0, 8.0]]), 0.5)
    add_fine_vessels(values, hu, [line], _axes(scene, QUIET, np.full(3, VOXEL)), QUIET.vessel_hu)
    np.testing.assert_array_equal(values, axes.values_zyx)


def test_painted_fine_vessels_do_not_touch_airways_and_some_are_close_to_them():
    pytest.importorskip("scipy")
    trunk = replace(a_tip(0.8), generation=4)
    places = np.random.default_rng(0).uniform(2.0, 38.0, (400, 3))
    vessels = fine_vessels([trunk], Lung(), places, 300, np.random.default_rng(3))
    assert len(vessels) > 150
    reach = float(trunk.outer_mm()[0])
    gaps = []
    for vessel in vessels:
        assert 0.3 <= vessel.radius_mm <= 0.6
        off = np.linalg.norm(vessel.points[:, None] - trunk.points, axis=2).min(axis=1)
        gaps.append(float(off.min()) - reach - vessel.radius_mm)
    assert min(gaps) > 0.0
    assert sum(gap < 1.5 for gap in gaps) >= 5


def test_terminal_airways_taper_by_murrays_rule_without_touching():
    found = grown(5)
    every = {tube.id: tube for tube in (a_tip(), *found)}
    assert len(found) >= 8 and len(every) == len(found) + 1
    for tube in found:
        parent = every[tube.parent]
        assert tube.radius_mm.min() >= MIN_RADIUS_MM and tube.radius_mm.max() < parent.radius_mm.min()
        assert np.allclose(tube.points[0], parent.points[-1])
        assert 0.2 <= tube.thickness_mm <= 0.42
        assert tube.generation == parent.generation + 1
        turn = math.degrees(
            math.acos(float(np.clip(direction(tube.points[:2]) @ direction(parent.points[-7:]), -1.0, 1.0)))
        )
        assert 5.0 < turn < 75.0
    siblings = [[tube for tube in found if tube.parent == parent] for parent in every]
    for fork in siblings:
        if len(fork) == 2:
            flow = sum(float(tube.radius_mm[0]) ** 2.8 for tube in fork)
            assert flow == pytest.approx(float(every[fork[0].parent].radius_mm[-1]) ** 2.8, rel=0.2)
    for one in found:
        for other in found:
            if one.id < other.id and len({one.id, one.parent, other.id, other.parent}) == 4:
                gap = np.linalg.norm(one.points[:, None] - other.points, axis=2).min()
                assert gap > one.outer_mm()[-1] + other.outer_mm()[-1]


def direction(points: np.ndarray) -> np.ndarray:
    way = points[-1] - points[0]
    return way / np.linalg.norm(way)


def test_share_of_airways_that_branch_further_depends_on_their_radius():
    counts = [sum(len(grown(seed, share)) for seed in range(12)) for share in (0.0, 0.3, 10.0)]
    assert counts[0] == 0 and 0 < counts[1] < 0.4 * counts[2]


def test_terminal_airway_centres_are_dark_and_their_walls_are_brighter():
    tubes = [a_tip(), *grown(5)]
    # The blur of the medium kernel, or of wider voxels, hides lumens of 0.45 mm even without noise.
    scene = Scene(np.full((134,) * 3, LUNG, np.int16), np.diag([0.3, 0.3, 0.3, 1.0]), tuple(tubes))
    made = paint(scene, replace(QUIET, kernel="sharp", slice_sigma_mm=0.2))
    num_compared = 0
    for tube in made.airways[1:]:
        middle = len(tube.points) // 2 + tube.true_from // 2
        if tube.points[middle].min() < 2.0 or tube.points[middle].max() > 38.0:
            continue  # The voxel is outside the scene.
        num_compared += 1
        at, course = tube.points[middle], direction(tube.points[middle - 1 : middle + 2])
        side = np.cross(course, [0.3, 0.8, 0.5])
        side /= np.linalg.norm(side)
        away = float(tube.radius_mm[middle]) + 0.3
        ring = [at + away * turned for turned in (side, -side, np.cross(course, side), -np.cross(course, side))]
        axis, wall = hu_at(made.volume, at[None])[0], hu_at(made.volume, np.array(ring)).mean()
        assert axis < -650.0 and axis < wall - 25.0, (tube.radius_mm[middle], axis, wall)
    assert num_compared >= 6


def hu_at(volume, points: np.ndarray) -> np.ndarray:
    ijk = volume.to_ijk(points)
    base = np.floor(ijk).astype(int)
    share = ijk - base
    result = np.zeros(len(points))
    for corner in np.ndindex(2, 2, 2):
        i, j, k = (base + corner).T
        result += np.prod(np.where(corner, share, 1.0 - share), axis=1) * volume.hu_zyx[k, j, i]
    return result


def test_true_radii_equal_those_of_the_painted_lumen():
    """Check that the partial volumes of the lumen along a terminal airway sum to the true area."""
    for radius in (0.45, 0.7):
        points = np.array([[9.1, 9.3, -3.0], [9.1, 9.3, 21.0]])
        tube = Tube(points, np.full(2, radius), thickness_mm=0.25)
        cover = paint(empty(30, tube), QUIET).cover_zyx
        area = cover[8:-8].sum(axis=(1, 2)) / 255.0 * VOXEL**2
        np.testing.assert_allclose(area, math.pi * radius**2, rtol=0.03)


def test_equal_seeds_give_equal_hard_cases_and_different_seeds_different_ones():
    one, again, other = grown(5), grown(5), grown(6)
    assert len(one) == len(again)
    assert all(np.array_equal(a.points, b.points) for a, b in zip(one, again, strict=True))
    assert len(one) != len(other) or not np.array_equal(one[0].points, other[0].points)
    thin = scanned(empty(40, a_tip()), OPTIONS, lambda _step: None)
    volumes = [imaged(thin, replace(OPTIONS, seed=seed), Slices(1.5))[0].hu_zyx for seed in (1, 1, 2)]
    assert np.array_equal(volumes[0], volumes[1]) and not np.array_equal(volumes[0], volumes[2])


def test_painted_volume_is_stored_and_read_again(tmp_path):
    calls = []

    def paint_thin() -> Scanned:
        calls.append(1)
        return scanned(empty(30, a_tip()), OPTIONS, lambda _step: None)

    first, second = (cached("key", paint_thin, tmp_path) for _ in range(2))
    assert len(calls) == 1
    np.testing.assert_array_equal(first.values_zyx, second.values_zyx)
    exact = paint_thin()
    assert np.abs(first.values_zyx - exact.values_zyx).max() <= 1 / 32 + 1e-3
    np.testing.assert_array_equal(first.airways[0].points, exact.airways[0].points)
    np.testing.assert_array_equal(first.lps_from_ijk, exact.lps_from_ijk)


def test_positions_in_thick_slices_match_the_ground_truth():
    tip = a_tip(2.0)
    points = np.array([[3.0, 12.0, 8.0], [30.0, 12.0, 16.0]])
    thin = scanned(empty(60, replace(tip, points=points, radius_mm=np.full(2, 2.0))), OPTIONS, lambda _step: None)
    for slices in (Slices(0.7), Slices(2.0), Slices(3.0, 2.0), Slices(2.0, is_resampled=True)):
        volume, truth, clean = imaged(thin, OPTIONS, slices)
        i, j, k = np.rint(volume.to_ijk(truth.branches[0].points[20:-20])).astype(int).T
        assert np.median(clean[k, j, i]) < -900.0
        assert truth.lumen_zyx[k, j, i].mean() > 0.9


def test_detection_rate_is_computed_by_class_of_radius():
    size = 40
    hu = np.zeros((size,) * 3, np.int16)
    thin = Scanned(hu.astype(np.float32), np.diag([VOXEL, VOXEL, VOXEL, 1.0]), (), hu.astype(np.uint8))
    volume = imaged(thin, QUIET, Slices(VOXEL))[0]
    lines = [np.stack([np.linspace(2.0, 20.0, 73), np.full(73, y), np.full(73, y)], axis=1) for y in (6.0, 16.0)]
    branches = tuple(TrueBranch(p, np.full(73, r), 3) for p, r in zip(lines, (0.5, 0.9), strict=True))
    found = np.zeros((size,) * 3, np.bool_)
    found[10, 10, :] = True
    i, j, k = np.rint(lines[1][:37] / VOXEL).astype(int).T
    found[k, j, i] = True
    done = track_hard.detected_airways(volume, Truth(found, branches, knows_radius=True), found)
    assert done.by_radius_mm["0.45-0.6"] == 1.0
    assert done.by_radius_mm["0.8-1"] == pytest.approx(0.5, abs=0.05)
    assert done.td == pytest.approx(0.75, abs=0.03) and done.bd == 0.5
    assert len(done.missed[0].points) == 0 and done.missed[1].points[:, 0].min() > 10.0


def test_precision_counts_a_voxel_adjacent_to_the_lumen_as_correct():
    touched = np.zeros((7, 7, 7), np.bool_)
    touched[3, 3, 3] = True
    found = touched.copy()
    found[2, 2, 2] = True  # adjacent to the lumen by a corner
    assert track_hard.within_a_voxel(found, touched) == 1.0
    found[1, 3, 3] = True
    assert track_hard.within_a_voxel(found, touched) == pytest.approx(2 / 3)


def test_every_case_name_of_the_hard_part_has_parameters_for_painting():
    assert track.PARTS["hard"].cases == track_hard.CASES


def test_hard_part_of_the_track_benchmark_runs_only_if_the_only_option_names_it(carina, monkeypatch, tmp_path):
    monkeypatch.setattr(track, "built_parts", lambda: ["speed", "hard"])
    monkeypatch.setattr(track, "run_section", lambda _function, request, threads: [])
    all_parts = carina("bench", "track", "--json", "-o", tmp_path / "all").json()["parts"]
    assert "speed" in all_parts and "hard" not in all_parts
    named = carina("bench", "track", "--only", "hard", "--case", "medium", "--json", "-o", tmp_path / "hard")
    assert list(named.json()["parts"]) == ["hard"]


def test_benchmark_report_compares_means_over_patients_with_the_targets():
    rows = [
        {"condition": "medium 0.7mm", "td": td, "bd": 0.96, "precision": 0.99, "false_branches": num}
        for td, num in ((0.99, 0), (0.95, 4))
    ]
    means = {row["what"]: row for row in track_hard._means(rows)}
    assert means["TD, mean"]["figure"] == pytest.approx(0.97) and not track.gate_of(means["TD, mean"]).passed
    assert track.gate_of(means["BD, mean"]).passed
    assert means["false branches, most"]["figure"] == 4 and not track.gate_of(means["false branches, most"]).passed
