"""DICOM Segmentation objects (PS3.3 A.51, C.8.20): frames placed by where they lie, never by their order."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.errors import VolumeImportError
from carina.volume.dicom_headers import read_dataset
from carina.volume.limits import MAX_VOXELS
from carina.volume.watch import Watch

__all__ = ["read_segmentation"]

_SEGMENTATION_STORAGE = "1.2.840.10008.5.1.4.1.1.66.4"
# Of the distance of two planes: rounding of decimal strings.
_PLANE = 0.05
_WIDEST_MM = 100.0


def read_segmentation(path: Path, watch: Watch) -> tuple[NDArray[np.uint8], NDArray[np.float64], dict[int, str]]:
    """The segments of a DICOM SEG file.

    Returns
    -------
    labels_zyx, lps_from_ijk, names
        Segment numbers on the smallest regular grid that holds all frames (frames that are left out are empty), its 4x4
        transform (mm), and the segments' labels.

    Raises
    ------
    VolumeImportError
        If it is not a segmentation, its segments overlap, or its frames do not lie on one grid.
    """
    watch.step("Reading the segmentation")
    try:
        data = read_dataset(path, pixels=True)
    except ValueError as error:
        raise _refused(path, f"it {error}", "copy or export it again") from None
    if str(data.get("SOPClassUID", "")) != _SEGMENTATION_STORAGE:
        raise _refused(path, "it is DICOM, but not a segmentation (SEG)", "choose the SEG file, or export it as NIfTI")
    if str(data.get("SegmentationType", "BINARY")) != "BINARY":
        raise _refused(
            path, "its segments are fractional (probabilities or occupancies)", "export a binary segmentation"
        )
    names = {int(s.SegmentNumber): _plain(str(s.get("SegmentLabel", ""))) for s in data.get("SegmentSequence", [])}
    if len(names) > 255 or any(not 0 < number <= 255 for number in names):
        raise _refused(path, f"it has {len(names)} segments; expected at most 255", "export only the airway segment")
    rows, columns, num_frames = (int(data.get(key, 0) or 0) for key in ("Rows", "Columns", "NumberOfFrames"))
    if min(rows, columns, num_frames) < 1 or rows * columns * num_frames > MAX_VOXELS * max(1, len(names)):
        problem = f"it claims {num_frames} frames of {columns} x {rows} pixels, which is implausible"
        raise _refused(path, problem, "export it again")
    places = _Places(path, data, num_frames)
    watch.step("Unpacking the segmentation", None)
    try:
        frames = np.asarray(data.pixel_array).reshape(num_frames, rows, columns) != 0
    except (ValueError, RuntimeError, AttributeError, NotImplementedError, TypeError):
        raise _refused(path, "its pixels cannot be read", "export it again without compression") from None
    if places.num_planes * rows * columns > MAX_VOXELS:
        raise _refused(path, f"its frames span {places.num_planes} planes, which is implausible", "export it again")
    labels = np.zeros((places.num_planes, rows, columns), dtype=np.uint8)
    for frame, plane, segment in zip(frames, places.planes, places.segments, strict=True):
        taken = labels[plane]
        if (frame & (taken != 0) & (taken != segment)).any():
            raise _refused(path, "its segments overlap", "export only the airway segment")
        taken[frame] = segment
    return labels, places.lps_from_ijk, names


class _Places:
    """Where the frames lie: one stack of parallel planes at equal distances."""

    def __init__(self, path: Path, data: Any, num_frames: int) -> None:
        shared = _first(data, "SharedFunctionalGroupsSequence")
        groups = list(data.get("PerFrameFunctionalGroupsSequence", []))
        if len(groups) != num_frames:
            raise _refused(path, f"it has {num_frames} frames but {len(groups)} frame descriptions", "export it again")
        try:
            orientations = [_item(g, shared, "PlaneOrientationSequence", "ImageOrientationPatient") for g in groups]
            orientation = np.array(orientations, dtype=np.float64).reshape(num_frames, 6)
            position = np.array(
                [_item(g, shared, "PlanePositionSequence", "ImagePositionPatient") for g in groups], dtype=np.float64
            ).reshape(num_frames, 3)
            measures = [_item(g, shared, "PixelMeasuresSequence", "PixelSpacing") for g in groups]
            spacing = np.array(measures, dtype=np.float64).reshape(num_frames, 2)
            self.segments = [
                int(_item(g, shared, "SegmentIdentificationSequence", "ReferencedSegmentNumber")) for g in groups
            ]
        except (KeyError, TypeError, ValueError):
            problem = "a frame lacks its position, orientation, pixel spacing or segment number"
            raise _refused(path, problem, "export it again") from None
        if not (spacing.min() > 0.0 and spacing.max() < _WIDEST_MM):
            raise _refused(path, f"its pixel spacing is implausible ({spacing.max():g} mm)", "export it again")
        if not all(0 < number <= 255 for number in self.segments):
            raise _refused(path, "its frames refer to segments that do not exist", "export it again")
        along, down = orientation[0, :3], orientation[0, 3:]
        normal = np.cross(along, down)
        straight = np.allclose([along @ along, down @ down, along @ down], [1.0, 1.0, 0.0], atol=1e-3)
        if not straight or np.ptp(orientation, axis=0).max() > 1e-4 or np.ptp(spacing, axis=0).max() > 1e-4:
            raise _refused(path, "its frames are not parallel", "export it again")
        heights = position @ normal
        levels = np.unique(np.round(heights, 3))
        # Frames may be left out, so their distances need not tell; overlapping slices are thicker than their distance.
        gap = _length(groups[0], shared, "SpacingBetweenSlices")
        if gap is None:
            single = _length(groups[0], shared, "SliceThickness") or 1.0
            gap = float(np.diff(levels).min()) if len(levels) > 1 else single
        planes = np.rint((heights - levels[0]) / gap)
        off = np.abs(position - (position[np.argmin(heights)] + np.outer(planes * gap, normal))).max()
        if not (gap > 0.0 and np.isfinite(position).all() and off <= _PLANE * max(gap, spacing.max())):
            raise _refused(path, "its frames are not on one regular grid", "export it again")
        self.planes = planes.astype(int)
        self.num_planes = int(self.planes.max()) + 1
        self._axes = (along * spacing[0, 1], down * spacing[0, 0], normal * gap)
        self._first = position[np.argmin(heights)]

    @property
    def lps_from_ijk(self) -> NDArray[np.float64]:
        """4x4, voxel (0, 0, 0) at the centre of the first pixel of the first plane."""
        matrix = np.eye(4)
        for axis in range(3):
            matrix[:3, axis] = self._axes[axis]
        matrix[:3, 3] = self._first
        return matrix


def _first(data: Any, name: str) -> Any:
    items = data.get(name) or []
    return items[0] if len(items) else None


def _item(group: Any, shared: Any, sequence: str, name: str) -> Any:
    """A value of a frame, from its own group or the shared one."""
    for place in (group, shared):
        holder = None if place is None else _first(place, sequence)
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


def _plain(name: str) -> str:
    """A segment's name as it may be shown: DICOM allows 64 characters, and what no text has would end a message."""
    return "".join(c if c.isprintable() else " " for c in name[:64]).strip()


def _refused(path: Path, problem: str, way_out: str) -> VolumeImportError:
    return VolumeImportError(f"reading the segmentation {path.name}: {problem}; {way_out}", code="import.mask")
