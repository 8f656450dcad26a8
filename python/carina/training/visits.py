"""Seen and visited segments of a flight, and the published counts from the order of the visits.

docs/training.md defines the terms; the durations are definitions of Carina, not pass marks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.training.flight_frames import FRAME_HZ
from carina.training.openings_in_sight import OpeningSights
from carina.training.task import RevisitRule

SEEN_S = 0.5
"""Time in s for which an opening must be in sight without interruption to count as seen."""
VISIT_S = 1.0
"""Time in s for which an opening must stay in the middle of the picture without interruption to count as visited."""
MIDDLE = 0.5
"""Maximum distance from the middle of the picture, in radii of the picture, at which an opening is in the middle."""


@one_line
@dataclass(frozen=True, slots=True)
class Visit:
    """Visit of a segment or another listed branch (a *place*): frame at which the visit counts, and its index."""

    frame: int
    place: int
    entered: bool = False
    """Whether the tip entered the place; otherwise its opening was held in the middle of the picture."""


def frames_of(seconds: float) -> int:
    """Return the number of consecutive frames of a flight that span a time in s."""
    return math.ceil(seconds * FRAME_HZ - 1e-6) + 1


def first_run(flags: NDArray[np.bool_], seconds: float) -> int | None:
    """Return the first frame up to which flags have been true for a time without a break; None if there is none."""
    ends = run_ends(flags.astype(np.int64), seconds)
    return next((frame for frame, value in ends if value == 1), None)


def run_ends(values: NDArray[np.int64], seconds: float) -> list[tuple[int, int]]:
    """Return for each run of equal values the frame at which the run has lasted for a time, and the value.

    Runs that are shorter are left out.
    """
    need = frames_of(seconds)
    starts = np.flatnonzero(np.diff(values, prepend=values[:1] - 1) != 0)
    lengths = np.diff(starts, append=len(values))
    return [
        (int(start) + need - 1, int(values[start]))
        for start, length in zip(starts, lengths, strict=True)
        if length >= need
    ]


def places_seen(
    sights: OpeningSights, places: Sequence[Sequence[int]], entered: Sequence[int | None] = ()
) -> list[int | None]:
    """Return for each place the frame at which all its openings have been seen, or None.

    Parameters
    ----------
    sights
        Openings in the frames of a flight.
    places
        Indices of the openings of each place; nearly always one.
    entered
        Frame at which each opening is seen from inside (`carina.training.segment_entries.openings_entered`), or None.
    """
    found: list[int | None] = []
    for openings in places:
        frames = [
            [first_run(sights.in_sight[:, k], SEEN_S), entered[k] if k < len(entered) else None] for k in openings
        ]
        known = [min(at for at in pair if at is not None) for pair in frames if pair != [None, None]]
        found.append(max(known) if len(known) == len(frames) else None)
    return found


def place_in_middle(sights: OpeningSights, places: Sequence[Sequence[int]]) -> NDArray[np.int64]:
    """Return (n,) index of the place whose opening is nearest to the middle of the picture, or -1.

    Only openings in sight within :data:`MIDDLE` count; of equally near openings the first one counts.
    """
    if not places:
        return np.full(len(sights.in_sight), -1)
    off = np.stack([sights.off_middle[:, list(openings)].min(axis=1) for openings in places], axis=1)
    best = np.argmin(off, axis=1)
    return np.where(off[np.arange(len(off)), best] <= MIDDLE, best, -1)


def visits_of(sights: OpeningSights, places: Sequence[Sequence[int]], entries: Sequence[Visit] = ()) -> list[Visit]:
    """Return the visits of places in their order; consecutive visits of one place are one visit.

    Parameters
    ----------
    sights
        Openings in the frames of a flight.
    places
        Indices of the openings of each place.
    entries
        Entries of the tip into places (`carina.training.segment_entries.entries_of`), which are visits too.
    """
    held = [Visit(frame, place) for frame, place in run_ends(place_in_middle(sights, places), VISIT_S) if place >= 0]
    visits: list[Visit] = []
    for visit in sorted([*entries, *held], key=lambda one: one.frame):
        if not (visits and visits[-1].place == visit.place):
            visits.append(visit)
    return visits


def revisits_of(visits: Sequence[Visit]) -> list[Visit]:
    """Return those visits whose place was visited before."""
    known: set[int] = set()
    found = []
    for visit in visits:
        if visit.place in known:
            found.append(visit)
        known.add(visit.place)
    return found


def progress_steps(visits: Sequence[Visit], rule: RevisitRule) -> list[Visit]:
    """Return the visits that count for structured progress.

    A visit counts if it is the next place in ascending order after the visit before; the first place counts as the
    next after the start, since the published scale has 18 steps for 18 segments. Each place counts once.

    Parameters
    ----------
    visits
        Visits in their order; the index of a place is its position in the ascending order of the case.
    rule
        No publication states whether a revisit breaks the sequence. ``breaks``: the visit before must be that of the
        previous place, whether or not it was visited earlier. ``ignored``: revisits are removed first.

    Examples
    --------
    The places 0, 1, 0, 2: the step to 2 counts only if the revisit of 0 is ignored.

    >>> flown = [Visit(frame, place) for frame, place in enumerate((0, 1, 0, 2))]
    >>> [visit.place for visit in progress_steps(flown, "breaks")]
    [0, 1]
    >>> [visit.place for visit in progress_steps(flown, "ignored")]
    [0, 1, 2]
    """
    if rule == "ignored":
        again = {visit.frame for visit in revisits_of(visits)}
        visits = [visit for visit in visits if visit.frame not in again]
    before, counted = -1, set()
    found = []
    for visit in visits:
        if visit.place == before + 1 and visit.place not in counted:
            counted.add(visit.place)
            found.append(visit)
        before = visit.place
    return found
