"""Tests of the argument ``progress`` of public functions, which accepts False, True or ``f(what, fraction)``."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import carina
from carina.display import progress as bars
from carina.display.progress import shows_progress, without_bars
from carina.errors import UsageError
from made import made_airways, made_phantom

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


def test_every_part_with_long_work_has_functions_with_progress() -> None:
    assert {name.partition(".")[0] for name in FUNCTIONS} >= {"volume", "render", "track", "plan", "export", "phantom"}
    assert {"track.measure_tree", "track.wall_field", "phantom.generate_phantom", "plan.plan_route"} <= set(FUNCTIONS)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_progress_has_the_same_type_and_the_same_refusal_in_every_public_function(name: str) -> None:
    called = FUNCTIONS[name]
    parameter = inspect.signature(called).parameters["progress"]
    assert (parameter.annotation, parameter.default) == ("ProgressChoice", None)
    # The argument is checked before all others, so the other arguments need not be valid.
    with pytest.raises(UsageError, match="progress: expected True, False, None or a function that takes a string and"):
        called(*([None] if "self" in inspect.signature(called).parameters else []), progress=3)


@pytest.mark.parametrize("choice", [False, True, None, "function"])
def test_long_functions_accept_every_choice_of_progress(choice: object) -> None:
    seen: list[tuple[str, float | None]] = []
    progress: Any = (lambda what, fraction: seen.append((what, fraction))) if choice == "function" else choice
    volume, airways = made_phantom(**SMALL).volume, made_airways(**SMALL)
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
def test_plan_route_accepts_every_choice_of_progress(choice: object) -> None:
    chest = {"seed": 4, "spacing_mm": 1.2, "generations": 5, "nodule": True}
    made = made_phantom(**chest)
    seen: list[tuple[str, float | None]] = []
    progress: Any = (lambda what, fraction: seen.append((what, fraction))) if choice == "function" else choice
    target = made.truth["nodule"]["centre_lps"]
    assert carina.plan_route(made.volume, made_airways(**chest), target, progress=progress).routes
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
def test_public_function_called_by_another_shows_no_second_bar(
    choice: Any, num: int, counted: type[CountedBar]
) -> None:
    outer(progress=choice)
    assert counted.made == num
    counted.made = 0
    outer(choice)
    assert counted.made == num


def test_inside_without_bars_a_bar_is_shown_only_on_request_of_the_call(counted: type[CountedBar]) -> None:
    with without_bars():
        inner()
        assert counted.made == 0
        inner(progress=True)
        assert counted.made == 1
    inner()
    assert counted.made == 2
