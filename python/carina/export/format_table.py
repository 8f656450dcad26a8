"""Table of file formats for airways: one row per format, with its contents and the programs that read it.

A new format needs a row here and a function that writes it. The command line, the list in the window
(``web/src/wire/exports.ts`` is generated from this table) and the error for other suffixes use the table.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from carina.display import one_line
from carina.errors import UsageError
from carina.export.mask_file import write_mask
from carina.export.mesh_file import write_mesh
from carina.export.tree_file import write_tree
from carina.export.tree_formats import write_markups, write_swc, write_vtp

ExportKind = Literal["surface", "lumen", "tree"]

EXPORT_TITLES: dict[ExportKind, str] = {
    "surface": "Airway surface",
    "lumen": "Lumen mask on the CT grid",
    "tree": "Branches and centrelines",
}
"""Titles for the user, in the order of the window."""


@one_line
@dataclass(frozen=True, slots=True)
class ExportFormat:
    """File format for airways."""

    suffix: str
    """Suffix in lower case, with its dots."""
    kind: ExportKind
    """Contents of the file: the surface or the mask of the lumen, or the tree."""
    words: str
    """Description in the format list: the programs that read the format, or its contents."""
    write: Callable[..., Path]
    """Function that writes the file; its arguments are the path, then a mesh, a mask and its volume, or a tree."""


EXPORT_FORMATS: tuple[ExportFormat, ...] = (
    ExportFormat(".stl", "surface", "For 3D printing and most 3D software", write_mesh),
    ExportFormat(".ply", "surface", "For MeshLab and Blender", write_mesh),
    ExportFormat(".obj", "surface", "For 3D modelling software", write_mesh),
    ExportFormat(".glb", "surface", "For web and phone viewers", write_mesh),
    ExportFormat(".nii.gz", "lumen", "NIfTI for 3D Slicer, ITK-SNAP, Python", write_mask),
    ExportFormat(".nii", "lumen", "NIfTI, uncompressed", write_mask),
    ExportFormat(".nrrd", "lumen", "NRRD for 3D Slicer", write_mask),
    ExportFormat(".mha", "lumen", "MetaImage for ITK", write_mask),
    # The longest matching suffix counts: ".mrk.json" also ends in ".json".
    ExportFormat(".json", "tree", "The complete tree: names, radii, confidence", write_tree),
    ExportFormat(".vtp", "tree", "For ParaView and VTK", write_vtp),
    ExportFormat(".mrk.json", "tree", "Curves for 3D Slicer", write_markups),
    ExportFormat(".swc", "tree", "For software that analyses tree morphology", write_swc),
)
EXPORT_SUFFIXES = tuple(row.suffix for row in EXPORT_FORMATS)
"""Suffixes that :func:`carina.export_airways` can write."""


def export_format(path: Path | str, *, kind: ExportKind | None = None) -> ExportFormat:
    """Return the format for a file name.

    Parameters
    ----------
    path
        File name; the case of its suffix does not matter.
    kind
        Kind of contents; other formats are ignored.

    Raises
    ------
    UsageError
        If no format has this suffix.
    """
    name = Path(path).name.lower()
    rows = [row for row in EXPORT_FORMATS if kind in {None, row.kind}]
    found = [row for row in rows if name.endswith(row.suffix)]
    if not found:
        what = {None: "airways", "surface": "a surface", "lumen": "a mask", "tree": "a tree"}[kind]
        known = ", ".join(row.suffix for row in rows)
        raise UsageError(f"{what}: expected a file name that ends in {known}; found {Path(path).name!r}")
    return max(found, key=lambda row: len(row.suffix))
