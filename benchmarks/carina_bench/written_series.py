"""DICOM series that benchmarks open: one uncompressed file for each slice of a generated chest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import UID, CTImageStorage, ExplicitVRLittleEndian, generate_uid

from carina.volume import Volume

__all__ = ["BOX_LPS", "write_slices", "write_stack"]

BOX_LPS = ((-179.2, -181.2, -189.5), (178.6, 176.6, 110.0))
"""Box of the generated chest: lowest and highest corner, LPS mm."""

_TEXTS = (
    "AccessionNumber", "BodyPartExamined", "ConvolutionKernel", "DeviceSerialNumber", "FilterType", "InstitutionName",
    "Manufacturer", "ManufacturerModelName", "PatientPosition", "ProtocolName", "RotationDirection", "ScanOptions",
    "SoftwareVersions", "StationName", "StudyDescription", "StudyID",
)  # fmt: skip
_NUMBERS = (
    "CTDIvol", "DataCollectionDiameter", "DistanceSourceToDetector", "DistanceSourceToPatient", "ExposureTime",
    "FocalSpots", "GantryDetectorTilt", "GeneratorPower", "KVP", "ReconstructionDiameter", "SingleCollimationWidth",
    "SliceLocation", "SliceThickness", "SpiralPitchFactor", "TableHeight", "TableSpeed", "TotalCollimationWidth",
    "WindowCenter", "WindowWidth", "XRayTubeCurrent",
)  # fmt: skip


def write_slices(volume: Volume, folder: Path, syntax: UID = ExplicitVRLittleEndian) -> Path:
    """Write a DICOM series with one uncompressed file per slice, as a scanner does; return its folder."""
    return write_stack(volume.hu_zyx, volume.lps_from_ijk, folder, syntax)


def write_stack(
    hu_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    folder: Path,
    syntax: UID = ExplicitVRLittleEndian,
) -> Path:
    """Write a DICOM series of slices whose stack may be sheared, as by a tilted gantry; return its folder.

    Parameters
    ----------
    hu_zyx
        (slices, rows, columns) HU.
    lps_from_ijk
        (4, 4) transform from column, row and slice to LPS mm; its third axis is the step from slice to slice.
    folder
        New folder.
    syntax
        An uncompressed transfer syntax.
    """
    folder.mkdir()
    series_uid, study_uid, frame_uid = generate_uid(), generate_uid(), generate_uid()
    step, spacing = lps_from_ijk, np.linalg.norm(lps_from_ijk[:3, :2], axis=0)
    directions = (lps_from_ijk[:3, :2] / spacing).T.reshape(-1)
    for index, values in enumerate(hu_zyx):
        dataset = Dataset()
        dataset.file_meta = FileMetaDataset()
        dataset.file_meta.TransferSyntaxUID = syntax
        dataset.file_meta.MediaStorageSOPClassUID = dataset.SOPClassUID = CTImageStorage
        dataset.SOPInstanceUID = dataset.file_meta.MediaStorageSOPInstanceUID = generate_uid()
        dataset.ImageType = ["ORIGINAL", "PRIMARY", "AXIAL"]
        dataset.Modality, dataset.SeriesDescription, dataset.SeriesNumber = "CT", "Synthetic chest", 1
        dataset.StudyInstanceUID, dataset.SeriesInstanceUID = study_uid, series_uid
        dataset.FrameOfReferenceUID = frame_uid
        dataset.Rows, dataset.Columns = values.shape
        dataset.PixelSpacing = [round(float(spacing[1]), 6), round(float(spacing[0]), 6)]
        dataset.ImageOrientationPatient = [round(float(v), 9) for v in directions]
        dataset.ImagePositionPatient = [round(float(v), 6) for v in step[:3, 3] + index * step[:3, 2]]
        dataset.SamplesPerPixel, dataset.PhotometricInterpretation = 1, "MONOCHROME2"
        dataset.BitsAllocated, dataset.BitsStored, dataset.HighBit, dataset.PixelRepresentation = 16, 16, 15, 1
        dataset.RescaleSlope, dataset.RescaleIntercept = 1, 0
        _add_scanner_tags(dataset, index)
        dataset.PixelData = values.astype("<i2" if syntax.is_little_endian else ">i2").tobytes()
        dataset["PixelData"].VR = "OW"
        dataset.save_as(folder / f"IM{index:04d}", enforce_file_format=True)
    return folder


def _add_scanner_tags(dataset: Dataset, index: int) -> None:
    """Add tags without influence on the volume, as many as a scanner writes: headers of CTs have about 120."""
    moment = f"10{index // 60:02d}{index % 60:02d}.25"
    dataset.PatientName, dataset.PatientID, dataset.PatientSex, dataset.PatientAge = "Phantom", "PHANTOM", "O", "060Y"
    for keyword in ("StudyDate", "SeriesDate", "AcquisitionDate", "ContentDate"):
        setattr(dataset, keyword, "20260101")
    for keyword in ("StudyTime", "SeriesTime"):
        setattr(dataset, keyword, "100000")
    dataset.AcquisitionTime = dataset.ContentTime = moment
    for keyword in _TEXTS:
        setattr(dataset, keyword, "CHEST")
    for keyword in _NUMBERS:
        setattr(dataset, keyword, 100)
    dataset.AcquisitionNumber, dataset.InstanceNumber = 1, index + 1
    code = Dataset()
    code.CodeValue, code.CodingSchemeDesignator, code.CodeMeaning = "CT", "DCM", "Chest"
    dataset.ProcedureCodeSequence, dataset.ReferencedStudySequence = [code], [Dataset(), Dataset()]
    for group in (0x0019, 0x0029, 0x0043):
        block = dataset.private_block(group, "CARINA BENCHMARK", create=True)
        for element in range(20):
            block.add_new(element, "LO", f"value {element}")
