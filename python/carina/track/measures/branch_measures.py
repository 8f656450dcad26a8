"""Measurement of an airway tree: a section across every centreline point, and summaries of branches and forks."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from carina._core import cast_sections
from carina.argument_checks import check_arguments, function, instance
from carina.display import one_line
from carina.display.progress import ProgressChoice, fraction_callback, progress_function, shows_progress
from carina.display.tables import Columns, Tabular, columns_of
from carina.errors import CancelledError, UsageError
from carina.track.find.result import Airways
from carina.track.intensity_levels import AirScale, air_scale
from carina.track.measures.branch_summary import (
    BranchSummary,
    Stenosis,
    diameter_by_neighbours,
    stenosis_of,
    summary_of,
)
from carina.track.measures.diameter import (
    Diameter,
    Passage,
    narrowest_diameter,
    narrowest_of_passages,
    passage_of,
    with_scatter,
)
from carina.track.measures.forks import (
    ForkMeasures,
    angle_deg,
    directions,
    find_forks,
    junction_flags,
    run_mm,
)
from carina.track.progress import Cancel, Progress
from carina.track.tree.airway_tree import AirwayTree, Branch
from carina.version import VERSION as CARINA_VERSION
from carina.volume.model import Volume

if TYPE_CHECKING:
    from carina._core import SectionCasts

__all__ = [
    "RAYS_PER_MM",
    "BranchMeasures",
    "BranchSummary",
    "ForkMeasures",
    "Stenosis",
    "TreeMeasures",
    "measure_tree",
]

Floats = NDArray[np.float64]

_SECTION_FIGURES = (
    "area_mm2",
    "equivalent_mm",
    "min_mm",
    "max_mm",
    "wall_mm",
    "area_error_mm2",
    "equivalent_error_mm",
    "min_error_mm",
    "max_error_mm",
    "wall_error_mm",
    "shift_mm",
)
FORMAT = "carina-measures"
VERSION = 1
METHOD = 2
"""Version of the method by which sections are measured; version 1 (before decision 0117) assumed a flat wall."""

MIN_CONTRAST_HU = 100.0
"""Minimum rise in HU of a wall above the lumen, if 4 standard deviations of the noise are less."""
BRIGHTEST_WALL_HU = 100.0
"""Upper limit in HU of wall values, so that calcified cartilage and enhanced vessels have no effect."""
WALL_RISE_HU = 1020.0
"""Rise in HU of an airway wall (soft tissue of 20 HU) above air; a thinner wall shows less in proportion."""
USUAL_NOISE_HU = 25.0
OPEN_SHARE = 0.9
"""Share of a section's rays that meet a wall, below which the lumen is open to another branch's lumen, as at a fork."""
MIN_EDGE_SHARE = 0.5
"""Minimum share of rays that meet a wall, for a section cut by the edge of the CT that a route's diameter may use."""
RAYS_PER_MM = 1024.0
"""Number of steps per mm to which ray lengths are rounded.

A step is a hundredth of the rays' error, and rounding reduces the stored size to a quarter.
"""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class BranchMeasures(Tabular):
    """Sections of one branch, one for every point of its centreline; NaN where there is no section.

    Errors are half of an interval that is to contain the true value in 95 of 100 cases. As a table (``to_pandas``,
    ``to_arrow``, ``to_columns``) it has a row for each section, with the fields that contain one figure per section,
    the centre as ``centre_x_mm``, ``centre_y_mm``, ``centre_z_mm`` (LPS), and ``is_usable``.
    """

    branch_id: int
    at_mm: Floats
    """Distance (n,) of each section from the start of the branch, mm."""
    centre_lps: Floats
    """Centre (n, 3) of the measured lumen in each section, LPS in mm."""
    normal_lps: Floats
    """Unit vector (n, 3) along the branch at each section, LPS."""
    area_mm2: Floats
    """Area (n,) of the lumen in each section, mm2."""
    equivalent_mm: Floats
    """Diameter (n,) of the circle with the area of the lumen in each section, mm."""
    min_mm: Floats
    """Least width (n,) of the lumen in each section, measured through its centre, mm; NaN if it was not measured."""
    max_mm: Floats
    """Greatest width (n,) of the lumen in each section, measured through its centre, mm; NaN if it was not measured."""
    wall_mm: Floats
    """Thickness (n,) of the wall in mm, where neither a vessel nor the mediastinum touches its outer side."""
    at_junction: NDArray[np.bool_]
    """Flags (n,): True for sections that cut through a fork; the summary does not use these sections."""
    at_edge: NDArray[np.bool_]
    """Flags (n,): whether rays left the volume before they met a wall.

    Such sections are incomplete and left out of the summary.
    """
    area_error_mm2: Floats
    equivalent_error_mm: Floats
    min_error_mm: Floats
    max_error_mm: Floats
    wall_error_mm: Floats
    shift_mm: Floats
    """Displacement (n,) of the edges outwards from the half-maximum in mm, to correct for the scanner's blur."""
    edge_mm: Floats
    """Distance (n, 64) of the lumen's edge from the centre, rounded to 1/1024 mm.

    The rays have equal angles, starting from ``section_axes(normal)``.
    """
    outer_mm: Floats
    """Distance (n, 64) of the wall's outer side from the centre in mm, on the rays of ``edge_mm``."""
    share: Floats
    """Share (n,) of the 64 rays of a section that met a wall, 0 to 1."""
    summary: BranchSummary
    """Summary of the branch."""
    found_by: str = CARINA_VERSION
    """Version of Carina that measured the sections."""
    method: int = METHOD
    """Method by which the sections were measured, see :data:`METHOD`."""

    @property
    def is_by_earlier_method(self) -> bool:
        """Whether an earlier method measured the sections; its diameters of small airways differ by up to a third."""
        return self.method != METHOD

    @property
    def is_usable(self) -> NDArray[np.bool_]:
        """Flags (n,): True for sections that the summary uses."""
        usable: NDArray[np.bool_] = np.isfinite(self.equivalent_mm) & ~self.at_junction & ~self.at_edge
        return usable

    def _columns(self) -> Columns:
        figures = {"at_mm": self.at_mm}
        figures |= {f"centre_{axis}_mm": self.centre_lps[:, n] for n, axis in enumerate("xyz")}
        figures |= {name: getattr(self, name) for name in _SECTION_FIGURES}
        columns: Columns = {name: ("float", _as_list(values)) for name, values in figures.items()}
        flags = {"at_junction": self.at_junction, "at_edge": self.at_edge, "is_usable": self.is_usable}
        return columns | {name: ("flag", values.tolist()) for name, values in flags.items()}

    def diameter_near(self, point_lps: Floats) -> float | None:
        """Return the diameter (mm) of the nearest section that the summary uses; None without one."""
        used = np.flatnonzero(self.is_usable)
        if not len(used):
            return None
        away = np.square(self.centre_lps[used] - point_lps).sum(axis=1)
        return float(self.equivalent_mm[used[int(np.argmin(away))]])

    def narrowest(self, until_mm: float = math.inf) -> Diameter | None:
        """Return the narrowest diameter up to a length along the branch; None without a usable section."""
        used = self.is_usable & (self.at_mm <= until_mm)
        return narrowest_diameter(
            self.at_mm[used], self.equivalent_mm[used], self.equivalent_error_mm[used], branch_id=self.branch_id
        )

    def passage(self, *, has_fork: bool, parent_mm: float = 0.0) -> Passage:
        """Return the diameter of the widest instrument that can pass each point of the branch.

        Parameters
        ----------
        has_fork
            Whether the branch ends in a fork.
        parent_mm
            Diameter of the parent, mm. Sections that are missing inside the parent's lumen leave no gap.
        """
        # Rays that end outside the CT do not show an opening to another lumen.
        is_cut = self.at_edge & (self.share < OPEN_SHARE)
        return passage_of(
            self.branch_id,
            self.at_mm,
            (self.equivalent_mm, self.equivalent_error_mm),
            (self.min_mm, self.min_error_mm),
            is_measured=np.isfinite(self.equivalent_mm) & (~self.at_edge | (self.share >= MIN_EDGE_SHARE)),
            at_junction=self.at_junction & ~is_cut,
            is_cut=is_cut,
            has_fork=has_fork,
            parent_mm=parent_mm,
        )

    def to_json(self) -> dict[str, Any]:
        """Return the sections as JSON values without the rays; None where there is no figure."""
        return {
            "branch": self.branch_id,
            "by_earlier_method": self.is_by_earlier_method,
            "summary": self.summary.to_json(),
            "centre_lps": np.round(self.centre_lps, 3).tolist(),
            "normal_lps": np.round(self.normal_lps, 5).tolist(),
            **{name: _as_list(getattr(self, name)) for name in ("at_mm", *_SECTION_FIGURES)},
            "at_junction": self.at_junction.tolist(),
            "at_edge": self.at_edge.tolist(),
        }


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class TreeMeasures(Tabular):
    """Measurements of an airway tree: sections, forks and branch summaries.

    As a table (``to_pandas``, ``to_arrow``, ``to_columns``) it has a row for each branch: ``id``, ``name``,
    ``generation``, ``parent``, ``kind``, the figures of `BranchSummary` by their names (``mean_mm`` is the diameter
    of the branch), and ``stenosis_percent``, which is None without a stenosis.

    Examples
    --------
    >>> import carina
    >>> volume = carina.generate_phantom(spacing_mm=2.5, generations=3, noise_hu=0).volume
    >>> table = carina.measure_tree(volume, carina.find_airways(volume)).to_columns()
    >>> table["name"][0], 15.0 < table["mean_mm"][0] < 21.0
    ('Trachea', True)
    """

    branches: tuple[BranchMeasures, ...]
    """Measures of the branches, in the order of the tree."""
    forks: tuple[ForkMeasures, ...]
    """Measurements of the forks, in the order of the branches."""
    blur_mm: tuple[float, float] | None
    """Blur of the scan within and across its slices, as standard deviations in mm; None if it could not be measured.

    Without it edges are placed at the half-maximum, and small lumens are underestimated.
    """
    noise: float
    """Standard deviation of the voxel values in the trachea, in the unit of the volume (HU for a CT in HU)."""
    notes: tuple[str, ...] = ()
    """Notes for the user on the measurement, such as that the blur of the CT could not be measured."""
    _keys: tuple[bytes, ...] = dataclasses.field(default=(), repr=False)
    """Cache key of each branch: the data from which the branch was measured (see :func:`measure_tree`)."""
    _measured: tuple[Branch, ...] = dataclasses.field(default=(), repr=False)
    """Branches that were measured, in the same order: the table contains their names."""
    _passages: dict[int, Passage] = dataclasses.field(default_factory=dict, init=False, repr=False)
    """Cache of the passages by branch ID: each plan reads those of all branches several times."""

    @classmethod
    def made_before(
        cls,
        tree: AirwayTree,
        branches: tuple[BranchMeasures, ...],
        forks: tuple[ForkMeasures, ...],
        *,
        blur_mm: tuple[float, float] | None,
        noise: float,
        notes: tuple[str, ...],
    ) -> TreeMeasures:
        """Return measures that were restored from storage; after an edit of the tree they are reused.

        Parameters
        ----------
        tree
            Tree that was measured.
        branches, forks, blur_mm, noise, notes
            Stored values.

        Raises
        ------
        UsageError
            If the sections do not match the centrelines of the tree.
        """
        for branch, measures in zip(tree.branches, branches, strict=True):
            if branch.id != measures.branch_id or len(branch.points) != len(measures.at_mm):
                raise UsageError(
                    f"expected {len(branch.points)} sections of branch {branch.id}; "
                    f"found {len(measures.at_mm)} of branch {measures.branch_id}"
                )
        keys = tuple(_key(branch, tree) for branch in tree.branches)
        return cls(branches, forks, blur_mm, noise, notes, keys, tree.branches)

    def _columns(self) -> Columns:
        figures = [
            field.name
            for field in dataclasses.fields(BranchSummary)
            if field.name not in {"measured_stenosis", "num_sections"}
        ]
        return columns_of(
            (
                {
                    "id": branch.id,
                    "name": branch.name,
                    "generation": branch.generation,
                    "parent": branch.parent,
                    "kind": branch.kind,
                    "num_sections": measures.summary.num_sections,
                    **{name: getattr(measures.summary, name) for name in figures},
                    "stenosis_percent": None
                    if measures.summary.stenosis is None
                    else measures.summary.stenosis.percent,
                }
                for branch, measures in zip(self._measured, self.branches, strict=True)
            ),
            {
                "id": "int",
                "name": "text",
                "generation": "int",
                "parent": "int",
                "kind": "text",
                "num_sections": "int",
                **dict.fromkeys(figures, "float"),
                "stenosis_percent": "float",
            },
        )

    def of(self, branch_id: int) -> BranchMeasures:
        """Return the measures of a branch.

        Raises
        ------
        UsageError
            If there is no such branch.
        """
        for branch in self.branches:
            if branch.branch_id == branch_id:
                return branch
        msg = f"no branch has the id {branch_id}; {len(self.branches)} branches were measured"
        raise UsageError(msg)

    def fork_of(self, branch_id: int) -> ForkMeasures | None:
        """Return the fork at the end of a branch; None at a tip."""
        return next((fork for fork in self.forks if fork.branch_id == branch_id), None)

    def passage(self, branch_id: int) -> Passage:
        """Return the diameter of the widest instrument that can pass each point of a branch.

        Raises
        ------
        UsageError
            If there is no such branch.
        """
        known = self._passages.get(branch_id)
        if known is not None:
            return known
        has_fork = self.fork_of(branch_id) is not None
        parent = next((fork.branch_id for fork in self.forks if branch_id in fork.children), None)
        if parent is None:
            found = self.of(branch_id).passage(has_fork=has_fork).without_start()
        else:
            parent_mm = self.of(parent).summary.mean_mm
            found = self.of(branch_id).passage(has_fork=has_fork, parent_mm=parent_mm or 0.0)
        self._passages[branch_id] = found
        return found

    def narrowest_of_route(self, branch_ids: Iterable[int], until_mm: float = math.inf) -> Diameter | None:
        """Return the diameter of the widest instrument that can pass a route; None if nothing was measured.

        The error of the diameter is half of an interval that is to contain the true value in 90 of 100 cases. Parts
        without sections are ignored; a planned route reports them too (:attr:`carina.plan.PlannedRoute.width`).

        Parameters
        ----------
        branch_ids
            Branches of the route, from the trachea.
        until_mm
            Length along the last branch to the end of the route.
        """
        ids = list(dict.fromkeys(branch_ids))
        passages = [self.passage(branch_id) for branch_id in ids]
        if passages:
            passages[-1] = passages[-1].until(until_mm)
        return narrowest_of_passages(passages)

    def to_json(self) -> dict[str, Any]:
        """Return the document ``carina-measures`` version 1: LPS, mm, degrees; errors are half of a 95 % interval.

        A stenosis is null if it does not exceed its error, also in measurements of an earlier version.
        """
        return {
            "format": FORMAT,
            "version": VERSION,
            "space": "LPS",
            "unit": "mm",
            "blur_mm": None if self.blur_mm is None else list(self.blur_mm),
            "noise": self.noise,
            "notes": list(self.notes),
            "branches": [branch.to_json() for branch in self.branches],
            "forks": [fork.to_json() for fork in self.forks],
        }


@shows_progress
@check_arguments(
    volume=instance(Volume, "open a volume with carina.open_volume"),
    airways=instance(Airways, "get airways from carina.find_airways"),
    previous=instance(TreeMeasures, "get measures from carina.measure_tree", optional=True),
    cancel=function,
)
def measure_tree(
    volume: Volume,
    airways: Airways,
    *,
    previous: TreeMeasures | None = None,
    progress: ProgressChoice = None,
    cancel: Cancel | None = None,
) -> TreeMeasures:
    """Measure every branch of the airways in sections across its centreline.

    Parameters
    ----------
    volume
        The CT in which the airways were found. Sections are measured in its values, even if the lumen is an imported
        mask.
    airways
        Airways with lumen and tree.
    previous
        Measures of these airways before an edit: unchanged branches are reused, with the blur and the noise of the
        scan. Forks and summaries are always computed again. Measures by an earlier method are not used.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is None while the progress is unknown.
    cancel
        Function that is called often; the calculation stops when it returns True.

    Returns
    -------
    TreeMeasures
        Sections (area, equivalent, least and greatest diameter, wall), forks and summaries. Branches that the CT
        does not show (drawn by hand, bridges) have a length and no other figure, and sections in interpolated slices
        have none. A stenosis is None if it does not
        exceed its error.

    Raises
    ------
    CancelledError
        If ``cancel()`` returned True.

    See Also
    --------
    TreeMeasures : its ``to_pandas()``, ``to_arrow()`` and ``to_columns()`` are a table with a row for each branch.

    Notes
    -----
    Edges are half-way between the lumen's lowest value and the wall's peak along each of 64 rays. The edges are then
    corrected for the blur of the scan: a tube of soft tissue is fitted whose blurred image has these edges and rises
    (``docs/decisions/0117``).

    Examples
    --------
    >>> from carina import generate_phantom
    >>> from carina.track import find_airways, measure_tree
    >>> volume = generate_phantom(spacing_mm=2.5, generations=3, noise_hu=0).volume
    >>> measures = measure_tree(volume, find_airways(volume))
    >>> 15.0 < measures.of(0).summary.mean_mm < 21.0
    True
    """
    tree = airways.tree
    if previous is not None and any(branch.is_by_earlier_method for branch in previous.branches):
        previous = None
    report = progress_function(progress)
    if report is not None:
        report("measuring the airways", 0.0)
    _raise_if_cancelled(cancel)
    scale = air_scale(volume)
    noise = _noise_in_trunk(volume, tree.root, scale) if previous is None else previous.noise
    keys = tuple(_key(branch, tree) for branch in tree.branches)
    known = {} if previous is None else dict(zip(previous._keys, previous.branches, strict=True))
    fresh = [number for number, key in enumerate(keys) if key not in known]
    normals = [_normals(branch, tree) for branch in tree.branches]
    casts = _cast(
        volume,
        [tree.branches[number] for number in fresh],
        [normals[number] for number in fresh],
        scale=scale,
        noise=noise,
        progress=report,
        cancel=cancel,
    )
    blur = casts.blur() if previous is None else previous.blur_mm
    rows = casts.measure(blur)
    _raise_if_cancelled(cancel)
    forks = find_forks(volume, airways.lumen_zyx, tree)
    fork_of = {fork.branch_id: fork for fork in forks}
    begins = np.cumsum([0, *(len(tree.branches[number].points) for number in fresh)])
    sections: list[dict[str, Any]] = []
    for number, branch in enumerate(tree.branches):
        if keys[number] in known:
            old = known[keys[number]]
            columns = {name: getattr(old, name) for name in (*_COLUMNS, "at_mm", "found_by")}
        else:
            first = begins[fresh.index(number)]
            columns = _columns(rows, slice(first, first + len(branch.points)), normals[number])
            if branch.kind != "tracked":
                # Where the CT shows no airway, sections are set to NaN, so that no calibre and no narrowing is reported
                # there.
                columns = {name: np.full_like(v, np.nan) if name in _FIGURES else v for name, v in columns.items()}
            else:
                unseen = _in_interpolated_slices(volume, branch)
                for name in _FIGURES if unseen.any() else ():
                    columns[name][unseen] = np.nan
            columns |= {"at_mm": run_mm(branch.points), "found_by": CARINA_VERSION}
        parent = None if branch.parent is None else tree.branch(branch.parent)
        flags = junction_flags(
            branch,
            normals[number],
            None if parent is None else fork_of.get(parent.id),
            fork_of.get(branch.id),
            None if parent is None else float(np.median(parent.radius)),
        )
        flags |= columns["share"] < OPEN_SHARE
        if keys[number] not in known:
            columns |= _errors_with_scatter(columns, flags)
        sections.append({**columns, "at_junction": flags})
    measured = tuple(
        known[key] if key in known and _has_same_inputs(known[key], one) else one
        for key, one in zip(keys, _summaries(tree, sections), strict=True)
    )
    notes = []
    if blur is None:
        notes.append(
            "the blur of the scan could not be measured, so edges are placed at half maximum and small lumens "
            "are underestimated"
        )
    if report is not None:
        report("airways measured", 1.0)
    return TreeMeasures(measured, forks, blur, noise, tuple(notes), keys, tree.branches)


def _in_interpolated_slices(volume: Volume, branch: Branch) -> NDArray[np.bool_]:
    """Return the points (n,) of a branch whose nearest slice was interpolated: no calibre was measured there."""
    levels = np.rint(volume.to_ijk(branch.points)[:, 2])
    return np.isin(levels, volume.source.interpolated_slices)


_COLUMNS = [
    "centre_lps",
    "normal_lps",
    "area_mm2",
    "equivalent_mm",
    "min_mm",
    "max_mm",
    "wall_mm",
    "at_edge",
    "area_error_mm2",
    "equivalent_error_mm",
    "min_error_mm",
    "max_error_mm",
    "wall_error_mm",
    "shift_mm",
    "edge_mm",
    "outer_mm",
    "share",
]
_FIGURES = {name for name in _COLUMNS if name.endswith(("_mm", "_mm2"))}


def _raise_if_cancelled(cancel: Cancel | None) -> None:
    if cancel is not None and cancel():
        raise CancelledError("stopped while measuring the airways")


def _key(branch: Branch, tree: AirwayTree) -> bytes:
    """Return the cache key of a branch's sections: its ID, kind and points, and its parent's end for a single point."""
    before = b""
    if len(branch.points) == 1 and branch.parent is not None:
        before = tree.branch(branch.parent).points[-2:].tobytes()
    return np.int64(branch.id).tobytes() + branch.kind.encode() + branch.points.tobytes() + before


def _has_same_inputs(old: BranchMeasures, new: BranchMeasures) -> bool:
    """Return whether an edit leaves the data unchanged from which a branch's summary and fork sections are computed."""
    return old.summary == new.summary and np.array_equal(old.at_junction, new.at_junction)


def _normals(branch: Branch, tree: AirwayTree) -> Floats:
    before = None
    if branch.parent is not None:
        points = tree.branch(branch.parent).points
        before = points[-2] if len(points) > 1 else None
    normals = directions(branch.points, branch.radius, before)
    # A branch of length 0 has no direction; its section is placed parallel to the axial plane.
    normals[np.linalg.norm(normals, axis=1) < 0.5] = [0.0, 0.0, 1.0]
    return normals


def _cast(
    volume: Volume,
    branches: list[Branch],
    normals: list[Floats],
    *,
    scale: AirScale,
    noise: float,
    progress: Progress | None,
    cancel: Cancel | None,
) -> SectionCasts:
    none = np.zeros((0, 3))
    # At least the median radius of the branch: beside a fork the distance to the wall is not a width.
    radius = [np.minimum(np.maximum(branch.radius, np.median(branch.radius)), 30.0) for branch in branches]
    return cast_sections(
        volume.hu_zyx,
        volume.lps_from_ijk,
        np.concatenate([none, *(branch.points for branch in branches)]),
        np.concatenate([none, *normals]),
        np.concatenate([np.zeros(0), *radius]),
        min_contrast=scale.span(MIN_CONTRAST_HU),
        brightest_wall=scale.level(BRIGHTEST_WALL_HU),
        wall_rise=scale.span(WALL_RISE_HU),
        noise=noise,
        cancel=cancel,
        progress=fraction_callback(progress, "measuring the airways", 0.0, 0.95),
    )


def _noise_in_trunk(volume: Volume, trunk: Branch, scale: AirScale) -> float:
    """Return the standard deviation of values well inside the trachea, estimated from the median deviation."""
    rest = []
    shape = np.array(volume.shape_zyx[::-1])
    for point, radius in zip(trunk.points, trunk.radius, strict=True):
        centre = volume.to_ijk(point)
        reach = 0.5 * radius / np.array(volume.spacing_mm)
        low = np.clip(np.ceil(centre - reach), 0, shape).astype(int)
        high = np.clip(np.floor(centre + reach) + 1, 0, shape).astype(int)
        block = volume.hu_zyx[low[2] : high[2], low[1] : high[1], low[0] : high[0]].astype(np.float64)
        if block.size >= 8:
            rest.append((block - np.median(block)).ravel())
    if not rest:
        return scale.span(USUAL_NOISE_HU)
    return max(1.4826 * float(np.median(np.abs(np.concatenate(rest)))), scale.span(1.0))


def _columns(rows: dict[str, Any], which: slice, normals: Floats) -> dict[str, Any]:
    part = {name: values[which] for name, values in rows.items()}
    part["normal_lps"] = normals
    part["at_edge"] = part.pop("left_share") > 0.0
    width = part.pop("width_error_mm")
    part["min_error_mm"] = part["max_error_mm"] = width
    part["area_error_mm2"] = np.full_like(part["area_mm2"], np.nan)
    del part["wall_share"]
    for name in ("edge_mm", "outer_mm"):
        part[name] = np.rint(part[name] * RAYS_PER_MM) / RAYS_PER_MM
    return part


def _errors_with_scatter(columns: dict[str, Any], at_junction: NDArray[np.bool_]) -> dict[str, Floats]:
    """Return the errors of diameters and areas of a branch's sections, including their scatter."""
    diameter = columns["equivalent_mm"]
    usable = np.isfinite(diameter) & ~at_junction & ~columns["at_edge"]
    error = with_scatter(columns["at_mm"], diameter, columns["equivalent_error_mm"], usable)
    # d(pi d^2 / 4) = pi d / 2 dd.
    return {"equivalent_error_mm": error, "area_error_mm2": 0.5 * np.pi * diameter * error}


def _summaries(tree: AirwayTree, sections: list[dict[str, Any]]) -> tuple[BranchMeasures, ...]:
    nothing = BranchSummary()
    plain = [
        BranchMeasures(branch_id=branch.id, summary=nothing, **columns)
        for branch, columns in zip(tree.branches, sections, strict=True)
    ]
    by_id = {branch.branch_id: branch for branch in plain}
    means = {branch.branch_id: _mean(branch) for branch in plain}
    drawn = {branch.id for branch in tree.branches if branch.kind != "tracked"}
    found = []
    for branch in tree.branches:
        measures = by_id[branch.id]
        parent = None if branch.parent is None else tree.branch(branch.parent)
        siblings = [] if parent is None else [child for child in parent.children if child != branch.id]
        # Drawn branches contain no air in the CT, so their neighbours are judged as if they did not exist.
        siblings, children = ([n for n in ids if n not in drawn] for ids in (siblings, branch.children))
        expected = diameter_by_neighbours(
            None if parent is None else means[parent.id],
            [means[sibling] for sibling in siblings],
            [means[child] for child in children],
        )
        summary = summary_of(
            measures.at_mm,
            (measures.equivalent_mm, measures.equivalent_error_mm),
            (measures.wall_mm, measures.wall_error_mm),
            measures.is_usable,
            angle_deg=None if parent is None else angle_deg(parent, branch),
            stenosis=stenosis_of(
                measures.at_mm,
                measures.equivalent_mm,
                measures.equivalent_error_mm,
                measures.is_usable,
                expected=expected,
            ),
        )
        found.append(dataclasses.replace(measures, summary=summary))
    return tuple(found)


def _mean(branch: BranchMeasures) -> float | None:
    usable = branch.equivalent_mm[branch.is_usable]
    return float(np.median(usable)) if len(usable) else None


def _as_list(values: Floats) -> list[float | None]:
    return [round(float(value), 4) if np.isfinite(value) else None for value in values]
