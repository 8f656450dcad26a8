"""Doubts whether a target is a nodule: density, contrast medium, a continuing tube, mediastinum, or an airway's wall.

A doubt has a code, and every output of a target contains the doubts. A target with a doubt is planned only after the
user has confirmed it (docs/planning.md).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from carina.argument_checks import shown
from carina.display import one_line
from carina.errors import TrackingError, UnconfirmedTargetError, UsageError
from carina.plan.cubic_box import Box, component_at, enclosed, from_faces, lung_median_hu, smoothed
from carina.plan.targets.boundary import DENSEST_HU, SMOOTH_MM
from carina.plan.targets.nodule import Nodule
from carina.scopes import WallField
from carina.volume import Volume
from carina.volume.mask_distances import ball_distance, distance_from
from carina.volume.model import Remark

if TYPE_CHECKING:
    from carina.track import Airways

Mask = NDArray[np.bool_]

DENSITY = "target.density"
CONTRAST = "target.contrast"
TUBE = "target.tube"
MEDIASTINUM = "target.mediastinum"
BESIDE_AIRWAY = "target.beside-airway"
ALL_CODES = (DENSITY, CONTRAST, TUBE, MEDIASTINUM, BESIDE_AIRWAY)

Confirmed = bool | Collection[str]
"""Doubts that a caller confirms: True for all of them, or their codes."""

DENSE_HU = 110.0
"""Density in HU above which a target may be a vessel or calcified.

By common knowledge soft tissue without contrast medium is 20 to 60 HU and vessels with contrast medium are 150 to 400
HU; contrast medium adds 20 to 60 HU to tumours.
"""
UNRESOLVED_MM, UNRESOLVED_SLICES = 1.0, 0.5
"""Radius of the largest ball in a faint target below which its density is uncertain: a length in mm, and a share of
the slice distance in addition.

The blur of the CT and of its slices makes a vessel, an airway's wall or a dense nodule of this size as faint as ground
glass.
"""
LIKE_BLOOD = (0.6, 1.5)
"""Range of the target's density, relative to blood, in which the target may be a vessel with contrast medium.

Partial volumes lower the density of a narrow vessel.
"""
BLOOD_BOX_MM = ((-40.0, 40.0), (-55.0, -8.0), (-30.0, 30.0))
"""Box round the end of the trachea, LPS mm, in which the great vessels are searched; it is in front of the spine."""
BLOOD_RADIUS_MM, BLOOD_PERCENT, MIN_BLOOD_MM3 = 5.0, 75.0, 2000.0
"""Limits for great vessels: least radius in mm, percentile that gives the blood's density, least volume in mm3."""
TUBE_STEP_MM = 0.5
"""Voxel size in mm for examining a target with a radius below `TUBE_COARSE_MM`."""
TUBE_COARSE_MM = 4.0
MAX_STEPS = 160
"""Maximum number of voxels along a side of the box round a target; a large mass gets larger voxels."""
BEYOND_MM = 3.0
"""Minimum distance in mm from a target up to which a tube must continue to count as a vessel.

For a target with a larger radius, the tube must continue for that radius. The stump of a thin vessel is shorter.
"""
TUBE_SHARE = 0.45
"""Minimum width of a continuing tube, as a share of the target's width, at which the target may be a vessel.

The limit was chosen with vessels of three CTs with 3 mm slices and with 25 balls painted into two of them; it was not
verified with other CTs.
"""
TUBE_SHARE_IN_AIRWAY = 0.6
"""Minimum width of a continuing tube for a lesion in an airway, as a share of the lesion's width.

The airway's own wall is narrower.
"""
TUBE_LEVEL = 0.4
"""Position of the threshold for tubes between the densities of lung (0) and target (1).

The boundary's own threshold of 0.5 loses a vessel that narrows.
"""
TUBE_SHARES = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5, TUBE_SHARE)
SLENDER = 0.5
"""Maximum ratio of the second to the first main axis of a target that is a piece of a tube; balls have 0.58 or more."""
THICK_MM, THICK_SHARE = 6.0, 1.5
"""Minimum radius in mm of chest wall, mediastinum and diaphragm, and the same as a multiple of the target's radius."""
SHELL_MM = (2.0, 4.0)
"""Range of distances in mm from a target in which surrounding lung is measured; closer voxels are blurred."""
LUNG_HU, LUNG_SHARE = -500.0, 0.25
"""Maximum density of lung in HU; minimum share of lung round a target, below which the target may be mediastinum."""
LUMEN_EDGE_MM = 1.0
"""Distance in mm outside a lumen within which air belongs to the airway, because blur moves its edge."""

NEAR_AIRWAY_MM = 5.0
"""Maximum distance in mm of a point from a lumen at which the point may select the airway."""
OFF_MM = 1.0
"""Maximum distance in mm of a point from the target that it selects beside an airway."""
WALL_MM, WALL_SHARE = 1.6, 0.5
"""Thickness in mm of an airway's wall, and the share of a target within the wall above which it may be the wall."""
IN_LUMEN = "airway wall"
"""Structure that a lesion inside an airway touches."""


@one_line
@dataclass(frozen=True, slots=True)
class TargetDoubt(Remark):
    """Reason for which a target may not be a nodule, with a code such as ``target.tube``."""

    def to_json(self) -> dict[str, str]:
        """Return the doubt as plain JSON types."""
        return {"code": self.code, "words": self.words}

    @classmethod
    def from_json(cls, record: Mapping[str, Any]) -> TargetDoubt:
        """Return the doubt that `to_json` wrote."""
        return cls(str(record["code"]), str(record["words"]))


def confirmed_codes(confirmed: Confirmed) -> tuple[str, ...]:
    """Return the codes of the doubts that are confirmed.

    Raises
    ------
    UsageError
        If a code is unknown (code ``plan.confirmed``).
    """
    if isinstance(confirmed, bool):
        return ALL_CODES if confirmed else ()
    is_list = isinstance(confirmed, tuple | list | set | frozenset)
    codes: tuple[Any, ...] = tuple(confirmed) if is_list else (confirmed,)
    for code in codes:
        if not isinstance(code, str) or code not in ALL_CODES:
            raise UsageError(
                f"confirmed: expected True, False or codes of doubts ({', '.join(ALL_CODES)}); found {shown(code)}",
                code="plan.confirmed",
            )
    return codes


def check_confirmed(doubts: Sequence[TargetDoubt], confirmed: Confirmed) -> None:
    """Raise an error unless every doubt is confirmed.

    Raises
    ------
    UnconfirmedTargetError
        With the code of the first doubt that is not confirmed, and all such doubts in ``doubts``.
    """
    codes = confirmed_codes(confirmed)
    left = tuple(doubt for doubt in doubts if doubt.code not in codes)
    if not left:
        return
    reasons = "; ".join(doubt.words for doubt in left)
    listed = ",".join(doubt.code for doubt in left)
    raise UnconfirmedTargetError(
        f"the target may not be a nodule: {reasons}. Look at it in the slices. If it is the target, confirm it "
        f"(--confirm {listed}, or confirmed= in Python)",
        doubts=left,
    )


def target_doubts(
    volume: Volume,
    nodule: Nodule,
    *,
    airways: Airways | None = None,
    wall: WallField | None = None,
    clicked_lps: tuple[float, float, float] | None = None,
) -> tuple[TargetDoubt, ...]:
    """Return the reasons for which a target may not be a nodule.

    Parameters
    ----------
    volume, nodule
        The CT and the target.
    airways
        The airways, which show where the great vessels are; without them contrast medium is not recognised.
    wall, clicked_lps
        Wall of the airways, and the point (3,), LPS mm, that the user clicked. With both, the wall of an airway and
        the vessel beside an airway are recognised; a boundary that was drawn needs no such check.

    Examples
    --------
    >>> import carina
    >>> made = carina.generate_phantom(seed=4, spacing_mm=1.0, nodule=True, box_lps=((-130, 15, -60), (-72, 75, -2)))
    >>> target_doubts(made.volume, carina.grow_nodule(made.volume, made.truth["nodule"]["centre_lps"]))
    ()
    """
    around = _Around(volume, nodule)
    found = []
    hu = nodule.density_hu
    if hu > DENSE_HU:
        found.append(
            TargetDoubt(
                DENSITY,
                f"at {hu:.0f} HU it is denser than soft tissue, like a vessel with contrast medium, bone or "
                "calcification",
            )
        )
        blood_hu = None if airways is None else _blood_hu(volume, airways)
        if blood_hu is not None and blood_hu > DENSE_HU and LIKE_BLOOD[0] <= hu / blood_hu <= LIKE_BLOOD[1]:
            found.append(
                TargetDoubt(
                    CONTRAST,
                    "the CT was taken with contrast medium, and it has about the density of the blood "
                    f"({blood_hu:.0f} HU)",
                )
            )
    elif nodule.kind != "solid" and around.radius_mm < _unresolved_mm(volume):
        found.append(
            TargetDoubt(
                DENSITY,
                f"at {hu:.0f} HU and {nodule.long_mm:.1f} x {nodule.short_mm:.1f} mm it is too small for slices of "
                f"{max(volume.spacing_mm):.3g} mm to show whether it is ground glass, or a part of a vessel or of an "
                "airway's wall",
            )
        )
    share = around.tube_share()
    if share is not None:
        found.append(
            TargetDoubt(
                TUBE,
                f"it continues beyond its boundary as a tube of {100 * share:.0f} % of its width, as a vessel does",
            )
        )
    elif around.is_slender():
        found.append(TargetDoubt(TUBE, "it is long and thin, like a piece of a vessel"))
    is_in_airway = IN_LUMEN in nodule.touches or (wall is not None and _is_centre_in_lumen(nodule, wall))
    if around.lung_share(None if is_in_airway else wall) < LUNG_SHARE:
        found.append(
            TargetDoubt(
                MEDIASTINUM,
                "there is hardly any lung round it: in the mediastinum, the hilum or the chest wall the CT shows no "
                "certain boundary, and organs and vessels look like a nodule",
            )
        )
    if airways is not None and wall is not None and clicked_lps is not None:
        gap_mm = _gap_mm(airways, clicked_lps)
        if gap_mm is not None and _may_be_airway(nodule, clicked_lps, gap_mm, found, wall):
            place = "in the lumen" if gap_mm == 0.0 else f"{gap_mm:.1f} mm from the lumen"
            found.append(
                TargetDoubt(
                    BESIDE_AIRWAY,
                    f"the point is {place} of an airway, and it may be the airway's wall or the vessel beside it",
                )
            )
    return tuple(found)


def _unresolved_mm(volume: Volume) -> float:
    """Return the radius in mm below which a target in a CT may be faint because of its size only."""
    return UNRESOLVED_MM + UNRESOLVED_SLICES * max(volume.spacing_mm)


def _is_centre_in_lumen(nodule: Nodule, wall: WallField) -> bool:
    """Return whether the centre of a target lies in an airway; the air round such a target is that of the airway."""
    return float(wall.distance_mm(np.array([nodule.centre_lps]))[0]) > 0.0


class _Around:
    """Tissue of the CT round a target, resampled to cubic voxels."""

    def __init__(self, volume: Volume, nodule: Nodule) -> None:
        self._nodule = nodule
        voxel_mm = float(np.linalg.norm(nodule.lps_from_ijk[:3, 0]))
        radius_mm = float(ball_distance(np.pad(nodule.inside_zyx, 1), voxel_mm).max())
        step = voxel_mm if radius_mm > TUBE_COARSE_MM else min(voxel_mm, TUBE_STEP_MM)
        self.radius_mm = radius_mm
        """Radius of the largest ball in the target, mm."""
        self._beyond_mm = max(BEYOND_MM, radius_mm)
        pad_mm = max(self._beyond_mm, SHELL_MM[1]) + max(4.0, 0.5 * radius_mm)
        sides_mm = np.array(nodule.inside_zyx.shape[::-1]) * voxel_mm + 2.0 * pad_mm
        step = max(step, float(sides_mm.max()) / MAX_STEPS)
        num = np.ceil(sides_mm / step).astype(int) + 1
        axes = nodule.lps_from_ijk[:3, :3] / voxel_mm
        matrix = np.eye(4)
        matrix[:3, :3] = axes * step
        matrix[:3, 3] = nodule.lps_from_ijk[:3, 3] - axes.sum(axis=1) * pad_mm
        box = Box.at(volume, matrix, tuple(int(n) for n in num[::-1]))
        self._step, self._known, self._lps_from_ijk = step, box.known, matrix
        inside = _resampled(nodule.inside_zyx, num, step / voxel_mm, pad_mm / voxel_mm)
        self._inside = inside | enclosed(inside)
        self._smooth = smoothed(box.hu_zyx, SMOOTH_MM / step)
        self._away = distance_from(self._inside, step, pad_mm)

    def lung_share(self, wall: WallField | None) -> float:
        """Return the share of lung in the shell round the target; 1 if the CT does not show the shell.

        Parameters
        ----------
        wall
            Wall of the airways: the air of an airway is not lung. If None, all air is lung.
        """
        shell = (self._away > SHELL_MM[0]) & (self._away <= SHELL_MM[1]) & self._known & ~self._inside
        if not shell.any():
            return 1.0
        lung = self._smooth[shell] < LUNG_HU
        if wall is not None:
            points = np.argwhere(shell)[lung, ::-1] @ self._lps_from_ijk[:3, :3].T + self._lps_from_ijk[:3, 3]
            lung[lung] = wall.distance_mm(points) <= -LUMEN_EDGE_MM
        return float(lung.mean())

    def is_slender(self) -> bool:
        """Return whether the target is much longer than wide in both other directions."""
        points = np.argwhere(self._inside).astype(np.float64)
        if len(points) < 4:
            return False
        squares = np.maximum(np.linalg.eigvalsh(np.cov(points.T)), 0.0)
        return bool(squares[1] < SLENDER**2 * squares[2])

    def tube_share(self) -> float | None:
        """Return the width of a tube that leaves the target, as a share of the target's width; None without a tube.

        Chest wall, mediastinum and diaphragm are not tubes.
        """
        lung_hu = lung_median_hu(self._smooth)
        bar_hu = lung_hu + TUBE_LEVEL * (min(self._nodule.density_hu, DENSEST_HU) - lung_hu)
        dense = (self._smooth > bar_hu) | self._inside
        dense |= enclosed(dense)
        depth = ball_distance(dense, self._step)
        peak = float(depth[self._inside].max())
        thick_mm = max(THICK_MM, THICK_SHARE * peak)
        core = from_faces(depth > thick_mm)
        thick = (distance_from(core, self._step, thick_mm + self._step) <= thick_mm + self._step) | core
        depth = np.where(thick & ~self._inside, np.float32(0.0), depth)
        middle = np.unravel_index(int(np.where(self._inside, depth, 0.0).argmax()), depth.shape)
        seed = (int(middle[0]), int(middle[1]), int(middle[2]))
        beyond = (self._away > self._beyond_mm) & ~self._inside
        least = TUBE_SHARE_IN_AIRWAY if IN_LUMEN in self._nodule.touches else TUBE_SHARE
        for share in (share for share in TUBE_SHARES if share >= least):
            if (component_at(depth >= share * peak, seed) & beyond).any():
                return share
        return None


def _resampled(mask: Mask, num: NDArray[np.intp], step: float, pad: float) -> Mask:
    """Return a mask on a padded grid along its own axes, by the nearest voxel.

    Parameters
    ----------
    mask
        (nz, ny, nx) mask.
    num
        Number of voxels of the grid along x, y and z.
    step, pad
        Voxel size of the grid, and its margin before the mask, in voxels of the mask.
    """
    found = np.zeros(tuple(int(n) for n in num[::-1]), dtype=bool)
    own = [np.rint(np.arange(n) * step - pad).astype(np.intp) for n in found.shape]
    there = [np.flatnonzero((at >= 0) & (at < size)) for at, size in zip(own, mask.shape, strict=True)]
    found[np.ix_(*there)] = mask[np.ix_(*(at[k] for at, k in zip(own, there, strict=True)))]
    return found


def _blood_hu(volume: Volume, airways: Airways) -> float | None:
    """Return the density in HU of the great vessels in front of the main carina; None if the CT does not show them."""
    step = 1.5
    end = np.array(airways.tree.root.points[-1], dtype=np.float64)
    low = end + np.array([one[0] for one in BLOOD_BOX_MM])
    num = [int(np.ceil((one[1] - one[0]) / step)) + 1 for one in BLOOD_BOX_MM]
    matrix = np.diag([step, step, step, 1.0])
    matrix[:3, 3] = low
    box = Box.at(volume, matrix, (num[2], num[1], num[0]))
    smooth = smoothed(box.hu_zyx, 1.0)
    tissue = (smooth > 0.0) & box.known
    core = ball_distance(tissue, step, BLOOD_RADIUS_MM) > BLOOD_RADIUS_MM
    if float(core.sum()) * step**3 < MIN_BLOOD_MM3:
        return None
    return float(np.percentile(smooth[core], BLOOD_PERCENT))


def _gap_mm(airways: Airways, point: tuple[float, float, float]) -> float | None:
    """Return the distance in mm of a point from the nearest lumen; None if it is above `NEAR_AIRWAY_MM`."""
    try:
        return float(airways.tracker.path_to(point, snap_mm=NEAR_AIRWAY_MM).snapped_mm)
    except TrackingError:
        return None


def _may_be_airway(
    nodule: Nodule, point: tuple[float, float, float], gap_mm: float, doubts: Sequence[TargetDoubt], wall: WallField
) -> bool:
    """Return whether a target near an airway may be the airway's wall, or the vessel beside it."""
    if any(doubt.code in {TUBE, MEDIASTINUM} for doubt in doubts):
        return True
    if IN_LUMEN in nodule.touches:
        # A click in the lumen selects the airway, because the ridge between two branches also borders on the lumen.
        return gap_mm == 0.0
    if float(nodule.distance_mm([point])[0]) > OFF_MM:
        return True
    points = np.argwhere(nodule.inside_zyx)[:, ::-1] @ nodule.lps_from_ijk[:3, :3].T + nodule.lps_from_ijk[:3, 3]
    return float((wall.distance_mm(points) > -WALL_MM).mean()) >= WALL_SHARE
