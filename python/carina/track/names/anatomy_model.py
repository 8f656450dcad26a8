"""Anatomical model of a bronchial tree: segments, their positions, their common stems, and their frequencies.

Directions and positions are those of anatomy atlases in words ("posterior and slightly up", "lowest, towards the
back"), converted by hand to numbers with wide tolerances; they are not fitted to any scan. Frequencies of variants are
those of the studies named beside them. In the vectors of a :class:`Segment`, x is lateral (away from the midline), y
posterior and z superior. In those of the :class:`Grammar`, which are in the body frame, x is the patient's left.

The model is a grammar. A branch *carries* a set of segments; a fork divides the set between its two sides; a set of
one segment is the bronchus of that segment. The states of the grammar are:

- an exact set of segments of one lobe ("RB9 and RB10, and no others are visible");
- a lobe: any set of its segments, with the odds of each segment being absent or not found;
- trunks of several lobes: trachea, main bronchi, bronchus intermedius, and their uncommon forms.
"""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Segment:
    """Segment of the lung in the anatomical model."""

    key: str
    """Name: RB1 ... LB10; LB1 and LB2 are the two halves of LB1+2; RB* and LB* are the subsuperior segments."""
    lobe: str
    """Lobe of the segment, such as RUL."""
    direction: Vector
    """Direction (3,) of the segment's bronchus: x lateral, y posterior, z superior."""
    place: Vector
    """Position of the segment's territory relative to the centre of the lung, x lateral, in about half lung heights."""
    absent: float
    """Probability that the segment is missing from the tree of a good CT, because it is absent or was not found."""
    bulk: float = 1.0
    """Expected total length of the segment's bronchi, relative to the mean over all segments."""


# Absent: RB7 6.1 %, B* present in 16 % (MESA, n = 3,169); no B9 in 18 % of 238 (Huang 2019); the rest: not found.
_RIGHT = (
    Segment("RB1", "RUL", (0.35, 0.05, 0.93), (0.10, 0.05, 1.00), 0.04),
    Segment("RB2", "RUL", (0.55, 0.75, 0.35), (0.30, 0.55, 0.65), 0.04),
    Segment("RB3", "RUL", (0.50, -0.85, 0.10), (0.15, -0.70, 0.50), 0.04),
    Segment("RB4", "RML", (0.80, -0.50, -0.35), (0.40, -0.55, -0.25), 0.04),
    Segment("RB5", "RML", (0.35, -0.80, -0.45), (-0.10, -0.80, -0.40), 0.04),
    Segment("RB6", "RLL", (0.35, 0.92, 0.10), (0.15, 0.75, 0.15), 0.04),
    Segment("RB*", "RLL", (0.35, 0.85, -0.35), (0.15, 0.70, -0.30), 0.94, 0.4),
    Segment("RB7", "RLL", (-0.15, -0.20, -0.97), (-0.30, -0.05, -0.75), 0.10, 0.6),
    Segment("RB8", "RLL", (0.50, -0.45, -0.75), (0.30, -0.25, -0.75), 0.05),
    Segment("RB9", "RLL", (0.75, 0.20, -0.65), (0.40, 0.20, -0.75), 0.15),
    Segment("RB10", "RLL", (0.20, 0.55, -0.80), (0.00, 0.55, -0.75), 0.04),
)
_LEFT = (
    Segment("LB1", "LUL", (0.30, 0.10, 0.95), (0.05, 0.10, 1.00), 0.04, 0.6),
    Segment("LB2", "LUL", (0.45, 0.65, 0.55), (0.25, 0.50, 0.70), 0.04, 0.6),
    Segment("LB3", "LUL", (0.50, -0.80, 0.30), (0.10, -0.70, 0.45), 0.04),
    Segment("LB4", "LUL", (0.80, -0.55, -0.10), (0.30, -0.65, -0.05), 0.05, 0.7),
    Segment("LB5", "LUL", (0.50, -0.70, -0.50), (0.05, -0.80, -0.35), 0.05, 0.7),
    Segment("LB6", "LLL", (0.35, 0.92, 0.10), (0.15, 0.75, 0.15), 0.04),
    Segment("LB*", "LLL", (0.35, 0.85, -0.35), (0.15, 0.70, -0.30), 0.94, 0.4),
    Segment("LB8", "LLL", (0.45, -0.45, -0.78), (0.20, -0.25, -0.75), 0.05),
    Segment("LB9", "LLL", (0.75, 0.20, -0.65), (0.40, 0.20, -0.75), 0.12),
    Segment("LB10", "LLL", (0.20, 0.55, -0.80), (0.00, 0.55, -0.75), 0.04),
)

LOBES: dict[str, tuple[str, ...]] = {
    lobe: tuple(s.key for s in (*_RIGHT, *_LEFT) if s.lobe == lobe) for lobe in ("RUL", "RML", "RLL", "LUL", "LLL")
}

# Weight of each group of segments as a common stem; other groups get the last figure of the lobe. RUL: B1-B2-B3
# together 59 %, B1+2 18 %, two stems of another kind 12 %, B2+3 9 % (Huang 2019); a short common piece of three may be
# followed by any pair. LUL: LB1+2 and LB3 76.1 %, three together 17.3 %, LB1+3 5.7 % (n = 10,000). RLL: common
# B8-B9-B10 9 %, B8+9 11 % (Huang 2019), usually B9+10 in the rest.
_STEMS: dict[str, tuple[dict[frozenset[str], float], float]] = {
    "RUL": ({frozenset({"1", "2"}): 0.40, frozenset({"2", "3"}): 0.28, frozenset({"1", "3"}): 0.26}, 0.1),
    "RML": ({}, 0.1),
    "RLL": (
        {
            frozenset({"7", "8", "9", "10"}): 1.0,
            frozenset({"8", "9", "10"}): 0.9,
            frozenset({"9", "10"}): 0.8,
            frozenset({"8", "9"}): 0.45,
            frozenset({"7", "8"}): 0.35,
            frozenset({"7", "9", "10"}): 0.15,
            frozenset({"7", "8", "9"}): 0.12,
            frozenset({"7", "10"}): 0.12,
            frozenset({"7", "8", "10"}): 0.05,
            frozenset({"*", "7", "8", "9", "10"}): 1.0,
            frozenset({"*", "8", "9", "10"}): 0.5,
        },
        0.02,
    ),
    "LUL": (
        {
            frozenset({"1", "2"}): 1.0,
            frozenset({"1", "2", "3"}): 1.0,
            frozenset({"4", "5"}): 1.0,
            frozenset({"1", "3"}): 0.01,
            frozenset({"3", "4", "5"}): 0.06,
        },
        0.005,
    ),
    "LLL": (
        {
            frozenset({"8", "9", "10"}): 1.0,
            frozenset({"9", "10"}): 0.8,
            frozenset({"8", "9"}): 0.45,
            frozenset({"*", "8", "9", "10"}): 1.0,
            frozenset({"8", "10"}): 0.05,
        },
        0.02,
    ),
}

# Directions of the bronchi of several segments; x is lateral (for the trachea: to the left).
_TRUNKS: dict[str, Vector] = {
    "RMB": (0.50, 0.10, -0.85),
    "BI": (0.25, 0.20, -0.95),
    "RUL": (0.90, 0.00, 0.25),
    "RML": (0.45, -0.75, -0.45),
    "RLL": (0.25, 0.30, -0.92),
    "LMB": (0.75, 0.15, -0.62),
    "LUL": (0.80, -0.40, 0.20),
    "LLL": (0.30, 0.40, -0.87),
}

_TRACHEA = (0.0, 0.22, -0.97)
"""Direction of the trachea, x to the left."""

TRUNCATED = math.log(0.25)
"""Log odds that the visible branch of a common stem of two segments ends before the stem divides."""
TRUNCATED_MORE = -0.5
"""Log odds that are added to ``TRUNCATED`` for each segment of the stem beyond the second."""
GROUP_LOST = 0.02
GROUPS_LOST = (
    frozenset({"LB1", "LB2", "LB3"}),
    frozenset({"LB4", "LB5"}),
    frozenset({"RB7", "RB8", "RB9", "RB10"}),
    frozenset({"LB8", "LB9", "LB10"}),
)
DOUBLE = math.log(0.1)
"""Log odds that two bronchi of one segment leave the same fork side by side."""


@dataclass(frozen=True, slots=True, eq=False)
class Division:
    """Divisions of a state (set of segments) into two states, in both orders, as arrays sorted by the divided state."""

    state: NDArray[np.intp]
    """Index in `names` (n,) of the state that is divided."""
    one: NDArray[np.intp]
    """Index in `names` (n,) of the state of each division's first part."""
    two: NDArray[np.intp]
    """Index in `names` (n,) of the state of each division's second part."""
    log_prior: NDArray[np.float64]
    """Log probability (n,) of the division, from anatomy alone."""
    place: NDArray[np.float64]
    """Unit vector (n, 3) from the centre of the territory of ``two`` to that of ``one``."""
    direction: NDArray[np.float64]
    """Unit vector (n, 3) along the difference of the two directions, ``one`` minus ``two``."""
    log_bulk: NDArray[np.float64]
    """Log ratio (n,) of the sizes of the two parts, ``one`` over ``two``."""


@dataclass(frozen=True, slots=True, eq=False)
class Grammar:
    """States (sets of segments, lobes and trunks) of the anatomical model and rules of their division."""

    names: list[str]
    """Name of each state, such as a segment, a lobe or a trunk."""
    segments: list[frozenset[str]]
    """Keys of the segments that a state carries (nominally)."""
    lobe: list[str | None]
    """Lobe of each state; None for trunks of several lobes."""
    kind: list[str]
    """Kind of each state: ``segment``, ``set``, ``lobe`` or ``trunk``."""
    direction: NDArray[np.float64]
    """Unit direction (n, 3) of each state's bronchus, in the body frame: x left, y posterior, z superior."""
    place: NDArray[np.float64]
    """Position (n, 3) of each state's territory, in the body frame, in units of about half a lung height."""
    log_calibre: NDArray[np.float64]
    """Log of the radius relative to a bronchus of one segment: flow is proportional to the cube of the radius."""
    side: NDArray[np.float64]
    """Side of each state: -1 right, +1 left, 0 both."""
    terminal: NDArray[np.bool_]
    """Whether each state is a single segment, which does not divide further."""
    division: Division
    """All divisions of the states."""
    shrink: list[tuple[int, NDArray[np.intp], NDArray[np.float64]]]
    """Rules for states with missing parts, which stand for other states: state, other states, log odds.

    The order of the rules allows the sums to be computed in one pass.
    """
    root_log_prior: NDArray[np.float64]
    """Log probability of each state at the root of a tree."""
    index: dict[str, int] = field(repr=False, default_factory=dict)
    left_isomerism: bool = False
    """Whether the right lung has the pattern of the left one."""

    def __len__(self) -> int:
        """Return the number of states."""
        return len(self.names)


def mirrored_key(key: str) -> str:
    """Return the key or the lobe of the other side, such as RB6 for LB6."""
    return {"L": "R", "R": "L"}[key[0]] + key[1:]


@dataclass(frozen=True, slots=True)
class _Lobe:
    """Lobe of a grammar: its segments, and the lobe of a usual chest whose divisions it has."""

    name: str
    keys: tuple[str, ...]
    pattern: str

    @property
    def halves(self) -> frozenset[str]:
        """Keys of the two halves of segment 1+2; empty in a lobe without this segment."""
        side = self.name[0]
        return frozenset({f"{side}B1", f"{side}B2"}) if self.pattern == "LUL" else frozenset()

    @property
    def groups_lost(self) -> list[frozenset[str]]:
        """Groups of segments that a search usually misses together."""
        own = [group for group in GROUPS_LOST if group <= set(LOBES[self.pattern])]
        if self.pattern == self.name:
            return own
        return [frozenset(map(mirrored_key, group)) for group in own]


def _stem_aptness(lobe: str, part: frozenset[str], seen: frozenset[str]) -> float:
    """Return the weight of a common stem of the segments ``part`` if only the segments ``seen`` are in the tree.

    The stem may also carry segments that are not visible.
    """
    if len(part) == 1:
        return 1.0
    if "*" in part and ("8" in seen - part or len(part - {"6"}) < 3):
        # B* leaves the whole basal trunk; a bronchus to its region from further down is a branch of RB9 or RB10.
        return 0.0
    table, other = _STEMS[lobe]
    best = other
    for group, aptness in table.items():
        if group & seen == part:
            best = max(best, aptness)
    return best


def _short(key: str) -> str:
    return key[2:]


def _set_name(of: _Lobe, keys: frozenset[str]) -> str:
    lobe = of.name
    order = [key for key in of.keys if key in keys and (len(keys) == 1 or not key.endswith("*"))]
    if lobe == "LUL" and {"LB1", "LB2"} <= keys:
        if keys == {"LB1", "LB2", "LB3"}:
            return "Upper division"
        if len(keys) == 5:
            return "LUL"
    if keys == frozenset(of.keys) or keys == {key for key in of.keys if not key.endswith("*")}:
        return lobe
    if keys == {"LB4", "LB5"}:
        return "Lingula"
    return order[0][:2] + "+".join(_short(key) for key in order)


class _Builder:
    def __init__(self) -> None:
        self.names: list[str] = []
        self.kind: list[str] = []
        self.keys: list[frozenset[str]] = []
        self.lobe: list[str | None] = []
        self.trunk: list[Vector | None] = []
        self.index: dict[str, int] = {}
        self.rows: list[tuple[int, int, int, float]] = []
        self.shrink: list[tuple[int, NDArray[np.intp], NDArray[np.float64]]] = []

    def add(
        self, label: str, *, name: str, kind: str, keys: frozenset[str], lobe: str | None, trunk: Vector | None = None
    ) -> int:
        self.index[label] = len(self.names)
        self.names.append(name)
        self.kind.append(kind)
        self.keys.append(keys)
        self.lobe.append(lobe)
        self.trunk.append(trunk)
        return self.index[label]

    def divide(self, state: str, one: str, two: str, share: float) -> None:
        at = self.index
        self.rows.append((at[state], at[one], at[two], math.log(share)))
        self.rows.append((at[state], at[two], at[one], math.log(share)))

    def stands_for(self, state: str, others: list[tuple[str, float]]) -> None:
        which = np.array([self.index[other] for other, _ in others], dtype=np.intp)
        odds = np.log(np.array([share for _, share in others]))
        self.shrink.append((self.index[state], which, odds))


def _exact(keys: frozenset[str]) -> str:
    return "=" + ",".join(sorted(keys))


def _add_lobe(build: _Builder, of: _Lobe, segments: dict[str, Segment]) -> None:
    """Add the exact sets of a lobe's segments, their divisions, and the lobe itself."""
    lobe, keys, halved = of.name, of.keys, of.halves
    sets = [frozenset(c) for size in range(1, len(keys) + 1) for c in itertools.combinations(keys, size)]
    for keys_of in sets:
        single = len(keys_of) == 1 or keys_of == halved
        name = _set_name(of, keys_of)
        trunk = _TRUNKS[of.pattern] if name == lobe else None
        build.add(_exact(keys_of), name=name, kind="segment" if single else "set", keys=keys_of, lobe=lobe, trunk=trunk)
    for whole in sets:
        if len(whole) == 1 or whole == halved:
            continue
        seen = frozenset(_short(key) for key in whole)
        # Only parts that contain the first key are tried, so that each unordered pair of parts is added once.
        first = min(whole, key=keys.index)
        parts = [part for part in sets if part < whole and first in part]
        apt = [
            _stem_aptness(of.pattern, frozenset(map(_short, part)), seen)
            * _stem_aptness(of.pattern, frozenset(map(_short, whole - part)), seen)
            for part in parts
        ]
        total = sum(apt)
        for part, weight in zip(parts, apt, strict=True):
            if weight > 0.0:
                build.divide(_exact(whole), _exact(part), _exact(whole - part), weight / total)

    def odds(part: frozenset[str], present: tuple[str, ...]) -> float:
        # LB1 without LB2 is very rare: it is a part of LB1+2 that was named separately.
        halves = len(part & halved) == 1
        share = math.prod(1.0 - segments[k].absent if k in part else segments[k].absent for k in present)
        for group in of.groups_lost:
            if group <= set(present) and not group & part:
                # A search that stopped on the stem loses all segments of the stem at once.
                rest = (k for k in present if k not in group)
                share += GROUP_LOST * math.prod(
                    1.0 - segments[k].absent if k in part else segments[k].absent for k in rest
                )
        return share * (0.05 if halves else 1.0)

    build.add(lobe, name=lobe, kind="lobe", keys=frozenset(keys), lobe=lobe, trunk=_TRUNKS[of.pattern])
    build.stands_for(lobe, [(_exact(part), odds(part, keys)) for part in sets])
    if of.pattern in {"RLL", "RUL"}:
        # A lobe without RB6, which then arises above it, or without RB1, which then arises from the trachea or main
        # bronchus.
        resected = "RB6" if lobe == "RLL" else "RB1"
        rest = tuple(key for key in keys if key != resected)
        name = "Right basal trunk" if lobe == "RLL" else "RUL"
        build.add(f"{lobe}-{resected}", name=name, kind="lobe", keys=frozenset(rest), lobe=lobe, trunk=_TRUNKS[lobe])
        build.stands_for(f"{lobe}-{resected}", [(_exact(p), odds(p, rest)) for p in sets if resected not in p])


def _add_usual_lungs(build: _Builder) -> dict[str, Segment]:
    """Add lobes and trunks of the lungs of a usual chest, and return the segments by key."""
    segments = {s.key: s for s in (*_RIGHT, *_LEFT)}
    for lobe, keys in LOBES.items():
        _add_lobe(build, _Lobe(lobe, keys, lobe), segments)
    right, left = frozenset(s.key for s in _RIGHT), frozenset(s.key for s in _LEFT)
    lower = frozenset(LOBES["RML"] + LOBES["RLL"])
    build.add("BI-RB6", name="BI", kind="trunk", keys=lower - {"RB6"}, lobe=None, trunk=_TRUNKS["BI"])
    build.add("BI", name="BI", kind="trunk", keys=lower, lobe=None, trunk=_TRUNKS["BI"])
    build.add("RMB-RB1", name="RMB", kind="trunk", keys=right - {"RB1"}, lobe=None, trunk=_TRUNKS["RMB"])
    build.add("RMB", name="RMB", kind="trunk", keys=right, lobe=None, trunk=_TRUNKS["RMB"])
    build.add("LMB", name="LMB", kind="trunk", keys=left, lobe=None, trunk=_TRUNKS["LMB"])
    build.add("Trachea-RUL", name="Trachea", kind="trunk", keys=left | lower, lobe=None, trunk=_TRACHEA)
    build.add("Trachea-RB1", name="Trachea", kind="trunk", keys=left | (right - {"RB1"}), lobe=None, trunk=_TRACHEA)
    build.add("Trachea", name="Trachea", kind="trunk", keys=left | right, lobe=None, trunk=_TRACHEA)

    build.divide("BI-RB6", "RML", "RLL-RB6", 1.0)
    build.divide("BI", "RML", "RLL", 0.94)
    build.divide("BI", _exact(frozenset({"RB6"})), "BI-RB6", 0.03)
    build.divide("RMB-RB1", "RUL-RB1", "BI", 1.0)
    build.divide("RMB", "RUL", "BI", 0.96)
    build.divide("RMB", _exact(frozenset({"RB1"})), "RMB-RB1", 0.005)
    build.divide("LMB", "LUL", "LLL", 0.97)
    build.divide("Trachea", "RMB", "LMB", 0.97)
    # A tracheal bronchus: RB1 alone, or the whole upper lobe (0.1 to 2 %).
    build.divide("Trachea", _exact(frozenset({"RB1"})), "Trachea-RB1", 0.006)
    build.divide("Trachea", "RUL", "Trachea-RUL", 0.004)
    build.divide("Trachea-RB1", "RMB-RB1", "LMB", 1.0)
    build.divide("Trachea-RUL", "BI", "LMB", 1.0)
    # A lobe or a lung may be removed, collapsed or cut off by the edge of the CT.
    build.stands_for("BI", [("RLL", 0.02), ("RML", 0.004)])
    build.stands_for("RMB", [("BI", 0.01), ("RUL", 0.004)])
    return segments


def _add_isomeric_lungs(build: _Builder) -> dict[str, Segment]:
    """Add lobes and trunks of two left lungs, the right of which is a mirror image, and return the segments by key."""
    mirrored = (
        Segment(mirrored_key(s.key), mirrored_key(s.lobe), s.direction, s.place, s.absent, s.bulk) for s in _LEFT
    )
    segments = {s.key: s for s in (*mirrored, *_LEFT)}
    for pattern in ("LUL", "LLL"):
        keys = LOBES[pattern]
        _add_lobe(build, _Lobe(mirrored_key(pattern), tuple(map(mirrored_key, keys)), pattern), segments)
        _add_lobe(build, _Lobe(pattern, keys, pattern), segments)
    for side in ("R", "L"):
        keys_of = frozenset(key for key in segments if key.startswith(side))
        name = f"{side}MB"
        build.add(name, name=name, kind="trunk", keys=keys_of, lobe=None, trunk=_TRUNKS["LMB"])
        build.divide(name, f"{side}UL", f"{side}LL", 0.97)
    build.add("Trachea", name="Trachea", kind="trunk", keys=frozenset(segments), lobe=None, trunk=_TRACHEA)
    build.divide("Trachea", "RMB", "LMB", 0.97)
    build.stands_for("RMB", [("RLL", 0.01), ("RUL", 0.01)])
    return segments


@functools.cache
def grammar(*, left_isomerism: bool = False) -> Grammar:
    """Return the grammar of both lungs, with usual and uncommon divisions.

    In a left isomerism, the right lung is the mirror image of the left one: it has two lobes and no RB7.
    """
    build = _Builder()
    segments = _add_isomeric_lungs(build) if left_isomerism else _add_usual_lungs(build)
    build.stands_for("LMB", [("LLL", 0.01), ("LUL", 0.01)])
    build.stands_for("Trachea", [("RMB", 0.006), ("LMB", 0.006)])

    count = len(build.names)
    direction, place, side, bulk = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count), np.zeros(count)
    for number, keys in enumerate(build.keys):
        parts = [segments[key] for key in sorted(keys)]
        bulk[number] = sum(p.bulk for p in parts)
        sides = {-1.0 if p.key.startswith("R") else 1.0 for p in parts}
        # x of the model is lateral: convert it to the patient's left.
        mirror = [np.array([-1.0 if p.key.startswith("R") else 1.0, 1.0, 1.0]) for p in parts]
        weights = np.array([p.bulk for p in parts])
        off_middle = [np.array([0.75, 0.0, 0.0]) + p.place for p in parts]
        place[number] = np.average([o * m for o, m in zip(off_middle, mirror, strict=True)], axis=0, weights=weights)
        mean = np.average(
            [np.array(p.direction) * m for p, m in zip(parts, mirror, strict=True)], axis=0, weights=weights
        )
        trunk = build.trunk[number]
        if trunk is not None:
            mean = np.array(trunk) * (mirror[0] if len(sides) == 1 else 1.0)
        direction[number] = mean / np.linalg.norm(mean)
        side[number] = next(iter(sides)) if len(sides) == 1 else 0.0
    rows = sorted(build.rows, key=lambda row: row[0])
    state, one, two = (np.array([row[k] for row in rows], dtype=np.intp) for k in range(3))
    toward = place[one] - place[two]
    turn = direction[one] - direction[two]
    root = np.full(count, -np.inf)
    # If a tree does not begin in the trachea, the user gave its root, or the volume is cropped.
    for label, share in (
        ("Trachea", 0.93),
        ("RMB", 0.02),
        ("LMB", 0.02),
        ("BI", 0.005),
        *((lobe, 0.005) for lobe in LOBES),
    ):
        if label in build.index:
            root[build.index[label]] = math.log(share)
    return Grammar(
        names=build.names,
        segments=build.keys,
        lobe=build.lobe,
        kind=build.kind,
        direction=direction,
        place=place,
        log_calibre=np.log(bulk) / 3.0,
        side=side,
        terminal=np.array([kind == "segment" for kind in build.kind]),
        division=Division(
            state=state,
            one=one,
            two=two,
            log_prior=np.array([row[3] for row in rows]),
            place=toward / np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-9),
            direction=turn / np.maximum(np.linalg.norm(turn, axis=1, keepdims=True), 1e-9),
            log_bulk=np.log(bulk[one] / bulk[two]),
        ),
        shrink=build.shrink,
        root_log_prior=root,
        index=build.index,
        left_isomerism=left_isomerism,
    )
