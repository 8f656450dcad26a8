"""Airway measures in a case file: edits that leave a branch unchanged share one stored copy of its cross-sections."""

from __future__ import annotations

from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from carina.case import json_records as f
from carina.case.bounds import MAX_MM, MAX_NUMBER, bounded_array
from carina.case.compression import deflate, inflate, pack_ints, unpack_ints
from carina.case.error_texts import damage_error
from carina.track import BranchMeasures, BranchSummary, ForkMeasures, Stenosis
from carina.track.measures.branch_measures import RAYS_PER_MM

FIGURES: Final = {
    "at_mm": 1,
    "centre_lps": 3,
    "normal_lps": 3,
    "area_mm2": 1,
    "equivalent_mm": 1,
    "min_mm": 1,
    "max_mm": 1,
    "wall_mm": 1,
    "area_error_mm2": 1,
    "equivalent_error_mm": 1,
    "min_error_mm": 1,
    "max_error_mm": 1,
    "wall_error_mm": 1,
    "shift_mm": 1,
    "share": 1,
}
"""Number of values per cross-section of each stored field, by field name in the order of storage."""
RAYS: Final = {"edge_mm": 64, "outer_mm": 64}
NO_RAY: Final = -1
AT_JUNCTION, AT_EDGE = 1, 2
MAX_SECTIONS: Final = 1_000_000


def sections_of(measures: BranchMeasures) -> dict[str, Any]:
    """Return the columns of a row of ``sections`` for the cross-sections of a branch."""
    columns = [np.asarray(getattr(measures, name), dtype="<f8") for name in FIGURES]
    # Stored field by field: similar values are then adjacent, which compresses better.
    figures = b"".join(np.ascontiguousarray(column.T).tobytes() for column in columns)
    rays = np.concatenate([getattr(measures, name) for name in RAYS], axis=1)
    steps = np.where(np.isfinite(rays), np.rint(rays * RAYS_PER_MM), NO_RAY).astype(np.int32)
    return {"num_sections": len(measures.at_mm), "figures": deflate(figures), "rays": pack_ints(steps.ravel())}


def flags_of(measures: BranchMeasures) -> bytes:
    """Return compressed flags, one integer per cross-section, that mark sections excluded from the summary."""
    return pack_ints(measures.at_junction * AT_JUNCTION + measures.at_edge * AT_EDGE)


def branch_facts(measures: BranchMeasures, fork: ForkMeasures | None) -> f.MeasuredFacts:
    """Return the summary of a branch and of the fork at its end, without the cross-sections."""
    summary, stenosis = measures.summary, measures.summary.measured_stenosis
    names = [name for name in f.SummaryFacts.__struct_fields__ if name != "stenosis"]
    return f.MeasuredFacts(
        branch_id=measures.branch_id,
        summary=f.SummaryFacts(
            **{name: getattr(summary, name) for name in names},
            stenosis=None
            if stenosis is None
            else f.StenosisFacts(*(getattr(stenosis, name) for name in f.StenosisFacts.__struct_fields__)),
        ),
        fork=None
        if fork is None
        else f.ForkFacts(
            children=tuple(fork.children),
            fork_lps=fork.fork_lps,
            carina_lps=fork.carina_lps,
            fork_to_carina_mm=fork.fork_to_carina_mm,
            angle_between_deg=fork.angle_between_deg,
        ),
        found_by=measures.found_by,
        method=measures.method,
    )


def branch_from(
    columns: tuple[Any, ...], flags: object, facts: f.MeasuredFacts, num_points: int, where: str
) -> BranchMeasures:
    """Return the measures of a branch, built from a row of ``sections``, the flags and the summary.

    Parameters
    ----------
    columns
        Number of sections, packed numbers and packed rays.
    flags
        Packed flags from :func:`flags_of`.
    facts
        Summary of the branch.
    num_points
        Expected number of sections.
    where
        Name of the row for messages.

    Raises
    ------
    CaseFileError
        ``case.damaged``.
    """
    count, figures, rays = columns
    if count != num_points or not 0 <= count <= MAX_SECTIONS:
        raise damage_error(where, f"{num_points} sections", str(count)[:40])
    width = sum(FIGURES.values())
    numbers = np.frombuffer(inflate(figures, 8 * width * count, where), dtype="<f8").reshape(width, count)
    known = numbers[~np.isnan(numbers)]
    bounded_array(known, where, -MAX_NUMBER, MAX_NUMBER)
    values: dict[str, Any] = {}
    at = 0
    for name, wide in FIGURES.items():
        values[name] = numbers[at] if wide == 1 else np.ascontiguousarray(numbers[at : at + wide].T)
        at += wide
    steps = unpack_ints(rays, sum(RAYS.values()) * count, where).reshape(count, sum(RAYS.values()))
    bounded_array(steps.ravel(), where, NO_RAY, MAX_MM * RAYS_PER_MM)
    at = 0
    for name, wide in RAYS.items():
        part = steps[:, at : at + wide]
        values[name] = np.where(part == NO_RAY, np.nan, part / RAYS_PER_MM)
        at += wide
    marks = unpack_ints(flags, count, where)
    bounded_array(marks, where, 0, AT_JUNCTION | AT_EDGE)
    return BranchMeasures(
        branch_id=facts.branch_id,
        at_junction=_read_only(marks & AT_JUNCTION != 0),
        at_edge=_read_only(marks & AT_EDGE != 0),
        summary=_summary_of(facts.summary),
        found_by=facts.found_by,
        method=facts.method,
        **{name: _read_only(value) for name, value in values.items()},
    )


def fork_from(facts: f.MeasuredFacts) -> ForkMeasures | None:
    """Return the measures of the fork at the end of a branch; None for a branch that ends at a tip."""
    fork = facts.fork
    return None if fork is None else ForkMeasures(facts.branch_id, **msgspec.structs.asdict(fork))


def _summary_of(facts: f.SummaryFacts) -> BranchSummary:
    values = msgspec.structs.asdict(facts)
    stenosis = values.pop("stenosis")
    return BranchSummary(
        **values, measured_stenosis=None if stenosis is None else Stenosis(**msgspec.structs.asdict(stenosis))
    )


def _read_only(values: NDArray[Any]) -> NDArray[Any]:
    values.flags.writeable = False
    return values
