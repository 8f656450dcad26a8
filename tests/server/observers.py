"""Workstation with a shared case, and observers that connect by its link, for several test files."""

from __future__ import annotations

import contextlib
import ssl

from live_server import SHOWN, WAIT_S, Window, running

from carina.server.wire import messages as wire
from encrypted_client import connected


def insecure():
    """Return TLS settings without a certificate check, as in a browser after its user compared the fingerprint."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    return context


@contextlib.contextmanager
def watching(url, *, token=None, hello=True):
    origin, _, own = url.partition("/#")
    address = origin.removeprefix("https://")
    with connected(f"wss://{address}/ws", origin=origin, context=insecure(), within_s=WAIT_S) as socket:
        watcher = Window(socket, hello=False)
        watcher.send(wire.ClientHello(wire.WIRE_VERSION, own if token is None else token))
        if hello:
            greeting = watcher.until(lambda m: isinstance(m, wire.ServerHello))
            assert greeting.watches
        yield watcher


def page_of(window, wanted=lambda page: page is not None):
    return window.until(lambda m: isinstance(m, wire.Watching) and wanted(m.page)).page


@contextlib.contextmanager
def sharing(tmp_path, monkeypatch, *, path="case", **replaced):
    """Provide the user's window of a workstation on which a case and the page for observers are open."""
    # The time limit is long, so that observers read the close reason even on a busy machine.
    monkeypatch.setattr("carina.server.observers.page.CLOSE_TIMEOUT_S", 60.0)
    # Server and client share one process, so a connection's first request may be late while a case is opened.
    monkeypatch.setattr("carina.server.network.request_timeouts.FIRST_REQUEST_WITHIN_S", 60.0)
    monkeypatch.setattr("carina.server.network.lan_server.HANDSHAKE_WITHIN_S", 60.0)

    web = tmp_path / "web"
    web.mkdir()
    (web / "index.html").write_text("the client")
    (web / "phone.html").write_text("the phone")
    with running(tmp_path, web=web, **replaced) as live, live.window() as window:
        window.send(SHOWN)
        window.send(wire.OpenPath(path))
        window.until_state(lambda s: s.airways in {"found", "failed"})
        window.send(wire.SetWatchPage(on=True))
        yield live, window, page_of(window)
