"""Start point given by the user: the air round it, and whether this air belongs to the airways."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.errors import NoResultError
from carina.track.find.air_upwards import connected_to
from carina.track.find.root_checks import SURE_TRACHEA_MM
from carina.track.find.top_of_trachea import TopOfTrachea
from carina.track.find.trachea_search import Trachea
from carina.track.intensity_levels import AirScale
from carina.track.paths.tracker import SNAP_MM, Point, as_point, words
from carina.volume.model import Volume

# Levels in HU at one of which the air of an airway must be enclosed in a slice; lung with emphysema is hardly
# brighter.
ENCLOSED_HU = (-800.0, -900.0, -950.0)
# Maximum area in mm2 of an airway's section in a slice: a main bronchus that runs along the slice.
MAX_SECTION_MM2 = 1500.0
# Distance in mm from the trachea's middle, in its slice, above which a point of the lumen is not in the trachea.
IN_TRACHEA_MM = 18.0
# Distance in mm above the upper end of the found trachea beyond which a given point may be in the true trachea.
ABOVE_MM = 5.0


@dataclass(frozen=True, slots=True)
class GivenStart:
    """Start point that a user gave in the trachea."""

    given: Point
    """Point that the user gave, LPS in mm."""
    point: Point
    """Centre of the nearest voxel of the lumen, LPS in mm."""
    snapped_mm: float
    """Distance in mm of the given point from the lumen; 0 inside the lumen."""
    trachea_is_doubted: bool
    """Whether the trachea lacks one of its usual features, so that it may be a bronchus."""

    def notes_if_moved_to(self, root: Point) -> list[str]:
        """Return the notes for a tree that begins at the upper end of the trachea."""
        moved_mm = float(np.linalg.norm(np.subtract(root, self.given)))
        if moved_mm <= SNAP_MM:
            return []
        where = words(self.given)
        return [f"the point {where} is in the trachea: the start was moved {moved_mm:.0f} mm to its upper end"]

    def notes_if_unchanged(self) -> list[str]:
        """Return the notes for a tree that begins at the point that the user gave."""
        return [f"the start was moved {self.snapped_mm:.1f} mm to the nearest lumen voxel"] if self.snapped_mm else []


def air_near(volume: Volume, root: Point, scale: AirScale) -> list[tuple[int, int, int]]:
    """Return the voxels of air near a given root: the nearest voxel, and those within 2 mm of this voxel."""
    centre = volume.to_ijk(np.array(root))
    shape = np.array(volume.shape_zyx[::-1])
    reach = np.ceil((SNAP_MM + 2.0) / np.array(volume.spacing_mm)) + 1
    low = np.clip(np.floor(centre - reach), 0, shape - 1).astype(int)
    high = np.clip(np.ceil(centre + reach), 0, shape - 1).astype(int)
    grid = np.stack(np.meshgrid(*(np.arange(low[a], high[a] + 1) for a in range(3)), indexing="ij"), axis=-1)
    voxels = grid.reshape(-1, 3)
    values = volume.hu_zyx[voxels[:, 2], voxels[:, 1], voxels[:, 0]]
    points = volume.to_lps(voxels.astype(np.float64))
    distance = np.linalg.norm(points - np.array(root), axis=1)
    air = (values <= scale.level(-850.0)) & (distance <= SNAP_MM)
    if not air.any():
        msg = (
            f"the root {words(root)} is not in an airway: no voxel within {SNAP_MM:g} mm is as dark as air; "
            "choose a point inside the trachea"
        )
        raise NoResultError(msg, code="track.outside-lumen")
    nearest = points[air][int(np.argmin(distance[air]))]
    chosen = air & (np.linalg.norm(points - nearest, axis=1) <= 2.0)
    # The nearest voxel comes first: it is the root.
    order = np.argsort(np.linalg.norm(points[chosen] - nearest, axis=1), kind="stable")
    return [(int(i), int(j), int(k)) for i, j, k in voxels[chosen][order]]


def nearest_in(volume: Volume, lumen: NDArray[np.uint8], point: Point) -> tuple[Point, float] | None:
    """Return the centre of the nearest voxel of a mask within the snapping distance, and that distance (0 inside)."""
    centre = volume.to_ijk(np.array(point))
    shape = np.array(volume.shape_zyx[::-1])
    here = np.clip(np.floor(centre + 0.5), 0, shape - 1).astype(int)
    if lumen[here[2], here[1], here[0]]:
        return as_point(volume.to_lps(here.astype(np.float64))), 0.0
    reach = np.ceil(SNAP_MM / np.array(volume.spacing_mm)) + 1
    low = np.clip(here - reach, 0, shape - 1).astype(int)
    high = np.clip(here + reach, 0, shape - 1).astype(int)
    block = lumen[low[2] : high[2] + 1, low[1] : high[1] + 1, low[0] : high[0] + 1]
    voxels = np.argwhere(block)[:, ::-1] + low
    if not len(voxels):
        return None
    points = volume.to_lps(voxels.astype(np.float64))
    distance = np.linalg.norm(points - np.array(point), axis=1)
    nearest = int(np.argmin(distance))
    if distance[nearest] > SNAP_MM:
        return None
    return as_point(points[nearest]), float(distance[nearest])


def is_in_trachea(volume: Volume, trachea: Trachea, top: TopOfTrachea | None, point: Point) -> bool:
    """Return whether a point of the lumen is in the trachea, above the carina."""
    if point[2] <= trachea.carina_lps[2]:
        return False
    places = volume.to_lps(np.array(trachea.seeds if top is None else top.seeds, dtype=np.float64))
    nearest = places[int(np.argmin(np.abs(places[:, 2] - point[2])))]
    return float(np.hypot(*(nearest - np.array(point))[:2])) <= IN_TRACHEA_MM


def refuse_open_air(volume: Volume, scale: AirScale, root: Point, voxel: tuple[int, int, int]) -> None:
    """Raise an error for a root in the lung or in the air outside the body.

    Raises
    ------
    NoResultError
        If the air around the voxel is wider in its slice than an airway.
    """
    i, j, k = voxel
    values = volume.hu_zyx[k]
    dx, dy, _ = volume.spacing_mm
    for level in ENCLOSED_HU:
        if values[j, i] >= scale.level(level):
            break
        start = np.zeros(values.shape, dtype=np.bool_)
        start[j, i] = True
        section = connected_to(start, values < scale.level(level))
        if float(section.sum()) * dx * dy <= MAX_SECTION_MM2:
            return
    msg = (
        f"the root {words(root)} is not in an airway: the air there merges with the lung or lies outside the body; "
        "choose a point inside the trachea, or let the trachea be found automatically"
    )
    raise NoResultError(msg, code="track.outside-lumen")


def refuse_air_outside_the_airways(root: Point, trachea: Trachea, top: Point) -> None:
    """Raise an error for a root in air beside the airways: in the oesophagus, the bowel or a bulla.

    Parameters
    ----------
    root
        The given root, LPS in mm.
    trachea
        The trachea that was found.
    top
        Upper end of the trachea, LPS in mm.

    Raises
    ------
    NoResultError
        If a trachea was found without doubts and the root is not connected to it.
    """
    is_sure = not trachea.notes and trachea.split_mm is not None and trachea.split_mm >= SURE_TRACHEA_MM
    if is_sure and root[2] <= top[2] + ABOVE_MM:
        msg = (
            f"the root {words(root)} is not in the airways: the air there is not connected to the trachea, which was "
            f"found at {words(top)}; choose a point inside it, or let it be found automatically"
        )
        raise NoResultError(msg, code="track.outside-lumen")
