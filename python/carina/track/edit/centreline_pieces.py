"""Division of a new centreline into pieces, each found in the CT, drawn by the user, or along a bridge."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from carina.track.edit.lumen import BRIDGE_RADIUS_MM
from carina.track.edit.tree_changes import Points, along_mm

Piece = tuple[Points, str]
"""Type of a piece of a centreline: points and kind; the last point of a piece is the first point of the next."""


def bridge_pieces(points: Points, kind: str, bridges: Sequence[Points], near_mm: float, least_mm: float) -> list[Piece]:
    """Divide a line into pieces on and off earlier bridges (branches across an obstruction that the user added).

    The lumen of a bridge may have been erased and painted or grown again; the part on the bridge stays a bridge,
    because the CT never showed an airway there.

    Parameters
    ----------
    points
        (n, 3) line, LPS in mm.
    kind
        Kind of the pieces that are off the bridges.
    bridges
        (n, 3) points of each bridge, LPS in mm.
    near_mm
        Half a voxel: largest distance of a point from the tube of a bridge.
    least_mm
        Shorter remainders beside the bridge are added to the bridge.
    """
    near_mm += BRIDGE_RADIUS_MM
    is_on = np.zeros(len(points), dtype=bool)
    for way in bridges:
        off = np.sqrt(np.square(points[:, None] - way[None]).sum(axis=2))
        place = off.argmin(axis=1)
        # A point is on a bridge if it is along the bridge, not before its start, beyond its end or on a path that
        # leaves it sideways.
        on_way = (off.min(axis=1) <= near_mm) & (place > 0) & (place < len(way) - 1)
        if on_way.any() and np.ptp(along_mm(way)[place[on_way]]) >= near_mm:
            is_on |= on_way
    return _split(points, is_on, "bridge", kind, least_mm)


def kind_of_added(doubtful: NDArray[np.bool_]) -> str:
    """Return the kind of an added branch: ``tracked`` if the CT shows a wall along its whole length, else ``manual``.

    A part with evidence only becomes an airway if the user adds it separately. As a piece of a branch with doubtful
    parts it would take part in naming, and change the names of its neighbours.

    Parameters
    ----------
    doubtful
        (n-1,) whether each segment is doubtful.
    """
    return "manual" if doubtful.any() else "tracked"


def painted_pieces(points: Points, was_found: NDArray[np.bool_], least_mm: float) -> list[Piece]:
    """Divide a line through newly painted lumen: points that the search had found are ``tracked``, others ``manual``.

    Parameters
    ----------
    points
        (n, 3) line, LPS in mm.
    was_found
        (n,) whether the search had each point's voxel in the lumen.
    least_mm
        Shorter remainders are added to the ``manual`` piece.
    """
    return _split(points, ~was_found, "manual", "tracked", least_mm)


def _split(points: Points, is_on: NDArray[np.bool_], kind: str, other: str, least_mm: float) -> list[Piece]:
    on, along = np.flatnonzero(is_on), along_mm(points)
    if not len(on):
        return [(points, other)]
    first = int(on[0]) if along[on[0]] >= least_mm else 0
    last = int(on[-1]) if along[-1] - along[on[-1]] >= least_mm else len(points) - 1
    pieces = [(points[: first + 1], other), (points[first : last + 1], kind), (points[last:], other)]
    return [piece for piece in pieces if len(piece[0]) > 1]
