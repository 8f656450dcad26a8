"""ASGI middleware that checks each request and adds security headers to each response."""

from __future__ import annotations

from starlette.datastructures import Headers
from starlette.responses import HTMLResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from carina.server.network.access_checks import Gate

CONTENT_SECURITY_POLICY = (
    "default-src 'self'; img-src 'self' blob: data:; style-src 'self' 'unsafe-inline'; connect-src 'self'; "
    "worker-src 'self' blob:; object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Allow only files of this server; inline styles are allowed because the panel library sets them on elements."""
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


class GateMiddleware:
    """ASGI middleware that refuses HTTP and WebSocket requests with a wrong Host or Origin header.

    The middleware also adds security headers to every HTTP response.
    """

    def __init__(self, app: ASGIApp, gate: Gate) -> None:
        self._app = app
        self._gate = gate

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse the request, or pass it to the application and add the headers to the response."""
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        method = scope["method"] if scope["type"] == "http" else None
        refusal = self._gate.refusal(method=method, headers=Headers(scope=scope))
        if refusal is not None:
            if scope["type"] == "websocket":
                # The WebSocket is not accepted yet, so the server answers with status 403.
                await send({"type": "websocket.close", "code": 1008, "reason": refusal})
                return
            await page("Carina refused this request", refusal, 403)(scope, receive, _with_headers(send))
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


def page(title: str, words: str, status: int) -> Response:
    """Return an HTML page with a title and one paragraph, without caching."""
    return HTMLResponse(PAGE.format(title=title, words=words), status, headers={"cache-control": "no-store"})
