"""Flood of the airway lumen from the trachea, repeated in smoothed copies if noise has opened the airway walls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina._core import flood_lumen
from carina.errors import NoResultError, UsageError
from carina.track.find.kernel_compensation import SoftenedCt
from carina.track.find.root_checks import LUNG_HU
from carina.track.intensity_levels import AirScale
from carina.track.progress import Stages
from carina.volume.model import Volume

MIN_WALL_CONTRAST_HU = 60.0
# Volume in mm3 above which an air space that the flood enters counts as a leak; a trachea has 20 to 40 ml.
LEAK_MM3 = 60_000.0
# Volume in mm3 above which a basin without a wall counts as a leak.
SMALL_LEAK_MM3 = 3_000.0
# Radius in mm of the ball that is closed round the entry of a leak.
CLOSED_RADIUS_MM = 10.0
# Volume in mm3 of a lumen above which, together with its share of lung and lumen, the lumen contains lung; trachea and
# bronchi have 40 to 100 ml.
MAX_LUMEN_MM3 = 150_000.0
# Share of the lung above which a flooded lumen counts as a leak.
MAX_LUNG_SHARE = 0.1
# Sigmas in mm of the smoothed copies in which a flood that leaked is repeated.
SMOOTHED_MM = (0.7, 1.0, 1.5)


@dataclass(frozen=True, slots=True, eq=False)
class Flood:
    """Result of a flood: lumen, leaks and the statistics of the air."""

    searched: SoftenedCt
    """Volume that was flooded: the original or a smoothed copy."""
    lumen: NDArray[np.uint8]
    """Lumen (nz, ny, nx), 1 inside."""
    leaks_lps: NDArray[np.float64]
    """Points (n, 3) at which the flood was stopped because it would have leaked, LPS in mm."""
    num_voxels: int
    """Number of voxels of the lumen."""
    air: float
    """Value of the air in the trachea, in the units of the volume; ``noise`` is its standard deviation."""
    noise: float
    core: int
    """Maximum value of air with its noise, in the units of the volume."""


def flood(
    soft: SoftenedCt,
    seeds: Sequence[tuple[int, int, int]],
    scale: AirScale,
    stage: Stages,
    *,
    end: int,
    is_default: bool,
) -> Flood:
    """Flood the lumen of the airways from the trachea.

    Parameters
    ----------
    soft
        CT that is searched; lumen that was clipped at its lowest value is restored in place.
    seeds
        Voxels (i, j, k) in the air of the trachea.
    end
        Voxel value at which the lumen ends, in the unit of the volume (HU for a CT in HU).
    is_default
        Whether ``end`` is the default rather than a choice of the user. A flood that fills the lung is then repeated in
        more and more smoothed copies, because noise opens walls (docs/decisions/0113).

    Raises
    ------
    UsageError
        If ``end`` is below the value of air.
    NoResultError
        If the flood fills the lung in every copy.
    """
    air, noise = _air_and_noise(soft.volume, seeds, scale)
    if end < air:
        msg = (
            f"the lumen threshold {end} is below the CT value of the air in the trachea ({air:.0f}), so too little "
            f"would count as lumen; choose at least {round(air + 2.5 * noise)}"
        )
        raise UsageError(msg)
    soft.restore_clipped_lumen(scale, noise)
    noise_hu, min_contrast = noise / scale.span(1.0), scale.span(MIN_WALL_CONTRAST_HU)
    for sigma_mm in (0.0, *SMOOTHED_MM):
        searched = soft
        if sigma_mm > 0.0:
            searched = soft.smoothed(sigma_mm)
            air, noise = _air_and_noise(searched.volume, seeds, scale)
            if end < air:
                break
        found = _flood_with_noise(searched, seeds, stage, end=end, air=air, noise=noise, min_contrast=min_contrast)
        if not is_default or not _is_lung(soft.volume, found.lumen, scale):
            return found
    msg = (
        f"the airways cannot be distinguished from the lung: noise of {noise_hu:.0f} HU in the trachea hides their "
        "walls. Open a reconstruction with a softer kernel or thicker slices"
    )
    raise NoResultError(msg)


def _flood_with_noise(
    searched: SoftenedCt,
    seeds: Sequence[tuple[int, int, int]],
    stage: Stages,
    *,
    end: int,
    air: float,
    noise: float,
    min_contrast: float,
) -> Flood:
    volume = searched.volume
    core = min(round(air + 2.5 * noise), end)
    lumen, report = flood_lumen(
        volume.hu_zyx,
        volume.lps_from_ijk,
        list(seeds),
        first_level=round(air - noise),
        core_level=core,
        last_level=end,
        leak_mm3=LEAK_MM3,
        small_leak_mm3=SMALL_LEAK_MM3,
        closed_radius_mm=CLOSED_RADIUS_MM,
        min_contrast=min_contrast,
        cancel=stage.cancel,
        progress=stage.share,
    )
    leaks = np.array([place for place, _ in report["leaks"]], dtype=np.float64).reshape(-1, 3)
    return Flood(searched, lumen, leaks, int(report["num_voxels"]), air, noise, core)


def _is_lung(volume: Volume, lumen: NDArray[np.uint8], scale: AirScale) -> bool:
    """Return whether a lumen is larger than airways can be, because it leaked through walls that noise had opened."""
    voxel_mm3 = abs(float(np.linalg.det(volume.lps_from_ijk[:3, :3])))
    flooded = int(np.count_nonzero(lumen))
    if flooded * voxel_mm3 <= MAX_LUMEN_MM3:
        return False
    low, high = (scale.level(hu) for hu in LUNG_HU)
    # Slices are counted one by one to avoid a second volume. The flood is included, because it may have filled the
    # lung.
    lung = sum(int(np.count_nonzero((values >= low) & (values <= high))) for values in volume.hu_zyx)
    return flooded > MAX_LUNG_SHARE * (lung + flooded)


def _air_and_noise(volume: Volume, seeds: Sequence[tuple[int, int, int]], scale: AirScale) -> tuple[float, float]:
    """Return the median value of the air round the seeds and its standard deviation, in the units of the volume."""
    sample = _values_round(volume, seeds)
    middle = float(np.median(sample))
    # A median deviation is used, so that mucus or a ventilator's tube does not change the result.
    return middle, max(1.4826 * float(np.median(np.abs(sample - middle))), scale.span(5.0), 0.7)


def _values_round(volume: Volume, seeds: Sequence[tuple[int, int, int]]) -> NDArray[np.float64]:
    """Return the values (n,) of the seed voxels and of their neighbours within one voxel."""
    at = np.array(seeds)
    offsets = np.stack(np.meshgrid(*[np.arange(-1, 2)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    voxels = (at[:, None, :] + offsets[None]).reshape(-1, 3)
    voxels = np.unique(np.clip(voxels, 0, np.array(volume.shape_zyx[::-1]) - 1), axis=0)
    return volume.hu_zyx[voxels[:, 2], voxels[:, 1], voxels[:, 0]].astype(np.float64)
