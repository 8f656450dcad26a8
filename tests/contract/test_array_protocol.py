"""Tests of the conversion of images and masks by ``numpy.asarray``, through ``__array__`` of numpy 2."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import carina
from carina.plan.lungs.lung_map import MappedMask
from carina.plan.turns.fork_view import Operator
from carina.plan.turns.pictures import TurnPicture
from carina.volume import Mask

POSE = carina.Pose.looking((5.5, 5.5, 5.5), (0, 0, -1))
OPERATOR: Operator = "head"


def volume() -> carina.Volume:
    values = np.arange(10 * 11 * 12, dtype=np.int16).reshape(10, 11, 12)
    return carina.Volume(values, np.diag([0.7, 0.8, 1.25, 1.0]))


def picture() -> Any:
    return carina.render_view(volume(), view="axial", pose=POSE, width=40, height=24)


def turn_picture() -> TurnPicture:
    return TurnPicture(None, OPERATOR, picture(), True, np.zeros((24, 40), dtype=bool))  # type: ignore[arg-type]


INSIDE = np.eye(4, dtype=np.uint8)[None]

VALUES: list[tuple[Callable[[], Any], str]] = [
    (volume, "hu_zyx"),
    (picture, "rgb"),
    (turn_picture, "rgb"),
    (lambda: Mask(INSIDE), "inside_zyx"),
    (lambda: MappedMask(INSIDE != 0, (0.0, 0.0, 0.0), 1.0), "inside_zyx"),
]


@pytest.mark.parametrize(("make", "field"), VALUES)
def test_asarray_returns_the_array_without_a_copy(make: Callable[[], Any], field: str) -> None:
    value = make()
    found = np.asarray(value)
    assert found is getattr(value, field)
    assert np.asarray(value, copy=False) is found


@pytest.mark.parametrize(("make", "field"), VALUES)
def test_asarray_follows_the_requested_type_and_copy(make: Callable[[], Any], field: str) -> None:
    value = make()
    whole = getattr(value, field)
    converted = np.asarray(value, dtype=np.float32)
    assert converted.dtype == np.float32
    np.testing.assert_array_equal(converted, whole)
    copied = np.array(value)
    assert copied.flags.writeable and not np.shares_memory(copied, whole)
    with pytest.raises(ValueError, match="copy"):
        np.asarray(value, dtype=np.float32, copy=False)


def test_numpy_functions_give_the_statistics_of_a_volume() -> None:
    assert int(np.max(volume())) == 10 * 11 * 12 - 1
    assert np.stack([volume(), volume()]).shape == (2, 10, 11, 12)
