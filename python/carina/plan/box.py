"""A cubic box cut out of a CT, with cubic voxels along LPS, and what is done in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.volume import Volume

__all__ = [
    "Box",
    "ball_distance",
    "beside",
    "box_step_mm",
    "component_at",
    "distance_from",
    "enclosed",
    "extent",
    "from_faces",
    "lung_median_hu",
    "smoothed",
    "surface",
    "trilinear",
    "uphill",
]

Mask = NDArray[np.bool_]
Values = NDArray[np.float32]

LEAST_STEP_MM, MOST_STEP_MM = 0.5, 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Box:
    """Interpolated values round a place."""

    hu_zyx: Values
    known: Mask
    """Inside the CT."""
    step_mm: float
    lps_from_ijk: NDArray[np.float64]

    @classmethod
    def around(
        cls, volume: Volume, centre_lps: NDArray[np.float64], half_mm: float, *, least_step_mm: float = 0.0
    ) -> Box:
        """Trilinear, the CT's edge repeated outside of it.

        Its voxels are as fine as the CT's finest spacing, 0.5 to 1 mm: where slices are thicker nothing is gained by
        finer ones, and nothing lost by coarser ones. ``least_step_mm`` makes them coarser than that.
        """
        step = max(box_step_mm(volume), least_step_mm)
        half = int(np.ceil(half_mm / step))
        num = 2 * half + 1
        matrix = np.diag([step, step, step, 1.0])
        matrix[:3, 3] = centre_lps - half * step
        return cls.at(volume, matrix, (num, num, num))

    @classmethod
    def at(cls, volume: Volume, lps_from_ijk: NDArray[np.float64], shape_zyx: tuple[int, ...]) -> Box:
        """The same for a box whose place is given; cubic voxels."""
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
        """Distances of all voxels from one, in voxels."""
        z, y, x = (np.arange(n, dtype=np.float64) - k for n, k in zip(self.hu_zyx.shape, at, strict=True))
        off: NDArray[np.float64] = np.sqrt(z[:, None, None] ** 2 + y[None, :, None] ** 2 + x[None, None, :] ** 2)
        return off

    def offsets_mm(self, point_lps: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distances of all voxels from a point, mm."""
        i, j, k = (point_lps - self.lps_from_ijk[:3, 3]) / self.step_mm
        z, y, x = (np.arange(n) - at for n, at in zip(self.hu_zyx.shape, (k, j, i), strict=True))
        off: NDArray[np.float64] = np.sqrt(z[:, None, None] ** 2 + y[None, :, None] ** 2 + x[None, None, :] ** 2)
        return self.step_mm * off


def box_step_mm(volume: Volume) -> float:
    """The cubic voxels of boxes in a CT."""
    return float(np.clip(min(volume.spacing_mm), LEAST_STEP_MM, MOST_STEP_MM))


def trilinear(hu_zyx: NDArray[Any], ijk: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values of an array between its voxels.

    Parameters
    ----------
    hu_zyx
        (nz, ny, nx)
    ijk
        (3, n), within the outer voxels' centres.
    """
    low = np.minimum(ijk.astype(np.intp), (np.array(hu_zyx.shape[::-1]) - 2).clip(0)[:, None])
    part = ijk - low
    high = np.minimum(low + 1, (np.array(hu_zyx.shape[::-1]) - 1)[:, None])
    total = np.zeros(ijk.shape[1])
    for corner in range(8):
        ends = [(high if corner >> a & 1 else low)[a] for a in range(3)]
        weight = np.prod([part[a] if corner >> a & 1 else 1.0 - part[a] for a in range(3)], axis=0)
        total += weight * hu_zyx[ends[2], ends[1], ends[0]]
    return total


def smoothed(values: Values, sigma_vox: float) -> Values:
    """A Gaussian of ``sigma_vox`` voxels, the edge repeated."""
    reach = max(int(np.ceil(3.0 * sigma_vox)), 1)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma_vox) ** 2)
    kernel /= kernel.sum()
    out = values
    for axis in range(3):
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
    """What lung is like among smoothed values; the usual where there is hardly any."""
    dark = smooth[(smooth < -600.0) & (smooth > -990.0)]
    return float(np.median(dark)) if dark.size > 200 else -850.0


def component_at(mask: Mask, at: tuple[int, ...]) -> Mask:
    """What is connected to a voxel of the mask by faces; nothing where it is no voxel of it."""
    import SimpleITK as sitk  # slow to load, and most of what is public here does not need it

    image: Any = sitk.GetImageFromArray(mask.astype(np.uint8))
    seed = tuple(int(k) for k in reversed(at))
    found: Mask = sitk.GetArrayFromImage(sitk.ConnectedThreshold(image, [seed], 1, 1)) != 0
    return found


def ball_distance(mask: Mask, step_mm: float) -> NDArray[np.float32]:
    """For each voxel of the mask the distance from its centre to the nearest one outside, less half a voxel; else 0.

    The box's own faces are no outside.
    """
    import SimpleITK as sitk  # slow to load, and most of what is public here does not need it

    found = np.zeros(mask.shape, dtype=np.float32)
    if not mask.any():
        return found
    # A voxel beyond the mask's own extent is all that its distances need.
    part = extent(mask, 1)
    inner = mask[part]
    if inner.all():
        found[part] = np.inf
        return found
    image: Any = sitk.GetImageFromArray((~inner).astype(np.uint8))
    image.SetSpacing([step_mm] * 3)
    far = sitk.SignedMaurerDistanceMap(image, insideIsPositive=False, squaredDistance=False, useImageSpacing=True)
    away: NDArray[np.float32] = sitk.GetArrayFromImage(far)
    # Rounded, so that a distance of whole voxels does not depend on how the mask was cut out.
    found[part] = np.where(inner, np.maximum(away - 0.5 * step_mm, 0.25 * step_mm).round(3), 0.0)
    return found


def distance_from(mask: Mask, step_mm: float, reach_mm: float) -> NDArray[np.float32]:
    """For each voxel outside a mask its distance from it as `ball_distance` counts it; infinite beyond ``reach_mm``."""
    found = np.full(mask.shape, np.inf, dtype=np.float32)
    if mask.any():
        part = extent(mask, int(np.ceil(reach_mm / step_mm)) + 2)
        away = ball_distance(~mask[part], step_mm)
        found[part] = np.where(away <= reach_mm, away, np.inf)
    return found


def extent(mask: Mask, margin: int) -> tuple[slice, slice, slice]:
    """The part of an array that holds all of a mask, and some voxels round it."""
    found = []
    for axis in range(3):
        filled = np.flatnonzero(mask.any(axis=tuple(n for n in range(3) if n != axis)))
        found.append(slice(max(int(filled[0]) - margin, 0), int(filled[-1]) + 1 + margin))
    return found[0], found[1], found[2]


def enclosed(mask: Mask) -> Mask:
    """Voxels outside a mask that no way leads from to the box's faces: hollows."""
    found = np.zeros_like(mask)
    if mask.any():
        part = extent(mask, 1)
        outside = ~mask[part]
        found[part] = outside & ~from_faces(outside)
    return found


def from_faces(mask: Mask) -> Mask:
    """What is connected to the box's faces."""
    import SimpleITK as sitk  # slow to load

    padded = np.pad(mask, 1, constant_values=True)
    image = sitk.GetImageFromArray(padded.astype(np.uint8))
    found = sitk.GetArrayFromImage(sitk.ConnectedThreshold(image, [(0, 0, 0)], 1, 1)) != 0
    inner: Mask = found[1:-1, 1:-1, 1:-1] & mask
    return inner


def beside(mask: Mask) -> Mask:
    """Voxels with a face to the mask."""
    padded = np.pad(mask, 1)
    found = np.zeros_like(mask)
    for axis in range(3):
        for shift in (-1, 1):
            found |= np.roll(padded, shift, axis=axis)[1:-1, 1:-1, 1:-1]
    return found


def surface(mask: Mask) -> Mask:
    """Voxels with a face to the outside."""
    padded = np.pad(mask, 1)
    deep = mask.copy()
    for axis in range(3):
        for shift in (-1, 1):
            deep &= np.roll(padded, shift, axis=axis)[1:-1, 1:-1, 1:-1]
    return mask & ~deep


def uphill(values: Values, at: tuple[int, ...]) -> tuple[int, ...]:
    """The voxel that is reached from one by going to the greatest of 26 neighbours as long as it is greater."""
    while True:
        window = tuple(slice(max(k - 1, 0), k + 2) for k in at)
        part = values[window]
        best = np.unravel_index(int(np.argmax(part)), part.shape)
        there = tuple(int(w.start + b) for w, b in zip(window, best, strict=True))
        if values[there] <= values[at]:
            return at
        at = there
