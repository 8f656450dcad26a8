"""Tests of the choice of renderers (lanes) with a fake clock: a renderer that slows frames down is not used."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carina.cluster import renderer_selection
from carina.cluster.renderer_selection import LaneChoice
from carina.cluster.scheduler import StripScheduler
from carina.cluster.settings import ClusterSettings
from carina_bench.cluster_simulation import SimulatedCluster, SimulatedRenderer

SIDE = 512
ROW_LINK_S = 3 * SIDE / 125e6
"""Time of a row on a link of 1 Gbit/s, s."""


class FakeFlight:
    """Flight on a fake clock: a frame takes ``interval_s(lanes, open frames)`` and ``work_s(lanes)``."""

    def __init__(
        self,
        num: int,
        interval_s: Callable[[tuple[int, ...], int], float],
        work_s: Callable[[tuple[int, ...]], float],
        *,
        max_open_frames: int = 3,
    ) -> None:
        self.choice = LaneChoice(max_open_frames)
        self.able = list(range(num))
        self.interval_s = interval_s
        self.work_s = work_s
        self.seconds: dict[int, float] = {}
        self.now_s = 0.0
        self.used: list[int] = []
        """Number of lanes that rendered strips of each frame."""

    def fly(self, frames: int = 400) -> FakeFlight:
        for _ in range(frames):
            lanes = self.choice.choose(self.able, self.seconds, self.now_s)
            number = self.choice.number
            interval_s = self.interval_s(lanes, self.choice.open_frames)
            self.now_s += interval_s
            self.choice.record_frame(number, interval_s, self.work_s(lanes), self.now_s)
            self.used.append(len(lanes))
        return self

    @property
    def usual(self) -> int:
        """Most frequent number of lanes among the last 100 frames."""
        return Counter(self.used[-100:]).most_common(1)[0][0]


def _network(work_s: float, fixed_s: float, answer_s: float) -> Callable[[tuple[int, ...], int], float]:
    """Return the time of a frame whose rendering is divided and whose answers the console reads one by one."""
    return lambda lanes, _: max(work_s / len(lanes), fixed_s + answer_s * len(lanes))


@pytest.mark.parametrize(("num", "expected"), [(1, 1), (2, 2), (4, 2), (8, 2), (16, 2)])
def test_lanes_that_make_fast_frames_slower_are_not_used(num, expected):
    flight = FakeFlight(num, _network(0.0141, 0.0063, 0.001), lambda _: 0.0141).fly()
    assert flight.usual == expected


def test_all_lanes_are_used_if_the_rendering_takes_most_of_the_time():
    flight = FakeFlight(16, _network(0.6, 0.0063, 0.001), lambda _: 0.6).fly(1000)
    # One lane less is tried for a few frames, because lanes that share a processor are always busy.
    assert flight.used.count(16) > 0.95 * len(flight.used) and set(flight.used) == {15, 16}


@settings(max_examples=60, deadline=None)
@given(
    st.integers(1, 16), st.floats(0.001, 1.0), st.floats(0.0, 0.02), st.floats(0.0, 0.02), st.sampled_from([max, sum])
)
def test_chosen_number_of_lanes_is_nearly_the_fastest_for_any_costs(num, work_s, fixed_s, answer_s, combine):
    def interval_s(count: int) -> float:
        return combine((work_s / count, fixed_s + answer_s * count))

    flight = FakeFlight(num, lambda lanes, _: interval_s(len(lanes)), lambda _: work_s).fly(800)
    best_s = min(interval_s(count) for count in range(1, num + 1))
    # Each step to more lanes must save 5 %, and a step to fewer lanes may cost 1 %.
    assert interval_s(flight.usual) <= 1.12 * best_s
    assert interval_s(flight.usual) <= 1.02 * interval_s(1)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(st.sampled_from(["frame", "old", "join", "leave"]), st.integers(0, 5), st.floats(1e-4, 2.0)),
        max_size=200,
    ),
    st.integers(1, 4),
)
def test_chosen_lanes_are_always_able_and_their_number_is_valid(events, max_open):
    choice = LaneChoice(max_open)
    able, now_s, number = [0], 0.0, 0
    for what, lane, seconds in events:
        now_s += seconds
        if what == "join" and lane not in able:
            able.append(lane)
        elif what == "leave" and len(able) > 1 and lane in able:
            able.remove(lane)
        elif what == "old":
            choice.record_frame(number - 1, seconds, seconds, now_s)
        lanes = choice.choose(able, {lane: seconds}, now_s)
        assert set(lanes) <= set(able) and len(set(lanes)) == len(lanes) >= 1
        assert list(lanes) == [name for name in able if name in lanes]
        assert 1 <= choice.open_frames <= max_open
        number = choice.number
        choice.record_frame(number, seconds, seconds * (1 + lane), now_s)


def test_noise_of_five_percent_does_not_change_the_number_of_lanes_again_and_again():
    noise = iter([1.0 + 0.05 * ((n * 7919) % 21 - 10) / 10 for n in range(4000)])
    flight = FakeFlight(8, lambda lanes, _: next(noise) * (0.010 + 0.0005 * len(lanes)), lambda _: 0.004).fly(3000)
    last = flight.used[500:]
    # A trial needs two changes; accepted changes would add more.
    assert sum(a != b for a, b in itertools.pairwise(last)) <= 12
    assert flight.usual == 1


def test_unused_lane_is_tried_again_after_growing_times():
    flight = FakeFlight(2, _network(0.004, 0.004, 0.004), lambda _: 0.004)
    began = []
    for _ in range(8000):
        flight.fly(1)
        if flight.used[-1] == 2 and (len(flight.used) < 2 or flight.used[-2] == 1):
            began.append(flight.now_s)
    gaps = [b - a for a, b in itertools.pairwise(began[1:])]
    assert len(gaps) >= 2
    assert all(later > 1.5 * earlier for earlier, later in itertools.pairwise(gaps))
    assert flight.used.count(2) < 0.03 * len(flight.used)


def test_unused_lanes_are_used_soon_after_frames_have_become_slower():
    flight = FakeFlight(8, _network(0.0141, 0.0063, 0.001), lambda _: 0.0141).fly(600)
    assert flight.usual == 2
    flight.interval_s, flight.work_s = _network(0.3, 0.0063, 0.001), lambda _: 0.3
    flight.fly(150)
    assert flight.used[-1] == 8


def test_lane_that_joins_is_tried_at_once_and_dropped_if_it_does_not_pay():
    flight = FakeFlight(2, _network(0.0141, 0.0063, 0.001), lambda _: 0.0141).fly(100)
    flight.able.append(2)
    flight.fly(1)
    assert flight.used[-1] == 3
    flight.fly(100)
    assert flight.usual == 2
    assert flight.used[-100:].count(3) <= renderer_selection.SETTLING_FRAMES + renderer_selection.MEASURED_FRAMES


def test_lane_that_leaves_is_replaced_by_an_unused_lane():
    flight = FakeFlight(4, _network(0.0141, 0.0063, 0.001), lambda _: 0.0141).fly(200)
    lost, other = flight.choice.used
    flight.able.remove(lost)
    lanes = flight.choice.choose(flight.able, flight.seconds, flight.now_s)
    assert other in lanes and lost not in lanes and len(lanes) == 2


def test_lane_with_a_slow_link_is_not_used():
    def interval_s(lanes: tuple[int, ...], _: int) -> float:
        return max(0.02 / len(lanes), 0.1 if 3 in lanes else 0.0)

    flight = FakeFlight(4, interval_s, lambda _: 0.02)
    flight.seconds = {0: 0.02, 1: 0.02, 2: 0.02, 3: 0.12}
    flight.fly(300)
    assert set(flight.choice.used) == {0, 1, 2}


def test_lanes_that_share_a_processor_are_reduced_to_one_although_all_are_busy():
    # Two lanes on one core: each renders half of the frame in the time of the whole, so both are always busy.
    flight = FakeFlight(2, lambda _, __: 0.02, lambda lanes: 0.02 * len(lanes)).fly(8000)
    assert flight.usual == 1
    first = flight.used.index(1)
    assert sum([0.02] * first) == pytest.approx(renderer_selection.FULLY_BUSY_S, abs=1.0)


def test_trial_of_too_few_lanes_ends_after_three_frames():
    # All lanes are busy, so one lane is tried after 10 s and then after growing times from a minute on.
    flight = FakeFlight(2, lambda lanes, _: 0.6 / len(lanes), lambda _: 0.6).fly(600)
    assert 0 < flight.used.count(1) <= 3 * (renderer_selection.ABORT_FRAMES + 1)


@pytest.mark.parametrize(
    ("loss", "expected"), [((1.30, 1.0, 1.0), 2), ((1.03, 1.0, 1.0), 1), ((1.5, 1.2, 1.0), 3), ((1.0, 1.0, 1.0), 1)]
)
def test_slow_frames_have_as_few_open_frames_as_the_frame_rate_allows(loss, expected):
    flight = FakeFlight(4, lambda lanes, frames: 0.6 / len(lanes) * loss[frames - 1], lambda _: 0.6).fly(400)
    assert flight.choice.open_frames == expected


def test_fast_frames_use_all_buffers_and_a_single_slow_lane_one():
    assert FakeFlight(4, _network(0.02, 0.002, 0.0005), lambda _: 0.02).fly(50).choice.open_frames == 3
    assert FakeFlight(1, _network(0.06, 0.002, 0.0005), lambda _: 0.06).fly(5).choice.open_frames == 1


def _simulated(frame_s: float, speeds: tuple[float, ...], **changes) -> tuple[float, float]:
    """Return the frame rate and the median response time of a simulated network of 1 Gbit/s."""
    renderers = [SimulatedRenderer(frame_s / SIDE / speed, 0.0012, 0.0003) for speed in speeds]
    cluster = SimulatedCluster(
        renderers,
        ClusterSettings(open_frames=3, **changes),
        console_seconds=0.001,
        console_row_seconds=ROW_LINK_S,
        row_cost=lambda row: 1.5 if row < SIDE / 2 else 0.5,
    )
    result = cluster.run(200, SIDE, settle=200)
    return result.fps, sorted(result.response_s)[100]


@pytest.mark.parametrize("frame_s", [0.0141, 0.02, 0.06, 0.588])
def test_simulated_cluster_is_never_slower_than_one_lane_and_never_faster_than_its_machines(frame_s):
    alone, _ = _simulated(frame_s, (1.0,))
    for num in (1, 2, 4, 8, 16):
        fps, _ = _simulated(frame_s, (1.0,) * num)
        assert alone <= 1.001 * fps
        assert fps <= num / frame_s


def test_simulated_scheduler_without_the_choice_of_lanes_is_slower_than_one_lane():
    all_lanes, _ = _simulated(0.0141, (1.0,) * 16, chooses_lanes=False)
    assert all_lanes < 0.7 * _simulated(0.0141, (1.0,))[0]


@pytest.mark.parametrize(("num", "paper_s", "speedup"), [(2, 0.453, 1.88), (4, 0.407, 2.73), (8, 0.313, 7.5)])
def test_simulated_response_time_at_the_frame_time_of_the_paper_is_not_longer_than_in_the_paper(num, paper_s, speedup):
    fps, response_s = _simulated(0.588, (1.0,) * num)
    assert response_s <= paper_s
    assert fps * 0.588 >= speedup


def test_scheduler_reports_the_share_zero_for_an_unused_lane():
    scheduler = StripScheduler(ClusterSettings(open_frames=1))
    for lane in "abcd":
        scheduler.join(lane, 0.0)
    now_s = 0.0
    for frame_id in range(200):
        scheduler.request(frame_id, 100, now_s)
        # Each answer takes the console 5 ms, and the rows take almost no time.
        while scheduler.num_open:
            tasks = [action for action in scheduler.take_actions() if hasattr(action, "task_id")]
            for task in tasks:
                now_s += 0.005
                scheduler.answered(task.lane, task.task_id, 0.00001 * (task.end_row - task.first_row), now_s)
    shares = sorted(view.share for view in scheduler.lanes())
    assert shares == [0.0, 0.0, 0.0, 1.0]
