"""The web application: the client's files, uploads, and the socket, behind the gate."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from importlib.resources import files
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

import carina
from carina.errors import CarinaError, ProtocolError, UsageError
from carina.server import messages as wire
from carina.server.hub import Hub, Outbox
from carina.server.security import Gate
from carina.server.uploads import Uploads

__all__ = ["create_app", "web_folder"]

CONTENT_SECURITY_POLICY = (
    "default-src 'self'; img-src 'self' blob: data:; style-src 'self' 'unsafe-inline'; connect-src 'self'; "
    "worker-src 'self' blob:; object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Only our own files; inline styles because the panels' library sets them on elements."""
SECURITY_HEADERS = {
    "content-security-policy": CONTENT_SECURITY_POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
}
PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><title>Carina</title>
<body style="margin:15vh auto;max-width:36rem;padding:0 1rem;font:16px/1.5 system-ui;background:#0e1113;color:#e6e8ea">
<h1 style="font-size:1.3rem">{title}</h1><p>{words}</p></body></html>
"""
HELLO_WITHIN_S = 20.0


def web_folder() -> Path | None:
    """Where the built client lies, or None if it was not built."""
    folder = Path(str(files("carina"))) / "_web"
    return folder if (folder / "index.html").is_file() else None


class GateMiddleware:
    """Host and Origin of every request, HTTP and WebSocket, before anything else; security headers on every answer."""

    def __init__(self, app: ASGIApp, gate: Gate) -> None:
        self._app = app
        self._gate = gate

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        method = scope["method"] if scope["type"] == "http" else None
        refusal = self._gate.refusal(method=method, headers=Headers(scope=scope))
        if refusal is not None:
            if scope["type"] == "websocket":
                # Before it is accepted: the server answers 403.
                await send({"type": "websocket.close", "code": 1008, "reason": refusal})
                return
            await _page("Carina does not answer this", refusal, 403)(scope, receive, _with_headers(send))
            return
        await self._app(scope, receive, _with_headers(send) if scope["type"] == "http" else send)


def _with_headers(send: Send) -> Send:
    async def send_with_headers(message: Message) -> None:
        if message["type"] == "http.response.start":
            present = {name.lower() for name, _ in message["headers"]}
            message["headers"] = [
                *message["headers"],
                *((k.encode(), v.encode()) for k, v in SECURITY_HEADERS.items() if k.encode() not in present),
            ]
        await send(message)

    return send_with_headers


def _page(title: str, words: str, status: int) -> Response:
    return HTMLResponse(PAGE.format(title=title, words=words), status, headers={"cache-control": "no-store"})


def _error(trouble: CarinaError, status: int) -> JSONResponse:
    return JSONResponse({"code": trouble.code, "message": str(trouble), "action": None}, status)


def create_app(hub: Hub, gate: Gate, uploads: Uploads, *, web: Path | None = None) -> Starlette:
    """The ASGI application.

    Parameters
    ----------
    hub
        Session, pump and client; started and stopped with the application.
    gate
        Secrets and checks.
    uploads
        Dropped files.
    web
        Folder of the built client; None shows a page that says how to build it.
    """

    async def index(request: Request) -> Response:
        token = request.query_params.get("token")
        if token is not None:
            if gate.redeem(token):
                return RedirectResponse("/", 303, headers={"set-cookie": gate.set_cookie, "cache-control": "no-store"})
            if gate.authorised(request.headers):
                return RedirectResponse("/", 303, headers={"cache-control": "no-store"})
            words = (
                "A link works once, so that nobody else can use it. Start Carina again, or go back to the open window."
            )
            return _page("This link was used already", words, 403)
        # No cookie is asked for here: after a click in another site's page the browser withholds a Strict cookie from
        # this navigation, but not from the socket that the page then opens. The files hold nothing of a patient.
        if web is None:
            words = "The window of Carina has not been built. Run <code>make run</code> in the repository, then reload."
            return _page("Nothing to show yet", words, 503)
        return FileResponse(web / "index.html", headers={"cache-control": "no-store"})

    async def asset(request: Request) -> Response:
        found = _asset_path(web, request.path_params["path"])
        if found is None:
            return _page("Nothing here", "Carina has no such page.", 404)
        # The builder puts a hash of the content in the name of everything below assets/.
        lasting = found.parent.name == "assets"
        return FileResponse(
            found, headers={"cache-control": "public, max-age=31536000, immutable" if lasting else "no-cache"}
        )

    async def begin_upload(request: Request) -> Response:
        if not gate.authorised(request.headers):
            return _error(CarinaError("this page has no access", code="protocol.not-authorised"), 401)
        try:
            return JSONResponse({"upload_id": uploads.begin()}, 201)
        except CarinaError as trouble:
            return _error(trouble, 507)

    async def one_upload(request: Request) -> Response:
        if not gate.authorised(request.headers):
            return _error(CarinaError("this page has no access", code="protocol.not-authorised"), 401)
        upload_id = request.path_params["upload_id"]
        if request.method == "DELETE":
            uploads.discard(upload_id)
            return Response(status_code=204)
        try:
            await uploads.add(upload_id, request.query_params.get("name", ""), request.stream())
        except UsageError as trouble:
            return _error(trouble, 413 if trouble.code == "upload.limit" else 404)
        except CarinaError as trouble:
            return _error(trouble, 507)
        return JSONResponse({}, 201)

    async def socket(websocket: WebSocket) -> None:
        await websocket.accept()
        if not gate.authorised(websocket.headers):
            reason = "this page belongs to an earlier start of Carina; open the link that it printed"
            await websocket.close(wire.CLOSE_CODES["protocol.not-authorised"], reason)
            return
        await _serve_client(websocket, hub)

    @contextlib.asynccontextmanager
    async def lifespan(_app: Starlette) -> AsyncIterator[None]:
        hub.start()
        try:
            yield
        finally:
            await asyncio.to_thread(hub.stop)

    routes: list[Any] = [
        Route("/", index),
        Route("/api/upload", begin_upload, methods=["POST"]),
        Route("/api/upload/{upload_id}", one_upload, methods=["PUT", "DELETE"]),
        WebSocketRoute("/ws", socket),
        Route("/{path:path}", asset),
    ]
    app = Starlette(routes=routes, lifespan=lifespan)
    app.add_middleware(GateMiddleware, gate=gate)
    app.state.gate = gate
    app.state.hub = hub
    return app


def _asset_path(web: Path | None, name: str) -> Path | None:
    """A file below the client's folder; None for anything else."""
    if web is None or "\0" in name:
        return None
    try:
        path = (web / name).resolve()
        return path if path.is_relative_to(web.resolve()) and path.is_file() else None
    except OSError:
        # A name that no file system takes: too long, or of too many parts.
        return None


async def _serve_client(websocket: WebSocket, hub: Hub) -> None:
    """One client, from its hello to its end."""
    outbox: Outbox | None = None
    sender: asyncio.Task[None] | None = None
    try:
        async with asyncio.timeout(HELLO_WITHIN_S):
            hello = wire.parse_client_message(await _receive_text(websocket))
        if not isinstance(hello, wire.ClientHello):
            raise ProtocolError("the first message must be hello", code="protocol.order")
        if hello.wire_version != wire.WIRE_VERSION:
            msg = (
                f"this page speaks version {hello.wire_version} and Carina version {wire.WIRE_VERSION}; reload the page"
            )
            raise ProtocolError(msg, code="protocol.version")
        await websocket.send_text(wire.encode_message(wire.ServerHello(wire.WIRE_VERSION, carina.__version__)))
        outbox = hub.attach()
        sender = asyncio.create_task(_send_all(websocket, hub, outbox))
        while True:
            message = wire.parse_client_message(await _receive_text(websocket))
            if hub.is_current(outbox):
                hub.handle(message)
    except ProtocolError as trouble:
        await _close(
            websocket, wire.CLOSE_CODES.get(trouble.code, wire.CLOSE_CODES["protocol.malformed"]), str(trouble)
        )
    except TimeoutError:
        await _close(websocket, wire.CLOSE_CODES["protocol.order"], "no hello came")
    except WebSocketDisconnect:
        pass
    finally:
        if outbox is not None:
            hub.detach(outbox)
        if sender is not None:
            sender.cancel()
            with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await sender


async def _receive_text(websocket: WebSocket) -> str:
    message = await websocket.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1006), message.get("reason"))
    text = message.get("text")
    if text is None:
        raise ProtocolError("a client sends text, no binary messages", code="protocol.type")
    return str(text)


async def _send_all(websocket: WebSocket, hub: Hub, outbox: Outbox) -> None:
    while True:
        topics, texts, pictures = await outbox.take()
        if not hub.is_current(outbox):
            reason = "Carina was opened in another window"
            await _close(websocket, wire.CLOSE_CODES["protocol.taken-over"], reason)
            return
        if outbox.overflowed:
            await _close(websocket, wire.CLOSE_CODES["protocol.slow-client"], "this window did not keep up")
            return
        for topic in topics:
            text = hub.topic_text(topic)
            if text is not None and outbox.is_news(topic, text):
                await websocket.send_text(text)
        for text in texts:
            await websocket.send_text(text)
        for picture in pictures:
            await websocket.send_bytes(picture)


async def _close(websocket: WebSocket, code: int, reason: str) -> None:
    if websocket.application_state is not WebSocketState.CONNECTED:
        return
    # A close frame holds 125 bytes, two of them the code.
    short = reason.encode()[:123].decode(errors="ignore")
    with contextlib.suppress(RuntimeError, WebSocketDisconnect):
        await websocket.close(code, short)
