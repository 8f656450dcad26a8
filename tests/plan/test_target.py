"""Tests of a target as a value: its record in the case file, refused values, and its aims."""

from __future__ import annotations

import copy
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nodules import ellipsoid

from carina.errors import UsageError
from carina.plan import Nodule, PlanTarget, proposed_aims


def a_target(**changed) -> PlanTarget:
    options = {
        "target_id": "t1",
        "name": "nodule in RB3",
        "nodule": ellipsoid((8.0, 6.0, 5.0)),
        "seed_lps": (3.0, -7.0, 41.0),
        "source": "click",
        "where": "lung",
    }
    return PlanTarget(**{**options, **changed})


def same(one: Nodule, other: Nodule) -> bool:
    return (
        one.to_json() == other.to_json()
        and np.array_equal(one.inside_zyx, other.inside_zyx)
        and np.array_equal(one.lps_from_ijk, other.lps_from_ijk)
    )


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), shape=st.tuples(*[st.integers(1, 9)] * 3))
def test_nodule_is_restored_from_its_record_bit_for_bit(seed, shape):
    rng = np.random.default_rng(seed)
    inside = rng.random(shape) < 0.5
    inside[tuple(rng.integers(0, shape))] = True
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn * rng.uniform(0.3, 1.2), rng.normal(size=3) * 100.0
    x, y, z = rng.normal(size=3) * 100.0
    numbers = [float(v) for v in rng.uniform(1.0, 1e4, 6)]
    made = Nodule(
        (x, y, z), "part-solid", *numbers, -31.7, ("pleura", "vessel"), inside, matrix, ("edited by hand: brush",)
    )
    assert same(Nodule.from_record(json.loads(json.dumps(made.to_record()))), made)


def test_target_is_restored_from_its_record_and_the_record_of_a_large_mass_is_small():
    made = a_target(nodule=ellipsoid((25.0, 25.0, 25.0)), note="PET positive\nbefore surgery", priority=3)
    text = json.dumps(made.to_record())
    assert len(text) < 40_000
    back = PlanTarget.from_record(json.loads(text))
    assert back.to_json() == made.to_json()
    assert same(back.nodule, made.nodule)


@pytest.mark.parametrize(
    ("where", "value"),
    [
        (("version",), 2),
        (("nodule", "version"), 9),
        (("nodule", "shape_zyx"), [4000, 4000, 4000]),
        (("nodule", "shape_zyx"), [3, 3, 3]),
        (("nodule", "shape_zyx"), [-1, -1, 5]),
        (("nodule", "inside"), "AAAA"),
        (("nodule", "inside"), 7),
        (("nodule", "kind"), "benign"),
        (("nodule", "volume_mm3"), float("nan")),
        (("nodule", "lps_from_ijk"), [[0.5, 0, 0, 0], [0, 0.7, 0, 0], [0, 0, 0.5, 0], [0, 0, 0, 1]]),
        (("nodule", "lps_from_ijk"), [[1, 2], [3, 4]]),
        (("nodule", "centre_lps"), [1.0, 2.0]),
        (("where",), "on the moon"),
        (("source",), "guess"),
        (("priority",), 0),
        (("target_id",), ""),
        (("aims_lps",), [[1.0, 2.0]]),
        (("seed_lps",), None),
    ],
)
def test_target_record_with_a_damaged_field_is_refused(where, value):
    record = copy.deepcopy(a_target().to_record())
    inner = record
    for key in where[:-1]:
        inner = inner[key]
    inner[where[-1]] = value
    with pytest.raises(UsageError):
        PlanTarget.from_record(record)
    del inner[where[-1]]
    with pytest.raises(UsageError):
        PlanTarget.from_record(record)


@pytest.mark.parametrize(
    "changed",
    [
        {"target_id": "a b"},
        {"name": "x" * 81},
        {"name": "bell\x07"},
        {"note": "x" * 2001},
        {"priority": 10},
        {"aims": ((3.0, -7.0, 40.0),) * 4},
        {"aims": ((3.0, -7.0, np.nan),)},
        {"seed_lps": (np.inf, 0.0, 0.0)},
    ],
)
def test_target_with_an_invalid_field_is_refused(changed):
    with pytest.raises(UsageError):
        a_target(**changed)


def test_aim_outside_the_target_is_refused_with_its_distance_from_the_target():
    with pytest.raises(UsageError, match=r"aim 2 lies 4\.\d mm outside the target") as error:
        a_target(aims=((3.0, -7.0, 40.0), (15.2, -7.0, 40.0)))
    assert error.value.code == "plan.aims"


def test_proposed_aims_of_a_long_nodule_are_its_middle_and_both_ends():
    nodule = ellipsoid((14.0, 6.0, 5.0))
    middle, near, far = proposed_aims(nodule, near_lps=(40.0, 0.0, 40.0))
    assert middle == pytest.approx(nodule.centre_lps, abs=0.3)
    assert near == pytest.approx((3.0 + 0.65 * 14.0, -7.0, 40.0), abs=1.2)
    assert far == pytest.approx((3.0 - 0.65 * 14.0, -7.0, 40.0), abs=1.2)
    assert a_target(nodule=nodule, aims=(middle, near, far)).aims == (middle, near, far)
    assert len(proposed_aims(ellipsoid((2.5, 2.0, 2.0)))) == 1


def test_proposed_aim_of_a_hollow_nodule_is_in_its_wall():
    whole = ellipsoid((9.0, 9.0, 9.0))
    z, y, x = np.indices(whole.inside_zyx.shape) - (np.array(whole.inside_zyx.shape) // 2)[:, None, None, None]
    hollow = whole.inside_zyx & (np.sqrt(x * x + y * y + z * z) * 0.5 > 5.0)
    made = Nodule(
        whole.centre_lps, "solid", 2000.0, 50.0, 18.0, 18.0, 0.3, 2000.0, 30.0, (), hollow, whole.lps_from_ijk
    )
    assert made.contains([made.middle_lps])[0]
    assert np.linalg.norm(np.array(made.middle_lps) - made.centre_lps) == pytest.approx(6.5, abs=1.0)
    assert a_target(nodule=made).aims == (made.middle_lps,)
    assert all(made.contains([aim])[0] for aim in proposed_aims(made))


def test_target_with_an_edited_boundary_retains_the_aims_that_are_still_inside():
    made = a_target(nodule=ellipsoid((14.0, 6.0, 5.0)))
    made = a_target(nodule=made.nodule, aims=proposed_aims(made.nodule))
    edited = made.with_nodule(ellipsoid((5.0, 5.0, 5.0)))
    assert edited.source == "edited"
    assert (edited.target_id, edited.name) == (made.target_id, made.name)
    assert edited.aims == made.aims[:1]
    gone = made.with_nodule(ellipsoid((5.0, 5.0, 5.0), centre_lps=(60.0, 0.0, 0.0)))
    assert gone.aims == (gone.nodule.centre_lps,)
