"""Limits on the length of import messages, so that a message fits a window and a terminal."""

from __future__ import annotations

from collections.abc import Sequence

MAX_MESSAGE_CHARS = 600
"""Maximum length of an error or a note; ``carina info --json`` lists every series completely."""
MAX_NAME_CHARS = 60
_HEAD_CHARS = 380  # a message begins with the problem and ends with the remedy


def bounded_message(text: str) -> str:
    """Return a message of at most ``MAX_MESSAGE_CHARS`` characters that keeps its beginning and its end."""
    if len(text) <= MAX_MESSAGE_CHARS:
        return text
    mark = " ... "
    return text[:_HEAD_CHARS] + mark + text[len(text) - (MAX_MESSAGE_CHARS - _HEAD_CHARS - len(mark)) :]


def bounded_name(name: str) -> str:
    """Return a file name of at most ``MAX_NAME_CHARS`` characters that keeps its beginning and its end."""
    if len(name) <= MAX_NAME_CHARS:
        return name
    half = (MAX_NAME_CHARS - 3) // 2
    return f"{name[:half]}...{name[-half:]}"


def bounded_list(entries: Sequence[str], *, at_most: int, separator: str = "; ") -> str:
    """Join the first entries of a list and state the number of the others."""
    more = len(entries) - at_most
    return separator.join(entries[:at_most]) + (f" and {more} more" if more > 0 else "")
