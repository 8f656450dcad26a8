"""A CT with a sharp reconstruction kernel as a softer one would show it: what the kernel raised is lowered again."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from carina._core import keep_cut_off_air_of, mix_with_blurs
from carina.track.find.disturbed import Disturbed
from carina.track.find.kernel import edge_undershoot_hu, undershoots_hu
from carina.track.levels import AirScale
from carina.track.paths.path_grid import DividedSlices
from carina.volume.model import Volume

__all__ = ["Softened", "as_it_is", "softened"]

# How wide the seam is that a kernel lays beside an edge (sigma): 0.6 to 1.1 mm is made good by this. None is narrower
# than the voxels.
SEAM_MM = 0.7
SEAM_VOXELS = 1.1
# Undershoot up to this is what CTs with soft kernels show, with as much as 60 HU of noise: patients -24 to -2 HU,
# phantoms -9 to 2. A softened CT is left with it: more softening only takes small airways away (docs/decisions/0113).
SOFT_HU = 3.0
# A copy that leaks with such rims is softened so much: what is left of its noise opens walls.
SOFTEST_HU = -8.0
# No kernel in use raises fine detail more than so many times; beyond, noise is all that there is.
MOST_RAISED = 3.2
STEPS = 5
# The amount is found on so much of the middle of the volume.
SLAB_MM = 40.0
LEAST_SLAB = 24
# Most files end here. Where one goes on, what is darker inside a small tube is air all the same.
FLOOR_HU = -1024.0
AIR_HU = -1000.0
# A wall's rise over a lumen that was cut off; a rim beside tissue has lung on its other sides.
WALL_RISE_HU = 250.0
# So much above air the softened CT is air for certain: so many deviations of its noise, or this.
CERTAIN_NOISES = 2.5
CERTAIN_HU = 40.0


@dataclass(frozen=True, slots=True)
class Softened:
    """What the airways are searched in."""

    volume: Volume
    """As a soft kernel would show it; the CT itself where its kernel is soft."""
    undershoot_hu: float | None
    """How much darker lung is beside edges in the CT; None where that was not to be found."""
    raised: float
    """How much the kernel raises the finest detail, as a factor less 1; 0 where it is soft."""
    smoothed_mm: float
    """Sigma of the Gaussian that took noise away; 0 where there was no need."""
    _sharp: Volume
    _values: NDArray[np.int16] | None
    """Those of ``volume``, to write to; None where it is the CT itself."""
    left_hu: float | None = None
    """How much darker lung is beside edges in a softened ``volume``, before lumen that was cut off is restored, which
    the measurement would take for rims; None where ``volume`` was not softened."""
    can_be_softened: bool = False
    """Whether the caller searches a softened copy if this search leaks."""
    divided: DividedSlices | None = None
    """The slices of the CT that were divided to make ``volume``; None where it has the CT's own."""
    disturbed: Disturbed | None = None
    """Parts of the CT whose values prove no small airway; None where they were not searched for."""

    def smoothed(self, sigma_mm: float) -> Softened:
        """Return a copy smoothed by a Gaussian of ``sigma_mm``, or of as many voxels if they are larger than 1 mm."""
        sigma_mm *= max(min(self.volume.spacing_mm), 1.0)
        values = mix_with_blurs(
            self.volume.hu_zyx,
            self.volume.lps_from_ijk,
            own=0.0,
            blurs=[(1.0, sigma_mm)],
            axes_ijk=(True, True, True),
        )
        volume = dataclasses.replace(self.volume, hu_zyx=values)
        return dataclasses.replace(self, volume=volume, smoothed_mm=sigma_mm, _values=None, left_hu=None)

    def walled(self, wall: Callable[[NDArray[np.int16]], None]) -> Softened:
        """Return a copy in which ``wall`` has made some air tissue; it changes the values (nz, ny, nx) in place."""
        values = self.volume.hu_zyx.copy()
        wall(values)
        volume = dataclasses.replace(self.volume, hu_zyx=values)
        if self._values is None:
            return dataclasses.replace(self, volume=volume)
        sharp = self._sharp.hu_zyx.copy()
        wall(sharp)
        return dataclasses.replace(
            self, volume=volume, _sharp=dataclasses.replace(self._sharp, hu_zyx=sharp), _values=values
        )

    def keep_cut_off_lumen(self, scale: AirScale, noise: float) -> None:
        """Make air of the airways' lumen that was cut off at the least value of the CT.

        The kernel made it darker than air, so what lay below the least value is missing, and lowering what the kernel
        raised leaves it brighter than it is.

        Parameters
        ----------
        noise
            In the trachea of ``volume``, in its numbers.
        """
        if self._values is None:
            return
        air = scale.level(AIR_HU)
        keep_cut_off_air_of(
            self._sharp.hu_zyx,
            self._sharp.lps_from_ijk,
            self._values,
            floor=max(self._sharp.value_range[0], round(scale.level(FLOOR_HU))),
            air=round(air),
            certain=round(air + max(CERTAIN_NOISES * noise, scale.span(CERTAIN_HU))),
            rise=round(scale.span(WALL_RISE_HU)),
            seam_mm=2.0 * _seam_mm(self._sharp),
        )


def as_it_is(volume: Volume, undershoot_hu: float | None = None) -> Softened:
    """Return the CT itself, whatever its kernel.

    Parameters
    ----------
    volume
        The CT.
    undershoot_hu
        Depth of its rims, if a softened copy is to be searched where the search of the CT itself leaks along them.
    """
    return Softened(volume, undershoot_hu, 0.0, 0.0, volume, None, can_be_softened=undershoot_hu is not None)


def softened(volume: Volume, scale: AirScale, most_hu: float = SOFT_HU) -> Softened:
    """Return the CT without what its kernel raised, if the kernel is an edge-enhancing one.

    The kernel is taken for one that raises detail by ``1 + a (1 - g)``, where g is a Gaussian's transfer (its blur:
    :data:`SEAM_MM`). The inverse never raises anything, noise least of all. ``a`` is the least with which the dark rims
    beside soft tissue are at most ``most_hu`` deep, in the plane or the direction in which there are rims.
    """
    undershoot = edge_undershoot_hu(volume, scale)
    if undershoot is None or undershoot <= SOFT_HU:
        return Softened(volume, undershoot, 0.0, 0.0, volume, None)
    slab = _middle_of(volume)
    x, y, z = (depth is not None and depth > SOFT_HU for depth in undershoots_hu(slab, scale))
    axes = (x, y, z)
    if not any(axes):
        return Softened(volume, undershoot, 0.0, 0.0, volume, None)

    def is_soft(raised: float) -> bool:
        lowered = dataclasses.replace(slab, hu_zyx=_lowered(slab, raised, axes))
        left = undershoots_hu(lowered, scale)
        depths = [depth for depth, is_sharp in zip(left, axes, strict=True) if is_sharp and depth is not None]
        return not depths or float(np.mean(depths)) <= most_hu

    low, high = 0.0, MOST_RAISED
    if is_soft(high):
        for _ in range(STEPS):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if is_soft(middle) else (middle, high)
    values = _lowered(volume, high, axes)
    copy = dataclasses.replace(volume, hu_zyx=values)
    return Softened(copy, undershoot, high, 0.0, volume, values, edge_undershoot_hu(copy, scale))


def _middle_of(volume: Volume) -> Volume:
    num = max(int(np.ceil(SLAB_MM / volume.spacing_mm[2])), LEAST_SLAB)
    first = max((volume.shape_zyx[0] - num) // 2, 0)
    return dataclasses.replace(volume, hu_zyx=volume.hu_zyx[first : first + num])


def _lowered(volume: Volume, raised: float, axes: tuple[bool, bool, bool]) -> NDArray[np.int16]:
    blurs = inverse_of(round(raised, 6), _seam_mm(volume))
    return mix_with_blurs(
        volume.hu_zyx, volume.lps_from_ijk, own=1.0 / (1.0 + raised), blurs=list(blurs), axes_ijk=axes
    )


def _seam_mm(volume: Volume) -> float:
    return max(SEAM_MM, SEAM_VOXELS * min(volume.spacing_mm))


@lru_cache(maxsize=64)
def inverse_of(raised: float, seam_mm: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return two Gaussians that sum to the inverse of ``1 + a (1 - g)`` less ``1 / (1 + a)``: weight and sigma in mm.

    The exact inverse is an infinite sum of Gaussians. Two of them differ from it by at most 0.005 at any frequency.
    """
    frequency = np.linspace(0.0, 1.2 / seam_mm, 300)

    def transfer(sigma_mm: float | NDArray[np.float64]) -> NDArray[np.float64]:
        result: NDArray[np.float64] = np.exp(-2.0 * (np.pi * np.multiply.outer(sigma_mm, frequency)) ** 2)
        return result

    rest = 1.0 / (1.0 + raised * (1.0 - transfer(seam_mm))) - 1.0 / (1.0 + raised)
    # Even values must stay as they are.
    total = raised / (1.0 + raised)
    narrow, wide = seam_mm * np.linspace(0.7, 1.3, 31), seam_mm * np.linspace(1.15, 2.8, 34)
    of_wide = transfer(wide)
    best = (np.inf, 0.0, 0.0, 0.0)
    for sigma_mm in narrow:
        difference = transfer(sigma_mm) - of_wide
        missing = rest - total * of_wide
        power = (difference**2).sum(axis=1)
        weight = (difference * missing).sum(axis=1) / np.maximum(power, 1e-12)
        off = np.abs(weight[:, None] * difference - missing).max(axis=1)
        n = int(off.argmin())
        best = min(best, (float(off[n]), float(weight[n]), float(sigma_mm), float(wide[n])))
    _, weight_of_narrow, narrow_mm, wide_mm = best
    return (weight_of_narrow, narrow_mm), (total - weight_of_narrow, wide_mm)
