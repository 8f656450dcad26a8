"""Search of points of one CT in another CT by normalised cross-correlation of small cubes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.plan.cubic_box import Box, smoothed, trilinear
from carina.plan.movement.deformation import Deformation
from carina.volume import Volume

Points = NDArray[np.float64]
Values = NDArray[np.float32]
Mask = NDArray[np.bool_]

MIN_HU, MAX_HU = -1000.0, 100.0
"""HU range that is compared; denser tissue, such as bone and contrast, counts as soft tissue."""
AVERAGED_MM = 1.3
"""Size in mm to which voxels are averaged before both CTs are compared."""
MIN_CLEAR = 0.1
"""Minimum variation of the CT round a landmark, as a share of the variation round the clearest landmarks."""
MIN_SPREAD_HU = 40.0
"""Minimum standard deviation of a cube's values, HU; a cube with less has too little structure to be found."""
LUNG_HU, ROUND_MM, MIN_LUNG = -500.0, 4.0, 0.45
"""Limits for lung round a landmark: largest HU, width in mm of the averaging Gaussian, least share of lung."""
SMOOTH_MM = 2.0
"""Width in mm of the Gaussian over which the structure round a landmark is measured."""


@dataclass(frozen=True, slots=True)
class Block:
    """Sizes of the cubes of tissue that are searched in the second CT."""

    half_mm: float
    """Half the side length of the cube, mm."""
    step_mm: float
    """Distance in mm between two compared points of a cube."""
    search_mm: float
    """Largest distance in mm along each axis from the expected position at which a cube is searched."""


def averaged(volume: Volume) -> Volume:
    """Return a CT whose voxels of less than about 1 mm are averaged, because noise hides small vessels."""
    num = [max(1, round(AVERAGED_MM / spacing)) for spacing in volume.spacing_mm]
    if max(num) == 1:
        return volume
    nz, ny, nx = (size // n for size, n in zip(volume.shape_zyx, num[::-1], strict=True))
    i, j, k = num
    parts = volume.hu_zyx[: nz * k, : ny * j, : nx * i].reshape(nz, k, ny, j, nx, i)
    total = np.zeros((nz, ny, nx), dtype=np.int32)
    for c in range(k):
        for b in range(j):
            for a in range(i):
                total += parts[:, c, :, b, :, a]
    matrix = volume.lps_from_ijk.copy()
    matrix[:3, 3] += matrix[:3, :3] @ (0.5 * (np.array(num) - 1.0))
    matrix[:3, :3] *= np.array(num, dtype=np.float64)
    return Volume((total // (i * j * k)).astype(np.int16), matrix)


def landmarks(
    volume: Volume, centre_lps: Points, half_mm: float, *, apart_mm: float, most: int, step_mm: float
) -> Points:
    """Return points (n, 3) in the lung where vessels end, fork or bend, LPS mm, the clearest ones first.

    At these points the CT varies in all directions, so that each point can be found again in another CT.

    Parameters
    ----------
    volume
        The CT.
    centre_lps, half_mm
        Middle and half the side length of the searched cube.
    apart_mm
        Least distance of two places.
    most
        Largest number of places.
    step_mm
        Least voxel size.
    """
    box = Box.around(volume, centre_lps, half_mm, least_step_mm=step_mm)
    values = np.clip(smoothed(box.hu_zyx, 0.7 / box.step_mm), MIN_HU, MAX_HU)
    slopes = [np.gradient(values, axis=axis) for axis in range(3)]
    sigma = SMOOTH_MM / box.step_mm
    tensor = {
        (a, b): smoothed((slopes[a] * slopes[b]).astype(np.float32), sigma) for a in range(3) for b in range(a, 3)
    }
    xx, yy, zz = tensor[0, 0], tensor[1, 1], tensor[2, 2]
    xy, xz, yz = tensor[0, 1], tensor[0, 2], tensor[1, 2]
    least = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    # The determinant divided by the sum of the minors is near the least eigenvalue of the structure tensor.
    minors = (yy * zz - yz * yz) + (xx * zz - xz * xz) + (xx * yy - xy * xy)
    clear = np.where(minors > 0.0, least / np.maximum(minors, 1e-3), 0.0)
    lung = smoothed(((box.hu_zyx < LUNG_HU) & (box.hu_zyx > MIN_HU + 40.0)).astype(np.float32), ROUND_MM / box.step_mm)
    clear = np.where((lung >= MIN_LUNG) & box.known, clear, 0.0)
    peak = clear > 0.0
    for axis in range(3):
        for way in (1, -1):
            peak &= clear >= np.roll(clear, way, axis=axis)
    index = np.argwhere(peak)
    index = index[np.argsort(-clear[tuple(index.T)], kind="stable")][: 20 * most]
    if len(index):
        strength = clear[tuple(index.T)]
        index = index[strength >= MIN_CLEAR * strength[len(strength) // 50]]
    places = index[:, ::-1] * box.step_mm + box.lps_from_ijk[:3, 3]
    chosen: list[Points] = []
    for place in places:
        if len(chosen) >= most:
            break
        if not chosen or np.linalg.norm(np.array(chosen) - place, axis=1).min() >= apart_mm:
            chosen.append(place)
    return np.array(chosen, dtype=np.float64).reshape(-1, 3)


def match_blocks(
    first: Volume,
    second: Volume,
    places: Points,
    expected: Deformation,
    block: Block,
    *,
    report: Callable[[], None] | None = None,
) -> tuple[Points, Points]:
    """Return the shifts (n, 3) in mm of places (n, 3) between two CTs, and the correlation (n,), 0 if not found.

    Parameters
    ----------
    first, second
        The CTs.
    places
        Places in the first CT, LPS mm.
    expected
        Expected shifts; the cubes of the second CT are deformed by them.
    block
        Sizes of the cubes.
    report
        Called before each place; it may raise an error to stop the work.
    """
    half = round(block.half_mm / block.step_mm)
    wide = half + round(block.search_mm / block.step_mm)
    guesses = expected.at(places)
    shifts, found = guesses.copy(), np.zeros(len(places))
    small, large = _grid(half, block.step_mm), _grid(wide, block.step_mm)
    for n, place in enumerate(places):
        if report is not None:
            report()
        here, known = _sampled(first, place + small)
        if not known.all() or here.std() < MIN_SPREAD_HU:
            continue
        gradient = expected.gradient(place)
        there, known = _sampled(second, place + guesses[n] + large @ gradient.T)
        if known.mean() < 0.75:
            continue
        side, size = 2 * half + 1, 2 * wide + 1
        score = _correlation(here.reshape(side, side, side), there.reshape(size, size, size))
        at = np.unravel_index(int(np.argmax(score)), score.shape)
        if any(k in (0, num - 1) for k, num in zip(at, score.shape, strict=True)):
            continue
        off = np.array([k + _vertex(score, at, axis) - (wide - half) for axis, k in enumerate(at)])[::-1]
        shifts[n] = guesses[n] + gradient @ (block.step_mm * off)
        found[n] = float(score[at])
    return shifts, found


def _grid(half: int, step_mm: float) -> Points:
    """Return the points of a cube as (n, 3) offsets in mm, x fastest."""
    axis = step_mm * np.arange(-half, half + 1)
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    return np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)


def _sampled(volume: Volume, places: Points) -> tuple[Points, Mask]:
    ijk = volume.ijk_from_lps[:3, :3] @ places.T + volume.ijk_from_lps[:3, 3:]
    top = (np.array(volume.shape_zyx[::-1]) - 1.0)[:, None]
    known = np.asarray(((ijk >= -0.5) & (ijk <= top + 0.5)).all(axis=0))
    values = trilinear(volume.hu_zyx, np.clip(ijk, 0.0, top))
    return np.clip(values, MIN_HU, MAX_HU), known


def _correlation(here: Points, there: Points) -> Points:
    """Return the normalised cross-correlation of a cube with a larger one at all offsets that contain it."""
    part = here - here.mean()
    num_offsets = tuple(np.array(there.shape) - np.array(here.shape) + 1)
    values = there - there.mean()
    axes = (0, 1, 2)
    spectrum = np.fft.rfftn(values) * np.conj(np.fft.rfftn(part, s=there.shape, axes=axes))
    product = np.fft.irfftn(spectrum, s=there.shape, axes=axes)
    both = product[: num_offsets[0], : num_offsets[1], : num_offsets[2]]
    num = here.size
    total, squares = _sums(values, here.shape), _sums(values * values, here.shape)
    spread = np.sqrt(np.maximum(squares - total * total / num, 1e-6) * float((part * part).sum()))
    found: Points = np.where(squares - total * total / num > num * 100.0, both / spread, 0.0)
    return found


def _sums(values: Points, shape: tuple[int, ...]) -> Points:
    """Return the sums of an array over all cubes of a shape, one sum for each position of the cube."""
    for axis, num in enumerate(shape):
        total = np.cumsum(np.insert(values, 0, 0.0, axis=axis), axis=axis)
        values = np.take(total, range(num, total.shape[axis]), axis=axis) - np.take(
            total, range(total.shape[axis] - num), axis=axis
        )
    return values


def _vertex(score: Points, at: tuple[np.intp, ...], axis: int) -> float:
    """Return the offset in steps of the vertex of a parabola through the best score and its neighbours."""
    place = list(at)
    before, after = place.copy(), place.copy()
    before[axis] -= 1
    after[axis] += 1
    low, middle, high = (float(score[tuple(one)]) for one in (before, place, after))
    curve = low - 2.0 * middle + high
    return 0.0 if curve >= -1e-9 else float(np.clip(0.5 * (low - high) / curve, -0.5, 0.5))
