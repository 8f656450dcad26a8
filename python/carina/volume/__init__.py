"""CT volumes: reading them, where their voxels are in the patient, and what they are good for."""

from carina.volume.demo import demo_patient
from carina.volume.grid_writing import GRID_SUFFIXES, write_grid, write_grid_to
from carina.volume.inspection import Inspection, inspect_path
from carina.volume.mask_files import Mask, MaskGridError, MaskLabel, MaskLabelError, open_mask
from carina.volume.model import Note, SeriesInfo, Volume, VolumeSource, badges_of
from carina.volume.opening import open_volume
from carina.volume.quality import Finding, Quality, quality_gate

__all__ = [
    "GRID_SUFFIXES",
    "Finding",
    "Inspection",
    "Mask",
    "MaskGridError",
    "MaskLabel",
    "MaskLabelError",
    "Note",
    "Quality",
    "SeriesInfo",
    "Volume",
    "VolumeSource",
    "badges_of",
    "demo_patient",
    "inspect_path",
    "open_mask",
    "open_volume",
    "quality_gate",
    "write_grid",
    "write_grid_to",
]
