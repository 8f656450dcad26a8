"""Regions of a CT that metal streaks or breathing motion disturb; small airways are not followed in these regions."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina._core import LumenTracker
from carina.track.find.breathing_step import find_steps
from carina.track.find.metal_streaks import find_streaks
from carina.track.intensity_levels import AirScale, air_scale
from carina.track.paths.path_grid import PathGrid
from carina.track.tree.airway_tree import AirwayTree
from carina.track.tree.uncertainty import FAINT, slice_from_feet
from carina.volume.model import Note, Volume

METAL = "track.metal"
"""Code of the permanent note (stored with the case and its exports) on metal streaks in the lungs."""
STEP = "track.breathing-step"
"""Code of the permanent note (stored with the case and its exports) on a movement of the chest between two slices."""

LUNG_HU = -860.0
"""Usual HU of lung; it replaces the values in metal streaks, so that the search follows no small airway there."""
IN_REGION = 0.5
"""Minimum share of a branch's points in a region with artefacts for which the branch counts as in the region."""
BESIDE_STEP_MM = 2.0
TISSUE_HU = 40.0
CERTAIN_AIR_HU = -940.0
MAX_DOUBTFUL = 0.3
"""Maximum share of branches with a confidence below 0.5; with a larger share, the search has leaked out of the
airways."""
SOME_IN_REGION = 0.2
MIN_BEYOND_MM = 10.0
"""Minimum length in mm beyond a region with artefacts that proves a branch with points in the region.

The limit applies to branches with more than ``SOME_IN_REGION`` of their points in the region; such branches must also
continue beyond the region by more than their length in the region.
"""
MAX_CONFIDENCE = 0.8
"""Maximum confidence of a branch in metal streaks or beside a breathing step."""


@dataclass(frozen=True, slots=True, eq=False)
class ArtefactRegions:
    """Regions of a CT whose values do not prove a small airway, and the grid of the search."""

    grid: PathGrid
    """Grid of the search: that of the CT, or a finer one."""
    streaks_zyx: NDArray[np.bool_] | None = None
    """Mask (nz, ny, nx) on the CT, True where metal streaks change the values; None if there are no streaks."""
    steps: tuple[int, ...] = ()
    """Slices k of the CT after which the chest has moved."""
    is_closed: bool = False
    """Whether streaks and steps are replaced by tissue in this search, because an earlier search leaked there."""

    def with_streaks_as_lung(self, volume: Volume, scale: AirScale) -> Volume:
        """Return a volume with uniform lung in place of the streaks; the given volume if there are no streaks."""
        if self.streaks_zyx is None:
            return volume
        values = volume.hu_zyx.copy()
        values[self._mask_in_grid(self.streaks_zyx)] = scale.level(LUNG_HU)
        return dataclasses.replace(volume, hu_zyx=values)

    def _mask_in_grid(self, ct_mask_zyx: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return a mask on the CT's grid converted to the grid of the search."""
        return self.grid.mask_in_parts(ct_mask_zyx.view(np.uint8)).view(np.bool_)

    def share_of(self, points_lps: NDArray[np.float64]) -> float:
        """Return the share of (n, 3) points (LPS, mm) that is in metal streaks or beside a step."""
        ct = self.grid.ct
        ijk = ct.to_ijk(points_lps)
        inside = np.zeros(len(ijk), np.bool_)
        if self.streaks_zyx is not None:
            i, j, k = np.clip(np.rint(ijk).astype(int), 0, np.array(ct.shape_zyx[::-1]) - 1).T
            inside |= self.streaks_zyx[k, j, i]
        for step in self.steps:
            inside |= np.abs(ijk[:, 2] - (step + 0.5)) <= BESIDE_STEP_MM / ct.spacing_mm[2] + 0.5
        return float(inside.mean())

    def closed(self, scale: AirScale) -> Volume:
        """Return the volume of the search grid with soft tissue in place of the streaks and, at steps, of all but air.

        At a step, the air of a bronchus touches lung. Air on both sides of a step belongs to the same wide airway and
        is kept.
        """
        ct = self.grid.ct
        excluded = np.zeros(ct.shape_zyx, np.bool_) if self.streaks_zyx is None else self.streaks_zyx.copy()
        for k in self.steps:
            is_air = np.all([_mean_of_9(ct.hu_zyx[n]) < scale.level(CERTAIN_AIR_HU) for n in (k, k + 1)], axis=0)
            excluded[k : k + 2][:, ~is_air] = True
        volume = self.grid.volume
        values = volume.hu_zyx.copy()
        values[self._mask_in_grid(excluded)] = scale.level(TISSUE_HU)
        return dataclasses.replace(volume, hu_zyx=values)

    def has_leaked(self, tree: AirwayTree) -> bool:
        """Return whether the search leaked through streaks or a step: too many branches are doubtful."""
        doubtful = [branch.confidence is not None and branch.confidence < FAINT for branch in tree.branches]
        is_changed = self.streaks_zyx is not None or bool(self.steps)
        return is_changed and sum(doubtful) > MAX_DOUBTFUL * len(doubtful)

    def remove_disturbed_ends(
        self, lumen: NDArray[np.uint8], core: LumenTracker, rows: Sequence[dict[str, Any]]
    ) -> float:
        """Remove from the lumen the branches that end in metal streaks or at a step; return their length in mm.

        An airway that passes through a disturbed part is visible again beyond it; a streak is not.

        Parameters
        ----------
        lumen
            (nz, ny, nx) on the grid, 1 inside; changed in place.
        core, rows
            Tracker of the lumen, and its branches.
        """
        if self.streaks_zyx is None and not self.steps:
            return 0.0
        length_mm, share, beyond_mm = (np.zeros(len(rows)) for _ in range(3))
        for number in range(len(rows) - 1, -1, -1):
            line = np.asarray(rows[number]["points"])
            length_mm[number] = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
            share[number] = self.share_of(line)
            beyond_mm[number] += (1.0 - share[number]) * length_mm[number]
            if number:
                beyond_mm[rows[number]["parent"]] += beyond_mm[number]
        excluded: list[int] = []
        for number in range(1, len(rows)):
            least_mm = max(MIN_BEYOND_MM, share[number] * length_mm[number])
            ends_there = share[number] >= SOME_IN_REGION and beyond_mm[number] < least_mm
            if ends_there or rows[number]["parent"] in excluded:
                excluded.append(number)
        if not excluded:
            return 0.0
        branch = core.branch_of_nodes([row["nodes"] for row in rows], [row["parent"] for row in rows])
        voxels = np.flatnonzero(lumen)[np.isin(branch, excluded)]
        lumen.reshape(-1)[voxels] = 0
        return float(length_mm[excluded].sum()) if len(voxels) else 0.0

    def with_limited_confidence(self, tree: AirwayTree) -> AirwayTree:
        """Return the tree with limited confidence of the branches in metal streaks or beside a step."""
        branches = tuple(
            dataclasses.replace(branch, confidence=MAX_CONFIDENCE)
            if branch.confidence is not None
            and branch.confidence > MAX_CONFIDENCE
            and self.share_of(branch.points) >= IN_REGION
            else branch
            for branch in tree.branches
        )
        return tree if branches == tree.branches else dataclasses.replace(tree, branches=branches)

    def notes(self, removed_mm: float) -> list[Note]:
        """Return the permanent notes on the regions with artefacts: slices, missing airways, advice."""
        ct = self.grid.ct
        notes = []
        if self.streaks_zyx is not None:
            used = np.flatnonzero(self.streaks_zyx.any(axis=(1, 2)))
            removed = (
                "" if removed_mm < 1.0 else f" {removed_mm:.0f} mm of airway that ended in the streaks were left out."
            )
            limits = (
                "no airway is followed through the streaks, and many airways are missing"
                if self.is_closed
                else "in the streaks only clearly open airways that continue beyond them are included, and small "
                "airways are missing"
            )
            words = (
                f"metal causes dark and bright streaks in {_slices(ct, int(used[0]), int(used[-1]))}, which look "
                f"like airways: {limits}.{removed} Check these slices, or open a reconstruction with metal artefact "
                "reduction"
            )
            notes.append(Note(METAL, words, badge=True))
        if self.steps:
            lost = (
                "only wide airways are followed beyond, because the search leaked there; many airways are missing"
                if self.is_closed
                else "small airways may be cut off or joined to others"
            )
            places = ", and between ".join(_slices(ct, k, k + 1, "and") for k in self.steps)
            words = (
                f"the chest moved during the scan, between {places}: airways are displaced there, and {lost}. "
                "Check the branches at these slices; repeat the scan in one breath if they matter"
            )
            notes.append(Note(STEP, words, badge=True))
        return notes


def _mean_of_9(plane: NDArray[np.int16]) -> NDArray[np.float32]:
    """Return the mean of each pixel of a slice and its eight neighbours, (ny, nx)."""
    padded = np.pad(plane.astype(np.float32), 1, mode="edge")
    nj, ni = plane.shape
    parts = [padded[j : j + nj, i : i + ni] for j in range(3) for i in range(3)]
    return np.asarray(np.mean(parts, axis=0), np.float32)


def _slices(volume: Volume, first: int, last: int, to: str = "to") -> str:
    """Return the range of slices from k ``first`` to ``last`` as text, counted from the feet."""
    ends = volume.to_lps(np.array([[0.0, 0.0, first], [0.0, 0.0, last]]))
    (low, count), (high, _) = (slice_from_feet(volume, end) for end in ends)
    return f"slices {min(low, high)} {to} {max(low, high)} of {count} from the feet"


def find_disturbed(grid: PathGrid) -> ArtefactRegions:
    """Find the regions of a CT in which artefacts hide or imitate small airways.

    The search uses the original slices of the CT: interpolated slices are more alike than those of a scanner, and they
    spread metal and its streaks (docs/decisions/0135).

    Parameters
    ----------
    grid
        Grid of the search, of a CT in canonical order: slices from the feet up.
    """
    ct = grid.ct
    scale = air_scale(ct)
    streaks = find_streaks(ct, scale)
    steps = find_steps(ct, scale, None if streaks is None else np.asarray(streaks.any(axis=(1, 2))))
    return ArtefactRegions(grid, streaks, steps)
