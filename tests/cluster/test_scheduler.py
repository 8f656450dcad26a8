"""Tests of the strip scheduler on simulated clocks: shares, deadlines, buffers and membership."""

from __future__ import annotations

import itertools
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from carina.cluster.scheduler import FrameDone, FrameDropped, Issue, LaneBack, LaneLate, StripScheduler
from carina.cluster.settings import ClusterSettings
from carina.cluster.shares import Shares
from carina.cluster.strips import cut_rows
from carina.errors import UsageError
from carina_bench.cluster_simulation import SimulatedCluster, SimulatedRenderer

ROW_S = 0.005 / 128


@given(
    st.integers(1, 700),
    st.lists(st.floats(0.0, 50.0), min_size=1, max_size=20),
    st.integers(1, 40),
    st.one_of(st.none(), st.integers(1, 90)),
)
def test_each_row_of_a_frame_is_in_exactly_one_strip(num_rows, shares, min_rows, max_rows):
    pieces = cut_rows(num_rows, dict(enumerate(shares)), min_rows=min_rows, max_rows=max_rows)
    ends = [0] + [end for _, _, end in pieces]
    assert [first for _, first, _ in pieces] == ends[:-1]
    assert ends[-1] == num_rows
    heights = Counter()
    for lane, first, end in pieces:
        assert end > first
        assert max_rows is None or end - first <= max_rows
        heights[lane] += end - first
    assert min(heights.values()) >= min(min_rows, num_rows)


def test_strip_heights_are_proportional_to_the_shares_of_the_lanes():
    pieces = cut_rows(512, {"a": 0.3, "b": 0.1, "c": 0.6}, min_rows=4)
    assert [(lane, end - first) for lane, first, end in pieces] == [("a", 154), ("b", 51), ("c", 307)]


def test_layout_without_a_lane_or_without_a_row_is_refused():
    with pytest.raises(UsageError, match="0 renderers"):
        cut_rows(5, {}, min_rows=1)
    with pytest.raises(UsageError, match="0 image rows"):
        cut_rows(0, {"a": 1.0}, min_rows=1)


def _settled(power: float, num: int = 400) -> list[float]:
    """Return the shares after many updates, in which the reported time is the cost times height ** ``power``."""
    shares = Shares(ClusterSettings())
    cost = {0: 3.0, 1: 1.0, 2: 1.0, 3: 1.0}
    for lane in cost:
        shares.join(lane)
    for _ in range(num):
        shares.update({lane: cost[lane] * p**power for lane, p in shares.all.items()})
    return [shares.all[lane] for lane in cost]


def test_shares_computed_from_time_per_row_converge_to_the_true_ones_and_from_time_per_strip_do_not():
    assert _settled(0.0)[0] == pytest.approx(0.1, abs=1e-6)
    # With the times of whole strips, as in the paper's formula, the slow lane settles at 1/sqrt(3) beside three lanes
    # of 1.
    assert _settled(1.0)[0] == pytest.approx(0.5774 / 3.5774, abs=1e-3)


@given(st.lists(st.tuples(st.sampled_from(["join", "leave", "epoch"]), st.integers(0, 5), st.floats(0.01, 99.0))))
def test_shares_sum_to_one_after_any_events(events):
    shares = Shares(ClusterSettings())
    for what, lane, seconds in events:
        if what == "join":
            shares.join(lane)
        elif what == "leave":
            shares.leave(lane)
        else:
            shares.update({n: seconds * (n + 1) for n in range(lane + 1)})
        assert not shares.all or sum(shares.all.values()) == pytest.approx(1.0)
        assert all(p > 0.0 for p in shares.all.values())


FLIGHT = ClusterSettings(in_flight=2, open_frames=3)


def test_slow_renderer_of_four_gets_its_true_share_and_the_frame_rate_is_near_ideal():
    slow = SimulatedRenderer(3 * ROW_S)
    renderers = [SimulatedRenderer(ROW_S)] * 3 + [slow]
    result = SimulatedCluster(renderers, FLIGHT).run(370, 512, settle=30)
    for lane, share in {0: 0.3, 1: 0.3, 2: 0.3, 3: 0.1}.items():
        assert result.shares[0][lane] == pytest.approx(share, abs=0.03)
    # In the ideal case four renderers of the speeds 1, 1, 1 and 1/3 share all rows.
    ideal = 1.0 / (512 * ROW_S / (3 + 1 / 3))
    assert result.fps >= 0.85 * ideal


def test_four_equal_renderers_reach_nine_tenths_of_the_ideal_frame_rate():
    result = SimulatedCluster([SimulatedRenderer(ROW_S)] * 4, FLIGHT).run(370, 512, settle=30)
    assert result.fps >= 0.9 / 0.005


def test_pre_assigned_strips_and_buffers_each_increase_the_frame_rate():
    def fps(**settings):
        return (
            SimulatedCluster([SimulatedRenderer(ROW_S)] * 4, ClusterSettings(**settings)).run(180, 512, settle=20).fps
        )

    plain, buffers, both = fps(in_flight=1, open_frames=1), fps(in_flight=1, open_frames=2), fps()
    assert plain < buffers < both
    assert both > 1.15 * plain


@pytest.mark.parametrize(("frame_s", "most_open"), [(0.588, 1), (0.06, 1), (0.02, 3)])
def test_only_one_long_frame_at_a_time_is_issued_to_a_single_lane(frame_s, most_open):
    settings = ClusterSettings(open_frames=3)
    alone = SimulatedCluster([SimulatedRenderer(frame_s / 512)], settings).run(55, 512, settle=5)
    # The time is that of the frame plus transport. Short frames are pipelined, because transport is a large part of
    # them.
    assert alone.response_s[-1] == pytest.approx(most_open * frame_s, abs=0.01 * (1 + frame_s))
    assert alone.fps > (0.85 if most_open == 1 else 0.98) / frame_s
    # Two lanes share the work and use the buffers.
    both = SimulatedCluster([SimulatedRenderer(frame_s / 512)] * 2, settings).run(55, 512, settle=5)
    assert both.fps > 1.9 / frame_s


def test_slow_renderer_limits_the_frame_rate_without_load_balancing():
    renderers = [SimulatedRenderer(ROW_S)] * 3 + [SimulatedRenderer(3 * ROW_S)]
    without = SimulatedCluster(renderers, ClusterSettings(balances=False, chooses_lanes=False)).run(70, 512, settle=30)
    assert without.shares[-1] == dict.fromkeys(range(4), 0.25)
    assert without.fps < 0.6 * SimulatedCluster(renderers).run(70, 512, settle=30).fps


def test_renderer_that_becomes_ten_times_slower_gets_a_smaller_share():
    """Let its replies arrive long after other lanes have completed the frame; they must still update its share."""
    fixture = _flying("a", "b", "c", "d", settings=ClusterSettings(open_frames=1), warm=20)
    now_s, due = 1.0, []
    free_s = dict.fromkeys("abcd", 0.0)
    for frame_id in range(40):
        fixture.scheduler.request(frame_id, 512, now_s)
        while FrameDone(frame_id) not in fixture.rest:
            fixture.take_actions()
            for task in [t for t in fixture.issued if all(t is not known for _, known in due)]:
                row_s = 0.0001 * (10 if task.lane == "a" else 1)
                free_s[task.lane] = max(free_s[task.lane], now_s) + row_s * (task.end_row - task.first_row)
                due.append((free_s[task.lane], task))
            due.sort(key=lambda item: item[0])
            deadline_s = fixture.scheduler.deadline_s
            if deadline_s is not None and deadline_s < due[0][0]:
                now_s = deadline_s
                fixture.scheduler.mark_late_lanes(now_s)
                fixture.take_actions()
            else:
                now_s, task = due.pop(0)
                fixture.answer(task, now_s)
    [view] = [view for view in fixture.scheduler.lanes() if view.lane == "a"]
    assert view.share < 0.05  # ideal: 1 / 31


class SchedulerFixture:
    """Scheduler with the lists of its unanswered strips and of its other actions."""

    def __init__(self, settings: ClusterSettings | None = None) -> None:
        self.scheduler = StripScheduler(settings)
        self.issued: list[Issue] = []
        self.rest: list[object] = []

    def take_actions(self):
        new = self.scheduler.take_actions()
        self.issued += [a for a in new if isinstance(a, Issue)]
        self.rest += [a for a in new if not isinstance(a, Issue)]
        return new

    def answer(self, task: Issue, now_s: float, seconds: float = 0.01) -> bool:
        self.issued.remove(task)
        accepted = self.scheduler.answered(task.lane, task.task_id, seconds, now_s)
        self.take_actions()
        return accepted

    def issued_to(self, lane) -> list[Issue]:
        return [task for task in self.issued if task.lane == lane]


def _flying(*lanes, settings=None, warm=3) -> SchedulerFixture:
    """Return a scheduler whose lanes have rendered ``warm`` frames at 10 ms per strip."""
    fixture = SchedulerFixture(settings or ClusterSettings(open_frames=1))
    for lane in lanes:
        fixture.scheduler.join(lane, 0.0)
    for frame_id in range(-warm, 0):
        now_s = frame_id * 0.01
        fixture.scheduler.request(frame_id, 100, now_s)
        fixture.take_actions()
        for task in list(fixture.issued):
            fixture.answer(task, now_s + 0.01)
    fixture.rest.clear()
    return fixture


def test_late_strip_is_issued_to_another_lane_and_the_first_reply_to_it_is_used():
    fixture = _flying("a", "b")
    fixture.scheduler.request(1, 100, 0.0)
    fixture.take_actions()
    [of_a], [of_b] = fixture.issued_to("a"), fixture.issued_to("b")
    assert fixture.answer(of_b, 0.01)
    # Three times the expected 10 ms is less than the minimum deadline of 50 ms.
    assert fixture.scheduler.deadline_s == pytest.approx(0.05)
    fixture.scheduler.mark_late_lanes(0.051)
    fixture.take_actions()
    assert fixture.rest == [LaneLate("a")]
    [again] = fixture.issued_to("b")
    assert (again.first_row, again.end_row, again.again) == (of_a.first_row, of_a.end_row, True)
    assert fixture.answer(again, 0.061)
    assert fixture.rest[-1] == FrameDone(1)
    # The late reply is not used, but it shows that the lane works again.
    assert not fixture.answer(of_a, 0.3, seconds=0.3)
    assert fixture.rest[-1] == LaneBack("a")


def test_reply_deadline_of_a_new_lane_follows_the_rate_of_the_other_lanes():
    fixture = _flying("a", "b", warm=20)
    fixture.scheduler.join("c", 0.0)
    fixture.scheduler.request(1, 99, 0.0)
    fixture.take_actions()
    for name in ("a", "b"):
        fixture.answer(fixture.issued_to(name)[0], 0.01)
    # The other lanes take 7 ms for 33 rows; nine times 7 ms is less than four times the minimum.
    assert fixture.scheduler.deadline_s == pytest.approx(0.2)
    alone = SchedulerFixture(ClusterSettings(open_frames=1))
    alone.scheduler.join("a", 0.0)
    alone.scheduler.request(1, 99, 0.0)
    alone.take_actions()
    assert alone.scheduler.deadline_s == pytest.approx(2.0), "the time of such a picture is unknown"


def test_reply_with_a_strip_is_accepted_only_while_its_rows_are_missing():
    fixture = _flying("a", "b")
    fixture.scheduler.request(1, 100, 0.0)
    fixture.take_actions()
    [of_a], [of_b] = fixture.issued_to("a"), fixture.issued_to("b")
    assert fixture.scheduler.expects("a", of_a.task_id)
    assert not fixture.scheduler.expects("b", of_a.task_id) and not fixture.scheduler.expects("nobody", of_a.task_id)
    fixture.answer(of_b, 0.01)
    fixture.scheduler.mark_late_lanes(0.06)
    fixture.take_actions()
    [again] = fixture.issued_to("b")
    fixture.answer(again, 0.07)
    assert not fixture.scheduler.expects("a", of_a.task_id)


def test_late_lane_gets_no_further_strip_until_it_replies():
    fixture = _flying("a", "b")
    fixture.scheduler.request(1, 100, 0.0)
    fixture.take_actions()
    fixture.answer(fixture.issued_to("b")[0], 0.01)
    fixture.scheduler.mark_late_lanes(0.06)
    fixture.take_actions()
    fixture.answer(fixture.issued_to("b")[0], 0.07)
    fixture.scheduler.request(2, 100, 0.07)
    fixture.take_actions()
    [task] = fixture.issued_to("b")
    assert (task.first_row, task.end_row) == (0, 100)


def test_strip_overdue_on_two_lanes_is_issued_to_a_third():
    fixture = _flying("a", "b", "c")
    fixture.scheduler.request(1, 99, 0.0)
    fixture.take_actions()
    fixture.answer(fixture.issued_to("c")[0], 0.01)
    fixture.scheduler.mark_late_lanes(0.06)
    fixture.take_actions()
    assert [task.lane for task in fixture.issued if task.again] == ["c", "c"]
    for task in fixture.issued_to("c"):
        fixture.answer(task, 0.07)
    assert FrameDone(1) in fixture.rest


def test_console_renders_while_no_lane_is_available_and_stops_when_one_returns():
    fixture = SchedulerFixture(ClusterSettings(open_frames=1))
    fixture.scheduler.join("console", 0.0, reserve=True)
    fixture.scheduler.join("a", 0.0, content=1)
    fixture.scheduler.request(1, 100, 0.0, content=1)
    fixture.take_actions()
    assert [t.lane for t in fixture.issued] == ["a"]
    [lost] = fixture.issued
    fixture.scheduler.failed("a", lost.task_id, 0.1)
    fixture.issued.clear()
    fixture.take_actions()
    assert [t.lane for t in fixture.issued] == ["console"]
    assert fixture.answer(fixture.issued[0], 0.5)
    fixture.scheduler.join("a", 0.6, content=2)
    fixture.scheduler.request(2, 100, 0.7, content=1)  # the lane has loaded another content
    fixture.take_actions()
    assert [t.lane for t in fixture.issued] == ["console"]
    fixture.answer(fixture.issued[0], 0.8)
    fixture.scheduler.load("a", 1, 0.9)
    fixture.scheduler.request(3, 100, 1.0, content=1)
    fixture.take_actions()
    assert [t.lane for t in fixture.issued] == ["a"]


def test_frame_requested_without_an_available_lane_waits_for_a_lane():
    fixture = SchedulerFixture()
    fixture.scheduler.request(1, 100, 0.0)
    assert fixture.take_actions() == []
    fixture.scheduler.join("a", 1.0)
    fixture.take_actions()
    assert [t.lane for t in fixture.issued] == ["a"]


def test_lane_that_joins_during_a_flight_gets_the_mean_share_of_the_next_frame():
    fixture = _flying("a", "b", "c")
    fixture.scheduler.request(1, 120, 0.0)
    fixture.scheduler.join("d", 0.001)
    fixture.take_actions()
    assert not fixture.issued_to("d")
    for task in list(fixture.issued):
        fixture.answer(task, 0.01)
    fixture.scheduler.request(2, 120, 0.02)
    fixture.take_actions()
    [task] = fixture.issued_to("d")
    assert task.end_row - task.first_row == 30


def test_only_the_newest_waiting_frame_of_a_stream_is_rendered():
    fixture = _flying("a", settings=ClusterSettings(in_flight=1, open_frames=1))
    for frame_id in (1, 2, 3):
        fixture.scheduler.request(frame_id, 10, 0.0, stream="airway")
    fixture.take_actions()
    assert fixture.rest == [FrameDropped(2)]
    fixture.answer(fixture.issued[0], 0.01)
    assert fixture.issued[0].frame_id == 3


def test_complete_frame_drops_the_older_frames_of_its_stream():
    fixture = _flying("a", "b", settings=ClusterSettings(open_frames=2))
    fixture.scheduler.request(1, 10, 0.0, stream="airway")
    fixture.scheduler.request(2, 10, 0.0, stream="airway")
    fixture.take_actions()
    for task in [t for t in fixture.issued if t.frame_id == 2]:
        fixture.answer(task, 0.01)
    assert fixture.rest == [FrameDone(2), FrameDropped(1)]
    assert not fixture.answer(fixture.issued[0], 0.02), "no row of a dropped frame is requested"


def test_buffer_of_a_dropped_frame_is_used_by_the_next_frame():
    fixture = _flying("a", settings=ClusterSettings(in_flight=4, open_frames=1))
    fixture.scheduler.request(1, 10, 0.0)
    fixture.scheduler.request(2, 10, 0.0)
    fixture.scheduler.drop(1, 0.0)
    fixture.take_actions()
    assert [t.frame_id for t in fixture.issued] == [1, 2]
    assert fixture.rest == [FrameDropped(1)]


def test_undivided_frames_are_issued_to_one_lane_each_up_to_the_capacity_of_the_lane():
    fixture = _flying("a", "b", settings=ClusterSettings(in_flight=2, open_frames=1))
    for frame_id in range(10):
        fixture.scheduler.request(frame_id, 100, 0.0, whole=True)
    fixture.take_actions()
    assert sorted((t.lane, t.frame_id) for t in fixture.issued) == [("a", 0), ("a", 2), ("b", 1), ("b", 3)]
    assert {(t.first_row, t.end_row) for t in fixture.issued} == {(0, 100)}


def test_frame_that_is_being_rendered_cannot_be_requested_again():
    fixture = _flying("a")
    fixture.scheduler.request(1, 10, 0.0)
    with pytest.raises(UsageError, match="already being rendered"):
        fixture.scheduler.request(1, 10, 0.0)


EVENTS = st.lists(
    st.one_of(
        st.tuples(st.just("want"), st.integers(1, 60), st.sampled_from([None, "s"]), st.booleans()),
        st.tuples(st.sampled_from(["join", "leave", "load", "answer", "fail", "drop"]), st.integers(0, 9)),
        st.tuples(st.just("tick"), st.floats(0.0, 5.0)),
    ),
    max_size=120,
)


@given(EVENTS, st.integers(1, 3), st.integers(1, 3), st.booleans(), st.one_of(st.none(), st.integers(3, 20)))
def test_no_strip_is_missing_or_doubled_in_any_order_of_events(events, in_flight, open_frames, reserve, max_rows):
    settings = ClusterSettings(in_flight=in_flight, open_frames=open_frames)
    scheduler = StripScheduler(settings)
    frame_ids = itertools.count()
    now_s, out, content = 0.0, {}, 0
    wanted, rows_of, complete, dropped = {}, {}, set(), set()

    def check():
        for action in scheduler.take_actions():
            if isinstance(action, Issue):
                assert action.task_id not in out
                out[action.task_id] = action
                assert action.frame_id not in complete | dropped
            elif isinstance(action, FrameDone):
                rows = rows_of[action.frame_id]
                assert rows == Counter(range(wanted[action.frame_id])), "each row exactly once"
                complete.add(action.frame_id)
            elif isinstance(action, FrameDropped):
                dropped.add(action.frame_id)
        for view in scheduler.lanes():
            assert view.num_in_flight <= in_flight
        assert scheduler.num_open + scheduler.num_waiting == len(wanted) - len(complete) - len(dropped)

    def answer(task):
        del out[task.task_id]
        rows = range(task.first_row, task.end_row)
        expects = scheduler.expects(task.lane, task.task_id)
        accepted = scheduler.answered(task.lane, task.task_id, 0.01, now_s)
        assert accepted == expects, "rows are copied before they are counted"
        if accepted:
            rows_of[task.frame_id].update(rows)
        check()

    if reserve:
        scheduler.join("console", 0.0, reserve=True)
    for event in events:
        now_s += 0.005
        match event:
            case ("want", num_rows, stream, whole):
                frame_id = next(frame_ids)
                wanted[frame_id], rows_of[frame_id] = num_rows, Counter()
                scheduler.request(
                    frame_id, num_rows, now_s, content=content, stream=stream, whole=whole, max_rows=max_rows
                )
            case ("join", n):
                scheduler.join(n % 4, now_s, content=content)
            case ("leave", n):
                scheduler.leave(n % 4, now_s)
            case ("load", n):
                content = n % 2
                scheduler.load(n % 4, content, now_s)
            case ("drop", n):
                scheduler.drop(n, now_s)
            case ("tick", seconds):
                now_s += seconds
                scheduler.mark_late_lanes(now_s)
            case ("answer" | "fail", n) if out:
                task = list(out.values())[n % len(out)]
                if event[0] == "answer":
                    answer(task)
                    continue
                del out[task.task_id]
                scheduler.failed(task.lane, task.task_id, now_s)
        check()
    # No lane fails any more and each content has a lane, so every requested frame must become complete.
    for n, shown in enumerate((0, 1)):
        scheduler.join(("rescue", n), now_s, content=shown)
    check()
    for _ in range(2000):
        mine = [task for task in out.values() if isinstance(task.lane, tuple) or task.lane == "console"]
        if mine:
            answer(mine[0])
        elif scheduler.num_open or scheduler.num_waiting:
            now_s += 10.0
            scheduler.mark_late_lanes(now_s)
            check()
        else:
            break
    assert set(wanted) == complete | dropped
