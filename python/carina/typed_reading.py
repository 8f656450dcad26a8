"""Reading of typed values by msgspec, where only one thread at a time prepares a type.

msgspec 0.22.0 stores its prepared data of a class in the class before the preparation is complete. The preparation runs
Python code, so another thread can read a value with the incomplete data, which ends the process with a segmentation
fault. In Carina only the functions of this module read typed values; ``tests/contract/test_typed_json.py`` checks
this rule.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, TypeVar

import msgspec

__all__ = ["json_decoder", "read_json", "read_plain"]

T = TypeVar("T")
_LOCK = threading.RLock()
_PREPARED: set[type] = set()


def read_plain(plain: Any, cls: type[T]) -> T:
    """Return the value of a class from dictionaries, lists, texts and numbers.

    Parameters
    ----------
    plain
        Result of parsing JSON text.
    cls
        Class with typed fields.

    Raises
    ------
    msgspec.ValidationError
        If a field is missing, unknown, or has another type or a value outside its bounds.

    Examples
    --------
    >>> from carina.commands import ChooseRoute
    >>> read_plain({"type": "choose_route", "branch_id": 3}, ChooseRoute).branch_id
    3
    """
    _prepare(cls)
    return msgspec.convert(plain, cls)


def read_json(
    text: bytes | bytearray | memoryview | str, cls: type[T], dec_hook: Callable[[type, Any], Any] | None = None
) -> T:
    """Return the value of a class from JSON text.

    Parameters
    ----------
    text
        JSON, in UTF-8.
    cls
        Class with typed fields.
    dec_hook
        Function ``dec_hook(type, plain)`` that reads a field of a type that msgspec does not know.

    Raises
    ------
    msgspec.MsgspecError
        If the text is not JSON, or does not have the fields of the class.
    """
    _prepare(cls)
    return msgspec.json.decode(text, type=cls, dec_hook=dec_hook)


def json_decoder(kind: Any) -> msgspec.json.Decoder[Any]:
    """Return a decoder of JSON text for a class or another type."""
    with _LOCK:
        return msgspec.json.Decoder(kind)


def _prepare(cls: type) -> None:
    if cls in _PREPARED:
        return
    with _LOCK:
        # Creating a decoder prepares the class and all classes of its fields.
        msgspec.json.Decoder(cls)
        _PREPARED.add(cls)
