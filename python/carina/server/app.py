"""ASGI application of the workstation: client files, uploads, downloads and the WebSocket, with access control."""

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
from starlette.websockets import WebSocket

from carina.errors import CarinaError, DiskError
from carina.plan.report import ReportKind
from carina.server.attached_programs import JOIN_PATH, serve_program
from carina.server.files.downloads import Downloads
from carina.server.files.films import Films
from carina.server.files.fork_sheets import fork_sheet_answer
from carina.server.files.pictures import Pictures
from carina.server.files.plan_reports import Reports
from carina.server.files.uploads import Uploads
from carina.server.files.web_files import asset_path, web_folder
from carina.server.hub import Hub
from carina.server.network.access_checks import Gate, comes_from_this_machine
from carina.server.network.access_middleware import GateMiddleware, page
from carina.server.network.same_user import comes_from_same_user
from carina.server.sockets.close_codes import close_socket
from carina.server.windows.websocket_session import serve_window
from carina.server.windows.window import Window

__all__ = ["create_app", "web_folder"]


def _status(trouble: CarinaError, usual: int) -> int:
    """Return the HTTP status of the response to an error: 507 for a disk error, else ``usual``."""
    if isinstance(trouble, DiskError):
        return 507
    return {"export.suffix": 404, "session.flights": 404, "upload.limit": 413}.get(trouble.code, usual)


def _error(trouble: CarinaError, status: int) -> JSONResponse:
    return JSONResponse({"code": trouble.code, "message": str(trouble), "action": None}, status)


def _not_authorised() -> JSONResponse:
    words = "this page is not authorised: open it again with the link that Carina printed when it started"
    return _error(CarinaError(words, code="protocol.not-authorised"), 401)


def create_app(hub: Hub, gate: Gate, uploads: Uploads, *, web: Path | None = None) -> Starlette:
    """Create the ASGI application.

    Parameters
    ----------
    hub
        Hub of the session and its windows; it starts and stops with the application.
    gate
        Secrets of the server, and its access checks.
    uploads
        Storage of files that users drop on a window.
    web
        Folder of the built client; None shows a page that states how to build it.
    """
    downloads, reports = Downloads(hub.session), Reports(hub.session)
    pictures, films = Pictures(hub.session), Films(hub.session)

    async def index(request: Request) -> Response:
        token = request.query_params.get("token")
        if token is not None:
            if gate.redeem(token) or (gate.is_used(token) and comes_from_same_user(request.scope)):
                # On another machine the cookie ends with the browser, because others may use that machine.
                cookie = gate.set_lasting_cookie if comes_from_this_machine(request.scope) else gate.set_cookie
                return RedirectResponse("/", 303, headers={"set-cookie": cookie, "cache-control": "no-store"})
            if gate.authorised(request.headers):
                return RedirectResponse("/", 303, headers={"cache-control": "no-store"})
            words = (
                "The link was used in another browser and cannot be used by other users. Open it in the browser that "
                "opened it first. If Carina has been restarted, open the new link that it printed."
            )
            return page("This link cannot be used here", words, 403)
        # No cookie is required here: after a click on another site the browser does not send a Strict cookie with this
        # navigation, but sends it with the WebSocket that the page opens. The files contain no patient data.
        if web is None:
            words = (
                "The Carina window has not been built. Run <code>make run</code> in the folder of Carina's source, "
                "then reload."
            )
            return page("The window has not been built", words, 503)
        return FileResponse(web / "index.html", headers={"cache-control": "no-store"})

    async def asset(request: Request) -> Response:
        found = asset_path(web, request.path_params["path"])
        if found is None:
            return page("Page not found", "This page does not exist.", 404)
        # Each file name below assets/ contains a hash of the content, so browsers may cache the file for ever.
        lasting = found.parent.name == "assets"
        return FileResponse(
            found, headers={"cache-control": "public, max-age=31536000, immutable" if lasting else "no-cache"}
        )

    async def begin_upload(request: Request) -> Response:
        if not gate.authorised(request.headers):
            return _not_authorised()
        try:
            return JSONResponse({"upload_id": uploads.begin()}, 201)
        except CarinaError as error:
            return _error(error, 507)

    async def one_upload(request: Request) -> Response:
        if not gate.authorised(request.headers):
            return _not_authorised()
        upload_id = request.path_params["upload_id"]
        if request.method == "DELETE":
            uploads.discard(upload_id)
            return Response(status_code=204)
        try:
            await uploads.add(upload_id, request.query_params.get("name", ""), request.stream())
        except CarinaError as error:
            return _error(error, _status(error, 404))
        return JSONResponse({}, 201)

    async def download(request: Request) -> Response:
        if not gate.authorised(request.headers):
            return _not_authorised()
        try:
            return await downloads.answer(request.path_params["suffix"])
        except CarinaError as error:
            return _error(error, _status(error, 409))

    async def plan(request: Request) -> Response:
        if not gate.authorised(request.headers):
            return _not_authorised()
        kind: ReportKind = "tracing" if request.query_params.get("kind") == "tracing" else "report"
        try:
            target_id, _, suffix = request.path_params["name"].partition(".")
            named = request.query_params.get("identity") == "ct"
            return await reports.answer(target_id, f".{suffix}", kind, "from the CT" if named else "none")
        except CarinaError as error:
            return _error(error, _status(error, 409))

    async def key_frames(request: Request) -> Response:
        if not gate.authorised(request.headers):
            return _not_authorised()
        try:
            return await downloads.key_frames()
        except CarinaError as error:
            return _error(error, 409)

    async def flight(request: Request) -> Response:
        if not gate.authorised(request.headers):
            return _not_authorised()
        try:
            return await downloads.flight(request.path_params["number"])
        except CarinaError as error:
            return _error(error, _status(error, 409))

    async def flight_log(request: Request) -> Response:
        if not gate.authorised(request.headers):
            return _not_authorised()
        try:
            return await downloads.flight_log(request.path_params["number"])
        except CarinaError as error:
            return _error(error, _status(error, 409))

    async def learner(request: Request) -> Response:
        if not gate.authorised(request.headers):
            return _not_authorised()
        try:
            return await downloads.learner(request.query_params.get("name", ""))
        except CarinaError as error:
            return _error(error, _status(error, 404))

    async def picture(request: Request) -> Response:
        if not gate.authorised(request.headers):
            return _not_authorised()
        try:
            view, query = request.path_params["view"], request.query_params
            return await pictures.answer(view, query, is_disconnected=request.is_disconnected)
        except CarinaError as error:
            return _error(error, _status(error, 409))

    async def fork_sheet(request: Request) -> Response:
        if not gate.authorised(request.headers):
            return _not_authorised()
        try:
            return await fork_sheet_answer(hub.session)
        except CarinaError as error:
            return _error(error, _status(error, 409))

    async def start_film(request: Request) -> Response:
        if not gate.authorised(request.headers):
            return _not_authorised()
        try:
            return await asyncio.to_thread(films.start, dict(request.query_params))
        except CarinaError as error:
            return _error(error, _status(error, 409))

    async def film(request: Request) -> Response:
        if not gate.authorised(request.headers):
            return _not_authorised()
        try:
            return await films.answer(request.path_params["job_id"])
        except CarinaError as error:
            return _error(error, _status(error, 409))

    async def case_picture(request: Request) -> Response:
        if not gate.authorised(request.headers):
            return _not_authorised()
        jpeg = await asyncio.to_thread(hub.session.cases.picture, request.path_params["case_id"])
        if jpeg is None:
            return _error(CarinaError("this case has no thumbnail", code="case.no-picture"), 404)
        # Patient data: the browser must not store the image on disk.
        return Response(jpeg, media_type="image/jpeg", headers={"cache-control": "no-store"})

    async def socket(websocket: WebSocket) -> None:
        await websocket.accept()
        if not gate.authorised(websocket.headers):
            reason = "Carina has been restarted since this page was opened; open the new link that it printed"
            await close_socket(websocket, "protocol.not-authorised", reason)
            return

        async def attach(_hello: object) -> Window:
            return hub.attach(at_machine=comes_from_this_machine(websocket.scope))

        await serve_window(websocket, attach)

    async def joined(websocket: WebSocket) -> None:
        await websocket.accept()
        if not gate.authorised(websocket.headers):
            reason = "this token is not valid for this instance of Carina"
            await close_socket(websocket, "protocol.not-authorised", reason)
            return
        await serve_program(websocket, hub.session)

    @contextlib.asynccontextmanager
    async def lifespan(_app: Starlette) -> AsyncIterator[None]:
        hub.start()
        try:
            yield
        finally:
            await hub.close_watch_page("Carina was closed")
            await asyncio.to_thread(hub.stop)
            films.close()

    routes: list[Any] = [
        Route("/", index),
        Route("/api/upload", begin_upload, methods=["POST"]),
        Route("/api/upload/{upload_id}", one_upload, methods=["PUT", "DELETE"]),
        Route("/api/airways{suffix:path}", download),
        Route("/api/plans/{name}", plan),
        Route("/api/key-frames.json", key_frames),
        Route("/api/flights/flight-{number:int}.jsonl", flight),
        Route("/api/flights/flight-{number:int}-log.zip", flight_log),
        Route("/api/course/learner.zip", learner),
        Route("/api/pictures/{view}.png", picture),
        Route("/api/forks.png", fork_sheet),
        Route("/api/films", start_film, methods=["POST"]),
        Route("/api/films/{job_id}", film),
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
