"""Conversion of the airway tree to wire messages: branches, full names, measurements, and open ends."""

from __future__ import annotations

import math
from typing import Any, cast

import msgspec
import numpy as np

from carina.server.wire import messages as wire
from carina.server.wire.codec import read_fields
from carina.track import Uncertainty, branch_side_and_lobe, name_words


def tree_message(airways: Any, measures: Any = None) -> wire.Tree:
    """Return the airway tree in the format of its files, with titles, measures once they are ready, and open ends.

    Parameters
    ----------
    airways
        :class:`carina.track.Airways`, or None.
    measures
        :class:`carina.track.TreeMeasures` of the same airways, or None if they are not ready.
    """
    if airways is None:
        return wire.Tree(None, (), None, (), ())
    tree = airways.tree
    measured = None if measures is None else tuple(branch_measures(measures.of(b.id)) for b in tree.branches)
    document = read_fields(wire.TreeDocument, tree.to_json(), "tree")
    absent = tuple(wire.AbsentAirway(one.full_name, one.reason, one.lps) for one in airways.absent)
    return wire.Tree(document, _titles(tree), measured, tuple(map(_uncertain_place, airways.uncertain)), absent)


def _uncertain_place(place: Uncertainty) -> wire.UncertainPlace:
    return wire.UncertainPlace(
        **msgspec.structs.asdict(place), statement=place.statement, explanation=place.explanation
    )


def _titles(tree: Any) -> tuple[wire.BranchTitle, ...]:
    lobes = branch_side_and_lobe(tree)
    found = []
    for branch in tree.branches:
        words = None if branch.name is None else name_words(branch.name)
        lobe = lobes.get(branch.id)
        if words is not None or lobe is not None:
            found.append(wire.BranchTitle(branch.id, None if words is None else words.long, cast(Any, lobe)))
    return tuple(found)


def branch_measures(measures: Any) -> wire.BranchMeasuresSummary:
    """Return the wire message with the summary of a branch's measurements (:class:`carina.track.BranchMeasures`)."""
    summary = measures.summary
    widths = np.where(measures.is_usable, measures.equivalent_mm, np.nan)
    most = None if np.isnan(widths).all() else int(np.nanargmax(widths))
    errors = measures.equivalent_error_mm
    stenosis = summary.stenosis
    return wire.BranchMeasuresSummary(
        branch_id=measures.branch_id,
        length_mm=round(summary.length_mm, 2),
        by_earlier_method=measures.is_by_earlier_method,
        lumen_mm=_number(summary.mean_mm),
        lumen_error_mm=_number(summary.mean_error_mm),
        min_lumen_mm=_number(summary.min_mm),
        min_lumen_error_mm=_number(_narrowest_error_mm(measures)),
        min_at_mm=_number(summary.min_at_mm),
        max_lumen_mm=None if most is None else _number(widths[most]),
        max_lumen_error_mm=None if most is None else _number(errors[most]),
        wall_mm=_number(summary.wall_mm),
        wall_error_mm=_number(summary.wall_error_mm),
        taper=_number(summary.taper, 4),
        angle_deg=_number(summary.angle_deg, 1),
        stenosis_percent=None if stenosis is None else _number(stenosis.percent, 1),
        stenosis_error_percent=None if stenosis is None else _number(stenosis.percent_error, 1),
        stenosis_at_mm=None if stenosis is None else _number(stenosis.at_mm),
    )


def _narrowest_error_mm(measures: Any) -> float | None:
    """Return the error in mm of a branch's narrowest diameter; None if it is unknown.

    Measurements of earlier versions do not contain this error; the error at the smallest cross-section replaces it.
    """
    summary = measures.summary
    if summary.min_mm is None or summary.min_error_mm is not None:
        return cast(float | None, summary.min_error_mm)
    widths = np.where(measures.is_usable, measures.equivalent_mm, np.nan)
    return float(measures.equivalent_error_mm[int(np.nanargmin(widths))])


def branch_detail_message(message: wire.AskBranchDetail, measures: Any) -> wire.BranchDetail:
    """Return the measurements along a branch for the chart; their fields are None until they are ready."""
    if measures is None:
        return wire.BranchDetail(message.request_id, message.branch_id, None, None)
    profile = wire.BranchProfile(
        at_mm=tuple(round(float(v), 3) for v in measures.at_mm),
        lumen_mm=_numbers(measures.equivalent_mm),
        lumen_error_mm=_numbers(measures.equivalent_error_mm),
        min_mm=_numbers(measures.min_mm),
        max_mm=_numbers(measures.max_mm),
        wall_mm=_numbers(measures.wall_mm),
        at_junction=tuple(bool(v) for v in np.asarray(measures.at_junction) | np.asarray(measures.at_edge)),
    )
    return wire.BranchDetail(message.request_id, message.branch_id, branch_measures(measures), profile)


def _number(value: Any, digits: int = 3) -> float | None:
    return None if value is None or not math.isfinite(value) else round(float(value), digits)


def _numbers(values: Any) -> tuple[float | None, ...]:
    return tuple(_number(v) for v in values)
