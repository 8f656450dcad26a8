"""Tests of examples in docstrings: each runs and prints the stated output, and every public name has one."""

from __future__ import annotations

import doctest
import importlib
import inspect
import pkgutil
from pathlib import Path

import pytest

import carina
from cached_test_data import cached_phantom, found_airways
from carina.errors import CarinaError


def with_examples() -> list[str]:
    """Return the modules whose text contains a doctest prompt, found without importing them."""
    root = Path(carina.__file__).parent
    names = ["carina"]
    names += [module.name for module in pkgutil.walk_packages([str(root)], "carina.") if "._core" not in module.name]
    found = []
    for name in names:
        spec = importlib.util.find_spec(name)
        if spec is not None and spec.origin and ">>> " in Path(spec.origin).read_text(encoding="utf-8"):
            found.append(name)
    return found


@pytest.mark.parametrize("name", with_examples())
def test_examples_in_docstrings_print_the_stated_output(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    # The examples share phantoms and their airways, because equal arguments give equal voxels.
    monkeypatch.setattr(carina, "generate_phantom", cached_phantom, raising=False)
    monkeypatch.setattr(carina, "find_airways", found_airways, raising=False)
    failed, tried = doctest.testmod(importlib.import_module(name), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert tried
    assert not failed, f"{failed} of {tried} examples of {name} print something else (see above)"


def test_every_public_name_has_a_docstring_example() -> None:
    lacking = []
    for name in carina.__all__:
        value = getattr(carina, name)
        is_error = inspect.isclass(value) and issubclass(value, CarinaError)
        if callable(value) and not is_error and ">>> " not in (value.__doc__ or ""):
            lacking.append(name)
    assert not lacking, f"no example in: {', '.join(lacking)}"
