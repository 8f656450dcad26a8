"""The scanner of painted CTs: from a scene to voxels by exact weights, then the kernel's edges and its noise.

Along each axis a voxel is the scene's mean over the voxel's own width, blurred by the kernel: weights of one axis are a
small matrix, and a volume is three products. A sharp kernel is a narrow blur whose edges are raised in plane by a
difference of Gaussians. Noise has the spectrum that filtered back-projection leaves: frequency times the square of the
kernel's transfer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Kernel", "noise_of_slice", "normal_share", "reach_mm", "sampled_weights", "sharpened_slice", "step_weights"]

Floats = NDArray[np.float64]

# The normal distribution on a grid fine enough for 1e-6 between its points.
_STEP = 0.0025
_AT = np.arange(-8.0, 8.0 + _STEP, _STEP)
_NORMAL = np.array([0.5 * math.erfc(-x / math.sqrt(2.0)) for x in _AT])
REACH_SIGMAS = 4.5
EDGE_PAD = 12


@dataclass(frozen=True, slots=True)
class Kernel:
    """A reconstruction kernel, as what it does to an edge."""

    sigma_mm: float
    """Of the Gaussian in plane, beside the voxel's own width."""
    overshoot: float = 0.0
    """How far an edge in plane runs over, as a share of its height; 0: a plain Gaussian."""
    surround_mm: float = 0.65
    """Sigma of the further blur that is taken away for the overshoot: how wide the seam beside an edge is."""

    def gain(self, pixel_mm: float) -> float:
        """The weight of the difference of Gaussians that makes :attr:`overshoot` in pixels of this width."""
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
        """What the overshoot multiplies a frequency (1/mm, in plane) by."""
        surround = np.exp(-2.0 * (math.pi * self.surround_mm * frequency) ** 2)
        result: Floats = 1.0 + self.gain(pixel_mm) * (1.0 - surround)
        return result

    def transfer(self, frequency: Floats, pixel_mm: float) -> Floats:
        """The kernel's transfer at a frequency (1/mm, in plane), without the voxel's width."""
        result: Floats = np.exp(-2.0 * (math.pi * self.sigma_mm * frequency) ** 2) * self.raised(frequency, pixel_mm)
        return result


def normal_share(x: Floats) -> Floats:
    """Return the share of the standard normal distribution below each x."""
    result: Floats = np.interp(x, _AT, _NORMAL)
    return result


def _ramp(x: Floats, sigma_mm: float) -> Floats:
    """The integral of a blurred step up to x."""
    if sigma_mm <= 0.0:
        return np.maximum(x, 0.0)
    s = x / sigma_mm
    result: Floats = x * normal_share(s) + sigma_mm * np.exp(-0.5 * s * s) / math.sqrt(2.0 * math.pi)
    return result


def _edge(x: Floats, box_mm: float, sigma_mm: float) -> Floats:
    """A unit step at 0 as voxels of this width show it at x."""
    result: Floats = (_ramp(x + 0.5 * box_mm, sigma_mm) - _ramp(x - 0.5 * box_mm, sigma_mm)) / box_mm
    return result


def reach_mm(box_mm: float, sigma_mm: float) -> float:
    """How far from a voxel's centre the scene still has a say in it."""
    return 0.5 * box_mm + REACH_SIGMAS * sigma_mm


def step_weights(at_mm: Floats, cells_mm: Floats, cell_mm: float, box_mm: float, sigma_mm: float) -> Floats:
    """Weights (m, n) of n cells of constant value, ``cell_mm`` wide, in m voxels ``box_mm`` wide. Exact."""
    u = at_mm[:, None] - cells_mm[None, :]
    half = 0.5 * cell_mm
    weights: Floats = _edge(u + half, box_mm, sigma_mm) - _edge(u - half, box_mm, sigma_mm)
    return weights


def sampled_weights(at_mm: Floats, cells_mm: Floats, cell_mm: float, box_mm: float, sigma_mm: float) -> Floats:
    """Weights (m, n) of n samples ``cell_mm`` apart, in m voxels, with no blur of their own; for cells below sigma."""
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
    """A slice (ny, nx) that the kernel's Gaussian has blurred, with the kernel's overshoot."""
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
    """Noise (ny, nx) of this standard deviation whose spectrum follows the kernel; its mean over the slice is 0."""
    white = np.random.default_rng(seed).standard_normal(shape_yx, dtype=np.float32)
    frequency = _frequencies(shape_yx, (pixel_mm, pixel_mm))
    amplitude = np.sqrt(frequency) * kernel.transfer(frequency, pixel_mm)
    # Columns of a half spectrum stand for two frequencies, but the first and, where nx is even, the last.
    twice = np.full(frequency.shape[1], 2.0)
    twice[0] = 1.0
    if shape_yx[1] % 2 == 0:
        twice[-1] = 1.0
    power = float((amplitude**2 * twice).sum() / (shape_yx[0] * shape_yx[1]))
    spectrum = np.fft.rfft2(white) * (amplitude * (noise_hu / math.sqrt(power))).astype(np.float32)
    return np.fft.irfft2(spectrum, s=shape_yx).astype(np.float32)
