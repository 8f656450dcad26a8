"""Cross-section measures of trees made by hand: one section per centreline point, with the widths that a test sets."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from carina.track import AirwayTree, Branch, BranchMeasures, BranchSummary, ForkMeasures, TreeMeasures

__all__ = ["exact_measures"]


def exact_measures(
    tree: AirwayTree,
    *,
    error_mm: float = 0.1,
    widths_mm: Mapping[int, np.ndarray] | None = None,
    flat: float = 1.0,
    missing: Mapping[int, slice] | None = None,
    method: int = 2,
) -> TreeMeasures:
    """Return cross-section measures of a tree with given diameters and errors.

    Parameters
    ----------
    error_mm
        Error of the diameter of each section.
    widths_mm
        Diameters (n,) of the sections by branch ID; other branches have the diameters of the lumen in the tree.
    flat
        Ratio of the smallest width of each section to its diameter.
    missing
        Slices of section indices, by branch ID, whose sections could not be measured.
    method
        Value of `BranchMeasures.method` of each branch.
    """
    widths_mm, missing = widths_mm or {}, missing or {}
    forks = [
        ForkMeasures(branch.id, branch.children, tuple(map(float, branch.points[-1])), None, None, None)
        for branch in tree.branches
        if branch.children
    ]

    def measured(branch: Branch) -> BranchMeasures:
        diameter = np.array(widths_mm.get(branch.id, 2.0 * branch.radius), dtype=np.float64)
        if branch.kind != "tracked":
            diameter[:] = np.nan
        diameter[missing.get(branch.id, slice(0, 0))] = np.nan
        num = len(branch.points)
        error = np.where(np.isfinite(diameter), error_mm, np.nan)
        none = np.full(num, np.nan)
        return BranchMeasures(
            branch_id=branch.id,
            at_mm=np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(branch.points, axis=0), axis=1))]),
            centre_lps=branch.points,
            normal_lps=np.tile([0.0, 0.0, 1.0], (num, 1)),
            area_mm2=0.25 * np.pi * diameter**2,
            equivalent_mm=diameter,
            min_mm=flat * diameter,
            max_mm=diameter / flat,
            wall_mm=none,
            at_junction=np.zeros(num, np.bool_),
            at_edge=np.zeros(num, np.bool_),
            area_error_mm2=none,
            equivalent_error_mm=error,
            min_error_mm=error,
            max_error_mm=error,
            wall_error_mm=none,
            shift_mm=none,
            edge_mm=np.zeros((num, 0)),
            outer_mm=np.zeros((num, 0)),
            share=np.ones(num),
            summary=BranchSummary(),
            method=method,
        )

    return TreeMeasures(tuple(measured(branch) for branch in tree.branches), tuple(forks), (0.4, 0.4), 25.0)
