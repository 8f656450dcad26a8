"""A bridge to a force device over the WebSocket: it counts a hundred answers a second, goes, and comes back."""

from __future__ import annotations

import threading
import time
from contextlib import ExitStack, contextmanager
from types import SimpleNamespace

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from carina.commands import CloseCase, OpenPath, WallNear
from carina.scopes import WallField, picture_threads
from carina.server import messages as wire
from carina.server.force_link import MAX_BRIDGES
from carina.server.security import Gate
from carina.server.serve import bind, make_server
from carina.server.uploads import Limits, Uploads
from carina.session import LocalStore, Session
from small_case import SmallRenderer, small_parts

WAIT_S = 120.0
RADIUS_MM = 5.0


def wall_field(volume, airways, *, progress, cancel):
    """A slab of lumen about the root, by plain geometry: its wall lies 5 mm to the left and right of it."""
    nz, ny, nx = volume.shape_zyx
    k, j, i = np.mgrid[0:nz, 0:ny, 0:nx]
    grid = np.stack([i, j, k], axis=-1).reshape(-1, 3) @ volume.lps_from_ijk[:3, :3].T + volume.lps_from_ijk[:3, 3]
    away = np.abs(grid[:, 0] - airways.root_lps[0])
    return WallField.from_distances((RADIUS_MM - away).reshape(nz, ny, nx).astype(np.float32), volume.lps_from_ijk)


class Bridge:
    """What a bridge in another process does."""

    def __init__(self, socket):
        self.socket = socket
        self.number = 0
        self.send(wire.ClientHello(wire.FORCE_VERSION))
        assert isinstance(self.receive(), wire.ServerHello)

    def send(self, message):
        self.socket.send(wire.encode_message(message))

    def receive(self):
        return wire.parse_to_force_message(self.socket.recv(timeout=WAIT_S))

    def ask(self, lps):
        self.number += 1
        self.send(wire.AskContact(self.number, lps))
        answer = self.receive()
        assert answer.number == self.number
        return answer

    def until_ready(self, lps):
        end_s = time.monotonic() + WAIT_S
        while (answer := self.ask(lps)).state != "ready":
            assert time.monotonic() < end_s, answer
            time.sleep(0.01)
        return answer


@contextmanager
def bridge(live, **headers):
    headers = headers or {"Authorization": f"Bearer {live.gate.secret}"}
    url = f"ws://127.0.0.1:{live.gate.port}/force"
    with connect(url, additional_headers=headers, compression=None, open_timeout=WAIT_S) as socket:
        yield socket


@pytest.fixture
def live(tmp_path):
    session = Session(SmallRenderer, parts=small_parts(wall_field=wall_field), store=LocalStore(tmp_path))
    with bind("127.0.0.1", 0) as sock:
        gate = Gate(host="127.0.0.1", port=sock.getsockname()[1])
        started = threading.Event()
        server = make_server(session, gate, on_started=started.set, web=None, uploads=Uploads(Limits()))
        thread = threading.Thread(target=lambda: server.run(sockets=[sock]), daemon=True)
        thread.start()
        try:
            assert started.wait(WAIT_S)
            session.do(OpenPath("case"))
            assert session.jobs.wait_idle(WAIT_S)
            yield SimpleNamespace(gate=gate, session=session, origin=f"http://127.0.0.1:{gate.port}")
        finally:
            server.should_exit = True
            thread.join(WAIT_S)
            assert not thread.is_alive()


def test_a_hundred_planes_a_second_through_loss_and_return(live):
    root = tuple(float(v) for v in live.session.snapshot().document.airways.root_lps)
    near = (root[0] + 4.0, root[1], root[2])
    before = picture_threads()
    for _ in range(2):
        with bridge(live) as socket:
            hand = Bridge(socket)
            plane = hand.until_ready(near).plane
            # The tip is a ball of 2.45 mm: its middle meets the wall that much before.
            assert plane.normal_lps == pytest.approx((-1.0, 0.0, 0.0), abs=0.02)
            assert plane.point_lps[0] == pytest.approx(root[0] + RADIUS_MM - 2.45, abs=0.1)
            assert plane.stiffness_n_per_mm > 0.0
            assert plane.damping_ns_per_mm > 0.0
            assert picture_threads() == max(1, before - 1)
            # As often as a bridge needs, for a whole second: one in which the machine has nothing else to do.
            end_s, num = time.monotonic() + WAIT_S, 0
            while num < 100:
                assert time.monotonic() < end_s, f"{num} a second"
                began_s, num = time.monotonic(), 0
                while time.monotonic() < began_s + 1.0:
                    place = (near[0] + 0.001 * num, *near[1:])
                    assert hand.ask(place).lps == pytest.approx(place)
                    num += 1
            # Cut off without a farewell, as when the bridge's program dies.
            socket.socket.close()
        end_s = time.monotonic() + WAIT_S
        while picture_threads() != before:
            assert time.monotonic() < end_s
            time.sleep(0.01)


def test_far_from_the_wall_and_without_a_case_there_is_no_plane(live):
    root = tuple(float(v) for v in live.session.snapshot().document.airways.root_lps)
    with bridge(live) as socket:
        hand = Bridge(socket)
        hand.until_ready(root)
        own = hand.ask(None)
        assert own.lps == pytest.approx(tuple(live.session.pose_info().pose.position_lps))
        live.session.do(CloseCase())
        answer = hand.ask(root)
        assert (answer.state, answer.plane) == ("none", None)


def test_a_flood_of_questions_is_answered_by_the_newest(live, monkeypatch):
    with bridge(live) as socket:
        hand = Bridge(socket)
        hand.until_ready((0.0, 0.0, 0.0))
        # The first answer takes until all questions are on the way.
        flooded, answer = threading.Event(), live.session.ask

        def ask(question):
            if isinstance(question, WallNear):
                assert flooded.wait(WAIT_S)
            return answer(question)

        monkeypatch.setattr(live.session, "ask", ask)
        for number in range(1000, 1400):
            hand.send(wire.AskContact(number, (0.0, 0.0, 0.0)))
        flooded.set()
        answers = [hand.receive()]
        while answers[-1].number < 1399:
            answers.append(hand.receive())
        numbers = [answer.number for answer in answers]
        assert numbers == sorted(numbers)
        assert len(numbers) < 200, "most of them were never answered: they came faster than one in a millisecond"


@pytest.mark.parametrize(
    "broken", ['{"type":"steer"}', "nonsense", '{"type":"ask_contact","number":1,"lps":[1,2,NaN]}']
)
def test_what_no_bridge_says_ends_its_socket_and_no_other(live, broken):
    with bridge(live) as other, bridge(live) as socket:
        well = Bridge(other)
        hand = Bridge(socket)
        hand.socket.send(broken)
        with pytest.raises(ConnectionClosed) as closed:
            hand.receive()
        assert closed.value.rcvd.code == wire.CLOSE_CODES["protocol.malformed"]
        well.until_ready((0.0, 0.0, 0.0))


def test_a_fault_ends_the_bridges_connection_and_not_only_its_answers(live, monkeypatch):
    """A device that waits for an answer that never comes would go on with an old plane."""
    with bridge(live) as socket:
        hand = Bridge(socket)
        hand.until_ready((0.0, 0.0, 0.0))
        monkeypatch.setattr(live.session, "ask", lambda _question: 1 / 0)
        hand.send(wire.AskContact(7, (0.0, 0.0, 0.0)))
        with pytest.raises(ConnectionClosed) as closed:
            hand.receive()
        assert closed.value.rcvd.code == 1011
    monkeypatch.undo()
    with bridge(live) as socket:
        Bridge(socket).until_ready((0.0, 0.0, 0.0))


def test_a_state_that_cannot_be_told_ends_the_windows_connection(live, monkeypatch):
    """A window that is told nothing any more would show an old state as if it were the present one."""
    url = f"ws://127.0.0.1:{live.gate.port}/ws"
    monkeypatch.setattr("carina.server.hub.state_message", lambda *_, **__: wire.Value((0.0, 0.0, float("nan")), None))
    with connect(url, additional_headers={"Authorization": f"Bearer {live.gate.secret}"}, compression=None) as socket:
        socket.send(wire.encode_message(wire.ClientHello(wire.WIRE_VERSION)))
        with pytest.raises(ConnectionClosed) as closed:
            list(socket)
        assert closed.value.rcvd.code == 1011


def test_no_more_bridges_than_can_be_served_and_a_place_that_is_left_is_given_anew(live):
    with ExitStack() as stack:
        hands = [Bridge(stack.enter_context(bridge(live))) for _ in range(MAX_BRIDGES)]
        with bridge(live) as socket, pytest.raises(ConnectionClosed) as closed:
            socket.recv(timeout=WAIT_S)
        assert closed.value.rcvd.code == wire.CLOSE_CODES["protocol.order"]
        assert f"at most {MAX_BRIDGES}" in closed.value.rcvd.reason
        hands[-1].ask((0.0, 0.0, 0.0))
        hands.pop().socket.close()
        end_s = time.monotonic() + WAIT_S
        while True:
            try:
                with bridge(live) as socket:
                    Bridge(socket).ask((0.0, 0.0, 0.0))
                break
            except ConnectionClosed:
                assert time.monotonic() < end_s, "the place of one that went was not given anew"


@pytest.mark.parametrize(
    ("first", "code"),
    [
        (wire.ClientHello(wire.FORCE_VERSION + 1), "protocol.version"),
        (wire.AskContact(1, None), "protocol.order"),
    ],
)
def test_a_bridge_begins_with_a_hello_of_this_version(live, first, code):
    with bridge(live) as socket:
        socket.send(wire.encode_message(first))
        with pytest.raises(ConnectionClosed) as closed:
            socket.recv(timeout=WAIT_S)
    assert closed.value.rcvd.code == wire.CLOSE_CODES[code]


def test_without_the_token_there_is_no_force(live):
    with bridge(live, Cookie="nothing=1", Origin=live.origin) as socket:
        with pytest.raises(ConnectionClosed) as closed:
            socket.recv(timeout=WAIT_S)
        assert closed.value.rcvd.code == wire.CLOSE_CODES["protocol.not-authorised"]
