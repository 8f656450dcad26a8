"""Blur and noise of a part of a CT, measured on its own edges and soft tissue, for structures that are inserted.

The blur is the median profile of edges between lung and soft tissue, along each axis of the voxels; the noise is the
power spectrum of homogeneous soft tissue in the slices, and its correlation between slices.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.errors import NoResultError
from carina.plan.cubic_box import smoothed

Values = NDArray[np.float32]
Floats = NDArray[np.float64]

LUNG_HU, TISSUE_HU = (-1000.0, -650.0), (-120.0, 160.0)
"""Ranges in HU of the two sides of an edge."""
SIDE_MM = 2.4
"""Distance in mm on both sides of an edge in which the CT must be homogeneous for the edge to be measured."""
SIDE_SPREAD_HU = 90.0
"""Largest standard deviation in HU of one side of an edge, above that of the noise."""
MAX_SLOPE_ACROSS = 0.3
"""Largest slope across the axis of an edge, as a share of the slope along the axis."""
LEAST_EDGES = 40
BIN_MM = 0.1
SIGMAS_MM = np.arange(0.15, 2.01, 0.025)
"""Standard deviations in mm of the Gaussian blur among which the best is chosen."""
GAINS = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0)
"""Weights of the difference of Gaussians in slices, which makes the overshoot of a sharp kernel."""
CLEARLY_BETTER = 0.7
"""Largest ratio of the squared errors of two fits with which a larger gain is chosen."""
SURROUND_MM = 0.65
"""Standard deviation in mm of the second Gaussian of the overshoot, added in quadrature."""
PATCH = 12
"""Side in pixels of a patch on which the noise is measured."""
FLAT_HU = (-30.0, 140.0)
"""Range in HU of the smoothed values of a patch of soft tissue whose noise is measured."""
FLAT_SPREAD_HU = 60.0
"""Largest range in HU of the smoothed values within a patch whose noise is measured."""
LEAST_PATCHES = 8
MAX_PATCHES = 400
_ERF = np.vectorize(math.erf, otypes=[np.float64])


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class CtTexture:
    """Blur and noise of a part of a CT."""

    sigma_mm: tuple[float, float, float]
    """Standard deviation in mm of the blur along the voxel axes i, j, k, with the voxel's width."""
    gain: float
    """Weight of the difference of Gaussians in the slices (i, j); 0 for a kernel without overshoot."""
    noise_hu: float
    """Standard deviation of the noise in soft tissue, HU."""
    power: Floats
    """(n,) mean power of the noise at ``frequency``, in the slices."""
    frequency: Floats
    """(n,) frequencies in cycles per pixel, ascending."""
    between_slices: float
    """Correlation of the noise of neighbouring slices."""
    num_edges: tuple[int, int, int]
    num_patches: int

    def noise(self, shape_zyx: tuple[int, int, int], seed: int) -> Values:
        """Return noise (nz, ny, nx) in HU with the measured spectrum and standard deviation."""
        rng = np.random.default_rng([seed, 46])
        nz, ny, nx = shape_zyx
        wide = (ny + 2 * PATCH, nx + 2 * PATCH)
        white = rng.standard_normal((nz + 8, *wide))
        fy, fx = np.fft.fftfreq(wide[0])[:, None], np.fft.rfftfreq(wide[1])[None, :]
        amplitude = np.sqrt(np.interp(np.hypot(fy, fx), self.frequency, self.power))
        grains = np.fft.irfft2(np.fft.rfft2(white, axes=(1, 2)) * amplitude, s=wide, axes=(1, 2))
        if self.between_slices > 0.02:
            # Noise that a Gaussian of s slices smooths has the correlation exp(-1 / (4 s^2)) between neighbours.
            grains = _along_first(grains, 0.5 / math.sqrt(-math.log(min(self.between_slices, 0.95))))
        grains = grains[4 : 4 + nz, PATCH : PATCH + ny, PATCH : PATCH + nx]
        # The standard deviation of the whole is exact, whatever the filters do to it.
        return np.asarray(grains * (self.noise_hu / max(float(grains.std()), 1e-9)), dtype=np.float32)


def measured_texture(
    hu_zyx: NDArray[np.int16], spacing_mm: tuple[float, float, float], *, wider_zyx: NDArray[np.int16] | None = None
) -> CtTexture:
    """Measure the blur and the noise of a part of a CT.

    Parameters
    ----------
    hu_zyx
        (nz, ny, nx) HU.
    wider_zyx
        Larger part of the CT, in which edges and soft tissue are searched if the first part has too few; None for none.
    spacing_mm
        Voxel spacing along i, j, k.

    Raises
    ------
    NoResultError
        ``insert.no-edges`` or ``insert.no-noise``: too few edges or too little soft tissue.
    """
    values = hu_zyx.astype(np.float32)
    wider = values if wider_zyx is None else wider_zyx.astype(np.float32)
    try:
        noise_hu, power, frequency, between, num_patches = _noise(values)
    except NoResultError:
        if wider_zyx is None:
            raise
        noise_hu, power, frequency, between, num_patches = _noise(wider)
    edges = []
    for axis in range(3):
        found = _edge_profile(values, axis, spacing_mm, noise_hu)
        if len(found[0]) == 0 and wider_zyx is not None:
            found = _edge_profile(wider, axis, spacing_mm, noise_hu)
        edges.append(found)
    if min(len(at) for at, _ in edges) == 0:
        raise NoResultError(
            f"measuring the blur of the CT: expected at least {LEAST_EDGES} edges between lung and soft tissue along "
            "each axis near the position; found fewer; choose a position nearer to the wall of the chest",
            code="insert.no-edges",
        )
    in_plane = [_fit(*edge[:2], gains=GAINS) for edge in edges[:2]]
    gain = float(np.mean([one[1] for one in in_plane]))
    across = _fit(*edges[2][:2], gains=(0.0,))
    # The two axes of a slice have the same kernel; one gain is fitted to both.
    sigma_i, sigma_j = (_fit(*edge[:2], gains=(gain,))[0] for edge in edges[:2])
    counts = tuple(len(at) for at, _ in edges)
    return CtTexture(
        (sigma_i, sigma_j, across[0]), gain, noise_hu, power, frequency, between,
        (counts[0], counts[1], counts[2]), num_patches,
    )  # fmt: skip


def _edge_profile(
    values: Values, axis_ijk: int, spacing_mm: tuple[float, float, float], noise_hu: float
) -> tuple[Floats, Floats]:
    """Return positions in mm and normalised values, 0 to 1, of all edges along an axis; empty if there are too few."""
    step = spacing_mm[axis_ijk]
    along = np.moveaxis(values, 2 - axis_ijk, -1)
    side = max(2, round(SIDE_MM / step))
    half = side + max(2, math.ceil(1.5 / step))
    # Slopes are measured on smoothed values; an edge is where the slope along the axis is largest.
    soft = smoothed(values, 0.8)
    slopes = [np.gradient(np.moveaxis(soft, 2 - axis_ijk, -1), axis=n) for n in range(3)]
    order = [a for a in (2, 1, 0) if a != axis_ijk]
    slopes[0], slopes[1] = (slopes[n] * step / spacing_mm[a] for n, a in enumerate(order))
    size = along.shape[-1]
    if size < 2 * half + 3:
        return np.empty(0), np.empty(0)
    middle = slice(half, size - half)
    rise = np.abs(slopes[2])
    peak = (rise[..., middle] >= rise[..., half - 1 : size - half - 1]) & (
        rise[..., middle] > rise[..., half + 1 : size - half + 1]
    )
    straight = np.hypot(slopes[0], slopes[1])[..., middle] < MAX_SLOPE_ACROSS * rise[..., middle]
    at = np.argwhere(peak & straight & (rise[..., middle] > 60.0))
    if len(at) == 0:
        return np.empty(0), np.empty(0)
    at = at[np.linspace(0, len(at) - 1, min(len(at), 60_000)).astype(int)]
    runs = along[at[:, 0, None], at[:, 1, None], at[:, 2, None] + np.arange(2 * half + 1)[None]].astype(np.float64)
    # Every run is turned so that lung comes first.
    turned = runs[:, 0] > runs[:, -1]
    runs[turned] = runs[turned, ::-1]
    low, high = runs[:, :side], runs[:, -side:]
    lows, highs = np.median(low, axis=1), np.median(high, axis=1)
    most = SIDE_SPREAD_HU + 1.5 * noise_hu
    good = (lows > LUNG_HU[0]) & (lows < LUNG_HU[1]) & (highs > TISSUE_HU[0]) & (highs < TISSUE_HU[1])
    good &= (low.std(axis=1) < most) & (high.std(axis=1) < most)
    runs, lows, highs = runs[good], lows[good], highs[good]
    if len(runs) < LEAST_EDGES:
        return np.empty(0), np.empty(0)
    shares = (runs - lows[:, None]) / (highs - lows)[:, None]
    # The first crossing of one half from the last sample below it, by linear interpolation.
    below = shares < 0.5
    last = np.array([int(np.flatnonzero(row)[-1]) for row in below])
    last = np.minimum(last, shares.shape[1] - 2)
    rows = np.arange(len(shares))
    a, b = shares[rows, last], shares[rows, last + 1]
    cross = last + (0.5 - a) / np.where(np.abs(b - a) < 1e-6, 1.0, b - a)
    positions = (np.arange(shares.shape[1])[None] - cross[:, None]) * step
    near = np.abs(positions) <= 3.5
    return positions[near], shares[near]


def _fit(at: Floats, shares: Floats, *, gains: tuple[float, ...]) -> tuple[float, float]:
    """Return the standard deviation (mm) and the gain of the blur whose edge fits the median profile best."""
    bins = np.round(at / BIN_MM).astype(int)
    places = np.unique(bins)
    found = [(one, float(np.median(shares[bins == one]))) for one in places if np.count_nonzero(bins == one) >= 8]
    x = np.array([one * BIN_MM for one, _ in found])
    y = np.array([share for _, share in found])
    best = (np.inf, 0.0, 0.0)
    for gain in gains:
        for sigma in SIGMAS_MM:
            off = float(np.square(edge_shares(x, float(sigma), gain) - y).mean())
            # Without a visible overshoot, gain and width replace each other; the plain blur is then preferred.
            if off < best[0] * (1.0 if gain == best[2] else CLEARLY_BETTER):
                best = (off, float(sigma), gain)
    return best[1], best[2]


def edge_shares(x_mm: Floats, sigma_mm: float, gain: float) -> Floats:
    """Return the values at positions across an edge of height 1 at 0, blurred and sharpened."""
    narrow = 0.5 * (1.0 + _ERF(x_mm / (sigma_mm * math.sqrt(2.0))))
    if gain == 0.0:
        return np.asarray(narrow)
    wide = 0.5 * (1.0 + _ERF(x_mm / (math.hypot(sigma_mm, SURROUND_MM) * math.sqrt(2.0))))
    return np.asarray(narrow + gain * (narrow - wide))


def _noise(values: Values) -> tuple[float, Floats, Floats, float, int]:
    """Return the noise of a CT in flat patches of soft tissue.

    The items are the standard deviation, the power by spatial frequency, the correlation between adjacent slices, and
    the number of patches that were measured.
    """
    soft = smoothed(values, 1.5)
    nz, ny, nx = values.shape
    y, x = np.mgrid[0:PATCH, 0:PATCH].reshape(2, -1) / PATCH - 0.5
    plain = np.stack([np.ones_like(x), x, y, x * y, x * x, y * y], axis=1)
    remove = np.eye(PATCH * PATCH) - plain @ np.linalg.pinv(plain)
    window = np.hanning(PATCH + 2)[1:-1]
    window2 = np.outer(window, window)
    fy, fx = np.fft.fftfreq(PATCH)[:, None], np.fft.fftfreq(PATCH)[None, :]
    rings = np.round(np.hypot(fy, fx) * PATCH).astype(int)
    residuals: list[Floats] = []
    pairs: list[float] = []
    for k in range(nz):
        for j in range(0, ny - PATCH + 1, PATCH // 2):
            for i in range(0, nx - PATCH + 1, PATCH // 2):
                part = soft[k, j : j + PATCH, i : i + PATCH]
                low, high = float(part.min()), float(part.max())
                if low < FLAT_HU[0] or high > FLAT_HU[1] or high - low > FLAT_SPREAD_HU:
                    continue
                one = remove @ values[k, j : j + PATCH, i : i + PATCH].reshape(-1).astype(np.float64)
                residuals.append(one)
                if k + 1 < nz:
                    other = remove @ values[k + 1, j : j + PATCH, i : i + PATCH].reshape(-1).astype(np.float64)
                    pairs.append(float(one @ other / max(math.sqrt((one @ one) * (other @ other)), 1e-9)))
    if len(residuals) < LEAST_PATCHES:
        raise NoResultError(
            f"measuring the noise of the CT: expected at least {LEAST_PATCHES} patches of homogeneous soft tissue near "
            f"the position; found {len(residuals)}; choose another position",
            code="insert.no-noise",
        )
    chosen = np.array(residuals)[np.linspace(0, len(residuals) - 1, min(len(residuals), MAX_PATCHES)).astype(int)]
    spread = chosen.std(axis=1)
    # A detrended patch lacks the part of the noise that the six terms of the trend explain.
    full = math.sqrt(PATCH * PATCH / (PATCH * PATCH - 6.0))
    noise_hu = full * float(np.median(spread))
    near = spread <= 1.5 * float(np.median(spread))
    spectra = np.abs(np.fft.fft2(chosen[near].reshape(-1, PATCH, PATCH) * window2)) ** 2
    mean = spectra.mean(axis=0)
    top = PATCH // 2
    power = np.array([mean[rings == n].mean() for n in range(1, top + 1)] + [mean[rings > top].mean()])
    frequency = np.array([*(np.arange(1, top + 1) / PATCH), 0.6])
    return noise_hu, power, frequency, float(np.median(pairs)) if pairs else 0.0, len(residuals)


def _along_first(values: Floats, sigma: float) -> Floats:
    """Return values smoothed along the first axis by a Gaussian, with periodic ends."""
    reach = max(1, math.ceil(3.0 * sigma))
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    found = np.zeros_like(values)
    for shift, weight in zip(range(-reach, reach + 1), weights, strict=True):
        found += weight * np.roll(values, shift, axis=0)
    return found / math.sqrt(float(np.square(weights).sum()))
