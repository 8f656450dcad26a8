"""Chest with all 18 segments and its wall, for tests of training."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from cached_test_data import masked_chest
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
    return Chest(*masked_chest())
