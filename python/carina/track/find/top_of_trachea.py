"""Upper end of the trachea in a scan that continues above the trachea or shows a tube in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina._core import flood_lumen
from carina.track.find.air_upwards import SEPTUM_MM2, SIDES, AirSection, dilate, follow_up
from carina.track.find.kernel_compensation import SoftenedCt
from carina.track.find.padding import padding_near
from carina.track.find.root_checks import SURE_TRACHEA_MM
from carina.track.find.upper_airway import (
    Cords,
    Tube,
    carina_of,
    find_cords,
    find_tube,
    join_sections,
    opening_in_front,
)
from carina.track.intensity_levels import AirScale
from carina.track.paths.tracker import Point, as_point
from carina.track.progress import Stages
from carina.track.tree.airway_tree import Branch
from carina.volume.model import Note, Volume

LARYNX = "track.larynx"
TUBE = "track.tube"

AIR_END_HU = -800.0
WALL_HU = 40.0
AT_CARINA_MM = 10.0
MAX_BELOW = 0.85
# The seeds are in a bronchus if the sections above them are larger by this factor and at least as long as a trachea.
WIDER_ABOVE = 1.5
# Volume in mm3 above which air above the trachea is not a throat but air outside the body.
MAX_THROAT_MM3 = 150_000.0


@dataclass(frozen=True, slots=True, eq=False)
class TopOfTrachea:
    """Upper end of the trachea, and the parts of the CT that were removed to separate the trachea from other air."""

    seeds: list[tuple[int, int, int]]
    """Voxels (i, j, k) of the trachea, from its top down."""
    start: Point
    """Uppermost voxel of the trachea, LPS in mm."""
    searched: SoftenedCt
    """CT for the search of the airways, in which tissue replaces all air that is not trachea."""
    upper_zyx: NDArray[np.uint8] | None
    """Mask (nz, ny, nx), 1 in larynx and throat; None if the scan ends below them."""
    sections: list[AirSection]
    """Sections of the trachea that contain a tube; empty without a tube."""
    tip_lps: NDArray[np.float64] | None
    """Tip of the tube, LPS in mm; None if there is no tube."""
    cut: list[AirSection]
    """Sections beside an opening to the air outside, where the lumen is limited to the section."""
    starts_in_it: bool
    """Whether a tube is in the lowest section of the trachea, so that no section without the tube exists for
    comparison."""
    is_open: bool
    """Whether the trachea is open to the air outside through the front of the neck."""
    cords: Cords | None
    """Vocal cords; None if the scan ends below the cords."""


def top_of_trachea(
    soft: SoftenedCt, seeds: list[tuple[int, int, int]], scale: AirScale, stage: Stages
) -> TopOfTrachea | None:
    """Find the trachea's upper end and any opening to other air; None if the end that was found is correct.

    Parameters
    ----------
    soft
        CT that is searched.
    seeds
        Voxels (i, j, k) of the trachea as it was found, from the top down; larynx and throat may be among them.
    scale
        Conversion from HU to the values of the volume.
    stage
        Receives progress and cancels the search.
    """
    stage.begin("finding the upper end of the trachea")
    volume = soft.volume
    sections = follow_up(volume, scale, scale.level(AIR_END_HU), seeds[-1], stage)
    padding = padding_near(volume, [*(section.voxel for section in reversed(sections)), *seeds[-1:]])
    if padding is not None:
        sections = _below_padding(sections, padding)
    if len(sections) < 3:
        return None
    tube = find_tube(sections)
    cords = find_cords(sections, tube)
    trachea = sections if cords is None else sections[: cords.begins_at + 1]
    opening = opening_in_front(volume, scale, trachea)
    if tube is None and cords is None and opening is None and padding is None:
        return _above_a_bronchus(soft, seeds, sections)
    is_open = opening is not None or _is_tracheostomy(trachea, tube)
    trachea, cut = join_sections(volume, sections, tube, len(trachea), is_open=is_open)
    top = trachea[-1]
    wall = round(scale.level(WALL_HU))

    def wall_off(values: NDArray[np.int16]) -> None:
        if cords is not None:
            values[top.k + 1 :] = wall
        if padding is not None:
            values[padding] = wall
        if opening is not None:
            part, air = opening
            values[part][air] = wall
        for section, air in cut:
            section.window_of(values)[air] = wall

    is_walled = cords is not None or opening is not None or padding is not None or bool(cut)
    in_tube = [] if tube is None else trachea[tube.first : tube.last + 4]
    return TopOfTrachea(
        seeds=[s.voxel for s in reversed(trachea)],
        start=as_point(volume.to_lps(np.array(top.voxel, dtype=np.float64))),
        searched=soft.with_wall(wall_off) if is_walled else soft,
        upper_zyx=None if cords is None else _upper_airway(volume, scale, sections[cords.begins_at + 1 :], top.k),
        sections=in_tube,
        tip_lps=None if tube is None else sections[tube.first].centre_lps,
        cut=[trachea[n] for n, section in enumerate(sections[: len(trachea)]) if any(section is c for c, _ in cut)],
        starts_in_it=tube is not None and tube.first == 0,
        is_open=is_open,
        cords=cords,
    )


def _below_padding(sections: list[AirSection], padding: NDArray[np.bool_]) -> list[AirSection]:
    """Return the sections below the lowest section that touches padding."""
    for n, section in enumerate(sections):
        if (dilate(section.air, SIDES) & section.window_of(padding)).any():
            return sections[:n]
    return sections


def _above_a_bronchus(
    soft: SoftenedCt, seeds: list[tuple[int, int, int]], sections: list[AirSection]
) -> TopOfTrachea | None:
    """Return the trachea above a bronchus that was treated as the trachea; None if the seeds are in the trachea."""
    trachea = sections[carina_of(sections) :]
    above = [section for section in trachea if section.k > seeds[0][2]]
    below = [section.area_mm2 for section in sections if section.k <= seeds[0][2]]
    if not above or not below or above[-1].centre_lps[2] - above[0].centre_lps[2] < SURE_TRACHEA_MM:
        return None
    if np.median([section.area_mm2 for section in above]) < WIDER_ABOVE * np.median(below):
        return None
    top = above[-1]
    return TopOfTrachea(
        seeds=[section.voxel for section in reversed(trachea)],
        start=as_point(soft.volume.to_lps(np.array(top.voxel, dtype=np.float64))),
        searched=soft,
        upper_zyx=None,
        sections=[],
        tip_lps=None,
        cut=[],
        starts_in_it=False,
        is_open=False,
        cords=None,
    )


def without_tube(top: TopOfTrachea, lowest: tuple[int, int, int], scale: AirScale, stage: Stages) -> NDArray[np.int16]:
    """Return a copy of the searched values (nz, ny, nx) with air in place of the tube wall.

    The tube is also removed below ``lowest`` (i, j, k).
    """
    volume = top.searched.volume
    values = volume.hu_zyx.copy()
    below = follow_up(volume, scale, scale.level(AIR_END_HU), lowest, stage, down=True)
    for section in [*top.sections, *(s for s in below if s.septum_mm2 >= SEPTUM_MM2)]:
        section.window_of(values)[section.whole] = round(scale.level(-1000.0))
    return values


def _is_tracheostomy(trachea: list[AirSection], tube: Tube | None) -> bool:
    """Return whether a tube ends in the trachea while the air at its upper end passes forwards out of the neck."""
    if tube is None or tube.last + 3 >= len(trachea):
        return False
    beside = trachea[max(tube.last - 3, 0) : tube.last + 4]
    # Exclude sections where fluid surrounds the tube.
    usual = float(np.median([section.area_mm2 for section in trachea]))
    return beside[-1].area_mm2 >= 0.6 * usual and any(section.leaves_in_front for section in beside)


def _upper_airway(volume: Volume, scale: AirScale, above: list[AirSection], top_k: int) -> NDArray[np.uint8]:
    """Return a mask of the air connected to the sections above the trachea.

    If this air is open to the outside, the mask contains only the sections.
    """
    mask = np.zeros(volume.shape_zyx, dtype=np.uint8)
    if not above:
        return mask
    level = round(scale.level(AIR_END_HU))
    found, _ = flood_lumen(
        np.ascontiguousarray(volume.hu_zyx[top_k + 1 :]),
        volume.lps_from_ijk,
        [(s.voxel[0], s.voxel[1], s.voxel[2] - top_k - 1) for s in above],
        first_level=level,
        core_level=level,
        last_level=level,
        leak_mm3=MAX_THROAT_MM3,
        small_leak_mm3=MAX_THROAT_MM3,
        closed_radius_mm=1.0,
        min_contrast=0.0,
    )
    mask[top_k + 1 :] = found
    for section in above:
        section.window_of(mask)[section.air] = 1
    return mask


def notes_of(top: TopOfTrachea, branches: tuple[Branch, ...]) -> list[Note]:
    """Return the permanent notes about the top of the trachea."""
    notes: list[Note] = []
    if top.cords is not None and top.cords.root_above_carina_mm is not None:
        words = (
            "the scan continues above the trachea, but the vocal cords were not identified: the tree begins "
            f"{top.cords.root_above_carina_mm:.0f} mm above the carina, where most tracheas begin; check its start in "
            "the slices"
        )
        notes.append(Note(LARYNX, words, badge=True))
    elif top.cords is not None:
        words = (
            f"the scan includes the larynx: the tree begins about {top.cords.cricoid_above_root_mm:.0f} mm below the "
            f"cricoid ({top.cords.above_root_mm:.0f} mm below the vocal cords); the larynx and the throat above it are "
            "upper airway and not part of the tree"
        )
        notes.append(Note(LARYNX, words, badge=True))
    if top.tip_lps is not None:
        name = "a tracheostomy tube" if top.is_open else "a tracheal tube"
        above_mm = _to_carina(branches, top.tip_lps)
        tip = f"its tip {above_mm:.0f} mm above the carina"
        if top.starts_in_it:
            # The tip is below the lowest followed section, which is at the carina unless the search went wrong.
            tip = "its tip at or below the carina" if above_mm < AT_CARINA_MM else f"{tip} or lower"
        words = f"{name} is in the trachea, {tip}; the air inside and around it is treated as one trachea"
        notes.append(Note(TUBE, words, badge=True))
    elif top.is_open:
        words = (
            "the trachea is open to the air outside through the front of the neck (a tracheostomy without a tube); "
            "the opening is not part of the tree"
        )
        notes.append(Note(TUBE, words, badge=True))
    return notes


def _to_carina(branches: tuple[Branch, ...], point: NDArray[np.float64]) -> float:
    """Return the length (mm) along the trachea from the place nearest to a point down to the carina.

    A short stub beside a tube is not the carina: the trachea continues as long as one child carries nearly all branches
    below.
    """
    size = [1] * len(branches)
    # Parents come before their children, so the reversed order adds each child before its parent.
    for branch in reversed(branches):
        if branch.parent is not None:
            size[branch.parent] += size[branch.id]
    line = [branches[0]]
    while line[-1].children:
        largest = max(line[-1].children, key=lambda child: size[child])
        if size[largest] < MAX_BELOW * (size[line[-1].id] - 1):
            break
        line.append(branches[largest])
    points = np.concatenate([branch.points for branch in line])
    nearest = int(np.argmin(np.linalg.norm(points - point, axis=1)))
    return float(np.linalg.norm(np.diff(points[nearest:], axis=0), axis=1).sum())
