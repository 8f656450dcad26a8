"""Letters of subsegments: a, b, c at the first fork of a segment, i, ii, iii at the next."""

from __future__ import annotations

import enum
import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["LetterRule", "letter_order"]


class LetterRule(enum.StrEnum):
    """In which order the subsegments of a segment get their letters."""

    TOP_LATERAL_BACK = "top-lateral-back"
    """Top before bottom, lateral before medial, back before front; the axis along which they lie farthest apart
    decides. Usual in Japan and in surgery."""
    BACK_FIRST = "back-first"
    """a is the posterior one, b the anterior one."""


def letter_order(middles: Sequence[NDArray[np.float64]], rule: LetterRule) -> tuple[list[int], float]:
    """The order in which siblings get their letters, and how sure it is (0..1).

    Parameters
    ----------
    middles
        Middles of what each supplies, body frame: x lateral, y posterior, z superior, mm.
    """
    points = np.array(middles)
    # Larger comes first, along each axis.
    spread = np.ptp(points, axis=0)
    axis = 1 if rule is LetterRule.BACK_FIRST else max((2, 0, 1), key=lambda a: (float(spread[a]), -a))
    order = sorted(range(len(points)), key=lambda k: (-float(points[k][axis]), k))
    sure = 1.0
    for before, after in itertools.pairwise(order):
        apart = points[before] - points[after]
        along = float(apart[axis]) ** 2
        if rule is LetterRule.BACK_FIRST:
            # Side by side, the rule says little.
            against = 0.5 * float((apart**2).sum() - along)
        else:
            # Another axis that says the opposite, nearly as loudly, makes it a matter of opinion.
            against = float((np.minimum(apart, 0.0) ** 2).sum())
        sure = min(sure, along / max(along + against, 1e-9))
    return order, sure
