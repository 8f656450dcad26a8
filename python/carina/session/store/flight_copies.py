"""Recorded flights of a case whose disk refuses writes, collected for a file on another disk."""

from __future__ import annotations

import logging
import sqlite3
import threading
from collections.abc import Sequence

from carina.case.recordings import RecordingFacts, RecordingWriter, WholeRecording
from carina.errors import CarinaError
from carina.session.store.interfaces import StoredCaseFile

logger = logging.getLogger(__name__)


def flight_count(number: int) -> str:
    """Return the number of recorded flights as words for a message."""
    return "1 recorded flight" if number == 1 else f"{number} recorded flights"


def whole_flights(
    file: StoredCaseFile | None, listed: Sequence[RecordingFacts], writers: Sequence[RecordingWriter], within_s: float
) -> tuple[tuple[WholeRecording, ...], int]:
    """Collect the flights that are in memory or can be read within a time limit.

    A full or read-only disk can still be read. A disk that does not respond cannot; the call returns after the limit.

    Parameters
    ----------
    file
        The live file; None if there is none.
    listed
        The flights of the case.
    writers
        Recordings that are not yet completely in the file.
    within_s
        Time limit for reading, in s.

    Returns
    -------
    tuple
        The collected flights in the order of the list, and the number of flights that are missing.
    """
    found: dict[int, WholeRecording] = {}
    by_number = {writer.number: writer for writer in writers}
    # Flights that are only in memory come first, because they need no disk.
    for facts in listed:
        writer = by_number.get(facts.recording_id)
        num_stored, unsaved_part = (1, "") if writer is None else writer.unsaved_part()
        if num_stored == 0:
            found[facts.recording_id] = WholeRecording(facts, unsaved_part)
    to_read = [one for one in listed if one.recording_id not in found]
    is_late = threading.Event()

    def read() -> None:
        for facts in to_read:
            if is_late.is_set():
                return
            try:
                text = _flight_text(file, facts.recording_id, by_number.get(facts.recording_id))
            except (CarinaError, OSError, sqlite3.Error) as error:
                logger.warning("a recorded flight cannot be read: %s", type(error).__name__)
            else:
                found[facts.recording_id] = WholeRecording(facts, text)

    reading = threading.Thread(target=read, name="carina-reading-flights", daemon=True)
    reading.start()
    reading.join(within_s)
    is_late.set()
    in_time = dict(found)
    return tuple(in_time[one.recording_id] for one in listed if one.recording_id in in_time), len(listed) - len(in_time)


def _flight_text(file: StoredCaseFile | None, number: int, writer: RecordingWriter | None) -> str:
    """Return all lines of a flight: those in the file, followed by those that are only in memory."""
    while True:
        num_stored, unsaved_part = (1, "") if writer is None else writer.unsaved_part()
        if num_stored == 0:
            return unsaved_part
        if file is None:
            raise CarinaError("its file is not there", code="case.not-saved")
        text = file.recording_text(number)
        # The count differs if the file has grown meanwhile; `CaseFile.keep_recording` adds all or none of them.
        if writer is None or writer.unsaved_part()[0] == num_stored:
            return text + unsaved_part
