"""OpenIGTLink over TCP: a client that receives trackers, and a server that publishes the tip."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from carina.errors import CarinaError, ProtocolError
from carina.navigate.devices.igtl import IgtlPose, IgtlRequest, IgtlStream, pack_image, pack_transform
from carina.navigate.devices.source import Listener, Source
from carina.navigate.samples import PoseSample

DEFAULT_PORT = 18944
CHUNK = 1 << 16
# Options of TCP keep-alive, in seconds (KEEPCNT: number of probes), which detect a peer that lost its power.
KEEPALIVE = (("TCP_KEEPIDLE", 4), ("TCP_KEEPALIVE", 4), ("TCP_KEEPINTVL", 2), ("TCP_KEEPCNT", 3))
# RAS is what 3D Slicer expects; Carina uses LPS.
RAS_FROM_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])
TIP_NAME = "CarinaTip"
PICTURE_NAME = "CarinaView"
MAX_PEERS = 8
CLOSING_S = 1.0


class IgtlClient(Source):
    """Client of a server of tracked tools (the PLUS toolkit and compatible servers); every tool is a device.

    Parameters
    ----------
    host, port
        Address of the server.
    tool
        Name of the only tool to use; None uses all.
    silence_s
        Time without data after which the connection is opened again. None never does so, since many peers send only
        while a tool moves or is visible; TCP keep-alive detects a disconnected peer within some 10 s.
    """

    def __init__(
        self,
        host: str,
        port: int,
        listener: Listener,
        *,
        tool: str | None = None,
        silence_s: float | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(f"openigtlink:{host}:{port}", "OpenIGTLink", listener, clock=clock)
        self._host, self._port, self._tool = host, port, tool
        self._silence_s = silence_s
        self._loop: asyncio.AbstractEventLoop | None = None
        self._task: asyncio.Task[None] | None = None
        self._devices: set[str] = set()

    def _connect_and_read(self) -> None:
        with contextlib.suppress(asyncio.CancelledError):
            asyncio.run(self._read())

    async def _read(self) -> None:
        self._loop, self._task = asyncio.get_running_loop(), asyncio.current_task()
        if self._stopping.is_set():
            return
        async with asyncio.timeout(3.0):
            reader, writer = await asyncio.open_connection(self._host, self._port)
        _keep_alive(writer)
        stream = IgtlStream()
        stream.num_bad = self.num_bad
        self._state, self._words = "live", "connected; no tracked tool yet"
        try:
            while data := await self._receive_bytes(reader):
                for message in stream.feed(data):
                    if isinstance(message, IgtlPose) and self._tool in {None, message.name}:
                        self._words = ""
                        self._pass_pose_on(message)
        except ProtocolError:
            self.num_bad["invalid headers"] += 1
            raise
        finally:
            writer.close()
            for device in self._devices:
                self._listener.disconnected(device)
            self._devices.clear()

    async def _receive_bytes(self, reader: asyncio.StreamReader) -> bytes:
        try:
            async with asyncio.timeout(self._silence_s):
                return await reader.read(CHUNK)
        except TimeoutError:
            raise TimeoutError(f"connected, but no data for {self._silence_s or 0.0:g} s") from None

    def _pass_pose_on(self, pose: IgtlPose) -> None:
        device = f"{self.address}/{pose.name}"
        self._devices.add(device)
        at_s = pose.time_s if pose.time_s > 0.0 else self._clock()
        self._publish_sample(device, PoseSample(at_s, pose.position_mm, pose.orientation_wxyz))

    def _wake_connection(self) -> None:
        loop, task = self._loop, self._task
        if loop is not None and task is not None and not loop.is_closed():
            with contextlib.suppress(RuntimeError):
                loop.call_soon_threadsafe(task.cancel)


def _keep_alive(writer: asyncio.StreamWriter) -> None:
    connection = writer.get_extra_info("socket")
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in KEEPALIVE:
        # An option that the operating system lacks keeps the system's default.
        with contextlib.suppress(AttributeError, OSError):
            connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


class IgtlServer:
    """Server that publishes the pose of the tip as TRANSFORM, and answers ``GET_IMAGE`` with the picture.

    A peer that reads slowly receives the latest pose when it reads again, and does not delay other peers.

    Parameters
    ----------
    pose
        Function that returns the current pose ``lps_from_camera``; None if there is none.
    picture
        Function that returns the current airway picture ``(height, width, 3)`` uint8, or None; called in a thread.
    host, port
        Address to listen on; port 0 selects a free port.
    rate_hz
        Rate at which the pose is sent.
    space
        ``"RAS"`` as 3D Slicer expects, or ``"LPS"``.
    """

    def __init__(
        self,
        pose: Callable[[], NDArray[np.float64] | None],
        *,
        picture: Callable[[], NDArray[np.uint8] | None] | None = None,
        host: str = "127.0.0.1",
        port: int = DEFAULT_PORT,
        rate_hz: float = 60.0,
        space: str = "RAS",
        version: int = 1,
    ) -> None:
        self._pose, self._picture = pose, picture
        self._rate_hz, self._version = rate_hz, version
        self._turn = RAS_FROM_LPS if space == "RAS" else np.eye(4)
        self._socket = _listening_socket(host, port)
        self.port: int = self._socket.getsockname()[1]
        self.num_sent = 0
        self.num_peers = 0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._task: asyncio.Task[None] | None = None
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, name="carina-openigtlink", daemon=True)

    def start(self) -> None:
        """Open the port and accept OpenIGTLink clients."""
        self._thread.start()
        self._ready.wait(5.0)

    def stop(self) -> None:
        """Stop listening, and close the connections of all clients."""
        loop, task = self._loop, self._task
        if loop is not None and task is not None and not loop.is_closed():
            with contextlib.suppress(RuntimeError):
                loop.call_soon_threadsafe(task.cancel)
        if self._thread.is_alive():
            self._thread.join()
        self._socket.close()

    def _run(self) -> None:
        with contextlib.suppress(asyncio.CancelledError):
            asyncio.run(self._serve())

    async def _serve(self) -> None:
        self._loop, self._task = asyncio.get_running_loop(), asyncio.current_task()
        peers: set[asyncio.Task[None]] = set()
        ending = False

        async def accept_client(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            task = asyncio.current_task()
            assert task is not None
            if ending or len(peers) >= MAX_PEERS:
                writer.close()
                return
            peers.add(task)
            self.num_peers = len(peers)
            try:
                await self._serve_client(reader, writer)
                # A peer that has stopped sending still receives the data that were packed for it.
                writer.close()
                async with asyncio.timeout(CLOSING_S):
                    await writer.wait_closed()
            except (OSError, ProtocolError, asyncio.CancelledError):
                pass  # The peer has disconnected, or does not use OpenIGTLink.
            finally:
                # Abort: a peer that does not read would otherwise keep the connection open until its data are flushed.
                writer.transport.abort()
                peers.discard(task)
                self.num_peers = len(peers)

        server = await asyncio.start_server(accept_client, sock=self._socket)
        self._ready.set()
        async with server:
            try:
                await asyncio.Event().wait()
            finally:
                # Peers are closed before the server, because the server waits for all connections from Python 3.12 on.
                ending = True
                server.close()
                for peer in peers:
                    peer.cancel()
                await asyncio.gather(*peers, return_exceptions=True)

    async def _serve_client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        sending = asyncio.Lock()
        poses = asyncio.create_task(self._send_poses(writer, sending))
        stream = IgtlStream()
        try:
            while data := await reader.read(CHUNK):
                for message in stream.feed(data):
                    if isinstance(message, IgtlRequest) and message.what == "GET_IMAGE" and self._picture is not None:
                        packed = await asyncio.to_thread(self._packed_picture)
                        if packed is not None:
                            async with sending:
                                writer.write(packed)
                                await writer.drain()
        finally:
            poses.cancel()
            await asyncio.gather(poses, return_exceptions=True)

    async def _send_poses(self, writer: asyncio.StreamWriter, sending: asyncio.Lock) -> None:
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            matrix = self._pose()
            if matrix is not None:
                async with sending:
                    writer.write(
                        pack_transform(TIP_NAME, self._turn @ matrix, time_s=time.time(), version=self._version)
                    )
                    await writer.drain()
                self.num_sent += 1
            # The next time follows from the clock, since errors of sleeps would add up; poses for a slow peer are
            # skipped.
            due = max(due + 1.0 / self._rate_hz, loop.time())
            await asyncio.sleep(due - loop.time())

    def _packed_picture(self) -> bytes | None:
        pixels = None if self._picture is None else self._picture()
        if pixels is None:
            return None
        return pack_image(PICTURE_NAME, np.ascontiguousarray(pixels), time_s=time.time(), version=self._version)


def _listening_socket(host: str, port: int) -> socket.socket:
    try:
        return socket.create_server((host, port), backlog=8)
    except OSError as error:
        raise CarinaError(
            f"cannot listen on {host}:{port} for OpenIGTLink: {error.strerror}; choose another port",
            code="server.port",
        ) from error
