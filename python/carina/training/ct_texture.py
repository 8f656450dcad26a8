"""Blur and noise of a part of a CT, measured on its own edges and soft tissue, for structures that are inserted.

The blur is the median profile of edges between lung and soft tissue, in a slice and across slices. The noise is the
autocovariance of homogeneous soft tissue in a slice and across slices, which determines its power at all frequencies.
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
"""Maximum standard deviation in HU of one side of an edge, above that of the noise."""
MAX_SLOPE_ACROSS, MAX_TILT_MM, MAX_TILT_VOXELS = 0.3, 0.2, 0.3
"""Maximum slope across the axis of an edge, as a share of the slope along the axis, and maximum shift of the edge
between neighbouring voxels across the axis: in mm, or in voxels along the axis if that is more.

The blur across thick slices widens the profile of an oblique edge in the slice. The shift is compared with the voxel,
because the blur of large voxels is wider.
"""
LEAST_EDGES = 40
BIN_MM, NEAR_EDGE_MM, EDGE_OFFSETS = 0.1, 3.5, 12
"""Width in mm of the bins of an edge profile, largest distance from the edge, and number of edge positions."""
SIGMAS_MM = np.arange(0.15, 2.01, 0.025)
"""Standard deviations in mm of the Gaussian blurs that are compared with the profile of an edge."""
GAINS = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0)
"""Weights that are tried for the difference of Gaussians in slices, which makes the overshoot of a sharp kernel."""
CLEARLY_BETTER = 0.7
"""Maximum ratio of the squared error of a fit with another gain to that of the best earlier fit, to replace it."""
SURROUND_MM = 0.65
"""Standard deviation in mm of the second Gaussian of the overshoot, added in quadrature."""
FLAT_HU = (-30.0, 140.0)
"""Range in HU of smoothed values of homogeneous soft tissue."""
SOFTEN_MM = 0.9
"""Standard deviation in mm of the smoothing before soft tissue is selected."""
MARGIN_MM, NEAR_LUNG_MM = 2.5, 18.0
"""Minimum distance in mm of soft tissue from other tissue, and maximum distance from lung.

The noise of shoulders and spine differs from that at the lung.
"""
TREND_MM = 9.0
"""Standard deviation in mm of the local mean that is subtracted from soft tissue: anatomy, not noise."""
LAG_MM = 6.0
"""Maximum distance in mm between voxels whose covariance is measured; beyond half of this distance it is faded to 0."""
MOST_SPREAD = 4.0
"""Maximum deviation from the local mean, in standard deviations; calcifications and strands of fat are left out."""
LEAST_VOXELS = 1500
POWER_STEPS = 30
"""Number of bisections that find the power to subtract from a spectrum."""
FAR_SHARE = 0.6
"""Share of `LAG_MM` from which the noise of two voxels of a slice is independent."""
MOST_PAIRS, LEAST_PAIRS = 100_000, 0.02
"""Maximum number of pairs of voxels for a distance, and minimum share of the voxels that have a partner there."""
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
    covariance_zyx: Floats
    """(2c+1, 2b+1, 2a+1) covariance in HU2 of two voxels by their distance; the middle is the variance."""
    num_edges: tuple[int, int, int]
    num_voxels: int
    """Number of voxels of soft tissue in which the noise was measured."""

    def noise(self, shape_zyx: tuple[int, int, int], seed: int) -> Values:
        """Return Gaussian noise (nz, ny, nx) in HU with the measured covariance."""
        rng = np.random.default_rng([seed, 46])
        reach = [n // 2 for n in self.covariance_zyx.shape]
        # The margin keeps opposite faces of the periodic noise independent.
        wide = [n + 2 * far for n, far in zip(shape_zyx, reach, strict=True)]
        power = self._power(wide)
        grains = np.fft.irfftn(np.fft.rfftn(rng.standard_normal(wide)) * np.sqrt(power), s=wide, axes=(0, 1, 2))
        nz, ny, nx = shape_zyx
        return np.asarray(grains[:nz, :ny, :nx], dtype=np.float32)

    def _power(self, wide_zyx: list[int]) -> Floats:
        """Return the power of each frequency of a periodic grid, the Fourier transform of the covariance."""
        around = np.zeros(wide_zyx)
        reach = [n // 2 for n in self.covariance_zyx.shape]
        around[tuple(slice(0, n) for n in self.covariance_zyx.shape)] = self.covariance_zyx
        around = np.roll(around, [-far for far in reach], axis=(0, 1, 2))
        power = np.fft.rfftn(around).real
        weights = np.full(power.shape[-1], 2.0)
        weights[0] = 1.0
        if wide_zyx[-1] % 2 == 0:
            weights[-1] = 1.0
        weights /= math.prod(wide_zyx)
        # An estimated covariance has some negative power. Without it the variance would be too large, and the noise too
        # fine; a subtraction from all frequencies gives the nearest spectrum with the variance.
        low, high = 0.0, max(float(power.max()), 0.0)
        for _ in range(POWER_STEPS):
            off = 0.5 * (low + high)
            if float((power - off).clip(0.0).sum(axis=(0, 1)) @ weights) > self.noise_hu**2:
                low = off
            else:
                high = off
        return np.asarray((power - low).clip(0.0))


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
        covariance, num_voxels = _covariance(values, spacing_mm)
    except NoResultError:
        if wider_zyx is None:
            raise
        covariance, num_voxels = _covariance(wider, spacing_mm)
    noise_hu = math.sqrt(float(covariance.max()))
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
    in_plane = [_fit(*edges[n], spacing_mm[n], gains=GAINS) for n in (0, 1)]
    gain = float(np.mean([one[1] for one in in_plane]))
    across = _fit(*edges[2], spacing_mm[2], gains=(0.0,))
    # The two axes of a slice have the same kernel. Motion and fat widen the edges of the heart and of the mediastinum,
    # which are most of the edges along one axis, so the narrower blur is that of the kernel.
    sigma = min(_fit(*edges[n], spacing_mm[n], gains=(gain,))[0] for n in (0, 1))
    counts = tuple(len(at) for at, _ in edges)
    return CtTexture(
        (sigma, sigma, across[0]), gain, noise_hu, covariance, (counts[0], counts[1], counts[2]), num_voxels
    )


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
    tilt_mm = max(MAX_TILT_MM, MAX_TILT_VOXELS * step)
    limits = [min(MAX_SLOPE_ACROSS, tilt_mm / spacing_mm[a]) for a in order]
    size = along.shape[-1]
    if size < 2 * half + 3:
        return np.empty(0), np.empty(0)
    middle = slice(half, size - half)
    rise = np.abs(slopes[2])
    peak = (rise[..., middle] >= rise[..., half - 1 : size - half - 1]) & (
        rise[..., middle] > rise[..., half + 1 : size - half + 1]
    )
    straight = np.hypot(slopes[0] / limits[0], slopes[1] / limits[1])[..., middle] < rise[..., middle]
    at = np.argwhere(peak & straight & (rise[..., middle] > 60.0))
    if len(at) == 0:
        return np.empty(0), np.empty(0)
    at = at[np.linspace(0, len(at) - 1, min(len(at), 60_000)).astype(int)]
    runs = along[at[:, 0, None], at[:, 1, None], at[:, 2, None] + np.arange(2 * half + 1)[None]].astype(np.float64)
    # Runs of voxels that begin in tissue are reversed, so that lung is the first side of every edge.
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
    off_mm, shares = _registered(shares, step)
    near = np.abs(off_mm) <= NEAR_EDGE_MM
    return off_mm[near], shares[near]


def _registered(shares: Floats, step: float) -> tuple[Floats, Floats]:
    """Return the positions in mm of the samples of edges (n, m) from the edge itself, and the samples."""
    # The first crossing of one half from the last sample below it, by linear interpolation.
    last = shares.shape[1] - 1 - np.argmax(shares[:, ::-1] < 0.5, axis=1)
    last = np.minimum(last, shares.shape[1] - 2)
    rows = np.arange(len(shares))
    a, b = shares[rows, last], shares[rows, last + 1]
    cross = last + (0.5 - a) / np.where(np.abs(b - a) < 1e-6, 1.0, b - a)
    return (np.arange(shares.shape[1])[None] - cross[:, None]) * step, shares


def _fit(at: Floats, shares: Floats, step: float, *, gains: tuple[float, ...]) -> tuple[float, float]:
    """Return the standard deviation (mm) and the gain of the blur whose edge fits the median profile best.

    Parameters
    ----------
    at, shares
        (n,) positions in mm and values of all edges.
    step
        Distance of two voxels in mm.
    gains
        Gains among which the best is chosen.
    """
    places, y = _binned(at, shares)
    best = (np.inf, 0.0, 0.0)
    for gain in gains:
        for sigma in SIGMAS_MM:
            # Compare with a sampled edge: large voxels make the profile wider than the blur alone.
            off = float(np.square(_sampled_edge(float(sigma), gain, step, places) - y).mean())
            # Without a visible overshoot, gain and width replace each other; the plain blur is then preferred.
            if off < best[0] * (1.0 if gain == best[2] else CLEARLY_BETTER):
                best = (off, float(sigma), gain)
    return best[1], best[2]


def _binned(at: Floats, shares: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Return the numbers of the bins of an edge profile, and the median value of each."""
    bins = np.round(at / BIN_MM).astype(np.int64)
    places = np.array([one for one in np.unique(bins) if np.count_nonzero(bins == one) >= 8])
    return places, np.array([float(np.median(shares[bins == one])) for one in places])


def _sampled_edge(sigma_mm: float, gain: float, step: float, places: NDArray[np.int64]) -> Floats:
    """Return the profile, at the bins, of blurred edges whose positions are found between voxels."""
    half = math.ceil((NEAR_EDGE_MM + step) / step)
    offsets = (np.arange(EDGE_OFFSETS) + 0.5) / EDGE_OFFSETS - 0.5
    exact = (np.arange(-half, half + 1)[None] + offsets[:, None]) * step
    at, shares = _registered(edge_shares(exact, sigma_mm, gain), step)
    order = np.argsort(at.reshape(-1))
    return np.asarray(np.interp(BIN_MM * places, at.reshape(-1)[order], shares.reshape(-1)[order]))


def edge_shares(x_mm: Floats, sigma_mm: float, gain: float) -> Floats:
    """Return the values at positions across an edge of height 1 at 0, blurred and sharpened."""
    narrow = 0.5 * (1.0 + _ERF(x_mm / (sigma_mm * math.sqrt(2.0))))
    if gain == 0.0:
        return np.asarray(narrow)
    wide = 0.5 * (1.0 + _ERF(x_mm / (math.hypot(sigma_mm, SURROUND_MM) * math.sqrt(2.0))))
    return np.asarray(narrow + gain * (narrow - wide))


def _covariance(values: Values, spacing_mm: tuple[float, float, float]) -> tuple[Floats, int]:
    """Return the covariance (2c+1, 2b+1, 2a+1) of two voxels of soft tissue by their distance, and the voxel count.

    The covariance is the variance less half of the squared differences of voxels at a distance. The median of the
    differences determines their square: seams of fat and vessels, which few pairs cross, are anatomy and no noise. The
    covariance is the product of that in a slice and that across slices, so that few numbers are estimated.
    """
    spacing_zyx = spacing_mm[::-1]
    mask = _soft_tissue(values, spacing_zyx)
    rest, mask = _residual(values, mask, spacing_zyx)
    num = int(mask.sum())
    if num < LEAST_VOXELS:
        raise NoResultError(
            f"measuring the noise of the CT: expected at least {LEAST_VOXELS} voxels of homogeneous soft tissue near "
            f"the position; found {num}; choose another position",
            code="insert.no-noise",
        )
    lags = [max(1, math.floor(LAG_MM / one)) for one in spacing_zyx]
    pairs = _Pairs(rest, mask, lags)
    c, b, a = lags
    in_slice = np.full((2 * b + 1, 2 * a + 1), np.nan)
    for j, i in np.ndindex(b + 1, 2 * a + 1):
        if j > 0 or i > a:
            in_slice[b + j, i] = in_slice[b - j, 2 * a - i] = pairs.half_square((0, j, i - a))
    y_mm, x_mm = (np.arange(-lag, lag + 1) * one for lag, one in zip(lags[1:], spacing_zyx[1:], strict=True))
    away_mm = np.hypot(y_mm[:, None], x_mm[None, :])
    # The noise of distant voxels is independent, so half of their squared differences is the variance.
    far = away_mm >= min(FAR_SHARE * LAG_MM, float(away_mm.max()))
    variance = float(np.nanmedian(in_slice[far])) if np.isfinite(in_slice[far]).any() else float(np.nanmax(in_slice))
    in_slice[b, a] = 0.0
    across = np.array([0.0, *(pairs.half_square((k, 0, 0)) for k in range(1, c + 1))])
    # Distances with too few pairs have no covariance.
    plane, depth = (np.nan_to_num(variance - one) for one in (in_slice, across))
    z_mm = np.arange(-c, c + 1) * spacing_zyx[0]
    covariance = depth[np.abs(np.arange(-c, c + 1)), None, None] / max(variance, 1e-9) * plane
    fade = np.clip((LAG_MM - np.hypot(z_mm[:, None, None], away_mm)) / (0.5 * LAG_MM), 0.0, 1.0)
    # At large distances the covariance comes from anatomy that the local mean did not remove.
    return covariance * (0.5 - 0.5 * np.cos(math.pi * fade)), num


class _Pairs:
    """Pairs of voxels of soft tissue at a distance, from a sample of the first voxels.

    Parameters
    ----------
    rest, mask
        (nz, ny, nx) differences from the local mean, and voxels of soft tissue.
    lags
        Maximum distances in voxels along z, y and x.
    """

    def __init__(self, rest: Floats, mask: NDArray[np.bool_], lags: list[int]) -> None:
        # The margin without tissue lets all distances be offsets in memory.
        wide = [(lag, lag) for lag in lags]
        self._mask = np.pad(mask, wide).ravel()
        # Values are whole HU, and so would be the median of their differences.
        dither = np.random.default_rng(45).uniform(-0.5, 0.5, rest.shape)
        self._rest = np.pad((rest + dither).astype(np.float32), wide).ravel()
        shape = [n + 2 * lag for n, lag in zip(rest.shape, lags, strict=True)]
        self._strides = (shape[1] * shape[2], shape[2], 1)
        places = np.flatnonzero(self._mask)
        self._places = places[np.linspace(0, len(places) - 1, min(len(places), MOST_PAIRS)).astype(np.int64)]

    def half_square(self, lag_zyx: tuple[int, int, int]) -> float:
        """Return half of the mean squared difference of voxels at a distance, by its median; nan with few pairs."""
        step = sum(lag * stride for lag, stride in zip(lag_zyx, self._strides, strict=True))
        first = self._places[self._mask[self._places + step]]
        if len(first) < LEAST_PAIRS * len(self._places):
            return math.nan
        away = float(np.median(np.abs(self._rest[first + step] - self._rest[first])))
        # Rounding and dither add 1/12 HU2 each to the variance of a voxel.
        return max(0.0, 0.5 * (1.4826 * away) ** 2 - 1.0 / 6.0)


def _residual(
    values: Values, mask: NDArray[np.bool_], spacing_zyx: tuple[float, ...]
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the differences of soft tissue from its local mean, and the mask without large differences."""
    trend = _spread_in(spacing_zyx, TREND_MM)
    weight = smoothed(mask.astype(np.float32), trend)
    mean = smoothed(np.where(mask, values, np.float32(0.0)), trend) / np.maximum(weight, np.float32(1e-3))
    rest = np.where(mask, values - mean, np.float32(0.0)).astype(np.float64)
    if mask.any():
        spread = 1.4826 * float(np.median(np.abs(rest[mask])))
        mask = mask & (np.abs(rest) <= MOST_SPREAD * max(spread, 1.0))
    return rest * mask, mask


def _soft_tissue(values: Values, spacing_zyx: tuple[float, ...]) -> NDArray[np.bool_]:
    """Return the mask of homogeneous soft tissue that is near the lung, without its boundaries."""
    soft = smoothed(values, _spread_in(spacing_zyx, SOFTEN_MM))
    flat = (soft > FLAT_HU[0]) & (soft < FLAT_HU[1])
    lung = (soft > LUNG_HU[0]) & (soft < LUNG_HU[1])
    flat = ~_grown(~flat, spacing_zyx, MARGIN_MM)
    found: NDArray[np.bool_] = flat & _grown(lung, spacing_zyx, NEAR_LUNG_MM)
    return found


def _spread_in(spacing_zyx: tuple[float, ...], sigma_mm: float) -> tuple[float, float, float]:
    """Return a standard deviation in voxels along z, y and x."""
    z, y, x = (max(sigma_mm / one, 0.1) for one in spacing_zyx)
    return z, y, x


def _grown(mask: NDArray[np.bool_], spacing_zyx: tuple[float, ...], reach_mm: float) -> NDArray[np.bool_]:
    """Return a mask that also contains each voxel within ``reach_mm``, along every axis, of a voxel of the mask."""
    found = mask
    for axis, one in enumerate(spacing_zyx):
        reach = max(1, round(reach_mm / one))
        # The difference of two cumulative sums is the number of mask voxels in a window along the axis.
        pad = [(reach + 1, reach) if a == axis else (0, 0) for a in range(3)]
        sums = np.cumsum(np.pad(found.astype(np.int32), pad), axis=axis)
        high, low = (np.take(sums, np.arange(start, start + mask.shape[axis]), axis=axis) for start in
                     (2 * reach + 1, 0))  # fmt: skip
        found = high > low
    return found
