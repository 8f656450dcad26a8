"""Tests of the export of a plan by OpenIGTLink, read back by pyigtl or by the tables of the protocol."""

from __future__ import annotations

import contextlib
import dataclasses
import socket
import struct
import threading

import numpy as np
import pytest
from sample_plan import DOUBT, a_plan, a_tree

from carina.errors import CarinaError, UsageError
from carina.export.nodule_surface import nodule_surface
from carina.export.plan_openigtlink import MAX_PEERS, PlanServer, plan_messages, send_plan

pyigtl = pytest.importorskip("pyigtl", reason="pyigtl, the independent peer, is not installed")

RAS = np.array([-1.0, -1.0, 1.0])
HEADER_BYTES = 58


@pytest.fixture(params=[1, 2])
def messages(request) -> list[bytes]:
    return plan_messages(a_plan(), a_tree(), version=request.param, time_s=12.5)


def fields_of(message: bytes):
    return pyigtl.messages.MessageBase.parse_header(message[:HEADER_BYTES])


def by_name(messages: list[bytes], name: str) -> bytes:
    (found,) = [one for one in messages if fields_of(one)["device_name"] == name]
    return found


def content_of(message: bytes) -> bytes:
    fields = fields_of(message)
    body = message[HEADER_BYTES:]
    assert fields["body_size"] == len(body)
    (checksum,) = struct.unpack(">Q", message[50:58])
    assert checksum == pyigtl.messages.CRC64(body)
    if fields["header_version"] == 1:
        return body
    size, metadata_header, metadata, _ = struct.unpack_from(">HHII", body)
    assert (size, metadata_header, metadata) == (12, 0, 0)
    return body[12:]


def read_by_pyigtl(message: bytes):
    fields = fields_of(message)
    found = pyigtl.messages.MessageBase.create_message(fields["message_type"])
    found.unpack(fields, message[HEADER_BYTES:])
    return found


def read_polydata(message: bytes) -> np.ndarray:
    """Return the points of a POLYDATA message with one line; the message has ten counts, then points, then cells."""
    content = content_of(message)
    counts = struct.unpack_from(">10I", content)
    num_points, num_lines, line_bytes = counts[0], counts[3], counts[4]
    assert [counts[n] for n in (1, 2, 5, 6, 7, 8, 9)] == [0] * 7
    assert num_lines == 1
    points = np.frombuffer(content, ">f4", 3 * num_points, 40).reshape(-1, 3)
    cells = np.frombuffer(content, ">u4", line_bytes // 4, 40 + points.nbytes)
    assert 40 + points.nbytes + line_bytes == len(content)
    assert cells.tolist() == [num_points, *range(num_points)]
    return points.astype(float)


def read_trajectories(message: bytes):
    content = content_of(message)
    assert len(content) % 150 == 0
    return list(struct.iter_unpack(">64s32sBB4B3f3ff20s", content))


def test_names_of_igtl_messages_are_unique_and_the_same_as_in_slicer(messages):
    names = [fields_of(one)["device_name"] for one in messages]
    assert names == [
        *("CarinaTarget1", "CarinaRoute1", "CarinaNeedle1", "CarinaRoute2", "CarinaNeedle2"),
        *("CarinaTargets", "CarinaNeedles", "CarinaPlan"),
    ]
    assert {fields_of(one)["timestamp"] for one in messages} == {12.5}


def test_routes_and_needles_are_sent_as_lines_in_ras_at_the_positions_of_the_plan(messages):
    tree = a_tree()
    for number, route in enumerate(a_plan().routes, 1):
        needle = read_polydata(by_name(messages, f"CarinaNeedle{number}"))
        assert np.abs(needle - np.array([route.leg.tip_lps, route.leg.aim_lps]) * RAS).max() < 1e-4
        way = read_polydata(by_name(messages, f"CarinaRoute{number}")) * RAS
        assert np.abs(way[0] - tree.root.points[0]).max() < 1e-4
        assert np.abs(way[-1] - route.leg.tip_lps).max() < 1e-4
        whole = tree.route_to(route.branch_id).points_lps
        assert max(np.linalg.norm(whole - point, axis=1).min() for point in way) < 1e-4


def test_target_surface_is_sent_as_triangles_around_its_centre_in_ras(messages):
    nodule, content = a_plan().nodule, content_of(by_name(messages, "CarinaTarget1"))
    counts = struct.unpack_from(">10I", content)
    assert [counts[n] for n in (1, 2, 3, 4, 7, 8, 9)] == [0] * 7
    points = np.frombuffer(content, ">f4", 3 * counts[0], 40).reshape(-1, 3).astype(float) * RAS
    cells = np.frombuffer(content, ">u4", counts[6] // 4, 40 + 12 * counts[0]).reshape(-1, 4)
    assert 40 + 12 * counts[0] + counts[6] == len(content)
    assert len(cells) == counts[5]
    assert (cells[:, 0] == 3).all()
    surface = nodule_surface(nodule)
    assert np.array_equal(cells[:, 1:], surface.triangles)
    assert np.abs(points - surface.vertices_lps).max() < 1e-4
    assert np.abs(points.mean(axis=0) - nodule.centre_lps).max() < 0.01


def test_pyigtl_reads_names_and_positions_of_the_targets(messages):
    plan = a_plan()
    found = read_by_pyigtl(by_name(messages, "CarinaTargets"))
    assert found.names == ["Target"]
    assert np.abs(np.array(found.positions[0]) - np.array(plan.nodule.centre_lps) * RAS).max() < 1e-4
    assert found.diameters[0] == pytest.approx(plan.nodule.equivalent_mm, rel=1e-6)


def test_sent_trajectories_run_from_the_scope_tip_to_the_aim(messages):
    rows = read_trajectories(by_name(messages, "CarinaNeedles"))
    for row, route, name in zip(
        rows, a_plan().routes, ("Route 1: LB3 to Target", "DOUBTFUL Route 2: branch 9 to Target"), strict=True
    ):
        assert row[0].rstrip(b"\0").decode() == name
        assert row[2] == 3
        assert np.abs(np.array(row[8:11]) * RAS - route.leg.tip_lps).max() < 1e-4
        assert np.abs(np.array(row[11:14]) * RAS - route.leg.aim_lps).max() < 1e-4
    assert rows[0][4:8] != rows[1][4:8]


def test_sent_text_of_the_plan_includes_its_doubts(messages):
    text = read_by_pyigtl(by_name(messages, "CarinaPlan")).string
    assert f"{DOUBT}." in text
    assert "CarinaRoute2, CarinaNeedle2: Route 2: branch 9 to Target." in text
    assert "up to 15 mm from where it is shown here" in text


def test_messages_in_lps_have_the_positions_of_the_plan():
    messages = plan_messages(a_plan(), a_tree(), space="LPS")
    route = a_plan().routes[0]
    needle = read_polydata(by_name(messages, "CarinaNeedle1"))
    assert np.abs(needle - np.array([route.leg.tip_lps, route.leg.aim_lps])).max() < 1e-4


def test_message_numbers_continue_over_several_targets_and_long_or_non_ascii_names_are_shortened():
    plans = {"Nodule Ö " + "x" * 80: a_plan(), "B": a_plan(doubts=())}
    messages = plan_messages(plans, a_tree())
    names = [fields_of(one)["device_name"] for one in messages]
    assert len(set(names)) == len(names) == 2 * 5 + 3
    found = read_by_pyigtl(by_name(messages, "CarinaTargets"))
    assert found.names[0].startswith("Nodule ? xxx")
    assert len(found.names[0]) == 63
    assert "Nodule Ö" in read_by_pyigtl(by_name(messages, "CarinaPlan")).string


def test_plan_without_a_route_is_sent_as_a_target_and_a_reason():
    plan = dataclasses.replace(a_plan(), routes=(), why="no route: the nearest airway found is LB3, 40 mm away")
    messages = plan_messages(plan, a_tree())
    assert [fields_of(one)["message_type"] for one in messages] == ["POLYDATA", "POINT", "STRING"]
    assert "40 mm away" in read_by_pyigtl(messages[-1]).string


def split(data: bytes) -> list[bytes]:
    found = []
    while data:
        size = HEADER_BYTES + fields_of(data[:HEADER_BYTES])["body_size"]
        assert len(data) >= size
        found.append(data[:size])
        data = data[size:]
    return found


def test_receiver_such_as_slicer_gets_all_messages_of_the_plan():
    received_data: list[bytes] = []
    with socket.create_server(("127.0.0.1", 0)) as server:

        def listen() -> None:
            peer, _ = server.accept()
            with peer:
                while data := peer.recv(1000):
                    received_data.append(data)

        thread = threading.Thread(target=listen)
        thread.start()
        num = send_plan(a_plan(), a_tree(), port=server.getsockname()[1])
        thread.join()
    messages = split(b"".join(received_data))
    assert num == len(messages) == 8
    assert [content_of(one) for one in messages] == [content_of(one) for one in plan_messages(a_plan(), a_tree())]


def test_missing_receiver_is_reported_with_a_remedy(monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(CarinaError, match=r"nothing listens there.*OpenIGTLinkIF") as caught:
        send_plan(a_plan(), a_tree(), port=port)
    assert caught.value.code == "plan.igtl"
    for trouble, text in (
        (socket.gaierror(-2, "Name or service not known"), "Name or service not known; check the address"),
        (TimeoutError("timed out"), "no answer within 5 s; check the address and the firewall"),
    ):

        def fails(*_, trouble=trouble, **__):
            raise trouble

        monkeypatch.setattr(socket, "create_connection", fails)
        with pytest.raises(CarinaError, match=text):
            send_plan(a_plan(), a_tree(), host="somewhere")


def received(peer: socket.socket, num: int) -> list[bytes]:
    data = b""
    peer.settimeout(60.0)
    while True:
        data += peer.recv(1 << 16)
        with contextlib.suppress(AssertionError, struct.error):
            if len(found := split(data)) == num:
                return found


def test_client_receives_the_plan_when_it_connects_and_again_on_request():
    with PlanServer(a_plan(), a_tree(), port=0) as server:
        for _ in range(2):
            with socket.create_connection((server.host, server.port)) as peer:
                first = received(peer, 8)
                assert [content_of(one) for one in first] == [
                    content_of(one) for one in plan_messages(a_plan(), a_tree())
                ]
                request = pyigtl.messages.MessageBase(device_name="CarinaNeedle2")
                request._message_type = "GET_POLYDATA"
                peer.sendall(request.pack())
                assert received(peer, 1) == [first[4]]
                request.device_name = ""
                request._message_type = "GET_TRAJ"
                peer.sendall(request.pack())
                assert received(peer, 1) == [first[6]]


def test_pyigtl_client_reads_points_and_text_from_the_server():
    with PlanServer(a_plan(), a_tree(), port=0) as server:
        client = pyigtl.OpenIGTLinkClient(server.host, server.port)
        try:
            assert DOUBT in client.wait_for_message("CarinaPlan", timeout=60).string
            assert client.wait_for_message("CarinaTargets", timeout=60).names == ["Target"]
        finally:
            client.stop()


def test_client_with_another_protocol_is_disconnected_and_others_are_served():
    with PlanServer(a_plan(), a_tree(), port=0) as server, socket.create_connection((server.host, server.port)) as bad:
        received(bad, 8)
        bad.sendall(b"GET / HTTP/1.1\r\n" + b"x" * 100)
        bad.settimeout(60.0)
        assert bad.recv(10) == b""
        with socket.create_connection((server.host, server.port)) as good:
            assert len(received(good, 8)) == 8


def test_server_shutdown_closes_its_connections_and_releases_its_port():
    server = PlanServer(a_plan(), a_tree(), port=0)
    server.start()
    peer = socket.create_connection((server.host, server.port))
    received(peer, 8)
    assert server.num_peers == 1
    with pytest.raises(CarinaError, match="choose another port") as caught:
        PlanServer(a_plan(), a_tree(), port=server.port)
    assert caught.value.code == "server.port"
    server.stop()
    assert peer.recv(10) == b""
    peer.close()
    assert server.num_peers == 0
    PlanServer(a_plan(), a_tree(), port=server.port).stop()


def test_connections_above_the_limit_are_refused():
    with PlanServer(a_plan(), a_tree(), port=0) as server, contextlib.ExitStack() as stack:
        for _ in range(MAX_PEERS):
            received(stack.enter_context(socket.create_connection((server.host, server.port))), 8)
        more = stack.enter_context(socket.create_connection((server.host, server.port)))
        more.settimeout(60.0)
        assert more.recv(10) == b""


def test_invalid_numbers_and_texts_in_igtl_messages_are_refused():
    with pytest.raises(UsageError, match="space"):
        plan_messages(a_plan(), a_tree(), space="XYZ")  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="version"):
        plan_messages(a_plan(), a_tree(), version=3)
    for port in (0, -1, 65_536, True):
        with pytest.raises(UsageError, match="port"):
            send_plan(a_plan(), a_tree(), port=port)
    with pytest.raises(UsageError, match="port"):
        PlanServer(a_plan(), a_tree(), port=70_000)
