"""HTTPS server of the viewing page for observers in the local network; the user starts it explicitly.

The server runs in the event loop of the workstation, because the messages for observers are created there. It serves
the files of the web client and one WebSocket. A client without the token of the link gets no window.
"""

from __future__ import annotations

import asyncio
import contextlib
import importlib.util
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from msgspec.structs import replace
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from carina.errors import CarinaError, ProtocolError, UsageError
from carina.installation import extra_command, not_built
from carina.server.files.web_files import asset_path
from carina.server.network.access_checks import Gate, TokenGate
from carina.server.network.access_middleware import GateMiddleware, page
from carina.server.network.certificate import make_certificate
from carina.server.network.lan_server import LanServer
from carina.server.network.listening import bind, lan_address
from carina.server.observers.window import WatchingWindow
from carina.server.sockets.rate_limits import FLOOD
from carina.server.windows.websocket_session import serve_window
from carina.server.windows.window import Window
from carina.server.wire import messages as wire

MAX_WATCHERS = 4
"""Maximum number of observers; the windows of the workstation are not counted."""
MAX_MESSAGE_BYTES = 8192
MAX_BYTES_PER_S = 65_536
"""Maximum number of bytes per s that one observer may send; 600 messages have about 50,000 bytes."""
WRONG_TOKEN_WAIT_S = 0.5
CLOSE_TIMEOUT_S = 1.0
"""Maximum time in s in which observers can receive the reason for the page's end before it closes."""


@dataclass(slots=True)
class _OpenPage:
    """Server, task, tokens and observers of an open viewing page."""

    server: LanServer
    serving: asyncio.Task[None]
    tokens: TokenGate
    address: str
    port: int
    sha256: str
    watchers: dict[int, tuple[WatchingWindow, wire.Watcher]] = field(default_factory=dict)
    nobody: asyncio.Event = field(default_factory=asyncio.Event)
    is_closing: bool = False

    def info(self) -> wire.WatchPage:
        shown = f"[{self.address}]" if ":" in self.address else self.address
        # A browser sends the part after # to no server and in no Referer header; the page sends the token itself.
        url = f"https://{shown}:{self.port}/#{self.tokens.token}"
        watchers = tuple(watcher for _, watcher in self.watchers.values())
        return wire.WatchPage(
            url=url,
            address=self.address,
            sha256=self.sha256,
            num_refused=self.tokens.num_refused,
            watchers=watchers,
        )


class ObserverPageServer:
    """Server of the viewing page, which can be started and stopped; call its methods in the event loop.

    Parameters
    ----------
    attach
        Function that creates the window of an observer.
    changed
        Called when the page opens or closes, and when an observer connects or disconnects.
    flooded
        Called when an observer was disconnected for sending too many messages.
    web
        Folder of the built client; None if the client was not built.
    address
        Address to listen on; None selects this machine's address in the local network.
    """

    def __init__(
        self,
        attach: Callable[[], WatchingWindow],
        changed: Callable[[], None],
        *,
        flooded: Callable[[], None] = lambda: None,
        web: Path | None,
        address: str | None = None,
    ) -> None:
        self._attach = attach
        self._changed = changed
        self._flooded = flooded
        self._web = web
        self._address = address
        self._open: _OpenPage | None = None
        self._switching = asyncio.Lock()
        self.shares_learners = False
        """Whether observers receive the learners of the training; False whenever the page is closed."""

    @cached_property
    def problem(self) -> str | None:
        """Message for the user why the page cannot be opened; None if it can be opened."""
        if self._web is None:
            return not_built("the window")
        if importlib.util.find_spec("cryptography") is None:
            return f"watching needs another library; install it with: {extra_command('phone')}"
        return None

    @property
    def is_open(self) -> bool:
        """Whether the viewing page is open, so that observers can connect."""
        return self._open is not None

    def info(self) -> wire.WatchPage | None:
        """Return the state of the page for the wire; None while the page is closed."""
        return None if self._open is None else replace(self._open.info(), learners=self.shares_learners)

    async def start(self) -> None:
        """Open the page with a new key, certificate and token; do nothing if it is open already.

        Raises
        ------
        CarinaError
            ``watch.missing`` if the client was not built; ``server.no-network`` or ``server.host`` without a usable
            address.
        """
        async with self._switching:
            if self._open is not None:
                return
            if self.problem is not None:
                raise CarinaError(self.problem, code="watch.missing")
            address = self._address or lan_address()
            certificate = await asyncio.to_thread(make_certificate, address)
            sock = bind(address, 0)
            tokens, started = TokenGate(), asyncio.Event()
            port = sock.getsockname()[1]
            app = self._create_app(Gate(host=address, port=port, scheme="https"), tokens)
            server = LanServer(
                app,
                certificate,
                max_message_bytes=MAX_MESSAGE_BYTES,
                on_started=started.set,
                max_bytes_per_s=MAX_BYTES_PER_S,
            )
            loop = asyncio.get_running_loop()
            handler = loop.get_exception_handler()
            serving = loop.create_task(server.serve(sockets=[sock]))
            waiting = loop.create_task(started.wait())
            await asyncio.wait({serving, waiting}, return_when=asyncio.FIRST_COMPLETED)
            # Restore the exception handler of the workstation's server.
            loop.set_exception_handler(handler)
            if not started.is_set():
                waiting.cancel()
                sock.close()
                raise CarinaError("the page for watchers did not start", code="watch.not-started")
            self._open = _OpenPage(server, serving, tokens, address, port, certificate.sha256)
            self._changed()

    async def stop(self, words: str) -> None:
        """Close the page, invalidate its link, token and certificate, and return when its port is closed.

        ``words`` is the reason that observers receive.
        """
        async with self._switching:
            opened = self._open
            if opened is None:
                return
            opened.is_closing = True
            self.shares_learners = False
            if opened.watchers:
                opened.nobody.clear()
                for window, _ in opened.watchers.values():
                    window.disconnect(words)
                # Observers that do not read the reason in time are disconnected.
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(CLOSE_TIMEOUT_S):
                        await opened.nobody.wait()
            opened.server.should_exit = True
            await opened.serving
            self._open = None
        self._changed()

    def disconnect(self, number: int) -> None:
        """Disconnect an observer, and replace the token, so that the previous link no longer works.

        Raises
        ------
        UsageError
            If no observer has this number.
        """
        found = None if self._open is None else self._open.watchers.get(number)
        if self._open is None or found is None:
            raise UsageError("this watcher has already left", code="watch.gone")
        self._open.tokens.renew()
        found[0].disconnect("the person at the workstation has disconnected you")
        self._changed()

    # ------------------------------------------------------------ requests

    def _create_app(self, gate: Gate, tokens: TokenGate) -> Starlette:
        async def index(_request: Request) -> Response:
            return self._web_file("index.html")

        async def asset(request: Request) -> Response:
            return self._web_file(request.path_params["path"])

        async def socket(websocket: WebSocket) -> None:
            await websocket.accept()
            opened = self._open
            came: list[WatchingWindow] = []
            address = websocket.client.host if websocket.client is not None else "unknown"

            async def attach(hello: wire.ClientHello) -> Window:
                came.append(await self._admit_observer(hello, tokens, address))
                return came[0]

            code: int | None = None
            try:
                code = await serve_window(websocket, attach)
            finally:
                if opened is not None and came:
                    if code == wire.CLOSE_CODES[FLOOD]:
                        # The previous link becomes invalid, as after send_away().
                        opened.tokens.renew()
                        self._flooded()
                    del opened.watchers[came[0].number]
                    if not opened.watchers:
                        opened.nobody.set()
                    self._changed()

        app = Starlette(routes=[Route("/", index), WebSocketRoute("/ws", socket), Route("/{path:path}", asset)])
        app.add_middleware(GateMiddleware, gate=gate)
        return app

    def _web_file(self, name: str) -> Response:
        found = asset_path(self._web, name)
        # The phone page belongs to another server.
        if found is None or found.name == "phone.html":
            return page("Page not found", "This page does not exist.", 404)
        return FileResponse(found, headers={"cache-control": "no-store"})

    async def _admit_observer(self, hello: wire.ClientHello, tokens: TokenGate, address: str) -> WatchingWindow:
        if not tokens.admits(hello.token or ""):
            # The delay slows down a client that guesses tokens.
            await asyncio.sleep(WRONG_TOKEN_WAIT_S)
            self._changed()
            msg = "this link is no longer valid; ask the person at the workstation for a new one"
            raise ProtocolError(msg, code="protocol.not-authorised")
        opened = self._open
        if opened is None or opened.is_closing:
            msg = "this case is no longer shared; ask the person at the workstation for a new link"
            raise ProtocolError(msg, code="protocol.watching-ended")
        if len(opened.watchers) >= MAX_WATCHERS:
            msg = f"{MAX_WATCHERS} people are already watching; connect again when one of them has left"
            raise ProtocolError(msg, code="protocol.too-many-windows")
        try:
            window = self._attach()
        except UsageError as error:
            raise ProtocolError(str(error), code="protocol.watching-ended") from error
        opened.watchers[window.number] = window, wire.Watcher(window.number, address, time.time())
        self._changed()
        return window
