"""Opening of DICOM series beside SimpleITK, pydicom and dcm2niix, for each transfer syntax.

All programs open the same files, alternately. CPU time includes that of the processes that a program starts.
"""

from __future__ import annotations

import importlib
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydicom import dcmread
from pydicom.uid import (
    DeflatedExplicitVRLittleEndian,
    ExplicitVRBigEndian,
    ImplicitVRLittleEndian,
    JPEGLSLossless,
    RLELossless,
)

from carina.cli.console import print_note
from carina.phantom import generate_phantom
from carina.volume import open_volume
from carina_bench.alternating_timer import Times, median_ratio, take_turns
from carina_bench.written_series import BOX_LPS, write_slices

__all__ = ["SYNTAXES", "measure", "words"]

SYNTAXES = (
    "explicit little endian",
    "implicit little endian",
    "big endian",
    "deflated",
    "RLE",
    "JPEG-LS",
    "lossless JPEG",
    "lossless JPEG 2000",
)
_UNPACKED = {
    "implicit little endian": ImplicitVRLittleEndian,
    "big endian": ExplicitVRBigEndian,
    "deflated": DeflatedExplicitVRLittleEndian,
}
_PACKED = {"RLE": RLELossless, "JPEG-LS": JPEGLSLossless}
_BY_ITK = {"lossless JPEG": "JPEG", "lossless JPEG 2000": "JPEG2000"}


def measure(request: dict[str, Any]) -> dict[str, Any]:
    """Measure all programs in each transfer syntax; the values of each program are compared with those of Carina."""
    volume = generate_phantom(spacing_mm=request["spacing_mm"], box_lps=BOX_LPS).volume
    rows = {}
    with tempfile.TemporaryDirectory(prefix="carina-bench-") as scratch:
        plain = write_slices(volume, Path(scratch) / "plain")
        for syntax in request["syntaxes"]:
            print_note(f"opening {syntax}")
            folder = plain
            if syntax != SYNTAXES[0]:
                folder = Path(scratch) / syntax.replace(" ", "-")
                if syntax in _UNPACKED:
                    write_slices(volume, folder, _UNPACKED[syntax])
                else:
                    _pack(plain, folder, syntax)
            rows[syntax] = _row(folder, request["repeats"])
            if folder != plain:
                shutil.rmtree(folder)  # each takes up to 320 MB
    return {"shape_zyx": list(volume.shape_zyx), "rows": rows}


def _row(folder: Path, repeats: int) -> dict[str, Any]:
    expected = open_volume(folder).hu_zyx
    functions: dict[str, Callable[[], object]] = {"Carina": lambda: open_volume(folder)}
    left_out = {}
    for name, program in {"SimpleITK": _by_simpleitk, "pydicom": _by_pydicom, "dcm2niix": _by_dcm2niix}.items():
        try:
            found = program(folder)
        except Exception as error:
            left_out[name] = f"{type(error).__name__}: {error}"[:120]
            continue
        if found is not None and not np.array_equal(np.rint(found), expected):
            left_out[name] = "reads other values"
            continue
        functions[name] = lambda program=program: program(folder)  # type: ignore[misc]
    times = take_turns(functions, repeats)
    return {
        "cpu_and_wall_ms": {name: taken.to_json() for name, taken in times.items()},
        "cpu_over_carina": {name: round(median_ratio(taken, times["Carina"]), 2) for name, taken in times.items()},
        "wall_over_carina": {name: round(_wall_ratio(taken, times["Carina"]), 2) for name, taken in times.items()},
        "left_out": left_out,
    }


def _wall_ratio(one: Times, other: Times) -> float:
    return float(np.median([a / b for a, b in zip(one.wall_ms, other.wall_ms, strict=True)]))


def _by_simpleitk(folder: Path) -> NDArray[Any]:
    sitk: Any = importlib.import_module("SimpleITK")
    reader = sitk.ImageSeriesReader()
    reader.SetFileNames(reader.GetGDCMSeriesFileNames(str(folder)))
    values: NDArray[Any] = sitk.GetArrayFromImage(reader.Execute())
    return values


def _by_pydicom(folder: Path) -> NDArray[Any]:
    slices = sorted((dcmread(path) for path in folder.iterdir()), key=lambda one: one.ImagePositionPatient[2])
    return np.stack([one.pixel_array * float(one.RescaleSlope) + float(one.RescaleIntercept) for one in slices])


def _by_dcm2niix(folder: Path) -> None:
    """Convert the series to NIfTI without compression; the file is not read again."""
    program = shutil.which("dcm2niix")
    if program is None:
        raise FileNotFoundError("dcm2niix is not installed")
    with tempfile.TemporaryDirectory(prefix="carina-bench-") as out:
        command = [program, "-b", "n", "-z", "n", "-f", "ct", "-o", out, str(folder)]
        subprocess.run(command, check=True, capture_output=True)
        if not list(Path(out).glob("*.nii")):
            raise ValueError("wrote no file")


def _pack(plain: Path, folder: Path, syntax: str) -> None:
    folder.mkdir()
    for path in sorted(plain.iterdir()):
        if syntax in _BY_ITK:
            _write_by_itk(path, folder / path.name, _BY_ITK[syntax])
            continue
        dataset = dcmread(path)
        dataset.compress(_PACKED[syntax])
        dataset.save_as(folder / path.name, enforce_file_format=True)


def _write_by_itk(source: Path, path: Path, compressor: str) -> None:
    """Write a slice with the tags of the original and pixels that ITK has compressed."""
    sitk: Any = importlib.import_module("SimpleITK")
    packed = path.with_suffix(".packed.dcm")
    dataset = dcmread(source)
    writer = sitk.ImageFileWriter()
    writer.SetImageIO("GDCMImageIO")
    writer.SetFileName(str(packed))
    writer.UseCompressionOn()
    writer.SetCompressor(compressor)
    writer.Execute(sitk.GetImageFromArray(dataset.pixel_array[None].astype(np.int16)))
    found = dcmread(packed)
    packed.unlink()
    dataset.file_meta.TransferSyntaxUID = found.file_meta.TransferSyntaxUID
    for keyword in ("BitsAllocated", "BitsStored", "HighBit", "PixelRepresentation"):
        setattr(dataset, keyword, getattr(found, keyword))
    dataset.PixelData = found.PixelData
    dataset["PixelData"].VR = "OB"
    dataset["PixelData"].is_undefined_length = True
    dataset.save_as(path, enforce_file_format=True)


def words(row: dict[str, Any]) -> list[str]:
    """Return the lines of the report."""
    nz, ny, nx = row["shape_zyx"]
    lines = [f"{nx} x {ny} x {nz} beside other programs: CPU time in ms, and CPU and wall time over Carina's"]
    for syntax, one in row["rows"].items():
        for name, taken in one["cpu_and_wall_ms"].items():
            ratios = f"{one['cpu_over_carina'][name]:8.2f} {one['wall_over_carina'][name]:8.2f}"
            lines.append(f"  {syntax:24} {name:10} {taken['median']:8.0f} {ratios}")
        lines += [f"  {syntax:24} {name:10} left out: {why}" for name, why in one["left_out"].items()]
    return lines
