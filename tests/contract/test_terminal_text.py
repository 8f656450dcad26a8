"""Tests that control sequences are removed from text of files before it is printed to a terminal."""

from __future__ import annotations

import ast
import json
from pathlib import Path

import pytest

import carina.cli
from carina.cli.console import print_json, print_note, print_result, progress_printer
from carina.display.terminal import as_line, as_terminal_text, escaped_json

ATTACKS = {
    "a\x1b[31mred\x1b[0m": "ared",
    "a\x1b[2J\x1b[Hb": "ab",
    "a\x9b2Jb": "ab",
    "a\x1b]0;title\x07b": "ab",
    "a\x1b]8;;http://x\x1b\\link\x1b]8;;\x1b\\b": "alinkb",
    "a\x1bPq...\x1b\\b": "ab",
    "a\x1bcb": "ab",
    "a\x07\x08\x0b\x0cb": "a????b",
    "line\roverwritten": "line?overwritten",
    "a\x7fb\x85c": "a?b?c",
    "exe.\u202egnp": "exe.?gnp",
    "\u2066a\u2069\u200f\u061c": "?a???",
    "a\u2028b": "a?b",
    "not UTF-8 \udcff": "not UTF-8 ?",
    "größer, 気管支, 🫁": "größer, 気管支, 🫁",
    "a\x1b": "a?",
    "a\x1b]0;never ends": "a",
}
CONTROLS = {chr(n) for n in (*range(32), *range(0x7F, 0xA0), *range(0x202A, 0x202F), *range(0x2066, 0x206A))} - {"\n"}


@pytest.mark.parametrize("text", ATTACKS)
def test_control_sequences_in_text_are_removed_before_printing(text):
    assert as_terminal_text(text) == ATTACKS[text]
    assert as_line(text) == ATTACKS[text]


def test_every_control_character_is_removed_from_a_line():
    for n in (*range(0x3000), *range(0xD800, 0xE000), 0xFEFF, 0x1F600):
        line = as_line(f"a{chr(n)}b")
        assert not set(line) & (CONTROLS | {"\n"})
        line.encode()


def test_line_breaks_are_preserved_in_messages_and_removed_from_lines():
    assert as_terminal_text("a\n\tb") == "a\n\tb"
    assert as_line("a\n\tb") == "a  b"


def test_json_output_contains_the_text_with_escaped_control_characters():
    for text in ATTACKS:
        dumped = json.dumps({"title": text}, ensure_ascii=False, indent=2)
        escaped = escaped_json(dumped)
        assert json.loads(escaped) == {"title": text}
        assert not set(escaped) & CONTROLS


def test_all_print_functions_remove_control_characters(capsys, monkeypatch):
    for text in ATTACKS:
        print_note(text)
        print_result(text, text)
        print_json({"text": text})
        progress_printer()(text, 0.5)
        monkeypatch.setattr("sys.stderr.isatty", lambda: True)
        progress_printer()(text, None)
        monkeypatch.undo()
    out, err = capsys.readouterr()
    assert not set(out) & CONTROLS
    assert not set(err.replace("\r\x1b[2K", "")) & CONTROLS


def test_command_line_prints_only_through_the_functions_that_remove_control_characters():
    found = []
    for path in sorted(Path(carina.cli.__file__).parent.glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "print":
                is_fixed = all(isinstance(argument, ast.Constant) for argument in node.args)
                if path.name != "console.py" and not is_fixed:
                    found.append(f"{path.name}:{node.lineno}")
    assert found == []
