"""Examples in the docstrings of the package."""

from __future__ import annotations

import doctest
import importlib

import pytest


@pytest.mark.parametrize("name", ["force_loop", "gamepad", "packets"])
def test_examples_print_their_stated_results(name: str) -> None:
    failed, tried = doctest.testmod(importlib.import_module(f"carina_haptics.{name}"))
    assert tried
    assert not failed
