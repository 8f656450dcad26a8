"""The web application: the client's files, uploads, and the socket, behind the gate."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

import carina
from carina.errors import CarinaError, DiskError, ProtocolError
from carina.server import messages as wire
from carina.server.closing import close_socket
from carina.server.downloads import Downloads
from carina.server.gate_middleware import GateMiddleware, page
from carina.server.hub import Hub
from carina.server.programs import JOIN_PATH, serve_program
from carina.server.security import Gate
from carina.server.senders import start_sender
from carina.server.uploads import Uploads
from carina.server.web_files import asset_path, web_folder
from carina.server.window import Window

__all__ = ["create_app", "web_folder"]

HELLO_WITHIN_S = 20.0


def _status(trouble: CarinaError, usual: int) -> int:
    """HTTP status of a refused file: 507 where the disk takes nothing."""
    if isinstance(trouble, DiskError):
        return 507
    return {"export.suffix": 404, "upload.limit": 413}.get(trouble.code, usual)


def _error(trouble: CarinaError, status: int) -> JSONResponse:
    return JSONResponse({"code": trouble.code, "message": str(trouble), "action": None}, status)


def _not_authorised() -> JSONResponse:
    words = "this page is not authorised: open it again with the link that Carina printed when it started"
    return _error(CarinaError(words, code="protocol.not-authorised"), 401)


def create_app(hub: Hub, gate: Gate, uploads: Uploads, *, web: Path | None = None) -> Starlette:
    """The ASGI application.

    Parameters
    ----------
    hub
        Session and windows; started and stopped with the application.
    gate
        Secrets and checks.
    uploads
        Dropped files.
    web
        Folder of the built client; None shows a page that says how to build it.
    """

    downloads = Downloads(hub.session)

    async def index(request: Request) -> Response:
        token = request.query_params.get("token")
        if token is not None:
            if gate.redeem(token):
                return RedirectResponse("/", 303, headers={"set-cookie": gate.set_cookie, "cache-control": "no-store"})
            if gate.authorised(request.headers):
                return RedirectResponse("/", 303, headers={"cache-control": "no-store"})
            words = (
                "The link works only once, so that nobody else can use it. Restart Carina, or go back to the open "
                "window."
            )
            return page("This link has already been used", words, 403)
        # No cookie is asked for here: after a click in another site's page the browser withholds a Strict cookie from
        # this navigation, but not from the socket that the page then opens. The files hold nothing of a patient.
        if web is None:
            words = "The Carina window has not been built. Run <code>make run</code> in the repository, then reload."
            return page("The window has not been built", words, 503)
        return FileResponse(web / "index.html", headers={"cache-control": "no-store"})

    async def asset(request: Request) -> Response:
        found = asset_path(web, request.path_params["path"])
        if found is None:
            return page("Nothing here", "This page does not exist.", 404)
        # The builder puts a hash of the content in the name of everything below assets/.
        lasting = found.parent.name == "assets"
        return FileResponse(
            found, headers={"cache-control": "public, max-age=31536000, immutable" if lasting else "no-cache"}
        )

    async def begin_upload(request: Request) -> Response:
        if not gate.authorised(request.headers):
            return _not_authorised()
        try:
            return JSONResponse({"upload_id": uploads.begin()}, 201)
        except CarinaError as trouble:
            return _error(trouble, 507)

    async def one_upload(request: Request) -> Response:
        if not gate.authorised(request.headers):
            return _not_authorised()
        upload_id = request.path_params["upload_id"]
        if request.method == "DELETE":
            uploads.discard(upload_id)
            return Response(status_code=204)
        try:
            await uploads.add(upload_id, request.query_params.get("name", ""), request.stream())
        except CarinaError as trouble:
            return _error(trouble, _status(trouble, 404))
        return JSONResponse({}, 201)

    async def download(request: Request) -> Response:
        if not gate.authorised(request.headers):
            return _not_authorised()
        try:
            return await downloads.answer(request.path_params["suffix"])
        except CarinaError as trouble:
            return _error(trouble, _status(trouble, 409))

    async def key_frames(request: Request) -> Response:
        if not gate.authorised(request.headers):
            return _not_authorised()
        try:
            return await downloads.key_frames()
        except CarinaError as trouble:
            return _error(trouble, 409)

    async def case_picture(request: Request) -> Response:
        if not gate.authorised(request.headers):
            return _not_authorised()
        jpeg = await asyncio.to_thread(hub.session.cases.picture, request.path_params["case_id"])
        if jpeg is None:
            return _error(CarinaError("this case has no picture", code="case.no-picture"), 404)
        # Of a patient: in memory only.
        return Response(jpeg, media_type="image/jpeg", headers={"cache-control": "no-store"})

    async def socket(websocket: WebSocket) -> None:
        await websocket.accept()
        if not gate.authorised(websocket.headers):
            reason = "Carina was restarted since this page was opened; open the link that it printed"
            await close_socket(websocket, "protocol.not-authorised", reason)
            return
        await _serve_window(websocket, hub)

    async def joined(websocket: WebSocket) -> None:
        await websocket.accept()
        if not gate.authorised(websocket.headers):
            await close_socket(websocket, "protocol.not-authorised", "this token does not belong to this Carina")
            return
        await serve_program(websocket, hub.session)

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
        Route("/api/airways{suffix:path}", download),
        Route("/api/key-frames.json", key_frames),
        Route("/api/cases/{case_id}/picture.jpg", case_picture),
        WebSocketRoute("/ws", socket),
        WebSocketRoute(JOIN_PATH, joined),
        Route("/{path:path}", asset),
    ]
    app = Starlette(routes=routes, lifespan=lifespan)
    app.add_middleware(GateMiddleware, gate=gate)
    app.state.gate = gate
    app.state.hub = hub
    return app


async def _serve_window(websocket: WebSocket, hub: Hub) -> None:
    """One window, from its hello to its end."""
    window: Window | None = None
    sender: asyncio.Task[None] | None = None
    worker: asyncio.Task[None] | None = None
    try:
        async with asyncio.timeout(HELLO_WITHIN_S):
            hello = wire.parse_client_message(await _receive_text(websocket))
        if not isinstance(hello, wire.ClientHello):
            raise ProtocolError("the first message must be hello", code="protocol.order")
        if hello.wire_version != wire.WIRE_VERSION:
            msg = (
                f"this page uses protocol version {hello.wire_version} and Carina uses version "
                f"{wire.WIRE_VERSION}; reload the page"
            )
            raise ProtocolError(msg, code="protocol.version")
        window = hub.attach()
        await websocket.send_text(wire.encode_message(wire.ServerHello(wire.WIRE_VERSION, carina.__version__)))
        sender = start_sender(websocket, "the window", _send_all(websocket, hub, window))
        worker = asyncio.create_task(window.inbox.work())
        while not worker.done():
            await window.inbox.put(wire.parse_client_message(await _receive_text(websocket)))
        worker.result()
    except ProtocolError as trouble:
        await close_socket(websocket, trouble.code, str(trouble))
    except TimeoutError:
        await close_socket(websocket, "protocol.order", "the client sent no hello message")
    except WebSocketDisconnect:
        pass
    finally:
        if worker is not None:
            worker.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await worker
        if window is not None:
            window.inbox.finish()
            hub.detach(window)
        if sender is not None:
            sender.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await sender


async def _receive_text(websocket: WebSocket) -> str:
    message = await websocket.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1006), message.get("reason"))
    text = message.get("text")
    if text is None:
        raise ProtocolError("the client sent a binary message; only text messages are accepted", code="protocol.type")
    return str(text)


async def _send_all(websocket: WebSocket, hub: Hub, window: Window) -> None:
    outbox = window.outbox
    while True:
        await outbox.filled()
        if outbox.overflowed:
            await close_socket(websocket, "protocol.slow-client", "this window could not keep up with the data")
            return
        topics, texts, pictures = outbox.take()
        # All of one moment, before anything is sent: what is called handled then has been told.
        told = [(topic, window.topic_text(topic)) for topic in topics]
        for topic, text in told:
            if text is not None and outbox.is_news(topic, text):
                await websocket.send_text(hub.with_own_names(text))
        for text in texts:
            await websocket.send_text(hub.with_own_names(text))
        for picture in pictures:
            await websocket.send_bytes(picture)
