"""Odd but honest inputs: what scanners, archives and programs write, each a kind that has to open.

The corpus (``corpus.py``) has most of them. This module selects those without damage and contradiction, and adds more
from public reports, which ``REPORTED`` names.
"""

from __future__ import annotations

import io
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from corpus import Input, all_inputs
from dicom_writer import chest, series
from pydicom.dataset import Dataset
from vti_writer import write_vti

__all__ = ["KINDS", "REPORTED"]

_DAMAGED = ("import.files-unread", "import.pixels-damaged", "import.slices-odd", "import.byte-order",
            "import.pixels-contradict", "import.clipped", "import.extra-data", "import.scaling",
            "import.two-patients", "import.not-numbers", "import.modality-lut")  # fmt: skip
"""Notes of damaged or contradicting inputs, which are not honest."""


def _edited(edit: Callable[[Dataset, int], None], **options: object) -> Callable[[Path], Path]:
    return lambda folder: series(folder / "scan", edit, **options)


def _set(**values: object) -> Callable[[Path], Path]:
    def edit(dataset: Dataset, _index: int) -> None:
        for keyword, value in values.items():
            setattr(dataset, keyword, value)

    return _edited(edit)


def _reversed(folder: Path) -> Path:
    return series(
        folder / "scan", lambda d, i: setattr(d, "InstanceNumber", 20 - i), name=lambda i: f"{20 - i:03d}.dcm"
    )


def _private(dataset: Dataset, _index: int) -> None:
    dataset.private_block(0x0019, "GEMS_ACQU_01", create=True).add_new(0x02, "SL", 912)


def _signed(dataset: Dataset, _index: int) -> None:
    stored = np.frombuffer(dataset.PixelData, "<u2").astype(np.int32) - 1024
    dataset.PixelData = stored.astype("<i2").tobytes()
    dataset.PixelRepresentation, dataset.RescaleIntercept = 1, 0


def _twelve_bits(dataset: Dataset, index: int) -> None:
    _signed(dataset, index)
    dataset.BitsStored, dataset.HighBit = 12, 11
    dataset.PixelData = (np.frombuffer(dataset.PixelData, "<u2") & 0x0FFF).tobytes()


def _latin(dataset: Dataset, _index: int) -> None:
    dataset.SpecificCharacterSet = ["", "ISO 2022 IR 100"]
    dataset.ImageComments = "a comment"
    dataset.PatientName = "Müller^Jörg"


def _turned(dataset: Dataset, index: int) -> None:
    dataset.ImageOrientationPatient = [-1, 0, 0, 0, 1, 0]
    dataset.ImagePositionPatient = [11.25, -14.5, round(-index * 2.5, 6)]


def _coronal(dataset: Dataset, index: int) -> None:
    dataset.ImageOrientationPatient = [1, 0, 0, 0, 0, -1]
    dataset.ImagePositionPatient = [-11.25, round(index * 2.5, 6), 100.0]


def _oblique(dataset: Dataset, index: int) -> None:
    row, column = np.array([0.8, 0.6, 0.0]), np.array([-0.36, 0.48, -0.8])
    dataset.ImageOrientationPatient = [float(v) for v in (*row, *column)]
    dataset.ImagePositionPatient = [round(float(v), 8) for v in np.cross(row, column) * 2.5 * index]


def _far(dataset: Dataset, index: int) -> None:
    dataset.ImagePositionPatient = [-1011.25, -2014.5, round(-1500.0 + index * 2.5, 6)]


def _zip_of_folders(folder: Path) -> Path:
    scan = series(folder / "scan")
    path = folder / "scan.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        archive.writestr("Study 1/", "")
        archive.writestr("__MACOSX/Study 1/._IM000", b"\x00\x05\x16\x07")
        archive.writestr("Study 1/.DS_Store", b"\0\0\0\1Bud1")
        for one in scan.iterdir():
            archive.write(one, f"Study 1/Serie Ä 3/{one.name}")
    return path


def _tar_of_folders(folder: Path) -> Path:
    scan = series(folder / "scan")
    path = folder / "scan.tar.bz2"
    with tarfile.open(path, "w:bz2", format=tarfile.PAX_FORMAT) as archive:
        for one in scan.iterdir():
            member = tarfile.TarInfo(f"{'Téte, face, sinus ' * 8}/{one.name}")
            member.size = one.stat().st_size
            archive.addfile(member, io.BytesIO(one.read_bytes()))
    return path


def _vti(coding: str, **options: object) -> Callable[[Path], Path]:
    return lambda folder: write_vti(folder / "ct.vti", chest(), coding, **options)


NEW = "New inputs"
_DOUBTED = ("import.orientation-doubted",)
REPORTED: dict[str, tuple[Callable[[Path], Path], tuple[str, ...], str]] = {
    "numbers of the slices in the other order": (_reversed, (), "ivmartel/dwv#560"),
    "no instance numbers": (_set(InstanceNumber=None), (), "icometrix/dicom2nifti#7"),
    "rows towards the right, slices from above": (_edited(_turned), (), "epam/mriviewer#250"),
    "coronal slices": (_edited(_coronal), (), "medInria/medInria-public#427"),
    "oblique slices": (_edited(_oblique), (), "cornerstonejs/cornerstone3D#160"),
    "slice thickness larger than the distance": (_set(SliceThickness="5"), (), "moloney/dcmstack#29"),
    "slice thickness smaller than the distance": (_set(SliceThickness="0.5"), (), "bbrister/SIFT3D#14"),
    "a negative SpacingBetweenSlices": (_set(SpacingBetweenSlices="-5"), (), "Slicer/Slicer#7987"),
    "a window of several values": (
        _set(WindowCenter=[40, -600], WindowWidth=[400, 1500]), (), "pymedphys/pymedphys#1906",
    ),
    "signed pixels with intercept 0": (_edited(_signed), (), "xtk/X#144"),
    "signed pixels in 12 of 16 bits": (_edited(_twelve_bits), (), "rordenlab/dcm2niix#688"),
    "texts in ISO 2022 IR 100": (_edited(_latin), (), "pydicom/pydicom#850"),
    "a zip archive made on macOS": (_zip_of_folders, (), "ImageMarkup/isic-challenge-scoring#15"),
    "folders with accents in a tar.bz2 archive": (_tar_of_folders, (), "commontk/CTK#404"),
    "VTI, base64 with zlib": (_vti("binary-zlib"), _DOUBTED, "Kitware/vtk-js#829"),
    "VTI, appended base64": (_vti("base64"), _DOUBTED, "InsightSoftwareConsortium/ITK#6032"),
    "VTI, appended base64 with zlib": (_vti("base64-zlib"), _DOUBTED, "JuliaVTK/ReadVTK.jl#73"),
    "VTI, appended raw, big endian": (_vti("raw", order=">", word="Q"), _DOUBTED, ""),
    "VTI, ASCII": (_vti("ascii"), _DOUBTED, ""),
    "private attributes in every slice": (_edited(_private), (), ""),
    "positions metres away from the origin": (_edited(_far), (), ""),
}  # fmt: skip
"""Maker, expected notes and the public report, if one was found, of each new kind."""


def _kinds() -> tuple[Input, ...]:
    new = tuple(
        Input(name, NEW, make, "opens", notes=notes, voxels=chest) for name, (make, notes, _) in REPORTED.items()
    )
    honest = tuple(
        entry
        for entry in all_inputs()
        if entry.expected == "opens" and entry.is_hu and entry.voxels is not None and not set(entry.notes) & {*_DAMAGED}
    )
    return honest + new


KINDS = _kinds()
"""Every odd but honest kind of input, with the exact voxels."""

PARTED = "merges or omits slices of two stacks in one folder"
MERGED = "joins slices whose settings differ, or leaves some out"
ENHANCED = "ignores the positions or rescales of single frames"
NOT_RIGHT = "refuses axes that are not at right angles"
COMPRESSED = "needs CompressedDataSize, which other programs leave out"
OTHERWISE_READ: dict[str, dict[str, tuple[str, str]]] = {
    "dcm2niix": {
        "another image type in the first and the last slice": ("reads other positions", MERGED),
        "some slices without series number and kernel": ("reads other positions", MERGED),
        "three slices without SeriesInstanceUID": ("reads other positions", MERGED),
        "a different frame of reference in every slice, and two kernels in alternating slices": (
            "reads other positions", PARTED,
        ),
        **dict.fromkeys(
            (
                "two studies in alternating slices",
                "two frames of reference in alternating slices",
                "two pixel spacings under one series UID",
                "two kernels at the same positions",
                "two kernels in alternating slices",
                "two kernels in alternating slices, with equal numbers of slices",
                "two acquisitions in alternating slices",
                "two acquisitions in alternating slices that differ only in their time",
                "two phases at the same positions",
                "with and without contrast agent at the same positions",
                "no series UID, two kernels in alternating slices",
            ),
            ("reads other positions", PARTED),
        ),
        # For the following two inputs, the result of dcm2niix depends on the order of the files in the folder.
        "two breath-holds that overlap by four slices": ("reads other values or reads other positions", PARTED),
        "a second kernel at some of the positions": ("reads other values or reads other positions", PARTED),
        "one file, frames in any order": ("reads other positions", ENHANCED),
        "a different slope and intercept in every frame": ("reads other positions", ENHANCED),
        "a series of four files with five frames each": ("reads other positions", ENHANCED),
        "two phases in one file": ("reads other positions", ENHANCED),
        "two files at the same positions": ("reads other positions", ENHANCED),
        "deflated": ("reads nothing", "does not inflate"),
        "signed pixels in 12 of 16 bits": ("reads other values", "takes the sign from the 16th bit"),
    },
    "SimpleITK": {
        "one file, frames in any order": ("reads other positions", ENHANCED),
        "a series of four files with five frames each": ("reads other positions", ENHANCED),
        "a different slope and intercept in every frame": ("reads other values", ENHANCED),
        "slope 0: neither slope nor intercept (-1024) is applied": (
            "reads other values", "adds the intercept, which nifti1.h forbids",
        ),
        "one file, compressed": ("reads other values", COMPRESSED),
        "64-bit floats, compressed": ("reads other values", COMPRESSED),
        "a compressed MetaImage file, compressed with gzip as a whole": ("reads other values", COMPRESSED),
        "NIfTI, axes 0.02 degrees off": ("reads nothing", NOT_RIGHT),
        "NIfTI, axes 0.17 degrees off": ("reads nothing", NOT_RIGHT),
        "NIfTI, axes 0.17 degrees off, the nearest rotation as qform": (
            "reads other positions", "uses the nearest rotation, 0.03 mm away",
        ),
        "a comment of 10 kB": ("reads nothing", "limits the length of a line"),
    },
    "nibabel": {
        "in metres, declared as metres": ("reads other positions", "does not convert units to mm"),
        "in micrometres, declared as micrometres": ("reads other positions", "does not convert units to mm"),
    },
    "pynrrd": {
        "compressed with bgzip, in many members": ("fails: NRRDError", "reads only the first gzip member"),
        "compressed, after bytes that readers skip": ("fails: error", "ignores `byte skip` of compressed values"),
    },
}  # fmt: skip
"""Answer of each reader that does not read an input in the same way, with the reason, by the name of the input."""
