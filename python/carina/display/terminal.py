"""Text of files made safe for a terminal: it can neither move the cursor nor hide or reorder other text."""

from __future__ import annotations

import re
from typing import Final

__all__ = ["as_line", "as_terminal_text", "escaped_json"]

# An escape sequence, whole: a colour code without its escape character would leave its digits behind.
_SEQUENCE: Final = re.compile(
    r"(?:\x1b\[|\x9b)[0-?]*[ -/]*[@-~]"  # CSI: colours, cursor
    r"|(?:\x1b[\]PX^_]|[\x9d\x90\x98\x9e\x9f])[^\x07\x1b\x9c]*(?:\x07|\x1b\\|\x9c)?"  # OSC, DCS and the like
    r"|\x1b[ -/]*[0-~]"
)
_CONTROL: Final = (
    r"\x00-\x08\x0b-\x1f\x7f-\x9f"  # C0 but tab and line feed, DEL, C1
    r"\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069"  # direction of writing
    r"\u2028\u2029"  # other line ends
    r"\ud800-\udfff"  # half characters, of file names that are not UTF-8: print() refuses them
)
_CONTROLS: Final = re.compile(f"[{_CONTROL}]")


def as_terminal_text(text: str) -> str:
    """Return text without escape sequences, with ? for other control characters; line breaks and tabs stay.

    Examples
    --------
    >>> as_terminal_text("a\\x1b[31mred\\x1b[0m name\\x07")
    'ared name?'
    """
    return _CONTROLS.sub("?", _SEQUENCE.sub("", text))


def as_line(text: str) -> str:
    """Return text as :func:`as_terminal_text` on one line: a name with a line break cannot look like a second row."""
    return as_terminal_text(text).replace("\n", " ").replace("\t", " ")


def escaped_json(text: str) -> str:
    """Return JSON in which the control characters that JSON allows inside texts are written as escapes."""
    return _CONTROLS.sub(lambda found: f"\\u{ord(found[0]):04x}", text)
