"""Tests of the quality gate of a CT: spacing, lung volume, cut lungs and padding."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pytest

from carina.volume import Volume, quality_gate
from carina.volume.quality import trusted_generation

SPACING_MM = np.array([2.2, 2.0, 2.6])


def body(
    shape_zyx=(90, 110, 130), *, lungs=True, flip=False, noise_hu=20.0, lowest_hu=-2048, spacing_mm=SPACING_MM
) -> Volume:
    """Return an elliptic body in air on a couch, with two ellipsoid lungs of 3.1 litres in total."""
    z, y, x = (
        (a - (n - 1) / 2) * s
        for a, n, s in zip(np.ogrid[tuple(map(slice, shape_zyx))], shape_zyx, spacing_mm[::-1], strict=True)
    )
    hu = np.full(shape_zyx, -1000.0)
    hu[np.broadcast_to((x / 130) ** 2 + (y / 90) ** 2 < 1, shape_zyx)] = 40
    hu[np.broadcast_to((y > 98) & (y < 106), shape_zyx)] = -940  # The foam of the couch has the density of emphysema.
    if lungs:
        for side in (-1, 1):
            hu[((x - side * 62) / 50) ** 2 + (y / 70) ** 2 + (z / 106) ** 2 < 1] = -850
    hu += np.random.default_rng(3).normal(0, noise_hu, shape_zyx)
    matrix = np.diag([*spacing_mm, 1.0])
    if flip:
        matrix[2, 2] *= -1
    return Volume(hu.round().clip(lowest_hu).astype(np.int16), matrix)


def codes(volume: Volume) -> list[str]:
    return [finding.code for finding in quality_gate(volume).findings]


@pytest.mark.parametrize(
    ("spacing_mm", "generation"),
    [((0.6, 0.6, 0.6), 8), ((0.7, 0.7, 1.25), 7), ((0.7, 0.7, 2.0), 6), ((0.7, 0.7, 3.0), 5), ((0.8, 0.8, 5.0), 3)],
)
def test_trusted_airway_generation_depends_on_the_widest_voxel_spacing(spacing_mm, generation):
    assert trusted_generation(spacing_mm) == generation


@pytest.mark.parametrize(("noise_hu", "generation"), [(None, 8), (25.0, 8), (45.0, 8), (85.0, 7), (130.0, 6)])
def test_trusted_airway_generation_falls_with_noise(noise_hu, generation):
    assert trusted_generation((0.7, 0.7, 0.7), noise_hu) == generation


def test_complete_lungs_are_found_and_not_reported_as_cut():
    quality = quality_gate(body())
    # The volume of the ellipsoids is 2 * 4/3 pi * 5.0 * 7.0 * 10.6 cm3; the coarse grid and the opening remove a few
    # per cent.
    assert quality.lung_litres == pytest.approx(3.11, rel=0.08)
    assert [finding.code for finding in quality.findings] == ["spacing"]
    assert "2.6 mm" in quality.findings[0].words


@pytest.mark.parametrize(("flip", "face"), [(False, "top"), (True, "bottom")])
def test_cut_lungs_are_reported_by_patient_direction(flip, face):
    whole = body(flip=flip)
    cut = Volume(np.ascontiguousarray(whole.hu_zyx[:55]), whole.lps_from_ijk)
    finding = next(finding for finding in quality_gate(cut).findings if finding.code == "cut")
    assert f"cut off at the {face} of" in finding.words


@pytest.mark.parametrize(("noise_hu", "lowest_hu"), [(60.0, -1024), (120.0, -1024), (120.0, -1000), (120.0, -2048)])
def test_air_around_a_noisy_patient_is_not_reported_as_cut_lungs(noise_hu, lowest_hu):
    """Check air whose mean is higher than -1000 HU, because the lowest value of the file cuts off its noise."""
    # Blocks of many voxels, whose means have little noise.
    whole = body((140, 180, 208), noise_hu=noise_hu, lowest_hu=lowest_hu, spacing_mm=np.array([1.33, 1.33, 1.66]))
    assert "cut" not in codes(whole)
    assert quality_gate(whole).lung_litres == pytest.approx(3.11, rel=0.1)
    half = Volume(np.ascontiguousarray(whole.hu_zyx[:85]), whole.lps_from_ijk)
    (words,) = [finding.words for finding in quality_gate(half).findings if finding.code == "cut"]
    assert "cut off at the top of" in words


def test_lungs_are_found_in_a_crop_without_air_outside_the_body():
    whole = body()
    crop = Volume(np.ascontiguousarray(whole.hu_zyx[:, 25:85, 15:115]), whole.lps_from_ijk)
    assert quality_gate(crop).lung_litres == pytest.approx(3.11, rel=0.15)


def test_body_without_lungs_is_reported_as_ct_without_lungs():
    assert "no-lungs" in codes(body(lungs=False))


def test_quality_check_reports_ct_values_of_padding():
    volume = body()
    hu = volume.hu_zyx.copy()
    hu[:, :10, :10] = -2000
    assert "padding" in codes(Volume(hu, volume.lps_from_ijk))


def test_thick_slices_are_reported_as_uneven_spacing_and_masks_as_not_a_ct():
    volume = body()
    assert "uneven" in codes(Volume(volume.hu_zyx, np.diag([0.7, 0.7, 3.0, 1.0])))
    mask = Volume((volume.hu_zyx < -500).astype(np.int16), volume.lps_from_ijk, is_hu=False, not_hu_reason="0 to 1")
    assert codes(mask)[:2] == ["not-hu", "mask"]


def test_quality_check_of_a_tiny_volume_raises_no_error():
    quality = quality_gate(Volume(np.array([[[-1000, 0]], [[40, 3]]], dtype=np.int16), np.diag([5.0, 0.5, 0.7, 1.0])))
    assert quality.to_json()["findings"]


def stored(volume: Volume, axes_zyx: tuple[int, ...], flips: tuple[bool, ...]) -> Volume:
    """Return the same volume with other axes: permuted, then reversed."""
    values = volume.hu_zyx.transpose(axes_zyx)[tuple(slice(None, None, -1 if flip else 1) for flip in flips)]
    matrix = volume.lps_from_ijk.copy()
    matrix[:3, :3] = volume.lps_from_ijk[:3, [2 - axis for axis in reversed(axes_zyx)]]
    for axis, flip in enumerate(reversed(flips)):
        if flip:
            matrix[:3, 3] += (values.shape[2 - axis] - 1) * matrix[:3, axis]
            matrix[:3, axis] *= -1
    return Volume(np.ascontiguousarray(values), matrix)


def test_quality_does_not_depend_on_the_order_of_the_axes_in_the_file():
    # Cut at the bottom and thick along head-foot, so that findings about directions are part of the comparison.
    whole = body()
    cut = Volume(np.ascontiguousarray(whole.hu_zyx[30:]), whole.lps_from_ijk @ np.diag([1.0, 1.0, 1.2, 1.0]))
    expected = quality_gate(cut)
    assert {"cut", "spacing"} <= {finding.code for finding in expected.findings}
    assert expected.body_mm is not None
    assert expected.noise_hu is not None
    for axes_zyx, flips in product(permutations(range(3)), product((False, True), repeat=3)):
        assert quality_gate(stored(cut, axes_zyx, flips)) == expected, (axes_zyx, flips)


@pytest.mark.parametrize("axes_zyx", list(permutations(range(3))))
def test_noise_of_a_grid_narrower_than_the_distance_of_compared_points_is_unknown(axes_zyx):
    narrow = Volume(np.full((40, 40, 3), 40, dtype=np.int16), np.eye(4))
    assert quality_gate(stored(narrow, axes_zyx, (False, False, False))).noise_hu is None


def test_average_chest_in_coronal_slices_is_not_called_large():
    x, y, z = (np.arange(-n, n + 1) * 4.0 for n in (50, 40, 50))
    zz, yy, xx = np.meshgrid(z, y, x, indexing="ij")
    hu = np.where((xx / 165) ** 2 + (yy / 115) ** 2 < 1, 40, -1000)
    for side in (-1, 1):
        hu[((xx - side * 75) / 60) ** 2 + (yy / 80) ** 2 + (zz / 130) ** 2 < 1] = -850
    axial = Volume(hu.astype(np.int16), np.diag([4.0, 4.0, 4.0, 1.0]))
    coronal = stored(axial, (1, 0, 2), (False, False, False))
    # A circle with the area of the ellipse of 330 x 230 mm.
    assert quality_gate(axial).body_mm == pytest.approx(np.sqrt(330.0 * 230.0), rel=0.03)
    assert quality_gate(coronal).body_mm == quality_gate(axial).body_mm
    assert "large-patient" not in codes(coronal)


def test_thick_axial_slices_in_a_sagittal_file_are_called_slices():
    volume = Volume(body().hu_zyx, np.diag([1.0, 1.0, 3.0, 1.0]))
    sagittal = stored(volume, (2, 1, 0), (False, False, False))
    (words,) = (finding.words for finding in quality_gate(sagittal).findings if finding.code == "spacing")
    assert words.startswith("slices are 3.0 mm apart")
