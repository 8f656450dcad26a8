"""The recorded flights of a case whose disk refuses, for a file elsewhere."""

from __future__ import annotations

import logging
import sqlite3
import threading
from collections.abc import Sequence

from carina.case.recordings import RecordingFacts, RecordingWriter, WholeRecording
from carina.errors import CarinaError
from carina.session.kept_files import KeptFile

__all__ = ["flight_count", "whole_flights"]

logger = logging.getLogger(__name__)


def flight_count(number: int) -> str:
    """For a message."""
    return "1 recorded flight" if number == 1 else f"{number} recorded flights"


def whole_flights(
    file: KeptFile | None, listed: Sequence[RecordingFacts], writers: Sequence[RecordingWriter], within_s: float
) -> tuple[tuple[WholeRecording, ...], int]:
    """Those whose lines are in memory, or can be read within a time, and how many are not among them.

    A full disk, or one that cannot be written, can still be read; one that is silent cannot, and is not waited for.
    """
    found: dict[int, WholeRecording] = {}
    by_number = {writer.number: writer for writer in writers}
    # Nothing of these is in the file: what is only in memory waits for no disk, wherever it stands in the list.
    for facts in listed:
        writer = by_number.get(facts.recording_id)
        num_kept, waiting = (1, "") if writer is None else writer.waiting()
        if num_kept == 0:
            found[facts.recording_id] = WholeRecording(facts, waiting)
    to_read = [one for one in listed if one.recording_id not in found]
    is_late = threading.Event()

    def read() -> None:
        for facts in to_read:
            if is_late.is_set():
                return
            try:
                text = _text(file, facts.recording_id, by_number.get(facts.recording_id))
            except (CarinaError, OSError, sqlite3.Error) as trouble:
                logger.warning("a recorded flight cannot be read: %s", type(trouble).__name__)
            else:
                found[facts.recording_id] = WholeRecording(facts, text)

    reading = threading.Thread(target=read, name="carina-reading-flights", daemon=True)
    reading.start()
    reading.join(within_s)
    is_late.set()
    in_time = dict(found)
    return tuple(in_time[one.recording_id] for one in listed if one.recording_id in in_time), len(listed) - len(in_time)


def _text(file: KeptFile | None, number: int, writer: RecordingWriter | None) -> str:
    """All lines that there are: those in the file, then those that are not yet."""
    while True:
        num_kept, waiting = (1, "") if writer is None else writer.waiting()
        if num_kept == 0:
            return waiting
        if file is None:
            raise CarinaError("its file is not there", code="case.not-saved")
        kept = file.recording_text(number)
        # Else the disk has taken some of it meanwhile: all of a call of `CaseFile.keep_recording` or none, by its lock.
        if writer is None or writer.waiting()[0] == num_kept:
            return kept + waiting
