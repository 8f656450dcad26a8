"""The frame pump's judgement, with a renderer, a hand and a client whose time the test moves."""

from __future__ import annotations

import itertools
import math
import random

import pytest

from carina.server.budget import AIRWAY_LEVELS, FINDER_BELOW_PER_S
from carina.server.pacing import FULL, LONG_S, LOST_AFTER_S, STILL_AFTER_S, FrameScheduler
from simulated_stream import AIRWAY, ALL_VIEWS, Machine, Simulation, airway, num_changes, num_coarser, rate_hz

# 5 ms to 250 ms for a full picture, and a factor of 50 between them.
FULL_COSTS_S = (0.005, 0.012, 0.025, 0.06, 0.12, 0.25)


class Player:
    """Plays renderer and client by hand: renders what is ordered, at a cost per ray."""

    def __init__(self, layout, *, cost_s: float = 1e-8, acknowledges: bool = True) -> None:
        self.scheduler = FrameScheduler()
        self.scheduler.set_layout(layout)
        self.now_s = 10.0
        self.cost_s = cost_s
        self.acknowledges = acknowledges
        self.sent = []

    def step(self, keys):
        self.scheduler.observe(keys, self.now_s)
        order = self.scheduler.next_order(self.now_s)
        if order is None:
            return None
        seconds = self.cost_s * order.width * order.height
        self.now_s += seconds
        self.sent.append(order)
        assert self.scheduler.rendered(order, len(self.sent), seconds, self.now_s)
        if self.acknowledges:
            self.scheduler.acknowledge(len(self.sent))
        return order

    def drain(self, keys):
        """Until nothing is wanted now."""
        orders = []
        while (order := self.step(keys)) is not None:
            orders.append(order)
        return orders


# ------------------------------------------------------------ the rate


@pytest.mark.parametrize("layout", [AIRWAY, ALL_VIEWS], ids=["airway alone", "six views"])
@pytest.mark.parametrize("full_s", FULL_COSTS_S)
@pytest.mark.parametrize("hand_hz", [60.0, 1000.0])
@pytest.mark.parametrize("counts", [True, False], ids=["rays counted", "by the clock alone"])
def test_the_asked_rate_is_held_whatever_a_picture_costs(layout, full_s, hand_hz, counts):
    simulation = Simulation(Machine(full_s, counts=counts), layout=dict(layout), hand_per_s=hand_hz)
    simulation.fly(2.0)
    sent = simulation.fly(3.0)
    # Ten per cent, as asked; a hand that moves more often than the rate gets no more than the rate.
    assert rate_hz(sent) == pytest.approx(60.0, rel=0.1)
    assert num_changes(sent) <= 1, "nothing changes, so the level does not either, but for one step finer"
    assert num_coarser(sent) == 0


@pytest.mark.parametrize("rate", [15.0, 30.0, 120.0])
def test_another_rate_is_held_too_and_a_lower_one_gives_finer_pictures(rate):
    at_60 = Simulation(Machine(0.08))
    at_60.fly(2.0)
    simulation = Simulation(Machine(0.08), rate_hz=rate, hand_per_s=240.0)
    simulation.fly(2.0)
    sent = simulation.fly(2.0)
    assert rate_hz(sent) == pytest.approx(rate, rel=0.1)
    level, level_at_60 = sent[-1][1].level, at_60.sent[-1][1].level
    assert level < level_at_60 if rate < 60.0 else level > level_at_60


@pytest.mark.parametrize("full_s", FULL_COSTS_S)
@pytest.mark.parametrize("samples", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("counts", [True, False], ids=["rays counted", "by the clock alone"])
def test_the_picture_is_as_fine_as_the_time_allows(full_s, samples, counts):
    simulation = Simulation(Machine(full_s, samples=samples, counts=counts))
    simulation.fly(6.0)
    time_s, order = simulation.sent[-1]
    took_s = simulation.machine.seconds(order, time_s)
    assert took_s < 1.05 / 60.0
    # One level finer would not have fitted: a level costs 0.82 to 0.86 of the one before, and 0.85 of the period is
    # asked for. What the model's prior is off by takes a little more of it.
    assert order.level == 0 or took_s > 0.66 / 60.0


def test_resolution_gives_way_before_the_step_does():
    areas = [level.scale for level in AIRWAY_LEVELS]
    steps = [level.step_vox for level in AIRWAY_LEVELS]
    assert areas == sorted(areas, reverse=True)
    assert steps == sorted(steps)
    first_coarse = next(n for n, step in enumerate(steps) if step > steps[0])
    assert all(area == areas[-1] for area in areas[first_coarse:])
    works = [level.work for level in AIRWAY_LEVELS]
    assert all(0.8 < b / a < 0.9 for a, b in itertools.pairwise(works))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("counts", [True, False], ids=["rays counted", "by the clock alone"])
def test_noise_and_hiccups_make_neither_flicker_nor_a_lower_rate(seed, counts):
    rng = random.Random(seed)
    # A tenth of noise, and once a second another program's moment.
    machine = Machine(
        0.06,
        slowed=lambda _now_s: math.exp(rng.gauss(0.0, 0.1)),
        shared=lambda _now_s: 3.0 if rng.random() < 1 / 60 else 1.0,
        counts=counts,
    )
    simulation = Simulation(machine, layout=dict(ALL_VIEWS))
    simulation.fly(2.0)
    sent = simulation.fly(10.0)
    assert rate_hz(sent) == pytest.approx(60.0, rel=0.1)
    assert num_changes(sent) <= 10, "no more than one change a second"
    widths = [order.width for _, order in airway(sent)]
    assert min(widths) >= (0.83 if counts else 0.7) * max(widths)


def test_a_slow_down_is_answered_within_a_few_pictures_and_taken_back_after_it():
    # Another process takes a core, and some of the memory's bandwidth, from second 15 to 18.
    simulation = Simulation(Machine(0.06, slowed=lambda now_s: 2.2 if 15.0 <= now_s < 18.0 else 1.0))
    before = simulation.fly(5.0)[-1][1].level
    hit = airway(simulation.fly(1.0))
    period_s = 1 / 60
    slow = [n for n, (time_s, o) in enumerate(hit) if simulation.machine.seconds(o, time_s) > 1.1 * period_s]
    assert 1 <= len(slow) <= 4, "a few pictures come late, then the level has given way"
    assert slow[-1] <= 4
    assert rate_hz(hit[5:]) == pytest.approx(60.0, rel=0.1)
    simulation.fly(2.0)
    recovered = airway(simulation.fly(3.0))
    assert rate_hz(recovered) == pytest.approx(60.0, rel=0.1)
    # One level apart is within the hysteresis.
    assert recovered[-1][1].level <= before + 1


@pytest.mark.parametrize("seed", range(3))
def test_waiting_for_a_core_does_not_cost_sharpness_that_would_not_shorten_it(seed):
    rng = random.Random(seed)
    quiet = Simulation(Machine(0.1))
    quiet.fly(3.0)
    # Every other picture waits for its cores, for 6 ms on average, whatever its size.
    waits = Machine(0.1, waits_s=lambda: rng.expovariate(1 / 0.006) if rng.random() < 0.5 else 0.0)
    simulation = Simulation(waits)
    simulation.fly(2.0)
    sent = simulation.fly(10.0)
    assert rate_hz(sent) == pytest.approx(60.0, rel=0.1)
    widths = sorted(order.width for _, order in airway(sent))
    assert widths[len(widths) // 2] >= 0.75 * quiet.sent[-1][1].width
    assert widths[0] >= 0.6 * quiet.sent[-1][1].width


def test_a_neighbour_who_stays_is_answered_and_one_who_leaves_is_forgotten():
    # Another program has half of the cores from second 15 to 18.
    machine = Machine(0.06, shared=lambda now_s: 2.0 if 15.0 <= now_s < 18.0 else 1.0)
    simulation = Simulation(machine)
    before = simulation.fly(5.0)[-1][1].width
    hit = airway(simulation.fly(3.0))
    late = [n for n, (time_s, o) in enumerate(hit) if machine.seconds(o, time_s - 0.001) > 1.1 / 60]
    assert late[-1] <= 10, "a few pictures come late, then the level has given way"
    assert rate_hz(hit[12:]) == pytest.approx(60.0, rel=0.05)
    assert airway(simulation.fly(3.0))[-1][1].width == before


def test_a_picture_is_as_fine_as_it_may_be_where_none_is_quick_enough_for_the_rate():
    # 40 ms for each picture, whatever its size: 25 a second at most.
    simulation = Simulation(Machine(0.06, each_s=0.040))
    simulation.fly(4.0)
    sent = airway(simulation.fly(4.0))
    rays_s = [simulation.machine.cost(order, 0.0)[1] for _, order in sent]
    assert all(0.25 / 60 < seconds <= 0.4 / 60 for seconds in rays_s), "neither coarser for nothing, nor slower yet"
    assert num_changes(sent) <= 1


def test_a_level_between_two_does_not_make_the_picture_swing():
    for cost in range(20):
        simulation = Simulation(Machine(0.02 * 1.12**cost))
        simulation.fly(2.0)
        sent = simulation.fly(8.0)
        assert num_changes(sent) <= 1
        assert num_coarser(sent) == 0


# ------------------------------------------------------------ rest


def test_a_view_that_did_not_change_is_not_rendered_again():
    player = Player({"airway": (200, 160), "axial": (100, 80), "xray-coronal": (100, 80)})
    keys = {"airway": 1, "axial": 1, "xray-coronal": 1}
    player.drain(keys)
    player.now_s += 1.0
    player.drain(keys)
    player.now_s += 1.0
    assert player.drain(keys) == []
    assert [o.view for o in player.sent].count("xray-coronal") == 1
    assert [o.full for o in player.sent if o.view == "xray-coronal"] == [True]


def test_the_first_airway_picture_is_coarse_and_the_last_one_full():
    player = Player({"airway": (800, 640)})
    orders = player.drain({"airway": 1})
    assert (orders[0].width, orders[0].height, orders[0].full) == (200, 160, False)
    assert player.scheduler.wake_s(player.now_s) == 10.0 + STILL_AFTER_S
    player.now_s = 10.0 + STILL_AFTER_S
    (last,) = player.drain({"airway": 1})
    assert (last.width, last.height, last.step_vox, last.full) == (800, 640, 0.5, True)
    assert player.scheduler.wake_s(player.now_s) is None


@pytest.mark.parametrize("full_s", [*FULL_COSTS_S, 0.6, 2.0])
def test_rest_brings_the_full_picture_within_a_bounded_time(full_s):
    simulation = Simulation(Machine(full_s), layout=dict(ALL_VIEWS))
    simulation.fly(3.0)
    stopped_s = simulation.now_s
    rested = airway(simulation.rest(5.0))
    assert rested[-1][1].grade == FULL
    assert (rested[-1][1].width, rested[-1][1].step_vox) == (800, 0.5)
    # The pause that shows that the hand rests, one picture of middle size where the full one takes long, and a little
    # for the pictures of the other views that were under way.
    middle_s = 1.3 * LONG_S if full_s > 0.8 * LONG_S else 0.0
    assert rested[-1][0] - stopped_s < STILL_AFTER_S + full_s + middle_s + 0.08


def test_a_full_picture_that_takes_long_has_one_of_middle_size_before_it():
    simulation = Simulation(Machine(1.0))
    moving = simulation.fly(2.0)[-1][1]
    sizes = [order.width for _, order in simulation.rest(3.0)]
    assert sizes[-1] == 800
    assert moving.width < sizes[-2] < 800
    assert simulation.sent[-1][1].full
    assert not simulation.sent[-2][1].full


# ------------------------------------------------------------ the view finder


def test_below_five_pictures_a_second_the_view_finder_stands_in_and_rest_shows_the_airway():
    simulation = Simulation(Machine(20.0, each_s=0.002), hand_per_s=60.0)  # 0.6 s at the lowest level
    simulation.fly(4.0)
    flown = simulation.fly(4.0)
    assert {order.purpose for _, order in flown} == {"finder"}
    assert rate_hz(flown) > 20.0, "the view finder follows the hand"
    probes_s = sum(seconds for _, seconds in simulation.probes)
    assert 3 <= len(simulation.probes) <= 20
    assert probes_s < 0.1 * 8.0, "looking whether the airway view is quick enough again holds up nothing"
    rested = simulation.rest(60.0)
    assert {order.purpose for _, order in rested} == {"picture"}
    assert rested[-1][1].full


def test_the_airway_view_comes_back_once_it_is_quick_again_and_stays():
    simulation = Simulation(Machine(20.0, each_s=0.002, slowed=lambda now_s: 1.0 if now_s < 18.0 else 0.01))
    simulation.fly(8.0)
    assert simulation.scheduler.finding
    simulation.fly(3.0)
    assert not simulation.scheduler.finding
    sent = simulation.fly(2.0)
    assert {order.purpose for _, order in sent} == {"picture"}
    assert rate_hz(sent) == pytest.approx(60.0, rel=0.1)


@pytest.mark.parametrize("rate", [3.5, 4.5, 5.5, 6.5, 7.5, 9.0])
def test_near_the_limit_the_view_finder_does_not_come_and_go(rate):
    # The coarsest level takes 1/rate seconds, with a little noise.
    rng = random.Random(3)
    last = AIRWAY_LEVELS[-1]
    work = last.scale**2 * (0.5 + 0.5 * 0.5 / last.step_vox)
    machine = Machine(0.002 + (1 / rate - 0.002) / work, 0.002, slowed=lambda _s: math.exp(rng.gauss(0.0, 0.05)))
    simulation = Simulation(machine)
    simulation.fly(10.0)
    stood_in = [order.purpose == "finder" for _, order in simulation.fly(30.0)]
    assert sum(a != b for a, b in itertools.pairwise(stood_in)) <= 1
    if rate < 0.9 * FINDER_BELOW_PER_S:
        assert stood_in[-1]
    if rate > 1.2 * FINDER_BELOW_PER_S:
        assert not stood_in[-1]


def test_a_renderer_that_takes_long_for_any_picture_is_probed_rarely():
    simulation = Simulation(Machine(0.5, each_s=0.4))
    simulation.fly(5.0)
    num, spent_s = len(simulation.probes), simulation.spent_s.get("probe", 0.0)
    simulation.fly(20.0)
    assert simulation.scheduler.finding
    assert simulation.spent_s["probe"] - spent_s < 0.08 * 20.0
    assert len(simulation.probes) > num


# ------------------------------------------------------------ several views, slow clients


def test_no_view_starves_and_none_slows_the_airway_view_while_it_moves():
    simulation = Simulation(Machine(0.1), layout=dict(ALL_VIEWS))
    simulation.fly(2.0)
    sent = simulation.fly(4.0)
    assert rate_hz(sent) == pytest.approx(60.0, rel=0.1)
    for view in ALL_VIEWS:
        assert sum(order.view == view for _, order in sent) >= 4 * 10, f"{view}: at least ten a second"


def test_where_nothing_is_quick_enough_the_others_still_take_no_more_than_their_share():
    simulation = Simulation(Machine(1.5, slices_s=0.03), layout=dict(ALL_VIEWS))
    simulation.fly(2.0)
    spent_s = dict(simulation.spent_s)
    sent = simulation.fly(6.0)
    assert {order.view for _, order in sent} == set(ALL_VIEWS)
    took = {v: s - spent_s.get(v, 0.0) for v, s in simulation.spent_s.items()}
    others_s = sum(s for v, s in took.items() if v != "picture")
    # A third of the airway's time, and at most one picture more than that.
    assert others_s < 0.35 * took["picture"] + 0.05


def test_a_dear_picture_of_another_view_waits_until_the_flight_is_over():
    layout = {**AIRWAY, "tree": (768, 768)}
    player = Player(layout, cost_s=1e-7)  # the full tree picture: 59 ms
    player.drain({"airway": 1, "tree": 1})
    for pose in range(2, 40):
        player.now_s += 1 / 60
        player.drain({"airway": pose, "tree": 1})
    assert [o.grade for o in player.sent if o.view == "tree"] == [1], "its moving picture, and no full one yet"
    player.now_s += STILL_AFTER_S
    player.drain({"airway": 39, "tree": 1})
    assert next(o for o in reversed(player.sent) if o.view == "tree").full


def test_pictures_in_flight_are_limited_and_an_ack_makes_room():
    player = Player({"airway": (64, 64), "axial": (64, 64)}, acknowledges=False)
    for pose in range(20):
        player.now_s += 0.02
        player.drain({"airway": pose, "axial": pose})
    assert player.scheduler.num_in_flight("airway") == 3
    assert player.scheduler.num_in_flight("axial") == 1
    player.now_s += 0.02
    assert player.step({"airway": 99, "axial": 99}) is None
    airway_ids = [n for n, o in enumerate(player.sent, start=1) if o.view == "airway"]
    player.scheduler.acknowledge(airway_ids[0])
    order = player.step({"airway": 100, "axial": 100})
    assert (order.view, order.key) == ("airway", 100)  # the newest pose, not those skipped
    assert player.scheduler.num_in_flight("airway") == 3


class Slow:
    """A client that decodes one picture at a time and drops what is overtaken (``web/src/net/pictures.ts``).

    What was dropped is acknowledged with the picture that was being decoded, so that the server hears how slow it is.
    """

    def __init__(self, decode_s: float, travel_s: float = 0.0) -> None:
        self.decode_s, self.travel_s = decode_s, travel_s
        self.scheduler = FrameScheduler()
        self.scheduler.set_layout(AIRWAY)

    def fly(self, seconds: float) -> tuple[int, int, float]:
        """Pictures rendered, pictures shown, and how old a pose was on the average when it was shown."""
        now_s, end_s, frame = 10.0, 10.0 + seconds, 0
        decoding, waiting, overtaken, acks, ages_s, made_s = None, None, [], [], [], {}
        while now_s < end_s:
            now_s += 0.001
            for due_s, done in [a for a in acks if a[0] <= now_s]:
                acks.remove((due_s, done))
                self.scheduler.acknowledge(done)
            if decoding is not None and now_s >= decoding[0]:
                acks += [(now_s + self.travel_s, done) for done in (*overtaken, decoding[1])]
                overtaken = []
                ages_s.append(now_s - made_s[decoding[1]])
                decoding = None
            if decoding is None and waiting is not None:
                decoding, waiting = (now_s + self.decode_s, waiting), None
            self.scheduler.observe({"airway": int(now_s * 60)}, now_s)
            order = self.scheduler.next_order(now_s)
            if order is not None:
                frame += 1
                made_s[frame] = now_s
                now_s += 0.010
                self.scheduler.rendered(order, frame, 0.010, now_s)
                if waiting is not None:
                    overtaken.append(waiting)
                waiting = frame
        return frame, len(ages_s), sum(ages_s) / len(ages_s)


def test_a_client_that_is_behind_is_not_sent_what_it_would_drop():
    rendered, shown, age_s = Slow(decode_s=0.150).fly(20.0)
    assert shown >= 0.8 * 20.0 / 0.160, "the client always has something to decode"
    # One is decoded and one waits; at 60 a second it would be nine times as many, on cores that the client lacks.
    assert rendered < 2.1 * shown
    assert age_s < 2.2 * 0.150


def test_a_client_that_is_far_away_gets_its_pictures_in_flight():
    # A round trip of 45 ms, and nothing is ever dropped: three under way, 60 a second.
    _, shown, _ = Slow(decode_s=0.004, travel_s=0.041).fly(10.0)
    assert shown > 0.85 * 10.0 * 50


def test_a_client_that_lost_its_pictures_is_not_left_without_any():
    player = Player({"airway": (64, 64)}, acknowledges=False)
    for pose in range(5):
        player.now_s += 0.02
        player.drain({"airway": pose})
    player.now_s += 0.02
    assert player.step({"airway": 9}) is None
    first_sent_s = 10.02
    assert player.scheduler.wake_s(player.now_s) == pytest.approx(first_sent_s + LOST_AFTER_S, abs=0.01)
    player.now_s = player.scheduler.wake_s(player.now_s) + 0.001
    assert player.step({"airway": 9}).key == 9


def test_a_view_that_comes_back_to_the_screen_gets_everything_and_its_old_pictures_are_forgotten():
    player = Player({"airway": (64, 64)}, acknowledges=False)
    player.scheduler.observe({"airway": 1}, player.now_s)
    under_way = player.scheduler.next_order(player.now_s)
    player.scheduler.set_layout({})
    assert not player.scheduler.rendered(under_way, 5, 0.01, player.now_s)
    assert player.scheduler.num_in_flight("airway") == 0
    player.scheduler.set_layout({"airway": (64, 64)})
    player.now_s += 0.02
    assert player.step({"airway": 1}).view == "airway"


def test_a_picture_that_failed_is_not_asked_for_until_it_changes():
    player = Player({"axial": (64, 64)})
    player.scheduler.observe({"axial": 1}, player.now_s)
    player.scheduler.failed(player.scheduler.next_order(player.now_s))
    assert player.step({"axial": 1}) is None
    assert player.step({"axial": 2}).key == 2


def test_a_view_with_nothing_to_show_is_not_rendered():
    player = Player({"tree": (64, 64)})
    assert player.step({"tree": None}) is None
    assert player.step({"tree": 1}) is not None
    player.scheduler.observe({"tree": None}, player.now_s)
    assert player.scheduler.next_order(player.now_s) is None
    assert player.scheduler.wake_s(player.now_s) is None


def test_a_resized_view_is_sent_again_and_the_others_are_not():
    player = Player({"axial": (64, 64), "coronal": (64, 64)})
    keys = {"axial": 1, "coronal": 1}
    player.drain(keys)
    player.scheduler.set_layout({"axial": (128, 64), "coronal": (64, 64)})
    assert [(o.view, o.width) for o in player.drain(keys)] == [("axial", 128)]


# ------------------------------------------------------------ giving way


def under_way(player, keys):
    """The full airway picture has just begun."""
    player.drain(keys)
    player.now_s += STILL_AFTER_S
    player.scheduler.observe(keys, player.now_s)
    order = player.scheduler.next_order(player.now_s)
    assert order.grade > 1
    return order


def test_a_full_picture_gives_way_to_a_movement_and_a_moving_one_does_not():
    player = Player({"airway": (800, 640)})
    order = under_way(player, {"airway": 1})
    assert not player.scheduler.gives_way(order, {"airway": 1}, player.now_s)
    assert player.scheduler.gives_way(order, {"airway": 2}, player.now_s)
    player.scheduler.given_up(order, 0.01)
    moving = player.step({"airway": 2})
    assert (moving.key, moving.grade) == (2, 1)
    assert not player.scheduler.gives_way(moving, {"airway": 3}, player.now_s)


def test_only_a_long_picture_gives_way_to_another_view():
    quick, slow = Player({**AIRWAY, "axial": (64, 64)}), Player({**AIRWAY, "axial": (64, 64)}, cost_s=2e-6)
    for player, gives_way in ((quick, False), (slow, True)):
        order = under_way(player, {"airway": 1, "axial": 1})
        assert player.scheduler.gives_way(order, {"airway": 1, "axial": 2}, player.now_s) == gives_way
