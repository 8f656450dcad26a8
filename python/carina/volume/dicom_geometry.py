"""Grid of a DICOM series from the tags of every slice.

A series without a regular, rectangular grid is refused, unless its slices can be put on such a grid with certainty: a
tilted gantry (``tilt_correction``), a few missing slices (``missing_slices``) and uneven slice distances
(``uneven_slices``) are corrected, with a badge.

The third axis is the offset from slice to slice according to ImagePositionPatient (PS3.3 C.7.6.2.1.1). SliceThickness
is not used: it is the thickness of tissue that one slice averages, and overlapping slices or gaps are common.

Tolerances (each tested on both sides):

- along the normal, a slice may deviate from the regular grid by a tenth of the slice distance, at most 0.3 mm; 0.06 mm
  is always allowed, because some scanners round positions to 0.1 mm;
- across the normal, a slice may deviate by 0.1 mm or a tenth of a pixel, whichever is more;
- the stack may be sheared by 0.2 degrees, or by 0.1 mm over its whole height, whichever is more (tilts near zero occur
  and are harmless; ``lps_from_ijk`` contains the shear, so that no voxel is displaced); a larger shear is a tilt;
- directions and pixel spacings of all slices must agree so that the far corner of the image moves by less than 0.1 mm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.errors import VolumeImportError
from carina.volume.axis_angles import MAX_LEAN_MM, MAX_SKEW_DEG
from carina.volume.dicom_headers import SETTINGS, SliceHeader
from carina.volume.digest import Geometry
from carina.volume.missing_slices import fillable_levels, interpolated_note, missing_levels
from carina.volume.model import Note
from carina.volume.tilt_correction import MAX_TILT_DEG, TiltShifts
from carina.volume.uneven_slices import UnevenSlices, even_part

MAX_CORNER_SHIFT_MM = 0.1
CLEAR_DIRECTION = math.cos(math.radians(40.0))
"""Minimum component along an axis of the patient of a direction that is named after this axis."""


@dataclass(frozen=True, slots=True, eq=False)
class SliceStack:
    """The slices of a series in order, with the grid of the volume that is made of them."""

    slices: tuple[SliceHeader, ...]
    """Slices sorted by position along (row x column)."""
    grid: Geometry
    """Shape of the volume, and its transform from voxel centres to LPS mm."""
    levels: tuple[int, ...]
    """Index in the volume of each slice, or of the nearest even slice."""
    tilt: TiltShifts | None = None
    """Correction of the gantry tilt; None for a rectangular stack."""
    uneven: UnevenSlices | None = None
    """Resampling of uneven slice distances; None if each slice is a slice of the volume."""

    @property
    def lps_from_ijk(self) -> NDArray[np.float64]:
        """Transform (4x4) from voxel centres of the volume to LPS mm."""
        return self.grid.lps_from_ijk

    @property
    def shape_zyx(self) -> tuple[int, int, int]:
        """Number of voxels of the volume along z, y, x."""
        return self.grid.shape_zyx

    @property
    def missing(self) -> tuple[int, ...]:
        """Indices in the volume of interpolated slices, farther than half a slice distance from each measured one."""
        return missing_levels(self.levels)

    @property
    def places(self) -> tuple[float, ...]:
        """Position of each slice as an index of the volume, which is a fraction between even slices."""
        if self.uneven is None:
            return tuple(float(level) for level in self.levels)
        return tuple(round(float(place), 3) for place in self.uneven.places)

    @property
    def is_resampled(self) -> bool:
        """Whether voxels are interpolated within or between the slices because of a tilt or uneven distances."""
        return self.tilt is not None or self.uneven is not None

    @property
    def is_corrected(self) -> bool:
        """Whether voxels of the volume are not pixels of the slices."""
        return self.is_resampled or len(self.levels) < self.shape_zyx[0]

    @property
    def sources(self) -> tuple[tuple[int, tuple[int, ...]], ...]:
        """Indices in the volume of the slices with measured values, each with the indices of its measured slices."""
        if self.uneven is not None:
            return tuple(enumerate(self.uneven.sources))
        return tuple((level, (index,)) for index, level in enumerate(self.levels))

    @property
    def notes(self) -> tuple[Note, ...]:
        """Notes for the user that name the corrections of the geometry."""
        notes = []
        if self.tilt is not None:
            words = (
                f"the gantry was tilted by {self.tilt.tilt_deg:.1f} degrees{self.tilt.edge}; the slices were moved "
                "within their planes and interpolated to a rectangular grid, so the voxels are not the pixels of the "
                "scanner"
            )
            notes.append(Note("import.tilt-corrected", words, badge=True))
        if self.uneven is not None:
            notes.append(self.uneven.note())
        elif self.missing:
            notes.append(interpolated_note(self.missing, self.shape_zyx[0]))
        return tuple(notes)


def _tilted_edge(step: NDArray[np.float64], lean: NDArray[np.float64]) -> str:
    """Return the text that names the edge of tilted slices which is nearer to the feet; empty if it is not clear.

    Parameters
    ----------
    step
        Movement of the table from slice to slice, LPS in mm.
    lean
        Part of this movement in the plane of the slices, LPS in mm.
    """
    axis = int(np.argmax(np.abs(lean)))
    is_along_body = abs(step[2]) >= CLEAR_DIRECTION * float(np.linalg.norm(step))
    if not is_along_body or axis == 2 or abs(lean[axis]) < CLEAR_DIRECTION * float(np.linalg.norm(lean)):
        return ""
    # The table moves towards the edge in the direction of the lean, so the opposite edge lies behind it.
    is_low = bool(lean[axis] * step[2] < 0.0)
    edge = {0: ("right", "left"), 1: ("anterior", "posterior")}[axis][is_low]
    return f" (the {edge} edge of the slices is nearer to the feet)"


def _refuse(what: str, problem: str, way_out: str, code: str) -> VolumeImportError:
    return VolumeImportError(f"{what}: {problem}; {way_out}", code=code)


def _check_alike(slices: Sequence[SliceHeader], what: str) -> None:
    """Raise an error if slices differ in size, orientation or pixel spacing."""
    first = slices[0]
    extent_mm = math.hypot(first.columns * first.spacing_mm[0], first.rows * first.spacing_mm[1])
    way_out = "keep only the slices of one scan in the folder"
    for header in slices[1:]:
        if (header.rows, header.columns) != (first.rows, first.columns):
            problem = (
                f"its slices have mixed sizes: expected {first.columns} x {first.rows} pixels as in "
                f"{first.file_name}, found {header.columns} x {header.rows} in {header.file_name}"
            )
            raise _refuse(what, problem, way_out, "import.geometry.mixed")
        turn = max(math.dist(header.row_lps, first.row_lps), math.dist(header.column_lps, first.column_lps))
        if turn * extent_mm > MAX_CORNER_SHIFT_MM:
            problem = (
                f"its slices have mixed orientations: {header.file_name} is rotated by {math.degrees(turn):.2f} "
                f"degrees relative to {first.file_name}"
            )
            raise _refuse(what, problem, way_out, "import.geometry.mixed")
        stretch_mm = max(
            abs(header.spacing_mm[0] - first.spacing_mm[0]) * header.columns,
            abs(header.spacing_mm[1] - first.spacing_mm[1]) * header.rows,
        )
        if stretch_mm > MAX_CORNER_SHIFT_MM:
            problem = (
                f"its slices have mixed pixel spacing: expected {first.spacing_mm[0]:g} x {first.spacing_mm[1]:g} "
                f"mm as in {first.file_name}, found {header.spacing_mm[0]:g} x {header.spacing_mm[1]:g} mm in "
                f"{header.file_name}"
            )
            raise _refuse(what, problem, way_out, "import.geometry.mixed")


def _levels(
    along_mm: NDArray[np.float64], ordered: Sequence[SliceHeader], what: str, *, fills_gaps: bool
) -> tuple[NDArray[np.int64], UnevenSlices | None]:
    """Return the index of each slice in the volume, and the resampling of slices with uneven distances.

    An index that no slice has is that of a missing slice. Raises an error if two slices have one position, or if the
    distances of neighbouring slices are irregular and cannot be corrected.
    """
    count = len(ordered)
    gaps = np.diff(along_mm)
    # The median is the intended distance; one missing or duplicate slice does not change it.
    expected = float(np.median(gaps))
    doubled = np.flatnonzero(gaps <= max(0.01, 0.02 * expected))
    if doubled.size:
        at = int(doubled[0])
        problem = (
            f"{doubled.size + 1 if doubled.size == count - 1 else doubled.size} of its {count} slices lie at the "
            f"position of another slice, first {ordered[at].file_name} and {ordered[at + 1].file_name}; expected one "
            "slice at each position; the folder may contain the series twice, or several phases of one scan"
        )
        raise _refuse(what, problem, "keep one slice for each position", "import.geometry.duplicate")
    tolerance = min(max(0.1 * expected, 0.06), 0.3)
    wrong = np.flatnonzero(np.abs(gaps - expected) > 2 * tolerance)
    levels: NDArray[np.int64] | None = np.arange(count)
    limit = ""
    if wrong.size:
        levels, limit = fillable_levels(gaps, expected, 2 * tolerance)
        if levels is not None and (setting := _setting_that_changes(np.flatnonzero(np.diff(levels) > 1), ordered)):
            levels, limit = None, f"the slices on both sides of the gap differ in {setting}, so it is not interpolated"
        if not fills_gaps:
            levels = None
    off = np.zeros(count)
    if levels is not None:
        off = np.abs(along_mm - along_mm[0] - levels * (along_mm[-1] - along_mm[0]) / levels[-1])
        if float(off.max()) <= tolerance:
            return levels, None
    if fills_gaps and not limit:
        uneven, limit = UnevenSlices.of(along_mm)
        # The resampling interpolates in every gap, not only in those that differ from the usual one.
        if uneven is not None and not (setting := _setting_that_changes(np.arange(count - 1), ordered)):
            return uneven.levels, uneven
        limit = limit or f"neighbouring slices differ in {setting}, so the stack is not resampled"
    because = f" ({limit})" if limit else ""
    way_out = "copy the whole series again, or choose another series"
    if (part := even_part(gaps)) is not None:
        first, last = part
        way_out += (
            f", or copy only slices {first + 1} to {last + 1} ({ordered[first].file_name} to "
            f"{ordered[last].file_name}), which are {np.median(gaps[first:last]):.2f} mm apart, to a new folder"
        )
    if levels is not None:
        at = int(off.argmax())
        problem = (
            f"slice spacing is irregular: slice {at + 1} of {count} ({ordered[at].file_name}) lies {off[at]:.2f} "
            f"mm off the regular {expected:.2f} mm grid; expected at most {tolerance:.2f} mm{because}"
        )
        raise _refuse(what, problem, "choose another series", "import.geometry.irregular")
    at = int(wrong[0])
    more = f" (and at {wrong.size - 1} more places)" if wrong.size > 1 else ""
    missing = round(float(gaps[at]) / expected) - 1
    cause = (
        f"; {'a slice' if missing == 1 else f'{missing} slices'} may be missing from the series"
        if missing >= 1 and abs(gaps[at] - (missing + 1) * expected) <= 2 * tolerance
        else ""
    )
    problem = (
        f"slice spacing is irregular: expected {expected:.2f} mm, found {gaps[at]:.2f} mm after slice {at + 1} of "
        f"{count} ({ordered[at].file_name}){more}{cause}{because}"
    )
    raise _refuse(what, problem, way_out, "import.geometry.irregular")


def _setting_that_changes(gaps: NDArray[np.int64], ordered: Sequence[SliceHeader]) -> str:
    """Return the name of a setting with different values on both sides of one of the gaps; empty if there is none.

    Such slices may come from different reconstructions or breaths, between which nothing can be interpolated. A setting
    with a different value in nearly every slice (a time, a counter) does not separate them.
    """
    for number, name in enumerate(SETTINGS.values()):
        values = [header.settings[number] for header in ordered]
        if 2 * len(set(values)) <= len(values) and any(values[at] != values[at + 1] for at in gaps):
            return name
    return ""


def grid_from_slices(slices: Sequence[SliceHeader], *, what: str, fills_gaps: bool = True) -> SliceStack:
    """Sort the slices of one series along their normal and compute their grid.

    Parameters
    ----------
    slices
        In any order; none has a ``problem``.
    what
        Beginning of error messages, such as "reading series 3 (Thorax)".
    fills_gaps
        Whether a few missing slices may be interpolated, and uneven distances resampled.

    Returns
    -------
    SliceStack
        The sorted slices, the grid of the volume and its corrections.

    Raises
    ------
    VolumeImportError
        ``import.single-slice``, ``import.geometry.mixed``, ``.duplicate``, ``.irregular``, ``.shifted`` or ``.tilt``.
    """
    if len(slices) < 2:
        problem = f"it contains only one image ({slices[0].file_name}); expected a stack of slices"
        raise _refuse(what, problem, "choose the folder of the whole scan", "import.single-slice")
    _check_alike(slices, what)
    first = slices[0]
    row = np.array(first.row_lps)
    column = np.array(first.column_lps)
    # The directions are unit vectors, perpendicular within MAX_SKEW_DEG; the grid uses them unchanged.
    normal = np.cross(row, column)
    normal /= np.linalg.norm(normal)
    ordered = sorted(
        slices, key=lambda header: (float(normal @ np.array(header.position_lps)), str(header.path), header.frame or 0)
    )
    positions = np.array([header.position_lps for header in ordered])
    along = positions @ normal
    levels, uneven = _levels(along, ordered, what, fills_gaps=fills_gaps)

    step = (positions[-1] - positions[0]) / levels[-1]
    height = float(along[-1] - along[0])
    lean = positions[-1] - positions[0] - height * normal
    lean_mm = float(np.linalg.norm(lean))
    tilt_deg = math.degrees(math.atan2(lean_mm, height))
    is_tilted = tilt_deg > MAX_SKEW_DEG and lean_mm > MAX_LEAN_MM
    if is_tilted and tilt_deg > MAX_TILT_DEG:
        problem = (
            f"its slices are sheared by {tilt_deg:.1f} degrees, a shift of {lean_mm:.1f} mm from the first to the "
            f"last; expected a gantry tilt of at most {MAX_TILT_DEG:g} degrees"
        )
        way_out = "export the series with the tilt corrected, or choose another one"
        raise _refuse(what, problem, way_out, "import.geometry.tilt")
    line = positions[0] + (levels if uneven is None else uneven.places)[:, None] * step
    across = positions - line
    across = np.linalg.norm(across - np.outer(across @ normal, normal), axis=1)
    allowed = max(MAX_CORNER_SHIFT_MM, 0.1 * min(first.spacing_mm))
    if float(across.max()) > allowed:
        at = int(across.argmax())
        problem = (
            f"slice {at + 1} of {len(ordered)} ({ordered[at].file_name}) is shifted sideways by {across[at]:.2f} "
            f"mm; expected at most {allowed:.2f} mm"
        )
        raise _refuse(what, problem, "choose another series", "import.geometry.shifted")

    lps_from_ijk = np.eye(4)
    lps_from_ijk[:3, 0] = row * first.spacing_mm[0]
    lps_from_ijk[:3, 1] = column * first.spacing_mm[1]
    lps_from_ijk[:3, 2] = step
    lps_from_ijk[:3, 3] = positions[0]
    shape_yx, tilt = (first.rows, first.columns), None
    if is_tilted:
        offsets_mm = (positions - positions[0]) @ np.stack([row, column], axis=1)
        tilt = TiltShifts.of(tilt_deg, offsets_mm, first.spacing_mm, shape_yx, edge=_tilted_edge(step, lean))
        shape_yx = tilt.shape_yx
        lps_from_ijk[:3, 2] = normal * height / levels[-1]
        lps_from_ijk[:3, 3] += lps_from_ijk[:3, :2] @ np.array(tilt.first_yx[::-1], dtype=np.float64)
    shape_zyx = (int(levels[-1]) + 1, *shape_yx)
    return SliceStack(tuple(ordered), Geometry(shape_zyx, lps_from_ijk), tuple(levels.tolist()), tilt, uneven)
