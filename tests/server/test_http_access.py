"""Tests of access to the server on loopback: links, cookies, hosts, origins, and the served files."""

from __future__ import annotations

import json
import os
from socket import create_connection

import pytest
from live_server import WAIT_S, running
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from carina.errors import CarinaError
from carina.server.network.same_user import SOCKET_TABLES
from carina.server.serve import bind, start_url
from carina.server.wire import messages as wire


@pytest.mark.parametrize("same_user", [True, False])
def test_used_start_link_is_exchanged_for_a_cookie_again_only_for_the_same_user(live, monkeypatch, same_user):
    url = start_url(live.gate)
    with live.http() as http:
        first = http.get(url)
        assert (first.status_code, first.headers["location"]) == (303, "/")
        for part in ("HttpOnly", "SameSite=Strict", "Max-Age"):
            assert part in first.headers["set-cookie"]
    if not same_user:
        other = os.getuid() + 1
        monkeypatch.setattr("os.getuid", lambda: other)
    with live.http() as http:
        again = http.get(url)
        # Only Linux shows the user of a socket.
        is_accepted = same_user and SOCKET_TABLES[0].exists()
        assert again.status_code == (303 if is_accepted else 403)
        assert ("set-cookie" in again.headers) == is_accepted
    with live.http() as http:
        assert http.get(url + "x").status_code == 403
    with live.http(cookie=live.cookie) as http:
        # The printed link is loaded again in a window that already has the cookie.
        assert http.get(url).status_code == 303


def test_every_http_response_has_the_security_headers(live):
    with live.http() as http:
        for path in ("/", "/nothing", "/?token=x"):
            headers = http.get(path).headers
            assert headers["x-content-type-options"] == "nosniff"
            assert "default-src 'self'" in headers["content-security-policy"]
            assert headers["referrer-policy"] == "no-referrer"
            assert "server" not in headers


def test_start_page_states_that_the_web_client_was_not_built(live):
    with live.http() as http:
        page = http.get("/")
    assert page.status_code == 503
    assert "make run" in page.text


def test_http_server_serves_only_files_of_the_built_web_client(tmp_path):
    web = tmp_path / "_web"
    (web / "assets").mkdir(parents=True)
    (web / "index.html").write_text("<!doctype html><title>Carina</title>", encoding="utf-8")
    (web / "assets" / "app-1a2b.js").write_text("1;", encoding="utf-8")
    (tmp_path / "secret.txt").write_text("secret", encoding="utf-8")
    with running(tmp_path, web=web) as live, live.http() as http:
        assert http.get("/").headers["cache-control"] == "no-store"
        script = http.get("/assets/app-1a2b.js")
        assert script.headers["content-type"].startswith("text/javascript")
        assert "immutable" in script.headers["cache-control"]
        for path in (
            "/../secret.txt",
            "/%2e%2e/secret.txt",
            "/assets/..%2f..%2fsecret.txt",
            "/..%5csecret.txt",
            "/%00",
            "/" + "a" * 5000,
            "/" + "a/" * 5000,
            "//etc/passwd",
            "/assets",
        ):
            assert http.get(path).status_code == 404


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1:1"])
def test_http_request_with_another_host_header_is_refused(live, host):
    with live.http(cookie=live.cookie, host=host) as http:
        assert http.get("/").status_code == 403
        assert http.post("/api/upload", headers={"origin": f"http://{host}"}).status_code == 403


def test_websocket_without_an_origin_header_or_with_another_origin_is_refused(live):
    for origin in (None, "http://evil.example", "null"):
        with (
            pytest.raises(InvalidStatus) as refused,
            connect(
                f"ws://127.0.0.1:{live.gate.port}/ws",
                origin=origin,
                additional_headers={"Cookie": live.cookie},
                open_timeout=WAIT_S,
            ),
        ):
            pass
        assert refused.value.response.status_code == 403


def test_websocket_with_another_host_header_is_refused(live):
    with (
        pytest.raises(InvalidStatus),
        connect(
            f"ws://evil.example:{live.gate.port}/ws",
            sock=create_connection(("127.0.0.1", live.gate.port)),
            origin=f"http://evil.example:{live.gate.port}",
            additional_headers={"Cookie": live.cookie},
            open_timeout=WAIT_S,
        ),
    ):
        pass


def test_websocket_without_the_access_cookie_is_refused_with_the_reason(live):
    with connect(f"ws://127.0.0.1:{live.gate.port}/ws", origin=live.origin, open_timeout=WAIT_S) as socket:
        with pytest.raises(ConnectionClosed) as closed:
            socket.recv(timeout=WAIT_S)
        assert closed.value.rcvd.code == 4401
        assert "link" in closed.value.rcvd.reason


def test_program_connects_with_the_secret_and_without_an_origin_header(live):
    with connect(
        f"ws://127.0.0.1:{live.gate.port}/ws",
        additional_headers={"Authorization": f"Bearer {live.gate.secret}"},
        open_timeout=WAIT_S,
    ) as socket:
        socket.send(wire.encode_message(wire.ClientHello(wire.WIRE_VERSION)))
        assert json.loads(socket.recv(timeout=WAIT_S))["type"] == "hello"


@pytest.mark.parametrize(
    "origin",
    [
        "null",
        "",
        "file://",
        "https://{host}",
        "http://{host}/",
        "http://{host}.evil.example",
        "http://localhost:{port}",
    ],
)
def test_websocket_with_another_origin_is_refused_even_with_the_secret(live, origin):
    host = f"127.0.0.1:{live.gate.port}"
    sent = origin.format(host=host, port=live.gate.port)
    with live.http(authorization=f"Bearer {live.gate.secret}", origin=sent) as http:
        assert http.post("/api/upload").status_code == 403


def test_server_start_on_a_port_in_use_is_refused_with_a_message():

    with bind("127.0.0.1", 0) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(CarinaError, match=f"port {port} is in use") as refused:
            bind("127.0.0.1", port)
        assert refused.value.code == "server.port"
    with pytest.raises(CarinaError, match="no such address"):
        bind("no-such-name.invalid", 0)
