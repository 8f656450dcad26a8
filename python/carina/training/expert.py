"""Comparison of a flight with an expert's flight: both are aligned by place in the airways, not by time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.argument_checks import check_arguments, instance
from carina.display import one_line
from carina.errors import NoResultError
from carina.track import AirwayTree
from carina.training.flight_frames import FRAME_HZ
from carina.training.handling import CentrelineIndex
from carina.training.score import Score

ALIGN_MM = 2.0
"""Maximum distance in mm along a branch between the tips of two flights that count as at one place."""
PATH_STEP_MM = 0.5
"""Distance in mm between the points of the expert's path from which the deviation is measured."""
MAX_PATH_POINTS = 40_000
VARIANCE_FRAMES = 11
"""Number of frames (1 s) over which the local variance of the deviation is computed."""
HIGH_ERROR_MM = 5.0
"""Deviation in mm above which a frame belongs to a high-error event; a limit of Carina, as no limit is published."""
HIGH_ERROR_FRAMES = 5
"""Least number of frames (0.5 s) from the first to the last frame of a high-error event; a limit of Carina."""
HIGH_ERROR_GAP_FRAMES = 5
"""Number of frames (0.5 s) without a high deviation that separate two high-error events; a limit of Carina."""


@one_line
@dataclass(frozen=True, slots=True)
class BranchStay:
    """Times that the learner's and the expert's flight spend in a branch."""

    name: str
    own_s: float
    expert_s: float


@one_line
@dataclass(frozen=True, slots=True)
class HighErrorEvent:
    """Period of at least 0.5 s in which the tip is more than 5 mm from the expert's tip at the same place.

    Periods less than 0.5 s apart are one event. The definition is Carina's; no threshold is published.
    """

    start_s: float
    """Time in s, from the start of the recording of the compared flight, at which the event begins."""
    duration_s: float
    worst_mm: float
    """Largest distance in mm of the tip from the expert's tip at the same place during the event."""
    worst_s: float
    """Time in s, from the start of the recording of the compared flight, at which ``worst_mm`` occurs."""
    branch: str
    """Branch in which ``worst_mm`` occurs."""

    def to_json(self) -> dict[str, Any]:
        """Return the event as plain JSON types."""
        return {
            "start_s": self.start_s,
            "duration_s": self.duration_s,
            "worst_mm": self.worst_mm,
            "worst_s": self.worst_s,
            "branch": self.branch,
        }


@one_line
@dataclass(frozen=True, slots=True)
class FlightComparison:
    """Differences of a flight from an expert's flight; measures without a published threshold."""

    own_time_s: float
    """Procedure time of the compared flight, s."""
    expert_time_s: float
    longest_stay: BranchStay | None
    """Branch with the largest excess of time over the expert's; None if no branch has an excess."""
    compared_share: float
    """Share, 0 to 1, of the frames of the procedure time in which the tip is at a place where the expert's tip was.

    The deviation is defined only in these frames.
    """
    deviation_mm: float | None
    """Mean distance in mm of the tip from the expert's tip at the same position in the airways; None without one."""
    deviation_variance_mm2: float | None
    """Mean variance of the distance between the tips of the two flights within one second, mm²."""
    worst_mm: float | None
    """Largest distance in mm of the tip of the compared flight from the path of the expert's tip, at the same place."""
    worst_branch: str | None
    worst_s: float | None
    """Time in s, from the start of the recording of the compared flight, at which ``worst_mm`` occurs."""
    high_error_events: tuple[HighErrorEvent, ...]
    """Periods with a high deviation, in the order of time; empty without a deviation."""
    num_contacts: int
    expert_contacts: int
    touched_only_own: tuple[str, ...]
    """Branches in which only the compared flight touched the wall."""
    entered_only_own: tuple[str, ...] = field(repr=False)
    """Branches that only the compared flight entered."""
    entered_only_expert: tuple[str, ...] = field(repr=False)

    @property
    def num_high_error_events(self) -> int | None:
        """Number of high-error events; None without a deviation."""
        return None if self.deviation_mm is None else len(self.high_error_events)

    def lines(self) -> tuple[str, ...]:
        """Return the differences as texts for the user, with their places."""
        found = [f"time: {self.own_time_s:.0f} s, expert {self.expert_time_s:.0f} s"]
        stay = self.longest_stay
        if stay is not None:
            found.append(
                f"longest stay beyond the expert's: {stay.own_s - stay.expert_s:.1f} s in {stay.name} "
                f"({stay.own_s:.1f} s, expert {stay.expert_s:.1f} s)"
            )
        if self.deviation_mm is None:
            found.append("deviation: not known, since the expert was at none of these places")
        else:
            found.append(
                f"deviation from the expert's path: mean {self.deviation_mm:.1f} mm, largest {self.worst_mm:.1f} mm in "
                f"{self.worst_branch} after {self.worst_s:.1f} s; compared over {100.0 * self.compared_share:.0f} % of "
                f"the time{self._variance_text()}"
            )
            found.append(self._high_error_text())
        touches = f"wall contacts: {self.num_contacts}, expert {self.expert_contacts}"
        if self.touched_only_own:
            touches += f"; the expert did not touch the wall in {', '.join(self.touched_only_own)}"
        found.append(touches)
        if self.entered_only_own:
            found.append(f"the expert did not enter {', '.join(self.entered_only_own)}")
        if self.entered_only_expert:
            found.append(f"only the expert entered {', '.join(self.entered_only_expert)}")
        return tuple(found)

    def _variance_text(self) -> str:
        variance = self.deviation_variance_mm2
        return "" if variance is None else f"; local variance {variance:.2f} mm²"

    def _high_error_text(self) -> str:
        events = self.high_error_events
        least_s = HIGH_ERROR_FRAMES / FRAME_HZ
        text = f"high-error events (over {HIGH_ERROR_MM:g} mm for {least_s:g} s or longer): {len(events)}"
        if events:
            longest = max(events, key=lambda one: one.duration_s)
            text += (
                f"; longest {longest.duration_s:.1f} s after {longest.start_s:.1f} s, up to {longest.worst_mm:.1f} mm "
                f"in {longest.branch}"
            )
        return text

    def to_json(self) -> dict[str, Any]:
        """Return the comparison as plain JSON types."""
        stay = self.longest_stay
        return {
            "own_time_s": self.own_time_s,
            "expert_time_s": self.expert_time_s,
            "longest_stay": None
            if stay is None
            else {"branch": stay.name, "own_s": stay.own_s, "expert_s": stay.expert_s},
            "compared_share": self.compared_share,
            "deviation_mm": self.deviation_mm,
            "deviation_variance_mm2": self.deviation_variance_mm2,
            "worst_mm": self.worst_mm,
            "worst_branch": self.worst_branch,
            "worst_s": self.worst_s,
            "num_high_error_events": self.num_high_error_events,
            "high_error_events": [one.to_json() for one in self.high_error_events],
            "num_contacts": self.num_contacts,
            "expert_contacts": self.expert_contacts,
            "touched_only_own": list(self.touched_only_own),
            "entered_only_own": list(self.entered_only_own),
            "entered_only_expert": list(self.entered_only_expert),
        }


@dataclass(frozen=True, slots=True)
class _Places:
    """Branch, position along it and tip at each frame of a score's procedure time."""

    ids: NDArray[np.int64]
    along: NDArray[np.float64]
    tips: NDArray[np.float64]


@check_arguments(
    tree=instance(AirwayTree, "get one from carina.find_airways"),
    own=instance(Score, "get one from carina.score_recording"),
    expert=instance(Score, "get one from carina.score_recording"),
)
def compare_flights(tree: AirwayTree, own: Score, expert: Score) -> FlightComparison:
    """Compare a flight with an expert's flight in the same airways.

    A place is a branch and a position along its centreline. Of several passes of the expert the one nearest to the
    tip counts, and only positions within 2 mm along the branch are compared.

    Parameters
    ----------
    tree
        Airways of the case.
    own, expert
        Scores of both flights for the same task.

    Returns
    -------
    FlightComparison
        The differences.

    Raises
    ------
    NoResultError
        ``training.expert``: if both flights are scored for different tasks.
    """
    if own.task.name != expert.task.name:
        raise NoResultError(
            f"compare: expected two flights of one task; found {own.task.name} and {expert.task.name}; score the "
            "expert's flight for the same task",
            code="training.expert",
        )
    index = CentrelineIndex(tree)
    ours, theirs = _places_of(index, own), _places_of(index, expert)
    names = {branch.id: branch.name or f"branch {branch.id}" for branch in tree.branches}
    deviations = _deviations(ours, _places_on(index, _path_of(theirs.tips)))
    known = np.flatnonzero(np.isfinite(deviations))
    worst = int(known[np.argmax(deviations[known])]) if len(known) else None
    touched = {one.branch for one in expert.contacts}
    in_own, in_expert = ({names[int(one)] for one in set(part.ids.tolist())} for part in (ours, theirs))
    return FlightComparison(
        own_time_s=own.procedure_time_s,
        expert_time_s=expert.procedure_time_s,
        longest_stay=_longest_stay(ours, theirs, names),
        compared_share=len(known) / len(deviations),
        deviation_mm=float(deviations[known].mean()) if len(known) else None,
        deviation_variance_mm2=_local_variance(deviations),
        worst_mm=None if worst is None else float(deviations[worst]),
        worst_branch=None if worst is None else names[int(ours.ids[worst])],
        worst_s=None if worst is None else own.clock_start_s + worst / FRAME_HZ,
        high_error_events=tuple(
            HighErrorEvent(
                start_s=own.clock_start_s + first / FRAME_HZ,
                duration_s=(last - first + 1) / FRAME_HZ,
                worst_mm=float(deviations[at]),
                worst_s=own.clock_start_s + at / FRAME_HZ,
                branch=names[int(ours.ids[at])],
            )
            for first, last, at in _high_error_periods(deviations)
        ),
        num_contacts=len(own.contacts),
        expert_contacts=len(expert.contacts),
        touched_only_own=tuple(dict.fromkeys(one.branch for one in own.contacts if one.branch not in touched)),
        entered_only_own=tuple(sorted(in_own - in_expert)),
        entered_only_expert=tuple(sorted(in_expert - in_own)),
    )


def _places_of(index: CentrelineIndex, score: Score) -> _Places:
    first, last = (round(at_s * FRAME_HZ) for at_s in (score.clock_start_s, score.clock_end_s))
    return _places_on(index, score.frames.lps_from_tip[first : last + 1, :3, 3])


def _places_on(index: CentrelineIndex, tips: NDArray[np.float64]) -> _Places:
    return _Places(*index.locate(tips), tips)


def _path_of(tips: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points (n, 3) on the path through tips, at most :data:`PATH_STEP_MM` apart, without repeated tips."""
    run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(tips, axis=0), axis=1))])
    at = np.linspace(0.0, run[-1], min(max(2, int(np.ceil(run[-1] / PATH_STEP_MM)) + 1), MAX_PATH_POINTS))
    at = np.union1d(at, run)
    return np.stack([np.interp(at, run, tips[:, axis]) for axis in range(3)], axis=1)


def _deviations(own: _Places, expert: _Places) -> NDArray[np.float64]:
    """Return the distance (n,) of the tip from the expert's at the same position; NaN where the expert was not."""
    found = np.full(len(own.ids), np.nan)
    for branch_id in np.unique(own.ids):
        mine, theirs = np.flatnonzero(own.ids == branch_id), np.flatnonzero(expert.ids == branch_id)
        if not len(theirs):
            continue
        for start in range(0, len(mine), 256):
            part = mine[start : start + 256]
            off = np.linalg.norm(own.tips[part, None] - expert.tips[theirs], axis=2)
            off[np.abs(own.along[part, None] - expert.along[theirs]) > ALIGN_MM] = np.inf
            nearest = off.min(axis=1)
            found[part] = np.where(np.isfinite(nearest), nearest, np.nan)
    return found


def _local_variance(deviations: NDArray[np.float64]) -> float | None:
    """Return the mean variance of the deviation within windows of one second; None without a complete window."""
    if len(deviations) < VARIANCE_FRAMES:
        return None
    windows = np.lib.stride_tricks.sliding_window_view(deviations, VARIANCE_FRAMES)
    complete = windows[np.isfinite(windows).all(axis=1)]
    return float(complete.var(axis=1).mean()) if len(complete) else None


def _high_error_periods(deviations: NDArray[np.float64]) -> list[tuple[int, int, int]]:
    """Return the first, the last and the worst frame of each high-error event.

    A frame without a deviation (NaN) has no high deviation. Periods are joined before their length is tested, so that
    a short return below the limit does not hide an event.
    """
    high = np.flatnonzero(deviations > HIGH_ERROR_MM)
    found = []
    for frames in np.split(high, np.flatnonzero(np.diff(high) > HIGH_ERROR_GAP_FRAMES) + 1):
        if len(frames) and frames[-1] - frames[0] + 1 >= HIGH_ERROR_FRAMES:
            found.append((int(frames[0]), int(frames[-1]), int(frames[np.argmax(deviations[frames])])))
    return found


def _longest_stay(own: _Places, expert: _Places, names: dict[int, str]) -> BranchStay | None:
    """Return the branch with the largest excess of time over the expert's; pieces of a bronchus have one name."""
    times: dict[str, list[float]] = {}
    for n, places in enumerate((own, expert)):
        ids, counts = np.unique(places.ids, return_counts=True)
        for branch_id, count in zip(ids.tolist(), counts.tolist(), strict=True):
            times.setdefault(names[branch_id], [0.0, 0.0])[n] += count / FRAME_HZ
    name, (own_s, expert_s) = max(times.items(), key=lambda one: one[1][0] - one[1][1])
    return BranchStay(name, own_s, expert_s) if own_s > expert_s else None
