"""Images whose pixels may show the name of the patient: found by their tags, and masked on request."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydicom.dataset import Dataset

__all__ = ["Box", "burned_in_reason", "cut_pixels", "is_outside", "mask_boxes"]

Box = tuple[int, int, int, int]
"""Rectangle of pixels: column and row of its first pixel, width and height."""

_SECONDARY_CAPTURE = "1.2.840.10008.5.1.4.1.1.7"
_TEXT_CLASSES = tuple(f"1.2.840.10008.5.1.4.1.1.{kind}" for kind in ("3.1", "6.1", "6.2", "77.1."))
"""Beginnings of the classes of ultrasound, video and photographs, for files without a modality."""
_WITH_TEXT = ("US", "IVUS", "ES", "XC", "GM", "SM", "OT", "SC", "DOC", "DG", "SD", "HC", "ECG", "EPS", "HD", "IO")
"""Modalities whose images usually contain text: ultrasound, video, photographs, captured screens, documents."""
_SCREENS = ("SCREEN SAVE", "DOSE_INFO", "DOSE INFO", "SCREENSAVE", "CAPTURE", "PATIENT PROTOCOL")


def burned_in_reason(dataset: Dataset) -> str | None:
    """Return why the pixels of an image may show text about the patient; None if nothing indicates it."""
    if _text(dataset, "BurnedInAnnotation") == "YES":
        return "its header states burned-in annotation"
    kind = _text(dataset, "SOPClassUID")
    if kind == _SECONDARY_CAPTURE or kind.startswith(f"{_SECONDARY_CAPTURE}.") or _text(dataset, "ConversionType"):
        return "it is a secondary capture (a picture of a screen or of a film)"
    if kind.startswith(_TEXT_CLASSES):
        return "images of its class (ultrasound, video, photographs) usually show text"
    modality = _text(dataset, "Modality")
    if modality in _WITH_TEXT:
        return f"images of the modality {modality} usually show text"
    image_type = _text(dataset, "ImageType")
    if any(one in image_type for one in _SCREENS):
        return "it is a saved screen or a dose table"
    if int(dataset.get("SamplesPerPixel") or 1) > 1:
        return "it is a colour image, as captured screens are"
    return None


def is_outside(dataset: Dataset, boxes: Sequence[Box]) -> bool:
    """Return whether a rectangle contains no pixel of an image."""
    return any(x >= int(dataset.Columns) or y >= int(dataset.Rows) for x, y, _, _ in boxes)


def cut_pixels(dataset: Dataset) -> None:
    """Remove bytes behind the last pixel, which may contain anything; the pixels must be uncompressed.

    Raises
    ------
    ValueError
        If there are fewer pixels than the header states.
    """
    count = int(dataset.get("NumberOfFrames") or 1) * int(dataset.Rows) * int(dataset.Columns)
    samples = int(dataset.get("SamplesPerPixel") or 1)
    for keyword, bits in (("PixelData", None), ("FloatPixelData", 32), ("DoubleFloatPixelData", 64)):
        if keyword not in dataset:
            continue
        stored = bytes(dataset[keyword].value)
        size = (count * samples * (bits or int(dataset.BitsAllocated)) + 7) // 8
        if len(stored) < size and _text(dataset, "PhotometricInterpretation") == "YBR_FULL_422":
            size = size * 2 // 3  # two pixels share their colour
        if size <= 0 or len(stored) < size:
            raise ValueError("fewer pixels than the header states")
        dataset[keyword].value = stored[:size] + b"\0" * (size % 2)


def mask_boxes(dataset: Dataset, boxes: Sequence[Box]) -> None:
    """Set rectangles of every frame to the smallest value of the image, in place; the pixels must be uncompressed.

    Raises
    ------
    ValueError
        If the pixels do not have the size that the header states.
    """
    rows, columns = int(dataset.Rows), int(dataset.Columns)
    samples = int(dataset.get("SamplesPerPixel") or 1)
    kind = "i" if int(dataset.PixelRepresentation) else "u"
    if int(dataset.BitsAllocated) % 8:
        raise ValueError("pixels that are not whole bytes")
    dtype = np.dtype(f"<{kind}{int(dataset.BitsAllocated) // 8}")
    count = int(dataset.get("NumberOfFrames") or 1) * rows * columns * samples
    values = np.frombuffer(dataset.PixelData, dtype, count).copy()
    frames = values.reshape(-1, rows, columns, samples)
    planar = samples > 1 and int(dataset.get("PlanarConfiguration") or 0) == 1
    if planar:
        frames = values.reshape(-1, rows, columns, 1)
    for x, y, width, height in boxes:
        frames[:, y : y + height, x : x + width] = values.min()
    dataset.PixelData = values.tobytes() + dataset.PixelData[values.nbytes :]


def _text(dataset: Dataset, keyword: str) -> str:
    try:
        value = dataset.get(keyword)
    except Exception:
        return ""  # pydicom raises various errors for a damaged value
    return "" if value is None else str(value).upper().strip()
