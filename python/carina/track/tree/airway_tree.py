"""Airway tree: branches with centrelines, radii, generations and names, and routes along it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.argument_checks import (
    COORDINATE_MM,
    any_number,
    array_of,
    check_arguments,
    check_fields,
    choice,
    each,
    instance,
    lps_point,
    number_from,
    numbers_within,
    shown,
    text_of,
    whole_from,
)
from carina.breathing import ChestDeformation
from carina.display import as_words, one_line
from carina.display.centreline_drawing import DRAWN_COLOUR, Way, generation_colour, ways_svg
from carina.display.html import caption, figure, table
from carina.display.tables import Columns, Tabular, columns_of
from carina.errors import TrackingError, UsageError
from carina.volume.model import Note

FORMAT = "carina-tree"
VERSION = 1
KINDS = ("tracked", "bridge", "manual")
TREE_HEIGHT_PX = 320
MAX_ROWS = 12
"""Maximum number of rows of a tree's table in a notebook; a longer table is shortened."""
NAME_SOURCES = ("anatomy", "person")

Points = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Branch:
    """Piece of airway between two forks, or between a fork and a tip."""

    id: int
    """ID of the branch, unique in the tree; it stays the same through edits."""
    parent: int | None
    """ID of the parent branch; None at the root."""
    children: tuple[int, ...]
    """IDs of the branches that leave the end of the branch."""
    generation: int
    """Number of forks between the root and the branch: 0 in the trachea."""
    name: str | None
    """Anatomical name of the branch, if it is beyond doubt; otherwise None."""
    kind: str
    """``tracked`` through the lumen, ``bridge`` across an obstruction, or ``manual``: drawn, the CT shows no airway."""
    points: Points
    """Centreline (n, 3), LPS in mm, from root to tip. The first point equals the parent's last point, bit for bit."""
    radius: NDArray[np.float64]
    """Radius (n,) of the circle with the area of the *lumen that the search found* across the branch, in mm.

    At a fork it is that of the nearest section of this branch. The radius depends on the threshold of the search:
    use the diameters of :func:`carina.track.measure_tree` in reports. The largest ball that fits is smaller, see
    ``wall_distance``.
    """
    cost: float | None = None
    """Cost of the path along this branch (weight times mm); None if it was not tracked."""
    confidence: float | None = None
    """Confidence that the branch is an airway, 0 to 1; None if it was not judged."""
    name_confidence: float | None = None
    """Confidence of the name, 0 to 1; None without a name, and for a name that a user gave."""
    name_from: str | None = None
    """Source of the name: ``anatomy`` or ``person`` (a user, whose name is never replaced); None without a name."""
    variant: str | None = None
    """Text on uncommon anatomy of the branch, such as "RB1 and RB2 share a stem"; None if there is none."""
    doubtful_mm: float = 0.0
    """Length in mm along which the CT shows no wall; above 0 only in ``manual`` branches, which a user added.
    """
    wall_mm: NDArray[np.float64] | None = field(default=None, repr=False)
    """Distance (n,) to the wall in mm; None for a tree that was read from a file. See ``wall_distance``."""

    def __post_init__(self) -> None:
        """Raise an error if a field of the branch has an invalid type or value."""
        check_fields(
            self,
            id=whole_from(0, 2**31),
            parent=whole_from(0, 2**31, optional=True),
            children=each(whole_from(0, 2**31)),
            generation=whole_from(0, 1000),
            name=text_of(optional=True),
            kind=choice(*KINDS),
            points=instance(np.ndarray, "give an array (n, 3)"),
            radius=instance(np.ndarray, "give an array (n,)"),
            cost=number_from(-1e12, 1e12, optional=True),
            confidence=any_number(optional=True),
            name_confidence=any_number(optional=True),
            name_from=choice(*NAME_SOURCES, optional=True),
            variant=text_of(optional=True),
            doubtful_mm=any_number(),
            wall_mm=array_of(None, optional=True),
        )
        check_fields(self, points=numbers_within(), radius=numbers_within())
        _check_branch(self)

    def __repr__(self) -> str:
        """Return one line with ID, name, generation, length and median radius."""
        name = "" if self.name is None else f"{as_words(self.name)}, "
        width = f"radius {np.median(self.radius):.3g} mm" if len(self.radius) else "no radius"
        return f"Branch({self.id}, {name}generation {self.generation}, {self.length_mm:.3g} mm long, {width})"

    def as_way(self) -> Way:
        """Return the branch as a polyline of a drawing of the tree."""
        colour = DRAWN_COLOUR if self.kind == "manual" else generation_colour(self.generation)
        title = f"{self.name or f'branch {self.id}'}, generation {self.generation}, {self.length_mm:.0f} mm"
        return Way(self.points, 2.0 * float(np.median(self.radius)), colour, title)

    @property
    def length_mm(self) -> float:
        """Length of the branch's centreline, mm."""
        return float(_cumulative_mm(self.points)[-1])

    @property
    def wall_distance(self) -> NDArray[np.float64]:
        """Radius (n,) of the largest ball that fits at each point, in mm; at most ``radius``."""
        return self.radius if self.wall_mm is None else self.wall_mm

    @property
    def tip_lps(self) -> Points:
        """Last point of the centreline, LPS in mm."""
        tip: Points = self.points[-1]
        return tip


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class TreeRow:
    """Bronchus as one row of a listing: a branch, or the consecutive branches into which side branches divide it."""

    branches: tuple[Branch, ...]
    """Pieces from the trachea outwards, each of which begins at the end of the one before."""
    depth: int
    """Number of bronchi (rows of the branch list) between the root and this one: 0 for the trachea."""

    @property
    def id(self) -> int:
        """ID of the bronchus: that of its first branch (piece between two forks)."""
        return self.branches[0].id

    @property
    def name(self) -> str | None:
        """Name that all pieces of the bronchus share; None without a name."""
        return self.branches[0].name

    @property
    def generation(self) -> int:
        """Generation of the first piece of the bronchus."""
        return self.branches[0].generation

    @property
    def length_mm(self) -> float:
        """Total length of the pieces of the bronchus, mm."""
        return sum(branch.length_mm for branch in self.branches)

    @property
    def lumen_mm(self) -> tuple[float, float]:
        """Smallest and largest median diameter of the found lumen (``Branch.radius``) among the pieces, mm."""
        widths = [2.0 * float(np.median(branch.radius)) for branch in self.branches]
        return min(widths), max(widths)

    @property
    def calibre(self) -> str:
        """Text of ``lumen_mm`` with one decimal, such as "3.1 to 4.0"; one number if both are equal."""
        least, most = (f"{width:.1f}" for width in self.lumen_mm)
        return least if least == most else f"{least} to {most}"


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """Smooth path from the root to a tip, for a flight.

    All arrays have one entry per point. ``forks_mm`` are positions along ``cumulative_mm``.
    """

    points_lps: Points
    """Points (n, 3), LPS in mm, about 1 mm apart."""
    cumulative_mm: NDArray[np.float64]
    """Distance (n,) from the root along the path, in mm."""
    radius_mm: NDArray[np.float64]
    """Radius (n,) in mm of the branch at each point, see :attr:`Branch.radius`."""
    generation: NDArray[np.int32]
    """Generation (n,) of the branch at each point."""
    branch_ids: NDArray[np.int32]
    """ID (n,) of the branch at each point; at a fork that of the branch that ends there."""
    forks_mm: list[float]
    """Positions of the forks that the route passes, in mm from its start."""

    @property
    def length_mm(self) -> float:
        """Length of the whole route, mm."""
        return float(self.cumulative_mm[-1])


@dataclass(frozen=True, slots=True, eq=False)
class AirwayTree(Tabular):
    """Tree of airway branches with one root.

    As a table (``to_pandas``, ``to_arrow``, ``to_columns``) it has a row for each branch: ``id``, ``name``,
    ``generation``, ``parent``, ``kind``, ``length_mm``, ``lumen_found_mm`` (median diameter of ``Branch.radius``;
    that
    of reports is in the table of :func:`carina.measure_tree`), ``confidence``, ``name_confidence``, ``name_from``,
    ``doubtful_mm`` and the end of the branch, ``tip_x_mm``, ``tip_y_mm``, ``tip_z_mm`` (LPS).

    Examples
    --------
    >>> import numpy as np
    >>> trunk = Branch(0, None, (), 0, "Trachea", "tracked", np.array([[0.0, 0, 0], [0, 0, -10]]), np.array([8.0, 8]))
    >>> tree = AirwayTree((trunk,))
    >>> tree.route_to(0).length_mm
    10.0
    >>> AirwayTree.from_json(tree.to_json()).branches[0].name
    'Trachea'
    >>> tree.to_columns()["length_mm"]
    [10.0]
    """

    branches: tuple[Branch, ...]
    """Branches; parents come before their children."""
    notes: tuple[Note, ...] = field(default=(), kw_only=True)
    """Permanent notes that put the whole tree in doubt; they are stored with the tree in every file."""
    _smooth: Callable[[Points], tuple[Points, NDArray[np.float64]]] | None = field(default=None, repr=False)
    """Function that smooths a path inside the lumen: evenly spaced points and their radii. Not saved."""

    def __post_init__(self) -> None:
        """Raise an error for inconsistent branches or notes."""
        check_fields(
            self,
            branches=each(instance(Branch, "get branches from an AirwayTree"), least=1),
            notes=each(instance(Note, "create a carina.volume.Note")),
        )
        _check(self.branches)

    def __len__(self) -> int:
        """Return the number of branches."""
        return len(self.branches)

    def __repr__(self) -> str:
        """Return one line with the numbers of branches, tips and generations."""
        last = max(branch.generation for branch in self.branches)
        return f"AirwayTree({len(self.branches)} branches, {len(self.tips())} tips, generations 0 to {last})"

    def _repr_html_(self) -> str:
        """Return an HTML drawing from the front and a table of the tree, for a notebook."""
        return self.to_html()

    @check_arguments(more=each(text_of(20_000)))
    def to_html(self, more: Sequence[str] = ()) -> str:
        """Return HTML with a drawing from the front, a table of the first branches, and the lines of ``more``."""
        inner_first = sorted(self.branches, key=lambda branch: (branch.generation, branch.id))
        svg = ways_svg(
            [branch.as_way() for branch in inner_first[::-1]], height_px=320, alt="airway tree, from the front"
        )
        listed = sorted(self.rows(), key=lambda row: (row.generation, row.id))
        rows = [
            (row.name or f"branch {row.id}", row.generation, row.length_mm, row.calibre) for row in listed[:MAX_ROWS]
        ]
        num_named = sum(branch.name is not None for branch in self.branches)
        num_drawn = sum(branch.kind == "manual" for branch in self.branches)
        lines = [
            f"{len(self)} branches ({num_named} named), {len(self.tips())} tips, "
            f"generations 0 to {inner_first[-1].generation}"
            + (f"; the first {len(rows)} branches are listed" if len(listed) > len(rows) else ""),
            "seen from the front (patient's right on the left); line width: lumen; colour: generation",
            *([f"{num_drawn} branches drawn by hand, in amber"] if num_drawn else []),
            *more,
            *(f"! {note.words}" for note in self.notes),
        ]
        shown = table(("branch", "generation", "length, mm", "lumen found, mm"), rows)
        body = f'<div style="display:flex;flex-wrap:wrap;align-items:flex-start">{svg}{shown}</div>'
        return figure(body, caption(lines))

    def _columns(self) -> Columns:
        return columns_of(
            (
                {
                    "id": one.id,
                    "name": one.name,
                    "generation": one.generation,
                    "parent": one.parent,
                    "kind": one.kind,
                    "length_mm": one.length_mm,
                    "lumen_found_mm": 2.0 * float(np.median(one.radius)) if len(one.radius) else None,
                    "confidence": one.confidence,
                    "name_confidence": one.name_confidence,
                    "name_from": one.name_from,
                    "doubtful_mm": one.doubtful_mm,
                    **dict(zip(("tip_x_mm", "tip_y_mm", "tip_z_mm"), one.tip_lps.tolist(), strict=True)),
                }
                for one in self.branches
            ),
            {
                "id": "int",
                "name": "text",
                "generation": "int",
                "parent": "int",
                "kind": "text",
                "length_mm": "float",
                "lumen_found_mm": "float",
                "confidence": "float",
                "name_confidence": "float",
                "name_from": "text",
                "doubtful_mm": "float",
                "tip_x_mm": "float",
                "tip_y_mm": "float",
                "tip_z_mm": "float",
            },
        )

    @check_arguments(deformation=instance(ChestDeformation, "get one from carina.breathing.Breathing.at"))
    def deformed(self, deformation: ChestDeformation) -> AirwayTree:
        """Return the tree in the moved patient: the same branches with moved centrelines and new radii.

        Parameters
        ----------
        deformation
            Deformation of the chest; one that moves nothing returns this tree.

        Examples
        --------
        >>> import numpy as np
        >>> import carina
        >>> trunk = Branch(0, None, (), 0, "Trachea", "tracked", np.array([[0.0, 0, 0], [0, 0, -10]]), np.full(2, 8.0))
        >>> narrow = carina.breathing.ChestDeformation(np.diag([0.5, 0.5, 0.9, 1.0]))
        >>> moved = AirwayTree((trunk,)).deformed(narrow).root
        >>> moved.length_mm, moved.radius.tolist()
        (9.0, [4.0, 4.0])
        """
        if deformation.is_rest:
            return self
        moved = []
        for branch in self.branches:
            factor = deformation.radii_mm(branch.points, np.ones(len(branch.points)))
            moved.append(
                replace(
                    branch,
                    points=deformation.points(branch.points),
                    radius=branch.radius * factor,
                    wall_mm=None if branch.wall_mm is None else branch.wall_mm * factor,
                )
            )
        return AirwayTree(tuple(moved), notes=self.notes)

    @property
    def root(self) -> Branch:
        """Trunk of the tree: the branch without a parent."""
        return self.branches[0]

    @check_arguments(branch_id=whole_from(0, 2**31))
    def branch(self, branch_id: int) -> Branch:
        """Return the branch with the given ID.

        Raises
        ------
        UsageError
            If there is no such branch.
        """
        for branch in self.branches:
            if branch.id == branch_id:
                return branch
        msg = f"no branch has the id {branch_id}; the tree has {len(self.branches)} branches"
        raise UsageError(msg)

    def tips(self) -> list[Branch]:
        """Return the branches without children."""
        return [branch for branch in self.branches if not branch.children]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the branches, each once, in the order of the tree."""
        return tuple(dict.fromkeys(branch.name for branch in self.branches if branch.name is not None))

    @check_arguments(name=text_of(80))
    def named(self, name: str) -> Branch:
        """Return the first branch with the given name.

        Raises
        ------
        UsageError
            If no branch has the name; the message lists the names of the tree, as `names` does.

        Examples
        --------
        >>> import carina
        >>> phantom = carina.generate_phantom(spacing_mm=3.0, generations=3)
        >>> tree = carina.find_airways(phantom.volume).tree
        >>> tree.named("RMB").generation
        1
        >>> "RB99" in tree.names
        False
        """
        for branch in self.branches:
            if branch.name == name:
                return branch
        listed = f"the names in this tree are {', '.join(self.names)}" if self.names else "no branch has a name"
        raise UsageError(f"no branch is named {shown(name)}; {listed}")

    def rows(self) -> tuple[TreeRow, ...]:
        """Return the branches as rows of a listing, in the order of the tree; each branch is in one row.

        A bronchus that continues past a side branch consists of several branches but has one row. A branch continues
        the row of its parent if it has the parent's name from the same source, is of the same kind, and is the only
        child with these properties. Branches without a name are rows of their own.

        Examples
        --------
        >>> import numpy as np
        >>> def piece(number, parent, children, start_mm, name):
        ...     points = np.array([[0.0, 0, -start_mm], [0, 0, -start_mm - 10]])
        ...     return Branch(number, parent, children, number, name, "tracked", points, np.full(2, 2.0))
        >>> pieces = piece(0, None, (1, 2), 0, "RB6"), piece(1, 0, (), 10, "RB6"), piece(2, 0, (), 10, None)
        >>> [(row.name, row.length_mm, len(row.branches)) for row in AirwayTree(pieces).rows()]
        [('RB6', 20.0, 2), (None, 10.0, 1)]
        """
        by_id = {branch.id: branch for branch in self.branches}
        head_of: dict[int, int] = {}
        pieces: dict[int, list[Branch]] = {}
        # Parents come before their children.
        for branch in self.branches:
            head_of[branch.id] = branch.id
            if branch.parent is not None:
                parent = by_id[branch.parent]
                if [child for child in parent.children if _continues_in_child(parent, by_id[child])] == [branch.id]:
                    head_of[branch.id] = head_of[parent.id]
            pieces.setdefault(head_of[branch.id], []).append(branch)
        depths: dict[int, int] = {}
        for head, members in pieces.items():
            above = members[0].parent
            depths[head] = 0 if above is None else depths[head_of[above]] + 1
        return tuple(TreeRow(tuple(members), depths[head]) for head, members in pieces.items())

    @check_arguments(branch_id=whole_from(0, 2**31))
    def lineage(self, branch_id: int) -> list[Branch]:
        """Return the branches from the root to the given branch."""
        found = [self.branch(branch_id)]
        while found[-1].parent is not None:
            found.append(self.branch(found[-1].parent))
        return found[::-1]

    @check_arguments(point_lps=lps_point())
    def nearest_branch(self, point_lps: Sequence[float] | Points) -> tuple[Branch, int, float]:
        """Return the branch nearest to a point, the index of its nearest centreline point, and the distance in mm."""
        point = np.asarray(point_lps, dtype=np.float64)
        best: tuple[Branch, int, float] | None = None
        for branch in self.branches:
            distances = np.linalg.norm(branch.points - point, axis=1)
            index = int(np.argmin(distances))
            if best is None or distances[index] < best[2]:
                best = (branch, index, float(distances[index]))
        assert best is not None
        return best

    @check_arguments(branch_id=whole_from(0, 2**31))
    def route_to(self, branch_id: int) -> Route:
        """Return the route from the root to the tip of a branch.

        Raises
        ------
        UsageError
            If there is no such branch.
        """
        lineage = self.lineage(branch_id)
        points = np.concatenate([lineage[0].points, *(branch.points[1:] for branch in lineage[1:])])
        radius = np.concatenate([lineage[0].radius, *(branch.radius[1:] for branch in lineage[1:])])
        # Ends of the branches, in mm along the unsmoothed path.
        last = np.cumsum([len(branch.points) - (number > 0) for number, branch in enumerate(lineage)]) - 1
        ends_mm = _cumulative_mm(points)[last]
        return route_along(
            points, radius, ends_mm, [b.id for b in lineage], [b.generation for b in lineage], smooth=self._smooth
        )

    def to_json(self) -> dict[str, Any]:
        """Return the document ``carina-tree`` version 1 (docs/contracts.md)."""
        document = {
            "format": FORMAT,
            "version": VERSION,
            "space": "LPS",
            "unit": "mm",
            "root": self.root.id,
            "branches": [
                {
                    "id": branch.id,
                    "parent": branch.parent,
                    "children": list(branch.children),
                    "generation": branch.generation,
                    "name": branch.name,
                    "kind": branch.kind,
                    "points": branch.points.tolist(),
                    "radius": branch.radius.tolist(),
                    "cost": branch.cost,
                    "confidence": branch.confidence,
                    "name_confidence": branch.name_confidence,
                    "name_from": branch.name_from,
                    "variant": branch.variant,
                    "doubtful_mm": branch.doubtful_mm,
                }
                for branch in self.branches
            ],
        }
        if self.notes:
            document["badges"] = [{"code": note.code, "words": note.words} for note in self.notes]
        return document

    @classmethod
    def from_json(cls, document: object) -> AirwayTree:
        """Read a document ``carina-tree`` version 1; unknown keys are ignored.

        Raises
        ------
        TrackingError
            If the document is not such a tree; the message names the branch and the error.
        """
        if not isinstance(document, Mapping):
            raise _refused(f"expected a JSON object, found {type(document).__name__}")
        for key, expected in (("format", FORMAT), ("version", VERSION), ("space", "LPS"), ("unit", "mm")):
            if document.get(key) != expected:
                raise _refused(f"{key} must be {expected!r}, found {document.get(key)!r}")
        rows = document.get("branches")
        if not isinstance(rows, Sequence) or isinstance(rows, str) or not rows:
            raise _refused("branches must be a list of at least one branch")
        branches = [_read_branch(row, number) for number, row in enumerate(rows)]
        if len({branch.id for branch in branches}) != len(branches):
            raise _refused("two branches have the same id")
        root = document.get("root")
        by_id = {branch.id: branch for branch in branches}
        if not isinstance(root, int) or root not in by_id:
            raise _refused(f"no branch has the id of the root, {root!r}")
        # Parents first, children in the order of their parent's list.
        ordered: list[Branch] = []
        waiting = [root]
        while waiting:
            branch_id = waiting.pop()
            if branch_id not in by_id:
                raise _refused(f"branch {branch_id} is listed as a child, but is missing or reached twice")
            branch = by_id.pop(branch_id)
            ordered.append(branch)
            waiting.extend(reversed(branch.children))
        if by_id:
            raise _refused(f"branch {next(iter(by_id))} is not connected to the root")
        return cls(tuple(ordered), notes=_read_badges(document.get("badges", ())))


def _continues_in_child(parent: Branch, child: Branch) -> bool:
    return (
        parent.name is not None
        and (child.name, child.name_from) == (parent.name, parent.name_from)
        and child.kind == parent.kind
    )


def route_along(
    points: Points,
    radius: NDArray[np.float64],
    ends_mm: NDArray[np.float64],
    branch_ids: Sequence[int],
    generations: Sequence[int],
    *,
    smooth: Callable[[Points], tuple[Points, NDArray[np.float64]]] | None,
) -> Route:
    """Return a route along points whose branches end at ``ends_mm``, smoothed as a whole if ``smooth`` is given."""
    along = _cumulative_mm(points)
    total = along[-1]
    if smooth is not None and len(points) > 3 and total > 0.0:
        points, _ = smooth(points)
        # The smoothed points are evenly spaced along the given ones.
        given_mm = np.linspace(0.0, total, len(points))
        radius = np.interp(given_mm, along, radius)
        along = _cumulative_mm(points)
    else:
        given_mm = along
    which = np.minimum(np.searchsorted(ends_mm, given_mm - 1e-9 * max(total, 1.0)), len(branch_ids) - 1)
    return Route(
        points_lps=points,
        cumulative_mm=along,
        radius_mm=radius,
        generation=np.asarray(generations, dtype=np.int32)[which],
        branch_ids=np.asarray(branch_ids, dtype=np.int32)[which],
        forks_mm=[float(np.interp(end, given_mm, along)) for end in ends_mm[:-1]],
    )


def _cumulative_mm(points: Points) -> NDArray[np.float64]:
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _refused(reason: str) -> TrackingError:
    return TrackingError(f"this is not a usable airway tree: {reason}", code="track.tree-format")


def _read_badges(rows: object) -> tuple[Note, ...]:
    if not isinstance(rows, Sequence) or isinstance(rows, str):
        raise _refused("badges must be a list")
    notes = []
    for number, row in enumerate(rows):
        code, words = (row.get("code"), row.get("words")) if isinstance(row, Mapping) else (None, None)
        if not isinstance(code, str) or not isinstance(words, str):
            raise _refused(f"badge {number} in the list must have code and words, both text")
        notes.append(Note(code, words, badge=True))
    return tuple(notes)


def _read_branch(row: object, number: int) -> Branch:
    where = f"branch {number} in the list"
    if not isinstance(row, Mapping):
        raise _refused(f"{where}: expected a JSON object, found {type(row).__name__}")

    def whole_from(key: str, value: object) -> int:
        if isinstance(value, bool) or not isinstance(value, int):
            raise _refused(f"{where}: {key} must be a whole number, found {value!r}")
        return value

    def text_or_none(key: str) -> str | None:
        value = row.get(key)
        if value is not None and not isinstance(value, str):
            raise _refused(f"{where}: {key} must be text or null, found {value!r}")
        return value

    def number_or_none(key: str) -> float | None:
        value = row.get(key)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise _refused(f"{where}: {key} must be a finite number or null, found {value!r}")
        return float(value)

    branch_id = whole_from("id", row.get("id"))
    where = f"branch {branch_id}"
    parent = row.get("parent")
    name, name_from = text_or_none("name"), text_or_none("name_from")
    kind = row.get("kind")
    children = row.get("children")
    if name_from is not None and name_from not in NAME_SOURCES:
        raise _refused(f"{where}: name_from must be one of {', '.join(NAME_SOURCES)} or null, found {name_from!r}")
    if not isinstance(kind, str) or kind not in KINDS:
        raise _refused(f"{where}: kind must be one of {', '.join(KINDS)}, found {kind!r}")
    if not isinstance(children, Sequence) or isinstance(children, str):
        raise _refused(f"{where}: children must be a list of ids")
    try:
        points = np.array(row.get("points"), dtype=np.float64)
        radius = np.array(row.get("radius"), dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise _refused(f"{where}: points must be a list of [x, y, z], radius a list of numbers") from None
    return Branch(
        id=branch_id,
        parent=None if parent is None else whole_from("parent", parent),
        children=tuple(whole_from("children", child) for child in children),
        generation=whole_from("generation", row.get("generation")),
        name=name,
        kind=kind,
        points=points,
        radius=radius,
        cost=number_or_none("cost"),
        confidence=number_or_none("confidence"),
        name_confidence=number_or_none("name_confidence"),
        name_from=name_from,
        variant=text_or_none("variant"),
        doubtful_mm=number_or_none("doubtful_mm") or 0.0,
    )


def _check_branch(branch: Branch) -> None:
    """Raise an error for a branch with impossible numbers."""
    where = f"branch {branch.id}"
    points, radius = branch.points, branch.radius
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 1 or not np.isfinite(points).all():
        raise _refused(f"{where}: points must be a list of finite [x, y, z]")
    if radius.shape != (len(points),) or not np.isfinite(radius).all() or (radius < 0).any():
        raise _refused(f"{where}: radius must contain one number of at least 0 for each of its {len(points)} points")
    if branch.confidence is not None and not 0.0 <= branch.confidence <= 1.0:
        raise _refused(f"{where}: confidence must be between 0 and 1, found {branch.confidence}")
    if branch.name_confidence is not None and not 0.0 <= branch.name_confidence <= 1.0:
        raise _refused(f"{where}: name_confidence must be between 0 and 1, found {branch.name_confidence}")
    if not 0.0 <= branch.doubtful_mm <= COORDINATE_MM:
        raise _refused(f"{where}: doubtful_mm must be at least 0, found {branch.doubtful_mm}")


def _check(branches: tuple[Branch, ...]) -> None:
    """Raise an error for an inconsistent tree, whose geometry would otherwise be wrong without notice."""
    if not branches:
        raise _refused("it has no branches")
    seen: dict[int, Branch] = {}
    for number, branch in enumerate(branches):
        where = f"branch {branch.id}"
        if (branch.parent is None) != (number == 0):
            raise _refused(f"{where}: the root, and only the root, must have no parent")
        if branch.parent is not None:
            parent = seen.get(branch.parent)
            if parent is None or branch.id not in parent.children:
                raise _refused(f"{where}: its parent {branch.parent} does not list it as a child")
            if not np.array_equal(branch.points[0], parent.points[-1]):
                raise _refused(f"{where}: its first point is not the last point of its parent {branch.parent}")
        if branch.generation < 0:
            raise _refused(f"{where}: generation must be at least 0, found {branch.generation}")
        seen[branch.id] = branch
    for branch in branches:
        for child in branch.children:
            if child not in seen or seen[child].parent != branch.id:
                raise _refused(f"branch {branch.id}: its child {child} is missing or has a different parent")
