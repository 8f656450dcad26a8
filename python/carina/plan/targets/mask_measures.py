"""Nodule from a drawn mask: volume, diameters and density, as for a segmented nodule.

The drawn boundary is used unchanged. The volume is that of the mask, and the error states how far a drawn boundary may
be off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.errors import NoResultError, UsageError
from carina.plan.cubic_box import Box, beside, box_step_mm, smoothed, surface, trilinear
from carina.plan.targets.boundary import SMOOTH_MM, SOLID_HU
from carina.plan.targets.boundary_measures import CORE_MM, SMALLEST_PART_MM3, cut_out, diameters
from carina.plan.targets.nodule import Nodule, NoduleKind
from carina.volume import Volume
from carina.volume.mask_distances import ball_distance

Mask = NDArray[np.bool_]

DRAWN_OFF = 0.5
"""Error (standard deviation) of a drawn boundary in voxels of the CT, common knowledge."""
SOLID_SHARE = 0.6
"""Minimum share of solid voxels away from the edge for a solid nodule; a nodule with fewer is part-solid."""
MARGIN_MM = 4.0
LARGEST_MM = 200.0


@dataclass(frozen=True, slots=True)
class DrawnStructure:
    """Structure that was drawn on a part of a CT's grid."""

    share_zyx: NDArray[np.float32]
    """(nz, ny, nx) share of each voxel inside the structure, 0 to 1."""
    first_zyx: tuple[int, int, int]
    """Index of the CT voxel at the first corner of the part."""


def drawn_nodule(volume: Volume, drawn: DrawnStructure, *, notes: tuple[str, ...] = (), off_mm: float = 0.0) -> Nodule:
    """Return the nodule of a structure that was drawn on the grid of a CT.

    Parameters
    ----------
    volume
        The CT.
    drawn
        Shares of its voxels.
    notes
        Notes on the boundary for the user.
    off_mm
        Additional uncertainty of the boundary, beyond that of a drawn one.

    Raises
    ------
    NoResultError
        If the structure is empty or larger than 20 cm (code ``plan.mask``).
    """
    share = drawn.share_zyx
    filled = np.argwhere(share > 0.0)
    if not filled.size:
        raise NoResultError("the structure is empty: it has no voxel in this CT", code="plan.mask")
    ijk = (filled + drawn.first_zyx)[:, ::-1].astype(np.float64)
    weights = share[share > 0.0].astype(np.float64)
    spacing = np.array(volume.spacing_mm)
    extent_mm = float(np.max((np.ptp(ijk, axis=0) + 1.0) * spacing))
    if extent_mm > LARGEST_MM:
        raise NoResultError(
            f"the structure is {extent_mm:.0f} mm long; a target has at most {LARGEST_MM:.0f} mm; choose the "
            "segmentation of the nodule, not of a lung or an airway tree",
            code="plan.mask",
        )
    volume_mm3 = float(weights.sum()) * abs(float(np.linalg.det(volume.lps_from_ijk[:3, :3])))
    centre = volume.to_lps((ijk * weights[:, None]).sum(axis=0) / weights.sum())
    corners = volume.to_lps(ijk)
    step = box_step_mm(volume)
    margin = MARGIN_MM + float(spacing.max())
    low = np.floor((corners.min(axis=0) - margin) / step) * step
    num = np.ceil((corners.max(axis=0) + margin - low) / step).astype(int) + 1
    matrix = np.diag([step, step, step, 1.0])
    matrix[:3, 3] = low
    inside = _on_cubes(volume, drawn, matrix, (int(num[2]), int(num[1]), int(num[0])), volume_mm3)
    return measured_mask(
        volume,
        inside,
        matrix,
        volume_mm3=volume_mm3,
        centre_lps=(float(centre[0]), float(centre[1]), float(centre[2])),
        notes=notes,
        off_mm=off_mm,
    )


def _on_cubes(
    volume: Volume, drawn: DrawnStructure, matrix: NDArray[np.float64], shape: tuple[int, int, int], volume_mm3: float
) -> Mask:
    """Return the mask of the cubic voxels with the largest shares; their total volume is the structure's volume."""
    padded = np.pad(drawn.share_zyx, 1)
    to_ijk = volume.ijk_from_lps @ matrix
    first = np.array(drawn.first_zyx[::-1]) - 1.0
    top = np.array(padded.shape[::-1]) - 1.0
    y, x = np.mgrid[0 : shape[1], 0 : shape[2]].reshape(2, -1)
    read = np.empty(shape, dtype=np.float32)
    for z in range(shape[0]):
        ijk = to_ijk[:3, 0, None] * x + to_ijk[:3, 1, None] * y + (to_ijk[:3, 2] * z + to_ijk[:3, 3] - first)[:, None]
        read[z] = trilinear(padded, np.clip(ijk, 0.0, top[:, None])).reshape(shape[1:])
    num = max(round(volume_mm3 / float(matrix[0, 0]) ** 3), 1)
    touched = np.flatnonzero(read > 0.0)
    order = np.argsort(-read.reshape(-1)[touched], kind="stable")[:num]
    inside = np.zeros(read.size, dtype=bool)
    inside[touched[order]] = True
    return inside.reshape(shape)


def measured_mask(
    volume: Volume,
    inside: Mask,
    lps_from_ijk: NDArray[np.float64],
    *,
    kind: NoduleKind | None = None,
    volume_mm3: float | None = None,
    centre_lps: tuple[float, float, float] | None = None,
    notes: tuple[str, ...] = (),
    touches: tuple[str, ...] = (),
    off_mm: float = 0.0,
) -> Nodule:
    """Return the nodule of a mask of cubic voxels.

    Parameters
    ----------
    volume
        The CT.
    inside, lps_from_ijk
        (nz, ny, nx) mask and (4, 4) transform of its grid.
    kind
        Kind of the nodule; determined from the density of the CT if None.
    volume_mm3, centre_lps
        Volume and centre; computed from the voxels if None.
    notes
        Notes on the boundary for the user.
    touches
        Structures that the nodule was cut from. The edge of the CT is added if it cuts the nodule.
    off_mm
        Additional uncertainty of the boundary, beyond that of a drawn one.

    Raises
    ------
    UsageError
        If the mask is empty (code ``plan.edit``).
    """
    if not inside.any():
        raise UsageError("the target would be empty", code="plan.edit")
    cropped, matrix, counted_lps = cut_out(inside, lps_from_ijk)
    box = Box.at(volume, matrix, cropped.shape)
    step = box.step_mm
    smooth = smoothed(box.hu_zyx, SMOOTH_MM / step)
    depth = ball_distance(cropped, step)
    core = depth > CORE_MM
    if core.sum() < 20:
        core = depth >= 0.6 * float(depth.max())
    dense = cropped & (smooth > SOLID_HU)
    solid_mm3 = float(dense.sum()) * step**3
    if kind is None:
        is_part = solid_mm3 > SMALLEST_PART_MM3
        # Unsmoothed values, because blur makes a small solid nodule look like ground glass.
        alike = float((box.hu_zyx[core] > SOLID_HU).mean()) >= SOLID_SHARE
        kind = "solid" if alike else "part-solid" if is_part else "ground-glass"
    counted_mm3 = float(cropped.sum()) * step**3
    mm3 = counted_mm3 if volume_mm3 is None else volume_mm3
    edge = surface(cropped)
    area_mm2 = float(edge.sum()) * step**2 * 1.2
    voxel_mm = float(np.prod(volume.spacing_mm)) ** (1.0 / 3.0)
    slack_mm = DRAWN_OFF * voxel_mm + off_mm
    ends = ("edge of the CT",) if (edge & beside(~box.known)).any() else ()
    long_mm, short_mm = diameters(cropped, step)
    return Nodule(
        centre_lps=counted_lps if centre_lps is None else centre_lps,
        kind=kind,
        volume_mm3=mm3,
        # The error is at most the whole volume.
        volume_error_mm3=min(area_mm2 * slack_mm, mm3),
        long_mm=long_mm,
        short_mm=short_mm,
        diameter_error_mm=0.5 * step + slack_mm,
        solid_mm3=mm3 if kind == "solid" else min(solid_mm3, mm3),
        density_hu=float(box.hu_zyx[core].mean()),
        touches=tuple(dict.fromkeys((*(word for word in touches if word != "edge of the CT"), *ends))),
        inside_zyx=cropped,
        lps_from_ijk=matrix,
        notes=notes,
    )
