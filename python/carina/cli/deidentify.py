"""``carina deidentify``: copies of DICOM images without identity."""

from __future__ import annotations

from pathlib import Path

import carina
from carina.cli.console import print_json, print_note, print_result, progress_printer
from carina.errors import UsageError


def write_copies(source: Path, folder: Path, *, alias: str, mask: list[str], as_json: bool) -> int:
    """Write the copies, and print their number and the images that were not copied."""
    boxes = [_box(text) for text in mask]
    copies = carina.deidentify(source, folder, alias=alias, mask=boxes, progress=progress_printer())
    for reason, count in copies.refused:
        print_note(f"note: {_images(count)} not copied: {reason}; blacken the text with --mask if it is needed")
    if as_json:
        print_json(copies.to_json())
        return 0
    patients = f"{copies.num_patients} patient{'s' if copies.num_patients != 1 else ''}"
    print_result(
        f"{_images(copies.num_images)} of {copies.num_series} series and {patients} written to {copies.folder}",
        "Check the pictures before you share them: text in pixels, and faces in head scans, can identify a patient.",
    )
    if copies.num_other_files:
        print_result(f"{copies.num_other_files} other files (reports, directories, documents) were not copied.")
    return 0


def _images(count: int) -> str:
    return f"{count} image{'s' if count != 1 else ''}"


def _box(text: str) -> tuple[int, int, int, int]:
    parts = text.split(",")
    try:
        x, y, width, height = (int(part) for part in parts)
    except ValueError:
        msg = f"--mask: expected four whole numbers x,y,width,height in pixels, such as 0,0,512,40; found {text[:40]!r}"
        raise UsageError(msg) from None
    return x, y, width, height
