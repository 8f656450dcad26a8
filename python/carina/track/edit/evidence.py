"""Evidence in the CT that a path is an airway: wall round its whole length, compared with paths through the lung.

Across a path, rays run to 16 sides, and their values are averaged over 2.5 mm along the path: an airway continues
over this length, noise and the rims of vessels do not. The rise of the sides above the middle is compared with the
same measure on the best paths through plain lung of this CT, and weighted (``evidence_verdict.py``).
docs/decisions/0140.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carina import _core
from carina.errors import NoResultError
from carina.track.edit.evidence_verdict import (
    STEP_MM,
    LungBaseline,
    PathStart,
    Sections,
    along_mm,
    doubtful_sections,
    turns_back,
)
from carina.track.edit.lumen import EditedLumen, Voxels, tissue_there
from carina.track.find.result import Airways
from carina.track.intensity_levels import air_scale
from carina.track.tree.airway_tree import AirwayTree
from carina.volume.model import Volume

__all__ = ["Evidence", "PathStart", "Sections", "evidence_of"]

Points = NDArray[np.float64]

# Number of sides to which rays run from the middle of a section (values of the CT across a path).
NUM_SIDES = 16
RING_MM = 0.35
"""Distance in mm between neighbouring samples on a ray from the path across an airway's wall."""
REACH_MM, FAR_MM = 3.2, 8.1
"""Lengths in mm of the rays that find the wall of a small airway, and of those that find the wall of a lobar
bronchus."""
OPEN_SIDES = 0.2
"""Maximum share of a cross-section's 16 rays that meet no wall in an airway."""
CLOSED_BUT = 1
"""Maximum number of sides without a wall in a cross-section that counts as closed."""
BEND_MM = 3.0
"""Length in mm before and after a point of a path over which the path's two directions are measured; their angle is
the bend."""
HALF_SECTIONS = 2
"""Number of sections on each side of a section that are averaged with the section."""
TANGENT_MM = 1.5
AROUND = 0.25
"""Quantile of the outer samples of a cross-section that is the value of the lung round it."""

MAX_MISSED_MM = 120.0
"""Maximum distance in mm from the tree to a point to which a path for a new branch is searched.

The bronchi of the lower lobe extend this far from the intermediate bronchus.
"""

TIP_ALLOWANCE = 20.0
"""Maximum extra cost of a path from a tip that is preferred to a path from other lumen, in mm along an airway's middle.

A thin wall between two airways side by side costs less than this; 1 mm through plain lung costs 25.
"""

# Number, and length in mm, of the paths through plain lung with which the evidence of a drawn path is compared.
NUM_RUNS = 96
RUN_MM = 10.0
NEAREST_MM, FARTHEST_MM = 8.0, 25.0
"""Minimum and maximum distance in mm from the tree's branches of the lung that serves for comparison."""
MIN_RUNS = 12
BEST_RUNS = 0.9
MIN_RISE_HU = 15.0
NOISE_SHARE, FAR_SHARE = 1.25, 2.0
"""Minimum rises in value from the middle of a path to its wall, even if paths through lung show smaller ones.

NOISE_SHARE is the factor on the noise for near walls; FAR_SHARE is the factor on the near rise for far walls.
"""
PLAIN_HU = -850.0
ENCLOSED, DARK_SHARE = 0.98, 0.1
CLOSED_HU, BRIGHT_HU, LUNG_END_HU, WALL_HU = -400.0, -800.0, -600.0, -500.0


class Evidence:
    """Evidence in one volume for airways beyond the lumen that the search found.

    Parameters
    ----------
    volume, base
        The CT on the grid of the paths, and its airways before any edit, so that the evidence does not depend on
        edits.
    """

    def __init__(self, volume: Volume, base: Airways) -> None:
        self._volume = volume
        self._scale = air_scale(volume)
        self.noise = self._scale.span(base.tracker.noise_hu)
        """Standard deviation of the values in air, in the units of the volume's values."""
        self.found_zyx = base.tracker.lumen_zyx
        """Lumen (nz, ny, nx) on the grid of the paths before any edit, found by the search or imported as a mask."""
        self.enclosures = _core.Enclosures(volume.hu_zyx, volume.lps_from_ijk)
        least = self._scale.span(MIN_RISE_HU)
        lung = _plain_lung(volume, base, self._scale.level(LUNG_END_HU))
        enough = len(lung) >= MIN_RUNS
        rises = self.enclosures.at(lung) if enough else np.zeros(1)
        values = self.enclosures.values_at(volume.to_lps(lung.astype(np.float64))) if enough else np.zeros(1)
        air = self._scale.level(-1000.0)
        # Dark values: at most as bright as air in a wide airway, and among the darkest tenth of this lung, because
        # neither emphysema nor noise is an airway.
        dark = (
            min(air + max(2.0 * self.noise, self._scale.span(40.0)), float(np.quantile(values, DARK_SHARE)))
            if enough
            else air
        )
        self._levels = {
            "enclosed": max(float(np.quantile(rises, ENCLOSED)), least),
            "dark": float(dark),
            "bright": float(self._scale.level(BRIGHT_HU)),
            "closed": float(self._scale.level(CLOSED_HU)),
        }
        usual = max(least, NOISE_SHARE * self.noise)
        self.compared_with = LungBaseline(usual, FAR_SHARE * usual, float(self._scale.level(PLAIN_HU)))
        """Comparison values of lung without airways: wall rises that a tenth of its best paths' sections exceed,
        and brightness."""
        if enough:
            self._compare(lung[:: max(1, len(lung) // NUM_RUNS)][:NUM_RUNS])

    def _compare(self, starts: Voxels) -> None:
        found = []
        for run in self.enclosures.runs(starts, away_mm=RUN_MM, **self._levels):
            if run is not None and len(run) > 2:
                found.append(self.sections(_even(self._volume.to_lps(run.astype(np.float64)))))
        if len(found) < MIN_RUNS:
            return
        rise = np.concatenate([run.rise for run in found])
        far = np.concatenate([run.far_rise for run in found])
        usual = max(self.compared_with.rise, float(np.quantile(rise, BEST_RUNS)))
        far_usual = max(FAR_SHARE * usual, float(np.quantile(far, BEST_RUNS)))
        bright = float(np.quantile(np.concatenate([run.middle for run in found]), 0.75))
        self.compared_with = LungBaseline(usual, far_usual, bright)

    def way(self, lumen: EditedLumen, voxel: NDArray[np.int64], toward: NDArray[np.int64], tips: Voxels) -> Voxels:
        """Return the (n, 3) voxels of the path with most wall evidence, from the lumen (first) to a voxel outside it.

        Parameters
        ----------
        lumen
            Lumen to start from.
        voxel
            Target (i, j, k).
        toward
            A voxel of the tree, as the goal if no airway leads to the target.
        tips
            (n, 3) voxels at the tips of the tree; a path from one of them is preferred to a path from a wall that is
            up to :data:`TIP_ALLOWANCE` cheaper.

        Raises
        ------
        NoResultError
            If the target is tissue, only tissue leads to it, or it is too far from the tree.
        """
        tissue_there(lumen, voxel, self._scale.level(WALL_HU))
        start, goal = ((int(v[0]), int(v[1]), int(v[2])) for v in (voxel, toward))
        away_mm = float(np.linalg.norm(self._volume.lps_from_ijk[:3, :3] @ (voxel - toward)))
        if away_mm > MAX_MISSED_MM:
            msg = (
                f"the point is {away_mm:.0f} mm from the tree, but a new branch can be at most {MAX_MISSED_MM:.0f} mm "
                "long; add the branches in between first"
            )
            raise NoResultError(msg, code="track.no-path")
        way = self.enclosures.way(
            lumen.core, start, goal, tips, tip_allowance=TIP_ALLOWANCE, **self._levels, cancel=lumen.cancel
        )
        if way is None:
            msg = (
                "no airway leads from the tree to the point: there is tissue in between. If the airway is obstructed "
                "there, bridge the obstruction; if only a thin wall or image noise is in the way, paint the lumen first"
            )
            raise NoResultError(msg, code="track.no-path")
        return way

    def doubtful(self, points: Points, start: PathStart | None = None) -> NDArray[np.bool_]:
        """Return (n-1,) flags, one per segment of a line: True where the CT shows no wall of an airway.

        Parameters
        ----------
        points
            (n, 3) line, LPS in mm.
        start
            Start of the line at a branch of the tree; None if it does not leave a branch.

        Returns
        -------
        (n-1,) bool
            True for segments without evidence.
        """
        sections = self.sections(points)
        is_doubtful = doubtful_sections(sections, self.compared_with, self._scale, start)
        along = along_mm(points)
        if start is not None and turns_back(points, along, start):
            is_doubtful = sections.at_mm >= start.inside_mm
        first = np.searchsorted(sections.at_mm, along[:-1] - 1e-9, side="left")
        last = np.searchsorted(sections.at_mm, along[1:] + 1e-9, side="right")
        num = np.concatenate([[0], np.cumsum(is_doubtful)])
        found: NDArray[np.bool_] = num[last] > num[first]
        return found

    def crosses_wall(self, points: Points, before: Points) -> bool:
        """Return whether a line crosses points brighter than the line ``before`` and than half-way to tissue."""
        new, old = (float(self.enclosures.values_at(_fine(line)).max()) for line in (points, before))
        return new > max(old, self._scale.level(WALL_HU)) + 3.0 * self.noise

    def sections(self, points: Points) -> Sections:
        """Measure the sections across a line of (n, 3) points, LPS in mm, one every half millimetre."""
        along = along_mm(points)
        at = np.linspace(0.0, along[-1], max(2, int(np.ceil(along[-1] / STEP_MM)) + 1))

        def places(where: NDArray[np.float64]) -> Points:
            return np.stack([np.interp(where, along, points[:, axis]) for axis in range(3)], axis=1)

        tangent = places(at + TANGENT_MM) - places(at - TANGENT_MM)
        tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
        helper = np.eye(3)[np.argmin(np.abs(tangent), axis=1)]
        across = np.cross(tangent, helper)
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
        up = np.cross(tangent, across)
        angle = 2.0 * np.pi * np.arange(NUM_SIDES) / NUM_SIDES
        sides = np.cos(angle)[None, :, None] * across[:, None, :] + np.sin(angle)[None, :, None] * up[:, None, :]
        off = np.arange(0.0, FAR_MM, RING_MM)
        samples = places(at)[:, None, None, :] + sides[:, :, None, :] * off[None, None, :, None]
        values = self.enclosures.values_at(samples.reshape(-1, 3)).reshape(len(at), NUM_SIDES, len(off))
        profiles = _mean_along(values.astype(np.float64), HALF_SECTIONS)
        middle = profiles[:, :, 0].mean(axis=1)
        near = off <= REACH_MM
        peaks, far_peaks = profiles[:, :, near].max(axis=2), profiles.max(axis=2)
        half = 0.5 * (middle[:, None] + peaks)
        first = (profiles[:, :, near] >= half[:, :, None]).argmax(axis=2)
        back, on = places(at) - places(at - BEND_MM), places(at + BEND_MM) - places(at)
        lengths = np.linalg.norm(back, axis=1) * np.linalg.norm(on, axis=1)
        bend = 1.0 - (back * on).sum(axis=1) / np.maximum(lengths, 1e-6)
        # The bend is set to 0 near the ends of a line, where one of its two directions cannot be measured.
        bend[:HALF_SECTIONS] = bend[-HALF_SECTIONS:] = 0.0
        return Sections(
            at_mm=at,
            middle=middle,
            rise=np.quantile(peaks, OPEN_SIDES, axis=1) - middle,
            far_rise=np.quantile(far_peaks, OPEN_SIDES, axis=1) - middle,
            closed=np.partition(peaks, CLOSED_BUT, axis=1)[:, CLOSED_BUT] - middle,
            far_closed=np.partition(far_peaks, CLOSED_BUT, axis=1)[:, CLOSED_BUT] - middle,
            around=np.quantile(profiles[:, :, ~near].reshape(len(at), -1), AROUND, axis=1),
            radius_mm=RING_MM * np.median(first, axis=1),
            bend=bend,
        )


def evidence_of(airways: Airways) -> Evidence:
    """Return the evidence in the CT of these airways; computed at first use and shared by all edited airways."""
    volume = airways.tracker.volume
    found: Evidence = airways.evidence.of(volume, lambda: Evidence(volume, airways.base or airways))
    return found


def _plain_lung(volume: Volume, base: Airways, brightest: float) -> Voxels:
    """Return (n, 3) voxels of lung without airways, 8 to 25 mm from the tree's branches, away from lumen and tissue."""
    places = _beside(base.tree)
    shape = np.array(volume.shape_zyx[::-1])
    ijk = np.floor(volume.to_ijk(places) + 0.5).astype(np.int64)
    ijk = ijk[((ijk >= 0) & (ijk < shape)).all(axis=1)]
    ijk = ijk[volume.hu_zyx[ijk[:, 2], ijk[:, 1], ijk[:, 0]] <= brightest]
    centres = volume.to_lps(ijk.astype(np.float64))
    core = base.tracker.core
    away = np.array([core.nearest((x, y, z), NEAREST_MM) is None for x, y, z in centres.tolist()], dtype=bool)
    found: Voxels = ijk[away].astype(np.uint16)
    return found


def _beside(tree: AirwayTree) -> Points:
    """Return points spread evenly round the branches beyond the main bronchi, equal at each call; LPS in mm."""
    branches = [branch for branch in tree.branches if branch.generation >= 2] or list(tree.branches)
    points = np.concatenate([branch.points for branch in branches])
    num = 12 * NUM_RUNS
    chosen = points[np.linspace(0, len(points) - 1, num).round().astype(int)]
    n = np.arange(num)
    z = 1.0 - 2.0 * ((n * 0.7548776662466927) % 1.0)
    turn = 2.0 * np.pi * ((n * 0.5698402909980532) % 1.0)
    ring = np.sqrt(1.0 - z * z)
    far = NEAREST_MM + (FARTHEST_MM - NEAREST_MM) * ((n * 0.6180339887498949) % 1.0)
    return np.asarray(chosen + far[:, None] * np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1))


def _mean_along(values: NDArray[np.float64], half: int) -> NDArray[np.float64]:
    """Return the mean of each entry and ``half`` entries before and after it on the first axis, clamped at the ends."""
    padded = np.concatenate([values[:1]] * half + [values] + [values[-1:]] * half)
    total = np.cumsum(np.concatenate([np.zeros_like(padded[:1]), padded]), axis=0)
    num = 2 * half + 1
    return np.asarray((total[num:] - total[:-num]) / num)


def _even(points: Points) -> Points:
    """Return a line of voxel centres with rounded corners and unchanged ends."""
    padded = np.concatenate([points[:1]] * 2 + [points] + [points[-1:]] * 2)
    mean = np.mean([padded[n : n + len(points)] for n in range(5)], axis=0)
    return np.asarray(np.concatenate([points[:1], mean[1:-1], points[-1:]]))


def _fine(points: Points) -> Points:
    """Return a polyline with three interpolated points added in each of its segments."""
    share = np.linspace(0.0, 1.0, 4, endpoint=False)[:, None, None]
    return np.asarray((points[:-1] + share * (points[1:] - points[:-1])).reshape(-1, 3))
