"""Writer of DICOM series of a small synthetic chest; each slice can be changed before it is written."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import SimpleITK as sitk
from pydicom import dcmread
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.encaps import encapsulate, generate_frames
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, generate_uid

__all__ = ["NUM_SLICES", "Edit", "chest", "packed", "repack", "series"]

NUM_SLICES, SIDE = 20, 32
GAP_MM = 2.5
Edit = Callable[[Dataset, int], None]


@cache
def chest(num_slices: int = NUM_SLICES, *, noise_hu: float = 15.0, seed: int = 5) -> np.ndarray:
    """Return int16 HU [z, y, x] of a body with two lungs, trachea and spine, which change slowly between slices."""
    z, y, x = np.mgrid[:num_slices, :SIDE, :SIDE].astype(np.float64)
    x, y, z = (x - 15.5) / 15.5, (y - 15.5) / 15.5, z / NUM_SLICES
    hu = np.full(z.shape, -1000.0)
    hu[(x / 0.95) ** 2 + (y / 0.75) ** 2 < 1] = 40
    lung = 0.30 + 0.1 * z
    hu[((np.abs(x) - 0.48) / lung) ** 2 + (y / 0.5) ** 2 < 1] = -850
    hu[(x / 0.1) ** 2 + ((y - 0.05) / 0.1) ** 2 < 1] = -990
    hu[(x / 0.15) ** 2 + ((y - 0.55) / 0.15) ** 2 < 1] = 400
    hu += np.random.default_rng(seed).normal(0, noise_hu, hu.shape)
    values = np.clip(np.rint(hu), -1024, 3000).astype(np.int16)
    values.flags.writeable = False
    return values


def series(
    folder: Path,
    edit: Edit | None = None,
    *,
    hu: np.ndarray | None = None,
    name: Callable[[int], str] = lambda index: f"IM{index:03d}",
    number: int = 3,
    uid: str | None = None,
    shift_mm: float = 0.0,
    gap_mm: float = GAP_MM,
    syntax: str = ExplicitVRLittleEndian,
) -> Path:
    """Write a series into the folder, one file for each slice, stored as HU + 1024 in unsigned 16-bit numbers.

    ``edit(dataset, index)`` changes a slice before it is written.
    """
    hu = chest() if hu is None else hu
    uid = uid or generate_uid()
    folder.mkdir(parents=True, exist_ok=True)
    for index, values in enumerate(hu):
        dataset = Dataset()
        dataset.file_meta = FileMetaDataset()
        dataset.file_meta.TransferSyntaxUID = syntax
        dataset.file_meta.MediaStorageSOPClassUID = dataset.SOPClassUID = CTImageStorage
        dataset.SOPInstanceUID = dataset.file_meta.MediaStorageSOPInstanceUID = generate_uid()
        dataset.ImageType = ["ORIGINAL", "PRIMARY", "AXIAL"]
        dataset.Modality = "CT"
        dataset.SeriesDescription = "Thorax"
        dataset.PatientName, dataset.PatientID, dataset.PatientBirthDate = "Secret^One", "SECRET-1", "19010101"
        dataset.StudyInstanceUID, dataset.SeriesInstanceUID = "1.2.3.4.5", uid
        dataset.FrameOfReferenceUID = "1.2.3.4.6"
        dataset.SeriesNumber, dataset.AcquisitionNumber = number, 1
        dataset.ConvolutionKernel, dataset.KVP = "B41f", "120"
        dataset.AcquisitionTime = "101500.0"
        dataset.Rows, dataset.Columns = values.shape
        dataset.PixelSpacing = [0.9, 0.7]
        dataset.ImageOrientationPatient = [1, 0, 0, 0, 1, 0]
        dataset.ImagePositionPatient = [-11.25, -14.5, round(shift_mm + index * gap_mm, 6)]
        dataset.SamplesPerPixel, dataset.PhotometricInterpretation = 1, "MONOCHROME2"
        dataset.BitsAllocated, dataset.BitsStored, dataset.HighBit, dataset.PixelRepresentation = 16, 16, 15, 0
        dataset.RescaleSlope, dataset.RescaleIntercept = 1, -1024
        dataset.PixelData = (values.astype(np.int32) + 1024).astype("<u2").tobytes()
        dataset["PixelData"].VR = "OW"
        if edit is not None:
            edit(dataset, index)
        path = folder / name(index)
        path.parent.mkdir(parents=True, exist_ok=True)
        with contextlib.redirect_stderr(io.StringIO()):
            dataset.save_as(path, enforce_file_format=True)
    return folder


def packed(dataset: Dataset, folder: Path, kind: str) -> None:
    """Compress the pixels of a slice without loss; ``kind`` is ``JPEG2000`` or ``JPEG``."""
    text = np.frombuffer(dataset.PixelData, "<u2").reshape(1, dataset.Rows, dataset.Columns)
    path = folder / "packed.tmp.dcm"
    writer = sitk.ImageFileWriter()
    writer.SetImageIO("GDCMImageIO")
    writer.SetFileName(str(path))
    writer.UseCompressionOn()
    writer.SetCompressor(kind)
    writer.Execute(sitk.GetImageFromArray(text.astype(np.int16 if dataset.PixelRepresentation else np.uint16)))
    found = dcmread(path)
    path.unlink()
    dataset.file_meta.TransferSyntaxUID = found.file_meta.TransferSyntaxUID
    dataset.PixelData = found.PixelData
    dataset["PixelData"].VR = "OB"
    dataset["PixelData"].is_undefined_length = True


def repack(dataset: Dataset, change: Callable[[bytes], bytes]) -> None:
    """Replace the compressed stream of a slice by ``change(stream)``."""
    frame = change(next(generate_frames(dataset.PixelData, number_of_frames=1)))
    dataset.PixelData = encapsulate([frame])
    dataset["PixelData"].VR = "OB"
    dataset["PixelData"].is_undefined_length = True
