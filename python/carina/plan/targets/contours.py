"""Rasterisation of a structure set's outlines to the share of each CT voxel that they enclose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.plan.targets.mask_measures import DrawnStructure
from carina.plan.targets.outline_slices import OutlineError, SliceOutline, SliceShare, runs_through_centres, slice_share
from carina.plan.targets.outline_stack import OutlineStack
from carina.volume import Volume
from carina.volume.dicom_structures import Contour

__all__ = ["OutlineError", "drawn_in"]

PLANE = 0.1
"""Maximum distance of an outline from a slice on which it counts as drawn, as a share of the slice distance.

Files round coordinates to 0.01 mm.
"""
PLANE_MM = 0.06
"""Minimum value in mm of the limit for the distance of an outline from its slice; some programs round to 0.1 mm."""
SUB_SLICES = 8
"""Number of heights per CT slice at which outlines between slices are sampled; this limits the error to 1/16 slice."""
OTHER_CT = "open the CT that it was drawn on"
SAME_FRAME = (
    "open the DICOM series that it was drawn on, so that Carina can compare the frame of reference, or export it on "
    "the slices of this CT"
)


@dataclass(frozen=True, slots=True, eq=False)
class _Plane:
    """All outlines of a structure at one height."""

    height: float
    """Height of the outlines in slices of the CT."""
    outlines: tuple[SliceOutline, ...]


def drawn_in(
    volume: Volume, contours: Sequence[Contour], *, may_be_between: bool = False
) -> tuple[DrawnStructure, tuple[str, ...], float]:
    """Compute the shares of a CT's voxels that the outlines of a structure enclose.

    An outline represents the slab half-way to its neighbours. A nested outline is a hole. Nearly equal outlines of one
    slice are averaged, and other outlines of one slice are united.

    Parameters
    ----------
    volume
        The CT.
    contours
        Outlines of the structure, points in LPS mm.
    may_be_between
        Accept outlines that lie between the CT's slices. The caller must know that the outlines and the CT have one
        frame of reference. Otherwise outlines between the slices indicate another CT.

    Returns
    -------
    drawn, notes, off_mm
        Shares of voxels; notes for the user; additional uncertainty of the boundary in mm.

    Raises
    ------
    OutlineError
        If the outlines are not parallel to the CT's slices, not within the CT, or contradictory.
    """
    points = [volume.to_ijk(contour.points_lps) for contour in contours]
    axis = _axis_across(points)
    across = [n for n in range(3) if n != axis]
    limits = np.array(volume.shape_zyx[::-1])
    slice_mm = float(volume.spacing_mm[axis])
    flat = [one[:, across] for one in points]
    low = np.min([one.min(axis=0) for one in flat], axis=0)
    high = np.max([one.max(axis=0) for one in flat], axis=0)
    heights = np.array([float(one[:, axis].mean()) for one in points])
    if (
        (low < -1.0).any()
        or (high > limits[across]).any()
        or heights.min() < -0.5
        or heights.max() > limits[axis] - 0.5
    ):
        raise OutlineError(
            "part of its outline lies outside this CT: it was drawn on another or a larger one", way_out=OTHER_CT
        )
    first = np.maximum(np.floor(low).astype(int) - 1, 0)
    size = np.minimum(np.ceil(high).astype(int) + 2, limits[across]) - first
    shape = (int(size[1]), int(size[0]))
    off = float(np.abs(heights - np.rint(heights)).max())
    is_between = off > max(PLANE, PLANE_MM / slice_mm)
    if is_between and not may_be_between:
        raise OutlineError(
            f"an outline lies {off * slice_mm:.1f} mm off the nearest slice of this CT: it was drawn on one with other "
            "slices",
            way_out=SAME_FRAME,
        )
    outlines = [SliceOutline(one - first, contour.is_xor) for one, contour in zip(flat, contours, strict=True)]
    planes = _planes(heights if is_between else np.rint(heights), outlines)
    centred = all(runs_through_centres(one) for one in flat)
    slices = [slice_share(plane.outlines, shape, centred=centred) for plane in planes]
    pixel_mm = float(np.sqrt(np.prod([volume.spacing_mm[n] for n in across])))
    stack = OutlineStack(
        [plane.height for plane in planes], [one.share for one in slices], pixel_mm=pixel_mm, slice_mm=slice_mm
    )
    start, share = _on_slices(stack, shape, int(limits[axis]), is_between=is_between)
    voxel_ml = float(np.prod(volume.spacing_mm)) / 1000.0
    notes = _notes_on_slices(slices, stack, pixel_mm, voxel_ml, centred=centred)
    notes += _notes_on_stack(stack, share, start, off * slice_mm, slice_mm, is_between=is_between)
    order = [2 - across[1], 2 - across[0]]
    # The axes of the array are plane, second in-plane axis, first in-plane axis.
    placed = np.moveaxis(share, (0, 1, 2), (2 - axis, order[0], order[1]))
    corner = [0, 0, 0]
    corner[2 - axis], corner[order[0]], corner[order[1]] = start, int(first[1]), int(first[0])
    drawn = DrawnStructure(np.ascontiguousarray(placed), (corner[0], corner[1], corner[2]))
    return drawn, tuple(notes), _off_mm(stack, share, start, slice_mm, is_between=is_between)


def _axis_across(points: Sequence[NDArray[np.float64]]) -> int:
    """Return the voxel axis (0, 1, 2 for i, j, k) that is perpendicular to the planes of all outlines."""
    spread = np.max([np.ptp(one, axis=0) for one in points], axis=0)
    axis = int(np.argmin(spread))
    if spread[axis] > PLANE:
        raise OutlineError(
            "its outlines are not parallel to the slices of this CT: they were drawn on another one", way_out=OTHER_CT
        )
    return axis


def _planes(heights: NDArray[np.float64], outlines: Sequence[SliceOutline]) -> list[_Plane]:
    """Collect the outlines of each height; heights that differ by rounding count as one height."""
    planes: list[_Plane] = []
    together: list[int] = []
    order = [int(n) for n in np.argsort(heights, kind="stable")]
    for n, following in zip(order, [*order[1:], None], strict=True):
        together.append(n)
        if following is None or heights[following] - heights[together[0]] > PLANE:
            height = float(heights[together].mean())
            planes.append(_Plane(height, tuple(outlines[m] for m in sorted(together))))
            together = []
    return planes


def _on_slices(
    stack: OutlineStack, shape: tuple[int, int], num_slices: int, *, is_between: bool
) -> tuple[int, NDArray[np.float32]]:
    """Return the first slice, and the shares of the voxels of all slices that a stack of outlines touches."""
    start = max(int(np.floor(stack.heights[0] - stack.reach + 0.5)), 0)
    end = min(int(np.ceil(stack.heights[-1] + stack.reach - 0.5)), num_slices - 1)
    share = np.zeros((end - start + 1, *shape), dtype=np.float32)
    # Outlines on the CT's slices are sampled at these slices alone, because averaging would blur them.
    offsets = (np.arange(SUB_SLICES) + 0.5) / SUB_SLICES - 0.5 if is_between else np.zeros(1)
    for n in range(len(share)):
        share[n] = np.mean([stack.at(start + n + offset) for offset in offsets], axis=0)
    return start, share


def _notes_on_slices(
    slices: Sequence[SliceShare], stack: OutlineStack, pixel_mm: float, voxel_ml: float, *, centred: bool
) -> list[str]:
    notes = []
    if centred:
        notes.append("its outline runs through the centres of voxels, which were taken as inside")
    twice = [one for one in slices if one.num_merged]
    if twice:
        apart = max(one.apart_vox for one in twice) * pixel_mm
        far = "identical" if apart < 0.005 else f"up to {apart:.2g} mm apart"
        notes.append(f"on {_slices(len(twice))} the boundary was drawn more than once ({far}): averaged")
    hollow = [one for one in slices if one.hole_vox > 0.0]
    if hollow:
        ml = sum(one.hole_vox for one in hollow) * voxel_ml * stack.step
        notes.append(f"on {_slices(len(hollow))} an outline within another was taken as a hole ({ml:.2g} ml)")
    return notes


def _notes_on_stack(
    stack: OutlineStack, share: NDArray[np.float32], start: int, off_mm: float, slice_mm: float, *, is_between: bool
) -> list[str]:
    if is_between:
        return [
            f"its outlines lie up to {off_mm:.1f} mm from the slices of this CT (they are {stack.step * slice_mm:.2g} "
            "mm apart): placed by position"
        ]
    filled = _num_filled(stack, share, start)
    if not filled:
        return []
    return [
        f"{_slices(filled)} without an outline: interpolated, because an outline stands for the slab half-way to its "
        "neighbours"
    ]


def _off_mm(stack: OutlineStack, share: NDArray[np.float32], start: int, slice_mm: float, *, is_between: bool) -> float:
    """Return the additional uncertainty in mm of a structure's boundary that was not drawn on every slice."""
    if is_between:
        return 0.5 * slice_mm * max(stack.step, 1.0)
    num = int((share > 0.0).any(axis=(1, 2)).sum())
    filled = _num_filled(stack, share, start)
    return 0.5 * slice_mm * max(stack.step, 1.0) * filled / num if num else 0.0


def _num_filled(stack: OutlineStack, share: NDArray[np.float32], start: int) -> int:
    touched = {start + int(n) for n in np.flatnonzero((share > 0.0).any(axis=(1, 2)))}
    return len(touched - {round(height) for height in stack.heights})


def _slices(num: int) -> str:
    return f"{num} slice{'s' if num != 1 else ''}"
