"""The pixels of one DICOM slice: stored numbers, then the rescale of that slice (PS3.3 C.7.6.16.2.9, C.11.1)."""

from __future__ import annotations

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray

from carina.errors import VolumeImportError
from carina.volume.dicom_headers import SliceHeader, read_dataset

__all__ = ["read_slice"]

# Stored as plain numbers: read here, checked byte for byte. Everything else is decoded by GDCM through SimpleITK.
_IMPLICIT_LITTLE, _EXPLICIT_LITTLE = "1.2.840.10008.1.2", "1.2.840.10008.1.2.1"
_DEFLATED_LITTLE, _EXPLICIT_BIG = "1.2.840.10008.1.2.1.99", "1.2.840.10008.1.2.2"
_PLAIN = {_IMPLICIT_LITTLE, _EXPLICIT_LITTLE, _DEFLATED_LITTLE, _EXPLICIT_BIG, ""}


def _truncated(header: SliceHeader, expected: int, found: int) -> VolumeImportError:
    msg = (
        f"reading {header.path.name}: its pixels are cut short: expected {expected} bytes, found {found}; the copy "
        "is incomplete; "
        "copy the series again"
    )
    return VolumeImportError(msg, code="import.truncated")


def _plain_pixels(header: SliceHeader) -> NDArray[np.int32]:
    num_bytes = header.bits_allocated // 8
    expected = header.rows * header.columns * num_bytes
    if header.path.stat().st_size < expected and header.transfer_syntax != _DEFLATED_LITTLE:
        raise _truncated(header, expected, header.path.stat().st_size)
    try:
        data = read_dataset(header.path, pixels=True).get("PixelData")
    except ValueError:
        raise _truncated(header, expected, 0) from None
    stored = b"" if data is None else bytes(data)
    if len(stored) < expected:
        raise _truncated(header, expected, len(stored))
    if len(stored) > expected + 1:  # one byte of padding keeps the length even
        msg = (
            f"reading {header.path.name}: expected {expected} bytes of pixels for {header.columns} x {header.rows}, "
            "found "
            f"{len(stored)}; the header does not fit the pixels; copy the series again"
        )
        raise VolumeImportError(msg, code="import.header")
    order = ">" if header.transfer_syntax == _EXPLICIT_BIG else "<"
    values = np.frombuffer(stored, dtype=f"{order}u{num_bytes}", count=header.rows * header.columns)
    # Bits beyond the used ones may hold anything (old overlays): shift them out at the top and at the bottom.
    word = values.astype(np.uint32) << np.uint32(31 - header.high_bit)
    kind = np.int32 if header.signed else np.uint32
    return (word.view(kind) >> kind(32 - header.bits_stored)).astype(np.int32).reshape(header.rows, header.columns)


def _decoded_values(header: SliceHeader) -> NDArray[np.float64]:
    reader = sitk.ImageFileReader()
    reader.SetImageIO("GDCMImageIO")
    reader.SetFileName(str(header.path))
    try:
        image = reader.Execute()
    except RuntimeError:
        msg = (
            f"reading {header.path.name}: its compressed pixels cannot be decoded (transfer syntax "
            f"{header.transfer_syntax}); the "
            "file is damaged or its compression is not supported; export the series uncompressed"
        )
        raise VolumeImportError(msg, code="import.truncated") from None
    size = image.GetSize()
    if size != (header.columns, header.rows, 1) or image.GetNumberOfComponentsPerPixel() != 1:
        msg = (
            f"reading {header.path.name}: expected {header.columns} x {header.rows} grey pixels, the compressed data "
            f"holds {size}; "
            "export the series again"
        )
        raise VolumeImportError(msg, code="import.header")
    # Two readings of one header must agree before the pixels are trusted: ours of the tags, and GDCM's.
    theirs = np.array(image.GetOrigin()), np.array(image.GetSpacing()[:2])
    if np.abs(theirs[0] - header.position_lps).max() > 0.01 or np.abs(theirs[1] - header.spacing_mm).max() > 1e-4:
        msg = (
            f"reading {header.path.name}: two readings of its position disagree; expected {header.position_lps}, found "
            f"{tuple(theirs[0])}; export the series again"
        )
        raise VolumeImportError(msg, code="import.geometry.disagree")
    # GDCM has already applied slope and intercept.
    return np.array(sitk.GetArrayViewFromImage(image)[0], dtype=np.float64)


def read_slice(header: SliceHeader) -> NDArray[np.float64] | NDArray[np.int32]:
    """Read one slice as rescaled numbers.

    Returns
    -------
    ndarray
        (rows, columns), after slope and intercept of this very slice: int32 where they are whole, else float64.

    Raises
    ------
    VolumeImportError
        ``import.truncated`` or ``import.header``, naming the file.
    """
    if header.transfer_syntax not in _PLAIN:
        return _decoded_values(header)
    stored = _plain_pixels(header)
    if header.slope == 1.0 and header.intercept == int(header.intercept) and abs(header.intercept) < 1 << 24:
        return stored + np.int32(header.intercept)
    return np.asarray(stored * header.slope + header.intercept, dtype=np.float64)
