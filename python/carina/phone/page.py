"""HTTPS server for the page that makes a phone an input device; the user starts it explicitly.

The server is separate from the workstation's server: it has its own socket, bound to the address in the local network,
its own token, and an application with one page, its files and one WebSocket. It gives no access to the data of a case.
The samples that it receives are processed like those of every device (``navigate.Pilot``).
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import uvicorn
from msgspec.structs import replace
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from carina.commands import CycleControl, DeviceGone, LevelHorizon, ResetLook
from carina.errors import CarinaError, ProtocolError
from carina.phone.link import DEVICE, PhoneLink
from carina.server.files.web_files import asset_path
from carina.server.network.access_checks import Gate, TokenGate
from carina.server.network.access_middleware import GateMiddleware, page
from carina.server.network.certificate import Certificate, make_certificate
from carina.server.network.lan_server import LanServer
from carina.server.network.listening import bind, lan_address
from carina.server.sockets.close_codes import close_socket
from carina.server.sockets.socket_io import start_sender
from carina.server.wire import messages as wire
from carina.session import Session
from carina.session.jobs.background_jobs import log_fault

logger = logging.getLogger(__name__)

HELLO_WITHIN_S = 5.0
WRONG_TOKEN_WAIT_S = 0.5
STATE_EVERY_S = 0.25
STARTS_WITHIN_S = 20.0


def qr_rows(text: str) -> tuple[str, ...]:
    """Return a text as QR code, with a border of four modules, as rows of 0 (light) and 1 (dark)."""
    import segno

    code = segno.make_qr(text, error="m")
    return tuple("".join("1" if dark else "0" for dark in row) for row in code.matrix_iter(border=4))


@dataclass(slots=True)
class _RunningPage:
    """Server, thread, tokens and wire state of a running phone page."""

    server: uvicorn.Server
    thread: threading.Thread
    tokens: TokenGate
    info: wire.PhoneInfo


class PhonePage:
    """Server of the phone page, which passes the samples of the phone to the session.

    Parameters
    ----------
    session
        Session whose tip the phone moves.
    web
        Folder of the built client.
    address
        Address to listen on; None selects this machine's address in the local network.
    changed
        Callback for a phone that connects or disconnects; called from any thread.
    """

    def __init__(self, session: Session, *, web: Path, address: str | None = None) -> None:
        self.changed: Callable[[], None] = lambda: None
        self._session = session
        self._web = web
        self._address = address
        self._open: _RunningPage | None = None
        self._lock = threading.Lock()
        # Only the page's event loop uses these; info() reads them from other threads.
        self._link: PhoneLink | None = None
        self._socket: WebSocket | None = None
        self._words = ""

    # ------------------------------------------------------------ start and stop

    def start(self) -> wire.PhoneInfo:
        """Start the page with a new key, certificate and token; do nothing if it runs already.

        Raises
        ------
        CarinaError
            With code ``server.no-network`` or ``server.host``.
        """
        with self._lock:
            if self._open is not None:
                return self._open.info
            address = self._address or lan_address()
            certificate = make_certificate(address)
            sock = bind(address, 0)
            try:
                self._open = self._start_server(sock, address, certificate)
            except BaseException:
                sock.close()
                raise
            info = self._open.info
        self.changed()
        return info

    def stop(self) -> None:
        """Stop the page, invalidate its link, token and certificate, and return when its port is closed."""
        with self._lock:
            opened, self._open = self._open, None
            if opened is None:
                return
            opened.server.should_exit = True
            opened.thread.join()
        self.changed()

    def info(self) -> wire.PhoneInfo | None:
        """Return the state of the page for the wire; None while the page is stopped."""
        opened, link = self._open, self._link
        if opened is None:
            return None
        bad = {} if link is None else dict(link.num_bad)
        return replace(
            opened.info,
            connected=self._socket is not None,
            rate_hz=0.0 if link is None else link.rate_hz(time.monotonic()),
            num_bad=sum(bad.values()),
            bad_words=", ".join(f"{why} ({n})" for why, n in bad.items()),
            num_refused=opened.tokens.num_refused,
        )

    def _start_server(self, sock: object, address: str, certificate: Certificate) -> _RunningPage:
        port = sock.getsockname()[1]  # type: ignore[attr-defined]
        tokens = TokenGate()
        shown = f"[{address}]" if ":" in address else address
        # A browser sends the part after # to no server and in no Referer header; the page sends the token itself.
        url = f"https://{shown}:{port}/#{tokens.token}"
        started = threading.Event()
        app = self._app(Gate(host=address, port=port, scheme="https"), tokens)
        server = LanServer(app, certificate, max_message_bytes=wire.MAX_PHONE_BYTES, on_started=started.set)
        thread = threading.Thread(target=server.run, args=([sock],), name="carina-phone", daemon=True)
        thread.start()
        if not started.wait(STARTS_WITHIN_S):
            server.should_exit = True
            raise CarinaError("the phone page did not start", code="phone.not-started")
        info = wire.PhoneInfo(
            url=url,
            address=address,
            sha256=certificate.sha256,
            num_refused=0,
            qr=qr_rows(url),
            connected=False,
            rate_hz=0.0,
            num_bad=0,
            bad_words="",
        )
        return _RunningPage(server, thread, tokens, info)

    # ------------------------------------------------------------ requests

    def _app(self, gate: Gate, tokens: TokenGate) -> Starlette:
        async def index(_request: Request) -> Response:
            return FileResponse(self._web / "phone.html", headers={"cache-control": "no-store"})

        async def asset(request: Request) -> Response:
            found = asset_path(self._web, f"assets/{request.path_params['name']}")
            # The scripts of the workstation contain no secrets, but the phone page does not need them.
            if found is None or not found.name.startswith("phone"):
                return page("Page not found", "This page does not exist.", 404)
            return FileResponse(found, headers={"cache-control": "no-cache"})

        async def socket(websocket: WebSocket) -> None:
            await websocket.accept()
            await self._serve_phone(websocket, tokens)

        app = Starlette(
            routes=[
                Route("/", index),
                Route("/assets/{name}", asset),
                WebSocketRoute("/phone", socket),
            ]
        )
        app.add_middleware(GateMiddleware, gate=gate)
        return app

    async def _serve_phone(self, websocket: WebSocket, tokens: TokenGate) -> None:
        """Serve one phone from its hello message until its socket closes."""
        teller: asyncio.Task[None] | None = None
        link = PhoneLink(self._receive_sample, self._run_action, clutch_held_moves=self._does_clutch_enable_movement)
        try:
            async with asyncio.timeout(HELLO_WITHIN_S):
                hello = wire.parse_phone_message(await _receive(websocket) or b"")
            if not isinstance(hello, wire.PhoneHello):
                raise ProtocolError("the first message must be phone_hello", code="protocol.order")
            if hello.wire_version != wire.WIRE_VERSION:
                raise ProtocolError(
                    "this page and Carina have different versions; reload the page", code="protocol.version"
                )
            if not tokens.admits(hello.token):
                # The delay slows down a client that guesses tokens.
                await asyncio.sleep(WRONG_TOKEN_WAIT_S)
                raise ProtocolError(
                    "this link is no longer valid; scan the code on the workstation", code="protocol.not-authorised"
                )
            await self._replace_connection(websocket, link)
            teller = start_sender(websocket, "a phone", self._send_states(websocket))
            while True:
                link.process_message(await _receive(websocket), time.monotonic())
                if self._socket is not websocket:
                    return
                if link.is_broken:
                    raise ProtocolError("too many messages could not be read", code="protocol.malformed")
        except ProtocolError as error:
            await close_socket(websocket, error.code, str(error))
        except TimeoutError:
            await close_socket(websocket, "protocol.order", "the client sent no hello message")
        except WebSocketDisconnect:
            pass
        except Exception as error:
            log_fault(logger, "the connection to a phone failed", error)
        finally:
            if teller is not None:
                teller.cancel()
                with contextlib.suppress(asyncio.CancelledError):
                    await teller
            if self._socket is websocket:
                self._socket = None
                self._session.do(DeviceGone(DEVICE))
                self.changed()

    async def _replace_connection(self, websocket: WebSocket, link: PhoneLink) -> None:
        """Give control of the tip to the newest connection, and close the previous one.

        A phone that loses its network can connect again before the server notices that the old connection is dead.
        """
        before, self._socket, self._link, self._words = self._socket, websocket, link, ""
        if before is not None:
            self._session.do(DeviceGone(DEVICE))
            await close_socket(
                before, "protocol.taken-over", "another phone, or another page on this phone, has taken over"
            )
        self.changed()

    async def _send_states(self, websocket: WebSocket) -> None:
        """Send the state of the page to the phone whenever the state changes."""
        last_sent = ""
        while True:
            text = wire.encode_message(self._state())
            if text != last_sent:
                await websocket.send_text(text)
                last_sent = text
            await asyncio.sleep(STATE_EVERY_S)

    def _state(self) -> wire.PhoneState:
        devices = self._session.devices.info()
        words = self._words
        if devices is None:
            return wire.PhoneState(False, "relative", False, False, words)
        pose = self._session.pose_info()
        holds = any(device.device == DEVICE and device.holds for device in devices.devices)
        return wire.PhoneState(True, devices.control, pose is not None and pose.mode == "scope", holds, words)

    # ------------------------------------------------------------ samples and actions

    def _receive_sample(self, sample: object) -> None:
        self._session.devices.receive_sample(DEVICE, sample)  # type: ignore[arg-type]

    def _does_clutch_enable_movement(self) -> bool:
        devices = self._session.devices.info()
        return devices is not None and devices.controls.clutch == "hold"

    def _run_action(self, action: str) -> None:
        self._words = ""
        try:
            pose = self._session.pose_info()
            if action == "next_control":
                self._session.do(CycleControl())
            elif pose is not None and pose.mode != "path":
                # Outside path mode the tip already looks ahead, so the button levels the horizon.
                self._session.do(LevelHorizon())
            else:
                self._session.do(ResetLook())
        except CarinaError as error:
            self._words = str(error)


async def _receive(websocket: WebSocket) -> str | None:
    """Return the next text message of the socket; None for a binary message."""
    message = await websocket.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1006), message.get("reason"))
    text = message.get("text")
    return None if text is None else str(text)
