"""Tests of privacy of exported cases: no name, number, date or text of the CT, with or without the packed scan."""

from __future__ import annotations

import contextlib
import json
import sqlite3
import zlib
from pathlib import Path

import numpy as np
import pytest
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian

import carina as package
from cached_test_data import cached_phantom
from carina import commands as c
from carina.volume import write_grid

UID = "1.2.826.0.1.3680043.9999.19610405"
TAGS = {
    "PatientName": "Müller^Gudrun",
    "PatientID": "KIS-4711-0815",
    "PatientBirthDate": "19610405",
    "PatientAddress": "Lindenallee 17",
    "OtherPatientIDs": "VERS-A123456789",
    "ReferringPhysicianName": "Sauerbruch^Ferdinand",
    "OperatorsName": "Röntgen^Wilhelm",
    "InstitutionName": "Charité Campus Mitte",
    "StationName": "SCANNER-RAUM-5",
    "AccessionNumber": "ACC-20260131-77",
    "StudyDate": "20251224",
    "SeriesDate": "20251224",
    "AcquisitionDate": "20251224",
    "StudyTime": "173015",
    "StudyDescription": "Verdacht Karzinom Gudrun",
    "SeriesDescription": "Thorax Mueller duennschicht",
    "ProtocolName": "PROTOKOLL Mueller",
    "ImageComments": "Frau Mueller hustet",
    "StudyInstanceUID": f"{UID}.1",
    "SeriesInstanceUID": f"{UID}.2",
    "FrameOfReferenceUID": f"{UID}.3",
}
SECRETS = (
    "Müller", "Mueller", "MUELLER", "Gudrun", "KIS-4711", "4711-0815", "Lindenallee", "A123456789", "Sauerbruch",
    "Röntgen", "Wilhelm", "Charité", "SCANNER-RAUM", "ACC-2026", "Karzinom", "PROTOKOLL", "hustet", "duennschicht",
    "19610405", "1961-04-05", "05.04.1961", "1961/04/05", "20251224", "2025-12-24", "24.12.2025", "173015", UID,
    "geheim",
)  # fmt: skip
ENCODINGS = ("utf-8", "latin-1", "utf-16-le", "utf-16-be")


def write_ct(folder: Path, chest) -> None:
    """Write a DICOM series with patient data in every tag that can contain text."""
    folder.mkdir(parents=True)
    volume = chest.volume
    matrix = volume.lps_from_ijk
    steps = np.linalg.norm(matrix[:3, :3], axis=0)
    for index, values in enumerate(volume.hu_zyx):
        slice_ = Dataset()
        slice_.file_meta = FileMetaDataset()
        slice_.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        slice_.file_meta.MediaStorageSOPClassUID = slice_.SOPClassUID = CTImageStorage
        slice_.file_meta.MediaStorageSOPInstanceUID = slice_.SOPInstanceUID = f"{UID}.2.{index + 1}"
        slice_.SpecificCharacterSet = "ISO_IR 100"
        for name, value in TAGS.items():
            setattr(slice_, name, value)
        slice_.Modality, slice_.ImageType = "CT", ["ORIGINAL", "PRIMARY", "AXIAL"]
        slice_.SeriesNumber, slice_.InstanceNumber = 3, index + 1
        slice_.Rows, slice_.Columns = values.shape
        slice_.PixelSpacing = [float(steps[1]), float(steps[0])]
        slice_.ImageOrientationPatient = [*(matrix[:3, 0] / steps[0]), *(matrix[:3, 1] / steps[1])]
        slice_.ImagePositionPatient = [float(f"{v:.9f}") for v in matrix[:3, 3] + index * matrix[:3, 2]]
        slice_.SamplesPerPixel, slice_.PhotometricInterpretation = 1, "MONOCHROME2"
        slice_.BitsAllocated = slice_.BitsStored = 16
        slice_.HighBit, slice_.PixelRepresentation = 15, 1
        slice_.RescaleSlope, slice_.RescaleIntercept = 1, 0
        slice_.PixelData = values.astype("<i2").tobytes()
        slice_["PixelData"].VR = "OW"
        slice_.save_as(folder / f"Mueller_{index:03d}_geheim.dcm", enforce_file_format=True)


def contents_of(path: Path):
    """Return all bytes of a file, the uncompressed content of its blobs, and its decoded texts."""
    yield path.read_bytes()
    with contextlib.closing(sqlite3.connect(path)) as case:
        for (table,) in case.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall():
            for row in case.execute(f"SELECT * FROM {table}"):
                for value in row:
                    blobs = [value] if isinstance(value, bytes) else [str(value).encode()]
                    with contextlib.suppress(zlib.error):
                        blobs.append(zlib.decompress(blobs[0]))
                    for blob in tuple(blobs):
                        with contextlib.suppress(ValueError):
                            blobs.append(json.dumps(json.loads(blob), ensure_ascii=False).encode())
                    yield from blobs


def needles() -> dict[bytes, str]:
    forms = [(form, secret) for secret in SECRETS for form in (secret, secret.lower(), secret.upper())]
    return {form.encode(encoding): secret for form, secret in forms for encoding in ENCODINGS}


def names_in(path: Path) -> set[str]:
    return {secret for content in contents_of(path) for needle, secret in needles().items() if needle in content}


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """Return a case of a patient's CT, saved beside the folder of the CT and in another folder."""
    root = tmp_path_factory.mktemp("privacy")
    person = root / "Müller, Gudrun 1961-04-05"
    chest = cached_phantom(spacing_mm=3.0, generations=3)
    write_ct(person / "ct", chest)
    mask = person / "Mueller_geheim_airways.nii.gz"
    write_grid(mask, chest.lumen_zyx, chest.volume.lps_from_ijk, what="the mask")
    with package.Case.open(person / "ct") as case:
        case.do(c.TakeMask(str(mask)))
        tip = case.airways.tree.tips()[0]
        case.do(c.AddTarget(tuple(float(v) for v in tip.points[-1])))
        case.do(c.EditTree(c.RenameBranch(tip.id, "near the tumour")))
        case.do(c.EditKeyFrames(c.KeyFrameAdd()))
        case.save(person / "beside.carina")
        case.save(root / "far.carina")
    return root, person


def test_privacy_check_detects_patient_data_in_slices_and_compressed_blobs(saved, tmp_path):
    _, person = saved
    assert {"Müller", "KIS-4711", "19610405", UID} <= {
        secret for needle, secret in needles().items() if needle in next((person / "ct").iterdir()).read_bytes()
    }
    with contextlib.closing(sqlite3.connect(tmp_path / "told.db")) as connection:
        connection.execute("CREATE TABLE one (a)")
        connection.execute("INSERT INTO one VALUES (?)", (zlib.compress(b'"M\\u00fcller"'),))
        connection.commit()
    assert names_in(tmp_path / "told.db") == {"Müller"}


def test_case_saved_under_a_name_contains_no_patient_data(saved):
    assert names_in(saved[1] / "beside.carina") == set()


def test_case_that_contains_its_scan_contains_no_patient_data(saved, carina, tmp_path):
    root, person = saved
    for name, path in (("one", person / "beside.carina"), ("other", root / "far.carina")):
        packed = tmp_path / f"{name}.carina"
        assert carina("case", "pack", path, "-o", packed).code == 0
        assert packed.stat().st_size > path.stat().st_size
        assert names_in(packed) == set()
