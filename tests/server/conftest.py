"""Fixture for the tests of the server: a running server."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from live_server import Live, running


@pytest.fixture
def live(tmp_path) -> Iterator[Live]:
    """Return a running server with a session over the small case."""
    with running(tmp_path) as live:
        yield live
