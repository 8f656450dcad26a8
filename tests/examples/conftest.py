"""Fixture of the tests of examples: the airways of equal volumes are searched once for all tests."""

from __future__ import annotations

from collections.abc import Iterator
from unittest.mock import patch

import pytest

import carina
from cached_test_data import found_airways


@pytest.fixture(scope="module", autouse=True)
def shared_airways() -> Iterator[None]:
    """Replace the search for airways by its cache, which gives equal trees for equal voxels and geometry."""
    with patch.object(carina, "find_airways", found_airways):
        yield
