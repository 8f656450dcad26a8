"""Tests of targets with a boundary in a case: grown from a click, planned automatically, stored in the case file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import msgspec
import numpy as np
import pytest

import carina
import carina.plan
from cached_test_data import cached_phantom, found_airways
from carina.case import CaseFile, CaseFileError
from carina.case.document import Lesion
from carina.case.sized_targets import lesion_facts, lesion_from_facts
from carina.commands import (
    AddTarget,
    AimTarget,
    BrushTarget,
    Cancel,
    ChoosePair,
    ChoosePlannedRoute,
    ChooseRoute,
    ChosenPlace,
    DescribeTarget,
    FlyFlight,
    GrowTarget,
    KeepDrive,
    LivePathTo,
    MarkAt,
    MarkSphere,
    MeasureMovement,
    MeasureMovementFromCase,
    OpenVolume,
    PlanningOf,
    PlanOptions,
    PlanToTakeAway,
    RemoveTarget,
    ResizeTarget,
    SeeTurn,
    SetAvailableScopes,
    SetMode,
    SetOperator,
    SetPlanOptions,
    TakeTarget,
)
from carina.errors import CarinaError, NoResultError, UsageError
from carina.phantom import Phantom, write_phantom
from carina.plan import PlanTarget
from carina.scopes import scope_presets
from carina.server.to_wire.plan import plans_message
from carina.server.to_wire.session import state_message
from carina.session import JobEnded, JobProgress, LocalStore, Session, default_parts
from carina.session.derived.plans import shown_surface
from carina.volume import write_grid
from second_scan import write_second_ct
from small_case import SmallRenderer, session_fixture, small_lps


def judge_as_replaced(*given: object, **options: object) -> object:
    """Call the present ``carina.plan.judge_scopes``, which a test may replace while a case is open."""
    return carina.plan.judge_scopes(*given, **options)


def pairs_as_replaced(*given: object, **options: object) -> object:
    """Call the present ``carina.plan.judge_pairs``, which a test may replace while a case is open."""
    return carina.plan.judge_pairs(*given, **options)


@pytest.fixture(autouse=True, scope="module")
def replaceable_judge() -> Iterator[None]:
    """Let the cases of this module use ``judge_as_replaced``."""
    # The drives of plan_route are tested in tests/plan/test_routes.py.
    parts = replace(
        default_parts(),
        judge_scopes=judge_as_replaced,
        judge_pairs=pairs_as_replaced,
        plan_route=partial(carina.plan.plan_route, drives=0),
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("carina.session.core.default_parts", lambda: parts)
        yield


@pytest.fixture(autouse=True)
def few_verdicts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Limit the plans to two instruments of eighteen and their drives to searches of milliseconds."""
    whole = carina.plan.judge_scopes

    def judge(*given: object, scopes: list, **options: object):
        return whole(*given, scopes=scopes[:2], effort=2000.0, **options)

    monkeypatch.setattr(carina.plan, "judge_scopes", judge)
    every = carina.plan.judge_pairs

    def pairs(*given: object, scopes: list, **options: object):
        return every(*given, scopes=scopes[:2], routes=2, effort=300.0, **options)

    monkeypatch.setattr(carina.plan, "judge_pairs", pairs)


@pytest.fixture(scope="module")
def chest() -> Phantom:
    return cached_phantom(seed=4, spacing_mm=1.5, generations=4, nodule=True)


@pytest.fixture(scope="module")
def airways(chest: Phantom) -> carina.Airways:
    return found_airways(chest.volume)


@pytest.fixture(scope="module")
def opened(chest: Phantom) -> Iterator[carina.Case]:
    with carina.Case.open(chest.volume) as case:
        yield case


@pytest.fixture
def case(opened: carina.Case) -> Iterator[carina.Case]:
    """Return the opened case; after the test all its changes are undone."""
    yield opened
    while opened.history():
        opened.undo()


def centre_of(chest: Phantom) -> tuple[float, float, float]:
    x, y, z = chest.truth["nodule"]["centre_lps"]
    return float(x), float(y), float(z)


def test_click_on_a_nodule_outside_the_airways_adds_a_planned_target_without_moving_the_tip(
    case: carina.Case, chest: Phantom, airways: carina.Airways
) -> None:
    before = case.pose.lps_from_camera.copy()
    route = case.state.document.route
    case.do(AddTarget(centre_of(chest)))
    (target,) = case.state.document.targets
    truth = chest.truth["nodule"]
    assert target.lesion is not None
    assert np.linalg.norm(np.subtract(target.lesion.nodule.centre_lps, centre_of(chest))) < 0.5
    assert abs(target.lesion.nodule.mean_mm - 2.0 * truth["radius_mm"]) < 1.0
    assert case.state.document.route is route
    assert np.array_equal(case.pose.lps_from_camera, before)
    # The plan of the session equals the plan of the Python function.
    alone = carina.plan_route(chest.volume, airways, target.lesion.nodule, drives=0)
    exported = case.ask(PlanToTakeAway(target.target_id))
    assert json.dumps(exported.plan.to_json()) == json.dumps(alone.to_json())


def test_hovering_over_a_point_states_the_target_that_a_click_there_adds(case: carina.Case, chest: Phantom) -> None:
    centre = centre_of(chest)
    mark = case.ask(MarkAt(centre))
    assert not mark.warns
    case.do(AddTarget(centre))
    (target,) = case.state.document.targets
    assert mark.sentences == (f"a click marks a {target.lesion.nodule.words}",)
    tree = case.state.document.airways.tree
    x, y, z = (float(v) for v in tree.tips()[0].points[len(tree.tips()[0].points) // 2])
    assert case.ask(MarkAt((x, y, z))).sentences[0] == "a click marks this place in the airway"
    empty = case.ask(MarkAt((centre[0] + 15.0, centre[1], centre[2])))
    assert empty.warns and empty.sentences[0] == "a click marks a point without a path"
    assert "nothing is denser" in empty.sentences[1]
    with pytest.raises(UsageError):
        case.ask(MarkAt((9000.0, 0.0, 0.0)))
    assert case.state.document.targets == (target,)


def test_planned_route_ends_at_the_planned_tip_position_and_has_a_needle_line(
    case: carina.Case, chest: Phantom
) -> None:
    case.do(AddTarget(centre_of(chest)))
    (target,) = case.state.document.targets
    with pytest.raises(UsageError, match="there is no route 99"):
        case.do(ChoosePlannedRoute(target.target_id, 99))
    case.do(ChoosePlannedRoute(target.target_id, 1))
    info = case.ask(PlanningOf())
    plan = info.targets[0].planned.plan
    route = case.state.document.route
    assert route.target_id == target.target_id
    assert np.linalg.norm(route.points_lps[-1] - np.array(plan.routes[0].leg.tip_lps)) < 2.0
    assert route.needle.ends_lps[1] == pytest.approx(plan.routes[0].leg.aim_lps)
    assert route.drawn.drawn_mm == 0.0
    # The window measures the route from the origin of its plan, along the centrelines.
    scale = case.state.route_scale
    assert scale.origin == plan.routes[0].origin and scale.origin.kind == "ridge"
    assert scale.origin.past_mm(scale.along_mm[-1]) == pytest.approx(plan.routes[0].from_carina_mm, abs=0.5)
    # The verdicts follow the plan; the first one is that of the planned instrument.
    assert len(info.verdicts) == 2
    assert info.verdicts[0].scope.name == plan.scope.name
    case.undo()
    assert case.state.document.route is None or case.state.document.route.needle is None
    assert case.ask(PlanningOf()).verdicts == ()


def test_new_plan_options_compute_a_new_plan_and_preserve_target_names_and_notes(
    case: carina.Case, chest: Phantom
) -> None:
    case.do(AddTarget(centre_of(chest)))
    (target,) = case.state.document.targets
    first = case.ask(PlanningOf()).targets[0].planned.plan
    case.do(SetPlanOptions(target_id=target.target_id, moved_mm=7.0, scope="ultrathin"))
    second = case.ask(PlanningOf()).targets[0].planned.plan
    assert (second.moved_mm, second.scope.name) == (7.0, "ultrathin")
    assert second is not first
    with pytest.raises(CarinaError, match="no tool is called"):
        case.do(SetPlanOptions(target_id=target.target_id, tool="spoon"))
    case.do(DescribeTarget(target_id=target.target_id, called="Nodule, right upper lobe", remark="growing", rank=2))
    (named,) = case.state.document.targets
    assert (named.name, named.note, named.priority) == ("Nodule, right upper lobe", "growing", 2)
    # A new name does not change the plan.
    assert case.ask(PlanningOf()).targets[0].planned.plan is second
    case.do(RemoveTarget(target.target_id))
    assert case.ask(PlanningOf()).standing == "unwanted"


def test_selecting_a_pair_of_route_and_scope_sets_both_in_one_undo_step(case: carina.Case, chest: Phantom) -> None:
    case.do(AddTarget(centre_of(chest)))
    (target,) = case.state.document.targets
    case.do(ChoosePlannedRoute(target.target_id, 1))
    info = case.ask(PlanningOf())
    plan = info.targets[0].planned.plan
    names = [preset.name for preset in scope_presets()[:2]]
    keys = [route.key for route in plan.routes[:2]]
    assert info.pairs_standing == "had"
    assert {(one.scope.name, one.route_key) for one in info.pairs} == {(n, key) for n in names for key in keys}
    other = next(one for one in info.pairs if one.scope.name != plan.scope.name and one.route_key == keys[-1])
    steps = len(case.history())
    case.do(ChoosePair(target_id=target.target_id, route=keys[-1], scope=other.scope.name, tool=other.tool))
    assert len(case.history()) == steps + 1
    (planned,) = case.ask(PlanningOf()).targets
    assert planned.planned.plan.scope == other.scope
    place = next(route for route in plan.routes if route.key == keys[-1])
    lesion = case.state.document.targets[0].lesion
    assert lesion.options.place == ChosenPlace(place.branch_id, place.along_mm, place.aim)
    # A route of the new plan ends at the place of the pair, whatever the scope's own best place is.
    assert any(
        (one.branch_id, one.aim) == (place.branch_id, place.aim) and abs(one.along_mm - place.along_mm) < 0.01
        for one in planned.planned.plan.routes
    )
    assert case.state.document.route.target_id == target.target_id
    case.undo()
    assert case.state.document.targets[0].lesion.options.scope == plan.scope.name
    with pytest.raises(NoResultError, match=r"has no route 1-2\.0"):
        case.do(ChoosePair(target_id=target.target_id, route="1-2.0", scope="thin", tool="needle-21g"))


def test_available_scopes_are_stored_and_listed_first(chest: Phantom, tmp_path: Path) -> None:
    names = [preset.name for preset in scope_presets()[:2]]
    store = LocalStore(tmp_path)
    session = Session(SmallRenderer, store=store)
    session.do(OpenVolume(chest.volume))
    session.jobs.wait_idle(None)
    session.do(SetAvailableScopes(scopes=(names[1],)))
    assert LocalStore(tmp_path).available_scopes() == (names[1],)
    session.do(AddTarget(centre_of(chest)))
    session.jobs.wait_idle(None)
    (target,) = session.snapshot().document.targets
    session.do(ChoosePlannedRoute(target.target_id, 1))
    session.jobs.wait_idle(None)
    info = session.ask(PlanningOf())
    assert info.available == (names[1],)
    half = len(info.pairs) // 2
    assert half > 0
    assert [one.scope.name for one in info.pairs] == [names[1]] * half + [names[0]] * half
    assert [one.available for one in plans_message(info).pairs] == [True] * half + [False] * half
    with pytest.raises(UsageError):
        session.do(SetAvailableScopes(scopes=("no-scope",)))
    session.do(SetAvailableScopes(scopes=None))
    assert all(one.available for one in plans_message(session.ask(PlanningOf())).pairs)
    session.close()


def test_target_inside_the_airway_lumen_has_no_boundary(case: carina.Case, airways: carina.Airways) -> None:
    tip = airways.tree.tips()[0]
    x, y, z = (float(v) for v in tip.points[len(tip.points) // 2])
    case.do(AddTarget((x, y, z)))
    (target,) = case.state.document.targets
    assert target.lesion is None
    assert target.route is not None
    with pytest.raises(NoResultError, match="not been planned"):
        case.do(ChoosePlannedRoute(target.target_id, 1))
    with pytest.raises(UsageError, match="lies in the airways"):
        case.do(SetPlanOptions(target_id=target.target_id))


def test_case_file_stores_targets_routes_and_notes(chest: Phantom, tmp_path: Path) -> None:
    write_phantom(chest, tmp_path / "scan")
    case = carina.Case.open(tmp_path / "scan" / "ct.nii.gz")
    case.do(AddTarget(centre_of(chest)))
    (target,) = case.state.document.targets
    case.do(SetPlanOptions(target_id=target.target_id, vessel_margin_mm=4.5))
    case.do(DescribeTarget(target_id=target.target_id, called="Left", remark="second opinion", rank=3))
    case.do(ChoosePlannedRoute(target.target_id, 1))
    case.do(SetMode("path"))
    (target,) = case.state.document.targets
    route = case.state.document.route
    exported = case.ask(PlanToTakeAway(target.target_id)).plan.to_json()
    path = case.save(tmp_path / "plan.carina")
    case.close()
    with carina.Case.open(path) as again:
        (restored,) = again.state.document.targets
        assert (restored.name, restored.note, restored.priority) == ("Left", "second opinion", 3)
        assert restored.lesion.options == PlanOptions(vessel_margin_mm=4.5)
        assert np.array_equal(restored.lesion.nodule.inside_zyx, target.lesion.nodule.inside_zyx)
        assert restored.lesion.nodule.to_json() == target.lesion.nodule.to_json()
        assert again.state.document.route.needle == route.needle
        # The plan is computed again and equals the earlier one.
        again.do(SetMode("free"))
        assert json.dumps(again.ask(PlanToTakeAway(restored.target_id)).plan.to_json()) == json.dumps(exported)


def test_simulated_drive_of_a_verdict_is_stored_as_a_flight_and_flown(chest: Phantom, tmp_path: Path) -> None:
    write_phantom(chest, tmp_path / "scan")
    case = carina.Case.open(tmp_path / "scan" / "ct.nii.gz")
    with pytest.raises(NoResultError, match="there is no verdict on 'thin'"):
        case.do(KeepDrive("thin"))
    case.do(AddTarget(centre_of(chest)))
    (target,) = case.state.document.targets
    case.do(ChoosePlannedRoute(target.target_id, 1))
    verdicts = case.ask(PlanningOf()).verdicts
    driven = next(one for one in verdicts if one.driven is not None)
    before = case.pose.lps_from_camera.copy()
    for name in (driven.scope.name, driven.scope.name):
        case.do(KeepDrive(name))
    assert np.array_equal(case.pose.lps_from_camera, before), "storing a drive does not move the tip"
    first, second = case.state.flights
    assert first.name == f"Simulated drive to {target.name}, {driven.scope.title}"
    assert (first.state, first.length_s) == ("complete", second.length_s)
    assert first.words == driven.words[0].upper() + driven.words[1:]
    assert first.length_s == pytest.approx(driven.driven.time_s[-1], abs=1e-5)
    # The flight contains every position that the scope reached, and ends at the last one.
    for number in (first.number, second.number):
        case.do(FlyFlight(number, first.length_s))
        assert np.allclose(case.pose.lps_from_camera, driven.driven.lps_from_camera[-1], atol=1e-9)
        # If nothing was rotated, two samples have the same time, and the later one is used.
        at_s = float(driven.driven.time_s[len(driven.driven.time_s) // 2]) + 1e-5
        middle = int(np.searchsorted(driven.driven.time_s, at_s)) - 1
        case.do(FlyFlight(number, at_s))
        assert np.allclose(case.pose.lps_from_camera, driven.driven.lps_from_camera[middle], atol=1e-9)
    path = case.save(tmp_path / "plan.carina")
    case.close()
    with CaseFile.open(path, read_only=True) as file:
        recordings = file.recordings()
        assert [(one.name, one.words, one.complete) for one in recordings] == [(first.name, first.words, True)] * 2
        replayed = list(file.recording(recordings[0].recording_id).replay(chest.volume))
    assert all(same for _, same in replayed)
    assert np.allclose(replayed[-1][0].pose.lps_from_camera, driven.driven.lps_from_camera[-1], atol=1e-9)
    # The flight has at least ten poses a second, also while the operator rotates the scope.
    assert np.diff([moment.time_s for moment, _ in replayed]).max() <= 0.1


def test_verdict_without_a_simulated_drive_cannot_be_stored_as_a_flight(
    case: carina.Case, chest: Phantom, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = carina.plan.judge_scopes

    def judge(*given: object, scopes: list, **options: object):
        return whole(*given, scopes=[replace(scopes[0], tip_mm=14.0, tube_mm=None)], **options)

    monkeypatch.setattr(carina.plan, "judge_scopes", judge)
    case.do(AddTarget(centre_of(chest)))
    (target,) = case.state.document.targets
    case.do(ChoosePlannedRoute(target.target_id, 1))
    with pytest.raises(NoResultError, match="was not driven along this route"):
        case.do(KeepDrive("thin"))
    assert case.state.flights == ()


def test_case_file_with_a_damaged_target_boundary_is_refused(chest: Phantom) -> None:
    nodule = carina.grow_nodule(chest.volume, centre_of(chest))
    target = PlanTarget("target-1", "Target 1", nodule, centre_of(chest), "click", "lung")
    facts = lesion_facts(Lesion(target))
    assert lesion_from_facts(facts).nodule.to_json() == nodule.to_json()
    record = facts.record
    for wrong in ({}, record | {"version": 99}, record | {"nodule": record["nodule"] | {"kind": "square"}}):
        with pytest.raises(CaseFileError):
            lesion_from_facts(msgspec.structs.replace(facts, record=wrong))


def test_surface_of_a_target_is_on_the_boundary_of_its_nodule(chest: Phantom) -> None:
    nodule = carina.grow_nodule(chest.volume, centre_of(chest))
    mesh = shown_surface(nodule)
    away = np.linalg.norm(mesh.vertices_lps - np.array(nodule.centre_lps), axis=1)
    assert abs(2.0 * away.mean() - nodule.equivalent_mm) < 0.6
    assert mesh.volume_mm3 == pytest.approx(nodule.volume_mm3, rel=0.15)


def test_target_boundary_is_edited_by_diameter_and_brush_and_gets_several_aims(
    case: carina.Case, chest: Phantom
) -> None:
    case.do(AddTarget(centre_of(chest)))
    (target,) = case.state.document.targets
    grown = target.lesion.nodule
    case.do(ResizeTarget(target.target_id, grown.long_mm + 4.0))
    wider = case.state.document.targets[0].lesion.nodule
    assert wider.long_mm == pytest.approx(grown.long_mm + 4.0, abs=0.5)
    edge = tuple(np.add(grown.centre_lps, (wider.long_mm / 2.0, 0.0, 0.0)))
    case.do(BrushTarget(target.target_id, (edge,), 3.0))
    painted = case.state.document.targets[0].lesion
    assert painted.nodule.volume_mm3 > wider.volume_mm3
    assert painted.target.source == "edited"
    case.do(BrushTarget(target.target_id, (edge,), 3.0, takes_away=True))
    assert case.state.document.targets[0].lesion.nodule.volume_mm3 < painted.nodule.volume_mm3
    with pytest.raises(CarinaError, match="does not touch"):
        case.do(BrushTarget(target.target_id, (tuple(np.add(edge, (40.0, 0.0, 0.0))),), 2.0))
    case.do(AimTarget(target.target_id, periphery=True))
    assert len(case.state.document.targets[0].lesion.target.aims) == 3
    assert len(case.ask(PlanningOf()).targets[0].planned.plan.aims) == 3
    # Each edit is one undo step.
    for _ in range(4):
        case.undo()
    assert case.state.document.targets[0].lesion.nodule is grown


def test_targets_are_read_from_files_and_created_as_spheres(case: carina.Case, chest: Phantom, tmp_path: Path) -> None:
    centre = centre_of(chest)
    mask = np.zeros(chest.volume.shape_zyx, dtype=np.uint8)
    k, j, i = np.rint(chest.volume.to_ijk(np.array(centre))).astype(int)[::-1]
    mask[k - 3 : k + 4, j - 3 : j + 4, i - 3 : i + 4] = 1
    write_grid(tmp_path / "mask.nrrd", mask, chest.volume.lps_from_ijk, what="a target")
    case.do(TakeTarget(str(tmp_path / "mask.nrrd")))
    case.do(MarkSphere(centre, 12.0))
    drawn, ball = case.state.document.targets
    assert (drawn.lesion.target.source, ball.lesion.target.source) == ("mask", "sphere")
    assert drawn.lesion.nodule.volume_mm3 == pytest.approx(7**3 * 1.5**3, rel=0.02)
    assert drawn.lesion.nodule.notes[-1].startswith("for comparison: the file's boundary has 1.16 \u00b1 ")
    assert "a click at its middle gives" in drawn.lesion.nodule.notes[-1]
    assert ball.lesion.nodule.long_mm == pytest.approx(12.0, abs=0.7)
    assert {one.target.name for one in case.ask(PlanningOf()).targets} == {drawn.name, ball.name}
    shifted = np.array(chest.volume.lps_from_ijk)
    shifted[:3, 3] += 0.7
    write_grid(tmp_path / "other.nrrd", mask, shifted, what="a target")
    with pytest.raises(CarinaError, match="grid"):
        case.do(TakeTarget(str(tmp_path / "other.nrrd")))
    assert len(case.state.document.targets) == 2


def test_click_beside_an_airway_adds_a_target_in_it_until_the_user_grows_a_nodule(
    case: carina.Case, chest: Phantom, airways: carina.Airways
) -> None:
    branch = max(airways.tree.branches[1:], key=lambda one: one.length_mm)
    n = len(branch.points) // 2
    along = branch.points[n + 1] - branch.points[n - 1]
    across = np.cross(along, (0.0, 0.0, 1.0))
    beside = branch.points[n] + across / np.linalg.norm(across) * (branch.radius[n] + 2.0)
    x, y, z = (float(v) for v in beside)
    case.do(AddTarget((x, y, z)))
    (target,) = case.state.document.targets
    assert target.lesion is None and target.route is not None
    assert target.snapped_mm > 0.05
    try:
        case.do(GrowTarget(target.target_id))
    except NoResultError:
        assert case.state.document.targets == (target,)
    else:
        (grown,) = case.state.document.targets
        assert grown.lesion is not None and (grown.target_id, grown.name) == (target.target_id, target.name)
        assert case.state.document.route is None or case.state.document.route.target_id != target.target_id


def test_see_turn_command_shows_the_camera_of_the_turn_for_both_operator_positions(
    case: carina.Case, chest: Phantom
) -> None:
    with pytest.raises(NoResultError, match="choose a planned route first"):
        case.do(SeeTurn(1))
    case.do(AddTarget(centre_of(chest)))
    (target,) = case.state.document.targets
    case.do(ChoosePlannedRoute(target.target_id, 1))
    turns = case.ask(PlanningOf()).turns
    assert turns.turns[0].at_main_carina
    # The turns contain the hand movements of the planned scope's drive.
    assert turns.turns[0].moves is not None
    for operator in ("head", "facing"):
        case.do(SetOperator(operator))
        for number, turn in enumerate(turns.turns, 1):
            case.do(SeeTurn(number))
            assert np.allclose(case.pose.lps_from_camera, turn.camera(operator).lps_from_camera)
    with pytest.raises(UsageError, match=f"has {len(turns.turns)} turns"):
        case.do(SeeTurn(len(turns.turns) + 1))
    message = plans_message(case.ask(PlanningOf()))
    assert [one.head for one in message.turns] == list(turns.words("head")[:-1])
    ends = {branch.id: branch.points[-1] for branch in case.state.document.airways.tree.branches}
    for one, turn in zip(message.turns, turns.turns, strict=True):
        assert np.allclose(ends[one.fork_branch_id], turn.fork_lps)
        assert one.doubts == turn.cautions and (one.hour_doubt is None) == (turn.hour_doubt is None)
        assert [way.branch_id for way in one.openings] == [turn.to_branch_id, *(way.branch_id for way in turn.others)]
        assert one.openings[0].middle_lps == turn.opening_lps
        assert one.openings[0].straight_ahead == turn.straight_ahead


def test_c_arm_angles_and_stations_of_the_selected_route_are_sent_unchanged(
    case: carina.Case, chest: Phantom, airways: carina.Airways
) -> None:
    case.do(AddTarget(centre_of(chest)))
    (target,) = case.state.document.targets
    assert plans_message(case.ask(PlanningOf())).carm is None
    case.do(ChoosePlannedRoute(target.target_id, 1))
    info = case.ask(PlanningOf())
    message = plans_message(info)
    plan = info.targets[0].planned.plan
    expected = carina.plan.carm_angles(chest.volume, case.state.document.airways, plan).to_json()
    assert (info.carm_standing, message.carm_standing) == ("had", "had")
    sent = json.loads(msgspec.json.encode(message.carm))
    assert [sent["why"], sent["limits"], sent["notes"]] == [expected[key] for key in ("why", "limits", "notes")]
    assert len(sent["angles"]) == len(expected["angles"]) > 0
    for one, of_python in zip(sent["angles"], expected["angles"], strict=True):
        assert one == {key: of_python[key] for key in one}
    # The report states the angles that the window shows.
    assert case.ask(PlanToTakeAway(target.target_id)).carm is info.carm

    stations = carina.plan.route_stations(airways.tree, plan, plan.routes[0])
    assert [one.head for one in message.targets[0].stations] == [one.words for one in stations] != []
    for one, station in zip(message.targets[0].stations, stations, strict=True):
        assert one.facing == station.words_for("facing") != one.head
        assert one.point_lps == station.landmark.point_lps and one.direction_lps == station.landmark.direction_lps
    assert message.station_note == carina.plan.STATION_NOTE


def test_compared_targets_have_the_order_of_the_python_function_and_unplanned_ones_state_their_reason(
    case: carina.Case, chest: Phantom
) -> None:
    x, y, z = centre_of(chest)
    case.do(AddTarget((x, y, z)))
    assert plans_message(case.ask(PlanningOf())).comparison is None
    case.do(AddTarget((x + 1.0, y, z)))
    first, second = case.state.document.targets
    # The scope stops nearer to the main carina for the smaller target, which is the second one.
    case.do(ResizeTarget(second.target_id, 5.0))
    case.do(DescribeTarget(first.target_id, second.name, "", 1))
    tree = case.state.document.airways.tree
    px, py, pz = (float(v) for v in tree.tips()[0].points[-1])
    case.do(AddTarget((px, py, pz)))
    info = case.ask(PlanningOf())
    plans = [one.planned.plan for one in info.targets]
    expected = carina.plan.compare_targets(plans, [one.target.name for one in info.targets])
    found = plans_message(info).comparison
    assert found.order == carina.plan.ORDER_RULE
    ids = {id(one.planned.plan): one.target.target_id for one in info.targets}
    assert [one.target_id for one in found.targets] == [ids[id(row.plan)] for row in expected]
    assert [one.target_id for one in found.targets] == [second.target_id, first.target_id]
    for one, row in zip(found.targets, expected, strict=True):
        value = row.to_json()
        sent = json.loads(msgspec.json.encode(one))
        assert {key: sent[key] for key in value} == value
    (rest,) = found.unplanned
    assert rest.target_id == case.state.document.targets[2].target_id and rest.why.startswith("not planned")


def test_growing_a_nodule_reports_progress_and_can_be_stopped():
    began = []

    def grow(_volume, _lps, *, progress, **_options):
        progress("looking for a nodule", None)
        began.append(True)
        if len(began) == 2:
            job = next(e for e in reversed(fixture.events) if isinstance(e, JobProgress))
            fixture.session.do(Cancel(job.job_id))
            progress("looking for a nodule", None)
        raise NoResultError("there is no nodule at this point", code="plan.no-nodule")

    fixture = session_fixture(target_from_click=grow)
    fixture.open()
    fixture.background.run_all()
    beside = small_lps((2.0, 25.0, 30.0))
    fixture.session.do(AddTarget(beside))
    fixture.background.run_all()
    events = [e for e in fixture.events if isinstance(e, JobProgress)]
    assert (events[-1].title, events[-1].what) == ("finding the path to Target 1", "looking for a nodule")
    assert len(fixture.session._core.case.document.targets) == 1
    fixture.session.do(AddTarget(beside))
    fixture.background.run_all()
    assert len(fixture.session._core.case.document.targets) == 1
    ended = [e for e in fixture.events if isinstance(e, JobEnded)]
    assert ended[-1].outcome == "cancelled"


def test_target_in_an_airway_and_path_to_the_cursor_are_measured_from_the_main_carina(
    case: carina.Case, airways: carina.Airways
) -> None:
    tree = airways.tree
    deep = max(tree.tips(), key=lambda tip: sum(one.length_mm for one in tree.lineage(tip.id)))
    trachea = next(branch for branch in tree.branches if branch.parent is None)
    places = [deep.points[len(deep.points) // 2], trachea.points[len(trachea.points) // 2]]
    # A place beside the centreline, in the lumen, has the distance of the centreline beside it.
    beside = places[1] + np.array([0.6 * float(trachea.radius[len(trachea.points) // 2]), 0.0, 0.0])
    for point in (*places, beside):
        lps = tuple(float(v) for v in point)
        case.do(AddTarget(lps))
        target = case.state.document.targets[-1]
        assert target.lesion is None and target.route is not None
        past_mm = case.state.target_places_mm[target.target_id]
        case.do(ChooseRoute(target_id=target.target_id))
        scale = case.state.route_scale
        assert scale.origin.kind == "ridge"
        assert past_mm == pytest.approx(scale.along_mm[-1] - scale.origin.along_mm), "as the path bar states it"
        assert (past_mm > 0.0) == (point is places[0]) and past_mm < target.length_mm
        pointed = case.ask(LivePathTo(lps))
        assert pointed.from_carina_mm == pytest.approx(past_mm, abs=0.5)
        message = state_message(case.state, frame_rate_hz=30.0)
        assert message.targets[-1].from_carina_mm == pytest.approx(past_mm, abs=0.01)


def test_distances_of_target_and_cursor_agree_at_forks(case: carina.Case, airways: carina.Airways) -> None:
    tree, tracker = airways.tree, airways.tracker
    rng = np.random.default_rng(5)
    forks = [branch.points[-1] for branch in tree.branches if branch.children]
    places = np.concatenate([fork + rng.uniform(-6.0, 6.0, size=(40, 3)) for fork in forks])
    places = places[tracker.inside(places)]
    # At these places, the nearest centreline is that of another branch than the one to whose lumen the place belongs.
    doubtful = [place for place in places if tree.nearest_branch(place)[0].id != tracker.branch_at(place)]
    assert len(doubtful) >= 5
    for place in doubtful[:5]:
        lps = tuple(float(v) for v in place)
        case.do(AddTarget(lps))
        target = case.state.document.targets[-1]
        past_mm = case.state.target_places_mm[target.target_id]
        assert case.ask(LivePathTo(lps)).from_carina_mm == pytest.approx(past_mm, abs=0.1)


def test_movement_measured_from_a_second_ct_replaces_the_default_and_is_stored(chest: Phantom, tmp_path: Path) -> None:
    write_phantom(chest, tmp_path / "scan")
    second = write_second_ct(chest.volume, tmp_path / "second.nii.gz")
    case = carina.Case.open(tmp_path / "scan" / "ct.nii.gz")
    case.do(AddTarget(centre_of(chest)))
    (target,) = case.state.document.targets
    default = case.ask(PlanningOf()).targets[0].planned.plan
    case.do(MeasureMovement(target.target_id, str(second)))
    (measured,) = case.state.document.targets
    movement = measured.lesion.options.movement
    assert 0.5 < np.linalg.norm(movement.shift_lps) < 20.0 and 0.0 < movement.error_mm < 5.0
    plan = case.ask(PlanningOf()).targets[0].planned.plan
    assert (default.movement.origin, plan.movement.origin) == ("default", "measured")
    message = plans_message(case.ask(PlanningOf()))
    assert message.targets[0].movement == plan.movement.words
    with pytest.raises(UsageError, match="either entered or measured"):
        case.do(SetPlanOptions(target_id=target.target_id, moved_mm=7.0, movement=movement))
    case.undo()
    assert case.state.document.targets[0].lesion.options.movement is None
    case.redo()
    path = case.save(tmp_path / "moved.carina")
    case.close()
    with carina.Case.open(path) as again:
        assert again.state.document.targets[0].lesion.options.movement == movement


def test_second_ct_of_a_case_that_is_not_in_the_list_is_refused(case: carina.Case, chest: Phantom) -> None:
    case.do(AddTarget(centre_of(chest)))
    (target,) = case.state.document.targets
    before = case.state.document
    with pytest.raises(UsageError, match="no longer in the list") as raised:
        case.do(MeasureMovementFromCase(target.target_id, "unknown"))
    assert raised.value.code == "session.recent" and case.state.document is before


def test_second_ct_that_is_not_comparable_changes_nothing(case: carina.Case, chest: Phantom, tmp_path: Path) -> None:
    case.do(AddTarget(centre_of(chest)))
    (target,) = case.state.document.targets
    before = case.state.document
    small = tmp_path / "small.nii.gz"
    write_grid(small, chest.volume.hu_zyx[:20], chest.volume.lps_from_ijk, what="the CT")
    with pytest.raises(NoResultError, match="Choose a CT of the whole chest") as raised:
        case.do(MeasureMovement(target.target_id, str(small)))
    assert raised.value.code == "movement.half-chest"
    assert case.state.document is before
    same = tmp_path / "same.nii.gz"
    write_grid(same, chest.volume.hu_zyx, chest.volume.lps_from_ijk, what="the CT")
    with pytest.raises(NoResultError, match="the second CT is the CT of this plan"):
        case.do(MeasureMovement(target.target_id, str(same)))
    assert case.state.document is before
