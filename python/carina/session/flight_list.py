"""The recorded flights of a case as they are shown."""

from __future__ import annotations

from carina.session.case import OpenCase
from carina.session.snapshot import FlightInfo, SavingInfo

__all__ = ["flight_list"]

MAX_SHOWN_CHARS = 4000
"""Of a name or a description that another program wrote."""


def flight_list(case: OpenCase, saving: SavingInfo) -> tuple[FlightInfo, ...]:
    """In their order; with the session locked."""
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
