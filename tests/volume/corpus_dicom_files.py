"""DICOM files of the corpus that cannot be used, or whose pixel data contradict their header."""
# ruff: noqa: E501 (a table: one input a line)

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from corpus import Input
from dicom_writer import chest, packed, repack, series
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import (
    BasicTextSRStorage,
    DeflatedExplicitVRLittleEndian,
    ExplicitVRBigEndian,
    ExplicitVRLittleEndian,
    ImplicitVRLittleEndian,
    RLELossless,
)

__all__ = ["FILES", "PIXELS"]

Make = Callable[[Path], Path]
COPY = "Copy the series again."
AGAIN = "Export the series again without compression."
UNREAD = {"expected": "opens", "notes": ("import.files-unread",), "do": COPY}


def _spoil(*at: int, change: Callable[[bytes], bytes], name: Callable[[int], str] = lambda i: f"IM{i:03d}") -> Make:
    """Return a function that writes a correct series and then damages the files ``at``."""

    def make(folder: Path) -> Path:
        series(folder, name=name)
        for index in at:
            path = folder / name(index)
            path.write_bytes(change(path.read_bytes()))
        return folder

    return make


def _beside(*files: tuple[str, bytes]) -> Make:
    def make(folder: Path) -> Path:
        series(folder)
        for name, data in files:
            (folder / name).write_bytes(data)
        return folder

    return make


def _report(folder: Path) -> Path:
    series(folder)
    report = Dataset()
    report.file_meta = FileMetaDataset()
    report.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    report.file_meta.MediaStorageSOPClassUID = report.SOPClassUID = BasicTextSRStorage
    report.file_meta.MediaStorageSOPInstanceUID = report.SOPInstanceUID = "1.2.3.4"
    report.Modality, report.SeriesInstanceUID = "SR", "1.2.3.5"
    report.save_as(folder / "IM100", enforce_file_format=True)
    return folder


def _other_series_cut(folder: Path) -> Path:
    series(folder)
    series(folder, hu=chest()[:4], number=9, name=lambda i: f"other-{i}.ima")
    (folder / "other-3.ima").write_bytes(b"")
    return folder


def _dead_link(folder: Path) -> Path:
    series(folder)
    (folder / "IM019").unlink()
    (folder / "IM019").symlink_to(folder / "gone")
    return folder


def _subfolders(folder: Path) -> Path:
    series(folder, name=lambda i: f"{i:02d}/slice")
    (folder / "19" / "slice").write_bytes(b"")
    return folder


def _top() -> np.ndarray:
    return chest()[:17]


LAST = (17, 18, 19)
FILE = "DICOM: files"
FILES = [
    Input("the last three files empty", FILE, _spoil(*LAST, change=lambda data: b""), voxels=_top, names=("3 files", "IM017 (empty)", "IM018", "IM019"), **UNREAD),
    Input("the last three files truncated within the first tags", FILE, _spoil(*LAST, change=lambda data: data[:300]), voxels=_top, names=("3 files", "IM017", "IM019"), **UNREAD),
    Input("the last three files truncated before the image size", FILE, _spoil(*LAST, change=lambda data: data[: data.index(b"\x28\x00\x10\x00")]), voxels=_top, names=("3 files", "IM017 (truncated header)"), **UNREAD),
    Input("the last three files contain only zeros", FILE, _spoil(*LAST, change=lambda data: bytes(len(data))), voxels=_top, names=("3 files", "IM017"), **UNREAD),
    Input("the last three files without their first 200 bytes", FILE, _spoil(*LAST, change=lambda data: data[200:]), voxels=_top, names=("3 files", "IM017 (not DICOM)"), **UNREAD),
    Input("the last three files replaced by an HTML page", FILE, _spoil(*LAST, change=lambda data: b"<html>404</html>"), voxels=_top, names=("3 files", "IM017"), **UNREAD),
    Input("the first file empty, file names with an extension", FILE, _spoil(0, change=lambda data: b"", name=lambda i: f"ct{'abcdefghijklmnopqrst'[i]}.dcm"), voxels=lambda: chest()[1:], names=("1 file", "cta.dcm"), **UNREAD),
    Input("the last file is a broken link", FILE, _dead_link, voxels=lambda: chest()[:19], names=("IM019",), **UNREAD),
    Input("the last file empty, each slice in a separate folder", FILE, _subfolders, voxels=lambda: chest()[:19], names=("1 file",), **UNREAD),
    Input("a damaged DICOM file with a different kind of name", FILE, _beside(("extra", bytes(128) + b"DICM\x02\x00\x00\x00UL\x04\x00" + b"\xff" * 50)), voxels=chest, names=("extra (truncated header)",), **UNREAD),
    Input("three empty files in mid-stack", FILE, _spoil(8, 9, 10, change=lambda data: b""), "import.geometry.irregular", names=("IM008 (empty)", "IM010"), do=COPY),
    Input("the pixels of the last file truncated", FILE, _spoil(19, change=lambda data: data[:-100]), "import.truncated", names=("IM019",), do=COPY),
    Input("the last file without pixels", FILE, _spoil(19, change=lambda data: data[: data.index(b"\xe0\x7f\x10\x00")]), "import.truncated", names=("IM019",), do=COPY),
    Input("every file truncated", FILE, _spoil(*range(20), change=lambda data: data[:300]), "import.no-images", names=("IM000",), do=COPY),
    Input("documents, archives and hidden files beside the slices", FILE, _beside(("README.txt", b"hello"), (".DS_Store", b"\0\0\0\1Bud1"), ("Thumbs.db", b""), ("report.pdf", b"%PDF-1.4"), ("._IM003", b"\0\5\26\7"), ("all.zip", b"PK\3\4"), ("VERSION", b"")), "opens", voxels=chest),
    Input("a directory file (DICOMDIR) that cannot be read", FILE, _beside(("DICOMDIR", b"")), "opens", voxels=chest),
    Input("a structured report with a file name like those of the slices", FILE, _report, "opens", voxels=chest),
    Input("an empty file of another series", FILE, _other_series_cut, "opens", ("import.several-series",), voxels=chest, series=2, do="If you need the other series, copy it again."),
]  # fmt: skip


def _edited(edit: Callable[[Dataset, int], None], **options: Any) -> Make:
    return lambda folder: series(folder, edit, **options)


def _packed(
    kind: str, change: Callable[[bytes], bytes] | None = None, at: tuple[int, ...] = (4, 5), **tags: Any
) -> Make:
    def make(folder: Path) -> Path:
        def edit(dataset: Dataset, index: int) -> None:
            if kind == "RLE":
                dataset.compress(RLELossless, generate_instance_uid=False)
            else:
                packed(dataset, folder, kind)
            if change is not None and index in at:
                repack(dataset, change)
            for keyword, value in tags.items():
                setattr(dataset, keyword, value)

        return series(folder, edit)

    return make


def _with(at: Callable[[bytes], int], new: bytes) -> Callable[[bytes], bytes]:
    def change(frame: bytes) -> bytes:
        place = at(frame)
        return frame[:place] + new + frame[place + len(new) :]

    return change


def _depth(frame: bytes) -> int:
    """Return the position of the byte in a JPEG 2000 stream that states bit depth and sign."""
    return frame.index(b"\xff\x4f\xff\x51") + 42


def _noise_of(folder: Path) -> Path:
    """Write a JPEG 2000 series with noise in one slice, as a decoder returns it for a damaged stream."""

    def edit(dataset: Dataset, index: int) -> None:
        if index == 7:
            dataset.PixelData = np.random.default_rng(3).integers(0, 3000, 1024).astype("<u2").tobytes()
        packed(dataset, folder, "JPEG2000")

    return series(folder, edit)


def _big(dataset: Dataset, index: int) -> None:
    dataset.PixelData = np.frombuffer(dataset.PixelData, "<u2").astype(">u2").tobytes()


def _turned(dataset: Dataset, index: int) -> None:
    if index in (4, 5, 6):
        _big(dataset, index)


def _metal(dataset: Dataset, index: int) -> None:
    words = np.frombuffer(dataset.PixelData, "<u2").copy()
    words[400:440] = 60000
    dataset.PixelData = words.tobytes()


def _little_metal(dataset: Dataset, index: int) -> None:
    words = np.frombuffer(dataset.PixelData, "<u2").copy()
    words[400:404] = 60000
    dataset.PixelData = words.tobytes()


def _padded(dataset: Dataset, index: int) -> None:
    dataset.PixelRepresentation = 1
    words = np.frombuffer(dataset.PixelData, "<u2").astype("<i2")
    words[:300] = -32768
    dataset.PixelData = words.tobytes()


def _padded_hu() -> np.ndarray:
    values = chest().copy()
    values.reshape(20, -1)[:, :300] = -32768
    return values


def _noisy() -> np.ndarray:
    return chest(noise_hu=90.0)


def _flipped(frame: bytes) -> bytes:
    """Return a compressed frame with one changed bit near its end, which affects only the finest details."""
    return frame[:-200] + bytes([frame[-200] ^ 4]) + frame[-199:]


def _cut_end(frame: bytes) -> bytes:
    return frame.rstrip(b"\0")[:-2]


PIXEL = "DICOM: pixels"
DAMAGED = {
    "expected": "opens",
    "notes": ("import.clipped", "import.pixels-damaged", "import.slices-odd"),
    "is_hu": False,
    "do": AGAIN,
}
REFUSED = {"expected": "import.truncated", "do": AGAIN}
CONTRADICT = {"expected": "opens", "notes": ("import.pixels-contradict",), "is_hu": False, "do": AGAIN}
PIXELS = [
    Input("implicit little endian", PIXEL, lambda folder: series(folder, syntax=ImplicitVRLittleEndian), "opens", voxels=chest),
    Input("big endian", PIXEL, _edited(_big, syntax=ExplicitVRBigEndian), "opens", voxels=chest),
    Input("deflated", PIXEL, lambda folder: series(folder, syntax=DeflatedExplicitVRLittleEndian), "opens", voxels=chest),
    Input("lossless JPEG 2000", PIXEL, _packed("JPEG2000"), "opens", voxels=chest),
    Input("lossless JPEG", PIXEL, _packed("JPEG"), "opens", voxels=chest),
    Input("RLE", PIXEL, _packed("RLE"), "opens", voxels=chest),
    Input("a sharp kernel with 90 HU of noise", PIXEL, lambda folder: series(folder, hu=_noisy()), "opens", voxels=_noisy),
    Input("JPEG 2000, 12 bits in a 16-bit stream", PIXEL, _packed("JPEG2000", BitsStored=12, HighBit=11), "opens", voxels=chest),
    Input("JPEG 2000, the end marker missing in two slices", PIXEL, _packed("JPEG2000", _cut_end), names=("IM004",), **REFUSED),
    Input("JPEG 2000, two slices truncated to half of their length", PIXEL, _packed("JPEG2000", lambda frame: frame[: len(frame) // 2]), names=("IM004",), **REFUSED),
    Input("JPEG 2000, signed in the stream, unsigned in the tags", PIXEL, _packed("JPEG2000", _with(_depth, b"\x8f"), at=tuple(range(20))), "opens", ("import.clipped", "import.pixels-contradict"), is_hu=False, names=("20 of 20",), do=AGAIN),
    Input("JPEG 2000, signed in the tags, unsigned in the stream", PIXEL, _packed("JPEG2000", PixelRepresentation=1), names=("20 of 20",), **CONTRADICT),
    Input("JPEG 2000, 16 bits in the stream, 10 in the tags", PIXEL, _packed("JPEG2000", BitsStored=10, HighBit=9), names=("20 of 20",), **CONTRADICT),
    Input("JPEG 2000, a different image size in the stream", PIXEL, _packed("JPEG2000", _with(lambda frame: frame.index(b"\xff\x4f\xff\x51") + 8, b"\0\0\0\x40")), names=("IM004",), **REFUSED),
    Input("JPEG 2000, noise instead of the picture in one slice", PIXEL, _noise_of, "opens", ("import.slices-odd",), is_hu=False, names=("IM007",), do=AGAIN),
    Input("JPEG 2000, 40 bytes of one slice overwritten", PIXEL, _packed("JPEG2000", _with(lambda frame: len(frame) * 3 // 10, b"\x55" * 40), at=(7,)), "opens", ("import.pixels-damaged", "import.slices-odd"), is_hu=False, names=("IM007",), do=AGAIN),
    Input("JPEG 2000, one bit of one slice changed", PIXEL, _packed("JPEG2000", _flipped, at=(7,)), "opens", ("import.pixels-damaged",), is_hu=False, names=("IM007", "1 of 20"), do=AGAIN),
    Input("JPEG, 40 bytes of one slice overwritten", PIXEL, _packed("JPEG", _with(lambda frame: len(frame) * 3 // 10, b"\x55" * 40), at=(7,)), names=("IM007",), **DAMAGED),
    Input("JPEG, zeros in the second half of two slices", PIXEL, _packed("JPEG", lambda frame: frame[: len(frame) // 2] + bytes(len(frame) - len(frame) // 2)), names=("IM004",), **DAMAGED),
    Input("JPEG, two slices truncated to half of their length", PIXEL, _packed("JPEG", lambda frame: frame[: len(frame) // 2]), names=("IM004",), **REFUSED),
    Input("JPEG, a marker inside the data of two slices", PIXEL, _packed("JPEG", _with(lambda frame: len(frame) * 3 // 4, b"\xff\xc0")), names=("IM004",), **REFUSED),
    Input("RLE, a run in two slices lengthened", PIXEL, _packed("RLE", _with(lambda frame: 64, b"\x7f")), names=("IM004",), **REFUSED),
    Input("little endian, declared as big endian", PIXEL, lambda folder: series(folder, syntax=ExplicitVRBigEndian), "opens", ("import.clipped", "import.byte-order"), is_hu=False, do=AGAIN),
    Input("three slices with swapped bytes", PIXEL, _edited(_turned), "opens", ("import.clipped", "import.byte-order"), is_hu=False, names=("IM004", "3 of 20"), do=AGAIN),
    Input("a few metal voxels outside the range of 16 bits", PIXEL, _edited(_little_metal), "opens", ("import.clipped",), do="None: at most 1 % of the voxels are affected."),
    Input("4 % of the voxels outside the range of 16 bits", PIXEL, _edited(_metal), "opens", ("import.clipped",), is_hu=False, do=AGAIN),
    Input("padding of -32768 round the picture", PIXEL, _edited(_padded), "opens", ("import.clipped",), voxels=_padded_hu, do="None: padding is not a part of the picture."),
]  # fmt: skip
