"""Tests of the softened copy in which the search looks at CTs with sharp kernels."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from sharp_kernel import grown, sharpened

import carina
from cached_test_data import MASKED_CHEST, cached_airways, cached_phantom
from cached_test_data import patient as the_patient
from carina.track.find.kernel_compensation import SEAM_MM, SOFT_HU, inverse_of, soften
from carina.track.find.kernel_sharpness import edge_undershoot_hu
from carina.track.intensity_levels import air_scale
from carina.track.tree.thick_slices import THICK_SLICES


def in_plane(volume, amount, sigma_mm, noise_hu=15.0):
    """Return the volume with an edge-enhancing kernel applied within each slice, as by scanners."""
    slices = []
    rng = np.random.default_rng(5)
    x, y = (sigma_mm / volume.spacing_mm[axis] for axis in (0, 1))
    for values in volume.hu_zyx:
        noisy = values + np.float32(noise_hu) * rng.standard_normal(values.shape, dtype=np.float32)
        slices.append(noisy + amount * (noisy - blurred(noisy, (y, x))))
    hu = np.clip(np.rint(np.stack(slices)), -1024, 3071).astype(np.int16)
    return dataclasses.replace(volume, hu_zyx=hu)


def blurred(values, sigmas):
    for axis, sigma in enumerate(sigmas):
        reach = int(np.ceil(4 * sigma))
        weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
        weights = (weights / weights.sum()).astype(np.float32)
        padded = np.moveaxis(
            np.pad(values, [(reach, reach) if a == axis else (0, 0) for a in range(2)], "edge"), axis, 0
        )
        out = sum(weight * padded[n : n + values.shape[axis]] for n, weight in enumerate(weights))
        values = np.moveaxis(out, 0, axis)
    return values


@pytest.mark.parametrize("raised", [0.05, 0.4, 1.0, 2.3, 3.2])
def test_sum_of_two_gaussians_inverts_the_sharp_kernel_at_every_frequency(raised):
    frequency = np.linspace(0.0, 1.5, 200)
    gaussian = np.exp(-2.0 * (np.pi * SEAM_MM * frequency) ** 2)
    inverse = 1.0 / (1.0 + raised)
    for weight, sigma_mm in inverse_of(raised, SEAM_MM):
        inverse = inverse + weight * np.exp(-2.0 * (np.pi * sigma_mm * frequency) ** 2)
    exact = 1.0 / (1.0 + raised * (1.0 - gaussian))
    assert np.abs(inverse - exact).max() < 0.006
    assert inverse[0] == pytest.approx(1.0, abs=1e-12)
    # The compensation raises no frequency, so it does not raise noise.
    assert inverse.max() <= 1.0 + 1e-9


def test_ct_with_a_soft_kernel_is_not_softened():
    for volume in (the_patient()[0], cached_phantom(**MASKED_CHEST).volume):
        found = soften(volume, air_scale(volume))
        assert found.volume is volume
        assert found.raised == 0.0


def test_softened_ct_has_no_dark_rims_beside_edges():
    volume = in_plane(the_patient()[0], 1.2, 0.8)
    scale = air_scale(volume)
    assert edge_undershoot_hu(volume, scale) > 25.0
    found = soften(volume, scale)
    assert found.raised > 0.3
    assert SOFT_HU - 12.0 < edge_undershoot_hu(found.volume, scale) <= SOFT_HU + 1.0
    # The search leaves the CT unchanged.
    assert volume.hu_zyx.min() == -1024


def test_ct_with_the_sharpest_kernel_has_the_airways_found_with_a_soft_kernel():
    """Use a CT that a search without compensation refuses: its lumens break through their walls along the dark rims."""
    soft_volume, soft = the_patient()
    airways = carina.find_airways(in_plane(soft_volume, 1.6, 1.1, 30.0))
    found, truth = airways.lumen_zyx != 0, soft.lumen_zyx != 0
    assert np.count_nonzero(found & grown(grown(truth))) > 0.98 * np.count_nonzero(found)
    assert np.count_nonzero(truth & grown(found)) > 0.9 * np.count_nonzero(truth)
    (badge,) = [note for note in airways.badges if note.code != THICK_SLICES]
    assert "softened copy" in badge.words


def test_lumens_clipped_at_the_least_ct_value_stay_as_dark_as_air_in_the_softened_ct():
    """Use an unsharp mask that lowers small lumens below -1024 HU, the least value of files.

    Softened without a correction, these lumens would be as bright as lung.
    """
    made = cached_phantom(**MASKED_CHEST)
    airways = carina.find_airways(sharpened(made.volume, 1.6, 30.0))
    found, truth = airways.lumen_zyx != 0, made.lumen_zyx != 0
    assert np.count_nonzero(found & truth) > 0.95 * np.count_nonzero(found)
    soft = cached_airways(**MASKED_CHEST)
    at = np.concatenate([branch.points for branch in soft.tree.branches])
    i, j, k = np.rint(made.volume.to_ijk(at)).astype(int).T
    assert grown(found)[k, j, i].mean() > 0.9


def test_given_lumen_threshold_applies_to_the_values_of_the_unsoftened_ct():
    volume = in_plane(the_patient()[0], 0.8, 0.8)
    airways = carina.find_airways(volume, lumen_threshold=-850)
    assert airways.threshold == -850
    assert (volume.hu_zyx[airways.lumen_zyx != 0] <= -850).mean() > 0.9
    assert not any("softened" in note for note in airways.notes)
