"""Tests of the page for a phone on loopback: certificate, token, refused and counted messages, movement of the tip."""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import itertools
import json
import math
import socket
import ssl
import subprocess
import sys
import time
from types import SimpleNamespace

import httpx
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidMessage

from carina.commands import CloseCase, SetMode, Steer
from carina.errors import CarinaError
from carina.navigate import PoseSample
from carina.navigate.pilot import CLUTCH_BUTTON
from carina.phone import PhoneSwitch
from carina.phone.link import MAX_BAD, ClockMap, PhoneLink
from carina.phone.page import qr_rows
from carina.server.devices import DeviceConnections
from carina.server.network.access_checks import TokenGate
from carina.server.network.lan_server import MAX_CONNECTIONS
from carina.server.wire import messages as wire
from encrypted_client import connected
from simulated_serial import wait_for
from small_case import session_fixture

WAIT_S = 120.0


def wxyz(axis: int, rad: float) -> list[float]:
    """Return the quaternion of a rotation about an axis of the pen: 0 right, 1 down, 2 forward."""
    turned = [math.cos(rad / 2), 0.0, 0.0, 0.0]
    turned[1 + axis] = math.sin(rad / 2)
    return turned


def sample(time_s: float, orientation=(1.0, 0.0, 0.0, 0.0), *, held=True, advance=0.0) -> str:
    turn = None if orientation is None else tuple(orientation)
    return wire.encode_message(wire.PhoneSample(time_s, turn, held, advance))


# ------------------------------------------------------------------ clock, token and messages without a network


def test_clock_offset_of_a_phone_is_that_of_the_message_with_the_least_delay():
    clock = ClockMap()
    delays_s = [0.080, 0.004, 0.250, 0.020]
    to_local_s = [clock.to_local_s(1000.0 + n / 60, 5.0 + n / 60 + delay_s) for n, delay_s in enumerate(delays_s)]
    # From the second message on all times are mapped as if each message had a delay of 4 ms.
    np.testing.assert_allclose(to_local_s[1:], [5.004 + n / 60 for n in (1, 2, 3)], atol=1e-9)
    assert to_local_s[0] <= 5.080


@pytest.mark.parametrize("jump_s", [-3600.0, -2.0, 1e9, -1e9])
def test_clock_offset_is_corrected_within_a_second_after_the_phone_clock_was_set(jump_s):
    clock = ClockMap()
    for n in range(10):
        clock.to_local_s(50.0 + n / 60, n / 60)
    late = [clock.to_local_s(50.0 + jump_s + n / 60, 1.0 + n / 60) - (1.0 + n / 60) for n in range(60)]
    assert late[-1] == pytest.approx(0.0, abs=1e-6)
    assert max(late) <= 1e-6, "no sample is from the future"


def test_extreme_time_sent_by_a_phone_affects_the_clock_offset_for_half_a_second():
    clock = ClockMap()
    clock.to_local_s(1e300, 0.0)
    late = [clock.to_local_s(50.0 + n / 60, 1.0 + n / 60) - (1.0 + n / 60) for n in range(60)]
    assert late[-1] == pytest.approx(0.0, abs=1e-9)


def test_only_the_phone_token_is_accepted_and_wrong_tokens_do_not_block_it():
    gate = TokenGate()
    assert gate.admits(gate.token)
    for n in range(1000):
        assert not gate.admits(f"wrong{n}")
    assert not gate.admits("w\u00f6rter")
    assert gate.admits(gate.token)
    assert gate.num_refused == 1001
    assert TokenGate().token != gate.token
    assert len(gate.token) >= 22  # 128 bits


def a_link(*, clutch="always"):
    samples: list[PoseSample] = []
    acts: list[str] = []
    link = PhoneLink(samples.append, acts.append, clutch_held_moves=lambda: clutch == "hold")
    return link, samples, acts


@pytest.mark.parametrize("clutch", ["always", "hold"])
@pytest.mark.parametrize("held", [True, False])
def test_tip_turns_only_while_the_phone_button_is_pressed_at_any_pen_setting(clutch, held):
    link, samples, _ = a_link(clutch=clutch)
    link.process_message(sample(1.0, held=held), 0.0)
    engaged = bool(samples[0].buttons >> CLUTCH_BUTTON & 1) == (clutch == "hold")
    assert engaged == held


def test_phone_without_a_sensor_advances_and_does_not_turn():
    link, samples, _ = a_link()
    link.process_message(sample(1.0, None, held=True, advance=1.0), 0.0)
    assert (samples[0].advance, samples[0].buttons, samples[0].position_mm) == (1.0, 1 << CLUTCH_BUTTON, None)


def test_invalid_phone_messages_are_counted_and_many_of_them_close_the_connection():
    link, samples, acts = a_link()
    bad = ["", "{", "[]", '{"type": "steer"}', sample(1.0).replace("true", "1"), "x" * 5000, None]
    bad.append(sample(1.0).replace("1.0", "NaN", 1))
    for n, text in enumerate(bad):
        link.process_message(text, 0.1 * n)
    assert samples == []
    assert sum(link.num_bad.values()) == len(bad)
    assert not link.is_broken
    link.process_message(wire.encode_message(wire.PhoneAct("recenter")), 1.0)
    link.process_message(sample(2.0), 1.1)
    assert (acts, len(samples)) == (["recenter"], 1)
    for n in range(MAX_BAD):
        link.process_message("{", 2.0 + n)
    assert link.is_broken


def test_phone_messages_above_the_rate_limit_are_dropped_unparsed_until_the_next_second():
    link, samples, _ = a_link()
    for n in range(5000):
        link.process_message(sample(n / 5000), n / 5000)
    assert 150 <= len(samples) <= 200  # 120 messages a second, and a burst of 60
    assert link.num_bad["too many samples"] == 5000 - len(samples)
    assert not link.is_broken
    before = len(samples)
    link.process_message(sample(3.0), 3.0)
    assert len(samples) == before + 1


def test_qr_code_of_the_phone_link_has_three_finder_patterns_and_a_quiet_zone():
    rows = qr_rows("https://192.0.2.7:50443/#" + "a" * 22)
    size = len(rows)
    assert all(len(row) == size and set(row) <= {"0", "1"} for row in rows)
    assert set("".join(rows[:4]) + "".join(row[:4] for row in rows)) == {"0"}
    eye = ["1111111", "1000001", "1011101", "1011101", "1011101", "1000001", "1111111"]
    for down, right in ((4, 4), (4, size - 11), (size - 11, 4)):
        assert [row[right : right + 7] for row in rows[down : down + 7]] == eye


def test_missing_phone_libraries_or_a_missing_page_are_reported_with_a_remedy(monkeypatch, tmp_path):
    with pytest.raises(CarinaError, match="make -C"):
        PhoneSwitch(session_fixture().session, tmp_path).start()
    (tmp_path / "phone.html").write_text("<!doctype html>")
    switch = PhoneSwitch(session_fixture().session, tmp_path)
    assert switch.problem is None
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "segno" else found(name))
    with pytest.raises(CarinaError, match=r"'segno>=") as refusal:
        switch.start()
    assert refusal.value.code == "phone.missing"
    assert switch.info() is None
    switch.stop()


def test_no_code_of_the_phone_page_is_loaded_before_the_user_opens_the_page():
    program = (
        "import sys; from carina.phone import PhoneSwitch; from carina.server import serve; "
        "from carina.session import Session; switch = PhoneSwitch(Session(lambda volume: None), None); switch.problem; "
        "sys.exit(any(m in sys.modules for m in ('carina.phone.page', 'carina.phone.certificate', 'cryptography')))"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


# ------------------------------------------------------------------ on loopback


@pytest.fixture
def web(tmp_path):
    """Return a folder with replacements of the files of the built client that the phone uses."""
    folder = tmp_path / "web"
    (folder / "assets").mkdir(parents=True)
    (folder / "phone.html").write_text("<!doctype html><title>phone</title>")
    (folder / "index.html").write_text("<!doctype html><title>workstation</title>")
    (folder / "assets" / "phone-1.js").write_text("// phone")
    (folder / "assets" / "index-1.js").write_text("// workstation")
    return folder


@pytest.fixture
def unhurried(monkeypatch):
    """Extend the deadlines to the limit of a test, so that a stall of ten seconds closes no connection.

    Tests of the deadlines set other values.
    """
    for name in (
        "carina.phone.page.HELLO_WITHIN_S",
        "carina.server.network.request_timeouts.FIRST_REQUEST_WITHIN_S",
        "carina.server.network.request_timeouts.BODY_WITHIN_S",
        "carina.server.network.lan_server.HANDSHAKE_WITHIN_S",
        "carina.server.network.lan_server.PING_EVERY_S",
        "carina.server.network.connection_limits.LIFE_S",
    ):
        monkeypatch.setattr(name, WAIT_S)


@pytest.fixture
def phone(web, unhurried):
    """Return an open page over the small case, as in the workstation."""
    fixture = session_fixture()
    fixture.session._core.clock = time.monotonic  # The thread of the device manager uses the real time.
    fixture.open()
    page = PhoneSwitch(fixture.session, web, address="127.0.0.1")
    sent: list[object] = []
    connections = DeviceConnections(fixture.session, sent.append, phone=page)
    connections.start()
    page.start()
    url, _, token = page.info().url.partition("#")
    yield SimpleNamespace(
        page=page, connections=connections, session=fixture.session, url=url, token=token, sent=sent, fixture=fixture
    )
    connections.stop()
    fixture.session.close()


def trusting(fingerprint: str) -> ssl.SSLContext:
    """Return the TLS settings of a user who accepted the warning; tests compare the certificate's fingerprint."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    assert fingerprint
    return context


@contextlib.contextmanager
def phone_connection(phone, *, token=None, origin=None, hello=True):
    base = phone.url.rstrip("/")
    context = trusting(phone.page.info().sha256)
    with connected(f"wss{base[5:]}/phone", origin=origin or base, context=context, within_s=WAIT_S) as link:
        if hello:
            link.send(wire.encode_message(wire.PhoneHello(wire.WIRE_VERSION, token or phone.token)))
        yield link


def state(link) -> wire.PhoneState:
    return wire.parse_to_phone_message(link.recv(timeout=WAIT_S))


def ended(link) -> tuple[int, str]:
    try:
        while True:
            link.recv(timeout=WAIT_S)
    except ConnectionClosed as closed:
        return closed.rcvd.code, closed.rcvd.reason


def get(phone, path, **headers):
    return httpx.get(f"{phone.url}{path}", verify=trusting("any"), headers=headers, timeout=WAIT_S)


def test_phone_certificate_has_the_shown_fingerprint_and_names_the_address(phone):
    host, port = phone.url[8:].rstrip("/").split(":")
    with (
        socket.create_connection((host, int(port)), timeout=WAIT_S) as plain,
        trusting("any").wrap_socket(plain) as secure,
    ):
        der = secure.getpeercert(binary_form=True)
        assert secure.version() in {"TLSv1.2", "TLSv1.3"}
    shown = phone.page.info().sha256
    assert hashlib.sha256(der).hexdigest() == shown.replace(":", "").lower()
    # A client that trusts only this certificate accepts it for this address, so name, dates and key usage are correct.
    strict = ssl.create_default_context(cadata=ssl.DER_cert_to_PEM_cert(der))
    assert httpx.get(phone.url, verify=strict, timeout=WAIT_S).status_code == 200
    from cryptography import x509

    constraints = x509.load_der_x509_certificate(der).extensions.get_extension_for_class(x509.BasicConstraints)
    assert not constraints.value.ca, "a leaf certificate: trust in it does not extend to other pages"


def test_phone_server_serves_only_the_page_and_its_files_and_none_contains_the_token(phone):
    answers = {path: get(phone, path) for path in ("", "assets/phone-1.js")}
    assert all(answer.status_code == 200 for answer in answers.values())
    assert all(phone.token not in answer.text for answer in answers.values())
    assert "default-src 'self'" in answers[""].headers["content-security-policy"]
    for path in (
        "index.html",
        "assets/index-1.js",
        "ws",
        "api/upload",
        "assets/..%2fphone.html",
        "assets/%00",
        "x" * 4000,
    ):
        assert get(phone, path).status_code in {404, 405}, path
    with pytest.raises(httpx.HTTPError):
        httpx.get(phone.url.replace("https", "http"), timeout=WAIT_S)


def test_phone_page_with_another_host_or_origin_is_refused(phone):
    assert get(phone, "", Host="evil.example").status_code == 403
    from websockets.exceptions import InvalidStatus

    with pytest.raises(InvalidStatus) as refused, phone_connection(phone, origin="https://evil.example"):
        pass
    assert refused.value.response.status_code == 403


def test_phone_with_a_wrong_token_without_a_token_or_without_a_message_is_refused_and_counted(phone, monkeypatch):
    with phone_connection(phone, token="wrong") as link:
        code, reason = ended(link)
    assert code == wire.CLOSE_CODES["protocol.not-authorised"]
    assert "scan the code" in reason
    with phone_connection(phone, hello=False) as link:
        link.send(sample(1.0))
        assert ended(link)[0] == wire.CLOSE_CODES["protocol.order"]
    monkeypatch.setattr("carina.phone.page.HELLO_WITHIN_S", 0.2)
    with phone_connection(phone, hello=False) as link:
        assert ended(link)[0] == wire.CLOSE_CODES["protocol.order"]
    info = phone.page.info()
    assert (info.num_refused, info.connected) == (1, False)
    assert phone.session.devices.info().devices == (), "no sample moved the tip"


def test_idle_unauthenticated_connections_do_not_block_a_phone_and_are_closed(phone, monkeypatch):
    monkeypatch.setattr("carina.server.network.request_timeouts.FIRST_REQUEST_WITHIN_S", 1.0)
    host, port = phone.url[8:].rstrip("/").split(":")
    with contextlib.ExitStack() as idle_connections, phone_connection(phone) as link:
        state(link)
        for n in range(MAX_CONNECTIONS):
            plain = idle_connections.enter_context(socket.create_connection((host, int(port)), timeout=WAIT_S))
            secure = idle_connections.enter_context(trusting("any").wrap_socket(plain))
            if n % 2:
                secure.sendall(b"GET / HTTP/1.1\r\nHost: never")
        wait_for(lambda: get(phone, "").status_code == 200, 60.0)
        # An authenticated connection stays open.
        link.send(sample(1.0))
        wait_for(lambda: phone.page.info().rate_hz > 0)


def test_request_timeout_of_a_connection_that_was_closed_logs_no_error(phone, monkeypatch, caplog):
    monkeypatch.setattr("carina.server.network.request_timeouts.FIRST_REQUEST_WITHIN_S", 0.5)
    for token in (None, "wrong"):
        with contextlib.ExitStack() as stack:

            def connect(stack=stack, token=token):
                # If the machine stalled for half a second, the connection was closed as unauthenticated.
                with contextlib.suppress(InvalidMessage):
                    return stack.enter_context(phone_connection(phone, token=token))

            link = wait_for(connect)
            _ = state(link) if token is None else ended(link)
    time.sleep(1.5)
    assert [r.getMessage() for r in caplog.records if r.levelname == "ERROR"] == []


def test_phone_turns_the_tip_while_its_button_is_pressed_and_advances_it(phone):
    phone.session.do(SetMode("free"))
    start = phone.session.pose_info().pose
    with phone_connection(phone) as link:
        assert state(link).case_open
        assert phone.page.info().connected
        turn = 0.0
        for n in range(40):
            turn = 0.01 * n
            link.send(sample(100.0 + n / 60, wxyz(1, turn)))
            time.sleep(1 / 60)
        # At the end the tip has turned to the right by the angle of the phone, without the delay of the filter.
        clock = itertools.count(40)

        def has_turned() -> bool:
            link.send(sample(100.0 + next(clock) / 60, wxyz(1, turn)))
            return angle(start, phone.session.pose_info().pose) == pytest.approx(turn, abs=0.005)

        wait_for(has_turned)
        now = phone.session.pose_info().pose
        rights = start.lps_from_camera[:3, :3].T @ now.forward_lps
        assert rights[0] > 0.25
        assert abs(rights[1]) < 0.01
        # With the button released the hand may return.
        for n in range(20):
            link.send(sample(100.0 + next(clock) / 60, wxyz(1, turn - 0.02 * n), held=False))
            time.sleep(1 / 60)
        assert angle(now, phone.session.pose_info().pose) < 0.05
        phone.session.do(SetMode("path"))
        at_mm, began_s = phone.session.pose_info().path_mm, time.monotonic()

        def has_advanced() -> bool:
            link.send(sample(100.0 + next(clock) / 60, None, held=False, advance=1.0))
            return phone.session.pose_info().path_mm - at_mm > 10.0

        wait_for(has_advanced)
        moved_mm = phone.session.pose_info().path_mm - at_mm
        # The speed is 25 mm/s; the first frame after a rest may count 0.1 s as elapsed.
        assert moved_mm < 25.0 * (time.monotonic() - began_s + 0.1)
        link.send(sample(100.0 + next(clock) / 60, None, held=False))
    wait_for(lambda: not phone.page.info().connected)


def angle(a, b) -> float:
    cosine = (np.trace(a.lps_from_camera[:3, :3].T @ b.lps_from_camera[:3, :3]) - 1) / 2
    return math.acos(max(-1.0, min(1.0, cosine)))


def test_advance_ends_when_the_phone_disconnects_with_its_button_pressed(phone):
    began_s = time.monotonic()
    with phone_connection(phone) as link:
        link.send(sample(1.0, None, held=False, advance=1.0))
        wait_for(lambda: phone.session.pose_info().path_mm > 0.5)
    wait_for(lambda: not phone.page.info().connected)
    # Without another sample a device moves the tip for at most a quarter of a second.
    end_mm = 25.0 * (time.monotonic() - began_s + 0.25 + 0.1)
    wait_for(lambda: not phone.session.devices.woken.is_set())
    rest_mm = phone.session.pose_info().path_mm
    assert rest_mm < end_mm
    time.sleep(0.2)
    assert phone.session.pose_info().path_mm == rest_mm


def test_invalid_times_and_numbers_of_a_phone_are_counted_and_the_tip_pose_stays_finite(phone):
    with phone_connection(phone) as link:
        state(link)
        for bad in ("NaN", "1e999", "null"):
            link.send(sample(1.0).replace("1.0", bad, 1))
        link.send(sample(1.0, (0.0, 0.0, 0.0, 0.0)))
        link.send(sample(1.0, (1e300, 0.0, 0.0, 0.0)))
        link.send(sample(2.0, advance=7.0))
        link.send(b"\x00\x01")
        link.send(sample(5.0, wxyz(1, 0.1)))
        link.send(sample(-5.0, wxyz(1, 1.0)))
        wait_for(lambda: phone.page.info().num_bad == 4)
        ignored = {}

        def last_is_ignored():
            # A sample within half a millisecond of another one is ignored, so only the reasons are certain, not the
            # counts.
            (device,) = phone.session.devices.info().devices
            ignored.update(device.num_ignored)
            return "timestamps that run backwards" in ignored

        wait_for(last_is_ignored)
        assert ignored["an orientation of length 0"] == 1
        assert ignored["numbers out of range"] == 1
        assert ignored["timestamps that run backwards"] == 1
    assert np.isfinite(phone.session.pose_info().pose.lps_from_camera).all()


def test_phone_that_lost_its_network_reconnects_and_its_old_connection_is_notified(phone):
    with phone_connection(phone) as first:
        state(first)
        with phone_connection(phone) as second:
            state(second)
            code, reason = ended(first)
            assert code == wire.CLOSE_CODES["protocol.taken-over"]
            assert "taken over" in reason
            second.send(sample(1.0, None, held=False, advance=1.0))
            wait_for(lambda: phone.session.pose_info().path_mm > 0.0)
            assert phone.page.info().connected
    wait_for(lambda: not phone.page.info().connected)


def test_phone_is_disconnected_if_the_state_cannot_be_encoded(phone, monkeypatch):
    with phone_connection(phone) as link:
        state(link)
        link.send(sample(1.0))
        wait_for(lambda: phone.page.info().rate_hz > 0)
        monkeypatch.setattr(phone.page._page, "_state", lambda: 1 / 0)
        assert ended(link)[0] == 1011
    wait_for(lambda: not phone.page.info().connected)
    devices = phone.session.devices.info().devices
    assert not any(device.device == "phone" for device in devices)


def test_phone_buttons_recentre_the_view_and_change_the_steering_mode(phone):
    with phone_connection(phone) as link:
        assert state(link).control == "path"
        phone.session.do(Steer(0.0, 0.5, 0.0, 0.0))
        turned = phone.session.pose_info().pose
        link.send(wire.encode_message(wire.PhoneAct("recenter")))
        wait_for(lambda: angle(turned, phone.session.pose_info().pose) > 0.4)
        link.send(wire.encode_message(wire.PhoneAct("next_control")))
        assert state(link).control == "relative"
        assert phone.session.pose_info().mode == "free"
        # Without a path the button levels the horizon.
        phone.session.do(Steer(0.0, 0.0, 0.0, 0.5))
        rolled = phone.session.pose_info().pose
        link.send(wire.encode_message(wire.PhoneAct("recenter")))
        wait_for(lambda: angle(rolled, phone.session.pose_info().pose) > 0.4)
        phone.session.do(CloseCase())
        wait_for(lambda: not state(link).case_open)
        for action in ("next_control", "recenter"):
            link.send(wire.encode_message(wire.PhoneAct(action)))
        link.send(sample(1.0))
        phone.fixture.open()
        assert state(link).case_open, "a command that needs a case changes nothing without one"


def test_many_invalid_messages_disconnect_the_phone(phone):
    with phone_connection(phone) as link:
        state(link)
        for _ in range(MAX_BAD + 1):
            link.send("{")
            time.sleep(0.01)
        assert ended(link)[0] == wire.CLOSE_CODES["protocol.malformed"]
    # The phone may connect again.
    with phone_connection(phone) as link:
        assert state(link).case_open


def test_link_of_a_phone_page_is_invalid_after_the_user_closes_the_page(phone):
    port = int(phone.url.rstrip("/").rpartition(":")[2])
    old = phone.page.info()
    with phone_connection(phone) as link:
        state(link)
        phone.connections.handle(wire.SetPhone(False))
        ended(link)
    wait_for(lambda: phone.page.info() is None)
    wait_for(lambda: any(isinstance(m, wire.DevicesMessage) and m.phone is None for m in phone.sent))
    with pytest.raises(OSError, match=r"refused|reset"):
        socket.create_connection(("127.0.0.1", port), timeout=WAIT_S).close()
    phone.connections.handle(wire.SetPhone(True))
    wait_for(lambda: phone.page.info() is not None)
    new = phone.page.info()
    assert new.sha256 != old.sha256
    assert new.url.partition("#")[2] != phone.token
    phone.url = new.url.partition("#")[0]
    with phone_connection(phone) as link:  # the old token
        assert ended(link)[0] == wire.CLOSE_CODES["protocol.not-authorised"]


def test_phone_page_is_open_or_closed_as_the_last_click_requested_in_any_order_of_threads(phone, monkeypatch):
    phone.connections.handle(wire.SetPhone(False))
    wait_for(lambda: phone.page.info() is None)
    waiting = []

    def thread(target, args, daemon):
        return SimpleNamespace(start=lambda: waiting.append((target, args)))

    monkeypatch.setattr("carina.server.devices.threading", SimpleNamespace(Thread=thread))
    for clicks in ([True, False], [True, False, True], [False]):
        for on in clicks:
            phone.connections.handle(wire.SetPhone(on))
        # The last thread runs first.
        while waiting:
            target, args = waiting.pop()
            target(*args)
        assert (phone.page.info() is not None) == clicks[-1]


def test_phone_page_is_closed_until_enabled_and_a_failure_states_its_reason(web):
    fixture = session_fixture()
    fixture.open()
    # This address is reserved for documentation, so no computer has it.
    page = PhoneSwitch(fixture.session, web, address="203.0.113.250")
    sent: list[object] = []
    connections = DeviceConnections(fixture.session, sent.append, phone=page)
    assert page.info() is None
    message = connections.message()
    assert (message.phone, message.phone_problem) == (None, None)
    connections.handle(wire.SetPhone(True))
    wait_for(lambda: any(isinstance(m, wire.Error) for m in sent))
    (error,) = [m for m in sent if isinstance(m, wire.Error)]
    assert error.code == "server.host"
    assert page.info() is None
    json.loads(wire.encode_message(connections.message()))
    fixture.session.close()
