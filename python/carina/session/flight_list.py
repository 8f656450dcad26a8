"""The recorded flights of a case in the form that windows show."""

from __future__ import annotations

from carina.session.case import OpenCase
from carina.session.snapshot import FlightInfo, SavingInfo

__all__ = ["flight_list"]

MAX_SHOWN_CHARS = 4000
"""Largest shown length of a name or a description, which another program may have written."""


def flight_list(case: OpenCase, saving: SavingInfo) -> tuple[FlightInfo, ...]:
    """Return the recorded flights in their order; the caller holds the session's lock."""
    running = {recording.number for recording in case.flights.unwritten if not recording.closed}
    return tuple(
        FlightInfo(
            number=one.recording_id,
            name=one.name[:MAX_SHOWN_CHARS],
            words=one.words[:MAX_SHOWN_CHARS],
            begun_s=None if saving.begun_s is None else saving.begun_s + one.begun_s,
            length_s=one.length_s,
            state="recording" if one.recording_id in running else "complete" if one.complete else "cut-off",
        )
        for one in case.flights.listed
    )
