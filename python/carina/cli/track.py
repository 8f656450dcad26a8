"""``carina track``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import carina
from carina.cli.arguments import check_output_file
from carina.cli.console import print_json, progress_printer, say
from carina.errors import NoResultError
from carina.export import write_tree

__all__ = ["report"]


def report(
    path: Path,
    *,
    root: NDArray[np.float64] | None,
    targets: list[NDArray[np.float64]],
    series: str | None,
    output: Path | None,
    as_json: bool,
) -> int:
    """Track all targets and write the tree; 4 if one of them has no path (the others are written)."""
    if output is not None:
        check_output_file(output)
    progress = progress_printer()
    volume = carina.open_volume(path, series=series, progress=progress)
    for warning in volume.source.warnings:
        say(f"note: {warning}")
    result = carina.track_paths(volume, root="auto" if root is None else root, targets=targets, progress=progress)
    rows: list[dict[str, Any]] = []
    for number, target in enumerate(result.targets, 1):
        row: dict[str, Any] = {
            "requested_lps": [float(v) for v in target.requested_lps],
            "used_lps": None if target.used_lps is None else [float(v) for v in target.used_lps],
            "snapped_mm": target.snapped_mm,
            "problem": target.problem,
        }
        if target.path is not None:
            row |= {
                "length_mm": target.path.length_mm,
                "cost": target.path.cost,
                "min_radius_mm": float(np.min(target.path.radius_mm)),
                "generation": int(target.path.generation[-1]),
            }
            snapped = f", snapped {target.snapped_mm:.1f} mm to the lumen" if target.snapped_mm else ""
            say(f"target {number}: {target.path.length_mm:.1f} mm, generation {row['generation']}{snapped}")
        else:
            say(f"target {number}: {target.problem}")
        rows.append(row)
    found = [target for target in result.targets if target.path is not None]
    if output is not None and found:
        write_tree(output, result.tree)
        say(f"wrote {output}")
    if as_json:
        print_json({"targets": rows, "tree": result.tree.to_json() if found else None})
    if len(found) == len(result.targets):
        return 0
    if not found:
        say("carina: no path to any target; nothing was written")
    return NoResultError.exit_code
