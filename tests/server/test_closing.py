"""Sockets end with a code of the wire and a reason that fits."""

from __future__ import annotations

import asyncio

import pytest
from starlette.websockets import WebSocketDisconnect, WebSocketState

from carina.server import messages as wire
from carina.server.closing import MAX_REASON_BYTES, close_socket


class Socket:
    """What is closed, and how."""

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
def test_a_socket_ends_with_its_code_and_reason(code):
    assert closed(code, "a sentence") == [(wire.CLOSE_CODES[code], "a sentence")]


def test_a_code_that_closes_no_socket_counts_as_malformed():
    assert closed("session.no-case", "no") == [(wire.CLOSE_CODES["protocol.malformed"], "no")]


@pytest.mark.parametrize("sign", ["a", "\u00fc", "\u2192", "\U0001fac1"])
@pytest.mark.parametrize("first", ["", "x", "xy", "xyz"])
def test_a_reason_is_cut_to_what_a_close_frame_holds_between_two_characters(sign, first):
    reason = first + sign * 200
    [(_, short)] = closed("protocol.order", reason)
    num_bytes = len(short.encode())
    assert MAX_REASON_BYTES - len(sign.encode()) < num_bytes <= MAX_REASON_BYTES
    assert reason.startswith(short)


def test_a_socket_that_has_ended_is_left_alone():
    assert closed("protocol.order", "late", state=WebSocketState.DISCONNECTED) == []
    for trouble in (RuntimeError("closed"), WebSocketDisconnect(1006)):
        assert len(closed("protocol.order", "at the same time", trouble=trouble)) == 1
