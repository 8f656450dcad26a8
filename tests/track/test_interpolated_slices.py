"""Tests of divided slices: cubic B-splines, compared with a plain solution of their equations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carina.track.paths.interpolated_slices import with_divided_slices


def spline(x):
    x = np.abs(x)
    return np.where(x < 1.0, 2.0 / 3.0 - x**2 + 0.5 * x**3, np.where(x < 2.0, (2.0 - x) ** 3 / 6.0, 0.0))


def mirrored(place, num):
    place = abs(place) % (2 * (num - 1))
    return min(place, 2 * (num - 1) - place)


def slowly(values, parts):
    """Return the spline at the middle of each part of one column, from a plain solution of the equations."""
    num = len(values)
    matrix = np.zeros((num, num))
    for k in range(num):
        for step in (-1, 0, 1):
            matrix[k, mirrored(k + step, num)] += spline(step)
    coefficients = np.linalg.solve(matrix, values.astype(np.float64))
    at = (np.arange(num * parts) + 0.5) / parts - 0.5
    found = np.array([sum(spline(x - k) * coefficients[mirrored(k, num)] for k in range(-3, num + 3)) for x in at])
    return np.clip(found, values.min(), values.max())


@given(
    num=st.integers(2, 12),
    parts=st.integers(2, 6),
    seed=st.integers(0, 2**32 - 1),
)
def test_interpolated_voxel_column_equals_the_plain_solution(num, parts, seed):
    column = np.random.default_rng(seed).integers(-1024, 3000, num).astype(np.int16)
    found = with_divided_slices(column.reshape(num, 1, 1), parts)[:, 0, 0]
    assert np.abs(found - slowly(column, parts)).max() <= 0.6


def test_interpolated_voxel_columns_are_independent_of_each_other_and_of_memory_layout():
    stack = np.random.default_rng(1).integers(-1024, 1000, (7, 70, 5)).astype(np.int16)
    # The second column stays in its range of values, which limits the result.
    stack[0, 41, 2], stack[1, 41, 2] = -1024, 1000
    whole = with_divided_slices(stack, 3)
    assert whole.shape == (21, 70, 5)
    assert whole.flags.c_contiguous
    np.testing.assert_array_equal(with_divided_slices(np.asfortranarray(stack), 3), whole)
    part = np.ascontiguousarray(stack[:, 41:44, 2:3])
    np.testing.assert_array_equal(with_divided_slices(part, 3), whole[:, 41:44, 2:3])


@pytest.mark.parametrize("parts", [3, 5])
def test_middle_of_an_odd_number_of_interpolated_slices_is_the_slice_itself(parts):
    stack = np.random.default_rng(2).integers(-1024, 1000, (6, 4, 5)).astype(np.int16)
    np.testing.assert_array_equal(with_divided_slices(stack, parts)[parts // 2 :: parts], stack)


def test_single_slice_or_division_into_one_part_is_not_interpolated():
    stack = np.random.default_rng(3).integers(-1024, 1000, (5, 4, 3)).astype(np.int16)
    np.testing.assert_array_equal(with_divided_slices(stack, 1), stack)
    np.testing.assert_array_equal(with_divided_slices(stack[:1], 4), np.repeat(stack[:1], 4, axis=0))
