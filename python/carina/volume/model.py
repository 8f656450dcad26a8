"""The volume on which all parts of Carina work: int16 values ``[z, y, x]`` and their position in LPS, mm."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from carina import _core
from carina.argument_checks import array_of, check_arguments, check_fields, coordinates, flag, instance, text_of
from carina.display import one_line
from carina.display.html import caption, figure, picture
from carina.display.slices import middle_slices
from carina.errors import GeometryError
from carina.volume.licence_notice import Citation

MAX_THICKNESS_MM = 20.0
"""Maximum thickness in mm of a chest CT's slices; a larger value of the tag has another unit or is a default."""
SPACING_MM = (0.01, 100.0)
"""Minimum and largest voxel spacing of any volume, in mm; values outside come from a lost unit or a false header."""
LUNG_WINDOW_HU = (1500.0, -600.0)
SLICE_HEIGHT_PX = 240


@one_line
@dataclass(frozen=True, slots=True)
class Remark:
    """A code for programs with a message for the user."""

    code: str
    """Stable code: ``import.clipped``, ... The list is in ``docs/import-answers.md``."""
    words: str
    """Text for the user, a part of a sentence, without a patient's name or a UID."""


@one_line
@dataclass(frozen=True, slots=True)
class Note(Remark):
    """A remark about a case for the user."""

    badge: bool = False
    """Whether the remark puts values or geometry in doubt; such remarks are part of all results of the case."""

    def __post_init__(self) -> None:
        """Raise an error for fields of a wrong type."""
        check_fields(self, code=text_of(200), words=text_of(20_000), badge=flag)

    def to_json(self) -> dict[str, str | bool]:
        """Return the note as plain JSON types, as every ``--json`` option prints it."""
        return {"code": self.code, "words": self.words, "badge": self.badge}


@one_line
@dataclass(frozen=True, slots=True)
class SeriesInfo:
    """One series in a folder, without the patient's name."""

    key: str
    """Short stable key to choose the series: its number, with a counter if needed, never a UID."""
    modality: str
    description: str
    num_slices: int
    shape_zyx: tuple[int, int, int] | None = None
    refused: str | None = None
    """Reason why the series cannot be opened; None if it can."""
    height_mm: float | None = None
    """Height that the slices cover, mm; None if the series is refused."""
    slice_distance_mm: float | None = None
    """Distance of neighbouring slices, mm; None if the series is refused."""
    thickness_mm: float | None = None
    """SliceThickness of all slices, mm; None without one common value."""
    kernel: str = ""
    """Reconstruction kernel, in lower case; empty if the slices state none or several."""
    phase: str = ""
    """Phase of breathing or of the heart, or time point; empty if the slices state none or several."""
    likeliest: str = ""
    """Why this series is the likeliest chest CT of its folder; empty for every other series."""
    acquired_on: str | None = field(default=None, repr=False)
    """ISO date of the scan, only for the list in the window of this user; see :attr:`VolumeSource.acquired_on`."""

    def to_json(self) -> dict[str, Any]:
        """Return the facts as plain JSON types, without the date, which can help to identify a patient."""
        found = asdict(self)
        del found["acquired_on"]
        return found


@one_line
@dataclass(frozen=True, slots=True)
class VolumeSource:
    """The origin of a volume, as texts for the user without a patient's name or a UID."""

    format: str
    """Format of the data: ``dicom``, ``nifti``, ``nrrd``, ``metaimage``, ``phantom`` or ``array``."""
    title: str
    """Series description or file name, for the title bar."""
    series: SeriesInfo | None = None
    other_series: tuple[SeriesInfo, ...] = ()
    notes: tuple[Note, ...] = ()
    """Notes for the user, for example on clipped values or on further series."""
    citation: Citation | None = None
    """Source and licence that must be shown with the data of the bundled case; None for other volumes."""
    acquired_on: str | None = field(default=None, repr=False)
    """ISO date of the scan; None if its files contain none.

    The date is used only in this user's own list of cases, to distinguish two scans. No file, message or log contains
    the date, because it can help to identify a patient.
    """
    slice_thickness_mm: float | None = None
    """SliceThickness of DICOM in mm: the thickness of tissue that one slice averages; None without one common value."""
    interpolated_slices: tuple[int, ...] = ()
    """Indices k of slices that were missing in the files and were interpolated; a badge names them."""
    tilt_deg: float | None = None
    """Gantry tilt in degrees that was corrected by resampling, with a badge; None for a scan without tilt."""
    slice_places: tuple[float, ...] = field(default=(), repr=False)
    """Position of each slice of the files as an index k, which may be a fraction; empty without a correction."""
    inserted: tuple[str, ...] = ()
    """Descriptions of structures that were inserted for training (`carina.insert_nodule`), with a badge."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Texts of all notes about the volume."""
        return tuple(note.words for note in self.notes)


@dataclass(frozen=True, slots=True, eq=False)
class Volume:
    """A chest CT (or another int16 volume) on a regular grid.

    ``hu_zyx`` is C-contiguous ``(nz, ny, nx)`` int16, read-only: HU if ``is_hu``, otherwise the file's numbers.
    ``lps_from_ijk`` is 4x4 float64; voxel (0, 0, 0) is the *centre* of the first voxel; its columns are the steps of
    one voxel along i, j, k in mm, each 0.01 to 100 mm long. ``numpy.asarray`` returns ``hu_zyx``.

    Examples
    --------
    >>> import numpy as np
    >>> import carina
    >>> volume = carina.Volume(np.zeros((4, 5, 6), dtype=np.int16), np.diag([0.7, 0.7, 1.25, 1.0]))
    >>> volume
    Volume(shape_zyx=(4, 5, 6), spacing_mm=(0.7, 0.7, 1.25), HU)
    >>> np.asarray(volume) is volume.hu_zyx
    True
    """

    hu_zyx: NDArray[np.int16]
    lps_from_ijk: NDArray[np.float64]
    is_hu: bool = True
    not_hu_reason: str | None = None
    source: VolumeSource = field(default_factory=lambda: VolumeSource(format="array", title="volume"))
    _range: tuple[int, int] | None = field(default=None, init=False, repr=False)
    _quality: Any = field(default=None, init=False, repr=False)
    """Cached result of the quality gate."""
    _digest: str | None = field(default=None, init=False, repr=False)
    """Cached result of ``ct_digest``."""
    _assessment: Any = field(default=None, init=False, repr=False)
    """Cached result of ``carina.track.assess_ct`` without airways."""

    def __post_init__(self) -> None:
        """Check the arrays, and make them read-only."""
        check_fields(
            self,
            hu_zyx=instance(np.ndarray, "give an array (nz, ny, nx) of int16"),
            is_hu=flag,
            not_hu_reason=text_of(optional=True),
            source=instance(VolumeSource, "give a carina.volume.VolumeSource"),
        )
        check_fields(self, GeometryError, "geometry.transform", lps_from_ijk=array_of(4, 4, largest=1e6))
        values = self.hu_zyx
        if values.ndim != 3 or 0 in values.shape:
            msg = f"a volume needs three axes with at least one voxel each; found shape {values.shape}"
            raise GeometryError(msg, code="geometry.shape")
        if values.dtype != np.int16 or not values.flags.c_contiguous:
            msg = f"voxel values must be C-contiguous int16; found {values.dtype}"
            raise GeometryError(msg, code="geometry.dtype")
        matrix = np.array(self.lps_from_ijk, dtype=np.float64)
        if matrix.shape != (4, 4) or not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:3, :3])) == 0.0:
            msg = "lps_from_ijk must be a finite, invertible 4x4 matrix"
            raise GeometryError(msg, code="geometry.transform")
        spacing = np.linalg.norm(matrix[:3, :3], axis=0)
        # float32 headers round, so 0.01 mm may be read as a slightly smaller number.
        if spacing.min() < SPACING_MM[0] * (1 - 1e-6) or spacing.max() > SPACING_MM[1] * (1 + 1e-6):
            found = ", ".join(f"{s:g}" for s in spacing)
            msg = f"the voxel spacing must be between {SPACING_MM[0]:g} and {SPACING_MM[1]:g} mm; found {found} mm"
            raise GeometryError(msg, code="geometry.spacing")
        values = values.view()
        values.flags.writeable = False
        matrix.flags.writeable = False
        object.__setattr__(self, "hu_zyx", values)
        object.__setattr__(self, "lps_from_ijk", matrix)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the parts for pickle and copy, including cached results."""
        return _volume_of, ({one.name: getattr(self, one.name) for one in fields(self)},)

    def __repr__(self) -> str:
        """Return the shape, the spacing and the unit."""
        unit = "HU" if self.is_hu else "not HU"
        sx, sy, sz = self.spacing_mm
        return f"Volume(shape_zyx={self.shape_zyx}, spacing_mm=({sx:.4g}, {sy:.4g}, {sz:.4g}), {unit})"

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """Return ``hu_zyx`` for ``numpy.asarray``; the array is copied only for another type or on request."""
        return np.array(self.hu_zyx, dtype=dtype, copy=copy)

    def _repr_html_(self) -> str:
        """Return three slices through the middle as HTML for notebooks, without file name and series text.

        File names and series texts may contain a patient's name.
        """
        low, high = self.value_range
        width, level = LUNG_WINDOW_HU if self.is_hu else (float(max(1, high - low)), (high + low) / 2.0)
        slices = middle_slices(self.hu_zyx, self.lps_from_ijk, (width, level), height_px=SLICE_HEIGHT_PX)
        (nz, ny, nx), (sx, sy, sz) = self.shape_zyx, self.spacing_mm
        lines = [
            f"{nx} × {ny} × {nz} voxels of {sx:.3g} × {sy:.3g} × {sz:.3g} mm, {'in HU' if self.is_hu else 'not in HU'}",
            "axial, coronal and sagittal slices through the centre, with patient right or anterior on the left; "
            f"window {width:g}, level {level:g}{' HU' if self.is_hu else ''}",
            *(f"! {note.words}" for note in badges_of(self)),
        ]
        if self.source.citation is not None:
            lines.append(str(self.source.citation))
        drawn = "".join(picture(rgb, f"{name} slice") for name, rgb in slices.items())
        return figure(f"<div>{drawn}</div>", caption(lines))

    @property
    def shape_zyx(self) -> tuple[int, int, int]:
        """Shape of the array of voxels."""
        nz, ny, nx = self.hu_zyx.shape
        return nz, ny, nx

    @property
    def value_range(self) -> tuple[int, int]:
        """The smallest and the largest value; computed at the first access and cached."""
        if self._range is None:
            object.__setattr__(self, "_range", _core.value_range(self.hu_zyx))
        assert self._range is not None
        return self._range

    @property
    def spacing_mm(self) -> tuple[float, float, float]:
        """Distance of voxel centres along i, j, k in mm."""
        sx, sy, sz = np.linalg.norm(self.lps_from_ijk[:3, :3], axis=0)
        return float(sx), float(sy), float(sz)

    @property
    def ijk_from_lps(self) -> NDArray[np.float64]:
        """Transform (4x4) from LPS mm to voxels, the inverse of ``lps_from_ijk``."""
        return np.asarray(np.linalg.inv(self.lps_from_ijk), dtype=np.float64)

    @check_arguments(points_ijk=coordinates(1e45))
    def to_lps(self, points_ijk: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert voxel coordinates ``(..., 3)`` to LPS mm."""
        return np.asarray(points_ijk, dtype=np.float64) @ self.lps_from_ijk[:3, :3].T + self.lps_from_ijk[:3, 3]

    @check_arguments(points_lps=coordinates(1e45))
    def to_ijk(self, points_lps: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert LPS mm ``(..., 3)`` to voxel coordinates."""
        inverse = self.ijk_from_lps
        return np.asarray(points_lps, dtype=np.float64) @ inverse[:3, :3].T + inverse[:3, 3]

    @property
    def centre_lps(self) -> NDArray[np.float64]:
        """Centre of the grid, LPS mm."""
        nz, ny, nx = self.shape_zyx
        return self.to_lps(np.array([(nx - 1) / 2, (ny - 1) / 2, (nz - 1) / 2]))

    @check_arguments(point_lps=array_of(3, largest=1e45))
    def contains_lps(self, point_lps: NDArray[np.float64]) -> bool:
        """Return whether a point is inside the grid, which extends half a voxel beyond the outer voxel centres."""
        nz, ny, nx = self.shape_zyx
        ijk = self.to_ijk(point_lps)
        return bool(np.all(ijk >= -0.5) and np.all(ijk <= np.array([nx, ny, nz]) - 0.5))


def _volume_of(values: dict[str, Any]) -> Volume:
    """Return the volume of a pickle, read-only, with its cached results."""
    found = {name: values.pop(name) for name in ("_range", "_quality", "_digest", "_assessment")}
    volume = Volume(**values)
    for name, value in found.items():
        object.__setattr__(volume, name, value)
    return volume


def badges_of(volume: Volume, airways: object | None = None) -> tuple[Note, ...]:
    """Return the permanent notes of a case, which are part of all its results; empty if nothing is in doubt.

    If the values are not HU, a note with the code ``import.not-hu`` states it.

    Parameters
    ----------
    volume
        The CT.
    airways
        Airways found in the CT, or another object with ``badges``; None without airways.
    """
    badges = [note for note in volume.source.notes if note.badge]
    if not volume.is_hu:
        reason = volume.not_hu_reason or "it is not in Hounsfield units"
        badges.insert(0, Note("import.not-hu", f"not HU: {reason}", badge=True))
    badges.extend(getattr(airways, "badges", ()))
    return tuple(dict.fromkeys(badges))
