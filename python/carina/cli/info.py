"""``carina info``: facts about a scan, a case or another file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from carina.cli.case import case_json, case_lines
from carina.cli.console import print_json, print_note, print_result, progress_printer
from carina.cli.opened import check_case_options, open_input_volume
from carina.session import is_case_file
from carina.track import CtAssessment, assess_ct
from carina.volume import Quality, badges_of, inspect_path, quality_gate


def report(path: Path, *, strict: bool, series: str | None, as_json: bool, ct: Path | None = None) -> int:
    """Print the facts about a path; return 3 with ``strict`` if there is a badge or a finding of the quality gate."""
    check_case_options(path, ct)
    progress = progress_printer()
    inspection = None if is_case_file(path) else inspect_path(path, series=series)
    volume = open_input_volume(path, series=series, progress=progress, ct=ct)
    case: dict[str, Any] = {"case": case_json(path)} if is_case_file(path) else {}
    quality: Quality | CtAssessment = assess_ct(volume) if volume.is_hu else quality_gate(volume)
    badges = badges_of(volume)
    low, high = volume.value_range
    if as_json:
        print_json(
            {
                "format": volume.source.format,
                "title": volume.source.title,
                "shape_zyx": list(volume.shape_zyx),
                "spacing_mm": list(volume.spacing_mm),
                "lps_from_ijk": volume.lps_from_ijk.tolist(),
                "unit": "HU" if volume.is_hu else None,
                "not_hu_reason": volume.not_hu_reason,
                "range": [low, high],
                "warnings": list(volume.source.warnings),
                "notes": [note.to_json() for note in volume.source.notes],
                "badges": [note.to_json() for note in badges],
                "interpolated_slices": list(volume.source.interpolated_slices),
                "tilt_deg": volume.source.tilt_deg,
                "citation": None if volume.source.citation is None else str(volume.source.citation),
                "inspection": None if inspection is None else inspection.to_json(),
                "quality": quality.to_json(),
                **case,
            }
        )
    else:
        nz, ny, nx = volume.shape_zyx
        sx, sy, sz = volume.spacing_mm
        print_result(f"{volume.source.title} ({volume.source.format})")
        print_result(f"  {nx} x {ny} x {nz} voxels of {sx:.3f} x {sy:.3f} x {sz:.3f} mm")
        unit = "HU" if volume.is_hu else f"not HU: {volume.not_hu_reason}"
        print_result(f"  values {low} to {high}, {unit}")
        for other in volume.source.other_series:
            state = f"cannot be opened: {other.refused}" if other.refused else "open it with --series"
            facts = [
                f"{other.thickness_mm:g} mm thick" if other.thickness_mm is not None else "",
                f"kernel {other.kernel}" if other.kernel and other.kernel not in other.description else "",
                other.phase,
            ]
            print_result(
                f"  also found: series {other.key}, {other.modality}, {other.num_slices} slices, "
                f"{', '.join(filter(None, [other.description or 'no description', *facts]))} ({state})"
            )
        for note in volume.source.notes:
            print_result(f"  {'finding' if note.badge else 'note'}: {note.words}")
        shown: set[str] = set()
        if isinstance(quality, CtAssessment):
            shown = {one.words for one in quality.statement if one.limits}
            for one in quality.statement:
                print_result(f"  {'quality' if one.limits else 'check'}: {one.name}: {one.words}")
            print_result(f"  {quality.trusted_words}")
        for finding in quality.findings:
            if not any(finding.words in words for words in shown):
                print_result(f"  quality: {finding.words}")
        if volume.source.citation:
            print_result(f"  {volume.source.citation}")
        if case:
            print_result(*case_lines(path))
    if strict and (quality.findings or badges):
        codes = ", ".join([*(badge.code for badge in badges), *(finding.code for finding in quality.findings)])
        print_note(f"carina: the scan check found problems ({codes}); exit code 3 because of --strict")
        return 3
    return 0
