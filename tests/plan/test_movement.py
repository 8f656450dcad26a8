"""Tests of the movement of a target that is measured from a second CT."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from nodules import ellipsoid

from cached_test_data import cached_phantom, found_airways
from carina.errors import CancelledError, NoResultError, UsageError
from carina.phantom import Phantom
from carina.plan import (
    MovementMeasurement,
    TargetMovement,
    default_movement,
    hit_share,
    measure_movement,
    plan_route,
)
from carina.plan.movement.deformation import Affine, Deformation, affine_fit, rigid_fit, rotation_deg
from carina.plan.movement.forks import named_forks
from carina.plan.movement.orientation import orientation_error
from carina.plan.movement.same_patient import (
    breath_notes,
    check_breath,
    check_gravity,
    cut_lungs_error,
    density_slope,
    few_forks,
    no_airways,
)
from carina.plan.movement.target_movement import shift_words
from carina.plan.reasons import plan_reasons
from carina.plan.routes.needle_hits import NeedleErrors
from carina.track import Airways
from carina.volume import Volume
from carina.volume.inserted_structures import SECOND_CT_WORDS, with_inserted
from carina_bench.breathing import Breath, breathed, random_breath


@cache
def chest() -> Phantom:
    return cached_phantom(seed=3, spacing_mm=1.8, generations=5, nodule=True)


@cache
def breath() -> Breath:
    return random_breath(np.zeros(3), seed=5)


@cache
def second() -> Volume:
    return breathed(chest().volume, breath(), seed=5)


@cache
def second_airways() -> Airways:
    return found_airways(second())


def place() -> np.ndarray:
    return np.array(chest().truth["nodule"]["centre_lps"])


@cache
def measured() -> MovementMeasurement:
    volume = chest().volume
    return measure_movement(volume, found_airways(volume), place(), second(), second_airways(), progress=False)


def refusal(volume: Volume, airways: Airways | None = None) -> NoResultError:
    first = chest().volume
    with pytest.raises(NoResultError) as raised:
        measure_movement(first, found_airways(first), place(), volume, airways, progress=False)
    return raised.value


def part_of(volume: Volume, axis: int, first: int, last: int) -> Volume:
    index = [slice(None)] * 3
    index[axis] = slice(first, last)
    matrix = volume.lps_from_ijk.copy()
    matrix[:3, 3] += first * matrix[:3, 2 - axis]
    return Volume(np.ascontiguousarray(volume.hu_zyx[tuple(index)]), matrix)


def test_measured_target_shift_is_within_its_error_and_forks_are_within_one_millimetre() -> None:
    found = measured()
    main = next(fork for fork in found.forks if fork.branch == "Trachea")
    true = breath().shifts(place()[None])[0] - breath().shifts(np.array([main.first_lps]))[0]
    movement = found.movement
    assert movement.origin == "measured" and movement.error_mm is not None
    assert np.linalg.norm(np.array(movement.shift_lps) - true) <= movement.error_mm <= 3.0
    assert np.linalg.norm(true) > 1.0
    at = np.array([fork.first_lps for fork in found.forks if fork.is_used])
    shifts = np.array([fork.shift_lps for fork in found.forks if fork.is_used])
    assert len(at) >= 12
    assert np.linalg.norm(shifts - breath().shifts(at), axis=1).max() <= 1.0
    assert found.is_target_seen and not found.movement.notes and found.num_vessels >= 50
    assert np.allclose(found.second_lps, place() + np.array(movement.shift_lps) + np.array(found.carina_shift_lps))
    document = found.to_json()
    assert document["movement"]["origin"] == "measured" and len(document["forks"]) == len(found.forks)


def test_movement_from_a_second_ct_with_an_inserted_nodule_states_the_insertion_in_the_plan() -> None:
    first = chest().volume
    marked = with_inserted(second().source, ("solid nodule, 8.0 mm, at -41.0 12.0 -180.0",))
    volume = dataclasses.replace(second(), source=marked)
    found = measure_movement(first, found_airways(first), place(), volume, second_airways(), progress=False)
    assert found.movement.notes == (SECOND_CT_WORDS,)
    assert found.movement.shift_lps == measured().movement.shift_lps
    plan = plan_route(
        first, found_airways(first), place(), movement=found.movement, drives=0, confirmed=True, progress=False
    )
    (reason,) = [one for one in plan_reasons(plan) if "inserted" in one.words]
    assert reason.severity == "stop"
    assert "second CT" in reason.words


def test_shift_of_the_ct_table_does_not_count_as_target_movement() -> None:
    moved = second().lps_from_ijk.copy()
    moved[:3, 3] += (40.0, -25.0, 310.0)
    volume = Volume(second().hu_zyx, moved)
    airways = dataclasses.replace(
        second_airways(), tree=shifted_tree(second_airways().tree, np.array([40.0, -25.0, 310.0]))
    )
    first = chest().volume
    found = measure_movement(first, found_airways(first), place(), volume, airways, progress=False)
    assert found.movement.shift_lps == pytest.approx(measured().movement.shift_lps, abs=0.1)
    assert found.carina_shift_lps[2] == pytest.approx(310.0, abs=25.0)


def shifted_tree(tree, offset):
    branches = tuple(dataclasses.replace(one, points=one.points + offset) for one in tree.branches)
    return dataclasses.replace(tree, branches=branches)


def test_target_missing_in_the_second_ct_is_reported_and_its_shift_is_that_of_its_neighbours() -> None:
    first = chest().volume
    nodule = chest().truth["nodule"]
    hu = second().hu_zyx.copy()
    z, y, x = np.indices(hu.shape).reshape(3, -1)
    at = np.stack([x, y, z], axis=1) @ second().lps_from_ijk[:3, :3].T + second().lps_from_ijk[:3, 3]
    now = place() + breath().shifts(place()[None])[0]
    near = np.linalg.norm(at - now, axis=1) < nodule["radius_mm"] + 3.0
    hu.reshape(-1)[near] = -850
    gone = Volume(hu, second().lps_from_ijk)
    target = ellipsoid((nodule["radius_mm"],) * 3, place())
    found = measure_movement(first, found_airways(first), target, gone, second_airways(), progress=False)
    assert not found.is_target_seen
    assert any("not recognised in the second CT" in note for note in found.movement.notes)
    off = np.array(found.movement.shift_lps) - np.array(measured().movement.shift_lps)
    assert np.linalg.norm(off) <= found.movement.error_mm


def test_second_ct_of_another_patient_is_refused() -> None:
    other = cached_phantom(seed=2, spacing_mm=1.1)
    error = refusal(other.volume, found_airways(other.volume))
    assert error.code == "movement.other-patient" and "Choose another CT" in str(error)


def test_second_ct_of_half_of_the_chest_is_refused() -> None:
    half = second().shape_zyx[0] // 2
    cut = part_of(second(), 0, half, second().shape_zyx[0])
    error = refusal(cut, found_airways(cut))
    assert error.code == "movement.half-chest" and "whole chest" in str(error)
    narrow = part_of(second(), 2, 0, second().shape_zyx[2] // 3)
    assert refusal(narrow).code == "movement.half-chest"


def test_second_ct_without_airways_is_refused() -> None:
    empty = Volume(np.full((90, 90, 90), 40, dtype=np.int16), np.diag([4.0, 4.0, 4.0, 1.0]))
    error = refusal(empty)
    assert error.code == "movement.no-airways" and "whole chest" in str(error)


def test_target_outside_the_second_ct_is_refused() -> None:
    volume = second()
    now = place() + breath().shifts(place()[None])[0]
    (k,) = volume.to_ijk(now[None])[:, 2].astype(int)
    below = now[2] < 0.0
    cut = part_of(volume, 0, k + 2, volume.shape_zyx[0]) if below else part_of(volume, 0, 0, k - 2)
    error = refusal(cut, second_airways())
    assert error.code in {"movement.outside", "movement.half-chest"}


def test_second_ct_of_a_patient_rotated_by_180_degrees_is_refused() -> None:
    volume = second()
    turned = Volume(np.ascontiguousarray(volume.hu_zyx[:, ::-1, ::-1]), volume.lps_from_ijk)
    corner = (
        volume.to_lps(np.array([[0.0, 0.0, 0.0]]))[0]
        + volume.to_lps(np.array([[volume.shape_zyx[2] - 1.0, volume.shape_zyx[1] - 1.0, 0.0]]))[0]
    )
    tree = second_airways().tree
    branches = tuple(
        dataclasses.replace(one, points=np.array([corner[0], corner[1], 0.0]) + one.points * (-1.0, -1.0, 1.0))
        for one in tree.branches
    )
    airways = dataclasses.replace(second_airways(), tree=dataclasses.replace(tree, branches=branches))
    error = refusal(turned, airways)
    assert error.code == "movement.pose" and "rotated by 180 degrees" in str(error)


def test_the_same_ct_and_a_ct_of_the_same_breath_measure_no_movement() -> None:
    first = chest().volume
    error = refusal(Volume(first.hu_zyx.copy(), first.lps_from_ijk), found_airways(first))
    assert error.code == "movement.same-ct" and "Choose another CT" in str(error)
    noise = np.random.default_rng(1).normal(0.0, 20.0, first.hu_zyx.shape)
    again = Volume((first.hu_zyx + noise).astype(np.int16), first.lps_from_ijk)
    error = refusal(again, found_airways(first))
    assert error.code == "movement.same-breath" and "expiration" in str(error)


def test_similar_breath_is_a_note_and_thick_slices_hide_a_small_movement() -> None:
    check_breath(1.1, 1.0)
    with pytest.raises(NoResultError, match="the same breath"):
        check_breath(1.1, 3.0)
    assert breath_notes(2.6) == []
    assert "may move more" in breath_notes(1.5)[0]


@pytest.mark.parametrize(
    ("signs", "code", "words"),
    [
        ((-1.0, 1.0, 1.0), "movement.mirrored", "right and left are exchanged"),
        ((1.0, 1.0, -1.0), "movement.mirrored", "head and feet are exchanged"),
        ((-1.0, -1.0, 1.0), "movement.pose", "prone in one CT"),
    ],
)
def test_wrong_orientation_is_recognised_without_names(signs, code, words) -> None:
    first, tree = found_airways(chest().volume).tree, second_airways().tree
    assert orientation_error(first, tree) is None
    carina = next(one for one in tree.branches if one.name == "Trachea").points[-1]
    branches = tuple(
        dataclasses.replace(
            one,
            points=(one.points - carina) * signs + (10.0, 20.0, 300.0),
            name=one.name if one.name == "Trachea" else None,
            name_from=one.name_from if one.name == "Trachea" else None,
            name_confidence=one.name_confidence if one.name == "Trachea" else None,
        )
        for one in tree.branches
    )
    error = orientation_error(first, dataclasses.replace(tree, branches=branches))
    assert error is not None and error.code == code
    assert words in str(error) and "orientation letters" in str(error)


def test_lungs_that_the_second_ct_cuts_explain_few_forks() -> None:
    whole = second()
    cut = part_of(whole, 0, whole.shape_zyx[0] // 2, whole.shape_zyx[0])
    error = cut_lungs_error(few_forks(3, cut), chest().volume, cut)
    assert error is not None and error.code == "movement.half-chest" and "lower end cuts" in str(error)
    assert cut_lungs_error(few_forks(3, whole), chest().volume, whole) is None
    upright = cut.lps_from_ijk.copy()
    upright[:3, 2] *= -1.0
    turned = cut_lungs_error(few_forks(3, cut), chest().volume, Volume(cut.hu_zyx, upright))
    assert turned is not None and "upper end cuts" in str(turned)


def test_refusals_state_thick_slices_missing_lungs_and_a_lost_unit() -> None:
    coarse = Volume(np.full((30, 90, 90), -850, dtype=np.int16), np.diag([4.0, 4.0, 5.0, 1.0]))
    assert "slices of the second CT are 5.0 mm apart" in str(few_forks(1, coarse))
    assert "apart" not in str(few_forks(1, second()))
    head = Volume(np.full((30, 90, 90), 40, dtype=np.int16), coarse.lps_from_ijk)
    assert "shows no lungs" in str(no_airways(head)) and "mark the trachea" in str(no_airways(coarse))
    assert "not in Hounsfield units" in str(no_airways(dataclasses.replace(head, is_hu=False)))


def sloped_lung(slope_hu_per_mm: float) -> Volume:
    """Return a block of lung whose density rises to the back."""
    rng = np.random.default_rng(1)
    y = 2.0 * np.arange(100) - 100.0
    values = -830.0 + slope_hu_per_mm * y[None, :, None] + rng.normal(0.0, 20.0, (80, 100, 90))
    return Volume(values.astype(np.int16), np.diag([2.0, 2.0, 2.0, 1.0]))


def test_prone_patient_is_recognised_by_the_denser_side_of_the_lung() -> None:
    supine, prone = sloped_lung(0.5), sloped_lung(-0.5)
    assert density_slope(supine) == pytest.approx(0.5, abs=0.1)
    check_gravity(supine, supine)
    check_gravity(supine, sloped_lung(-0.05))
    with pytest.raises(NoResultError, match="second CT the front of the lungs is denser") as raised:
        check_gravity(supine, prone)
    assert raised.value.code == "movement.pose"


def test_cts_with_too_few_equally_named_forks_are_refused() -> None:
    tree = second_airways().tree
    bare = tuple(
        one if one.id < 3 else dataclasses.replace(one, name=None, name_from=None, name_confidence=None)
        for one in tree.branches
    )
    airways = dataclasses.replace(second_airways(), tree=dataclasses.replace(tree, branches=bare))
    error = refusal(second(), airways)
    assert error.code == "movement.few-forks" and "the same name in both CTs" in str(error)


def test_forks_with_doubtful_names_are_not_matched_between_two_cts() -> None:
    tree = second_airways().tree
    names, here, there = named_forks(found_airways(chest().volume).tree, tree)
    assert len(names) == len(here) == len(there) >= 12
    doubtful = tuple(
        dataclasses.replace(one, name_confidence=0.3) if one.name == names[3] else one for one in tree.branches
    )
    fewer, _, _ = named_forks(found_airways(chest().volume).tree, dataclasses.replace(tree, branches=doubtful))
    assert set(names) - set(fewer) == {names[3]}


def test_forks_with_swapped_names_do_not_affect_the_fitted_motion() -> None:
    rng = np.random.default_rng(3)
    here = rng.uniform(-90.0, 90.0, (30, 3))
    there = here + np.array([2.0, 1.0, 9.0]) + 0.05 * (here * [0.0, 0.0, 1.0])
    there[[4, 9]] = there[[9, 4]]
    rigid, fits = rigid_fit(here, there)
    assert not fits[[4, 9]].any() and fits.sum() == 28
    motion = affine_fit(here[fits], there[fits], rigid)
    off = np.linalg.norm(here[fits] + motion.shifts(here[fits]) - there[fits], axis=1)
    assert off.max() < 0.5 and rotation_deg(motion) < 1.0


def test_predicted_shift_at_an_excluded_point_does_not_depend_on_its_measured_shift() -> None:
    rng = np.random.default_rng(4)
    places = rng.uniform(-40.0, 40.0, (60, 3))
    shifts = 0.001 * places**2
    changed = shifts.copy()
    changed[7] += 50.0
    still = Affine(np.eye(3), np.zeros(3))
    before, after = (Deformation(places, one, still).at(places[7:8], beyond_mm=0.1) for one in (shifts, changed))
    assert before == pytest.approx(after)
    assert np.linalg.norm(Deformation(places, shifts, still).at(places) - shifts, axis=1).max() < 1.5


def test_measurement_of_movement_can_be_cancelled() -> None:
    first = chest().volume
    with pytest.raises(CancelledError):
        measure_movement(
            first, found_airways(first), place(), second(), second_airways(), progress=False, cancel=lambda: True
        )


def test_plan_uses_the_measured_movement_instead_of_the_default() -> None:
    volume = chest().volume
    airways = found_airways(volume)
    default = plan_route(volume, airways, place(), drives=0)
    plan = plan_route(volume, airways, place(), movement=measured(), drives=0)
    assert default.movement.origin == "default" and default.movement.most_mm in {15.0, 20.0}
    assert plan.movement == measured().movement
    assert plan.moved_mm == pytest.approx(measured().movement.length_mm + measured().movement.error_mm)
    assert plan.to_json()["movement"]["words"].startswith("Movement of the target measured from the second CT: ")
    assert plan_route(volume, airways, place(), moved_mm=7.0, drives=0).movement == TargetMovement("given", 7.0)
    first, other = plan.routes[0].leg, default.routes[0].leg
    assert first.hit_share == other.hit_share and first.hit_share_moved > other.hit_share_moved
    with pytest.raises(UsageError, match="found both"):
        plan_route(volume, airways, place(), moved_mm=7.0, movement=measured(), drives=0)


def test_hit_share_with_a_measured_shift_is_between_those_of_start_and_end_position() -> None:
    nodule = ellipsoid((6.0, 6.0, 6.0), (0.0, 0.0, 0.0))
    tip, aim = np.array([-20.0, 0.0, 0.0]), np.zeros(3)
    still = hit_share(nodule, tip, aim, 40.0, NeedleErrors())
    small = hit_share(nodule, tip, aim, 40.0, NeedleErrors(), moved_mm=0.1, shift_lps=(0.0, 0.0, 1.0))
    far = hit_share(nodule, tip, aim, 40.0, NeedleErrors(), moved_mm=0.1, shift_lps=(0.0, 0.0, 24.0))
    assert small == pytest.approx(still, abs=0.03)
    # The nodule is on the line of the needle along about a quarter of the shift.
    assert 0.15 < far < 0.4


def test_default_movement_is_larger_in_lower_lobes_and_if_the_lobe_is_unknown() -> None:
    assert [default_movement(lobe).most_mm for lobe in ("RLL", "LLL", None, "RUL")] == [20.0, 20.0, 20.0, 15.0]
    assert default_movement("RUL").words.startswith("CT taken at inspiration")


def test_movement_text_states_direction_error_and_reference_point() -> None:
    assert shift_words((0.3, -0.2, -9.0)) == "9 mm down"
    assert shift_words((0.0, -5.0, 9.0)) == "10 mm (9 mm up, 5 mm to the front)"
    assert shift_words((0.1, 0.2, 0.3)) == "less than 1 mm"
    movement = TargetMovement.measured((0.0, 0.0, -9.0), 3.0)
    assert movement.words == (
        "Movement of the target measured from the second CT: 9 mm down, \u00b1 3 mm relative to the main carina"
    )
    assert movement.most_mm == 12.0
    with pytest.raises(UsageError):
        TargetMovement("measured", 5.0)
    with pytest.raises(UsageError):
        TargetMovement("default", 5.0, (0.0, 0.0, 1.0), 1.0)
