"""The page by which others of the local network watch: an encrypted server of its own, off until a person opens it.

It runs in the workstation's event loop, since what it shows is written there. It knows the client's files and one
socket; whoever does not bring the link's token gets no window.
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

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from carina.errors import CarinaError, ProtocolError, UsageError
from carina.installation import extra_command, not_built
from carina.server import messages as wire
from carina.server.certificate import make_certificate
from carina.server.conversation import converse
from carina.server.gate_middleware import GateMiddleware, page
from carina.server.lan_server import LanServer
from carina.server.listening import bind, lan_address
from carina.server.message_limits import FLOOD
from carina.server.security import Gate, TokenGate
from carina.server.watching_window import WatchingWindow
from carina.server.web_files import asset_path
from carina.server.window import Window

__all__ = ["MAX_WATCHERS", "WatchPage"]

MAX_WATCHERS = 4
"""Beside the windows of who works here."""
MAX_MESSAGE_BYTES = 8192
MAX_BYTES_PER_S = 65_536
"""Of one observer; 600 messages have about 50,000 bytes."""
WRONG_TOKEN_WAIT_S = 0.5
FAREWELL_S = 1.0
"""How long watchers may take to hear why they are sent away."""


@dataclass(slots=True)
class _Open:
    """All that ends when the page is closed."""

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
        # Behind the #: a browser sends it nowhere and keeps it out of every Referer; the page hands it over by itself.
        url = f"https://{shown}:{self.port}/#{self.tokens.token}"
        watchers = tuple(watcher for _, watcher in self.watchers.values())
        return wire.WatchPage(
            url=url,
            address=self.address,
            sha256=self.sha256,
            num_refused=self.tokens.num_refused,
            watchers=watchers,
        )


class WatchPage:
    """Opens and closes the page; event loop only.

    Parameters
    ----------
    attach
        Makes a window for a watcher.
    changed
        Told when the page opens or closes, and when a watcher comes or goes.
    flooded
        Called when an observer was disconnected for sending too many messages.
    web
        Folder of the built client; None where it was not built.
    address
        Where to listen; None takes this machine's address in its network.
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
        self._open: _Open | None = None
        self._switching = asyncio.Lock()

    @cached_property
    def problem(self) -> str | None:
        """Why it cannot be opened, in words."""
        if self._web is None:
            return not_built("the window")
        if importlib.util.find_spec("cryptography") is None:
            return f"watching needs another library; install it with: {extra_command('phone')}"
        return None

    @property
    def is_open(self) -> bool:
        """Whether anybody may watch."""
        return self._open is not None

    def info(self) -> wire.WatchPage | None:
        """Return what the windows show of the page; None while it is closed."""
        return None if self._open is None else self._open.info()

    async def start(self) -> None:
        """Open it, with a new key, certificate and token; the same again changes nothing.

        Raises
        ------
        CarinaError
            ``watch.missing``; ``server.no-network``, ``server.host``.
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
            app = self._app(Gate(host=address, port=port, scheme="https"), tokens)
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
            # What this loop cannot accept is told to the workstation's own server, as before.
            loop.set_exception_handler(handler)
            if not started.is_set():
                waiting.cancel()
                sock.close()
                raise CarinaError("the page for watchers did not start", code="watch.not-started")
            self._open = _Open(server, serving, tokens, address, port, certificate.sha256)
            self._changed()

    async def stop(self, words: str) -> None:
        """Close it: link, token and certificate are void. Returns when nothing listens any more.

        ``words`` tell the watchers why.
        """
        async with self._switching:
            opened = self._open
            if opened is None:
                return
            opened.is_closing = True
            if opened.watchers:
                opened.nobody.clear()
                for window, _ in opened.watchers.values():
                    window.send_away(words)
                # Whoever does not read it is cut off.
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(FAREWELL_S):
                        await opened.nobody.wait()
            opened.server.should_exit = True
            await opened.serving
            self._open = None
        self._changed()

    def send_away(self, number: int) -> None:
        """End a watcher's connection; by the link that it had nobody comes in any more.

        Raises
        ------
        UsageError
            If there is no such watcher.
        """
        found = None if self._open is None else self._open.watchers.get(number)
        if self._open is None or found is None:
            raise UsageError("this watcher has already left", code="watch.gone")
        self._open.tokens.renew()
        found[0].send_away("the person at the workstation has disconnected you")
        self._changed()

    # ------------------------------------------------------------ what it answers

    def _app(self, gate: Gate, tokens: TokenGate) -> Starlette:
        async def index(_request: Request) -> Response:
            return self._file("index.html")

        async def asset(request: Request) -> Response:
            return self._file(request.path_params["path"])

        async def socket(websocket: WebSocket) -> None:
            await websocket.accept()
            opened = self._open
            came: list[WatchingWindow] = []
            address = websocket.client.host if websocket.client is not None else "unknown"

            async def attach(hello: wire.ClientHello) -> Window:
                came.append(await self._admitted(hello, tokens, address))
                return came[0]

            code: int | None = None
            try:
                code = await converse(websocket, attach)
            finally:
                if opened is not None and came:
                    if code == wire.CLOSE_CODES[FLOOD]:
                        # Nobody comes back by the same link, as after an observer was sent away.
                        opened.tokens.renew()
                        self._flooded()
                    del opened.watchers[came[0].number]
                    if not opened.watchers:
                        opened.nobody.set()
                    self._changed()

        app = Starlette(routes=[Route("/", index), WebSocketRoute("/ws", socket), Route("/{path:path}", asset)])
        app.add_middleware(GateMiddleware, gate=gate)
        return app

    def _file(self, name: str) -> Response:
        found = asset_path(self._web, name)
        # The page for a phone has nothing to do here.
        if found is None or found.name == "phone.html":
            return page("Page not found", "This page does not exist.", 404)
        return FileResponse(found, headers={"cache-control": "no-store"})

    async def _admitted(self, hello: wire.ClientHello, tokens: TokenGate, address: str) -> WatchingWindow:
        if not tokens.admits(hello.token or ""):
            # Who tries others waits.
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
        except UsageError as trouble:
            raise ProtocolError(str(trouble), code="protocol.watching-ended") from trouble
        opened.watchers[window.number] = window, wire.Watcher(window.number, address, time.time())
        self._changed()
        return window
