"""Tests of unique class names in the Python reference, and of the build of the documentation by `make check` and CI."""

from __future__ import annotations

import importlib
import re
from collections import defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def documented_modules() -> list[str]:
    """Return the modules that the Python reference describes."""
    pages = sorted((ROOT / "docs" / "api").glob("*.md"))
    return [name for page in pages for name in re.findall(r"automodule:: ([\w.]+)", page.read_text(encoding="utf-8"))]


def test_each_documented_class_name_belongs_to_exactly_one_class() -> None:
    """Check all documented modules, because Sphinx cannot resolve an annotation whose name two of them define."""
    classes: dict[str, set[type]] = defaultdict(set)
    for module in map(importlib.import_module, documented_modules()):
        for name in getattr(module, "__all__", dir(module)):
            value = getattr(module, name)
            if isinstance(value, type) and value.__module__.startswith("carina."):
                classes[name].add(value)
    assert len(classes) > 100
    ambiguous = {name: found for name, found in classes.items() if len(found) > 1}
    assert not ambiguous


@pytest.mark.parametrize("file", ["Makefile", ".ci/run"])
def test_documentation_is_built_by_make_check(file: str) -> None:
    text = (ROOT / file).read_text(encoding="utf-8")
    assert re.search(r"^(check:|.*make .*\bcheck-python\b).*\bdocs\b", text, re.MULTILINE)
