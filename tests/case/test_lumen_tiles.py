"""Tests of the conversion of a lumen mask to stored tiles and back."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from carina.case.lumen_tiles import TILE, TILE_BYTES, from_tiles, num_tiles, to_tiles

shapes = st.tuples(*(st.integers(1, 70) for _ in range(3)))


@given(shape=shapes, seed=st.integers(0, 2**32 - 1), share=st.sampled_from([0.0, 0.0001, 0.3, 1.0]))
def test_any_lumen_is_restored_from_its_stored_tiles(shape, seed, share):
    lumen = (np.random.default_rng(seed).random(shape) < share).astype(np.uint8)
    tiles = to_tiles(lumen)
    places = [place for place, _ in tiles]
    assert places == sorted(set(places))
    assert all(len(bits) == TILE_BYTES and any(bits) for _, bits in tiles)
    assert all(0 <= place < num_tiles(shape) for place in places)
    found = from_tiles(shape, tiles)
    np.testing.assert_array_equal(found, lumen)
    assert not found.flags.writeable


def test_every_nonzero_voxel_is_lumen_and_an_edit_of_one_voxel_changes_one_tile():
    lumen = np.zeros((80, 80, 80), np.uint8)
    lumen[10:70, 20, 20] = 255
    before = to_tiles(lumen)
    np.testing.assert_array_equal(from_tiles(lumen.shape, before), lumen != 0)
    lumen[TILE + 2, 21, 21] = 1
    assert sum(one != other for one, other in zip(before, to_tiles(lumen), strict=True)) == 1
