"""Grid files of the corpus: NIfTI, NRRD and MetaImage, correct or with one defect."""

from __future__ import annotations

import bz2
import gzip
import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from corpus import Input
from grid_writers import AIR, FORMS, LPS_FROM_IJK, bgzip, chest, metaimage, nifti, nrrd
from nifti_qform_writer import nearest_rotation, with_both_forms, with_qform

__all__ = ["INPUTS"]

Make = Callable[[Path], Path]
AGAIN = "Export the file again."
SLICER = "Open the DICOM series from which the file was made, or convert that series again."


def _same() -> np.ndarray:
    return chest()


def _nifti(values: np.ndarray | None = None, **options: Any) -> Make:
    return lambda folder: nifti(folder, chest() if values is None else values, **options)


def _nrrd(values: np.ndarray | None = None, **options: Any) -> Make:
    return lambda folder: nrrd(folder, chest() if values is None else values, **options)


def _meta(values: np.ndarray | None = None, **options: Any) -> Make:
    return lambda folder: metaimage(folder, chest() if values is None else values, **options)


def _form(name: str, kind: str = "<i2") -> Make:
    return lambda folder: FORMS[name](folder, chest().astype(kind))


def _lines(*changes: tuple[str, str]) -> Callable[[list[str]], None]:
    """Return an edit that replaces the header lines that begin with the given texts.

    An empty beginning inserts the new line before the last line; an empty new line removes the old one.
    """

    def edit(lines: list[str]) -> None:
        for old, new in changes:
            if not old:
                lines.insert(len(lines) - 1, new)
                continue
            at = next(n for n, line in enumerate(lines) if line.startswith(old))
            lines[at : at + 1] = [new] if new else []

    return edit


def _gzipped(edit: Callable[[bytes], bytes]) -> Make:
    def make(folder: Path) -> Path:
        path = folder / "ct.nii.gz"
        path.write_bytes(edit(gzip.compress(nifti(folder, chest()).read_bytes())))
        (folder / "ct.nii").unlink()
        return path

    return make


def _edited(make: Make, edit: Callable[[bytearray], None]) -> Make:
    def again(folder: Path) -> Path:
        path = make(folder)
        data = bytearray(path.read_bytes())
        edit(data)
        path.write_bytes(bytes(data))
        return path

    return again


def _gaps(places: str) -> np.ndarray:
    values = chest().astype(np.float32)
    if places == "few":
        values[4, 8, 8] = np.nan
        values[5, 8, 8], values[5, 8, 9] = np.inf, -np.inf
    elif places == "lung":
        values[4:6][values[4:6] == -860] = np.nan
    elif places == "round":
        values[:, :AIR] = values[:, -AIR:] = np.nan
    else:
        values[...] = np.nan
    return values


def _few_voxels() -> np.ndarray:
    values = chest()
    values[4, 8, 8], values[5, 8, 8], values[5, 8, 9] = -1000, 1200, -1000
    return values


def _lost_lung() -> np.ndarray:
    values = chest()
    values[4:6][values[4:6] == -860] = -1000
    return values


def _nifti2(folder: Path) -> Path:
    header = bytearray(544)
    struct.pack_into("<i", header, 0, 540)
    header[4:12] = b"n+2\0\r\n\x1a\n"
    (folder / "ct.nii").write_bytes(bytes(header) + chest().tobytes())
    return folder / "ct.nii"


def _straight(scale: float = 1.0) -> np.ndarray:
    matrix = np.diag([0.7 * scale, 0.9 * scale, 1.25 * scale, 1.0])
    matrix[:3, 3] = np.array([-31.5, 12.25, 140.0]) * scale
    return matrix


def _ras(lines: list[str]) -> None:
    matrix = np.diag([-1.0, -1.0, 1.0, 1.0]) @ LPS_FROM_IJK
    at = next(n for n, line in enumerate(lines) if line.startswith("space directions"))
    lines[at] = "space directions: " + " ".join(f"({','.join(map(repr, matrix[:3, a].tolist()))})" for a in range(3))
    _lines(
        ("space: ", "space: right-anterior-superior"),
        ("space origin", f"space origin: ({','.join(map(repr, matrix[:3, 3].tolist()))})"),
    )(lines)


def _skewed(degrees: float) -> np.ndarray:
    """Return ``lps_from_ijk`` of the grid with its second axis rotated by an angle towards the first axis."""
    matrix = LPS_FROM_IJK.copy()
    angle = np.radians(degrees)
    first, second = (matrix[:3, axis] / np.linalg.norm(matrix[:3, axis]) for axis in (0, 1))
    matrix[:3, 1] = np.linalg.norm(matrix[:3, 1]) * (np.sin(angle) * first + np.cos(angle) * second)
    return matrix


def _pixdim(axis: int, value: float) -> Make:
    """Return a function that writes a NIfTI file with a qform and no sform, and with one changed number of pixdim."""
    return _edited(
        lambda folder: with_qform(folder, LPS_FROM_IJK), lambda data: struct.pack_into("<f", data, 76 + 4 * axis, value)
    )


def _packed(make: Make, pack: Callable[[bytes], bytes] = gzip.compress) -> Make:
    """Return a function that writes a file which is compressed as a whole but has no suffix ``.gz``."""

    def again(folder: Path) -> Path:
        path = make(folder)
        path.write_bytes(pack(path.read_bytes()))
        return path

    return again


def _named(make: Make, name: bytes) -> Make:
    return lambda folder: make(folder).rename(folder / os.fsdecode(name))


_FLOATS = chest().astype(np.float32)
_STORED = (chest().astype(np.int32) + 1024).astype(np.uint16)
_HALVES = (chest() * 2).astype(np.int16)
_EIGHTS = (chest() * 8).astype(np.int16)
_N, _R, _M, _G = "NIfTI", "NRRD", "MetaImage", "Values that are not finite numbers"
_L, _A, _Z, _V, _B = (
    "Grids: left and right",
    "Grids: almost right angles",
    "Grids: compressed files",
    "Grids: values of text headers",
    "Grids: names of files",
)
_HEADER = "Correct the header, or export the file again."
_UNPACK = "Decompress the file and open the result."
_NOT3D = "Save each volume as a separate file."
_COPY = "Copy the file again."
_WHOLE = "Check that the file contains the whole scan."
_SIDES = "Check left and right by the heart and the liver, or open the DICOM series."
_VOXELS = "Check these voxels before you trust a measure near them."
_SPACING = "Export the file again with its spacing in mm."
_SKEWED = "Resample the file to a rectangular grid first."

INPUTS: tuple[Input, ...] = (
    Input("a single file", _N, _form("nifti"), "opens", voxels=_same),
    Input("a single file, compressed with gzip", _N, _form("nifti gzip"), "opens", voxels=_same),
    Input("compressed with bgzip, in many members", _N, _form("nifti bgzip"), "opens", voxels=_same),
    Input("compressed with gzip, followed by zeros up to the next block", _N,
          _gzipped(lambda p: p + bytes(300)), "opens", voxels=_same),
    Input("a pair of .hdr and .img, values from byte 0", _N, _form("nifti pair"), "opens", voxels=_same),
    Input("big endian", _N, _form("nifti", ">i2"), "opens", voxels=_same),
    Input("64-bit floats, big endian", _N, _form("nifti", ">f8"), "opens", voxels=_same),
    Input("64-bit integers", _N, _form("nifti", "<i8"), "opens", voxels=_same),
    Input("unsigned values with an intercept of -1024", _N, _nifti(_STORED, scale=(1, -1024)), "opens",
          voxels=_same),
    Input("slope 0.5", _N, _nifti(_HALVES, scale=(0.5, 0)), "opens", voxels=_same),
    Input("slope 0.125: fractional values, rounded to whole HU", _N, _nifti(_EIGHTS, scale=(0.125, 0.25)), "opens",
          voxels=_same),
    Input("slope 0: neither slope nor intercept (-1024) is applied", _N,
          _nifti(scale=(0, -1024)), "opens", voxels=_same),
    Input("slope NaN", _N, _nifti(scale=(np.nan, 5)), "opens", ("import.scaling",), voxels=_same,
          do=f"Compare a known tissue with its HU. {AGAIN}"),
    Input("intercept NaN", _N, _nifti(scale=(1, np.nan)), "import.header.scaling", do=AGAIN),
    Input("in metres, declared as metres", _N, _nifti(lps_from_ijk=_straight(1e-3), units=1), "opens", voxels=_same),
    Input("in micrometres, declared as micrometres", _N,
          _nifti(lps_from_ijk=_straight(1e3), units=3), "opens", voxels=_same),
    Input("in metres, declared as millimetres", _N, _nifti(lps_from_ijk=_straight(1e-3)), "import.geometry.spacing",
          do=_SPACING),
    Input("voxels 125 mm apart", _N, _nifti(lps_from_ijk=_straight(100)), "import.geometry.spacing",
          do=_SPACING),
    Input("four axes, one time point", _N, _nifti(dim=(24, 20, 12, 1)), "opens", voxels=_same),
    Input("four axes, two time points", _N, _nifti(np.concatenate([chest(), chest()]), dim=(24, 20, 12, 2)),
          "import.not-3d", do=_NOT3D),
    Input("qform only, left-handed by its qfac", _N,
          _nifti(lps_from_ijk=np.diag([-1.0, -1.0, -1.0, 1.0]) @ np.diag([0.7, 0.9, 1.25, 1.0]), forms=(1, 0), qfac=-1),
          "opens", voxels=_same),
    Input("qform and sform with different positions", _N, _nifti(forms=(1, 1)), "import.geometry.ambiguous",
          do="Save the file again with only one of the two positions."),
    Input("neither qform nor sform", _N, _nifti(forms=(0, 0)), "import.geometry.orientation-unknown", do=SLICER),
    Input("Analyze 7.5", _N, _nifti(magic=b"\0\0\0\0"), "import.geometry.orientation-unknown", do=SLICER),
    Input("values from byte 0 of a single file", _N, _nifti(offset=0), "import.header.offset", do=AGAIN),
    Input("values from byte 348 of a single file", _N, _nifti(offset=348), "import.header.offset", do=AGAIN),
    Input("values from byte 352.5", _N, _nifti(offset=352.5), "import.header.offset", do=AGAIN),
    Input("values from byte 1024, after an extension", _N, _nifti(offset=1024), "opens", voxels=_same),
    Input("NIfTI-2", _N, _nifti2, "import.not-supported", do="Save the file as NIfTI-1, for example from 3D Slicer."),
    Input("colour", _N, _nifti(datatype=128, bits=24), "import.not-supported",
          do="Export the file again as 16-bit grey values."),
    Input("16 bits according to datatype, 32 according to bitpix", _N, _nifti(bits=32), "import.header", do=AGAIN),
    Input("an axis of -12 voxels", _N, _nifti(dim=(24, 20, -12)), "import.header", do=AGAIN),
    Input("compressed with gzip and truncated", _N, _gzipped(lambda p: p[: len(p) // 2]), "import.truncated",
          do=_COPY),
    Input("compressed with gzip, truncated in its checksum", _N, _gzipped(lambda p: p[:-3]), "import.truncated",
          do=_COPY),
    Input("compressed with gzip, one bit changed", _N,
          _gzipped(lambda p: p[:200] + bytes([p[200] ^ 4]) + p[201:]), "import.truncated", do=_COPY),
    Input("compressed with gzip, followed by other bytes", _N, _gzipped(lambda p: p + b"and more"), "opens",
          ("import.extra-data",), voxels=_same, do=f"{_WHOLE} {_COPY}"),
    Input("twice as many bytes as the header states", _N, _nifti(behind=chest().tobytes()), "opens",
          ("import.extra-data",), voxels=_same, do=f"{_WHOLE} {AGAIN}"),
    Input("an attached header, raw", _R, _form("nrrd"), "opens", voxels=_same),
    Input("compressed with gzip", _R, _form("nrrd gzip"), "opens", voxels=_same),
    Input("compressed with bgzip, in many members", _R, _nrrd(encoding="gzip", pack=bgzip), "opens", voxels=_same),
    Input("compressed, after bytes that readers skip", _R,
          _nrrd(encoding="gzip", pack=lambda data: gzip.compress(bytes(7) + data), edit=_lines(("", "byte skip: 7"))),
          "opens", voxels=_same),
    Input("a detached header", _R, _form("nrrd detached"), "opens", voxels=_same),
    Input("big endian floats", _R, _form("nrrd", ">f4"), "opens", voxels=_same),
    Input("right-anterior-superior", _R, _nrrd(edit=_ras), "opens", voxels=_same),
    Input("left-handed directions", _R, _nrrd(lps_from_ijk=np.diag([1.0, 1.0, -1.0, 1.0]) @ LPS_FROM_IJK), "opens",
          voxels=_same),
    Input("lines with Windows line ends (CR LF)", _R, _nrrd(newline="\r\n"), "opens", voxels=_same),
    Input("compressed with bzip2", _R, _nrrd(encoding="bzip2", pack=bz2.compress), "import.not-supported",
          do="Save the file again with gzip, or without compression."),
    Input("values as text", _R, _nrrd(encoding="ascii"), "import.not-supported",
          do="Save the file again as 16-bit values, raw or gzip."),
    Input("spacings without directions", _R,
          _nrrd(edit=_lines(("space: ", ""), ("space directions", "spacings: 0.7 0.9 1.25"), ("space origin", ""))),
          "import.geometry.orientation-unknown", do=SLICER),
    Input("directions in a space without left and right", _R, _nrrd(edit=_lines(("space: ", "space: scanner-xyz"))),
          "import.geometry.orientation-unknown", do=SLICER),
    Input("a list of 2D images instead of a volume", _R,
          _nrrd(edit=_lines(("space directions", "space directions: none (0.7,0,0) (0,0.9,0)"))), "import.not-3d",
          do=_NOT3D),
    Input("a field twice, with two values", _R,
          _nrrd(edit=_lines(("", "space origin: (0,0,0)"))), "import.header.twice", do=AGAIN),
    Input("16-bit values without a byte order", _R, _nrrd(edit=_lines(("endian", ""))), "import.header", do=AGAIN),
    Input("values in another folder", _R, _nrrd(detached="../ct.raw"), "import.elsewhere",
          do="Save the scan again, with both files in one folder."),
    Input("in micrometres", _R, _nrrd(edit=_lines(("", 'space units: "um" "um" "um"'))), "import.not-supported",
          do="Save the file again in mm."),
    Input("a byte order mark before the header", _R, _nrrd(begin=b"\xef\xbb\xbf"), "import.not-an-image", do=AGAIN),
    Input("one file, raw", _M, _form("metaimage"), "opens", voxels=_same),
    Input("one file, compressed", _M, _form("metaimage compressed"), "opens", voxels=_same),
    Input("a detached header", _M, _form("metaimage detached"), "opens", voxels=_same),
    Input("most significant byte first", _M, _form("metaimage", ">i2"), "opens", voxels=_same),
    Input("64-bit floats, compressed", _M, _form("metaimage compressed", "<f8"), "opens", voxels=_same),
    Input("lines with Windows line ends (CR LF)", _M, _meta(newline="\r\n"), "opens", voxels=_same),
    Input("both byte orders declared", _M, _meta(edit=_lines(("", "ElementByteOrderMSB = True"))), "import.header",
          do=AGAIN),
    Input("axes that are not at right angles", _M,
          _meta(edit=_lines(("TransformMatrix", "TransformMatrix = 1 0 0 0 1 0 0 0.3 0.954"))),
          "import.geometry.sheared", do=_SKEWED),
    Input("directions that are not of length 1", _M,
          _meta(edit=_lines(("TransformMatrix", "TransformMatrix = 2 0 0 0 2 0 0 0 2"))),
          "import.geometry.ambiguous", do="Export the file again with its spacing in ElementSpacing."),
    Input("two origins", _M, _meta(edit=_lines(("", "Position = 1 2 3"))), "import.geometry.ambiguous", do=AGAIN),
    Input("an origin twice", _M, _meta(edit=_lines(("", "Offset = 1 2 3"))), "import.header.twice", do=AGAIN),
    Input("values with a scaling function", _M, _meta(edit=_lines(("", "ElementToIntensityFunctionSlope = 2"))),
          "import.not-supported", do="Save the file again with its final values."),
    Input("values as text", _M, _meta(edit=_lines(("BinaryData ", "BinaryData = False"))), "import.not-supported",
          do="Save the file again in binary form."),
    Input("values in several files", _M, _meta(data_file="LIST"), "import.not-supported",
          do="Save the file again as one file."),
    Input("no TransformMatrix", _M, _meta(edit=_lines(("TransformMatrix", ""))), "opens",
          ("import.orientation-doubted",), voxels=_same, do=_SIDES),
    Input("an AnatomicalOrientation that contradicts the directions", _M,
          _meta(edit=_lines(("TransformMatrix", "TransformMatrix = 1 0 0 0 1 0 0 0 1"),
                            ("", "AnatomicalOrientation = LAI"))), "opens",
          ("import.orientation-doubted",), voxels=_same, do=_SIDES),
    Input("an AnatomicalOrientation that agrees with the directions", _M,
          _meta(edit=_lines(("TransformMatrix", "TransformMatrix = -1 0 0 0 1 0 0 0 -1"),
                            ("", "AnatomicalOrientation = LAS"))), "opens", voxels=_same),
    Input("no Offset", _M, _meta(edit=_lines(("Offset", ""))), "opens", ("import.position-missing",), voxels=_same,
          do="Save the scan again with its position before you import masks or targets."),
    Input("CompressedData that is neither true nor false", _M,
          _meta(edit=_lines(("CompressedData", "CompressedData = maybe"))), "import.header", do=AGAIN),
    Input("TransformMatrix before NDims", _M,
          _meta(edit=lambda lines: lines.insert(1, lines.pop(5))), "import.header.disagree", do=AGAIN),
    Input("a HeaderSize that contradicts the header", _M, _meta(edit=_lines(("", "HeaderSize = 8"))), "import.header",
          do=AGAIN),
    Input("a few NaN and infinities, NIfTI", _G, _nifti(_gaps("few")), "opens", ("import.not-numbers",),
          voxels=_few_voxels, do=_VOXELS),
    Input("a few NaN and infinities, NRRD", _G, _nrrd(_gaps("few")), "opens", ("import.not-numbers",),
          voxels=_few_voxels, do=_VOXELS),
    Input("a few NaN and infinities, MetaImage", _G, _meta(_gaps("few"), compressed=True), "opens",
          ("import.not-numbers",), voxels=_few_voxels, do=_VOXELS),
    Input("NaN in a tenth of the lung", _G, _nifti(_gaps("lung")), "opens", ("import.not-numbers",), is_hu=False,
          voxels=_lost_lung, do=f"{AGAIN} Voxels that software has masked out are lost."),
    Input("NaN round the patient", _G, _nifti(_gaps("round")), "opens", ("import.not-numbers",), voxels=_same),
    Input("pixdim[1] negative, qform only", _L, _pixdim(1, -0.7), "import.geometry.ambiguous", do=SLICER),
    Input("pixdim[2] negative, qform only", _L, _pixdim(2, -0.9), "import.geometry.ambiguous", do=SLICER),
    Input("pixdim[3] negative, qform only", _L, _pixdim(3, -1.25), "import.geometry.ambiguous", do=SLICER),
    Input("pixdim[1] negative, sform only", _L,
          _edited(_nifti(), lambda data: struct.pack_into("<f", data, 80, -0.7)), "import.geometry.ambiguous",
          do=SLICER),
    Input("qfac (pixdim[0]) -2, qform only", _L, _pixdim(0, -2), "import.geometry.ambiguous", do=SLICER),
    Input("qfac (pixdim[0]) 0, qform only", _L, _pixdim(0, 0), "opens", voxels=_same),
    Input("a negative ElementSpacing", _L, _meta(edit=_lines(("ElementSpacing", "ElementSpacing = -0.7 0.9 1.25"))),
          "import.geometry.spacing", do=_SPACING),
    Input("NIfTI, axes 0.02 degrees off", _A, _nifti(lps_from_ijk=_skewed(0.02)), "opens", voxels=_same),
    Input("NIfTI, axes 0.17 degrees off", _A, _nifti(lps_from_ijk=_skewed(0.17)), "opens", voxels=_same),
    Input("NIfTI, axes 0.17 degrees off, the nearest rotation as qform", _A,
          lambda folder: with_both_forms(folder, _skewed(0.17), nearest_rotation(_skewed(0.17))), "opens",
          voxels=_same),
    Input("NRRD, axes 0.17 degrees off", _A, _nrrd(lps_from_ijk=_skewed(0.17)), "opens", voxels=_same),
    Input("NIfTI, axes 0.7 degrees off", _A, _nifti(lps_from_ijk=_skewed(0.7)), "import.geometry.sheared",
          do=_SKEWED),
    Input("NRRD, axes 0.7 degrees off", _A, _nrrd(lps_from_ijk=_skewed(0.7)), "import.geometry.sheared",
          do=_SKEWED),
    Input("a NIfTI file compressed with gzip and named .nii", _Z, _packed(_nifti()), "opens", voxels=_same),
    Input("an NRRD file compressed with gzip as a whole", _Z, _packed(_nrrd()), "opens", voxels=_same),
    Input("an NRRD file with compressed values, compressed again as a whole", _Z, _packed(_form("nrrd gzip")), "opens",
          voxels=_same),
    Input("a compressed MetaImage file, compressed with gzip as a whole", _Z,
          _packed(_form("metaimage compressed")), "opens", voxels=_same),
    Input("compressed twice with gzip", _Z, _packed(_packed(_nifti())), "import.not-an-image", do=_UNPACK),
    Input("compressed with bzip2", _Z, _packed(_nifti(), bz2.compress), "import.not-an-image", do=_UNPACK),
    Input("MetaImage, decimal commas", _V, _meta(edit=_lines(("ElementSpacing", "ElementSpacing = 0,7 0,9 1,25"))),
          "import.header", do=_HEADER, names=("'0,7 0,9 1,25'", "a comma is not accepted")),
    Input("NRRD, decimal commas", _V, _nrrd(edit=_lines(("space origin", "space origin: (-31,5,12,25,140,0)"))),
          "import.header", do=_HEADER, names=("'(-31,5,12,25,140,0)'", "a comma is not accepted")),
    Input("a header value of 10 kB", _V, _nrrd(edit=_lines(("space: ", "space: " + "x" * 10_000))),
          "import.geometry.orientation-unknown", do=SLICER, names=("(10000 characters)",)),
    Input("a comment of 10 kB", _V, _meta(edit=lambda lines: lines.insert(5, "Comment = " + "x " * 5_000)), "opens",
          voxels=_same),
    Input("a name that is not UTF-8", _B, _named(_nifti(), b"l\xe9.nii"), "opens", voxels=_same),
    Input("a name with a line break", _B, _named(_nrrd(), b"a\nb.nrrd"), "opens", voxels=_same),
    Input("only NaN", _G, _nifti(_gaps("all")), "import.no-numbers", do=AGAIN),
)  # fmt: skip
