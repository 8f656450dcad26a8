"""What became of targets: the path to each, their common tree, and what the search took."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.display.tables import Columns, Tabular, columns_of
from carina.track.find.found import Airways
from carina.track.paths.tracker import TrackedPath
from carina.track.tree.airway_tree import AirwayTree

__all__ = ["GraphSearch", "TargetResult", "TargetSearch", "TrackResult"]

Points = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TargetSearch:
    """What the search for one target took, and where its path runs."""

    cost: float
    """Sum over the edges of length in mm times weight."""
    search_s: float
    """Seconds from the call to the least cost; what earlier targets settled is not searched again."""
    num_settled: int
    """Nodes settled for it."""
    num_path_nodes: int
    num_outside: int | None
    """Nodes of the path outside the lumen that was found; None where there is no lumen to compare with."""
    outside_mm: float | None
    """Length of the path outside that lumen, mm; None likewise."""
    value_range: tuple[int, int]
    """Least and greatest value of the path's voxels, in the volume's own numbers."""
    to_node_mm: float
    """From the target's voxel to the node that stands for it, mm; above 0 where the voxel was cut away."""


@dataclass(frozen=True, slots=True, eq=False)
class GraphSearch:
    """The graph that was searched, and what the search took."""

    cost: str
    graph: str
    labels: str | None
    """``bins`` of 16 HU, or the class of the ``lumen``; None on the voxel graph."""
    num_nodes: int
    num_edges: int
    """Undirected; links between centres and boundaries included."""
    num_centres: int
    """Nodes in the middle of an IsoRegion."""
    build_s: float
    """Seconds that graph and cost took to build."""
    quantum: float
    """Integer unit of the costs."""
    first_ijk: tuple[int, int, int]
    shape_ijk: tuple[int, int, int]
    """The box of voxels that was searched (for the cost ``lumen`` its lumen)."""
    is_whole: bool
    """True if that is the whole volume."""
    branch_nodes_lps: Points
    """(n, 3) places where paths part: nodes that two or more others point back to (paper, Figure 13)."""
    targets: tuple[TargetSearch | None, ...]
    """One for each target, None where there is no path."""
    notes: tuple[str, ...] = ()


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class TargetResult:
    """What became of one target."""

    requested_lps: NDArray[np.float64]
    used_lps: NDArray[np.float64] | None
    """Where the path ends: the target, or the lumen voxel it was moved to."""
    snapped_mm: float
    path: TrackedPath | None
    problem: str | None
    """Why there is no path, in words."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class TrackResult(Tabular):
    """Paths to several targets, and their common tree.

    As a table (``to_pandas``, ``to_arrow``, ``to_columns``) it has a row for each target: its number from 1, the
    requested place ``x_mm``, ``y_mm``, ``z_mm`` (LPS), ``length_mm``, ``cost`` and ``generation`` of its path,
    ``snapped_mm``, and ``problem``, why there is no path.
    """

    tree: AirwayTree | None
    """None where there is neither a path nor an airway tree."""
    targets: tuple[TargetResult, ...]
    airways: Airways | None
    """None where no airway lumen was found, which the costs ``paper`` and ``walls`` do without."""
    search: GraphSearch | None = None
    """The graph that was searched and what that took; None for the cost ``lumen`` on the voxel graph."""

    def _columns(self) -> Columns:
        return columns_of(
            (
                {
                    "target": number,
                    **dict(zip(("x_mm", "y_mm", "z_mm"), one.requested_lps.tolist(), strict=True)),
                    "length_mm": None if one.path is None else one.path.length_mm,
                    "cost": None if one.path is None else one.path.cost,
                    "generation": None if one.path is None else int(one.path.generation[-1]),
                    "snapped_mm": one.snapped_mm,
                    "problem": one.problem,
                }
                for number, one in enumerate(self.targets, start=1)
            ),
            {
                "target": "int",
                "x_mm": "float",
                "y_mm": "float",
                "z_mm": "float",
                "length_mm": "float",
                "cost": "float",
                "generation": "int",
                "snapped_mm": "float",
                "problem": "text",
            },
        )
