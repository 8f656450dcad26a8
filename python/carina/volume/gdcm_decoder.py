"""Decoding of compressed DICOM pixels by GDCM: JPEG, JPEG-LS, JPEG 2000 and RLE."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carina.disk import library_path
from carina.errors import VolumeImportError

_NUMBERS = {
    "UINT8": np.uint8, "INT8": np.int8, "UINT12": np.uint16, "INT12": np.int16,
    "UINT16": np.uint16, "INT16": np.int16, "UINT32": np.uint32, "INT32": np.int32,
}  # fmt: skip
"""NumPy type of decoded numbers, by GDCM's name of the type."""


class DecodingError(ValueError):
    """Error for pixels that GDCM cannot decode."""


def decode(path: Path) -> NDArray[np.int32]:
    """Return the stored numbers (planes, rows, columns) or (rows, columns, samples) of a DICOM file with one image.

    Parameters
    ----------
    path
        File with the compressed pixels and the tags that describe them.

    Raises
    ------
    DecodingError
        If the pixels cannot be decoded.
    VolumeImportError
        ``import.no-decoder`` if GDCM is not installed.
    """
    try:
        import gdcm  # slow to load, and needed for compressed files only
    except ImportError:
        from carina.installation import install_command

        msg = f"reading a compressed DICOM file: the decoder (GDCM) is missing; run: {install_command(REQUIREMENT)}"
        raise VolumeImportError(msg, code="import.no-decoder") from None
    reader = gdcm.ImageReader()
    with library_path(path) as name:
        reader.SetFileName(name)
        if not reader.Read():
            raise DecodingError
    image = reader.GetImage()
    kind = _NUMBERS.get(image.GetPixelFormat().GetScalarTypeAsString())
    text = image.GetBuffer()
    if kind is None or not text:
        raise DecodingError
    # The binding returns the bytes as text; a byte above 127 is a surrogate.
    stored = text.encode("utf-8", "surrogateescape")
    shape = [image.GetDimension(axis) for axis in reversed(range(image.GetNumberOfDimensions()))]
    samples = image.GetPixelFormat().GetSamplesPerPixel()
    shape += [samples] * (samples != 1)
    if len(stored) != int(np.prod(shape)) * np.dtype(kind).itemsize:
        raise DecodingError
    return np.frombuffer(stored, dtype=kind).reshape(shape).astype(np.int32)


REQUIREMENT = "python-gdcm>=3.0.26"
"""Requirement specifier of the Python package that contains the decoder."""
