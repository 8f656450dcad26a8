"""A new centreline in pieces of one kind each: found in the CT, drawn by a person, or over a bridge."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from carina.track.edit.lumen import BRIDGE_RADIUS_MM
from carina.track.edit.tree import Points, along_mm

__all__ = ["Piece", "bridge_pieces", "kind_of_added", "painted_pieces"]

Piece = tuple[Points, str]
"""Points, and their kind; the last point of a piece is the first of the next."""


def bridge_pieces(points: Points, kind: str, bridges: Sequence[Points], near_mm: float, least_mm: float) -> list[Piece]:
    """Where a line leads over a bridge that was made before, it is that bridge.

    The bridge's lumen may have been erased and painted again, or grown again: what was never seen in the CT does not
    become an airway by that.

    Parameters
    ----------
    near_mm
        Half a voxel: how far off a bridge's tube a point of it may lie.
    least_mm
        What would be left beside the bridge and is shorter belongs to it.
    """
    near_mm += BRIDGE_RADIUS_MM
    is_on = np.zeros(len(points), dtype=bool)
    for way in bridges:
        off = np.sqrt(np.square(points[:, None] - way[None]).sum(axis=2))
        place = off.argmin(axis=1)
        # Not before its beginning or beyond its end, and along it, not off it to a side.
        on_way = (off.min(axis=1) <= near_mm) & (place > 0) & (place < len(way) - 1)
        if on_way.any() and np.ptp(along_mm(way)[place[on_way]]) >= near_mm:
            is_on |= on_way
    return _split(points, is_on, "bridge", kind, least_mm)


def kind_of_added(doubtful: NDArray[np.bool_]) -> str:
    """Kind of a branch that was added along a line: an airway where the CT shows a wall all along, else drawn by hand.

    The part that has evidence is an airway only once it is asked for by itself. As a piece of a branch that a person
    insists on it would take part in naming, and rename its neighbours.

    Parameters
    ----------
    doubtful
        (n-1,) per segment.
    """
    return "manual" if doubtful.any() else "tracked"


def painted_pieces(points: Points, was_found: NDArray[np.bool_], least_mm: float) -> list[Piece]:
    """Of a line that new paint brought into reach: what the search had found is found, the rest is a person's.

    Parameters
    ----------
    was_found
        (n,) whether the search had each point's voxel in the lumen.
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
