"""Strict reading and writing of wire messages from the annotations of frozen dataclasses.

One description serves four readers: this parser, the writer, the JSON schema and the TypeScript types
(``wire_types.py``). The parser refuses whatever it was not promised: unknown and missing fields, wrong types (a bool is
no number), numbers that are not finite or out of range, over-long text and lists, doubled keys.
"""

from __future__ import annotations

import dataclasses
import json
import math
import struct
import types
import typing
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NoReturn, TypeVar, Union, get_args, get_origin, get_type_hints

from carina.errors import ProtocolError

__all__ = [
    "MAX_HEADER_BYTES",
    "MAX_TEXT_BYTES",
    "Length",
    "Range",
    "decode_fields",
    "encode_picture",
    "field_types",
    "load_json_object",
    "optional_fields",
    "split_picture",
    "to_jsonable",
]

MAX_TEXT_BYTES = 262_144
"""Largest text message from a client: a transfer function by hand fits many times over."""
MAX_HEADER_BYTES = 65_536
"""Largest JSON header of a picture."""

T = TypeVar("T")
_FIELD_TYPES: dict[type[Any], dict[str, Any]] = {}


@dataclass(frozen=True, slots=True)
class Range:
    """Inclusive bounds of a number."""

    low: float
    high: float


WHOLE = Range(-(2**53 - 1), 2**53 - 1)
REAL = Range(-1e15, 1e15)
"""Of numbers that have no bounds of their own; whatever a client sends has some (``tests/contract``)."""
MAX_DEPTH = 32
"""Of an object that is read elsewhere."""


@dataclass(frozen=True, slots=True)
class Length:
    """Inclusive bounds of the length of a text or a list."""

    low: int
    high: int


def field_types(cls: type[Any]) -> dict[str, Any]:
    """The annotated type of each field of a dataclass, in order."""
    known = _FIELD_TYPES.get(cls)
    if known is None:
        hints = get_type_hints(cls, include_extras=True)
        known = _FIELD_TYPES[cls] = {f.name: hints[f.name] for f in dataclasses.fields(cls)}
    return known


def optional_fields(cls: type[Any]) -> frozenset[str]:
    """Fields that a message may lack: those that came after programs had learned the message."""
    return getattr(cls, "may_lack", frozenset())


def _refuse(code: str, message: str) -> NoReturn:
    raise ProtocolError(message, code=f"protocol.{code}")


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    keys = dict(pairs)
    if len(keys) != len(pairs):
        _refuse("json", "a message names the same field twice")
    return keys


def _no_constant(text: str) -> NoReturn:
    _refuse("number", f"a message contains {text}, which is no finite number")


def load_json_object(text: str | bytes, *, max_bytes: int = MAX_TEXT_BYTES) -> dict[str, Any]:
    """Parse one JSON object, without doubled keys, NaN or infinities.

    Raises
    ------
    ProtocolError
        ``protocol.size`` or ``protocol.json``.
    """
    if len(text) > max_bytes:
        _refuse("size", f"a message is too long: at most {max_bytes} bytes are read, this one has {len(text)}")
    try:
        value = json.loads(text, object_pairs_hook=_unique_keys, parse_constant=_no_constant)
    except ProtocolError:
        raise
    except (ValueError, RecursionError):
        # ValueError: JSONDecodeError, bad UTF-8, and integers of more digits than Python converts.
        _refuse("json", "a message is not JSON")
    if not isinstance(value, dict):
        _refuse("json", "a message must be a JSON object")
    return value


def decode_fields(cls: type[T], value: Any, where: str = "message") -> T:
    """Build a message dataclass from a parsed JSON object; ``type`` must already be taken out.

    Raises
    ------
    ProtocolError
        Naming the field and what was expected.
    """
    if not isinstance(value, dict):
        _refuse("field", f"{where} must be an object")
    hints = field_types(cls)
    if not getattr(cls, "extra_keys_allowed", False):
        unknown = sorted(set(value) - set(hints))
        if unknown:
            _refuse("field", f"{where} has a field that is not known: {unknown[0][:40]!r}")
    missing = [name for name in hints if name not in value and name not in optional_fields(cls)]
    if missing:
        _refuse("field", f"{where} lacks the field {missing[0]!r}")
    given = {name: hint for name, hint in hints.items() if name in value}
    return cls(**{name: _decode(hint, value[name], f"{where}.{name}") for name, hint in given.items()})


def _decode(hint: Any, value: Any, where: str) -> Any:
    bounds: tuple[Any, ...] = ()
    if get_origin(hint) is Annotated:
        hint, *metadata = get_args(hint)
        bounds = tuple(metadata)
    origin = get_origin(hint)
    if origin in (Union, types.UnionType):
        choices = get_args(hint)
        if value is None:
            if type(None) in choices:
                return None
            _refuse("field", f"{where} must not be null")
        return _decode_one_of([c for c in choices if c is not type(None)], value, where)
    if origin is Literal:
        # `is` type check: True == 1 would pass a bool as a version.
        if not any(value == choice and type(value) is type(choice) for choice in get_args(hint)):
            _refuse("field", f"{where} must be one of {', '.join(map(str, get_args(hint)))}")
        return value
    if hint is bool:
        if not isinstance(value, bool):
            _refuse("field", f"{where} must be true or false")
        return value
    if hint in (int, float):
        return _decode_number(hint, value, where, bounds)
    if hint is str:
        if not isinstance(value, str):
            _refuse("field", f"{where} must be text")
        if any(0xD800 <= ord(c) <= 0xDFFF or (ord(c) < 0x20 and c not in "\n\t") for c in value):
            _refuse("field", f"{where} holds characters that no text has")
        _check_length(value, where, bounds, "characters")
        return value
    if origin is tuple:
        (item, *_) = get_args(hint)
        if not isinstance(value, list):
            _refuse("field", f"{where} must be a list")
        _check_length(value, where, bounds, "entries")
        return tuple(_decode(item, v, f"{where}[{n}]") for n, v in enumerate(value))
    if origin is dict:
        if not isinstance(value, dict):
            _refuse("field", f"{where} must be an object")
        _check_document(value, where)
        return value
    if dataclasses.is_dataclass(hint):
        return decode_fields(typing.cast(type[Any], hint), value, where)
    msg = f"no reader for {hint!r} at {where}"
    raise TypeError(msg)


def _decode_one_of(choices: list[Any], value: Any, where: str) -> Any:
    if len(choices) == 1:
        return _decode(choices[0], value, where)
    if all(map(dataclasses.is_dataclass, choices)):
        return decode_fields(_of_kind(choices, value, where), value, where)
    last: ProtocolError | None = None
    for choice in choices:
        try:
            return _decode(choice, value, where)
        except ProtocolError as error:
            last = error
    assert last is not None
    raise last


def _of_kind(choices: list[Any], value: Any, where: str) -> type[Any]:
    """Of dataclasses that each have a literal ``kind``, the one that an object names."""
    kinds = {get_args(field_types(choice)["kind"])[0]: choice for choice in choices}
    kind = value.get("kind") if isinstance(value, dict) else None
    if not isinstance(kind, str) or kind not in kinds:
        _refuse("field", f"{where}.kind must be one of {', '.join(kinds)}")
    return typing.cast(type[Any], kinds[kind])


def _decode_number(kind: Any, value: Any, where: str, bounds: tuple[Any, ...]) -> int | float:
    if isinstance(value, bool) or not isinstance(value, int | float) or (kind is int and not isinstance(value, int)):
        _refuse("field", f"{where} must be a {'whole number' if kind is int else 'number'}")
    if not any(isinstance(bound, Range) for bound in bounds):
        bounds = (WHOLE if kind is int else REAL,)
    for bound in bounds:
        # Compared before the conversion: a huge integer has no float.
        if isinstance(bound, Range) and not bound.low <= value <= bound.high:
            # A huge integer has too many digits to be written, too.
            found = "more" if abs(value) > 1e15 else f"{value:g}"
            _refuse("range", f"{where} must lie between {bound.low:g} and {bound.high:g}; found {found}")
    try:
        number = kind(value)
    except OverflowError:
        _refuse("range", f"{where} is too large")
    if not math.isfinite(number):
        _refuse("number", f"{where} is no finite number")
    return typing.cast(float, number)


def _check_document(value: Any, where: str) -> None:
    """Numbers that have a float, and no more depth than anybody needs: others read what is inside."""
    waiting = [(value, 1)]
    while waiting:
        inner, depth = waiting.pop()
        if isinstance(inner, dict | list):
            if depth > MAX_DEPTH:
                _refuse("size", f"{where} is nested too deeply: at most {MAX_DEPTH} levels are read")
            waiting += [(entry, depth + 1) for entry in (inner.values() if isinstance(inner, dict) else inner)]
        elif isinstance(inner, int | float):
            _decode_number(float, float(inner) if isinstance(inner, bool) else inner, where, ())


def _check_length(value: Any, where: str, bounds: tuple[Any, ...], unit: str) -> None:
    for bound in bounds:
        if isinstance(bound, Length) and not bound.low <= len(value) <= bound.high:
            wanted = f"{bound.low}" if bound.low == bound.high else f"{bound.low} to {bound.high}"
            _refuse("size", f"{where} must have {wanted} {unit}; it has {len(value)}")


def to_jsonable(value: Any) -> Any:
    """Dataclasses, tuples and numbers as JSON values; a message's ``type`` comes first.

    Raises
    ------
    ValueError
        If a number is not finite: JSON has no NaN, and a picture's matrix with one would be a fault of ours.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        wire_type = getattr(value, "wire_type", None)
        fields = {f.name: to_jsonable(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return fields if wire_type is None else {"type": wire_type, **fields}
    if isinstance(value, dict):
        return {str(key): to_jsonable(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [to_jsonable(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        msg = "a message would hold a number that is not finite"
        raise ValueError(msg)
    return value


def encode_picture(header: Any, payload: bytes) -> bytes:
    """One binary message: u32 little-endian header length, JSON header, payload."""
    text = json.dumps(to_jsonable(header), allow_nan=False, separators=(",", ":")).encode()
    return struct.pack("<I", len(text)) + text + payload


def split_picture(data: bytes) -> tuple[dict[str, Any], bytes]:
    """The header (as parsed JSON) and the payload of a binary message.

    Raises
    ------
    ProtocolError
        If the length lies, the header is no JSON object, or there is no payload.
    """
    if len(data) < 4:
        _refuse("picture", "a picture is too short for its header length")
    (length,) = struct.unpack_from("<I", data)
    if length > MAX_HEADER_BYTES:
        _refuse("size", f"a picture's header is too long: {length} bytes")
    if 4 + length >= len(data):
        _refuse("picture", "a picture ends before its payload")
    return load_json_object(data[4 : 4 + length], max_bytes=MAX_HEADER_BYTES), data[4 + length :]
