"""What a search gives: the airways of a volume, paths to targets, and what the search took."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.display import as_words, one_line
from carina.track.edit_kinds import TreeEdit
from carina.track.kept import KeptForVolume
from carina.track.paths import PathTracker, TrackedPath
from carina.track.tree import AirwayTree
from carina.track.uncertain import Uncertainty
from carina.volume.model import Note

__all__ = ["Airways", "GraphSearch", "TargetResult", "TargetSearch", "TrackResult"]

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
    num_outside: int
    """Nodes of the path outside the lumen that was found."""
    outside_mm: float
    """Length of the path outside that lumen, mm."""
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
    num_centers: int
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


@dataclass(frozen=True, slots=True, eq=False)
class Airways:
    """The airways of a volume.

    Examples
    --------
    >>> import carina
    >>> phantom = carina.generate_phantom(spacing_mm=3.0, generations=3)
    >>> airways = carina.find_airways(phantom.volume)
    >>> airways.lumen_zyx.shape == phantom.volume.shape_zyx
    True
    """

    lumen_zyx: NDArray[np.uint8]
    """(nz, ny, nx), 1 inside the lumen, read-only."""
    root_lps: NDArray[np.float64]
    """Where all paths begin, LPS mm."""
    tree: AirwayTree
    tracker: PathTracker
    threshold: float
    """Value at which the lumen ends (HU where the volume is in HU)."""
    notes: tuple[str, ...] = ()
    """What was limited or moved, in words."""
    wall_levels: tuple[float, float, float] | None = None
    """Values that tell lumen from wall on diagonal steps (certain air, half-way, rise); None for a given lumen."""
    edits: tuple[TreeEdit, ...] = ()
    """What a person changed since they were found, in order."""
    base: Airways | None = None
    """What was found, before the edits; None where there are none."""
    next_id: int | None = None
    """The first id that no branch ever had; None before the first edit."""
    uncertain: tuple[Uncertainty, ...] = ()
    """What could not be followed and why, the widest first; last, where the CT stops being trustworthy."""
    bridges: tuple[NDArray[np.float64], ...] = ()
    """(n, 3) LPS mm each: ways of the bridges that a person made and did not cut; what leads there stays a bridge."""
    evidence: KeptForVolume[Any] = field(default_factory=KeptForVolume, repr=False, compare=False)
    """What the CT shows of airways beyond those found, for edits; found when first needed, the same after each edit."""

    def __repr__(self) -> str:
        edited = f", {len(self.edits)} edits" if self.edits else ""
        return f"Airways({self.tree!r}, root_lps={as_words(self.root_lps)}, threshold={self.threshold:g}{edited})"

    def _repr_html_(self) -> str:
        """The tree, drawn and as a table, and what was found, in a notebook."""
        badges = {note.words for note in self.badges}
        more = [note for note in self.notes if note not in badges]
        if self.edits:
            more.append(f"{len(self.edits)} edits by a person")
        if self.uncertain:
            first = self.uncertain[0].reason
            more.append(f"{len(self.uncertain)} places that could not be followed; the widest: {first}")
        return self.tree.to_html(more)

    @property
    def badges(self) -> tuple[Note, ...]:
        """The lasting notes: a search that was stopped, a mask that is doubted. They go with the tree wherever it goes
        and stay through edits; their words are in ``notes`` too."""
        return self.tree.notes

    @property
    def report(self) -> tuple[str, ...]:
        """The notes."""
        return self.notes


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
class TrackResult:
    """Paths to several targets, and their common tree."""

    tree: AirwayTree
    targets: tuple[TargetResult, ...]
    airways: Airways
    search: GraphSearch | None = None
    """The graph that was searched and what that took; None for the cost ``lumen`` on the voxel graph."""
