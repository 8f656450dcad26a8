"""The volume every part works on: int16 values ``[z, y, x]`` and their place in patient space (LPS, mm)."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from carina import _core
from carina.argument_checks import array_of, check_arguments, check_fields, coordinates, flag, instance, text_of
from carina.display import one_line
from carina.display.html import caption, figure, picture
from carina.display.slices import middle_slices
from carina.errors import GeometryError
from carina.volume.citation import Citation

__all__ = ["SPACING_MM", "Note", "Remark", "SeriesInfo", "Volume", "VolumeSource", "badges_of"]

SPACING_MM = (0.01, 100.0)
"""The least and the largest distance of voxels in any volume. No scanner is outside; a lost unit or a lie is."""
LUNG_WINDOW_HU = (1500.0, -600.0)
SLICE_HEIGHT_PX = 240


@one_line
@dataclass(frozen=True, slots=True)
class Remark:
    """Something to be said, for programs and for people."""

    code: str
    """Stable, for programs: ``import.clipped``, ... The list is in ``docs/import-answers.md``."""
    words: str
    """A sentence part for the screen and the terminal, without a patient's name or a UID."""


@one_line
@dataclass(frozen=True, slots=True)
class Note(Remark):
    """One thing that a person should know about a case."""

    badge: bool = False
    """True where it puts the values or the geometry in doubt: it goes with the case wherever the case goes."""

    def __post_init__(self) -> None:
        check_fields(self, code=text_of(200), words=text_of(20_000), badge=flag)

    def to_json(self) -> dict[str, str | bool]:
        """Plain JSON types, as every ``--json`` prints a note."""
        return {"code": self.code, "words": self.words, "badge": self.badge}


@one_line
@dataclass(frozen=True, slots=True)
class SeriesInfo:
    """One series found in a folder. Holds no patient name."""

    key: str
    """Short stable key to choose it by: the number of the series and a counter, never a UID."""
    modality: str
    description: str
    num_slices: int
    shape_zyx: tuple[int, int, int] | None = None
    refused: str | None = None
    """Why it cannot be opened, or None."""


@one_line
@dataclass(frozen=True, slots=True)
class VolumeSource:
    """Where a volume came from, in words fit for the screen (no patient name, no UID)."""

    format: str
    """``dicom``, ``nifti``, ``nrrd``, ``metaimage``, ``phantom`` or ``array``."""
    title: str
    """Series text or file name, for the title bar."""
    series: SeriesInfo | None = None
    other_series: tuple[SeriesInfo, ...] = ()
    notes: tuple[Note, ...] = ()
    """Things a person should know: clipped values, a series beside it, ..."""
    citation: Citation | None = None
    """Source and licence that must be shown with the data, for the bundled case."""
    acquired_on: str | None = field(default=None, repr=False)
    """ISO date on which the scan was made, where its files say one. For this person's own list of cases alone: it tells
    two scans apart and, with other things, whose they are. No file, message or log holds it."""
    slice_thickness_mm: float | None = None
    """SliceThickness of DICOM: how much tissue one slice averages. None where the files do not state one thickness."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """The words of all notes."""
        return tuple(note.words for note in self.notes)


@dataclass(frozen=True, slots=True, eq=False)
class Volume:
    """A chest CT (or another int16 volume) on a regular grid.

    ``hu_zyx`` is C-contiguous ``(nz, ny, nx)`` int16, read-only: HU where ``is_hu``, else the file's numbers.
    ``lps_from_ijk`` is 4x4 float64; voxel (0, 0, 0) is the *centre* of the first voxel; columns are the steps of one
    voxel along i, j, k in mm, each 0.01 to 100 mm long. ``numpy.asarray`` returns ``hu_zyx``.

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
    """What the quality gate found, once it was asked."""
    _digest: str | None = field(default=None, init=False, repr=False)
    """What ``ct_digest`` found, once it was asked."""

    def __post_init__(self) -> None:
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
        # float32 headers round: a hundredth of a millimetre may come as a little less.
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
        return _volume_of, ({one.name: getattr(self, one.name) for one in fields(self)},)

    def __repr__(self) -> str:
        unit = "HU" if self.is_hu else "not HU"
        sx, sy, sz = self.spacing_mm
        return f"Volume(shape_zyx={self.shape_zyx}, spacing_mm=({sx:.4g}, {sy:.4g}, {sz:.4g}), {unit})"

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """Return ``hu_zyx`` for ``numpy.asarray``; the array is copied only for another type or on request."""
        return np.array(self.hu_zyx, dtype=dtype, copy=copy)

    def _repr_html_(self) -> str:
        """Three slices through the middle, in a notebook. No file name and no series text: they can name a patient."""
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
        """Shape of the array."""
        nz, ny, nx = self.hu_zyx.shape
        return nz, ny, nx

    @property
    def value_range(self) -> tuple[int, int]:
        """The smallest and the largest value. Found when first asked for, and kept."""
        if self._range is None:
            object.__setattr__(self, "_range", _core.value_range(self.hu_zyx))
        assert self._range is not None
        return self._range

    @property
    def spacing_mm(self) -> tuple[float, float, float]:
        """Distance of voxel centres along i, j, k."""
        sx, sy, sz = np.linalg.norm(self.lps_from_ijk[:3, :3], axis=0)
        return float(sx), float(sy), float(sz)

    @property
    def ijk_from_lps(self) -> NDArray[np.float64]:
        """The inverse of ``lps_from_ijk``."""
        return np.asarray(np.linalg.inv(self.lps_from_ijk), dtype=np.float64)

    @check_arguments(points_ijk=coordinates(1e45))
    def to_lps(self, points_ijk: NDArray[np.float64]) -> NDArray[np.float64]:
        """Voxel coordinates ``(..., 3)`` to LPS mm."""
        return np.asarray(points_ijk, dtype=np.float64) @ self.lps_from_ijk[:3, :3].T + self.lps_from_ijk[:3, 3]

    @check_arguments(points_lps=coordinates(1e45))
    def to_ijk(self, points_lps: NDArray[np.float64]) -> NDArray[np.float64]:
        """LPS mm ``(..., 3)`` to voxel coordinates."""
        inverse = self.ijk_from_lps
        return np.asarray(points_lps, dtype=np.float64) @ inverse[:3, :3].T + inverse[:3, 3]

    @property
    def centre_lps(self) -> NDArray[np.float64]:
        """Middle of the grid, LPS mm."""
        nz, ny, nx = self.shape_zyx
        return self.to_lps(np.array([(nx - 1) / 2, (ny - 1) / 2, (nz - 1) / 2]))

    @check_arguments(point_lps=array_of(3, largest=1e45))
    def contains_lps(self, point_lps: NDArray[np.float64]) -> bool:
        """Return whether the point is in the grid, which includes half a voxel beyond the outer centres."""
        nz, ny, nx = self.shape_zyx
        ijk = self.to_ijk(point_lps)
        return bool(np.all(ijk >= -0.5) and np.all(ijk <= np.array([nx, ny, nz]) - 0.5))


def _volume_of(values: dict[str, Any]) -> Volume:
    """Return the volume that a pickle holds, read-only, with what was found of it."""
    found = {name: values.pop(name) for name in ("_range", "_quality", "_digest")}
    volume = Volume(**values)
    for name, value in found.items():
        object.__setattr__(volume, name, value)
    return volume


def badges_of(volume: Volume, airways: object | None = None) -> tuple[Note, ...]:
    """Return the lasting notes of a case, which all its results repeat; empty where nothing is in doubt.

    That its numbers are not HU is one of them, with the code ``import.not-hu``.

    Parameters
    ----------
    volume
        The CT.
    airways
        What was found in it; anything with ``badges``.
    """
    badges = [note for note in volume.source.notes if note.badge]
    if not volume.is_hu:
        reason = volume.not_hu_reason or "it is not in Hounsfield units"
        badges.insert(0, Note("import.not-hu", f"not HU: {reason}", badge=True))
    badges.extend(getattr(airways, "badges", ()))
    return tuple(dict.fromkeys(badges))
