"""JSON files beside NIfTI files, as BIDS and dcm2niix write them: the slice thickness, which NIfTI cannot state."""

from __future__ import annotations

import json
from pathlib import Path

from carina.disk import open_regular
from carina.volume.model import MAX_THICKNESS_MM

__all__ = ["only_volume_in", "stated_thickness_mm"]

_MAX_BYTES = 1 << 20
_MAX_ENTRIES = 64
_NIFTI = (".nii.gz", ".nii")
_VOLUMES = (*_NIFTI, ".nrrd", ".nhdr", ".mha", ".mhd", ".vti")
_BESIDE = (".json", ".tsv", ".txt", ".md", ".bval", ".bvec", ".raw", ".zraw", ".raw.gz")
_NAMES = ("readme", "license", "changes")


def stated_thickness_mm(path: Path) -> float | None:
    """Return the slice thickness in mm that the JSON file of a NIfTI file states; None without a plausible one.

    No other value is read: such files may contain the name of the patient.
    """
    suffix = next((one for one in _NIFTI if path.name.lower().endswith(one)), None)
    if suffix is None:
        return None
    sidecar = path.with_name(f"{path.name[: -len(suffix)]}.json")
    try:
        with open_regular(sidecar) as file:
            text = file.read(_MAX_BYTES + 1)
        value = json.loads(text)["SliceThickness"] if len(text) <= _MAX_BYTES else None
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    # The comparison is false for NaN, and exact for whole numbers beyond the range of float.
    return round(float(value), 4) if 0 < value <= MAX_THICKNESS_MM else None


def only_volume_in(folder: Path) -> Path | None:
    """Return the volume of a folder that contains one volume file and only descriptions beside it, else None."""
    volumes: list[Path] = []
    try:
        for number, entry in enumerate(folder.iterdir()):
            name = entry.name.lower()
            if number >= _MAX_ENTRIES or not entry.is_file():
                return None
            if name.endswith(_VOLUMES):
                volumes.append(entry)
            elif not (name.endswith(_BESIDE) or name.startswith(".") or name in _NAMES):
                return None
    except OSError:
        return None
    return volumes[0] if len(volumes) == 1 else None
