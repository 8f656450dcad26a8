"""Export of the lumen's surface as STL, PLY, OBJ or GLB, with vertices in LPS, mm.

References
----------
STL (binary, 3D Systems 1988); PLY (Turk 1994); Wavefront OBJ; glTF 2.0, section 4 (GLB).
"""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from carina.disk import write_whole
from carina.errors import UsageError
from carina.export.header_notes import badge_lines
from carina.track.surface.mesh import Mesh
from carina.volume import Note

_LUMEN = "airway lumen"


def write_mesh(
    path: Path | str, mesh: Mesh, *, note: str | None = None, badges: Sequence[Note] = (), contents: str = _LUMEN
) -> Path:
    """Write a surface in the format of the suffix: ``.stl``, ``.ply``, ``.obj`` or ``.glb``.

    STL, PLY and OBJ contain LPS millimetres, and their header states this. GLB requires metres with +y up: its vertices
    are also LPS millimetres, and its only node rotates and scales them (patient's head up, front towards the viewer).

    Parameters
    ----------
    path, mesh
        File to be written, and the surface.
    note
        Information for readers in the header of the file, such as the part that was drawn by hand.
    badges
        Lasting notes of the case, also in the header. The header of an STL is too short; it only states that there are
        some.
    contents
        Name of the surface in the header.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    UsageError
        If the suffix is unknown.
    DiskError
        If the file cannot be written; a former file stays unchanged.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in _WRITERS:
        known = ", ".join(MESH_SUFFIXES)
        msg = f"saving a surface: expected a file name that ends in {known}; found {Path(path).name!r}"
        raise UsageError(msg)
    return write_whole(path, _WRITERS[suffix](mesh, note, badge_lines(badges), contents), what="the surface")


def _stl(mesh: Mesh, note: str | None, badges: list[str], contents: str) -> bytes:
    corners = mesh.vertices_lps[mesh.triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(across, axis=1, keepdims=True)
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])
    rows = np.zeros(len(corners), dtype=record)
    rows["normal"] = np.divide(across, lengths, out=np.zeros_like(across), where=lengths > 0.0)
    rows["corners"] = corners
    # A header that begins with "solid" would mark a text STL. The header has 80 bytes.
    words = f"Carina {contents}{', space LPS, unit mm' if not badges else '; unit mm'}; SPACE=LPS"
    words += ("" if note is None else "; PART IS NOT FROM THE CT") + ("; IN DOUBT" if badges else "")
    return words.encode().ljust(80) + struct.pack("<I", len(rows)) + rows.tobytes()


def _ply(mesh: Mesh, note: str | None, badges: list[str], contents: str) -> bytes:
    header = "\n".join(
        [
            "ply",
            "format binary_little_endian 1.0",
            f"comment Carina {contents}, space LPS, unit mm",
            *([] if note is None else [f"comment {note}"]),
            *(f"comment badge {line}" for line in badges),
            f"element vertex {len(mesh.vertices_lps)}",
            "property float x",
            "property float y",
            "property float z",
            f"element face {len(mesh.triangles)}",
            "property list uchar uint vertex_indices",
            "end_header",
            "",
        ]
    )
    faces = np.zeros(len(mesh.triangles), dtype=np.dtype([("count", "u1"), ("corners", "<u4", 3)]))
    faces["count"], faces["corners"] = 3, mesh.triangles
    return header.encode() + mesh.vertices_lps.astype("<f4").tobytes() + faces.tobytes()


def _obj(mesh: Mesh, note: str | None, badges: list[str], contents: str) -> bytes:
    text = io.StringIO()
    text.write(f"# Carina {contents}, space LPS, unit mm\n" + ("" if note is None else f"# {note}\n"))
    text.write("".join(f"# badge {line}\n" for line in badges) + "o airways\n")
    np.savetxt(text, mesh.vertices_lps, fmt="v %.5f %.5f %.5f")
    np.savetxt(text, mesh.triangles.astype(np.int64) + 1, fmt="f %d %d %d")
    return text.getvalue().encode()


def _glb(mesh: Mesh, note: str | None, badges: list[str], contents: str) -> bytes:
    points = mesh.vertices_lps.astype("<f4")
    corners = mesh.triangles.astype("<u4")
    payload = points.tobytes() + corners.tobytes()
    scale = 0.001
    extras: dict[str, Any] = {} if note is None else {"note": note}
    if badges:
        extras["badges"] = badges
    document = {
        "asset": {"version": "2.0", "generator": "Carina"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        # Columns of the matrix: directions of patient left, posterior and superior. +x is left, +y is up, the front
        # faces +z.
        "nodes": [
            {
                "name": "airways",
                "mesh": 0,
                "matrix": [scale, 0, 0, 0, 0, 0, -scale, 0, 0, scale, 0, 0, 0, 0, 0, 1],
                "extras": {"space": "LPS", "unit": "mm", **extras},
            }
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [
            {
                "name": "mucosa",
                "doubleSided": True,
                "pbrMetallicRoughness": {
                    "baseColorFactor": [0.86, 0.55, 0.5, 1.0],
                    "metallicFactor": 0.0,
                    "roughnessFactor": 0.6,
                },
            }
        ],
        "buffers": [{"byteLength": len(payload)}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": points.nbytes, "target": 34962},
            {"buffer": 0, "byteOffset": points.nbytes, "byteLength": corners.nbytes, "target": 34963},
        ],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": len(points),
                "type": "VEC3",
                "min": [float(v) for v in points.min(axis=0)],
                "max": [float(v) for v in points.max(axis=0)],
            },
            {"bufferView": 1, "componentType": 5125, "count": corners.size, "type": "SCALAR"},
        ],
    }
    words = json.dumps(document, allow_nan=False).encode()
    words += b" " * (-len(words) % 4)
    chunks = struct.pack("<II", len(words), 0x4E4F534A) + words + struct.pack("<II", len(payload), 0x004E4942) + payload
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks


_WRITERS: dict[str, Callable[[Mesh, str | None, list[str], str], bytes]] = {
    ".stl": _stl,
    ".ply": _ply,
    ".obj": _obj,
    ".glb": _glb,
}
MESH_SUFFIXES = tuple(_WRITERS)
"""Suffixes that :func:`write_mesh` can write."""
