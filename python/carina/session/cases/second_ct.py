"""Command that measures the movement of a target from a second CT of the patient."""

from __future__ import annotations

from collections.abc import Callable
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
        return self._measure(command.target_id, lambda job: self._open_second_ct(command.path, job))

    @does(c.MeasureMovementFromFiles)
    def measure_movement_from_files(self, command: c.MeasureMovementFromFiles) -> str:
        """Measure the movement of a target from a temporary CT; the path of the CT in an uploaded case is not used."""
        return self._measure(command.target_id, lambda job: self._open_second_ct(command.folder, job, dropped=True))

    @does(c.MeasureMovementFromCase)
    def measure_movement_from_case(self, command: c.MeasureMovementFromCase) -> str:
        """Measure the movement of a target from the CT of a case of the list, with the airways of that case."""
        records, listed = self._saving.records, self.core.store.recent() if self.core.store else ()
        record = None if records is None else records.find(command.recent_id)
        if records is not None and record is not None:
            path, has_place = str(records.path_of(record)), record.place is not None
            return self._measure(
                command.target_id,
                lambda job: self._open_case(path, job, dropped=not has_place),
                title=f"case {record.shown_title}",
            )
        known = next((one for one in listed if one.recent_id == command.recent_id), None)
        if known is None:
            raise UsageError("this case is no longer in the list; choose its folder or file", code="session.recent")
        return self._measure(
            command.target_id, lambda job: self._open_second_ct(known.path, job), title=f"case {known.title}"
        )

    def _measure(
        self, target_id: str, open_second: Callable[[Job], tuple[Volume, Airways | None]], *, title: str | None = None
    ) -> str:
        """Start the job that measures the movement of a target from the second CT that a function opens.

        ``title`` names the second CT in the message; None for the title of its volume.
        """
        case = self.core.needed_case()
        with self.core.lock:
            target = needed_target(case.document, target_id)
            if target.lesion is None:
                raise UsageError(f"{target.name} lies in the airways: it has no boundary", code="plan.target")
            airways = case.document.airways
            lesion = target.lesion
        if airways is None:
            raise UsageError("find the airways of this CT first", code="track.no-airways")

        def work(job: Job) -> None:
            volume, second_airways = open_second(job)
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
                now = needed_target(case.document, target_id)
                if now.lesion is None or now.lesion.nodule is not lesion.nodule:
                    raise UsageError(f"{now.name} was edited during the measurement; measure again", code="plan.target")
                options = msgspec.structs.replace(now.lesion.options, moved_mm=None, movement=measured)
                changed = replace(now, lesion=replace(now.lesion, options=options))
                self.core.change(case, f"measure the movement of {now.name}", with_target(case.document, changed))
                second = f"the second CT was {title or volume.source.title}"
                self.core.emit(UserMessage(". ".join((f"{now.name}: {movement.words}", second, *movement.notes))))

        return self.core.jobs.start(f"second ct {target_id}", "comparing with the second CT", work)

    def _open_second_ct(self, path: str, job: Job, *, dropped: bool = False) -> tuple[Volume, Airways | None]:
        """Return a second CT with the airways of its case; None if the airways must be found."""
        if self._saving.scans is None or not is_case_file(path):
            return self._saving.open_ct(path, job.progress, job.cancel), None
        return self._open_case(path, job, dropped=dropped)

    def _open_case(self, path: str, job: Job, *, dropped: bool = False) -> tuple[Volume, Airways | None]:
        """Return the CT of a case file and its airways; None if the case has none.

        ``dropped`` is that of `CaseScans.open`: whether the file states no valid path of the CT.
        """
        scans = self._saving.scans
        if scans is None:
            raise UsageError("this session stores no cases; choose the folder or file of the CT", code="case.no-scan")
        with CaseFile.open(Path(path), read_only=True) as file:
            volume = scans.open(file, dropped=dropped, progress=job.progress, cancel=job.cancel).volume
            return volume, file.load(volume).history().current.airways
