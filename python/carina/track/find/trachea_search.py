"""Search for the trachea by its anatomy, then along its air so that its whole length is found."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina._core import find_trachea_voxels
from carina.errors import NoResultError
from carina.track.find.air_upwards import AirSection, follow_up
from carina.track.find.chest_size import longest_trachea_mm
from carina.track.find.root_checks import LUNG_HU, UP_FIRST_MM, has_lung
from carina.track.find.whole_trachea import (
    AIR_END_HU,
    MISSED_MM,
    begins_below_top,
    down_to_the_carina,
    trachea_sections,
    with_tissue_beside,
)
from carina.track.intensity_levels import AirScale
from carina.track.paths.tracker import Point, as_point
from carina.track.progress import Stages
from carina.volume.model import Volume

# HU levels. AirScale converts each one to the values of the volume. The search uses the first level that shows a
# trachea: a lower one if the wall between trachea and lung is thin, a higher one if the slices blur the trachea.
TRACHEA_AIR_HU = (-800.0, -900.0, -700.0)
# Minimum value in HU of the tissue that must surround a candidate for the trachea.
TISSUE_HU = -450.0

# Notes on a trachea that lacks one of its usual features.
TRACHEA_DOUBTS = {
    "cut-off": "the scan begins just above the carina and shows little of the trachea",
    "narrow-bronchus": (
        "the trachea may not have been identified correctly: one main bronchus is short or narrow; check the trachea "
        "and the main bronchi in the slices"
    ),
    "one-bronchus": (
        "the trachea may not have been identified correctly: it continues into only one main bronchus (the search "
        "lost the other one, or it is outside the scan); check the trachea and the main bronchi in the slices"
    ),
    "one-lung": (
        "the trachea may not have been identified correctly: there is aerated lung on one side only; check the "
        "trachea and the main bronchi in the slices"
    ),
}

# The lowest voxels of a trachea may be in one main bronchus. The air is followed down from a place this far above those
# voxels, so that the path reaches both main bronchi.
SURELY_ABOVE_MM = 20.0

NO_LUNGS = (
    "this scan shows no lungs, so the airways cannot be found: it may be a CT of the head or neck, where only the "
    "throat, the larynx and the upper trachea are visible; open a chest CT that includes the trachea and the lungs"
)


@dataclass(frozen=True, slots=True, eq=False)
class Trachea:
    """Trachea that the search found."""

    seeds: list[tuple[int, int, int]]
    """Voxels (i, j, k) of the trachea's air, from the top down."""
    top: Point
    """Uppermost voxel of the trachea, LPS in mm."""
    notes: list[str]
    """Doubts about the trachea, as texts for the user."""
    split_mm: float | None
    """Length of the trachea above the carina in mm; None if a main bronchus or a lung is missing."""
    diameters_mm: NDArray[np.float64]
    """Equivalent diameter of the trachea in each of its slices, (n,) mm."""
    carina_lps: NDArray[np.float64]
    """Position (3,) of the carina, LPS in mm."""


def trachea_in(
    values: NDArray[np.int16], volume: Volume, scale: AirScale, stage: Stages, *, painted: bool = False
) -> Trachea:
    """Find the trachea by its anatomy: a tube that divides into two main bronchi between the lungs.

    Parameters
    ----------
    values
        (nz, ny, nx) on the volume's grid: the volume's values, or a copy in which some air was replaced by tissue.
    painted
        Whether the values are a drawn lumen, which shows no lungs.

    Raises
    ------
    NoResultError
        If no tube is like a trachea; the message names the missing feature.
    """
    stage.begin("finding the trachea")
    lung = None if painted else (scale.level(LUNG_HU[0]), scale.level(LUNG_HU[1]))
    found, problem = None, ""
    for air_hu in TRACHEA_AIR_HU:
        try:
            other = find_trachea_voxels(
                values,
                volume.lps_from_ijk,
                air=scale.level(air_hu),
                tissue=scale.level(TISSUE_HU),
                lung=lung,
                cancel=stage.cancel,
            )
        except NoResultError as error:
            problem = problem or str(error)
            continue
        if found is None or (
            len(other["doubts"]) < len(found["doubts"])
            # A candidate far below the present one is a bronchus of the same airway, also if it has fewer doubts.
            and _top_z(volume, other) >= _top_z(volume, found) - UP_FIRST_MM
        ):
            found = other
        if not found["doubts"]:
            break
    if found is None:
        if not volume.is_hu:
            problem += ". The volume is not in HU: if its lowest values are clipped, lung and airway look alike"
        raise NoResultError(problem)
    voxels = found["voxels_ijk"]
    points = volume.to_lps(voxels)
    # Voxels farther from the carina than the length of the longest trachea belong to larynx and throat.
    longest_mm = longest_trachea_mm(float(np.median(found["diameters_mm"])))
    near = np.linalg.norm(points - found["carina_lps"], axis=1) <= longest_mm
    voxels, points = voxels[near], points[near]
    seeds = [(int(i), int(j), int(k)) for i, j, k in voxels]
    notes = [TRACHEA_DOUBTS[doubt] for doubt in found["doubts"]]
    is_whole = not {"one-bronchus", "one-lung"} & set(found["doubts"])
    length_mm = float(found["length_mm"]) if is_whole else None
    return Trachea(
        seeds, as_point(points[0]), notes, length_mm, found["diameters_mm"][near], np.asarray(found["carina_lps"])
    )


def _top_z(volume: Volume, found: dict[str, Any]) -> float:
    return float(volume.to_lps(found["voxels_ijk"][0])[2])


def found_trachea(volume: Volume, scale: AirScale, stage: Stages) -> Trachea:
    """Find the whole trachea of a CT, down to the carina.

    Raises
    ------
    NoResultError
        If there is no trachea; the message states whether the scan shows lungs.
    """
    try:
        trachea = trachea_in(volume.hu_zyx, volume, scale, stage)
    except NoResultError as error:
        if volume.is_hu and not has_lung(volume, scale):
            raise NoResultError(f"no trachea was found: {NO_LUNGS}") from error
        raise
    return whole_trachea(volume, scale, trachea, stage)


def whole_trachea(volume: Volume, scale: AirScale, trachea: Trachea, stage: Stages) -> Trachea:
    """Correct a trachea that was found to end above the carina or to begin below its top.

    Beside an oblique trachea, air in the oesophagus or in the top of a lung diverges from the trachea like a main
    bronchus. The trachea's own air is therefore followed down to the carina, and the search is repeated without the air
    beside it.
    """
    area = float(np.pi / 4.0 * np.median(trachea.diameters_mm) ** 2)
    heights = volume.to_lps(np.array(trachea.seeds, dtype=np.float64))[:, 2]
    start = trachea.seeds[int(np.flatnonzero(heights >= min(heights[-1] + SURELY_ABOVE_MM, heights[0]))[-1])]
    down = down_to_the_carina(volume, scale, start, stage, area_mm2=area)
    lowest = start if down is None or not down.divides else down.sections[-1].voxel
    ends_early = float(heights[-1] - volume.to_lps(np.array(lowest, dtype=np.float64))[2]) >= MISSED_MM
    top_k = trachea.seeds[0][2]
    reaches_top = (volume.shape_zyx[0] - 1 - top_k) * volume.spacing_mm[2] < MISSED_MM
    if not ends_early and reaches_top:
        return trachea
    sections = follow_up(volume, scale, scale.level(AIR_END_HU), lowest, stage)
    is_late = not reaches_top and begins_below_top(sections, top_k, area)
    if not ends_early and not is_late:
        return trachea
    try:
        again = trachea_in(with_tissue_beside(volume, scale, sections), volume, scale, stage)
    except NoResultError:
        again = None
    num_more = MISSED_MM / 2.0 / volume.spacing_mm[2]
    if (
        again is not None
        and len(again.notes) <= len(trachea.notes)
        and (not ends_early or again.seeds[-1][2] <= trachea.seeds[-1][2] - num_more)
        and (not is_late or again.seeds[0][2] >= top_k + num_more)
    ):
        return again
    return _along(volume, trachea, trachea_sections(sections, max(top_k, sections[0].k), area))


def trachea_round(volume: Volume, scale: AirScale, start: tuple[int, int, int], stage: Stages) -> Trachea | None:
    """Find the trachea from a voxel (i, j, k) in the air of the trachea, the larynx or the throat.

    Returns
    -------
    Trachea or None
        None if the air below does not divide into two main bronchi between the lungs.
    """
    down = down_to_the_carina(volume, scale, start, stage)
    if down is None or not down.divides:
        return None
    sections = follow_up(volume, scale, scale.level(AIR_END_HU), down.sections[-1].voxel, stage)
    if not sections:
        return None
    try:
        return trachea_in(with_tissue_beside(volume, scale, sections), volume, scale, stage)
    except NoResultError:
        return None


def _along(volume: Volume, trachea: Trachea, sections: list[AirSection]) -> Trachea:
    """Return the trachea extended by sections of its air above and below."""
    if not sections:
        return trachea
    own = {section.k for section in sections}
    diameters = {seed[2]: float(d) for seed, d in zip(trachea.seeds, trachea.diameters_mm, strict=True)}
    voxels = {seed[2]: seed for seed in trachea.seeds if seed[2] not in own}
    for section in sections:
        voxels[section.k] = section.voxel
        diameters.setdefault(section.k, 2.0 * float(np.sqrt(section.area_mm2 / np.pi)))
    order = sorted(voxels, reverse=True)
    seeds = [voxels[k] for k in order]
    ends = volume.to_lps(np.array([seeds[0], seeds[-1]], dtype=np.float64))
    carina = trachea.carina_lps if ends[1][2] >= trachea.carina_lps[2] else ends[1]
    return dataclasses.replace(
        trachea,
        seeds=seeds,
        top=as_point(ends[0]),
        split_mm=None if trachea.split_mm is None else float(np.linalg.norm(ends[0] - ends[1])),
        diameters_mm=np.array([diameters[k] for k in order]),
        carina_lps=carina,
    )
