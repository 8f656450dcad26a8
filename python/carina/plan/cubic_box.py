"""Cubic box cut out of a CT, with cubic voxels along LPS, and morphological operations on its masks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.volume import Volume
from carina.volume.mask_distances import extent
from carina.volume.mask_parts import numbered_parts

Mask = NDArray[np.bool_]
Values = NDArray[np.float32]

MIN_STEP_MM, MAX_STEP_MM = 0.5, 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Box:
    """Part of a CT, interpolated to cubic voxels."""

    hu_zyx: Values
    known: Mask
    """Mask (nz, ny, nx) of the voxels of the box that are inside the CT."""
    step_mm: float
    lps_from_ijk: NDArray[np.float64]

    @classmethod
    def around(
        cls, volume: Volume, centre_lps: NDArray[np.float64], half_mm: float, *, least_step_mm: float = 0.0
    ) -> Box:
        """Return a box centred on a point, with trilinear values; outside the CT the values of its edge are repeated.

        The voxel size is the finest spacing of the CT, limited to 0.5 to 1 mm. Finer voxels would add nothing in
        thicker slices, and coarser ones lose nothing in thinner slices.

        Parameters
        ----------
        volume
            The CT.
        centre_lps
            (3,) centre of the box, LPS mm.
        half_mm
            Half the side length of the box.
        least_step_mm
            Least voxel size; it may make the voxels coarser.
        """
        step = max(box_step_mm(volume), least_step_mm)
        half = int(np.ceil(half_mm / step))
        num = 2 * half + 1
        matrix = np.diag([step, step, step, 1.0])
        matrix[:3, 3] = centre_lps - half * step
        return cls.at(volume, matrix, (num, num, num))

    @classmethod
    def at(cls, volume: Volume, lps_from_ijk: NDArray[np.float64], shape_zyx: tuple[int, ...]) -> Box:
        """Return a box of the given shape and transform, with trilinear values.

        Parameters
        ----------
        volume
            The CT.
        lps_from_ijk
            (4, 4) transform from voxel indices of the box to LPS mm; cubic voxels.
        shape_zyx
            Number of voxels on each axis.
        """
        nz, ny, nx = shape_zyx
        to_ijk = volume.ijk_from_lps @ lps_from_ijk
        values = np.empty((nz, ny, nx), dtype=np.float32)
        known = np.empty(values.shape, dtype=bool)
        y, x = np.mgrid[0:ny, 0:nx].reshape(2, -1)
        top = np.array(volume.shape_zyx[::-1]) - 1
        for z in range(nz):
            ijk = to_ijk[:3, 0, None] * x + to_ijk[:3, 1, None] * y + (to_ijk[:3, 2] * z + to_ijk[:3, 3])[:, None]
            known[z] = ((ijk >= -0.5) & (ijk <= (top + 0.5)[:, None])).all(axis=0).reshape(ny, nx)
            values[z] = trilinear(volume.hu_zyx, np.clip(ijk, 0.0, top[:, None])).reshape(ny, nx)
        return cls(values, known, float(np.linalg.norm(lps_from_ijk[:3, 0])), lps_from_ijk)

    def steps_from(self, at: tuple[int, ...]) -> NDArray[np.float64]:
        """Return the distance of each voxel of the box from one voxel, in voxels."""
        z, y, x = (np.arange(n, dtype=np.float64) - k for n, k in zip(self.hu_zyx.shape, at, strict=True))
        off: NDArray[np.float64] = np.sqrt(z[:, None, None] ** 2 + y[None, :, None] ** 2 + x[None, None, :] ** 2)
        return off

    def offsets_mm(self, point_lps: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the offset of each voxel from a point (LPS mm) in mm."""
        i, j, k = (point_lps - self.lps_from_ijk[:3, 3]) / self.step_mm
        z, y, x = (np.arange(n) - at for n, at in zip(self.hu_zyx.shape, (k, j, i), strict=True))
        off: NDArray[np.float64] = np.sqrt(z[:, None, None] ** 2 + y[None, :, None] ** 2 + x[None, None, :] ** 2)
        return self.step_mm * off


def box_step_mm(volume: Volume) -> float:
    """Return the voxel size in mm of boxes in a CT: its finest spacing, limited to 0.5 to 1 mm."""
    return float(np.clip(min(volume.spacing_mm), MIN_STEP_MM, MAX_STEP_MM))


def trilinear(hu_zyx: NDArray[Any], ijk: NDArray[np.float64]) -> NDArray[np.float64]:
    """Interpolate an array trilinearly between its voxels.

    Parameters
    ----------
    hu_zyx
        (nz, ny, nx) values.
    ijk
        (3, n) voxel coordinates, within the centres of the outer voxels.

    Returns
    -------
    NDArray[np.float64]
        (n,) interpolated values.
    """
    low = np.minimum(ijk.astype(np.intp), (np.array(hu_zyx.shape[::-1]) - 2).clip(0)[:, None])
    part = ijk - low
    high = np.minimum(low + 1, (np.array(hu_zyx.shape[::-1]) - 1)[:, None])
    total = np.zeros(ijk.shape[1])
    shares = 1.0 - part, part
    for corner in range(8):
        i, j, k = (corner >> a & 1 for a in range(3))
        ends = (low, high)
        weight = shares[i][0] * shares[j][1]
        weight *= shares[k][2]
        total += weight * hu_zyx[ends[k][2], ends[j][1], ends[i][0]]
    return total


def smoothed(values: Values, sigma_vox: float | tuple[float, float, float]) -> Values:
    """Smooth values by a Gaussian of ``sigma_vox`` voxels; the values of the edge are repeated outside.

    Parameters
    ----------
    values
        (nz, ny, nx) values.
    sigma_vox
        Standard deviation in voxels, one for all axes or one for each of z, y and x.
    """
    sigmas = (sigma_vox,) * 3 if isinstance(sigma_vox, float | int) else sigma_vox
    out = values
    for axis, sigma in enumerate(sigmas):
        reach = max(int(np.ceil(3.0 * sigma)), 1)
        kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
        kernel /= kernel.sum()
        pad = [(reach, reach) if a == axis else (0, 0) for a in range(3)]
        wide = np.pad(out, pad, mode="edge")
        num = out.shape[axis]
        total, part = np.zeros_like(out), np.empty_like(out)
        where = [slice(None)] * 3
        for n, weight in enumerate(kernel):
            where[axis] = slice(n, n + num)
            np.multiply(wide[tuple(where)], np.float32(weight), out=part)
            total += part
        out = total
    return out


def lung_median_hu(smooth: Values) -> float:
    """Return the median density of lung in smoothed values, HU; -850 HU if there is hardly any lung."""
    dark = smooth[(smooth < -600.0) & (smooth > -990.0)]
    return float(np.median(dark)) if dark.size > 200 else -850.0


def component_at(mask: Mask, at: tuple[int, ...]) -> Mask:
    """Return the face-connected part of a mask that contains a voxel; empty if the voxel is not in the mask.

    Parameters
    ----------
    mask
        (nz, ny, nx) mask.
    at
        Index (z, y, x) of the voxel.
    """
    parts = numbered_parts(mask)
    found: Mask = (parts == parts[at]) & mask[at]
    return found


def components(mask: Mask) -> NDArray[np.uint32]:
    """Return the number, from 1, of the part of a mask that contains each voxel; parts are connected by faces.

    The number is 0 outside the mask.
    """
    return numbered_parts(mask)


def enclosed(mask: Mask) -> Mask:
    """Return the voxels outside a mask that the mask separates from the faces of the box (hollows)."""
    found = np.zeros_like(mask)
    if mask.any():
        part = extent(mask, 1)
        outside = ~mask[part]
        found[part] = outside & ~from_faces(outside)
    return found


def from_faces(mask: Mask) -> Mask:
    """Return the part of a mask that is connected to the faces of its box."""
    # A margin of one voxel connects all parts that touch a face to one part, which also contains the first voxel.
    inner: Mask = numbered_parts(np.pad(mask, 1, constant_values=True))[1:-1, 1:-1, 1:-1] == 1
    return inner


def beside(mask: Mask) -> Mask:
    """Return the mask of all voxels that share a face with a voxel of the given mask."""
    padded = np.pad(mask, 1)
    found = np.zeros_like(mask)
    for axis in range(3):
        for shift in (-1, 1):
            found |= np.roll(padded, shift, axis=axis)[1:-1, 1:-1, 1:-1]
    return found


def surface(mask: Mask) -> Mask:
    """Return the voxels of a mask that share a face with a voxel outside the mask."""
    padded = np.pad(mask, 1)
    deep = mask.copy()
    for axis in range(3):
        for shift in (-1, 1):
            deep &= np.roll(padded, shift, axis=axis)[1:-1, 1:-1, 1:-1]
    return mask & ~deep


def uphill(values: Values, at: tuple[int, ...]) -> tuple[int, ...]:
    """Return the local maximum that a steepest ascent over the 26 neighbours reaches from a voxel.

    Parameters
    ----------
    values
        (nz, ny, nx) values.
    at
        Index (z, y, x) of the first voxel.
    """
    while True:
        window = tuple(slice(max(k - 1, 0), k + 2) for k in at)
        part = values[window]
        best = np.unravel_index(int(np.argmax(part)), part.shape)
        there = tuple(int(w.start + b) for w, b in zip(window, best, strict=True))
        if values[there] <= values[at]:
            return at
        at = there
