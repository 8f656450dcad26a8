"""Tests of the spelling of names in Python and of keys in JSON: only ``centre``."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import carina
from cached_test_data import cached_airways, cached_phantom
from carina.track import measure_tree

PACKAGE = Path(carina.__file__).parent
OTHER_SPELLING = {
    ("phantom/leaning_trachea.py", "center_lps"),  # key of the compiled module
    ("phantom/chest.py", "center_lps"),  # earlier versions of truth.json, and the compiled module
    ("server/wire/codec.py", "center_lps"),  # wire version 1
    ("server/wire/messages_of_phone.py", "recenter"),  # action of the wire
    ("volume/grid_writing.py", "CenterOfRotation"),  # key of MetaImage
    ("export/plan_dicom_sr.py", "Center"),  # term of DICOM
}


def names_in(path: Path) -> Iterator[str]:
    """Yield the identifiers of a module, and its strings that may be keys."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.isidentifier():
            yield node.value
        for name in ("id", "attr", "arg", "name"):
            found = getattr(node, name, None)
            if isinstance(found, str):
                yield found


def test_no_name_or_key_in_the_package_has_the_american_spelling_of_centre() -> None:
    found = {
        (path.relative_to(PACKAGE).as_posix(), name)
        for path in PACKAGE.rglob("*.py")
        for name in names_in(path)
        if "center" in name.lower()
    }
    assert found == OTHER_SPELLING


def keys_of(document: Any) -> Iterator[str]:
    """Yield all keys of a JSON document, at any depth."""
    if isinstance(document, dict):
        yield from document
        for value in document.values():
            yield from keys_of(value)
    elif isinstance(document, list):
        for value in document:
            yield from keys_of(value)


def test_documents_of_a_phantom_and_of_its_measures_use_centre() -> None:
    options: dict[str, Any] = {"spacing_mm": 3.0, "generations": 4, "stenosis": True, "nodule": True}
    made = cached_phantom(**options)
    truth = set(keys_of(made.truth))
    measures = set(keys_of(measure_tree(made.volume, cached_airways(**options)).to_json()))
    assert "centre_lps" in truth & measures
    assert not [key for key in truth | measures if "center" in key]
    assert set(made.truth["nodule"]) >= {"centre_lps", "radius_mm"} and "centre_lps" in made.truth["stenosis"]
