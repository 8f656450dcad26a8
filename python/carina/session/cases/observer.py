"""Commands of a session that mirrors a case of another process, and takes the case over when that process ends."""

from __future__ import annotations

import numpy as np

from carina import commands as c
from carina.case.stored_state import Moment
from carina.errors import UsageError
from carina.session.airways.finding import AirwayHandlers
from carina.session.command_registry import CommandHandlers, does
from carina.session.core import ALL_TOPICS, SessionCore
from carina.session.flights.scope_contact import ScopeContactHandlers
from carina.session.open_case.open_case import LastMove, OpenCase, restore
from carina.session.saving.autosave import Autosave, ReplacementCase


class ObserverHandlers(CommandHandlers):
    """Commands that mirror a case of another process: all but display settings (`Sight`) is copied from the owner."""

    def __init__(
        self, core: SessionCore, finding: AirwayHandlers, holding: ScopeContactHandlers, saving: Autosave
    ) -> None:
        super().__init__(core)
        self._finding = finding
        self._holding = holding
        self._saving = saving

    @does(c.FollowMoment)
    def follow_moment(self, command: c.FollowMoment) -> None:
        """Replace the state of the case by a newer one; objects that are identical in both are not computed again."""
        case, moment = self.core.needed_case(), command.moment
        with self.core.lock:
            self._replace_state(case, moment)
            self.core.changed(*ALL_TOPICS)
        self._holding.resume(case)

    @does(c.TakeOver)
    def take_over(self, command: c.TakeOver) -> None:
        """Become the process that owns and stores the case.

        Raises
        ------
        UsageError
            ``case.open`` if another process has the case open.
        """
        case, records = self.core.needed_case(), self._saving.records
        record = None if records is None else records.find(command.case_id)
        if record is None:
            raise UsageError("this case is no longer in the list", code="session.recent")
        while_opening = ReplacementCase(self._saving)
        reopened = while_opening.take(record.digest, record.case_id)
        if reopened is None:
            while_opening.release()
            raise UsageError("another program has this case open", code="case.open")
        try:
            moment = reopened.file.load(case.info.volume)
        except BaseException:
            while_opening.release()
            raise
        with self.core.lock:
            self._replace_state(case, moment)
            while_opening.attach(case, record.place)
            self.core.changed(*ALL_TOPICS, "flights")
        self._holding.resume(case)
        if case.search.status == "waiting":
            # The owner ended before its search for the airways finished.
            self._finding.start(case, None, case.info.scale.threshold, label=None)

    def _replace_state(self, case: OpenCase, moment: Moment) -> None:
        """Replace history, measurements and tip of the case by a stored state; the caller holds the session's lock."""
        before, mode = case.navigator.pose, case.navigator.mode
        case.history = moment.history()
        case.measured.replace_all(moment.measures)
        case.scope.pending = None
        restore(case, moment)
        self.core.follow(case)
        if case.navigator.mode != mode or not np.array_equal(
            case.navigator.pose.lps_from_camera, before.lps_from_camera
        ):
            # A move re-centres zoomed slices on the tip.
            self.core.after_move(case, mode)
        case.last_move = LastMove(person_moved=moment.person_moved)
