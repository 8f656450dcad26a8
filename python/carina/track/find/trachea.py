"""Corrections of the trachea's lumen, slice by slice."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carina.track.find.air_upwards import Section, disc, spread
from carina.volume.model import Volume

__all__ = ["add_sections", "fill_trachea"]

# Half the side of the examined window: more than the radius of any trachea.
MAX_TRACHEA_RADIUS_MM = 18.0
# Margin round a section within which the lumen is limited to it, in voxels.
BESIDE = 8
# Largest notch that is filled between a tube on the wall and the rest of the trachea.
NOTCH_MM = 4.5


def fill_trachea(volume: Volume, lumen: NDArray[np.uint8], seeds: NDArray[np.int_]) -> None:
    """Fill the holes of the trachea's lumen in each slice: a ventilator tube must not divide it into two airways.

    Parameters
    ----------
    volume
        The CT.
    lumen
        (nz, ny, nx) uint8, 1 inside; changed in place.
    seeds
        (n, 3) voxels (i, j, k) of the trachea, one in each of its slices.
    """
    up = np.abs(volume.lps_from_ijk[2, :3]) / np.array(volume.spacing_mm)
    axis = int(np.argmax(up))
    across = [a for a in range(3) if a != axis]
    # A view with the first index along the trachea: changes to it change the lumen.
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
    """Join the air in a tube, the air round the tube and the tube itself into one lumen.

    The step is needed for a tube that touches the wall, because the air round it then does not enclose the tube.

    Parameters
    ----------
    lumen
        (nz, ny, nx) uint8, 1 inside, in canonical order; changed in place.
    spacing_mm
        Size of the voxels along x, y and z.
    sections
        Sections of the trachea that contain the tube.
    cut
        Sections beside an opening in the neck: the lumen is limited to these sections.
    """
    notch = disc(NOTCH_MM, (spacing_mm[1], spacing_mm[0]))
    for section in sections:
        window = section.window_of(lumen)
        window[section.whole] = 1
        # Beside a tube that touches the wall, the air forms two narrow horns, which are not airways: fill the notches.
        beside = spread(section.whole, notch)
        window[beside & ~spread(~spread((window != 0) & beside, notch), notch)] = 1
    for section in cut:
        window = section.window_of(lumen)
        at = np.argwhere(section.whole)
        # Limit the change to the part of the slice that can be connected to the section.
        low, high = np.maximum(at.min(axis=0) - BESIDE, 0), at.max(axis=0) + BESIDE + 1
        near = (slice(low[0], high[0]), slice(low[1], high[1]))
        window[near][~section.whole[near]] = 0
