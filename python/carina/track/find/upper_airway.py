"""Detection of the upper end of the trachea (at the cricoid, below the vocal cords) and of a tube in the trachea."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.track.find.air_upwards import SEPTUM_HU, SEPTUM_MM2, AirSection, dilate, disc
from carina.track.find.chest_size import longest_trachea_mm, usual_trachea_mm
from carina.track.intensity_levels import AirScale
from carina.volume.model import Volume

# Minimum height above the carina at which the vocal cords are searched, in diameters of the trachea. The cords of an
# adult are 7 diameters above the carina, those of a newborn 8.
MIN_DIAMETERS = 4.0
# Minimum height at which the cords are searched if the sections start inside a tube, in diameters of the trachea: these
# sections begin above the tip of the tube, some way above the carina.
MIN_DIAMETERS_IN_A_TUBE = 2.0
# Length in mm of visible trachea below which only its lowest part is compared with the sections above.
SHORT_MM = 15.0
# Share of the trachea's width below which a section is the cone below the cords or a stenosis.
NARROW_WIDTH = 0.7
# Share of the trachea's area below which a section is the cone below the cords or a stenosis.
NARROW_AREA = 0.6
# Maximum ratio of the width (left-right) to the depth (front-back) of a section that counts as a slit.
SLIT = 0.6
# Ratio of a section's width to that of the trachea from which the section counts as throat (pharynx).
THROAT_WIDTH = 1.3
# Height in mm above a narrow place up to which sections are searched for more trachea, which shows that the narrow
# place is a stenosis.
ABOVE_MM = 45.0
# Minimum length in mm of trachea above a narrow place that shows that the place is a stenosis.
TRACHEA_ABOVE_MM = 20.0
# Least length in mm between two narrow places round a tube that shows that trachea follows above the fluid on its cuff.
TRACHEA_ABOVE_TUBE_MM = 9.0
# Greatest length in mm of a larynx, from the cone below the true cords to the wide part of the vestibule.
LONGEST_MM = 40.0
# Length in mm of the larynx above the cords; cords that fluid hides are placed this far below the larynx's upper end.
ABOVE_CORDS_MM = 20.0
# Range of heights in mm of an adult's cords above the lower border of the cricoid, scaled in smaller and larger
# people.
CORDS_ABOVE_CRICOID_MM = (18.0, 25.0)
# Distance in mm of the tree's start below an adult's cords, which is below the cricoid; scaled in smaller people.
BELOW_THE_CORDS_MM = 26.5
# Maximum distance in mm of the tree's start below the cricoid in larger people: the tree begins at the middle of the
# heights within this distance for every position of the cords.
LESS_BELOW_CRICOID_MM = 9.0
# Diameter of an adult's trachea, mm.
ADULT_DIAMETER_MM = 17.3
# Height in mm of an adult's cords above the lowest section, which is just below the carina.
ADULT_CORDS_MM = 146.0
# Range of relative sizes of the trachea in which the larynx has an adult's size; outside it the larynx scales with the
# trachea.
ADULT_SIZES = (0.92, 1.0)
# Limits of the size of a larynx relative to an adult's; an estimate outside them is set to the limit.
SIZES = (0.4, 1.2)
# Minimum extent in mm (left-right and front-back) of a CT of a neck or a head, also of a child's.
MIN_NECK_MM = 90.0
# Height in mm above the narrow part's lower end in which the true vocal cords are searched: the length of the cone
# below them.
CONE_MM = 9.0
# Range of areas of sections that belong to the trachea, as shares of the median area above the carina.
AREAS_OF_TRACHEA = (0.6, 1.6)
# Length in mm of a gap between sections of the trachea, above which the trachea counts as ended.
CARINA_GAP_MM = 4.0
# Ratio of a section's area to the trachea's above which the section is throat, or air outside the body.
WIDEST = 2.5
# Length in mm below which a bright ring in the trachea does not count as a tube.
MIN_TUBE_MM = 12.0
# Minimum median value in HU of plastic between air and air, also after blur by thick slices; noise is only just above
# -800 HU.
MIN_PLASTIC_HU = -600.0
# Minimum peak value in HU of a tube whose wall touches the wall of the trachea all round.
LINE_HU = 500.0
LINE_NOISES = 8.0
"""Minimum brightness of a tube's radiopaque line above water, in standard deviations of the noise."""
# Maximum area of the air in a tube that fills the trachea, as a share of the trachea's area.
TIGHT_AREA = 0.55
# Length in mm below which a narrow part of the trachea does not count as a tube that fills the trachea.
MIN_TIGHT_MM = 25.0
# Minimum ratio of the depth of a section beside an opening in the front of the neck to the depth of the trachea.
DEEPER = 1.12
# Maximum ratio of a section's depth to the trachea's at which the trachea counts as complete again above an opening.
COMPLETE_DEPTH = 1.3
# Height in mm below and above an opening in the neck in which the tube through it dents the front of the trachea.
DENT_MM = 8.0
# Share of the trachea's area below which the air round a tube shows that fluid surrounds the tube.
LITTLE_AREA = 0.8
# Extent in mm of the search for an opening in the front of the neck, to the front.
FORWARD_MM = 160.0
# Extent in mm of the search for an opening in the neck, to each side.
ASIDE_MM = 25.0
# Extent in mm of the search for an opening in the neck, up and down.
UP_DOWN_MM = 30.0
# Value in HU below which a voxel in front of the neck counts as open air, so that an opening is there.
OPEN_AIR_HU = -900.0
# Highest mean in HU of a block of air outside the body (that of lung is higher), and side of the block in mm.
PURE_AIR_HU, PURE_AIR_MM = -940.0, 7.0
# Minimum distance in mm of the air outside the body in front of the middle of the trachea.
FRONT_MM = 25.0
# Ratio of a section's area to the trachea's above which the section is lung: noise has opened the wall between them.
LUNG_AREA = 5.0
# Minimum volume in mm3 of air outside the body, without the trachea's own air.
OUTSIDE_MM3 = 12_000.0


@dataclass(frozen=True, slots=True)
class Cords:
    """Position of the vocal cords in a stack of sections, and the root of the tree below them."""

    at: int
    """Index of the section at the vocal cords."""
    begins_at: int
    """Index of the first section below the cricoid, where the tree begins."""
    above_root_mm: float
    """Height in mm of the section with index ``at`` above the root of the tree."""
    root_above_carina_mm: float | None = None
    """Height of the root above the carina, mm, if the cords were not seen; None if they were seen.

    Without visible cords, only the length shows that more than the trachea was followed.
    """
    size: float = 1.0
    """Size of the larynx relative to an adult's larynx."""

    @property
    def are_visible(self) -> bool:
        """Whether the cords were seen in the sections."""
        return self.root_above_carina_mm is None

    @property
    def cricoid_above_root_mm(self) -> float:
        """Expected height of the lower border of the cricoid above the root, in mm."""
        return self.above_root_mm - 0.5 * sum(CORDS_ABOVE_CRICOID_MM) * self.size


@dataclass(frozen=True, slots=True)
class Tube:
    """Tube in the trachea, as a range of sections."""

    first: int
    """Index of the section at the tip (lowest section) of the tube; ``last`` is that of its upper end."""
    last: int


def _heights(sections: list[AirSection]) -> NDArray[np.float64]:
    return np.array([section.centre_lps[2] for section in sections])


def _typical_size(
    sections: list[AirSection], heights: NDArray[np.float64], tube: Tube | None, *, within_mm: float = 60.0
) -> tuple[float, float, float]:
    """Return the median width, depth and area of the trachea's lower sections, below the tip of any tube."""
    stop = len(sections) if tube is None else max(tube.first - 1, 1)
    lower = [s for s, z in zip(sections[:stop], heights[:stop], strict=True) if z - heights[0] <= within_mm]
    rows = np.array([[s.width_mm, s.depth_mm, s.area_mm2] for s in lower])
    width, depth, area = np.median(rows, axis=0)
    return float(width), float(depth), float(area)


def find_tube(sections: list[AirSection]) -> Tube | None:
    """Return the tube among the sections, or None if there is no tube.

    A tube shows as plastic or metal between the air in it and the air round it. If it fills the trachea, it shows as a
    narrow round lumen with a line as bright as its radiopaque marker all along. Both must be brighter than the noise.
    """
    heights = _heights(sections)
    open_all = float(np.median([s.area_mm2 for s in sections[: max(len(sections) // 3, 1)]]))
    peaks = np.array([s.peak for s in sections])
    plastic_hu = np.array([s.septum_hu for s in sections])
    line_hu = max(LINE_HU, LINE_NOISES * float(np.median([s.noise_hu for s in sections])))
    shows = np.array([s.septum_mm2 >= SEPTUM_MM2 for s in sections])
    tight = np.array([s.area_mm2 <= TIGHT_AREA * open_all and s.peak >= line_hu for s in sections])
    for signs, least_mm in ((shows, MIN_TUBE_MM), (shows | tight, MIN_TIGHT_MM)):
        runs = [
            (first, last)
            for first, last in _runs(signs, heights, gap_mm=4.0)
            if heights[last] - heights[first] >= least_mm
            and _is_bright(peaks[first : last + 1], heights[last] - heights[first])
            and _is_plastic(plastic_hu[first : last + 1][shows[first : last + 1]])
        ]
        if runs:
            return Tube(runs[0][0], runs[-1][1])
    return None


def _is_bright(peaks: NDArray[np.float64], length_mm: float) -> bool:
    """Return whether a tube shows as plastic or metal in most slices, or in some slices of a long tube."""
    share = 0.9 if length_mm >= MIN_TIGHT_MM else 0.6
    return bool(np.quantile(peaks, share) >= SEPTUM_HU)


def _is_plastic(septum_hu: NDArray[np.float64]) -> bool:
    """Return whether the material between two parts of air is brighter than noise, as plastic is.

    Without such material the result is True: the wall of the tube then touches the wall of the trachea.
    """
    return not len(septum_hu) or bool(np.median(septum_hu) >= MIN_PLASTIC_HU)


def _runs(signs: NDArray[np.bool_], heights: NDArray[np.float64], *, gap_mm: float) -> list[tuple[int, int]]:
    """Return the first and last indices of each run of True values; gaps up to ``gap_mm`` are bridged."""
    runs: list[tuple[int, int]] = []
    for n in np.flatnonzero(signs):
        if runs and (heights[n] - heights[runs[-1][1]] <= gap_mm or n == runs[-1][1] + 1):
            runs[-1] = (runs[-1][0], int(n))
        else:
            runs.append((int(n), int(n)))
    return runs


def find_cords(sections: list[AirSection], tube: Tube | None) -> Cords | None:
    """Return the vocal cords among the sections, or None if the scan or its air ends below them.

    Upwards, the trachea narrows to a slit, or to nothing where the cords are closed, and no trachea follows. A
    stenosis, in contrast, is followed by trachea. If the scan ends just above a narrow place, only a slit counts as
    cords. If no cords are visible and the sections are longer than any trachea, the tree begins at the usual length of
    a trachea.
    """
    heights = _heights(sections)
    typical = _typical_size(sections, heights, tube)
    diameter = 2.0 * float(np.sqrt(typical[2] / np.pi))
    least = MIN_DIAMETERS_IN_A_TUBE if tube is not None and tube.first == 0 else MIN_DIAMETERS
    for first, last in _larynges(sections, tube, typical, least * diameter):
        # The true cords have the first minimum of the area, since the false cords are above them, and are close above
        # the cone.
        areas = np.array([s.area_mm2 for s in sections[first : last + 1]])
        near = heights[first : last + 1] - heights[first] <= CONE_MM
        at = first + int(np.flatnonzero(near & (areas <= 1.1 * areas[near].min()))[0])
        if tube is not None and heights[last] - heights[first] > LONGEST_MM:
            # Fluid reaches up to the cords: only the upper end of the larynx is visible.
            at = int(np.flatnonzero(heights <= heights[last] - ABOVE_CORDS_MM)[-1])
        starts_in_it = tube is not None and tube.first == 0
        size = _larynx_size(diameter, None if starts_in_it else float(heights[at] - heights[0]))
        # The root is below the cricoid for every position of the cords, and nearest to the wanted height: slices may be
        # thick.
        below = np.flatnonzero(heights <= heights[at] - CORDS_ABOVE_CRICOID_MM[1] * size)
        if len(below):
            wanted = heights[at] - root_below_cords_mm(size)
            root = int(below[np.argmin(np.abs(heights[below] - wanted))])
            return Cords(at, root, float(heights[at] - heights[root]), size=size)
    carina = carina_of(sections)
    above = heights - heights[carina]
    usual_mm = 2.0 * float(np.sqrt(np.median([section.area_mm2 for section in sections]) / np.pi))
    if above[-1] > longest_trachea_mm(usual_mm):
        _, _, area_mm2 = _typical_size(sections[carina:], heights[carina:], None)
        is_trachea = np.array([section.area_mm2 <= WIDEST * area_mm2 for section in sections])
        root = int(np.flatnonzero((above <= usual_trachea_mm(usual_mm)) & is_trachea)[-1])
        return Cords(len(sections) - 1, root, float(above[-1] - above[root]), float(above[root]))
    return None


def carina_of(sections: list[AirSection]) -> int:
    """Return the index of the lowest section of the trachea; sections of bronchi may be below it."""
    heights = _heights(sections)
    areas = np.array([section.area_mm2 for section in sections])
    low, high = np.array(AREAS_OF_TRACHEA) * np.median(areas)
    like = (areas >= low) & (areas <= high)
    middle = len(sections) // 2
    for first, last in _runs(like, heights, gap_mm=CARINA_GAP_MM):
        if last >= middle:
            return min(first, middle)
    return 0


def root_below_cords_mm(size: float) -> float:
    """Return the distance (mm) of the root below the cords, for a size of the larynx relative to an adult's."""
    low, high = CORDS_ABOVE_CRICOID_MM
    return min(BELOW_THE_CORDS_MM * size, 0.5 * (high * size + low * size + LESS_BELOW_CRICOID_MM))


def _larynx_size(diameter_mm: float, cords_mm: float | None) -> float:
    """Return the size of the larynx relative to an adult's larynx.

    Parameters
    ----------
    diameter_mm
        Diameter of the trachea.
    cords_mm
        Height of the cords above the lowest section; None if the lowest section is not at the carina.
    """
    size = diameter_mm / ADULT_DIAMETER_MM
    if cords_mm is not None:
        size = 0.5 * (size + cords_mm / ADULT_CORDS_MM)
    size = min(size / ADULT_SIZES[0], 1.0) if size < ADULT_SIZES[1] else size / ADULT_SIZES[1]
    return min(max(size, SIZES[0]), SIZES[1])


def has_larynx(volume: Volume, sections: list[AirSection]) -> bool:
    """Return whether sections from the trachea upwards contain a larynx, even if few sections of trachea precede it.

    A volume smaller than a neck contains no larynx: it is a part of a chest, a specimen or a model.
    """
    width_mm, depth_mm = (n * mm for n, mm in zip(volume.shape_zyx[:0:-1], volume.spacing_mm[:2], strict=True))
    if len(sections) < 3 or min(width_mm, depth_mm) < MIN_NECK_MM:
        return False
    typical = _typical_size(sections, _heights(sections), None, within_mm=SHORT_MM)
    return bool(_larynges(sections, None, typical, 0.0))


def _larynges(
    sections: list[AirSection], tube: Tube | None, typical: tuple[float, float, float], least_mm: float
) -> list[tuple[int, int]]:
    """Return the first and last index of each narrow part like a larynx, ``least_mm`` or more above the first."""
    heights = _heights(sections)
    width, depth, area = typical
    up = heights - heights[0]
    found: list[tuple[int, int]] = []
    narrow = np.array([s.width_mm < NARROW_WIDTH * width or s.area_mm2 < NARROW_AREA * area for s in sections])
    # Closed cords show as missing slices.
    steps = np.diff(heights)
    usual = float(np.median(steps)) if len(steps) else 0.0
    for n in np.flatnonzero(steps > 2.5 * usual):
        narrow[n] = True
    runs = _runs(narrow, heights, gap_mm=1.5)
    for number, (first, last) in enumerate(runs):
        if up[first] < least_mm or first == 0:
            continue
        end = float(heights[last])
        above = [s for s, z in zip(sections[last + 1 :], heights[last + 1 :], strict=True) if z - end <= ABOVE_MM]
        if _is_trachea(above, width, depth, area):
            continue
        # Fluid above the cuff of a tube leaves only the tube's own lumen; some trachea follows above the fluid.
        if tube is not None and number + 1 < len(runs):
            following = heights[runs[number + 1][0]] - end
            if TRACHEA_ABOVE_TUBE_MM <= following <= ABOVE_MM:
                continue
        is_slit = min(s.width_mm / s.depth_mm for s in sections[first : last + 1]) <= SLIT
        is_throat = any(s.width_mm >= THROAT_WIDTH * width for s in above)
        is_shut = bool((steps[first : last + 1] > 2.5 * usual).any())
        if is_slit or is_throat or (is_shut and above):
            found.append((first, last))
    return found


def _is_trachea(above: list[AirSection], width: float, depth: float, area: float) -> bool:
    like = np.array(
        [
            0.75 * width <= s.width_mm <= 1.25 * width
            and 0.65 * area <= s.area_mm2 <= 1.35 * area
            and s.depth_mm <= 1.4 * depth
            for s in above
        ],
        dtype=np.bool_,
    )
    if not like.any():
        return False
    heights = _heights(above)
    return any(heights[b] - heights[a] >= TRACHEA_ABOVE_MM for a, b in _runs(like, heights, gap_mm=1.5))


def join_sections(
    volume: Volume, sections: list[AirSection], tube: Tube | None, stop: int, *, is_open: bool
) -> tuple[list[AirSection], list[tuple[AirSection, NDArray[np.bool_]]]]:
    """Return the first ``stop`` sections, each limited or extended to the air of the trachea alone.

    Where an opening leaves the trachea, the air reaches forward; where fluid surrounds a tube, only the tube's own
    lumen remains. Such sections are replaced by the sections below and above, moved to the line between those two.

    Returns
    -------
    list, list
        The sections, and each section that reached forward with the air that was cut off.
    """
    heights = _heights(sections)
    _, depth, area = _typical_size(sections, heights, tube)
    forward = np.array([is_open and (s.leaves_in_front or s.depth_mm > DEEPER * depth) for s in sections[:stop]])
    by_tube = np.arange(stop) <= (-1 if tube is None else tube.last + 3)
    little = np.array([s.area_mm2 < LITTLE_AREA * area for s in sections[:stop]]) & by_tube
    cut: list[tuple[AirSection, NDArray[np.bool_]]] = []
    own = list(sections[:stop])
    dx, dy, _ = volume.spacing_mm
    for begin, end in _runs(forward | little, heights, gap_mm=4.0):
        first, last = begin, end
        reaches = any(s.leaves_in_front for s in sections[first : last + 1]) and is_open
        if reaches:
            # The wall of the tube dents the front of the trachea a little below and above the opening too.
            first = int(np.flatnonzero(heights >= heights[first] - DENT_MM)[0])
            last = min(int(np.flatnonzero(heights <= heights[last] + DENT_MM)[-1]), stop - 1)
        first = max(first, 1)
        low = sections[first - 1]
        # The tree may begin beside the opening, so the next complete section may be above ``stop``.
        whole = (s for s in sections[last + 1 :] if not s.leaves_in_front and s.depth_mm <= COMPLETE_DEPTH * depth)
        high = next(whole, None)
        for n in range(first, last + 1):
            section = sections[n]
            share = 0.0 if high is None else (section.k - low.k) / (high.k - low.k)
            middle = low.centre_lps + share * ((high or low).centre_lps - low.centre_lps)
            i, j, _ = volume.to_ijk(middle)
            inside = _move_section(volume, low, (j, i), section)
            if high is not None:
                inside |= _move_section(volume, high, (j, i), section)
            air = section.air & inside if reaches else section.air
            if not air.any():
                continue
            cells = np.argwhere(air)
            off = np.hypot((cells[:, 0] + section.corner[0] - j) * dy, (cells[:, 1] + section.corner[1] - i) * dx)
            nearest = cells[int(np.argmin(off))] + section.corner
            own[n] = dataclasses.replace(
                section,
                air=air,
                whole=inside if reaches else section.whole | inside,
                voxel=(int(nearest[1]), int(nearest[0]), section.k),
                centre_lps=middle,
            )
            if reaches:
                cut.append((section, section.air & ~inside))
    return own, cut


def _move_section(
    volume: Volume, section: AirSection, middle: tuple[float, float], into: AirSection
) -> NDArray[np.bool_]:
    """Return the mask of a section with its centre moved to ``middle`` (j, i), in the window of another section."""
    i, j, _ = volume.to_ijk(section.centre_lps)
    shift = np.rint(np.subtract(middle, (j, i))).astype(int) + section.corner - into.corner
    cells = np.argwhere(section.whole) + shift
    cells = cells[((cells >= 0) & (cells < into.whole.shape)).all(axis=1)]
    out = np.zeros_like(into.whole)
    out[cells[:, 0], cells[:, 1]] = True
    return out


def opening_in_front(
    volume: Volume, scale: AirScale, sections: list[AirSection]
) -> tuple[tuple[slice, slice, slice], NDArray[np.bool_]] | None:
    """Return the air of an opening in the front of the neck that connects the trachea to the air outside.

    Returns
    -------
    tuple of slices, numpy.ndarray
        A part [z, y, x] of the volume, and a mask of the voxels in it that are air of the opening or outside, without
        the trachea's own air. None if there is no such opening.
    """
    cut = [s for s in sections if s.leaves_in_front]
    if not cut:
        return None
    _, _, usual_mm2 = _typical_size(sections, _heights(sections), None)
    if max(s.area_mm2 for s in sections) > LUNG_AREA * usual_mm2:
        return None
    dx, dy, dz = volume.spacing_mm
    nk, nj, ni = volume.shape_zyx
    low, high = cut[0].k, cut[-1].k
    around = int(UP_DOWN_MM / dz)
    k0, k1 = max(low - around, 0), min(high + around + 1, nk)
    middle_i, middle_j = (int(np.median([s.voxel[a] for s in cut])) for a in (0, 1))
    aside, forward = int(ASIDE_MM / dx), int(FORWARD_MM / dy)
    part = (
        slice(k0, k1),
        slice(max(middle_j - forward, 0), min(middle_j + int(10.0 / dy), nj)),
        slice(max(middle_i - aside, 0), min(middle_i + aside + 1, ni)),
    )
    air = volume.hu_zyx[part] < scale.level(OPEN_AIR_HU)
    own = np.zeros(air.shape, dtype=np.bool_)
    start = np.zeros(air.shape, dtype=np.bool_)
    for section in sections:
        if not k0 <= section.k < k1:
            continue
        at = np.argwhere(section.air) + section.corner - (part[1].start, part[2].start)
        inside = ((at >= 0) & (at < air.shape[1:])).all(axis=1)
        own[section.k - k0, at[inside, 0], at[inside, 1]] = True
        if section.leaves_in_front:
            start[section.k - k0] = dilate(own[section.k - k0], disc(1.5 * max(dx, dy), (dy, dx)))
    free = air & ~own
    reached = start & free
    size = -1
    while size != (size := int(reached.sum())):
        for _ in range(4):
            wider = reached.copy()
            for axis in range(3):
                ahead = [slice(None)] * 3
                behind = [slice(None)] * 3
                ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
                wider[tuple(ahead)] |= reached[tuple(behind)]
                wider[tuple(behind)] |= reached[tuple(ahead)]
            reached = wider & free
    pure = _is_pure_air(volume.hu_zyx[part], (dz, dy, dx), scale)
    # Exclude air near the trachea: it may be the trachea's own air, of which noise hides a part.
    pure[:, max(middle_j - int(FRONT_MM / dy) - part[1].start, 0) :] = False
    if size * dx * dy * dz < OUTSIDE_MM3 or int((reached & pure).sum()) * dx * dy * dz < OUTSIDE_MM3:
        return None
    return part, reached


def _is_pure_air(values: NDArray[np.int16], step_mm: tuple[float, float, float], scale: AirScale) -> NDArray[np.bool_]:
    """Return a mask (nz, ny, nx) of blocks whose mean value is that of air; single dark voxels of lung are excluded."""
    sizes = [max(round(PURE_AIR_MM / step), 1) for step in step_mm]
    padding = [(0, -n % size) for n, size in zip(values.shape, sizes, strict=True)]
    whole = np.pad(values, padding, mode="edge").astype(np.float32)
    (nz, ny, nx), (bz, by, bx) = whole.shape, sizes
    means = whole.reshape(nz // bz, bz, ny // by, by, nx // bx, bx).mean(axis=(1, 3, 5))
    pure = means <= scale.level(PURE_AIR_HU)
    for axis, size in enumerate(sizes):
        pure = np.repeat(pure, size, axis=axis)
    return np.asarray(pure[: values.shape[0], : values.shape[1], : values.shape[2]], np.bool_)
