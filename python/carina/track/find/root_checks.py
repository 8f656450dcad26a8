"""Checks that the root of a grown tree is the top of the trachea."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carina.errors import NoResultError
from carina.track.intensity_levels import AirScale, air_scale
from carina.track.paths.tracker import as_point, words
from carina.track.tree.airway_tree import Branch
from carina.volume.model import Volume

# Range of values of lung from inspiration to expiration, partly with emphysema; there must be lung on both sides of the
# trachea's division.
LUNG_HU = (-950.0, -600.0)
# Rise in mm, before a fall by as much, from which a path counts as going up first.
UP_FIRST_MM = 10.0
# Length in mm above its division from which a tube is surely the trachea; the left main bronchus has 40 to 55 mm.
SURE_TRACHEA_MM = 60.0
# Distance in mm from the middle between the lungs within which the end of a branch belongs to neither side.
MIDDLE_MM = 10.0
# Minimum share of the lateral ends of branches on the side with fewer ends.
MIN_SIDE = 0.05
# Side length in mm of the blocks on which lung is distinguished from air outside the body.
BLOCK_MM = 4.0
# Highest standard deviation in HU in a block of lung; the blurred edge between air and skin has more.
EVEN_HU = 150.0
# Minimum volume in mm3 of lung; a smaller volume is mastoid air cells or bowel.
MIN_LUNG_MM3 = 40_000.0


def refuse_a_root_below_the_carina(volume: Volume, branches: tuple[Branch, ...]) -> None:
    """Raise an error if branches in the lung go up from the root: it is then in a bronchus, not the trachea.

    Branches in throat, nose and oesophagus above the root do not count: they end in soft tissue.

    Raises
    ------
    NoResultError
        If at least three tips in the lung are reached by going up first.
    """
    root_z = float(branches[0].points[0][2])
    upward: list[bool | None] = []
    tips = []
    for branch in branches:
        first = None if branch.parent is None else upward[branch.parent]
        if first is None:
            rise = branch.points[:, 2] - root_z
            off = np.flatnonzero(np.abs(rise) > UP_FIRST_MM)
            first = bool(rise[off[0]] > 0.0) if len(off) else None
        upward.append(first)
        if first and not branch.children:
            tips.append(branch.points[-1])
    scale = air_scale(volume) if tips else None
    num_in_lung = sum(scale is not None and _is_in_lung(volume, tip, scale) for tip in tips)
    if num_in_lung >= 3:
        msg = (
            f"no trachea was found: the airway at {words(as_point(branches[0].points[0]))} continues upwards into "
            "the lung, so it is probably a more distal bronchus; mark a point in the trachea"
        )
        raise NoResultError(msg)


def refuse_a_root_of_one_lung(volume: Volume, branches: tuple[Branch, ...], trachea_mm: float) -> None:
    """Raise an error if a root divides in two but leads into one lung only: it is a bronchus, not the trachea.

    A main or lower bronchus divides as the trachea does and has lung on both sides, but its branches stay on one
    side of the middle between the lungs. A tube longer than any bronchus is accepted as the trachea without this
    check, because a lung may be missing.

    Parameters
    ----------
    volume
        The CT.
    branches
        The tree grown from the root.
    trachea_mm
        Length of the tube above its division.

    Raises
    ------
    NoResultError
        If nearly all ends are on one side.
    """
    if trachea_mm >= SURE_TRACHEA_MM:
        return
    middle = _middle_between_the_lungs(volume)
    if middle is None:
        return
    ends = np.array([branch.points[-1][0] for branch in branches if not branch.children])
    # In LPS, +x is the patient's left.
    right, left = int((ends < middle - MIDDLE_MM).sum()), int((ends > middle + MIDDLE_MM).sum())
    if min(right, left) <= MIN_SIDE * (right + left):
        side = "right" if right > left else "left"
        place = words(as_point(branches[0].points[0]))
        msg = (
            f"no trachea was found: the airway at {place} forks but leads into the {side} lung only, so it is "
            "probably a main bronchus or a more distal one. The scan may be cropped below the carina: open one that "
            "includes the trachea, or mark the point in the airway where paths should start"
        )
        raise NoResultError(msg)


def _middle_between_the_lungs(volume: Volume) -> float | None:
    """Return the LPS x coordinate half-way between the outer parts of the lungs; None if there is no lung."""
    size = np.maximum(np.rint(BLOCK_MM / np.array(volume.spacing_mm)), 1).astype(int)
    counts = np.array(volume.shape_zyx[::-1]) // size
    if not counts.all():
        return None
    scale = air_scale(volume)
    low, high = scale.level(LUNG_HU[0]), scale.level(LUNG_HU[1])
    (ni, nj, nk), (si, sj, sk) = counts.tolist(), size.tolist()
    found: list[NDArray[np.float64]] = []
    for k in range(nk):
        slab = volume.hu_zyx[k * sk : (k + 1) * sk, : nj * sj, : ni * si]
        means = slab.reshape(sk, nj, sj, ni, si).mean(axis=(0, 2, 4))
        j, i = np.nonzero((means >= low) & (means <= high))
        ijk = np.stack([i, j, np.full(len(i), k)], axis=1) * size + 0.5 * (size - 1)
        found.append(volume.to_lps(ijk)[:, 0])
    x = np.concatenate(found)
    return float(np.quantile(x, [0.1, 0.9]).mean()) if len(x) else None


def has_lung(volume: Volume, scale: AirScale) -> bool:
    """Return whether a CT shows lung: enough uniformly dark tissue, without the edges between air and tissue."""
    size = np.maximum(np.rint(BLOCK_MM / np.array(volume.spacing_mm)), 1).astype(int)
    counts = np.array(volume.shape_zyx[::-1]) // size
    low, high = scale.level(LUNG_HU[0]), scale.level(LUNG_HU[1])
    (ni, nj, nk), (si, sj, sk) = counts.tolist(), size.tolist()
    block_mm3 = float(np.prod(np.array(volume.spacing_mm) * size))
    found = 0
    for k in range(nk):
        slab = volume.hu_zyx[k * sk : (k + 1) * sk, : nj * sj, : ni * si].astype(np.float32)
        blocks = slab.reshape(sk, nj, sj, ni, si)
        means = blocks.mean(axis=(0, 2, 4))
        is_even = blocks.std(axis=(0, 2, 4)) <= scale.span(EVEN_HU)
        found += int(((means >= low) & (means <= high) & is_even).sum())
    return found * block_mm3 >= MIN_LUNG_MM3


def _is_in_lung(volume: Volume, point: NDArray[np.float64], scale: AirScale) -> bool:
    """Return whether more than half of the voxels within 8 mm of a point (LPS, mm) have values of lung."""
    centre = volume.to_ijk(point)
    reach = np.ceil(8.0 / np.array(volume.spacing_mm))
    shape = np.array(volume.shape_zyx[::-1])
    low = np.clip(np.floor(centre - reach), 0, shape - 1).astype(int)
    high = np.clip(np.ceil(centre + reach), 0, shape - 1).astype(int)
    block = volume.hu_zyx[low[2] : high[2] + 1, low[1] : high[1] + 1, low[0] : high[0] + 1]
    return bool(((block >= scale.level(LUNG_HU[0])) & (block <= scale.level(LUNG_HU[1]))).mean() > 0.5)
