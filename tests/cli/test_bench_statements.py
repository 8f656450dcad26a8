"""Tests of how ``carina bench track --only statements`` judges statements about disease."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from carina_bench.track_statements import (
    Case,
    Counts,
    Fact,
    Statement,
    fact_of,
    is_at_blunt_end,
    is_passed,
    judge,
    statements_of,
)

FAR = 30.0
LINE = np.stack([np.zeros(41), np.zeros(41), -np.arange(41.0)], axis=1)
"""Centreline (41, 3) of an airway of 40 mm that leads down from the origin, LPS mm."""


def statement(kind: str, *lps: float, lobe: str | None = None) -> Statement:
    return Statement(kind, np.array(lps) if lps else None, f"{kind} here", lobe)


def result(*, uncertain=(), absent=(), badges=(), names=()) -> SimpleNamespace:
    """Return a replacement of a search result with the attributes that ``judge`` reads."""
    tree = SimpleNamespace(branches=[SimpleNamespace(name=name) for name in names])
    return SimpleNamespace(uncertain=uncertain, absent=absent, badges=badges, tree=tree)


def place(kind: str, lps: tuple[float, float, float], length_mm: float | None = 5.0) -> SimpleNamespace:
    return SimpleNamespace(kind=kind, lps=lps, reason=f"{kind} here", length_mm=length_mm)


def absence(name: str, kind: str, lps: tuple[float, float, float] | None = None) -> SimpleNamespace:
    return SimpleNamespace(name=name, kind=kind, lps=lps, words=f"{name}: {kind}")


@pytest.mark.parametrize(
    ("stated", "fact", "is_true"),
    [
        (statement("filled", 0, 0, -20), Fact("filled", LINE), True),
        (statement("filled", FAR, 0, -20), Fact("filled", LINE), False),
        (statement("stump", 0, 0, -20), Fact("filled", LINE), True),
        (statement("filled", 0, 0, -20), Fact("tube"), False),
        (statement("tube"), Fact("tube"), True),
        (statement("larynx"), Fact("tube"), False),
        (statement("stump", FAR, 0, 0, lobe="RML"), Fact("stump", LINE, "RML"), True),
        (statement("stump", FAR, 0, 0, lobe="RLL"), Fact("stump", LINE, "RML"), False),
        (statement("stump", lobe="RLL"), Fact("stump", LINE, "RML"), False),
    ],
)
def test_statement_counts_as_true_if_the_truth_has_its_finding_at_its_position_or_in_its_lobe(stated, fact, is_true):
    assert (fact_of(stated, [fact]) is fact) is is_true


def test_stated_obstruction_in_a_real_ct_is_false_if_a_listed_airway_continues_beyond_it():
    assert is_passed(statement("filled", 1, 0, -20), [LINE])
    assert not is_passed(statement("filled", 1, 0, -38), [LINE]), "2 mm of the airway are left"
    assert not is_passed(statement("filled", FAR, 0, -20), [LINE]), "the airway is elsewhere"
    assert not is_passed(statement("filled"), [LINE]), "the statement has no position"


def test_only_a_stump_without_a_lobe_counts_as_correct_at_a_blunt_end_of_the_phantom():
    ends = LINE[-1:]
    assert is_at_blunt_end(statement("stump", 0, 0, -40), ends)
    assert not is_at_blunt_end(statement("stump", 0, 0, -30), ends)
    assert not is_at_blunt_end(statement("filled", 0, 0, -40), ends)
    assert not is_at_blunt_end(statement("stump", 0, 0, -40, lobe="RML"), ends)
    assert not is_at_blunt_end(statement("stump", 0, 0, -40), None)


def test_lost_airways_and_blocked_airways_of_unknown_length_are_not_scored_as_statements():
    airways = result(
        uncertain=(place("lost", (0, 0, 0)), place("blocked", (0, 0, 0), None), place("blocked", (0, 0, 0))),
        absent=(absence("RB4", "lost"), absence("RML", "resected")),
        badges=(SimpleNamespace(code="track.larynx", words="larynx"), SimpleNamespace(code="track.leak", words="leak")),
    )
    assert [one.kind for one in statements_of(airways)] == ["filled", "stump", "larynx"]


def test_true_false_and_missing_statements_are_counted():
    reported: list[str] = []
    counts = Counts()
    case = Case("case", "part", None, (Fact("filled", LINE), Fact("tube")))
    judge(case, result(uncertain=(place("filled", (0, 0, -20)), place("filled", (FAR, 0, 0)))), counts, reported.append)
    assert (counts.num_true, counts.num_false, counts.num_unknown) == (1, 1, 0)
    assert counts.named == {"filled": 1, "tube": 0} and counts.facts == {"filled": 1, "tube": 1}
    assert reported == ["  false: filled here", "  not stated: tube "]


def test_statement_about_a_real_ct_is_listed_for_review_unless_a_listed_airway_contradicts_it():
    counts = Counts()
    case = Case("case", "real", None, listed=(LINE,))
    judge(case, result(uncertain=(place("filled", (0, 0, -20)), place("filled", (FAR, 0, 0)))), counts, lambda _: None)
    assert (counts.num_true, counts.num_false, counts.num_unknown) == (0, 1, 1)


def test_missed_segment_counts_as_reported_if_it_or_its_lobe_is_listed_as_absent():
    reported: list[str] = []
    counts = Counts()
    case = Case("case", "part", None, segments=("RB1", "RB3", "RB4", "RB6", "LB1+2"))
    airways = result(names=("RB1+3", None), absent=(absence("RML", "lost"), absence("LB1+2", "nothing")))
    judge(case, airways, counts, reported.append)
    assert (counts.num_missed, counts.num_unreported) == (3, 1)
    assert reported == ["  missed without a word: RB6"]
