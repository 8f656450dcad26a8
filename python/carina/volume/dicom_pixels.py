"""Reader of the pixels of one DICOM slice: stored numbers, then rescale (PS3.3 C.7.6.16.2.9, C.11.1).

Pixels that are certainly wrong (too few, another size, a stream that cannot be decoded) are refused. If pixels can be
read but other data contradict them, they get a ``Doubt``, and the volume is not HU.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.encaps import encapsulate
from pydicom.uid import UID, CTImageStorage

from carina.disk import scratch_folder
from carina.errors import VolumeImportError
from carina.volume.dicom_headers import SliceHeader
from carina.volume.dicom_pixel_bytes import read_plain_pixels, read_stream_bytes
from carina.volume.dicom_streams import Stream, decoder_words, read_stream, rle_problem
from carina.volume.gdcm_decoder import decode
from carina.volume.model import Remark
from carina.volume.padding import PaddedPixels, find_padding

# Transfer syntaxes of uncompressed numbers, which this module reads and checks. GDCM decodes all others.
_IMPLICIT_LITTLE, _EXPLICIT_LITTLE = "1.2.840.10008.1.2", "1.2.840.10008.1.2.1"
_DEFLATED_LITTLE, _EXPLICIT_BIG = "1.2.840.10008.1.2.1.99", "1.2.840.10008.1.2.2"
_RLE = "1.2.840.10008.1.2.5"
# Transfer syntaxes that GDCM decodes: JPEG (lossy and lossless), JPEG-LS, JPEG 2000 (PS3.5 A.4).
_JPEG_LS = ("1.2.840.10008.1.2.4.80", "1.2.840.10008.1.2.4.81")
_CODED = {f"1.2.840.10008.1.2.4.{number}" for number in (50, 51, 53, 55, 57, 70, 80, 81, 90, 91)} | {_RLE}
_PLAIN = {_IMPLICIT_LITTLE, _EXPLICIT_LITTLE, _DEFLATED_LITTLE, _EXPLICIT_BIG, ""}


@dataclass(frozen=True, slots=True)
class Doubt(Remark):
    """Reason why the pixels of a slice may be wrong although they could be read."""


@dataclass(frozen=True, slots=True)
class SlicePixels:
    """One slice after its rescale or Modality LUT, with padding set to air."""

    numbers: NDArray[np.float64] | NDArray[np.int32]
    """(rows, columns), int32 if all values are whole numbers, otherwise float64."""
    doubts: tuple[Doubt, ...]
    padded: PaddedPixels | None = None
    """Padding that was set to air; None if the slice has no padding above air."""


def _truncated_error(header: SliceHeader, expected: int, found: int) -> VolumeImportError:
    msg = (
        f"reading {header.file_name}: its pixel data is truncated (expected {expected} bytes, found {found}), probably "
        "by an incomplete copy; copy the series again"
    )
    return VolumeImportError(msg, code="import.truncated")


def _plain_pixels(header: SliceHeader) -> tuple[NDArray[np.int32], tuple[Doubt, ...]]:
    """Return the stored numbers of an uncompressed slice, and doubts about their byte order."""
    num_bytes = header.bits_allocated // 8
    expected = header.rows * header.columns * num_bytes
    if header.path.stat().st_size < expected and header.transfer_syntax != _DEFLATED_LITTLE:
        raise _truncated_error(header, expected, header.path.stat().st_size)
    try:
        stored, surplus = read_plain_pixels(header, expected)
    except ValueError:
        raise _truncated_error(header, expected, 0) from None
    if len(stored) < expected:
        raise _truncated_error(header, expected, len(stored))
    if surplus > 1:  # one byte of padding makes the length even
        whole = expected * header.num_frames
        frames = f" in {header.num_frames} frames" if header.frame is not None else ""
        msg = (
            f"reading {header.path.name}: expected {whole} bytes of pixel data for {header.columns} x {header.rows} "
            f"pixels{frames}, found {whole + surplus}; the header does not match the pixel data; copy the series again"
        )
        raise VolumeImportError(msg, code="import.header")
    order = ">" if header.transfer_syntax == _EXPLICIT_BIG else "<"
    words = np.frombuffer(stored, dtype=f"{order}u{num_bytes}", count=header.rows * header.columns)
    words = words.reshape(header.rows, header.columns).astype(f"=u{num_bytes}", copy=False)
    return _used_bits(words, header), _byte_order_doubts(words, lambda some: _used_bits(some, header))


def _used_bits(words: NDArray[np.generic], header: SliceHeader) -> NDArray[np.int32]:
    # Bits outside the used ones may contain other data (old overlays), so both ends are shifted out.
    word = words.astype(np.uint32) << np.uint32(31 - header.high_bit)
    kind = np.int32 if header.signed else np.uint32
    return (word.view(kind) >> kind(32 - header.bits_stored)).astype(np.int32)


def _roughness(values: NDArray[np.int32]) -> float:
    return float(np.abs(np.diff(values, axis=1)).mean()) if values.shape[1] > 1 else 0.0


def _byte_order_doubts(
    words: NDArray[np.generic], used_bits: Callable[[NDArray[np.generic]], NDArray[np.int32]]
) -> tuple[Doubt, ...]:
    """Return a doubt if the stored numbers are noise and become an image when their bytes are swapped.

    In shared and synthetic CTs, with noise up to 90 HU, swapping makes correct rows 25 to 300 times as rough, and
    swapped rows smoother by the same factor. Numbers that use only one byte cannot be checked.
    """
    if words.dtype.itemsize != 2:
        return ()
    some = np.ascontiguousarray(words[:: max(1, words.shape[0] // 32)])
    rough = _roughness(used_bits(some))
    if rough < 200 or rough < 5 * _roughness(used_bits(some.byteswap())):
        return ()
    low_bytes = some & np.uint16(255)
    if low_bytes.min() == low_bytes.max():
        return ()
    words_of = "its byte order appears to differ from what the file states: read as stated, its values are noise"
    return (Doubt("import.byte-order", words_of),)


def _check_coded_size(header: SliceHeader, stream: Stream | None) -> None:
    """Raise an error if the size of a compressed stream differs from that of the tags."""
    if stream is not None and stream.has_size_of(header.rows, header.columns):
        return
    found = (
        "no readable size"
        if stream is None
        else f"{stream.columns} x {stream.rows} pixels with {stream.components} values each"
    )
    msg = (
        f"reading {header.file_name}: expected {header.columns} x {header.rows} grey pixels, found {found}; the "
        "file is damaged; copy the series again"
    )
    raise VolumeImportError(msg, code="import.truncated")


def _check_jpeg_ls_depth(header: SliceHeader, stream: Stream | None) -> None:
    """Raise an error if a JPEG-LS stream and the tags state words of different sizes.

    GDCM would decode such a stream beyond the end of its memory and end the process.
    """
    if stream is None or header.transfer_syntax not in _JPEG_LS:
        return
    if (stream.bits <= 8) != (header.bits_allocated == 8):
        msg = (
            f"reading {header.file_name}: its compressed stream contains {stream.bits}-bit numbers, but the tags "
            f"reserve {header.bits_allocated} bits, which the decoder cannot read; export the series uncompressed"
        )
        raise VolumeImportError(msg, code="import.header")


def _stream_doubts(header: SliceHeader, stream: Stream, pixels: NDArray[np.int32]) -> list[Doubt]:
    """Return doubts about a stream that contradicts the tags (PS3.5 8.2); it is unknown which of the two is right."""
    doubts = []
    if stream.problem is not None:
        doubts.append(Doubt("import.pixels-damaged", f"the compressed data is corrupt: {stream.problem}"))
    if stream.signed is not None and stream.signed != header.signed:
        kinds = ("signed", "unsigned") if stream.signed else ("unsigned", "signed")
        words = f"the compressed stream contains {kinds[0]} numbers, but the tags say {kinds[1]}"
        doubts.append(Doubt("import.pixels-contradict", words))
    elif stream.bits != header.bits_stored:
        # Harmless if every number has the same meaning with both depths, as in the many files that pad 12 bits to 16.
        bits = min(stream.bits, header.bits_stored)
        low, high = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if header.signed else (0, (1 << bits) - 1)
        if int(pixels.min()) < low or int(pixels.max()) > high:
            words = f"the compressed stream has {stream.bits}-bit numbers, but the tags say {header.bits_stored}-bit"
            doubts.append(Doubt("import.pixels-contradict", words))
    return doubts


def _decoded_pixels(header: SliceHeader) -> tuple[NDArray[np.int32], tuple[Doubt, ...]]:
    """Decode with GDCM, from a new file with only the compressed pixels and the tags that decoding needs.

    So no other element of a damaged file affects GDCM, and slope, intercept and geometry are read by Carina only.
    """
    if header.transfer_syntax not in _CODED:
        msg = (
            f"reading {header.path.name}: its pixels use an unsupported compression; expected "
            "JPEG, JPEG-LS, JPEG 2000 or RLE; export the series uncompressed"
        )
        raise VolumeImportError(msg, code="import.not-supported")
    try:
        frame = read_stream_bytes(header)
    except ValueError:
        loss = "cannot be found" if header.frame is None else "cannot be divided into its frames"
        msg = f"reading {header.path.name}: its pixel data {loss}; the file is damaged; copy the series again"
        raise VolumeImportError(msg, code="import.truncated") from None
    if frame is None:
        msg = (
            f"reading {header.file_name}: its compressed pixel data is truncated, probably by an incomplete copy; copy "
            "the series again"
        )
        raise VolumeImportError(msg, code="import.truncated")
    stream, doubts = None, []
    if header.transfer_syntax == _RLE:
        problem = rle_problem(frame, header.rows * header.columns)
        if problem is not None:
            doubts.append(Doubt("import.pixels-damaged", f"the compressed data is corrupt: {problem}"))
    else:
        stream = read_stream(frame)
        _check_coded_size(header, stream)
        _check_jpeg_ls_depth(header, stream)
    pixels = Dataset()
    pixels.file_meta = FileMetaDataset()
    pixels.file_meta.TransferSyntaxUID = UID(header.transfer_syntax)
    pixels.file_meta.MediaStorageSOPClassUID = pixels.SOPClassUID = CTImageStorage
    pixels.file_meta.MediaStorageSOPInstanceUID = pixels.SOPInstanceUID = UID("1.2.3")
    pixels.Rows, pixels.Columns = header.rows, header.columns
    pixels.SamplesPerPixel, pixels.PhotometricInterpretation = 1, "MONOCHROME2"
    pixels.BitsAllocated, pixels.BitsStored, pixels.HighBit = header.bits_allocated, header.bits_stored, header.high_bit
    pixels.PixelRepresentation = 1 if header.signed else 0
    pixels.PixelData = encapsulate([frame])
    pixels["PixelData"].VR = "OB"
    pixels["PixelData"].is_undefined_length = True
    with scratch_folder() as folder:
        path = folder / "pixels.dcm"
        try:
            pixels.save_as(path, enforce_file_format=True)
            with decoder_words() as muttered:
                values = decode(path)
        except (RuntimeError, ValueError, MemoryError, OverflowError, TypeError, AttributeError, LookupError):
            msg = (
                f"reading {header.file_name}: its compressed pixel data cannot be decoded (transfer syntax "
                f"{header.transfer_syntax}); the file is damaged or its compression is not supported; export the "
                "series uncompressed"
            )
            raise VolumeImportError(msg, code="import.truncated") from None
    if values.shape != (header.rows, header.columns):
        msg = (
            f"reading {header.file_name}: expected {header.columns} x {header.rows} grey pixels, found "
            f"an image of size {values.shape[::-1]}; export the series again"
        )
        raise VolumeImportError(msg, code="import.header")
    if stream is not None:
        values = _signed_as_tagged(values, stream, header)
        doubts.extend(_stream_doubts(header, stream, values))
    if muttered and not any(doubt.code == "import.pixels-damaged" for doubt in doubts):
        doubts.append(Doubt("import.pixels-damaged", "the compressed data is corrupt"))
    if header.bits_allocated == 16:
        words = (values & 0xFFFF).astype(np.uint16)
        kind = np.int16 if header.signed else np.uint16
        doubts.extend(_byte_order_doubts(words, lambda some: some.view(kind).astype(np.int32)))
    return values, tuple(doubts)


def _signed_as_tagged(values: NDArray[np.int32], stream: Stream, header: SliceHeader) -> NDArray[np.int32]:
    """Return decoded numbers of JPEG 2000 with the sign and the depth that the tags state if the stream contradicts."""
    if stream.signed is None or stream.signed == header.signed:
        return values
    unused = 32 - header.bits_stored
    word = values.astype(np.uint32) << np.uint32(unused)
    kind = np.int32 if header.signed else np.uint32
    return (word.view(kind) >> kind(unused)).astype(np.int32)


def is_compressed(header: SliceHeader) -> bool:
    """Return whether the pixels are compressed and need a decoder."""
    return header.transfer_syntax not in _PLAIN


def decode_slice(header: SliceHeader) -> SlicePixels:
    """Read one slice, rescaled by its own tags, with padding set to air and with doubts about its pixels.

    Raises
    ------
    VolumeImportError
        ``import.truncated``, ``import.header`` or ``import.not-supported``; the message names the file.
    """
    stored, doubts = _plain_pixels(header) if header.transfer_syntax in _PLAIN else _decoded_pixels(header)
    numbers, more = _modality_values(stored, header)
    padded = find_padding(stored, numbers, header.padding) if header.modality == "CT" else None
    if padded is not None:
        numbers[padded.inside] = padded.fill
    return SlicePixels(numbers, (*doubts, *more), padded)


def _rescale(stored: NDArray[np.int32], header: SliceHeader) -> NDArray[np.float64] | NDArray[np.int32]:
    if header.slope == 1.0 and header.intercept == int(header.intercept) and abs(header.intercept) < 1 << 24:
        return np.asarray(stored + np.int32(header.intercept), dtype=np.int32)
    return np.asarray(stored * header.slope + header.intercept, dtype=np.float64)


def _modality_values(
    stored: NDArray[np.int32], header: SliceHeader
) -> tuple[NDArray[np.float64] | NDArray[np.int32], tuple[Doubt, ...]]:
    """Return the values after the rescale or the Modality LUT, and a doubt if the two contradict each other."""
    if header.modality_lut is None:
        return _rescale(stored, header), ()
    by_table = header.modality_lut.values(stored)
    if not (header.has_slope or header.has_intercept):
        return by_table, ()
    by_rescale = _rescale(stored, header)
    apart = float(np.abs(by_table - by_rescale).max())
    if apart < 1.0:
        return by_rescale, ()
    words = (
        "the tags contain both a rescale and a Modality LUT, of which DICOM allows one, and their values differ by up "
        f"to {apart:.0f}; the values of the rescale are shown"
    )
    return by_rescale, (Doubt("import.modality-lut", words),)


def read_slice(header: SliceHeader) -> NDArray[np.float64] | NDArray[np.int32]:
    """Return the rescaled values of a slice as `decode_slice` does, without the doubts about them."""
    return decode_slice(header).numbers
