"""Tracking of paths from the root to targets, in the lumen or on another graph."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from carina.argument_checks import check_arguments, choice, each, flag, function, instance, lps_point, number_from
from carina.display.progress import ProgressChoice, progress_function, shows_progress
from carina.errors import CancelledError, NoResultError, UsageError, check_type
from carina.track.edit.edit_list import MoveRoot
from carina.track.edit.edits import edit_airways
from carina.track.find.airways import Airways, find_airways
from carina.track.paths.tracker import SNAP_MM, Point, as_point
from carina.track.progress import Cancel, Progress
from carina.track.targets.paper_tracker import COSTS, GRAPHS, check_choice, track_on_graph
from carina.track.targets.results import TargetResult, TrackResult
from carina.volume.model import Volume
from carina.volume.point_check import check_in_volume


def _check_root(where: str, name: str, value: object) -> None:
    """Raise an error unless a root is "auto" or a point."""
    (choice("auto") if isinstance(value, str) else lps_point())(where, name, value)


@shows_progress
@check_arguments(
    volume=instance(Volume, "open a volume with carina.open_volume"),
    root=_check_root,
    targets=each(lps_point(), least=1, most=10_000),
    cost=choice(*COSTS),
    graph=choice(*GRAPHS),
    airways=instance(Airways, "get airways from carina.find_airways", optional=True),
    lumen_threshold=number_from(-40_000.0, 40_000.0, optional=True),
    snap_mm=number_from(0.0, 100.0, unit="mm"),
    relax=flag,
    cancel=function,
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
    relax: bool = True,
    progress: ProgressChoice = None,
    cancel: Cancel | None = None,
) -> TrackResult:
    """Track the least-cost paths from the root to targets (the Intelligent Path Tracker).

    Parameters
    ----------
    volume
        The CT.
    root
        Point, LPS in mm, or "auto" for the top of the trachea. A point in the larynx or the throat is moved to the
        top of the trachea. With the costs ``walls`` and ``paper`` paths begin at the given point itself, in any
        volume; without a lumen there, ``airways`` of the result is None.
    targets
        Points, LPS in mm. A point outside the lumen is moved to the nearest lumen voxel within ``snap_mm``, which
        the result states.
    cost
        ``lumen``: keep to the middle of the airway. ``walls``: the paper's gradient and Laplacian on all voxels,
        with expensive walls as section 6.3 needs them. ``paper``: the formula of 6.2 as printed, in which walls are
        cheap: paths follow edges. ``walls`` and ``paper`` do not use a lumen, and their paths may leave it;
        ``search`` lists each crossing of the wall, if there is a lumen. The targets of ``walls`` and ``paper`` are not
        moved.
    graph
        ``voxel``, or ``isoregion``: pruned as in paper 6.1. The pruned graph is smaller if values are equal over
        some voxels, but slower in all measurements (benchmarks/README.md).
    airways
        Airways found before; they keep their root unless ``root`` is given.
    lumen_threshold
        Value at which the lumen ends, as for `find_airways`.
    snap_mm
        Largest distance by which a target is moved to the lumen.
    relax
        Whether paths of the cost ``walls`` are shortened and smoothed after the search, in the tube that it followed.
        False returns the path of the search, as in the paper: 20 to 38 % longer, with a turn of 30 degrees per 3 mm.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is None while the progress is unknown.
    cancel
        Function that is called often; the calculation stops when it returns True.

    Returns
    -------
    TrackResult
        One entry per target, in order: a path, or the reason why there is none. If no target has a path, the tree is
        the automatic one, if any.

    Raises
    ------
    UsageError
        If a target is not a point in the volume, there is no target, or cost or graph is unknown.
    NoResultError
        If the airways cannot be found at all, and the cost or ``root="auto"`` needs them.

    Examples
    --------
    >>> import carina
    >>> phantom = carina.generate_phantom(spacing_mm=3.0, generations=3)
    >>> airways = carina.find_airways(phantom.volume)
    >>> tip = airways.tree.tips()[0]
    >>> found = carina.track_paths(phantom.volume, targets=[tip.tip_lps], airways=airways)
    >>> abs(found.targets[0].path.length_mm - airways.tree.route_to(tip.id).length_mm) < 5.0
    True
    """
    check_type("track_paths", "volume", volume, Volume, "open a volume with carina.open_volume")
    report = progress_function(progress)
    check_choice(cost, graph)
    points = [as_point(target) for target in targets]
    if not points:
        raise UsageError("expected at least one target; found none")
    for point in points:
        check_in_volume(volume, point, "the target")
    start = None if isinstance(root, str) else root
    if isinstance(root, str) and root != "auto":
        msg = f"root: expected 'auto' or a point, found {root!r}"
        raise UsageError(msg)
    if cost != "lumen":
        return track_on_graph(
            volume,
            airways or _airways_from_root(volume, start, lumen_threshold, report, cancel),
            points,
            cost=cost,
            graph=graph,
            root_lps=start,
            relax=relax,
            progress=report,
            cancel=cancel,
        )
    if airways is None or (start is not None and not np.array_equal(as_point(start), airways.root_lps)):
        airways = find_airways(volume, root_lps=start, lumen_threshold=lumen_threshold, progress=report, cancel=cancel)
        if start is not None:
            airways = _with_start_at(volume, airways, as_point(start), cancel)
    if graph != "voxel":
        return track_on_graph(
            volume, airways, points, cost=cost, graph=graph, snap_mm=snap_mm, progress=report, cancel=cancel
        )
    results: list[TargetResult] = []
    for point in points:
        if cancel is not None and cancel():
            raise CancelledError("stopped while searching for paths")
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
        tree = dataclasses.replace(airways.tracker.tree_to(found), notes=airways.badges)
    return TrackResult(tree, tuple(results), airways)


def _with_start_at(volume: Volume, airways: Airways, start: Point, cancel: Cancel | None) -> Airways:
    """Return the airways with paths that begin at a start given in the trachea instead of at the trachea's top."""
    if np.linalg.norm(airways.root_lps - np.array(start)) <= SNAP_MM:
        return airways
    try:
        return edit_airways(volume, airways, MoveRoot(start), cancel=cancel)
    except NoResultError:
        # The start is in the larynx or the throat, which the tree does not include.
        return airways


def _airways_from_root(
    volume: Volume,
    root: Sequence[float] | NDArray[np.float64] | None,
    lumen_threshold: float | None,
    progress: Progress | None,
    cancel: Cancel | None,
) -> Airways | None:
    """Find the airways from a root, for comparison with paths; return None if a given root is not in a lumen.

    The result is also None for a given root in a volume that is not in HU, where any value may look like air.
    """
    if root is not None:
        check_in_volume(volume, as_point(root), "the root")
    if root is not None and not volume.is_hu:
        return None
    try:
        return find_airways(volume, root_lps=root, lumen_threshold=lumen_threshold, progress=progress, cancel=cancel)
    except NoResultError as error:
        if root is None:
            msg = f"{error}; the costs walls and paper need no airways, but a start point (root)"
            raise NoResultError(msg, code=error.code) from error
        return None
