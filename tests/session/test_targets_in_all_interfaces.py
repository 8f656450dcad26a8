"""Tests that one point gives the same target, doubts or refusal on the command line, in Python and on the wire."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import carina
import carina.cli.plan
from cached_test_data import cached_phantom, found_airways
from carina.cli.app import app
from carina.commands import AddTarget, ConfirmTarget, GrowTarget, PlanningOf
from carina.errors import NoResultError, UnconfirmedTargetError, without_options
from carina.phantom import Phantom
from carina.plan import judge_scopes, target_from_click
from carina.server.to_wire.plan import plans_message
from carina.session import default_parts
from carina.volume import Volume

BESIDE_AIRWAY = "target.beside-airway"
Point = tuple[float, float, float]


@dataclass(frozen=True)
class Chest:
    """Phantom with a ball in the wall of the left main bronchus and a dense ball in the lung; places of all kinds."""

    volume: Volume
    airways: carina.Airways
    path: Path
    nodule: Point
    dense: Point
    places: tuple[Point, ...]


def as_point(values: object) -> Point:
    x, y, z = (round(float(v), 2) for v in np.asarray(values).reshape(3))
    return x, y, z


@pytest.fixture(scope="module")
def chest(tmp_path_factory: pytest.TempPathFactory) -> Chest:
    made: Phantom = cached_phantom(seed=4, spacing_mm=1.5, generations=4, nodule=True)
    volume = made.volume
    airways = found_airways(volume)
    nodule = np.array(made.truth["nodule"]["centre_lps"])
    branches = sorted(airways.tree.branches[1:], key=lambda one: -one.length_mm)
    rng = np.random.default_rng(3)
    k, j, i = np.indices(volume.shape_zyx)
    points = volume.to_lps(np.stack([i, j, k], axis=-1).astype(float))
    hu = np.array(volume.hu_zyx)

    def ball(middle: np.ndarray, radius_mm: float, level_hu: int) -> None:
        off = np.linalg.norm(points - middle, axis=-1)
        share = np.clip(0.5 - (off - radius_mm) / 1.5, 0.0, 1.0)
        hu[:] = np.rint(hu * (1.0 - share) + level_hu * share).astype(np.int16)

    # The dense ball is as deep in the lung as the nodule, on its side away from the mediastinum.
    dense = nodule + np.array([0.0, 28.0, 0.0])
    ball(dense, 5.0, 300)
    root = airways.tree.root
    main = next(one for one in airways.tree.branches if one.name == "LMB")
    n = len(main.points) // 2
    along = main.points[n + 1] - main.points[n - 1]
    across = np.cross(along, (0.0, 1.0, 0.0))
    across /= np.linalg.norm(across)
    on_wall = main.points[n] + across * main.radius[n]
    ball(on_wall, 3.5, 30)
    places = [nodule, dense, on_wall, root.points[len(root.points) // 2], nodule + np.array([0.0, 0.0, 3.0])]
    places += [nodule + np.array([0.0, 25.0, 20.0]), np.array(volume.to_lps(np.array(volume.shape_zyx[::-1]) * 0.5))]
    for branch in branches[:8]:
        n = len(branch.points) // 2
        tangent = branch.points[n + 1] - branch.points[n - 1]
        aside = np.cross(tangent, rng.normal(size=3))
        aside /= np.linalg.norm(aside)
        places.append(branch.points[n])
        places += [branch.points[n] + aside * (branch.radius[n] + mm) for mm in (1.0, 4.0)]
    changed = Volume(hu, volume.lps_from_ijk)
    folder = tmp_path_factory.mktemp("chest")
    path = folder / "ct.nii.gz"
    carina.volume.write_grid(path, changed.hu_zyx, changed.lps_from_ijk, what="a chest")
    opened = carina.open_volume(path)
    found = [as_point(one) for one in places if opened.contains_lps(np.array(one))]
    return Chest(opened, found_airways(opened), path, as_point(nodule), as_point(dense), tuple(found[:30]))


@pytest.fixture(scope="module")
def wall(chest: Chest) -> carina.WallField:
    return carina.wall_field(chest.volume, chest.airways)


@pytest.fixture(autouse=True)
def quick(chest: Chest, wall: carina.WallField, monkeypatch: pytest.MonkeyPatch) -> None:
    """Search for airways and their wall once, drive along no route, and judge no instrument."""
    monkeypatch.setattr("carina.plan.targets.from_click.wall_field", lambda _volume, _airways: wall)
    monkeypatch.setattr(carina, "find_airways", lambda _volume, **_options: chest.airways)
    monkeypatch.setattr(carina, "wall_field", lambda _volume, _airways, **_options: wall)
    monkeypatch.setattr(carina, "plan_route", partial(carina.plan_route, drives=0))
    monkeypatch.setattr(carina.cli.plan, "judge_scopes", lambda *_given, **_options: ())


@pytest.fixture(scope="module")
def case(chest: Chest) -> Iterator[carina.Case]:
    planned = partial(carina.plan.plan_route, drives=0)
    parts = replace(default_parts(), judge_scopes=partial(judge_scopes, effort=500.0), plan_route=planned)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("carina.session.core.default_parts", lambda: parts)
        with carina.Case.open(chest.volume) as opened:
            yield opened


def of_python(chest: Chest, at: Point) -> tuple[str, list[str]]:
    """Return the text of the target with the codes of its doubts, or the code of the refusal."""
    try:
        target = target_from_click(chest.volume, at, airways=chest.airways)
    except NoResultError as error:
        return error.code, []
    return target.words, [doubt.code for doubt in target.doubts]


def of_command_line(chest: Chest, at: Point) -> tuple[str, list[str]]:
    result = CliRunner().invoke(
        app, ["plan", str(chest.path), "--target", ",".join(f"{v:.2f}" for v in at), "--confirm", "all"]
    )
    reported = [line.removeprefix("target: ") for line in result.stderr.splitlines() if line.startswith("target: ")]
    if not reported:
        assert result.exit_code == 4, result.output
        return result.stderr, []
    doubts = [line for line in result.stderr.splitlines() if line.startswith("! The target may not be a nodule")]
    return reported[0], [line.rpartition("(")[2].rstrip(")") for line in doubts]


def of_wire(case: carina.Case, at: Point) -> tuple[str | None, list[str], bool]:
    """Return the text of the target (None for a place in the airways), its open doubts, and whether it has a plan."""
    case.do(AddTarget(at))
    target = case.state.document.targets[-1]
    plans = plans_message(case.ask(PlanningOf()))
    planned = next((one for one in plans.targets if one.target_id == target.target_id), None)
    case.undo()
    if planned is None:
        return None, [], False
    assert target.lesion is not None
    text = target.lesion.target.words.removeprefix(f"{target.name}: ")
    return text, list(planned.unconfirmed), planned.moved_mm is not None


def check_places(chest: Chest, case: carina.Case, places: tuple[Point, ...]) -> set[str]:
    """Compare the answers at places, and return the kinds of answers that occurred."""
    kinds = set()
    for at in places:
        text, doubts = of_python(chest, at)
        shown, listed = of_command_line(chest, at)
        marked, question, is_planned = of_wire(case, at)
        if text.startswith("plan."):
            kinds.add(text)
            assert not listed
            with pytest.raises(NoResultError) as error:
                target_from_click(chest.volume, at, airways=chest.airways)
            assert " ".join(str(error.value).split())[:60] in " ".join(shown.split()), at
            assert marked is None, at
            continue
        kinds.update(doubts or ["none"])
        assert (shown, listed) == (text, doubts), at
        if BESIDE_AIRWAY in doubts and marked is None:
            # Beside an airway a click in the window selects the branch, and the target is only offered as a choice.
            continue
        assert (marked, question) == (text, doubts), at
        assert is_planned == (not doubts), at
    return kinds


def test_point_gives_the_same_answer_on_the_command_line_in_python_and_on_the_wire(
    chest: Chest, case: carina.Case
) -> None:
    kinds = check_places(chest, case, chest.places[:4])
    assert {"none", "target.density", "plan.in-airway"} <= kinds


@pytest.mark.soak
def test_thirty_points_give_the_same_answers_on_the_command_line_in_python_and_on_the_wire(
    chest: Chest, case: carina.Case
) -> None:
    assert len(chest.places) == 30
    check_places(chest, case, chest.places)


def test_plan_command_refuses_a_doubtful_target_without_a_confirmation(chest: Chest) -> None:
    given = ["plan", str(chest.path), "--target", ",".join(str(v) for v in chest.dense)]
    refused = CliRunner().invoke(app, given)
    assert refused.exit_code == UnconfirmedTargetError.exit_code
    assert "denser than soft tissue" in refused.stderr
    assert "--confirm target.density" in " ".join(refused.stderr.split())
    assert CliRunner().invoke(app, [*given, "--confirm", "target.tube"]).exit_code == refused.exit_code
    odd = CliRunner().invoke(app, [*given, "--confirm", "target.odd"])
    assert odd.exit_code == 2


def test_window_plans_a_doubtful_target_only_after_its_confirmation(chest: Chest, case: carina.Case) -> None:
    case.do(AddTarget(chest.dense))
    (target,) = case.state.document.targets
    (requested,) = plans_message(case.ask(PlanningOf())).targets
    assert ([code for code, _ in requested.doubts], requested.unconfirmed) == (["target.density"], ("target.density",))
    assert requested.moved_mm is None and not requested.routes
    assert requested.problem is not None and "--confirm" not in requested.problem
    case.do(ConfirmTarget(target.target_id, ("target.density",)))
    (planned,) = plans_message(case.ask(PlanningOf())).targets
    assert ([code for code, _ in planned.doubts], planned.unconfirmed) == (["target.density"], ())
    assert planned.moved_mm is not None
    case.undo()
    (again,) = plans_message(case.ask(PlanningOf())).targets
    assert again.unconfirmed == ("target.density",)
    case.undo()
    with pytest.raises(carina.CarinaError, match="removed"):
        case.do(GrowTarget(target.target_id))
    assert without_options("a target (--confirm all)") == "a target"
