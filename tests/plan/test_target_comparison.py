"""Tests of the comparison of several targets."""

from __future__ import annotations

import dataclasses

import pytest
from phantom_plan import plan

from carina.errors import UsageError
from carina.plan import ORDER_RULE, Plan, TargetDoubt, compare_targets
from carina.plan.target_comparison import comparison_lines
from carina.scopes import ScopeHold


def changed(**values: object) -> Plan:
    """Return the plan with a changed first route only."""
    return dataclasses.replace(plan(), routes=(dataclasses.replace(plan().routes[0], **values),))


def test_compared_targets_are_ordered_by_outlook_then_doubts_then_hit_share() -> None:
    leg = plan().routes[0].leg
    doubt, hold = TargetDoubt("target.tube", "it continues as a tube"), ScopeHold(300.0, 0.0, 0.5)
    plans = {
        "none": dataclasses.replace(plan(), routes=(), why="no airway is near"),
        "no": changed(outlook="does not reach"),
        "maybe": changed(outlook="may reach"),
        "doubtful": dataclasses.replace(changed(outlook="reaches", doubts=()), doubts=(doubt,)),
        "low": changed(outlook="reaches", doubts=(), hold=hold, leg=dataclasses.replace(leg, hit_share=0.2)),
        "high": changed(outlook="reaches", doubts=(), hold=hold, leg=dataclasses.replace(leg, hit_share=0.9)),
    }
    found = compare_targets(list(plans.values()), list(plans))
    assert [one.title for one in found] == ["high", "low", "doubtful", "maybe", "no", "none"]
    text = "\n".join(comparison_lines(found))
    assert text.startswith(ORDER_RULE)
    assert "it continues as a tube" in text
    assert "no airway is near" in text


def test_figures_in_the_target_comparison_are_those_of_each_plan() -> None:
    (row,) = compare_targets([plan()], ["one"])
    stored = plan().to_json()["routes"][0]
    value = row.to_json()
    for name in ("outlook", "narrowest_mm", "narrowest_error_mm", "from_carina_mm"):
        assert value[name] == stored[name]
    for name in ("hit_share", "to_target_mm", "vessel_mm"):
        assert value[name] == stored["leg"][name]


def test_target_comparison_with_a_missing_name_is_refused() -> None:
    with pytest.raises(UsageError, match="one for each plan"):
        compare_targets([plan(), plan()], ["one"])


def test_column_of_doubts_states_what_it_is_about_because_vessel_and_outlook_have_their_own() -> None:
    leg = dataclasses.replace(plan().routes[0].leg, vessel_mm=1.2)
    poor = dataclasses.replace(changed(outlook="does not reach", doubts=(), leg=leg), doubts=())
    (_, line) = comparison_lines(compare_targets([poor], ["one"]))
    assert "outlook does not reach" in line
    assert "vessel 1.2 mm" in line
    assert line.endswith("doubts about target and airways none")
