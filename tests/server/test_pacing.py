"""The frame pump's judgement, with a clock that the test moves."""

from __future__ import annotations

from carina.server.pacing import LEVELS, LONG_S, SETTLED_AFTER_S, STILL_AFTER_S, TARGET_S, FrameScheduler


class Player:
    """Plays renderer and client: renders what is ordered, in the seconds that a cost per ray gives."""

    def __init__(self, *, cost_s: float = 1e-7, acknowledges: bool = True) -> None:
        self.scheduler = FrameScheduler()
        self.now_s = 10.0
        self.cost_s = cost_s
        self.acknowledges = acknowledges
        self.sent = []
        self.frame_id = 0

    def step(self, keys):
        self.scheduler.observe(keys, self.now_s)
        order = self.scheduler.next_order(self.now_s)
        if order is None:
            return None
        self.frame_id += 1
        seconds = self.cost_s * order.width * order.height / order.step_vox
        self.now_s += seconds
        assert self.scheduler.rendered(order, self.frame_id, seconds)
        self.sent.append(order)
        if self.acknowledges:
            self.scheduler.acknowledge(self.frame_id)
        return order

    def drain(self, keys):
        """Until nothing is wanted now."""
        orders = []
        while (order := self.step(keys)) is not None:
            orders.append(order)
        return orders


def test_a_view_that_did_not_change_is_not_rendered_again():
    player = Player()
    player.scheduler.set_layout({"airway": (200, 160), "axial": (100, 80), "xray-coronal": (100, 80)})
    keys = {"airway": 1, "axial": 1, "xray-coronal": 1}
    player.drain(keys)
    player.now_s += 1.0
    player.drain(keys)
    player.now_s += 1.0
    assert player.drain(keys) == []
    assert [o.view for o in player.sent].count("xray-coronal") == 1
    assert [o.full for o in player.sent if o.view == "xray-coronal"] == [True]


def test_the_first_airway_picture_is_coarse_and_the_last_one_full():
    player = Player()
    player.scheduler.set_layout({"airway": (800, 640)})
    orders = player.drain({"airway": 1})
    assert (orders[0].width, orders[0].height, orders[0].full) == (200, 160, False)
    assert player.scheduler.wake_s(player.now_s) == 10.0 + STILL_AFTER_S
    player.now_s = 10.0 + STILL_AFTER_S
    (last,) = player.drain({"airway": 1})
    assert (last.width, last.height, last.step_vox, last.full) == (800, 640, 0.5, True)
    assert player.scheduler.wake_s(player.now_s) is None


def test_a_full_picture_that_takes_long_waits_until_the_person_really_rests():
    player = Player(cost_s=1e-6)  # the full picture: 1 s
    player.scheduler.set_layout({"airway": (800, 640)})
    player.drain({"airway": 1})
    player.drain({"airway": 2})
    changed_s = player.now_s
    player.scheduler.observe({"airway": 3}, changed_s)
    moving = player.drain({"airway": 3})[-1]
    player.now_s = player.scheduler.wake_s(player.now_s)
    assert player.now_s == changed_s + STILL_AFTER_S
    (paused,) = player.drain({"airway": 3})
    assert moving.width < paused.width < 800
    assert not paused.full
    assert player.cost_s * paused.width * paused.height / paused.step_vox <= LONG_S
    player.now_s = player.scheduler.wake_s(player.now_s)
    assert player.now_s == changed_s + SETTLED_AFTER_S
    (full,) = player.drain({"airway": 3})
    assert (full.width, full.full) == (800, True)
    assert player.scheduler.wake_s(player.now_s) is None


def test_resolution_follows_the_cost_down_and_up_again():
    player = Player(cost_s=4e-7)  # 800 x 640 at half a voxel: 410 ms
    player.scheduler.set_layout({"airway": (800, 640)})
    for pose in range(30):
        player.step({"airway": pose})
    last = player.sent[-1]
    assert player.cost_s * last.width * last.height / last.step_vox <= 1.15 * TARGET_S
    assert last.width < 800
    player.cost_s = 2e-8  # 20 ms at full size: nothing needs to be coarse
    for pose in range(100, 130):
        player.step({"airway": pose})
    assert (player.sent[-1].width, player.sent[-1].step_vox) == (800, 0.5)


def test_resolution_does_not_swing_between_two_levels():
    for cost_s in (3e-8, 1e-7, 2.3e-7, 5e-7, 1e-6):
        player = Player(cost_s=cost_s)
        player.scheduler.set_layout({"airway": (800, 640)})
        for pose in range(60):
            player.step({"airway": pose})
        assert len({(o.width, o.step_vox) for o in player.sent[-30:]}) == 1


def test_levels_go_from_fine_to_coarse():
    costs = [scale * scale / step_vox for scale, step_vox in LEVELS]
    assert costs == sorted(costs, reverse=True)


def test_pictures_in_flight_are_limited_and_an_ack_makes_room():
    player = Player(acknowledges=False)
    player.scheduler.set_layout({"airway": (64, 64), "axial": (64, 64)})
    for pose in range(20):
        player.step({"airway": pose, "axial": pose})
    assert player.scheduler.num_in_flight("airway") == 3
    assert player.scheduler.num_in_flight("axial") == 1
    assert player.step({"airway": 99, "axial": 99}) is None
    airway_ids = [n for n, o in enumerate(player.sent, start=1) if o.view == "airway"]
    player.scheduler.acknowledge(airway_ids[0])
    order = player.step({"airway": 100, "axial": 100})
    assert (order.view, order.key) == ("airway", 100)  # the newest pose, not those skipped
    assert player.scheduler.num_in_flight("airway") == 3


def test_the_airway_goes_first_and_the_others_are_not_starved_while_it_moves():
    player = Player(cost_s=2e-7)
    layout = {"axial": (300, 200), "coronal": (300, 200), "tri-plane": (300, 200), "airway": (800, 640)}
    player.scheduler.set_layout(layout)
    assert player.step(dict.fromkeys(layout, 0)).view == "airway"
    for pose in range(1, 200):
        player.step(dict.fromkeys(layout, pose))
    views = [o.view for o in player.sent]
    assert {"axial", "coronal", "tri-plane"} <= set(views[-60:])
    spent = {
        v: sum(player.cost_s * o.width * o.height / o.step_vox for o in player.sent if o.view == v) for v in layout
    }
    others = sum(s for v, s in spent.items() if v != "airway")
    # A third of the airway's time, and at most one picture more than that.
    assert others < 0.35 * spent["airway"] + 0.03


def test_a_new_client_gets_everything_and_old_orders_are_for_nobody():
    player = Player(acknowledges=False)
    player.scheduler.set_layout({"airway": (64, 64)})
    player.scheduler.observe({"airway": 1}, player.now_s)
    under_way = player.scheduler.next_order(player.now_s)
    player.scheduler.forget_sent()
    assert not player.scheduler.rendered(under_way, 5, 0.01)
    assert player.scheduler.num_in_flight("airway") == 0
    assert player.step({"airway": 1}).view == "airway"


def test_a_picture_that_failed_is_not_asked_for_until_it_changes():
    player = Player()
    player.scheduler.set_layout({"axial": (64, 64)})
    player.scheduler.observe({"axial": 1}, player.now_s)
    player.scheduler.failed(player.scheduler.next_order(player.now_s))
    assert player.step({"axial": 1}) is None
    assert player.step({"axial": 2}).key == 2


def test_a_view_with_nothing_to_show_is_not_rendered():
    player = Player()
    player.scheduler.set_layout({"tree": (64, 64)})
    assert player.step({"tree": None}) is None
    assert player.step({"tree": 1}) is not None
    player.scheduler.observe({"tree": None}, player.now_s)
    assert player.scheduler.next_order(player.now_s) is None
    assert player.scheduler.wake_s(player.now_s) is None


def test_a_resized_view_is_sent_again_and_the_others_are_not():
    player = Player()
    player.scheduler.set_layout({"axial": (64, 64), "coronal": (64, 64)})
    keys = {"axial": 1, "coronal": 1}
    player.drain(keys)
    player.scheduler.set_layout({"axial": (128, 64), "coronal": (64, 64)})
    assert [(o.view, o.width) for o in player.drain(keys)] == [("axial", 128)]
