"""Tests of masks that occupy memory only on pages with set voxels."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from carina.volume.sparse_mask import empty_mask, sparse_mask

LARGE = (64, 1024, 1024)


def resident_bytes(mask):
    """Return the resident bytes of the memory mapping of a mask; it may include an adjacent mapping."""
    at = mask.__array_interface__["data"][0]
    found = None
    for line in Path("/proc/self/smaps").read_text().splitlines():
        first = line.split(maxsplit=1)[0]
        if "-" in first and not first.endswith(":"):
            low, high = (int(end, 16) for end in first.split("-"))
            found = low <= at < high
        elif found and line.startswith("Rss:"):
            return 1024 * int(line.split()[1])
    raise AssertionError("the mask lies in no mapping")


@given(arrays(np.uint8, st.tuples(*[st.integers(1, 9)] * 3), elements=st.sampled_from([0, 1, 255])))
def test_sparse_copy_equals_the_mask_and_is_read_only(mask):
    before = mask.copy()
    copy = sparse_mask(mask)
    assert copy.dtype == np.uint8
    assert copy.flags.c_contiguous
    assert np.array_equal(copy, (mask != 0).astype(np.uint8))
    assert np.array_equal(mask, before)
    with pytest.raises(ValueError, match="read-only"):
        copy[0, 0, 0] = 1


def test_mask_in_any_memory_order_is_copied_by_its_indices():
    mask = np.zeros((3, 4, 5), bool)
    mask[2, 0, 4] = mask[1, 3, 0] = True
    seen = mask.transpose(2, 0, 1)[::-1]
    assert np.array_equal(sparse_mask(seen), seen)


@pytest.mark.skipif(sys.platform != "linux", reason="the system tells its memory in /proc")
def test_reading_a_sparse_mask_allocates_no_memory_for_unset_voxels():
    empty = empty_mask(LARGE)
    before = resident_bytes(empty)
    assert not empty.any()
    assert resident_bytes(empty) == before
    mask = np.zeros(LARGE, np.uint8)
    mask[:, 500:504, 600:640] = 1
    copy = sparse_mask(mask)
    assert copy.sum() == mask.sum()
    # Each of the 64 blocks has 4 rows of 1 kB, which is one or two pages.
    assert resident_bytes(copy) <= before + 64 * 2 * 4096
