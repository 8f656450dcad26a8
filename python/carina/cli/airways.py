"""``carina airways`` and ``carina export``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import carina
from carina.cli.arguments import check_output_file
from carina.cli.console import print_json, progress_printer, say
from carina.errors import UsageError
from carina.export import export_airways, export_tree, is_tree_file, read_tree, write_mask, write_tree
from carina.track import Airways
from carina.volume import Volume, open_mask

__all__ = ["find", "write"]


def find(
    path: Path,
    *,
    seed: NDArray[np.float64] | None,
    from_mask: Path | None,
    label: int | None,
    resample: bool,
    series: str | None,
    mask: Path | None,
    output: Path | None,
    as_json: bool,
) -> int:
    """Find the airways of a scan, write tree and mask where asked, and say what was found."""
    if output is not None:
        check_output_file(output, ".json")
    if mask is not None:
        check_output_file(mask, what="--mask")
    _check_mask_options(from_mask, label, resample)
    volume = _open(path, series)
    airways = _airways(volume, seed=seed, from_mask=from_mask, label=label, resample=resample)
    if output is not None:
        write_tree(output, airways.tree)
        say(f"wrote {output}")
    if mask is not None:
        write_mask(mask, airways.lumen_zyx, volume)
        say(f"wrote {mask}")
    rows = _rows(airways)
    lumen_ml = float(np.count_nonzero(airways.lumen_zyx)) * abs(np.linalg.det(volume.lps_from_ijk[:3, :3])) / 1000.0
    deepest = max(branch.generation for branch in airways.tree.branches)
    length_mm = sum(branch.length_mm for branch in airways.tree.branches)
    if as_json:
        print_json(
            {
                "root_lps": [float(v) for v in airways.root_lps],
                "num_branches": len(airways.tree),
                "deepest_generation": deepest,
                "length_mm": length_mm,
                "lumen_ml": lumen_ml,
                "threshold": float(airways.threshold) if np.isfinite(airways.threshold) else None,
                "notes": list(airways.notes),
                "branches": rows,
            }
        )
        return 0
    print(
        f"{len(airways.tree)} branches to generation {deepest}, {length_mm / 1000.0:.2f} m in all, "
        f"lumen {lumen_ml:.1f} ml"
    )
    for row in rows:
        name = row["name"] or "-"
        print(
            f"{'  ' * row['generation']}{row['id']:>4} {name:<18} {row['length_mm']:6.1f} mm long, "
            f"{row['lumen_mm']:4.1f} mm wide"
        )
    return 0


def write(
    path: Path,
    *,
    output: Path,
    tree: Path | None,
    from_mask: Path | None,
    label: int | None,
    resample: bool,
    series: str | None,
    as_json: bool,
) -> int:
    """Find the airways, or take a tree from a file, and write them in another format."""
    try:
        tree_alone = is_tree_file(output)
    except UsageError as error:
        raise UsageError(f"-o: {error}") from None
    check_output_file(output)
    _check_mask_options(from_mask, label, resample)
    given = None if tree is None else read_tree(tree)
    volume = _open(path, series)
    if given is not None and tree_alone:
        nowhere = [b.id for b in given.branches if not any(volume.contains_lps(point) for point in b.points)]
        if len(nowhere) == len(given):
            raise UsageError(f"--tree: no branch of {tree} lies in the scan {path.name}; is it another patient's?")
        export_tree(output, given)
    else:
        airways = _airways(volume, seed=None, from_mask=from_mask, label=label, resample=resample)
        given = given or airways.tree
        export_airways(output, volume, airways, tree=given, progress=progress_printer())
    say(f"wrote {output}")
    if as_json:
        print_json({"output": str(output), "num_branches": len(given)})
    return 0


def _open(path: Path, series: str | None) -> Volume:
    volume = carina.open_volume(path, series=series, progress=progress_printer())
    for warning in volume.source.warnings:
        say(f"note: {warning}")
    return volume


def _check_mask_options(from_mask: Path | None, label: int | None, resample: bool) -> None:
    if from_mask is None and (label is not None or resample):
        raise UsageError("--label and --resample say how to read a mask; give one with --from-mask")


def _airways(
    volume: Volume, *, seed: NDArray[np.float64] | None, from_mask: Path | None, label: int | None, resample: bool
) -> Airways:
    progress = progress_printer()
    lumen = None
    if from_mask is not None:
        mask = open_mask(from_mask, volume, label=label, resample=resample, progress=progress)
        lumen = mask.inside_zyx
        for note in mask.notes:
            say(f"note: {note}")
    airways = carina.find_airways(volume, root_lps=seed, lumen_zyx=lumen, progress=progress)
    for note in airways.notes:
        say(f"note: {note}")
    return airways


def _rows(airways: Airways) -> list[dict[str, Any]]:
    return [
        {
            "id": branch.id,
            "parent": branch.parent,
            "generation": branch.generation,
            "name": branch.name,
            "name_confidence": branch.name_confidence,
            "variant": branch.variant,
            "kind": branch.kind,
            "confidence": branch.confidence,
            "length_mm": branch.length_mm,
            "lumen_mm": 2.0 * float(np.median(branch.radius)),
        }
        for branch in airways.tree.branches
    ]
