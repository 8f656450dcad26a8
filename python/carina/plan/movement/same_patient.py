"""Checks whether a second CT is another scan of the same patient in the same pose, with the whole chest.

Each refusal states what is wrong, what was expected and found, and what the user can do.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carina.errors import NoResultError
from carina.plan.movement.deformation import Affine, rotation_deg
from carina.volume import Volume

Points = NDArray[np.float64]
Mask = NDArray[np.bool_]

MIN_RIGID, MIN_FORKS = 5, 8
"""Minimum number of forks that both trees name, and minimum number of them that follow one motion."""
MIN_RIGID_SHARE = 0.6
"""Share of forks that follow one rigid motion within 15 mm below which the second CT may be another patient's."""
MAX_TURN_DEG = 20.0
"""Maximum rotation between both CTs in degrees; beyond it the patient is in another pose."""
MAX_MEDIAN_MM = 5.0
"""Median distance in mm of the forks from their affine motion above which the second CT may be another patient's."""
STRETCH = (0.7, 1.4)
"""Minimum and maximum ratio of the chest's length or width in the second CT to that in the first."""
MIN_INSIDE = 0.85
"""Minimum share of the first CT's forks whose expected positions are inside the second CT."""
MIN_SIZE = 0.9
"""Minimum size of the second CT on each axis, as a share of the extent of the first CT's forks."""
MIN_FORKS_FOUND = 0.85
"""Minimum share of named forks whose surroundings are found in the second CT.

The share is at least 0.95 in two CTs of one patient, and at most 0.8 in phantoms of two patients.
"""
MIN_NEAR, NEAR_MM = 8, 45.0
"""Minimum number of vessels and forks found in the second CT within a distance in mm of the target."""
MIN_SLOPE = 0.15
"""Minimum increase of the lung's density towards one side, HU per mm, at which the patient's pose is known."""
EVERY = 4
THIN_MM = 2.5
"""Slice distance in mm above which few forks are found, as a message explains."""
LUNG_HU = (-960, -600)
"""Minimum and maximum HU of lung in the checks of the patient's pose and of the CT's extent."""
MIN_LUNG_VOXELS, MIN_LUNG_ML = 5000, 300.0
"""Least number of lung voxels (every fourth on each axis) for the check of the pose; least volume of lungs in ml."""
SAME_BREATH_MM = 1.0
"""Distance in mm from a rigid motion, of 90 % of the points, up to which the breath counts as the same in both CTs."""
SIMILAR_BREATH_MM = 2.5
"""Distance in mm from a rigid motion, of 90 % of the points, up to which a note calls the breaths similar."""
CUT_SHARE, CUT_TIMES = 0.1, 2.0
"""Minimum share of lung in an end slice that cuts the lungs; minimum ratio of this share to that of the first CT."""


def check_other_ct(first: Volume, second: Volume) -> None:
    """Raise an error if the second CT is the first one."""
    if first.shape_zyx == second.shape_zyx and np.array_equal(first.hu_zyx, second.hu_zyx):
        raise NoResultError(
            "the second CT is the CT of this plan, in which nothing has moved. Choose another CT of the patient, such "
            "as one in expiration or an earlier one",
            code="movement.same-ct",
        )


def check_breath(breath_mm: float, slice_mm: float) -> None:
    """Raise an error if all places follow one rigid motion, so that the CTs show no movement by breathing.

    Parameters
    ----------
    breath_mm
        Distance within which 90 % of the matched places lie from one rigid motion, mm.
    slice_mm
        Largest voxel size of both CTs, mm.
    """
    if breath_mm < max(SAME_BREATH_MM, 0.5 * slice_mm):
        raise NoResultError(
            f"both CTs show the same breath: forks and vessels move by only {breath_mm:.1f} mm against each other. "
            "How far breathing moves the target cannot be measured from them. Choose a CT in another breath, such as "
            "one in expiration",
            code="movement.same-breath",
        )


def breath_notes(breath_mm: float) -> list[str]:
    """Return the note that both CTs show a similar breath; an empty list if the breaths differ."""
    if breath_mm >= SIMILAR_BREATH_MM:
        return []
    return [
        f"both CTs show a similar breath (forks and vessels move by {breath_mm:.1f} mm against each other); in the "
        "procedure the target may move more than between these CTs"
    ]


def cut_lungs_error(trouble: NoResultError, first: Volume, second: Volume) -> NoResultError | None:
    """Return an error for a second CT that cuts through the lungs, if the cut explains ``trouble``; else None.

    Cut lungs do not explain an error that reports another pose of the patient.
    """
    side = None if trouble.code == "movement.pose" else cut_side(first, second)
    if side is None:
        return None
    return NoResultError(
        f"the second CT shows only a part of the chest: its {side} end cuts through the lungs. Choose a CT of the "
        "whole chest",
        code="movement.half-chest",
    )


def cut_side(first: Volume, second: Volume) -> str | None:
    """Return the end (*upper* or *lower*) at which the second CT cuts off more lung than the first; None if neither."""
    here, there = lung_shares(first), lung_shares(second)
    cut = {side: share for side, share in there.items() if share >= max(CUT_SHARE, CUT_TIMES * here[side])}
    return max(cut, key=lambda side: cut[side]) if cut else None


def lung_shares(volume: Volume) -> dict[str, float]:
    """Return the share of lung in the lowest and in the uppermost slice of a CT."""
    ends = (0, -1) if volume.lps_from_ijk[2, 2] > 0.0 else (-1, 0)
    found: dict[str, float] = {}
    for side, index in zip(("lower", "upper"), ends, strict=True):
        face = volume.hu_zyx[index]
        found[side] = float(((face > LUNG_HU[0]) & (face < LUNG_HU[1])).mean())
    return found


def few_forks(num: int, second: Volume) -> NoResultError:
    """Return the error for trees of two CTs that have too few forks with the same names."""
    forks = "1 fork has" if num == 1 else f"{num} forks have"
    slice_mm = max(second.spacing_mm)
    thick = f"; the slices of the second CT are {slice_mm:.1f} mm apart" if slice_mm > THIN_MM else ""
    return NoResultError(
        f"only {forks} the same name in both CTs; at least {MIN_FORKS} are needed{thick}. Choose a thin-slice CT of "
        "the whole chest, or correct the airways of both CTs in their cases",
        code="movement.few-forks",
    )


def no_airways(second: Volume) -> NoResultError:
    """Return the error for a second CT in which no airways were found."""
    voxel_ml = float(np.prod(second.spacing_mm)) * EVERY**3 / 1000.0
    if second.is_hu and voxel_ml * float(_lung(second).sum()) < MIN_LUNG_ML:
        words = "the second CT shows no lungs; it may show another part of the body. Choose a CT of the whole chest"
    else:
        unit = "" if second.is_hu else "; its values are not in Hounsfield units"
        words = (
            f"no airways were found in the second CT{unit}. Choose a CT of the whole chest, or open it as a case, mark "
            "the trachea there, save the case and choose the case"
        )
    return NoResultError(words, code="movement.no-airways")


def _lung(volume: Volume) -> Mask:
    """Return the mask of lung in every fourth voxel of a CT; it may include foam of the table and gas in the bowel."""
    values = volume.hu_zyx[::EVERY, ::EVERY, ::EVERY]
    return np.asarray((values > LUNG_HU[0]) & (values < LUNG_HU[1]))


def check_motion(rigid: Affine, fits: Mask) -> None:
    """Raise an error if the forks do not follow one rigid motion, or if the motion rotates the patient."""
    turn = rotation_deg(rigid)
    if turn > MAX_TURN_DEG and fits.sum() >= MIN_RIGID:
        raise NoResultError(
            f"the airways of the second CT are rotated by {turn:.0f} degrees (at most {MAX_TURN_DEG:.0f} expected): "
            "the patient lies in another pose, such as prone, or the orientation in its file is wrong. Choose a CT in "
            "the pose of the procedure, and check its orientation letters",
            code="movement.pose",
        )
    if fits.mean() < MIN_RIGID_SHARE:
        raise _other_patient(
            f"only {int(fits.sum())} of {len(fits)} forks of the airways fit to one motion "
            f"(at least {100 * MIN_RIGID_SHARE:.0f} % expected)"
        )


def check_affine(motion: Affine, off_mm: Points) -> None:
    """Raise an error if the forks do not follow one affine motion, or if the motion stretches the chest too much."""
    median = float(np.median(off_mm))
    stretch = np.linalg.svd(motion.matrix)[1]
    if median > MAX_MEDIAN_MM:
        raise _other_patient(
            f"the forks of the airways are {median:.1f} mm (median) from the best fit "
            f"(less than {MAX_MEDIAN_MM:.0f} mm expected)"
        )
    if stretch.min() < STRETCH[0] or stretch.max() > STRETCH[1]:
        raise _other_patient(
            f"its airways are {stretch.min():.1f} to {stretch.max():.1f} times as large ({STRETCH[0]} to {STRETCH[1]} "
            "expected)"
        )


def check_forks(names: tuple[str, ...], fits: Mask, second: Volume) -> None:
    """Raise an error if too few named forks fit to the motion."""
    if fits.sum() < MIN_FORKS:
        raise few_forks(int(fits.sum()), second)
    if fits.mean() < MIN_RIGID_SHARE:
        raise _other_patient(
            f"only {int(fits.sum())} of {len(names)} forks of the airways fit "
            f"(at least {100 * MIN_RIGID_SHARE:.0f} % expected)"
        )


def check_extent(first: Volume, second: Volume, motion: Affine, forks: Points) -> None:
    """Raise an error if the second CT lacks a part of the airways of the first CT."""
    share = float(_inside(second, forks + motion.shifts(forks)).mean()) if len(forks) else 1.0
    if share < MIN_INSIDE and _inside(first, forks).mean() > share:
        raise NoResultError(
            f"the second CT shows only {100 * share:.0f} % of the airways' forks of this CT "
            f"(at least {100 * MIN_INSIDE:.0f} % expected). Choose a CT of the whole chest",
            code="movement.half-chest",
        )


def check_size(second: Volume, forks: Points) -> None:
    """Raise an error if the second CT is smaller than the airways of the first CT."""
    if not len(forks):
        return
    corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) * (
        np.array(second.shape_zyx[::-1]) - 1.0
    )
    sizes = np.ptp(corners @ second.lps_from_ijk[:3, :3].T, axis=0)
    needed = MIN_SIZE * np.ptp(forks, axis=0)
    for axis, what in enumerate(("wide", "deep", "high")):
        if sizes[axis] < needed[axis]:
            raise NoResultError(
                f"the second CT is only {sizes[axis]:.0f} mm {what}; the airways of this CT need {needed[axis]:.0f} "
                "mm. Choose a CT of the whole chest",
                code="movement.half-chest",
            )


def check_inside(second: Volume, place: Points, radius_mm: float) -> None:
    """Raise an error if a target is not inside the second CT."""
    rim = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * (radius_mm / np.sqrt(3.0) + 2.0)
    if not _inside(second, place + rim).all():
        raise NoResultError(
            "the second CT ends before the target. Choose a CT that includes the target", code="movement.outside"
        )


def check_gravity(first: Volume, second: Volume) -> None:
    """Raise an error if the denser side of the lungs is the back in one CT and the front in the other.

    Gravity makes the lower side denser, so the patient's pose differs. Without a clear difference in density the pose
    is not known and no error is raised.
    """
    here, there = density_slope(first), density_slope(second)
    if here is None or there is None:
        return
    if here * there < 0.0 and min(abs(here), abs(there)) >= MIN_SLOPE:
        prone = "second" if there < 0.0 else "first"
        raise NoResultError(
            f"in the {prone} CT the front of the lungs is denser than the back: the patient lies prone there but not "
            "in the other CT. Choose a CT in the pose of the procedure",
            code="movement.pose",
        )


def density_slope(volume: Volume) -> float | None:
    """Return the increase of the lung's density from front to back, HU per mm; None for too little lung.

    The slope is fitted to the median density of thin layers.
    """
    values = volume.hu_zyx[::EVERY, ::EVERY, ::EVERY]
    z, y, x = np.nonzero(_lung(volume))
    if len(z) < MIN_LUNG_VOXELS:
        return None
    row = volume.lps_from_ijk[1]
    height = EVERY * (row[0] * x + row[1] * y + row[2] * z) + row[3]
    density = values[z, y, x].astype(np.float64)
    low, high = np.quantile(height, (0.05, 0.95))
    edges = np.linspace(low, high, 13)
    layer = np.searchsorted(edges, height, side="right")
    medians, middles = [], []
    for number in range(1, 13):
        own = density[layer == number]
        if len(own) >= 200:
            medians.append(float(np.median(own)))
            middles.append(0.5 * (edges[number - 1] + edges[number]))
    if len(medians) < 6:
        return None
    return float(np.polyfit(middles, medians, 1)[0])


def check_structure(score: Points, least: float) -> None:
    """Raise an error if the surroundings of too few named forks were found in the second CT."""
    share = float((score >= least).mean())
    if share < MIN_FORKS_FOUND:
        raise _other_patient(
            f"the surroundings of only {100 * share:.0f} % of the named forks were found in the second CT "
            f"(at least {100 * MIN_FORKS_FOUND:.0f} % expected)"
        )


def check_places(places: Points, target: Points) -> None:
    """Raise an error if too few vessels and forks near the target were found in the second CT."""
    num = int((np.linalg.norm(places - target, axis=1) <= NEAR_MM).sum())
    if num < MIN_NEAR:
        raise NoResultError(
            f"only {num} vessels and forks within {NEAR_MM:.0f} mm of the target were found in the second CT (at least "
            f"{MIN_NEAR} expected), so that the movement there is not known. Choose a CT with thinner slices or less "
            "motion",
            code="movement.too-uncertain",
        )


def _other_patient(why: str) -> NoResultError:
    return NoResultError(
        f"the second CT does not seem to show the same patient: {why}. Choose another CT, or check the airways "
        "of both CTs",
        code="movement.other-patient",
    )


def _inside(volume: Volume, places: Points) -> Mask:
    ijk = places @ volume.ijk_from_lps[:3, :3].T + volume.ijk_from_lps[:3, 3]
    top = np.array(volume.shape_zyx[::-1]) - 1.0
    return np.asarray(((ijk >= 0.0) & (ijk <= top)).all(axis=1))
