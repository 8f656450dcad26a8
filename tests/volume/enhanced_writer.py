"""Writer of enhanced (multi-frame) CT and MR files with the content of the synthetic chest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from dicom_writer import GAP_MM, chest
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.encaps import encapsulate
from pydicom.sequence import Sequence as Items
from pydicom.uid import EnhancedCTImageStorage, ExplicitVRLittleEndian, generate_uid

__all__ = ["ORIGIN_LPS", "Frame", "chest_frames", "enhanced", "item"]

ORIGIN_LPS = (-11.25, -14.5)
EditFile = Callable[[Dataset], None]


@dataclass
class Frame:
    """One frame: its stored values, its position, and the tags of its functional groups."""

    stored: np.ndarray
    """Unsigned 16-bit numbers [row, column]."""
    z_mm: float
    """Height of the frame, mm."""
    content: dict[str, Any]
    """Tags of FrameContentSequence."""
    groups: dict[str, dict[str, Any]]
    """Tags of other functional groups by the keyword of the group."""


def item(**tags: Any) -> Dataset:
    """Return a data set with some tags."""
    dataset = Dataset()
    for keyword, value in tags.items():
        setattr(dataset, keyword, value)
    return dataset


def chest_frames(
    hu: np.ndarray | None = None,
    *,
    slope: Callable[[int], float] = lambda index: 1.0,
    intercept: Callable[[int], float] = lambda index: -1024.0,
    first_mm: float = 0.0,
    gap_mm: float = GAP_MM,
    content: dict[str, Any] | None = None,
    groups: dict[str, dict[str, Any]] | None = None,
) -> list[Frame]:
    """Return the frames of a chest from bottom to top, each with a separate rescale."""
    frames = []
    for index, values in enumerate(chest() if hu is None else hu):
        stored = np.rint((values.astype(np.float64) - intercept(index)) / slope(index))
        rescale = {"RescaleSlope": slope(index), "RescaleIntercept": intercept(index), "RescaleType": "HU"}
        own = {"PixelValueTransformationSequence": rescale, **(groups or {})}
        frames.append(Frame(stored.astype("<u2"), round(first_mm + index * gap_mm, 6), dict(content or {}), own))
    return frames


def enhanced(
    path: Path,
    frames: Sequence[Frame],
    *,
    edit: EditFile | None = None,
    series_uid: str = "1.2.3.4.7",
    kind: str = EnhancedCTImageStorage,
    number: int = 3,
    syntax: str = ExplicitVRLittleEndian,
    streams: Sequence[bytes] | None = None,
    shared_position: bool = False,
) -> Path:
    """Write one enhanced file; ``streams`` are compressed frames, and ``edit(dataset)`` changes the file."""
    dataset = Dataset()
    dataset.file_meta = FileMetaDataset()
    dataset.file_meta.TransferSyntaxUID = syntax
    dataset.file_meta.MediaStorageSOPClassUID = dataset.SOPClassUID = kind
    dataset.SOPInstanceUID = dataset.file_meta.MediaStorageSOPInstanceUID = generate_uid()
    dataset.ImageType = ["ORIGINAL", "PRIMARY", "VOLUME", "NONE"]
    dataset.Modality = "CT"
    dataset.SeriesDescription = "Thorax"
    dataset.PatientName, dataset.PatientID, dataset.PatientBirthDate = "Secret^One", "SECRET-1", "19010101"
    dataset.StudyInstanceUID, dataset.SeriesInstanceUID = "1.2.3.4.5", series_uid
    dataset.FrameOfReferenceUID = "1.2.3.4.6"
    dataset.SeriesNumber, dataset.AcquisitionNumber = number, 1
    dataset.NumberOfFrames = len(frames)
    dataset.Rows, dataset.Columns = frames[0].stored.shape
    dataset.SamplesPerPixel, dataset.PhotometricInterpretation = 1, "MONOCHROME2"
    dataset.BitsAllocated, dataset.BitsStored, dataset.HighBit, dataset.PixelRepresentation = 16, 16, 15, 0
    shared = Dataset()
    shared.PixelMeasuresSequence = Items([item(PixelSpacing=[0.9, 0.7], SliceThickness=3.0)])
    shared.PlaneOrientationSequence = Items([item(ImageOrientationPatient=[1, 0, 0, 0, 1, 0])])
    shared.CTReconstructionSequence = Items([item(ConvolutionKernel="B41f")])
    dataset.SharedFunctionalGroupsSequence = Items([shared])
    groups = []
    for frame in frames:
        own = Dataset()
        own.FrameContentSequence = Items([item(**frame.content)])
        own.PlanePositionSequence = Items([item(ImagePositionPatient=[*ORIGIN_LPS, frame.z_mm])])
        for keyword, tags in frame.groups.items():
            setattr(own, keyword, Items([item(**tags)]))
        groups.append(own)
    dataset.PerFrameFunctionalGroupsSequence = Items(groups)
    if streams is None:
        dataset.PixelData = b"".join(frame.stored.astype("<u2").tobytes() for frame in frames)
        dataset["PixelData"].VR = "OW"
    else:
        dataset.PixelData = encapsulate(list(streams))
        dataset["PixelData"].VR = "OB"
        dataset["PixelData"].is_undefined_length = True
    if edit is not None:
        edit(dataset)
    path.parent.mkdir(parents=True, exist_ok=True)
    dataset.save_as(path, enforce_file_format=True)
    return path
