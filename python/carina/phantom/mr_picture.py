"""Synthetic magnetic resonance (MR) picture of the phantom's chest, with the same ground truth."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.argument_checks import check_arguments, function, number_from, whole_from
from carina.display.progress import ProgressChoice, progress_function, shows_progress
from carina.errors import CancelledError
from carina.phantom.chest import Phantom, generate_phantom
from carina.volume import Volume, VolumeSource

__all__ = ["generate_mr_phantom"]

# Spoiled gradient echo with an ultrashort echo time, as for MR of the lung: repetition time and echo time in ms, flip
# angle in degrees.
REPETITION_MS, ECHO_MS, FLIP_DEG = 4.0, 0.05, 5.0
# T1 and T2* in ms at 1.5 T. Lung: T2* of a full breath (PMC3354915). Muscle stands for
# all soft tissue.
SOFT_T1_MS, SOFT_T2_MS = 870.0, 30.0
LUNG_T1_MS, LUNG_T2_MS = 1200.0, 1.2
FAT_T1_MS, FAT_T2_MS = 250.0, 30.0
BONE_T1_MS, BONE_T2_MS, BONE_PROTONS = 250.0, 0.4, 0.25
# Limits in HU of fat, and least HU of bone, in the CT from which the picture is computed.
FAT_HU, BONE_HU = (-150.0, -40.0), 200.0
# HU above which water no longer belongs to lung.
LUNG_END_HU = -500.0
SOFT_VALUE = 400.0
"""Value of soft tissue at places with the average sensitivity of the receiving coil."""
# Number of voxels of the CT along each side of a voxel of the picture.
FINE = 2
# Number of waves of the sensitivity of the coils along each axis, over the whole picture.
WAVES = 3


@shows_progress
@check_arguments(
    seed=whole_from(0, 2**64 - 1),
    spacing_mm=number_from(0.6, 5.0, unit="mm"),
    slice_mm=number_from(0.6, 10.0, unit="mm", optional=True),
    generations=whole_from(3, 9),
    bias=number_from(0.0, 0.9),
    snr=number_from(1.0, 1000.0),
    cancel=function,
)
def generate_mr_phantom(
    *,
    seed: int = 0,
    spacing_mm: float = 1.5,
    slice_mm: float | None = None,
    generations: int = 6,
    bias: float = 0.3,
    snr: float = 20.0,
    progress: ProgressChoice = None,
    cancel: Callable[[], bool] | None = None,
) -> Phantom:
    """Generate an MR picture of the chest of :func:`carina.generate_phantom`, with the same airways and ground truth.

    The signal is that of a spoiled gradient echo with an ultrashort echo time at 1.5 T: air gives none, lung a little
    (by its water), fat much and bone little. The picture has the limited resolution, the smooth variation of the
    coils' sensitivity (bias field) and the Rician noise of magnitude pictures. Its values have no unit. The picture has
    no distortion by motion, flow, or susceptibility.

    Parameters
    ----------
    seed
        Seed of the anatomy, the bias field and the noise.
    spacing_mm
        Size of the voxels in the plane of the slices, mm; 0.6 to 5.
    slice_mm
        Thickness and distance of the slices, mm; None for ``spacing_mm``.
    generations
        Airways divide up to this generation, 3 to 9.
    bias
        Largest relative difference of the coils' sensitivity from its mean, 0 to 0.9.
    snr
        Signal of soft tissue over the standard deviation of the noise in each of the two channels.
    progress, cancel
        As for :func:`carina.generate_phantom`.

    Returns
    -------
    Phantom
        The picture, not in HU, and its ground truth. A voxel belongs to the lumen if at least half of it does.

    Raises
    ------
    UsageError
        If an option is out of range.
    CancelledError
        If ``cancel`` returned True.

    Examples
    --------
    >>> made = generate_mr_phantom(spacing_mm=5.0, generations=3)
    >>> made.volume.is_hu
    False
    """
    report = progress_function(progress)
    voxel_mm = np.array([spacing_mm, spacing_mm, spacing_mm if slice_mm is None else slice_mm])
    whole = generate_phantom(
        seed=seed,
        spacing_mm=[float(v) for v in voxel_mm / FINE],
        generations=generations,
        noise_hu=0.0,
        progress=report or False,
        cancel=cancel,
    )
    if cancel is not None and cancel():
        raise CancelledError("stopped while generating the phantom")
    if report is not None:
        report("computing the signal", None)
    shape_zyx = tuple(n // FINE for n in whole.volume.shape_zyx)
    signal = _mean_of_blocks(_signal(whole.volume.hu_zyx), shape_zyx)
    rng = np.random.default_rng(seed)
    signal *= SOFT_VALUE * _sensitivity(shape_zyx, bias, rng)
    sigma = SOFT_VALUE / snr
    real, imaginary = (rng.normal(0.0, sigma, shape_zyx).astype(np.float32) for _ in range(2))
    values = np.rint(np.hypot(signal + real, imaginary)).astype(np.int16)
    lumen = (_mean_of_blocks(whole.lumen_zyx.astype(np.float32), shape_zyx) >= 0.5).astype(np.uint8)
    lumen.flags.writeable = False
    matrix = whole.volume.lps_from_ijk.copy()
    # The centre of a block is half a block of voxels away from the centre of its first voxel.
    matrix[:3, 3] += matrix[:3, :3] @ np.full(3, (FINE - 1) / 2.0)
    matrix[:3, :3] *= FINE
    title = f"MR phantom {seed}: synthetic, not a patient"
    volume = Volume(values, matrix, is_hu=False, source=VolumeSource(format="phantom", title=title))
    return dataclasses.replace(whole, volume=volume, lumen_zyx=lumen)


def _signal(hu_zyx: NDArray[np.int16]) -> NDArray[np.float32]:
    """Return the signal of a CT's voxels (nz, ny, nx); soft tissue has 1."""
    soft = _echo(SOFT_T1_MS, SOFT_T2_MS)
    hu = np.array([-1000.0, LUNG_END_HU, 0.0, BONE_HU, 3 * BONE_HU])
    protons = np.array([0.0, 1.0 + LUNG_END_HU / 1000.0, 1.0, 1.0, BONE_PROTONS])
    lung, bone = _echo(LUNG_T1_MS, LUNG_T2_MS), _echo(BONE_T1_MS, BONE_T2_MS)
    # A signal for each number of the CT, which has few numbers.
    numbers = np.arange(np.iinfo(np.int16).min, np.iinfo(np.int16).max + 1)
    echo = protons * np.array([lung, lung, soft, soft, bone]) / soft
    table = np.interp(numbers, hu, echo).astype(np.float32)
    signal: NDArray[np.float32] = table[hu_zyx.astype(np.int64) - numbers[0]]
    # Between lung and a wall there are voxels with the HU of fat: only voxels all of whose neighbours are fat are fat.
    is_fat = (hu_zyx > FAT_HU[0]) & (hu_zyx < FAT_HU[1])
    for axis in range(3):
        inner = [slice(None)] * 3
        inner[axis] = slice(1, -1)
        before, after = list(inner), list(inner)
        before[axis], after[axis] = slice(None, -2), slice(2, None)
        within = is_fat.copy()
        within[tuple(inner)] &= is_fat[tuple(before)] & is_fat[tuple(after)]
        is_fat = within
    signal[is_fat] = _echo(FAT_T1_MS, FAT_T2_MS) / soft
    return signal


def _echo(t1_ms: float, t2_ms: float) -> float:
    """Return the signal of a spoiled gradient echo for a proton density of 1 (Ernst's equation)."""
    recovered = np.exp(-REPETITION_MS / t1_ms)
    angle = np.radians(FLIP_DEG)
    return float(np.sin(angle) * (1.0 - recovered) / (1.0 - np.cos(angle) * recovered) * np.exp(-ECHO_MS / t2_ms))


def _mean_of_blocks(values: NDArray[np.float32], shape_zyx: tuple[int, ...]) -> NDArray[np.float32]:
    """Return the means of blocks of voxels; the voxels beyond the last whole block are left out."""
    nz, ny, nx = shape_zyx
    whole = values[: nz * FINE, : ny * FINE, : nx * FINE]
    blocks = whole.reshape(nz, FINE, ny, FINE, nx, FINE)
    means: NDArray[np.float32] = blocks.mean(axis=(1, 3, 5), dtype=np.float32)
    return means


def _sensitivity(shape_zyx: tuple[int, ...], bias: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return the relative sensitivity of the coils (nz, ny, nx), a sum of slow waves, from 1 - bias to 1 + bias."""
    field = np.zeros(shape_zyx, dtype=np.float32)
    places: list[Any] = [np.linspace(0.0, 1.0, n, dtype=np.float32) for n in shape_zyx]
    for _ in range(WAVES):
        waves = [np.cos(np.pi * (rng.uniform(0.5, 1.5) * at + rng.uniform(0.0, 2.0))) for at in places]
        field += rng.uniform(0.5, 1.0) * np.einsum("k,j,i->kji", *waves, dtype=np.float32)
    largest = float(np.abs(field).max())
    relative: NDArray[np.float32] = np.float32(1.0) + np.float32(bias / largest if largest > 0.0 else 0.0) * field
    return relative
