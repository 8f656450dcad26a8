"""Tests of the reservation of one rendering thread for other work."""

from __future__ import annotations

import pytest

from carina import _core
from carina.render import picture_threads, reserved_thread


def test_thread_reservation_takes_one_rendering_thread_and_releases_it_after_an_error() -> None:
    before = picture_threads()
    counted = []

    def fail() -> None:
        with reserved_thread():
            counted.append(picture_threads())
            raise ValueError("stop")

    with pytest.raises(ValueError, match="stop"):
        fail()
    assert counted == [max(1, before - 1)]
    assert picture_threads() == before


def test_nested_thread_reservations_take_one_thread_together() -> None:
    before = picture_threads()
    with reserved_thread():
        with reserved_thread():
            assert picture_threads() == max(1, before - 1)
        assert picture_threads() == max(1, before - 1)
    assert picture_threads() == before


def test_thread_reservation_ends_when_its_object_is_deleted_and_a_second_release_has_no_effect() -> None:
    before = picture_threads()
    first, second = _core.ReservedThread(), _core.ReservedThread()
    first.release()
    first.release()
    assert picture_threads() == max(1, before - 1)
    del second
    assert picture_threads() == before
