"""Strict decoder and encoder of messages: frozen values (:mod:`carina.commands.value`) as JSON, by msgspec.

msgspec refuses unknown and missing fields, wrong types (a bool is not a number), numbers out of range, and over-long
texts and lists. This module also refuses what msgspec accepts: duplicate keys, NaN, over-long messages, and too deep
objects that another module parses.
"""

from __future__ import annotations

import json
import math
import struct
from typing import Any, NoReturn, TypeVar

import msgspec

from carina.commands.value import Command, FrozenValue, LocalCommand, describe_error, snake_case, subclasses
from carina.errors import CarinaError, ProtocolError
from carina.session.attach.messages import JoinMessage, ToJoinMessage
from carina.typed_reading import read_plain

MAX_TEXT_BYTES = 262_144
"""Maximum size in bytes of a text message from a client, far above the size of a transfer function."""
MAX_HEADER_BYTES = 65_536
"""Maximum size in bytes of the JSON header of an image message."""
MAX_DEPTH = 32
"""Maximum nesting depth of an object that another module parses."""

V = TypeVar("V", bound=FrozenValue)


def message_tag(name: str) -> str:
    """Return the ``type`` of a message by its class name: ``PoseMessage`` and ``Pose`` give ``pose``."""
    return snake_case(name.removesuffix("Message"))


class ClientMessage(FrozenValue, tag_field="type", tag=message_tag, frozen=True):
    """A message from a window to the server that is not a command: about the connection, queries and uploaded files."""


class ServerMessage(FrozenValue, tag_field="type", tag=message_tag, frozen=True):
    """A message from the server to a window."""


class PhoneMessage(FrozenValue, tag_field="type", tag=snake_case, frozen=True):
    """A message from the phone page to the server."""


class ToPhoneMessage(FrozenValue, tag_field="type", tag=snake_case, frozen=True):
    """A message from the server to the phone page."""


def type_name(cls: type[FrozenValue]) -> str | None:
    """Return the ``type`` of a message class; None for a class that only occurs inside messages."""
    config = cls.__struct_config__
    return str(config.tag) if config.tag_field == "type" else None


def by_type(*bases: type[FrozenValue]) -> dict[str, type[FrozenValue]]:
    """Return the message classes derived from some base classes, by ``type``, without local commands."""
    found = [cls for base in bases for cls in (base, *subclasses(base)) if cls not in MESSAGE_BASES]
    return {str(type_name(cls)): cls for cls in found if not issubclass(cls, LocalCommand)}


MESSAGE_BASES = {Command, ClientMessage, ServerMessage, PhoneMessage, ToPhoneMessage, JoinMessage, ToJoinMessage}


def _protocol_error(code: str, message: str) -> NoReturn:
    raise ProtocolError(message, code=f"protocol.{code}")


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    keys = dict(pairs)
    if len(keys) != len(pairs):
        _protocol_error("json", "a message contains the same field twice")
    return keys


def _refuse_constant(text: str) -> NoReturn:
    _protocol_error("number", f"a message contains {text}, which is not a finite number")


def _finite_number(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        _protocol_error("range", "a message contains a number that is too large")
    return number


def load_json_object(text: str | bytes, *, max_bytes: int = MAX_TEXT_BYTES) -> dict[str, Any]:
    """Parse one JSON object, without doubled keys, NaN or infinities.

    Raises
    ------
    ProtocolError
        ``protocol.size``, ``protocol.json``, ``protocol.number`` or ``protocol.range``.
    """
    if len(text) > max_bytes:
        _protocol_error("size", f"a message is too long: expected at most {max_bytes} bytes, found {len(text)}")
    try:
        value = json.loads(
            text, object_pairs_hook=_unique_keys, parse_constant=_refuse_constant, parse_float=_finite_number
        )
    except ProtocolError:
        raise
    except (ValueError, RecursionError):
        # ValueError: JSONDecodeError, bad UTF-8, and integers of more digits than Python converts.
        _protocol_error("json", "a message is not JSON")
    if not isinstance(value, dict):
        _protocol_error("json", "a message must be a JSON object")
    return value


OLD_WORDS: dict[str, tuple[str, dict[str, str]]] = {
    "set_mask": ("set_outline", {"mask": "outline"}),
    "set_zoom": ("set_zoom", {"center_lps": "centre_lps"}),
}
"""Names of commands and fields in wire version 1, which is still accepted: old type to new type and fields."""


def decode(classes: dict[str, type[FrozenValue]], text: str | bytes, *, max_bytes: int = MAX_TEXT_BYTES) -> Any:
    """Decode one message of the given classes; command names of wire version 1 are accepted too.

    Raises
    ------
    ProtocolError
        With a ``protocol.*`` code and one sentence.
    """
    fields = load_json_object(text, max_bytes=max_bytes)
    name = fields.get("type")
    if isinstance(name, str) and name in OLD_WORDS and OLD_WORDS[name][0] in classes:
        name, words = OLD_WORDS[name]
        fields = {
            words.get(field, field) if words.get(field) not in fields else field: v for field, v in fields.items()
        }
        fields["type"] = name
    if not isinstance(name, str) or name not in classes:
        shown = repr(name)[:40] if isinstance(name, str) else "none"
        _protocol_error("type", f"a message has an unknown type: {shown}")
    message = read_fields(classes[name], fields, name)
    problem = message.choice_problem()
    if problem is not None:
        _protocol_error("choice", problem)
    return message


def read_fields(cls: type[V], fields: dict[str, Any], where: str) -> V:
    """Create a value of a class from these fields.

    Raises
    ------
    ProtocolError
        If a field is invalid; the message names the field and the expected value.
    CarinaError
        If the constructor of the value refuses it by a rule that types cannot express.
    """
    document = fields.get("document")
    if isinstance(document, dict):
        _check_document(document, f"{where}.document")
    try:
        return read_plain(fields, cls)
    except msgspec.ValidationError as error:
        if isinstance(error.__cause__, CarinaError):
            raise error.__cause__ from None
        _protocol_error(*describe_error(error, fields, where, cls))
    except RecursionError:
        _protocol_error("size", f"{where} is nested too deeply")


def _check_document(value: Any, where: str) -> None:
    """Refuse numbers beyond the float range and too deep nesting in an object that another module parses."""
    waiting = [(value, 1)]
    while waiting:
        inner, depth = waiting.pop()
        if isinstance(inner, dict | list):
            if depth > MAX_DEPTH:
                _protocol_error("size", f"{where} is nested too deeply: expected at most {MAX_DEPTH} levels")
            waiting += [(entry, depth + 1) for entry in (inner.values() if isinstance(inner, dict) else inner)]
        elif isinstance(inner, int | float) and not -1e15 <= inner <= 1e15:
            _protocol_error("range", f"{where} contains a number that is too large")


def encode(message: FrozenValue, **encoded: str) -> str:
    """Return a message as JSON text, with its ``type`` first.

    Parameters
    ----------
    message
        The message.
    **encoded
        JSON texts that replace the values of the fields of these names.

    Raises
    ------
    ValueError
        If a number is not finite: JSON has no NaN, and such a number is a bug of the server.
    """
    # msgspec's encoder would write NaN as null.
    plain = msgspec.to_builtins(message)
    for name in encoded:
        del plain[name]
    text = json.dumps(plain, allow_nan=False, separators=(",", ":"))
    if not encoded:
        return text
    return "".join((text[:-1], *(f',"{name}":{value}' for name, value in encoded.items()), "}"))


def encode_picture(header: FrozenValue, payload: bytes) -> bytes:
    """Return one binary message: u32 little-endian header length, JSON header, payload."""
    text = encode(header).encode()
    return struct.pack("<I", len(text)) + text + payload


def split_picture(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the header (as parsed JSON) and the payload of a binary message.

    Raises
    ------
    ProtocolError
        If the stated length is wrong, the header is not a JSON object, or the payload is missing.
    """
    if len(data) < 4:
        _protocol_error("picture", "an image message is truncated: it ends within its header")
    (length,) = struct.unpack_from("<I", data)
    if length > MAX_HEADER_BYTES:
        _protocol_error("size", f"the header of an image message is too long: {length} bytes")
    if 4 + length >= len(data):
        _protocol_error("picture", "an image message is truncated: it ends before the image data")
    return load_json_object(data[4 : 4 + length], max_bytes=MAX_HEADER_BYTES), data[4 + length :]
