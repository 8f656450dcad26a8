"""Tests of clicks on large lesions: on the chest wall, with lobes, and beside vessels with contrast medium."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import SimpleITK as sitk

from carina.errors import NoResultError
from carina.plan import grow_nodule, nodule_from_mask
from carina.plan.targets.click_comparison import click_note
from carina.volume import Volume

STEP_MM = 1.5
LUNG_RADIUS_MM = 80.0
WALL_X_MM = 20.0
"""Distance of the chest wall from the middle of the volume, on the patient's left."""


@functools.cache
def chest_part(
    balls: tuple[tuple[float, float, float, float], ...],
    vessel_hu: float = 0.0,
    slice_mm: float = 1.5,
) -> tuple[Volume, float]:
    """Return a part of a lung at the chest wall with a lesion, a union of balls (x, y, z, radius), and its volume."""
    num = 92
    axis = (np.arange(num) - (num - 1) / 2) * STEP_MM
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij", sparse=True)

    def share(distance):
        return np.clip(0.5 - distance / STEP_MM, 0.0, 1.0)

    lung = share(np.sqrt((x - WALL_X_MM + LUNG_RADIUS_MM) ** 2 + y**2 + z**2) - LUNG_RADIUS_MM)
    body = share(np.sqrt((x - WALL_X_MM + LUNG_RADIUS_MM) ** 2 + y**2 + z**2) - LUNG_RADIUS_MM - 30.0)
    hu = -1000.0 + body * 1040.0
    hu = hu * (1.0 - lung) - 860.0 * lung
    lesion = share(
        np.min([np.sqrt((x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2) - radius for a, b, c, radius in balls], axis=0)
    )
    own = lesion * lung
    hu = hu * (1.0 - own) + 40.0 * own
    if vessel_hu:
        # The vessel runs along z behind the lesion, through the complete volume.
        a, b, _, radius = balls[0]
        vessel = share(np.hypot(x - a, y - b - radius - 3.0) - 5.0) * np.ones_like(hu)
        hu = hu * (1.0 - vessel) + vessel_hu * vessel
        own = own * (1.0 - vessel)
    smooth = sitk.GetArrayFromImage(sitk.DiscreteGaussian(sitk.GetImageFromArray(hu), [0.2, 0.2, 0.2]))
    smooth = smooth + np.random.default_rng(3).normal(0.0, 12.0, smooth.shape)
    thick = round(slice_mm / STEP_MM)
    smooth = smooth[: num // thick * thick].reshape(-1, thick, num, num).mean(axis=1)
    matrix = np.diag([STEP_MM, STEP_MM, STEP_MM * thick, 1.0])
    matrix[:3, 3] = axis[0], axis[0], axis[0] + 0.5 * (thick - 1) * STEP_MM
    return Volume(np.rint(smooth).astype(np.int16), matrix), float(own.sum()) * STEP_MM**3


@pytest.mark.parametrize(
    ("radius_mm", "slice_mm"),
    [(18.0, 3.0), *(pytest.param(*case, marks=pytest.mark.soak) for case in ((18.0, 1.5), (24.0, 1.5), (24.0, 3.0)))],
)
def test_mass_with_a_wide_contact_to_the_chest_wall_has_the_true_volume_and_a_doubt(radius_mm, slice_mm):
    volume, true_mm3 = chest_part(((WALL_X_MM - 4.0, 0.0, 0.0, radius_mm),), slice_mm=slice_mm)
    nodule = grow_nodule(volume, (WALL_X_MM - 9.0, 2.0, -1.0))
    assert nodule.volume_mm3 == pytest.approx(true_mm3, rel=0.15)
    assert nodule.volume_mm3 == pytest.approx(true_mm3, abs=nodule.volume_error_mm3)
    assert nodule.volume_error_mm3 < 0.35 * true_mm3
    assert "pleura" in nodule.touches
    assert any("uncertain where the nodule touches the chest wall" in note for note in nodule.notes)


def test_lobulations_of_a_mass_belong_to_the_mass():
    balls = ((-14.0, 0.0, 0.0, 13.0), (-14.0, 13.0, 4.0, 7.0), (-25.0, -8.0, 0.0, 6.5), (-14.0, 0.0, -14.0, 6.0))
    volume, true_mm3 = chest_part(balls)
    for at in ((-14.0, 0.0, 0.0), (-14.0, 14.0, 4.0)):
        nodule = grow_nodule(volume, at)
        assert nodule.volume_mm3 == pytest.approx(true_mm3, rel=0.05)
        assert nodule.volume_mm3 == pytest.approx(true_mm3, abs=nodule.volume_error_mm3)
    assert nodule.notes == ()


def test_vessel_with_contrast_medium_is_not_part_of_a_mass():
    volume, true_mm3 = chest_part(((-20.0, -6.0, 0.0, 13.0),), vessel_hu=300.0)
    nodule = grow_nodule(volume, (-20.0, -6.0, 0.0))
    assert nodule.volume_mm3 == pytest.approx(true_mm3, rel=0.1)
    assert not nodule.contains([(-20.0, 12.0, 0.0)])[0]


def test_click_deep_in_the_chest_wall_is_refused():
    volume, _ = chest_part(((WALL_X_MM - 4.0, 0.0, 0.0, 24.0),))
    with pytest.raises(NoResultError) as error:
        grow_nodule(volume, (WALL_X_MM + 15.0, 40.0, 0.0))
    assert error.value.code == "plan.no-boundary"


def test_note_of_a_target_from_a_file_compares_its_volume_with_that_of_a_click_at_its_middle():
    volume, _ = chest_part(((-14.0, 0.0, 0.0, 13.0),))
    k, j, i = np.indices(volume.shape_zyx)
    off = np.linalg.norm(volume.to_lps(np.stack([i, j, k], axis=-1).astype(float)) - (-14.0, 0.0, 0.0), axis=-1)
    drawn = nodule_from_mask(volume, off < 13.0)
    note = click_note(volume, drawn)
    assert note.startswith(f"for comparison: the file's boundary has {drawn.volume_mm3 / 1000.0:.2f} \u00b1 ")
    assert "a click at its middle gives " in note
    assert f"{drawn.long_mm:.1f} x {drawn.short_mm:.1f} mm" in note
    assert "exceeds" not in note
    larger = nodule_from_mask(volume, off < 18.0)
    assert "the difference exceeds both errors" in click_note(volume, larger)
    aside = np.linalg.norm(volume.to_lps(np.stack([i, j, k], axis=-1).astype(float)) - (-40.0, 30.0, 0.0), axis=-1)
    assert "a click at the middle of the file's boundary gives no nodule" in click_note(
        volume, nodule_from_mask(volume, aside < 4.0)
    )
