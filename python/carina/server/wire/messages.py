"""All messages between server and client, with their parsers and encoder (specification: ``protocol/README.md``).

Requests about the case are the commands of :mod:`carina.commands`. The messages of the connection are defined in
``messages_from_client.py``, ``messages_from_server.py`` and the ``messages_of_*.py`` files; those of
``messages_of_phone.py`` go between the server and the phone page, on a separate socket. A new message needs only a new
class in one of them.

``python -m carina.server.wire.generate`` generates ``web/src/wire/messages.ts`` and ``protocol/schema.json`` from
the classes; a test fails if the files differ from the classes. World coordinates are LPS mm, matrices are 4x4
row-major, units are in the names. Numbers are bounded, so that no client can request an arbitrarily large image or
volume.
"""

from __future__ import annotations

import struct
from typing import Any

from carina import version
from carina.commands import *  # noqa: F403
from carina.commands.value import Command
from carina.errors import ProtocolError
from carina.server.wire.codec import (
    ClientMessage,
    PhoneMessage,
    ServerMessage,
    ToPhoneMessage,
    by_type,
    decode,
    encode,
    read_fields,
    split_picture,
)
from carina.server.wire.messages_from_client import *  # noqa: F403
from carina.server.wire.messages_from_server import *  # noqa: F403
from carina.server.wire.messages_from_server import PictureHeader
from carina.server.wire.messages_of_devices import *  # noqa: F403
from carina.server.wire.messages_of_edits import *  # noqa: F403
from carina.server.wire.messages_of_key_frames import *  # noqa: F403
from carina.server.wire.messages_of_pacs import *  # noqa: F403
from carina.server.wire.messages_of_phone import *  # noqa: F403
from carina.server.wire.messages_of_plan import *  # noqa: F403
from carina.server.wire.messages_of_training import *  # noqa: F403
from carina.server.wire.messages_of_tree import *  # noqa: F403
from carina.session.attach.messages import *  # noqa: F403
from carina.session.attach.messages import JoinMessage, ToJoinMessage

WIRE_VERSION = version.WIRE_VERSION

CLOSE_CODES: dict[str, int] = {
    "protocol.malformed": 4400,
    "protocol.not-authorised": 4401,
    "protocol.version": 4402,
    "protocol.order": 4403,
    "protocol.taken-over": 4409,
    "protocol.case-closed": 4410,
    "protocol.slow-client": 4413,
    "protocol.flood": 4414,
    "protocol.too-many-windows": 4429,
    "protocol.watching-ended": 4410,
}
"""Close codes of the WebSocket by error code; the server sends one sentence with each."""


CLIENT_MESSAGES = by_type(Command, ClientMessage)
SERVER_MESSAGES = by_type(ServerMessage)
PHONE_MESSAGES = by_type(PhoneMessage)
TO_PHONE_MESSAGES = by_type(ToPhoneMessage)
JOIN_MESSAGES = by_type(Command, JoinMessage)
TO_JOIN_MESSAGES = by_type(ToJoinMessage)
MAX_PHONE_BYTES = 2048
"""Maximum size in bytes of a message from a phone; a sample has about 200 bytes."""


def parse_client_message(text: str | bytes, *, max_bytes: int = 262_144) -> Any:
    """Parse one message from a client.

    Raises
    ------
    ProtocolError
        With a ``protocol.*`` code and one sentence.
    """
    return decode(CLIENT_MESSAGES, text, max_bytes=max_bytes)


def parse_phone_message(text: str | bytes) -> Any:
    """Parse one message from the phone page.

    Raises
    ------
    ProtocolError
        With a ``protocol.*`` code and one sentence.
    """
    return decode(PHONE_MESSAGES, text, max_bytes=MAX_PHONE_BYTES)


def parse_to_phone_message(text: str | bytes) -> Any:
    """Parse one message from the server to the phone page; for tests."""
    return decode(TO_PHONE_MESSAGES, text, max_bytes=MAX_PHONE_BYTES)


def parse_join_message(text: str | bytes) -> Any:
    """Parse one message from a program that joins a case: a command or a join message.

    Raises
    ------
    ProtocolError
        With a ``protocol.*`` code and one sentence.
    """
    return decode(JOIN_MESSAGES, text)


def parse_to_join_message(text: str | bytes) -> Any:
    """Parse one message from the server to a program that joins a case."""
    return decode(TO_JOIN_MESSAGES, text, max_bytes=64 * 1024 * 1024)


def parse_server_message(text: str | bytes, *, max_bytes: int = 64 * 1024 * 1024) -> Any:
    """Parse one text message from the server; for programs and tests."""
    return decode(SERVER_MESSAGES, text, max_bytes=max_bytes)


def parse_picture(data: bytes) -> tuple[PictureHeader, bytes]:
    """Split one binary image message into header and payload.

    Raises
    ------
    ProtocolError
        If the payload is not an image of the stated codec, or the encoded outlines are malformed.
    """
    fields, payload = split_picture(data)
    header = read_fields(PictureHeader, fields, "picture")
    magic = b"\xff\xd8\xff" if header.codec == "jpeg" else b"\x89PNG\r\n\x1a\n"
    if not payload.startswith(magic):
        raise ProtocolError(f"the payload of an image message is not {header.codec.upper()}", code="protocol.picture")
    end = len(payload)
    if header.outline is not None:
        _line_places(payload, end, header.outline.num_bytes)
        end -= header.outline.num_bytes
    for layer in reversed(header.layers):
        _line_places(payload, end, layer.num_bytes)
        end -= layer.num_bytes
    return header, payload


def split_outline(header: PictureHeader, payload: bytes) -> tuple[bytes, tuple[tuple[tuple[float, float], ...], ...]]:
    """Split a payload into the image data and the lines of the outline: columns and rows in pixels of the image.

    Raises
    ------
    ProtocolError
        ``protocol.picture`` if the outline is longer than the payload, or ends within a line.
    """
    if header.outline is None:
        return payload, ()
    lines = []
    for start, count in _line_places(payload, len(payload), header.outline.num_bytes):
        values = struct.unpack_from(f"<{2 * count}H", payload, start)
        lines.append(tuple((c / 16.0, r / 16.0) for c, r in zip(values[::2], values[1::2], strict=True)))
    num_layers = sum(layer.num_bytes for layer in header.layers)
    return payload[: len(payload) - header.outline.num_bytes - num_layers], tuple(lines)


def _line_places(payload: bytes, end: int, num_bytes: int) -> list[tuple[int, int]]:
    """Return, for each line in the last ``num_bytes`` before ``end``, the offset and the number of its points."""
    at = end - num_bytes
    if at <= 0:
        raise ProtocolError("the outline in an image message leaves no room for the image", code="protocol.picture")
    places = []
    while at < end:
        count = int.from_bytes(payload[at : at + 2], "little") if at + 2 <= end else 0
        if count == 0 or at + 2 + 4 * count > end:
            raise ProtocolError("the outline in an image message ends in the middle of a line", code="protocol.picture")
        places.append((at + 2, count))
        at += 2 + 4 * count
    return places


def encode_message(message: Any, **encoded: str) -> str:
    """Encode a message as JSON text; the JSON texts ``encoded`` replace the values of the fields of these names."""
    return encode(message, **encoded)
