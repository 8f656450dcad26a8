"""Division of a picture into strips (paper 5.1, Figure 8)."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import TypeVar

from carina.errors import UsageError

Lane = TypeVar("Lane", bound=Hashable)


def cut_rows(
    num_rows: int, shares: Mapping[Lane, float], *, min_rows: int, max_rows: int | None = None
) -> list[tuple[Lane, int, int]]:
    """Return the rows of a picture for each lane, top to bottom in the order of ``shares``.

    Parameters
    ----------
    num_rows
        Height of the picture.
    shares
        Share of each lane, in any unit, at least 0.
    min_rows
        Smallest height of a lane's band. If there are too few rows, the slowest lanes get none.
    max_rows
        Higher bands are divided into strips of about equal height; None for no limit.

    Returns
    -------
    list of (lane, first row, row after the last)
        Each row exactly once. Heights follow the shares to within a row, except for ``min_rows``.

    Raises
    ------
    UsageError
        If there is no lane or no row.
    """
    if not shares or num_rows < 1:
        raise UsageError(f"cannot divide {num_rows} image rows among {len(shares)} renderers", code="usage.cluster")
    # The fastest lanes come first, because the others get none if rows are few. Ties keep their order.
    max_lanes = max(1, num_rows // min_rows)
    served = sorted(shares, key=lambda lane: -shares[lane])[:max_lanes]
    heights = dict.fromkeys(served, min(min_rows, num_rows))
    spare = num_rows - sum(heights.values())
    # Rows of a lane beyond its minimum; a lane whose share is below the minimum leaves no rows to the others.
    total = sum(shares[lane] for lane in served)
    wanted = {
        lane: max(0.0, (num_rows * shares[lane] / total if total > 0.0 else num_rows / len(served)) - heights[lane])
        for lane in served
    }
    sum_wanted = sum(wanted.values())
    if spare and sum_wanted > 0.0:
        exact = {lane: spare * wanted[lane] / sum_wanted for lane in served}
        for lane in served:
            heights[lane] += int(exact[lane])
        left = num_rows - sum(heights.values())
        for lane in sorted(served, key=lambda lane: -(exact[lane] % 1.0))[:left]:
            heights[lane] += 1
    # Rounding can leave one or two rows although all remainders are zero; the fastest lane gets these rows.
    heights[served[0]] += num_rows - sum(heights.values())
    strips: list[tuple[Lane, int, int]] = []
    first = 0
    for lane in shares:
        height = heights.get(lane, 0)
        parts = 1 if max_rows is None else max(1, -(-height // max(1, max_rows)))
        for n in range(parts):
            start, end = first + height * n // parts, first + height * (n + 1) // parts
            if end > start:
                strips.append((lane, start, end))
        first += height
    return strips
