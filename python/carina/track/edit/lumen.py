"""Voxels that an edit adds to the lumen or removes: brush strokes, bridges, airways that the search missed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina._core import (
    LumenTracker,
    cheapest_way,
    edit_lumen,
    flood_lumen,
    fresh_lumen,
    lumen_array,
    lumen_states,
    reroot_lumen,
    voxels_of,
)
from carina.errors import NoResultError, UsageError
from carina.track.edit.edit_list import PaintLumen, Point
from carina.track.intensity_levels import air_scale
from carina.track.paths.path_grid import PathGrid
from carina.track.progress import Cancel
from carina.volume.anatomical_planes import PLANES
from carina.volume.model import Volume
from carina.volume.point_check import check_in_volume

Voxels = NDArray[np.uint16]
"""Type of an array of voxels (n, 3), as indices i, j, k."""

MAX_BRIDGE_MM = 60.0
"""Maximum length in mm of a bridge across an obstruction; a longer one would be a guess."""
BRIDGE_RADIUS_MM = 1.0
MAX_MISSED_RADIUS_MM = 4.0
AIR_REACH_MM = 2.0
"""Distance in mm from a click within which the darkest voxel is used if the click is beside an airway."""
GROWTH_REACH_MM = (60.0, 60.0, 100.0)
"""Reach in mm along LPS x, y, z of the growth beyond a bridge: the airways beyond a blocked lobar bronchus."""
GROWTH_LEAK_MM3 = 20_000.0
GROWTH_SMALL_LEAK_MM3 = 3_000.0
CLOSED_RADIUS_MM = 10.0
MIN_WALL_CONTRAST_HU = 60.0

LUMEN_END_HU, WALL_HU, SOFT_HU, DENSE_HU = -800.0, -500.0, -100.0, 200.0
CORE_HU = -950.0


@dataclass(frozen=True, slots=True)
class EditedLumen:
    """Compiled tracker of a lumen, with the operations that change it."""

    grid: PathGrid
    core: LumenTracker
    is_fresh: bool = False
    """Whether each change computes the tracker from scratch, which is slow: the reference for the fast updates."""
    cancel: Cancel | None = None
    changed_box: tuple[NDArray[np.int64], NDArray[np.int64]] | None = None
    """First and last voxel of the box that the last change affected; None if the whole lumen may be affected."""

    @property
    def volume(self) -> Volume:
        """CT on the grid of the tracker."""
        return self.grid.volume

    def changed(self, added: Voxels, removed: Voxels) -> EditedLumen:
        """Return a copy of the lumen with voxels added and removed."""
        hu = self.volume.hu_zyx
        if self.is_fresh:
            lumen = lumen_array(self.core)
            lumen[removed[:, 2], removed[:, 1], removed[:, 0]] = 0
            lumen[added[:, 2], added[:, 1], added[:, 0]] = 1
            return self.built(lumen, self.root_ijk)
        core, box = edit_lumen(self.core, hu, added, removed, cancel=self.cancel)
        first, shape = (np.zeros(3, np.int64),) * 2 if box is None else (np.array(box[0]), np.array(box[1]))
        return EditedLumen(self.grid, core, False, self.cancel, (first, first + shape - 1))

    def rerooted(self, root_ijk: tuple[int, int, int]) -> EditedLumen:
        """Return a copy of the lumen with paths from another root voxel."""
        if self.is_fresh:
            return self.built(lumen_array(self.core), root_ijk)
        core = reroot_lumen(self.core, root_ijk, cancel=self.cancel)
        return EditedLumen(self.grid, core, False, self.cancel)

    def built(self, lumen_zyx: NDArray[np.uint8], root_ijk: tuple[int, int, int]) -> EditedLumen:
        """Return an edited lumen of the same search from a mask and a root, computed from scratch."""
        core = fresh_lumen(self.core, self.volume.hu_zyx, lumen_zyx, root_ijk, cancel=self.cancel)
        return EditedLumen(self.grid, core, self.is_fresh, self.cancel)

    @property
    def root_ijk(self) -> tuple[int, int, int]:
        """Voxel (i, j, k) of the root."""
        found = self.core.path(self.core.root)
        assert found is not None
        return _triple(np.rint(self.volume.to_ijk(found[0][0])))

    def voxel_of_node(self, node: int) -> tuple[int, int, int]:
        """Return the voxel (i, j, k) of a node of the tracker."""
        return _triple(voxels_of(self.core, np.array([node], dtype=np.uint32))[0])

    def state_at(self, voxel: NDArray[np.int64]) -> int:
        """Return the state of a voxel: 0 outside the lumen, 1 in lumen that no path reaches, 2 in reachable lumen."""
        return int(lumen_states(self.core, _triple(voxel), (1, 1, 1))[0, 0, 0])


def voxel_of(volume: Volume, lps: Point) -> NDArray[np.int64]:
    """Return the voxel (i, j, k) that contains a point.

    Raises
    ------
    UsageError
        If the point is outside the volume.
    """
    check_in_volume(volume, lps, "the point", code="track.outside-volume")
    shape = np.array(volume.shape_zyx[::-1])
    found: NDArray[np.int64] = np.clip(np.floor(volume.to_ijk(np.array(lps)) + 0.5), 0, shape - 1).astype(np.int64)
    return found


def painted_voxels(volume: Volume, edit: PaintLumen) -> Voxels:
    """Return the voxels under a stroke of the brush.

    A disc is one voxel thick: it contains the voxels whose centres are within half the spacing of the axis that is
    most nearly parallel to the slice's normal. The voxel at the brush's centre is always included.

    Raises
    ------
    UsageError
        If no point of the stroke is in the volume.
    """
    normal = np.zeros(3)
    half_mm = np.inf
    matrix = volume.lps_from_ijk[:3, :3]
    if edit.plane != "ball":
        normal[PLANES[edit.plane].normal_axis] = 1.0
        half_mm = 0.5 * float(np.abs(matrix.T @ normal).max())
    points = np.array(edit.points_lps)
    shape = np.array(volume.shape_zyx[::-1])
    found = []
    for a, b in zip(points, points[1:] if len(points) > 1 else points, strict=False):
        reach = (edit.radius_mm + 1.0) / np.array(volume.spacing_mm) + 1.0
        ends = volume.to_ijk(np.stack([a, b]))
        low = np.clip(np.floor(ends.min(axis=0) - reach), 0, shape - 1).astype(np.int64)
        high = np.clip(np.ceil(ends.max(axis=0) + reach), 0, shape - 1).astype(np.int64)
        voxels = _box_voxels(low, high)
        off = volume.to_lps(voxels.astype(np.float64)) - a
        way = b - a
        length2 = float(way @ way)
        share = np.clip(off @ way / length2, 0.0, 1.0) if length2 > 0.0 else np.zeros(len(off))
        off -= share[:, None] * way
        height = off @ normal
        beside = np.linalg.norm(off - height[:, None] * normal, axis=1)
        # The interval is half-open, so a plane between two slices selects only one of them.
        inside = (beside <= edit.radius_mm) & (height > -half_mm) & (height <= half_mm)
        found.append(voxels[inside])
    centres = np.floor(volume.to_ijk(points) + 0.5).astype(np.int64)
    is_in = ((centres >= 0) & (centres < shape)).all(axis=1)
    if not is_in.any():
        raise UsageError("the brush stroke lies outside the scan; paint inside the scan", code="track.outside-volume")
    return _unique(np.concatenate([*found, centres[is_in]]))


def bridge_way(lumen: EditedLumen, start: NDArray[np.int64]) -> Voxels:
    """Return the voxels of the shortest path from the reachable lumen to a voxel, as face neighbours.

    The path may lead through any tissue. Dense tissue (bone, contrast medium) costs more, so that the path runs
    round it.

    Raises
    ------
    NoResultError
        If the path is longer than a bridge may be; the message states its length.
    """
    volume = lumen.volume
    scale = air_scale(volume)
    away_mm = _away_mm(lumen, start, MAX_BRIDGE_MM)
    if away_mm is not None:
        low, high = _box_round(volume, start, (1.3 * away_mm + 10.0,) * 3)
        values = _crop(volume.hu_zyx, low, high)
        weights = np.full(values.shape, 3.0, dtype=np.float32)
        weights[values <= scale.level(LUMEN_END_HU)] = 1.0
        weights[values >= scale.level(DENSE_HU)] = 12.0
        way = _way(lumen, low, high, weights, start)
        if way is not None and (length_mm := _length_mm(volume, way)) <= MAX_BRIDGE_MM:
            return by_faces(way)
        if way is not None:
            away_mm = length_mm
    far = f"more than {MAX_BRIDGE_MM:g} mm" if away_mm is None else f"{away_mm:.0f} mm"
    msg = (
        f"the bridge would be {far} long, but at most {MAX_BRIDGE_MM:g} mm is possible; click nearer to the "
        "obstruction, or bridge in two steps"
    )
    raise NoResultError(msg, code="track.bridge-too-long")


def tissue_there(lumen: EditedLumen, start: NDArray[np.int64], wall: float) -> None:
    """Raise an error that states why a voxel is refused, if it is brighter than half-way between air and tissue.

    Raises
    ------
    NoResultError
        If the voxel is tissue; the message states what to do.
    """
    value = int(lumen.volume.hu_zyx[start[2], start[1], start[0]])
    if value > wall:
        unit = " HU" if lumen.volume.is_hu else ""
        msg = (
            f"this point is in tissue ({value}{unit}), not in an airway; click in the dark middle of the branch, or "
            "bridge to the airway beyond"
        )
        raise NoResultError(msg, code="track.outside-lumen")


def air_voxel(lumen: EditedLumen, start: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return a voxel that is as dark as lumen: ``start`` itself, or the darkest within 2 mm of it.

    Raises
    ------
    NoResultError
        If there is no air within 2 mm.
    """
    volume = lumen.volume
    end = air_scale(volume).level(LUMEN_END_HU)
    low, high = _box_round(volume, start, (AIR_REACH_MM,) * 3)
    voxels = _box_voxels(low, high)
    centre = volume.to_lps(start.astype(np.float64))
    off = np.linalg.norm(volume.to_lps(voxels.astype(np.float64)) - centre, axis=1)
    voxels, off = voxels[off <= AIR_REACH_MM], off[off <= AIR_REACH_MM]
    values = volume.hu_zyx[voxels[:, 2], voxels[:, 1], voxels[:, 0]]
    here = int(volume.hu_zyx[start[2], start[1], start[0]])
    if here <= end:
        return start
    if int(values.min()) > end:
        unit = " HU" if volume.is_hu else ""
        msg = (
            f"this point is not in air ({here}{unit}); click in the dark middle of the airway beyond the obstruction, "
            "or paint its lumen first"
        )
        raise NoResultError(msg, code="track.outside-lumen")
    order = np.lexsort((off, values))
    found: NDArray[np.int64] = voxels[order[0]]
    return found


def grown_beyond(lumen: EditedLumen, start: NDArray[np.int64]) -> Voxels:
    """Return the lumen round a voxel of air, grown as in the automatic search, with its protection against leaks."""
    volume = lumen.volume
    scale = air_scale(volume)
    low, high = _box_round(volume, start, GROWTH_REACH_MM)
    values = _crop(volume.hu_zyx, low, high)
    matrix = volume.lps_from_ijk.copy()
    matrix[:3, 3] = volume.to_lps(low.astype(np.float64))
    at = start - low
    here = int(values[at[2], at[1], at[0]])
    core, end = scale.level(CORE_HU), scale.level(LUMEN_END_HU)
    grown, _ = flood_lumen(
        values,
        matrix,
        [_triple(at)],
        first_level=min(here, end),
        core_level=min(core, end),
        last_level=end,
        leak_mm3=GROWTH_LEAK_MM3,
        small_leak_mm3=GROWTH_SMALL_LEAK_MM3,
        closed_radius_mm=CLOSED_RADIUS_MM,
        min_contrast=scale.span(MIN_WALL_CONTRAST_HU),
        cancel=lumen.cancel,
    )
    voxels = np.argwhere(grown)[:, ::-1] + low
    return _unique(np.concatenate([voxels, start[None]]))


def tube_round(volume: Volume, points: NDArray[np.float64], radius_mm: float | NDArray[np.float64]) -> Voxels:
    """Return the voxels whose centres are within a radius (mm) of one of (n, 3) points, LPS in mm."""
    radii = np.broadcast_to(np.asarray(radius_mm, dtype=np.float64), (len(points),))
    ijk = volume.to_ijk(points)
    centres = np.floor(ijk + 0.5)
    reach = np.ceil(radii.max() / np.array(volume.spacing_mm) + 0.5).astype(np.int64)
    offsets = _box_voxels(-reach, reach)
    shape = np.array(volume.shape_zyx[::-1])
    found = [np.zeros((0, 3), dtype=np.int64)]
    for point, centre, radius in zip(ijk, centres.astype(np.int64), radii, strict=True):
        ball = centre + offsets
        off_mm = np.linalg.norm((ball - point) @ volume.lps_from_ijk[:3, :3].T, axis=1)
        ball = ball[off_mm <= radius + 1e-6]
        found.append(ball[((ball >= 0) & (ball < shape)).all(axis=1)])
    return _unique(np.concatenate(found))


def voxels_along(volume: Volume, points: NDArray[np.float64]) -> Voxels:
    """Return the voxels along a line of (n, 3) points (LPS, mm), sampled every tenth of a voxel."""
    ijk = volume.to_ijk(points)
    counts = np.maximum(np.ceil(10.0 * np.abs(np.diff(ijk, axis=0)).max(axis=1)), 1).astype(np.int64)
    pieces = [a + np.arange(n)[:, None] / n * (b - a) for a, b, n in zip(ijk[:-1], ijk[1:], counts, strict=True)]
    shape = np.array(volume.shape_zyx[::-1])
    voxels = np.floor(np.concatenate([*pieces, ijk[-1:]]) + 0.5).astype(np.int64)
    return _unique(np.clip(voxels, 0, shape - 1))


def missed_radii(volume: Volume, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the radius (mm) of the airway at each of (n, 3) path points (LPS, mm), from 26 rays.

    On each ray the wall is at half of its rise. The radius is the 0.4 quantile of the rays, because rays along the
    airway meet no wall; a median over five neighbours removes single errors. The radius is at most 4 mm and at least
    half a voxel.
    """
    directions = _box_voxels(np.full(3, -1), np.full(3, 1)).astype(np.float64)
    directions = directions[np.any(directions != 0.0, axis=1)] @ volume.lps_from_ijk[:3, :3].T
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    step_mm = 0.5 * min(volume.spacing_mm)
    steps = np.arange(0.0, MAX_MISSED_RADIUS_MM + 2.0, step_mm)
    places = points[:, None, None] + steps[None, None, :, None] * directions[None, :, None, :]
    values = _interpolated(volume, places.reshape(-1, 3)).reshape(len(points), len(directions), len(steps))
    inner = values[:, :, 0].min(axis=1)
    half = 0.5 * (inner[:, None] + values.max(axis=2))
    is_wall = values >= half[:, :, None]
    first = np.maximum(is_wall.argmax(axis=2), 1)[:, :, None]
    before, at = (np.take_along_axis(values, first + n, axis=2)[:, :, 0] for n in (-1, 0))
    share = np.clip((half - before) / np.maximum(at - before, 1e-9), 0.0, 1.0)
    rays = np.where(is_wall.any(axis=2), step_mm * (first[:, :, 0] - 1 + share), steps[-1])
    radius = np.quantile(rays, 0.4, axis=1)
    padded = np.pad(radius, 2, mode="edge")
    radius = np.median(np.stack([padded[n : n + len(radius)] for n in range(5)]), axis=0)
    clipped: NDArray[np.float64] = np.clip(radius, 0.5 * min(volume.spacing_mm), MAX_MISSED_RADIUS_MM)
    return clipped


def _interpolated(volume: Volume, points: NDArray[np.float64]) -> NDArray[np.float64]:
    shape = np.array(volume.shape_zyx[::-1])
    ijk = np.clip(volume.to_ijk(points), 0, shape - 1)
    base = np.minimum(np.floor(ijk).astype(np.int64), np.maximum(shape - 2, 0))
    share = ijk - base
    total = np.zeros(len(points))
    for corner in range(8):
        bits = np.array([corner & 1, corner >> 1 & 1, corner >> 2])
        at = np.minimum(base + bits, shape - 1)
        weight = np.prod(np.where(bits == 1, share, 1.0 - share), axis=1)
        total += weight * volume.hu_zyx[at[:, 2], at[:, 1], at[:, 0]]
    return total


def _away_mm(lumen: EditedLumen, start: NDArray[np.int64], reach_mm: float) -> float | None:
    """Return the distance in mm from a voxel to the nearest reachable lumen, searched in growing boxes."""
    volume = lumen.volume
    centre = volume.to_lps(start.astype(np.float64))
    for reach in (10.0, 25.0, reach_mm):
        low, high = _box_round(volume, start, (reach,) * 3)
        states = lumen_states(lumen.core, _triple(low), _triple(high - low + 1))
        voxels = np.argwhere(states == 2)[:, ::-1] + low
        if len(voxels):
            away = float(np.linalg.norm(volume.to_lps(voxels.astype(np.float64)) - centre, axis=1).min())
            if away <= reach:
                return away
    return None


def _way(
    lumen: EditedLumen,
    low: NDArray[np.int64],
    high: NDArray[np.int64],
    weights: NDArray[np.float32],
    start: NDArray[np.int64],
) -> Voxels | None:
    goals = (lumen_states(lumen.core, _triple(low), _triple(high - low + 1)) == 2).astype(np.uint8)
    weights = np.where(goals != 0, np.float32(1.0), weights)
    way = cheapest_way(weights, goals, lumen.volume.spacing_mm, _triple(start - low), cancel=lumen.cancel)
    return None if way is None else (way + low).astype(np.uint16)


def by_faces(way: Voxels) -> Voxels:
    """Return a path with voxels added so that consecutive ones share a face: lumen may not connect across an edge."""
    found = [way[0].astype(np.int64)]
    for voxel in way[1:].astype(np.int64):
        for axis in range(3):
            if found[-1][axis] != voxel[axis]:
                between = found[-1].copy()
                between[axis] = voxel[axis]
                found.append(between)
    return np.array(found, dtype=np.uint16)


def _length_mm(volume: Volume, way: Voxels) -> float:
    points = volume.to_lps(way.astype(np.float64))
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _box_round(
    volume: Volume, voxel: NDArray[np.int64], reach_mm: tuple[float, ...]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first and last voxel of the box that extends ``reach_mm`` from a voxel along LPS x, y, z."""
    inverse = np.abs(np.linalg.inv(volume.lps_from_ijk[:3, :3]))
    reach = np.ceil(inverse @ np.array(reach_mm)).astype(np.int64)
    shape = np.array(volume.shape_zyx[::-1])
    return np.maximum(voxel - reach, 0), np.minimum(voxel + reach, shape - 1)


def _box_voxels(low: NDArray[np.int64], high: NDArray[np.int64]) -> NDArray[np.int64]:
    shape = high - low + 1
    k, j, i = np.indices(tuple(shape[::-1])).reshape(3, -1)
    return np.stack([i, j, k], axis=1) + low


def _crop(values: NDArray[np.int16], low: NDArray[np.int64], high: NDArray[np.int64]) -> NDArray[np.int16]:
    return np.ascontiguousarray(values[low[2] : high[2] + 1, low[1] : high[1] + 1, low[0] : high[0] + 1])


def _unique(voxels: NDArray[np.int64]) -> Voxels:
    return np.unique(voxels, axis=0).astype(np.uint16)


def _triple(values: NDArray[np.generic]) -> tuple[int, int, int]:
    i, j, k = (int(v) for v in values)
    return i, j, k
