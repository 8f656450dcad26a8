"""Decompression of gzip and zlib streams in pieces: all members, their checksums, and the count of trailing bytes."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from typing import BinaryIO, Protocol

_CHUNK_BYTES = 1 << 20
_GZIP = b"\x1f\x8b"


class Readable(Protocol):
    """Interface of an object that is read in pieces."""

    def read(self, num_bytes: int, /) -> bytes:
        """Return at most ``num_bytes``; empty at the end."""


class Unpacker:
    """Decompression of a file from its present position to its end.

    A gzip file may consist of several members (as bgzip and pigz write them); zeros behind them pad the file to whole
    blocks and are ignored. All other bytes behind the last member are counted in ``trailing_bytes``.
    """

    def __init__(self, file: Readable, kind: str, *, chunk_bytes: int = _CHUNK_BYTES) -> None:
        self._file = file
        self._chunk_bytes = chunk_bytes
        self._bits = {"gzip": zlib.MAX_WBITS | 16, "zlib": zlib.MAX_WBITS | 32}[kind]
        self._many = kind == "gzip"
        self.trailing_bytes = 0

    def __iter__(self) -> Iterator[bytes]:
        """Yield the decompressed data in pieces of at most 1 MiB.

        Raises
        ------
        ValueError
            If the stream is damaged (a wrong checksum included) or truncated.
        """
        inflater = zlib.decompressobj(self._bits)
        chunk = b""
        while True:
            if not chunk:
                chunk = self._file.read(self._chunk_bytes)
                if not chunk:
                    msg = "its compressed data ends prematurely"
                    raise ValueError(msg)
            try:
                piece = inflater.decompress(chunk, _CHUNK_BYTES)
            except zlib.error:
                msg = "its compressed data is corrupt"
                raise ValueError(msg) from None
            if piece:
                yield piece
            chunk = inflater.unconsumed_tail
            if inflater.eof:
                chunk = self._next_member(inflater.unused_data)
                if not chunk:
                    return
                inflater = zlib.decompressobj(self._bits)

    def _next_member(self, rest: bytes) -> bytes:
        """Return the first bytes of the next member; empty if there is none."""
        while True:
            if self._many and not self.trailing_bytes:
                while len(rest.lstrip(b"\0")) < 2:
                    more = self._file.read(self._chunk_bytes)
                    if not more:
                        break
                    rest = rest.lstrip(b"\0") + more
                rest = rest.lstrip(b"\0")
                if rest.startswith(_GZIP):
                    return rest
            self.trailing_bytes += len(rest)
            rest = self._file.read(self._chunk_bytes)
            if not rest:
                return b""


class UnpackedFile:
    """The decompressed content of a gzip file, read from the beginning to the end like a file.

    ``read`` raises ValueError if the gzip file is damaged.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._pieces = iter(Unpacker(file, "gzip"))
        self._rest = b""

    def read(self, num_bytes: int) -> bytes:
        """Return at most ``num_bytes``; empty at the end."""
        if not self._rest:
            self._rest = next(self._pieces, b"")
        out, self._rest = self._rest[:num_bytes], self._rest[num_bytes:]
        return out
