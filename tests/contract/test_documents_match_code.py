"""Tests that the documents agree with the code: versions, exit codes, messages, close codes and names."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from document_names import ROOT, Named, all_source, documents, names_in, problem

from carina.case.schema import SCHEMA
from carina.errors import CarinaError
from carina.server.wire import messages as wire
from carina.version import WIRE_VERSION

CONTRACTS = (ROOT / "docs" / "contracts.md").read_text(encoding="utf-8")
PROTOCOL = (ROOT / "protocol" / "README.md").read_text(encoding="utf-8")
# CHANGELOG.md and the decisions are excluded, because they state versions of earlier times.
ALL_DOCUMENTS = [
    *documents(),
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "web/README.md", "benchmarks/README.md")),
]


def subclasses(base: type[CarinaError]) -> set[type[CarinaError]]:
    """Return an error class and all its direct and indirect subclasses."""
    return {base}.union(*(subclasses(one) for one in base.__subclasses__()))


def test_wire_documentation_page_names_the_wire_version() -> None:
    assert PROTOCOL.splitlines()[0].endswith(f"(version {WIRE_VERSION})")


@pytest.mark.parametrize("document", ALL_DOCUMENTS, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_wire_version_in_a_document_is_that_of_the_code(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    assert {int(one) for one in re.findall(r"[Ww]ire version (\d+)", text)} <= {WIRE_VERSION}
    if document.parent.name == "protocol":
        history = [int(one) for one in re.findall(r"version (\d+)", text)]
        assert max(history) == WIRE_VERSION


@pytest.mark.parametrize("document", ALL_DOCUMENTS, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_newest_case_schema_in_a_document_is_that_of_the_code(document: Path) -> None:
    stated = [int(one) for one in re.findall(r"\bschema (\d+)\b", document.read_text(encoding="utf-8"))]
    describes = document.name in {"case-file.md", "contracts.md", "conventions.md"}
    assert stated or not describes
    assert not stated or max(stated) == SCHEMA


def test_cluster_pages_name_the_locked_versions_of_ray() -> None:
    [locked] = re.findall(
        r"^ray(?:\[[^]]*\])?==([\d.]+)", (ROOT / "requirements-cluster.lock").read_text(), re.MULTILINE
    )
    stated = re.findall(r'rayVersion: "([\d.]+)"|\bRay (\d+\.\d+)', (ROOT / "docs" / "cluster.md").read_text())
    assert len(stated) > 1
    assert {whole or f"{part}.{locked.rpartition('.')[2]}" for whole, part in stated} == {locked}


def test_contract_page_lists_the_exit_codes_of_all_errors() -> None:
    table = {int(code) for code in re.findall(r"^\| (\d+) \|", CONTRACTS, re.MULTILINE)}
    raised = {cls.exit_code for cls in subclasses(CarinaError) if cls.__module__.startswith("carina.")}
    assert raised | {0} <= table


@cache
def format_versions() -> dict[str, int]:
    """Return the newest version of each JSON format that the package writes.

    A module defines both as constants (``FORMAT``, ``VERSION``) or writes them into a dictionary.
    """
    found: dict[str, int] = {}
    for path in sorted((ROOT / "python" / "carina").rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        constants = {name: value for node in tree.body for name, value in assigned(node)}
        pairs = [(constants.get("FORMAT"), constants.get("VERSION"))]
        for node in ast.walk(tree):
            if isinstance(node, ast.Dict):
                entries = {key.value: value for key, value in zip(node.keys, node.values, strict=True) if is_text(key)}
                pairs.append(tuple(value_of(entries.get(name), constants) for name in ("format", "version")))
        for name, version in pairs:
            if isinstance(name, str) and isinstance(version, int):
                found[name] = max(version, found.get(name, 0))
    return found


def is_text(node: ast.expr | None) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def assigned(node: ast.stmt) -> Iterator[tuple[str, object]]:
    """Yield names and constants of an assignment: ``A = 1`` or ``A, B = "x", 1``."""
    if isinstance(node, ast.Assign) and len(node.targets) == 1:
        target, value = node.targets[0], node.value
        names = target.elts if isinstance(target, ast.Tuple) else [target]
        values = value.elts if isinstance(value, ast.Tuple) else [value]
        for name, one in zip(names, values, strict=False):
            if isinstance(name, ast.Name) and isinstance(one, ast.Constant):
                yield name.id, one.value


def value_of(node: ast.expr | None, constants: dict[str, object]) -> object:
    match node:
        case ast.Constant(value=value):
            return value
        case ast.Name(id=name):
            return constants.get(name)
    return None


def test_every_json_format_of_the_package_has_a_version_in_the_code() -> None:
    found = format_versions()
    assert {"carina-tree", "carina-transfer", "carina-keys", "carina-recording", "carina-plan", "carina-pose"} <= set(
        found
    )


@pytest.mark.parametrize("document", ALL_DOCUMENTS, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_format_versions_in_a_document_are_those_of_the_code(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    stated = re.findall(r"`(carina-[a-z-]+)` (?:version )?(\d+)", text)
    stated += re.findall(r'"format": "(carina-[a-z-]+)", "version": (\d+)', text)
    newest = {name: max(int(version) for other, version in stated if other == name) for name, _ in stated}
    found = format_versions()
    assert newest == {name: found.get(name) for name in newest}


def test_wire_documentation_page_names_every_close_code() -> None:
    stated = {int(code) for code in re.findall(r"^\| (\d{4})", PROTOCOL, re.MULTILINE)}
    assert set(wire.CLOSE_CODES.values()) <= stated
    assert stated - {1001} <= set(wire.CLOSE_CODES.values())


def test_tables_of_the_wire_documentation_contain_exactly_the_messages_of_the_code() -> None:
    known = {
        *wire.CLIENT_MESSAGES, *wire.SERVER_MESSAGES, *wire.PHONE_MESSAGES, *wire.TO_PHONE_MESSAGES,
        *wire.JOIN_MESSAGES, *wire.TO_JOIN_MESSAGES,
    }  # fmt: skip
    cells = re.findall(r"^\| ((?:`[a-z_]+(?: \{[^`]*)?`[ ·]*)+) \|", PROTOCOL, re.MULTILINE)
    stated = {name for cell in cells for name in re.findall(r"`([a-z_]+)", cell)}
    assert stated == known


def test_fields_in_the_tables_of_the_wire_documentation_exist() -> None:
    sent = {**wire.CLIENT_MESSAGES, **wire.PHONE_MESSAGES, **wire.JOIN_MESSAGES}
    received = {**wire.SERVER_MESSAGES, **wire.TO_PHONE_MESSAGES, **wire.TO_JOIN_MESSAGES}
    # The table of changes by version, which precedes this heading, contains earlier names.
    present = PROTOCOL.partition("## Text messages")[2]
    stated = re.findall(r"`([a-z_]+) \{((?:[^`{}]|\{[^`{}]*\})*)\}`", present)
    assert len(stated) > 60
    for name, fields in stated:
        names = set(re.findall(r"[a-z_0-9]+", re.sub(r":\[[^]]*\]|\\?\|null", "", fields)))
        known = [set(group[name].__struct_fields__) for group in (sent, received) if name in group]
        assert any(names <= one for one in known), f"{name} {names}"


def test_error_codes_in_the_contract_page_exist_in_the_code() -> None:
    source = all_source()
    for code in re.findall(r"`((?:import|track|plan|session)\.[a-z]+-[a-z-]+|case\.no-[a-z]+)`", CONTRACTS):
        assert f"'{code}'" in source, code


def test_architecture_table_names_the_file_that_defines_each_function() -> None:
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
def test_names_in_backticks_of_a_document_exist_in_the_code(document: Path) -> None:
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
def test_wrong_name_in_backticks_of_a_document_is_reported(text: str) -> None:
    assert problem(Named("ARCHITECTURE.md", 1, text)) is not None
