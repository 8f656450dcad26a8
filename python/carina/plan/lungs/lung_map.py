"""Map of the structures in both lungs: vessels, fissures and lobes, as masks for display over slices."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from carina.display import one_line
from carina.display.progress import ProgressChoice, fraction_callback, progress_function, shows_progress
from carina.errors import CancelledError, CarinaError
from carina.plan.cubic_box import Box, smoothed
from carina.plan.lungs.fissures import FissureBox
from carina.plan.lungs.lobes import LOBE_NAMES, Lobes, lobes
from carina.plan.lungs.tissue_near_needle import NearbyTissue, lung_box, lung_surroundings
from carina.plan.lungs.vessels import VesselBranch, VesselTree, grow_tree
from carina.scopes import WallField
from carina.track import Airways, AirwayTree
from carina.volume import Volume
from carina.volume.mask_distances import ball_distance

Mask = NDArray[np.bool_]

SURE = 0.8
"""Mean confidence below which a part of a vessel is displayed as doubtful, 0 to 1."""
RIM_MM = 3.0
"""Width in mm of the outer layer of the lungs in which no vessels are searched, because it may be chest wall."""
LUNG_HU = 250.0
"""Maximum density of a voxel of lung, in HU above the median density of the lungs."""
ROUND_MM, MIN_LUNG = 5.0, 0.35
"""Width in mm of the Gaussian that averages the share of lung round a vessel, and least share of lung.

The share is one half beside the pleura and one fifth between trachea and spine. The limit removes folds of the
mediastinum, which look like vessels.
"""
AIRWAY_GENERATIONS = 2
"""Maximum generation of airways whose air is excluded from the lung; airways beyond it are too thin to matter."""
DEEP_MM, MIN_DEEP = 6.0, 0.25
"""Depth in mm below the lungs' surface, and minimum share of a vessel's centreline at this depth or deeper.

Breathing between slices causes steps along the surface that look like vessels.
"""
NEAR_MM = 3.0
"""Maximum distance in mm between a lobe border and a fissure that lies on this border."""
STRETCH_MM = 1.5
"""Width in mm of the Gaussian that averages the confidence of the voxels along a vessel."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class MappedMask:
    """Mask of one structure on a grid of cubic voxels along LPS."""

    inside_zyx: Mask
    first_lps: tuple[float, float, float]
    """Centre of the first voxel of the mask, LPS mm."""
    spacing_mm: float

    @classmethod
    def placed(cls, inside_zyx: Mask, lps_from_ijk: NDArray[np.float64]) -> MappedMask:
        """Return a mask as a `MappedMask` on the grid of a (4, 4) transform."""
        x, y, z = (float(v) for v in lps_from_ijk[:3, 3])
        return cls(inside_zyx, (x, y, z), float(lps_from_ijk[0, 0]))

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """Return ``inside_zyx`` for ``numpy.asarray``; the array is copied only for another type or on request."""
        return np.array(self.inside_zyx, dtype=dtype, copy=copy)

    @property
    def lps_from_ijk(self) -> NDArray[np.float64]:
        """(4, 4) transform from voxel indices to LPS mm."""
        place = np.diag([self.spacing_mm] * 3 + [1.0])
        place[:3, 3] = self.first_lps
        return place

    @property
    def ml(self) -> float:
        """Volume of the structure in ml."""
        return float(np.count_nonzero(self.inside_zyx)) * self.spacing_mm**3 / 1000.0


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class LungMap:
    """Vessels, fissures and lobes of both lungs; None for a structure that is not found yet or could not be found.

    Vessels of the mediastinum and the hila are not included, because a CT without contrast does not show them.
    """

    vessels: MappedMask | None = None
    """Vessels at 1 mm; arteries and veins are not distinguished, and vessels thinner than about 1 mm are incomplete."""
    sure_vessels: MappedMask | None = None
    """Voxels of the vessels whose mean confidence is at least `SURE`."""
    vessel_tree: VesselTree | None = None
    """Vessels as lines with radii, without those along the edge of the lungs."""
    fissures: MappedMask | None = None
    """Visible fissures as plates at 1 mm; empty if none is visible."""
    fissure_shares: tuple[float | None, float | None] | None = None
    """Share of the estimated lobe borders on a visible fissure, for the right and the left lung.

    None for a lung without a border: it is one lobe, or it is outside the CT.
    """
    lobes: tuple[tuple[str, MappedMask], ...] = ()
    """Name and mask (2 mm grid) of each lobe; where no fissure is visible, the borders follow from the airways."""
    missing_lobes: tuple[str, ...] = ()
    """Names of the lobes without a bronchus in the tree; their volume is labelled as that of their neighbours."""
    problems: tuple[str, ...] = ()
    """Messages for the user about structures that could not be found."""


@shows_progress
def map_lungs(
    volume: Volume,
    airways: Airways,
    wall: WallField,
    *,
    progress: ProgressChoice = None,
    found: Callable[[LungMap], None] | None = None,
) -> LungMap:
    """Find the vessels, then their tree, then lobes and fissures; a failure for the lobes is stored in ``problems``.

    Parameters
    ----------
    volume, airways, wall
        The CT, its airways and their wall.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is None while the progress is unknown. The function may raise CancelledError to stop
        the calculation.
    found
        Called with each partial map while the rest is being computed.

    Returns
    -------
    LungMap
        Masks and vessel tree.

    Raises
    ------
    NoResultError
        If there is no lung in the CT (``plan.no_lung``).
    CancelledError
        If ``progress`` raised it.
    """
    report = progress_function(progress)

    def say(what: str, share: float) -> None:
        if report is not None:
            report(what, share)

    say("finding the lungs", 0.0)
    box = lung_box(volume)
    looking = "looking for vessels"
    say(looking, 0.05)
    seen = lung_surroundings(volume, wall, box=box, progress=lambda what, share: say(what, 0.05 + 0.4 * (share or 0.0)))
    say(looking, 0.45)
    inside = seen.vessel & _within(seen.box.known, round(RIM_MM / seen.box.step_mm)) & _amid_lung(seen, airways.tree)
    made = LungMap(_cropped(inside, seen.box), _cropped(_standing_out(inside, seen), seen.box))
    say(looking, 0.48)
    if found is not None:
        found(made)
    on_progress = fraction_callback(report, "following the vessels", 0.48, 0.55)
    tree = grow_tree(seen.box, inside, seen.sure, on_progress=on_progress)
    made = replace(made, vessel_tree=_deep_lines(tree, seen.box))
    if found is not None:
        found(made)
    try:
        segmented = lobes(
            volume,
            airways.tree,
            box=box,
            progress=lambda what, share: say(what, 0.55 + 0.45 * (share or 0.0)),
        )
    except CancelledError:
        raise
    except CarinaError as error:
        return replace(made, problems=(str(error),))
    return _with_lobes(made, segmented)


def _within(known: Mask, num_voxels: int) -> Mask:
    """Erode a mask by ``num_voxels`` voxels across faces."""
    inner = np.pad(known, 1)
    for _ in range(num_voxels):
        less = inner.copy()
        for axis in range(3):
            for shift in (-1, 1):
                less &= np.roll(inner, shift, axis=axis)
        inner = less
    return inner[1:-1, 1:-1, 1:-1]


def _amid_lung(seen: NearbyTissue, tree: AirwayTree) -> Mask:
    """Return the mask of the vessel voxels surrounded by lung rather than by mediastinum or chest wall."""
    lung = seen.box.known & (seen.box.hu_zyx < seen.lung_hu + LUNG_HU)
    step_mm, first = seen.box.step_mm, seen.box.lps_from_ijk[:3, 3]
    for branch in tree.branches:
        if branch.generation > AIRWAY_GENERATIONS:
            continue
        for point, radius_mm in zip(branch.points, branch.radius, strict=True):
            at, far = (point - first) / step_mm, (radius_mm + RIM_MM / 2.0) / step_mm
            low = np.maximum(np.ceil(at - far).astype(int), 0)
            high = np.minimum(np.floor(at + far).astype(int) + 1, lung.shape[::-1])
            if (low >= high).any():
                continue
            x, y, z = ((np.arange(a, b) - k) ** 2.0 for a, b, k in zip(low, high, at, strict=True))
            part = tuple(slice(a, b) for a, b in zip(low[::-1], high[::-1], strict=True))
            lung[part] &= z[:, None, None] + y[None, :, None] + x[None, None, :] > far * far
    share = smoothed(lung[::2, ::2, ::2].astype(np.float32), 0.5 * ROUND_MM / step_mm)
    amid = share >= MIN_LUNG
    for axis, num in enumerate(lung.shape):
        amid = amid.repeat(2, axis=axis).take(np.arange(num), axis=axis)
    return amid


def _deep_lines(tree: VesselTree, box: Box) -> VesselTree:
    """Return a vessel tree with only the branches that are deep enough in the lungs.

    An orphaned branch becomes a root.
    """
    deep = _within(box.known, round(DEEP_MM / box.step_mm))
    places: dict[int, int] = {}
    remaining: list[VesselBranch] = []
    for number, branch in enumerate(tree.branches):
        i, j, k = np.rint((branch.points_lps - box.lps_from_ijk[:3, 3]) / box.step_mm).astype(np.intp).T
        if float(deep[k, j, i].mean()) < MIN_DEEP:
            continue
        places[number] = len(remaining)
        parent = None if branch.parent is None else places.get(branch.parent)
        remaining.append(replace(branch, parent=parent))
    return replace(tree, branches=tuple(remaining))


def _standing_out(inside: Mask, seen: NearbyTissue) -> Mask:
    """Return the mask of the vessel voxels whose confidence, averaged along the vessel, is at least `SURE`."""
    sigma = STRETCH_MM / seen.box.step_mm
    weight = smoothed(inside.astype(np.float32), sigma)
    mean = smoothed(np.where(inside, seen.sure, 0.0).astype(np.float32), sigma)
    found: Mask = inside & (mean >= SURE * weight)
    return found


def _with_lobes(made: LungMap, segmented: Lobes) -> LungMap:
    named = [(name, segmented.label_zyx == number) for number, name in enumerate(LOBE_NAMES, 1)]
    return replace(
        made,
        fissures=None if segmented.fissure is None else _cropped(segmented.fissure.mask, segmented.fissure.box),
        fissure_shares=None if segmented.fissure is None else _seen_shares(segmented, segmented.fissure),
        lobes=tuple((name, MappedMask.placed(mask, segmented.lps_from_ijk)) for name, mask in named if mask.any()),
        missing_lobes=segmented.missing,
    )


def _seen_shares(segmented: Lobes, fissure: FissureBox) -> tuple[float | None, float | None]:
    step_mm = float(segmented.lps_from_ijk[0, 0])
    first = fissure.box.lps_from_ijk[:3, 3] - segmented.lps_from_ijk[:3, 3]
    seen = np.zeros(segmented.label_zyx.shape, dtype=bool)
    places = np.rint((np.argwhere(fissure.mask)[:, ::-1] * fissure.box.step_mm + first) / step_mm).astype(np.intp)
    i, j, k = places[((places >= 0) & (places < seen.shape[::-1])).all(axis=1)].T
    seen[k, j, i] = True
    near = ball_distance(~seen, step_mm) + 0.5 * step_mm <= NEAR_MM if seen.any() else seen
    border = (segmented.label_zyx > 0) & (segmented.border_mm < step_mm)
    right = np.isin(segmented.label_zyx, [n for n, name in enumerate(LOBE_NAMES, 1) if name.startswith("R")])

    def share(of: Mask) -> float | None:
        return float(near[of].mean()) if of.any() else None

    return share(border & right), share(border & ~right)


def _cropped(mask: Mask, box: Box) -> MappedMask:
    """Return a mask on the grid of a box as a `MappedMask`, cropped to the structure."""
    return MappedMask.placed(mask, np.array(box.lps_from_ijk, dtype=np.float64))
