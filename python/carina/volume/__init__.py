"""CT volumes: readers, positions of the voxels in the patient, and checks of image quality.

Readers are loaded at first use, so that code that needs only the types does not load a DICOM library.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from carina.volume.cache import CachedCt, CachedSize, OpenedCt, VolumeCache
    from carina.volume.demo import demo_patient
    from carina.volume.digest import Geometry, canonical_geometry, ct_digest, refuse_other_ct, same_geometry
    from carina.volume.grid_writing import GRID_SUFFIXES, check_grid_fits, write_grid, write_grid_to
    from carina.volume.inspection import Inspection, inspect_path
    from carina.volume.licence_notice import Citation
    from carina.volume.mask_files import Mask, MaskGridError, MaskLabel, MaskLabelError, open_mask
    from carina.volume.model import Note, SeriesInfo, Volume, VolumeSource, badges_of
    from carina.volume.opening import open_volume
    from carina.volume.quality import Finding, Quality, quality_gate
    from carina.volume.source_files import CtSource

_HOME = {
    "CachedCt": "cache",
    "CachedSize": "cache",
    "Citation": "licence_notice",
    "CtSource": "source_files",
    "Finding": "quality",
    "GRID_SUFFIXES": "grid_writing",
    "Geometry": "digest",
    "Inspection": "inspection",
    "Mask": "mask_files",
    "MaskGridError": "mask_files",
    "MaskLabel": "mask_files",
    "MaskLabelError": "mask_files",
    "Note": "model",
    "OpenedCt": "cache",
    "Quality": "quality",
    "SeriesInfo": "model",
    "Volume": "model",
    "VolumeCache": "cache",
    "VolumeSource": "model",
    "badges_of": "model",
    "canonical_geometry": "digest",
    "ct_digest": "digest",
    "demo_patient": "demo",
    "inspect_path": "inspection",
    "open_mask": "mask_files",
    "open_volume": "opening",
    "quality_gate": "quality",
    "refuse_other_ct": "digest",
    "same_geometry": "digest",
    "check_grid_fits": "grid_writing",
    "write_grid": "grid_writing",
    "write_grid_to": "grid_writing",
}

__all__ = [
    "GRID_SUFFIXES",
    "CachedCt",
    "CachedSize",
    "Citation",
    "CtSource",
    "Finding",
    "Geometry",
    "Inspection",
    "Mask",
    "MaskGridError",
    "MaskLabel",
    "MaskLabelError",
    "Note",
    "OpenedCt",
    "Quality",
    "SeriesInfo",
    "Volume",
    "VolumeCache",
    "VolumeSource",
    "badges_of",
    "canonical_geometry",
    "check_grid_fits",
    "ct_digest",
    "demo_patient",
    "inspect_path",
    "open_mask",
    "open_volume",
    "quality_gate",
    "refuse_other_ct",
    "same_geometry",
    "write_grid",
    "write_grid_to",
]


def __getattr__(name: str) -> Any:
    home = _HOME.get(name)
    if home is None:
        msg = f"module 'carina.volume' has no attribute {name!r}"
        raise AttributeError(msg)
    return getattr(importlib.import_module(f"carina.volume.{home}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
