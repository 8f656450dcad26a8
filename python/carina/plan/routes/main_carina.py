"""Origin of the distances along the airways: the ridge of the main carina, or a substitute if it is not known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from carina.argument_checks import check_arguments, check_fields, choice, instance, number_from
from carina.display import one_line
from carina.track import Airways, AirwayTree, Branch
from carina.track.measures.forks import find_forks
from carina.volume import Volume

OriginKind = Literal["ridge", "axes", "root", "route"]

SAME_PLACE_MM = 1e-6
AT_ORIGIN_MM = 0.5
"""Maximum distance in mm from the origin at which a text calls a point *at the origin*."""
MAIN_BRONCHI = ("RMB", "LMB")
AXES_NOTE = (
    "no ridge of the main carina was found; distances are measured from the point where the axes of the main bronchi "
    "meet, and the ridge lies about a tracheal radius below, so the scope shows that much less"
)


@one_line
@dataclass(frozen=True, slots=True)
class DistanceOrigin:
    """Origin of the distances along a route; distances are positive beyond the origin and negative before it.

    Examples
    --------
    >>> origin = DistanceOrigin("ridge", along_mm=120.0, axes_mm=110.0)
    >>> origin.past_mm(162.4), origin.words(origin.past_mm(162.4)), origin.fork_mm(110.0)
    (42.400000000000006, '42 mm past the main carina', 0.0)
    """

    kind: OriginKind = "root"
    """Point from which distances are measured.

    ``ridge``: the ridge of the main carina, which the scope shows. ``axes``: the point where the axes of the main
    bronchi meet, about a tracheal radius above the ridge, if no ridge of wall was found. ``root``: the start of the
    airway tree, if the route passes no main carina. ``route``: the start of the route, if its path was not searched in
    the airways and passes no main carina.
    """
    along_mm: float = 0.0
    """Distance of the origin from the root of the tree along the centrelines, mm.

    For a path that was not searched in the airways: from the start of the path, along the path.
    """
    axes_mm: float | None = None
    """Distance in mm from the root to the point where the axes of the main bronchi meet, measured like ``along_mm``.

    None if the route passes no main carina.
    """

    def __post_init__(self) -> None:
        """Raise an error if a field of this `DistanceOrigin` has an invalid value."""
        check_fields(
            self,
            kind=choice("ridge", "axes", "root", "route"),
            along_mm=number_from(0.0, 10_000.0, unit="mm"),
            axes_mm=number_from(0.0, 10_000.0, optional=True, unit="mm"),
        )

    @property
    def is_carina(self) -> bool:
        """Whether distances are measured from the main carina, at its ridge or at the axes of the main bronchi."""
        return self.kind in {"ridge", "axes"}

    @property
    def note(self) -> str | None:
        """Note of each output whose distances are measured from the axes of the main bronchi; None otherwise."""
        return AXES_NOTE if self.kind == "axes" else None

    @property
    def ridge_beyond_axes_mm(self) -> float | None:
        """Distance in mm of the ridge beyond the point where the axes of the main bronchi meet, or None."""
        return self.along_mm - self.axes_mm if self.kind == "ridge" and self.axes_mm is not None else None

    def past_mm(self, along_mm: float) -> float:
        """Return the distance in mm of a point from the origin.

        Parameters
        ----------
        along_mm
            Distance of the place from the root along the centrelines.
        """
        return along_mm - self.along_mm

    def from_carina_mm(self, along_mm: float) -> float | None:
        """Return the distance in mm of a point from the main carina; None if the route passes no main carina.

        Parameters
        ----------
        along_mm
            Distance of the place from the root along the centrelines.
        """
        return self.past_mm(along_mm) if self.is_carina else None

    def is_main_carina(self, along_mm: float) -> bool:
        """Return whether a fork of the centrelines is that of the main carina.

        Parameters
        ----------
        along_mm
            Distance of the fork from the root along the centrelines.
        """
        return self.axes_mm is not None and abs(along_mm - self.axes_mm) < SAME_PLACE_MM

    def fork_mm(self, along_mm: float) -> float:
        """Return the distance in mm of a fork of the centrelines from the origin.

        The result is 0 for the main carina itself, and for a fork between the axes and the ridge of the main carina.

        Parameters
        ----------
        along_mm
            Distance of the fork from the root along the centrelines.
        """
        past_mm = self.past_mm(along_mm)
        at_carina = self.axes_mm is not None and along_mm > self.axes_mm - SAME_PLACE_MM
        return max(past_mm, 0.0) if at_carina else past_mm

    def words(self, past_mm: float) -> str:
        """Return a distance from the origin as text, such as *42 mm past the main carina*."""
        if self.is_carina:
            return carina_words(past_mm)
        start = "route" if self.kind == "route" else "airway tree"
        return f"{past_mm:.0f} mm from the start of the {start}"

    def to_json(self) -> dict[str, Any]:
        """Return the origin as plain JSON types."""
        return {"kind": self.kind, "along_mm": self.along_mm}


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class RouteScale:
    """Distances along a flight route as plans, verdicts and reports state them."""

    origin: DistanceOrigin
    along_mm: NDArray[np.float64]
    """Distance in mm of each point of the route, ``(n,)``.

    Measured from the root of the tree along the centrelines or, for a path that was not searched in the airways, along
    the path from its start.
    """


ROOT = DistanceOrigin()
"""Origin at the start of the airway tree."""


def carina_words(past_mm: float) -> str:
    """Return a distance from the main carina as text.

    Examples
    --------
    >>> carina_words(41.6), carina_words(0.2), carina_words(-12.0)
    ('42 mm past the main carina', 'at the main carina', '12 mm above the main carina')
    """
    if abs(past_mm) < AT_ORIGIN_MM:
        return "at the main carina"
    return f"{abs(past_mm):.0f} mm {'past' if past_mm > 0.0 else 'above'} the main carina"


@check_arguments(
    volume=instance(Volume, "open a volume with carina.open_volume"),
    airways=instance(Airways, "get airways from carina.find_airways"),
)
def distance_origin(volume: Volume, airways: Airways) -> DistanceOrigin:
    """Return the origin of the distances along the routes that pass the main carina of the airways.

    Parameters
    ----------
    volume, airways
        The CT and its airways.

    Returns
    -------
    DistanceOrigin
        Of kind ``axes`` if no wall separates the main bronchi, and ``root`` if the tree has no main bronchus.

    Examples
    --------
    >>> import carina
    >>> made = carina.generate_phantom(seed=4, spacing_mm=1.5, generations=4)
    >>> carina.plan.distance_origin(made.volume, carina.find_airways(made.volume)).kind
    'ridge'
    """
    axes = axes_origin(airways.tree)
    mother = mother_of_main_bronchi(airways.tree)
    beyond_mm = None if mother is None else _ridge_beyond_axes_mm(volume, airways, mother)
    return axes if beyond_mm is None else replace(axes, kind="ridge", along_mm=axes.along_mm + beyond_mm)


def axes_origin(tree: AirwayTree) -> DistanceOrigin:
    """Return the point where the axes of the main bronchi meet as origin of distances; only the tree is used.

    The origin is the root if the tree has no main bronchus.
    """
    mother = mother_of_main_bronchi(tree)
    if mother is None:
        return ROOT
    axes_mm = sum(branch.length_mm for branch in tree.lineage(mother.id))
    return DistanceOrigin("axes", axes_mm, axes_mm)


def origins_of_branches(tree: AirwayTree, origin: DistanceOrigin) -> dict[int, DistanceOrigin]:
    """Return the origin of the distances in each branch, by branch ID.

    The origin of a branch that leaves the trachea above the main carina is the root, because the route to the branch
    does not pass the carina.

    Parameters
    ----------
    tree
        The airway tree.
    origin
        Origin of the tree (`distance_origin`).
    """
    mother = mother_of_main_bronchi(tree) if origin.is_carina else None
    if mother is None:
        return {branch.id: origin for branch in tree.branches}
    passing = {mother.id}
    # Parents precede their children in the tree.
    for branch in tree.branches:
        if branch.parent in passing:
            passing.add(branch.id)
    passing |= {branch.id for branch in tree.lineage(mother.id)}
    return {branch.id: origin if branch.id in passing else ROOT for branch in tree.branches}


def mother_of_main_bronchi(tree: AirwayTree) -> Branch | None:
    """Return the branch that ends in the main carina: the last common branch of the routes to both main bronchi.

    If only one main bronchus is known, the result is the branch before it. The result is None without a main bronchus,
    or if the tree begins in one.
    """
    first: dict[str, Branch] = {}
    for branch in tree.branches:
        if branch.name in MAIN_BRONCHI:
            first.setdefault(branch.name, branch)
    ways = [tree.lineage(branch.id)[:-1] for branch in first.values()]
    common = [mothers[0] for mothers in zip(*ways, strict=False) if all(one.id == mothers[0].id for one in mothers)]
    return common[-1] if common else None


def _ridge_beyond_axes_mm(volume: Volume, airways: Airways, mother: Branch) -> float | None:
    """Return how far the ridge of a fork is beyond the point where the axes of its branches meet, in mm.

    None if the branch does not end in a fork, or if no wall separates the branches.
    """
    if len(mother.children) < 2:
        return None
    ids = {mother.id, *mother.children}
    alone = AirwayTree(tuple(_without_rest(branch, ids) for branch in airways.tree.branches if branch.id in ids))
    return find_forks(volume, airways.lumen_zyx, alone)[0].fork_to_carina_mm


def _without_rest(branch: Branch, ids: set[int]) -> Branch:
    """Return a copy of a branch that keeps its parent and children only if they are among the given IDs."""
    parent = branch.parent if branch.parent in ids else None
    return replace(branch, parent=parent, children=tuple(i for i in branch.children if i in ids))
