"""Tests of OpenIGTLink: the codec against the independent pyigtl, and damaged messages of a peer."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
import socket
import struct
import sys
import threading
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carina.errors import ProtocolError, UsageError
from carina.navigate import PoseSample
from carina.navigate.devices import IgtlClient, IgtlServer, Listener, open_source
from carina.navigate.devices.crc import crc64, crc64_bitwise
from carina.navigate.devices.igtl import (
    HEADER,
    IgtlPose,
    IgtlRequest,
    IgtlStream,
    pack_image,
    pack_message,
    pack_position,
    pack_qtdata,
    pack_transform,
    pose_matrix,
)
from carina.navigate.rotation import rotation_from_vector, wxyz_from_rotation

pyigtl = pytest.importorskip("pyigtl", reason="pyigtl, the independent peer, is not installed")

TURN = rotation_from_vector(np.array([0.4, -1.2, 0.7]))
POSE = IgtlPose("Pen", 12.5, (1.5, -20.25, 300.0), wxyz_from_rotation(TURN))


def wait_for(what, seconds=120.0):
    end = time.monotonic() + seconds
    while not (found := what()):
        assert time.monotonic() < end, "the condition was not met in time"
        threading.Event().wait(0.005)
    return found


def same_pose(found: IgtlPose, expected: IgtlPose) -> None:
    assert found.name == expected.name
    np.testing.assert_allclose(pose_matrix(found), pose_matrix(expected), atol=1e-4)  # Numbers are float32 on the wire.


@settings(max_examples=30, deadline=None)
@given(st.binary(max_size=300))
def test_checksum_by_table_equals_bitwise_checksum_and_that_of_pyigtl(data):
    assert crc64(data) == crc64_bitwise(data) == pyigtl.messages.CRC64(data)


def test_checksum_of_a_large_igtl_message_equals_that_of_pyigtl():
    data = np.random.default_rng(1).integers(0, 256, 100_001, dtype=np.uint8).tobytes()
    assert crc64(data) == pyigtl.messages.CRC64(data)


@pytest.mark.parametrize("version", [1, 2, 3])
def test_all_igtl_pose_messages_are_read_in_all_versions_and_fragmentations(version):
    data = (
        pack_transform("Pen", pose_matrix(POSE), time_s=12.5, version=version)
        + pack_message("STATUS", "x", b"\0" * 30, version=version)
        + pack_position("Pen", POSE, version=version)
        + pack_qtdata("Tracker", [POSE, POSE], time_s=12.5, version=version)
    )
    for size in (1, 7, 58, 1000):
        stream = IgtlStream()
        found = [m for n in range(0, len(data), size) for m in stream.feed(data[n : n + size])]
        assert len(found) == 4
        for pose in found:
            same_pose(pose, POSE)
            assert pose.time_s == 12.5
        assert (stream.num_skipped, stream.num_bad) == (1, {})


def test_pyigtl_and_carina_read_the_poses_of_each_other():
    packed = pack_transform("Pen", pose_matrix(POSE), time_s=12.5)
    fields = pyigtl.messages.MessageBase.parse_header(packed[:58])
    theirs = pyigtl.messages.MessageBase.create_message(fields["message_type"])
    theirs.unpack(fields, packed[58:])
    np.testing.assert_allclose(theirs.matrix, pose_matrix(POSE), atol=1e-4)
    for version in (1, 2):
        message = pyigtl.TransformMessage(pose_matrix(POSE), device_name="Pen", timestamp=12.5)
        message.header_version, message.metadata = version, {"Status": "OK"} if version == 2 else {}
        (ours,) = IgtlStream().feed(message.pack())
        same_pose(ours, POSE)
    w, x, y, z = POSE.orientation_wxyz
    position = pyigtl.messages.PositionMessage(
        positions=np.array([POSE.position_mm]), quaternions=np.array([[x, y, z, w]]), names=["Pen"], device_name="Pen"
    )
    (ours,) = IgtlStream().feed(position.pack())
    same_pose(ours, POSE)


def test_pyigtl_reads_a_carina_picture():
    pixels = np.random.default_rng(2).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    packed = pack_image("View", pixels)
    fields = pyigtl.messages.MessageBase.parse_header(packed[:58])
    theirs = pyigtl.messages.MessageBase.create_message("IMAGE")
    theirs.unpack(fields, packed[58:])
    np.testing.assert_array_equal(np.asarray(theirs.image).reshape(30, 40, 3), pixels)


def test_igtl_message_with_a_wrong_checksum_is_dropped_and_the_next_is_read():
    good, broken = pack_transform("Pen", np.eye(4)), bytearray(pack_transform("Pen", np.eye(4)))
    broken[80] ^= 1
    stream = IgtlStream()
    assert len(stream.feed(good + bytes(broken) + good)) == 2
    assert stream.num_bad == {"wrong checksum": 1}


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (b"\0" * 48, "TRANSFORM"),
        (struct.pack(">12f", *[math.nan] * 12), "TRANSFORM"),
        (b"\0" * 47, "TRANSFORM"),
        (struct.pack(">12f", 1, 0, 0, 0, 1, 0, 0, 0, -1, 0, 0, 0), "TRANSFORM"),  # a mirroring matrix
        (b"\0" * 13, "POSITION"),
        (b"\0" * 51, "QTDATA"),
    ],
)
def test_igtl_message_with_invalid_content_is_counted_and_skipped(content, kind):
    stream = IgtlStream()
    found = stream.feed(pack_message(kind, "x", content) + pack_transform("Pen", np.eye(4)))
    assert [m.name for m in found] == ["Pen"]
    assert stream.num_bad == {"malformed content": 1}


def test_stated_message_length_of_four_gibibytes_allocates_no_memory_and_ends_the_stream():
    for num_bytes in (4 << 30, (1 << 64) - 1):
        stream = IgtlStream()
        with pytest.raises(ProtocolError, match="bytes"):
            stream.feed(HEADER.pack(1, b"TRANSFORM", b"x", 0, num_bytes, 0))
    stream = IgtlStream()
    assert stream.feed(HEADER.pack(1, b"TRANSFORM", b"x", 0, 1 << 20, 0)) == []
    assert stream.num_bad == {"wrong pose length": 1}
    for _ in range(16):
        stream.feed(b"\0" * (1 << 16))
    assert len(stream._buffer) == 0
    assert len(stream.feed(pack_transform("Pen", np.eye(4)))) == 1


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=400), st.integers(0, 2))
def test_random_bytes_in_an_igtl_stream_are_refused_or_skipped(data, version):
    stream = IgtlStream()
    with contextlib.suppress(ProtocolError):
        stream.feed(data)
        stream.feed(pack_message("TRANSFORM", "x", data, version=version))


class SampleRecorder:
    def __init__(self):
        self.samples: list[tuple[str, PoseSample]] = []
        self.gone: list[str] = []
        self.listener = Listener(lambda device, sample: self.samples.append((device, sample)), self.gone.append)


def test_igtl_source_loses_no_pose_at_120_hz_and_reconnects():
    recorder = SampleRecorder()
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(10.0)
        port = listening.getsockname()[1]
        client = IgtlClient("127.0.0.1", port, recorder.listener)
        client.RETRY_S = 0.05
        client.start()
        try:
            peer, _ = listening.accept()
            # Poses are sent by the clock, because repeated sleeps give less than 120 Hz.
            began = time.monotonic()
            for n in range(240):
                matrix = np.eye(4)
                matrix[0, 3] = n
                peer.sendall(pack_transform("Pen", matrix, time_s=100.0 + n / 120.0))
                threading.Event().wait(max(0.0, began + (n + 1) / 120.0 - time.monotonic()))
            wait_for(lambda: len(recorder.samples) == 240)
            assert [s.position_mm[0] for _, s in recorder.samples] == list(range(240))
            device = f"openigtlink:127.0.0.1:{port}/Pen"
            assert {d for d, _ in recorder.samples} == {device}
            # At a header with a length of 4 GiB the source closes the connection and opens a new one.
            peer.sendall(HEADER.pack(1, b"TRANSFORM", b"x", 0, 4 << 30, 0))
            peer.close()
            again, _ = listening.accept()
            assert device in recorder.gone
            assert client.status().num_bad == {"invalid headers": 1}
            again.sendall(pack_transform("Pen", np.eye(4), time_s=1.0))
            wait_for(lambda: len(recorder.samples) == 241)
            again.close()
        finally:
            client.stop()


def test_pyigtl_tracker_at_60_hz_moves_the_tip():
    recorder = SampleRecorder()
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    server = pyigtl.OpenIGTLinkServer(port=port, local_server=True)
    client = IgtlClient("127.0.0.1", port, recorder.listener)
    client.RETRY_S = 0.05
    client.start()
    try:
        wait_for(server.is_connected)
        began = time.monotonic()
        for n in range(120):
            matrix = np.eye(4)
            matrix[0, 3] = n
            server.send_message(pyigtl.TransformMessage(matrix, device_name="Pen"), wait=True)
            threading.Event().wait(max(0.0, began + (n + 1) / 60.0 - time.monotonic()))
        wait_for(lambda: len(recorder.samples) >= 119)
        xs = [s.position_mm[0] for _, s in recorder.samples]
        assert all(b > a for a, b in itertools.pairwise(xs))
    finally:
        client.stop()
        server.stop()


def received(peer: socket.socket) -> bytes:
    data = peer.recv(1 << 16)
    assert data, "the connection was closed"
    return data


def picture_among_poses(peer: socket.socket):
    """Return the first IMAGE message that arrives, as pyigtl reads it."""
    # The data received last may end in the middle of a pose message.
    data, mark = b"", b"IMAGE".ljust(12, b"\0") + b"CarinaView"
    until = time.monotonic() + 60.0
    while (at := data.find(mark) - 2) < 0 or len(data) < at + HEADER.size:
        data += received(peer)
        assert time.monotonic() < until, "poses came, and no picture"
    fields = pyigtl.messages.MessageBase.parse_header(data[at : at + HEADER.size])
    end = at + HEADER.size + HEADER.unpack(data[at : at + HEADER.size])[4]
    while len(data) < end:
        data += received(peer)
    picture = pyigtl.messages.MessageBase.create_message("IMAGE")
    picture.unpack(fields, data[at + HEADER.size : end])
    return picture


def test_pyigtl_receives_the_tip_at_60_hz_and_the_picture_on_request():
    count = itertools.count()
    pixels = np.random.default_rng(3).integers(0, 256, (12, 16, 3), dtype=np.uint8)

    def tip() -> np.ndarray:
        matrix = np.eye(4)
        matrix[:3, 3] = (1.0, 2.0, float(next(count)))
        return matrix

    server = IgtlServer(tip, picture=lambda: pixels, port=0, rate_hz=120.0)
    server.start()
    seen: list[float] = []
    client = pyigtl.OpenIGTLinkClient(host="127.0.0.1", port=server.port)
    try:
        first = wait_for(lambda: client.wait_for_message("CarinaTip", timeout=2))
        # In RAS, left and posterior have the opposite signs of LPS.
        assert (first.matrix[0, 3], first.matrix[1, 3]) == (-1.0, -2.0)
        client.stop()
        wait_for(lambda: server.num_peers == 0)
        # A plain receiver that is the only peer receives every pose.
        with socket.create_connection(("127.0.0.1", server.port), timeout=10.0) as plain:
            stream, until, rate_hz = IgtlStream(), time.monotonic() + 60.0, 0.0
            # The measurement is repeated until the machine is idle enough for one second at the full rate.
            while rate_hz <= 60.0:
                assert time.monotonic() < until, f"{rate_hz:.0f} poses a second"
                began, first = time.monotonic(), len(seen)
                while len(seen) < first + 120:
                    seen += [m.position_mm[2] for m in stream.feed(received(plain)) if isinstance(m, IgtlPose)]
                rate_hz = 120.0 / (time.monotonic() - began)
            assert (np.diff(seen) == 1.0).all()
            plain.sendall(pack_message("GET_IMAGE", "CarinaView", b""))
            picture = picture_among_poses(plain)
        np.testing.assert_array_equal(np.asarray(picture.image).reshape(pixels.shape), pixels)
        assert IgtlStream().feed(pack_message("GET_IMAGE", "v", b"")) == [IgtlRequest("GET_IMAGE", "v")]
    finally:
        client.stop()
        server.stop()


def test_noise_or_disconnection_of_a_client_does_not_stop_the_igtl_server():
    server = IgtlServer(lambda: np.eye(4), port=0)
    server.start()
    try:
        for noise in (b"GET / HTTP/1.1\r\n\r\n" * 9, b"\0" * 200, b""):
            with socket.create_connection(("127.0.0.1", server.port)) as peer:
                peer.sendall(noise)
        with socket.create_connection(("127.0.0.1", server.port), timeout=10.0) as peer:
            assert received(peer)
    finally:
        server.stop()


@pytest.mark.parametrize("reads", [True, False])
def test_igtl_server_stops_while_a_client_is_connected(reads, monkeypatch):
    if sys.version_info < (3, 12):

        async def wait_closed(self):
            # The handler behaves like that of Python 3.12 and later, which waits until the last connection is closed.
            while self._active_count:
                await asyncio.sleep(0.005)

        monkeypatch.setattr(asyncio.base_events.Server, "wait_closed", wait_closed)
    pixels = np.zeros((1500, 2000, 3), dtype=np.uint8)  # The picture is larger than the buffers of the socket.
    server = IgtlServer(lambda: np.eye(4), picture=lambda: pixels, port=0)
    server.start()
    with socket.create_connection(("127.0.0.1", server.port)) as peer:
        assert peer.recv(10)
        if not reads:
            for _ in range(10):
                peer.sendall(pack_message("GET_IMAGE", "v", b""))

            def held_up() -> bool:
                # The server sends 60 poses per second.
                sent = server.num_sent
                threading.Event().wait(0.2)
                return server.num_sent == sent

            wait_for(held_up)
        ending = threading.Thread(target=server.stop, daemon=True)
        ending.start()
        ending.join(5.0)
        assert not ending.is_alive()


def test_igtl_source_reconnects_if_its_peer_sends_nothing():
    recorder = SampleRecorder()
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(8.0)
        client = IgtlClient("127.0.0.1", listening.getsockname()[1], recorder.listener, silence_s=0.2)
        client.RETRY_S = 0.05
        client.start()
        try:
            silent, _ = listening.accept()
            silent.sendall(pack_transform("Pen", np.eye(4), time_s=1.0))
            wait_for(lambda: len(recorder.samples) == 1)
            # The peer disappears without closing the connection, as after a loss of power.
            again, _ = listening.accept()
            assert recorder.gone[0].endswith("/Pen")
            again.sendall(pack_transform("Pen", np.eye(4), time_s=2.0))
            wait_for(lambda: len(recorder.samples) == 2)
            wait_for(lambda: "no data for 0.2 s" in client.status().words)
            silent.close()
            again.close()
        finally:
            client.stop()


def test_invalid_device_name_in_a_message_does_not_stop_the_igtl_source():
    recorder = SampleRecorder()
    client = IgtlClient("a" * 64 + "..b", 18944, recorder.listener)
    client.RETRY_S = 0.02
    client.start()
    try:
        wait_for(lambda: len(recorder.gone) >= 2)
        assert "UnicodeError" in wait_for(lambda: client.status().words)
    finally:
        client.stop()


def test_idle_igtl_connection_stays_open_with_tcp_keepalive():
    recorder = SampleRecorder()
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(0.6)
        address = f"openigtlink:127.0.0.1:{listening.getsockname()[1]}"
        client = open_source(address, recorder.listener)
        client.RETRY_S = 0.05
        client.start()
        try:
            idle, _ = listening.accept()
            idle.sendall(pack_transform("Pen", np.eye(4), time_s=1.0))
            wait_for(lambda: len(recorder.samples) == 1)
            with pytest.raises(TimeoutError):
                listening.accept()
            assert client.status().state == "live"
            idle.sendall(pack_transform("Pen", np.eye(4), time_s=2.0))
            wait_for(lambda: len(recorder.samples) == 2)
            assert recorder.gone == []
            idle.close()
        finally:
            client.stop()


def test_tcp_keepalive_detects_a_lost_idle_peer_within_10_seconds(monkeypatch):
    writers, connect = [], asyncio.open_connection

    async def noted(*address):
        reader, writer = await connect(*address)
        writers.append(writer)
        return reader, writer

    monkeypatch.setattr(asyncio, "open_connection", noted)
    recorder = SampleRecorder()
    with socket.create_server(("127.0.0.1", 0)) as listening:
        client = IgtlClient("127.0.0.1", listening.getsockname()[1], recorder.listener)
        client.start()
        try:
            wait_for(lambda: client.status().state == "live")
            connection = writers[0].get_extra_info("socket")
            assert connection.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) != 0
            if sys.platform.startswith("linux"):
                options = (socket.TCP_KEEPIDLE, socket.TCP_KEEPINTVL, socket.TCP_KEEPCNT)
                idle_s, between_s, times = (connection.getsockopt(socket.IPPROTO_TCP, option) for option in options)
                assert idle_s + between_s * times <= 10, "the lost peer is detected within 10 s"
        finally:
            client.stop()


def test_time_after_which_a_silent_peer_is_reconnected_can_be_set_in_the_address():
    recorder = SampleRecorder()
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(8.0)
        client = open_source(f"openigtlink:127.0.0.1:{listening.getsockname()[1]}?silence=0.2", recorder.listener)
        client.RETRY_S = 0.05
        client.start()
        try:
            first, _ = listening.accept()
            again, _ = listening.accept()
            first.close()
            again.close()
        finally:
            client.stop()
    for broken in ("silence=nan", "silence=0", "silent=5"):
        with pytest.raises(UsageError):
            open_source(f"openigtlink:127.0.0.1:18944?{broken}", recorder.listener)
