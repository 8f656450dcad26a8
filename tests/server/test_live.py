"""The whole server on loopback: real sockets, real threads, a small case. Waits are bounded and end on events."""

from __future__ import annotations

import asyncio
import contextlib
import gzip
import json
import threading
from dataclasses import dataclass
from socket import create_connection
from types import SimpleNamespace

import httpx
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from carina.errors import CarinaError
from carina.render import TransferFunction
from carina.server import messages as wire
from carina.server.downloads import Downloads
from carina.server.security import Gate
from carina.server.serve import bind, make_server, start_url
from carina.server.uploads import Limits, Uploads
from carina.session import LocalStore, Session
from small_case import BRANCHES_IJK, SmallRenderer, small_airways, small_lumen, small_parts, small_volume

WAIT_S = 10.0
"""Bound of every wait; what is waited for takes milliseconds."""


@dataclass
class Live:
    """A running server."""

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
        """A client as the browser is one: cookie and origin."""
        with connect(
            f"ws://127.0.0.1:{self.gate.port}/ws",
            origin=self.origin,
            additional_headers={"Cookie": self.cookie},
            compression=None,
            open_timeout=WAIT_S,
        ) as socket:
            yield Window(socket, hello=hello)


class Window:
    """What a client sent and saw."""

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
        """The first message that is wanted; pictures are acknowledged on the way."""
        while True:
            message = self.next()
            if acknowledge and isinstance(message, wire.PictureHeader):
                self.send(wire.Ack(message.frame_id))
            if wanted(message):
                return message

    def until_state(self, wanted):
        return self.until(lambda m: isinstance(m, wire.State) and wanted(m))

    def close_code(self):
        with pytest.raises(ConnectionClosed) as closed:
            self.until(lambda _message: False)
        return closed.value.rcvd.code, closed.value.rcvd.reason


@contextlib.contextmanager
def running(tmp_path, *, web=None, **replaced):
    opened = []
    parts = small_parts(**replaced)

    def open_volume(path, progress, cancel):
        opened.append(path)
        return small_parts(**replaced).open_volume(path, progress, cancel)

    parts = small_parts(**({"open_volume": open_volume} | replaced))
    session = Session(SmallRenderer, parts=parts, store=LocalStore(tmp_path / "config"))
    uploads = Uploads(Limits(num_files=20, total_bytes=10_000, file_bytes=5000))
    with bind("127.0.0.1", 0) as sock:
        gate = Gate(host="127.0.0.1", port=sock.getsockname()[1])
        started = threading.Event()
        server = make_server(session, gate, on_started=started.set, web=web, uploads=uploads)
        thread = threading.Thread(target=lambda: server.run(sockets=[sock]), daemon=True)
        thread.start()
        try:
            assert started.wait(WAIT_S)
            yield Live(gate, session, uploads, opened)
        finally:
            server.should_exit = True
            thread.join(WAIT_S)
            assert not thread.is_alive()


@pytest.fixture
def live(tmp_path):
    with running(tmp_path) as live:
        yield live


def lps(ijk):
    return tuple(float(v) for v in small_volume().to_lps(ijk))


SHOWN = wire.Layout((wire.ViewSize("airway", 160, 120), wire.ViewSize("axial", 80, 60), wire.ViewSize("tree", 64, 48)))


def open_case(window, path="case"):
    window.send(wire.OpenPath(path))
    return window.until_state(lambda s: s.airways == "found")


# ---------------------------------------------------------------- getting in


def test_the_link_is_exchanged_for_a_cookie_once(live):
    url = start_url(live.gate)
    with live.http() as http:
        first = http.get(url)
        assert (first.status_code, first.headers["location"]) == (303, "/")
        assert "HttpOnly" in first.headers["set-cookie"]
        assert "SameSite=Strict" in first.headers["set-cookie"]
    with live.http() as http:
        again = http.get(url)
        assert again.status_code == 403
        assert "set-cookie" not in again.headers
    with live.http(cookie=live.cookie) as http:
        # A reload of the printed link in the window that is already in.
        assert http.get(url).status_code == 303


def test_every_answer_has_the_security_headers(live):
    with live.http() as http:
        for path in ("/", "/nothing", "/?token=x"):
            headers = http.get(path).headers
            assert headers["x-content-type-options"] == "nosniff"
            assert "default-src 'self'" in headers["content-security-policy"]
            assert headers["referrer-policy"] == "no-referrer"
            assert "server" not in headers


def test_a_page_says_so_where_the_client_was_not_built(live):
    with live.http() as http:
        page = http.get("/")
    assert page.status_code == 503
    assert "make run" in page.text


def test_the_built_client_is_served_and_nothing_beside_it(tmp_path):
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
def test_another_host_is_refused(live, host):
    with live.http(cookie=live.cookie, host=host) as http:
        assert http.get("/").status_code == 403
        assert http.post("/api/upload", headers={"origin": f"http://{host}"}).status_code == 403


def test_a_socket_without_or_with_another_origin_does_not_open(live):
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


def test_a_socket_with_another_host_does_not_open(live):
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


def test_a_socket_without_the_cookie_is_told_why(live):
    with connect(f"ws://127.0.0.1:{live.gate.port}/ws", origin=live.origin, open_timeout=WAIT_S) as socket:
        with pytest.raises(ConnectionClosed) as closed:
            socket.recv(timeout=WAIT_S)
        assert closed.value.rcvd.code == 4401
        assert "link" in closed.value.rcvd.reason


def test_a_program_comes_in_with_the_secret_and_without_an_origin(live):
    with connect(
        f"ws://127.0.0.1:{live.gate.port}/ws",
        additional_headers={"Authorization": f"Bearer {live.gate.secret}"},
        open_timeout=WAIT_S,
    ) as socket:
        socket.send('{"type": "hello", "wire_version": 1}')
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
def test_an_origin_that_is_not_exactly_ours_is_refused_even_with_the_secret(live, origin):
    host = f"127.0.0.1:{live.gate.port}"
    sent = origin.format(host=host, port=live.gate.port)
    with live.http(authorization=f"Bearer {live.gate.secret}", origin=sent) as http:
        assert http.post("/api/upload").status_code == 403


def test_uploads_on_a_disk_that_takes_nothing_are_refused_in_words(live, monkeypatch):
    def full(**_options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tempfile.mkdtemp", full)
    with live.http(authorization=f"Bearer {live.gate.secret}") as http:
        answer = http.post("/api/upload")
    assert answer.status_code == 507
    assert "No space left" in answer.json()["message"]


def test_the_airways_are_taken_away_as_a_file_that_does_not_stay(live, tmp_path, monkeypatch):
    made = []

    def export(path, volume, airways):
        path.write_text(f"{path.name} {volume.shape_zyx} {len(airways.tree.branches)}")
        made.append(path)
        return path

    monkeypatch.setattr(Downloads.__init__, "__defaults__", (export,))
    with running(tmp_path / "own") as own, own.window() as window:
        with own.http() as stranger:
            assert stranger.get("/api/airways.stl").status_code == 401
        with own.http(cookie=own.cookie) as http:
            early = http.get("/api/airways.stl")
            assert early.status_code == 409
            assert "no case" in early.json()["message"]
            open_case(window)
            answer = http.get("/api/airways.nii.gz")
            assert answer.status_code == 200
            assert answer.headers["content-disposition"] == 'attachment; filename="airways.nii.gz"'
            assert answer.text.startswith("airways.nii.gz (")
            for wrong in (".exe", ".stl/../x", "/../../etc/passwd", ""):
                assert http.get(f"/api/airways{wrong}").status_code in {403, 404}
            # Removed after the last byte, before the next answer of this connection.
            (path,) = made
            assert not path.parent.exists()


def test_a_file_does_not_stay_when_a_part_of_it_is_asked_for_that_it_does_not_have(live, tmp_path, monkeypatch):
    def export(path, *_parts):
        path.write_text("short")
        return path

    monkeypatch.setattr(Downloads.__init__, "__defaults__", (export,))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with running(tmp_path / "own") as own, own.window() as window, own.http(cookie=own.cookie) as http:
        open_case(window)
        for part in ("bytes=900-", "bytes=x-y", "bytes=0-1"):
            http.get("/api/airways.stl", headers={"range": part})
        http.head("/api/airways.stl")
        assert http.get("/api/airways.stl").text == "short"
    assert not list(tmp_path.glob("carina-download-*"))


def test_a_file_does_not_stay_when_the_server_ends_while_it_is_made(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    begun, may_end = threading.Event(), threading.Event()

    def export(path, *_parts):
        begun.set()
        assert may_end.wait(WAIT_S)
        # As one that writes its file at the end.
        path.parent.mkdir(exist_ok=True)
        path.write_text("the anatomy of somebody")
        return path

    async def ends_meanwhile():
        answering = asyncio.create_task(
            Downloads(SimpleNamespace(airways_to_take_away=lambda: (1, 2)), export).answer(".stl")
        )
        await asyncio.to_thread(begun.wait, WAIT_S)
        answering.cancel()
        with pytest.raises(asyncio.CancelledError):
            await answering
        may_end.set()

    asyncio.run(ends_meanwhile())
    assert not list(tmp_path.iterdir())


def test_a_file_that_cannot_be_made_is_refused_in_words(live, tmp_path, monkeypatch):
    def export(path, *_parts):
        path.write_text("half")
        raise CarinaError("the disk is full", code="export.disk")

    monkeypatch.setattr(Downloads.__init__, "__defaults__", (export,))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with running(tmp_path / "own") as own, own.window() as window, own.http(cookie=own.cookie) as http:
        open_case(window)
        answer = http.get("/api/airways.json")
    assert answer.status_code == 507
    assert answer.json()["message"] == "the disk is full"
    assert not list(tmp_path.glob("carina-download-*"))


def test_a_file_in_the_place_of_a_folder_is_refused_in_words(live):
    with live.http(authorization=f"Bearer {live.gate.secret}") as http:
        upload = http.post("/api/upload").json()["upload_id"]
        assert http.put(f"/api/upload/{upload}", params={"name": "a"}, content=b"1").status_code == 201
        for name in ("a/b", "a/b/c"):
            answer = http.put(f"/api/upload/{upload}", params={"name": name}, content=b"1")
            assert answer.status_code == 507
            assert "could not be stored" in answer.json()["message"]
    assert live.uploads.place(upload).read_bytes() == b"1"


def test_thousands_of_steers_and_acks_of_frames_never_sent_leave_the_session_answering(live):
    with live.window() as window:
        window.send(SHOWN)
        open_case(window)
        # 3000: three minutes of a 16 ms loop at once. Each moves 0.001 mm.
        window.send(*(wire.Steer(0.001, 0.0, 0.0, 0.0) for _ in range(3000)))
        window.send(*(wire.Ack(10**9 + n) for n in range(1000)))
        window.send(wire.SetFov(77.0))
        window.until_state(lambda s: s.fov_deg == 77.0)
        window.until(lambda m: isinstance(m, wire.PictureHeader) and m.full)
        last = live.session.pose_info()
        assert last.path_mm == pytest.approx(3.0)


# ---------------------------------------------------------------- the conversation


def test_the_first_messages_are_all_that_the_start_page_needs(live):
    with live.window() as window:
        start = window.until(lambda m: isinstance(m, wire.Start))
        assert not start.notice_accepted
        assert [d.name for d in start.demos] == ["phantom", "patient"]
        state = window.until_state(lambda s: True)
        assert (state.case, state.stage) == (None, "empty")
        window.send(wire.AcceptNotice())
        assert window.until(lambda m: isinstance(m, wire.Start)).notice_accepted


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("not json", 4400),
        ('{"type": "go_to", "path_mm": NaN}', 4400),
        ('{"type": "launch"}', 4400),
        ('{"type": "undo", "twice": true}', 4400),
        (b"\x00\x01", 4400),
    ],
)
def test_one_bad_message_closes_the_socket_with_its_code_and_a_sentence(live, text, code):
    with live.window() as window:
        window.socket.send(text)
        closed, reason = window.close_code()
        assert closed == code
        assert len(reason) > 15


def test_another_wire_version_and_a_missing_hello_are_refused(live):
    with live.window(hello=False) as window:
        window.send(wire.ClientHello(99))
        assert window.close_code()[0] == 4402
    with live.window(hello=False) as window:
        window.send(wire.Undo())
        assert window.close_code()[0] == 4403


def test_a_second_hello_is_answered_with_an_error(live):
    with live.window() as window:
        window.send(wire.ClientHello(wire.WIRE_VERSION))
        assert window.until(lambda m: isinstance(m, wire.Error)).code == "protocol.order"


def test_a_message_over_the_limit_closes_the_socket(live):
    with live.window() as window:
        window.socket.send('{"type": "open_path", "path": "' + "x" * 300_000 + '"}')
        assert window.close_code()[0] in {1009, 4400}


def test_a_command_that_cannot_be_done_is_answered_and_the_socket_stays_open(live):
    with live.window() as window:
        window.send(wire.NextFork())
        error = window.until(lambda m: isinstance(m, wire.Error))
        assert (error.code, error.message) == ("session.no-case", "no case is open")
        open_case(window)


@pytest.mark.parametrize(
    ("message", "words"),
    [
        ({"type": "set_fov", "fov_deg": 171}, ["170", "171"]),
        ({"type": "set_fov", "fov_deg": 59}, ["60", "59"]),
        ({"type": "layout", "views": [{"view": "airway", "width": 0, "height": 64}]}, ["16", "0"]),
        ({"type": "layout", "views": [{"view": "airway", "width": 8193, "height": 64}]}, ["4096", "8193"]),
    ],
)
def test_a_value_out_of_range_closes_the_socket_with_the_value_and_the_range(live, message, words):
    with live.window() as window:
        window.socket.send(json.dumps(message))
        closed, reason = window.close_code()
        assert closed == 4400
        assert all(word in reason for word in words), reason


@pytest.mark.parametrize(
    ("points", "words"),
    [
        ([], "at least one point"),
        ([[5, 1, 1, 1, 0], [4, 1, 1, 1, 1]], "found 4 at point 1 after 5"),
        ([[0, 1, 2, 1, 0.5]], "0 to 1; found at point 0"),
    ],
)
def test_a_transfer_function_that_is_none_is_refused_in_words_and_the_old_one_stays(tmp_path, points, words):
    with running(tmp_path, transfer_from_json=TransferFunction.from_json) as live, live.window() as window:
        before = open_case(window)
        document = {"format": "carina-transfer", "version": 1, "points": points}
        window.send(wire.SetTransfer(preset=None, document=document))
        error = window.until(lambda m: isinstance(m, wire.Error))
        assert error.code == "render.transfer"
        assert words in error.message
        window.send(wire.SetShading(on=not before.shading))
        assert window.until_state(lambda s: s.shading is not before.shading).transfer == before.transfer


def test_the_fine_texture_is_switched_off_and_undone_over_the_wire(live):
    with live.window() as window:
        assert open_case(window).texture
        window.send(wire.SetTexture(on=False))
        assert window.until_state(lambda s: not s.texture).can_undo == "fine texture"
        window.send(wire.Undo())
        window.until_state(lambda s: s.texture)


def test_opening_a_case_brings_state_tree_route_pose_and_pictures_of_all_views(live):
    with live.window() as window:
        window.send(SHOWN)
        state = open_case(window)
        assert state.case.title == "Thorax 1.5"
        assert state.case.other_series[0].refused == "too few slices"
        window.until(lambda m: isinstance(m, wire.PictureHeader) and m.view == "tree" and m.full)
        trees = [m.tree for m in window.seen if isinstance(m, wire.Tree) and m.tree is not None]
        assert [b.name for b in trees[-1].branches] == ["Trachea", "RMB", "LMB", None]
        route = [m.route for m in window.seen if isinstance(m, wire.Route)].pop()
        assert route.branch_id == 3
        assert len(route.points_lps) == len(route.cumulative_mm) == len(route.generation) == len(route.radius_mm)
        assert {p.view for p in window.pictures} == {"airway", "axial", "tree"}
        (route,) = [m.route for m in window.seen if isinstance(m, wire.Route) and m.route is not None][-1:]


def test_flying_gives_newer_poses_and_never_an_older_one_after_a_newer(live):
    with live.window() as window:
        window.send(SHOWN)
        open_case(window)
        for _ in range(30):
            window.send(wire.Steer(0.5, 0.01, 0.0, 0.0))
            window.until(lambda m: isinstance(m, wire.Pose))
        last = [m for m in window.seen if isinstance(m, wire.Pose)][-1]
        assert last.path_mm == pytest.approx(15.0)
        still = window.until(
            lambda m: isinstance(m, wire.PictureHeader) and m.view == "airway" and m.full and m.pose_id >= last.pose_id
        )
        assert (still.width, still.height) == (160, 120)
        assert still.lps_from_camera == last.lps_from_camera
        for view in ("airway", "axial"):
            poses = [p.pose_id for p in window.pictures if p.view == view]
            assert poses == sorted(poses)
        # A picture names a pose that was told before it came, or with it: pose numbers only grow.
        poses = [m.pose_id for m in window.seen if isinstance(m, wire.Pose)]
        assert poses == sorted(set(poses))


def test_without_acks_no_more_than_three_airway_pictures_come(live):
    with live.window() as window:
        window.send(wire.Layout((wire.ViewSize("airway", 160, 120),)))
        window.send(wire.OpenPath("case"))
        window.until(lambda m: isinstance(m, wire.State) and m.airways == "found", acknowledge=False)
        for _ in range(20):
            window.send(wire.Steer(0.5, 0.0, 0.0, 0.0))
            window.until(lambda m: isinstance(m, wire.Pose), acknowledge=False)
        # An answer that comes after everything before it was handled.
        window.send(wire.SetFov(115.0))
        window.until(lambda m: isinstance(m, wire.State) and m.fov_deg == 115.0, acknowledge=False)
        while len(window.pictures) < 3:
            window.next()
        window.send(wire.SetFov(110.0))
        window.until(lambda m: isinstance(m, wire.State) and m.fov_deg == 110.0, acknowledge=False)
        assert len(window.pictures) == 3
        window.send(*(wire.Ack(p.frame_id) for p in window.pictures))
        newest = window.until(lambda m: isinstance(m, wire.PictureHeader))
        assert newest.pose_id == [m for m in window.seen if isinstance(m, wire.Pose)][-1].pose_id


def test_a_click_in_the_airway_view_is_answered_with_the_wall_point(live):
    with live.window() as window:
        window.send(SHOWN)
        open_case(window)
        shown = window.until(lambda m: isinstance(m, wire.PictureHeader) and m.view == "airway" and m.full)
        window.send(wire.Pick(pick_id=1, frame_id=shown.frame_id, column=80.5, row=60.5))
        nothing = window.until(lambda m: isinstance(m, wire.Picked))
        assert (nothing.pick_id, nothing.lps, nothing.depth_mm, nothing.voxel_value) == (1, None, None, None)
        # A voxel of tissue beside the trachea.
        wall = lps((18.2, 14.0, 30.0))
        live.session.scene().renderer.hit = SimpleNamespace(position_lps=np.array(wall), depth_mm=7.126)
        window.send(wire.Pick(pick_id=2, frame_id=shown.frame_id, column=12.0, row=100.0))
        found = window.until(lambda m: isinstance(m, wire.Picked))
        assert found == wire.Picked(2, wall, 7.13, 40, 0, "Trachea", 0)
        view, column, row = live.session.scene().renderer.picks[-1]
        assert (column, row) == (12, 100)
        np.testing.assert_array_equal(view.pose.lps_from_camera.ravel(), shown.lps_from_camera)
        window.send(wire.Pick(pick_id=3, frame_id=10_000_000, column=12.0, row=100.0))
        assert window.until(lambda m: isinstance(m, wire.Error)).code == "session.pick"


def test_the_asked_rate_is_told_and_another_can_be_asked_for(live):
    with live.window() as window:
        assert window.until_state(lambda s: True).frame_rate_hz == 60.0
        window.send(wire.SetFrameRate(24.0))
        assert window.until_state(lambda s: s.frame_rate_hz != 60.0).frame_rate_hz == 24.0
    with live.window() as later:
        assert later.until_state(lambda s: True).frame_rate_hz == 24.0


def test_a_refused_file_keeps_the_session_and_says_the_words_of_the_refusal(live):
    with live.window() as window:
        before = open_case(window)
        window.send(wire.OpenPath("/scans/bad"))
        error = window.until(lambda m: isinstance(m, wire.Error))
        assert error.message == "/scans/bad holds no images: choose a DICOM folder"
        assert window.until(lambda m: isinstance(m, wire.Done) and m.outcome == "failed")
        window.send(wire.SetFov(100.0))
        assert window.until_state(lambda s: s.fov_deg == 100.0).case == before.case


def test_targets_are_undone_and_done_again(live):
    left = lps(BRANCHES_IJK[2][1][1])
    with live.window() as window:
        open_case(window)
        window.send(wire.AddTarget(left))
        added = window.until_state(lambda s: len(s.targets) == 1)
        assert (added.can_undo, added.route_id) == ("add Target 1", "target-1")
        window.until(lambda m: isinstance(m, wire.Route) and m.route is not None and m.route.target_id == "target-1")
        window.send(wire.Undo())
        undone = window.until_state(lambda s: not s.targets)
        assert (undone.can_redo, undone.route_id) == ("add Target 1", "branch-3")
        window.send(wire.Redo())
        assert window.until_state(lambda s: len(s.targets) == 1).targets == added.targets


def test_a_change_that_leaves_tree_and_route_alone_does_not_send_them_again(live):
    with live.window() as window:
        open_case(window)

        def is_route(message):
            return isinstance(message, wire.Route) and message.route is not None

        # It may come before the state that says "found", and then comes once only.
        if not any(map(is_route, window.seen)):
            window.until(is_route)
        # Answers come in order, so after this one nothing of the opening is still on its way.
        window.send(wire.SetFov(95.0))
        window.until_state(lambda s: s.fov_deg == 95.0)
        window.seen.clear()
        for fov_deg in (100.0, 110.0, 120.0):
            window.send(wire.SetFov(fov_deg))
            window.until_state(lambda s, fov_deg=fov_deg: s.fov_deg == fov_deg)
        assert not [m for m in window.seen if isinstance(m, wire.Tree | wire.Route | wire.Pose)]


def test_a_search_can_be_cancelled_and_the_pictures_stay(tmp_path):
    reached, stopped = threading.Event(), threading.Event()

    def find_airways(volume, *, progress, cancel, **_options):
        progress("growing the lumen", 0.3)
        reached.set()
        while not cancel():
            stopped.wait(0.001)  # a real search looks as often
        progress("growing the lumen", 0.4)

    with running(tmp_path, find_airways=find_airways) as live, live.window() as window:
        window.send(SHOWN, wire.OpenPath("case"))
        job = window.until(lambda m: isinstance(m, wire.Progress) and m.what == "growing the lumen")
        assert (job.title, job.fraction) == ("finding the airways", 0.3)
        assert reached.wait(WAIT_S)
        window.until(lambda m: isinstance(m, wire.PictureHeader) and m.view == "airway")
        window.send(wire.Cancel(job.job_id))
        done = window.until(lambda m: isinstance(m, wire.Done) and m.job_id == job.job_id)
        assert done.outcome == "cancelled"
        window.send(wire.Steer(1.0, 0.0, 0.0, 0.0))
        pose = window.until(lambda m: isinstance(m, wire.Pose))
        window.until(lambda m: isinstance(m, wire.PictureHeader) and m.pose_id >= pose.pose_id and m.view == "airway")


def test_a_reload_gets_the_whole_state_and_fresh_pictures(live):
    with live.window() as window:
        window.send(SHOWN)
        before = open_case(window)
        window.send(wire.GoTo(20.0))
        pose = window.until(lambda m: isinstance(m, wire.Pose) and m.path_mm == 20.0)
    with live.window() as window:
        assert window.until_state(lambda s: True).case == before.case
        assert window.until(lambda m: isinstance(m, wire.Tree)).tree is not None
        assert window.until(lambda m: isinstance(m, wire.Route)).route is not None
        assert window.until(lambda m: isinstance(m, wire.Pose)) == pose
        window.send(SHOWN)
        for view in ("airway", "axial", "tree"):
            if view not in {p.view for p in window.pictures}:
                window.until(lambda m, view=view: isinstance(m, wire.PictureHeader) and m.view == view)


def test_a_second_window_takes_over_and_the_first_is_told(live):
    with live.window() as first:
        open_case(first)
        with live.window() as second:
            code, reason = first.close_code()
            assert (code, reason) == (4409, "Carina was opened in another window")
            second.send(SHOWN, wire.Steer(1.0, 0.0, 0.0, 0.0))
            second.until(lambda m: isinstance(m, wire.PictureHeader))


# ---------------------------------------------------------------- dropped files


def test_dropped_files_are_opened_and_removed(live):
    with live.http(cookie=live.cookie, origin=live.origin) as http, live.window() as window:
        upload_id = http.post("/api/upload").json()["upload_id"]
        for name in ("s/1.dcm", "../../2.dcm"):
            assert http.put(f"/api/upload/{upload_id}", params={"name": name}, content=b"x" * 10).status_code == 201
        folder = live.uploads._uploads[upload_id].folder
        assert sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()) == [
            "2.dcm",
            "s/1.dcm",
        ]
        window.send(wire.OpenUpload(upload_id))
        window.until(lambda m: isinstance(m, wire.Done))
        assert live.opened == [str(folder)]
        # Answered after the end of the job was handled, and with it the removal.
        window.send(wire.OpenUpload(upload_id))
        assert window.until(lambda m: isinstance(m, wire.Error)).code == "upload.gone"
        assert not folder.exists()
        assert live.session.store.recent() == ()


def nrrd(labels_zyx):
    """Labels on the small case's grid, as another tool writes them."""
    matrix = small_volume().lps_from_ijk
    axes = " ".join(f"({x!r},{y!r},{z!r})" for x, y, z in matrix[:3, :3].T.tolist())
    origin = "({!r},{!r},{!r})".format(*matrix[:3, 3].tolist())
    header = (
        "NRRD0004\ntype: uint8\ndimension: 3\nspace: left-posterior-superior\n"
        f"sizes: {' '.join(str(n) for n in labels_zyx.shape[::-1])}\nspace directions: {axes}\n"
        f"space origin: {origin}\nkinds: domain domain domain\nendian: little\nencoding: gzip\n\n"
    )
    return header.encode() + gzip.compress(labels_zyx.tobytes())


def test_a_dropped_mask_is_kept_until_its_question_is_answered_and_takes_the_place_of_the_airways(tmp_path):
    def find_airways(volume, *, lumen_zyx=None, notes=(), **_options):
        airways = small_airways(volume)
        if lumen_zyx is not None:
            airways.lumen_zyx, airways.report, airways.threshold = lumen_zyx, list(notes), float("nan")
        return airways

    labels = small_lumen() * 3
    labels[0, 0, 0] = 1
    with running(tmp_path, find_airways=find_airways) as live, live.window() as window:
        assert open_case(window).airways_from == "search"
        with live.http(cookie=live.cookie, origin=live.origin) as http:
            upload_id = http.post("/api/upload").json()["upload_id"]
            sent = http.put(f"/api/upload/{upload_id}", params={"name": "airway.nrrd"}, content=nrrd(labels))
            assert sent.status_code == 201
        folder = live.uploads._uploads[upload_id].folder
        window.send(wire.ImportMask(upload_id))
        asked = window.until_state(lambda s: s.mask_question is not None)
        assert [label.number for label in asked.mask_question.labels] == [1, 3]
        assert (asked.airways_from, asked.can_undo) == ("search", None)
        assert (folder / "airway.nrrd").exists()
        window.send(wire.AnswerMask(3, False))
        taken = window.until_state(lambda s: s.airways_from == "mask")
        assert (taken.can_undo, taken.mask_question) == ("take the mask as airways", None)
        assert (taken.airways_words, taken.lumen_threshold) == ("the lumen is the mask airway.nrrd", None)
        window.send(wire.Undo())
        assert window.until_state(lambda s: s.airways_from == "search").can_redo == "take the mask as airways"
        assert not folder.exists()


def test_a_mask_without_a_case_or_without_its_upload_is_refused(live):
    with live.http(cookie=live.cookie, origin=live.origin) as http, live.window() as window:
        upload_id = http.post("/api/upload").json()["upload_id"]
        assert http.put(f"/api/upload/{upload_id}", params={"name": "m.nrrd"}, content=b"x").status_code == 201
        window.send(wire.ImportMask(upload_id))
        assert window.until(lambda m: isinstance(m, wire.Error)).code == "session.no-case"
        window.send(wire.ImportMask(upload_id))
        assert window.until(lambda m: isinstance(m, wire.Error)).code == "upload.gone"
        window.send(wire.AnswerMask(1, False))
        assert window.until(lambda m: isinstance(m, wire.Error)).code == "session.no-case"


def test_uploads_need_the_cookie_and_the_origin_and_keep_their_bounds(live):
    with live.http(origin=live.origin) as http:
        assert http.post("/api/upload").status_code == 401
        assert http.put("/api/upload/x").status_code == 401
    with live.http(cookie=live.cookie) as http:
        assert http.post("/api/upload").status_code == 403
    with live.http(cookie=live.cookie, origin=live.origin) as http:
        upload_id = http.post("/api/upload").json()["upload_id"]
        big = http.put(f"/api/upload/{upload_id}", params={"name": "a"}, content=b"x" * 5001)
        assert (big.status_code, big.json()["code"]) == (413, "upload.limit")
        assert http.put("/api/upload/other", params={"name": "a"}, content=b"x").status_code == 404
        assert http.delete(f"/api/upload/{upload_id}").status_code == 204
        assert http.put(f"/api/upload/{upload_id}", params={"name": "a"}, content=b"x").status_code == 404


def test_a_port_in_use_says_so():
    from carina.errors import CarinaError

    with bind("127.0.0.1", 0) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(CarinaError, match=f"port {port} is in use") as refused:
            bind("127.0.0.1", port)
        assert refused.value.code == "server.port"
    with pytest.raises(CarinaError, match="no such address"):
        bind("no-such-name.invalid", 0)
