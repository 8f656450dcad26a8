"""Tests of the argument ``progress`` of public functions, which accepts False, True or ``f(what, fraction)``."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import carina
from cached_test_data import cached_airways, cached_phantom
from carina.display import progress as bars
from carina.display.progress import shows_progress, without_bars
from carina.errors import UsageError

PARTS = ("volume", "scopes", "render", "track", "navigate", "phantom", "plan", "export", "session", "cluster")
SMALL = {"spacing_mm": 3.0, "generations": 3}


def functions_with_progress() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Yield every public function and method with an argument ``progress``, with its name."""
    for part in PARTS:
        module = importlib.import_module(f"carina.{part}")
        for name in module.__all__:
            found = getattr(module, name)
            if getattr(found, "_is_protocol", False):
                continue
            inner = [(f"{name}.{one}", getattr(found, one)) for one in vars(found)] if inspect.isclass(found) else []
            for title, one in [(name, found), *inner]:
                is_public = not title.rpartition(".")[2].startswith("_")
                if is_public and inspect.isroutine(one) and "progress" in inspect.signature(one).parameters:
                    yield f"{part}.{title}", one


FUNCTIONS = dict(functions_with_progress())


def test_every_package_with_slow_functions_has_functions_with_a_progress_argument() -> None:
    assert {name.partition(".")[0] for name in FUNCTIONS} >= {"volume", "render", "track", "plan", "export", "phantom"}
    assert {"track.measure_tree", "track.wall_field", "phantom.generate_phantom", "plan.plan_route"} <= set(FUNCTIONS)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_progress_argument_has_the_same_type_and_error_message_in_every_public_function(name: str) -> None:
    called = FUNCTIONS[name]
    parameter = inspect.signature(called).parameters["progress"]
    assert (parameter.annotation, parameter.default) == ("ProgressChoice", None)
    # The argument is checked before all others, so the other arguments need not be valid.
    with pytest.raises(UsageError, match="progress: expected True, False, None or a function that takes a string and"):
        called(*([None] if "self" in inspect.signature(called).parameters else []), progress=3)


@pytest.mark.parametrize("choice", [False, True, None, "function"])
def test_slow_functions_accept_every_value_of_the_progress_argument(choice: object) -> None:
    seen: list[tuple[str, float | None]] = []
    progress: Any = (lambda what, fraction: seen.append((what, fraction))) if choice == "function" else choice
    volume, airways = cached_phantom(**SMALL).volume, cached_airways(**SMALL)
    calls: list[Callable[[], object]] = [
        lambda: carina.generate_phantom(spacing_mm=6.0, generations=3, progress=progress),
        lambda: carina.track.measure_tree(volume, airways, progress=progress),
        lambda: carina.wall_field(volume, airways, progress=progress),
        lambda: carina.track.lumen_mesh(volume, airways, progress=progress),
        lambda: carina.Renderer(volume).prepare(progress=progress),
    ]
    for call in calls:
        call()
    # A step of a few milliseconds reports no fraction.
    assert ({"generating the phantom", "measuring the airways"} <= {what for what, _ in seen}) == (choice == "function")
    assert all(isinstance(what, str) and (share is None or 0.0 <= share <= 1.0) for what, share in seen)


@pytest.mark.parametrize("choice", [False, True, None, "function"])
def test_plan_route_accepts_every_value_of_the_progress_argument(choice: object) -> None:
    chest = {"seed": 4, "spacing_mm": 1.2, "generations": 5, "nodule": True}
    made = cached_phantom(**chest)
    seen: list[tuple[str, float | None]] = []
    progress: Any = (lambda what, fraction: seen.append((what, fraction))) if choice == "function" else choice
    target = made.truth["nodule"]["centre_lps"]
    drives = 1 if choice == "function" else 0
    assert carina.plan_route(made.volume, cached_airways(**chest), target, drives=drives, progress=progress).routes
    assert {what for what, _ in seen} == ({"planning the routes"} if choice == "function" else set())


class CountedBar:
    made = 0

    def __init__(self) -> None:
        type(self).made += 1

    def draw(self, text: str, fraction: float | None) -> None:
        pass

    def close(self) -> None:
        pass


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> type[CountedBar]:
    monkeypatch.setattr(bars, "create_progress_bar", lambda: CountedBar)
    monkeypatch.setattr(bars, "BEGIN_S", 0.0)
    monkeypatch.setattr(bars, "EVERY_S", 0.0)
    monkeypatch.setattr(CountedBar, "made", 0)
    return CountedBar


@shows_progress
def inner(*, progress: Any = None) -> None:
    if progress is not None:
        progress("inner", 0.5)


@shows_progress
def outer(progress: Any = None) -> None:
    inner()
    if progress is not None:
        progress("outer", 0.5)


@pytest.mark.parametrize(("choice", "num"), [(None, 1), (True, 1), (False, 0), (lambda _what, _share: None, 0)])
def test_public_function_called_by_another_shows_no_second_progress_bar(
    choice: Any, num: int, counted: type[CountedBar]
) -> None:
    outer(progress=choice)
    assert counted.made == num
    counted.made = 0
    outer(choice)
    assert counted.made == num


def test_progress_bar_is_hidden_inside_without_bars_unless_the_call_requests_it(counted: type[CountedBar]) -> None:
    with without_bars():
        inner()
        assert counted.made == 0
        inner(progress=True)
        assert counted.made == 1
    inner()
    assert counted.made == 2
