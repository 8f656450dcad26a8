"""Commands of the simulated breathing: movement, period and coughs of the open case."""

from __future__ import annotations

import threading
from dataclasses import replace

from carina import commands as c
from carina.breathing import Breathing, ChestFrame
from carina.errors import NoResultError, UsageError
from carina.session.command_registry import CommandHandlers, does
from carina.session.core import SessionCore
from carina.session.open_case.live_breathing import TICK_S
from carina.session.open_case.open_case import OpenCase
from carina.session.state.snapshot import ChestMoved


class BreathingHandlers(CommandHandlers):
    """Simulated breathing of the open case, and the thread that requests pictures while the chest moves."""

    def __init__(self, core: SessionCore) -> None:
        super().__init__(core)
        self._closed = threading.Event()
        self._thread: threading.Thread | None = None

    @does(c.SetBreathing)
    def set_breathing(self, command: c.SetBreathing) -> None:
        """Switch the breathing on or off, or change it; a new period begins from rest.

        Raises
        ------
        NoResultError
            ``breathing.no-airways``: without airways, whose height is that of the chest.
        GeometryError
            ``breathing.height``: if the airways are too low.
        """
        case = self.core.needed_case()
        with self.core.lock:
            live, now_s = case.flights.breathing, self.core.clock()
            wanted = Breathing.of_movement(command.movement_mm, command.period_s) if command.on else None
            if wanted is not None:
                if case.document.airways is None:
                    raise NoResultError("breathing needs the airways: wait for the search", code="breathing.no-airways")
                ChestFrame.of_tree(case.document.airways.tree)
            before = live.breathing
            if wanted is not None and before is not None and before.period_s == wanted.period_s:
                live.breathing = replace(wanted, coughs_s=before.coughs_s)
            else:
                live.begin(wanted, now_s)
            self._changed(case)

    @does(c.Cough)
    def cough(self, _command: c.Cough) -> None:
        """Let the patient cough now.

        Raises
        ------
        UsageError
            ``breathing.off``: if the breathing is off.
        """
        case = self.core.needed_case()
        with self.core.lock:
            if case.flights.breathing.breathing is None:
                raise UsageError("a cough needs the simulated breathing: switch it on first", code="breathing.off")
            case.flights.breathing.cough(self.core.clock())
            self._changed(case)

    def _changed(self, case: OpenCase) -> None:
        for step in self.core.after_breathing:
            step(case)
        self.core.changed("state", "pose", "views")
        if case.flights.breathing.breathing is not None and self._thread is None:
            self._thread = threading.Thread(target=self._report, name="carina-breathing", daemon=True)
            self._thread.start()

    def _report(self) -> None:
        """Report movements of the chest until the breathing ends; the body of the thread."""
        while not self._closed.wait(TICK_S):
            with self.core.lock:
                case = self.core.case
                if case is None or case.flights.breathing.breathing is None:
                    self._thread = None
                    return
                if case.flights.breathing.is_moving:
                    self.core.emit(ChestMoved(case.navigator.scope_state is not None))

    def close(self) -> None:
        """End the thread."""
        self._closed.set()
