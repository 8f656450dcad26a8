"""Tests of the geometry by which random drives are checked: distances to a mesh, and cells inside a lumen."""

from __future__ import annotations

import numpy as np
from drive_checks import Floats
from lumen_cells import LumenCells, lattice_of, points_on
from mesh_distance import MeshDistance, solid_angles


def tube_mesh() -> tuple[Floats, np.ndarray]:
    """Return a closed bent tube with a ridge as a mesh with edges of a few mm, counterclockwise from outside."""
    rows, round_ = 40, 20
    turns = np.linspace(0.0, 2.0 * np.pi, round_, endpoint=False)
    vertices, triangles = [], []
    for row in range(rows):
        radius = 3.0 + 0.8 * np.cos(2.0 * turns) - (1.2 if row == 20 else 0.0)
        middle = 4.0 * np.sin(0.1 * row)
        vertices += [[middle + r * np.cos(t), r * np.sin(t), 1.0 * row] for r, t in zip(radius, turns, strict=True)]
    vertices += [[0.0, 0.0, -0.6], [4.0 * np.sin(3.9), 0.0, 39.6]]
    for row in range(rows - 1):
        for n in range(round_):
            a, b = row * round_ + n, row * round_ + (n + 1) % round_
            triangles += [[a, b, b + round_], [a, b + round_, a + round_]]
    for n in range(round_):
        a, b = n, (n + 1) % round_
        triangles += [[b, a, rows * round_], [a + (rows - 1) * round_, b + (rows - 1) * round_, rows * round_ + 1]]
    return np.array(vertices), np.array(triangles)


def test_mesh_distances_match_densely_sampled_points_and_their_signs_match_the_solid_angle(
    rng: np.random.Generator,
) -> None:
    vertices, triangles = tube_mesh()
    corners = vertices[triangles]
    wall = MeshDistance(vertices, triangles)
    points = vertices[rng.integers(len(vertices), size=300)] + rng.normal(0.0, 0.4, (300, 3))
    found = wall.signed_mm(points)
    dense = points_on(corners, 0.3)
    nearest = np.array([np.linalg.norm(dense - p, axis=1).min() for p in points])
    near = np.isfinite(found)
    assert near.sum() > 200
    # Every point of a triangle with edges of 0.3 mm is within 0.174 mm of its corners.
    assert (np.abs(found[near]) <= nearest[near] + 1e-9).all()
    assert (np.hypot(found[near], 0.174) >= nearest[near] - 1e-9).all()
    assert nearest[~near].min() > 1.2
    inside = solid_angles(points, corners) > 0.5
    assert np.array_equal(found[near] < 0.0, inside[near])


def test_lumen_cells_of_a_mesh_are_inside_the_mesh(rng: np.random.Generator) -> None:
    vertices, triangles = tube_mesh()
    corners = vertices[triangles]
    cells = LumenCells.of_mesh(MeshDistance(vertices, triangles), corners, np.array([[0.0, 0.0, 2.0]]))
    points = rng.uniform(vertices.min(axis=0) - 1.0, vertices.max(axis=0) + 1.0, (800, 3))
    inside = solid_angles(points, corners) > 0.5
    depths = cells.depths_mm(points)
    assert (depths[inside] <= 0.0).all()
    assert (depths[~inside] > 0.0).all()
    # Without seeds the side of each cell that the mesh does not touch is computed separately.
    alone = LumenCells.of_mesh(MeshDistance(vertices, triangles), corners, np.zeros((0, 3)))
    assert np.array_equal(alone.depths_mm(points) > 0.0, ~inside)
    radii = rng.uniform(0.0, 2.0, 800)
    held = cells.holds_balls(points, radii)
    dense = points_on(corners, 0.4)
    for p, r in zip(points[held], radii[held], strict=True):
        assert np.linalg.norm(dense - p, axis=1).min() >= r
    assert held.sum() > 10


def test_sampled_distance_grid_is_exact_near_the_wall() -> None:
    def tube(points: Floats) -> Floats:
        return np.hypot(points[:, 0], points[:, 1]) - 3.0

    low, spacing = np.array([-12.0, -11.0, -9.0]), (0.5, 0.4, 0.6)
    found = lattice_of(tube, low, spacing, (31, 56, 49))
    z, y, x = np.meshgrid(*(np.arange(n) for n in found.shape), indexing="ij")
    truth = tube(low + np.stack([x, y, z], axis=-1).reshape(-1, 3) * spacing).reshape(found.shape)
    near = (truth > -2.5) & (truth < 4.5)
    assert np.allclose(found[near], truth[near], atol=1e-5)
    assert (found[truth <= -2.5] <= -2.5 + 1e-5).all()
    assert (found[truth >= 4.5] >= 4.5 - 1e-5).all()
