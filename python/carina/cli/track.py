"""``carina track``: compute the paths to targets."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import carina
from carina.cli.arguments import check_output_file
from carina.cli.console import ProgressCallback, print_json, print_note, progress_printer
from carina.cli.opened import OpenedInput, check_case_options, open_input
from carina.errors import NoResultError
from carina.export import write_tree
from carina.track import Airways, DrawnPart, drawn_part
from carina.track.targets.paper_tracker import check_choice, track_on_graph
from carina.track.targets.results import GraphSearch, TargetSearch


def report(
    path: Path,
    *,
    root: NDArray[np.float64] | None,
    targets: list[NDArray[np.float64]],
    cost: str,
    graph: str,
    series: str | None,
    strict: bool,
    output: Path | None,
    as_json: bool,
    relax: bool = True,
    ct: Path | None = None,
) -> int:
    """Track all targets and write the tree; return 4 if a target has no path (the other paths are written)."""
    if output is not None:
        check_output_file(output, ".json")
    check_choice(cost, graph)
    # With the cost ``lumen``, paths start at the root of the case's airways; the other costs accept any start point.
    check_case_options(path, ct, root=root is not None and cost == "lumen")
    progress = progress_printer()
    source = open_input(path, series=series, strict=strict, progress=progress, ct=ct)
    volume, badges = source.volume, source.badges
    result = carina.track_paths(
        volume,
        root="auto" if root is None else root,
        targets=targets,
        cost=cost,
        graph=graph,
        relax=relax,
        airways=None if source.moment is None else _airways_of_case(source, progress, cost, root),
        progress=progress,
    )
    if result.airways is not None:
        badges.add(result.airways.badges)
    elif result.tree is not None:
        badges.add(result.tree.notes)
    search = result.search
    if search is None and as_json:
        # Paths read from the airways come without figures: build the graph again and search it, to the targets only.
        search = track_on_graph(volume, result.airways, targets, cost=cost, graph=graph, progress=progress).search
    rows: list[dict[str, Any]] = []
    for number, target in enumerate(result.targets, 1):
        row: dict[str, Any] = {
            "requested_lps": [float(v) for v in target.requested_lps],
            "used_lps": None if target.used_lps is None else [float(v) for v in target.used_lps],
            "snapped_mm": target.snapped_mm,
            "problem": target.problem,
        }
        if target.path is not None:
            along_mm = np.linalg.norm(np.diff(target.path.points_lps, axis=0), axis=1).cumsum()
            drawn = DrawnPart(0.0)
            if result.airways is not None:
                drawn = drawn_part(result.airways.tree, target.path.branch_ids, np.concatenate([[0.0], along_mm]))
            row |= {
                "length_mm": target.path.length_mm,
                "cost": target.path.cost,
                "min_radius_mm": None if result.airways is None else float(np.min(target.path.wall_mm)),
                "generation": None if result.airways is None else int(target.path.generation[-1]),
                **drawn.to_json(),
            }
            if drawn.words is not None:
                print_note(f"target {number}: {drawn.words}")
            outside = None if search is None else search.targets[number - 1]
            if outside is not None:
                row["search"] = dataclasses.asdict(outside)
                if cost != "lumen":
                    low, high = outside.value_range
                    unit = " HU" if volume.is_hu else ""
                    print_note(f"target {number}: values along the path from {low} to {high}{unit}")
                if search is not None and search.is_relaxed:
                    print_note(f"target {number}: {relaxation_text(outside)}")
                if outside.outside_mm:
                    print_note(f"target {number}: {crossing_text(outside)}")
            snapped = f", snapped {target.snapped_mm:.1f} mm to the lumen" if target.snapped_mm else ""
            depth = "" if result.airways is None else f", generation {row['generation']}"
            print_note(f"target {number}: {target.path.length_mm:.1f} mm{depth}{snapped}")
        else:
            print_note(f"target {number}: {target.problem}")
        rows.append(row)
    for note in () if result.search is None else result.search.notes:
        print_note(f"note: {note}")
    found = [target for target in result.targets if target.path is not None]
    if output is not None and found and result.tree is not None:
        write_tree(output, result.tree, badges=badges.notes)
        print_note(f"wrote {output}")
    if as_json:
        print_json(
            {
                "cost": cost,
                "graph": graph,
                "search": None if search is None else _search_row(search),
                "targets": rows,
                "tree": result.tree.to_json() if found and result.tree is not None else None,
                "badges": badges.to_json(),
            }
        )
    if len(found) == len(result.targets):
        return 0
    if not found:
        print_note("carina: no path was found to any target; nothing was written")
    return NoResultError.exit_code


def relaxation_text(search: TargetSearch) -> str:
    """Return the length of the path of the search as text, and how much of it was outside the lumen."""
    text = f"the path of the search was {search.search_length_mm:.1f} mm long before it was shortened and smoothed"
    if not search.search_outside_mm:
        return text
    return f"{text}; {search.search_outside_mm:.1f} mm of it were outside the airway lumen"


def crossing_text(search: TargetSearch) -> str:
    """Return the length of a path outside the lumen, and where the path crosses its wall, as text."""
    crossings = search.crossings or ()
    places = ", ".join(
        f"{('back in' if number else 'in') if crossing.enters else 'out'} at {crossing.along_mm:.1f} mm"
        for number, crossing in enumerate(crossings)
    )
    words = f"{search.outside_mm:.1f} mm of the path are outside the airway lumen"
    return f"{words}; distances from the start to each crossing of the wall: {places}" if places else words


def _airways_of_case(
    source: OpenedInput, progress: ProgressCallback, cost: str, root: NDArray[np.float64] | None
) -> Airways | None:
    """Return the airways of a case; None if it has none and the cost and the given root make them unnecessary."""
    document = source.document
    if cost != "lumen" and (document is None or document.airways is None):
        if root is None:
            msg = (
                "this case has no segmented airways to start from; give the start point of the paths with --root x,y,z"
            )
            raise NoResultError(msg, code="track.no-airways")
        return None
    return source.airways(progress)


def _search_row(search: GraphSearch) -> dict[str, Any]:
    """Return size and computing times of the graph; the search time of each target is in the row of that target."""
    return {
        "labels": search.labels,
        "equal_by": None if search.labels is None else {"bins": "bins of 16", "lumen": "lumen"}[search.labels],
        "num_nodes": search.num_nodes,
        "relaxed": search.is_relaxed,
        "num_edges": search.num_edges,
        "num_centres": search.num_centres,
        "build_s": search.build_s,
        "search_s": sum(target.search_s for target in search.targets if target is not None),
        "quantum": search.quantum,
        "box": {"first_ijk": list(search.first_ijk), "shape_ijk": list(search.shape_ijk), "whole": search.is_whole},
        "branch_nodes_lps": search.branch_nodes_lps.tolist(),
        "notes": list(search.notes),
    }
