"""``carina airways`` and ``carina export``: find the airways of a scan, and write them in other formats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import carina
from carina.cli.adding import add_branches, error_json
from carina.cli.arguments import check_needs, check_output_file, check_range
from carina.cli.console import print_json, print_note, print_result, progress_printer
from carina.cli.opened import (
    Badges,
    OpenedInput,
    assessment_json,
    check_case_options,
    open_input,
    print_assessment,
)
from carina.errors import UsageError
from carina.export import (
    EXPORT_FORMATS,
    EXPORT_TITLES,
    MASK_SUFFIXES,
    check_export,
    check_mask_file,
    export_airways,
    export_tree,
    is_tree_file,
    printable_mould,
    printable_phantom,
    read_tree,
    write_mask,
    write_mesh,
    write_tree,
)
from carina.export.printable_mould import MOULD_PARTS
from carina.export.printable_phantom import BUILD_MM, LEAST_WALL_MM, WALL_MM
from carina.track import Absence, Airways, TreeMeasures, TreeRow, drawn_tree, kind_words, lumen_mask, measure_tree
from carina.volume import Volume, open_mask


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
    strict: bool = False,
    add_lps: Sequence[NDArray[np.float64]] = (),
    even_without_evidence: bool = False,
    ct: Path | None = None,
) -> int:
    """Find the airways of a scan, write the tree and the mask on request, and print the result.

    Return 4 if a requested branch could not be added, else 0; the other results are written in both cases.
    """
    if even_without_evidence and not add_lps:
        raise UsageError("--even-without-evidence only applies to added branches; add one with --add-branch x,y,z")
    if output is not None:
        check_output_file(output, ".json")
    if mask is not None:
        check_output_file(mask, *MASK_SUFFIXES, what="--mask")
    _check_mask_options(from_mask, label, resample)
    check_case_options(path, ct, seed=seed is not None, from_mask=from_mask)
    source = open_input(path, series=series, progress=progress_printer(), strict=strict, ct=ct)
    volume, badges = source.volume, source.badges
    if mask is not None:
        check_mask_file(mask, volume)
    airways = _airways(source, seed=seed, from_mask=from_mask, label=label, resample=resample)
    badges.add_airways_notes(airways)
    added = add_branches(
        volume, airways, add_lps, even_without_evidence=even_without_evidence, progress=progress_printer()
    )
    airways, drawn = added.airways, drawn_tree(added.airways.tree)
    exit_code = added.refused[0].exit_code if added.refused else 0
    if output is not None:
        write_tree(output, airways.tree, badges=badges.notes)
        print_note(f"wrote {output}")
    inside_zyx = lumen_mask(volume, airways)
    if mask is not None:
        note = None if drawn.words is None else f"{drawn.words}: not from the CT"
        write_mask(mask, inside_zyx, volume, note=note, badges=badges.notes)
        print_note(f"wrote {mask}")
    measures = measure_tree(volume, airways, progress=progress_printer())
    rows = _rows(airways, measures)
    lumen_ml = float(np.count_nonzero(inside_zyx)) * abs(np.linalg.det(volume.lps_from_ijk[:3, :3])) / 1000.0
    deepest = max(branch.generation for branch in airways.tree.branches)
    length_mm = sum(branch.length_mm for branch in airways.tree.branches)
    shares = airways.calibrated_shares
    if as_json:
        print_json(
            {
                "root_lps": [float(v) for v in airways.root_lps],
                "num_branches": len(airways.tree),
                "deepest_generation": deepest,
                "length_mm": length_mm,
                **drawn.to_json(),
                "lumen_ml": lumen_ml,
                "threshold": float(airways.threshold) if np.isfinite(airways.threshold) else None,
                "notes": list(airways.notes),
                "absent": [_absence_row(absence) for absence in airways.absent],
                "badges": badges.to_json(),
                "assessment": assessment_json(volume, airways),
                "calibrated_shares": None if shares is None else shares.to_json(),
                "added": list(added.rows),
                "branches": rows,
                **({} if not added.refused else {"error": error_json(added.refused[0])}),
            }
        )
        return exit_code
    print_result(
        f"{len(airways.tree)} branches up to generation {deepest}, {length_mm / 1000.0:.2f} m in total, "
        f"lumen volume {lumen_ml:.1f} ml"
    )
    for row in airways.tree.rows():
        kind = kind_words(row.branches[0].kind)
        wide = _width(row, measures) if kind is None else f"{kind}: the CT shows no airway here"
        print_result(f"{'  ' * row.depth}{row.id:>4} {row.name or '-':<18} {row.length_mm:6.1f} mm long, {wide}")
    for absence in airways.absent:
        print_result(absence.words)
    return exit_code


def _absence_row(absence: Absence) -> dict[str, Any]:
    return {
        "name": absence.name,
        "kind": absence.kind,
        "carrier": absence.carrier,
        "beyond_mm": absence.beyond_mm,
        "lps": None if absence.lps is None else list(absence.lps),
        "width_mm": absence.width_mm,
        "branch_id": absence.branch_id,
        "slice_from_feet": absence.slice_number,
        "num_slices": absence.num_slices,
        "words": absence.words,
    }


def print_formats() -> None:
    """Print the formats that ``carina export`` writes, and the programs that read them."""
    for kind, title in EXPORT_TITLES.items():
        print_result(title)
        for row in EXPORT_FORMATS:
            if row.kind == kind:
                print_result(f"  {row.suffix:<10} {row.words}")


@dataclass(frozen=True, slots=True)
class PrintOptions:
    """Options of a printable phantom or mould."""

    mould: bool
    wall_mm: float
    open_tips: bool
    names: bool
    build_mm: tuple[float, float, float]
    least_wall_mm: float

    @classmethod
    def of(
        cls,
        *,
        wanted: bool,
        mould: bool,
        wall_mm: float | None,
        open_tips: bool,
        no_names: bool,
        build_mm: NDArray[np.float64] | None,
        least_wall_mm: float | None,
    ) -> PrintOptions | None:
        """Return the options, checked; None if no printable phantom is wanted."""
        if not wanted:
            check_needs(
                "a printable phantom (--phantom-print)",
                mould=mould,
                wall_mm=wall_mm,
                open_tips=open_tips,
                no_names=no_names,
                build_mm=build_mm,
                least_wall_mm=least_wall_mm,
            )
            return None
        if mould and open_tips:
            raise UsageError(
                "--open-tips only applies without --mould; the supports of the core open the tips of a cast"
            )
        check_range("--wall-mm", wall_mm, *WALL_MM, "mm")
        check_range("--least-wall-mm", least_wall_mm, 0.1, 10.0, "mm")
        sides = BUILD_MM if build_mm is None else (float(build_mm[0]), float(build_mm[1]), float(build_mm[2]))
        for side in sides:
            check_range("--build-mm", side, 10.0, 5000.0, "mm")
        return cls(
            mould,
            2.0 if wall_mm is None else wall_mm,
            open_tips,
            not no_names,
            sides,
            LEAST_WALL_MM if least_wall_mm is None else least_wall_mm,
        )


def write(
    path: Path,
    *,
    printed: PrintOptions | None,
    output: Path,
    tree: Path | None,
    from_mask: Path | None,
    label: int | None,
    resample: bool,
    series: str | None,
    as_json: bool,
    strict: bool = False,
    ct: Path | None = None,
) -> int:
    """Find the airways, or read a tree from a file, and write them in another format."""
    if printed is not None:
        check_output_file(output, ".stl", ".ply", ".obj")
        for part in MOULD_PARTS if printed.mould else ():
            check_output_file(_part_file(output, part))
        if tree is not None:
            raise UsageError("--tree only applies to formats without the lumen; --phantom-print needs the lumen")
    try:
        tree_alone = is_tree_file(output)
    except UsageError as error:
        raise UsageError(f"-o: {error}") from None
    check_output_file(output)
    _check_mask_options(from_mask, label, resample)
    if tree is not None and tree_alone:
        check_needs("formats with the lumen, or without --tree", from_mask=from_mask)
    check_case_options(path, ct, tree=tree, from_mask=from_mask)
    given = None if tree is None else read_tree(tree)
    airways: Airways | None = None
    source = open_input(path, series=series, progress=progress_printer(), strict=strict, ct=ct)
    volume, badges = source.volume, source.badges
    check_export(output, volume)
    if tree is not None:
        badges.add_tree(tree)
    if given is not None and tree_alone:
        nowhere = [b.id for b in given.branches if not any(volume.contains_lps(point) for point in b.points)]
        if len(nowhere) == len(given):
            raise UsageError(
                f"--tree: no branch of {tree} lies within the scan {path.name}; the tree may belong to another patient"
            )
        export_tree(output, given, badges=badges.notes)
    elif printed is not None:
        airways = _airways(source, seed=None, from_mask=from_mask, label=label, resample=resample)
        badges.add_airways_notes(airways)
        write_it = _write_mould if printed.mould else _write_print
        return write_it(output, volume, airways, printed, badges, as_json=as_json)
    else:
        airways = _airways(source, seed=None, from_mask=from_mask, label=label, resample=resample)
        given = given or airways.tree
        badges.add_airways_notes(airways)
        export_airways(output, volume, airways, tree=given, badges=badges.notes, progress=progress_printer())
    print_note(f"wrote {output}")
    if as_json:
        print_json(
            {
                "output": str(output),
                "num_branches": len(given),
                "badges": badges.to_json(),
                "assessment": assessment_json(volume, airways),
            }
        )
    return 0


def _write_print(
    output: Path, volume: Volume, airways: Airways, printed: PrintOptions, badges: Badges, *, as_json: bool
) -> int:
    """Write a printable phantom, and print its facts."""
    made = printable_phantom(
        volume,
        airways,
        wall_mm=printed.wall_mm,
        open_tips=printed.open_tips,
        names=printed.names,
        build_mm=printed.build_mm,
        least_wall_mm=printed.least_wall_mm,
        progress=progress_printer(),
    )
    drawn = drawn_tree(airways.tree).words
    note = None if drawn is None else f"{drawn}: not from the CT"
    write_mesh(output, made.mesh, note=note, badges=badges.notes, contents="printable airway wall")
    print_note(f"wrote {output}")
    if made.num_narrow:
        print_note(f"note: {made.num_narrow} branches have a lumen below 2 mm, which a print may block")
    if made.names_left_out:
        print_note(f"note: no room for the names {', '.join(made.names_left_out)}")
    if as_json:
        notes = {"badges": badges.to_json(), "assessment": assessment_json(volume, airways)}
        print_json({"output": str(output), **made.to_json(), **notes})
    else:
        x, y, z = made.size_mm
        print_result(
            f"wall of {made.wall_mm:g} mm, {x:.0f} x {y:.0f} x {z:.0f} mm, {made.mesh.volume_mm3 / 1000.0:.0f} ml of "
            f"material, {len(made.names)} names"
        )
    return 0


def _part_file(output: Path, part: str) -> Path:
    """Return the file of a part of the mould: its name ends with the name of the part."""
    return output.with_name(f"{output.stem}-{part}{output.suffix}")


def _write_mould(
    output: Path, volume: Volume, airways: Airways, printed: PrintOptions, badges: Badges, *, as_json: bool
) -> int:
    """Write the parts of a mould, and print its facts."""
    made = printable_mould(
        volume,
        airways,
        wall_mm=printed.wall_mm,
        names=printed.names,
        build_mm=printed.build_mm,
        least_wall_mm=printed.least_wall_mm,
        progress=progress_printer(),
    )
    drawn = drawn_tree(airways.tree).words
    note = None if drawn is None else f"{drawn}: not from the CT"
    files = [_part_file(output, part) for part in made.parts]
    for file, (part, mesh) in zip(files, made.parts.items(), strict=True):
        write_mesh(file, mesh, note=note, badges=badges.notes, contents=f"mould of the airway wall, {part}")
        print_note(f"wrote {file}")
    if made.num_left_out:
        reason = "a half would enclose them, or their lumen is too thin for a core"
        print_note(f"note: {made.num_left_out} branches are not in the mould, because {reason}")
    if as_json:
        outputs = [str(file) for file in files]
        notes = {"badges": badges.to_json(), "assessment": assessment_json(volume, airways)}
        print_json({"output": str(output), "files": outputs, **made.to_json(), **notes})
    else:
        print_result(
            f"mould of {len(made.branches)} branches for a cast of {made.wall_mm:g} mm: front, back and core, "
            f"{len(made.names)} names"
        )
    return 0


def _check_mask_options(from_mask: Path | None, label: int | None, resample: bool) -> None:
    check_range("--label", label, 0, 2**31 - 1)
    if from_mask is None and (label is not None or resample):
        raise UsageError("--label and --resample only apply to an imported segmentation; specify one with --from-mask")


def _airways(
    source: OpenedInput, *, seed: NDArray[np.float64] | None, from_mask: Path | None, label: int | None, resample: bool
) -> Airways:
    progress = progress_printer()
    if source.moment is not None:
        return source.airways(progress)
    volume, lumen = source.volume, None
    if from_mask is not None:
        mask = open_mask(from_mask, volume, label=label, resample=resample, progress=progress)
        lumen = mask.inside_zyx
        for note in mask.notes:
            print_note(f"note: {note}")
    airways = carina.find_airways(volume, root_lps=seed, lumen_zyx=lumen, progress=progress)
    for note in airways.notes:
        print_note(f"note: {note}")
    print_assessment(volume, airways)
    return airways


def _rows(airways: Airways, measures: TreeMeasures) -> list[dict[str, Any]]:
    row_of = {branch.id: row.id for row in airways.tree.rows() for branch in row.branches}
    return [
        {
            "id": branch.id,
            "parent": branch.parent,
            # The pieces of a bronchus between its side branches have the same name.
            "row": row_of[branch.id],
            "generation": branch.generation,
            "name": branch.name,
            "name_confidence": branch.name_confidence,
            "variant": branch.variant,
            "kind": branch.kind,
            "confidence": branch.confidence,
            "doubtful_mm": round(branch.doubtful_mm, 2),
            "length_mm": branch.length_mm,
            "lumen_mm": measures.of(branch.id).summary.mean_mm,
            "lumen_error_mm": measures.of(branch.id).summary.mean_error_mm,
        }
        for branch in airways.tree.branches
    ]


def _width(row: TreeRow, measures: TreeMeasures) -> str:
    """Return the range of diameters of a row as text, such as "3.1 to 4.0 mm wide"; another text if none is known."""
    found = [measures.of(branch.id).summary.mean_mm for branch in row.branches]
    known = [f"{mm:.1f}" for mm in sorted(mm for mm in found if mm is not None)]
    if not known:
        return "its width cannot be measured"
    width = known[0] if known[0] == known[-1] else f"{known[0]} to {known[-1]}"
    return f"{width:>4} mm wide"
