"""Cross-sections of the trachea's air, followed upwards slice by slice into larynx and throat."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from carina.errors import CancelledError
from carina.track.intensity_levels import AirScale
from carina.track.progress import Stages
from carina.volume.model import Volume

Scalar = TypeVar("Scalar", bound=np.generic)

# Half the side length in mm of the square window that is examined in each slice.
WINDOW_MM = 45.0
# Maximum movement in mm of a section's edge per mm of height; it prevents following air that leaves the trachea
# sideways or forwards.
SPREAD_PER_MM = 1.0
# Maximum thickness in mm of a tube's wall across which air still belongs to the section; tube walls are up to 1.5 mm
# thick.
BRIDGED_MM = 1.2
# Maximum height in mm over which the air between trachea and larynx may be invisible because the vocal cords are
# closed.
LOST_MM = 14.0
# Upper limit in HU of air across the wall of a tube; lung is brighter.
AIR_HU = -930.0
# Maximum distance in mm across the wall of a tube at which air is still added.
BESIDE_MM = 3.2
# Distance in mm round a section within which the peak of its surroundings is measured.
ROUND_MM = 2.5
# Minimum area in mm2 of a tube's material (plastic and its radiopaque line) between air and air.
SEPTUM_MM2 = 12.0
# Minimum peak value in HU of the material between two areas of air that is a tube's wall and not tissue.
SEPTUM_HU = 150.0
# Number of sections with a tube's material in the air, from which the air counts as the lumen of a tube.
IN_A_TUBE = 3


@dataclass(frozen=True, slots=True, eq=False)
class AirSection:
    """Section of the air of trachea, larynx or throat in one slice."""

    k: int
    """Index k of the section's slice."""
    corner: tuple[int, int]
    """Indices (j, i) of the first voxel of the window that the masks cover."""
    air: NDArray[np.bool_]
    """Mask (ny, nx) of the section's air, in the window."""
    whole: NDArray[np.bool_]
    """Mask (ny, nx) of the air and of material that the air encloses or nearly encloses, such as the wall of a tube."""
    voxel: tuple[int, int, int]
    """Voxel (i, j, k) of the section's air that is nearest to the section's centre."""
    centre_lps: NDArray[np.float64]
    """Centre of the section, LPS in mm."""
    area_mm2: float
    """Area of the section with the material that its air encloses (``whole``), mm2."""
    width_mm: float
    """Extent of the section from right to left, mm."""
    depth_mm: float
    """Extent of the section from front to back, mm."""
    septum_mm2: float
    """Area of the material that the section's air encloses, mm2."""
    septum_hu: float
    """Median value of the enclosed material in HU; NaN if there is none."""
    noise_hu: float
    """Standard deviation of the section's air in HU, estimated from the median deviation."""
    peak: float
    """Highest voxel value in the section or within a few voxels round it, HU; the wall of a tube is brighter than
    tissue."""
    leaves_in_front: bool
    """Whether the air continues in front of the section, outside the part that is followed."""

    def window_of(self, values: NDArray[Scalar]) -> NDArray[Scalar]:
        """Return the part of (nz, ny, nx) values that the masks of this section cover."""
        j, i = self.corner
        nj, ni = self.air.shape
        return values[self.k, j : j + nj, i : i + ni]


def disc(radius_mm: float, step_mm: tuple[float, float]) -> list[tuple[int, int]]:
    """Return the offsets (j, i) of the pixels within a radius of a pixel, without (0, 0)."""
    rj, ri = (int(radius_mm / step) for step in step_mm)
    return [
        (j, i)
        for j in range(-rj, rj + 1)
        for i in range(-ri, ri + 1)
        if (j, i) != (0, 0) and np.hypot(j * step_mm[0], i * step_mm[1]) <= radius_mm
    ]


def dilate(mask: NDArray[np.bool_], offsets: list[tuple[int, int]]) -> NDArray[np.bool_]:
    """Return the union of a mask and copies of it moved by each offset (dilation)."""
    out = mask.copy()
    nj, ni = mask.shape
    for j, i in offsets:
        if abs(j) >= nj or abs(i) >= ni:
            continue
        out[max(j, 0) : nj + min(j, 0), max(i, 0) : ni + min(i, 0)] |= mask[
            max(-j, 0) : nj + min(-j, 0), max(-i, 0) : ni + min(-i, 0)
        ]
    return out


SIDES = [(-1, 0), (1, 0), (0, -1), (0, 1)]


def connected_to(start: NDArray[np.bool_], within: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pixels of a mask that are connected to start pixels through pixel sides."""
    out = start & within
    size = -1
    while size != (size := int(out.sum())):
        # Several steps are grown between two counts, because counting costs as much as a step.
        for _ in range(4):
            out = dilate(out, SIDES) & within
    return out


def with_holes_filled(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask (ny, nx) with its holes filled."""
    outside = np.zeros_like(mask)
    outside[[0, -1], :] = outside[:, [0, -1]] = True
    return ~connected_to(outside, ~mask)


def close_gaps(mask: NDArray[np.bool_], offsets: list[tuple[int, int]]) -> NDArray[np.bool_]:
    """Return a mask with gaps narrower than the disc of the offsets closed, and then its holes filled."""
    wider = dilate(np.pad(mask, 4), offsets)
    tight = ~dilate(~wider, offsets)
    return with_holes_filled(tight[4:-4, 4:-4] | mask)


def follow_up(
    volume: Volume, scale: AirScale, air: float, start: tuple[int, int, int], stage: Stages, *, down: bool = False
) -> list[AirSection]:
    """Return the sections of the trachea's air from a voxel upwards, until the air or the scan ends.

    Each section is the air that touches the section below it. The air in a tube and the air round the tube are one
    section.

    Parameters
    ----------
    volume
        Volume in canonical order: slices from the feet up.
    scale
        Conversion from HU to the values of the volume.
    air
        Largest voxel value that counts as air, in the unit of the volume (HU for a CT in HU).
    start
        Voxel (i, j, k) in the air of the trachea.
    stage
        Cancels the search.
    down
        Whether to follow the air downwards instead.

    Raises
    ------
    CancelledError
        If the stage was cancelled.
    """
    dx, dy, dz = volume.spacing_mm
    step = (dy, dx)
    size = [int(np.ceil(WINDOW_MM / s)) for s in step]
    _, nj, ni = volume.shape_zyx
    bridge = disc(BRIDGED_MM + 0.7 * max(dx, dy), step)
    limit = disc(max(SPREAD_PER_MM * dz, dx, dy) + 0.3, step)
    beside, close_by = disc(BESIDE_MM + 0.5 * max(dx, dy), step), disc(ROUND_MM, step)
    strict, to_hu = scale.level(AIR_HU), 1.0 / scale.span(1.0)
    zero = scale.level(0.0)
    found: list[AirSection] = []
    i, j, k = start
    below: NDArray[np.bool_] | None = None
    corner = (0, 0)
    lost_mm, tubes = 0.0, 0
    for k in range(start[2], -1, -1) if down else range(start[2], volume.shape_zyx[0]):
        if stage.cancel is not None and stage.cancel():
            raise CancelledError("stopped while finding the airways")
        moved = (min(max(j - size[0], 0), max(nj - 2 * size[0], 0)), min(max(i - size[1], 0), max(ni - 2 * size[1], 0)))
        values = volume.hu_zyx[k, moved[0] : moved[0] + 2 * size[0], moved[1] : moved[1] + 2 * size[1]]
        is_air = values < air
        if below is None:
            last = np.zeros(values.shape, dtype=np.bool_)
            last[j - moved[0], i - moved[1]] = True
            seeds, allowed = last, np.ones_like(last)
        else:
            last = _move_mask(below, moved[0] - corner[0], moved[1] - corner[1], values.shape)
            seeds, allowed = last, dilate(last, limit)
        region = connected_to(seeds & is_air, is_air & allowed)
        if tubes >= IN_A_TUBE:
            # Only air across the tube's wall is added. If connected air could also spread by ``beside`` in each slice,
            # the search would follow the air of a tracheostomy tube out of the neck in thin slices.
            around = dilate(last, beside)
            connected = connected_to(region, is_air & around)
            region |= connected_to(around & (values < strict) & ~connected, is_air & around)
        if not region.any():
            lost_mm += dz
            if lost_mm > LOST_MM or below is None:
                break
            continue
        lost_mm = 0.0
        corner = moved
        whole = close_gaps(region, bridge)
        septum = whole & ~is_air
        at = np.argwhere(whole)
        middle = at.mean(axis=0)
        cells = np.argwhere(region)
        off = np.hypot(*((cells - middle) * step).T)
        jj, ii = cells[int(np.argmin(off))] + moved
        j, i = (int(v) for v in np.rint(middle) + moved)
        extent = (np.ptp(at, axis=0) + 1) * step
        more = dilate(region, SIDES) & is_air & ~region
        front = np.argwhere(more)[:, 0]
        near = dilate(whole, close_by) & ~region
        septum_mm2 = float(septum.sum() * dx * dy)
        peak = (float(values[near].max()) - zero) * to_hu if near.any() else -1000.0
        own = values[region].astype(np.float64)
        noise_hu = 1.4826 * float(np.median(np.abs(own - np.median(own)))) * to_hu
        septum_hu = (float(np.median(values[septum])) - zero) * to_hu if septum.any() else float("nan")
        # Several slices with a wall between air and air show a tube; fluid above its cuff does not end the tube.
        if tubes < IN_A_TUBE:
            tubes = tubes + 1 if septum_mm2 >= SEPTUM_MM2 else 0
        found.append(
            AirSection(
                k=k,
                corner=corner,
                air=region,
                whole=whole,
                voxel=(int(ii), int(jj), k),
                centre_lps=volume.to_lps(np.array([middle[1] + moved[1], middle[0] + moved[0], k], dtype=np.float64)),
                area_mm2=float(whole.sum() * dx * dy),
                width_mm=float(extent[1]),
                depth_mm=float(extent[0]),
                septum_mm2=septum_mm2,
                septum_hu=septum_hu,
                noise_hu=noise_hu,
                peak=peak,
                leaves_in_front=bool(len(front) and (front < middle[0] - 0.25 * extent[0] / dy).any()),
            )
        )
        below = whole
    return found


def _move_mask(mask: NDArray[np.bool_], dj: int, di: int, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return a mask moved to a window of the given shape that begins ``dj`` and ``di`` voxels later."""
    out = np.zeros(shape, dtype=np.bool_)
    part = mask[max(dj, 0) : max(dj, 0) + shape[0] - max(-dj, 0), max(di, 0) : max(di, 0) + shape[1] - max(-di, 0)]
    out[max(-dj, 0) : max(-dj, 0) + part.shape[0], max(-di, 0) : max(-di, 0) + part.shape[1]] = part
    return out
