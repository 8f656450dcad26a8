"""Tests of text and file names from files, converted for messages: one line, short, valid in every encoding."""

from __future__ import annotations

import os

import pytest

from carina.display.escaped_text import MAX_VALUE_CHARS, printable, shown_value
from carina.errors import CarinaError, DiskError, UsageError, VolumeImportError


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("Sättiger é 患者 🫁.nii", "Sättiger é 患者 🫁.nii"),
        (os.fsdecode(b"l\xe9.nii"), r"l\xe9.nii"),
        ("a\nb\tc\x1b[31m\x7f\x9b", r"a\x0ab\x09c\x1b[31m\x7f\x9b"),
        ("gnp\u202etxt.nii\u2028", r"gnp\u202etxt.nii\u2028"),
        ("\ud800", r"\ud800"),
    ],
)
def test_control_and_invalid_characters_are_printed_as_escapes(text, expected):
    assert printable(text) == expected
    printable(text).encode("utf-8")


@pytest.mark.parametrize("kind", [CarinaError, VolumeImportError, DiskError, UsageError])
def test_every_error_message_can_be_printed(kind):
    message = str(kind(f"reading {os.fsdecode(bytes([0x6C, 0xE9, 0x0A]))}"))
    assert message == r"reading l\xe9\x0a"


def test_short_value_is_shown_completely_and_a_long_value_shortened_with_its_length():
    assert shown_value("0,7 0,8 2") == "'0,7 0,8 2'"
    assert shown_value("x" * MAX_VALUE_CHARS) == f"'{'x' * MAX_VALUE_CHARS}'"
    long = shown_value("begin" + "x" * 10_000 + "end")
    assert long.startswith("'begin") and long.endswith("end' (10008 characters)")
    assert len(long) < MAX_VALUE_CHARS + 30
    assert len(shown_value("\x00" * 10_000)) < MAX_VALUE_CHARS + 30
