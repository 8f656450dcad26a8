"""Tests of the painter of ``carina bench track``: contrast of thin lumens, continuity, noise, kernels and slices."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from carina_bench.paint import KERNELS, PaintOptions, Scene, paint
from carina_bench.paint_tubes import Tube, wall_mm

VOXEL = 0.55
LUNG = -860
QUIET = PaintOptions(noise_hu=0.0)
# The blur is equal in all directions, so that one formula is valid for all directions.
EVEN = replace(QUIET, slice_sigma_mm=KERNELS["medium"].sigma_mm)


def share_of_disc(radius: float, off: np.ndarray | float, sigma: float) -> np.ndarray:
    """Return the share of a long round tube after a Gaussian blur, at the distance ``off`` (mm) from its axis.

    On the axis the share is 1 - exp(-r^2 / 2 s^2).
    """
    t = (np.arange(400) + 0.5) * radius / 400
    rho = np.atleast_1d(np.asarray(off, float))[:, None]
    ring = t * np.exp(-((t - rho) ** 2) / (2 * sigma**2)) * scaled_bessel(t * rho / sigma**2) / sigma**2
    return ring.sum(axis=1) * radius / 400


def scaled_bessel(x: np.ndarray) -> np.ndarray:
    return np.i0(x) * np.exp(-x)


def predicted(radius: float, off: np.ndarray | float, sigma: float) -> np.ndarray:
    """Return the expected HU of lumen, wall and lung at the distance ``off`` from the axis of an airway, mm.

    A voxel of width h adds the variance h^2 / 12 to the blur.
    """
    wide = math.sqrt(sigma**2 + VOXEL**2 / 12.0)
    lumen, outer = (share_of_disc(r, off, wide) for r in (radius, radius + float(wall_mm(np.array(radius)))))
    return -1000.0 * lumen + 20.0 * (outer - lumen) + LUNG * (1.0 - outer)


def straight(diameter_vox: float, offset_vox: tuple[float, ...], direction: tuple[float, ...], size: int = 26):
    """Return a scene with one tube near its middle, and a point and the direction of the tube's axis."""
    middle = (0.5 * (size - 1) + np.array(offset_vox)) * VOXEL
    along = np.array(direction) / np.linalg.norm(direction)
    points = middle + np.linspace(-size, size, 41)[:, None] * along
    tube = Tube(points, np.full(41, 0.5 * diameter_vox * VOXEL))
    return empty(size, tube), middle, along


def empty(size: int, *tubes: Tube) -> Scene:
    return Scene(np.full((size,) * 3, LUNG, np.int16), np.diag([VOXEL, VOXEL, VOXEL, 1.0]), tubes)


def from_axis(painted, middle: np.ndarray, along: np.ndarray, reach_mm: float = 4.5):
    """Return the distance (n,) from the axis, the HU and the position along the axis of voxels near the middle."""
    places = painted.volume.to_lps(np.argwhere(painted.volume.hu_zyx > -9999)[:, ::-1].astype(float)) - middle
    at = places @ along
    off = np.linalg.norm(places - at[:, None] * along, axis=1)
    near = (np.abs(at) < reach_mm) & (off < 0.87 * VOXEL)
    return off[near], painted.volume.hu_zyx.ravel()[near].astype(float), at[near]


def test_formula_of_a_blurred_disc_equals_a_numerical_integral():
    for radius in (0.2, 0.55, 1.3):
        assert share_of_disc(radius, 0.0, 0.43)[0] == pytest.approx(
            1 - math.exp(-(radius**2) / (2 * 0.43**2)), abs=1e-4
        )


@pytest.mark.parametrize("diameter_vox", [1.0, 1.5, 2.0])
@pytest.mark.parametrize(
    ("offset_vox", "direction"),
    [
        ((0.5, 0.5, 0.0), (0, 0, 1)),
        ((0.0, 0.0, 0.0), (0, 0, 1)),
        ((0.3, 0.1, 0.2), (1, 0, 0)),
        ((0.5, 0.0, 0.25), (1, 1, 0)),
        ((0.1, 0.4, 0.3), (1, 2, 3)),
        ((0.0, 0.25, 0.0), (-3, 1, 1)),
    ],
)
def test_thin_lumen_has_the_contrast_that_the_blur_predicts(diameter_vox, offset_vox, direction):
    scene, middle, along = straight(diameter_vox, offset_vox, direction)
    off, hu, _ = from_axis(paint(scene, EVEN), middle, along)
    expected = predicted(0.5 * diameter_vox * VOXEL, off, EVEN.scanner().sigma_mm)
    nearest = off <= off.min() + 0.1 * VOXEL
    assert abs(hu[nearest].min() - expected[nearest].min()) <= 10.0
    assert np.abs(hu - expected).max() <= 10.0


@pytest.mark.parametrize("kernel", ["soft", "medium", "sharp"])
def test_each_kernel_shows_a_lumen_along_z_as_its_formula_predicts(kernel):
    scene, middle, along = straight(2.0, (0.5, 0.5, 0.0), (0, 0, 1))
    options = replace(QUIET, kernel=kernel)
    off, hu, _ = from_axis(paint(scene, options), middle, along)
    one = options.scanner()
    expected = predicted(VOXEL, off, one.sigma_mm)
    gain = one.gain(VOXEL)
    expected = expected + gain * (expected - predicted(VOXEL, off, math.hypot(one.sigma_mm, one.surround_mm)))
    # Edge enhancement increases the error of the formula, which approximates a box by a Gaussian.
    assert np.abs(hu - expected).max() <= (15.0 if kernel == "sharp" else 10.0)


def test_values_along_a_painted_tube_one_voxel_wide_vary_by_at_most_25_hu():
    """Check that the values on the axis of a bent tube vary by at most 25 HU plus the effect of the voxel distance.

    In a CT that is painted voxel by voxel they vary by hundreds of HU.
    """
    turn = np.linspace(0.0, 1.6, 200)
    points = np.stack([9.0 + 7.0 * np.cos(turn), 2.0 + 7.0 * np.sin(turn), 3.0 + 8.0 * turn], axis=1)
    made = paint(empty(34, Tube(points, np.full(200, 0.5 * VOXEL))), EVEN)
    inner = points[30:-30]
    i, j, k = np.rint(made.volume.to_ijk(inner)).astype(int).T
    places = made.volume.to_lps(np.stack([i, j, k], axis=1).astype(float))
    off = np.linalg.norm(places[:, None] - points[None], axis=2).min(axis=1)
    hu = made.volume.hu_zyx[k, j, i].astype(float)
    assert np.ptp(hu - predicted(0.5 * VOXEL, off, EVEN.scanner().sigma_mm)) < 25.0
    assert hu.max() < -400.0 and np.ptp(hu) < 120.0


def test_painted_airway_wall_has_the_requested_thickness():
    for radius in (0.8, 1.6, 3.0):
        scene, *_ = straight(2 * radius / VOXEL, (0.2, 0.3, 0.0), (0, 0, 1), size=24)
        scene = replace(scene, hu_zyx=np.full_like(scene.hu_zyx, -1000))
        plane = paint(scene, replace(QUIET, wall_hu=0.0)).volume.hu_zyx[12].astype(float)
        area = float((plane + 1000.0).sum()) / 1000.0 * VOXEL**2
        found = math.sqrt(radius**2 + area / math.pi) - radius
        assert found == pytest.approx(float(wall_mm(np.array(radius))), rel=0.03)


@pytest.mark.parametrize(
    ("radius_mm", "thinnest", "thickest"),
    [
        (9.0, 1.0, 3.0),
        (6.1, 1.0, 1.5),
        (4.3, 1.0, 1.5),
        (3.4, 1.0, 1.2),
        (2.8, 1.0, 1.2),
        (1.75, 0.5, 0.8),
        (1.45, 0.5, 0.8),
    ],
)
def test_painted_wall_thickness_is_in_the_anatomical_range_for_its_radius(radius_mm, thinnest, thickest):
    assert thinnest <= float(wall_mm(np.array(radius_mm))) <= thickest


def test_sum_of_partial_volumes_is_the_volume_of_the_lumen():
    scene, _, _ = straight(1.5, (0.3, 0.1, 0.0), (0, 0, 1))
    cover = paint(scene, QUIET).cover_zyx
    area = cover.sum(axis=(1, 2)) / 255.0 * VOXEL**2
    np.testing.assert_allclose(area[6:-6], math.pi * (0.75 * VOXEL) ** 2, rtol=0.02)


@pytest.mark.parametrize("kernel", ["soft", "medium", "sharp"])
@pytest.mark.parametrize("noise_hu", [15.0, 90.0])
def test_painted_noise_has_the_requested_standard_deviation(kernel, noise_hu):
    scene = Scene(np.full((6, 120, 140), -300, np.int16), np.diag([VOXEL, VOXEL, 0.7, 1.0]), ())
    hu = paint(scene, PaintOptions(kernel=kernel, noise_hu=noise_hu)).volume.hu_zyx.astype(float)
    assert hu.std() == pytest.approx(noise_hu, rel=0.05)


def test_noise_of_a_sharper_kernel_is_finer():
    scene = Scene(np.full((6, 120, 140), -300, np.int16), np.diag([VOXEL, VOXEL, 0.7, 1.0]), ())
    likeness = []
    for kernel in ("soft", "medium", "sharp"):
        hu = paint(scene, PaintOptions(kernel=kernel, noise_hu=40.0)).volume.hu_zyx + 300.0
        likeness.append(float((hu[:, :, 1:] * hu[:, :, :-1]).mean() / hu.var()))
    assert likeness[0] > likeness[1] + 0.1 > likeness[2] + 0.2


@pytest.mark.parametrize("voxel", [0.3, 0.55, 0.7])
def test_edge_overshoot_has_the_requested_share_of_the_step(voxel):
    """Use the side of a wide tube oblique to the grid, whose edge samples all positions between voxels."""
    size, radius = 32, 400.0
    middle = np.array([0.5 * (size - 1) * voxel - radius * 0.9, 0.5 * (size - 1) * voxel - radius * 0.4359, 0.0])
    points = middle + np.array([[0.0, 0.0, -4.0], [0.0, 0.0, 6.0]])
    tube = Tube(points, np.full(2, radius), is_artery=True)
    scene = Scene(np.full((3, size, size), LUNG, np.int16), np.diag([voxel, voxel, 0.7, 1.0]), (tube,))
    options = replace(QUIET, kernel="sharp")
    plane = paint(scene, options).volume.hu_zyx[1].astype(float)[6:-6, 6:-6]
    height = options.vessel_hu - LUNG
    assert (plane.max() - options.vessel_hu) / height == pytest.approx(0.18, rel=0.05)
    assert (LUNG - plane.min()) / height == pytest.approx(min(0.18, (1024 + LUNG) / height), rel=0.05)
    soft = paint(scene, replace(options, kernel="soft")).volume.hu_zyx
    assert soft.max() <= options.vessel_hu and soft.min() >= LUNG


@pytest.mark.parametrize("slice_mm", [0.5, 1.5, 3.0, 5.0])
def test_painted_slices_have_the_requested_thickness_and_distance(slice_mm):
    hu = np.full((60, 8, 8), LUNG, np.int16)
    hu[29] += 1000  # The thickness of the tissue is 0.5 mm.
    scene = Scene(hu, np.diag([VOXEL, VOXEL, 0.5, 1.0]), ())
    made = paint(scene, replace(QUIET, slice_mm=slice_mm, slice_sigma_mm=1e-4)).volume
    assert made.spacing_mm[2] == pytest.approx(slice_mm)
    rise = made.hu_zyx[:, 4, 4] - float(LUNG)
    assert rise.max() == pytest.approx(1000.0 * 0.5 / slice_mm, abs=1.5)
    seen = made.to_lps(np.array([[4.0, 4.0, float(rise.argmax())]]))[0, 2]
    assert abs(seen - 29 * 0.5) <= 0.5 * slice_mm + 1e-6


def test_equal_seeds_give_equal_painted_cts_and_different_seeds_different_ones():
    scene, *_ = straight(1.5, (0.3, 0.1, 0.0), (1, 2, 3))
    one, again, other = (paint(scene, PaintOptions(seed=seed)).volume.hu_zyx for seed in (4, 4, 5))
    assert np.array_equal(one, again)
    assert not np.array_equal(one, other)


def test_painted_bifurcation_is_open_and_its_branches_are_separate_beyond_it():
    top, fork = np.array([9.0, 9.0, 17.0]), np.array([9.0, 9.0, 9.0])
    tips = [fork + 9.0 * np.array([side * 0.6, 0.0, -0.8]) for side in (-1, 1)]
    tubes = [
        Tube(np.linspace(a, b, 20), np.full(20, r), n)
        for n, (a, b, r) in enumerate([(top, fork, 1.8), (fork, tips[0], 1.4), (fork, tips[1], 1.4)])
    ]
    hu = paint(empty(34, *tubes), QUIET).volume
    for tube in tubes:
        i, j, k = np.rint(hu.to_ijk(tube.points[1:-2])).astype(int).T
        assert hu.hu_zyx[k, j, i].max() < -880
    between = np.rint(hu.to_ijk(np.array([[9.0, 9.0, 3.5]]))).astype(int)[0]
    assert hu.hu_zyx[between[2], between[1], between[0]] > -870


def test_painted_breathing_moves_ground_truth_and_image_together():
    scene, *_ = straight(3.0, (0.0, 0.0, 0.0), (1, 0, 0.4))
    made = paint(scene, replace(QUIET, breathing_mm=3.0, breathing_period_mm=30.0))
    points = made.airways[0].points
    assert np.abs(points - scene.tubes[0].points).max() > 1.5
    ijk = np.rint(made.volume.to_ijk(points)).astype(int)
    i, j, k = ijk[((ijk >= 3) & (ijk < 23)).all(axis=1)].T
    assert len(k) > 5
    # The expected value is -1000 HU after the blur of a lumen 3 voxels wide.
    assert made.volume.hu_zyx[k, j, i].max() < -780
    assert (made.cover_zyx[k, j, i] > 200).all()


def test_painted_fluid_is_in_the_lower_half_and_a_plug_closes_the_lumen():
    scene, middle, _ = straight(10.0, (0.0, 0.0, 0.0), (0, 0, 1), size=18)
    front, back = (middle + np.array([0.0, y, 0.0]) for y in (-1.6, 1.6))

    def seen(level):
        tube = replace(scene.tubes[0], filled_from=np.full(41, level))
        made = paint(replace(scene, tubes=(tube,)), QUIET)
        ijk = np.rint(made.volume.to_ijk(np.array([front, back]))).astype(int)
        return [int(made.volume.hu_zyx[k, j, i]) for i, j, k in ijk]

    assert seen(-1.0) == pytest.approx([-1000, -1000], abs=8)
    assert seen(0.0) == pytest.approx([-1000, 15], abs=8)
    assert seen(1.0) == pytest.approx([15, 15], abs=8)


def test_tubes_derived_from_a_mask_have_the_radii_of_the_mask():
    pytest.importorskip("skimage")
    pytest.importorskip("scipy")
    from carina_bench.paint_scene import tubes_of_mask

    size = 60
    z, y, x = np.indices((size,) * 3) * VOXEL
    mask = np.zeros((size,) * 3, bool)
    mid = 0.5 * size * VOXEL
    trunk, radii = np.array([mid, mid]), (2.2, 0.9)
    mask |= (np.hypot(x - trunk[0], y - trunk[1]) < radii[0]) & (z > mid) & (z < 30.0)
    along = np.clip(mid - z, 0.0, 12.0)
    for side in (-1, 1):
        mask |= (np.hypot(x - mid - side * 0.6 * along, y - mid) < radii[1]) & (z <= mid) & (z > mid - 12.0)
    tubes = tubes_of_mask(mask, np.diag([VOXEL, VOXEL, VOXEL, 1.0]))
    assert len(tubes) == 3 and [tube.parent for tube in tubes] == [None, 0, 0]
    assert float(np.median(tubes[0].radius_mm)) == pytest.approx(radii[0], abs=0.25 * VOXEL)
    for tube in tubes[1:]:
        # Sections perpendicular to z of the oblique tubes are round; perpendicular to the tubes' axes they are slightly
        # narrower.
        assert float(np.median(tube.radius_mm)) == pytest.approx(radii[1] * 0.93, abs=0.3 * VOXEL)
