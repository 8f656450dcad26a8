"""Archives and discs of the corpus."""
# ruff: noqa: E501 (a table: one input a line)

from __future__ import annotations

import io
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path

from corpus import Input
from dicom_writer import chest, series

__all__ = ["INPUTS"]

FAMILY = "Archives and discs"
WHOLE = {"expected": "opens", "voxels": chest}
COPY = "Copy the file again."


def _files(folder: Path) -> dict[str, bytes]:
    scan = series(folder / "scan", name=lambda index: f"DICOM/ST0/I{index}")
    return {path.relative_to(scan).as_posix(): path.read_bytes() for path in sorted(scan.rglob("*")) if path.is_file()}


def _zipped(files: dict[str, bytes]) -> bytes:
    text = io.BytesIO()
    with zipfile.ZipFile(text, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return text.getvalue()


def _zip(change: Callable[[bytes], bytes] = bytes) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = folder / "scan.zip"
        path.write_bytes(change(_zipped(_files(folder))))
        return path

    return make


def _tar(mode: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = folder / "scan.tar.gz"
        with tarfile.open(path, mode) as archive:
            for name, content in _files(folder).items():
                member = tarfile.TarInfo(name)
                member.size = len(content)
                archive.addfile(member, io.BytesIO(content))
        return path

    return make


def _disc(folder: Path) -> Path:
    _files(folder)
    (folder / "scan" / "AUTORUN.INF").write_text("[autorun]")
    return folder / "scan"


INPUTS = [
    Input("a zip archive", FAMILY, _zip(), **WHOLE),
    Input("a zip archive in a zip archive", FAMILY, _zip(lambda data: _zipped({"inner.zip": data})), **WHOLE),
    Input("a tar archive", FAMILY, _tar("w"), **WHOLE),
    Input("a tar archive compressed with gzip", FAMILY, _tar("w:gz"), **WHOLE),
    Input("a tar archive compressed with xz", FAMILY, _tar("w:xz"), **WHOLE),
    Input("a zip archive with a file whose path leads out of the archive", FAMILY, _zip(lambda data: data.replace(b"DICOM/ST0/I7", b"../../../I_7")), **WHOLE),
    Input("the root of a disc, files without extension", FAMILY, _disc, **WHOLE),
    Input("a truncated zip archive", FAMILY, _zip(lambda data: data[: len(data) // 2]), "import.archive.damaged", names=("scan.zip",), do=COPY),
]  # fmt: skip
