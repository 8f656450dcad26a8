"""Writer of VTI files for tests, in each coding of the format; it shares no code with Carina's reader."""

from __future__ import annotations

import base64
import struct
import zlib
from pathlib import Path

import numpy as np

__all__ = ["CODINGS", "write_vti"]

CODINGS = ("ascii", "binary", "binary-zlib", "raw", "raw-zlib", "base64", "base64-zlib")
_TYPES = {"i1": "Int8", "u1": "UInt8", "i2": "Int16", "u2": "UInt16", "i4": "Int32", "f4": "Float32", "f8": "Float64"}


def write_vti(
    path: Path,
    values: np.ndarray,
    coding: str,
    *,
    order: str = "<",
    word: str = "I",
    block: int = 4096,
    spacing: str = "0.7 0.9 2.5",
    origin: str = "-11.25 -14.5 30",
    first: tuple[int, int, int] = (0, 0, 0),
    direction: str | None = "1 0 0 0 1 0 0 0 1",
    data: str = "PointData",
    more: str = "",
    wrap: bool = False,
) -> Path:
    """Write values ``[z, y, x]`` as one array and return the path."""
    sizes = values.shape[::-1]
    last = [n + s - (1 if data == "PointData" else 0) for n, s in zip(first, sizes, strict=True)]
    extent = " ".join(f"{a} {b}" for a, b in zip(first, last, strict=True))
    packed = coding.endswith("-zlib")
    kind = coding.removesuffix("-zlib")
    stored = values.astype(values.dtype.newbyteorder(order)).tobytes()
    if packed:
        blocks = [stored[at : at + block] for at in range(0, len(stored), block)]
        streams = [zlib.compress(one) for one in blocks]
        partial = len(stored) % block
        numbers = [len(blocks), block, partial, *map(len, streams)]
        parts = [struct.pack(f"{order}{len(numbers)}{word}", *numbers), b"".join(streams)]
    else:
        parts = [struct.pack(f"{order}{word}", len(stored)) + stored]
    text = b"".join(base64.b64encode(part) for part in parts)
    if wrap:
        text = b"\n".join(text[at : at + 76] for at in range(0, len(text), 76))
    form = {"ascii": "ascii", "binary": "binary"}.get(kind, "appended")
    inline = {"ascii": " ".join(map(str, values.ravel())).encode(), "binary": b"\n  " + text + b"\n"}.get(kind, b"")
    appended = {"raw": b"".join(parts), "base64": text}.get(kind)
    head = (
        f'<?xml version="1.0"?>\n<VTKFile type="ImageData" version="1.0" '
        f'byte_order="{"LittleEndian" if order == "<" else "BigEndian"}" '
        f'header_type="{"UInt32" if word == "I" else "UInt64"}"'
        + (' compressor="vtkZLibDataCompressor"' if packed else "")
        + f'>\n<!-- a > comment --><ImageData WholeExtent="{extent}" Origin="{origin}" Spacing="{spacing}"'
        + (f' Direction="{direction}"' if direction else "")
        + f'>\n<Piece Extent="{extent}">\n<{data} Scalars="ct">\n{more}'
        f'<DataArray type="{_TYPES[values.dtype.str[1:]]}" Name="ct" format="{form}"'
        + (' offset="0"' if appended is not None else "")
        + ">"
    )
    tail = f"</DataArray>\n</{data}>\n</Piece>\n</ImageData>\n"
    end = b""
    if appended is not None:
        end = f'<AppendedData encoding="{kind}">\n _'.encode() + appended + b"\n</AppendedData>\n"
    path.write_bytes(head.encode() + inline + tail.encode() + end + b"</VTKFile>\n")
    return path
