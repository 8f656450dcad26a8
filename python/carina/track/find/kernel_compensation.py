"""Compensation of a sharp reconstruction kernel: copies of a CT in which the enhancement of detail is reversed."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from carina._core import keep_cut_off_air_of, mix_with_blurs
from carina.track.find.artefact_regions import ArtefactRegions
from carina.track.find.kernel_sharpness import edge_undershoot_hu, undershoots_hu
from carina.track.intensity_levels import AirScale
from carina.track.paths.path_grid import DividedSlices
from carina.volume.model import Volume

# Sigma in mm of the seam (the rim that a sharp kernel produces beside an edge) that is compensated; no seam is
# narrower than the voxels.
SEAM_MM = 0.7
# Minimum sigma of the compensated seam, in voxels.
SEAM_VOXELS = 1.1
# Undershoot in HU up to which a kernel counts as soft; a softened CT keeps this undershoot (docs/decisions/0113).
SOFT_HU = 3.0
# Undershoot in HU of the more strongly softened copy, which is searched if the first softened copy leaks too.
SOFTEST_HU = -8.0
# Maximum factor by which a kernel in use enhances fine detail; a larger estimate comes from noise.
MAX_RAISED = 3.2
# Number of iterations (trial softening, then measurement) that determine the amount of softening.
STEPS = 5
# Thickness in mm of the slab in the middle of the volume from which the amount of softening is determined.
SLAB_MM = 40.0
# Minimum number of slices of the slab in which the amount of softening is measured.
MIN_SLAB = 24
# Lowest value in HU that most files store; darker values of a sharp kernel are clipped to it.
FLOOR_HU = -1024.0
# Voxel value of air in HU.
AIR_HU = -1000.0
# Minimum rise in HU from a clipped lumen to its wall; a rim beside tissue has lung on its other sides.
WALL_RISE_HU = 250.0
# Distance of the limit of certain air above the value of air, in standard deviations of the noise.
CERTAIN_NOISES = 2.5
# Distance of the limit of certain air above the value of air, in HU.
CERTAIN_HU = 40.0


@dataclass(frozen=True, slots=True)
class SoftenedCt:
    """CT that is searched for airways, with a record of how it was softened or smoothed."""

    volume: Volume
    """CT as a soft kernel would show it; the original if its kernel is soft."""
    undershoot_hu: float | None
    """Undershoot in HU beside edges of the original CT (how much darker lung is there).

    None if it was not measurable.
    """
    raised: float
    """Factor by which the kernel enhances the finest detail, minus 1; 0 if the kernel is soft."""
    smoothed_mm: float
    """Sigma of the Gaussian that removed noise, in mm; 0 if the volume was not smoothed."""
    _sharp: Volume
    _values: NDArray[np.int16] | None
    """Values of ``volume``, writable; None if ``volume`` is the original CT."""
    left_hu: float | None = None
    """Undershoot in HU that remains in a softened ``volume``; None if ``volume`` was not softened.

    The undershoot is measured before clipped lumen is restored, because the measurement would take that lumen for
    rims.
    """
    can_be_softened: bool = False
    """Whether the caller searches a softened copy if this search leaks."""
    divided: DividedSlices | None = None
    """Division of the slices of the CT that made ``volume``; None if ``volume`` has the original slices."""
    disturbed: ArtefactRegions | None = None
    """Parts of the CT whose values do not prove a small airway; None if they were not searched for."""

    def smoothed(self, sigma_mm: float) -> SoftenedCt:
        """Return a copy smoothed by a Gaussian of ``sigma_mm`` (in units of the voxel size if voxels exceed 1 mm)."""
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

    def with_wall(self, wall: Callable[[NDArray[np.int16]], None]) -> SoftenedCt:
        """Return a copy in which ``wall`` has replaced air by tissue; it changes the values (nz, ny, nx) in place."""
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

    def restore_clipped_lumen(self, scale: AirScale, noise: float) -> None:
        """Restore the lumen of airways that was clipped at the lowest value of the CT.

        The kernel made this lumen darker than air, so the values below the lowest value of the CT are missing, and the
        compensation of the kernel makes the lumen brighter than it is.

        Parameters
        ----------
        scale
            Conversion from HU to the values of the volume.
        noise
            Standard deviation of the voxel values of air in the trachea of ``volume``.
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


def unsoftened(volume: Volume, undershoot_hu: float | None = None) -> SoftenedCt:
    """Return the original CT for a search, unchanged whatever its kernel is.

    Parameters
    ----------
    volume
        The CT.
    undershoot_hu
        Depth of its rims, if a softened copy is to be searched after a leak along the rims; otherwise None.
    """
    return SoftenedCt(volume, undershoot_hu, 0.0, 0.0, volume, None, can_be_softened=undershoot_hu is not None)


def soften(volume: Volume, scale: AirScale, most_hu: float = SOFT_HU) -> SoftenedCt:
    """Return a CT with the enhancement of an edge-enhancing kernel reversed; the original if the kernel is soft.

    The kernel is modelled as ``1 + a (1 - g)``, where g is the transfer function of a Gaussian (its sigma:
    :data:`SEAM_MM`). The inverse never amplifies anything, in particular no noise. ``a`` is the smallest value for
    which the dark rims beside soft tissue are at most ``most_hu`` deep, along the axes that have rims.
    """
    undershoot = edge_undershoot_hu(volume, scale)
    if undershoot is None or undershoot <= SOFT_HU:
        return SoftenedCt(volume, undershoot, 0.0, 0.0, volume, None)
    slab = _central_part(volume)
    x, y, z = (depth is not None and depth > SOFT_HU for depth in undershoots_hu(slab, scale))
    axes = (x, y, z)
    if not any(axes):
        return SoftenedCt(volume, undershoot, 0.0, 0.0, volume, None)

    def is_soft(raised: float) -> bool:
        lowered = dataclasses.replace(slab, hu_zyx=_lower_detail(slab, raised, axes))
        left = undershoots_hu(lowered, scale)
        depths = [depth for depth, is_sharp in zip(left, axes, strict=True) if is_sharp and depth is not None]
        return not depths or float(np.mean(depths)) <= most_hu

    low, high = 0.0, MAX_RAISED
    if is_soft(high):
        for _ in range(STEPS):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if is_soft(middle) else (middle, high)
    values = _lower_detail(volume, high, axes)
    copy = dataclasses.replace(volume, hu_zyx=values)
    return SoftenedCt(copy, undershoot, high, 0.0, volume, values, edge_undershoot_hu(copy, scale))


def _central_part(volume: Volume) -> Volume:
    num = max(int(np.ceil(SLAB_MM / volume.spacing_mm[2])), MIN_SLAB)
    first = max((volume.shape_zyx[0] - num) // 2, 0)
    return dataclasses.replace(volume, hu_zyx=volume.hu_zyx[first : first + num])


def _lower_detail(volume: Volume, raised: float, axes: tuple[bool, bool, bool]) -> NDArray[np.int16]:
    blurs = inverse_of(round(raised, 6), _seam_mm(volume))
    return mix_with_blurs(
        volume.hu_zyx, volume.lps_from_ijk, own=1.0 / (1.0 + raised), blurs=list(blurs), axes_ijk=axes
    )


def _seam_mm(volume: Volume) -> float:
    return max(SEAM_MM, SEAM_VOXELS * min(volume.spacing_mm))


@lru_cache(maxsize=64)
def inverse_of(raised: float, seam_mm: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return weight and sigma (mm) of two Gaussians that approximate the inverse of ``1 + a (1 - g)``.

    The sum of the Gaussians is the inverse less ``1 / (1 + a)``. The exact inverse is an infinite sum of Gaussians;
    two of them differ from it by at most 0.005 at any frequency.
    """
    frequency = np.linspace(0.0, 1.2 / seam_mm, 300)

    def transfer(sigma_mm: float | NDArray[np.float64]) -> NDArray[np.float64]:
        result: NDArray[np.float64] = np.exp(-2.0 * (np.pi * np.multiply.outer(sigma_mm, frequency)) ** 2)
        return result

    rest = 1.0 / (1.0 + raised * (1.0 - transfer(seam_mm))) - 1.0 / (1.0 + raised)
    # The weights must keep uniform values unchanged.
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
