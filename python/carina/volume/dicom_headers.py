"""The tags of each DICOM file that decide where its pixels are and what they mean (PS3.3 C.7.6.2, C.7.6.3, C.8.2.1).

Headers of foreign files are hostile until proven otherwise: every value is checked where it is read, and what a file
lacks is kept as a sentence (``problem``) for the person, never guessed.
"""

from __future__ import annotations

import logging
import math
import os
import warnings
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pydicom
from pydicom.dataset import Dataset

from carina.errors import VolumeImportError
from carina.volume.watch import Watch

__all__ = ["MAX_IMAGE_SIDE", "SliceHeader", "looks_like_dicom", "read_dataset", "read_headers"]

# pydicom reports odd values with the value itself, which may be a name; nothing of a header may reach a log.
logging.getLogger("pydicom").setLevel(logging.CRITICAL + 1)

MAX_FILES = 200_000  # more is somebody's disk, not a scan
MAX_IMAGE_SIDE = (
    8192  # pixels; the largest detectors are half of that, and a lying header is stopped before memory is taken
)
_MAX_INFLATED_BYTES = 1 << 28  # of one file in the deflated transfer syntax
_DEFLATED = b"1.2.840.10008.1.2.1.99"

_TAGS = [
    "BitsAllocated", "BitsStored", "BodyPartExamined", "Columns", "HighBit", "ImageOrientationPatient",
    "ImagePositionPatient", "ImageType", "LossyImageCompression", "Modality", "NumberOfFrames",
    "PhotometricInterpretation", "PixelRepresentation", "PixelSpacing", "ProtocolName", "RescaleIntercept",
    "RescaleSlope", "RescaleType", "Rows", "SOPClassUID", "SamplesPerPixel", "SeriesDescription", "SeriesInstanceUID",
    "SeriesNumber", "SharedFunctionalGroupsSequence",
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class SliceHeader:
    """One image file of a series. Never printed: it holds a UID (left out of the repr)."""

    path: Path
    series_uid: str = field(repr=False)
    modality: str
    description: str
    body_part: str
    series_number: int | None
    localizer: bool
    rows: int
    columns: int
    position_lps: tuple[float, float, float]
    """Centre of the first pixel, mm."""
    row_lps: tuple[float, float, float]
    """Unit direction of growing column index (the first three numbers of ImageOrientationPatient)."""
    column_lps: tuple[float, float, float]
    """Unit direction of growing row index."""
    spacing_mm: tuple[float, float]
    """Distance of columns, distance of rows: (x, y), the reverse of PixelSpacing's order."""
    slope: float
    intercept: float
    has_rescale: bool
    rescale_type: str
    bits_allocated: int
    bits_stored: int
    high_bit: int
    signed: bool
    lossy: bool
    transfer_syntax: str
    problem: str | None = None
    problem_code: str = "import.tags"


def looks_like_dicom(path: Path) -> bool:
    """True where the first bytes are a DICOM preamble, or a bare data set as old archives write it."""
    try:
        with path.open("rb") as file:
            head = file.read(132)
    except OSError:
        return False
    if head[128:132] == b"DICM":
        return True
    # Without preamble: the first element's group is 0002 or 0008 (little or big endian) and its element is small.
    groups = {b"\x02\x00", b"\x08\x00", b"\x00\x02", b"\x00\x08"}
    return len(head) == 132 and head[:2] in groups and 0 in head[2:4]


def _check_inflated_size(path: Path) -> None:
    # A deflated data set is inflated as a whole before any tag can be read: count first, so that a bomb takes no
    # memory.
    with path.open("rb") as file:
        head = file.read(2048)
        at = head.find(_DEFLATED)
        if head[128:132] != b"DICM" or at < 0:
            return
        length_at = head.find(b"\x02\x00\x00\x00UL\x04\x00")
        if length_at < 0:
            msg = "the deflated file has no group length"
            raise ValueError(msg)
        group_length = int.from_bytes(head[length_at + 8 : length_at + 12], "little")
        file.seek(length_at + 12 + group_length)
        inflater = zlib.decompressobj(-zlib.MAX_WBITS)
        total = 0
        while (chunk := file.read(1 << 16)) and not inflater.eof:
            while chunk:
                total += len(inflater.decompress(chunk, 1 << 20))
                chunk = inflater.unconsumed_tail
                if total > _MAX_INFLATED_BYTES:
                    msg = "the deflated file is implausibly large"
                    raise ValueError(msg)


def read_dataset(path: Path, *, pixels: bool) -> Dataset:
    """Read one file with pydicom, without its warnings (they may quote patient data).

    Raises
    ------
    ValueError
        If the file cannot be read as DICOM, whatever the reason; the text holds no value of the file.
    """
    try:
        _check_inflated_size(path)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if pixels:
                return pydicom.dcmread(path, force=True)
            return pydicom.dcmread(path, force=True, stop_before_pixels=True, specific_tags=_TAGS)
    except Exception as error:
        # pydicom raises many kinds on a broken file; each of them means the same to us.
        msg = f"cannot be read as DICOM ({type(error).__name__})"
        raise ValueError(msg) from None


class _Tags:
    """Checked access to one data set; collects what is wrong with it."""

    def __init__(self, dataset: Dataset) -> None:
        self.dataset = dataset
        self.problems: list[str] = []

    def raw(self, keyword: str) -> Any:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                return self.dataset.get(keyword)
        except Exception:
            # An unreadable value counts as a missing one.
            return None

    def text(self, keyword: str) -> str:
        value = self.raw(keyword)
        return "" if value is None else "".join(c for c in str(value) if c.isprintable()).strip()[:64]

    def whole(self, keyword: str, default: int) -> int:
        try:
            return int(self.raw(keyword))
        except (TypeError, ValueError, OverflowError):
            return default

    def numbers(self, keyword: str, count: int, *, needed: bool = True) -> tuple[float, ...] | None:
        value = self.raw(keyword)
        if value is None or value == "":
            if needed:
                self.problems.append(f"the tag {keyword} is missing")
            return None
        try:
            values = tuple(float(v) for v in (value if count > 1 else [value]))
        except (TypeError, ValueError):
            values = ()
        if len(values) != count or not all(math.isfinite(v) for v in values):
            self.problems.append(f"the tag {keyword} should hold {count} finite number{'s' if count > 1 else ''}")
            return None
        return values


def _unit(vector: tuple[float, ...]) -> tuple[float, float, float]:
    x, y, z = vector
    length = math.sqrt(x * x + y * y + z * z)
    return (x / length, y / length, z / length) if length > 0 else (0.0, 0.0, 0.0)


def _parse(path: Path, dataset: Dataset) -> SliceHeader | None:
    tags = _Tags(dataset)
    rows, columns = tags.whole("Rows", 0), tags.whole("Columns", 0)
    modality = tags.text("Modality")
    if rows <= 0 or columns <= 0:
        return None  # a report, a structure set, a directory file: not an image

    image_type = [str(v).strip().upper() for v in (tags.raw("ImageType") or [])]
    problem: str | None = None
    code = "import.tags"
    num_frames = tags.whole("NumberOfFrames", 1)
    samples = tags.whole("SamplesPerPixel", 1)
    photometric = tags.text("PhotometricInterpretation") or "MONOCHROME2"
    bits_allocated = tags.whole("BitsAllocated", 0)
    bits_stored = tags.whole("BitsStored", bits_allocated)
    high_bit = tags.whole("HighBit", bits_stored - 1)
    if num_frames != 1 or "SharedFunctionalGroupsSequence" in dataset:
        problem, code = (
            f"it is a multi-frame image ({num_frames} frames in one file), which cannot be read yet",
            "import.multi-frame",
        )
    elif samples != 1 or not photometric.startswith("MONOCHROME"):
        problem, code = f"it is a colour image ({photometric}), not a scan", "import.not-a-scan"
    elif (
        bits_allocated not in (8, 16)
        or not 0 < bits_stored <= bits_allocated
        or not bits_stored <= high_bit + 1 <= bits_allocated
    ):
        problem, code = f"its pixels have {bits_allocated} bits ({bits_stored} used); expected 8 or 16", "import.pixels"
    elif max(rows, columns) > MAX_IMAGE_SIDE:
        problem, code = (
            f"its header claims {columns} x {rows} pixels; at most {MAX_IMAGE_SIDE} a side are read",
            "import.header",
        )

    position = tags.numbers("ImagePositionPatient", 3)
    orientation = tags.numbers("ImageOrientationPatient", 6)
    spacing = tags.numbers("PixelSpacing", 2)
    slope = tags.numbers("RescaleSlope", 1, needed=False)
    intercept = tags.numbers("RescaleIntercept", 1, needed=False)
    row_lps = column_lps = (0.0, 0.0, 0.0)
    if orientation is not None:
        row_lps, column_lps = _unit(orientation[:3]), _unit(orientation[3:])
        lengths = [math.dist((0, 0, 0), orientation[:3]), math.dist((0, 0, 0), orientation[3:])]
        cosine = sum(a * b for a, b in zip(row_lps, column_lps, strict=True))
        # 1e-3 passes values written with four digits; a far corner 300 mm away moves by at most 0.3 mm then.
        if any(abs(length - 1) > 1e-3 for length in lengths) or abs(cosine) > 1e-3:
            tags.problems.append("the tag ImageOrientationPatient does not hold two perpendicular unit directions")
    if spacing is not None and min(spacing) <= 0:
        tags.problems.append(f"the tag PixelSpacing should be above 0 mm; found {min(spacing):g}")
    if slope is not None and slope[0] == 0:
        tags.problems.append("the tag RescaleSlope is 0, so every pixel would have the same value")
    if problem is None and tags.problems:
        problem = "; ".join(tags.problems)

    meta = getattr(dataset, "file_meta", None)
    return SliceHeader(
        path=path,
        series_uid=str(tags.raw("SeriesInstanceUID") or ""),
        modality=modality,
        description=tags.text("SeriesDescription") or tags.text("ProtocolName"),
        body_part=tags.text("BodyPartExamined"),
        series_number=tags.whole("SeriesNumber", -1) if tags.raw("SeriesNumber") is not None else None,
        localizer="LOCALIZER" in image_type,
        rows=rows,
        columns=columns,
        position_lps=(position[0], position[1], position[2]) if position else (0.0, 0.0, 0.0),
        row_lps=row_lps,
        column_lps=column_lps,
        spacing_mm=(spacing[1], spacing[0]) if spacing else (0.0, 0.0),
        slope=slope[0] if slope else 1.0,
        intercept=intercept[0] if intercept else 0.0,
        has_rescale=slope is not None and intercept is not None,
        rescale_type=tags.text("RescaleType").upper(),
        bits_allocated=bits_allocated,
        bits_stored=bits_stored,
        high_bit=high_bit,
        signed=tags.whole("PixelRepresentation", 0) == 1,
        lossy=tags.text("LossyImageCompression") == "01",
        transfer_syntax=str(getattr(meta, "TransferSyntaxUID", "") or ""),
        problem=problem,
        problem_code=code,
    )


def _walk(folder: Path, *, recursive: bool, watch: Watch) -> Iterator[Path]:
    count = 0
    # followlinks stays off: a link to a parent would never end.
    for root, folders, files in os.walk(folder):
        watch.step("Looking for images")
        folders.sort()
        if not recursive:
            folders.clear()
        for name in sorted(files):
            count += 1
            if count > MAX_FILES:
                msg = (
                    f"reading the folder {folder.name}: it holds more than {MAX_FILES} files; expected one scan; "
                    "choose the folder of the scan itself"
                )
                raise VolumeImportError(msg, code="import.too-many-files")
            path = Path(root) / name
            if path.is_file():
                yield path


def read_headers(folder: Path, *, recursive: bool, watch: Watch) -> list[SliceHeader]:
    """Read the headers of all DICOM images in a folder; everything else is passed over.

    Raises
    ------
    VolumeImportError
        If the folder holds implausibly many files.
    CancelledError
        If the person cancels.
    """
    paths = [path for path in _walk(folder, recursive=recursive, watch=watch) if looks_like_dicom(path)]
    headers = []
    for index, path in enumerate(paths):
        watch.step("Reading the headers", index / len(paths))
        try:
            header = _parse(path, read_dataset(path, pixels=False))
        except ValueError:
            continue  # begins like DICOM and is not
        if header is not None:
            headers.append(header)
    return headers
