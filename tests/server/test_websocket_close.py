"""Tests of closed sockets: close codes, and reasons of limited length."""

from __future__ import annotations

import asyncio

import pytest
from starlette.websockets import WebSocketDisconnect, WebSocketState

from carina.server.sockets.close_codes import MAX_REASON_BYTES, close_socket
from carina.server.wire import messages as wire


class Socket:
    """Replacement of a socket that records close codes and reasons."""

    def __init__(self, state=WebSocketState.CONNECTED, trouble=None) -> None:
        self.application_state = state
        self.closed = []
        self._trouble = trouble

    async def close(self, code, reason):
        self.closed.append((code, reason))
        if self._trouble is not None:
            raise self._trouble


def closed(code, reason, **made):
    socket = Socket(**made)
    asyncio.run(close_socket(socket, code, reason))
    return socket.closed


@pytest.mark.parametrize("code", wire.CLOSE_CODES)
def test_websocket_closes_with_the_code_and_reason_of_the_error(code):
    assert closed(code, "a sentence") == [(wire.CLOSE_CODES[code], "a sentence")]


def test_error_without_a_close_code_closes_the_websocket_as_malformed():
    assert closed("session.no-case", "no") == [(wire.CLOSE_CODES["protocol.malformed"], "no")]


@pytest.mark.parametrize("sign", ["a", "\u00fc", "\u2192", "\U0001fac1"])
@pytest.mark.parametrize("first", ["", "x", "xy", "xyz"])
def test_close_reason_is_shortened_to_the_limit_of_a_close_frame_at_a_character_boundary(sign, first):
    reason = first + sign * 200
    [(_, short)] = closed("protocol.order", reason)
    num_bytes = len(short.encode())
    assert MAX_REASON_BYTES - len(sign.encode()) < num_bytes <= MAX_REASON_BYTES
    assert reason.startswith(short)


def test_closed_websocket_is_not_closed_again():
    assert closed("protocol.order", "late", state=WebSocketState.DISCONNECTED) == []
    for trouble in (RuntimeError("closed"), WebSocketDisconnect(1006)):
        assert len(closed("protocol.order", "at the same time", trouble=trouble)) == 1
