"""Assignment of segments to bronchi: a sum over all readings (assignments of names) of a tree, by the anatomical model.

A reading assigns a state of the grammar to each bronchus. Sums over every derivation of the grammar, from the tips
inwards (inside) and back (outside), give each bronchus the probability of each state, which is its confidence. The
labels are then assigned from the trachea down: at each fork the likeliest division of the state of the airway before
it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from carina.track.names.anatomy_model import DOUBLE, TRUNCATED, TRUNCATED_MORE, Grammar
from carina.track.names.tree_shape import Bronchus, Lung

Array = NDArray[np.float64]

# Concentrations of the directions (von Mises-Fisher): 3 is a spread of about 35 degrees, as between different
# anatomies. Observations are correlated, so all log evidence is multiplied by TEMPER.
KAPPA_DIRECTION = 3.0
KAPPA_PLACE = 4.0
KAPPA_TURN = 2.5
PLACE_SPREAD = 0.45
PLACE_ANY = 0.9
BULK_SPREAD = 1.0
BULK_ANY = 1.6
WRONG_SIDE = -6.0
CALIBRE_SPREAD = 0.3
CALIBRE_ANY = 0.5
CALIBRE_INSIDE = math.log(0.7)
"""Log of the usual radius of an airway inside a segment, relative to the radius of the segment's bronchus."""
MAX_FORKS = 11
"""Maximum number of forks from the root up to which states are assigned to bronchi; RB10 may be the eighth bronchus."""
TEMPER = 0.6
DIVISION = -0.8
"""Log probability penalty of each division of a set of segments at a fork.

Forks inside a segment spread like neighbouring segments, so a fork that looks like a division of segments is weaker
evidence than among forks in all directions.
"""


def _log_peak(kappa: Array | float) -> Array:
    """Return the log of the von Mises-Fisher density at its pole, relative to the uniform density."""
    k = np.maximum(kappa, 1e-6)
    result: Array = np.log(2.0 * k / -np.expm1(-2.0 * k))
    return result


STUMP_MM = 2.5
"""Radius in mm from which a short end of a bronchus counts as a stump (after a resection, or before a plug)."""
STUMP_SHARE = 0.55
"""Minimum ratio of a stump's radius to its parent's radius.

A short blind bronchus of this width is not a twig but the rest of a lost bronchus.
"""
STUMP_SPUR = 6.0
MEDIAL_BASAL = "RB7"
BASAL = frozenset({"RB8", "RB9", "RB10"})
SUBSEGMENTS_APART = (0.30, 0.055)
"""Mean and standard deviation of the distance between the territories of two subsegments of a basal segment.

The distance is in units of the lung's size (root mean square distance of its territories from their centre). Both
distributions were measured on phantoms (benchmarks/measurements/airways.md, 0116).
"""
MEDIAL_APART = (0.47, 0.06)
"""Mean and standard deviation of the distance between the territories of RB7 and of another basal segment."""
MAX_APART_ODDS = 6.0
"""Maximum magnitude of the log odds that follow from this distance."""
LOST_LOBE = math.log(0.05)
"""Log odds that nothing is left of a lobe with a stump: the lobe was resected, or is plugged at its origin."""


@dataclass(frozen=True, slots=True, eq=False)
class _ForkSide:
    """One or several bronchi that leave a fork and are combined into one side of a division in two."""

    middle: Array
    direction: Array
    bulk: float
    spur: float
    interior: Array
    """Log odds per state that all bronchi of this side are inside the segment of that state."""


@dataclass(frozen=True, slots=True)
class Reading:
    """Label that was assigned to one bronchus."""

    state: int | None
    """State of the grammar; None for a bronchus that leads to no segment (a twig, an accessory bronchus)."""
    confidence: float
    """Probability of the label, 0 to 1."""
    inside: int | None = None
    """State of the segment in whose territory the bronchus lies; None if it lies in none."""
    twin: bool = False
    """Whether the bronchus is one of several bronchi of its segment that leave a fork side by side."""
    settled: int | None = None
    """State that remains if a part of ``state`` is missing, such as RB5 for a middle lobe without RB4."""
    again: bool = False
    """Whether the bronchus is a further part of its parent's airway, with the same label, beyond a side branch."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Labels (readings) that the solver assigned to all bronchi of a tree."""

    readings: list[Reading]


class _Tables:
    """Sums over the readings below one fork, for each subset of its bronchi (as a bit mask)."""

    def __init__(self, parts: Sequence[_ForkSide], sums: Sequence[Array], model: _Model) -> None:
        self.model = model
        self.num = len(parts)
        self.part: dict[int, _ForkSide] = {}
        self.sums: dict[int, Array] = {}
        for k, (part, inside) in enumerate(zip(parts, sums, strict=True)):
            self.part[1 << k], self.sums[1 << k] = part, inside
        self.full = (1 << self.num) - 1
        for subset in sorted(range(1, self.full + 1), key=lambda s: (s.bit_count(), s)):
            if subset.bit_count() < 2:
                continue
            self.part[subset] = _together([self.part[1 << k] for k in range(self.num) if subset >> k & 1])
            structure = self.structure(subset)
            if subset != self.full:
                terminal = self.model.grammar.terminal
                structure[terminal] = np.logaddexp(structure[terminal], DOUBLE + self.part[subset].interior[terminal])
                structure = self.model.shrunk(structure)
            self.sums[subset] = structure

    def splits(self, subset: int) -> list[tuple[int, int]]:
        """Return the unordered pairs of disjoint subsets whose union is the given subset."""
        low = subset & -subset
        found = []
        one = subset
        while one:
            if one & low and one != subset:
                found.append((one, subset ^ one))
            one = (one - 1) & subset
        return found

    def rows(self, one: int, two: int) -> Array:
        """Return the log weight of each division of the grammar at a fork whose two sides are ``one`` and ``two``.

        The weight of the undivided airway before the fork is not included.
        """
        division = self.model.grammar.division
        return (
            division.log_prior
            + self.model.apart(self.part[one], self.part[two])
            + self.sums[one][division.one]
            + self.sums[two][division.two]
        )

    def structure(self, subset: int) -> Array:
        splits = self.splits(subset)
        total = np.full(len(self.model.grammar), -np.inf)
        for one, two in splits:
            by_state = self.model.sum_by_state(self.rows(one, two))
            for other in (
                by_state,
                self.sums[one] + self.part[two].spur,
                self.sums[two] + self.part[one].spur,
            ):
                total = np.logaddexp(total, other)
        return total


def _together(parts: Sequence[_ForkSide]) -> _ForkSide:
    bulk = np.array([part.bulk for part in parts])
    direction = np.sum([part.direction for part in parts], axis=0)
    return _ForkSide(
        middle=np.average([part.middle for part in parts], axis=0, weights=np.sqrt(bulk)),
        direction=direction / max(float(np.linalg.norm(direction)), 1e-9),
        bulk=float(bulk.sum()),
        spur=sum(part.spur for part in parts),
        interior=np.sum([part.interior for part in parts], axis=0),
    )


class _Model:
    """Log evidence of each state for the bronchi of one tree in one orientation of the body axes."""

    def __init__(
        self,
        grammar: Grammar,
        bronchi: list[Bronchus],
        lungs: dict[int, Lung],
        frame: NDArray[np.float64],
        *,
        mirrored: bool,
        wishes: dict[int, Array],
        held: dict[int, tuple[Array, float]],
    ) -> None:
        self.grammar = grammar
        self.bronchi = bronchi
        self.lungs = lungs
        self.wishes = wishes
        self.held = held
        turn = frame.copy()
        if mirrored:
            turn[0] *= -1.0
        self.directions = np.array([b.direction for b in bronchi]) @ turn.T
        self.middles = np.array([b.middle for b in bronchi]) @ turn.T
        self.turn = turn
        sizes = [len(keys) if kind == "set" else 2 for keys, kind in zip(grammar.segments, grammar.kind, strict=True)]
        more = np.maximum(np.array(sizes) - 2, 0)
        is_lobe = np.array([kind == "lobe" for kind in grammar.kind])
        self.truncated = np.where(is_lobe, -np.inf, TRUNCATED + TRUNCATED_MORE * more)
        self.stump = np.where(is_lobe, LOST_LOBE, self.truncated)
        division = grammar.division
        bounds = np.flatnonzero(np.diff(division.state, prepend=-1))
        self._bounds, self._states = bounds, division.state[bounds]
        leaves = [k for k, kind in enumerate(grammar.kind) if kind == "segment" and "," not in grammar.names[k]]
        self._lung_place = {}
        for side in (-1.0, 1.0):
            mine = np.array([grammar.place[k] for k in leaves if grammar.side[k] == side])
            middle = mine.mean(axis=0)
            self._lung_place[side] = (middle, float(np.sqrt(((mine - middle) ** 2).sum(axis=1).mean())))

    def sum_by_state(self, rows: Array) -> Array:
        total = np.full(len(self.grammar), -np.inf)
        peak = np.maximum.reduceat(rows, self._bounds)
        safe = np.where(np.isfinite(peak), peak, 0.0)
        widths = np.diff(np.append(self._bounds, len(rows)))
        sums = np.add.reduceat(np.exp(rows - np.repeat(safe, widths)), self._bounds)
        with np.errstate(divide="ignore"):
            total[self._states] = np.log(sums) + safe
        return total

    def shrunk(self, own: Array) -> Array:
        total = own.copy()
        for state, others, odds in self.grammar.shrink:
            total[state] = np.logaddexp(total[state], np.logaddexp.reduce(odds + total[others]))
        return total

    def apart(self, one: _ForkSide, two: _ForkSide) -> Array:
        """Return the log evidence, for each division, that its parts are positioned like the two fork sides."""
        division = self.grammar.division
        offset = one.middle - two.middle
        turn = one.direction - two.direction
        far, wide = float(np.linalg.norm(offset)), float(np.linalg.norm(turn))
        kappa_turn = KAPPA_TURN * min(1.0, wide / 0.6)
        place = KAPPA_PLACE * (division.place @ (offset / max(far, 1e-9)) - 1.0) + _log_peak(KAPPA_PLACE)
        change = kappa_turn * (division.direction @ (turn / max(wide, 1e-9)) - 1.0) + _log_peak(kappa_turn)
        bulk = math.log(one.bulk / two.bulk)
        size = (
            -0.5 * ((bulk - division.log_bulk) / BULK_SPREAD) ** 2
            + 0.5 * (bulk / BULK_ANY) ** 2
            + math.log(BULK_ANY / BULK_SPREAD)
        )
        result: Array = TEMPER * (place + change + np.clip(size, -4.0, 1.0)) + DIVISION
        return result

    def evidence(self, number: int) -> Array:
        """Return the log evidence of each state from the direction and calibre of one bronchus alone."""
        grammar = self.grammar
        total = KAPPA_DIRECTION * (grammar.direction @ self.directions[number] - 1.0) + _log_peak(KAPPA_DIRECTION)
        lung = self.lungs.get(number)
        if lung is not None:
            at = (self.middles[number] - self.turn @ lung.middle) / lung.size_mm
            x = float((self.turn @ lung.middle)[0])
            other = next((other for other in self.lungs.values() if other is not lung), None)
            side = 0.0 if other is None else math.copysign(1.0, x - float((self.turn @ other.middle)[0]))
            radius = math.log(max(self.bronchi[number].radius_mm, 0.1) / max(lung.unit_radius_mm, 0.1))
            calibre = (
                -0.5 * ((radius - grammar.log_calibre) / CALIBRE_SPREAD) ** 2
                + 0.5 * ((radius - CALIBRE_INSIDE) / CALIBRE_ANY) ** 2
                + math.log(CALIBRE_ANY / CALIBRE_SPREAD)
            )
            total += np.clip(calibre, -8.0, 1.0)
            for which, (middle, size) in self._lung_place.items():
                mine = grammar.side == which
                off = (grammar.place[mine] - middle) / size - at
                spread = (off**2).sum(axis=1) / PLACE_SPREAD**2
                anywhere = (at**2).sum() / PLACE_ANY**2
                place = -0.5 * (spread - anywhere) + 3.0 * math.log(PLACE_ANY / PLACE_SPREAD)
                total[mine] += np.clip(place, -5.0, 2.0)
                if side not in {0.0, which}:
                    total[mine] += WRONG_SIDE
        result: Array = TEMPER * total
        return result


def _spur(bronchi: list[Bronchus], number: int) -> float:
    """Return the log odds that a bronchus leads to no segment: high for twigs, low with many branches."""
    bronchus = bronchi[number]
    assert bronchus.parent is not None
    parent = bronchi[bronchus.parent]
    share = bronchus.bulk_mm / max(sum(bronchi[c].bulk_mm for c in parent.children), 1e-9)
    if _is_stump(bronchi, number):
        return -STUMP_SPUR
    return -(1.0 if _is_short_tip(bronchi, number) else 3.5 if bronchus.children else 2.2) - 8.0 * share


def _is_short_tip(bronchi: list[Bronchus], number: int) -> bool:
    bronchus = bronchi[number]
    return (
        bronchus.parent is not None
        and not bronchus.children
        and bronchus.length_mm < 2.5 * bronchi[bronchus.parent].radius_mm
    )


def _is_stump(bronchi: list[Bronchus], number: int) -> bool:
    """Return whether a bronchus is short, blind and wide: the stump that a resection or a plug leaves, not a twig."""
    bronchus = bronchi[number]
    return (
        _is_short_tip(bronchi, number)
        and bronchus.parent is not None
        and bronchus.radius_mm >= STUMP_MM
        and bronchus.radius_mm >= STUMP_SHARE * bronchi[bronchus.parent].radius_mm
    )


def probability_of_one_segment(apart: float) -> float:
    """Return the probability that two neighbouring basal bronchi are subsegments of one segment, and none is RB7.

    `apart` is the distance between their territories in units of the lung's size. Before the distance is known, both
    cases are equally probable: RB7 is absent in 6 % of people, and a common stem of RB7 and one other basal segment is
    as rare.
    """

    def log_density(mean: float, spread: float) -> float:
        return -0.5 * ((apart - mean) / spread) ** 2 - math.log(spread)

    odds = log_density(*SUBSEGMENTS_APART) - log_density(*MEDIAL_APART)
    if apart < SUBSEGMENTS_APART[0]:
        odds = MAX_APART_ODDS
    elif apart > MEDIAL_APART[0]:
        odds = -MAX_APART_ODDS
    return 1.0 / (1.0 + math.exp(-min(max(odds, -MAX_APART_ODDS), MAX_APART_ODDS)))


class Solver:
    """Solver that sums over all readings (assignments of names) of one tree in one orientation of the body axes.

    Parameters
    ----------
    grammar
        The anatomical grammar.
    bronchi, lungs
        The bronchi of the tree, and their lungs.
    frame
        (3, 3) rows left, posterior, superior in LPS.
    mirrored
        Whether to read the left lung as a right one and the other way round.
    wishes
        For bronchi that a user named: log odds per state, 0 for states that fit the name.
    held
        For bronchi with such names on them or beyond them: log odds per segment that they are inside it, and log
        odds that they carry no segment.
    max_forks
        Forks farther than this from the root are not read: the bronchi beyond are inside a segment.
    """

    log_evidence: float
    """Log evidence of the tree under the anatomical model, summed over all readings."""

    def __init__(
        self,
        grammar: Grammar,
        bronchi: list[Bronchus],
        lungs: dict[int, Lung],
        frame: NDArray[np.float64],
        *,
        mirrored: bool = False,
        wishes: dict[int, Array] | None = None,
        held: dict[int, tuple[Array, float]] | None = None,
        max_forks: int = MAX_FORKS,
    ) -> None:
        self.model = model = _Model(
            grammar, bronchi, lungs, frame, mirrored=mirrored, wishes=wishes or {}, held=held or {}
        )
        self.grammar = grammar
        self.bronchi = bronchi
        count = len(bronchi)
        self.own: list[Array] = [np.empty(0)] * count
        self.sums: list[Array] = [np.empty(0)] * count
        self.tables: list[_Tables | None] = [None] * count
        self.posts: list[Array] = [np.empty(0)] * count
        self.readings: list[Reading] = [Reading(None, 0.0)] * count
        terminal = grammar.terminal
        forks = [0] * count
        for number, bronchus in enumerate(bronchi):
            forks[number] = 0 if bronchus.parent is None else forks[bronchus.parent] + 1
        nothing = np.zeros(len(grammar))
        for number in range(count - 1, -1, -1):
            bronchus = bronchi[number]
            if forks[number] > max_forks:
                continue
            local = model.evidence(number)
            if number in model.wishes:
                local = local + model.wishes[number]
            interior = model.held[number][0] if number in model.held else nothing
            if bronchus.children and forks[number] < max_forks:
                parts = [self.part_of(child) for child in bronchus.children]
                table = _Tables(parts, [self.sums[child] for child in bronchus.children], model)
                structure = table.sums[table.full].copy()
                self.tables[number] = table
            else:
                structure = self.ending(number).copy()
            structure[terminal] = interior[terminal]
            self.own[number] = structure + local
            self.sums[number] = model.shrunk(self.own[number])
        self._root = grammar.root_log_prior + self.sums[0]
        self.log_evidence = float(np.logaddexp.reduce(self._root))

    def solution(self) -> Solution:
        """Return the labels of all bronchi with their probabilities."""
        self.posts[0] = np.exp(self._root - self.log_evidence)
        for number in range(len(self.bronchi)):
            self._outward(number)
        self._read(0, int(np.argmax(self.posts[0])))
        self._compare_medial_basal()
        return Solution(self.readings)

    def shares_of_states(self) -> Array:
        """Return the probability (n, states) that each bronchus has each state, summed over all readings."""
        self.solution()
        shares = np.zeros((len(self.bronchi), len(self.grammar)))
        for number, post in enumerate(self.posts):
            if len(post) and len(self.own[number]) and post.sum() > 1e-9:
                shares[number] = self._spread_shrink(post, self.sums[number], self.own[number])
        return shares

    def ending(self, number: int) -> Array:
        """Return the log odds, for each state, that a bronchus ends before it divides."""
        return self.model.stump if _is_stump(self.bronchi, number) else self.model.truncated

    def part_of(self, number: int) -> _ForkSide:
        """Return a bronchus as one side of a fork, with its log odds per state."""
        model = self.model
        inner, spur = model.held.get(number, (None, 0.0))
        bronchus = self.bronchi[number]
        return _ForkSide(
            middle=model.middles[number],
            direction=model.directions[number],
            bulk=max(bronchus.bulk_mm, 1e-3),
            spur=_spur(self.bronchi, number) + spur,
            interior=np.zeros(len(self.grammar)) if inner is None else inner,
        )

    def _spread_shrink(self, post: Array, sums: Array, own: Array) -> Array:
        """Move a part of the probability of each state with missing parts to the states that it may stand for."""
        spread = post.copy()
        for state, others, odds in reversed(self.grammar.shrink):
            if spread[state] <= 0.0 or not np.isfinite(sums[state]):
                continue
            # The sums of the other states may already include replacements by their own rules.
            shares = np.exp(odds + sums[others] - sums[state])
            spread[others] += spread[state] * shares
            spread[state] *= math.exp(min(own[state] - sums[state], 0.0)) if np.isfinite(own[state]) else 0.0
        return spread

    def _outward(self, number: int) -> None:
        """Compute the probabilities of the states of a bronchus's children from those of the bronchus."""
        post = self.posts[number]
        if not len(post):
            post = self.posts[number] = np.zeros(len(self.grammar))
        table = self.tables[number]
        if table is None or post.sum() < 1e-9:
            return
        spread = self._spread_shrink(post, self.sums[number], self.own[number])
        # Segments end the grammar: everything beyond is inside them.
        weights = np.where(self.grammar.terminal, 0.0, spread)
        posts = {1 << k: np.zeros(len(self.grammar)) for k in range(table.num)}
        if table.num == 1:
            posts[1] = weights
        else:
            whole = {table.full: weights}
            for subset in sorted(table.sums, key=lambda s: -s.bit_count()):
                if subset.bit_count() >= 2:
                    self._divide(table, subset, whole, posts)
        for k, child in enumerate(self.bronchi[number].children):
            self.posts[child] = posts[1 << k]

    def _divide(self, table: _Tables, subset: int, whole: dict[int, Array], posts: dict[int, Array]) -> None:
        weights = whole.get(subset)
        if weights is None or weights.sum() < 1e-9:
            return
        structure = table.sums[subset]
        if subset != table.full:
            own = table.structure(subset)
            terminal = self.grammar.terminal
            doubled = np.logaddexp(own, np.where(terminal, DOUBLE + table.part[subset].interior, -np.inf))
            weights = self._spread_shrink(weights, structure, doubled)
            with np.errstate(invalid="ignore"):
                share = np.where(np.isfinite(doubled), np.exp(own - doubled), 0.0)
            weights = weights * share
            structure = own
        splits = table.splits(subset)
        with np.errstate(divide="ignore", invalid="ignore"):
            outside = np.where((weights > 0.0) & np.isfinite(structure), np.log(weights) - structure, -np.inf)
        division = self.grammar.division
        size = len(self.grammar)
        for one, two in splits:
            mass = np.exp(outside[division.state] + table.rows(one, two))
            on_one = np.exp(outside + table.sums[one] + table.part[two].spur)
            on_two = np.exp(outside + table.sums[two] + table.part[one].spur)
            for part, which, going_on in ((one, division.one, on_one), (two, division.two, on_two)):
                gained = np.bincount(which, weights=mass, minlength=size) + going_on
                target = posts if part.bit_count() == 1 else whole
                target[part] = target.get(part, np.zeros(size)) + gained

    def _compare_medial_basal(self) -> None:
        """Compare each reading as a common stem of RB7 and another basal segment with one segment that divides.

        A fork inside a segment adds no evidence in the sums over all readings, but two labels do. In a lung without RB7
        (6 % of people) a fork inside RB8 or RB10 is therefore read as RB7 and this segment. The distance between the
        territories of both sides distinguishes the two cases. Stems that a user named are not changed.
        """
        grammar = self.grammar
        found = {key for number in range(len(self.bronchi)) for key in self._segment_of(number)}
        if not found >= BASAL | {MEDIAL_BASAL}:
            return
        named = {*self.model.wishes, *self.model.held}
        for number, bronchus in enumerate(self.bronchi):
            sides = {key: child for child in bronchus.children for key in self._segment_of(child)}
            state, lung = self.readings[number].settled, self.model.lungs.get(number)
            if state is None or lung is None or len(sides) != 2 or grammar.segments[state] != set(sides):
                continue
            key = next((one for one in sides if one in BASAL), None)
            if key is None or MEDIAL_BASAL not in sides:
                continue
            medial, other = sides[MEDIAL_BASAL], sides[key]
            stem = [number]
            while self.readings[stem[-1]].again and (parent := self.bronchi[stem[-1]].parent) is not None:
                stem.append(parent)
            if named & {*stem, medial, other}:
                continue
            offset = self.model.middles[medial] - self.model.middles[other]
            one_segment = probability_of_one_segment(float(np.linalg.norm(offset)) / lung.size_mm)
            segment = grammar.index[f"={key}"]
            if one_segment < 0.5:
                for which in (*stem, *bronchus.children):
                    reading = self.readings[which]
                    self.readings[which] = replace(reading, confidence=reading.confidence * (1.0 - one_segment))
                continue
            for which in stem:
                before = self.readings[which]
                sure = min(1.0, before.confidence * one_segment + float(self.posts[which][segment]))
                self.readings[which] = Reading(segment, sure, settled=segment, again=before.again)
            self._read_below(number, segment)

    def _segment_of(self, number: int) -> frozenset[str]:
        """Return the key of the segment as which a bronchus is read, as a set; empty if it is read otherwise."""
        settled = self.readings[number].settled
        if settled is None or not self.grammar.terminal[settled]:
            return frozenset()
        return self.grammar.segments[settled]

    # Assignment of labels, from the trachea down.

    def _read(self, number: int, state: int, *, again: bool = False) -> None:
        settled = self._settled(state, self.sums[number], self.own[number])
        sure = float(min(self.posts[number][state], 1.0))
        self.readings[number] = Reading(state, sure, settled=settled, again=again)
        self._read_below(number, settled)

    def _settled(self, state: int, sums: Array, own: Array) -> int:
        """Return the likeliest state that an incomplete state stands for, or the state itself if it is likelier."""
        while True:
            rule = next((r for r in self.grammar.shrink if r[0] == state), None)
            if rule is None:
                return state
            _, others, odds = rule
            best = int(np.argmax(odds + sums[others]))
            if np.isfinite(own[state]) and own[state] >= odds[best] + sums[others[best]]:
                return state
            state = int(others[best])

    def _read_below(self, number: int, state: int) -> None:
        table = self.tables[number]
        if self.grammar.terminal[state]:
            for child in self.bronchi[number].children:
                self._read_inside(child, state, self.readings[number].confidence)
        elif table is not None and table.num == 1:
            self._read(self.bronchi[number].children[0], state, again=True)
        elif table is not None:
            self._read_split(number, table, table.full, state)

    def _read_split(self, number: int, table: _Tables, subset: int, state: int) -> None:
        best = (-math.inf, "", 0, 0, 0)
        division = self.grammar.division
        lo, hi = np.searchsorted(division.state, [state, state + 1])
        for one, two in table.splits(subset):
            rows = table.rows(one, two)[lo:hi]
            if len(rows) and rows.max() > best[0]:
                best = (float(rows.max()), "divide", one, two, lo + int(np.argmax(rows)))
            for followed, left in ((one, two), (two, one)):
                value = float(table.sums[followed][state] + table.part[left].spur)
                if value > best[0]:
                    best = (value, "go on", followed, left, 0)
        if subset != table.full and self.grammar.terminal[state]:
            value = DOUBLE + float(table.part[subset].interior[state])
            if value >= best[0]:
                best = (value, "twins", subset, 0, 0)
        _, how, one, two, row = best
        children = self.bronchi[number].children
        if how == "divide":
            parts = ((one, int(division.one[row])), (two, int(division.two[row])))
            for part, carried in parts:
                self._read_part(number, table, part, carried, again=False)
        elif how == "go on":
            self._read_part(number, table, one, state, again=True)
            for k in range(table.num):
                if two >> k & 1:
                    self._read_spur(children[k])
        elif how == "twins":
            mass = self.readings[number].confidence
            for k in range(table.num):
                if subset >> k & 1:
                    self._read_inside(children[k], state, mass * 0.8, twin=True)

    def _read_part(self, number: int, table: _Tables, part: int, state: int, *, again: bool) -> None:
        if part.bit_count() == 1:
            self._read(self.bronchi[number].children[part.bit_length() - 1], state, again=again)
        else:
            own = table.structure(part)
            terminal = self.grammar.terminal
            own[terminal] = np.logaddexp(own[terminal], DOUBLE + table.part[part].interior[terminal])
            self._read_split(number, table, part, self._settled(state, table.sums[part], own))

    def _read_inside(self, number: int, state: int, confidence: float, *, twin: bool = False) -> None:
        self.readings[number] = Reading(None, confidence, inside=state, twin=twin)
        for child in self.bronchi[number].children:
            self._read_inside(child, state, confidence)

    def _read_spur(self, number: int) -> None:
        self.readings[number] = Reading(None, 0.0)
        for child in self.bronchi[number].children:
            self._read_spur(child)
