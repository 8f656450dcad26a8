"""Letters of subsegments: a, b, c at the first fork of a segment, i, ii, iii at the next."""

from __future__ import annotations

import enum
import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


class LetterRule(enum.StrEnum):
    """Rule for the order in which the subsegments of a segment get their letters."""

    TOP_LATERAL_BACK = "top-lateral-back"
    """Letter a is the upper subsegment, else the lateral one, else the posterior one.

    The axis along which the subsegments are farthest apart decides. This rule is usual in Japan and in surgery.
    """
    BACK_FIRST = "back-first"
    """Letter a is the posterior subsegment, and letter b the anterior one, whatever their other positions."""


def letter_order(middles: Sequence[NDArray[np.float64]], rule: LetterRule) -> tuple[list[int], float]:
    """Return the indices of siblings in the order of their letters, and the certainty of this order (0 to 1).

    Parameters
    ----------
    middles
        Centre of the region that each sibling supplies, mm: x lateral, y posterior, z superior along the axes of the
        body.
    rule
        Rule for the order.
    """
    points = np.array(middles)
    # On the axis that decides, the sibling with the larger coordinate gets the first letter.
    spread = np.ptp(points, axis=0)
    axis = 1 if rule is LetterRule.BACK_FIRST else max((2, 0, 1), key=lambda a: (float(spread[a]), -a))
    order = sorted(range(len(points)), key=lambda k: (-float(points[k][axis]), k))
    sure = 1.0
    for before, after in itertools.pairwise(order):
        apart = points[before] - points[after]
        along = float(apart[axis]) ** 2
        if rule is LetterRule.BACK_FIRST:
            # The order is uncertain if siblings lie mainly side by side instead of one behind the other.
            against = 0.5 * float((apart**2).sum() - along)
        else:
            # Another axis that implies the opposite order, with nearly the same distance, makes the order uncertain.
            against = float((np.minimum(apart, 0.0) ** 2).sum())
        sure = min(sure, along / max(along + against, 1e-9))
    return order, sure
