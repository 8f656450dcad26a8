"""Soak test of unsuitable second CTs: each is refused with its cause, or measured within the stated error."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from cached_test_data import cached_phantom, found_airways
from carina.errors import NoResultError
from carina.plan import measure_movement
from carina.volume import Volume
from carina_bench.breathing import breathed, random_breath

pytestmark = pytest.mark.soak

Change = Callable[[Volume], Volume]


def flipped(*axes: int) -> Change:
    return lambda volume: Volume(np.ascontiguousarray(np.flip(volume.hu_zyx, axes)), volume.lps_from_ijk)


def part(axis: int, first: float, last: float) -> Change:
    def cut(volume: Volume) -> Volume:
        num = volume.shape_zyx[axis]
        index = [slice(None)] * 3
        index[axis] = slice(int(first * num), int(last * num))
        matrix = volume.lps_from_ijk.copy()
        matrix[:3, 3] += int(first * num) * matrix[:3, 2 - axis]
        return Volume(np.ascontiguousarray(volume.hu_zyx[tuple(index)]), matrix)

    return cut


def thick(num: int) -> Change:
    """Return the change to slices that are averages of a number of slices."""

    def change(volume: Volume) -> Volume:
        hu = volume.hu_zyx[: len(volume.hu_zyx) // num * num]
        matrix = volume.lps_from_ijk.copy()
        matrix[:3, 3] += 0.5 * (num - 1) * matrix[:3, 2]
        matrix[:3, 2] *= num
        return Volume(hu.reshape(-1, num, *hu.shape[1:]).mean(axis=1).astype(np.int16), matrix)

    return change


def prone(volume: Volume) -> Volume:
    """Return a CT whose lungs are denser in front, in the orientation of the patient."""
    hu = volume.hu_zyx.astype(np.float32)
    y = volume.lps_from_ijk[1, 1] * (np.arange(hu.shape[1]) - 0.5 * hu.shape[1])
    lung = (hu < -600) & (hu > -960)
    return Volume((hu - np.where(lung, 0.6 * y[None, :, None], 0.0)).astype(np.int16), volume.lps_from_ijk)


def without_lungs(volume: Volume) -> Volume:
    return Volume(np.where(volume.hu_zyx < -200, 30, volume.hu_zyx).astype(np.int16), volume.lps_from_ijk)


HALF, NONE, FEW, MEASURED = "movement.half-chest", "movement.no-airways", "movement.few-forks", "measured"
CHANGES: dict[str, tuple[Change, set[str]]] = {
    "whole": (lambda volume: volume, {MEASURED}),
    "slices of 3.6 mm": (thick(2), {MEASURED, FEW}),
    "slices of 9 mm": (thick(5), {FEW, NONE}),
    "upper 80 %": (part(0, 0.2, 1.0), {MEASURED}),
    "upper half": (part(0, 0.5, 1.0), {HALF}),
    "lower half": (part(0, 0.0, 0.5), {HALF, NONE}),
    "right half": (part(2, 0.0, 0.5), {HALF, NONE, FEW}),
    "left half": (part(2, 0.5, 1.0), {HALF, NONE, FEW}),
    "prone": (prone, {"movement.pose"}),
    "prone, read as supine": (flipped(1, 2), {"movement.pose"}),
    "mirrored": (flipped(2), {"movement.mirrored"}),
    "no lungs": (without_lungs, {NONE}),
}


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_unsuitable_second_cts_are_refused_with_their_cause(seed: int) -> None:
    made = cached_phantom(seed=seed, spacing_mm=1.8, generations=5, nodule=True)
    first, airways = made.volume, found_airways(made.volume)
    place = np.array(made.truth["nodule"]["centre_lps"])
    carina = airways.tree.branches[0].points[-1]
    breath = random_breath(carina, seed)
    second = breathed(first, breath, seed=seed)
    true = breath.shifts(place[None])[0] - breath.shifts(carina[None])[0]
    found: dict[str, str | None] = {}
    for name, (change, codes) in CHANGES.items():
        try:
            movement = measure_movement(first, airways, place, change(second), progress=False).movement
        except NoResultError as error:
            found[name] = None if error.code in codes else f"{error.code}: {error}"
        else:
            assert movement.error_mm is not None
            off = float(np.linalg.norm(np.array(movement.shift_lps) - true))
            is_right = MEASURED in codes and off <= movement.error_mm
            found[name] = None if is_right else f"{off:.1f} mm from the truth, stated {movement.error_mm:.1f} mm"
    other = cached_phantom(seed=seed + 1, spacing_mm=1.8, generations=5, nodule=True).volume
    with pytest.raises(NoResultError) as raised:
        measure_movement(first, airways, place, other, progress=False)
    assert raised.value.code == "movement.other-patient"
    assert {name: words for name, words in found.items() if words is not None} == {}
