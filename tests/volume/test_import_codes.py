"""Tests of the codes of refusals and notes of the import: each is unique and listed on the page with its remedy."""

from __future__ import annotations

import ast
import re
from collections import Counter
from pathlib import Path

import pytest
from corpus import PAGE, all_inputs, numbered_remedies, sentences

import carina.cli.opened
import carina.track
import carina.volume

CODE = re.compile(r"import(\.[a-z0-9]+(-[a-z0-9]+)*)+")
ROW = re.compile(r"^\| `(?P<code>[\w.-]+)` \| (?P<kind>[^|]+) \| (?P<means>[^|]+) \| (?P<do>[^|]+) \|$", re.MULTILINE)
NUMBER = re.compile(r"\bA\d+\b")
NUMBERS = re.compile(r"(A\d+(, )?)+\.?")
SOURCES = [*sorted(Path(carina.volume.__file__).parent.glob("*.py")), Path(carina.cli.opened.__file__)]
SEARCH = sorted(Path(carina.track.__file__).parent.rglob("*.py"))


def rows() -> list[dict[str, str]]:
    """Return the rows of the table of codes on the page."""
    part = PAGE.read_text(encoding="utf-8").split("## Codes")[1]
    return [match.groupdict() for match in ROW.finditer(part)]


def advice() -> list[str]:
    """Return the cells of the last column of all tables of inputs and of the table of codes."""
    page = PAGE.read_text(encoding="utf-8")
    inputs = page[: page.index("<!-- tables: end -->")]
    cells = re.findall(r"^\| [^|]+ \| (?:opens|refused)[^|]* \| ([^|]+) \|$", inputs, re.MULTILINE)
    assert len(cells) == len(all_inputs())
    return [*cells, *(row["do"] for row in rows())]


def nodes(kind: type) -> list:
    """Return all syntax nodes of a kind in the source files of the import."""
    return [node for path in SOURCES for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, kind)]


def raised() -> set[str]:
    """Return every string in the source files of the import that has the form of a code."""
    found = {node.value for node in nodes(ast.Constant) if isinstance(node.value, str)}
    return {text for text in found if CODE.fullmatch(text)}


def noted() -> dict[str, set[str]]:
    """Return the badge flags that the source states as literals for each code of a note."""
    found: dict[str, set[str]] = {}
    for node in nodes(ast.Call):
        if getattr(node.func, "id", "") not in ("Note", "Doubt") or not isinstance(node.args[0], ast.Constant):
            continue
        badge = next((word.value for word in node.keywords if word.arg == "badge"), None)
        if node.func.id == "Doubt" or (isinstance(badge, ast.Constant) and badge.value):
            kind = "badge"
        else:
            kind = "note" if badge is None else "note or badge"
        found.setdefault(node.args[0].value, set()).add(kind)
    return found


def test_every_error_code_of_the_import_is_on_the_documentation_page():
    documented = {row["code"] for row in rows()}
    assert len(raised()) > 40
    assert raised() - documented == set()


def test_import_codes_and_their_meanings_are_unique():
    assert len({row["code"] for row in rows()}) == len(rows())
    assert len({row["means"] for row in rows()}) == len(rows())


def test_every_import_refusal_and_every_badge_has_a_remedy_on_the_documentation_page():
    numbers = set(numbered_remedies().values())
    short = [row for row in rows() if row["kind"] != "note" and len(row["do"]) < 10]
    assert [row["code"] for row in short if not set(NUMBER.findall(row["do"])) & numbers] == []


def test_remedy_numbers_on_the_documentation_page_exist_and_each_is_used_at_least_twice():
    used = Counter(number for cell in advice() for number in NUMBER.findall(cell))
    assert used.keys() == set(numbered_remedies().values())
    assert [number for number, count in used.items() if count < 2] == []


def test_documentation_page_states_each_remedy_completely_once():
    stated = Counter(one for cell in advice() for one in sentences(cell) if not NUMBERS.fullmatch(one) and one != "-")
    stated.update(list(numbered_remedies()))
    assert [one for one, count in stated.items() if count > 1] == []


def test_documentation_page_marks_refusals_notes_and_badges_as_the_code_does():
    kinds = {row["code"]: row["kind"] for row in rows()}
    assert noted()
    for code, found in noted().items():
        kind = next(iter(found)) if len(found) == 1 else "note or badge"
        assert kinds[code] == kind, code


@pytest.mark.parametrize("kind", ["refusal", "note"])
def test_import_corpus_expects_refusal_codes_only_as_refusals_and_note_codes_as_notes(kind):
    kinds = {row["code"]: row["kind"] for row in rows()}
    shown = {entry.expected for entry in all_inputs()} - {"opens"}
    if kind == "note":
        shown = {code for entry in all_inputs() for code in entry.notes}
    for code in shown:
        assert (kinds[code] == "refusal") is (kind == "refusal"), code


def test_every_badge_of_an_airway_search_is_on_the_documentation_page():
    badges = {row["code"] for row in rows() if row["kind"] == "badge"}
    trees = [ast.parse(path.read_text()) for path in SEARCH]
    named = {
        node.targets[0].id: node.value.value
        for tree in trees
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign)
        and isinstance(node.targets[0], ast.Name)
        and isinstance(node.value, ast.Constant)
    }
    calls = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Call)]
    firsts = [node.args[0] for node in calls if getattr(node.func, "id", "") == "Note" and node.args]
    codes = {
        first.value if isinstance(first, ast.Constant) else named.get(getattr(first, "id", "")) for first in firsts
    }
    assert "track.search-stopped" in codes
    assert codes - {None} <= badges
