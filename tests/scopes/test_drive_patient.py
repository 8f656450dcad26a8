"""The scope in a patient's airways, checked against the iso-surface of the CT at a quarter of a voxel."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from drive_checks import shaft_balls, tip_surface_lps
from numpy.typing import NDArray

import carina
from carina.scopes import ScopeDrive
from carina.track import Mesh, lumen_mesh

pytestmark = pytest.mark.soak
NUM_SAMPLES = 25
SCOPES = ("standard", "ultrathin", "thin", "therapeutic", "diagnostic", "single-use-slim")


def fine_points(mesh: Mesh, apart_mm: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points on a mesh, no farther apart than that, with the normals of their triangles (out of the lumen)."""
    corners = mesh.vertices_lps[mesh.triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    corners = corners[np.linalg.norm(across, axis=1) > 1e-9]
    while True:
        edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
        if edges.max() <= apart_mm:
            break
        long = edges.max(axis=1) > apart_mm
        a, b, c = np.moveaxis(corners[long], 1, 0)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        quarters = [np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        corners = np.concatenate([corners[~long], *quarters])
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return corners.mean(axis=1), across / np.linalg.norm(across, axis=1)[:, None]


def test_a_thousand_random_drives_stay_in_the_patients_lumen() -> None:
    check_patient(1000)


def check_patient(num_drives: int) -> tuple[float, float]:
    spatial: Any = pytest.importorskip("scipy.spatial", reason="needs scipy (make bench-setup)")
    volume = carina.demo_patient()
    airways = carina.find_airways(volume)
    field = carina.wall_field(volume, airways)
    points, normals = fine_points(lumen_mesh(volume, airways), 0.25 * min(volume.spacing_mm))
    wall = spatial.cKDTree(points)

    def outside_mm(of: NDArray[np.float64]) -> NDArray[np.float64]:
        """How far beyond the wall points are, by the nearest of its points; below 0 inside."""
        _, nearest = wall.query(of, k=4)
        # At a ridge the nearest triangles see a point from two sides: in the wall is what all of them have behind them.
        heights = np.einsum("nka,nka->nk", of[:, None] - points[nearest], normals[nearest])
        return heights.min(axis=1)

    tree = airways.tree
    tips, root = tree.tips(), tree.root
    rng = np.random.default_rng(7)
    worst_tip = worst_shaft = -9.0
    travels_mm, num_touched = [], 0
    for run in range(num_drives):
        drive = ScopeDrive(field, SCOPES[run % len(SCOPES)], root.points)
        route = tree.route_to(tips[rng.integers(len(tips))].id)
        state = drive.place(route.points_lps, rng.uniform(0.0, 260.0))
        low, high = drive.flexion_range_rad
        push, roll, flexion = rng.normal(0.3, 0.6), 0.0, 0.0
        places, touched = [state.pose.position_lps], False
        for n in range(NUM_SAMPLES):
            roll += rng.normal(0.0, 0.1)
            flexion = float(np.clip(0.98 * flexion + rng.normal(0.0, 0.1), low, high))
            state = drive.drive(state.insertion_mm + push + rng.normal(0.0, 0.8), roll, flexion, 1 / 60)
            assert np.isfinite(state.pose.lps_from_camera).all()
            places.append(state.pose.position_lps)
            touched |= state.contact is not None
            # A quarter of the states, others in every run, and the last.
            if (n + run) % 4 and n < NUM_SAMPLES - 1:
                continue
            # Drawn back to the entry, nothing of it is inside; were that so in all runs, the worst would stay at -9.
            worst_tip = max([worst_tip, *outside_mm(tip_surface_lps(drive))])
            axis, radius = shaft_balls(drive)
            far, _ = wall.query(axis)
            worst_shaft = max([worst_shaft, *(radius - np.where(outside_mm(axis) < 0.0, far, -far))])
        travels_mm.append(float(np.linalg.norm(places[-1] - places[0])))
        num_touched += touched
    print(f"deepest in the wall: tip {worst_tip:.3f} mm, shaft {worst_shaft:.3f} mm")
    print(f"median travel {np.median(travels_mm):.1f} mm, {num_touched} of {num_drives} touched")
    assert -9.0 < worst_tip <= 0.1
    assert -9.0 < worst_shaft <= 0.5
    assert np.median(travels_mm) > 5.0
    assert num_touched > 0.5 * num_drives
    return worst_tip, worst_shaft
