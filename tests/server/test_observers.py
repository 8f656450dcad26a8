"""Tests of observers over the network: a link that can be revoked, a window that changes nothing, and one case only."""

from __future__ import annotations

import asyncio
import contextlib

import httpx
import pytest
from live_server import SHOWN, WAIT_S
from observers import insecure, page_of, sharing, watching

from carina import commands
from carina.commands import all_commands
from carina.commands.value import LocalCommand
from carina.errors import UsageError
from carina.render import Sight
from carina.server.files.uploads import Limits, Uploads
from carina.server.hub import Hub
from carina.server.observers.page import MAX_WATCHERS
from carina.server.observers.window import READ_ONLY
from carina.server.wire import messages as wire
from carina.session import OpeningInfo
from carina.volume.opening_preview import OpeningPreview
from small_case import LEFT_TIP, session_fixture

pytest.importorskip("cryptography")


@pytest.fixture
def shared_case(tmp_path, monkeypatch):
    """Provide the user's window of a workstation on which a case and the page for observers are open."""
    with sharing(tmp_path, monkeypatch) as shared:
        yield shared


def fields(value):
    """Return all texts in a message, at any depth."""
    return wire.encode_message(value)


def test_observer_sees_the_case_and_the_flight_with_separate_view_settings(shared_case):
    live, window, page = shared_case
    with watching(page.url) as watcher:
        watcher.send(SHOWN)
        watcher.until_state(lambda s: s.case is not None)
        for kind in (wire.Tree, wire.RouteMessage, wire.KeyFramesMessage, wire.PoseMessage):
            watcher.received(lambda m, kind=kind: isinstance(m, kind))
        window.send(wire.GoTo(20.0))
        pose = watcher.until(lambda m: isinstance(m, wire.PoseMessage) and m.path_mm == 20.0)
        watcher.until(lambda m: isinstance(m, wire.PictureHeader) and m.view == "airway" and m.pose_id == pose.pose_id)
        before = live.session.snapshot().sight
        watcher.send(wire.SetCrosshair(LEFT_TIP), wire.SetTexture(on=False))
        assert watcher.until_state(lambda s: not s.sight.texture).sight.crosshair_lps == LEFT_TIP
        assert live.session.snapshot().sight is before, "the stored view settings are those of the user"
        page_state = page_of(window, lambda page: page is not None and page.watchers)
        assert [w.address for w in page_state.watchers] == ["127.0.0.1"]
    assert page_of(window, lambda page: page is not None and not page.watchers).url == page.url


def test_pictures_sent_to_an_observer_are_at_most_as_large_as_a_screen(shared_case):
    _live, _window, page = shared_case
    with watching(page.url) as watcher:
        watcher.send(wire.Layout((wire.ViewSize("axial", 4096, 2048),)))
        picture = watcher.until(lambda m: isinstance(m, wire.PictureHeader) and m.full)
        assert (picture.width, picture.height) == (1600, 800)


def test_session_refuses_every_command_of_an_observer_except_view_settings():
    fixture = session_fixture()
    fixture.open()
    fixture.session.subscribe(lambda _event: None, window=7, watches=True)
    before = (fixture.session.snapshot(), fixture.session.history(), fixture.session.pose_info())
    refused = allowed = 0
    for cls in all_commands():
        if cls.sets in Sight.__struct_fields__:
            allowed += 1
            continue
        # The session checks the caller first, so the values of the fields do not matter.
        command = cls(**dict.fromkeys(cls.__struct_fields__))
        with pytest.raises(UsageError, match="you are watching") as refusal:
            fixture.session.do(command, window=7)
        assert refusal.value.code == "session.watching"
        refused += 1
    assert (fixture.session.snapshot(), fixture.session.history(), fixture.session.pose_info()) == before
    assert refused > 50 and allowed == 10
    fixture.session.do(commands.SetSlab(10.0, "max"), window=7)
    assert fixture.session.snapshot(7).sight.slab.thickness_mm == 10.0
    assert fixture.session.snapshot().sight == before[0].sight


def test_observer_does_not_see_another_case_and_cannot_change_it():
    fixture = session_fixture()
    fixture.open()
    end = fixture.session.subscribe(lambda _event: None, window=7, watches=True)
    fixture.session.do(commands.OpenPath("another"))
    fixture.background.run_all()
    assert fixture.session.snapshot().case_number == 2
    assert fixture.session.snapshot(7).case is None
    assert fixture.session.scene(7) is None
    end()
    with pytest.raises(UsageError, match="watching"):
        fixture.session.do(commands.SetTexture(on=False), window=7)
    with pytest.raises(UsageError, match="watching"):
        fixture.session.do(commands.Steer(1.0, 0.0, 0.0, 0.0), window=7)


def test_observer_page_requires_an_open_case(live):
    with live.window() as window:
        window.send(wire.SetWatchPage(on=True))
        assert window.until(lambda m: isinstance(m, wire.Error)).code in {"session.no-case", "watch.missing"}
    with pytest.raises(UsageError):
        session_fixture().session.subscribe(lambda _event: None, window=1, watches=True)


def sample(cls):
    """Return a message of this class from the samples of the protocol."""
    import json
    from pathlib import Path

    folder = Path(__file__).resolve().parents[2] / "protocol" / "valid" / "client"
    for path in sorted(folder.glob("*.json")):
        text = path.read_text(encoding="utf-8")
        if json.loads(text)["type"] == cls.__struct_config__.tag:
            return wire.parse_client_message(text)
    raise AssertionError(f"no sample of {cls.__name__}")


def test_observer_messages_that_open_save_list_or_use_devices_are_refused(shared_case):
    live, _window, page = shared_case
    before = (live.session.snapshot(), live.session.pose_info())
    with watching(page.url) as watcher:
        watcher.send(SHOWN)
        watcher.until_state(lambda s: s.case is not None)
        num = 0
        for cls in wire.CLIENT_MESSAGES.values():
            is_own = getattr(cls, "sets", None) in Sight.__struct_fields__
            if is_own or issubclass(cls, READ_ONLY) or issubclass(cls, LocalCommand):
                continue
            watcher.send(sample(cls))
            error = watcher.until(lambda m: isinstance(m, wire.Error))
            assert error.code == "session.watching", cls
            num += 1
        assert num > 60
    assert (live.session.snapshot(), live.session.pose_info()) == before


def test_observer_receives_no_folder_name_no_other_case_and_no_link(shared_case):
    live, window, page = shared_case
    live.session.store.remember("/scans/somebody/Miller^Anna/ct", "2026-01-01")
    with watching(page.url) as watcher:
        watcher.until_state(lambda s: s.case is not None)
        window.send(wire.SetPhone(on=True), wire.WatchDevices(on=True))
        window.until(lambda m: isinstance(m, wire.DevicesMessage))
        live.session._core.opening = OpeningInfo("job-9", "job-9", OpeningPreview((), "1", 1), str)
        live.session._core.changed("opening")
        window.until(lambda m: isinstance(m, wire.OpeningMessage) and m.job_id == "job-9")
        window.send(wire.OpenPath("/scans/somebody/bad"), wire.SetFov(80.0))
        watcher.until_state(lambda s: s.look.fov_deg == 80.0)
        start = watcher.received(lambda m: isinstance(m, wire.Start))
        assert (start.recent, start.storage) == ((), None)
        state = [m for m in watcher.seen if isinstance(m, wire.State)][-1]
        assert state.saving.copy_folder is None and state.saving.title is None
        assert state.case.other_series == ()
        kinds = {type(m) for m in watcher.seen}
        private = {wire.DevicesMessage, wire.Pen, wire.Watching, wire.Progress, wire.Notice, wire.Done}
        assert not kinds & (private | {wire.OpeningMessage})
        text = " ".join(fields(m) for m in watcher.seen)
        assert "somebody" not in text and "token" not in text and page.url.partition("#")[2] not in text


def test_observer_with_a_wrong_token_is_refused_and_counted(shared_case):
    _live, window, page = shared_case
    with watching(page.url, token="guess", hello=False) as watcher:
        code, reason = watcher.close_code()
        assert code == wire.CLOSE_CODES["protocol.not-authorised"]
        assert "no longer valid" in reason
    assert page_of(window, lambda page: page is not None and page.num_refused == 1)


def test_observer_page_refuses_plain_http_and_serves_only_the_web_client(shared_case):
    _live, _window, page = shared_case
    origin = page.url.partition("/#")[0]
    with pytest.raises(httpx.TransportError):
        httpx.get(origin.replace("https", "http"), timeout=WAIT_S)
    with httpx.Client(base_url=origin, verify=insecure(), timeout=WAIT_S) as client:
        assert client.get("/").text == "the client"
        for path in ("/api/airways.json", "/api/cases/1/picture.jpg", "/phone.html", "/..%2f..%2fetc/passwd"):
            assert client.get(path).status_code == 404, path
        assert client.post("/api/upload", headers={"origin": origin}).status_code in {404, 405}
        assert client.get("/", headers={"host": "evil.example"}).status_code == 403


def test_end_of_sharing_disconnects_all_observers_and_closes_the_port(shared_case):
    _live, window, page = shared_case
    with watching(page.url) as watcher:
        watcher.until_state(lambda s: s.case is not None)
        window.send(wire.SetWatchPage(on=False))
        assert watcher.close_code() == (4410, "the person at the workstation has stopped sharing the case")
    page_of(window, lambda page: page is None)
    with pytest.raises(ConnectionRefusedError), watching(page.url):
        pass
    # A new link has another token and another certificate.
    window.send(wire.SetWatchPage(on=True))
    again = page_of(window)
    assert again.sha256 != page.sha256
    with watching(again.url, token=page.url.partition("#")[2], hello=False) as watcher:
        assert watcher.close_code()[0] == 4401


def test_removed_observer_cannot_reconnect_with_the_same_link(shared_case):
    _live, window, page = shared_case
    with watching(page.url) as first, watching(page.url) as second:
        page_state = page_of(window, lambda page: page is not None and len(page.watchers) == 2)
        window.send(wire.SendAway(page_state.watchers[0].number))
        assert first.close_code() == (4410, "the person at the workstation has disconnected you")
        left = page_of(window, lambda page: page is not None and len(page.watchers) == 1)
        assert left.url != page.url
        window.send(wire.SetFov(81.0))
        second.until_state(lambda s: s.look.fov_deg == 81.0)
        with watching(page.url, hello=False) as again:
            assert again.close_code()[0] == 4401
    window.send(wire.SendAway(999))
    assert window.until(lambda m: isinstance(m, wire.Error)).code == "watch.gone"


@pytest.mark.parametrize("how", ["another", "closed"])
def test_sharing_ends_when_another_case_is_opened_or_the_case_is_closed(shared_case, how):
    _live, window, page = shared_case
    with watching(page.url) as watcher:
        watcher.send(SHOWN)
        watcher.until_state(lambda s: s.case is not None)
        window.send(wire.OpenPath("another") if how == "another" else wire.CloseCase())
        assert watcher.close_code() == (4410, "the case that you were watching was closed")
        assert {m.case.number for m in watcher.seen if isinstance(m, wire.State)} == {1}
    page_of(window, lambda page: page is None)


def test_maximum_number_of_observers_does_not_prevent_further_windows_of_the_user(shared_case):
    live, window, page = shared_case
    with contextlib.ExitStack() as opened:
        for _ in range(MAX_WATCHERS):
            opened.enter_context(watching(page.url))
        with watching(page.url, hello=False) as refused:
            assert refused.close_code()[0] == wire.CLOSE_CODES["protocol.too-many-windows"]
        with live.window() as another_neutral_path:
            another_neutral_path.until_state(lambda s: s.case is not None)
        window.send(wire.Steer(1.0, 0.0, 0.0, 0.0))
        window.until(lambda m: isinstance(m, wire.PoseMessage))


class OpenPage:
    """Viewing page that is open, without a server."""

    is_open, shares_learners = True, False

    async def stop(self, _words):
        self.shares_learners = False


@pytest.fixture
def hub(monkeypatch):
    made = Hub(session_fixture().session, Uploads(Limits(num_files=20, total_bytes=10_000, file_bytes=5000)))
    made._watch_page = OpenPage()
    monkeypatch.setattr("carina.server.hub.CLASSROOM_S", 0.01)
    yield made
    made.session.close()
    made._uploads.close()


def classroom_tasks():
    return [task for task in asyncio.all_tasks() if "_follow_classroom" in repr(task.get_coro()) and not task.done()]


def test_learners_that_are_shared_again_at_once_are_read_by_one_task(hub, monkeypatch):
    monkeypatch.setattr("carina.server.hub.CLASSROOM_S", 3.0)

    async def switch_quickly():
        for learners in (True, False, True, False, True):
            hub._share_learners(learners)
            await asyncio.sleep(0.0)
        assert len(classroom_tasks()) == 1
        hub._share_learners(False)
        await asyncio.sleep(0.0)
        assert classroom_tasks() == []
        hub._share_learners(True)
        await hub.close_watch_page("closed")
        await asyncio.sleep(0.0)
        assert classroom_tasks() == []

    asyncio.run(switch_quickly())


def test_reading_of_the_learners_continues_after_a_failure_which_is_logged(hub, monkeypatch, caplog):
    read = []

    def fail_twice(command):
        read.append(command)
        if len(read) < 3:
            raise OSError("the folder is gone")

    monkeypatch.setattr(hub.session, "do", fail_twice)

    async def read_until_it_succeeds():
        hub._share_learners(True)
        async with asyncio.timeout(60.0):
            while len(read) < 4:
                await asyncio.sleep(0.01)
        hub._share_learners(False)

    asyncio.run(read_until_it_succeeds())
    assert {type(command) for command in read} == {commands.ReadTrainingFiles}
    assert caplog.text.count("the learners could not be read for the teacher's view: OSError") == 2
