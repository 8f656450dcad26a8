"""Tests of C-arm angles for a route, against simulated radiographs."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from phantom_plan import airways, plan, volume

from carina.plan import carm
from carina.plan.carm import CARM_LIMITS, CArmAngles, ShadowParts, carm_angles, carm_words, shadow_parts
from carina.render import DrrView
from carina.render.radiograph import cast_drr
from carina.volume import Volume


@cache
def chest() -> Volume:
    """Return the phantom with a spine: a column of bone behind the trachea."""
    made = volume()
    hu = np.array(made.hu_zyx)
    k, j, i = np.indices(hu.shape, sparse=True)
    x, y, _ = (
        made.lps_from_ijk[axis, 0] * i
        + made.lps_from_ijk[axis, 1] * j
        + made.lps_from_ijk[axis, 2] * k
        + made.lps_from_ijk[axis, 3]
        for axis in range(3)
    )
    root = airways().tree.root.points.mean(axis=0)
    hu[np.broadcast_to(np.hypot(x - root[0], y - root[1] - 40.0) < 17.0, hu.shape)] = 400
    return dataclasses.replace(made, hu_zyx=hu)


@cache
def parts() -> ShadowParts:
    return shadow_parts(chest(), airways().tree)


@cache
def angles() -> CArmAngles:
    return carm_angles(chest(), airways(), plan(), shadows=parts())


def dark(points_lps: np.ndarray, radius_mm: float, view: DrrView) -> np.ndarray:
    """Return the pixels of a radiograph of balls of metal in air."""
    made = volume()
    hu = np.full(made.hu_zyx.shape, -1000, dtype=made.hu_zyx.dtype)
    reach = int(np.ceil(radius_mm / min(made.spacing_mm)))
    steps = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    steps = steps[np.linalg.norm(steps * np.array(made.spacing_mm), axis=1) <= radius_mm]
    ijk = np.rint((points_lps - made.lps_from_ijk[:3, 3]) @ np.linalg.inv(made.lps_from_ijk[:3, :3]).T).astype(int)
    for step in steps:
        at = ijk + step
        at = at[((at >= 0) & (at < np.array(hu.shape[::-1]))).all(axis=1)]
        hu[at[:, 2], at[:, 1], at[:, 0]] = 1000
    shown = cast_drr(dataclasses.replace(made, hu_zyx=hu), dataclasses.replace(view, window_mm=(4.0, 2.0)))
    return np.asarray(shown.rgb[:, :, 0] > 100)


def overlap(primary_deg: float, secondary_deg: float) -> tuple[int, int]:
    """Return the numbers of pixels of target and tip that spine or mediastinum cover in the picture."""
    view = DrrView(primary_deg=primary_deg, secondary_deg=secondary_deg, width=256, height=256)
    nodule = plan().nodule
    target = np.array(nodule.centre_lps)
    away = np.linalg.norm(parts().points_lps - target, axis=1) > 0.5 * nodule.long_mm + 4.0
    shadow = dark(parts().points_lps[away], 1.6, view)
    ball = dark(target[None], 0.5 * nodule.long_mm, view)
    tip = dark(np.array([plan().routes[0].leg.tip_lps]), 1.5, view)
    assert ball.any()
    assert tip.any()
    return int((ball & shadow).sum()), int((tip & shadow).sum())


def test_spine_is_found_in_the_ct_and_the_mediastinum_is_between_the_lungs() -> None:
    root = airways().tree.root.points.mean(axis=0)
    assert len(parts().spine_lps) > 1000
    assert np.abs(parts().spine_lps[:, 0] - root[0]).max() < 37.0
    assert parts().spine_lps[:, 1].min() > root[1]
    assert len(parts().mediastinum_lps) > 1000


def test_target_and_tip_are_outside_the_shadows_of_spine_and_mediastinum_at_each_proposed_c_arm_angle() -> None:
    found = angles()
    assert found.why is None
    assert 1 <= len(found.angles) <= 3
    for one in found.angles:
        assert one.suits
        assert overlap(one.primary_deg, one.secondary_deg) == (0, 0)


def test_c_arm_angle_with_the_target_in_a_shadow_is_not_proposed() -> None:
    everywhere = [(p, s) for p in range(-60, 61, 30) for s in (-30, 0, 30)]
    covered = [one for one in everywhere if sum(overlap(*one)) > 0]
    assert covered
    for primary, secondary in covered:
        assert all((one.primary_deg, one.secondary_deg) != (primary, secondary) for one in angles().angles)


def covered_side(side: int) -> ShadowParts:
    """Return shadows that cover the target for a detector at the left (1) or right (-1) of the patient."""
    # Points on the rays from the target to a detector at the patient's left and front (LAO), or right and front (RAO).
    target = np.array(plan().nodule.centre_lps)
    turns, rises = np.radians(np.arange(10.0, 71.0)), np.radians(np.arange(-45.0, 46.0, 2.0))
    turn, rise = (one.ravel() for one in np.meshgrid(turns, rises))
    rays = np.stack([side * np.sin(turn) * np.cos(rise), -np.cos(turn) * np.cos(rise), np.sin(rise)], axis=-1)
    return ShadowParts(target + 40.0 * rays, target[None] + 200.0)


@pytest.mark.parametrize("side", [1, -1], ids=["LAO covered", "RAO covered"])
def test_c_arm_angles_from_a_side_covered_by_the_spine_are_not_proposed(side: int) -> None:
    found = carm_angles(chest(), airways(), plan(), shadows=covered_side(side))
    assert found.angles
    assert all(side * one.primary_deg <= 15.0 for one in found.angles)
    assert any(side * one.primary_deg < -15.0 for one in found.angles)


def test_reason_is_stated_if_no_c_arm_angle_is_clear() -> None:
    target = np.array(plan().nodule.centre_lps)
    tight = target + 25.0 * np.random.default_rng(1).normal(size=(20_000, 3))
    found = carm_angles(chest(), airways(), plan(), shadows=ShadowParts(tight, tight[:0]))
    assert found.angles == ()
    assert found.why is not None
    assert "no C-arm angle within the limits" in found.why
    assert "no spine" not in " ".join(found.notes)


def test_plan_notes_that_no_spine_was_found() -> None:
    found = carm_angles(chest(), airways(), plan(), shadows=ShadowParts(parts().spine_lps[:0], parts().mediastinum_lps))
    assert "no spine was found" in found.notes[0]


@pytest.mark.parametrize(
    ("at", "primary", "secondary", "right", "down"),
    [
        ((60, 0, 0), 0, 0, 1, 0),  # patient left is on screen right in the AP view
        ((0, -60, 0), 30, 0, -1, 0),  # LAO: an anterior marker moves to the screen's left, the spine to its right
        ((0, 60, 0), 30, 0, 1, 0),
        ((0, 60, 0), -30, 0, -1, 0),  # RAO: the spine moves to the screen's left
        ((0, 0, 60), 0, 0, 0, -1),  # the head is up
        ((0, -60, 0), 0, 25, 0, 1),  # cranial: the detector is nearer to the head, so an anterior marker moves down
        ((0, -60, 0), 0, -25, 0, -1),
    ],
)
def test_marker_in_the_fluoroscopy_picture_is_on_the_side_expected_for_a_supine_patient(
    at: tuple[int, int, int], primary: int, secondary: int, right: int, down: int
) -> None:
    view = DrrView(primary_deg=primary, secondary_deg=secondary, width=200, height=200, mm_per_px=1.5)
    marker = np.array([volume().centre_lps + np.array(at)])
    (y, x) = np.argwhere(dark(marker, 4.0, view)).mean(axis=0)
    (place,), _ = carm.projected_mm(volume(), view, marker)
    assert (x - 99.5, y - 99.5) == (pytest.approx(place[0] / 1.5, abs=1.0), pytest.approx(place[1] / 1.5, abs=1.0))
    assert np.sign(np.round((x - 99.5) / 5.0)) == right
    assert np.sign(np.round((y - 99.5) / 5.0)) == down


def test_c_arm_angles_are_named_as_in_fluoroscopy() -> None:
    assert carm_words(30, 10) == "LAO 30\u00b0, cranial 10\u00b0"
    assert carm_words(-45, -20) == "RAO 45\u00b0, caudal 20\u00b0"
    assert "usual limits without a published source" in CARM_LIMITS
    assert angles().to_json()["limits"] == CARM_LIMITS


def stored_otherwise(made: Volume, turn_deg: float, *, is_flipped: bool) -> Volume:
    """Return the same patient on another grid: turned about the long axis, or with the columns in reverse order."""
    (nz, ny, nx), centre = made.shape_zyx, made.centre_lps
    turn = np.radians(turn_deg)
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    axes = rotation @ made.lps_from_ijk[:3, :3] @ np.diag([-1.0 if is_flipped else 1.0, 1.0, 1.0])
    matrix = np.eye(4)
    matrix[:3, :3] = axes
    matrix[:3, 3] = centre - axes @ ((np.array([nx, ny, nz]) - 1.0) / 2.0)
    k, j, i = np.meshgrid(np.arange(nz), np.arange(ny), np.arange(nx), indexing="ij")
    lps = np.stack([i, j, k], axis=-1).reshape(-1, 3) @ axes.T + matrix[:3, 3]
    ijk = np.rint((lps - made.lps_from_ijk[:3, 3]) @ np.linalg.inv(made.lps_from_ijk[:3, :3]).T).astype(int)
    inside = ((ijk >= 0) & (ijk < [nx, ny, nz])).all(axis=1)
    at = np.clip(ijk, 0, [nx - 1, ny - 1, nz - 1])
    hu = np.where(inside, made.hu_zyx[at[:, 2], at[:, 1], at[:, 0]], -1000).reshape(nz, ny, nx)
    return Volume(hu.astype(np.int16), matrix)


def coarse(made: Volume) -> Volume:
    """Return every second voxel of a volume along each axis, because spine and mediastinum are found on a 3 mm grid."""
    return Volume(np.ascontiguousarray(made.hu_zyx[::2, ::2, ::2]), made.lps_from_ijk @ np.diag([2.0, 2.0, 2.0, 1.0]))


@pytest.mark.parametrize(("turn_deg", "is_flipped"), [(0.0, True), (12.0, False)], ids=["mirrored", "oblique"])
def test_grid_of_the_ct_does_not_change_the_side_of_the_angles(turn_deg: float, is_flipped: bool) -> None:
    made = stored_otherwise(coarse(chest()), turn_deg, is_flipped=is_flipped)
    assert (np.linalg.det(made.lps_from_ijk[:3, :3]) < 0.0) == is_flipped
    found = carm_angles(made, airways(), plan())
    assert found.angles
    first, expected = found.angles[0], angles().angles[0]
    assert overlap(first.primary_deg, first.secondary_deg) == (0, 0)
    assert abs(first.primary_deg - expected.primary_deg) <= 10.0
    assert abs(first.secondary_deg - expected.secondary_deg) <= 10.0
    covered = carm_angles(made, airways(), plan(), shadows=covered_side(1))
    assert covered.angles
    assert all(one.primary_deg <= 15.0 for one in covered.angles)


@pytest.mark.parametrize(
    ("turn_deg", "is_flipped"), [(0.0, False), (0.0, True), (12.0, False)], ids=["usual", "mirrored", "oblique"]
)
def test_marker_on_the_left_of_the_patient_is_at_the_right_of_the_radiograph_on_any_grid(
    turn_deg: float, is_flipped: bool
) -> None:
    air = Volume(np.full((60, 70, 80), -1000, dtype=np.int16), np.diag([2.5, 2.5, 2.5, 1.0]))
    made = stored_otherwise(air, turn_deg, is_flipped=is_flipped)
    hu = np.array(made.hu_zyx)
    i, j, k = np.rint(made.to_ijk((made.centre_lps + np.array([60.0, 0.0, 0.0]))[None])[0]).astype(int)
    hu[k - 2 : k + 3, j - 2 : j + 3, i - 2 : i + 3] = 1000
    view = DrrView(width=128, height=128, mm_per_px=2.5, window_mm=(4.0, 2.0))
    shown = np.asarray(cast_drr(Volume(hu, made.lps_from_ijk), view).rgb[:, :, 0] > 100)
    assert shown.any()
    assert np.argwhere(shown)[:, 1].mean() == pytest.approx(63.5 + 60.0 / 2.5, abs=2.0)
