"""Choices of the fastest way to cast over equal values, with given costs in place of measured times."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from carina.render import AirwayView, Renderer, TransferFunction
from carina.render.leap_choice import (
    MAX_VIEWS,
    MIN_GAIN,
    MORE_ROUNDS,
    PICTURES_BETWEEN,
    PREFETCH_RETRY,
    PREFETCH_TRIALS,
    ROUNDS,
    STRIPS,
    LeapChoice,
    PrefetchChoice,
    is_faster,
)
from carina.render.scene import ValueMaps
from carina.scopes import DepthOfField, Pose
from carina.volume import Volume

DIAGONAL_MM = 200.0


class Costs:
    """Costs of strips that do not depend on time, and the number of strips that were measured."""

    def __init__(self, leap, brute):
        self.leap, self.brute, self.calls = leap, brute, 0

    def __call__(self, rows, leaps):
        assert 0 <= rows[0] < rows[1]
        self.calls += 1
        return self.leap(rows) if leaps else self.brute(rows)


def constant(leap, brute):
    return Costs(lambda _rows: leap, lambda _rows: brute)


@pytest.fixture
def scene():
    ramp = TransferFunction(points=np.array([[0.0, 0, 0, 0, 0.0], [255.0, 1, 1, 1, 0.9]]), unit="raw")
    return ValueMaps(words=np.zeros((2, 2, 2), np.uint16), label_values=[0]), ramp


def view_at(x_mm=0.0, direction=(0.0, 0.0, 1.0), size=64):
    return AirwayView(Pose.looking((x_mm, 0.0, 0.0), direction), width=size, height=size)


@pytest.mark.parametrize("leap", [0.5, 0.999 - MIN_GAIN, 1.001 - MIN_GAIN, 1.0, 2.0])
def test_leaps_are_chosen_if_they_save_the_least_gain(scene, leap):
    choice = LeapChoice().leaps(scene, view_at(), constant(leap, 1.0), diagonal_mm=DIAGONAL_MM)
    assert choice is (leap < 1.0 - MIN_GAIN)


def test_costs_are_summed_over_strips_of_the_whole_picture():
    def leap(rows):
        return 10.0 if rows[0] < 30 else 1.0

    assert is_faster(120, Costs(leap, lambda _rows: 6.0))
    assert not is_faster(120, Costs(leap, lambda _rows: 3.0))


def test_interrupted_measurement_of_a_strip_does_not_change_the_choice():
    spikes = iter([100.0] + [1.0] * 99)
    assert is_faster(64, Costs(lambda _rows: next(spikes), lambda _rows: 2.0))


def test_close_costs_are_measured_in_further_rounds():
    disturbed = itertools.chain([1.2] * (ROUNDS * STRIPS), itertools.repeat(1.0))
    costs = Costs(lambda _rows: next(disturbed), lambda _rows: 1.15)
    assert is_faster(64, costs)
    assert costs.calls == 2 * (ROUNDS + MORE_ROUNDS) * STRIPS
    clear = constant(1.0, 1.3)
    assert is_faster(64, clear)
    assert clear.calls == 2 * ROUNDS * STRIPS


def test_one_view_is_measured_once_and_its_choice_stays(scene):
    choice, costs = LeapChoice(), constant(1.0, 2.0)
    assert choice.leaps(scene, view_at(), costs, diagonal_mm=DIAGONAL_MM)
    calls = costs.calls
    assert calls == 2 * ROUNDS * STRIPS
    later = constant(2.0, 1.0)
    for _ in range(3 * PICTURES_BETWEEN):
        assert choice.leaps(scene, view_at(), later, diagonal_mm=DIAGONAL_MM)
    assert later.calls == 0


def test_views_near_the_measured_one_are_measured_again_only_after_some_pictures(scene):
    choice = LeapChoice()
    choice.leaps(scene, view_at(), constant(1.0, 2.0), diagonal_mm=DIAGONAL_MM)
    later = constant(2.0, 1.0)
    chosen = [
        choice.leaps(scene, view_at(0.1 * n), later, diagonal_mm=DIAGONAL_MM) for n in range(1, PICTURES_BETWEEN + 2)
    ]
    assert chosen == [True] * PICTURES_BETWEEN + [False]


@pytest.mark.parametrize("view", [view_at(0.2 * DIAGONAL_MM), view_at(direction=(1.0, 0.0, 0.5))])
def test_camera_that_has_moved_or_turned_far_is_measured_again(scene, view):
    choice = LeapChoice()
    assert choice.leaps(scene, view_at(), constant(1.0, 2.0), diagonal_mm=DIAGONAL_MM)
    assert not choice.leaps(scene, view, constant(2.0, 1.0), diagonal_mm=DIAGONAL_MM)


def test_another_transfer_function_or_map_is_measured_again(scene):
    choice = LeapChoice()
    maps, transfer = scene
    assert choice.leaps(scene, view_at(), constant(1.0, 2.0), diagonal_mm=DIAGONAL_MM)
    for other in ((maps, dataclasses.replace(transfer)), (dataclasses.replace(maps), transfer)):
        assert not choice.leaps(other, view_at(), constant(2.0, 1.0), diagonal_mm=DIAGONAL_MM)


def test_small_picture_is_not_measured(scene):
    costs = constant(1.0, 2.0)
    assert LeapChoice().leaps(scene, view_at(size=48), costs, diagonal_mm=DIAGONAL_MM) is None
    assert costs.calls == 0


def test_number_of_stored_choices_is_limited(scene):
    choice = LeapChoice()
    for n in range(2 * MAX_VIEWS):
        choice.leaps(scene, view_at(100.0 * n), constant(1.0, 2.0), diagonal_mm=DIAGONAL_MM)
    assert len(choice._chosen) == MAX_VIEWS


@pytest.fixture
def paper_renderer(airway):
    values = np.clip((airway.volume.hu_zyx.astype(np.int32) + 1000) // 5, 0, 255).astype(np.int16)
    # Noise in the lumen would leave no equal neighbours to leap over.
    values[values < 60] = 5
    ramp = TransferFunction(
        points=np.array([[0.0, 0, 0, 0, 0.0], [20.0, 0, 0, 0, 0.0], [255.0, 1, 1, 1, 0.9]]),
        sampling="nearest",
        unit="raw",
    )
    renderer = Renderer(Volume(values, airway.volume.lps_from_ijk), transfer=ramp)
    renderer.prepare()
    return renderer


@pytest.mark.parametrize("leaps", [True, False])
def test_automatic_picture_is_that_of_the_chosen_method_also_in_strips(airway, paper_renderer, monkeypatch, leaps):
    monkeypatch.setattr("carina.render.leap_choice.is_faster", lambda _height, _cost: leaps)
    automatic = AirwayView(airway.pose, width=96, height=64)
    forced = dataclasses.replace(automatic, method="leap-always" if leaps else "brute")
    expected = paper_renderer.render(forced)
    whole = paper_renderer.render(automatic)
    np.testing.assert_array_equal(whole.rgb, expected.rgb)
    assert whole.stats.num_leaps == expected.stats.num_leaps
    assert (whole.stats.num_leaps > 0) is leaps
    strips = [paper_renderer.render(automatic, rows=rows).rgb for rows in ((0, 10), (10, 64))]
    np.testing.assert_array_equal(np.concatenate(strips), expected.rgb)
    assert paper_renderer.with_chosen_method(automatic).method == forced.method


def test_pictures_with_and_without_prefetching_are_equal(airway, paper_renderer, monkeypatch):
    view = AirwayView(airway.pose, width=96, height=64, method="leap-always")
    choices = iter([False, True])
    monkeypatch.setattr(PrefetchChoice, "prefetches", lambda *_args, **_named: next(choices))
    without, with_prefetching = paper_renderer.render(view), paper_renderer.render(view)
    np.testing.assert_array_equal(with_prefetching.rgb, without.rgb)
    assert with_prefetching.stats.num_leaps == without.stats.num_leaps > 0
    assert with_prefetching.stats.num_samples == without.stats.num_samples
    assert next(choices, None) is None


def test_automatic_leaping_and_brute_pictures_differ_by_at_most_one_level(airway, paper_renderer):
    pictures = [
        paper_renderer.render(AirwayView(airway.pose, width=96, height=64, method=method)).rgb.astype(int)
        for method in ("leap", "leap-always", "brute")
    ]
    for picture in pictures[:2]:
        off = np.abs(picture - pictures[2])
        assert off.max() <= 1
        # One pixel in ten thousand may differ; a picture of 6144 pixels has at most one such pixel on average.
        assert np.count_nonzero(off.any(axis=-1)) <= 3


def test_picture_with_depth_of_field_is_that_of_a_method(airway, paper_renderer):
    blurred = AirwayView(airway.pose, width=96, height=64, depth_of_field=DepthOfField(near_mm=3.0, far_mm=50.0))
    automatic = paper_renderer.render(blurred)
    methods = [dataclasses.replace(blurred, method=method) for method in ("leap-always", "brute")]
    assert any(np.array_equal(automatic.rgb, paper_renderer.render(view).rgb) for view in methods)


def prefetched_pictures(choice, maps, costs, num, pose=None):
    """Return for each picture whether it prefetches; ``costs`` are those without and with prefetching."""
    ways = []
    for _ in range(num):
        way = choice.prefetches(maps, view_at().pose if pose is None else pose, diagonal_mm=DIAGONAL_MM)
        choice.add(maps, prefetched=way, cost=costs[way])
        ways.append(way)
    return ways


@pytest.mark.parametrize("with_prefetching", [0.5, 0.999 - MIN_GAIN, 1.001 - MIN_GAIN, 1.0, 2.0])
def test_leaps_prefetch_if_the_first_pictures_were_faster_with_it(scene, with_prefetching):
    ways = prefetched_pictures(PrefetchChoice(), scene[0], (1.0, with_prefetching), PREFETCH_RETRY)
    assert ways[:PREFETCH_TRIALS] == [False, True] * (PREFETCH_TRIALS // 2)
    assert set(ways[PREFETCH_TRIALS:]) == {with_prefetching < 1.0 - MIN_GAIN}


def test_the_other_way_is_tried_again_and_taken_once_it_is_faster(scene):
    choice = PrefetchChoice()
    prefetched_pictures(choice, scene[0], (1.0, 0.5), PREFETCH_RETRY)
    ways = prefetched_pictures(choice, scene[0], (0.2, 0.5), PREFETCH_RETRY)
    assert not any(ways)
    ways = prefetched_pictures(choice, scene[0], (0.2, 0.1), PREFETCH_RETRY)
    assert all(ways)


def test_far_views_and_other_maps_are_measured_again(scene):
    choice, maps = PrefetchChoice(), scene[0]
    prefetched_pictures(choice, maps, (1.0, 0.5), PREFETCH_TRIALS + 1)
    near = view_at(0.05 * DIAGONAL_MM).pose
    assert prefetched_pictures(choice, maps, (1.0, 0.5), 1, near) == [True]
    far = view_at(0.5 * DIAGONAL_MM).pose
    trials = [False, True] * (PREFETCH_TRIALS // 2)
    assert prefetched_pictures(choice, maps, (1.0, 2.0), PREFETCH_TRIALS + 1, far) == [*trials, False]
    other = dataclasses.replace(maps)
    assert prefetched_pictures(choice, other, (1.0, 0.5), PREFETCH_TRIALS + 1, far) == [*trials, True]


def test_late_time_of_former_maps_is_ignored(scene):
    choice, maps = PrefetchChoice(), scene[0]
    prefetched_pictures(choice, maps, (1.0, 0.5), PREFETCH_TRIALS)
    choice.add(dataclasses.replace(maps), prefetched=True, cost=9.0)
    assert prefetched_pictures(choice, maps, (1.0, 0.5), 1) == [True]
