"""Tests of a scope that is driven in a lumen; an independent geometry checks that the scope stays inside."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from random_drive_inputs import KINDS, random_samples

from carina.errors import CancelledError, UsageError
from carina.phantom import Phantom, generate_phantom, lumen_distance_at
from carina.scopes import ScopeDrive, WallField, lever_flexion, scope_preset

SEED = 3
Point = list[float]


@pytest.fixture(scope="module")
def chest() -> Phantom:
    # The ground truth is exact at any spacing, and the test does not use the voxels.
    return generate_phantom(seed=SEED, spacing_mm=9.0, noise_hu=0.0)


def sampled(spacing: tuple[float, float, float]) -> WallField:
    """Return the wall field of the exact lumen on a lattice (x, y, z, mm).

    The lattice is computed in slabs, because all points at once take half a gigabyte.
    """
    low, high = np.array([-70.0, -50.0, -90.0]), np.array([70.0, 50.0, 112.0])
    x, y, z = (np.arange(a, b, s) for a, b, s in zip(low, high, spacing, strict=True))
    distance = np.empty((len(z), len(y), len(x)), dtype=np.float32)
    for first in range(0, len(z), 100):
        slab = slice(first, first + 100)
        points = np.stack(np.meshgrid(z[slab], y, x, indexing="ij")[::-1], axis=-1)
        distance[slab] = -lumen_distance_at(points.reshape(-1, 3), seed=SEED).reshape(points.shape[:3])
    matrix = np.diag([*spacing, 1.0])
    matrix[:3, 3] = low
    return WallField.from_distances(distance, matrix)


@pytest.fixture(scope="module")
def field() -> WallField:
    return sampled((0.9, 0.8, 1.0))


def path_to(chest: Phantom, branch_id: int) -> NDArray[np.float64]:
    """Return the path from the root to the end of a branch, LPS mm."""
    branches: dict[int, dict[str, Any]] = {b["id"]: b for b in chest.truth["branches"]}
    points: list[Point] = []
    at: int | None = branch_id
    while at is not None:
        points = branches[at]["points"][: None if not points else -1] + points
        at = branches[at]["parent"]
    return np.array(points)


def test_equal_control_samples_give_scope_poses_that_are_equal_bit_for_bit(chest: Phantom, field: WallField) -> None:
    def run(kind: str) -> list[NDArray[np.float64]]:
        rng = np.random.default_rng(5)
        drive = ScopeDrive(field, "ebus", path_to(chest, 0))
        return [s.pose.lps_from_camera for s in random_samples(kind, drive, rng, 20)]

    for kind in KINDS:
        assert all(np.array_equal(a, b) for a, b in zip(run(kind), run(kind), strict=True)), kind


def test_copied_scope_drive_has_an_equal_pose_and_moves_independently(chest: Phantom, field: WallField) -> None:
    path = path_to(chest, 1)
    one = ScopeDrive(field, "thin", path)
    one.drive(60.0, 0.4, 0.3, 0.1)
    other = one.copy()
    assert np.array_equal(other.state.pose.lps_from_camera, one.state.pose.lps_from_camera)
    before = one.state
    moved = other.drive(80.0, 0.4, 0.9, 0.1)
    assert one.state is before and len(one.shaft_lps()) < len(other.shaft_lps())
    again = one.drive(80.0, 0.4, 0.9, 0.1)
    assert np.array_equal(again.pose.lps_from_camera, moved.pose.lps_from_camera)
    assert np.array_equal(one.shaft_lps(), other.shaft_lps())


def test_scope_too_thick_for_the_airway_stops_and_reports_the_diameter_that_passes(
    chest: Phantom, field: WallField
) -> None:
    by_name = {b["name"]: b for b in chest.truth["branches"]}
    path = path_to(chest, by_name["RB10"]["id"])
    drive = ScopeDrive(field, "therapeutic", path_to(chest, 0))
    state = drive.place(path, 400.0)
    assert state.limit == "narrow"
    assert state.passable_mm is not None
    assert 1.0 < state.passable_mm < 6.04
    thin = ScopeDrive(field, "ultrathin", path_to(chest, 0))
    assert thin.place(path, 400.0).insertion_mm > state.insertion_mm + 5.0


def test_insertion_depth_is_measured_from_the_start_of_the_path(chest: Phantom, field: WallField) -> None:
    path = path_to(chest, 0)
    drive = ScopeDrive(field, "standard", path)
    assert drive.state.insertion_mm == drive.entry_mm < 8.0
    state = drive.drive(50.0, 0.0, 0.0, 0.1)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    there = [np.interp(50.0, along, path[:, a]) for a in range(3)]
    # The trachea is curved; a stiff scope leaves its centreline by less than the radius.
    assert float(np.linalg.norm(state.pose.position_lps - there)) < 7.0
    assert state.limit == "none"
    assert drive.drive(-5.0, 0.0, 0.0, 0.1).limit == "entry"


def test_depth_is_measured_from_the_vocal_cords_and_a_facing_operator_sees_a_rotated_picture(
    chest: Phantom, field: WallField
) -> None:
    path = path_to(chest, 0)
    # The vocal cords are 12 mm above the scan.
    head = ScopeDrive(field, "standard", path, cords_mm=-12.0)
    facing = ScopeDrive(field, "standard", path, operator="facing")
    a, b = head.drive(40.0, 0.0, 0.0, 0.1), facing.drive(40.0, 0.0, 0.0, 0.1)
    assert head.depth_from_cords_mm == pytest.approx(52.0)
    assert facing.depth_from_cords_mm is None
    # Anterior is up for an operator at the head end and down for one who faces the patient; the position of the tip is
    # equal.
    assert a.pose.lps_from_camera[1, 1] > 0.9
    assert b.pose.lps_from_camera[1, 1] < -0.9
    for _ in range(3):
        assert np.array_equal(a.pose.lps_from_camera[:3, 2:], b.pose.lps_from_camera[:3, 2:])
        assert np.array_equal(a.pose.lps_from_camera[:3, :2], -b.pose.lps_from_camera[:3, :2])
        # The same is true for a bent tip, which would swing to the other side if the instrument were rotated.
        a, b = (drive.drive(48.0, 0.4, 0.8, 0.1) for drive in (head, facing))
    b = facing.set_operator("head")
    assert facing.state is b
    assert np.array_equal(b.pose.lps_from_camera, a.pose.lps_from_camera)
    for name in ("insertion_mm", "roll_rad", "flexion_rad", "contact", "record"):
        assert getattr(b, name) == getattr(a, name), name
    with pytest.raises(UsageError, match="expected one of head, facing"):
        facing.set_operator("above")  # type: ignore[arg-type]
    with pytest.raises(UsageError):
        ScopeDrive(field, "standard", path, cords_mm=math.nan)


def test_tip_pressed_against_a_wall_reports_contact_and_a_red_picture(chest: Phantom, field: WallField) -> None:
    drive = ScopeDrive(field, "standard", path_to(chest, 0))
    drive.drive(60.0, 0.0, 0.0, 0.1)
    assert drive.state.contact is None
    for _ in range(30):
        state = drive.drive(60.0, 0.0, math.radians(130), 0.1)
    assert state.contact is not None
    assert state.contact.depth_mm > 1.0
    assert state.record.count >= 1
    assert state.record.time_s == pytest.approx(3.0, abs=0.2)
    touched = lumen_distance_at([state.contact.point_lps], seed=SEED)[0]
    assert abs(touched) < 0.3
    assert state.flexion_rad == math.radians(130)
    # After release the tip touches the curved wall of the trachea at most, without pressure.
    released = drive.drive(60.0, 0.0, 0.0, 0.1).contact
    assert released is None or released.depth_mm < 0.3


def test_lever_at_each_end_gives_the_flexion_limit_of_its_side() -> None:
    stops = (-math.radians(130), math.radians(180))
    assert lever_flexion(1.0, stops) == stops[1]
    assert lever_flexion(-1.0, stops) == stops[0]
    assert lever_flexion(1.0, stops, invert=True) == stops[0]
    assert lever_flexion(9.0, stops) == stops[1]
    with pytest.raises(UsageError):
        lever_flexion(math.nan, stops)


def test_invalid_control_samples_paths_and_wall_fields_are_refused(chest: Phantom, field: WallField) -> None:
    drive = ScopeDrive(field, "standard", path_to(chest, 0))
    before = drive.drive(30.0, 0.1, 0.2, 0.1)
    for bad in ((math.nan, 0, 0, 0.1), (0, math.inf, 0, 0.1), (0, 0, math.nan, 0.1), (0, 0, 0, -1.0)):
        with pytest.raises(UsageError) as refused:
            drive.drive(*bad)
        assert refused.value.code == "scope.drive"
    assert drive.state is before
    with pytest.raises(UsageError):
        ScopeDrive(field, "standard", [[0.0, 0.0, 0.0]])
    with pytest.raises(UsageError):
        ScopeDrive(field, "standard", np.zeros((4, 2)))
    thick = dataclasses.replace(scope_preset("therapeutic"), tube_mm=None)
    thinnest = min(chest.truth["branches"], key=lambda b: float(max(b["radius"][3:])))
    with pytest.raises(UsageError, match=r"6\.0 mm wide"):
        ScopeDrive(field, thick, thinnest["points"][3:])
    with pytest.raises(UsageError) as refused:
        WallField.from_distances(np.full((4, 5, 6), np.nan, dtype=np.float32), np.eye(4))
    assert refused.value.code == "usage.range"


def test_computation_of_a_wall_field_can_be_cancelled() -> None:
    corners = np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]], dtype=np.float64)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.uint32)
    made = WallField.from_mesh(corners, faces, spacing_mm=0.3)
    assert made.distance_mm([[1.0, 2.0, 2.0], [-1.0, 2.0, 2.0]]) == pytest.approx([1.0, -1.0], abs=0.05)
    with pytest.raises(CancelledError):
        WallField.from_mesh(4.0 * corners, faces, spacing_mm=0.15, cancel=lambda: True)
