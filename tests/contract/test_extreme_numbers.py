"""Tests of the bounds of numbers on the wire and in files, which are checked before a number is used."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec import inspect

from carina.errors import CarinaError, ProtocolError
from carina.export import read_tree
from carina.navigate import open_key_frames, open_recording
from carina.render import TransferFunction, transfer_preset
from carina.server.wire import messages as wire
from carina.server.wire.codec import MAX_DEPTH
from carina.track import AirwayTree, Branch, edits_from_json

PROTOCOL = Path(__file__).resolve().parents[2] / "protocol"
PARSERS = {
    "client": wire.parse_client_message,
    "server": wire.parse_server_message,
    "phone": wire.parse_phone_message,
    "to-phone": wire.parse_to_phone_message,
}
EVIL = [
    "9" * 10_000,
    "9" * 400,
    "-" + "9" * 400,
    "1e999",
    "-1e999",
    "1e308",
    "9007199254740993",
    "NaN",
    "Infinity",
    "-Infinity",
    "true",
    "null",
    '"1"',
    "[" * 5000 + "]" * 5000,
    '{"a":' * 5000 + "1" + "}" * 5000,
    "[]",
    "{}",
    "-0.0",
    "1e-320",
]


def numbers_of(kind: inspect.Type):
    """Yield for each number in the type of a field whether the number has a finite range."""
    match kind:
        case inspect.IntType() | inspect.FloatType():
            yield kind.ge is not None and kind.le is not None and np.isfinite([kind.ge, kind.le]).all()
        case inspect.UnionType():
            for choice in kind.types:
                yield from numbers_of(choice)
        case inspect.StructType():
            for field in kind.fields:
                yield from numbers_of(field.type)
        case inspect.TupleType():
            for item in kind.item_types:
                yield from numbers_of(item)
        case inspect.VarTupleType():
            yield from numbers_of(kind.item_type)


INCOMING = [*wire.CLIENT_MESSAGES.values(), *wire.PHONE_MESSAGES.values()]


@pytest.mark.parametrize("cls", INCOMING, ids=lambda cls: cls.__name__)
def test_every_number_that_a_client_sends_has_a_range(cls):
    missing = [field.name for field in inspect.type_info(cls).fields if not all(numbers_of(field.type))]
    assert missing == [], f"{cls.__name__}: give these bounds (carina/commands/fields.py)"


def evil_texts(document: Any):
    """Yield the document as text with each of its values replaced by each value of ``EVIL``."""
    mark = "@@evil@@"

    def places(value, path=()):
        yield path
        if isinstance(value, dict):
            for key, entry in value.items():
                yield from places(entry, (*path, key))
        elif isinstance(value, list):
            # In a long list, only the first and the last element are replaced.
            for n in {0, len(value) - 1} if value else ():
                yield from places(value[n], (*path, n))

    for path in places(document):
        if not path:
            continue
        changed = json.loads(json.dumps(document))
        inner = changed
        for step in path[:-1]:
            inner = inner[step]
        inner[path[-1]] = mark
        text = json.dumps(changed)
        for evil in EVIL:
            yield text.replace(f'"{mark}"', evil)


SAMPLES = [p for kind in PARSERS for p in sorted((PROTOCOL / "valid" / kind).glob("*.json"))]


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_extreme_values_in_a_message_raise_no_error_other_than_protocol_error(path):
    parse = PARSERS[path.parent.name]
    for text in evil_texts(json.loads(path.read_bytes())):
        try:
            parse(text)
        except ProtocolError as error:
            assert len(str(error)) < 500  # noqa: PT017, it may also be taken


def test_huge_integer_in_the_hello_message_of_a_phone_is_refused_before_its_token_is_read():
    for number in ("9" * 400, "1e400", str(2**63)):
        with pytest.raises(ProtocolError):
            wire.parse_phone_message(f'{{"type":"phone_hello","wire_version":{number},"token":"x"}}')


def test_document_with_excessive_nesting_or_numbers_is_refused():
    for inside in ("[" * MAX_DEPTH + "]" * MAX_DEPTH, "9" * 400, "1e999"):
        with pytest.raises(ProtocolError):
            wire.parse_client_message(f'{{"type":"set_transfer","preset":null,"document":{{"points":{inside}}}}}')


TREE = AirwayTree(
    (
        Branch(0, None, (1,), 0, "Trachea", "tracked", np.array([[0.0, 0, 0], [0, 0, -9]]), np.array([8.0, 7.5])),
        Branch(1, 0, (), 1, None, "manual", np.array([[0.0, 0, -9], [0, 0, -20]]), np.array([7.5, 6.0])),
    )
)
IDENTITY = [float(v) for v in np.eye(4).ravel()]
FILES = {
    "tree": (TREE.to_json(), read_tree),
    "transfer": (
        transfer_preset("endoscopic").to_json(),
        lambda path: TransferFunction.from_json_text(path.read_text(encoding="utf-8")),
    ),
    "keys": (
        {
            "format": "carina-keys",
            "version": 1,
            "keys": [{"time_s": 0.0, "lps_from_camera": IDENTITY}, {"time_s": 1.0, "lps_from_camera": IDENTITY}],
        },
        open_key_frames,
    ),
    "recording": (
        {"format": "carina-recording", "version": 1, "carina": "0", "case": {}, "tip": {}, "begin": []},
        open_recording,
    ),
    "edits": (
        {
            "format": "carina-tree-edits",
            "version": 1,
            "space": "LPS",
            "unit": "mm",
            "edits": [{"kind": "cut-branch", "branch_id": 1, "at_mm": 1.0}, {"kind": "move-root", "lps": [0, 0, 0]}],
        },
        lambda path: edits_from_json(json.loads(path.read_text(encoding="utf-8"))),
    ),
}


def is_json(text):
    try:
        json.loads(text)
    except (ValueError, RecursionError):
        return False
    return True


@pytest.mark.parametrize("kind", FILES)
def test_extreme_values_in_a_file_raise_no_error_other_than_carina_error(kind, tmp_path):
    document, read = FILES[kind]
    path = tmp_path / "file.json"
    for text in evil_texts(document):
        path.write_text(text, encoding="utf-8")
        if kind == "edits" and not is_json(text):
            continue  # The reader receives only values that json.loads can return.
        with contextlib.suppress(CarinaError):
            read(path)
