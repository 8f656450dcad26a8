"""Tests of the outline of the lumen in a plane: against a synthetic chest, the voxels of the mask, and after edits."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from carina.errors import GeometryError
from carina.track import LumenOutline, PaintLumen, edit_airways

SIZE = 400


def plane(normal, middle_lps, mm_per_px, size=SIZE):
    """Return the matrix ``lps_from_pixel`` of a square picture in the plane of a normal and a middle."""
    normal = np.asarray(normal, dtype=np.float64) / np.linalg.norm(normal)
    right = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    right /= np.linalg.norm(right)
    down = np.cross(normal, right)
    matrix = np.eye(4)
    matrix[:3, :3] = np.column_stack([right * mm_per_px, down * mm_per_px, normal])
    matrix[:3, 3] = np.asarray(middle_lps) - size / 2 * (matrix[:3, 0] + matrix[:3, 1])
    return matrix


def points_lps(lines, matrix):
    """Return points (n, 3) along the lines, at most a fifth of a pixel apart, LPS mm."""
    places = []
    for line in lines:
        steps = np.linalg.norm(np.diff(line, axis=0), axis=1)
        for start, end, length in zip(line[:-1], line[1:], steps, strict=True):
            t = np.linspace(0.0, 1.0, max(int(length * 5), 2))[:, None]
            places.append(start + t * (end - start))
    flat = np.concatenate(places)
    return flat @ matrix[:3, :2].T + matrix[:3, 3]


def half_voxel_mm(volume, directions):
    """Return half the extent of a voxel along each direction (n, 3), mm."""
    axes = volume.lps_from_ijk[:3, :3] / np.linalg.norm(volume.lps_from_ijk[:3, :3], axis=0)
    along = np.abs(directions @ axes)
    return 0.5 / np.max(along / np.asarray(volume.spacing_mm), axis=1)


def planes_through_airways(chest, count):
    """Return planes at any angle through points in the tubes."""
    random = np.random.default_rng(3)
    for _ in range(count):
        start, end, radius = chest.tubes[random.integers(len(chest.tubes))]
        middle = start + random.uniform(0.2, 0.8) * (end - start)
        yield plane(random.normal(size=3), middle, random.uniform(0.03, 0.2)), radius


def test_lumen_outline_on_any_plane_is_within_half_a_voxel_of_the_true_wall(chest, found):
    outline = LumenOutline(chest.volume, found)
    offs = []
    for matrix, _ in planes_through_airways(chest, 60):
        lines = outline.lines(matrix, SIZE, SIZE)
        places = points_lps(lines, matrix) if lines else np.empty((0, 3))
        depth = chest.depth_mm(places)
        # The direction to the wall is the gradient of the true distance.
        step = 1e-3
        slope = np.stack([(chest.depth_mm(places + step * e) - depth) / step for e in np.eye(3)], axis=1)
        slope /= np.linalg.norm(slope, axis=1, keepdims=True)
        ends = np.stack([np.linalg.norm(places - end, axis=1) - radius for _, end, radius in chest.tubes[3:]])
        # At the drawn ends of the tubes the found lumen may end earlier, and at forks two walls are blurred into one.
        walls = np.sort([off_tube(places, *tube) for tube in chest.tubes], axis=0)
        clear = (walls[1] > 3.0) & (ends > 6.0).all(axis=0) & inside_by(chest.volume, places, 4.0)
        offs.append((np.abs(depth) / half_voxel_mm(chest.volume, slope))[clear])
    offs = np.concatenate(offs)
    assert len(offs) > 5_000
    assert offs.max() <= 1.0, f"{offs.max():.2f} half voxels"
    assert np.median(offs) < 0.35


def off_tube(points, start, end, radius):
    along = np.clip((points - start) @ (end - start) / ((end - start) @ (end - start)), 0.0, 1.0)
    return np.linalg.norm(points - start - along[..., None] * (end - start), axis=-1) - radius


def inside_by(volume, points, margin_mm):
    """Return for each point whether it is inside the volume by more than ``margin_mm``."""
    ijk = volume.to_ijk(points)
    margin = margin_mm / np.asarray(volume.spacing_mm)
    return ((ijk > margin) & (ijk < np.array(volume.shape_zyx[::-1]) - 1 - margin)).all(axis=1)


def sides(lumen_zyx, ijk):
    """Return whether lumen voxels, and whether other voxels, are within half a voxel of each position (n, 3)."""
    nearest = np.rint(ijk).astype(int)
    found = np.zeros((2, len(ijk)), dtype=bool)
    shape = np.array(lumen_zyx.shape[::-1])
    for offset in np.stack(np.meshgrid(*[[-1, 0, 1]] * 3), axis=-1).reshape(-1, 3):
        voxel = nearest + offset
        off = np.linalg.norm(np.maximum(np.abs(ijk - voxel) - 0.5, 0.0), axis=1)
        held = ((voxel >= 0) & (voxel < shape)).all(axis=1)
        i, j, k = np.clip(voxel, 0, shape - 1).T
        is_lumen = held & (lumen_zyx[k, j, i] != 0)
        found[0] |= is_lumen & (off <= 0.5)
        found[1] |= ~is_lumen & (off <= 0.5)
    return found


def test_lumen_outline_on_any_plane_separates_mask_voxels_to_half_a_voxel(chest, found):
    outline = LumenOutline(chest.volume, found)
    random = np.random.default_rng(5)
    num_points = 0
    for matrix, _ in planes_through_airways(chest, 25):
        lines = outline.lines(matrix, SIZE, SIZE)
        if not lines:
            continue
        places = points_lps(lines, matrix)
        num_points += len(places)
        assert sides(found.lumen_zyx, chest.volume.to_ijk(places)).all()
        if not all(np.array_equal(line[0], line[-1]) for line in lines):
            continue
        # The outline is complete: points farther than half a voxel from the mask's edge are on the side that the mask
        # states.
        pixels = random.uniform(0, SIZE, (400, 2))
        near = sides(found.lumen_zyx, chest.volume.to_ijk(pixels @ matrix[:3, :2].T + matrix[:3, 3]))
        sure = near[0] != near[1]
        np.testing.assert_array_equal(winds_round(lines, pixels[sure]), near[0][sure])
    assert num_points > 10_000


def winds_round(lines, places):
    turns = np.zeros(len(places), dtype=int)
    for line in lines:
        for (ax, ay), (bx, by) in pairwise(line):
            crosses = (ay <= places[:, 1]) != (by <= places[:, 1])
            if crosses.any():
                right = ax + (places[:, 1] - ay) / (by - ay) * (bx - ax) > places[:, 0]
                turns += np.where(crosses & right, 1 if by > ay else -1, 0)
    return turns != 0


def test_lumen_outline_includes_painted_and_excludes_erased_voxels(chest, found):
    start, end, _ = chest.tubes[3]
    at = tuple(float(v) for v in start + 0.6 * (end - start))
    matrix = plane((0.2, 1.0, 0.1), at, 0.1)
    # The point is 4.2 mm from the axis of a bronchus of 3.2 mm radius, so in its wall.
    aside = np.array([[SIZE / 2 + 42.0, SIZE / 2]])
    aside_lps = tuple(float(v) for v in aside[0] @ matrix[:3, :2].T + matrix[:3, 3])

    def holds(airways):
        lines = LumenOutline(chest.volume, airways).lines(matrix, SIZE, SIZE)
        assert sides(airways.lumen_zyx, chest.volume.to_ijk(points_lps(lines, matrix))).all()
        return bool(winds_round(lines, aside)[0])

    assert not holds(found)
    painted = edit_airways(chest.volume, found, PaintLumen((at,), 5.5, "ball", erase=False))
    assert holds(painted)
    outline = LumenOutline(chest.volume, painted)
    erased = edit_airways(chest.volume, painted, PaintLumen((aside_lps,), 1.5, "ball", erase=True))
    assert not holds(erased)
    # A rename does not change the lumen array, so the outline is not computed again.
    assert outline.lumen_zyx is painted.lumen_zyx


def test_outline_of_the_mask_of_another_tool_is_half_way_between_its_voxels(chest):
    lumen = np.zeros(chest.volume.shape_zyx, dtype=np.uint8)
    lumen[40:50, 30:42, 20:37] = 1
    given = SimpleNamespace(lumen_zyx=lumen, wall_levels=None)
    matrix = chest.volume.lps_from_ijk @ np.array(
        [[0.1, 0, 0, 10], [0, 0.1, 0, 20], [0, 0, 1, 45], [0, 0, 0, 1]], dtype=np.float64
    )
    (line,) = LumenOutline(chest.volume, given).lines(matrix, SIZE, SIZE)
    ijk = line * 0.1 + (10, 20)
    np.testing.assert_allclose(ijk.min(axis=0), (19.5, 29.5), atol=1e-6)
    np.testing.assert_allclose(ijk.max(axis=0), (36.5, 41.5), atol=1e-6)


def test_plane_that_does_not_cut_the_airways_has_no_outline_and_a_singular_matrix_is_refused(chest, found):
    outline = LumenOutline(chest.volume, found)
    corner = chest.volume.to_lps(np.zeros(3))
    assert outline.lines(plane((0, 0, 1), corner, 0.01), SIZE, SIZE) == ()
    assert outline.encoded(plane((0, 0, 1), corner, 0.01), SIZE, SIZE) == b""
    with pytest.raises(GeometryError):
        outline.lines(np.zeros((4, 4)), SIZE, SIZE)
