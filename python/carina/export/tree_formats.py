"""Export of the airway tree to formats of external software: VTP (VTK), SWC (neuron tracers), Slicer markups.

All coordinates are in LPS, mm, and the files state this if the format allows it.

References
----------
VTK XML PolyData (VTK file formats); SWC (Cannon et al. 1998); 3D Slicer markups schema 1.0.3.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.disk import write_whole
from carina.export.header_notes import badge_lines, lasting
from carina.track import drawn_tree, kind_words
from carina.track.tree.airway_tree import AirwayTree, Branch
from carina.volume import Note

_MARKUPS_SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/"
    "markups-schema-v1.0.3.json#"
)
# Colours that readers with any colour vision can distinguish; the colour of a branch depends on its generation.
_GENERATION_RGB = (
    (0.34, 0.71, 0.91),
    (0.90, 0.62, 0.0),
    (0.0, 0.62, 0.45),
    (0.94, 0.89, 0.26),
    (0.0, 0.45, 0.70),
    (0.84, 0.37, 0.0),
    (0.80, 0.47, 0.65),
)
_DRAWN_RGB = (0.96, 0.71, 0.30)


def _label(branch: Branch) -> str:
    name, kind = branch.name or f"branch {branch.id}", kind_words(branch.kind)
    return name if kind is None else f"{name} ({kind})"


def write_vtp(path: Path | str, tree: AirwayTree, *, badges: Sequence[Note] = ()) -> Path:
    """Write the centrelines as VTK PolyData, one line per branch.

    Point data: ``Radius`` (mm). Cell data: ``BranchId``, ``ParentId`` (-1 at the root), ``Generation``, ``Bridge`` (1
    across an obstruction), ``DrawnByHand`` (1 if the branch was drawn by hand where the CT shows no airway),
    ``NameConfidence`` (-1 if unknown), ``Name`` and ``Kind`` (texts). Field data: ``Space`` LPS, ``Unit`` mm, ``Note``
    for the drawn parts, ``Badges`` for the lasting notes of the case.

    Parameters
    ----------
    path
        File to be written.
    tree
        The tree.
    badges
        Lasting notes of the case (``carina.volume.badges_of``).

    Raises
    ------
    CarinaError
        If the file cannot be written; a former file stays unchanged.
    """
    from xml.sax.saxutils import quoteattr  # imported on use: it loads HTTP and mail libraries

    branches = tree.branches
    points = np.concatenate([branch.points for branch in branches])
    counts = np.array([len(branch.points) for branch in branches])
    number = len(points)
    note = drawn_tree(tree).words
    reported = badge_lines(lasting(tree, badges))

    def data(name: str, values: NDArray[Any], components: int = 1) -> str:
        kinds = {"f8": "Float64", "i8": "Int64", "i4": "Int32"}
        raw = np.ascontiguousarray(values).tobytes()
        # Inline binary data: the number of bytes, then the bytes, in one base64 text.
        text = base64.b64encode(np.uint64(len(raw)).tobytes() + raw).decode()
        kind = kinds[values.dtype.str[1:]]
        return (
            f'<DataArray type="{kind}" Name={quoteattr(name)} NumberOfComponents="{components}" format="binary">'
            f"{text}</DataArray>"
        )

    def texts(name: str, values: list[str]) -> str:
        # VTK stores texts as the decimal codes of their bytes, each text ended by 0.
        codes = " ".join(str(byte) for value in values for byte in [*value.encode(), 0])
        return (
            f'<Array type="String" Name={quoteattr(name)} NumberOfTuples="{len(values)}" format="ascii">{codes}</Array>'
        )

    def cells(values: list[float], dtype: str) -> NDArray[Any]:
        return np.array(values, dtype=dtype)

    document = "\n".join(
        [
            '<?xml version="1.0"?>',
            '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">',
            "<PolyData>",
            "<FieldData>",
            texts("Space", ["LPS"]),
            texts("Unit", ["mm"]),
            *([] if note is None else [texts("Note", [note])]),
            *([texts("Badges", reported)] if reported else []),
            "</FieldData>",
            f'<Piece NumberOfPoints="{number}" NumberOfVerts="0" NumberOfLines="{len(branches)}" NumberOfStrips="0" '
            'NumberOfPolys="0">',
            '<PointData Scalars="Radius">',
            data("Radius", np.concatenate([branch.radius for branch in branches]).astype("<f8")),
            "</PointData>",
            '<CellData Scalars="Generation">',
            data("BranchId", cells([b.id for b in branches], "<i4")),
            data("ParentId", cells([-1 if b.parent is None else b.parent for b in branches], "<i4")),
            data("Generation", cells([b.generation for b in branches], "<i4")),
            data("Bridge", cells([int(b.kind == "bridge") for b in branches], "<i4")),
            data("DrawnByHand", cells([int(b.kind == "manual") for b in branches], "<i4")),
            data(
                "NameConfidence",
                cells([-1.0 if b.name_confidence is None else b.name_confidence for b in branches], "<f8"),
            ),
            texts("Name", [branch.name or "" for branch in branches]),
            texts("Kind", [branch.kind for branch in branches]),
            "</CellData>",
            "<Points>",
            data("Points", points.astype("<f8"), 3),
            "</Points>",
            "<Lines>",
            data("connectivity", np.arange(number, dtype="<i8")),
            data("offsets", np.cumsum(counts).astype("<i8")),
            "</Lines>",
            "</Piece>",
            "</PolyData>",
            "</VTKFile>",
            "",
        ]
    )
    return write_whole(path, document.encode(), what="the tree")


def write_swc(path: Path | str, tree: AirwayTree, *, badges: Sequence[Note] = ()) -> Path:
    """Write the centrelines as SWC: ``number type x y z radius parent`` per line, LPS mm, type 0 (undefined).

    A fork is one node, so a child begins with the point after its parent's last one.

    Parameters
    ----------
    path
        File to be written.
    tree
        The tree.
    badges
        Lasting notes of the case, written as comments.

    Raises
    ------
    CarinaError
        If the file cannot be written; a former file stays unchanged.
    """
    lines = ["# Carina airway tree", "# space LPS, unit mm, radius to the wall", "# number type x y z radius parent"]
    if (note := drawn_tree(tree).words) is not None:
        lines.insert(2, f"# {note}: the CT shows no airway there")
    lines[2:2] = [f"# badge {line}" for line in badge_lines(lasting(tree, badges))]
    last_node: dict[int, int] = {}
    node = 0
    for branch in tree.branches:
        before = -1 if branch.parent is None else last_node[branch.parent]
        lines.append(f"# branch {branch.id}: {_label(branch)}, generation {branch.generation}, {branch.kind}")
        first = 0 if branch.parent is None else 1
        for point, radius in zip(branch.points[first:], branch.radius[first:], strict=True):
            node += 1
            x, y, z = (repr(float(v)) for v in point)
            lines.append(f"{node} 0 {x} {y} {z} {float(radius)!r} {before}")
            before = node
        last_node[branch.id] = before
    return write_whole(path, ("\n".join(lines) + "\n").encode(), what="the tree")


def write_markups(path: Path | str, tree: AirwayTree, *, badges: Sequence[Note] = ()) -> Path:
    """Write the centrelines as 3D Slicer markups (``.mrk.json``): one named curve per branch, in LPS, mm.

    The name and description of a drawn or bridged branch state that the CT does not show it, and its curve is thin and
    amber. Each description contains the lasting notes of the case.

    Parameters
    ----------
    path
        File to be written.
    tree
        The tree.
    badges
        Lasting notes of the case (``carina.volume.badges_of``).

    Raises
    ------
    CarinaError
        If the file cannot be written; a former file stays unchanged.
    """
    document = {
        "@schema": _MARKUPS_SCHEMA,
        "markups": [_curve(branch, badge_lines(lasting(tree, badges))) for branch in tree.branches],
    }
    return write_whole(path, (json.dumps(document, allow_nan=False) + "\n").encode(), what="the tree")


def _curve(branch: Branch, badges: list[str]) -> dict[str, Any]:
    is_drawn = branch.kind != "tracked"
    colour = list(_DRAWN_RGB if is_drawn else _GENERATION_RGB[branch.generation % len(_GENERATION_RGB)])
    return {
        "type": "Curve",
        "name": _label(branch),
        "description": "; ".join(
            [*([f"{kind_words(branch.kind)}: the CT shows no airway here"] if is_drawn else []), *badges]
        ),
        "coordinateSystem": "LPS",
        "coordinateUnits": "mm",
        "locked": True,
        "fixedNumberOfControlPoints": False,
        "labelFormat": "%N-%d",
        "lastUsedControlPointNumber": len(branch.points),
        "controlPoints": [
            {
                "id": str(number),
                "label": "",
                "description": f"radius {radius:.2f} mm",
                "associatedNodeID": "",
                "position": [float(v) for v in point],
                "orientation": [-1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0],
                "selected": True,
                "locked": False,
                "visibility": True,
                "positionStatus": "defined",
            }
            for number, (point, radius) in enumerate(zip(branch.points, branch.radius, strict=True), 1)
        ],
        "measurements": [],
        "display": {
            "visibility": True,
            "color": colour,
            "selectedColor": colour,
            "propertiesLabelVisibility": True,
            "pointLabelsVisibility": False,
            "glyphScale": 0.5,
            "lineThickness": 0.15 if is_drawn else 0.4,
        },
    }
