"""Tests of wrong values for every public function, constructor and method: each is refused with a Carina error."""

from __future__ import annotations

import inspect
from collections.abc import Iterator

import pytest
from public_arguments import GOOD, Things, called, public_calls
from wrong_values import NEVER_VALID, SELDOM_VALID, call_problem, must_be_refused, not_finite

import fake_anywidget

# The plan that plan_route returns is an argument of later calls, so plan_route is called first, and only once.
CALLS = sorted(dict.fromkeys(public_calls()), key=lambda name: name != "plan_route")
SLOW = {"find_airways", "plan_route", "edit_airways", "wall_field", "Case.open", "track_paths"}
"""Functions whose successful calls take about a second.

Without the soak mark only values that are refused are tested.
"""
VALID: dict[tuple[str, str], set[str]] = {
    # A lumen that was read from a file has no threshold, so NaN is valid.
    ("Airways", "threshold"): {"nan"},
}
"""Values that one argument accepts though its type or :data:`NEVER_VALID` excludes them, each with its reason."""


@pytest.fixture(scope="module")
def things(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Things]:
    made = Things(tmp_path_factory.mktemp("things"))
    yield made
    made.close()


@pytest.fixture(autouse=True)
def anywidget(monkeypatch: pytest.MonkeyPatch) -> None:
    fake_anywidget.install(monkeypatch)


def test_table_of_valid_arguments_contains_every_public_function() -> None:
    missing = sorted(set(CALLS) - GOOD.keys())
    assert not missing, f"add arguments with which the call succeeds to tests/contract/public_arguments.py: {missing}"
    assert not sorted(GOOD.keys() - set(CALLS)), "functions in GOOD that are not public"


@pytest.mark.parametrize("name", CALLS)
def test_public_function_called_with_its_valid_arguments_succeeds(name: str, things: Things) -> None:
    call, arguments, state = called(name, things)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(things.folder)
        result = call(**arguments)
    if name == "Case.open":
        result.close()
    if name == "plan_route":
        things.plan = result
    assert not_finite(result if (name, "threshold") not in VALID else None) is None
    assert state is None or not_finite(state()) is None


def problems(name: str, things: Things, *, accepted: bool) -> Iterator[str]:
    """Yield a description for each wrong value of one function whose outcome is wrong."""
    call, _, _ = called(name, things)
    for parameter in inspect.signature(call).parameters.values():
        if parameter.name.startswith("_"):
            continue
        for value_name, value in {**NEVER_VALID, **SELDOM_VALID}.items():
            refuse = must_be_refused(parameter, value_name)
            if value_name in VALID.get((name, parameter.name), ()) or (not refuse and not accepted):
                continue
            call, arguments, state = called(name, things)
            wrong = {**arguments, parameter.name: value}
            found = call_problem(lambda call=call, wrong=wrong: call(**wrong), refuse=refuse, after=state)
            if found is not None:
                yield f"{name}({parameter.name}={value_name}): {found}"


@pytest.mark.parametrize("name", CALLS)
def test_public_function_refuses_wrong_argument_values(
    name: str, things: Things, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path_factory.mktemp("work"))
    found = list(problems(name, things, accepted=name not in SLOW))
    assert not found, "\n".join(found)


@pytest.mark.soak
@pytest.mark.parametrize("name", sorted(SLOW))
def test_slow_public_function_refuses_wrong_argument_values(
    name: str, things: Things, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path_factory.mktemp("work"))
    found = list(problems(name, things, accepted=True))
    assert not found, "\n".join(found)
