"""How well a tree fits a human bronchial tree, whatever its size, and what that leaves of the confidence of names."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from carina.track.names.model import Grammar
from carina.track.names.shape import Bronchus, Lung
from carina.track.names.solve import Solver
from carina.volume.model import Note

__all__ = ["MISFIT", "POOR_FIT", "calibrated", "fit_of", "misfit_note"]

Frame = NDArray[np.float64]

MISFIT = "track.tree-unlike-human"
POOR_FIT = 1.5
"""A tree that fits less well is no human bronchial tree, or not in the orientation of its file: docs/decisions/0116."""
AGAINST = 1.5
"""What an advantage over the other orientations counts, beside the evidence itself."""
MIRRORED_FIT = 0.75
"""Situs inversus is rare and a tree of any kind may fit a mirrored one: it must fit better by this much."""
MIN_READ = 10
"""Bronchi that carry a reading; with fewer the fit is chance."""
GOOD_FIT = 4.0
"""A tree that fits better is as good as any."""
# Log odds of a right name: at even odds of its reading, per log odds of the reading, per nat below a good fit. From
# trees of phantoms (seeds 101 to 124: true ones, degraded and warped into other anatomies, and those found in CTs) and
# judged on the seeds 201 to 224 (docs/decisions/0116; carina_bench.track_confidence makes them).
NAME_ODDS = (0.295, 1.073, 0.706)
SUREST = 0.995
"""Readings are not taken for surer than this."""


def calibrated(reading: float, fit: float | None) -> float:
    """How often a name whose reading holds this share of all is right, in a tree that fits so well.

    Parameters
    ----------
    fit
        From :func:`fit_of`; None counts as good.

    Examples
    --------
    >>> round(calibrated(0.9, 4.5), 2), round(calibrated(0.9, 3.0), 2)
    (0.93, 0.88)
    """
    if reading <= 0.0:
        return 0.0
    part = min(max(reading, 0.01), SUREST)
    even, slope, per_nat = NAME_ODDS
    poor = min(GOOD_FIT if fit is None else fit, GOOD_FIT) - GOOD_FIT
    share = 1.0 / (1.0 + math.exp(-(even + slope * math.log(part / (1.0 - part)) + per_nat * poor)))
    # Where other readings hold more together no name is given, however often the likeliest of them is right.
    return share if reading >= 0.5 else min(share, reading)


def fit_of(
    grammar: Grammar,
    bronchi: list[Bronchus],
    lungs: dict[int, Lung],
    frame: Frame,
    *,
    mirrored: bool,
    max_forks: int,
) -> float | None:
    """The goodness of fit of a tree, nats per bronchus; None where too few bronchi can be judged.

    Evidence over chance, per bronchus that carries a reading, of the central airways, and one and a half times what it
    is above the best of the six orientations that no patient has (upside down, back to front, and those mirrored). It
    is 4 to 5 in phantoms, 3.2 to 4.9 in the three patients it was seen in, below 2.5 in most trees that branch
    at random, below 2.2 in vessels and below 1.5 in trees that stand on their heads. A phantom with plugs in two lobes
    fits 1.8, so the bar lies below that, and most random trees and some vessels pass.

    Parameters
    ----------
    frame, mirrored
        What the tree was read with.
    """

    def solved(turn: Frame, *, flipped: bool = False) -> Solver:
        return Solver(grammar, bronchi, lungs, turn, mirrored=flipped, max_forks=max_forks)

    own = solved(frame, flipped=mirrored)
    num = sum(reading.state is not None and not reading.again for reading in own.solution().readings)
    if num < MIN_READ:
        return None
    signs = [flip for flip in itertools.product((1.0, -1.0), repeat=3) if flip[1:] != (1.0, 1.0)]
    other = max(solved(np.diag(flip)).log_evidence for flip in signs)
    above = (own.log_evidence - other) / num
    return own.log_evidence / num + AGAINST * above - (MIRRORED_FIT if mirrored else 0.0)


def misfit_note() -> Note:
    """The lasting note of a tree that fits too poorly."""
    words = (
        "this tree does not look like a human bronchial tree: the names of its branches are not reliable, and segments "
        "are not named. Check the orientation of the scan (upside down, back to front), whether what was segmented is "
        "the airways and not vessels or a leak, and whether the anatomy was changed by surgery or disease"
    )
    return Note(MISFIT, words, badge=True)
