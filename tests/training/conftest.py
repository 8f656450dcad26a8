"""Chest with all 18 segments and its wall, for tests of training."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

import carina
from cached_test_data import MASKED_CHEST, cached_airways, cached_phantom
from carina.scopes import WallField
from carina.track import Airways, AirwayTree
from carina.volume import Volume


@dataclass(frozen=True)
class Chest:
    volume: Volume
    airways: Airways
    wall: WallField

    @property
    def tree(self) -> AirwayTree:
        return self.airways.tree


@pytest.fixture(scope="session")
def chest() -> Chest:
    volume, airways = cached_phantom(**MASKED_CHEST).volume, cached_airways(**MASKED_CHEST)
    # The coarsest spacing is enough for the scores and twice as fast.
    return Chest(volume, airways, carina.wall_field(volume, airways, spacing_mm=0.6, progress=False))
