"""The plan of a target as a report, made by a job that the window sees and can stop."""

from __future__ import annotations

import asyncio
import time
from concurrent.futures import Future
from pathlib import Path
from shutil import rmtree

from starlette.responses import Response

from carina.commands import PlanningOf, PlanToTakeAway
from carina.errors import CancelledError, CarinaError
from carina.export import export_plan
from carina.plan.report import PlanMaterials, ReportKind, whole_sheet, write_report
from carina.server.for_once import FileForOnce, new_folder
from carina.session import Session
from carina.session.jobs import Job

__all__ = ["REPORT_SUFFIXES", "Reports"]

REPORT_SUFFIXES = (".html", ".pdf", ".json")
PLAN_SUFFIXES = (".mrk.json", ".seg.nrrd")
"""For 3D Slicer; DICOM needs the folder of the CT, and is written by ``carina plan``."""
STEM: dict[ReportKind, str] = {"report": "plan", "tracing": "tracing-sheet"}
"""Of every file: neither the patient nor the case is in its name."""
SHEET_SHARE = 0.8
LOOK_S = 0.2
# A page of its own origin, which reaches nothing of the workstation's; the report's own policy holds besides.
SANDBOX = "sandbox allow-scripts allow-modals"


class Reports:
    """Makes reports of the open case.

    Parameters
    ----------
    session
        Whose plans.
    """

    def __init__(self, session: Session) -> None:
        self._session = session

    async def answer(self, target_id: str, suffix: str, kind: ReportKind) -> Response:
        """The report with this suffix, which is removed once it has been sent.

        Raises
        ------
        CarinaError
            If Carina writes no such file, there is no plan yet, the job was stopped, or the disk takes nothing.
        """
        known = (*REPORT_SUFFIXES, *PLAN_SUFFIXES)
        if suffix not in known:
            msg = f"Carina can write a plan as {', '.join(known)}; found {suffix!r}"
            raise CarinaError(msg, code="export.suffix")
        materials: PlanMaterials = self._session.ask(PlanToTakeAway(target_id))
        folder = new_folder()
        try:
            path = await asyncio.wrap_future(self._begin(materials, target_id, folder / f"{STEM[kind]}{suffix}", kind))
        except BaseException:
            rmtree(folder, ignore_errors=True)
            raise
        headers = {"cache-control": "no-store"}
        if suffix == ".html":
            # Shown, not saved: it is to be printed.
            return FileForOnce(path, headers=headers | {"content-security-policy": SANDBOX})
        return FileForOnce(path, filename=path.name, headers=headers)

    def _begin(self, materials: PlanMaterials, target_id: str, path: Path, kind: ReportKind) -> Future[Path]:
        done: Future[Path] = Future()

        def work(job: Job) -> None:
            def rendering(share: float) -> None:
                job.progress("rendering the pictures", SHEET_SHARE * share)

            def writing(share: float) -> None:
                job.progress("laying out the pages", SHEET_SHARE + (1.0 - SHEET_SHARE) * share)

            try:
                if path.name.endswith(PLAN_SUFFIXES):
                    done.set_result(
                        export_plan(path, materials.plan, materials.airways.tree, badges=materials.airways.badges)
                    )
                    return
                asked = _with_verdicts(self._session, materials, target_id, job)
                plays = path.suffix == ".html" and kind == "report"
                sheet = whole_sheet(asked, clips=plays, progress=rendering, cancel=job.cancel)
                made = write_report(path, sheet, kind=kind, progress=writing, cancel=job.cancel)
            except CancelledError:
                _settle(done, CarinaError("the report was stopped", code="plan.report-stopped"))
                raise
            except BaseException as trouble:
                _settle(done, trouble)
                raise
            if not done.cancelled():
                done.set_result(made)

        self._session.jobs.start("report", "making the report", work)
        return done


def _with_verdicts(session: Session, materials: PlanMaterials, target_id: str, job: Job) -> PlanMaterials:
    """With the verdicts of all instruments, which are waited for: a report that counts half of them misleads."""
    waited = False
    while session.ask(PlanningOf()).verdicts_standing == "making":
        waited = True
        job.progress("waiting for the verdicts on the instruments", None)
        time.sleep(LOOK_S)
    return session.ask(PlanToTakeAway(target_id)) if waited else materials


def _settle(done: Future[Path], trouble: BaseException) -> None:
    """The one who waits may have gone."""
    if not done.cancelled():
        done.set_exception(trouble)
