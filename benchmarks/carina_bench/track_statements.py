"""``carina bench track --only statements``: whether statements about disease, tubes and the larynx are true.

A *statement* is an uncertain place or an absence that names a disease (a stump, a blocked or a filled bronchus), or a
badge that names a tube or the larynx. A statement is true if the case was generated with such a finding near the stated
place. In a real CT a stated disease is false if readers list an airway that continues beyond the stated place; any
other statement of a real CT is printed for review and not counted.

Each segment that the search did not name must be in the list of absences, or its lobe must be.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.config import load_settings
from carina.errors import CarinaError
from carina.phantom import Phantom, generate_phantom
from carina.track import Airways, find_airways
from carina.track.names.anatomy_model import LOBES
from carina.volume import Volume
from carina_bench.filled_bronchi import with_secretions
from carina_bench.track_hard_cases import hard_cases
from carina_bench.track_painted import PATIENTS
from carina_bench.track_visible import CTS, SEGMENTS, listed_airways, opened_ct

__all__ = ["CASES", "Case", "Fact", "Statement", "fact_of", "judge", "run", "statements_of"]

Say = Callable[[str], None]
Row = dict[str, Any]
Points = NDArray[np.float64]

DISEASES = {"resected": "stump", "stump": "stump", "blocked": "filled", "filled": "filled"}
"""Kind of finding that makes a statement of disease true, by the kind of absence or uncertain place.

The text of a stump is *it was resected, or a tumour or mucus fills it*, so a filled bronchus makes it true as well.
"""
BADGES = {"track.tube": "tube", "track.larynx": "larynx"}
"""Kind of finding that makes a badge (permanent note) true, by the badge's code."""
REACH_MM = 10.0
"""Maximum distance between the place of a statement and a finding that makes it true, mm."""
PASSED_MM = 5.0
"""Minimum length in mm by which a listed airway continues beyond a stated disease, which is then false."""
BLUNT_END_MM = 5.0
"""Maximum distance between the place of a stump and a blunt end of a phantom's airways that explains it, mm."""

THIN_MM, THICK_MM = 1.0, 3.0
"""Slice thicknesses of the phantoms, mm."""
NUM_PEOPLE = 20
"""Number of healthy phantoms that are searched."""
NUM_PATIENTS_OF_A_FINDING = 4
"""Number of phantoms that are searched with each kind of finding."""
FILLED = ("RB6", "LB10", "RML", "LB6", "RB10")
"""Bronchi that are filled in phantoms."""
FLUID = ((1.0, 4.0, 9.0), (0.8, 4.0, 9.0))
"""Secretions: filled share of a section's height, and start and length along the bronchus, mm."""
PAINTED = (("medium", "0.7mm"), ("medium", "2mm"), ("medium", "3mm"), ("sharp", "0.7mm"))
"""Kernels and slices of painted patients."""
MIN_TRUE = 0.95
"""Minimum accepted share of the search's statements that are true."""
MIN_NAMED = 0.9
"""Minimum accepted share of missed segments that the list of absences contains."""
CASES = (*PATIENTS, "healthy", "resected", "filled", "tubes", "necks", "crops", "real")
"""Values that ``--case`` accepts: painted patients, and kinds of phantoms or real CTs."""


@dataclass(frozen=True, slots=True)
class Fact:
    """Finding with which a case was generated."""

    kind: str
    """Kind of finding: ``stump``, ``filled``, ``tube`` or ``larynx``."""
    points_lps: Points | None = None
    """Places (n, 3) of the finding, LPS mm; None if a statement needs no place to be true."""
    lobe: str | None = None


@dataclass(frozen=True, slots=True)
class Statement:
    """Statement of the search about the patient: kind, name and position."""

    kind: str
    lps: Points | None
    text: str
    lobe: str | None = None


@dataclass(frozen=True, slots=True)
class Case:
    """CT with the findings that its patient has."""

    name: str
    part: str
    volume: Volume
    facts: tuple[Fact, ...] = ()
    segments: tuple[str, ...] = ()
    """Segments inside the scan; empty if they are not known."""
    listed: tuple[Points, ...] = ()
    """Centrelines of the airways that readers list in a real CT, LPS mm."""
    blunt_ends: Points | None = None
    """Ends (n, 3) of a phantom's airways, LPS mm; None for other cases.

    The airways of the last generation end in a closed wall, the widest with a diameter of 6 mm. A stump stated there is
    true, but it is not a finding that must be stated.
    """


@dataclass(slots=True)
class Counts:
    """Sums of statements, findings and missed segments over cases."""

    num_true: int = 0
    num_false: int = 0
    num_unknown: int = 0
    num_at_blunt_ends: int = 0
    """Number of true stumps whose place is at a blunt end of a phantom's airways."""
    named: Counter[str] = field(default_factory=Counter)
    facts: Counter[str] = field(default_factory=Counter)
    num_unreported: int = 0
    num_missed: int = 0


def statements_of(airways: Airways) -> list[Statement]:
    """Return the statements of a search result about disease, tubes and the larynx."""
    found = [
        Statement(DISEASES[place.kind], np.array(place.lps), place.reason)
        for place in airways.uncertain
        if place.kind in DISEASES and not (place.kind == "blocked" and place.length_mm is None)
    ]
    found += [
        Statement(
            DISEASES[absence.kind], None if absence.lps is None else np.array(absence.lps), absence.words, absence.name
        )
        for absence in airways.absent
        if absence.kind in DISEASES
    ]
    found += [Statement(BADGES[note.code], None, note.words) for note in airways.badges if note.code in BADGES]
    return found


def fact_of(statement: Statement, facts: Sequence[Fact]) -> Fact | None:
    """Return the finding of a case that makes a statement true; None if there is none."""
    for fact in facts:
        is_kind = fact.kind == statement.kind or {fact.kind, statement.kind} == {"filled", "stump"}
        if not is_kind:
            continue
        if fact.points_lps is None or (statement.lobe is not None and statement.lobe == fact.lobe):
            return fact
        if statement.lps is not None:
            off_mm = np.linalg.norm(fact.points_lps - statement.lps, axis=1).min()
            if off_mm <= REACH_MM:
                return fact
    return None


def is_passed(statement: Statement, listed: Sequence[Points]) -> bool:
    """Return whether a listed airway passes the place of a statement and continues beyond it by :data:`PASSED_MM`."""
    if statement.lps is None:
        return False
    for points in listed:
        off_mm = np.linalg.norm(points - statement.lps, axis=1)
        nearest = int(off_mm.argmin())
        beyond_mm = float(np.linalg.norm(np.diff(points[nearest:], axis=0), axis=1).sum())
        if off_mm[nearest] <= 0.5 * REACH_MM and beyond_mm >= PASSED_MM:
            return True
    return False


def is_at_blunt_end(statement: Statement, blunt_ends: Points | None) -> bool:
    """Return whether a statement is a stump at a blunt end of a phantom's airways.

    The absence of a lobe is never one.
    """
    if blunt_ends is None or statement.lps is None or statement.lobe is not None or statement.kind != "stump":
        return False
    return bool(np.linalg.norm(blunt_ends - statement.lps, axis=1).min() <= BLUNT_END_MM)


def judge(case: Case, airways: Airways, counts: Counts, say: Say) -> None:
    """Add the counts of a case to the sums, and print the false statements and the missing findings."""
    named: set[int] = set()
    for statement in statements_of(airways):
        fact = fact_of(statement, case.facts)
        if fact is not None:
            counts.num_true += 1
            named.add(id(fact))
        elif is_at_blunt_end(statement, case.blunt_ends):
            counts.num_true += 1
            counts.num_at_blunt_ends += 1
        elif case.listed and not is_passed(statement, case.listed):
            counts.num_unknown += 1
            say(f"  for review: {statement.text}")
        else:
            counts.num_false += 1
            say(f"  false: {statement.text}")
    for fact in case.facts:
        counts.facts[fact.kind] += 1
        counts.named[fact.kind] += id(fact) in named
        if id(fact) not in named:
            say(f"  not stated: {fact.kind} {fact.lobe or ''}")
    names = {branch.name for branch in airways.tree.branches}
    absent = {absence.name for absence in airways.absent}
    for segment in case.segments:
        is_named = any(name is not None and _covers(name, segment) for name in names)
        if not is_named:
            counts.num_missed += 1
            if not any(name == _lobe(segment) or _covers(name, segment) for name in absent):
                counts.num_unreported += 1
                say(f"  missed without a word: {segment}")


def _covers(name: str, segment: str) -> bool:
    """Return whether the name of a stem such as RB1+3 contains the segment, such as RB3."""
    side, _, numbers = name.partition("B")
    own_side, _, own = segment.partition("B")
    return side == own_side and set(own.split("+")) <= set(numbers.split("+"))


def _lobe(segment: str) -> str:
    """Return the name of the lobe to which a segment such as RB3 or LB1+2 belongs."""
    first = segment.split("+", maxsplit=1)[0]
    return next(lobe for lobe, segments in LOBES.items() if first in segments)


def run(quick: bool, say: Say, cases: Sequence[str] = ()) -> list[Row]:
    """Return the shares of true statements, of stated findings, and of missed segments that are reported as absent."""
    counts: dict[str, Counts] = {}
    for case in _cases(quick, say, cases):
        try:
            airways = find_airways(case.volume, progress=False)
        except CarinaError as error:
            say(f"{case.name}: {error}")
            continue
        say(f"{case.name}: {len(airways.tree)} branches")
        judge(case, airways, counts.setdefault(case.part, Counts()), say)
    return list(_rows(counts))


def _rows(counts: dict[str, Counts]) -> Iterator[Row]:
    num_true = sum(one.num_true for one in counts.values())
    num_false = sum(one.num_false for one in counts.values())
    for part, one in counts.items():
        note = f"{one.num_true} true, {one.num_false} false, {one.num_unknown} for review"
        note += f"; {one.num_at_blunt_ends} of the true ones at blunt ends of the phantom"
        yield {"what": "false statements", "case": part, "figure": one.num_false, "note": note}
    share = num_true / max(num_true + num_false, 1)
    note = f"{num_true} of {num_true + num_false}"
    yield {"what": "statements that are true", "figure": share, "limit": MIN_TRUE, "note": note}
    facts: Counter[str] = Counter()
    named: Counter[str] = Counter()
    for one in counts.values():
        facts.update(one.facts)
        named.update(one.named)
    for kind, num in facts.items():
        note = f"{named[kind]} of {num}"
        row: Row = {"what": "generated findings that are stated", "case": kind, "figure": named[kind] / num}
        yield row | {"limit": MIN_NAMED, "note": note}
    num_missed = sum(one.num_missed for one in counts.values())
    unreported = sum(one.num_unreported for one in counts.values())
    note = f"{unreported} of {num_missed} missed"
    row = {"what": "missed segments without a report", "figure": unreported, "limit": 0, "better": "lower"}
    yield row | {"note": note}


def _cases(quick: bool, say: Say, cases: Sequence[str]) -> Iterator[Case]:
    wanted = cases or CASES
    makers: dict[str, Callable[[int], Iterator[Case]]] = {
        "healthy": _healthy,
        "resected": _resected,
        "filled": _filled,
        "tubes": _tubes,
        "necks": _necks,
        "crops": _crops,
    }
    for part, maker in makers.items():
        if part in wanted:
            yield from maker(1 if quick else NUM_PEOPLE if part == "healthy" else NUM_PATIENTS_OF_A_FINDING)
    data = load_settings().data_dir
    if data is None or not data.is_dir():
        say("no masks and no real CTs: CARINA_DATA_DIR names no folder")
        return
    patients = [name for name in PATIENTS if name in wanted][: 1 if quick else None]
    for kernel, slices in PAINTED[: 1 if quick else None]:
        for painted in hard_cases(data, patients, (kernel,), (slices,), say):
            yield Case(painted.name, "painted", painted.volume)
    if "real" in wanted:
        for name in CTS[: 1 if quick else None]:
            with opened_ct(data / "ct", name) as volume:
                if volume is None:
                    say(f"{name} is not in {data / 'ct'}")
                    continue
                listed = listed_airways(name)
                yield Case(name, "real", volume, listed=tuple(one.points for one in listed))


def _spacing(slice_mm: float) -> tuple[float, float, float]:
    return (THIN_MM, THIN_MM, slice_mm)


def _healthy(num: int) -> Iterator[Case]:
    for seed in range(1, num + 1):
        for slice_mm, noise_hu in ((THIN_MM, 25.0), (THIN_MM, 60.0), (THICK_MM, 25.0)):
            made = generate_phantom(seed=seed, spacing_mm=_spacing(slice_mm), noise_hu=noise_hu)
            name = f"healthy {seed} {slice_mm:g} mm {noise_hu:g} HU"
            yield Case(name, "healthy", made.volume, segments=SEGMENTS, blunt_ends=_blunt_ends(made))


def _resected(num: int) -> Iterator[Case]:
    for seed in range(1, num + 1):
        for lobe in LOBES:
            for slice_mm in (THIN_MM, THICK_MM):
                made = generate_phantom(seed=seed, spacing_mm=_spacing(slice_mm), noise_hu=25.0, resected=lobe)
                whole = generate_phantom(seed=seed, spacing_mm=10.0, noise_hu=0.0)
                facts = (Fact("stump", np.array(_branch(whole, lobe)["points"]), lobe),)
                left = tuple(segment for segment in SEGMENTS if _lobe(segment) != lobe)
                name = f"resected {lobe} {seed} {slice_mm:g} mm"
                yield Case(name, "resected", made.volume, facts, left, blunt_ends=_blunt_ends(made))


def _filled(num: int) -> Iterator[Case]:
    for seed in range(1, num + 1):
        for slice_mm in (THIN_MM, THICK_MM):
            made = generate_phantom(seed=seed, spacing_mm=_spacing(slice_mm), noise_hu=25.0)
            for bronchus in FILLED:
                for share, from_mm, length_mm in FLUID:
                    try:
                        wet = with_secretions(made, bronchus, share=share, from_mm=from_mm, length_mm=length_mm)
                    except (ValueError, StopIteration):
                        continue
                    facts = (Fact("filled", wet.axis_lps),)
                    name = f"filled {bronchus} {share:.0%} {seed} {slice_mm:g} mm"
                    yield Case(name, "filled", wet.volume, facts, blunt_ends=_blunt_ends(made))


def _tubes(num: int) -> Iterator[Case]:
    for seed in range(1, num + 1):
        for tube in ("endotracheal", "tracheostomy"):
            for slice_mm in (THIN_MM, THICK_MM):
                made = generate_phantom(seed=seed, spacing_mm=_spacing(slice_mm), noise_hu=25.0, neck=True, tube=tube)
                facts = (Fact("tube"), Fact("larynx"))
                name = f"{tube} {seed} {slice_mm:g} mm"
                yield Case(name, "tubes", made.volume, facts, SEGMENTS, blunt_ends=_blunt_ends(made))


def _necks(num: int) -> Iterator[Case]:
    for seed in range(1, num + 1):
        for lean in ((0.0, 0.0), (15.0, 10.0)):
            for slice_mm in (THIN_MM, THICK_MM):
                spacing = _spacing(slice_mm)
                made = generate_phantom(seed=seed, spacing_mm=spacing, noise_hu=25.0, neck=True, lean_deg=lean)
                name = f"neck {seed} lean {lean[0]:g} {slice_mm:g} mm"
                facts = (Fact("larynx"),)
                yield Case(name, "necks", made.volume, facts, SEGMENTS, blunt_ends=_blunt_ends(made))


def _crops(num: int) -> Iterator[Case]:
    """Yield chests of which one lung, the apices or the bases are outside the scan."""
    for seed in range(1, num + 1):
        made = generate_phantom(seed=seed, spacing_mm=THIN_MM, noise_hu=25.0)
        carina = made.volume.to_ijk(np.zeros(3))
        i, _, k = (int(value) for value in np.rint(carina))
        # The right lung is at low i; the scan contains the first 25 mm of both main bronchi.
        parts = {
            "right lung": (slice(None), slice(None), slice(0, i + 25)),
            "left lung": (slice(None), slice(None), slice(i - 25, None)),
            "above the bases": (slice(k - 40, None), slice(None), slice(None)),
        }
        for name, box in parts.items():
            yield Case(f"crop {name} {seed}", "crops", _cut(made.volume, box), blunt_ends=_blunt_ends(made))


def _cut(volume: Volume, box: tuple[slice, slice, slice]) -> Volume:
    first = np.array([axis.start or 0 for axis in box])[::-1]
    lps_from_ijk = volume.lps_from_ijk.copy()
    lps_from_ijk[:3, 3] = volume.to_lps(first.astype(np.float64))
    return Volume(np.ascontiguousarray(volume.hu_zyx[box]), lps_from_ijk)


def _blunt_ends(made: Phantom) -> Points:
    """Return the ends (n, 3) of a phantom's airways, LPS mm."""
    return np.array([one["points"][-1] for one in made.truth["branches"] if not one["children"]])


def _branch(made: Phantom, name: str) -> dict[str, Any]:
    branch: dict[str, Any] = next(one for one in made.truth["branches"] if one["name"] == name)
    return branch
