"""The pixels of one DICOM slice: stored numbers, then the rescale of that slice (PS3.3 C.7.6.16.2.9, C.11.1)."""

from __future__ import annotations

import struct
import tempfile
from pathlib import Path

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import UID, CTImageStorage

from carina.errors import VolumeImportError
from carina.volume.dicom_headers import SliceHeader, read_dataset

__all__ = ["read_slice"]

# Stored as plain numbers: read here, checked byte for byte. Everything else is decoded by GDCM through SimpleITK.
_IMPLICIT_LITTLE, _EXPLICIT_LITTLE = "1.2.840.10008.1.2", "1.2.840.10008.1.2.1"
_DEFLATED_LITTLE, _EXPLICIT_BIG = "1.2.840.10008.1.2.1.99", "1.2.840.10008.1.2.2"
_RLE = "1.2.840.10008.1.2.5"
# What GDCM decodes: JPEG (lossy and lossless), JPEG-LS, JPEG 2000 (PS3.5 A.4).
_CODED = {f"1.2.840.10008.1.2.4.{number}" for number in (50, 51, 53, 55, 57, 70, 80, 81, 90, 91)} | {_RLE}
_PLAIN = {_IMPLICIT_LITTLE, _EXPLICIT_LITTLE, _DEFLATED_LITTLE, _EXPLICIT_BIG, ""}


def _truncated(header: SliceHeader, expected: int, found: int) -> VolumeImportError:
    msg = (
        f"reading {header.path.name}: its pixels are cut short: expected {expected} bytes, found {found}; the copy is "
        "incomplete; copy the series again"
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
            f"found {len(stored)}; the header does not fit the pixels; copy the series again"
        )
        raise VolumeImportError(msg, code="import.header")
    order = ">" if header.transfer_syntax == _EXPLICIT_BIG else "<"
    values = np.frombuffer(stored, dtype=f"{order}u{num_bytes}", count=header.rows * header.columns)
    # Bits beyond the used ones may hold anything (old overlays): shift them out at the top and at the bottom.
    word = values.astype(np.uint32) << np.uint32(31 - header.high_bit)
    kind = np.int32 if header.signed else np.uint32
    return (word.view(kind) >> kind(32 - header.bits_stored)).astype(np.int32).reshape(header.rows, header.columns)


_JPEG_START, _J2K_START = b"\xff\xd8\xff", b"\xff\x4f\xff\x51"
_MAX_J2K_TILES = 4096  # one tile is usual; each costs the decoder kilobytes, whatever it holds


def _coded_size(stored: bytes) -> tuple[int, int, int] | None:
    """Rows, columns and components that a JPEG, JPEG-LS or JPEG 2000 stream claims for itself, or None.

    The decoder believes the stream, not the tags, and takes memory for it before it finds out (ITU-T T.81 B.2.2,
    T.87 C.2.2, T.800 A.5.1).
    """
    at = stored.find(_J2K_START, 0, 4096)
    if at >= 0:
        right, bottom, left, top, tile_x, tile_y = struct.unpack_from(">6I", stored, at + 8)
        (components,) = struct.unpack_from(">H", stored, at + 40)
        if min(tile_x, tile_y) < 1 or -(-right // tile_x) * -(-bottom // tile_y) > _MAX_J2K_TILES:
            return None
        return bottom - top, right - left, components
    at = stored.find(_JPEG_START, 0, 4096)
    if at < 0:
        return None
    at += 2
    while stored[at] == 0xFF:
        marker = stored[at + 1]
        if marker == 0xF7 or (0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC)):
            rows, columns, components = struct.unpack_from(">2HB", stored, at + 5)
            return rows, columns, components
        at += 2 + int.from_bytes(stored[at + 2 : at + 4], "big")
    return None


def _check_coded_size(header: SliceHeader, stored: bytes) -> None:
    try:
        size = _coded_size(stored)
    except (IndexError, struct.error):
        size = None
    if size == (header.rows, header.columns, 1):
        return
    found = "no readable size" if size is None else f"{size[1]} x {size[0]} pixels of {size[2]} values"
    msg = (
        f"reading {header.path.name}: expected {header.columns} x {header.rows} grey pixels, its compressed stream "
        f"holds {found}; the file is damaged; copy the series again"
    )
    raise VolumeImportError(msg, code="import.truncated")


def _decoded_pixels(header: SliceHeader) -> NDArray[np.int32]:
    """Decode with GDCM, which gets a new file with the compressed pixels and what decoding needs, and nothing else.

    So no other element of a damaged file can mislead it, and slope, intercept and geometry are read in one place
    only: ours.
    """
    if header.transfer_syntax not in _CODED:
        msg = (
            f"reading {header.path.name}: its pixels are compressed in a way that cannot be decoded here; expected "
            "JPEG, JPEG-LS, JPEG 2000 or RLE; export the series uncompressed"
        )
        raise VolumeImportError(msg, code="import.unsupported")
    try:
        stored = bytes(read_dataset(header.path, pixels=True).get("PixelData") or b"")
    except ValueError:
        msg = f"reading {header.path.name}: its pixels cannot be found; the file is damaged; copy the series again"
        raise VolumeImportError(msg, code="import.truncated") from None
    if header.transfer_syntax != _RLE:
        _check_coded_size(header, stored)
    pixels = Dataset()
    pixels.file_meta = FileMetaDataset()
    pixels.file_meta.TransferSyntaxUID = UID(header.transfer_syntax)
    pixels.file_meta.MediaStorageSOPClassUID = pixels.SOPClassUID = CTImageStorage
    pixels.file_meta.MediaStorageSOPInstanceUID = pixels.SOPInstanceUID = UID("1.2.3")
    pixels.Rows, pixels.Columns = header.rows, header.columns
    pixels.SamplesPerPixel, pixels.PhotometricInterpretation = 1, "MONOCHROME2"
    pixels.BitsAllocated, pixels.BitsStored, pixels.HighBit = header.bits_allocated, header.bits_stored, header.high_bit
    pixels.PixelRepresentation = 1 if header.signed else 0
    pixels.PixelData = stored
    pixels["PixelData"].VR = "OB"
    pixels["PixelData"].is_undefined_length = True
    reader = sitk.ImageFileReader()
    reader.SetImageIO("GDCMImageIO")
    with tempfile.TemporaryDirectory(prefix="carina-") as folder:
        path = Path(folder) / "pixels.dcm"
        reader.SetFileName(str(path))
        try:
            pixels.save_as(path, enforce_file_format=True)
            image = reader.Execute()
        except (RuntimeError, ValueError, MemoryError):
            msg = (
                f"reading {header.path.name}: its compressed pixels cannot be decoded (transfer syntax "
                f"{header.transfer_syntax}); the file is damaged or its compression is not supported; export the "
                "series uncompressed"
            )
            raise VolumeImportError(msg, code="import.truncated") from None
    if image.GetSize() != (header.columns, header.rows, 1) or image.GetNumberOfComponentsPerPixel() != 1:
        msg = (
            f"reading {header.path.name}: expected {header.columns} x {header.rows} grey pixels, the compressed data "
            f"holds {image.GetSize()}; export the series again"
        )
        raise VolumeImportError(msg, code="import.header")
    return np.array(sitk.GetArrayViewFromImage(image)[0], dtype=np.int32)


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
    stored = _plain_pixels(header) if header.transfer_syntax in _PLAIN else _decoded_pixels(header)
    if header.slope == 1.0 and header.intercept == int(header.intercept) and abs(header.intercept) < 1 << 24:
        return stored + np.int32(header.intercept)
    return np.asarray(stored * header.slope + header.intercept, dtype=np.float64)
