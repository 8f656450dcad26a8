"""Digests of the code that computes cached data; data that other code computed is not used."""

from __future__ import annotations

import contextlib
import functools
import hashlib
from pathlib import Path

from carina import _core
from carina.version import VERSION

__all__ = ["compiled_code_digest", "reader_digest"]

_DECODERS = ("pydicom", "python-gdcm", "numpy", "av")


@functools.cache
def compiled_code_digest() -> str:
    """Return a digest of the compiled module: another build has another digest, even with the same version.

    The file is read at the first call only, because importing Carina must stay fast.

    Returns
    -------
    str
        32 hexadecimal digits.

    Raises
    ------
    OSError
        If the file of the module cannot be read.
    """
    with Path(_core.__file__).open("rb") as file:
        return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest()


@functools.cache
def reader_digest() -> str:
    """Return a digest of all code that reads volumes: Carina's version, Python files, compiled module and decoders.

    Returns
    -------
    str
        32 hexadecimal digits.

    Raises
    ------
    OSError
        If a file of the code cannot be read.
    """
    import importlib.metadata  # slow to load, and called once

    found = hashlib.blake2b(VERSION.encode(), digest_size=16)
    for source in sorted(Path(__file__).parent.glob("*.py")):
        found.update(source.name.encode())
        found.update(source.read_bytes())
    found.update(compiled_code_digest().encode())
    for decoder in _DECODERS:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found.update(importlib.metadata.version(decoder).encode())
    return found.hexdigest()
