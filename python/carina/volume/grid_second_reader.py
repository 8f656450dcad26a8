"""Second reader of the geometry in NIfTI, NRRD, MetaImage and VTI headers, as a check of the first one.

The first reader (``grid_headers``) decides what is accepted. This module reads only the size and the position of the
grid, shares no code with the first reader, and computes each value in another way, so that a mistake in one of them
appears as a disagreement: the byte order from the number of axes, a rotation from its angle and axis, the fields of a
text header by their names in the whole text. Tests compare it with SimpleITK.

Sources: nifti1.h (NIfTI-1.1), the NRRD format definition (teem), MetaIO's documentation.
"""

from __future__ import annotations

import math
import re

import numpy as np
from numpy.typing import NDArray

_NIFTI = np.dtype(
    {
        "names": ["dim", "pixdim", "units", "qform", "sform", "quaternion", "offset", "rows"],
        "formats": ["8i2", "8f4", "u1", "i2", "i2", "3f4", "3f4", "(3,4)f4"],
        "offsets": [40, 76, 123, 252, 254, 256, 268, 280],
        "itemsize": 348,
    }
)
"""The fields of a NIfTI header that describe the grid."""
_MM_BY_UNIT = {0: 1.0, 1: 1000.0, 2: 1.0, 3: 0.001}
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_LISTS = frozenset({"DimSize", "ElementSpacing", "ElementSize", "TransformMatrix", "Offset"})
"""Fields of MetaImage whose length MetaIO derives from NDims, which must precede them."""


def read_geometry(head: bytes, format: str) -> tuple[tuple[int, ...], NDArray[np.float64]]:  # noqa: A002 - as in grid_headers
    """Read the size of a grid and its transform from voxel centres to LPS mm.

    Parameters
    ----------
    head
        The header, decompressed.
    format
        ``nifti``, ``nrrd`` or ``metaimage``.

    Returns
    -------
    shape_ijk, lps_from_ijk
        The numbers of voxels along the axes, and the 4x4 transform.

    Raises
    ------
    ValueError
        If a value that the geometry needs is missing or malformed.
    """
    if format == "nifti":
        return _nifti(head)
    text = head.decode("latin-1")
    if format == "vti":
        return _vti(text)
    return _nrrd(text) if format == "nrrd" else _metaimage(text)


def _transform(columns: list[NDArray[np.float64]], origin: NDArray[np.float64]) -> NDArray[np.float64]:
    found = np.eye(4)
    found[:3] = np.column_stack([*columns, origin])
    return found


def _nifti(head: bytes) -> tuple[tuple[int, ...], NDArray[np.float64]]:
    # The number of axes is between 1 and 7 in the right byte order only.
    little = np.frombuffer(head, dtype=_NIFTI, count=1)[0]
    fields = little if 1 <= little["dim"][0] <= 7 else little.view(_NIFTI.newbyteorder(">"))
    sizes = [int(size) for size in fields["dim"][1 : int(fields["dim"][0]) + 1]]
    while len(sizes) > 3 and sizes[-1] == 1:
        sizes.pop()
    if fields["sform"] > 0:
        columns, origin = list(fields["rows"][:, :3].T.astype(np.float64)), fields["rows"][:, 3].astype(np.float64)
    elif fields["qform"] > 0:
        spacing = fields["pixdim"][1:4].astype(np.float64)
        if fields["pixdim"][0] < 0:
            spacing[2] = -spacing[2]
        turn = _rotation(fields["quaternion"].astype(np.float64))
        columns, origin = [turn[:, axis] * spacing[axis] for axis in range(3)], fields["offset"].astype(np.float64)
    else:
        raise ValueError
    millimetres = _MM_BY_UNIT.get(int(fields["units"]) % 8)
    if millimetres is None:
        raise ValueError
    to_lps = np.array([-millimetres, -millimetres, millimetres])
    return tuple(sizes), _transform([to_lps * column for column in columns], to_lps * origin)


def _rotation(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation of a unit quaternion with this vector part (Rodrigues' formula)."""
    sine = float(np.linalg.norm(vector))
    if sine == 0.0:
        return np.eye(3)
    # nifti1.h: a vector whose length is 1 except for rounding is a half turn.
    angle = math.pi if 1.0 - sine * sine < 1e-7 else 2.0 * math.asin(sine)
    x, y, z = vector / sine
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * (cross @ cross))


def _numbers(text: str, count: int | None = None) -> list[float]:
    found = [float(number) for number in _NUMBER.findall(text)]
    if count is not None and len(found) != count:
        raise ValueError
    return found


def _nrrd(text: str) -> tuple[tuple[int, ...], NDArray[np.float64]]:
    def field(name: str) -> str:
        found = re.search(rf"^{name}[ \t]*:(?!=)[ \t]*(.*?)\r?$", text, re.MULTILINE | re.IGNORECASE)
        if found is None:
            raise ValueError
        return found[1]

    # The format forbids spacings of axes that have directions.
    if re.search(r"^spacings[ \t]*:(?!=)[^\r\n]*\d", text, re.MULTILINE | re.IGNORECASE):
        raise ValueError
    sizes = tuple(int(size) for size in _numbers(field("sizes")))
    space = field("space").lower()
    initials = [word[0] for word in space.split("-")] if "-" in space else list(space)
    signs = np.array([1.0 if initial in "lps" else -1.0 for initial in initials])
    if signs.shape != (3,):
        raise ValueError
    vectors = np.reshape(_numbers(field("space directions"), 9), (3, 3))
    return sizes, _transform([signs * vector for vector in vectors], signs * _numbers(field("space origin"), 3))


def _metaimage(text: str) -> tuple[tuple[int, ...], NDArray[np.float64]]:
    fields: dict[str, str] = {}
    for line in text.splitlines():
        name, _, value = line.partition("=")
        if name.strip() in _LISTS and "NDims" not in fields:
            raise ValueError
        fields[name.strip()] = value

    def first(*names: str) -> str | None:
        return next((fields[name] for name in names if name in fields), None)

    sizes = tuple(int(size) for size in _numbers(fields.get("DimSize", ""), int(fields.get("NDims", "3"))))
    spacing = _numbers(first("ElementSpacing", "ElementSize") or "1 1 1", 3)
    turn = _numbers(first("TransformMatrix", "Rotation", "Orientation") or "1 0 0 0 1 0 0 0 1", 9)
    origin = np.array(_numbers(first("Offset", "Position", "Origin") or "0 0 0", 3))
    # Each group of three numbers is the direction of one axis.
    axes = [np.array(turn[3 * axis : 3 * axis + 3]) for axis in range(3)]
    return sizes, _transform([length * axis for length, axis in zip(spacing, axes, strict=True)], origin)


def _vti(text: str) -> tuple[tuple[int, ...], NDArray[np.float64]]:
    tag = text[text.index("<ImageData") :]
    tag = tag[: tag.index(">")]

    def numbers(name: str, default: str | None = None) -> list[float]:
        _, mark, after = tag.replace("'", '"').partition(f'{name}="')
        if not mark and default is None:
            raise ValueError
        return _numbers(after.split('"')[0] if mark else default or "")

    extent, spacing, origin = numbers("WholeExtent"), numbers("Spacing"), np.array(numbers("Origin", "0 0 0"))
    turn = numbers("Direction", "1 0 0 0 1 0 0 0 1")
    on_cells = (
        text.rindex("<CellData") > text.rindex("<PointData")
        if "<CellData" in text and "<PointData" in text
        else ("<PointData" not in text)
    )
    low, high = extent[0::2], extent[1::2]
    sizes = tuple(int(b - a) + (0 if on_cells else 1) for a, b in zip(low, high, strict=True))
    # The direction of an axis is a column of the matrix.
    axes = [spacing[axis] * np.array(turn[axis::3]) for axis in range(3)]
    shift = 0.5 if on_cells else 0.0
    first = origin + sum(((low[axis] + shift) * axes[axis] for axis in range(3)), np.zeros(3))
    return sizes, _transform(axes, first)
