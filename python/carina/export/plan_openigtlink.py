"""Transfer of a plan over OpenIGTLink: to a server such as 3D Slicer's, or to clients that connect.

3D Slicer reads POLYDATA as models, which it places in RAS, and STRING as text; it ignores POINT and TRAJ, which other
navigation software reads. So targets are sent as surfaces, routes and needles as lines, and targets and needles also as
points and trajectories.

References
----------
OpenIGTLink protocol 3: header, POINT, TRAJ, POLYDATA, STRING; SlicerOpenIGTLink, ``vtkMRMLIGTLConnectorNode``.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Final, Literal, Self

import numpy as np
from numpy.typing import NDArray

from carina.errors import CarinaError, ProtocolError, UsageError
from carina.export.nodule_surface import nodule_surface
from carina.export.plan_content import DrawnRoute, DrawnTarget, drawn_plans
from carina.navigate.devices.igtl import IgtlRequest, IgtlStream, pack_message
from carina.plan import Plan
from carina.track import AirwayTree

DEFAULT_PORT: Final = 18944
LOOPBACK: Final = "127.0.0.1"
SEND_TIMEOUT_S: Final = 5.0
"""Timeout in s for a connection, and for sending each message."""
CLOSE_TIMEOUT_S: Final = 2.0
"""Time in s for a server to close the connection after the last message."""
WAKE_S: Final = 0.1
MAX_PEERS: Final = 8
CHUNK: Final = 1 << 16

Space = Literal["RAS", "LPS"]

_POINT = struct.Struct(">64s32s4B3ff20s")
_TRAJECTORY = struct.Struct(">64s32sBB4B3f3ff20s")
_ENTRY_AND_TARGET = 3
_ASCII, _UTF8 = 3, 106
_MAX_STRING_BYTES = 65_535
# Colours as in the markups for 3D Slicer, so that both imports of a plan look alike.
_TARGET_RGBA = (240, 228, 66, 255)
_NEEDLE_RGBA = (204, 121, 167, 255)
_DOUBTFUL_RGBA = (217, 38, 38, 255)

Points = NDArray[np.float64]


def plan_messages(
    plan: Plan | Mapping[str, Plan],
    tree: AirwayTree,
    *,
    space: Space = "RAS",
    version: int = 1,
    time_s: float = 0.0,
) -> list[bytes]:
    """Return a plan as OpenIGTLink messages.

    In order: for each target POLYDATA ``CarinaTargetN`` (its surface); for each route POLYDATA ``CarinaRouteN`` (a line
    from the trachea to the scope's tip) and ``CarinaNeedleN`` (from there to the aim); POINT ``CarinaTargets``; TRAJ
    ``CarinaNeedles`` (from the scope's tip to the aim); STRING ``CarinaPlan`` with all texts. With several targets the
    numbering of routes continues from one target to the next.

    Parameters
    ----------
    plan
        A plan, or several by the names of their targets.
    tree
        The airway tree of the plan.
    space
        ``"RAS"`` as 3D Slicer and the protocol expect, or ``"LPS"``.
    version
        Version of the header: 1, or 2 (protocol 3).
    time_s
        Time stamp of the messages in seconds since 1970; 0 for none.

    Returns
    -------
    list of bytes
        Complete messages. Positions are float32, exact to 2e-5 mm in a patient.

    Raises
    ------
    UsageError
        If there is no target, the tree is another one, or ``space`` or ``version`` is unknown.
    """
    if space not in ("RAS", "LPS"):
        raise UsageError(f'space: expected "RAS" or "LPS"; found {space!r}', code="plan.space")
    if version not in (1, 2):
        raise UsageError(f"version of the header: expected 1 or 2; found {version!r}", code="plan.version")
    turn = np.array([-1.0, -1.0, 1.0]) if space == "RAS" else np.ones(3)
    targets = drawn_plans(plan, tree)
    drawn = [(target, route) for target in targets for route in target.routes]

    def message(kind: str, name: str, content: bytes) -> bytes:
        return pack_message(kind, name, content, time_s=time_s, version=version)

    found = [
        message("POLYDATA", f"CarinaTarget{number}", _surface_content(target, turn))
        for number, target in enumerate(targets, 1)
    ]
    for number, (_, route) in enumerate(drawn, 1):
        leg = route.route.leg
        needle = np.array([leg.tip_lps, leg.aim_lps])
        found.append(message("POLYDATA", f"CarinaRoute{number}", _polyline_content(route.way_lps * turn)))
        found.append(message("POLYDATA", f"CarinaNeedle{number}", _polyline_content(needle * turn)))
    found.append(message("POINT", "CarinaTargets", b"".join(_point_content(target, turn) for target in targets)))
    if drawn:
        rows = b"".join(_trajectory_content(target, route, turn) for target, route in drawn)
        found.append(message("TRAJ", "CarinaNeedles", rows))
    found.append(message("STRING", "CarinaPlan", _string_content(_plan_text(targets))))
    return found


def send_plan(
    plan: Plan | Mapping[str, Plan],
    tree: AirwayTree,
    *,
    host: str = LOOPBACK,
    port: int = DEFAULT_PORT,
    space: Space = "RAS",
    version: int = 1,
) -> int:
    """Send a plan to an OpenIGTLink server, such as a connector of 3D Slicer.

    Parameters
    ----------
    plan, tree, space, version
        As for :func:`plan_messages`.
    host, port
        Address of the server. Any address but that of this computer sends the plan over the network, unencrypted.

    Returns
    -------
    int
        Number of messages that were sent.

    Raises
    ------
    UsageError
        As for :func:`plan_messages`, or if the port is invalid.
    CarinaError
        ``plan.igtl`` if no server answers or the connection is lost; the message contains a remedy.
    """
    _check_port(port, least=1)
    messages = plan_messages(plan, tree, space=space, version=version, time_s=time.time())
    where = f"{host}:{port}"
    try:
        with socket.create_connection((host, port), timeout=SEND_TIMEOUT_S) as connection:
            for one in messages:
                connection.sendall(one)
            # Messages in transit are lost if a connection is closed with unread data, so the server's data is read
            # first.
            connection.shutdown(socket.SHUT_WR)
            connection.settimeout(CLOSE_TIMEOUT_S)
            with contextlib.suppress(TimeoutError):
                while connection.recv(CHUNK):
                    pass
    except ConnectionRefusedError as error:
        raise CarinaError(
            f"sending the plan to {where}: nothing listens there; in 3D Slicer open the module OpenIGTLinkIF, add a "
            "connector of the type server with this port, and tick Active",
            code="plan.igtl",
        ) from error
    except TimeoutError as error:
        raise CarinaError(
            f"sending the plan to {where}: no answer within {SEND_TIMEOUT_S:g} s; check the address and the firewall",
            code="plan.igtl",
        ) from error
    except OSError as error:
        raise CarinaError(
            f"sending the plan to {where}: {error.strerror or type(error).__name__}; check the address, and that the "
            "other side is still open",
            code="plan.igtl",
        ) from error
    return len(messages)


class PlanServer:
    """Server that offers a plan over OpenIGTLink.

    Every client receives all messages when it connects, and messages that it requests again.

    Parameters
    ----------
    plan, tree, space, version
        As for :func:`plan_messages`.
    host, port
        Address to listen on; port 0 selects a free one. Any address but that of this computer offers the plan on the
        network, unencrypted, to any client.

    Raises
    ------
    UsageError
        As for :func:`plan_messages`, or if the port is invalid.
    CarinaError
        ``server.port`` if the server cannot listen on the port.

    Examples
    --------
    >>> import carina
    >>> from carina.export import PlanServer
    >>> made = carina.generate_phantom(seed=4, spacing_mm=1.2, generations=5, nodule=True)
    >>> found = carina.find_airways(made.volume)
    >>> plan = carina.plan_route(made.volume, found, made.truth["nodule"]["centre_lps"])
    >>> with PlanServer(plan, found.tree, port=0) as server:
    ...     server.port > 0
    True
    """

    def __init__(
        self,
        plan: Plan | Mapping[str, Plan],
        tree: AirwayTree,
        *,
        host: str = LOOPBACK,
        port: int = DEFAULT_PORT,
        space: Space = "RAS",
        version: int = 1,
    ) -> None:
        _check_port(port, least=0)
        self._messages = plan_messages(plan, tree, space=space, version=version, time_s=time.time())
        try:
            self._socket = socket.create_server((host, port), backlog=MAX_PEERS)
        except OSError as error:
            raise CarinaError(
                f"cannot listen on {host}:{port} for OpenIGTLink: {error.strerror}; choose another port",
                code="server.port",
            ) from error
        # On some systems closing a socket does not wake a thread in accept, so accept has a timeout.
        self._socket.settimeout(WAKE_S)
        self.host = host
        self.port: int = self._socket.getsockname()[1]
        self._lock = threading.Lock()
        self._peers: dict[socket.socket, threading.Thread] = {}
        self._is_ending = False
        self._thread = threading.Thread(target=self._accept, name="carina-plan-openigtlink", daemon=True)

    def __repr__(self) -> str:
        """Return address, number of messages and number of clients."""
        return f"PlanServer({self.host}:{self.port}, {len(self._messages)} messages, {self.num_peers} connected)"

    def __enter__(self) -> Self:
        """Start the server."""
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop the server."""
        self.stop()

    @property
    def num_peers(self) -> int:
        """Number of OpenIGTLink clients that are connected."""
        with self._lock:
            return len(self._peers)

    def start(self) -> None:
        """Start to listen for clients."""
        self._thread.start()

    def stop(self) -> None:
        """Stop listening and close all connections."""
        with self._lock:
            self._is_ending = True
            peers = dict(self._peers)
        # Closing a socket does not wake a thread in recv; shutdown does.
        for one in peers:
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
        if self._thread.is_alive():
            self._thread.join()
        self._socket.close()
        for thread in peers.values():
            thread.join()

    def _accept(self) -> None:
        while True:
            try:
                peer, _ = self._socket.accept()
            except TimeoutError:
                if self._is_ending:
                    return
                continue
            except OSError:
                return  # the server was stopped
            with self._lock:
                if self._is_ending or len(self._peers) >= MAX_PEERS:
                    peer.close()
                    continue
                thread = threading.Thread(target=self._serve_peer, args=(peer,), name="carina-plan-peer", daemon=True)
                self._peers[peer] = thread
                thread.start()

    def _serve_peer(self, peer: socket.socket) -> None:
        stream = IgtlStream()
        try:
            with peer:
                peer.settimeout(SEND_TIMEOUT_S)
                for one in self._messages:
                    peer.sendall(one)
                peer.settimeout(None)
                peer.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
                while data := peer.recv(CHUNK):
                    for request in stream.feed(data):
                        if isinstance(request, IgtlRequest):
                            self._answer_request(peer, request)
        except (OSError, ProtocolError):
            pass  # the client disconnected, does not read, or sends invalid data
        finally:
            with self._lock:
                self._peers.pop(peer, None)

    def _answer_request(self, peer: socket.socket, request: IgtlRequest) -> None:
        """Send the messages of the requested type, limited to the requested name if there is one."""
        peer.settimeout(SEND_TIMEOUT_S)
        kind = request.what.removeprefix("GET_").encode()
        for one in self._messages:
            named = one[14:34].rstrip(b"\0").decode("ascii")
            if one[2:14].rstrip(b"\0") == kind and request.name in {"", named}:
                peer.sendall(one)
        peer.settimeout(None)


def _check_port(port: int, *, least: int) -> None:
    if isinstance(port, bool) or not isinstance(port, int) or not least <= port <= 65_535:
        raise UsageError(f"port: expected {least} to 65535; found {port!r}", code="plan.port")


def _polyline_content(points: Points) -> bytes:
    """Return the content of a POLYDATA message with one line through all points, without attributes."""
    indices = np.concatenate([[len(points)], np.arange(len(points))]).astype(">u4").tobytes()
    # Number of points; number and bytes of vertices, lines, polygons and strips; attributes.
    head = struct.pack(">10I", len(points), 0, 0, 1, len(indices), 0, 0, 0, 0, 0)
    return head + points.astype(">f4").tobytes() + indices


def _surface_content(target: DrawnTarget, turn: Points) -> bytes:
    """Return the content of a POLYDATA message with a target's surface.

    LPS and RAS differ by a rotation, which does not change the orientation of the triangles.
    """
    mesh = nodule_surface(target.plan.nodule)
    num = len(mesh.triangles)
    cells = np.concatenate([np.full((num, 1), 3), mesh.triangles], axis=1).astype(">u4").tobytes()
    head = struct.pack(">10I", len(mesh.vertices_lps), 0, 0, 0, 0, num, len(cells), 0, 0, 0)
    return head + (mesh.vertices_lps * turn).astype(">f4").tobytes() + cells


def _point_content(target: DrawnTarget, turn: Points) -> bytes:
    nodule = target.plan.nodule
    place = np.array(nodule.centre_lps) * turn
    return _POINT.pack(_ascii_text(target.name, 64), b"Target", *_TARGET_RGBA, *place, nodule.equivalent_mm, b"")


def _trajectory_content(target: DrawnTarget, route: DrawnRoute, turn: Points) -> bytes:
    leg = route.route.leg
    name = f"{route.title} to {target.name}"
    return _TRAJECTORY.pack(
        _ascii_text(f"DOUBTFUL {name}" if route.is_doubtful else name, 64),
        b"Trajectory",
        _ENTRY_AND_TARGET,
        0,
        *(_DOUBTFUL_RGBA if route.is_doubtful else _NEEDLE_RGBA),
        *(np.array(leg.tip_lps) * turn),
        *(np.array(leg.aim_lps) * turn),
        0.0,
        b"",
    )


def _ascii_text(text: str, num: int) -> bytes:
    """Return a text as ASCII bytes, at most ``num - 1`` of them, to leave space for a terminating zero byte."""
    return text.encode("ascii", "replace")[: num - 1]


def _plan_text(targets: Sequence[DrawnTarget]) -> str:
    lines, number = [], 0
    for n, target in enumerate(targets, 1):
        lines.append(f"CarinaTarget{n}: {target.name}: {target.words}")
        for route in target.routes:
            number += 1
            lines.append(f"CarinaRoute{number}, CarinaNeedle{number}: {route.title} to {target.name}. {route.words}")
    return "\n".join(lines)


def _string_content(text: str) -> bytes:
    content = text.encode()
    if len(content) > _MAX_STRING_BYTES:
        # The length field has 16 bits. The text is cut between characters.
        content = content[: _MAX_STRING_BYTES - 4].decode(errors="ignore").encode() + b" ..."
    return struct.pack(">HH", _ASCII if content.isascii() else _UTF8, len(content)) + content
