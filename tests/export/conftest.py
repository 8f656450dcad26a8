"""Fixtures for tests of printable parts."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from carina.export.printable_phantom import PrintedLumen
from carina.track import Airways
from carina.volume import Volume


@pytest.fixture(scope="module")
def shared_lumen() -> Iterator[None]:
    """Compute the printed lumen of each selection of branches only once, because all prints of a chest have it."""
    compute = PrintedLumen.of
    computed: dict[Any, tuple[PrintedLumen, Volume, Airways]] = {}

    def of(volume: Volume, airways: Airways, report: Any, *, branches: frozenset[int] | None = None) -> PrintedLumen:
        key = (id(volume), id(airways), branches)
        if key not in computed:
            # The objects are stored, so that no other object can have their identifiers.
            computed[key] = (compute(volume, airways, report, branches=branches), volume, airways)
        return computed[key][0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PrintedLumen, "of", staticmethod(of))
        yield
