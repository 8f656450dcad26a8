"""Edits of a target's boundary by hand: by diameter, with a brush, or as a sphere where the CT shows no boundary."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carina.errors import UsageError, check_type
from carina.plan.cubic_box import Box, box_step_mm, component_at, enclosed, smoothed
from carina.plan.targets.mask_measures import measured_mask
from carina.plan.targets.nodule import Nodule
from carina.volume import Volume
from carina.volume.mask_distances import ball_distance
from carina.volume.point_check import check_in_volume

Mask = NDArray[np.bool_]
Place = NDArray[np.float64]

DIAMETERS_MM = (1.0, 150.0)
BRUSH_MM = (0.5, 40.0)
RESIZED, BRUSHED, SPHERE = (
    "boundary set by hand to a diameter",
    "boundary edited by hand",
    "a sphere set by hand: the CT shows no boundary that was used",
)
SPHERE_OFF_MM = 2.0
"""Additional uncertainty in mm of a sphere's boundary, beyond that of a drawn boundary (common knowledge)."""


def resized(nodule: Nodule, volume: Volume, diameter_mm: float) -> Nodule:
    """Move the boundary of a nodule by the same distance everywhere, to a given long axial diameter.

    Parameters
    ----------
    nodule, volume
        The nodule and its CT. The kind stays; density and volume are measured again.
    diameter_mm
        New ``long_mm``, 1 to 150 mm.

    Raises
    ------
    UsageError
        If the diameter is out of range, nothing of the nodule would be left, or more than half of it would be outside
        the CT (code ``plan.edit``).

    Examples
    --------
    >>> import carina
    >>> made = carina.generate_phantom(seed=4, spacing_mm=1.0, nodule=True, box_lps=((-130, 15, -60), (-72, 75, -2)))
    >>> nodule = carina.grow_nodule(made.volume, made.truth["nodule"]["centre_lps"])
    >>> wider = resized(nodule, made.volume, nodule.long_mm + 4.0)
    >>> round(wider.long_mm - nodule.long_mm)
    4
    """
    _check(volume, diameter_mm, DIAMETERS_MM, "diameter")
    step = float(np.linalg.norm(nodule.lps_from_ijk[:3, 0]))
    by_mm = 0.5 * (diameter_mm - nodule.long_mm)
    inside, matrix = _padded(nodule, max(by_mm, 0.0) + 3.0 * step)
    # Cavities are restored unchanged after the resizing.
    hollow = enclosed(inside)
    whole = inside | hollow
    # Signed distance, positive inside. It is smoothed, because distances between voxels have steps.
    depth = smoothed(ball_distance(whole, step) - ball_distance(~whole, step), 0.6)
    radii = 0.5 * np.array([nodule.long_mm, nodule.short_mm, 0.0])
    radii[2] = 3.0 * nodule.volume_mm3 / (4.0 * np.pi * radii[0] * radii[1])
    if float(radii.min()) + by_mm < 0.5 * step:
        raise _refused("nothing of the target would be left; choose a larger diameter")
    # Voxel distances have a bias of a part of a voxel, so an ellipsoid gives the number of voxels of the result.
    num = round(nodule.volume_mm3 / step**3 * float(np.prod((radii + by_mm) / radii)))
    retained = np.zeros(depth.size, dtype=bool)
    retained[np.argsort(-depth, axis=None, kind="stable")[: max(num, 1)]] = True
    retained = retained.reshape(depth.shape) & ~hollow
    found = _edited(nodule, volume, _in_ct(volume, _main_piece(retained), matrix), matrix, RESIZED)
    # The diameter is stored exactly as it was set; voxels represent it to half a voxel.
    return replace(found, long_mm=float(diameter_mm), short_mm=min(found.short_mm, float(diameter_mm)))


def brushed(nodule: Nodule, volume: Volume, centre_lps: ArrayLike, radius_mm: float, *, add: bool = True) -> Nodule:
    """Add the balls of a brush to a nodule, or remove them from it.

    After a removal only the largest connected part remains.

    Parameters
    ----------
    nodule, volume
        The nodule and its CT.
    centre_lps, radius_mm
        Centre of the brush, (3,) LPS mm in the CT, or centres (n, 3) of a stroke, and its radius, 0.5 to 40 mm.
    add
        Whether the balls are added or removed.

    Raises
    ------
    UsageError
        If a centre is outside the CT, an added ball is not connected to the nodule, no removed ball touches the nodule,
        or nothing of the nodule is left (code ``plan.edit``).
    """
    _check(volume, radius_mm, BRUSH_MM, "brush radius")
    centres = _points_in(volume, centre_lps)
    step = float(np.linalg.norm(nodule.lps_from_ijk[:3, 0]))
    inside, matrix = _padded(nodule, 2.0 * step, also=(centres, radius_mm) if add else None)
    balls = _balls(inside.shape, matrix, centres, radius_mm)
    if not add:
        if not (inside & balls).any():
            raise _refused("the brush does not touch the target")
        left = inside & ~balls
        if not left.any():
            raise _refused("nothing of the target would be left; use a smaller brush, or remove the target")
        return _edited(nodule, volume, _main_piece(left), matrix, BRUSHED)
    if not (inside & _near(balls, step)).any() or _adds_a_piece(inside, balls):
        raise _refused("the brush does not touch the target; a target is one piece")
    return _edited(nodule, volume, _in_ct(volume, inside | balls, matrix), matrix, BRUSHED)


def sphere(volume: Volume, centre_lps: ArrayLike, diameter_mm: float) -> Nodule:
    """Return a ball as a target where the CT shows no boundary, as in the mediastinum or in a consolidation.

    Parameters
    ----------
    volume
        The CT.
    centre_lps, diameter_mm
        (3,) LPS mm in the CT, and 1 to 150 mm.

    Raises
    ------
    UsageError
        If one of them is out of range (code ``plan.edit``).
    """
    _check(volume, diameter_mm, DIAMETERS_MM, "diameter")
    centre = _point_in(volume, centre_lps)
    step = box_step_mm(volume)
    half = math.ceil(0.5 * diameter_mm / step) + 2
    matrix = np.diag([step, step, step, 1.0])
    matrix[:3, 3] = centre - half * step
    inside = _off((2 * half + 1,) * 3, matrix, centre) <= 0.5 * diameter_mm
    inside[half, half, half] = True
    return measured_mask(volume, _in_ct(volume, inside, matrix), matrix, notes=(SPHERE,), off_mm=SPHERE_OFF_MM)


def _edited(nodule: Nodule, volume: Volume, inside: Mask, matrix: Place, note: str) -> Nodule:
    notes = (*(one for one in nodule.notes if one != note), note)
    found = measured_mask(volume, inside, matrix, kind=nodule.kind, notes=notes, touches=nodule.touches)
    hollow = enclosed(inside)
    if not hollow.any():
        return found
    # As for a segmented nodule, the volume is that inside the outer surface.
    hollow_mm3 = float(hollow.sum()) * float(np.linalg.norm(matrix[:3, 0])) ** 3
    return replace(found, volume_mm3=found.volume_mm3 + hollow_mm3)


def _balls(shape: tuple[int, ...], matrix: Place, centres: Place, radius_mm: float) -> Mask:
    """Return the union of balls round centres (n, 3), LPS mm, on a grid of cubic voxels."""
    found = np.zeros(shape, dtype=bool)
    step = float(np.linalg.norm(matrix[:3, 0]))
    reach = math.ceil(radius_mm / step) + 1
    size = np.array(shape[::-1])
    for ijk in (centres - matrix[:3, 3]) @ np.linalg.inv(matrix[:3, :3]).T:
        low = np.clip(np.floor(ijk).astype(int) - reach, 0, size)
        high = np.clip(np.ceil(ijk).astype(int) + reach + 1, 0, size)
        i, j, k = (np.arange(a, b) - c for a, b, c in zip(low, high, ijk, strict=True))
        near = k[:, None, None] ** 2 + j[None, :, None] ** 2 + i**2 <= (radius_mm / step) ** 2
        found[low[2] : high[2], low[1] : high[1], low[0] : high[0]] |= near
    return found


def _adds_a_piece(inside: Mask, balls: Mask) -> bool:
    """Return whether a part of balls is connected neither to a mask nor to the balls that are connected to it."""
    left = balls & ~inside
    while left.any():
        first = np.unravel_index(int(left.argmax()), left.shape)
        piece = component_at(inside | balls, (int(first[0]), int(first[1]), int(first[2])))
        if not (piece & inside).any():
            return True
        left &= ~piece
    return False


def _padded(nodule: Nodule, margin_mm: float, also: tuple[Place, float] | None = None) -> tuple[Mask, Place]:
    """Return a nodule's mask and transform on a larger grid: extended by a margin in mm and to the balls in ``also``.

    ``also`` contains the centres (n, 3), LPS mm, and the radius in mm of the balls, or is None.
    """
    matrix = nodule.lps_from_ijk
    step = float(np.linalg.norm(matrix[:3, 0]))
    low = np.zeros(3, dtype=int)
    high = np.array(nodule.inside_zyx.shape[::-1]) - 1
    if also is not None:
        ijk = (also[0] - matrix[:3, 3]) @ np.linalg.inv(matrix[:3, :3]).T
        low = np.minimum(low, np.floor(ijk.min(axis=0) - also[1] / step).astype(int))
        high = np.maximum(high, np.ceil(ijk.max(axis=0) + also[1] / step).astype(int))
    margin = math.ceil(margin_mm / step)
    before, after = margin - low, high - (np.array(nodule.inside_zyx.shape[::-1]) - 1) + margin
    if np.prod((high - low + 1 + 2 * margin).astype(float)) * step**3 > DIAMETERS_MM[1] ** 3 * 4.0:
        raise _refused("the brush lies far from the target")
    inside = np.pad(nodule.inside_zyx, [(int(before[a]), int(after[a])) for a in (2, 1, 0)])
    placed = matrix.copy()
    placed[:3, 3] -= matrix[:3, :3] @ before
    return inside, placed


def _in_ct(volume: Volume, inside: Mask, matrix: Place) -> Mask:
    """Return the part of a mask inside the CT; raise an error if less than half of the mask is inside."""
    known = Box.at(volume, matrix, inside.shape).known
    retained = inside & known
    if retained.sum() < 0.5 * inside.sum():
        raise _refused("more than half of the target would lie outside the CT")
    return retained


def _main_piece(mask: Mask) -> Mask:
    """Return the connected part of a mask with the most voxels."""
    left, best = mask.copy(), np.zeros_like(mask)
    while left.sum() > best.sum():
        first = np.unravel_index(int(left.argmax()), left.shape)
        piece = component_at(left, tuple(int(k) for k in first))
        left &= ~piece
        if piece.sum() > best.sum():
            best = piece
    return best


def _off(shape: tuple[int, ...], matrix: Place, point: Place) -> NDArray[np.float64]:
    """Return the distance (nz, ny, nx) in mm of each voxel of a grid from a point."""
    k, j, i = np.indices(shape)
    places = np.stack([i, j, k], axis=-1) @ matrix[:3, :3].T + matrix[:3, 3]
    off: NDArray[np.float64] = np.linalg.norm(places - point, axis=-1)
    return off


def _near(mask: Mask, step_mm: float) -> Mask:
    """Return a mask extended by one voxel across faces."""
    return ball_distance(~mask, step_mm, 1.1 * step_mm) <= 1.1 * step_mm


def _check(volume: Volume, mm: float, limits: tuple[float, float], what: str) -> None:
    check_type("target", "volume", volume, Volume, "open a volume with carina.open_volume")
    if not (math.isfinite(mm) and limits[0] <= mm <= limits[1]):
        raise _refused(f"expected a {what} of {limits[0]:g} to {limits[1]:g} mm; found {mm:g}")


def _point_in(volume: Volume, at_lps: ArrayLike) -> Place:
    try:
        point = np.asarray(at_lps, dtype=np.float64).reshape(3)
    except (TypeError, ValueError):
        raise UsageError(f"target: expected a point x,y,z in LPS mm; found {at_lps!r}", code="plan.point") from None
    check_in_volume(volume, point, "target: the point", code="plan.edit")
    return point


def _points_in(volume: Volume, centres_lps: ArrayLike) -> Place:
    """Return one point (3,) or several (n, 3), LPS mm, as an array (n, 3); reject points outside the CT."""
    try:
        centres = np.asarray(centres_lps, dtype=np.float64).reshape(-1, 3)
    except (TypeError, ValueError):
        centres = np.zeros((0, 3))
    if not len(centres):
        raise UsageError(f"target: expected points x,y,z in LPS mm; found {centres_lps!r}", code="plan.point")
    for centre in centres:
        check_in_volume(volume, centre, "target: the point", code="plan.edit")
    return centres


def _refused(problem: str) -> UsageError:
    return UsageError(f"editing the target: {problem}", code="plan.edit")
