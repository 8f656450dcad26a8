"""Readers that share no code with Carina, as references for the voxels and positions of an opened scan.

Each reader returns the blocks that it finds: voxel values and the transform from voxel centres to LPS mm. A folder may
contain other images beside the opened series; their blocks have no place in its grid and are ignored.
"""

from __future__ import annotations

import contextlib
import gzip
import importlib
import importlib.util
import os
import shutil
import subprocess
import tarfile
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import nibabel
import nrrd
import numpy as np
import pydicom
import SimpleITK as sitk
from pydicom.dataset import Dataset

from carina.volume import Volume

__all__ = ["DCM2NIIX", "DICOM_ONLY", "NO_READER", "READERS", "Block", "compared", "missing_program"]

TOLERANCE_MM = 1e-3
"""Maximum distance of positions that two readers may give; headers with float32 cause about 1e-4 mm."""
DCM2NIIX = shutil.which("dcm2niix")
"""Path of the program dcm2niix (Debian package of the same name); None if it is not installed."""
NO_READER, DICOM_ONLY = "has no reader of this format", "reads DICOM only"
"""Texts with which other programs report formats that they do not know."""
_RAS_TO_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])


class CannotReadError(Exception):
    """Reason why a reader returns no voxels of an input."""


@dataclass(frozen=True)
class Block:
    """Voxels of one file or frame."""

    values_zyx: np.ndarray
    lps_from_ijk: np.ndarray


def by_pydicom(path: Path) -> Iterator[Block]:
    """Yield each slice and frame, by pydicom's pixels and the tags of PS3.3 C.7.6.2.1.1, C.7.6.16.2 and C.11.1."""
    for data in _datasets(path):
        # Several files have tags with invalid texts; pydicom reads the others.
        with contextlib.suppress(Exception):
            pixels = data.pixel_array.astype(np.float64)
            frames = pixels if pixels.ndim == 3 else pixels[None]
            shared = _items(data, "SharedFunctionalGroupsSequence", 1)
            own = _items(data, "PerFrameFunctionalGroupsSequence", len(frames))
            for values, group in zip(frames, own, strict=True):
                tags = _Tags(group, shared[0], data)
                row, column = np.reshape(np.array(tags["ImageOrientationPatient"], float), (2, 3))
                matrix = np.eye(4)
                matrix[:3, 0] = row * float(tags["PixelSpacing"][1])
                matrix[:3, 1] = column * float(tags["PixelSpacing"][0])
                matrix[:3, 2] = np.cross(row, column)
                matrix[:3, 3] = np.array(tags["ImagePositionPatient"], float)
                hu = values * float(tags.get("RescaleSlope") or 1) + float(tags.get("RescaleIntercept") or 0)
                yield Block(hu[None], matrix)


def by_simpleitk(path: Path) -> Iterator[Block]:
    """Yield each file that ITK reads."""
    files = [path]
    if path.is_dir():
        files = [one for one in sorted(path.rglob("*")) if _is_dicom(one)]
    for file in files:
        if file.suffix == ".vti":
            raise CannotReadError(NO_READER)
        try:
            image = sitk.ReadImage(str(file))
        except RuntimeError:
            continue
        while image.GetDimension() > 3:
            image = image[(slice(None),) * 3 + (0,)]
        if image.GetDimension() == 3 and image.GetNumberOfComponentsPerPixel() == 1:
            matrix = np.eye(4)
            matrix[:3, :3] = np.reshape(image.GetDirection(), (3, 3)) * image.GetSpacing()
            matrix[:3, 3] = image.GetOrigin()
            yield Block(sitk.GetArrayFromImage(image).astype(np.float64), matrix)


def by_nibabel(path: Path) -> Iterator[Block]:
    """Yield the image of a NIfTI file, or of a pair of a header and its values."""
    if not path.name.lower().endswith((".nii", ".nii.gz", ".hdr")):
        raise CannotReadError(NO_READER)
    kind = nibabel.Nifti1Pair if path.suffix == ".hdr" else nibabel.Nifti1Image
    yield _nifti_block(kind.from_filename(str(path)))


def by_pynrrd(path: Path) -> Iterator[Block]:
    """Yield the image of an NRRD file."""
    if not path.name.lower().endswith((".nrrd", ".nhdr")):
        raise CannotReadError(NO_READER)
    values, header = nrrd.read(str(path))
    matrix = np.eye(4)
    matrix[:3, :3] = np.asarray(header["space directions"], float).T
    matrix[:3, 3] = header["space origin"]
    sign = {"left-posterior-superior": 1, "right-anterior-superior": -1}[header["space"]]
    yield Block(values.transpose(2, 1, 0).astype(np.float64), np.diag([sign, sign, 1.0, 1.0]) @ matrix)


def by_vtk(path: Path) -> Iterator[Block]:
    """Yield the image of a VTI file. VTK reads MetaImage files, too, but without their directions."""
    if not path.name.lower().endswith(".vti"):
        raise CannotReadError(NO_READER)
    convert = importlib.import_module("vtkmodules.util.numpy_support").vtk_to_numpy
    reader = importlib.import_module("vtkmodules.vtkIOXML").vtkXMLImageDataReader()
    reader.SetFileName(str(path))
    reader.Update()
    image = reader.GetOutput()
    extent = image.GetExtent()
    shape = [extent[2 * axis + 1] - extent[2 * axis] + 1 for axis in (2, 1, 0)]
    matrix = np.eye(4)
    turn = image.GetDirectionMatrix()
    matrix[:3, :3] = np.array([[turn.GetElement(r, c) for c in range(3)] for r in range(3)]) * image.GetSpacing()
    matrix[:3, 3] = np.array(image.GetOrigin()) + matrix[:3, :3] @ extent[::2]
    yield Block(convert(image.GetPointData().GetScalars()).reshape(shape).astype(np.float64), matrix)


def by_dcm2niix(path: Path) -> Iterator[Block]:
    """Yield each image to which dcm2niix converts a folder."""
    assert DCM2NIIX is not None
    if not path.is_dir():
        raise CannotReadError(DICOM_ONLY)
    out = path.parent / f"{path.name}-nifti"
    out.mkdir(exist_ok=True)
    command = [DCM2NIIX, "-b", "n", "-z", "n", "-f", "%s_%t_%j", "-d", "9", "-o", str(out), str(path)]
    subprocess.run(command, capture_output=True, timeout=60, check=False)
    for file in sorted(out.glob("*.nii")):
        yield _nifti_block(nibabel.Nifti1Image.from_filename(str(file)))


READERS: dict[str, Callable[[Path], Iterator[Block]]] = {
    "pydicom": by_pydicom,
    "SimpleITK": by_simpleitk,
    "nibabel": by_nibabel,
    "dcm2niix": by_dcm2niix,
    "pynrrd": by_pynrrd,
    "VTK": by_vtk,
}
HAS_VTK = importlib.util.find_spec("vtkmodules") is not None
"""Whether VTK is installed, which only benchmarks need (``make bench-setup``)."""


def missing_program(reader: str) -> str | None:
    """Return why a reader cannot run on this machine; None if it can."""
    if reader == "dcm2niix" and DCM2NIIX is None:
        return "dcm2niix is not installed (Debian package dcm2niix)"
    if reader == "VTK" and not HAS_VTK:
        return "VTK is not installed (make bench-setup)"
    return None


def unpacked(path: Path, folder: Path) -> Path:
    """Return the folder with the content of an archive and of archives in it, or a file under a plain name.

    A file that is compressed as a whole is decompressed, because most readers decide by the name whether to do so.
    """
    if path.is_dir() or not path.is_file():
        return path
    if path.read_bytes()[:2] == b"\x1f\x8b" and not tarfile.is_tarfile(path) and not path.name.endswith(".nii.gz"):
        folder.mkdir()
        plain = folder / path.name.removesuffix(".gz")
        plain.write_bytes(gzip.decompress(path.read_bytes()))
        return plain
    if not path.name.isprintable():
        folder.mkdir()
        return Path(shutil.copy(path, folder / f"ct{path.suffix}"))
    is_zip, is_tar = zipfile.is_zipfile(path), tarfile.is_tarfile(path)
    if is_zip or is_tar:
        folder.mkdir()
        if is_zip:
            with zipfile.ZipFile(path) as archive:
                archive.extractall(folder)
        else:
            with tarfile.open(path) as packed:
                packed.extractall(folder, filter="data")
        for one in list(folder.rglob("*.zip")):
            unpacked(one, one.with_name(f"{one.name}-content"))
        return folder
    return path.parent if _is_dicom(path) else path


def compared(reader: str, path: Path, volume: Volume, folder: Path) -> str:
    """Return "same" if a reader finds all measured voxels at their positions, or what it does instead.

    Parameters
    ----------
    reader
        Key of ``READERS``.
    path
        The input that Carina opened.
    volume
        The result of Carina.
    folder
        New folder for the content of an archive.
    """
    try:
        blocks = list(READERS[reader](unpacked(path, folder)))
    except CannotReadError as error:
        return str(error)
    except Exception as error:
        return f"fails: {type(error).__name__}"
    if not blocks:
        return "reads nothing"
    is_padded = any(note.code == "import.padding" for note in volume.source.notes)
    lowest = int(volume.hu_zyx.min())
    missing = set(range(volume.shape_zyx[0])) - set(volume.source.interpolated_slices)
    placed = set()
    for block in blocks:
        for k, plane in _planes_on(volume, block):
            placed.add(k)
            # Padding was set to air, the lowest value; other readers return the stored value there.
            own = volume.hu_zyx[k]
            inside = own > lowest if is_padded else np.ones(own.shape, dtype=bool)
            # A reader may return undefined memory, which may contain NaN: such a plane differs.
            with np.errstate(invalid="ignore"):
                is_same = bool((np.abs(np.rint(plane) - own)[inside] <= 1.0).all())
            if is_same:
                missing.discard(k)
    if not missing:
        return "same"
    return "reads other values" if missing <= placed else "reads other positions"


def _planes_on(volume: Volume, block: Block) -> Iterator[tuple[int, np.ndarray]]:
    """Yield the number and the values of each slice of the volume that a block contains, in the volume's order."""
    matrix = block.lps_from_ijk.copy()
    if len(block.values_zyx) == 1:
        # The third axis of a single slice is arbitrary.
        normal = np.cross(matrix[:3, 0], matrix[:3, 1])
        matrix[:3, 2] = normal / np.linalg.norm(normal) * np.linalg.norm(volume.lps_from_ijk[:3, 2])
    local = volume.ijk_from_lps @ matrix
    turn = np.rint(local[:3, :3])
    if not np.array_equal(np.abs(turn).sum(axis=0), [1, 1, 1]) or abs(round(np.linalg.det(turn))) != 1:
        return
    sizes = np.array(block.values_zyx.shape[::-1])
    first = np.rint(local[:3, 3])
    corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) * (sizes - 1)
    there = corners @ matrix[:3, :3].T + matrix[:3, 3]
    here = volume.to_lps(corners @ turn.T + first)
    if np.linalg.norm(there - here, axis=1).max() > TOLERANCE_MM:
        return
    order = [int(np.flatnonzero(turn[axis])[0]) for axis in range(3)]
    values = block.values_zyx.transpose(2, 1, 0).transpose(order)
    flips = tuple(slice(None, None, int(turn[axis].sum())) for axis in range(3))
    values = values[flips]
    low = np.minimum(first, first + turn @ (sizes - 1)).astype(int)
    if tuple(low[:2]) != (0, 0) or values.shape[:2] != volume.shape_zyx[:0:-1]:
        return
    for at in range(values.shape[2]):
        if 0 <= low[2] + at < volume.shape_zyx[0]:
            yield int(low[2]) + at, values[:, :, at].T


def _nifti_block(image: nibabel.Nifti1Image) -> Block:
    values = np.asarray(image.dataobj, dtype=np.float64)
    values = values.reshape(values.shape[:3]) if values[0, 0, 0].size == 1 else values[..., 0]
    return Block(values.transpose(2, 1, 0), _RAS_TO_LPS @ image.affine)


def _is_dicom(path: Path) -> bool:
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(132)[128:] == b"DICM"


def _datasets(path: Path) -> Iterator[Dataset]:
    if not path.is_dir():
        raise CannotReadError(DICOM_ONLY)
    for folder, _, names in os.walk(path):
        for name in names:
            file = Path(folder) / name
            if _is_dicom(file):
                yield pydicom.dcmread(file)


def _items(data: Dataset, keyword: str, count: int) -> list[Dataset]:
    return list(data[keyword].value) if keyword in data else [Dataset()] * count


class _Tags:
    """Values of a frame: from its functional groups, from the shared ones, or from the file."""

    def __init__(self, *groups: Dataset) -> None:
        self._groups = groups

    def __getitem__(self, keyword: str):
        for group in self._groups:
            for dataset in (
                group,
                *(sequence.value[0] for sequence in group if sequence.VR == "SQ" and sequence.value),
            ):
                if keyword in dataset:
                    return dataset[keyword].value
        raise KeyError(keyword)

    def get(self, keyword: str):
        try:
            return self[keyword]
        except KeyError:
            return None
