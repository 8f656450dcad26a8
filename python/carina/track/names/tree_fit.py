"""Goodness of fit between a tree and a human bronchial tree, and the confidence of names that follows from it."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from carina.track.names.anatomy_model import Grammar
from carina.track.names.assignment import Solver
from carina.track.names.tree_shape import Bronchus, Lung
from carina.volume.model import Note

Frame = NDArray[np.float64]

MISFIT = "track.tree-unlike-human"
POOR_FIT = 1.5
"""Minimum goodness of fit of a human bronchial tree in the orientation of its file (docs/decisions/0137)."""
AGAINST = 1.5
"""Weight in the goodness of fit of the tree's advantage over other orientations; its evidence has weight 1."""
MIRRORED_FIT = 0.75
"""Additional goodness of fit that a tree needs to be read as a mirrored chest.

Situs inversus is rare, and a tree of any kind may fit a mirrored chest by chance.
"""
MIN_READ = 10
"""Minimum number of bronchi with an assigned state for which the goodness of fit is computed."""
GOOD_FIT = 4.0
"""Goodness of fit above which a better fit no longer raises the confidence."""
# Log odds of a correct name: constant, factor of the log odds of the reading, and change per nat below a good fit.
# Fitted on trees of phantoms of seeds 101 to 124, checked on seeds 201 to 224 (docs/decisions/0137;
# carina_bench.track_confidence).
NAME_ODDS = (0.295, 1.073, 0.706)
SUREST = 0.995
"""Upper limit of a reading's share before its log odds are computed."""


def calibrated(reading: float, fit: float | None) -> float:
    """Return the probability that a name is correct.

    Parameters
    ----------
    reading
        Share of all readings that support the name, 0..1.
    fit
        Goodness of fit from :func:`fit_of`; None counts as good.

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
    # If the other readings together have the larger share, the confidence stays below one half, so no name is given.
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
    """Compute the goodness of fit of a tree, in nats per bronchus; None if too few bronchi can be judged.

    The fit is the log evidence over chance of the central airways, per bronchus that carries a reading, plus 1.5
    times its excess over the best of the six orientations that no patient has (upside down, back to front, and those
    mirrored). The fit is 4 to 5 in phantoms, 3.2 to 4.9 in three patients, below 2.5 in most randomly branching
    trees, below 2.2 in vessels and below 1.5 in trees that are upside down. A phantom with plugs in two lobes has
    1.8, so the limit is below 1.8, and most random trees and some vessels pass.

    Parameters
    ----------
    grammar
        The anatomical grammar.
    bronchi, lungs
        The bronchi of the tree, and their lungs.
    frame, mirrored
        Body axes and laterality with which the tree was read.
    max_forks
        Forks farther than this from the root are not read.
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
    """Return the permanent note on a tree that fits too poorly."""
    words = (
        "this tree does not look like a human bronchial tree: the names of its branches are not reliable, and segments "
        "are not named. Check the orientation of the scan (upside down, back to front), whether what was segmented is "
        "the airways and not vessels or a leak, and whether the anatomy was changed by surgery or disease"
    )
    return Note(MISFIT, words, badge=True)
