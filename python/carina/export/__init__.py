"""File formats."""

from carina.export.any_file import export_airways, export_tree, is_tree_file
from carina.export.film import Film, write_film
from carina.export.format_table import EXPORT_FORMATS, EXPORT_SUFFIXES, EXPORT_TITLES, ExportFormat, export_format
from carina.export.mask_file import write_mask
from carina.export.mesh_file import write_mesh
from carina.export.tree_file import read_badges, read_tree, write_tree
from carina.export.tree_formats import write_markups, write_swc, write_vtp
from carina.export.video import VIDEO_SUFFIXES, VideoWriter

__all__ = [
    "EXPORT_FORMATS",
    "EXPORT_SUFFIXES",
    "EXPORT_TITLES",
    "VIDEO_SUFFIXES",
    "ExportFormat",
    "Film",
    "VideoWriter",
    "export_airways",
    "export_format",
    "export_tree",
    "is_tree_file",
    "read_badges",
    "read_tree",
    "write_film",
    "write_markups",
    "write_mask",
    "write_mesh",
    "write_swc",
    "write_tree",
    "write_vtp",
]
