"""Fixtures that write DICOM series, correct or with a defect in chosen slices."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, generate_uid

ROW_LPS = np.array([0.8, 0.6, 0.0])
"""Direction of the rows, LPS; the directions are oblique, so a test with exchanged axes or signs fails."""
COLUMN_LPS = np.array([-0.36, 0.48, -0.8])
"""Direction of the columns, LPS."""
NORMAL_LPS = np.cross(ROW_LPS, COLUMN_LPS)
"""Direction of the slices, LPS."""
ORIGIN_LPS = np.array([-31.5, 12.25, 140.0])
"""Position of the first pixel of the first slice, LPS mm."""
ROW_MM, COLUMN_MM, GAP_MM = 0.9, 0.7, 1.25
"""Distances between rows, between columns and between slices, mm; all differ, so exchanged axes are detected."""
ROWS, COLUMNS, SLICES = 11, 13, 9
"""Numbers of rows, columns and slices."""


def stored_values(index: int) -> np.ndarray:
    """Return stored pixel values that differ in every pixel of a slice and between slices."""
    grid = np.arange(ROWS * COLUMNS, dtype=np.int16).reshape(ROWS, COLUMNS)
    return (grid * 8 + index * 17).astype(np.int16)


@pytest.fixture
def write_series(tmp_path: Path) -> Callable[..., Path]:
    """Return a function that writes one CT series into a folder and returns the folder.

    Its argument ``edit(dataset, index)`` changes a slice before it is written.
    """

    def write(
        folder: str = "scan",
        *,
        edit: Callable[[Dataset, int], None] | None = None,
        series_uid: str | None = None,
        number: int = 3,
        description: str = "Thorax 1.25",
        num_slices: int = SLICES,
        name: Callable[[int], str] = lambda index: f"IM{index:03d}",
        syntax: str = ExplicitVRLittleEndian,
    ) -> Path:
        path = tmp_path / folder
        path.mkdir(exist_ok=True)
        uid = series_uid or generate_uid()
        for index in range(num_slices):
            meta = FileMetaDataset()
            meta.TransferSyntaxUID = syntax
            meta.MediaStorageSOPClassUID = CTImageStorage
            meta.MediaStorageSOPInstanceUID = generate_uid()
            dataset = Dataset()
            dataset.file_meta = meta
            dataset.SOPClassUID = CTImageStorage
            dataset.SOPInstanceUID = meta.MediaStorageSOPInstanceUID
            dataset.SeriesInstanceUID = uid
            dataset.StudyInstanceUID = "1.2.3.4.5"
            dataset.PatientName = "Secret^Person"
            dataset.PatientID = "SECRET-ID"
            dataset.Modality = "CT"
            dataset.ImageType = ["ORIGINAL", "PRIMARY", "AXIAL"]
            dataset.SeriesNumber = number
            dataset.SeriesDescription = description
            # The thickness differs from the distance between slices, because the importer must not use it.
            dataset.SliceThickness = 5.0
            dataset.Rows, dataset.Columns = ROWS, COLUMNS
            dataset.PixelSpacing = [ROW_MM, COLUMN_MM]
            dataset.ImageOrientationPatient = [*ROW_LPS, *COLUMN_LPS]
            dataset.ImagePositionPatient = [float(f"{v:.9f}") for v in ORIGIN_LPS + index * GAP_MM * NORMAL_LPS]
            dataset.SamplesPerPixel = 1
            dataset.PhotometricInterpretation = "MONOCHROME2"
            dataset.BitsAllocated = dataset.BitsStored = 16
            dataset.HighBit = 15
            dataset.PixelRepresentation = 1
            dataset.RescaleSlope, dataset.RescaleIntercept = 1, -1024
            dataset.PixelData = stored_values(index).tobytes()
            dataset["PixelData"].VR = "OW"
            if edit is not None:
                edit(dataset, index)
            dataset.save_as(path / name(index), enforce_file_format=True)
        return path

    return write


@pytest.fixture
def expected_lps_from_ijk() -> np.ndarray:
    """Return ``lps_from_ijk`` of the series that ``write_series`` writes without an edit."""
    matrix = np.eye(4)
    matrix[:3, 0] = ROW_LPS * COLUMN_MM
    matrix[:3, 1] = COLUMN_LPS * ROW_MM
    matrix[:3, 2] = NORMAL_LPS * GAP_MM
    matrix[:3, 3] = ORIGIN_LPS
    return matrix


@pytest.fixture
def expected_hu_zyx() -> np.ndarray:
    """Return the HU values [z, y, x] of the series that ``write_series`` writes without an edit."""
    return np.stack([stored_values(index) - 1024 for index in range(SLICES)]).astype(np.int16)
