"""Thick slices computed from an image of thin slices: means over a slice thickness, or linear interpolation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina_bench.paint_scanner import Kernel, noise_of_slice, sharpened_slice

__all__ = ["Slices", "noisy_slices", "slice_weights", "sliced"]

Floats = NDArray[np.float64]

SAME_MM = 0.15
"""Maximum difference between two thicknesses, or two distances of slices, that count as equal, mm."""


@dataclass(frozen=True, slots=True)
class Slices:
    """Thickness and distance of the slices of a CT."""

    thickness_mm: float
    increment_mm: float | None = None
    """Distance between two slices, mm; None means that it equals the thickness. Slices overlap if it is less."""
    is_resampled: bool = False
    """Whether a slice is interpolated between two thin slices, instead of being their mean over its thickness."""

    @property
    def distance_mm(self) -> float:
        """Distance in mm between the centres of two adjacent slices."""
        return self.thickness_mm if self.increment_mm is None else self.increment_mm

    def are_thin(self, thin_mm: float) -> bool:
        """Return whether thin slices of ``thin_mm`` thickness and distance already are these slices."""
        return abs(self.distance_mm - thin_mm) <= SAME_MM and self.thickness_mm <= thin_mm + SAME_MM


def slice_weights(num_thin: int, thin_mm: float, slices: Slices) -> tuple[Floats, float, float]:
    """Return weights (m, n) of n thin slices for m slices, the position of the first slice, and the slice distance.

    Position and distance are in mm; the position is measured from the centre of the first thin slice. A mean over a
    slice thickness of thin slices, which are means over ``thin_mm``, has a trapezoidal profile.
    """
    if slices.are_thin(thin_mm):
        return np.eye(num_thin), 0.0, thin_mm
    step = slices.distance_mm
    if slices.is_resampled:
        at = np.arange(0.0, (num_thin - 1) * thin_mm + 1e-6, step) / thin_mm
        return np.maximum(1.0 - np.abs(at[:, None] - np.arange(num_thin)), 0.0), 0.0, step
    first = 0.5 * (slices.thickness_mm - thin_mm)
    last = num_thin * thin_mm - 0.5 * (slices.thickness_mm + thin_mm)
    at = np.arange(first, max(last, first) + 1e-6, step)
    edges = (np.arange(num_thin + 1) - 0.5) * thin_mm
    low, high = at[:, None] - 0.5 * slices.thickness_mm, at[:, None] + 0.5 * slices.thickness_mm
    weights = np.maximum(np.minimum(edges[1:], high) - np.maximum(edges[:-1], low), 0.0)
    return weights / weights.sum(axis=1, keepdims=True), first, step


def sliced(thin_zyx: NDArray[np.float32], weights: Floats) -> NDArray[np.float32]:
    """Return slices (m, ny, nx), the sums of n thin slices with the weights (m, n)."""
    result = np.zeros((len(weights), *thin_zyx.shape[1:]), np.float32)
    for k, row in enumerate(weights):
        for n in np.flatnonzero(row):
            result[k] += np.float32(row[n]) * thin_zyx[n]
    return result


def noisy_slices(
    values_zyx: NDArray[np.float32],
    weights: Floats,
    kernel: Kernel,
    pixel_mm: float,
    noise_hu: float,
    seed: tuple[int, ...],
    *,
    is_resampled: bool = False,
) -> NDArray[np.int16]:
    """Return the CT values in HU of slices with the kernel's overshoot and noise.

    The noise is drawn for the thin slices and averaged together with them, so overlapping slices share a part of their
    noise. The noise of the thin slices is chosen so that the averaged slices have the standard deviation ``noise_hu``.
    If the slices are interpolated between thin slices (``is_resampled``), the thin slices have the noise ``noise_hu``,
    which the interpolation reduces.
    """
    shape: tuple[int, int] = (values_zyx.shape[1], values_zyx.shape[2])
    result = np.empty(values_zyx.shape, np.int16)
    drawn: dict[int, NDArray[np.float32]] = {}
    for k, row in enumerate(weights):
        used = [int(n) for n in np.flatnonzero(row)]
        if noise_hu <= 0.0:
            used = []
        drawn = {
            n: drawn[n] if n in drawn else noise_of_slice(shape, kernel, pixel_mm, noise_hu, (*seed, n)) for n in used
        }
        plane = sharpened_slice(values_zyx[k], kernel, pixel_mm)
        share = 1.0 if is_resampled else float(np.linalg.norm(row))
        for n in used:
            plane = plane + np.float32(row[n] / share) * drawn[n]
        result[k] = np.clip(np.rint(plane), -1024, 3071)
    return result
