"""Function ``deidentify``: writes de-identified copies of the images of a folder, file or archive to a new folder."""

from __future__ import annotations

import io
import os
import secrets
import shutil
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import PYDICOM_IMPLEMENTATION_UID, UID, ExplicitVRLittleEndian

from carina.argument_checks import check_arguments, file_path, function, text_of
from carina.deidentification.burned_in_text import Box, burned_in_reason, cut_pixels, is_outside, mask_boxes
from carina.deidentification.profile_actions import clean_dataset
from carina.deidentification.pseudonyms import Pseudonyms
from carina.disk import create_folders, disk_trouble, sync_folder
from carina.display import one_line
from carina.display.progress import ProgressChoice, progress_function, shows_progress
from carina.errors import UsageError, VolumeImportError
from carina.volume.dicom_files import files_below
from carina.volume.dicom_headers import read_dataset
from carina.volume.dicom_signature import looks_like_dicom
from carina.volume.io_errors import guarded
from carina.volume.opening import check_exists
from carina.volume.progress import Watch
from carina.volume.scan_place import scan_place

__all__ = ["DeidentifiedImages", "deidentify"]

_MAX_BOXES = 64
_OUTSIDE = "it may show text, and a rectangle to blacken is outside of it"
_PIXELS = ("PixelData", "FloatPixelData", "DoubleFloatPixelData")


@one_line
@dataclass(frozen=True, slots=True)
class DeidentifiedImages:
    """Numbers and notes of one run of :func:`deidentify`."""

    folder: Path
    """The new folder, with one subfolder for each series."""
    num_images: int
    """Number of written images."""
    num_series: int
    num_patients: int
    num_masked: int
    """Number of written images in which pixels with burnt-in text were masked."""
    refused: tuple[tuple[str, int], ...]
    """Reasons why images were not written, each with the number of images."""
    num_other_files: int
    """Number of files that were not copied because they are not DICOM images (reports, directories, documents)."""

    def to_json(self) -> dict[str, Any]:
        """Return the result as plain JSON types, as ``carina deidentify --json`` prints it."""
        return {
            "folder": str(self.folder),
            "num_images": self.num_images,
            "num_series": self.num_series,
            "num_patients": self.num_patients,
            "num_masked": self.num_masked,
            "refused": [{"reason": reason, "num_images": count} for reason, count in self.refused],
            "num_other_files": self.num_other_files,
        }


@shows_progress
@check_arguments(source=file_path(), folder=file_path(), alias=text_of(32), cancel=function)
def deidentify(
    source: str | Path,
    folder: str | Path,
    *,
    alias: str = "PATIENT",
    mask: Sequence[Box] = (),
    progress: ProgressChoice = None,
    cancel: Callable[[], bool] | None = None,
) -> DeidentifiedImages:
    """Write copies of DICOM images without identity to a new folder (PS3.15, basic confidentiality profile).

    Names, numbers, dates, institutions, free text, private attributes, overlays and everything unknown are removed in
    all sequences. UIDs are replaced consistently, so that series, studies and references fit together. Positions and
    pixels stay; compressed pixels are decompressed, because their streams may contain comments. The originals are not
    changed, and no file of the copy shows which original it was made from.

    Images whose pixels may show text (burned-in annotation, captured screens, ultrasound, dose tables) are not copied,
    unless ``mask`` covers the text.

    Parameters
    ----------
    source
        DICOM folder, file or archive; folders are searched with all their subfolders.
    folder
        Folder to create. It must not exist, and must be outside of the source.
    alias
        Name and ID of the patient in the copies; further patients get a number.
    mask
        Rectangles ``(x, y, width, height)`` in pixels that are blackened in images that may show text. Without
        rectangles these images are refused, as are those that do not contain every rectangle at least in part.
    progress
        False, True or ``f(what, fraction)``. True or None shows a progress bar in a terminal or a notebook. The
        fraction is None where it is unknown.
    cancel
        Called often; the work stops when it returns True, and nothing is left behind.

    Returns
    -------
    DeidentifiedImages
        Numbers of written and refused images.

    Raises
    ------
    VolumeImportError
        ``import.no-images``: the source has no DICOM images; ``deidentify.burned-in``: every image was refused.
    UsageError
        If the folder exists or is inside the source, or a rectangle is not one.
    DiskError
        If the folder cannot be written.
    CancelledError
        If ``cancel()`` returned true.

    Examples
    --------
    >>> import carina, pathlib
    >>> try:
    ...     carina.deidentify("scan", pathlib.Path.cwd())
    ... except carina.UsageError as error:
    ...     print(error.code)
    deidentify.folder
    """
    boxes = _checked_boxes(mask)
    target = Path(folder).expanduser().absolute()
    _check_target(Path(source).expanduser().absolute(), target)
    if not alias.isprintable() or set(alias) & set("\\^="):
        raise UsageError(f"deidentify: alias: expected a plain name without \\, ^ and =; found {alias!r}")
    watch = Watch(progress_function(progress), cancel)

    def run(path: Path) -> DeidentifiedImages:
        check_exists(path)
        with scan_place(path, watch) as place:
            return _Run(path, target, Pseudonyms(alias), boxes, watch).write(place.path)

    return guarded(Path(source).expanduser(), run)


def _checked_boxes(mask: Any) -> tuple[Box, ...]:
    try:
        boxes = [tuple(int(value) for value in box) for box in mask]
        fits = all(len(box) == 4 and min(box) >= 0 and box[2] > 0 and box[3] > 0 and max(box) <= 65535 for box in boxes)
    except (TypeError, ValueError, OverflowError):
        boxes, fits = [], False
    if not fits or len(boxes) > _MAX_BOXES:
        raise UsageError(
            f"deidentify: mask: expected at most {_MAX_BOXES} rectangles (x, y, width, height) in pixels, such as "
            "(0, 0, 512, 40)"
        )
    return tuple((x, y, width, height) for x, y, width, height in boxes)


def _check_target(source: Path, target: Path) -> None:
    if os.path.lexists(target):
        raise UsageError(
            f"deidentify: {target} exists; name a new folder, so that no file of it is mixed with the copies",
            code="deidentify.folder",
        )
    if target.resolve().is_relative_to(source.resolve()):
        raise UsageError(
            "deidentify: the new folder is inside the source; name a folder outside of it", code="deidentify.folder"
        )


class _Run:
    """The copies of one call; the folder appears under its name only when it is complete."""

    def __init__(self, path: Path, target: Path, names: Pseudonyms, boxes: tuple[Box, ...], watch: Watch) -> None:
        self._path = path
        self._target = target
        self._names = names
        self._boxes = boxes
        self._watch = watch
        self._series: dict[str, list[str]] = {}
        self._refused: Counter[str] = Counter()
        self._num_masked = 0
        self._num_others = 0

    def write(self, place: Path) -> DeidentifiedImages:
        """Write the copies of all images at a path."""
        files = list(files_below(place, watch=self._watch))
        draft = self._target.with_name(f".{self._target.name[:80]}.{secrets.token_hex(4)}.part")
        try:
            create_folders(draft, private=True)
            for index, path in enumerate(files):
                self._watch.step("De-identifying the images", index / len(files))
                self._copy(path, draft)
            num_images = sum(map(len, self._series.values()))
            if num_images == 0:
                raise self._nothing_written()
            draft.rename(self._target)
            sync_folder(self._target.parent)
        except OSError as error:
            if isinstance(error, VolumeImportError) or error.errno is None:
                raise
            raise disk_trouble(error, "cannot write the de-identified copy to", self._target) from None
        finally:
            shutil.rmtree(draft, ignore_errors=True)
        return DeidentifiedImages(
            self._target,
            num_images,
            len(self._series),
            self._names.num_patients,
            self._num_masked,
            tuple(self._refused.most_common()),
            self._num_others,
        )

    def _copy(self, path: Path, draft: Path) -> None:
        if not looks_like_dicom(path):
            self._num_others += 1
            return
        try:
            dataset = read_dataset(path, pixels=True)
            is_image = any(keyword in dataset for keyword in _PIXELS)
        except Exception:
            self._refused["the file is damaged"] += 1
            return
        if not is_image:
            self._num_others += 1
            return
        reason = burned_in_reason(dataset)
        if reason is not None and not self._boxes:
            self._refused[reason] += 1
            return
        try:
            if reason is not None and is_outside(dataset, self._boxes):
                self._refused[_OUTSIDE] += 1
                return
            _decompress(dataset)
            cut_pixels(dataset)
            _clear_overlay_bits(dataset)
            if reason is not None:
                mask_boxes(dataset, self._boxes)
            clean_dataset(dataset, self._names, masked=reason is not None)
        except Exception:
            self._refused["its pixels cannot be decoded"] += 1
            return
        try:
            content = _encoded(dataset)
        except Exception:
            self._refused["an attribute of its header is missing or damaged"] += 1
            return
        self._num_masked += reason is not None
        self._save(str(dataset.get("SeriesInstanceUID") or ""), content, draft)

    def _save(self, series: str, content: bytes, draft: Path) -> None:
        known = self._series.setdefault(series, [])
        number = list(self._series).index(series) + 1
        folder = draft / f"series-{number:03d}"
        folder.mkdir(exist_ok=True)
        known.append("")
        (folder / f"image-{len(known):05d}.dcm").write_bytes(content)

    def _nothing_written(self) -> VolumeImportError:
        if self._refused:
            reasons = "; ".join(f"{reason} ({count})" for reason, count in self._refused.most_common(3))
            masked = "blacken the text with a mask" if not self._boxes else "copy the files again"
            return VolumeImportError(
                f"de-identifying {self._path.name}: no image can be copied: {reasons}; {masked}, or choose the images "
                "of the scanner",
                code="deidentify.burned-in",
            )
        return VolumeImportError(
            f"de-identifying {self._path.name}: it contains no DICOM images; choose the folder of a DICOM scan",
            code="import.no-images",
        )


def _encoded(dataset: Dataset) -> bytes:
    """Return the bytes of a DICOM file (explicit VR, little endian) with the attributes of a de-identified data set."""
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID = UID(str(dataset.get("SOPClassUID") or ""))
    meta.MediaStorageSOPInstanceUID = UID(str(dataset.get("SOPInstanceUID") or ""))
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    meta.ImplementationClassUID = PYDICOM_IMPLEMENTATION_UID
    clean = Dataset(dataset)
    clean.file_meta = meta
    clean.preamble = bytes(128)
    buffer = io.BytesIO()
    clean.save_as(buffer, enforce_file_format=True)
    return buffer.getvalue()


def _decompress(dataset: Dataset) -> None:
    """Convert the pixels to uncompressed little-endian values."""
    syntax = dataset.file_meta.TransferSyntaxUID if "TransferSyntaxUID" in dataset.file_meta else None
    if syntax is None or "PixelData" not in dataset:
        return
    if syntax.is_compressed and syntax.is_encapsulated:
        dataset.decompress(as_rgb=False, generate_instance_uid=False)
    elif not syntax.is_little_endian:
        width = int(dataset.BitsAllocated) // 8
        if width > 1:
            dataset.PixelData = np.frombuffer(dataset.PixelData, f">u{width}").astype(f"<u{width}").tobytes()


def _clear_overlay_bits(dataset: Dataset) -> None:
    """Clear the bits in which old images store overlays, which may show text, above or below the bits of the pixels."""
    if "PixelData" not in dataset:
        return
    allocated, stored, high = int(dataset.BitsAllocated), int(dataset.BitsStored), int(dataset.HighBit)
    used = range(high - stored + 1, high + 1)
    cleared = 0
    for group in range(0x6000, 0x6100, 2):
        if (group, 0x0102) in dataset and (group, 0x3000) not in dataset:
            position = int(dataset[group, 0x0102].value)
            if position not in used and 0 <= position < allocated:
                cleared |= 1 << position
    if cleared and allocated in (8, 16, 32):
        values = np.frombuffer(dataset.PixelData, f"<u{allocated // 8}")
        dataset.PixelData = (values & ~np.array(cleared, values.dtype)).tobytes()
