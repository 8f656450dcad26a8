"""Tests of the shutdown of servers: within the grace period and without an error, whatever their clients do."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import ssl
import threading
import time
from types import SimpleNamespace

import pytest
import uvicorn
from live_server import WAIT_S, running
from starlette.applications import Starlette

from carina.phone.page import PhonePage
from carina.server.network import shutdown as ending
from carina.server.network.connection_limits import UnauthenticatedConnections
from small_case import session_fixture

REQUEST = b"GET / HTTP/1.1\r\nHost: %s\r\n\r\n"


@pytest.fixture
def log_records(caplog):
    """Return a function that lists the log messages of uvicorn at level WARNING or above."""
    with caplog.at_level(logging.WARNING):
        yield lambda: [record.getMessage() for record in caplog.records if record.name.startswith("uvicorn")]


@pytest.fixture
def page(tmp_path):
    """Return the encrypted page for phones of a running workstation."""
    (tmp_path / "phone.html").write_text("<!doctype html><title>phone</title>" + "x" * 1000)
    page = PhonePage(session_fixture().session, web=tmp_path, address="127.0.0.1")
    page.start()
    yield page
    page.stop()


def tls_connection(page) -> ssl.SSLSocket:
    """Connect to the page with encryption, as a browser does; the test decides what the connection sends and reads."""
    context = ssl.create_default_context()
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    return context.wrap_socket(socket.create_connection(place(page), timeout=WAIT_S))


def place(page) -> tuple[str, int]:
    host, port = page.info().url.partition("#")[0][8:].rstrip("/").split(":")
    return host, int(port)


def answer(secure: ssl.SSLSocket, page) -> bytes:
    """Send a request and return the complete response; the connection stays open."""
    secure.sendall(REQUEST % "{}:{}".format(*place(page)).encode())
    got = b""
    while not got.endswith(b"x" * 1000):
        got += secure.recv(4096)
    return got


def has_ended(sock) -> bool:
    """Wait until the server closes the connection, and return True."""
    with contextlib.suppress(ConnectionError, ssl.SSLError):
        while sock.recv(4096):
            pass
    return True


def test_phone_server_stops_without_waiting_for_a_sleeping_browser(page, log_records):
    with tls_connection(page) as idle, tls_connection(page) as quiet:
        assert answer(idle, page).startswith(b"HTTP/1.1 200")
        page.stop()
        # Neither connection has read or sent anything since the response.
        assert log_records() == []
        assert has_ended(idle)
        assert has_ended(quiet)


def test_phone_server_stops_while_a_connected_phone_sleeps(page, log_records):
    host = "{}:{}".format(*place(page)).encode()
    with tls_connection(page) as phone:
        phone.sendall(
            b"GET /phone HTTP/1.1\r\nHost: %s\r\nOrigin: https://%s\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n" % (host, host)
        )
        assert phone.recv(4096).startswith(b"HTTP/1.1 101")
        page.stop()
        assert log_records() == []
        assert has_ended(phone)


def test_unfinished_tls_handshake_does_not_delay_the_shutdown_of_the_phone_server(page, log_records):
    with socket.create_connection(place(page), timeout=WAIT_S) as half:
        half.sendall(b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03")
        page.stop()
        assert log_records() == []


def test_workstation_stops_although_a_window_does_not_read_its_messages(tmp_path, log_records, monkeypatch):
    ends = ending.TimedShutdownServer._end_connections
    unread: list[int] = []

    async def with_much_on_its_way(server) -> None:
        for connection in server.server_state.connections:
            connection.transport.write(bytes(20_000_000))
            unread.append(connection.transport.get_write_buffer_size())
        await ends(server)

    monkeypatch.setattr(ending.TimedShutdownServer, "_end_connections", with_much_on_its_way)
    with socket.socket() as deaf:
        with running(tmp_path) as live:
            deaf.connect(("127.0.0.1", live.gate.port))
            deaf.sendall(
                f"GET /ws HTTP/1.1\r\nHost: 127.0.0.1:{live.gate.port}\r\nOrigin: {live.origin}\r\n"
                f"Cookie: {live.cookie}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
            )
            assert deaf.recv(12) == b"HTTP/1.1 101"
        assert unread and unread[0] > 0
        assert log_records() == []


def test_connection_that_arrives_during_shutdown_is_refused(tmp_path, log_records, monkeypatch):
    late: list[socket.socket] = []
    ends = ending.TimedShutdownServer._end_connections

    async def arrives(server) -> None:
        # The system accepts the connection before the shutdown, and the server receives the connection after it has
        # closed all others.
        await ends(server)
        ours, theirs = socket.socketpair()
        late.append(theirs)
        config = server.config
        await asyncio.get_running_loop().connect_accepted_socket(
            lambda: config.http_protocol_class(
                config=config, server_state=server.server_state, app_state=server.lifespan.state
            ),
            ours,
        )

    monkeypatch.setattr(ending.TimedShutdownServer, "_end_connections", arrives)
    with running(tmp_path):
        pass
    assert log_records() == []
    with late[0] as theirs:
        theirs.settimeout(WAIT_S)
        assert theirs.recv(1) == b""


def test_open_connection_is_requested_once_to_close_and_not_aborted_if_it_closes_in_time():
    calls = []

    class Connection:
        """Connection that closes a moment after the request, like a connection that is still writing its response."""

        def __init__(self):
            self.transport = self

        def is_closing(self):
            return False

        def shutdown(self):
            calls.append("asked")
            asyncio.get_running_loop().call_later(3 * ending.POLL_INTERVAL_S, server.server_state.connections.clear)

    async def end():
        server.server_state.connections.add(Connection())
        await server._end_connections()

    async def app(_scope, _receive, _send):
        raise AssertionError("nobody asks")

    unauthenticated = SimpleNamespace(abort=lambda _transport: calls.append("cut"))
    server = ending.TimedShutdownServer(uvicorn.Config(app, timeout_graceful_shutdown=600), unauthenticated)
    asyncio.run(asyncio.wait_for(end(), WAIT_S))
    assert calls == ["asked"]


def test_second_interrupt_ends_the_application_without_an_error(log_records):
    """Check the second interrupt, at which uvicorn alone would cancel the application and print a traceback."""
    ended = []

    @contextlib.asynccontextmanager
    async def lifespan(_app):
        yield
        ended.append("whole")

    app = Starlette(lifespan=lifespan)
    config = uvicorn.Config(app, lifespan="on", log_config=None, host="127.0.0.1", port=0, timeout_graceful_shutdown=3)
    server = ending.TimedShutdownServer(config, UnauthenticatedConnections())
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        end_s = time.monotonic() + WAIT_S
        while not server.started:
            assert time.monotonic() < end_s
            thread.join(0.01)
    finally:
        server.force_exit = server.should_exit = True
        thread.join(WAIT_S)
    assert ended == ["whole"]
    assert log_records() == []
