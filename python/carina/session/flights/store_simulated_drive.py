"""Storage of the simulated drive of a scope verdict as a flight of the case."""

from __future__ import annotations

from typing import TextIO, cast

import numpy as np

from carina import commands as c
from carina.case.recordings import RecordingFacts, WholeRecording
from carina.errors import NoResultError
from carina.navigate import Navigator, Pilot, Recorder, case_key
from carina.plan import Verdict, drive_flight
from carina.session.command_registry import CommandHandlers, answers, does
from carina.session.flights.recording import new_flight
from carina.session.flights.tip_commands import place_pose, view_words
from carina.session.open_case.open_case import LoadedFlight, OpenCase
from carina.session.state.snapshot import UserMessage
from carina.version import VERSION

MAX_NAME = 200


class VerdictDriveHandlers(CommandHandlers):
    """Commands that store the simulated drive of a verdict as a flight: a recording whose moves place the tip."""

    @does(c.KeepDrive)
    def keep(self, command: c.KeepDrive) -> None:
        """Add the drive of an instrument's verdict to the flights of the case; the tip does not move.

        The flight of a case without a file stays in memory until the case is saved.

        Raises
        ------
        NoResultError
            ``plan.no-verdict``: if the instrument has no verdict yet, or its drive was not simulated.
        """
        case = self.core.needed_case()
        with self.core.lock:
            verdict = _verdict_with_drive(case, command.scope)
        assert verdict.driven is not None
        times_s, poses = drive_flight(verdict.driven)
        # Recordings round times to 1 us, and an unrounded time could exceed the rounded length.
        times_s = np.round(times_s, 6)
        key = case_key(case.info.volume)
        with self.core.lock:
            document = case.document
            target = next(
                (t for t in document.targets if document.route is not None and t.target_id == document.route.target_id),
                None,
            )
            name, into = new_flight(case, self.core.clock())
            to = "" if target is None else f" to {target.name}"
            name = into.name = f"Simulated drive{to}, {verdict.scope.title}"[:MAX_NAME]
            pilot = Pilot(Navigator(poses[0], volume=case.info.volume))
            view = {**view_words(document, case.sight), "scope": verdict.scope.name}
            recorder = Recorder(pilot, cast(TextIO, into), case=key, carina=VERSION, now_s=0.0, view=view)
            for time_s, pose in zip(times_s.tolist(), poses, strict=True):
                recorder.tick(time_s)
                pilot.apply(place_pose(pose))
            recorder.close()
            assert into.number is not None
            words = verdict.words[:1].upper() + verdict.words[1:]
            facts = RecordingFacts(into.number, name, words, into.begun_s, round(recorder.length_s, 6), complete=True)
            case.flights.unwritten = (*case.flights.unwritten, into)
            case.flights.listed = (*case.flights.listed, facts)
            # The case can play the flight without reading it from a file.
            case.flights.flown = LoadedFlight(into.number, times_s, np.stack([one.lps_from_camera for one in poses]))
            self.core.emit(UserMessage(f"the drive was stored as a flight of {recorder.length_s:.0f} s: {name}"))
            self.core.changed("flights")

    @answers(c.UnstoredFlights)
    def flights_to_keep(self, _question: c.UnstoredFlights) -> tuple[WholeRecording, ...]:
        """Return the finished flights, with their lines, of which the case file contains no line yet."""
        with self.core.lock:
            case = self.core.needed_case()
            writers = {one.number: one for one in case.flights.unwritten if one.closed}
            found = []
            for facts in case.flights.listed:
                num_stored, text = (
                    writers[facts.recording_id].unsaved_part() if facts.recording_id in writers else (1, "")
                )
                if num_stored == 0:
                    found.append(WholeRecording(facts, text))
            return tuple(found)


def _verdict_with_drive(case: OpenCase, scope: str) -> Verdict:
    """Return the verdict of an instrument with a simulated drive; the caller holds the session's lock."""
    verdict = next((one for one in case.planning.verdicts() if one.scope.name == scope), None)
    if verdict is None:
        raise NoResultError(
            f"there is no verdict on {scope!r} for the route that is taken: take a planned route, and wait for the "
            "verdicts",
            code="plan.no-verdict",
        )
    if verdict.driven is None:
        raise NoResultError(
            f"{verdict.scope.title} was not driven along this route, so there is no drive to store: {verdict.words}",
            code="plan.no-verdict",
        )
    return verdict
