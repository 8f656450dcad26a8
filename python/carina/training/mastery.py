"""Mastery of a task, judged over several attempts, and published reference values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from carina.display import one_line
from carina.training.score import Score
from carina.training.segments import SEGMENTS

MASTERY_TIME_S = 120.0
MASTERY_IN_A_ROW = 2
MASTERY_SOURCE = "Cold 2024, Respiration, 10.1159/000542045"
"""Source: mastery is two procedures with 18 segments, 18 progressions and less than 120 s each."""
ATTEMPTS_FOR_VERDICT = 6
NOT_AN_INSPECTION = "mastery is defined for the inspection of all segments"
"""Reason why an attempt at a task other than the inspection of all segments does not count."""
IN_A_ROW_RULE = "in a row: Carina's reading; the source states no order"
NOT_COMPARABLE = "measured with another system; not directly comparable"
VERDICT_SOURCE = "Konge 2011, Respiration 81:483"
"""Source: a single attempt supports no judgement; six give a generalisability coefficient above 0.80."""


@one_line
@dataclass(frozen=True, slots=True)
class ReferenceGroup:
    """Published values of one group, with their source."""

    group: str
    diagnostic_completeness: float
    structured_progress: float
    procedure_time_s: float
    mean_intersegmental_time_s: float
    source: str = "BronchoBot study on a phantom, Cold 2025"

    def to_json(self) -> dict[str, Any]:
        """Return the values as plain JSON types."""
        return {
            "group": self.group,
            "diagnostic_completeness": self.diagnostic_completeness,
            "structured_progress": self.structured_progress,
            "procedure_time_s": self.procedure_time_s,
            "mean_intersegmental_time_s": self.mean_intersegmental_time_s,
            "source": self.source,
            "remark": NOT_COMPARABLE,
        }


REFERENCE_GROUPS = (
    ReferenceGroup("novices (10)", 9, 2, 281, 32),
    ReferenceGroup("intermediates (10)", 15, 7, 251, 16),
    ReferenceGroup("experienced (10)", 16, 8, 190, 13),
    ReferenceGroup("autonomous robot", 18, 18, 124, 7),
)
"""Published values of groups in a study with an airway phantom, for comparison; they are not pass marks."""


@one_line
@dataclass(frozen=True, slots=True)
class Mastery:
    """Mastery over the attempts of one learner, in their order."""

    passed: tuple[bool, ...]
    """Whether each attempt fulfilled the definition of a mastery procedure and counts."""
    counted: tuple[bool, ...]
    """Whether each attempt counts towards mastery."""
    reasons: tuple[tuple[str, ...], ...]
    """Reasons why each attempt does not count."""
    basis: str = "over the recordings that you gave, in your order"
    """Text for the user that names the attempts on which the judgement is based."""

    @property
    def num_counted(self) -> int:
        """Number of attempts that count towards mastery."""
        return sum(self.counted)

    @property
    def two_in_a_row(self) -> bool:
        """Whether two successive attempts passed; an attempt that does not count interrupts the sequence."""
        starts = range(len(self.passed) - MASTERY_IN_A_ROW + 1)
        return any(all(self.passed[n : n + MASTERY_IN_A_ROW]) for n in starts)

    @property
    def verdict(self) -> bool | None:
        """Whether mastery was reached; None with fewer than six attempts that count."""
        return self.two_in_a_row if self.num_counted >= ATTEMPTS_FOR_VERDICT else None

    @property
    def words(self) -> str:
        """Verdict as a text for the user."""
        if self.verdict is None:
            return (
                f"no verdict: it needs {ATTEMPTS_FOR_VERDICT} attempts that count ({VERDICT_SOURCE}); "
                f"found {self.num_counted}"
            )
        reached = "reached" if self.verdict else "not reached"
        return f"mastery {reached} {self.basis} ({MASTERY_SOURCE})"

    def to_json(self) -> dict[str, Any]:
        """Return the verdict as plain JSON types."""
        return {
            "verdict": self.verdict,
            "words": self.words,
            "num_attempts": len(self.passed),
            "num_counted": self.num_counted,
            "attempts_needed": ATTEMPTS_FOR_VERDICT,
            "passed": list(self.passed),
            "reasons": [list(one) for one in self.reasons],
            "two_in_a_row": self.two_in_a_row,
            "definition": (
                f"{MASTERY_IN_A_ROW} procedures with {len(SEGMENTS)} segments, {len(SEGMENTS)} progressions "
                f"and less than {MASTERY_TIME_S:.0f} s each"
            ),
            "added_rule": IN_A_ROW_RULE,
            "sources": [MASTERY_SOURCE, VERDICT_SOURCE],
        }


def judge_mastery(scores: Sequence[Score]) -> Mastery:
    """Judge mastery over the attempts of one learner.

    An attempt does not count if its score has doubts, if no segment was seen or the tip did not move, if its task is
    not an inspection of all segments under the standard conditions, if the case lacks one of the 18 segments, or if
    its poses repeat those of an earlier attempt (a replay, at any speed). The standard conditions are Carina's: the
    clock starts below the cords, a return breaks the sequence, no hints, an instrument instead of a free camera, and no
    simulated breathing.

    Parameters
    ----------
    scores
        Scores in the order of the attempts.
    """
    passed, counted, reasons = [], [], []
    for number, score in enumerate(scores):
        why = [one.words for one in score.doubts]
        if score.task.kind != "inspect":
            why.append(NOT_AN_INSPECTION)
        why += [f"the conditions differ: {one}" for one in _other_conditions(score)]
        if score.diagnostic_completeness < 1:
            why.append("no segment was seen")
        if score.path_length_mm <= 0.0 or score.procedure_time_s <= 0.0:
            why.append("the tip did not move")
        if score.num_case_segments < len(SEGMENTS):
            why.append(f"the case has {score.num_case_segments} of {len(SEGMENTS)} segments")
        same = next((n for n in range(number) if score.frames.repeats(scores[n].frames)), None)
        if same is not None:
            why.append(f"the poses repeat those of attempt {same + 1}: a replay of its recording")
        reasons.append(tuple(why))
        counted.append(not why)
        passed.append(not why and is_mastery_procedure(score))
    return Mastery(tuple(passed), tuple(counted), tuple(reasons))


def _other_conditions(score: Score) -> list[str]:
    """Return the conditions of an attempt that differ from the standard conditions, as texts for the user."""
    task, frames = score.task, score.frames
    used = {frames.optics[number].is_free_camera for number in set(frames.optics_number.tolist())}
    differing = {
        "the clock starts at the main carina, not below the cords": task.clock != "cords",
        "a return to a segment is ignored": task.revisit_rule != "breaks",
        f"the task gives hints ({', '.join(task.hints)})": bool(task.hints),
        "the flight used a camera without an instrument": True in used,
        "the patient breathed (simulated breathing)": any(one is not None for _, one in frames.motions),
    }
    return [text for text, differs in differing.items() if differs]


def is_mastery_procedure(score: Score) -> bool:
    """Return whether a score has 18 segments, 18 progressions and less than 120 s."""
    return (
        score.diagnostic_completeness == len(SEGMENTS)
        and score.structured_progress == len(SEGMENTS)
        and score.procedure_time_s < MASTERY_TIME_S
    )
