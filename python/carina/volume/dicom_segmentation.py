"""DICOM Segmentation objects (PS3.3 A.51, C.8.20): bit planes, fractions and label maps, placed by frame position."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.errors import VolumeImportError
from carina.volume.dicom_headers import damaged_elements_refused, read_dataset
from carina.volume.model import Volume
from carina.volume.progress import Watch
from carina.volume.read_limits import MAX_VOXELS

_SEGMENTATION_STORAGE = "1.2.840.10008.5.1.4.1.1.66.4"
_LABEL_MAP_STORAGE = "1.2.840.10008.5.1.4.1.1.66.7"
_TYPES = ("BINARY", "FRACTIONAL", "LABELMAP")
# Tolerance of the distance of two planes, as a fraction of the plane distance, for rounded decimal strings.
_PLANE = 0.05
# Tolerance of directions: two axes within 0.06 degrees are parallel.
_PARALLEL = 1e-3
_WIDEST_MM = 100.0
_LARGEST_NUMBER = 65535
_UNREADABLE = (ValueError, RuntimeError, AttributeError, NotImplementedError, TypeError, KeyError, IndexError)


class Segmentation:
    """The segments of a DICOM SEG file on the smallest regular grid that contains all frames.

    Segments may overlap. A plane without a frame is empty (PS3.3 C.8.20.2.3.2 lets writers omit empty frames).
    """

    def __init__(self, path: Path, data: Any, places: _FramePositions, shape: tuple[int, int, int]) -> None:
        self._path, self._places, self._shape = path, places, shape
        self._segmentation_type = _segmentation_type(data)
        self._pixels = _Pixels(path, data, self._segmentation_type, shape)
        self._is_probability = str(data.get("SegmentationFractionalType", "")).upper() == "PROBABILITY"
        self.lps_from_ijk = places.lps_from_ijk
        """Transform (4x4) from voxels to LPS mm; voxel (0, 0, 0) is the centre of the first plane's first pixel."""
        self.names = _names(path, data)
        """Labels of the described segments, by number."""
        self.notes = places.notes
        """Notes for the user about the corrections that were necessary to place the frames."""
        self.num_voxels: dict[int, int] = {}
        """Number of voxels of each segment that is not empty."""
        for frame, segment in zip(self._pixels, places.segments, strict=True):
            numbers = ((segment, int(np.count_nonzero(frame))),) if segment is not None else _label_counts(frame)
            for number, count in numbers:
                if count and number != self._pixels.background:
                    self.num_voxels[number] = self.num_voxels.get(number, 0) + count

    def inside(self, number: int) -> tuple[NDArray[np.bool_], tuple[str, ...]]:
        """Return the voxels ``[z, y, x]`` of one segment, independent of other segments, and notes about it.

        Parameters
        ----------
        number
            Number of the segment.

        Raises
        ------
        VolumeImportError
            If two frames of the segment have one position and differ (code ``import.mask``).
        """
        _, rows, columns = self._shape
        found = np.zeros((self._places.num_planes, rows, columns), dtype=bool)
        taken: set[int] = set()
        num_copies = 0
        for frame, plane, segment in zip(
            self._pixels, self._places.planes.tolist(), self._places.segments, strict=True
        ):
            if segment is not None and segment != number:
                continue
            here = frame if segment is not None else frame == number
            if plane in taken:
                if not np.array_equal(found[plane], here):
                    problem = f"two frames of segment {number} have the same position and differ"
                    raise _refusal(self._path, problem, "export one time point or one version of the segment")
                num_copies += 1
            taken.add(plane)
            found[plane] = here
        notes = []
        if num_copies:
            notes.append(f"{num_copies} of its frames were stored twice and were read once")
        if self._pixels.is_graded:
            what = "probabilities" if self._is_probability else "occupancies"
            notes.append(f"it contains {what}; voxels of 50 % or more count as inside")
        return found, tuple(notes)


def read_segmentation(path: Path, watch: Watch, *, volume: Volume | None = None) -> Segmentation:
    """Read the segments of a DICOM SEG file (BINARY, FRACTIONAL or LABELMAP).

    Parameters
    ----------
    path
        The file.
    watch
        Progress and cancellation.
    volume
        The CT. The distance of its slices is used if the file does not state the distance of its planes.

    Raises
    ------
    VolumeImportError
        If the file is not a segmentation, is damaged, or if its frames are not on one grid (code ``import.mask``).
    """
    with damaged_elements_refused(lambda problem: _refusal(path, problem, "copy or export it again")):
        return _read_segmentation(path, watch, volume)


def _read_segmentation(path: Path, watch: Watch, volume: Volume | None) -> Segmentation:
    watch.step("Reading the segmentation")
    try:
        data = read_dataset(path, pixels=True)
    except ValueError as error:
        raise _refusal(path, f"it {error}", "copy or export it again") from None
    try:
        return _read(path, data, volume, watch)
    except (*_UNREADABLE, OverflowError) as error:
        if isinstance(error, VolumeImportError):
            raise
        raise _refusal(path, "its header is damaged", "copy or export it again") from None


def _read(path: Path, data: Any, volume: Volume | None, watch: Watch) -> Segmentation:
    if str(data.get("SOPClassUID", "")) not in (_SEGMENTATION_STORAGE, _LABEL_MAP_STORAGE):
        raise _refusal(path, "it is DICOM, but not a segmentation (SEG)", "choose the SEG file, or export it as NIfTI")
    kind = _segmentation_type(data)
    if kind not in _TYPES:
        raise _refusal(
            path, "its SegmentationType is not BINARY, FRACTIONAL or LABELMAP", "export a binary segmentation"
        )
    rows, columns, num_frames = (int(data.get(key, 0) or 0) for key in ("Rows", "Columns", "NumberOfFrames"))
    num_segments = len(data.get("SegmentSequence") or [])
    if min(rows, columns, num_frames) < 1 or rows * columns * num_frames > MAX_VOXELS * max(1, num_segments):
        problem = f"it claims {num_frames} frames of {columns} x {rows} pixels, which is implausible"
        raise _refusal(path, problem, "export it again")
    places = _FramePositions(path, data, num_frames, kind, volume)
    if places.num_planes * rows * columns > MAX_VOXELS:
        raise _refusal(path, f"its frames span {places.num_planes} planes, which is implausible", "export it again")
    watch.step("Unpacking the segmentation", None)
    found = Segmentation(path, data, places, (num_frames, rows, columns))
    if not found.num_voxels and kind == "FRACTIONAL":
        raise _refusal(path, "no voxel of its fractional segments reaches 50 %", "export a binary segmentation")
    return found


def _segmentation_type(data: Any) -> str:
    """Return the segmentation type: BINARY, FRACTIONAL or LABELMAP. Some files omit the type and get a default."""
    default = "LABELMAP" if str(data.get("SOPClassUID", "")) == _LABEL_MAP_STORAGE else "BINARY"
    return str(data.get("SegmentationType") or default).strip().upper()


def _names(path: Path, data: Any) -> dict[int, str]:
    names = {
        int(s.SegmentNumber): _printable_name(str(s.get("SegmentLabel", ""))) for s in data.get("SegmentSequence") or []
    }
    if any(not 0 <= number <= _LARGEST_NUMBER for number in names):
        raise _refusal(path, f"it has segment numbers outside 0 to {_LARGEST_NUMBER}", "export it again")
    return names


def _label_counts(frame: NDArray[Any]) -> list[tuple[int, int]]:
    numbers, counts = np.unique(frame, return_counts=True)
    return [(int(number), int(count)) for number, count in zip(numbers, counts, strict=True)]


class _Pixels:
    """Frames of a segmentation: bool if each segment has its own frames, segment numbers in a label map."""

    def __init__(self, path: Path, data: Any, kind: str, shape: tuple[int, int, int]) -> None:
        self._path, self._segmentation_type, self._shape = path, kind, shape
        self.background = int(data.get("PixelPaddingValue", 0) or 0) if kind == "LABELMAP" else -1
        """Pixel value of a label map that marks the background (PS3.3 C.8.20.2); -1 for other types."""
        self.is_graded = False
        """Whether a fractional segment has values other than 0 and 1."""
        self._bits: NDArray[np.uint8] | None = None
        self._frames: NDArray[Any] = np.empty(0)
        self._largest = 0
        bits = int(data.get("BitsAllocated", 0) or 0)
        if kind == "FRACTIONAL":
            self._largest = int(data.get("MaximumFractionalValue", 0) or 0)
            if bits != 8 or not 0 < self._largest <= 255:
                problem = "its segments are fractional, but it does not say which number means all (8 bits expected)"
                raise _refusal(path, problem, "export a binary segmentation")
        if kind == "BINARY" and bits == 1 and not data.file_meta.TransferSyntaxUID.is_compressed:
            # Frames of single bits follow each other without padding (PS3.5 8.2), so that each can be read separately.
            self._bits = np.frombuffer(data.PixelData, dtype=np.uint8)
            if self._bits.size * 8 < shape[0] * shape[1] * shape[2]:
                raise _refusal(path, "its pixels cannot be read: some are missing", "copy or export it again")
            return
        try:
            self._frames = np.asarray(data.pixel_array).reshape(shape)
        except _UNREADABLE:
            raise _refusal(path, "its pixels cannot be read", "export it again without compression") from None
        if kind == "FRACTIONAL":
            self.is_graded = bool(((self._frames != 0) & (self._frames != self._largest)).any())

    def __iter__(self) -> Iterator[NDArray[Any]]:
        """Yield the frames in the order of the file, as bool or, in a label map, as numbers."""
        num, rows, columns = self._shape
        size = rows * columns
        for n in range(num):
            if self._bits is not None:
                start = n * size
                part = self._bits[start // 8 : (start + size + 7) // 8]
                frame = np.unpackbits(part, bitorder="little")[start % 8 : start % 8 + size]
                yield frame.reshape(rows, columns) != 0
            elif self._segmentation_type == "BINARY":
                yield self._frames[n] != 0
            elif self._segmentation_type == "FRACTIONAL":
                yield 2 * self._frames[n].astype(np.int32) >= self._largest
            else:
                yield self._frames[n]


class _FramePositions:
    """Positions of the frames: a stack of parallel planes at equal distances."""

    def __init__(self, path: Path, data: Any, num_frames: int, kind: str, volume: Volume | None) -> None:
        shared = _first_item(data, "SharedFunctionalGroupsSequence")
        groups = list(data.get("PerFrameFunctionalGroupsSequence") or [])
        if len(groups) != num_frames:
            raise _refusal(path, f"it has {num_frames} frames but {len(groups)} frame descriptions", "export it again")
        try:
            orientations = [_item(g, shared, "PlaneOrientationSequence", "ImageOrientationPatient") for g in groups]
            orientation = np.array(orientations, dtype=np.float64).reshape(num_frames, 6)
            position = np.array(
                [_item(g, shared, "PlanePositionSequence", "ImagePositionPatient") for g in groups], dtype=np.float64
            ).reshape(num_frames, 3)
            measures = [_item(g, shared, "PixelMeasuresSequence", "PixelSpacing") for g in groups]
            spacing = np.array(measures, dtype=np.float64).reshape(num_frames, 2)
            self.segments = [
                None
                if kind == "LABELMAP"
                else int(_item(g, shared, "SegmentIdentificationSequence", "ReferencedSegmentNumber"))
                for g in groups
            ]
            """The segment of each frame; None in a label map."""
        except (KeyError, TypeError, ValueError, AttributeError):
            problem = "a frame lacks its position, orientation, pixel spacing or segment number"
            raise _refusal(path, problem, "export it again") from None
        if not (spacing.min() > 0.0 and spacing.max() < _WIDEST_MM):
            raise _refusal(path, f"its pixel spacing is implausible ({spacing.max():g} mm)", "export it again")
        known = {int(s.SegmentNumber) for s in data.get("SegmentSequence") or []}
        if any(number is not None and (number not in known or number < 1) for number in self.segments):
            raise _refusal(path, "its frames refer to segments that do not exist", "export it again")
        along, down = orientation[0, :3], orientation[0, 3:]
        normal = np.cross(along, down)
        straight = np.allclose([along @ along, down @ down, along @ down], [1.0, 1.0, 0.0], atol=1e-3)
        if not straight or np.ptp(orientation, axis=0).max() > 1e-4 or np.ptp(spacing, axis=0).max() > 1e-4:
            raise _refusal(path, "its frames are not parallel", "export it again")
        if not np.isfinite(position).all():
            raise _refusal(path, "its frames are not on one regular grid", "export it again")
        heights = position @ normal
        self._first_item = position[np.argmin(heights)]
        levels = np.unique(np.round(heights, 3))
        claimed = _length(groups[0], shared, "SpacingBetweenSlices")
        self.notes: tuple[str, ...] = ()
        gaps = [claimed, _slice_mm(volume, normal)]
        # Frames may be omitted, so the distances of frames may be multiples of the plane distance. SliceThickness comes
        # last, because overlapping slices are thicker than their distance.
        gaps.append(float(np.diff(levels).min()) if len(levels) > 1 else _length(groups[0], shared, "SliceThickness"))
        for gap in (*gaps, 1.0):
            if gap is None or gap <= 0.0:
                continue
            planes = np.rint((heights - levels[0]) / gap)
            off = np.abs(position - (self._first_item + np.outer(planes * gap, normal))).max()
            # If two positions along the normal fall into one plane, the plane distance is too large.
            apart = len(np.unique(planes)) == len(levels)
            if apart and off <= _PLANE * gap:
                break
        else:
            raise _refusal(path, "its frames are not on one regular grid", "export it again")
        if claimed is not None and abs(gap - claimed) > 1e-6:
            self.notes = (
                f"its SpacingBetweenSlices ({claimed:g} mm) contradicts the positions of its frames ({gap:g} mm "
                "apart), which were used",
            )
        self.planes = planes.astype(int)
        self.num_planes = int(self.planes.max()) + 1
        self._axes = (along * spacing[0, 1], down * spacing[0, 0], normal * gap)

    @property
    def lps_from_ijk(self) -> NDArray[np.float64]:
        """Transform (4x4) from voxels to LPS mm; voxel (0, 0, 0) is the centre of the first plane's first pixel."""
        matrix = np.eye(4)
        for axis in range(3):
            matrix[:3, axis] = self._axes[axis]
        matrix[:3, 3] = self._first_item
        return matrix


def _slice_mm(volume: Volume | None, normal: NDArray[np.float64]) -> float | None:
    """Return the CT's voxel spacing in mm along the normal of a segmentation's planes; None if no axis is parallel."""
    if volume is None:
        return None
    for axis in range(3):
        step = volume.lps_from_ijk[:3, axis]
        length = float(np.linalg.norm(step))
        if np.linalg.norm(np.cross(step / length, normal)) <= _PARALLEL:
            return length
    return None


def _first_item(data: Any, name: str) -> Any:
    items = data.get(name) or []
    return items[0] if len(items) else None


def _item(group: Any, shared: Any, sequence: str, name: str) -> Any:
    """Return an attribute of a frame from its own functional group, or else from the shared one."""
    for place in (group, shared):
        holder = None if place is None else _first_item(place, sequence)
        value = None if holder is None else holder.get(name)
        if value is not None:
            return value
    raise KeyError(name)


def _length(group: Any, shared: Any, name: str) -> float | None:
    try:
        value = float(_item(group, shared, "PixelMeasuresSequence", name))
    except (KeyError, TypeError, ValueError):
        return None
    return value if 0.0 < value < _WIDEST_MM else None


def _printable_name(name: str) -> str:
    """Return a segment's name for messages: at most 64 characters, as DICOM allows, all printable."""
    return "".join(c if c.isprintable() else " " for c in name[:64]).strip()


def _refusal(path: Path, problem: str, way_out: str) -> VolumeImportError:
    return VolumeImportError(f"reading the segmentation {path.name}: {problem}; {way_out}", code="import.mask")
