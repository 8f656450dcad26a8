"""Cleaning of text from files for a terminal, so that it cannot move the cursor or hide other text."""

from __future__ import annotations

import re
from typing import Final

# The pattern covers a whole escape sequence: without the escape character alone, the digits of a colour would stay.
_SEQUENCE: Final = re.compile(
    r"(?:\x1b\[|\x9b)[0-?]*[ -/]*[@-~]"  # CSI: colours, cursor
    r"|(?:\x1b[\]PX^_]|[\x9d\x90\x98\x9e\x9f])[^\x07\x1b\x9c]*(?:\x07|\x1b\\|\x9c)?"  # OSC, DCS and the like
    r"|\x1b[ -/]*[0-~]"
)
_CONTROL: Final = (
    r"\x00-\x08\x0b-\x1f\x7f-\x9f"  # C0 without tab and line feed, DEL, C1
    r"\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069"  # direction of writing
    r"\u2028\u2029"  # line and paragraph separator
    r"\ud800-\udfff"  # surrogates from file names that are not UTF-8, which print() refuses
)
_CONTROLS: Final = re.compile(f"[{_CONTROL}]")


def as_terminal_text(text: str) -> str:
    r"""Return text without escape sequences, with ? for other control characters; line breaks and tabs stay.

    Examples
    --------
    >>> as_terminal_text("a\x1b[31mred\x1b[0m name\x07")
    'ared name?'
    """
    return _CONTROLS.sub("?", _SEQUENCE.sub("", text))


def as_line(text: str) -> str:
    """Return text as :func:`as_terminal_text` does, on one line: a line break cannot imitate a second row."""
    return as_terminal_text(text).replace("\n", " ").replace("\t", " ")


def escaped_json(text: str) -> str:
    """Return JSON with escapes instead of the control characters that JSON allows in strings."""
    return _CONTROLS.sub(lambda found: f"\\u{ord(found[0]):04x}", text)
