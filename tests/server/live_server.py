"""Complete server on loopback over a small case, and a client that acts as the browser."""

from __future__ import annotations

import contextlib
import threading
import time
from dataclasses import dataclass

import httpx
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from carina.server.files.uploads import Limits, Uploads
from carina.server.network.access_checks import Gate
from carina.server.serve import bind, make_server
from carina.server.wire import messages as wire
from carina.session import LocalStore, Session
from small_case import SmallRenderer, small_parts

WAIT_S = 120.0
"""Upper limit of every wait, seconds. The awaited events take milliseconds, or seconds on a busy machine."""


@dataclass
class Live:
    """Running server with its session, gate and uploads."""

    gate: Gate
    session: Session
    uploads: Uploads
    opened: list

    @property
    def origin(self):
        return f"http://127.0.0.1:{self.gate.port}"

    @property
    def cookie(self):
        return self.gate.set_cookie.split(";")[0]

    def http(self, **headers):
        return httpx.Client(base_url=self.origin, headers=headers, timeout=WAIT_S)

    @contextlib.contextmanager
    def window(self, *, hello=True):
        """Connect a client as the browser does, with cookie and origin."""
        with connect(
            f"ws://127.0.0.1:{self.gate.port}/ws",
            origin=self.origin,
            additional_headers={"Cookie": self.cookie},
            compression=None,
            open_timeout=WAIT_S,
        ) as socket:
            yield Window(socket, hello=hello)


class Window:
    """Client that stores the messages and pictures that it receives."""

    def __init__(self, socket, *, hello):
        self.socket = socket
        self.pictures = []
        self.seen = []
        if hello:
            self.send(wire.ClientHello(wire.WIRE_VERSION))
            self.until(lambda m: isinstance(m, wire.ServerHello))

    def send(self, *messages):
        for message in messages:
            self.socket.send(wire.encode_message(message))

    def next(self):
        data = self.socket.recv(timeout=WAIT_S)
        if isinstance(data, bytes):
            header, _ = wire.parse_picture(data)
            self.pictures.append(header)
            return header
        message = wire.parse_server_message(data)
        self.seen.append(message)
        return message

    def until(self, wanted, *, acknowledge=True):
        """Return the next message that meets the condition ``wanted``.

        Acknowledge the pictures that arrive before it.
        """
        end_s = time.monotonic() + WAIT_S
        while True:
            message = self.next()
            assert time.monotonic() < end_s, "other messages come, and this one does not"
            if acknowledge and isinstance(message, wire.PictureHeader):
                self.send(wire.Ack(message.frame_id))
            if wanted(message):
                return message

    def received(self, wanted):
        """Return the first message that meets the condition ``wanted``, among those received before or later.

        The server writes a tree concurrently with answers and sends the route after it. Both may arrive before or long
        after a state that follows from the tree.
        """
        return next(filter(wanted, self.seen), None) or self.until(wanted)

    def until_state(self, wanted):
        return self.until(lambda m: isinstance(m, wire.State) and wanted(m))

    def close_code(self):
        with pytest.raises(ConnectionClosed) as closed:
            self.until(lambda _message: False)
        return closed.value.rcvd.code, closed.value.rcvd.reason


@contextlib.contextmanager
def serving(session, uploads, *, web=None, **options):
    """Run a server in a separate thread, and return its gate."""
    with bind("127.0.0.1", 0) as sock:
        gate = Gate(host="127.0.0.1", port=sock.getsockname()[1])
        started = threading.Event()
        server = make_server(
            session, gate, on_started=started.set, web=web, uploads=uploads, watch_address="127.0.0.1", **options
        )
        thread = threading.Thread(target=lambda: server.run(sockets=[sock]), daemon=True)
        thread.start()
        try:
            assert started.wait(WAIT_S)
            yield gate
        finally:
            server.should_exit = True
            thread.join(WAIT_S)
            assert not thread.is_alive()


@contextlib.contextmanager
def running(tmp_path, *, web=None, backend=None, is_backend_forced=False, **replaced):
    """Run a server over the small case, with some parts of the session replaced by ``replaced``."""
    opened = []

    def open_volume(path, progress, cancel):
        opened.append(path)
        return small_parts(**replaced).open_volume(path, progress, cancel)

    parts = small_parts(**({"open_volume": open_volume} | replaced))
    session = Session(SmallRenderer, parts=parts, store=LocalStore(tmp_path / "config"))
    uploads = Uploads(Limits(num_files=20, total_bytes=10_000, file_bytes=5000))
    options = {"backend": backend, "is_backend_forced": is_backend_forced}
    with serving(session, uploads, web=web, **options) as gate:
        yield Live(gate, session, uploads, opened)


SHOWN = wire.Layout((wire.ViewSize("airway", 160, 120), wire.ViewSize("axial", 80, 60), wire.ViewSize("tree", 64, 48)))


def open_case(window, path="case"):
    window.send(wire.OpenPath(path))
    return window.until_state(lambda s: s.airways == "found")
