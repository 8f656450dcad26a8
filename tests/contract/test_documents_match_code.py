"""Versions, exit codes, messages, close codes and names in the documents are those of the code."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from document_names import ROOT, Named, all_source, documents, names_in, problem

from carina.case.schema import SCHEMA
from carina.errors import CarinaError
from carina.server import messages as wire
from carina.version import WIRE_VERSION

CONTRACTS = (ROOT / "docs" / "contracts.md").read_text(encoding="utf-8")
PROTOCOL = (ROOT / "protocol" / "README.md").read_text(encoding="utf-8")


def subclasses(base: type[CarinaError]) -> set[type[CarinaError]]:
    """Return a class and all classes below it."""
    return {base}.union(*(subclasses(one) for one in base.__subclasses__()))


def test_the_page_of_the_wire_names_the_wire_version() -> None:
    assert PROTOCOL.splitlines()[0].endswith(f"(version {WIRE_VERSION})")


def test_the_contract_names_the_schema_of_the_case_file() -> None:
    found = re.search(r"\(`NAME\.carina`, schema (\d+)", CONTRACTS)
    assert found is not None
    assert int(found.group(1)) == SCHEMA


def test_the_contract_lists_the_exit_codes_of_all_errors() -> None:
    table = {int(code) for code in re.findall(r"^\| (\d+) \|", CONTRACTS, re.MULTILINE)}
    raised = {cls.exit_code for cls in subclasses(CarinaError) if cls.__module__.startswith("carina.")}
    assert raised | {0} <= table


@pytest.mark.parametrize("document", documents(), ids=lambda path: path.name)
def test_format_versions_in_a_document_are_those_of_the_code(document: Path) -> None:
    stated = re.findall(r"`(carina-[a-z-]+)` (?:version )?(\d+)", document.read_text(encoding="utf-8"))
    source = all_source()
    newest = {name: str(max(int(version) for other, version in stated if other == name)) for name, _ in stated}
    for name, version in newest.items():
        pairs = re.findall(rf"FORMAT = '{name}'\s+VERSION = (\d+)|'{name}', (\d+)", source)
        known = {one for pair in pairs for one in pair if one}
        if known:
            assert version in known, f"{name} {version}"


def test_the_page_of_the_wire_names_every_close_code() -> None:
    stated = {int(code) for code in re.findall(r"^\| (\d{4})", PROTOCOL, re.MULTILINE)}
    assert set(wire.CLOSE_CODES.values()) <= stated
    assert stated - {1001} <= set(wire.CLOSE_CODES.values())


def test_messages_in_the_tables_of_the_wire_exist() -> None:
    known = {
        *wire.CLIENT_MESSAGES, *wire.SERVER_MESSAGES, *wire.PHONE_MESSAGES, *wire.TO_PHONE_MESSAGES,
        *wire.JOIN_MESSAGES, *wire.TO_JOIN_MESSAGES,
    }  # fmt: skip
    cells = re.findall(r"^\| ((?:`[a-z_]+(?: \{[^`]*)?`[ ·]*)+) \|", PROTOCOL, re.MULTILINE)
    stated = {name for cell in cells for name in re.findall(r"`([a-z_]+)", cell)}
    assert len(stated) > 60
    assert stated <= known


def test_error_codes_in_the_contract_exist_in_the_code() -> None:
    source = all_source()
    for code in re.findall(r"`((?:import|track|plan|session)\.[a-z]+-[a-z-]+|case\.no-[a-z]+)`", CONTRACTS):
        assert f"'{code}'" in source, code


def test_a_row_of_the_architecture_names_the_file_that_defines_the_function() -> None:
    text = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| \d+ \| `([\w.]+)`, `([\w./]+)`", text, re.MULTILINE)
    assert len(rows) > 8
    for name, file in rows:
        path = next(p for p in (ROOT / file, ROOT / "python" / "carina" / file) if p.exists())
        assert re.search(rf"\b{name.rpartition('.')[2]}\b", path.read_text(encoding="utf-8")), f"{name} in {file}"


@pytest.mark.parametrize("document", documents(), ids=lambda path: path.name)
def test_tests_that_a_document_names_exist(document: Path) -> None:
    stated = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", document.read_text(encoding="utf-8"))
    missing = [
        f"{file}::{name}"
        for file, name in stated
        if not (ROOT / file).exists() or f"def {name}(" not in (ROOT / file).read_text(encoding="utf-8")
    ]
    assert not missing
    assert stated or document.name != "import-answers.md"


@pytest.mark.parametrize("document", documents(), ids=lambda path: path.name)
def test_names_in_a_document_exist(document: Path) -> None:
    found = [f"{one.document}:{one.line}: `{one.text}`: {why}" for one in names_in(document) if (why := problem(one))]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    "text",
    [
        "_serve_window",
        "server/no_such_file.py",
        "carina.no_such",
        "Session.no_such",
        "carina nonsense",
        "--no-such-option",
        "make nonsense",
    ],
)
def test_a_wrong_name_is_found(text: str) -> None:
    assert problem(Named("ARCHITECTURE.md", 1, text)) is not None
