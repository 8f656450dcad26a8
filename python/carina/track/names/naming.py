"""Anatomical names for an airway tree, from trachea to subsegments, with confidence and variants.

Naming uses no trained weights and no scans: a grammar of anatomy (``anatomy_model``), the shape of the tree
(``tree_shape``), and the sum over all readings of the tree (``assignment``). A reading assigns a state of the grammar,
such as a segment or a lobe, to each bronchus. See docs/decisions/0116.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from carina.track.names.anatomy_model import LOBES, Grammar, grammar
from carina.track.names.assignment import Solution, Solver
from carina.track.names.letters import LetterRule, letter_order
from carina.track.names.name_texts import (
    ISOMERISM,
    LEFT_ISOMERISM,
    MIRRORED,
    MIRRORED_CHEST,
    NameWords,
    bare_name,
    name_words,
    segment_of,
)
from carina.track.names.tree_fit import MISFIT, POOR_FIT, calibrated, fit_of, misfit_note
from carina.track.names.tree_shape import Bronchus, body_frame, bronchi_of, find_lungs, refined_frame
from carina.track.names.without_drawn import carried_names, seen_part
from carina.track.tree.airway_tree import AirwayTree, Branch
from carina.track.tree.trachea_diameter_range import with_limited_confidence
from carina.volume.model import Note

__all__ = [
    "LetterRule",
    "NameWords",
    "branch_side_and_lobe",
    "log_evidence_of",
    "name_tree",
    "name_words",
    "segment_readings",
    "segments_of_unnamed",
]

SURE_ENOUGH = 0.5
"""Minimum probability of a name; with a lower probability only the lobe of a branch is stated."""
UNFIT = -40.0
"""Log odds of a reading (assignment of names) that contradicts a name given by a user."""
LOG_MIRRORED = math.log(1e-3)
"""Log odds of a mirrored chest.

Situs inversus has a frequency of 1 in 10,000; files with left and right exchanged are more frequent.
"""
TURN_SPREAD_RAD = math.radians(15.0)
"""Standard deviation in radians of a patient's rotation on the table."""
MAX_TURNS, MIN_TURN_RAD = 12, math.radians(0.1)
"""Maximum number of rotations of the body axes, and the rotation (rad) below which they have converged."""
MIN_GAIN = 1.5
"""Gain of log evidence that a fit of the three angles of the body axes reaches by noise alone: 0.5 for each angle."""
MIN_READ_FOR_FRAME = 6.0
"""Minimum expected number of bronchi with an assigned state for which the body axes are refined by their directions."""
MIN_BRANCHES = 12
"""Minimum number of branches of a tree whose lobes are distinguished."""
COARSE_FORKS = 5
"""Number of forks from the root up to which airways determine the body axes and the side of the three-lobed lung."""
NUM_TREES = 4
"""Maximum number of trees whose lobes are cached; a further tree replaces the least recently used one."""
LETTERS, ROMAN = "abcdefgh", ("i", "ii", "iii", "iv", "v", "vi", "vii", "viii")

_VARIANT_STEMS = {
    "RB1+2": "RB1 and RB2 share a stem",
    "RB2+3": "RB2 and RB3 share a stem",
    "RB1+3": "RB1 and RB3 share a stem",
    "RB7+8": "RB7 and RB8 share a stem",
    "RB8+9": "RB8 and RB9 share a stem",
    "RB7+10": "RB7 and RB10 share a stem",
    "LB8+9": "LB8 and LB9 share a stem",
    "LB1+3": "LB1 and LB3 share a stem; LB2 arises separately",
    "LB2+3": "LB2 and LB3 share a stem; LB1 arises separately",
    "LB3+4+5": "LB3 and the lingular bronchus share a stem",
    "RB*": "a subsuperior bronchus (found in one patient in six)",
    "LB*": "a subsuperior bronchus (found in one patient in six)",
}
_SWAP = str.maketrans("RL", "LR")
LOG_ISOMERISM = math.log(3.6e-5)
"""Log odds of a left isomerism: heterotaxy in 0.8 of 10,000 births (Lin 2014), 35 of 78 of them left (Oreto 2023)."""


@dataclass(frozen=True, slots=True, eq=False)
class _Named:
    """Bronchi of a tree with the states that were assigned to them."""

    bronchi: list[Bronchus]
    solution: Solution
    grammar: Grammar
    frame: NDArray[np.float64]
    mirrored: bool
    fit: float | None
    """Goodness of fit of the tree, in nats per bronchus; see :func:`carina.track.names.tree_fit.fit_of`."""
    log_evidence: float
    """Logarithm of the sum of the probabilities of all assignments of states to the bronchi."""

    @property
    def is_misfit(self) -> bool:
        return self.fit is not None and self.fit < POOR_FIT


def name_tree(tree: AirwayTree, *, letter_rule: LetterRule = LetterRule.TOP_LATERAL_BACK) -> AirwayTree:
    """Name the branches of an airway tree.

    Laterality comes from LPS coordinates alone (-x is the patient's right). If the pattern of the chest is mirrored,
    the ``variant`` of the root states this. Sides are always those of the patient: a three-lobed lung on the
    patient's left gets LB1 to LB10 and a lobe LML.

    Parameters
    ----------
    tree
        From :func:`find_airways` or any other source; also parts of a tree, or a tree that begins below the trachea.
    letter_rule
        Rule for the letters of subsegments.

    Returns
    -------
    AirwayTree
        The same branches, IDs and geometry with new ``name``, ``name_confidence`` and ``name_from`` ("anatomy").
        Branches that the user named keep their names, which also constrain the other names. The name is None if its
        confidence would be below 0.5. Branches between which only a twig leaves share a name. ``variant`` describes
        uncommon anatomy at a branch. ``notes`` report a tree that does not look human (``track.tree-unlike-human``;
        then no segment is named and no confidence exceeds 0.5) and a mirrored chest (``track.mirrored``). If the
        notes state that the size was not calibrated (``track.size-not-calibrated``), the confidence of branches and
        names is limited. Branches that were drawn without evidence (kind ``manual``), and branches below them, get
        no name and do not change the other names.

    Examples
    --------
    >>> import numpy as np
    >>> from carina.track import Branch
    >>> trunk = Branch(0, None, (), 0, None, "tracked", np.array([[0.0, 0, 0], [0, 4, -30]]), np.array([8.0, 8]))
    >>> name_tree(AirwayTree((trunk,))).branches[0].name is None
    True

    References
    ----------
    Nomenclature, frequencies of variants: shared reference, features 5.4. Labelling by a grammar with sums over
    derivations: docs/decisions/0116.
    """
    seen, place_of = seen_part(tree)
    named = with_limited_confidence(_named_all(seen, letter_rule))
    return named if seen is tree else carried_names(tree, named, place_of)


def name_human_tree(tree: AirwayTree, *, is_mirrored: bool) -> AirwayTree:
    """Name the branches of a tree that is known to be a human one, however poorly it fits.

    Otherwise the same as :func:`name_tree`. The confidence of names still decreases with the goodness of fit. A reading
    with another laterality than the known one, ``is_mirrored``, needs the usual goodness of fit.
    """
    seen, place_of = seen_part(tree)
    named = with_limited_confidence(_named_all(seen, LetterRule.TOP_LATERAL_BACK, human_mirrored=is_mirrored))
    return named if seen is tree else carried_names(tree, named, place_of)


def _named_all(tree: AirwayTree, letter_rule: LetterRule, *, human_mirrored: bool | None = None) -> AirwayTree:
    """Name a tree; for a known human tree, ``human_mirrored`` states whether the three-lobed lung is on the left."""
    read = _read(tree)
    names, notes = _names_of(read, letter_rule)
    given = {bare_name(b.name) for b in tree.branches if b.name_from == "person" and b.name is not None}
    lasting = tuple(note for note in tree.notes if note.code not in (MISFIT, MIRRORED, ISOMERISM))
    if read.is_misfit and read.mirrored is not human_mirrored:
        names, notes = _names_of_misfit(names), {}
        lasting = (*lasting, misfit_note())
    elif read.mirrored:
        lasting = (*lasting, Note(MIRRORED, f"the airways are {notes[0]}", badge=True))
    elif read.grammar.left_isomerism:
        lasting = (*lasting, Note(ISOMERISM, f"the airways have a {notes[0]}", badge=True))
    made = []
    for number, branch in enumerate(tree.branches):
        if branch.name_from == "person":
            made.append(dataclasses.replace(branch, variant=notes.get(number)))
            continue
        name, sure = names.get(number, (None, 0.0))
        if name in given:
            name = None
        made.append(
            dataclasses.replace(
                branch,
                name=name,
                name_confidence=None if name is None else round(sure, 3),
                name_from=None if name is None else "anatomy",
                variant=notes.get(number),
            )
        )
    return dataclasses.replace(tree, branches=tuple(made), notes=lasting)


def _names_of_misfit(names: dict[int, tuple[str | None, float]]) -> dict[int, tuple[str | None, float]]:
    """Remove the names of segments and limit the confidence of the others, for a tree unlike a human one."""
    return {
        number: (name, min(sure, SURE_ENOUGH))
        for number, (name, sure) in names.items()
        if name is not None and ((words := name_words(name)) is None or words.boyden is None)
    }


def branch_side_and_lobe(tree: AirwayTree) -> dict[int, str | None]:
    """Return the lobe of each branch by ID: RUL, RML, RLL, LUL, LLL, or None.

    Trunks of several lobes and unknown branches have None; a lobe's own bronchus belongs to the lobe. Names given by
    the user take precedence. In a mirrored chest (see :func:`name_tree`) the lobes of the three-lobed lung are LUL,
    LML and LLL.
    """
    is_named = any(branch.name_from == "anatomy" for branch in tree.branches)
    is_human = not any(note.code == MISFIT for note in tree.notes) if is_named else None
    return dict(_side_and_lobe(tuple(tree.branches), is_human))


@lru_cache(maxsize=NUM_TREES)
def _side_and_lobe(branches: tuple[Branch, ...], is_human: bool | None) -> dict[int, str | None]:
    """Return the lobes of a tree's branches; cached, because plans, reports and windows need them repeatedly.

    A named tree was judged when it was named (``is_human``); other trees are judged here (None).
    """
    whole = AirwayTree(branches)
    tree, place_of, read = _seen_and_read(branches)
    found: dict[int, str | None] = dict.fromkeys((branch.id for branch in tree.branches), None)
    by_place = {} if (read.is_misfit if is_human is None else not is_human) else _lobes_of(read)
    for number, branch in enumerate(tree.branches):
        lobe = by_place.get(number)
        if branch.name_from == "person" and branch.name is not None:
            words = name_words(branch.name)
            if words is not None:
                lobe = words.lobe
        found[branch.id] = lobe
    return {branch.id: found.get(place_of.get(branch.id, -1)) for branch in whole.branches}


@lru_cache(maxsize=NUM_TREES)
def _seen_and_read(branches: tuple[Branch, ...]) -> tuple[AirwayTree, dict[int, int], _Named]:
    """Return the visible part of a tree with the IDs of its branches (`seen_part`), and its likeliest readings.

    They are cached, because lobes and absent segments of one tree are both computed from them.
    """
    tree, place_of = seen_part(AirwayTree(branches))
    return tree, place_of, _read(tree)


def segment_readings(tree: AirwayTree) -> tuple[float | None, list[tuple[str, float, tuple[int, ...]]]]:
    """Return data for the calibration of names: a tree's goodness of fit, and its segments' probabilities.

    Returns
    -------
    (float or None, list of (str, float, tuple of int))
        Goodness of fit (:func:`carina.track.names.tree_fit.fit_of`); and for each segment its name, the share of all
        readings (0..1) and the IDs of its branches.
    """
    read = _read(tree)
    found = []
    for bronchus, reading in zip(read.bronchi, read.solution.readings, strict=True):
        if reading.state is None or reading.again or read.grammar.kind[reading.state] != "segment":
            continue
        word = _on_patient_side(read.grammar.names[reading.state], mirrored=read.mirrored)
        segment = segment_of(word)
        if segment is not None:
            found.append((segment, reading.confidence, tuple(tree.branches[piece].id for piece in bronchus.pieces)))
    return read.fit, found


def log_evidence_of(tree: AirwayTree) -> float:
    """Return the logarithm of the probability of a tree, summed over all names that the user's names permit.

    The difference between the values of one tree with and without names given by the user is the logarithm of the
    probability of these names.
    """
    return _read(seen_part(tree)[0], judges_fit=False).log_evidence


def segments_of_unnamed(tree: AirwayTree) -> dict[int, frozenset[str]]:
    """Return the segments to which each unnamed branch leads in its likeliest reading, by branch ID.

    The readings of these branches are too uncertain for a name. Branches inside a segment and twigs are left out.
    """
    tree, _, read = _seen_and_read(tuple(tree.branches))
    found: dict[int, frozenset[str]] = {}
    for bronchus, reading in zip(read.bronchi, read.solution.readings, strict=True):
        state = reading.state if reading.settled is None else reading.settled
        if state is None:
            continue
        keys = read.grammar.segments[state]
        names = {"LB1+2" if key in {"LB1", "LB2"} else key for key in keys if not key.endswith("*")}
        sided = frozenset(_on_patient_side(name, mirrored=read.mirrored) for name in names)
        for piece in bronchus.pieces:
            if tree.branches[piece].name is None:
                found[tree.branches[piece].id] = sided
    return found


# Assignment of states to bronchi.


def _read(tree: AirwayTree, *, judges_fit: bool = True) -> _Named:
    rules = grammar()
    given = {
        number: bare_name(branch.name)
        for number, branch in enumerate(tree.branches)
        if branch.name_from == "person" and branch.name is not None
    }
    bronchi = bronchi_of(tree, frozenset(given))
    lungs = find_lungs(bronchi)
    wishes, held = _constraints(rules, bronchi, given)

    def attempt(frame: NDArray[np.float64], *, mirrored: bool = False) -> tuple[float, Solver]:
        solver = Solver(
            rules, bronchi, lungs, frame, mirrored=mirrored, wishes=wishes, held=held, max_forks=COARSE_FORKS
        )
        log_odds = LOG_MIRRORED if mirrored else LOG_ISOMERISM if rules.left_isomerism else 0.0
        return solver.log_evidence - 0.5 * (_angle(frame) / TURN_SPREAD_RAD) ** 2 + log_odds, solver

    def refined(
        score: float, solver: Solver, frame: NDArray[np.float64], *, mirrored: bool = False
    ) -> tuple[float, NDArray[np.float64]]:
        """Return the score and the frame after rotations towards the expected directions of the bronchi."""
        for _ in range(MAX_TURNS):
            closer = _closer_frame(rules, bronchi, solver, frame, mirrored=mirrored)
            if closer is None:
                break
            change = _angle(closer @ frame.T)
            score, solver = attempt(closer, mirrored=mirrored)
            frame = closer
            if change < MIN_TURN_RAD:
                break
        return score, frame

    frame = np.eye(3)
    score, best = attempt(frame)
    straight = score
    guess = body_frame(bronchi, lungs)
    if float(np.trace(guess)) < 1.0 + 2.0 * math.cos(math.radians(6.0)):
        other, solver = attempt(guess)
        if other > score:
            score, best, frame = other, solver, guess
    mirrored = False
    first, unrefined = frame, score
    score, frame = refined(score, best, first)
    if lungs:
        other, solver = attempt(first, mirrored=True)
        # A rotated patient may resemble a mirrored one until the frame is refined.
        if other > score:
            straight = other if first is not guess else attempt(np.eye(3), mirrored=True)[0]
            score, frame = refined(other, solver, first, mirrored=True)
            mirrored = True
    if lungs and not mirrored:
        usual, rules = rules, grammar(left_isomerism=True)
        usual_constraints, (wishes, held) = (wishes, held), _constraints(rules, bronchi, given)
        other, solver = attempt(first)
        # The usual reading and that of a left isomerism are compared in body axes that neither has refined.
        if other > unrefined:
            straight = other if first is not guess else attempt(np.eye(3))[0]
            score, frame = refined(other, solver, first)
        else:
            rules, (wishes, held) = usual, usual_constraints
    # A weakly supported rotation is mostly noise and would change with every tip, so the frame turns by a share of it.
    frame = _part_of(frame, 1.0 - MIN_GAIN / max(score - straight, MIN_GAIN))
    final = Solver(rules, bronchi, lungs, frame, mirrored=mirrored, wishes=wishes, held=held)
    solution = final.solution()
    fit = fit_of(rules, bronchi, lungs, frame, mirrored=mirrored, max_forks=COARSE_FORKS) if judges_fit else None
    return _Named(bronchi, solution, rules, frame, mirrored, fit, final.log_evidence)


def _part_of(rotation: NDArray[np.float64], share: float) -> NDArray[np.float64]:
    """Return the rotation about the axis of another rotation by a share (0..1) of its angle."""
    angle = _angle(rotation)
    skew = 0.5 * (rotation - rotation.T)
    if share >= 1.0 or angle < 1e-6 or angle > math.pi - 1e-3:
        return rotation if share > 0.0 else np.eye(3)
    cross = skew / math.sin(angle)
    turned: NDArray[np.float64] = (
        np.eye(3) + math.sin(share * angle) * cross + (1.0 - math.cos(share * angle)) * cross @ cross
    )
    return turned


def _angle(rotation: NDArray[np.float64]) -> float:
    """Return the angle of a rotation in radians."""
    return math.acos(max(-1.0, min(1.0, (float(np.trace(rotation)) - 1.0) / 2.0)))


def _closer_frame(
    rules: Grammar, bronchi: list[Bronchus], solver: Solver, frame: NDArray[np.float64], *, mirrored: bool
) -> NDArray[np.float64] | None:
    """Return body axes in which the bronchi point in the mean directions of their states, over all readings.

    No state is chosen, so a small change of the tree turns the frame by a small angle.
    """
    shares = solver.shares_of_states()
    if float(shares.sum()) < MIN_READ_FOR_FRAME:
        return None
    flip = np.array([-1.0 if mirrored else 1.0, 1.0, 1.0])
    expected = shares @ (rules.direction * flip)
    weights = np.linalg.norm(expected, axis=1)
    used = weights > 1e-6
    seen = np.array([bronchus.direction for bronchus in bronchi])[used]
    return refined_frame(frame, seen, expected[used] / weights[used, None], weights[used])


def _constraints(
    rules: Grammar, bronchi: list[Bronchus], given: dict[int, str]
) -> tuple[dict[int, NDArray[np.float64]], dict[int, tuple[NDArray[np.float64], float]]]:
    """Return the log odds per state that users' names impose on their bronchi and on the bronchi before them."""
    wishes: dict[int, NDArray[np.float64]] = {}
    held: dict[int, tuple[NDArray[np.float64], float]] = {}
    known = {number: name for number, name in given.items() if name_words(name) is not None}
    for number, bronchus in enumerate(bronchi):
        own = [known[piece] for piece in bronchus.pieces if piece in known]
        if own:
            wishes[number] = sum((_fits(rules, name) for name in own), np.zeros(len(rules)))
        inner = [known[branch] for branch in bronchus.below if branch in known]
        if own or inner:
            inside = sum((_holds(rules, name) for name in inner), np.zeros(len(rules)))
            held[number] = (inside, UNFIT * len(own + inner))
    return wishes, held


def _fits(rules: Grammar, name: str) -> NDArray[np.float64]:
    """Return log odds per state: 0 for states that a branch of that name may have, ``UNFIT`` for others."""
    segment = segment_of(name)
    fits = np.zeros(len(rules), dtype=bool)
    for k in range(len(rules)):
        keys = rules.segments[k]
        if segment is not None and segment == bare_name(name):
            parts = {"LB1+2": {"LB1", "LB2"}}.get(segment, {segment})
            fits[k] = rules.kind[k] == "segment" and keys <= parts
        elif segment is not None:
            continue  # A subsegment is inside its segment, so no state fits the branch itself.
        elif name in LOBES:
            fits[k] = rules.lobe[k] == name
        elif name in {"Right basal trunk", "Left basal trunk"}:
            lower = "RLL" if name.startswith("R") else "LLL"
            fits[k] = rules.lobe[k] == lower and f"{lower[0]}B6" not in keys and len(keys) >= 2
        else:
            fits[k] = rules.names[k] == name
    return np.where(fits, 0.0, UNFIT)


def _holds(rules: Grammar, name: str) -> NDArray[np.float64]:
    """Return log odds per state: 0 for segments in which a branch of that name may lie, ``UNFIT`` for others."""
    segment = segment_of(name)
    if segment is None:
        return np.full(len(rules), UNFIT)
    parts = {"LB1+2": {"LB1", "LB2"}}.get(segment, {segment})
    return np.array([0.0 if keys <= parts else UNFIT for keys in rules.segments])


# Names of the bronchi, from the states that were assigned to them.


def _names_of(read: _Named, rule: LetterRule) -> tuple[dict[int, tuple[str | None, float]], dict[int, str]]:
    bronchi, rules, readings = read.bronchi, read.grammar, read.solution.readings
    words: list[str | None] = [None] * len(bronchi)
    sure = np.zeros(len(bronchi))
    carried = {number for number, r in enumerate(readings) if r.state is not None}
    seen = {
        key
        for r in readings
        if r.state is not None and rules.kind[r.state] == "segment"
        for key in rules.segments[r.state]
    }
    for number, (bronchus, reading) in enumerate(zip(bronchi, readings, strict=True)):
        parent = bronchus.parent
        if reading.state is None:
            continue
        sure[number] = calibrated(reading.confidence, read.fit)
        if reading.again and parent is not None:
            words[number] = words[parent]
            sure[number] = min(sure[number], sure[parent]) if words[parent] else 0.0
            continue
        words[number] = _word(rules, reading.state, seen)
    _halves(read, words, rule)
    _letters(read, words, sure, rule)
    names: dict[int, tuple[str | None, float]] = {}
    for number, bronchus in enumerate(bronchi):
        word = words[number]
        if word is None or sure[number] < SURE_ENOUGH:
            continue
        for piece in bronchus.pieces:
            names[piece] = (_on_patient_side(word, mirrored=read.mirrored), float(sure[number]))
        settled = readings[number].settled
        if len(bronchus.pieces) > 1 and settled is not None and segment_of(word) is None and rules.terminal[settled]:
            # A lobe of which one segment remains, with a twig on its bronchus: beyond the twig the branch has the
            # segment's name.
            last = _on_patient_side(_word(rules, settled, seen), mirrored=read.mirrored)
            names[bronchus.pieces[-1]] = (last, float(sure[number]))
    if len(bronchi[0].pieces) + len(bronchi[0].below) < MIN_BRANCHES:
        certain = {"Trachea", "RMB", "LMB"} if len(bronchi) > 1 else set()
        names = {number: (name, share) for number, (name, share) in names.items() if name in certain}
    _name_stubs(read, words, sure, names)
    notes = _variants(read, words, sure, carried)
    if read.mirrored:
        notes = {number: _swapped_note(note) for number, note in notes.items()}
        notes[0] = (
            f"{MIRRORED_CHEST}: the three-lobed lung is on the patient's left. Check whether this is situs inversus, "
            "or left and right are swapped in the volume or in the segmentation"
        )
    if read.grammar.left_isomerism:
        notes[0] = (
            f"{LEFT_ISOMERISM}: both lungs have the pattern of the left lung, with two lobes. Check the other organs "
            "(heterotaxy)"
        )
    return names, notes


def _word(rules: Grammar, state: int, seen: set[str]) -> str:
    name, keys = rules.names[state], rules.segments[state]
    for side in _halved_sides(rules):
        halves = {f"{side}B1", f"{side}B2"}
        if len(keys) == 1 and keys <= halves and not halves <= seen:
            return f"{side}B1+2"
    if rules.kind[state] != "set":
        return name
    lobe = rules.lobe[state]
    if lobe in {"RLL", "LLL"}:
        basal = {key for key in LOBES[lobe] if not key.endswith(("*", "B6"))}
        if f"{lobe[0]}B6" not in keys and len(basal & keys) >= 2 and basal & seen <= keys:
            return "Right basal trunk" if lobe == "RLL" else "Left basal trunk"
    return name


def _halved_sides(rules: Grammar) -> tuple[str, ...]:
    """Return the sides (right, left) of the model on which segments 1 and 2 are halves of one segment."""
    return ("R", "L") if rules.left_isomerism else ("L",)


def _halves(read: _Named, words: list[str | None], rule: LetterRule) -> None:
    """Replace LB1 and LB2 that arise separately beside LB3 by letters of LB1+2, unless one shares a stem with LB3."""
    for side in _halved_sides(read.grammar):
        one = f"{side}B"
        halves = [number for number, word in enumerate(words) if word in {f"{one}1", f"{one}2"}]
        if len(halves) == 2 and not {f"{one}1+3", f"{one}2+3"} & set(words):
            lateral = np.array([-1.0 if read.mirrored or side == "R" else 1.0, 1.0, 1.0])
            order, _ = letter_order([read.frame @ read.bronchi[n].ahead * lateral for n in halves], rule)
            for sign, which in zip(LETTERS, order, strict=False):
                words[halves[which]] = f"{one}1+2{sign}"


def _letters(read: _Named, words: list[str | None], sure: NDArray[np.float64], rule: LetterRule) -> None:
    """Name the subsegments, from the first fork of each segment on."""
    bronchi, rules, readings = read.bronchi, read.grammar, read.solution.readings
    level = [0] * len(bronchi)
    for number, bronchus in enumerate(bronchi):
        inside = [c for c in bronchus.children if readings[c].inside is not None]
        if not inside:
            continue
        twins = [c for c in inside if readings[c].twin]
        groups = {readings[c].inside for c in twins}
        sets = [[c for c in twins if readings[c].inside == g] for g in sorted(g for g in groups if g is not None)]
        sets.append([c for c in inside if not readings[c].twin])
        for group in sets:
            if not group:
                continue
            state = readings[group[0]].inside
            assert state is not None
            if readings[group[0]].twin:
                base, depth, trust = rules.names[state], 0, calibrated(readings[group[0]].confidence, read.fit)
            else:
                base_word, depth, trust = words[number], level[number], float(sure[number])
                settled = readings[number].settled
                if base_word is not None and segment_of(base_word) is None and settled is not None:
                    base_word = rules.names[settled]
                if base_word is None or segment_of(base_word) is None:
                    continue
                base = base_word
            if len(group) == 1:
                words[group[0]], sure[group[0]], level[group[0]] = base, trust, depth
                continue
            if depth >= 2:
                continue
            side = -1.0 if (base.startswith("R") != read.mirrored) else 1.0
            lateral = np.array([side, 1.0, 1.0])
            order, order_sure = letter_order([read.frame @ bronchi[c].ahead * lateral for c in group], rule)
            signs = LETTERS if depth == 0 else ROMAN
            for sign, which in zip(signs, order, strict=False):
                child = group[which]
                words[child] = base + sign
                sure[child] = trust * order_sure
                level[child] = depth + 1


def _on_patient_side(word: str, *, mirrored: bool) -> str:
    """Return a name with the patient's side: in a mirrored chest, the model's right is the patient's left."""
    if not mirrored:
        return word
    fixed = {"BI": "BI", "Trachea": "Trachea", "RML": "LML", "Accessory cardiac bronchus": "Accessory cardiac bronchus"}
    if word in fixed:
        return fixed[word]
    if word.startswith(("Right", "Left")):
        return word.replace("Right", "_").replace("Left", "Right").replace("_", "Left")
    if word in {"Upper division", "Lingula"}:
        return word
    return word[0].translate(_SWAP) + word[1:]


def _swapped_note(note: str) -> str:
    return note.replace("RB", "_B").replace("LB", "RB").replace("_B", "LB")


def _name_stubs(
    read: _Named,
    words: list[str | None],
    sure: NDArray[np.float64],
    names: dict[int, tuple[str | None, float]],
) -> None:
    """Name each short piece between two merged forks like the bronchus before the piece."""
    for number, bronchus in enumerate(read.bronchi):
        word = words[number]
        for stub in bronchus.stubs:
            if word is not None and segment_of(word) is None and sure[number] >= SURE_ENOUGH and stub not in names:
                names[stub] = (_on_patient_side(word, mirrored=read.mirrored), float(sure[number]))


def _variants(read: _Named, words: list[str | None], sure: NDArray[np.float64], carried: set[int]) -> dict[int, str]:
    """Return the texts of the anatomical variants, by the index of the branch that shows the variant."""
    bronchi, readings = read.bronchi, read.solution.readings
    notes: dict[int, str] = {}

    def note(number: int, text: str) -> None:
        first = bronchi[number].pieces[0]
        notes[first] = f"{notes[first]}; {text}" if first in notes else text

    found = {word for number, word in enumerate(words) if word is not None and sure[number] >= SURE_ENOUGH}
    for number, bronchus in enumerate(bronchi):
        word, parent = words[number], bronchus.parent
        if word is None or sure[number] < SURE_ENOUGH or readings[number].again:
            continue
        above = None if parent is None else words[parent]
        if word in _VARIANT_STEMS and not (read.grammar.left_isomerism and word == "RB1+2"):
            note(number, _VARIANT_STEMS[word])
        if above == "Trachea" and word in {"RB1", "RUL"}:
            note(number, "a tracheal bronchus: it arises from the trachea, above the carina")
        if above == "RMB" and word == "RB1":
            note(number, "RB1 arises separately from the right main bronchus")
        if above == "BI" and word == "RB6":
            note(number, "RB6 arises from the bronchus intermedius, at or above the middle lobe bronchus")
        has_rb7 = "RB7" in found or read.grammar.left_isomerism
        if word == "Right basal trunk" and not has_rb7 and {"RB8", "RB10"} <= found:
            note(number, "RB7 was not found")
        if word in {"Right basal trunk", "Left basal trunk"}:
            side = word[0]
            if f"{side}B9" not in found and {f"{side}B8", f"{side}B10"} <= found:
                note(number, f"{side}B9 was not found: it may be absent, or arise from a neighbouring segment")
        if word == "BI" and "RML" not in found and "RB4" not in found and "RB5" not in found and "RLL" in found:
            note(number, "the middle lobe bronchus was not found")
    for number, bronchus in enumerate(bronchi):
        # This bronchus is the third one at a fork, and no segment was assigned to it.
        if number in carried or readings[number].inside is not None or bronchus.parent is None:
            continue
        above = words[bronchus.parent]
        if above is None or sure[bronchus.parent] < SURE_ENOUGH:
            continue
        if bronchus.length_mm < 2.0 * bronchi[bronchus.parent].radius_mm and not bronchus.children:
            continue
        down = read.frame @ bronchus.direction
        if above == "Trachea" and bronchus.children:
            note(number, "perhaps a tracheal bronchus: it arises from the trachea")
        elif above in {"BI", "RMB"} and down[2] < -0.2 and down[0] * (-1.0 if read.mirrored else 1.0) > -0.1:
            note(number, "perhaps an accessory cardiac bronchus")
        elif above in {*LOBES, "Lingula", "Upper division", "Right basal trunk", "Left basal trunk"}:
            note(number, f"an accessory bronchus that arises from {above}")
    return notes


def _lobes_of(read: _Named) -> dict[int, str | None]:
    """Return the lobe of each branch, by the branch's index in the tree; None if unknown."""
    rules = read.grammar
    found: dict[int, str | None] = {}
    own: list[str | None] = [None] * len(read.bronchi)
    for number, (bronchus, reading) in enumerate(zip(read.bronchi, read.solution.readings, strict=True)):
        state = reading.state if reading.state is not None else reading.inside
        if state is not None:
            own[number] = rules.lobe[state]
        elif bronchus.parent is not None:
            own[number] = own[bronchus.parent]
        lobe = own[number]
        sided = None if lobe is None else _on_patient_side(lobe, mirrored=read.mirrored)
        # All branches below get this lobe; a later iteration replaces the lobe of each that is a bronchus.
        for piece in (*bronchus.pieces, *bronchus.below):
            found[piece] = sided
    return found
