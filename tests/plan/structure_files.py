"""DICOM SEG and RTSTRUCT files of exact structures in the form that other programs write, and a CT for these files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
from numpy.typing import NDArray
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian, generate_uid

from carina.volume import Volume

SPACING_MM = (0.7, 0.8, 1.25)
SHAPE_ZYX = (40, 50, 60)
FRAME, STUDY, SERIES = "1.2.826.0.1.1", "1.2.826.0.1.2", "1.2.826.0.1.3"
Outlines = dict[int, list[NDArray[np.float64]]]


def oblique() -> NDArray[np.float64]:
    """Return an oblique voxel-to-LPS matrix, none of whose axes is parallel to an axis of the patient."""
    a, b = np.radians(9.0), np.radians(-6.0)
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1.0]])
    turn @= np.array([[1.0, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    matrix = np.eye(4)
    matrix[:3, :3] = turn * SPACING_MM
    matrix[:3, 3] = (-20.0, 31.0, -112.0)
    return matrix


def lung_with_ball(radius_mm: float = 6.0) -> tuple[Volume, NDArray[np.float64]]:
    """Return a CT of a ball in lung, and the middle of the ball, LPS mm."""
    matrix = oblique()
    empty = Volume(np.zeros(SHAPE_ZYX, dtype=np.int16), matrix)
    centre = empty.to_lps(np.array([29.3, 24.6, 19.7]))
    k, j, i = np.indices(SHAPE_ZYX)
    off = np.linalg.norm(empty.to_lps(np.stack([i, j, k], axis=-1).astype(float)) - centre, axis=-1)
    share = np.clip(0.5 - (off - radius_mm) / 0.8, 0.0, 1.0)
    noise = np.random.default_rng(3).normal(0.0, 20.0, SHAPE_ZYX)
    return Volume(np.rint(-860.0 + 890.0 * share + noise).astype(np.int16), matrix), centre


def ball_voxels(volume: Volume, centre: NDArray[np.float64], radius_mm: float) -> NDArray[np.bool_]:
    k, j, i = np.indices(volume.shape_zyx)
    places = volume.to_lps(np.stack([i, j, k], axis=-1).astype(float))
    return np.linalg.norm(places - centre, axis=-1) < radius_mm


def ball_outlines(volume: Volume, centre: NDArray[np.float64], radius_mm: float) -> Outlines:
    """Return the circles in which the slices of a volume cut a ball, LPS mm."""
    normal = volume.lps_from_ijk[:3, 2] / volume.spacing_mm[2]
    across, up = (volume.lps_from_ijk[:3, n] / volume.spacing_mm[n] for n in (0, 1))
    found: Outlines = {}
    for k in range(volume.shape_zyx[0]):
        height = float((volume.to_lps(np.array([0.0, 0.0, k])) - centre) @ normal)
        if abs(height) < radius_mm:
            turn = np.linspace(0.0, 2.0 * np.pi, 90, endpoint=False)[:, None]
            r = np.sqrt(radius_mm**2 - height**2)
            found[k] = [centre + height * normal + r * (np.cos(turn) * across + np.sin(turn) * up)]
    return found


def edge_outlines(volume: Volume, inside: NDArray[np.bool_]) -> Outlines:
    """Return outlines along the outer edges of the voxels of a mask."""
    found: Outlines = {}
    for k, plane in enumerate(np.pad(inside, ((0, 0), (1, 1), (1, 1)))):
        following: dict[tuple[float, float], list[tuple[float, float]]] = {}
        for j, i in np.argwhere(plane):
            a, b, c, d = (i - 0.5, j - 0.5), (i + 0.5, j - 0.5), (i + 0.5, j + 0.5), (i - 0.5, j + 0.5)
            for start, end, (nj, ni) in (
                (a, b, (j - 1, i)),
                (b, c, (j, i + 1)),
                (c, d, (j + 1, i)),
                (d, a, (j, i - 1)),
            ):
                if not plane[nj, ni]:
                    following.setdefault(start, []).append(end)
        while following:
            start = at = next(iter(following))
            loop = []
            while True:
                loop.append(at)
                ends = following[at]
                step = ends.pop()
                if not ends:
                    del following[at]
                at = step
                if at == start:
                    break
            ijk = np.array([(x - 1.0, y - 1.0, k) for x, y in loop])
            found.setdefault(k, []).append(volume.to_lps(ijk))
    return found


def centre_outlines(volume: Volume, inside: NDArray[np.bool_]) -> Outlines:
    """Return outlines through the centres of a convex mask's outer voxels, as programs that trace pixels write them."""
    found: Outlines = {}
    for k, plane in enumerate(inside):
        rows = np.flatnonzero(plane.any(axis=1))
        if len(rows) < 2:
            continue
        ends = [(np.flatnonzero(plane[j])[[0, -1]], j) for j in rows]
        loop = [(first, j, k) for (first, _), j in ends] + [(last, j, k) for (_, last), j in reversed(ends)]
        found[k] = [volume.to_lps(np.array(loop, dtype=float))]
    return found


def structure_set(
    path: Path,
    structures: Sequence[tuple[str, Outlines]],
    *,
    kind: str = "CLOSED_PLANAR",
    change: Callable[[Dataset], Any] | None = None,
    frame: str = FRAME,
    study: str = STUDY,
    series: str = SERIES,
) -> Path:
    """Write an RTSTRUCT file as planning systems write it; return its path."""
    data = Dataset()
    data.file_meta = FileMetaDataset()
    data.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    data.file_meta.MediaStorageSOPClassUID = data.SOPClassUID = "1.2.840.10008.5.1.4.1.1.481.3"
    data.file_meta.MediaStorageSOPInstanceUID = data.SOPInstanceUID = generate_uid()
    data.Modality, data.StudyInstanceUID, data.SeriesInstanceUID = "RTSTRUCT", study, generate_uid()
    one_series, one_study, one_frame = Dataset(), Dataset(), Dataset()
    one_series.SeriesInstanceUID = series
    one_study.ReferencedSOPClassUID, one_study.ReferencedSOPInstanceUID = "1.2.840.10008.3.1.2.3.1", study
    one_study.RTReferencedSeriesSequence = [one_series]
    one_frame.FrameOfReferenceUID, one_frame.RTReferencedStudySequence = frame, [one_study]
    data.ReferencedFrameOfReferenceSequence = [one_frame]
    data.StructureSetROISequence, data.ROIContourSequence = [], []
    for number, (name, outlines) in enumerate(structures, 1):
        region, drawn = Dataset(), Dataset()
        region.ROINumber, region.ROIName, region.ReferencedFrameOfReferenceUID = number, name, frame
        data.StructureSetROISequence.append(region)
        drawn.ReferencedROINumber = number
        drawn.ContourSequence = []
        for points in (one for plane in outlines.values() for one in plane):
            item = Dataset()
            item.ContourGeometricType, item.NumberOfContourPoints = kind, len(points)
            item.ContourData = [f"{value:.3f}" for value in points.ravel()]
            drawn.ContourSequence.append(item)
        data.ROIContourSequence.append(drawn)
    if change is not None:
        change(data)
    pydicom.dcmwrite(path, data, enforce_file_format=True)
    return path


def segmentation(
    path: Path,
    volume: Volume,
    labels_zyx: NDArray[Any],
    *,
    frame: str = FRAME,
    study: str = STUDY,
    series: str = SERIES,
) -> Path:
    """Write a SEG file with one frame for each segment and each plane that is not empty; return its path."""
    spacing = volume.spacing_mm
    direction = volume.lps_from_ijk[:3, :3] / spacing
    data, measures, orientation, shared = Dataset(), Dataset(), Dataset(), Dataset()
    frames = []
    data.PerFrameFunctionalGroupsSequence, data.SegmentSequence = [], []
    for number in (int(v) for v in np.unique(labels_zyx) if v):
        segment = Dataset()
        segment.SegmentNumber, segment.SegmentLabel = number, f"nodule {number}"
        data.SegmentSequence.append(segment)
        for k, plane in enumerate(labels_zyx):
            if (plane == number).any():
                frames.append(plane == number)
                group, position, which = Dataset(), Dataset(), Dataset()
                position.ImagePositionPatient = [f"{v:.6f}" for v in volume.to_lps(np.array([0.0, 0.0, k]))]
                which.ReferencedSegmentNumber = number
                group.PlanePositionSequence, group.SegmentIdentificationSequence = [position], [which]
                data.PerFrameFunctionalGroupsSequence.append(group)
    measures.PixelSpacing, measures.SpacingBetweenSlices = [spacing[1], spacing[0]], spacing[2]
    orientation.ImageOrientationPatient = [f"{v:.8f}" for v in [*direction[:, 0], *direction[:, 1]]]
    shared.PixelMeasuresSequence, shared.PlaneOrientationSequence = [measures], [orientation]
    data.SharedFunctionalGroupsSequence = [shared]
    data.file_meta = FileMetaDataset()
    data.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    data.file_meta.MediaStorageSOPClassUID = data.SOPClassUID = "1.2.840.10008.5.1.4.1.1.66.4"
    data.file_meta.MediaStorageSOPInstanceUID = data.SOPInstanceUID = generate_uid()
    data.Modality, data.SegmentationType, data.StudyInstanceUID = "SEG", "BINARY", study
    data.FrameOfReferenceUID = frame
    referenced = Dataset()
    referenced.SeriesInstanceUID = series
    data.ReferencedSeriesSequence = [referenced]
    data.Rows, data.Columns, data.NumberOfFrames = *labels_zyx.shape[1:], len(frames)
    data.BitsAllocated = data.BitsStored = data.SamplesPerPixel = 1
    data.HighBit = data.PixelRepresentation = 0
    data.PhotometricInterpretation = "MONOCHROME2"
    data.PixelData = np.packbits(np.stack(frames).ravel(), bitorder="little").tobytes()
    if len(data.PixelData) % 2:
        data.PixelData += b"\0"
    pydicom.dcmwrite(path, data, enforce_file_format=True)
    return path


def ct_files(folder: Path, volume: Volume, *, frame: str = FRAME, study: str = STUDY, series: str = SERIES) -> Path:
    """Write the CT as a DICOM series into a folder; return the folder."""
    folder.mkdir(parents=True)
    spacing = volume.spacing_mm
    direction = volume.lps_from_ijk[:3, :3] / spacing
    for k, plane in enumerate(volume.hu_zyx):
        data = Dataset()
        data.file_meta = FileMetaDataset()
        data.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        data.file_meta.MediaStorageSOPClassUID = data.SOPClassUID = "1.2.840.10008.5.1.4.1.1.2"
        data.file_meta.MediaStorageSOPInstanceUID = data.SOPInstanceUID = generate_uid()
        data.ImageType, data.Modality = ["ORIGINAL", "PRIMARY", "AXIAL"], "CT"
        data.PatientName, data.PatientID = "Secret^One", "SECRET-1"
        data.StudyInstanceUID, data.SeriesInstanceUID, data.FrameOfReferenceUID = study, series, frame
        data.SeriesNumber = 3
        data.Rows, data.Columns = plane.shape
        data.PixelSpacing = [spacing[1], spacing[0]]
        data.ImageOrientationPatient = [f"{v:.10f}" for v in [*direction[:, 0], *direction[:, 1]]]
        data.ImagePositionPatient = [f"{v:.6f}" for v in volume.to_lps(np.array([0.0, 0.0, k]))]
        data.SamplesPerPixel, data.PhotometricInterpretation = 1, "MONOCHROME2"
        data.BitsAllocated, data.BitsStored, data.HighBit, data.PixelRepresentation = 16, 16, 15, 0
        data.RescaleSlope, data.RescaleIntercept = 1, -1024
        data.PixelData = (plane.astype(np.int32) + 1024).clip(0).astype("<u2").tobytes()
        data["PixelData"].VR = "OW"
        pydicom.dcmwrite(folder / f"IM{k:03d}", data, enforce_file_format=True)
    return folder
