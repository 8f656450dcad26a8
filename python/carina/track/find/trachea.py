"""The trachea's lumen, slice by slice."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carina.track.find.air_upwards import Section, disc, spread
from carina.volume.model import Volume

__all__ = ["add_sections", "fill_trachea"]

# Wider than any trachea.
MAX_TRACHEA_RADIUS_MM = 18.0
# Voxels.
BESIDE = 8
# A notch this wide between a tube and the wall that it lies on, and the rest of the trachea, is part of it.
NOTCH_MM = 4.5


def fill_trachea(volume: Volume, lumen: NDArray[np.uint8], seeds: NDArray[np.int_]) -> None:
    """Fill, in each slice of the trachea, what its lumen encloses: a ventilator's tube is no wall between two airways.

    Parameters
    ----------
    lumen
        (nz, ny, nx) uint8, 1 inside; changed in place.
    seeds
        (n, 3) voxels (i, j, k) of the trachea, one in each of its slices.
    """
    up = np.abs(volume.lps_from_ijk[2, :3]) / np.array(volume.spacing_mm)
    axis = int(np.argmax(up))
    across = [a for a in range(3) if a != axis]
    # Slices of the lumen, first index along the trachea; a view, so that what is filled is filled in the lumen.
    slices = lumen.transpose(2, 1, 0).transpose(axis, *across)
    reach = [int(np.ceil(MAX_TRACHEA_RADIUS_MM / volume.spacing_mm[a])) for a in across]
    for seed in seeds:
        low = [max(int(seed[a]) - r, 0) for a, r in zip(across, reach, strict=True)]
        part = slices[seed[axis], low[0] : seed[across[0]] + reach[0] + 1, low[1] : seed[across[1]] + reach[1] + 1]
        outside = np.zeros(np.array(part.shape) + 2, dtype=np.bool_)
        outside[[0, -1], :] = outside[:, [0, -1]] = True
        free = np.pad(part == 0, 1, constant_values=True)
        while True:
            wider = outside.copy()
            wider[1:] |= outside[:-1]
            wider[:-1] |= outside[1:]
            wider[:, 1:] |= outside[:, :-1]
            wider[:, :-1] |= outside[:, 1:]
            wider &= free
            if wider.sum() == outside.sum():
                break
            outside = wider
        part[~outside[1:-1, 1:-1]] = 1


def add_sections(
    lumen: NDArray[np.uint8], spacing_mm: tuple[float, float, float], sections: list[Section], cut: list[Section]
) -> None:
    """Make one lumen of a tube's air, the air round it and the tube between them: one on the wall encloses none.

    Parameters
    ----------
    lumen
        (nz, ny, nx) uint8, 1 inside, in canonical order; changed in place.
    spacing_mm
        Of its voxels, along x, y and z.
    cut
        Sections beside an opening in the neck: the lumen there ends where they end.
    """
    notch = disc(NOTCH_MM, (spacing_mm[1], spacing_mm[0]))
    for section in sections:
        window = section.window_of(lumen)
        window[section.whole] = 1
        # Where a tube lies on the trachea's wall, air runs out into two horns beside it: no airways.
        beside = spread(section.whole, notch)
        window[beside & ~spread(~spread((window != 0) & beside, notch), notch)] = 1
    for section in cut:
        window = section.window_of(lumen)
        at = np.argwhere(section.whole)
        # Not beyond what can hang together with it in its slice.
        low, high = np.maximum(at.min(axis=0) - BESIDE, 0), at.max(axis=0) + BESIDE + 1
        near = (slice(low[0], high[0]), slice(low[1], high[1]))
        window[near][~section.whole[near]] = 0
