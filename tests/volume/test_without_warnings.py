"""Tests of the suppression of warnings in one thread."""

from __future__ import annotations

import threading
import warnings

import pytest

from carina.volume.without_warnings import without_warnings

PROMPT_S = 30.0


def test_block_silences_its_own_thread_only_and_blocks_may_overlap():
    entered, leave, left = threading.Event(), threading.Event(), threading.Event()

    def other_thread():
        with without_warnings():
            warnings.warn("quiet in the other thread", stacklevel=1)
            entered.set()
            assert leave.wait(PROMPT_S)
        left.set()

    with warnings.catch_warnings(record=True) as shown:
        warnings.simplefilter("always")
        other = threading.Thread(target=other_thread)
        other.start()
        assert entered.wait(PROMPT_S)
        warnings.warn("beside a block", stacklevel=1)
        with without_warnings():
            leave.set()
            assert left.wait(PROMPT_S)
            # The other block began before this one and ended within it.
            warnings.warn("quiet", stacklevel=1)
            with without_warnings():
                warnings.warn("quiet in a nested block", stacklevel=1)
            warnings.warn("quiet after a nested block", stacklevel=1)
        warnings.warn("after the block", stacklevel=1)
        other.join()
    assert [str(one.message) for one in shown] == ["beside a block", "after the block"]


@pytest.mark.parametrize("change", [lambda: warnings.simplefilter("error"), warnings.resetwarnings])
def test_block_is_quiet_after_other_code_has_changed_the_filters(change, recwarn):
    with warnings.catch_warnings():
        for _ in range(2):
            change()
            with without_warnings():
                warnings.warn("quiet", stacklevel=1)
        num_filters = len(warnings.filters)
        with without_warnings():
            assert len(warnings.filters) == num_filters
    assert len(recwarn) == 0


def test_filter_of_another_thread_survives_a_block():
    with warnings.catch_warnings():
        with without_warnings():
            threading.Thread(target=lambda: warnings.simplefilter("error", BytesWarning)).start()
            while not any(one[2] is BytesWarning for one in warnings.filters):
                pass
        assert any(one[:1] + one[2:3] == ("error", BytesWarning) for one in warnings.filters)
