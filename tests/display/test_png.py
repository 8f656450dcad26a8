"""Tests of the PNG decoder for images that Carina has written."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest
import SimpleITK as sitk

from carina.display.png import SIGNATURE, png_bytes, png_pixels


@pytest.mark.parametrize("shape", [(1, 1), (5, 7), (40, 33)])
def test_decoded_image_equals_the_encoded_one_and_that_of_another_reader(rng, tmp_path, shape):
    noise = rng.integers(0, 256, (*shape, 3)).astype(np.uint8)
    ramp = np.broadcast_to(np.arange(shape[1])[None, :, None], (*shape, 3)).astype(np.uint8)
    for rgb in (noise, np.ascontiguousarray(ramp), np.repeat(noise[:1], shape[0], axis=0)):
        stored = png_bytes(rgb, {"carina-pose": "{}"})
        np.testing.assert_array_equal(png_pixels(stored), rgb)
        (tmp_path / "image.png").write_bytes(stored)
        np.testing.assert_array_equal(sitk.GetArrayFromImage(sitk.ReadImage(tmp_path / "image.png")), rgb)


def test_truncated_or_changed_file_is_refused(rng):
    stored = png_bytes(rng.integers(0, 256, (9, 8, 3)).astype(np.uint8))
    for length in range(len(stored)):
        with pytest.raises(ValueError, match=r"expected|truncated|end|checksum"):
            png_pixels(stored[:length])
    for at in range(len(stored)):
        changed = bytearray(stored)
        changed[at] ^= 4
        with pytest.raises(ValueError, match=r"expected|truncated|end|checksum"):
            png_pixels(bytes(changed))


def png_of(scanlines: bytes, *, header: bytes) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    return SIGNATURE + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(scanlines)) + chunk(b"IEND", b"")


COLOUR = struct.pack(">IIBBBBB", 2, 1, 8, 2, 0, 0, 0)


@pytest.mark.parametrize(
    ("scanlines", "header", "reason"),
    [
        (bytes(7), struct.pack(">IIBBBBB", 2, 1, 16, 2, 0, 0, 0), "8-bit"),
        (bytes(3), struct.pack(">IIBBBBB", 2, 1, 8, 0, 0, 0, 0), "8-bit"),
        (bytes(6), COLOUR, "size"),
        (bytes(100_000), COLOUR, "size"),
        (b"\4" + bytes(6), COLOUR, "another program"),
        (b"", struct.pack(">IIBBBBB", 0, 1, 8, 2, 0, 0, 0), "out of range"),
        (b"", struct.pack(">IIBBBBB", 2**32 - 1, 2**32 - 1, 8, 2, 0, 0, 0), "out of range"),
    ],
)
def test_image_of_another_kind_or_size_is_refused(scanlines, header, reason):
    with pytest.raises(ValueError, match=reason):
        png_pixels(png_of(scanlines, header=header))
