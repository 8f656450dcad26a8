"""Targets from masks that were drawn by a user or made by a program."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carina.errors import NoResultError, UsageError, check_type
from carina.plan.targets.mask_measures import DrawnStructure, drawn_nodule
from carina.plan.targets.nodule import Nodule
from carina.plan.targets.region import whereabouts
from carina.plan.targets.target import PlanTarget, TargetSource
from carina.scopes import WallField
from carina.volume import Mask, Volume
from carina.volume.mask_parts import parts_by_size

CRUMB = 0.05
"""Maximum size of a part of a mask that is ignored as stray voxels, as a share of the largest part's voxels."""
PIECE_MM = 5.0
"""Maximum distance in mm between a point and the part of a mask that the point selects."""


def nodule_from_mask(volume: Volume, mask: Mask | NDArray[np.bool_], *, at_lps: ArrayLike | None = None) -> Nodule:
    """Return the nodule of a mask on a CT's own grid.

    The volume is that of the mask; the error is that of a drawn boundary, half a voxel on all sides (common knowledge).

    Parameters
    ----------
    volume, mask
        The CT, and a mask from `open_mask` or an array (nz, ny, nx) of bool.
    at_lps
        (3,) point in LPS mm that selects a part, if the mask has several.

    Raises
    ------
    UsageError
        If the mask has another shape than the CT (code ``plan.mask``).
    NoResultError
        If the mask is empty, is too large for a nodule, or has several parts and no point selects one.

    Examples
    --------
    >>> import carina
    >>> made = carina.generate_phantom(seed=4, spacing_mm=1.0, nodule=True, box_lps=((-130, 15, -60), (-72, 75, -2)))
    >>> volume, centre = made.volume, made.truth["nodule"]["centre_lps"]
    >>> k, j, i = np.indices(volume.shape_zyx)
    >>> ball = np.linalg.norm(volume.to_lps(np.stack([i, j, k], axis=-1)) - centre, axis=-1) < 6.0
    >>> nodule_from_mask(volume, ball).equivalent_mm > 11.5
    True
    """
    check_type("nodule_from_mask", "volume", volume, Volume, "open a volume with carina.open_volume")
    inside = mask.inside_zyx if isinstance(mask, Mask) else np.asarray(mask)
    notes = mask.notes if isinstance(mask, Mask) else ()
    if inside.shape != volume.shape_zyx:
        raise UsageError(
            f"the mask has {_sizes(inside.shape)} voxels and the CT {_sizes(volume.shape_zyx)}: it was drawn on "
            "another grid; open its file with carina.open_mask, which checks where it lies",
            code="plan.mask",
        )
    if inside.dtype != bool and not np.isin(inside, (0, 1)).all():
        raise UsageError(
            "the segmentation contains values other than 0 and 1; choose one structure of it", code="plan.mask"
        )
    filled = np.flatnonzero(inside.any(axis=(1, 2)))
    if not filled.size:
        raise NoResultError("the segmentation is empty: it has no voxel in this CT", code="plan.mask")
    low, high = [int(filled[0])], [int(filled[-1]) + 1]
    for axes in ((0, 2), (0, 1)):
        filled = np.flatnonzero(inside[low[0] : high[0]].any(axis=axes))
        low.append(int(filled[0]))
        high.append(int(filled[-1]) + 1)
    part = inside[low[0] : high[0], low[1] : high[1], low[2] : high[2]].astype(np.float32)
    drawn, piece_notes = one_piece(volume, DrawnStructure(part, (low[0], low[1], low[2])), at_lps)
    return drawn_nodule(volume, drawn, notes=(*notes, *piece_notes))


def target_from_mask(
    volume: Volume,
    mask: Mask | NDArray[np.bool_],
    *,
    target_id: str = "target",
    name: str = "",
    at_lps: ArrayLike | None = None,
    wall: WallField | None = None,
) -> PlanTarget:
    """Return a target from a mask on a CT's own grid.

    Parameters
    ----------
    volume, mask, at_lps
        As for `nodule_from_mask`.
    target_id, name
        Identifier and name of the target.
    wall
        Wall of the airways, with which a target in an airway is recognised.
    """
    nodule = nodule_from_mask(volume, mask, at_lps=at_lps)
    return target_of(volume, nodule, "mask", target_id=target_id, name=name, wall=wall)


def target_of(
    volume: Volume, nodule: Nodule, source: TargetSource, *, target_id: str, name: str, wall: WallField | None
) -> PlanTarget:
    """Return a target for a nodule that was read from a file, with its location and doubts."""
    return PlanTarget(
        target_id=target_id,
        name=name,
        nodule=nodule,
        seed_lps=nodule.middle_lps,
        source=source,
        where=whereabouts(volume, nodule, wall=wall),
    )


def one_piece(
    volume: Volume, drawn: DrawnStructure, at_lps: ArrayLike | None
) -> tuple[DrawnStructure, tuple[str, ...]]:
    """Return one connected part of a mask, and notes on the parts that were left out.

    Parameters
    ----------
    volume
        The CT.
    drawn
        Shares of its voxels.
    at_lps
        (3,) point in LPS mm that selects the part; None if there is only one.

    Raises
    ------
    NoResultError
        If there are several parts and no point selects one, or no part is at the point.
    """
    labels = parts_by_size(drawn.share_zyx > 0.0, corners=True)
    num = int(labels.max())
    if num == 0:
        return drawn, ()
    voxel_ml = abs(float(np.linalg.det(volume.lps_from_ijk[:3, :3]))) / 1000.0
    sizes_ml = np.bincount(labels.reshape(-1), weights=drawn.share_zyx.reshape(-1), minlength=num + 1)[1:] * voxel_ml
    order = np.argsort(-sizes_ml, kind="stable") + 1
    if at_lps is not None:
        chosen = _piece_at(volume, drawn, labels, at_lps)
    else:
        large = [int(n) for n in order if sizes_ml[n - 1] >= CRUMB * sizes_ml.max()]
        if len(large) > 1:
            listed = ", ".join(f"{sizes_ml[n - 1]:.2g} ml" for n in large[:4])
            more = f" and {len(large) - 4} more" if len(large) > 4 else ""
            raise NoResultError(
                f"the mask has {len(large)} separate parts ({listed}{more}); a target is one nodule: give a point in "
                "the intended part (--part, or at_lps= in Python), or a mask of it alone",
                code="plan.mask-parts",
            )
        chosen = large[0]
    left = num - 1
    share = np.where(labels == chosen, drawn.share_zyx, np.float32(0.0))
    note = f"{left} other part{'s' if left > 1 else ''} of the mask ({sizes_ml.sum() - sizes_ml[chosen - 1]:.2g} ml)"
    return DrawnStructure(share, drawn.first_zyx), (f"{note} left out",) if left else ()


def _piece_at(volume: Volume, drawn: DrawnStructure, labels: NDArray[Any], at_lps: ArrayLike) -> int:
    point = np.asarray(at_lps, dtype=np.float64).reshape(-1)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise UsageError("target: expected a point x,y,z in LPS mm", code="plan.point")
    filled = np.argwhere(labels > 0)
    off = np.linalg.norm(volume.to_lps((filled + drawn.first_zyx)[:, ::-1].astype(np.float64)) - point, axis=1)
    nearest = int(np.argmin(off))
    if off[nearest] > PIECE_MM:
        raise NoResultError(
            f"the mask has no part at this point: the nearest is {off[nearest]:.0f} mm away", code="plan.mask-parts"
        )
    return int(labels[tuple(filled[nearest])])


def _sizes(shape: tuple[int, ...]) -> str:
    return " x ".join(str(n) for n in shape[::-1])
