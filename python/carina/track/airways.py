"""From a volume to its airways and to paths through them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from carina._core import LumenTracker, extend_lumen, find_trachea_voxels, flood_lumen
from carina.errors import CancelledError, GeometryError, NoResultError, UsageError
from carina.track.edit_kinds import TreeEdit
from carina.track.levels import AirScale, air_scale
from carina.track.names import name_tree
from carina.track.paths import SNAP_MM, Cancel, PathTracker, Point, TrackedPath, as_point, branches_from_rows, words
from carina.track.root_checks import (
    LUNG_HU,
    UP_FIRST_MM,
    refuse_a_root_below_the_carina,
    refuse_a_root_of_one_lung,
)
from carina.track.trachea import fill_trachea
from carina.track.tree import AirwayTree, Branch
from carina.track.uncertain import Uncertainty, find_uncertain, with_confidence
from carina.volume.model import Volume

if TYPE_CHECKING:
    from carina.track.paper import GraphSearch

__all__ = ["Airways", "TargetResult", "TrackResult", "find_airways", "track_paths"]

Progress = Callable[[str, float | None], None]

# HU levels, read on the volume's own scale (AirScale).
LUMEN_END_HU = -800.0
"""Where the automatic lumen ends.

Half-way between lumen and wall would be -500 HU where the wall is thick. On slices of 3 mm a small airway's wall does
not reach that, so the flood stops lower; against the mask of QIN-LSC-0003 the Dice score is flat between -800 and -750
and falls above.
"""
# The first that shows a trachea counts: lower where its wall to the lung is thin, higher where the slices blur it.
TRACHEA_AIR_HU = (-800.0, -900.0, -700.0)
TISSUE_HU = -450.0
MIN_WALL_CONTRAST_HU = 60.0
STEP_RISE_HU = 25.0
HALF_WALL_HU = -500.0
# Beyond the flood's end airways are followed by their shape (docs/decisions/0015). The least rise to a wall; how long a
# drop of mucus or a beat of the heart may blot it out; how far a branch must lead to be one. Slices thicker than the
# smallest lumen show its wall only mixed with what lies beside it: so many more of them must agree.
LEAST_RISE_HU = 15.0
GAP_MM = 2.0
MIN_FOLLOWED_MM = 2.0
THIN_SLICE_MM = 1.0
THICK_SECTIONS = 5.0

# What is missing where a trachea was found all the same, in words.
TRACHEA_DOUBTS = {
    "cut-off": "the volume begins close above the carina: little of the trachea is in view",
    "narrow-bronchus": "the trachea is less certain: one main bronchus is short or narrow; look at it",
    "one-bronchus": "the trachea is less certain: it goes on into one main bronchus only (the other is blocked, cut "
    "off or was removed); look at it",
    "one-lung": "the trachea is less certain: there is aerated lung on one side only; look at it",
}

# A trachea holds 20-40 ml, both lungs some litres. The largest piece of tree behind one noisy voxel is below 60 ml.
LEAK_MM3 = 60_000.0
SMALL_LEAK_MM3 = 3_000.0
CLOSED_RADIUS_MM = 10.0
MIN_LUMEN_MM3 = 300.0
# Trachea, two main, five lobar and some segmental bronchi: with fewer there is too little to tell lobes apart.
MIN_GRAMMAR_BRANCHES = 12
# A trachea is 100 to 140 mm long; higher up it is larynx and throat.
MAX_TRACHEA_MM = 150.0


@dataclass(frozen=True, slots=True, eq=False)
class Airways:
    """The airways of a volume."""

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

    @property
    def report(self) -> tuple[str, ...]:
        """The notes."""
        return self.notes


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


@dataclass(frozen=True, slots=True, eq=False)
class TrackResult:
    """Paths to several targets, and their common tree."""

    tree: AirwayTree
    targets: tuple[TargetResult, ...]
    airways: Airways
    search: GraphSearch | None = None
    """The graph that was searched and what that took; None for the cost ``lumen`` on the voxel graph."""


def find_airways(
    volume: Volume,
    *,
    root_lps: Sequence[float] | NDArray[np.float64] | None = None,
    lumen_threshold: float | None = None,
    lumen_zyx: NDArray[np.uint8] | None = None,
    progress: Progress | None = None,
    cancel: Cancel | None = None,
) -> Airways:
    """Find the airway lumen and its tree.

    Parameters
    ----------
    volume
        A chest CT, in HU or not.
    root_lps
        Where the paths begin, LPS mm; the top of the trachea unless told. A point outside the lumen is moved to the
        nearest lumen voxel within 5 mm. Needed where the trachea is not in view.
    lumen_threshold
        Value at which the lumen ends, in the volume's own numbers; -800 HU unless told, or from the histogram where the
        volume is not in HU. Where it is told, the lumen is not followed beyond it by its shape.
    lumen_zyx
        A lumen from another tool, (nz, ny, nx), not 0 inside, on the volume's grid: used instead of the automatic one.
        Of several pieces the one with the root counts; a note says how much is not connected to it.
    progress, cancel
        Told what is going on; asked whether to stop.

    Returns
    -------
    Airways
        Lumen, root, tree with generations, names and confidence, tracker, notes on what was limited, and what could not
        be followed.

    Raises
    ------
    NoResultError
        If there is no trachea, no lumen at the root, or the lumen is empty; the message says which.
    UsageError
        If the root is not in the volume, or the threshold leaves no lumen.
    GeometryError
        If ``lumen_zyx`` is not on the volume's grid.
    CancelledError
        If ``cancel()`` said so.

    References
    ----------
    Paper 6; DESIGN section 4, "Airways".
    """
    stage = _Stages(progress, cancel)
    root = None if root_lps is None else as_point(root_lps)
    if root is not None and not volume.contains_lps(np.array(root)):
        msg = f"the root {words(root)} lies outside the volume"
        raise UsageError(msg)
    notes: list[str] = []
    # None: a lumen from another tool need not agree with what this CT shows, and is not judged by it.
    noise: float | None = None
    leaks = np.empty((0, 3))
    # None: the root was not found by a split into two main bronchi.
    trachea_mm: float | None = None
    if lumen_zyx is not None:
        lumen, levels, end = _given_lumen(volume, lumen_zyx), None, float("nan")
        if root is None:
            drawn = np.where(lumen != 0, -1000, 40).astype(np.int16)
            trachea = _trachea_in(drawn, volume, AirScale(-1000.0, 0.0), stage, painted=True)
            root, notes = trachea.top, list(trachea.notes)
    else:
        grown = _grow(volume, root, lumen_threshold, stage)
        lumen, levels, end, root = grown.lumen, grown.levels, grown.end, grown.root
        noise, leaks, trachea_mm = grown.noise, grown.leaks_lps, grown.trachea_mm
        notes += grown.notes
    stage.begin("measuring the lumen")
    assert root is not None
    core = LumenTracker(volume.hu_zyx, volume.lps_from_ijk, lumen, levels=levels, root_lps=root, reach_mm=SNAP_MM)
    tracker = PathTracker(volume, core)
    stage.begin("solving the paths")
    core.solve_all(cancel=cancel, progress=stage.share)
    stage.begin("finding the branches")
    rows = core.branches(cancel=cancel, progress=stage.share)
    branches = branches_from_rows(rows)
    if root_lps is None:
        refuse_a_root_below_the_carina(volume, branches)
        if trachea_mm is not None:
            refuse_a_root_of_one_lung(volume, branches, trachea_mm)
    tree = AirwayTree(branches, _smooth=tracker.smooth)
    uncertain: tuple[Uncertainty, ...] = ()
    if noise is not None:
        stage.begin("judging the branches")
        tree = with_confidence(volume, tree, noise)
        uncertain = find_uncertain(volume, tree, leaks)
    if len(tree) >= MIN_GRAMMAR_BRANCHES:
        tree = name_tree(tree)
    else:
        tree = dataclasses.replace(tree, branches=_named(tree.branches))
    tracker.set_branches(tree.branches, [row["nodes"] for row in rows])
    if core.num_settled < core.num_nodes:
        notes.append(f"{core.num_nodes - core.num_settled} lumen voxels are not connected to the root")
    lumen.flags.writeable = False
    root_at = branches[0].points[0].copy()
    stage.begin("airways found", 1.0)
    return Airways(
        lumen_zyx=lumen,
        root_lps=root_at,
        tree=tree,
        tracker=tracker,
        threshold=end,
        notes=tuple(notes),
        wall_levels=levels,
        uncertain=uncertain,
    )


def track_paths(
    volume: Volume,
    *,
    root: Literal["auto"] | Sequence[float] | NDArray[np.float64] = "auto",
    targets: Sequence[Sequence[float] | NDArray[np.float64]],
    cost: str = "lumen",
    graph: str = "voxel",
    airways: Airways | None = None,
    lumen_threshold: float | None = None,
    snap_mm: float = SNAP_MM,
    progress: Progress | None = None,
    cancel: Cancel | None = None,
) -> TrackResult:
    """Track the least-cost paths from the root to targets (the Intelligent Path Tracker).

    Parameters
    ----------
    root
        LPS mm, or "auto" for the top of the trachea.
    targets
        Points, LPS mm. One outside the lumen is moved to the nearest lumen voxel within ``snap_mm``, and the result
        says so.
    cost
        ``lumen``: keep to the middle of the airway. ``paper``: the paper's formula (6.2) on all voxels; it follows
        edges and may leave the lumen, ``search`` says where. Its targets are not moved.
    graph
        ``voxel``, or ``isoregion``: pruned as in paper 6.1.
    airways
        Airways found before; they keep their root unless ``root`` is given.

    Returns
    -------
    TrackResult
        One entry per target, in order: a path, or the reason why there is none. Where no target has a path the tree is
        the automatic one.

    Raises
    ------
    UsageError
        If a target is not a point in the volume, there is none, or cost or graph is unknown.
    NoResultError
        If the airways cannot be found at all.
    """
    from carina.track.paper import check_choice, track_on_graph

    check_choice(cost, graph)
    points = [as_point(target) for target in targets]
    if not points:
        raise UsageError("give at least one target")
    for point in points:
        if not volume.contains_lps(np.array(point)):
            msg = f"the target {words(point)} lies outside the volume"
            raise UsageError(msg)
    start = None if isinstance(root, str) else root
    if isinstance(root, str) and root != "auto":
        msg = f"root: expected 'auto' or a point, found {root!r}"
        raise UsageError(msg)
    if airways is None or (start is not None and not np.array_equal(as_point(start), airways.root_lps)):
        airways = find_airways(
            volume, root_lps=start, lumen_threshold=lumen_threshold, progress=progress, cancel=cancel
        )
    if (cost, graph) != ("lumen", "voxel"):
        return track_on_graph(
            volume, airways, points, cost=cost, graph=graph, snap_mm=snap_mm, progress=progress, cancel=cancel
        )
    results: list[TargetResult] = []
    for point in points:
        if cancel is not None and cancel():
            raise CancelledError("tracking was stopped")
        requested = np.array(point)
        try:
            path = airways.tracker.path_to(point, snap_mm=snap_mm, cancel=cancel)
        except NoResultError as error:
            results.append(TargetResult(requested, None, 0.0, None, str(error)))
        else:
            used = path.voxel_path_lps[-1] if path.snapped_mm > 0.0 else requested
            results.append(TargetResult(requested, used, path.snapped_mm, path, None))
    found = [result.path for result in results if result.path is not None]
    tree = airways.tree
    if found:
        tree = airways.tracker.tree_to(found)
    return TrackResult(tree, tuple(results), airways)


@dataclass(frozen=True, slots=True, eq=False)
class _Trachea:
    seeds: list[tuple[int, int, int]]
    """Its voxels (i, j, k), from the top down."""
    top: Point
    notes: list[str]
    split_mm: float | None
    """Length above its split into two main bronchi; None where one is missing, or a lung."""


@dataclass(frozen=True, slots=True, eq=False)
class _Grown:
    lumen: NDArray[np.uint8]
    levels: tuple[float, float, float]
    end: float
    root: Point
    notes: list[str]
    noise: float
    leaks_lps: NDArray[np.float64]
    trachea_mm: float | None
    """As :attr:`_Trachea.split_mm`; None where the root was given."""


class _Stages:
    """Hands progress on, with the name of the present stage, and stops between stages when asked."""

    def __init__(self, progress: Progress | None, cancel: Cancel | None) -> None:
        self._progress = progress
        self.cancel = cancel
        self._what = ""

    def begin(self, what: str, fraction: float | None = None) -> None:
        if self.cancel is not None and self.cancel():
            raise CancelledError("finding the airways was stopped")
        self._what = what
        if self._progress is not None:
            self._progress(what, fraction)

    def share(self, fraction: float) -> None:
        if self._progress is not None:
            self._progress(self._what, fraction)


def _given_lumen(volume: Volume, lumen_zyx: NDArray[np.uint8]) -> NDArray[np.uint8]:
    given = np.asarray(lumen_zyx)
    if given.shape != volume.shape_zyx:
        msg = f"the lumen must be on the volume's grid: expected shape {volume.shape_zyx}, found {given.shape}"
        raise GeometryError(msg, code="geometry.shape")
    inside = np.ascontiguousarray(given != 0).astype(np.uint8)
    if not inside.any():
        raise NoResultError("the given lumen is empty: no voxel of the mask is set. Choose the mask of the airways")
    return inside


def _trachea_in(
    values: NDArray[np.int16], volume: Volume, scale: AirScale, stage: _Stages, *, painted: bool = False
) -> _Trachea:
    stage.begin("finding the trachea")
    lung = None if painted else (scale.level(LUNG_HU[0]), scale.level(LUNG_HU[1]))
    found, problem = None, ""
    for air_hu in TRACHEA_AIR_HU:
        try:
            other = find_trachea_voxels(
                values,
                volume.lps_from_ijk,
                air=scale.level(air_hu),
                tissue=scale.level(TISSUE_HU),
                lung=lung,
                cancel=stage.cancel,
            )
        except NoResultError as error:
            problem = problem or str(error)
            continue
        if found is None or (
            len(other["doubts"]) < len(found["doubts"])
            # Not a bronchus of the same airway, which may look the part better.
            and _top_z(volume, other) >= _top_z(volume, found) - UP_FIRST_MM
        ):
            found = other
        if not found["doubts"]:
            break
    if found is None:
        if not volume.is_hu:
            problem += (
                ". The volume is not in HU: if its values are cut off at the dark end, lung and airway look alike"
            )
        raise NoResultError(problem)
    voxels = found["voxels_ijk"]
    points = volume.to_lps(voxels)
    near = np.linalg.norm(points - found["carina_lps"], axis=1) <= MAX_TRACHEA_MM
    voxels, points = voxels[near], points[near]
    seeds = [(int(i), int(j), int(k)) for i, j, k in voxels]
    notes = [TRACHEA_DOUBTS[doubt] for doubt in found["doubts"]]
    is_whole = not {"one-bronchus", "one-lung"} & set(found["doubts"])
    return _Trachea(seeds, as_point(points[0]), notes, float(found["length_mm"]) if is_whole else None)


def _top_z(volume: Volume, found: dict[str, Any]) -> float:
    return float(volume.to_lps(found["voxels_ijk"][0])[2])


def _air_round(volume: Volume, root: Point, scale: AirScale) -> list[tuple[int, int, int]]:
    """The voxels of air nearest to a root that a person gave: the nearest one and those within 2 mm of it."""
    center = volume.to_ijk(np.array(root))
    shape = np.array(volume.shape_zyx[::-1])
    reach = np.ceil((SNAP_MM + 2.0) / np.array(volume.spacing_mm)) + 1
    low = np.clip(np.floor(center - reach), 0, shape - 1).astype(int)
    high = np.clip(np.ceil(center + reach), 0, shape - 1).astype(int)
    grid = np.stack(np.meshgrid(*(np.arange(low[a], high[a] + 1) for a in range(3)), indexing="ij"), axis=-1)
    voxels = grid.reshape(-1, 3)
    values = volume.hu_zyx[voxels[:, 2], voxels[:, 1], voxels[:, 0]]
    points = volume.to_lps(voxels.astype(np.float64))
    distance = np.linalg.norm(points - np.array(root), axis=1)
    air = (values <= scale.level(-850.0)) & (distance <= SNAP_MM)
    if not air.any():
        msg = (
            f"the root {words(root)} is not in an airway: no voxel within {SNAP_MM:g} mm is as dark as air. "
            "Choose a point inside the trachea"
        )
        raise NoResultError(msg, code="track.outside-lumen")
    nearest = points[air][int(np.argmin(distance[air]))]
    chosen = air & (np.linalg.norm(points - nearest, axis=1) <= 2.0)
    # The nearest first: it is the root.
    order = np.argsort(np.linalg.norm(points[chosen] - nearest, axis=1), kind="stable")
    return [(int(i), int(j), int(k)) for i, j, k in voxels[chosen][order]]


def _grow(volume: Volume, root: Point | None, lumen_threshold: float | None, stage: _Stages) -> _Grown:
    scale = air_scale(volume)
    notes: list[str] = []
    trachea_mm: float | None = None
    end = scale.level(LUMEN_END_HU) if lumen_threshold is None else round(float(lumen_threshold))
    if root is not None:
        # The whole airway, if the root is in it; a point lower down would else make a part of it the trunk.
        try:
            grown = _grow(volume, None, lumen_threshold, stage)
        except NoResultError:
            grown = None
        if grown is not None:
            snapped = _nearest_lumen(volume, grown.lumen, root)
            if snapped is not None:
                point, moved_mm = snapped
                if moved_mm > 0.0:
                    grown.notes.append(f"the root was moved {moved_mm:.1f} mm to the nearest lumen voxel")
                return dataclasses.replace(grown, root=point)
        seeds = _air_round(volume, root, scale)
        start = as_point(volume.to_lps(np.array(seeds[0], dtype=np.float64)))
    else:
        trachea = _trachea_in(volume.hu_zyx, volume, scale, stage)
        seeds, start, notes, trachea_mm = trachea.seeds, trachea.top, trachea.notes, trachea.split_mm
    stage.begin("growing the airway")
    sample = _values_round(volume, seeds)
    middle = float(np.median(sample))
    # Median deviation, so that a drop of mucus or the tube of a ventilator does not widen the range.
    noise = max(1.4826 * float(np.median(np.abs(sample - middle))), scale.span(5.0), 0.7)
    first = round(middle - noise)
    core = min(round(middle + 2.5 * noise), end)
    if end < middle:
        msg = (
            f"the lumen threshold {end} is below the air of the trachea ({middle:.0f}): nothing would be lumen; "
            f"choose at least {round(middle + 2.5 * noise)}"
        )
        raise UsageError(msg)
    lumen, report = flood_lumen(
        volume.hu_zyx,
        volume.lps_from_ijk,
        seeds,
        first_level=first,
        core_level=core,
        last_level=end,
        leak_mm3=LEAK_MM3,
        small_leak_mm3=SMALL_LEAK_MM3,
        closed_radius_mm=CLOSED_RADIUS_MM,
        min_contrast=scale.span(MIN_WALL_CONTRAST_HU),
        cancel=stage.cancel,
        progress=stage.share,
    )
    if root is None:
        fill_trachea(volume, lumen, np.array(seeds))
    voxel_mm3 = abs(float(np.linalg.det(volume.lps_from_ijk[:3, :3])))
    if report["num_voxels"] * voxel_mm3 < MIN_LUMEN_MM3:
        msg = (
            f"no airway lumen was found at {words(start)}: air there is open to the lung, or is a small pocket. "
            "Choose a root inside the trachea"
        )
        raise NoResultError(msg)
    if report["leaks"]:
        num = len(report["leaks"])
        places = "one place" if num == 1 else f"{num} places"
        notes.append(f"the search was stopped at {places} where it would have run out of the airway into the lung")
    levels = (float(core), float(max(scale.level(HALF_WALL_HU), end)), scale.span(STEP_RISE_HU))
    if lumen_threshold is None:
        stage.begin("following the small airways")
        followed = extend_lumen(
            volume.hu_zyx,
            volume.lps_from_ijk,
            lumen,
            air=middle,
            lung=(scale.level(LUNG_HU[0]), scale.level(LUNG_HU[1])),
            brightest=scale.level(HALF_WALL_HU),
            least_rise=scale.span(LEAST_RISE_HU),
            gap_mm=GAP_MM,
            min_length_mm=MIN_FOLLOWED_MM + THICK_SECTIONS * max(max(volume.spacing_mm) - THIN_SLICE_MM, 0.0),
            cancel=stage.cancel,
            progress=stage.share,
        )
        if followed["followed"]:
            length_mm = sum(path["length_mm"] for path in followed["followed"])
            notes.append(
                f"{length_mm:.0f} mm of small airways, in {len(followed['followed'])} pieces, were followed by the "
                "shape of their walls, beyond where these hold the air"
            )
        np.minimum(lumen, 1, out=lumen)
    leaks = np.array([place for place, _ in report["leaks"]], dtype=np.float64).reshape(-1, 3)
    return _Grown(lumen, levels, float(end), start, notes, noise, leaks, trachea_mm)


def _values_round(volume: Volume, seeds: Sequence[tuple[int, int, int]]) -> NDArray[np.float64]:
    """Values of the seeds and their neighbours within one voxel, all well inside the air."""
    at = np.array(seeds)
    offsets = np.stack(np.meshgrid(*[np.arange(-1, 2)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    voxels = (at[:, None, :] + offsets[None]).reshape(-1, 3)
    voxels = np.unique(np.clip(voxels, 0, np.array(volume.shape_zyx[::-1]) - 1), axis=0)
    return volume.hu_zyx[voxels[:, 2], voxels[:, 1], voxels[:, 0]].astype(np.float64)


def _nearest_lumen(volume: Volume, lumen: NDArray[np.uint8], point: Point) -> tuple[Point, float] | None:
    """The centre of the nearest lumen voxel within the snapping distance, and that distance (0 inside the lumen)."""
    center = volume.to_ijk(np.array(point))
    shape = np.array(volume.shape_zyx[::-1])
    here = np.clip(np.floor(center + 0.5), 0, shape - 1).astype(int)
    if lumen[here[2], here[1], here[0]]:
        return as_point(volume.to_lps(here.astype(np.float64))), 0.0
    reach = np.ceil(SNAP_MM / np.array(volume.spacing_mm)) + 1
    low = np.clip(here - reach, 0, shape - 1).astype(int)
    high = np.clip(here + reach, 0, shape - 1).astype(int)
    block = lumen[low[2] : high[2] + 1, low[1] : high[1] + 1, low[0] : high[0] + 1]
    voxels = np.argwhere(block)[:, ::-1] + low
    if not len(voxels):
        return None
    points = volume.to_lps(voxels.astype(np.float64))
    distance = np.linalg.norm(points - np.array(point), axis=1)
    nearest = int(np.argmin(distance))
    if distance[nearest] > SNAP_MM:
        return None
    return as_point(points[nearest]), float(distance[nearest])


def _named(branches: tuple[Branch, ...]) -> tuple[Branch, ...]:
    """Names that are beyond doubt in a tree too small for more: trachea and main bronchi.

    The trunk is the trachea where it runs down for at least 20 mm and splits in two; of the two the one that leads to
    the patient's right (-x in LPS) is the right main bronchus.
    """
    trunk = branches[0]
    if len(trunk.children) != 2 or trunk.points[0][2] - trunk.points[-1][2] < 20.0:
        return branches
    one, two = (branches[child] for child in trunk.children)

    def side_mm(branch: Branch) -> float:
        # Mean place of all that hangs on it: a main bronchus is short, its lung is not.
        below = [branch]
        for member in below:
            below.extend(branches[child] for child in member.children)
        points = np.concatenate([member.points for member in below])
        return float(points[:, 0].mean() - trunk.points[-1][0])

    sides = {branch.id: side_mm(branch) for branch in (one, two)}
    right, left = sorted((one, two), key=lambda branch: sides[branch.id])
    if not sides[right.id] < -10.0 < 10.0 < sides[left.id] or min(len(right.children), len(left.children)) < 2:
        return branches
    names = {trunk.id: "Trachea", right.id: "RMB", left.id: "LMB"}
    return tuple(
        dataclasses.replace(branch, name=names[branch.id], name_from="anatomy") if branch.id in names else branch
        for branch in branches
    )
