"""Reader of DICOM structure sets (RTSTRUCT, PS3.3 A.19, C.8.8.5, C.8.8.6): outlines in LPS, and references to the CT.

This module does not rasterise outlines. UIDs of these values never occur in messages or logs.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import Dataset

from carina.display import one_line
from carina.errors import VolumeImportError
from carina.volume.dicom_files import read_headers
from carina.volume.dicom_headers import IDENTITY, damaged_elements_refused, read_dataset
from carina.volume.dicom_references import References
from carina.volume.model import Volume
from carina.volume.progress import Watch

_STRUCTURE_SET_STORAGE = "1.2.840.10008.5.1.4.1.1.481.3"
_CLOSED = {"CLOSED_PLANAR": False, "CLOSEDPLANAR_XOR": True}
_MAX_POINTS = 5_000_000
_LARGEST_LPS = 1e5
# Tolerance in voxels: the first pixel of a slice coincides with a voxel centre of its own CT.
_ON_GRID = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Contour:
    """One closed outline of a structure."""

    points_lps: NDArray[np.float64]
    """(n, 3) LPS mm; the last point is connected to the first."""
    is_xor: bool
    """Whether a point inside an even number of outlines of its plane is outside the structure (PS3.3 C.8.8.6.3)."""

    @property
    def area_mm2(self) -> float:
        """Area in mm² that the outline encloses."""
        points = self.points_lps - self.points_lps[0]
        return 0.5 * float(np.linalg.norm(np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)))


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Structure:
    """One region of interest with its outlines."""

    number: int
    name: str
    contours: tuple[Contour, ...]
    num_open: int
    """Number of outlines that are points or open lines, which enclose no area."""
    references: References


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class StructureSet:
    """All structures of an RTSTRUCT file."""

    structures: tuple[Structure, ...]


def read_structures(path: Path, watch: Watch) -> StructureSet:
    """Read the structures of an RTSTRUCT file.

    Raises
    ------
    VolumeImportError
        If the file is not a structure set or is damaged (code ``import.mask``).
    """
    with damaged_elements_refused(lambda problem: structures_refused(path, problem, "copy or export it again")):
        return _read_structures(path, watch)


def _read_structures(path: Path, watch: Watch) -> StructureSet:
    watch.step("Reading the structure set")
    try:
        data = read_dataset(path, pixels=True)
    except ValueError as error:
        raise structures_refused(path, f"it {error}", "copy or export it again") from None
    if str(data.get("SOPClassUID", "")) != _STRUCTURE_SET_STORAGE:
        raise structures_refused(path, "it is DICOM, but not a structure set (RTSTRUCT)", "choose the RTSTRUCT file")
    whole = _references(data)
    try:
        regions = {int(item.ROINumber): item for item in data.get("StructureSetROISequence") or []}
        drawn: dict[int, list[Dataset]] = {}
        for item in data.get("ROIContourSequence") or []:
            drawn.setdefault(int(item.ReferencedROINumber), []).extend(item.get("ContourSequence") or [])
        found = tuple(_structure(path, item, drawn.get(number, []), whole) for number, item in regions.items())
    except (AttributeError, TypeError, ValueError, OverflowError):
        raise structures_refused(path, "one of its structures is damaged", "export it again") from None
    if not found:
        raise structures_refused(path, "it contains no structures", "export it with the outline of the nodule")
    return StructureSet(found)


def _structure(path: Path, region: Dataset, items: list[Dataset], whole: References) -> Structure:
    contours, num_open, num_points = [], 0, 0
    images = set()
    for item in items:
        kind = str(item.get("ContourGeometricType", "CLOSED_PLANAR")).strip().upper()
        values = item.get("ContourData")
        points = np.array([] if values is None else values, dtype=np.float64).reshape(-1, 3)
        num_points += len(points)
        if num_points > _MAX_POINTS:
            raise structures_refused(path, "a structure has implausibly many points", "export it again")
        if not np.isfinite(points).all() or (points.size and np.abs(points).max() > _LARGEST_LPS):
            raise ValueError(kind)
        images.update(_uids(item, "ContourImageSequence", "ReferencedSOPInstanceUID"))
        if kind in _CLOSED and len(points) >= 3:
            contours.append(Contour(points, _CLOSED[kind]))
        elif len(points):
            num_open += 1
    frame = str(region.get("ReferencedFrameOfReferenceUID") or "")
    references = References(
        frozenset({frame}) if frame else whole.frames, whole.studies, whole.series, frozenset(images) or whole.images
    )
    name = "".join(c if c.isprintable() else " " for c in str(region.get("ROIName") or "")[:64]).strip()
    return Structure(int(region.ROINumber), name, tuple(contours), num_open, references)


def read_references(path: Path) -> References:
    """Return the images that a DICOM object (RTSTRUCT, SEG) refers to; empty if the file cannot be read."""
    try:
        return _references(read_dataset(path, pixels=True))
    except Exception:
        # pydicom raises various errors for damaged elements.
        return References()


def _references(data: Dataset) -> References:
    frames, studies, series, images = set(), set(), set(), set()
    if data.get("FrameOfReferenceUID"):
        frames.add(str(data.FrameOfReferenceUID))
    for frame in data.get("ReferencedFrameOfReferenceSequence") or []:
        if frame.get("FrameOfReferenceUID"):
            frames.add(str(frame.FrameOfReferenceUID))
        for study in frame.get("RTReferencedStudySequence") or []:
            studies.update(_uid(study, "ReferencedSOPInstanceUID"))
            for one in study.get("RTReferencedSeriesSequence") or []:
                series.update(_uid(one, "SeriesInstanceUID"))
                images.update(_uids(one, "ContourImageSequence", "ReferencedSOPInstanceUID"))
    for one in data.get("ReferencedSeriesSequence") or []:
        series.update(_uid(one, "SeriesInstanceUID"))
        images.update(_uids(one, "ReferencedInstanceSequence", "ReferencedSOPInstanceUID"))
    if not studies:
        studies.update(_uid(data, "StudyInstanceUID"))
    return References(frozenset(frames), frozenset(studies), frozenset(series), frozenset(images))


def _uid(item: Dataset, name: str) -> set[str]:
    value = str(item.get(name) or "").strip("\0 ")
    return {value} if value else set()


def _uids(item: Dataset, sequence: str, name: str) -> set[str]:
    return {uid for one in item.get(sequence) or [] for uid in _uid(one, name)}


def ct_references(path: Path, volume: Volume, watch: Watch) -> References | None:
    """Return the UIDs of the DICOM series of a CT; None if its files are not DICOM, or no series matches it.

    Parameters
    ----------
    path
        The folder or a file of the CT.
    volume
        The CT; only files whose position is a voxel of the CT count.
    watch
        Progress and cancellation.
    """
    folder = path if path.is_dir() else path.parent
    try:
        headers = read_headers(folder, recursive=path.is_dir(), watch=watch)
    except (VolumeImportError, OSError):
        return None
    limits = np.array(volume.shape_zyx[::-1]) - 0.5
    references = []
    for header in headers:
        ijk = volume.to_ijk(np.array(header.position_lps))
        if np.abs(ijk - np.rint(ijk)).max() <= _ON_GRID and (ijk > -0.5).all() and (ijk < limits).all():
            references.append(header)
    if not references:
        return None
    names = list(IDENTITY)
    frame, study = names.index("FrameOfReferenceUID"), names.index("StudyInstanceUID")
    return References(
        frozenset({header.identity[frame] for header in references} - {""}),
        frozenset({header.identity[study] for header in references} - {""}),
        frozenset({header.series_uid for header in references} - {""}),
        frozenset({header.sop_uid for header in references} - {""}),
    )


def structures_refused(path: Path, problem: str, way_out: str, *, code: str = "import.mask") -> VolumeImportError:
    """Return the error for a structure set that cannot be used."""
    return VolumeImportError(f"reading the structure set {path.name}: {problem}; {way_out}", code=code)


def is_structure_set(path: Path) -> bool:
    """Return whether a DICOM file is an RTSTRUCT."""
    try:
        data: Any = read_dataset(path, pixels=False)
        return str(data.get("SOPClassUID", "")) == _STRUCTURE_SET_STORAGE
    except Exception:
        # ``read_dataset`` raises ValueError, and pydicom raises various errors for a damaged element.
        return False
