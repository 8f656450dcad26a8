"""Scanner of painted CTs: computes voxels from a scene by exact weights, then adds the kernel's overshoot and noise.

Along each axis a voxel is the scene's mean over the voxel's width, blurred by the kernel. The weights of one axis are a
small matrix, so a volume is three matrix products. A sharp kernel is a narrow blur whose edges are enhanced in plane by
a difference of Gaussians. The noise has the spectrum of filtered back-projection: frequency times the square of the
kernel's transfer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Kernel", "noise_of_slice", "normal_share", "reach_mm", "sampled_weights", "sharpened_slice", "step_weights"]

Floats = NDArray[np.float64]

# Step of the table in standard deviations: errors of linear interpolation stay below 1e-6.
_STEP = 0.0025
_AT = np.arange(-8.0, 8.0 + _STEP, _STEP)
_NORMAL = np.array([0.5 * math.erfc(-x / math.sqrt(2.0)) for x in _AT])
REACH_SIGMAS = 4.5
"""Distance, in standard deviations of the blur, within which a cell contributes to a blurred voxel."""
EDGE_PAD = 12
"""Number of pixels by which a slice is extended at its edges before it is sharpened."""


@dataclass(frozen=True, slots=True)
class Kernel:
    """Reconstruction kernel of a scanner, described by its effect on an edge."""

    sigma_mm: float
    """Standard deviation of the kernel's Gaussian blur in plane, mm, in addition to the voxel's width."""
    overshoot: float = 0.0
    """Overshoot at an edge in plane, as a fraction of the edge's height; 0 is a plain Gaussian blur."""
    surround_mm: float = 0.65
    """Standard deviation of the second blur, which is subtracted for the overshoot, mm.

    It determines the width of the dark seam that the overshoot makes at an edge.
    """

    def gain(self, pixel_mm: float) -> float:
        """Return the weight of the difference of Gaussians that causes :attr:`overshoot` in pixels of this width."""
        if self.overshoot <= 0.0:
            return 0.0
        x = np.linspace(0.0, 4.0 * (self.sigma_mm + self.surround_mm) + pixel_mm, 4001)
        narrow = _edge(x, pixel_mm, self.sigma_mm)
        wide = _edge(x, pixel_mm, math.hypot(self.sigma_mm, self.surround_mm))
        low, high = 0.0, 64.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            over = float((narrow + middle * (narrow - wide)).max()) - 1.0
            low, high = (middle, high) if over < self.overshoot else (low, middle)
        return 0.5 * (low + high)

    def raised(self, frequency: Floats, pixel_mm: float) -> Floats:
        """Return the factor by which overshoot raises the transfer function at each frequency (1/mm, in plane)."""
        surround = np.exp(-2.0 * (math.pi * self.surround_mm * frequency) ** 2)
        result: Floats = 1.0 + self.gain(pixel_mm) * (1.0 - surround)
        return result

    def transfer(self, frequency: Floats, pixel_mm: float) -> Floats:
        """Return the kernel's transfer at each frequency (1/mm, in plane), without the effect of the pixel's width."""
        result: Floats = np.exp(-2.0 * (math.pi * self.sigma_mm * frequency) ** 2) * self.raised(frequency, pixel_mm)
        return result


def normal_share(x: Floats) -> Floats:
    """Return the cumulative distribution of the standard normal distribution at each x."""
    result: Floats = np.interp(x, _AT, _NORMAL)
    return result


def _ramp(x: Floats, sigma_mm: float) -> Floats:
    """Return the integral from minus infinity to x of a unit step at 0 that is blurred by ``sigma_mm``."""
    if sigma_mm <= 0.0:
        return np.maximum(x, 0.0)
    s = x / sigma_mm
    result: Floats = x * normal_share(s) + sigma_mm * np.exp(-0.5 * s * s) / math.sqrt(2.0 * math.pi)
    return result


def _edge(x: Floats, box_mm: float, sigma_mm: float) -> Floats:
    """Return the values at x of a unit step at 0 that is blurred by ``sigma_mm`` and averaged over ``box_mm``."""
    result: Floats = (_ramp(x + 0.5 * box_mm, sigma_mm) - _ramp(x - 0.5 * box_mm, sigma_mm)) / box_mm
    return result


def reach_mm(box_mm: float, sigma_mm: float) -> float:
    """Return the maximum distance from a voxel's centre at which the scene contributes to the voxel, mm."""
    return 0.5 * box_mm + REACH_SIGMAS * sigma_mm


def step_weights(at_mm: Floats, cells_mm: Floats, cell_mm: float, box_mm: float, sigma_mm: float) -> Floats:
    """Return exact weights (m, n) of n cells of constant value, ``cell_mm`` wide, for m voxels ``box_mm`` wide."""
    u = at_mm[:, None] - cells_mm[None, :]
    half = 0.5 * cell_mm
    weights: Floats = _edge(u + half, box_mm, sigma_mm) - _edge(u - half, box_mm, sigma_mm)
    return weights


def sampled_weights(at_mm: Floats, cells_mm: Floats, cell_mm: float, box_mm: float, sigma_mm: float) -> Floats:
    """Return weights (m, n) of n point samples, ``cell_mm`` apart, for m voxels ``box_mm`` wide.

    The weights are accurate if ``cell_mm`` is smaller than ``sigma_mm``.
    """
    u = (at_mm[:, None] - cells_mm[None, :]) / sigma_mm
    half = 0.5 * box_mm / sigma_mm
    weights: Floats = (normal_share(u + half) - normal_share(u - half)) * (cell_mm / box_mm)
    return weights


def _frequencies(shape_yx: tuple[int, int], spacing_yx: tuple[float, float]) -> Floats:
    fy = np.fft.fftfreq(shape_yx[0], spacing_yx[0])[:, None]
    fx = np.fft.rfftfreq(shape_yx[1], spacing_yx[1])[None, :]
    result: Floats = np.hypot(fy, fx)
    return result


def sharpened_slice(values: NDArray[np.float32], kernel: Kernel, pixel_mm: float) -> NDArray[np.float32]:
    """Return a slice (ny, nx) with the kernel's overshoot; ``values`` are already blurred by the kernel's Gaussian."""
    if kernel.overshoot <= 0.0:
        return values
    padded = np.pad(values, EDGE_PAD, mode="edge")
    raised = kernel.raised(_frequencies(padded.shape, (pixel_mm, pixel_mm)), pixel_mm)
    spectrum = np.fft.rfft2(padded) * raised.astype(np.float32)
    result = np.fft.irfft2(spectrum, s=padded.shape)
    ny, nx = values.shape
    return result[EDGE_PAD : EDGE_PAD + ny, EDGE_PAD : EDGE_PAD + nx].astype(np.float32)


def noise_of_slice(
    shape_yx: tuple[int, int], kernel: Kernel, pixel_mm: float, noise_hu: float, seed: tuple[int, ...]
) -> NDArray[np.float32]:
    """Return noise (ny, nx) of mean 0 and standard deviation ``noise_hu`` with the kernel's spectrum."""
    white = np.random.default_rng(seed).standard_normal(shape_yx, dtype=np.float32)
    frequency = _frequencies(shape_yx, (pixel_mm, pixel_mm))
    amplitude = np.sqrt(frequency) * kernel.transfer(frequency, pixel_mm)
    # A column of the half spectrum represents two frequencies, except the first and, for even nx, the last.
    twice = np.full(frequency.shape[1], 2.0)
    twice[0] = 1.0
    if shape_yx[1] % 2 == 0:
        twice[-1] = 1.0
    power = float((amplitude**2 * twice).sum() / (shape_yx[0] * shape_yx[1]))
    spectrum = np.fft.rfft2(white) * (amplitude * (noise_hu / math.sqrt(power))).astype(np.float32)
    return np.fft.irfft2(spectrum, s=shape_yx).astype(np.float32)
