"""Forces of random drives of every instrument: within the limits, and felt at walls.

`make soak` uses 1,000 drives in the phantom and 1,000 in the patient; `make test` uses a few in the phantom.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from lumen_cells import lattice_of
from numpy.typing import NDArray
from random_drive_inputs import DT_S, kind_of, random_samples, scope_of

import carina
from cached_test_data import patient as made_patient
from carina.phantom import generate_phantom, lumen_distance_at
from carina.scopes import ScopeDrive, ScopeState, WallField
from carina_haptics import FORCE_LIMIT_N, FORCE_SLEW_N_PER_MS, MAX_STIFFNESS_N_PER_MM, ForceLaw, forces_along

SEED = 3
LOW, HIGH = np.array([-70.0, -50.0, -90.0]), np.array([70.0, 50.0, 112.0])

Floats = NDArray[np.float64]
Lumen = tuple[WallField, Floats, list[Floats]]
"""Wall, path of the trachea, routes from the root to each end."""


@pytest.fixture(scope="module")
def chest() -> Lumen:
    """Return the phantom's wall and paths, without voxels of the whole chest."""
    truth = generate_phantom(seed=SEED, spacing_mm=9.0, noise_hu=0.0).truth
    branches: dict[int, dict[str, Any]] = {b["id"]: b for b in truth["branches"]}

    def path_to(branch_id: int) -> Floats:
        points: list[list[float]] = []
        at: int | None = branch_id
        while at is not None:
            points = branches[at]["points"][: None if not points else -1] + points
            at = branches[at]["parent"]
        return np.array(points)

    spacing = (0.6, 0.55, 0.65)
    shape = tuple(int(n) for n in np.ceil((HIGH - LOW) / spacing)[::-1])
    matrix = np.diag([*spacing, 1.0])
    matrix[:3, 3] = LOW
    distances = lattice_of(lambda p: -lumen_distance_at(p, seed=SEED), LOW, spacing, shape)
    routes = [path_to(b["id"]) for b in branches.values() if not b["children"]]
    return WallField.from_distances(distances, matrix), path_to(0), routes


@pytest.fixture(scope="module")
def patient() -> Lumen:
    """Return the wall and the paths of the bundled patient."""
    volume, airways = made_patient()
    tree = airways.tree
    routes = [tree.route_to(tip.id).points_lps for tip in tree.tips()]
    return carina.wall_field(volume, airways), tree.root.points, routes


def driven_states(lumen: Lumen, run: int, num_samples: int) -> list[ScopeState]:
    """Return the states of one random drive."""
    wall, trachea, routes = lumen
    rng = np.random.default_rng([5, run])
    drive = ScopeDrive(wall, scope_of(run), trachea)
    route = routes[rng.integers(len(routes))]
    # Many drives start at the deepest position.
    deep_mm = 400.0 if rng.uniform() < 0.4 else rng.uniform(0.0, 260.0)
    return [drive.place(route, deep_mm), *random_samples(kind_of(run), drive, rng, num_samples)]


def hand_samples(states: list[ScopeState]) -> Floats:
    """Return samples (n, 9), one per millisecond, of a hand that presses as deep as the contact, then releases."""
    at = np.array([_hand_position(state) for state in states])
    forward = np.array([state.pose.lps_from_camera[:3, 2] for state in states])
    ticks = round(1000.0 * DT_S)
    share = np.linspace(0.0, 1.0, ticks, endpoint=False)[:, None]
    moved = np.concatenate([a + share * (b - a) for a, b in itertools.pairwise(at)])
    speed = 1000.0 * np.diff(moved, axis=0, prepend=moved[:1])
    rows = np.concatenate([moved, speed, np.repeat(forward[:-1], ticks, axis=0)], axis=1)
    return np.concatenate([rows, np.full((40, 9), 1e30)])


def _hand_position(state: ScopeState) -> Floats:
    contact = state.contact
    pressed = np.zeros(3) if contact is None else contact.depth_mm * np.array(contact.normal_lps)
    return state.pose.position_lps - pressed


def check_forces(lumen: Lumen, runs: Iterable[int], num_samples: int) -> None:
    """Check that forces stay within the limits, end after the release, and are felt in some drives."""
    largest_n = 0.0
    for run in runs:
        scope = scope_of(run)
        law = ForceLaw(tip_radius_mm=scope.tip_mm / 2.0, stiffness_n_per_mm=MAX_STIFFNESS_N_PER_MM)
        samples = hand_samples(driven_states(lumen, run, num_samples))
        forces = np.concatenate([np.zeros((1, 3)), forces_along(lumen[0], samples, law)])
        drive = f"{scope.name}, {kind_of(run)}, run {run}"
        assert np.isfinite(forces).all(), drive
        assert np.linalg.norm(forces, axis=1).max() <= FORCE_LIMIT_N, drive
        # 1e-9: rounding of a difference of forces of some newtons.
        assert np.linalg.norm(np.diff(forces, axis=0), axis=1).max() <= FORCE_SLEW_N_PER_MS + 1e-9, drive
        assert (forces[-1] == 0.0).all(), drive
        largest_n = max(largest_n, float(np.linalg.norm(forces, axis=1).max()))
    assert largest_n > 0.3


@pytest.mark.slow
def test_forces_of_random_drives_are_within_the_limits(chest: Lumen) -> None:
    check_forces(chest, range(8), num_samples=40)


@pytest.mark.soak
def test_forces_of_a_thousand_random_drives_are_within_the_limits(chest: Lumen) -> None:
    check_forces(chest, range(1000), num_samples=40)


@pytest.mark.soak
def test_forces_of_a_thousand_random_drives_in_a_patient_are_within_the_limits(patient: Lumen) -> None:
    check_forces(patient, range(1000), num_samples=25)
