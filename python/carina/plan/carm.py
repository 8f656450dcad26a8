"""C-arm angles at which target and tip are clear of spine and mediastinum and the last branch is seen lengthwise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.argument_checks import check_arguments, instance, whole_from
from carina.display import one_line
from carina.errors import CancelledError, NoResultError, UsageError
from carina.plan.cubic_box import Box
from carina.plan.lungs.tissue_near_needle import lung_box
from carina.plan.routes.plan_route import Plan
from carina.render import DrrView, geometry
from carina.track import Airways, AirwayTree
from carina.volume import Volume

Points = NDArray[np.float64]
Mask = NDArray[np.bool_]

MAX_PRIMARY_DEG, MAX_SECONDARY_DEG = 60, 30
"""Maximum LAO or RAO, and cranial or caudal, angle that is searched, in degrees (common knowledge)."""
STEP_DEG = 5
MIN_CLEAR_MM = 3.0
"""Least distance in mm, at the scale of the isocentre, between target or tip and the shadow of spine or mediastinum."""
MAX_TILT_DEG = 30.0
"""Maximum angle in degrees between the last branch and the image plane; at 30, 87 % of its length is visible."""
ENOUGH_MM = 15.0
"""Distance in mm from the shadows above which a larger distance does not improve the rank."""
APART_DEG = 15.0
"""Minimum difference in degrees between two proposed C-arm positions; the lower-ranked of more similar ones is
dropped."""
MAX_ANGLES = 3
LAST_MM = 20.0
"""Length in mm of centreline before the scope's tip over which the direction of the last branch is measured."""

GRID_MM = 3.0
HALF_DIAGONAL_MM = 0.5 * 3.0**0.5 * GRID_MM
BONE_HU = 150.0
SPINE_HALF_MM = 35.0
"""Half the width in mm of the spine with its transverse processes."""
LEFT_MM, RIGHT_MM = 95.0, 55.0
"""Maximum distances in mm of mediastinum from the spine, left and right; tissue beyond may be diaphragm."""
AROUND_TARGET_MM = 4.0
"""Distance in mm from the target within which tissue belongs to the target and its blurred edge."""

CARM_LIMITS = (
    f"Searched from RAO {MAX_PRIMARY_DEG} to LAO {MAX_PRIMARY_DEG} and from caudal {MAX_SECONDARY_DEG} to cranial "
    f"{MAX_SECONDARY_DEG} degrees (usual limits without a published source; check your C-arm and table). Supine "
    "patient, as in the DRR view, with the C-arm centred on the middle of the CT. Spine and mediastinum (heart and "
    "great vessels, all tissue between the lungs) are estimated from the CT; the target's movement since the CT is not "
    "included."
)


@one_line
@dataclass(frozen=True, slots=True)
class CArmAngle:
    """Position of a C-arm, and what its picture shows of a route; angles are those of `carina.render.DrrView`."""

    primary_deg: float
    """Rotation of the detector towards the patient's left (LAO, above 0) or right (RAO, below 0), degrees."""
    secondary_deg: float
    """Rotation of the detector towards the head (cranial, above 0) or the feet (caudal, below 0), degrees."""
    target_clear_mm: float
    """Distance from the target's outline to the nearest shadow, mm at the isocentre; below 0 inside the shadow."""
    tip_clear_mm: float
    """Distance from the scope's tip to the nearest shadow, mm at the isocentre; below 0 inside the shadow."""
    tilt_deg: float
    """Angle in degrees between the last branch and the image plane; 0 if the branch is visible in its full length."""

    @property
    def name(self) -> str:
        """Name of the C-arm's position by its angles, such as *LAO 30°, cranial 10°*."""
        return carm_words(self.primary_deg, self.secondary_deg)

    @property
    def words(self) -> str:
        """C-arm position, with the clearances of target and tip and the tilt of the last branch, as text."""
        return (
            f"{self.name}: target {self.target_clear_mm:.0f} mm and tip {self.tip_clear_mm:.0f} mm clear of spine and "
            f"mediastinum, last branch {self.tilt_deg:.0f}\u00b0 out of the picture"
        )

    @property
    def suits(self) -> bool:
        """Whether target and tip are clear of shadows by `MIN_CLEAR_MM`, and the last branch is tilted little."""
        return min(self.target_clear_mm, self.tip_clear_mm) >= MIN_CLEAR_MM and self.tilt_deg <= MAX_TILT_DEG

    def to_json(self) -> dict[str, Any]:
        """Return the position as plain JSON types."""
        return {
            "primary_deg": self.primary_deg,
            "secondary_deg": self.secondary_deg,
            "target_clear_mm": self.target_clear_mm,
            "tip_clear_mm": self.tip_clear_mm,
            "tilt_deg": self.tilt_deg,
            "name": self.name,
            "words": self.words,
        }


@one_line
@dataclass(frozen=True, slots=True)
class CArmAngles:
    """Proposed C-arm positions for one route, the position with the best rank first."""

    route_key: str
    angles: tuple[CArmAngle, ...]
    why: str | None
    """Reason, as text for the user, why no C-arm position suits; None if a position suits."""
    notes: tuple[str, ...] = ()

    @property
    def lines(self) -> tuple[str, ...]:
        """Texts for the user: the positions, or the reason why none suits, then the notes."""
        return (*((self.why,) if self.why is not None else ()), *(one.words for one in self.angles), *self.notes)

    def to_json(self) -> dict[str, Any]:
        """Return the positions as plain JSON types."""
        return {
            "route": self.route_key,
            "angles": [one.to_json() for one in self.angles],
            "why": self.why,
            "limits": CARM_LIMITS,
            "notes": list(self.notes),
        }


@dataclass(frozen=True, slots=True, eq=False)
class ShadowParts:
    """Surface of the structures that hide a target in a radiograph, as points on a grid of 3 mm, LPS mm."""

    spine_lps: Points
    mediastinum_lps: Points

    @property
    def points_lps(self) -> Points:
        """Points (n, 3) of both structures, LPS mm."""
        return np.concatenate([self.spine_lps, self.mediastinum_lps])


def carm_words(primary_deg: float, secondary_deg: float) -> str:
    """Return the angles of a C-arm as text, such as *LAO 30°, cranial 10°*.

    Examples
    --------
    >>> carm_words(30, -10), carm_words(-15, 0), carm_words(0, 0)
    ('LAO 30\u00b0, caudal 10\u00b0', 'RAO 15\u00b0', 'AP')
    """
    first = "AP" if primary_deg == 0 else f"{'LAO' if primary_deg > 0 else 'RAO'} {abs(primary_deg):.0f}\u00b0"
    if secondary_deg == 0:
        return first
    return f"{first}, {'cranial' if secondary_deg > 0 else 'caudal'} {abs(secondary_deg):.0f}\u00b0"


@check_arguments(
    volume=instance(Volume, "open a volume with carina.open_volume"),
    airways=instance(Airways, "get airways from carina.find_airways"),
    plan=instance(Plan, "get one from carina.plan_route"),
    route_number=whole_from(1, 100),
)
def carm_angles(
    volume: Volume,
    airways: Airways,
    plan: Plan,
    *,
    route_number: int = 1,
    shadows: ShadowParts | None = None,
    cancel: Callable[[], bool] | None = None,
) -> CArmAngles:
    """Return the positions of a C-arm that show target, tip and last branch of a route beside spine and mediastinum.

    Parameters
    ----------
    volume, airways, plan
        The CT, its airways, and a plan in them.
    route_number
        Number of the route, from 1.
    shadows
        Spine and mediastinum (`shadow_parts`); found in the CT if None.
    cancel
        Called often; the work stops when it returns True.

    Returns
    -------
    CArmAngles
        Up to three positions at least 15 degrees apart; none, with the reason, if no position suits.

    Raises
    ------
    UsageError
        If there is no such route.
    CancelledError
        If ``cancel()`` returned True.
    """
    if route_number > len(plan.routes):
        raise UsageError(f"route_number: the plan has {len(plan.routes)} routes; found {route_number}")
    route = plan.routes[route_number - 1]
    nodule = plan.nodule
    tip = np.array(route.leg.tip_lps)
    target, radius_mm = np.array(nodule.centre_lps), 0.5 * nodule.long_mm
    try:
        parts = shadow_parts(volume, airways.tree) if shadows is None else shadows
    except NoResultError as error:
        return CArmAngles(route.key, (), f"C-arm angles are not known: {error}")
    notes = []
    if not len(parts.spine_lps):
        notes.append("no spine was found in the CT; only the mediastinum was considered")
    points = parts.points_lps
    points = points[np.linalg.norm(points - target, axis=1) > radius_mm + AROUND_TARGET_MM]
    if not len(points):
        return CArmAngles(route.key, (), "C-arm angles are not known: the CT shows neither spine nor mediastinum")
    last = _last_direction(airways.tree, route.branch_id, route.along_mm)
    found: list[CArmAngle] = []
    for primary in range(-MAX_PRIMARY_DEG, MAX_PRIMARY_DEG + 1, STEP_DEG):
        if cancel is not None and cancel():
            raise CancelledError("the search for C-arm angles was cancelled")
        for secondary in range(-MAX_SECONDARY_DEG, MAX_SECONDARY_DEG + 1, STEP_DEG):
            view = DrrView(primary_deg=primary, secondary_deg=secondary)
            flat, scale = projected_mm(volume, view, points)
            (target_at, tip_at), (target_scale, _) = projected_mm(volume, view, np.stack([target, tip]))
            cells = HALF_DIAGONAL_MM * scale
            off = np.linalg.norm(flat - target_at, axis=1) - cells
            off_tip = np.linalg.norm(flat - tip_at, axis=1) - cells
            out = geometry.orbit_pose(volume.centre_lps, primary, secondary, 1.0).position_lps - volume.centre_lps
            tilt = float(np.degrees(np.arcsin(np.clip(abs(float(last @ out)), 0.0, 1.0))))
            clear = float(off.min()) - radius_mm * float(target_scale)
            found.append(CArmAngle(float(primary), float(secondary), clear, float(off_tip.min()), tilt))
    best = sorted((one for one in found if one.suits), key=_order)
    chosen: list[CArmAngle] = []
    for one in best:
        if all(
            max(abs(one.primary_deg - other.primary_deg), abs(one.secondary_deg - other.secondary_deg)) >= APART_DEG
            for other in chosen
        ):
            chosen.append(one)
    if chosen:
        return CArmAngles(route.key, tuple(chosen[:MAX_ANGLES]), None, tuple(notes))
    return CArmAngles(route.key, (), _why_none(found), tuple(notes))


def _order(one: CArmAngle) -> tuple[float, ...]:
    """Return the sort key of a position: clearance up to 15 mm times visible share of the branch, then small angles."""
    clear = min(one.target_clear_mm, one.tip_clear_mm, ENOUGH_MM)
    value = clear * float(np.cos(np.radians(one.tilt_deg)))
    return -round(value, 1), abs(one.primary_deg) + abs(one.secondary_deg), one.primary_deg, one.secondary_deg


def _why_none(found: list[CArmAngle]) -> str:
    nearest = max(found, key=lambda one: min(one.target_clear_mm, one.tip_clear_mm))
    clear = min(nearest.target_clear_mm, nearest.tip_clear_mm)
    if clear < MIN_CLEAR_MM:
        what = "target" if nearest.target_clear_mm <= nearest.tip_clear_mm else "tip"
        return (
            f"no C-arm angle within the limits shows target and tip {MIN_CLEAR_MM:.0f} mm clear of spine and "
            f"mediastinum; at the best one, {nearest.name}, the {what} is "
            + (f"{clear:.0f} mm clear" if clear >= 0.0 else f"{-clear:.0f} mm within their shadow")
        )
    return (
        "no C-arm angle within the limits shows target and tip clear of spine and mediastinum and the last branch "
        f"lengthwise; at the best one, {nearest.name}, the branch is {nearest.tilt_deg:.0f}\u00b0 out of the picture"
    )


def projected_mm(volume: Volume, view: DrrView, points_lps: Points) -> tuple[Points, Points]:
    """Return points in the radiograph of `carina.render.cast_drr`, in mm at the scale of the isocentre.

    Parameters
    ----------
    volume
        The CT, whose middle is the isocentre.
    view
        Angles and distances of the C-arm.
    points_lps
        (n, 3) LPS mm.

    Returns
    -------
    places, scale
        (n, 2) mm from the middle of the picture to the right and downwards, and (n,) magnification against the
        isocentre.
    """
    detector = geometry.orbit_pose(
        volume.centre_lps, view.primary_deg, view.secondary_deg, view.sid_mm - view.sod_mm
    ).lps_from_camera
    right, down, to_source = detector[:3, :3].T
    source = volume.centre_lps + view.sod_mm * to_source
    off = points_lps - source
    scale = view.sod_mm / np.maximum(-(off @ to_source), 1.0)
    return np.stack([off @ right * scale, off @ down * scale], axis=1), scale


def _last_direction(tree: AirwayTree, branch_id: int, along_mm: float) -> Points:
    """Return the direction of the chord of the last branch up to the tip, over at most 20 mm; unit vector, LPS."""
    lineage = tree.lineage(branch_id)
    points = lineage[-1].points
    along = sum(branch.length_mm for branch in lineage[:-1]) + np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]
    )

    def at(mm: float) -> Points:
        return np.array([np.interp(mm, along, points[:, axis]) for axis in range(3)])

    end = max(along_mm, float(along[0]) + 2.0)
    chord = at(end) - at(max(end - LAST_MM, float(along[0])))
    return chord / max(float(np.linalg.norm(chord)), 1e-9)


def shadow_parts(volume: Volume, tree: AirwayTree) -> ShadowParts:
    """Return the surfaces of spine and mediastinum of a CT as points on a grid of 3 mm.

    The spine is bone behind the trachea, within 35 mm of the middle of the vertebral bodies in each slice. The
    mediastinum is all tissue without lung between it and the middle of the chest, in rows of axial slices with lung on
    both sides, up to 95 mm to the left of the spine and 55 mm to the right (mirrored chests: the reverse).

    Parameters
    ----------
    volume
        The CT.
    tree
        Airways, whose first branch is the trachea.

    Raises
    ------
    NoResultError
        If there is no lung in the CT (code ``plan.no_lung``).
    """
    lungs = lung_box(volume)
    every = max(round(GRID_MM / lungs.step_mm), 1)
    # Blocks of voxels are averaged, because a single voxel is noisy.
    corners = volume.to_lps(
        np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) * (np.array(volume.shape_zyx[::-1]) - 1.0)
    )
    low, high = corners.min(axis=0), corners.max(axis=0)
    matrix = np.diag([GRID_MM, GRID_MM, GRID_MM, 1.0])
    start = lungs.lps_from_ijk[:3, 3]
    before = np.ceil((start - low) / GRID_MM).astype(np.intp)
    matrix[:3, 3] = start - GRID_MM * before
    nx, ny, nz = (np.floor((high - matrix[:3, 3]) / GRID_MM).astype(np.intp) + 1).tolist()
    box = Box.at(volume, matrix, (nz, ny, nx))
    lung = np.zeros(box.hu_zyx.shape, dtype=bool)
    known = lungs.known[::every, ::every, ::every]
    first = [int(n) for n in before[::-1]]
    extent = [min(known.shape[axis], lung.shape[axis] - first[axis]) for axis in range(3)]
    window = tuple(slice(first[axis], first[axis] + extent[axis]) for axis in range(3))
    lung[window] = known[tuple(slice(size) for size in extent)]
    spine, middle_mm = _spine(box, tree)
    between = np.maximum.accumulate(lung, axis=2) & np.maximum.accumulate(lung[:, :, ::-1], axis=2)[:, :, ::-1]
    x = box.lps_from_ijk[0, 3] + GRID_MM * np.arange(nx)
    left_mm, right_mm = (RIGHT_MM, LEFT_MM) if _is_mirrored(tree) else (LEFT_MM, RIGHT_MM)
    middle = np.clip(np.searchsorted(x, middle_mm), 0, nx - 1)
    # Tissue belongs to the mediastinum if no lung is between it and the middle of the chest in its row.
    passed = np.cumsum(lung, axis=2)
    at_middle = np.take_along_axis(passed, np.broadcast_to(middle[:, None, None], (nz, ny, 1)), axis=2)
    off = x[None, :] - middle_mm[:, None]
    inner = ((off <= left_mm) & (off >= -right_mm))[:, None, :]
    mediastinum = between & ~lung & (passed == at_middle) & inner & ~spine & box.known
    return ShadowParts(_places(box, spine), _places(box, mediastinum))


def _is_mirrored(tree: AirwayTree) -> bool:
    return any(branch.name == "LML" for branch in tree.branches)


def _spine(box: Box, tree: AirwayTree) -> tuple[Mask, Points]:
    """Return the mask of the spine, and the x of its middle in each slice, LPS mm.

    The spine is bone behind the trachea near the middle of the vertebral bodies of the slice. Without bone, the middle
    is that of the trachea.
    """
    root = tree.root.points
    x, y, z = (box.lps_from_ijk[axis, 3] + GRID_MM * np.arange(n) for axis, n in enumerate(box.hu_zyx.shape[::-1]))
    behind = y > float(root[:, 1].mean())
    near = np.abs(x - float(root[:, 0].mean())) < 2.0 * SPINE_HALF_MM
    bone = (box.hu_zyx > BONE_HU) & box.known & behind[:, None] & near
    spine = np.zeros(bone.shape, dtype=bool)
    middles = np.full(len(z), np.nan)
    smooth = np.full(len(z), float(root[:, 0].mean()))
    for k, flat in enumerate(bone):
        columns = flat.sum(axis=0).astype(np.float64)
        if columns.sum() >= 10:
            # The median is used, so that a single rib does not shift the middle.
            middles[k] = float(x[np.searchsorted(np.cumsum(columns), 0.5 * columns.sum())])
    for k in range(len(z)):
        around = middles[max(k - 8, 0) : k + 9]
        around = around[np.isfinite(around)]
        if len(around):
            smooth[k] = float(np.median(around))
            spine[k] = bone[k] & (np.abs(x - smooth[k]) <= SPINE_HALF_MM)
    return spine, smooth


def _places(box: Box, mask: Mask) -> Points:
    """Return the surface voxels of a mask as points (n, 3), LPS mm; their shadow is that of the whole mask."""
    padded = np.pad(mask, 1)
    inside = mask.copy()
    for axis in range(3):
        for shift in (-1, 1):
            inside &= np.roll(padded, shift, axis=axis)[1:-1, 1:-1, 1:-1]
    return np.argwhere(mask & ~inside)[:, ::-1] * GRID_MM + box.lps_from_ijk[:3, 3]
