"""``carina insert``: insert a nodule into a CT for training, and write the marked CT."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carina.cli.arguments import check_output_file, check_range
from carina.cli.console import print_json, print_note, print_result, progress_printer
from carina.cli.opened import check_case_options, open_input
from carina.disk import write_whole
from carina.errors import UsageError
from carina.training import free_nodule_position, insert_nodule
from carina.training.insert_nodule import DIAMETER_MM, NoduleKind
from carina.volume import GRID_SUFFIXES, check_grid_fits, write_grid
from carina.volume.inserted_structures import file_mark

KINDS: tuple[NoduleKind, ...] = ("solid", "part-solid", "ground-glass")


def report(
    path: Path,
    *,
    output: Path,
    at_lps: NDArray[np.float64] | None,
    kind: str,
    diameter_mm: float,
    core_mm: float | None,
    density_hu: float | None,
    spiculation: float,
    seed: int,
    through_vessels: bool,
    truth: Path | None,
    series: str | None,
    strict: bool,
    ct: Path | None,
    as_json: bool,
) -> int:
    """Insert a nodule at a point, or at a random free position, and write the CT and the truth."""
    chosen = next((one for one in KINDS if one == kind), None)
    if chosen is None:
        raise UsageError(f"--kind: expected {', '.join(KINDS)}; found {kind!r}")
    check_range("--diameter-mm", diameter_mm, *DIAMETER_MM, "mm")
    check_range("--spiculation", spiculation, 0.0, 1.0)
    check_output_file(output, *GRID_SUFFIXES)
    if truth is not None:
        check_output_file(truth, ".json", what="--truth")
    if output.exists() and path.exists() and output.samefile(path):
        raise UsageError(f"-o: {output} is the scan itself, which is never changed; choose another file")
    check_case_options(path, ct)
    progress = progress_printer()
    source = open_input(path, series=series, strict=strict, progress=progress, ct=ct)
    volume = source.volume
    check_grid_fits(output, volume.shape_zyx, volume.lps_from_ijk, what="the CT")
    airways = source.airways(progress)
    place = at_lps
    if place is None:
        place = free_nodule_position(
            volume,
            airways,
            diameter_mm=diameter_mm,
            spiculation=spiculation,
            seed=seed,
            through_vessels=through_vessels,
        )
    made = insert_nodule(
        volume,
        airways,
        place,
        kind=chosen,
        diameter_mm=diameter_mm,
        core_diameter_mm=core_mm,
        density_hu=density_hu,
        spiculation=spiculation,
        seed=seed,
        through_vessels=through_vessels,
    )
    # Level 1: noise does not become smaller at a higher level.
    write_grid(
        output, made.volume.hu_zyx, volume.lps_from_ijk, what="the CT", note=file_mark(made.volume.source), level=1
    )
    print_note(f"wrote {output}")
    if truth is not None:
        write_whole(truth, json.dumps(made.to_json(), indent=2).encode(), what="the truth of the nodule")
        print_note(f"wrote {truth}")
    source.badges.add([made.note])
    if as_json:
        print_json({"output": str(output), **made.to_json(), "badges": source.badges.to_json()})
    else:
        x, y, z = made.centre_lps
        print_result(
            f"{made.kind} nodule of {made.diameter_mm:g} mm ({made.volume_mm3:.0f} mm3) inserted at "
            f"{x:.1f},{y:.1f},{z:.1f} (LPS, mm)"
        )
    return 0
