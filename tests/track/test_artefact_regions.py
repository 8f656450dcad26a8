"""Tests of CTs disturbed by metal or breathing: few false airways, lower confidence, and a lasting note."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cached_test_data import cached_airways, cached_phantom
from cached_test_data import patient as the_patient
from carina.phantom import Phantom, lumen_distance_at
from carina.track import Airways, find_airways
from carina.track.find.air_upwards import AirSection
from carina.track.find.artefact_regions import LUNG_HU, MAX_CONFIDENCE, METAL, STEP, ArtefactRegions, find_disturbed
from carina.track.find.breathing_step import find_steps
from carina.track.find.metal_streaks import find_streaks
from carina.track.find.upper_airway import find_tube
from carina.track.intensity_levels import air_scale
from carina.track.paths.path_grid import PathGrid
from carina.volume.model import Volume
from carina_bench.track_disturbed_cases import Step, noisy, stepped, streaked, with_clips, with_metal

CHEST: dict[str, Any] = {"spacing_mm": 1.1, "noise_hu": 25.0}
THICK: dict[str, Any] = {"spacing_mm": (0.8, 0.8, 3.0), "noise_hu": 25.0}
SEEDS = [1, pytest.param(2, marks=pytest.mark.soak)]
MAX_FALSE = 3


def made(seed: int) -> Phantom:
    return cached_phantom(**CHEST, seed=seed)


def slices_in(text: str) -> tuple[int, int, int]:
    """Return the first slice number, the last slice number and the number of slices that a note of streaks states."""
    first, rest = text.split("in slices ")[1].split(" to ", 1)
    last, count = rest.split(" from the feet")[0].split(" of ")
    return int(first), int(last), int(count)


def hilum(phantom: Phantom) -> NDArray[np.float64]:
    branch = next(row for row in phantom.truth["branches"] if row["generation"] == 3)
    return np.array(branch["points"])[len(branch["points"]) // 2]


def badges(airways: Airways) -> set[str]:
    return {note.code for note in airways.badges}


def num_false(airways: Airways, seed: int, volume: Volume) -> int:
    """Return the number of false branches among the airways found in a disturbed CT.

    More than half of the points of a false branch lie farther than a voxel outside every lumen.
    """
    voxel_mm = float(np.cbrt(np.prod(volume.spacing_mm)))
    return sum(
        bool((lumen_distance_at(branch.points, seed=seed) > voxel_mm).mean() > 0.5) for branch in airways.tree.branches
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_metal_streaks_of_surgical_clips_add_few_false_branches_and_leave_a_note(seed: int) -> None:
    phantom = made(seed)
    volume = with_clips(phantom.volume, hilum(phantom), seed=seed)
    found = find_airways(volume)
    assert num_false(found, seed, volume) <= MAX_FALSE
    (note,) = [note for note in found.badges if note.code == METAL]
    assert note.badge
    assert note.words in found.notes
    changed = np.abs(volume.hu_zyx - phantom.volume.hu_zyx) > 100
    streaks = np.flatnonzero(changed.mean(axis=(1, 2)) > 0.02) + 1
    first, last, _ = slices_in(note.words)
    # The note also counts slices within 2 mm of the streaks.
    assert streaks[0] - 4 <= first <= streaks[0] + 1
    assert streaks[-1] - 1 <= last <= streaks[-1] + 4


def test_branches_in_metal_streaks_have_at_most_the_limit_of_confidence() -> None:
    phantom = made(2)
    volume = with_clips(phantom.volume, hilum(phantom), seed=2)
    region = find_streaks(volume, air_scale(volume))
    assert region is not None
    found = find_airways(volume)
    last = np.array(volume.shape_zyx[::-1]) - 1
    for branch in found.tree.branches:
        i, j, k = np.clip(np.rint(volume.to_ijk(branch.points)).astype(int), 0, last).T
        if region[k, j, i].mean() > 0.5:
            assert branch.confidence is not None
            assert branch.confidence <= MAX_CONFIDENCE


def test_metal_without_streaks_and_contrast_medium_leave_the_airways_unchanged() -> None:
    """Use the bundled patient, which has values above 2,000 HU in 69 of 97 slices."""
    volume, _ = the_patient()
    assert (volume.hu_zyx >= 2000).any(axis=(1, 2)).sum() > 60
    assert find_streaks(volume, air_scale(volume)) is None
    phantom = made(1)
    places, sizes = hilum(phantom)[None] + [[0.0, 0.0, 3.0]], np.array([[4.0, 4.0, 20.0]])
    lead = with_metal(phantom.volume, places, sizes, seed=1, streak_hu=0.0)
    assert find_streaks(lead, air_scale(lead)) is None


def test_region_disturbed_by_metal_ends_where_its_streaks_end() -> None:
    phantom = made(1)
    volume = phantom.volume
    place = hilum(phantom)
    sizes = np.array([[4.0, 4.0, 6.0]])
    near = find_streaks(with_metal(volume, place[None], sizes, seed=1, half_mm=8.0), air_scale(volume))
    far = find_streaks(with_metal(volume, place[None], sizes, seed=1, half_mm=25.0), air_scale(volume))
    assert near is not None
    assert far is not None
    assert near.sum() < 0.5 * far.sum()
    assert not near.any(axis=(1, 2)).all()


def test_metal_is_found_in_a_ct_whose_values_are_clipped_below_those_of_metal() -> None:
    phantom = made(1)
    volume = with_clips(phantom.volume, hilum(phantom), seed=1)
    clipped = dataclasses.replace(volume, hu_zyx=np.minimum(volume.hu_zyx, np.int16(1400)))
    assert find_streaks(clipped, air_scale(clipped)) is not None
    plain = dataclasses.replace(phantom.volume, hu_zyx=np.minimum(phantom.volume.hu_zyx, np.int16(300)))
    assert find_streaks(plain, air_scale(plain)) is None


@pytest.mark.parametrize("shift_mm", [(0.0, 3.3, 6.6), (0.0, 0.0, -6.6), (2.2, 4.4, 0.0)])
@pytest.mark.parametrize("seed", SEEDS)
def test_breathing_step_is_found_between_its_slices(seed: int, shift_mm: tuple[float, float, float]) -> None:
    volume = made(seed).volume
    step = Step(-30.0, shift_mm)
    heights = volume.lps_from_ijk[2, 3] + volume.spacing_mm[2] * np.arange(volume.shape_zyx[0])
    first = int(np.flatnonzero(heights >= step.above_lps_z)[0])
    assert find_steps(stepped(volume, step), air_scale(volume)) == (first - 1,)


def test_search_in_a_ct_with_a_breathing_step_leaves_a_note_with_its_slices() -> None:
    phantom = made(1)
    volume = stepped(phantom.volume, Step(-30.0))
    found = find_airways(volume)
    (note,) = [note for note in found.badges if note.code == STEP]
    heights = volume.lps_from_ijk[2, 3] + volume.spacing_mm[2] * np.arange(volume.shape_zyx[0])
    first = int(np.flatnonzero(heights >= -30.0)[0])
    assert f"between slices {first} and {first + 1} of {volume.shape_zyx[0]} from the feet" in note.words
    assert note.badge


def test_search_that_leaked_at_a_breathing_step_is_repeated_with_that_lung_excluded() -> None:
    """Use a CT in which the first search leaks at a breathing step.

    Air of a bronchus on one side of the step touches lung on the other side.
    """
    volume = made(1).volume
    values = volume.hu_zyx.copy()
    k = values.shape[0] // 2
    values[k, 100:140, 100:140] = -1000
    values[k + 1, 100:120, 100:140] = -860
    values[k + 1, 120:140, 100:140] = -1000
    closed = ArtefactRegions(PathGrid(dataclasses.replace(volume, hu_zyx=values)), steps=(k,)).closed(air_scale(volume))
    assert (closed.hu_zyx[k : k + 2, 102:118, 102:138] == 40).all()
    assert (closed.hu_zyx[k : k + 2, 122:138, 102:138] == -1000).all()
    assert (closed.hu_zyx[k - 1] == values[k - 1]).all()
    assert (closed.hu_zyx[k + 2] == values[k + 2]).all()


def test_metal_streaks_and_breathing_steps_of_the_ct_are_found_in_divided_slices() -> None:
    phantom = cached_phantom(**THICK, seed=1)
    volume = stepped(with_clips(phantom.volume, hilum(phantom), seed=1), Step(-60.0))
    scale = air_scale(volume)
    streaks = find_streaks(volume, scale)
    assert streaks is not None
    grid = PathGrid.of(volume)
    found, in_ct = find_disturbed(grid), find_disturbed(PathGrid(volume))
    assert grid.parts == 3
    assert found.streaks_zyx is not None
    assert (found.streaks_zyx == streaks).all()
    assert found.steps == in_ct.steps
    assert len(found.steps) == 1
    parts = np.repeat(streaks, 3, axis=0)
    even = found.with_streaks_as_lung(grid.volume, scale).hu_zyx
    assert (even[parts] == LUNG_HU).all()
    assert (even[~parts] == grid.volume.hu_zyx[~parts]).all()
    changed = in_ct.closed(scale).hu_zyx != volume.hu_zyx
    closed = found.closed(scale).hu_zyx
    assert (closed[np.repeat(changed, 3, axis=0)] == 40).all()
    (step,) = found.steps
    beside = np.repeat(streaks, 3, axis=0)
    beside[3 * step : 3 * step + 6] = True
    assert (closed[~beside] == grid.volume.hu_zyx[~beside]).all()
    points = volume.to_lps(np.argwhere(streaks)[::500, ::-1].astype(np.float64))
    assert found.share_of(points) == in_ct.share_of(points) == 1.0


def test_metal_streaks_in_divided_slices_add_few_false_branches_and_leave_a_note() -> None:
    phantom = cached_phantom(**THICK, seed=1)
    volume = with_clips(phantom.volume, hilum(phantom), seed=1)
    found = find_airways(volume)
    assert found.tracker.lumen_zyx.shape[0] == 3 * volume.shape_zyx[0]
    assert num_false(found, 1, volume) <= MAX_FALSE
    (note,) = [note for note in found.badges if note.code == METAL]
    region = find_streaks(volume, air_scale(volume))
    assert region is not None
    used = np.flatnonzero(region.any(axis=(1, 2))) + 1
    assert slices_in(note.words) == (used[0], used[-1], volume.shape_zyx[0])


def test_note_of_a_breathing_step_in_divided_slices_names_slices_of_the_ct() -> None:
    volume = stepped(cached_phantom(**THICK, seed=1).volume, Step(-30.0))
    found = find_airways(volume)
    assert found.tracker.lumen_zyx.shape[0] == 3 * volume.shape_zyx[0]
    (note,) = [note for note in found.badges if note.code == STEP]
    (step,) = find_steps(volume, air_scale(volume))
    assert f"between slices {step + 1} and {step + 2} of {volume.shape_zyx[0]} from the feet" in note.words


@pytest.mark.parametrize("noise_hu", [60.0, 100.0])
@pytest.mark.parametrize("sigma_mm", [0.0, 0.8])
def test_image_noise_is_not_reported_as_breathing_step_or_metal(noise_hu: float, sigma_mm: float) -> None:
    volume = noisy(made(1).volume, noise_hu, seed=1, sigma_mm=sigma_mm)
    assert find_steps(volume, air_scale(volume)) == ()
    assert find_streaks(volume, air_scale(volume)) is None


@pytest.mark.parametrize("seed", SEEDS)
def test_correlated_noise_and_streaks_are_not_reported_as_tracheal_tube(seed: int) -> None:
    volume, plain = the_patient()
    above_z = plain.tree.root.tip_lps[2] + 20.0
    changed = streaked(noisy(volume, 100.0, seed=seed, sigma_mm=0.8), 100.0, seed=seed, from_lps_z=above_z)
    assert "track.tube" not in badges(find_airways(changed))


@pytest.mark.parametrize(("plastic_hu", "is_tube"), [(-350.0, True), (-760.0, False)])
def test_tracheal_tube_is_found_only_if_its_plastic_is_brighter_than_noise(plastic_hu: float, is_tube: bool) -> None:
    one = np.ones((1, 1), dtype=np.bool_)
    sections = [
        AirSection(
            k=k,
            corner=(0, 0),
            air=one,
            whole=one,
            voxel=(0, 0, k),
            centre_lps=np.array([0.0, 0.0, float(k)]),
            area_mm2=250.0,
            width_mm=18.0,
            depth_mm=18.0,
            septum_mm2=40.0 if k > 30 else 0.0,
            septum_hu=plastic_hu if k > 30 else float("nan"),
            noise_hu=90.0,
            peak=300.0,
            leaves_in_front=False,
        )
        for k in range(80)
    ]
    assert (find_tube(sections) is not None) is is_tube


@pytest.mark.parametrize("seed", SEEDS)
def test_plain_chest_has_no_note_of_metal_or_a_breathing_step(seed: int) -> None:
    assert not badges(cached_airways(**CHEST, seed=seed)) & {METAL, STEP}
    volume, found = the_patient()
    assert find_steps(volume, air_scale(volume)) == ()
    assert not badges(found) & {METAL, STEP}
