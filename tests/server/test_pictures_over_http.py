"""Tests of saved pictures over HTTP: access, the window's own sight, and refusals as messages."""

from __future__ import annotations

import socket
import threading
import time
from types import SimpleNamespace

from live_server import WAIT_S, open_case

from carina.errors import CancelledError
from carina.server.wire import messages as wire

SIZE = {"width": 64, "height": 48, "full_width": 64, "scale": 1}


def test_picture_requires_the_cookie_and_an_open_case(live):
    with live.http() as unauthenticated:
        assert unauthenticated.get("/api/pictures/axial.png", params=SIZE | {"window": 1}).status_code == 401
    with live.http(cookie=live.cookie) as http:
        answer = http.get("/api/pictures/axial.png", params=SIZE | {"window": 1})
        assert answer.status_code == 409
        assert "no case" in answer.json()["message"]


def test_picture_shows_the_sight_of_the_window_that_requests_it(live, monkeypatch):
    # The renderer of the small case returns pictures without the methods of a picture.
    png = SimpleNamespace(png=lambda *, badges: b"\x89PNG" + str(len(badges)).encode())
    monkeypatch.setattr("carina.server.files.pictures.finish_case_picture", lambda *_marks, **_of: png)
    with live.window() as window, live.window() as other, live.http(cookie=live.cookie) as http:
        first, second = (next(m.window for m in one.seen if isinstance(m, wire.ServerHello)) for one in (window, other))
        assert first != second
        open_case(window)
        window.send(wire.SetWindow(400.0, 40.0))
        window.until_state(lambda s: s.sight.window is not None)
        seen = {
            number: live.session.scene(number).spec("axial", 64, 48, 0.5, full_width=64).window_hu
            for number in (first, second)
        }
        assert seen[first] == (400.0, 40.0) != seen[second]
        answer = http.get("/api/pictures/axial.png", params=SIZE | {"window": first})
        assert answer.status_code == 200, answer.text
        assert answer.headers["content-type"] == "image/png"
        assert answer.headers["content-disposition"] == 'attachment; filename="axial.png"'
        assert answer.content == b"\x89PNG1"


def test_picture_with_invalid_parameters_is_refused_with_a_message(live):
    with live.window() as window, live.http(cookie=live.cookie) as http:
        open_case(window)
        for view, change in (("axial", {"width": 0}), ("axial", {"scale": 9}), ("oblique", {})):
            answer = http.get(f"/api/pictures/{view}.png", params=SIZE | {"window": 1} | change)
            assert answer.status_code == 409
            assert answer.json()["message"]


def test_picture_stops_when_the_browser_disconnects(live, monkeypatch):
    started, stopped = threading.Event(), threading.Event()

    def slow(_pictures, _view, _order, _requested, stop):
        started.set()
        while not stop.cancelled and not live.session.jobs._closed:
            time.sleep(0.01)
        stopped.set()
        raise CancelledError("given up")

    monkeypatch.setattr("carina.server.files.pictures.Pictures._png", slow)
    with live.window() as window:
        open_case(window)
        host = f"127.0.0.1:{live.gate.port}"
        with socket.create_connection(("127.0.0.1", live.gate.port)) as browser:
            path = "/api/pictures/axial.png?window=1&width=64&height=48&full_width=64&scale=1"
            browser.sendall(f"GET {path} HTTP/1.1\r\nHost: {host}\r\nCookie: {live.cookie}\r\n\r\n".encode())
            assert started.wait(WAIT_S)
        assert stopped.wait(WAIT_S)


FILM = {"flight": "route", "width": 64, "height": 48, "window": 1}


def test_video_requires_the_cookie_the_origin_and_a_case(live):
    with live.http(origin=live.origin) as unauthenticated:
        assert unauthenticated.post("/api/films", params=FILM).status_code == 401
        assert unauthenticated.get("/api/films/job-1").status_code == 401
        assert unauthenticated.get("/api/forks.png").status_code == 401
    with live.http(cookie=live.cookie) as http:
        assert http.post("/api/films", params=FILM).status_code == 403
    with live.http(cookie=live.cookie, origin=live.origin) as http:
        for answer in (
            http.post("/api/films", params=FILM),
            http.post("/api/films", params=FILM | {"flight": "key_frames"}),
            http.get("/api/films/job-1"),
            http.get("/api/forks.png"),
        ):
            assert answer.status_code == 409
            assert answer.json()["message"]


def test_start_message_names_the_command_if_this_installation_makes_no_videos(live, monkeypatch):
    monkeypatch.setattr("carina.server.windows.broadcast_cache.video_problem", lambda: "videos need PyAV: do this")
    with live.window() as window:
        assert window.received(lambda m: isinstance(m, wire.Start)).no_video == "videos need PyAV: do this"
