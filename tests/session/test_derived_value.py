"""Tests of derived values: computed by one background job for the newest inputs, retried only on request."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from carina.errors import CancelledError, NoResultError
from carina.session.derived.derived_value import Cached, Derived
from carina.session.jobs.background_jobs import JobEnded, JobProgress, JobRunner
from small_case import Background, Clock


class DerivedValueFixture:
    """Derived value of strings with a background that the test runs by hand, its events, and the computed inputs."""

    def __init__(self, submit=None, same=None):
        self.background = Background()
        self.clock = Clock()
        self.lock = threading.RLock()
        self.events, self.made, self.settled = [], [], []
        self.while_making = lambda inputs, attempt: None
        self.jobs = JobRunner(submit or self.background, self.events.append, self.clock)
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
        return [e.outcome for e in self.events if isinstance(e, JobEnded)]


A, B, C = "a", "b", "c"


def once(act):
    """Return a function that calls ``act`` only at its first call."""
    left = [act]
    return lambda *arguments: left.pop()(*arguments) if left else None


def test_derived_value_is_computed_once_in_the_background_and_returned_for_its_inputs_only():
    fixture = DerivedValueFixture()
    assert fixture.value.standing(A) == "unwanted"
    fixture.value.want(A)
    fixture.value.want(A)
    assert (fixture.value.standing(A), fixture.value.of(A), fixture.made) == ("making", None, [])
    fixture.background.run_all()
    fixture.value.want(A)
    assert (fixture.value.standing(A), fixture.value.of(A)) == ("had", "a after None")
    assert (fixture.value.of(B), fixture.value.of(None), fixture.value.standing(B)) == (None, None, "unwanted")
    assert (fixture.made, fixture.ends(), fixture.background.waiting) == ([A], ["done"], [])
    assert fixture.settled == ["Derived('word', had)"]


def test_derived_value_is_computed_only_for_the_newest_inputs_before_its_job_starts():
    fixture = DerivedValueFixture()
    for inputs in (A, B, C):
        fixture.value.want(inputs)
    assert len(fixture.background.waiting) == 1
    fixture.background.run_all()
    assert (fixture.made, fixture.value.of(C)) == ([C], "c after None")


def test_newer_inputs_restart_the_running_job_of_a_derived_value():
    fixture = DerivedValueFixture()
    fixture.while_making = once(lambda *_: fixture.value.want(B))
    fixture.value.want(A)
    fixture.background.run_all()
    assert (fixture.made, fixture.ends()) == ([A, B], ["done"])
    assert (fixture.value.of(A), fixture.value.of(B)) == (None, "b after None")
    assert len({e.job_id for e in fixture.events}) == 1


def test_derived_value_computed_for_stale_inputs_is_not_returned():
    fixture = DerivedValueFixture()

    def make(inputs, _attempt):
        if inputs == A:
            fixture.value.want(B)
        return inputs.upper()

    fixture.value._make = make
    fixture.value.want(A)
    fixture.background.run_all()
    assert (fixture.value.of(A), fixture.value.of(B), len(fixture.settled)) == (None, "B", 1)


def test_request_for_the_inputs_of_the_present_value_ends_the_job_and_the_value_stays():
    fixture = DerivedValueFixture()
    fixture.value.want(A)
    fixture.background.run_all()
    fixture.while_making = once(lambda *_: fixture.value.want(A))
    fixture.value.want(B)
    fixture.background.run_all()
    assert (fixture.value.of(A), fixture.value.of(B), fixture.value.standing(A)) == ("a after None", None, "had")
    assert fixture.ends() == ["done", "cancelled"]


def test_inputs_requested_again_are_computed_after_the_function_was_cancelled():
    fixture = DerivedValueFixture()

    def changed_and_restored(_inputs, attempt):
        fixture.value.want(B)
        assert attempt.cancel()
        fixture.value.want(A)
        raise CancelledError("given up when it was stale")

    fixture.while_making = once(changed_and_restored)
    fixture.value.want(A)
    fixture.background.run_all()
    assert (fixture.made, fixture.value.standing(A), fixture.ends()) == ([A, A], "had", ["done"])


def test_inputs_requested_again_before_the_function_is_cancelled_are_computed_once():
    fixture = DerivedValueFixture()

    def changed_and_restored(*_):
        fixture.value.want(B)
        fixture.value.want(A)

    fixture.while_making = changed_and_restored
    fixture.value.want(A)
    fixture.background.run_all()
    assert (fixture.made, fixture.value.standing(A), fixture.ends()) == ([A], "had", ["done"])


def test_previous_derived_value_is_passed_to_the_next_computation():
    fixture = DerivedValueFixture()
    for inputs in (A, B):
        fixture.value.want(inputs)
        fixture.background.run_all()
    assert fixture.value.of(B) == "b after a after None"


def test_request_for_none_stops_the_job_and_the_present_value_stays():
    fixture = DerivedValueFixture()
    fixture.value.want(A)
    fixture.background.run_all()
    fixture.while_making = lambda *_: fixture.value.want(None)
    fixture.value.want(B)
    fixture.background.run_all()
    assert fixture.ends() == ["done", "cancelled"]
    assert (fixture.value.of(A), fixture.value.of(B), fixture.value.standing(B)) == ("a after None", None, "unwanted")


def fail(*_):
    raise NoResultError("no such word")


def test_failed_derived_value_states_its_reason_and_is_retried_on_request_only():
    fixture = DerivedValueFixture()
    fixture.while_making = fail
    fixture.value.want(A)
    fixture.background.run_all()
    fixture.value.want(A)
    assert (fixture.value.standing(A), str(fixture.value.error)) == ("failed", "no such word")
    assert (fixture.ends(), fixture.background.waiting, fixture.settled) == (
        ["failed"],
        [],
        ["Derived('word', failed)"],
    )
    fixture.while_making = lambda *_: None
    fixture.value.again()
    assert fixture.background.waiting == [], "a new computation needs a request with inputs"
    fixture.value.want(A)
    fixture.background.run_all()
    assert (fixture.value.standing(A), fixture.value.error) == ("had", None)


def test_older_derived_value_is_available_for_its_inputs_after_a_failure():
    fixture = DerivedValueFixture()
    fixture.value.want(A)
    fixture.background.run_all()
    fixture.while_making = fail
    fixture.value.want(B)
    fixture.background.run_all()
    assert (fixture.value.of(A), fixture.value.of(B)) == ("a after None", None)


def test_different_or_repeated_inputs_are_computed_after_a_failure():
    fixture = DerivedValueFixture()
    fixture.while_making = fail
    fixture.value.want(A)
    fixture.background.run_all()
    for inputs in (B, A):
        fixture.while_making = lambda *_: None
        fixture.value.want(inputs)
        fixture.background.run_all()
        assert fixture.value.standing(inputs) == "had"


def test_failure_for_stale_inputs_is_reported_and_the_newest_inputs_get_a_new_job():
    fixture = DerivedValueFixture()

    def replaced(*_):
        fixture.value.want(B)
        fail()

    fixture.while_making = once(replaced)
    fixture.value.want(A)
    fixture.background.run_all()
    assert (fixture.ends(), fixture.value.of(B), fixture.value.error) == (["failed", "done"], "b after None", None)


def stop(fixture):
    (job,) = fixture.jobs.running
    assert fixture.jobs.cancel(job.job_id)


@pytest.mark.parametrize("begun", [False, True])
def test_derived_value_that_the_user_stopped_is_computed_again_on_request_only(begun):
    fixture = DerivedValueFixture()
    fixture.value.want(A)
    if begun:
        fixture.while_making = once(lambda *_: stop(fixture))
    else:
        stop(fixture)
    fixture.background.run_all()
    fixture.value.want(A)
    assert (fixture.value.standing(A), fixture.value.error, fixture.background.waiting) == ("stopped", None, [])
    assert (fixture.ends(), fixture.settled) == (["cancelled"], ["Derived('word', stopped)"])
    fixture.value.again()
    fixture.value.want(A)
    fixture.background.run_all()
    assert fixture.value.standing(A) == "had"


def test_stop_by_the_user_applies_to_the_newest_inputs_also_while_older_ones_are_computed():
    fixture = DerivedValueFixture()

    def replace_and_stop(*_):
        fixture.value.want(B)
        stop(fixture)

    fixture.while_making = once(replace_and_stop)
    fixture.value.want(A)
    fixture.background.run_all()
    assert (fixture.made, fixture.value.standing(B), fixture.ends()) == ([A], "stopped", ["cancelled"])


def test_derived_value_stopped_after_its_computation_finished_is_not_used():
    fixture = DerivedValueFixture()

    def make(inputs, _attempt):
        stop(fixture)
        return inputs

    fixture.value._make = make
    fixture.value.want(A)
    fixture.background.run_all()
    assert (fixture.value.of(A), fixture.value.standing(A)) == (None, "stopped")


@pytest.mark.parametrize("repeat", ["other inputs", "again"])
@pytest.mark.parametrize("begun", [False, True])
def test_inputs_requested_between_stop_and_end_of_the_job_are_computed(repeat, begun):
    fixture = DerivedValueFixture()
    wanted = B if repeat == "other inputs" else A

    def stop_and_want(*_):
        stop(fixture)
        if repeat == "again":
            fixture.value.again()
        fixture.value.want(wanted)

    fixture.value.want(A)
    if begun:
        fixture.while_making = once(stop_and_want)
    else:
        stop_and_want()
    fixture.background.run_all()
    assert (fixture.value.standing(wanted), fixture.ends()) == ("had", ["cancelled", "done"])


def test_job_that_follows_a_stopped_job_can_be_stopped():
    fixture = DerivedValueFixture()
    fixture.value.want(A)
    stop(fixture)
    fixture.value.want(B)
    fixture.background.run_next()
    stop(fixture)
    fixture.background.run_all()
    assert (fixture.made, fixture.value.standing(B), fixture.ends()) == ([], "stopped", ["cancelled", "cancelled"])


def test_computation_that_checks_for_cancellation_is_cancelled_by_a_stop():
    fixture = DerivedValueFixture()
    heard = []

    def stop_and_ask(_inputs, attempt):
        heard.append(attempt.cancel())
        stop(fixture)
        heard.append(attempt.cancel())
        with pytest.raises(CancelledError):
            attempt.check()

    fixture.while_making = stop_and_ask
    fixture.value.want(A)
    fixture.background.run_all()
    assert heard == [False, True]


def test_computation_that_raises_cancelled_error_counts_as_stopped():
    fixture = DerivedValueFixture()

    def give_up(*_):
        raise CancelledError("given up")

    fixture.while_making = give_up
    fixture.value.want(A)
    fixture.background.run_all()
    assert (fixture.value.standing(A), fixture.ends()) == ("stopped", ["cancelled"])


def test_discarding_a_derived_value_ends_its_job_and_removes_value_and_request():
    fixture = DerivedValueFixture()
    fixture.value.want(A)
    fixture.background.run_all()
    fixture.while_making = once(lambda *_: fixture.value.discard())
    fixture.value.want(B, then=fixture.settled.append)
    fixture.background.run_all()
    fixture.value.want(C)
    fixture.background.run_all()
    assert (fixture.made, fixture.ends(), fixture.settled) == ([A, B], ["done", "cancelled"], ["Derived('word', had)"])
    assert [fixture.value.of(inputs) for inputs in (A, B, C)] == [None, None, None]
    assert fixture.value._had is None, "the object does not prevent the release of the volume"


def test_derived_value_discarded_before_its_job_begins_is_not_computed():
    fixture = DerivedValueFixture()
    fixture.value.want(A)
    fixture.value.discard()
    fixture.background.run_all()
    assert (fixture.made, fixture.ends(), fixture.settled) == ([], ["cancelled"], [])


def test_callback_of_a_request_runs_once_when_the_derived_value_is_available():
    fixture = DerivedValueFixture()
    done = []
    fixture.value.want(A, then=done.append)
    fixture.value.want(A, then=done.append)
    fixture.value.want(A)
    assert done == []
    fixture.background.run_all()
    assert done == ["a after None"]
    fixture.value.want(A, then=done.append)
    assert len(done) == 2, "at once if it is available"


def test_callback_is_dropped_if_the_computation_fails_or_other_inputs_are_requested():
    fixture = DerivedValueFixture()
    done = []
    fixture.while_making = once(fail)
    fixture.value.want(A, then=done.append)
    fixture.background.run_all()
    fixture.value.want(A, then=done.append)
    fixture.value.again()
    fixture.value.want(A)
    fixture.background.run_all()
    fixture.value.want(B, then=done.append)
    fixture.value.want(C)
    fixture.background.run_all()
    assert (fixture.made, done) == ([A, A, C], [])


def test_error_in_a_callback_is_reported_without_losing_the_derived_value():
    fixture = DerivedValueFixture()
    fixture.value.want(A, then=fail)
    fixture.background.run_all()
    assert (fixture.value.standing(A), fixture.ends()) == ("had", ["failed"])
    fixture.value.want(B)
    fixture.background.run_all()
    assert fixture.value.standing(B) == "had"


def test_error_in_a_callback_does_not_cancel_the_value_that_the_callback_requested():
    fixture = DerivedValueFixture()

    def want_next_and_fail(_value):
        fixture.value.want(B)
        fail()

    fixture.value.want(A, then=want_next_and_fail)
    fixture.background.run_all()
    assert (fixture.made, fixture.value.standing(B), fixture.ends()) == ([A, B], "had", ["failed", "done"])


def test_callback_of_a_derived_value_may_request_the_next_value():
    fixture = DerivedValueFixture()
    fixture.value.want(A, then=lambda _: fixture.value.want(B))
    fixture.background.run_all()
    assert (fixture.made, fixture.value.of(B), fixture.ends()) == ([A, B], "b after a after None", ["done", "done"])


def test_derived_value_is_available_at_once_if_jobs_run_synchronously():
    fixture = DerivedValueFixture(submit=lambda work: work())
    fixture.value.want(A)
    assert fixture.value.of(A) == "a after None"
    fixture.value.want(B, then=lambda _: fixture.value.want(C))
    assert (fixture.value.of(C), fixture.made) == ("c after b after a after None", [A, B, C])


def test_given_equality_function_decides_whether_inputs_are_equal():
    fixture = DerivedValueFixture(same=lambda a, b: a[0] == b[0])
    fixture.value.want("one")
    fixture.background.run_all()
    fixture.value.want("others")
    assert (fixture.value.of("o"), fixture.background.waiting) == ("one after None", [])


def test_request_for_a_derived_value_while_carina_closes_is_refused():
    fixture = DerivedValueFixture()
    fixture.jobs.close()
    with pytest.raises(CancelledError, match="closing"):
        fixture.value.want(A)
    with pytest.raises(CancelledError, match="closing"):
        fixture.value.want(B)


def test_estimated_time_left_ignores_computations_for_stale_inputs():
    fixture = DerivedValueFixture()

    def long_and_stale(_inputs, attempt):
        attempt.progress("making", 0.2)
        fixture.clock.advance(100.0)
        fixture.value.want(B)

    fixture.while_making = once(long_and_stale)
    fixture.value.want(A)
    fixture.background.run_all()
    assert [e.seconds_left for e in fixture.events if isinstance(e, JobProgress)] == [None, None]


def test_session_lock_is_free_while_a_derived_value_is_computed():
    """Use real threads: the session requests newer inputs while a computation runs and reports its progress."""
    with ThreadPoolExecutor(2) as pool:
        fixture = DerivedValueFixture(submit=pool.submit)
        begun, changed = threading.Event(), threading.Event()

        def make(inputs, attempt):
            begun.set()
            assert changed.wait(60)
            with fixture.lock:
                attempt.progress("making", 0.5)
            return inputs

        fixture.value._make = make
        fixture.value.want(A)
        assert begun.wait(60)
        assert fixture.lock.acquire(timeout=60)
        fixture.value.want(B)
        changed.set()
        fixture.lock.release()
        assert fixture.jobs.wait_idle(60)
    assert (fixture.value.of(B), fixture.ends()) == (B, ["done"])


def test_cached_value_is_computed_again_only_for_other_input_objects():
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
