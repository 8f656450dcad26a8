"""Reader of the DICOM tags that decide the position and the meaning of pixels (PS3.3 C.7.6.2, C.7.6.3, C.8.2.1).

Headers are untrusted input: every value is checked when it is read. A missing value is never guessed; it is stored as a
message for the user (``problem``).
"""

from __future__ import annotations

import contextlib
import datetime
import functools
import logging
import math
import re
import zlib
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pydicom
from pydicom.datadict import dictionary_VR
from pydicom.dataelem import RawDataElement
from pydicom.dataset import Dataset
from pydicom.multival import MultiValue
from pydicom.tag import BaseTag, Tag

from carina.errors import CarinaError
from carina.volume.axis_angles import MAX_SKEW_DEG
from carina.volume.character_sets import settle_character_set
from carina.volume.dicom_frames import described_frames, each_frame, is_enhanced
from carina.volume.dicom_modality_lut import ModalityLut, read_modality_lut
from carina.volume.model import MAX_THICKNESS_MM
from carina.volume.padding import PaddingRange, padding_ranges
from carina.volume.without_warnings import without_warnings

# pydicom logs odd values, which may be a name; nothing of a header may be logged.
logging.getLogger("pydicom").setLevel(logging.CRITICAL + 1)

MAX_IMAGE_SIDE = (
    8192  # pixels; twice the size of the largest detectors; larger claims are refused before memory is allocated
)
MAX_INFLATED_BYTES = 1 << 28
"""Largest decompressed size of a deflated file, bytes."""
_DEFLATED = b"1.2.840.10008.1.2.1.99"

# Tags that identify the patient and the scan. Slices with two values never form one volume.
IDENTITY = {
    "PatientID": "patients",
    "PatientName": "patients",
    "PatientBirthDate": "patients",
    "StudyInstanceUID": "studies",
    "FrameOfReferenceUID": "frames of reference",
    "Modality": "modalities",
}

# Tags that may change within one scan (a chest in several breaths has several acquisitions) but may also distinguish
# two scans.
SETTINGS = {
    "ImageType": "image type",
    "ConvolutionKernel": "reconstruction kernel",
    "FilterType": "filter",
    "TemporalPositionIdentifier": "temporal position",
    "TemporalPositionIndex": "temporal index",
    "TemporalPositionTimeOffset": "time offset",
    "NominalPercentageOfCardiacPhase": "cardiac phase",
    "NominalPercentageOfRespiratoryPhase": "respiratory phase",
    "StackID": "stack",
    "EchoNumbers": "echo",
    "EchoTime": "echo time",
    "DiffusionBValue": "b-value",
    "KVP": "tube voltage",
    "ContrastBolusAgent": "contrast agent",
    "SeriesDescription": "series description",
    "SeriesNumber": "series number",
    "AcquisitionNumber": "acquisition number",
    "AcquisitionTime": "acquisition time",
}

_IDENTITY_TAGS, _SETTING_TAGS = ([Tag(keyword) for keyword in keywords] for keywords in (IDENTITY, SETTINGS))

HEADER_TAGS = sorted({
    "BitsAllocated", "BitsStored", "BodyPartExamined", "Columns", "HighBit", "ImageOrientationPatient",
    "ImagePositionPatient", "LossyImageCompression", "NumberOfFrames", "PhotometricInterpretation",
    "ConcatenationUID", "ModalityLUTSequence", "PerFrameFunctionalGroupsSequence", "PixelPaddingRangeLimit",
    "PixelPaddingValue", "PixelRepresentation", "PixelSpacing",
    "ProtocolName", "RescaleIntercept", "RescaleSlope", "RescaleType", "Rows", "SOPClassUID", "SOPInstanceUID",
    "SamplesPerPixel", "SeriesInstanceUID", "SharedFunctionalGroupsSequence", "SliceThickness", *IDENTITY, *SETTINGS,
})  # fmt: skip
"""Keywords of all elements that a header is parsed from."""


_DATES = ("AcquisitionDate", "AcquisitionDateTime", "StudyDate")
_DATE_TAGS = [Tag(keyword) for keyword in _DATES]
FIRST_CT_YEAR = 1971


@dataclass(frozen=True, slots=True)
class SliceHeader:
    """Header of one image of a series: a file, or a frame of a multi-frame file.

    The header is never logged, because it contains UIDs (omitted from the repr).
    """

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
    """Centre of the first pixel, LPS mm."""
    row_lps: tuple[float, float, float]
    """Unit direction of increasing column index (the first three numbers of ImageOrientationPatient), LPS."""
    column_lps: tuple[float, float, float]
    """Unit direction of increasing row index, LPS."""
    spacing_mm: tuple[float, float]
    """Distance of columns and distance of rows in mm: (x, y), the reverse order of PixelSpacing."""
    thickness_mm: float | None
    """SliceThickness in mm; None if the tag is missing or is not a possible thickness."""
    slope: float
    intercept: float
    has_slope: bool
    has_intercept: bool
    rescale_type: str
    bits_allocated: int
    bits_stored: int
    high_bit: int
    signed: bool
    lossy: bool
    transfer_syntax: str
    sop_uid: str = field(repr=False)
    identity: tuple[str, ...] = field(repr=False)
    """Values of the tags in ``IDENTITY``; "" for a missing tag."""
    settings: tuple[str, ...] = field(repr=False)
    """Values of the tags in ``SETTINGS``; "" for a missing tag."""
    pixels_at: int | None = None
    """Offset of the element PixelData in the file; None if unknown."""
    padding: tuple[PaddingRange, ...] = ()
    """Ranges of stored values that mark padding (PixelPaddingValue, PixelPaddingRangeLimit); empty without the tags."""
    modality_lut: ModalityLut | None = None
    frame: int | None = None
    """Index of the frame in a file with functional groups; None for a file with one classic image."""
    num_frames: int = 1
    """Number of frames in the file."""
    image_uid: str = field(default="", repr=False)
    """For a frame: UID of the image, which several files of one concatenation share; empty for a classic image."""
    problem: str | None = None
    problem_code: str = "import.tags"

    @property
    def file_name(self) -> str:
        """Name of the file for messages, with the number of the frame in a multi-frame file."""
        return self.path.name if self.frame is None else f"{self.path.name} (frame {self.frame + 1})"

    @property
    def image_key(self) -> Hashable:
        """Identifier, series, frame and position of the image, which are equal for a file and its copies."""
        return self.sop_uid, self.series_uid, self.frame, self.position_lps

    @property
    def has_rescale(self) -> bool:
        """Whether the header contains rescale slope and intercept."""
        return self.has_slope and self.has_intercept


def _check_inflated_size(path: Path) -> None:
    """Raise an error if a deflated file decompresses to an implausible size."""
    # A deflated data set is decompressed as a whole before any tag can be read, so its size is counted first; a
    # decompression bomb then takes no memory.
    with path.open("rb") as file:
        head = file.read(2048)
        at = head.find(_DEFLATED)
        if head[128:132] != b"DICM" or at < 0:
            return
        length_at = head.find(b"\x02\x00\x00\x00UL\x04\x00")
        if length_at < 0:
            msg = "the deflated file has no group-length element"
            raise ValueError(msg)
        group_length = int.from_bytes(head[length_at + 8 : length_at + 12], "little")
        file.seek(length_at + 12 + group_length)
        inflater = zlib.decompressobj(-zlib.MAX_WBITS)
        total = 0
        while (chunk := file.read(1 << 16)) and not inflater.eof:
            while chunk:
                total += len(inflater.decompress(chunk, 1 << 20))
                chunk = inflater.unconsumed_tail
                if total > MAX_INFLATED_BYTES:
                    msg = "the file decompresses to an implausible size"
                    raise ValueError(msg)


def read_dataset(path: Path, *, pixels: bool) -> Dataset:
    """Read one file with pydicom, without its warnings, which may quote patient data.

    Parameters
    ----------
    path
        The file.
    pixels
        Read all elements including the pixels; otherwise only the tags that Carina uses.

    Raises
    ------
    ValueError
        If the file cannot be read as DICOM; the message contains no value of the file.
    """
    return _read(path, pixels=pixels)[0]


def _read(path: Path, *, pixels: bool, tags: Sequence[Any] = HEADER_TAGS) -> tuple[Dataset, int | None]:
    """Read the data set, and the offset of its pixel element if the element was skipped and can be found."""
    try:
        _check_inflated_size(path)
        with without_warnings():
            if pixels:
                dataset = pydicom.dcmread(path, force=True)
                settle_character_set(dataset)
                return dataset, None
            with path.open("rb") as file:
                dataset = pydicom.dcmread(file, force=True, stop_before_pixels=True, specific_tags=list(tags))
                at = file.tell()
                settle_character_set(dataset)
                return dataset, at if file.read(4) in PIXEL_TAGS else None
    except Exception as error:
        # pydicom raises various errors for a damaged file; all have the same meaning here.
        msg = f"cannot be read as DICOM ({type(error).__name__})"
        raise ValueError(msg) from None


@contextlib.contextmanager
def damaged_elements_refused(refusal: Callable[[str], CarinaError]) -> Iterator[None]:
    """Convert any error that pydicom or NumPy raises for a damaged element, and suppress their warnings.

    pydicom converts a value at its first use, so that a damaged element can raise almost any exception anywhere in code
    that reads the data set.

    Parameters
    ----------
    refusal
        Returns the error for a problem, such as "one of its elements is damaged (ValueError)".
    """
    try:
        with without_warnings():  # pydicom's warnings may quote content of the file
            yield
    except (CarinaError, OSError, MemoryError):
        raise
    except Exception as error:
        raise refusal(f"one of its elements is damaged ({type(error).__name__})") from None


def acquisition_date(path: Path) -> str | None:
    """Return the ISO date of an image's acquisition, or else of its study; None if the file has no plausible date.

    Years before the first clinical CT (1971) are refused, because anonymisers write them in place of a date.
    """
    try:
        dataset = _read(path, pixels=False, tags=_DATE_TAGS)[0]
        with without_warnings():  # pydicom's warnings may quote the value
            texts = [_Tags(dataset).text(keyword) for keyword in _DATES]
    except Exception:
        return None  # a damaged date counts as missing
    for text in texts:
        # ACR-NEMA dates contain points; the value of a date with time begins with the date.
        digits = text.replace(".", "")[:8]
        if re.fullmatch(r"[0-9]{8}", digits):
            with contextlib.suppress(ValueError):
                date = datetime.date(int(digits[:4]), int(digits[4:6]), int(digits[6:]))
                if date.year >= FIRST_CT_YEAR:
                    return date.isoformat()
    return None


PIXEL_TAGS = (b"\xe0\x7f\x10\x00", b"\x7f\xe0\x00\x10")
"""The tag of PixelData in little-endian and big-endian order."""


class _Tags:
    """Checked access to the values of one data set; collects the problems that it finds."""

    def __init__(self, dataset: Dataset) -> None:
        self.dataset = dataset
        self.problems: list[str] = []

    def raw(self, keyword: str) -> Any:
        try:
            return self.dataset.get(keyword)
        except Exception:
            # An unreadable value counts as missing; pydicom raises various errors for it.
            return None

    def plain(self, tag: BaseTag) -> str:
        """Return a value as text for comparison: numbers in one form, letters without case, lists joined.

        Most values are compared as stored in the file, which takes a tenth of the time of converting them.
        """
        try:
            element = self.dataset.get_item(tag)
            value = None if element is None else element.value
            if value and isinstance(value, bytes) and not _is_comparable(element, tag, value):
                value = self.dataset[tag].value
        except Exception:
            return ""  # an unreadable value counts as missing
        if not value:
            return ""
        if isinstance(value, bytes):
            return comparable_bytes(value)
        parts = [str(v) for v in value] if isinstance(value, (list, tuple, MultiValue)) else [str(value)]
        return "/".join(filter(None, map(_comparable, parts)))

    def text(self, keyword: str) -> str:
        value = self.raw(keyword)
        return "" if value is None else "".join(c for c in str(value) if c.isprintable()).strip()[:64]

    def whole(self, keyword: str, default: int) -> int:
        try:
            return int(self.raw(keyword))
        except (TypeError, ValueError, OverflowError):
            return default

    def cell(self, keyword: str) -> int | None:
        """Return a pixel value of a tag as an integer, in whatever form the file stores it; None without the tag."""
        value = self.raw(keyword)
        if isinstance(value, (MultiValue, list)):
            value = value[0] if len(value) else None
        if isinstance(value, bytes):
            value = int.from_bytes(value[:2], "little" if _is_little_endian(self.dataset) else "big") if value else None
        try:
            return None if value is None else int(value)
        except (TypeError, ValueError, OverflowError):
            return None

    def numbers(self, keyword: str, count: int, *, needed: bool = True) -> tuple[float, ...] | None:
        try:
            value = self.dataset.get(keyword)
        except Exception:
            value = ()  # the tag exists, but is not a number
        if value is None or value == "":
            if needed:
                self.problems.append(f"the tag {keyword} is missing")
            return None
        try:
            values = tuple(float(v) for v in (value if count > 1 else [value]))
        except (TypeError, ValueError):
            values = ()
        if len(values) != count or not all(math.isfinite(v) for v in values):
            self.problems.append(f"the tag {keyword} should contain {count} finite number{'s' if count > 1 else ''}")
            return None
        return values


def _thickness_mm(tags: _Tags) -> float | None:
    """Return SliceThickness in mm; None if the tag is missing or impossible, and the series is not refused."""
    try:
        thickness_mm = float(tags.text("SliceThickness"))
    except ValueError:
        return None
    return thickness_mm if 0.0 < thickness_mm <= MAX_THICKNESS_MM else None


def _is_little_endian(dataset: Dataset) -> bool:
    return dataset.original_encoding[1] is not False


def _modality_lut(tags: _Tags, *, signed: bool) -> ModalityLut | None:
    sequence = tags.raw("ModalityLUTSequence")
    try:
        if not sequence:
            return None
        return read_modality_lut(sequence[0], signed=signed, little_endian=_is_little_endian(tags.dataset))
    except Exception:
        # pydicom raises various errors for a damaged table.
        tags.problems.append("the tag ModalityLUTSequence contains no usable table")
        return None


def _is_comparable(element: Any, tag: BaseTag, value: bytes) -> bool:
    """Return whether the bytes of a value can be compared instead of its text, which needs ASCII.

    Other characters depend on the character set.
    """
    return isinstance(element, RawDataElement) and not _is_binary(tag) and value.isascii() and b"\x1b" not in value


def _is_binary(tag: BaseTag) -> bool:
    return dictionary_VR(tag) in ("FD", "FL", "UL", "US", "SL", "SS")


def comparable_bytes(value: bytes) -> str:
    """Return a stored text for comparison: numbers in one form, letters without case, values joined by a slash."""
    return "/".join(filter(None, map(_comparable, value.decode("latin-1").strip("\0 ").split("\\"))))


@functools.lru_cache(maxsize=4096)
def _comparable(text: str) -> str:
    text = " ".join(text.replace("^", " ").split()).casefold()
    try:
        return f"{float(text):g}" if len(text) < 16 and text[:1] in "+-.0123456789" else text
    except ValueError:
        return text


def _unit(vector: tuple[float, ...]) -> tuple[float, float, float]:
    x, y, z = vector
    length = math.sqrt(x * x + y * y + z * z)
    return (x / length, y / length, z / length) if length > 0 else (0.0, 0.0, 0.0)


def read_image_headers(path: Path) -> tuple[list[SliceHeader], Dataset]:
    """Read the headers of the images of one file and its tags.

    The list has one header for a slice, one for each frame of an enhanced file, and none for a file without an image,
    such as a report. The data set has the tags of the last frame.

    Raises
    ------
    ValueError
        If the file cannot be read as DICOM.
    """
    dataset, pixels_at = _read(path, pixels=False)
    with without_warnings():  # pydicom's warnings may quote content of the file
        try:
            if not is_enhanced(dataset):
                header = _parse(path, dataset, pixels_at)
                return ([] if header is None else [header]), dataset
            return _parse_frames(path, dataset, pixels_at), dataset
        except Exception as error:
            # pydicom converts values at first use and raises various errors for damaged ones.
            msg = f"cannot be read as DICOM ({type(error).__name__})"
            raise ValueError(msg) from None


def _parse_frames(path: Path, dataset: Dataset, pixels_at: int | None) -> list[SliceHeader]:
    """Return the header of each frame of an enhanced file."""
    stated, described = _Tags(dataset).whole("NumberOfFrames", 1), described_frames(dataset)
    if stated != described:
        header = _parse(path, dataset, pixels_at)
        problem = f"its header states {stated} frames and describes {described}"
        return [] if header is None else [replace(header, problem=problem, problem_code="import.header")]
    found = [_parse(path, dataset, pixels_at, frame=frame) for frame in each_frame(dataset)]
    return [header for header in found if header is not None]


def _parse(path: Path, dataset: Dataset, pixels_at: int | None, *, frame: int | None = None) -> SliceHeader | None:
    """Return the header of a slice or frame, parsed from its tags; None for a file without an image."""
    tags = _Tags(dataset)
    rows, columns = tags.whole("Rows", 0), tags.whole("Columns", 0)
    modality = tags.text("Modality")
    if rows <= 0 or columns <= 0:
        return None

    image_type = [str(v).strip().upper() for v in (tags.raw("ImageType") or [])]
    problem: str | None = None
    code = "import.tags"
    num_frames = tags.whole("NumberOfFrames", 1)
    samples = tags.whole("SamplesPerPixel", 1)
    photometric = tags.text("PhotometricInterpretation") or "MONOCHROME2"
    bits_allocated = tags.whole("BitsAllocated", 0)
    bits_stored = tags.whole("BitsStored", bits_allocated)
    high_bit = tags.whole("HighBit", bits_stored - 1)
    if frame is None and (num_frames != 1 or "SharedFunctionalGroupsSequence" in dataset):
        problem, code = (
            f"it is a multi-frame image ({num_frames} frames in one file) that does not describe its frames as an "
            "enhanced CT or MR image does",
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
            f"its header claims {columns} x {rows} pixels; at most {MAX_IMAGE_SIDE} per side are supported",
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
        # 1e-3 accepts vectors written with four digits; the directions themselves are stored unchanged.
        if any(abs(length - 1) > 1e-3 for length in lengths) or abs(cosine) > math.sin(math.radians(MAX_SKEW_DEG)):
            tags.problems.append("the tag ImageOrientationPatient does not contain two perpendicular unit vectors")
    if spacing is not None and min(spacing) <= 0:
        tags.problems.append(f"the tag PixelSpacing should be above 0 mm; found {min(spacing):g}")
    if slope is not None and slope[0] == 0:
        tags.problems.append("the tag RescaleSlope is 0, so every pixel would have the same value")
    signed = tags.whole("PixelRepresentation", 0) == 1
    lut = _modality_lut(tags, signed=signed)
    if problem is None and tags.problems:
        problem = "; ".join(tags.problems)
    mark = tags.cell("PixelPaddingValue")
    padding: tuple[PaddingRange, ...] = ()
    if mark is not None and problem is None:
        padding = padding_ranges(
            mark,
            tags.cell("PixelPaddingRangeLimit"),
            bits_allocated=bits_allocated,
            bits_stored=bits_stored,
            high_bit=high_bit,
            signed=signed,
        )

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
        thickness_mm=_thickness_mm(tags),
        slope=slope[0] if slope else 1.0,
        intercept=intercept[0] if intercept else 0.0,
        has_slope=slope is not None,
        has_intercept=intercept is not None,
        rescale_type=lut.unit if lut and slope is None and intercept is None else tags.text("RescaleType").upper(),
        bits_allocated=bits_allocated,
        bits_stored=bits_stored,
        high_bit=high_bit,
        signed=signed,
        lossy=tags.text("LossyImageCompression") == "01",
        transfer_syntax=str(getattr(meta, "TransferSyntaxUID", "") or ""),
        sop_uid=str(tags.raw("SOPInstanceUID") or ""),
        identity=tuple(map(tags.plain, _IDENTITY_TAGS)),
        settings=tuple(map(tags.plain, _SETTING_TAGS)),
        pixels_at=pixels_at,
        padding=padding,
        modality_lut=lut,
        frame=frame,
        num_frames=1 if frame is None else num_frames,
        image_uid="" if frame is None else str(tags.raw("ConcatenationUID") or tags.raw("SOPInstanceUID") or ""),
        problem=problem,
        problem_code=code,
    )
