"""Command that measures the movement of a target from a second CT of the patient."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from carina import commands as c
from carina.case import CaseFile
from carina.errors import UsageError
from carina.session.command_registry import CommandHandlers, does
from carina.session.core import SessionCore
from carina.session.jobs.background_jobs import Job
from carina.session.saving.autosave import Autosave
from carina.session.state.snapshot import UserMessage
from carina.session.store.find_scan import is_case_file
from carina.session.targets.planning import with_target
from carina.session.targets.retrack import needed_target

if TYPE_CHECKING:
    from carina.track import Airways
    from carina.volume import Volume


class SecondCtHandlers(CommandHandlers):
    """Command that opens a second CT, compares it with the CT of the case, and plans with the measured movement."""

    def __init__(self, core: SessionCore, saving: Autosave) -> None:
        super().__init__(core)
        self._saving = saving

    @does(c.MeasureMovement)
    def measure_movement(self, command: c.MeasureMovement) -> str:
        """Measure the movement of a target as a job; a second CT that is not comparable changes nothing."""
        case = self.core.needed_case()
        with self.core.lock:
            target = needed_target(case.document, command.target_id)
            if target.lesion is None:
                raise UsageError(f"{target.name} lies in the airways: it has no boundary", code="plan.target")
            airways = case.document.airways
            lesion = target.lesion
        if airways is None:
            raise UsageError("find the airways of this CT first", code="track.no-airways")

        def work(job: Job) -> None:
            volume, second_airways = self._open_second_ct(command.path, job)
            found = self.core.parts.measure_movement(
                case.info.volume,
                airways,
                lesion.target,
                volume,
                second_airways,
                progress=job.progress,
                cancel=job.cancel,
            )
            movement = found.movement
            assert movement.shift_lps is not None
            assert movement.error_mm is not None
            measured = c.MeasuredMovement(movement.shift_lps, movement.error_mm, movement.notes)
            with self.core.lock:
                job.check()
                now = needed_target(case.document, command.target_id)
                if now.lesion is None or now.lesion.nodule is not lesion.nodule:
                    raise UsageError(f"{now.name} was edited during the measurement; measure again", code="plan.target")
                options = msgspec.structs.replace(now.lesion.options, moved_mm=None, movement=measured)
                changed = replace(now, lesion=replace(now.lesion, options=options))
                self.core.change(case, f"measure the movement of {now.name}", with_target(case.document, changed))
                self.core.emit(UserMessage(". ".join((f"{now.name}: {movement.words}", *movement.notes))))

        return self.core.jobs.start(f"second ct {command.target_id}", "comparing with the second CT", work)

    def _open_second_ct(self, path: str, job: Job) -> tuple[Volume, Airways | None]:
        """Return a second CT with the airways of its case; None if the airways must be found."""
        scans = self._saving.scans
        if scans is None or not is_case_file(path):
            return self._saving.open_ct(path, job.progress, job.cancel), None
        with CaseFile.open(Path(path), read_only=True) as file:
            volume = scans.open(file, progress=job.progress, cancel=job.cancel).volume
            return volume, file.load(volume).history().current.airways
