"""Results of tracking paths to targets: the path to each target, their common tree, and the effort of the search."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.display.tables import Columns, Tabular, columns_of
from carina.track.find.result import Airways
from carina.track.paths.tracker import TrackedPath
from carina.track.tree.airway_tree import AirwayTree

Points = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class WallCrossing:
    """Place where a path leaves the found lumen, or returns into it."""

    along_mm: float
    """Distance from the start of the path, mm."""
    lps: tuple[float, float, float]
    """First point behind the wall, LPS in mm."""
    enters: bool
    """Whether the path returns into the lumen here; False where it leaves the lumen."""


@dataclass(frozen=True, slots=True)
class TargetSearch:
    """Effort of the search for one target, and statistics of its path."""

    cost: float
    """Cost of the path: the sum over its edges of length in mm times weight."""
    search_s: float
    """Seconds from the call to the least cost; nodes settled for earlier targets are not searched again."""
    num_settled: int
    """Number of nodes that were settled for this target."""
    num_path_nodes: int
    """Number of nodes of the path to the target."""
    num_outside: int | None
    """Number of nodes of the search's path outside the found lumen; None if there is no lumen to compare with."""
    outside_mm: float | None
    """Length of the path outside the found lumen, in mm; None if there is no lumen to compare with.

    With the cost ``walls`` the path is the relaxed one, unless the search was made without relaxation.
    """
    value_range: tuple[int, int]
    """Lowest and highest value of the path's voxels, in the unit of the volume (HU for a CT in HU)."""
    to_node_mm: float
    """Distance in mm from the voxel of the target to its node; above 0 if the voxel was pruned."""
    search_length_mm: float = 0.0
    """Length in mm of the path of the search, before relaxation or smoothing."""
    search_outside_mm: float | None = None
    """Length in mm of the path of the search outside the found lumen; None if there is no lumen to compare with."""
    crossings: tuple[WallCrossing, ...] | None = None
    """Places where the path crosses the wall of the found lumen; None if there is no lumen to compare with."""


@dataclass(frozen=True, slots=True, eq=False)
class GraphSearch:
    """Graph that was searched, and the effort of the search."""

    cost: str
    """Cost of the edges: ``lumen``, ``paper`` or ``walls``."""
    graph: str
    """Kind of the graph: ``voxel`` or ``isoregion``."""
    labels: str | None
    """Labels of the IsoRegions: ``bins`` of 16 HU, or the class of the ``lumen``; None on the voxel graph."""
    num_nodes: int
    """Number of nodes of the graph."""
    num_edges: int
    """Number of undirected edges, including links between centres and boundaries."""
    num_centres: int
    """Number of nodes in the centre of an IsoRegion."""
    build_s: float
    """Time for building the graph and the cost of its edges, s."""
    quantum: float
    """Unit of the integer path costs; every cost is a whole multiple of it."""
    first_ijk: tuple[int, int, int]
    """First voxel (i, j, k) of the box that was searched."""
    shape_ijk: tuple[int, int, int]
    """Shape of the box of voxels that was searched, from ``first_ijk`` on (for the cost ``lumen``: its lumen)."""
    is_whole: bool
    """Whether the searched box is the whole volume."""
    branch_nodes_lps: Points
    """Positions (n, 3) where paths part, LPS in mm: predecessors of two or more nodes (paper, Figure 13)."""
    targets: tuple[TargetSearch | None, ...]
    """Search of each target; None if there is no path to the target."""
    notes: tuple[str, ...] = ()
    """Texts for the user about limits of the search."""
    is_relaxed: bool = False
    """Whether the paths were relaxed after the search (cost ``walls`` only)."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class TargetResult:
    """Path to one target, or the reason why there is none."""

    requested_lps: NDArray[np.float64]
    """Target as requested, LPS in mm."""
    used_lps: NDArray[np.float64] | None
    """End of the path, LPS in mm: the target, or the lumen voxel to which it was moved; None if there is no path."""
    snapped_mm: float
    """Distance in mm from the given target to the nearest point of the lumen, to which the target was moved."""
    path: TrackedPath | None
    """Path to the target; None if there is no path."""
    problem: str | None
    """Text that states why there is no path; None if there is one."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class TrackResult(Tabular):
    """Paths to several targets, and their common tree.

    As a table (``to_pandas``, ``to_arrow``, ``to_columns``) it has a row for each target: its number from 1, the
    requested point ``x_mm``, ``y_mm``, ``z_mm`` (LPS), ``length_mm``, ``cost`` and ``generation`` of its path,
    ``snapped_mm``, and ``problem``, the reason why there is no path.
    """

    tree: AirwayTree | None
    """Common tree of the paths; None if there is neither a path nor an airway tree."""
    targets: tuple[TargetResult, ...]
    """Results, one for each target, in order."""
    airways: Airways | None
    """Airways in which the paths run.

    None if no lumen was found, which the costs ``paper`` and ``walls`` do not need.
    """
    search: GraphSearch | None = None
    """Graph that was searched and the effort; None for the cost ``lumen`` on the voxel graph."""

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
