"""Tests of derived values: computed by one background job for the newest inputs, retried only on request."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from carina.errors import CancelledError, NoResultError
from carina.session.derived.derived_value import Cached, Derived
from carina.session.jobs.background_jobs import JobEnded, JobProgress, JobRunner
from small_case import Background, Clock


class Workshop:
    """Derived value of strings with a background that the test runs by hand, its events, and the computed inputs."""

    def __init__(self, submit=None, same=None):
        self.background = Background()
        self.clock = Clock()
        self.lock = threading.RLock()
        self.told, self.made, self.settled = [], [], []
        self.while_making = lambda inputs, attempt: None
        self.jobs = JobRunner(submit or self.background, self.told.append, self.clock)
        options = {} if same is None else {"same": same}
        self.value = Derived(
            self.jobs, self.lock, kind="word", title="making a word", make=self.make, settled=self.settle, **options
        )

    def make(self, inputs, attempt):
        self.made.append(inputs)
        self.while_making(inputs, attempt)
        attempt.progress("making", 0.5)
        return f"{inputs} after {attempt.before}"

    def settle(self):
        self.settled.append(repr(self.value))

    def ends(self):
        return [e.outcome for e in self.told if isinstance(e, JobEnded)]


A, B, C = "a", "b", "c"


def once(act):
    """Return a function that calls ``act`` only at its first call."""
    left = [act]
    return lambda *arguments: left.pop()(*arguments) if left else None


def test_value_is_computed_once_in_the_background_and_returned_for_its_inputs_only():
    shop = Workshop()
    assert shop.value.standing(A) == "unwanted"
    shop.value.want(A)
    shop.value.want(A)
    assert (shop.value.standing(A), shop.value.of(A), shop.made) == ("making", None, [])
    shop.background.run_all()
    shop.value.want(A)
    assert (shop.value.standing(A), shop.value.of(A)) == ("had", "a after None")
    assert (shop.value.of(B), shop.value.of(None), shop.value.standing(B)) == (None, None, "unwanted")
    assert (shop.made, shop.ends(), shop.background.waiting) == ([A], ["done"], [])
    assert shop.settled == ["Derived('word', had)"]


def test_only_the_newest_inputs_before_the_start_of_the_job_are_computed():
    shop = Workshop()
    for inputs in (A, B, C):
        shop.value.want(inputs)
    assert len(shop.background.waiting) == 1
    shop.background.run_all()
    assert (shop.made, shop.value.of(C)) == ([C], "c after None")


def test_newer_inputs_restart_the_running_job():
    shop = Workshop()
    shop.while_making = once(lambda *_: shop.value.want(B))
    shop.value.want(A)
    shop.background.run_all()
    assert (shop.made, shop.ends()) == ([A, B], ["done"])
    assert (shop.value.of(A), shop.value.of(B)) == (None, "b after None")
    assert len({e.job_id for e in shop.told}) == 1


def test_result_for_stale_inputs_is_not_returned():
    shop = Workshop()

    def make(inputs, _attempt):
        if inputs == A:
            shop.value.want(B)
        return inputs.upper()

    shop.value._make = make
    shop.value.want(A)
    shop.background.run_all()
    assert (shop.value.of(A), shop.value.of(B), len(shop.settled)) == (None, "B", 1)


def test_request_of_the_present_inputs_ends_the_job_and_keeps_the_value():
    shop = Workshop()
    shop.value.want(A)
    shop.background.run_all()
    shop.while_making = once(lambda *_: shop.value.want(A))
    shop.value.want(B)
    shop.background.run_all()
    assert (shop.value.of(A), shop.value.of(B), shop.value.standing(A)) == ("a after None", None, "had")
    assert shop.ends() == ["done", "cancelled"]


def test_inputs_requested_again_are_computed_after_the_function_was_cancelled():
    shop = Workshop()

    def gone_and_back(_inputs, attempt):
        shop.value.want(B)
        assert attempt.cancel()
        shop.value.want(A)
        raise CancelledError("given up when it was stale")

    shop.while_making = once(gone_and_back)
    shop.value.want(A)
    shop.background.run_all()
    assert (shop.made, shop.value.standing(A), shop.ends()) == ([A, A], "had", ["done"])


def test_inputs_requested_again_before_the_cancellation_are_computed_once():
    shop = Workshop()

    def gone_and_back(*_):
        shop.value.want(B)
        shop.value.want(A)

    shop.while_making = gone_and_back
    shop.value.want(A)
    shop.background.run_all()
    assert (shop.made, shop.value.standing(A), shop.ends()) == ([A], "had", ["done"])


def test_previous_value_is_passed_to_the_next_computation():
    shop = Workshop()
    for inputs in (A, B):
        shop.value.want(inputs)
        shop.background.run_all()
    assert shop.value.of(B) == "b after a after None"


def test_request_of_none_stops_the_job_and_keeps_the_present_value():
    shop = Workshop()
    shop.value.want(A)
    shop.background.run_all()
    shop.while_making = lambda *_: shop.value.want(None)
    shop.value.want(B)
    shop.background.run_all()
    assert shop.ends() == ["done", "cancelled"]
    assert (shop.value.of(A), shop.value.of(B), shop.value.standing(B)) == ("a after None", None, "unwanted")


def fail(*_):
    raise NoResultError("no such word")


def test_failure_states_its_reason_and_is_retried_on_request_only():
    shop = Workshop()
    shop.while_making = fail
    shop.value.want(A)
    shop.background.run_all()
    shop.value.want(A)
    assert (shop.value.standing(A), str(shop.value.error)) == ("failed", "no such word")
    assert (shop.ends(), shop.background.waiting, shop.settled) == (["failed"], [], ["Derived('word', failed)"])
    shop.while_making = lambda *_: None
    shop.value.again()
    assert shop.background.waiting == [], "whoever wants it says of what"
    shop.value.want(A)
    shop.background.run_all()
    assert (shop.value.standing(A), shop.value.error) == ("had", None)


def test_older_value_is_available_for_its_inputs_after_a_failure():
    shop = Workshop()
    shop.value.want(A)
    shop.background.run_all()
    shop.while_making = fail
    shop.value.want(B)
    shop.background.run_all()
    assert (shop.value.of(A), shop.value.of(B)) == ("a after None", None)


def test_different_inputs_and_repeated_inputs_are_computed_after_a_failure():
    shop = Workshop()
    shop.while_making = fail
    shop.value.want(A)
    shop.background.run_all()
    for inputs in (B, A):
        shop.while_making = lambda *_: None
        shop.value.want(inputs)
        shop.background.run_all()
        assert shop.value.standing(inputs) == "had"


def test_failure_of_stale_inputs_is_reported_and_the_newest_get_their_own_job():
    shop = Workshop()

    def replaced(*_):
        shop.value.want(B)
        fail()

    shop.while_making = once(replaced)
    shop.value.want(A)
    shop.background.run_all()
    assert (shop.ends(), shop.value.of(B), shop.value.error) == (["failed", "done"], "b after None", None)


def stop(shop):
    (job,) = shop.jobs.running
    assert shop.jobs.cancel(job.job_id)


@pytest.mark.parametrize("begun", [False, True])
def test_value_that_the_user_stopped_is_retried_on_request_only(begun):
    shop = Workshop()
    shop.value.want(A)
    if begun:
        shop.while_making = once(lambda *_: stop(shop))
    else:
        stop(shop)
    shop.background.run_all()
    shop.value.want(A)
    assert (shop.value.standing(A), shop.value.error, shop.background.waiting) == ("stopped", None, [])
    assert (shop.ends(), shop.settled) == (["cancelled"], ["Derived('word', stopped)"])
    shop.value.again()
    shop.value.want(A)
    shop.background.run_all()
    assert shop.value.standing(A) == "had"


def test_stop_applies_to_the_newest_inputs_also_while_older_ones_are_computed():
    shop = Workshop()

    def replace_and_stop(*_):
        shop.value.want(B)
        stop(shop)

    shop.while_making = once(replace_and_stop)
    shop.value.want(A)
    shop.background.run_all()
    assert (shop.made, shop.value.standing(B), shop.ends()) == ([A], "stopped", ["cancelled"])


def test_value_stopped_after_its_computation_finished_is_not_used():
    shop = Workshop()

    def make(inputs, _attempt):
        stop(shop)
        return inputs

    shop.value._make = make
    shop.value.want(A)
    shop.background.run_all()
    assert (shop.value.of(A), shop.value.standing(A)) == (None, "stopped")


@pytest.mark.parametrize("repeat", ["other inputs", "again"])
@pytest.mark.parametrize("begun", [False, True])
def test_inputs_requested_between_stop_and_end_of_the_job_are_computed(repeat, begun):
    shop = Workshop()
    wanted = B if repeat == "other inputs" else A

    def stop_and_want(*_):
        stop(shop)
        if repeat == "again":
            shop.value.again()
        shop.value.want(wanted)

    shop.value.want(A)
    if begun:
        shop.while_making = once(stop_and_want)
    else:
        stop_and_want()
    shop.background.run_all()
    assert (shop.value.standing(wanted), shop.ends()) == ("had", ["cancelled", "done"])


def test_job_that_follows_a_stopped_job_can_be_stopped():
    shop = Workshop()
    shop.value.want(A)
    stop(shop)
    shop.value.want(B)
    shop.background.run_next()
    stop(shop)
    shop.background.run_all()
    assert (shop.made, shop.value.standing(B), shop.ends()) == ([], "stopped", ["cancelled", "cancelled"])


def test_function_that_checks_for_cancellation_is_cancelled():
    shop = Workshop()
    heard = []

    def stop_and_ask(_inputs, attempt):
        heard.append(attempt.cancel())
        stop(shop)
        heard.append(attempt.cancel())
        with pytest.raises(CancelledError):
            attempt.check()

    shop.while_making = stop_and_ask
    shop.value.want(A)
    shop.background.run_all()
    assert heard == [False, True]


def test_function_that_raises_cancelled_counts_as_stopped():
    shop = Workshop()

    def give_up(*_):
        raise CancelledError("given up")

    shop.while_making = give_up
    shop.value.want(A)
    shop.background.run_all()
    assert (shop.value.standing(A), shop.ends()) == ("stopped", ["cancelled"])


def test_opening_another_case_discards_value_job_and_request():
    shop = Workshop()
    shop.value.want(A)
    shop.background.run_all()
    shop.while_making = once(lambda *_: shop.value.discard())
    shop.value.want(B, then=shop.settled.append)
    shop.background.run_all()
    shop.value.want(C)
    shop.background.run_all()
    assert (shop.made, shop.ends(), shop.settled) == ([A, B], ["done", "cancelled"], ["Derived('word', had)"])
    assert [shop.value.of(inputs) for inputs in (A, B, C)] == [None, None, None]
    assert shop.value._had is None, "it keeps no volume alive"


def test_value_discarded_before_its_job_begins_is_not_computed():
    shop = Workshop()
    shop.value.want(A)
    shop.value.discard()
    shop.background.run_all()
    assert (shop.made, shop.ends(), shop.settled) == ([], ["cancelled"], [])


def test_callback_runs_once_when_the_value_is_available():
    shop = Workshop()
    done = []
    shop.value.want(A, then=done.append)
    shop.value.want(A, then=done.append)
    shop.value.want(A)
    assert done == []
    shop.background.run_all()
    assert done == ["a after None"]
    shop.value.want(A, then=done.append)
    assert len(done) == 2, "at once where it is had"


def test_callback_is_dropped_if_the_value_fails_or_other_inputs_are_requested():
    shop = Workshop()
    done = []
    shop.while_making = once(fail)
    shop.value.want(A, then=done.append)
    shop.background.run_all()
    shop.value.want(A, then=done.append)
    shop.value.again()
    shop.value.want(A)
    shop.background.run_all()
    shop.value.want(B, then=done.append)
    shop.value.want(C)
    shop.background.run_all()
    assert (shop.made, done) == ([A, A, C], [])


def test_error_in_a_callback_is_reported_without_losing_the_value():
    shop = Workshop()
    shop.value.want(A, then=fail)
    shop.background.run_all()
    assert (shop.value.standing(A), shop.ends()) == ("had", ["failed"])
    shop.value.want(B)
    shop.background.run_all()
    assert shop.value.standing(B) == "had"


def test_error_in_a_callback_does_not_cancel_the_value_that_it_requested():
    shop = Workshop()

    def want_next_and_fail(_value):
        shop.value.want(B)
        fail()

    shop.value.want(A, then=want_next_and_fail)
    shop.background.run_all()
    assert (shop.made, shop.value.standing(B), shop.ends()) == ([A, B], "had", ["failed", "done"])


def test_callback_may_request_the_next_value():
    shop = Workshop()
    shop.value.want(A, then=lambda _: shop.value.want(B))
    shop.background.run_all()
    assert (shop.made, shop.value.of(B), shop.ends()) == ([A, B], "b after a after None", ["done", "done"])


def test_synchronous_background_computes_the_value_at_the_request():
    shop = Workshop(submit=lambda work: work())
    shop.value.want(A)
    assert shop.value.of(A) == "a after None"
    shop.value.want(B, then=lambda _: shop.value.want(C))
    assert (shop.value.of(C), shop.made) == ("c after b after a after None", [A, B, C])


def test_custom_equality_decides_whether_inputs_are_equal():
    shop = Workshop(same=lambda a, b: a[0] == b[0])
    shop.value.want("one")
    shop.background.run_all()
    shop.value.want("others")
    assert (shop.value.of("o"), shop.background.waiting) == ("one after None", [])


def test_request_while_carina_closes_is_refused():
    shop = Workshop()
    shop.jobs.close()
    with pytest.raises(CancelledError, match="closing"):
        shop.value.want(A)
    with pytest.raises(CancelledError, match="closing"):
        shop.value.want(B)


def test_time_left_ignores_attempts_for_stale_inputs():
    shop = Workshop()

    def long_and_stale(_inputs, attempt):
        attempt.progress("making", 0.2)
        shop.clock.advance(100.0)
        shop.value.want(B)

    shop.while_making = once(long_and_stale)
    shop.value.want(A)
    shop.background.run_all()
    assert [e.seconds_left for e in shop.told if isinstance(e, JobProgress)] == [None, None]


def test_lock_is_not_held_while_a_value_is_computed():
    """Use real threads: the session requests newer inputs while a computation runs and reports its progress."""
    with ThreadPoolExecutor(2) as pool:
        shop = Workshop(submit=pool.submit)
        begun, changed = threading.Event(), threading.Event()

        def make(inputs, attempt):
            begun.set()
            assert changed.wait(60)
            with shop.lock:
                attempt.progress("making", 0.5)
            return inputs

        shop.value._make = make
        shop.value.want(A)
        assert begun.wait(60)
        assert shop.lock.acquire(timeout=60)
        shop.value.want(B)
        changed.set()
        shop.lock.release()
        assert shop.jobs.wait_idle(60)
    assert (shop.value.of(B), shop.ends()) == (B, ["done"])


def test_cached_value_is_computed_again_only_for_other_objects():
    made = []

    def make(inputs):
        made.append(inputs)
        return len(made)

    cached = Cached(make)
    first, second = ([1], None), ([1], None)
    assert not cached.has_other_inputs(first)
    assert [cached.of(first), cached.of((first[0], None)), cached.of(second), cached.of(first)] == [1, 1, 2, 3]
    assert (cached.has_other_inputs(first), cached.has_other_inputs(second)) == (False, True)
    cached.forget()
    assert (cached.has_other_inputs(second), repr(cached)) == (False, "Cached(nothing)")
