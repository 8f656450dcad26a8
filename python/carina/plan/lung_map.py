"""What lies round every target at once: vessels, fissures and lobes of both lungs, made to be drawn over slices."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from carina.display import one_line
from carina.display.progress import ProgressChoice, progress_function, share_function, shows_progress
from carina.errors import CancelledError, CarinaError
from carina.plan.box import Box, ball_distance, smoothed
from carina.plan.fissures import FissureBox
from carina.plan.lobes import LOBE_NAMES, Lobes, lobes
from carina.plan.surroundings import Surroundings, lung_box, lung_surroundings
from carina.plan.vessels import VesselBranch, VesselTree, grow_tree
from carina.scopes import WallField
from carina.track import Airways, AirwayTree
from carina.volume import Volume

__all__ = ["LungMap", "MappedMask", "map_lungs"]

Mask = NDArray[np.bool_]

SURE = 0.8
"""A stretch of vessel that is on average less sure is drawn as doubtful: 1.3 times the least curvature."""
RIM_MM = 3.0
"""The lungs are closed over the vessels that leave them, and reach into the chest wall: its rim looks like vessels."""
LUNG_HU = 250.0
"""Above the lungs' median: what is darker is lung."""
ROUND_MM, LEAST_LUNG = 5.0, 0.35
"""A vessel of the lungs has lung round it, by a Gaussian: half beside the pleura, a fifth between trachea and spine.
The lungs are closed over the hila and round the trachea, and folds of the mediastinum there look like vessels."""
AIRWAY_GENERATIONS = 2
"""Air in airways up to here is no lung; those farther out are too thin to matter."""
DEEP_MM, LEAST_DEEP = 6.0, 0.25
"""A line of which less lies so deep runs along the edge of the lungs, where slices shifted by breathing make steps."""
NEAR_MM = 3.0
"""A border so near to a fissure that is seen lies on it: the lobes are told on a grid of 2 mm."""
STRETCH_MM = 1.5
"""Of the Gaussian over which that mean is taken: single voxels would make a line flicker between sure and doubtful."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class MappedMask:
    """One structure on a grid of cubic voxels along LPS."""

    inside_zyx: Mask
    first_lps: tuple[float, float, float]
    """The middle of its first voxel."""
    spacing_mm: float

    @classmethod
    def placed(cls, inside_zyx: Mask, lps_from_ijk: NDArray[np.float64]) -> MappedMask:
        """From the place of such a grid, (4, 4)."""
        x, y, z = (float(v) for v in lps_from_ijk[:3, 3])
        return cls(inside_zyx, (x, y, z), float(lps_from_ijk[0, 0]))

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """Return ``inside_zyx`` for ``numpy.asarray``; the array is copied only for another type or on request."""
        return np.array(self.inside_zyx, dtype=dtype, copy=copy)

    @property
    def lps_from_ijk(self) -> NDArray[np.float64]:
        """(4, 4)."""
        place = np.diag([self.spacing_mm] * 3 + [1.0])
        place[:3, 3] = self.first_lps
        return place

    @property
    def ml(self) -> float:
        """Its volume."""
        return float(np.count_nonzero(self.inside_zyx)) * self.spacing_mm**3 / 1000.0


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class LungMap:
    """Vessels, fissures and lobes of both lungs; None where one is still to be looked for, or could not be told.

    Vessels of the mediastinum and the hila are no part of it: without contrast a CT does not show them.
    """

    vessels: MappedMask | None = None
    """At 1 mm: arteries and veins are not told apart, and those thinner than about 1 mm are seen in part."""
    sure_vessels: MappedMask | None = None
    """The stretches of them that stand out well."""
    vessel_tree: VesselTree | None = None
    """The same vessels as lines with radii; those that run along the edge of the lungs are left out."""
    fissures: MappedMask | None = None
    """Plates at 1 mm, as far as they are seen; empty where none is."""
    fissure_shares: tuple[float | None, float | None] | None = None
    """Of the estimated borders of lobes, right and left, the share that lies on a fissure that is seen.

    None for a side without a border: its lung is one lobe, or is not in the CT.
    """
    lobes: tuple[tuple[str, MappedMask], ...] = ()
    """By name, at 2 mm. Where no fissure is seen their borders follow from the airways."""
    missing_lobes: tuple[str, ...] = ()
    """No bronchus of them is on the tree: their room is told as their neighbours'."""
    problems: tuple[str, ...] = ()
    """Why something could not be told."""


@shows_progress
def map_lungs(
    volume: Volume,
    airways: Airways,
    wall: WallField,
    *,
    progress: ProgressChoice = None,
    found: Callable[[LungMap], None] | None = None,
) -> LungMap:
    """Vessels first, then the tree that they form, then lobes and fissures; what fails is told and the rest is there.

    Parameters
    ----------
    volume, airways, wall
        The CT, its airways and their wall.
    progress
        False, True or ``f(what, fraction)``. True, as None, shows a bar in a terminal or a notebook. The fraction is
        None where it is unknown. It may raise CancelledError.
    found
        Given what is made so far, while the rest is still being looked for.

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
    on_share = share_function(report, "following the vessels", 0.48, 0.55)
    tree = grow_tree(seen.box, inside, seen.sure, on_share=on_share)
    made = replace(made, vessel_tree=_deep_lines(tree, seen.box))
    if found is not None:
        found(made)
    try:
        told = lobes(
            volume,
            airways.tree,
            box=box,
            progress=lambda what, share: say(what, 0.55 + 0.45 * (share or 0.0)),
        )
    except CancelledError:
        raise
    except CarinaError as trouble:
        return replace(made, problems=(str(trouble),))
    return _with_lobes(made, told)


def _within(known: Mask, num_voxels: int) -> Mask:
    """Without the outermost voxels, counted by faces."""
    inner = np.pad(known, 1)
    for _ in range(num_voxels):
        less = inner.copy()
        for axis in range(3):
            for shift in (-1, 1):
                less &= np.roll(inner, shift, axis=axis)
        inner = less
    return inner[1:-1, 1:-1, 1:-1]


def _amid_lung(seen: Surroundings, tree: AirwayTree) -> Mask:
    """Where lung lies round, and not mediastinum or chest wall: of every second voxel, for those beside it too."""
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
    amid = share >= LEAST_LUNG
    for axis, num in enumerate(lung.shape):
        amid = amid.repeat(2, axis=axis).take(np.arange(num), axis=axis)
    return amid


def _deep_lines(tree: VesselTree, box: Box) -> VesselTree:
    """The branches that lie deep enough in the lungs; where one begins at another that does not, a piece begins."""
    deep = _within(box.known, round(DEEP_MM / box.step_mm))
    places: dict[int, int] = {}
    kept: list[VesselBranch] = []
    for number, branch in enumerate(tree.branches):
        i, j, k = np.rint((branch.points_lps - box.lps_from_ijk[:3, 3]) / box.step_mm).astype(np.intp).T
        if float(deep[k, j, i].mean()) < LEAST_DEEP:
            continue
        places[number] = len(kept)
        parent = None if branch.parent is None else places.get(branch.parent)
        kept.append(replace(branch, parent=parent))
    return replace(tree, branches=tuple(kept))


def _standing_out(inside: Mask, seen: Surroundings) -> Mask:
    """Where the mean over a stretch of the vessel is sure."""
    sigma = STRETCH_MM / seen.box.step_mm
    weight = smoothed(inside.astype(np.float32), sigma)
    mean = smoothed(np.where(inside, seen.sure, 0.0).astype(np.float32), sigma)
    found: Mask = inside & (mean >= SURE * weight)
    return found


def _with_lobes(made: LungMap, told: Lobes) -> LungMap:
    named = [(name, told.label_zyx == number) for number, name in enumerate(LOBE_NAMES, 1)]
    return replace(
        made,
        fissures=None if told.fissure is None else _cropped(told.fissure.mask, told.fissure.box),
        fissure_shares=None if told.fissure is None else _seen_shares(told, told.fissure),
        lobes=tuple((name, MappedMask.placed(mask, told.lps_from_ijk)) for name, mask in named if mask.any()),
        missing_lobes=told.missing,
    )


def _seen_shares(told: Lobes, fissure: FissureBox) -> tuple[float | None, float | None]:
    step_mm = float(told.lps_from_ijk[0, 0])
    first = fissure.box.lps_from_ijk[:3, 3] - told.lps_from_ijk[:3, 3]
    seen = np.zeros(told.label_zyx.shape, dtype=bool)
    places = np.rint((np.argwhere(fissure.mask)[:, ::-1] * fissure.box.step_mm + first) / step_mm).astype(np.intp)
    i, j, k = places[((places >= 0) & (places < seen.shape[::-1])).all(axis=1)].T
    seen[k, j, i] = True
    near = ball_distance(~seen, step_mm) + 0.5 * step_mm <= NEAR_MM if seen.any() else seen
    border = (told.label_zyx > 0) & (told.border_mm < step_mm)
    right = np.isin(told.label_zyx, [n for n, name in enumerate(LOBE_NAMES, 1) if name.startswith("R")])

    def share(of: Mask) -> float | None:
        return float(near[of].mean()) if of.any() else None

    return share(border & right), share(border & ~right)


def _cropped(mask: Mask, box: Box) -> MappedMask:
    """Without the box's values, which are large."""
    return MappedMask.placed(mask, np.array(box.lps_from_ijk, dtype=np.float64))
