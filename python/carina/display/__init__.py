"""Display of values: one line of text in a terminal or log, and HTML in a notebook."""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar

__all__ = ["MAX_CHARS", "as_words", "joined_in_line", "one_line"]

T = TypeVar("T")

MAX_CHARS = 160
"""Maximum length of a line in characters, about two terminal widths; a longer line ends in three dots."""
MAX_STRING_CHARS = 60
MAX_INNER_CHARS = 48
MAX_ITEMS = 6


def one_line(cls: type[T]) -> type[T]:
    """Give a dataclass a ``repr`` of one line that summarises its fields.

    Fields with their default value are omitted. Arrays are shown by type and shape, long collections by length.
    """

    def shown(self: Any) -> str:
        pieces = []
        # Keyword-only fields come last, as in a call.
        for field in sorted(dataclasses.fields(self), key=lambda field: bool(field.kw_only)):
            value = getattr(self, field.name)
            if field.repr and not _is_default(field, value):
                pieces.append(f"{field.name}={as_words(value)}")
        return joined_in_line(type(self).__qualname__, pieces)

    cls.__repr__ = shown  # type: ignore[method-assign]
    return cls


def as_words(value: Any) -> str:
    """Return a short text for a value, without line breaks.

    Examples
    --------
    >>> as_words((1.0, 0.30000000000000004, -7.25))
    '(1, 0.3, -7.25)'
    >>> as_words(list(range(100)))
    '<100 of int>'
    """
    if isinstance(value, float):
        return f"{value:.6g}"
    if value is None or isinstance(value, bool | int):
        return repr(value)
    if isinstance(value, str):
        return repr(value if len(value) <= MAX_STRING_CHARS else value[: MAX_STRING_CHARS - 1] + "…")
    if isinstance(value, bytes | bytearray | memoryview):
        return f"<{len(value)} bytes>"
    # Arrays are recognised by their attributes, so that numpy is not imported for a line of text.
    if hasattr(value, "dtype") and hasattr(value, "shape"):
        if value.ndim == 1 and value.size <= MAX_ITEMS:
            return as_words(tuple(value.tolist()))
        return f"{value.dtype}[{', '.join(str(n) for n in value.shape)}]"
    if isinstance(value, tuple | list | set | frozenset | dict):
        return _collection(value)
    text = f"{type(value).__name__}(…)" if dataclasses.is_dataclass(value) else f"<{type(value).__name__}>"
    whole = repr(value)
    return whole if len(whole) <= MAX_INNER_CHARS and "\n" not in whole and " at 0x" not in whole else text


def _collection(values: Any) -> str:
    items = list(values.items()) if isinstance(values, dict) else list(values)
    kinds = {type(item).__name__ for item in values}
    many = f"<{len(items)} of {kinds.pop()}>" if len(kinds) == 1 else f"<{len(items)} items>"
    if len(items) > MAX_ITEMS:
        return many
    if isinstance(values, dict):
        text = "{" + ", ".join(f"{as_words(key)}: {as_words(item)}" for key, item in items) + "}"
    else:
        opened, closed = ("[", "]") if isinstance(values, list) else ("(", ")")
        comma = "," if isinstance(values, tuple) and len(items) == 1 else ""
        text = opened + ", ".join(as_words(item) for item in items) + comma + closed
    return text if len(text) <= MAX_INNER_CHARS else many


def _is_default(field: dataclasses.Field[Any], value: Any) -> bool:
    default = field.default
    if default is dataclasses.MISSING and field.default_factory is not dataclasses.MISSING:
        # An empty collection counts as the default; other factories are not called for a line of text.
        return isinstance(value, list | dict | set) and not value
    if value is default:
        return True
    return isinstance(value, bool | int | float | str | tuple) and type(value) is type(default) and value == default


def joined_in_line(name: str, pieces: list[str]) -> str:
    """Return ``Name(piece, piece)``; three dots replace the pieces that do not fit in one line."""
    text = f"{name}({', '.join(pieces)})"
    while len(text) > MAX_CHARS and pieces:
        pieces.pop()
        text = f"{name}({', '.join([*pieces, '…'])})"
    return text
