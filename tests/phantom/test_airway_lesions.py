"""Tests of lesions in the airways of a phantom: truth, voxels, and what the airway search finds."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import carina
from carina.errors import UsageError
from carina.phantom import Phantom
from carina.phantom.airway_lesions import BRONCHI, LESION_HU, LESIONS, stretch_of

OPTIONS = {"seed": 3, "spacing_mm": 1.0, "noise_hu": 15.0, "box_lps": ((-90, -60, -130), (90, 80, 10))}
SEEDS = (3, 5, 8)


@functools.cache
def made(seed: int, lesion: str | None) -> Phantom:
    return carina.generate_phantom(**(OPTIONS | {"seed": seed}), lesion=lesion, progress=False)


def distance_from_axis(phantom: Phantom, zyx: np.ndarray, axis: np.ndarray) -> np.ndarray:
    places = phantom.volume.to_lps(zyx[:, ::-1].astype(np.float64))
    return np.linalg.norm(places[:, None] - axis[None, ::4], axis=2).min(axis=1)


@pytest.mark.parametrize("kind", LESIONS)
@pytest.mark.parametrize("seed", SEEDS)
def test_lesion_fills_the_stated_share_of_its_bronchus_and_changes_nothing_else(seed, kind):
    ill, healthy = made(seed, kind), made(seed, None)
    lesion = ill.truth["lesion"]
    assert lesion["kind"] == kind
    assert lesion["branch"] in BRONCHI[kind]
    branch = ill.truth["branches"][lesion["branch_id"]]
    assert branch["name"] == lesion["branch"]
    assert branch == healthy.truth["branches"][lesion["branch_id"]], "the tree is that without the lesion"
    stretch = stretch_of(branch, lesion["from_mm"], lesion["to_mm"])

    changed = np.argwhere(ill.volume.hu_zyx != healthy.volume.hu_zyx)
    assert len(changed) > 20
    off = distance_from_axis(ill, changed, stretch.axis_lps)
    # A voxel that the lesion touches may have its centre almost a voxel's diagonal outside the lumen.
    assert off.max() <= stretch.radius_mm.max() + 0.87 + 0.4

    # Volume: the rise of the values, in units of the rise from air to the lesion, against slabs of the true sections.
    rise = ill.volume.hu_zyx.astype(np.float64) - healthy.volume.hu_zyx
    volume_mm3 = rise.sum() / (LESION_HU[kind] + 1000.0) * np.prod(ill.volume.spacing_mm)
    section_mm2 = np.pi * stretch.radius_mm**2
    most_mm3 = lesion["filled"] * float(np.sum(section_mm2)) * 0.2
    if kind in {"mucus", "bleeding"}:
        assert volume_mm3 == pytest.approx(most_mm3, rel=0.1)
    else:
        assert 0.3 * most_mm3 < volume_mm3 < most_mm3

    removed = (healthy.lumen_zyx > 0) & (ill.lumen_zyx == 0)
    assert removed.sum() * np.prod(ill.volume.spacing_mm) == pytest.approx(volume_mm3, rel=0.15)
    assert not ((ill.lumen_zyx > 0) & (healthy.lumen_zyx == 0)).any()


@pytest.mark.parametrize("kind", LESIONS)
def test_inside_of_a_lesion_has_its_ct_value_and_the_noise_of_the_phantom(kind):
    ill, healthy = made(3, kind), made(3, None)
    full = (ill.volume.hu_zyx.astype(int) - healthy.volume.hu_zyx) == round(LESION_HU[kind] + 1000.0)
    assert full.sum() > 10
    values = ill.volume.hu_zyx[full]
    assert np.mean(values) == pytest.approx(LESION_HU[kind], abs=4.0 * 15.0 / np.sqrt(full.sum()) + 3.0)
    assert 5.0 < np.std(values) < 25.0


def test_fluid_lies_in_the_posterior_part_of_its_bronchus():
    ill = made(3, "bleeding")
    lesion = ill.truth["lesion"]
    branch = ill.truth["branches"][lesion["branch_id"]]
    middle = stretch_of(branch, lesion["from_mm"], lesion["to_mm"]).axis_lps.mean(axis=0)
    assert lesion["centre_lps"][1] > middle[1]
    assert lesion["filled"] < 0.5


def test_same_seed_gives_the_same_lesion_and_another_seed_another_one():
    one, again, other = (
        carina.generate_phantom(**(OPTIONS | {"seed": seed, "spacing_mm": 2.5}), lesion="tumour", progress=False)
        for seed in (3, 3, 4)
    )
    assert one.truth["lesion"] == again.truth["lesion"] != other.truth["lesion"]
    assert np.array_equal(one.volume.hu_zyx, again.volume.hu_zyx)


@pytest.mark.parametrize("wrong", [{"lean_deg": (10.0, 0.0)}, {"with_distance": True}])
def test_lesion_with_a_lean_or_distances_is_refused(wrong):
    with pytest.raises(UsageError, match="lesion: expected a chest without"):
        carina.generate_phantom(spacing_mm=5.0, lesion="mucus", **wrong)


def test_unknown_lesion_is_refused_with_the_known_ones():
    with pytest.raises(UsageError, match="foreign-body"):
        carina.generate_phantom(spacing_mm=5.0, lesion="polyp")
