"""Escaping and shortening of text from files, file names and headers, for messages."""

from __future__ import annotations

import re

MAX_VALUE_CHARS = 80
"""Number of characters to which a message shortens a value of a file's header."""
MAX_WORD_CHARS = 800
"""Maximum length of a word in a message, in characters; a word from a user or a file may have a million."""
# C0 and C1 control characters, line and paragraph separators, direction overrides, and surrogates: Python stores a byte
# of a file name that is not UTF-8 as a surrogate, which no encoder accepts.
_UNSAFE = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")


def printable(text: str) -> str:
    r"""Return a text whose control characters and undecodable bytes are replaced by escapes such as ``\xe9``.

    Examples
    --------
    >>> printable("l\udce9 1\n2")
    'l\\xe9 1\\x0a2'
    """
    return _UNSAFE.sub(_escape, text)


def shortened_words(text: str, max_chars: int = MAX_WORD_CHARS) -> str:
    """Return a message in which each word of more than ``max_chars`` characters is shortened in the middle.

    Examples
    --------
    >>> shortened_words("no file " + "x" * 900, max_chars=20)
    'no file xxxxxxxxxxxxxx…xxxxx'
    """
    tail = max_chars // 4

    def shorten(found: re.Match[str]) -> str:
        return f"{found[0][: max_chars - tail - 1]}…{found[0][-tail:]}"

    return re.sub(rf"\S{{{max_chars + 1},}}", shorten, text)


def shown_value(value: str, max_chars: int = MAX_VALUE_CHARS) -> str:
    """Return a value in quotation marks on one line, shortened in the middle if it is long.

    Examples
    --------
    >>> shown_value("0,7 0,8 2")
    "'0,7 0,8 2'"
    """
    text = printable(" ".join(value[: 20 * max_chars].split(" ")))
    if len(value) > max_chars or len(text) > max_chars:
        tail = printable(value[-max_chars // 4 :])[-max_chars // 4 :]
        return f"'{text[: max_chars - len(tail)]}…{tail}' ({len(value)} characters)"
    return f"'{text}'"


def _escape(found: re.Match[str]) -> str:
    code = ord(found[0])
    if 0xDC80 <= code <= 0xDCFF:  # a byte 0x80 to 0xff of a file name (PEP 383)
        code -= 0xDC00
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"
