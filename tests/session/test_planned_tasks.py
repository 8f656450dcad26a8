"""Tests of tasks that take place, aim and instrument from the chosen route of a plan."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from carina.errors import NoResultError
from carina.session.training.planned_tasks import planned_task
from carina.training import find_task

REACH = find_task("reach-target")
PLACE, AIM = (1.0, 2.0, 3.0), (4.0, 5.0, 6.0)


def document(*, needle=True, scope="ultrathin"):
    route = SimpleNamespace(needle=SimpleNamespace(ends_lps=(PLACE, AIM)) if needle else None, target_id="target-1")
    lesion = SimpleNamespace(options=SimpleNamespace(scope=scope))
    targets = (SimpleNamespace(target_id="target-1", lesion=lesion), SimpleNamespace(target_id="other", lesion=None))
    return SimpleNamespace(route=route, targets=targets)


def test_task_takes_place_aim_and_instrument_of_the_planned_route():
    task = planned_task(REACH, document())
    assert (task.place_lps, task.aim_lps, task.scope) == (PLACE, AIM, "ultrathin")
    assert planned_task(task, document(scope="generic")) is task, "a stored task is not changed by another plan"


@pytest.mark.parametrize("shown", [document(needle=False), SimpleNamespace(route=None, targets=())])
def test_task_without_a_planned_route_is_unchanged_and_refused(shown):
    task = planned_task(REACH, shown)
    assert task is REACH
    with pytest.raises(NoResultError, match="expected a chosen route to a planned target"):
        task.check_case(None)


def test_other_tasks_are_unchanged():
    task = find_task("find-rb6")
    assert planned_task(task, document()) is task
