"""A session beside the process that owns its case: it shows what is done there, and goes on when that one has gone."""

from __future__ import annotations

import numpy as np

from carina import commands as c
from carina.case.moment import Moment
from carina.errors import UsageError
from carina.session.case import LastMove, OpenCase, restore
from carina.session.core import ALL_TOPICS, SessionCore
from carina.session.finding import AirwayFinding
from carina.session.holding import ScopeHolding
from carina.session.saving import Between, Saving
from carina.session.subject import Subject, does

__all__ = ["Following"]


class Following(Subject):
    """Document, history, tip and numbers are the owner's; how the case is looked at is this session's own."""

    def __init__(self, core: SessionCore, finding: AirwayFinding, holding: ScopeHolding, saving: Saving) -> None:
        super().__init__(core)
        self._finding = finding
        self._holding = holding
        self._saving = saving

    @does(c.FollowMoment)
    def follow_moment(self, command: c.FollowMoment) -> None:
        """What is the same object as before is not made again."""
        case, moment = self.core.needed_case(), command.moment
        with self.core.lock:
            self._become(case, moment)
            self.core.changed(*ALL_TOPICS)
        self._holding.resume(case)

    @does(c.TakeOver)
    def take_over(self, command: c.TakeOver) -> None:
        """UsageError ``case.open`` while another process has it."""
        case, records = self.core.needed_case(), self._saving.records
        record = None if records is None else records.find(command.case_id)
        if record is None:
            raise UsageError("this case is no longer in the list", code="session.recent")
        between = Between(self._saving)
        reopened = between.take(record.digest, record.case_id)
        if reopened is None:
            between.give_back()
            raise UsageError("another program has this case open", code="case.open")
        try:
            moment = reopened.file.load(case.info.volume)
        except BaseException:
            between.give_back()
            raise
        with self.core.lock:
            self._become(case, moment)
            between.attach(case, record.place)
            self.core.changed(*ALL_TOPICS, "flights")
        self._holding.resume(case)
        if case.search.status == "waiting":
            # Its owner went while it was looking for them.
            self._finding.start(case, None, case.info.scale.threshold, label=None)

    def _become(self, case: OpenCase, moment: Moment) -> None:
        """With the session locked."""
        before, mode = case.navigator.pose, case.navigator.mode
        case.history = moment.history()
        case.measured.take(moment.measures)
        case.scope.awaited = None
        restore(case, moment)
        self.core.follow(case)
        if case.navigator.mode != mode or not np.array_equal(
            case.navigator.pose.lps_from_camera, before.lps_from_camera
        ):
            # Slices that were zoomed go along with the tip.
            self.core.after_move(case, mode)
        case.last_move = LastMove(person_moved=moment.person_moved)
