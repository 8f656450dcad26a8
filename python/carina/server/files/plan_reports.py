"""Reports and plan files of a target, created by a job that windows display and can stop."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from shutil import rmtree
from typing import Literal

from starlette.responses import Response

from carina.commands import CtFolder, PlanningOf, PlanToTakeAway
from carina.errors import CancelledError, CarinaError
from carina.export import export_plan
from carina.plan.report import PlanMaterials, ReportKind, whole_sheet, write_report
from carina.server.files.job_results import set_failure, set_result
from carina.server.files.one_shot_file import OneShotFileResponse, new_folder
from carina.session import Session
from carina.session.jobs.background_jobs import Job
from carina.volume import badges_of

REPORT_SUFFIXES = (".html", ".pdf", ".json")
PLAN_SUFFIXES = (".mrk.json", ".seg.nrrd")
"""Suffixes of plan files for 3D Slicer."""
DICOM_SUFFIXES = (".seg.dcm", ".sr.dcm", ".pdf.dcm")
"""Suffixes of DICOM files (segmentation, measurements, report), which refer to the CT and need its folder."""
STEM: dict[ReportKind, str] = {"report": "plan", "tracing": "tracing-sheet"}
"""Beginning of the file name by kind of report; it contains neither the patient nor the case."""
SHEET_SHARE = 0.8
POLL_INTERVAL_S = 0.2
# The sandbox gives the report a separate origin without access to the server; the report also has its own policy.
SANDBOX = "sandbox allow-scripts allow-modals"


class Reports:
    """Creator of the plan reports and plan files of the open case's targets.

    Parameters
    ----------
    session
        Session with the open case.
    """

    def __init__(self, session: Session) -> None:
        self._session = session

    async def answer(
        self, target_id: str, suffix: str, kind: ReportKind, identity: Literal["none", "from the CT"] = "none"
    ) -> Response:
        """Return a response with the report or plan file of this suffix, which is deleted after the response.

        ``identity`` selects the patient identity in DICOM files; the default contains no patient data.

        Raises
        ------
        CarinaError
            If Carina does not write this suffix, the target has no plan, the job was stopped, or the disk refuses
            writes.
        """
        known = (*REPORT_SUFFIXES, *PLAN_SUFFIXES, *DICOM_SUFFIXES)
        if suffix not in known:
            msg = f"Carina can write a plan as {', '.join(known)}; found {suffix!r}"
            raise CarinaError(msg, code="export.suffix")
        materials: PlanMaterials = self._session.ask(PlanToTakeAway(target_id))
        archive = _Archive(self._session.ask(CtFolder()), identity) if suffix in DICOM_SUFFIXES else None
        folder = new_folder()
        try:
            place = folder / f"{STEM[kind]}{suffix}"
            path = await asyncio.wrap_future(self._start_job(materials, target_id, place, kind, archive))
        except BaseException:
            rmtree(folder, ignore_errors=True)
            raise
        headers = {"cache-control": "no-store"}
        if suffix == ".html":
            # Without a file name in the headers, the browser displays the report, so that the user can print it.
            return OneShotFileResponse(path, headers=headers | {"content-security-policy": SANDBOX})
        return OneShotFileResponse(path, filename=path.name, headers=headers)

    def _start_job(
        self, materials: PlanMaterials, target_id: str, path: Path, kind: ReportKind, archive: _Archive | None
    ) -> Future[Path]:
        done: Future[Path] = Future()

        def work(job: Job) -> None:
            try:
                made = _write_file(self._session, materials, target_id, path, kind=kind, archive=archive, job=job)
            except CancelledError:
                set_failure(done, CarinaError("the report was stopped", code="plan.report-stopped"))
                raise
            except BaseException as error:
                set_failure(done, error)
                raise
            set_result(done, made)

        self._session.jobs.start("report", "making the report", work)
        return done


def write_archive_files(
    session: Session,
    target_id: str,
    suffixes: Sequence[str],
    folder: Path,
    *,
    identity: Literal["none", "from the CT"],
    job: Job,
) -> list[Path]:
    """Write DICOM files of a target's plan into a folder, and return their paths.

    Parameters
    ----------
    session
        Session with the open case.
    target_id
        ID of the target.
    suffixes
        Some of :data:`DICOM_SUFFIXES`.
    folder
        Existing folder.
    identity
        Identity of the patient in the files.
    job
        Job that writes them, for progress and cancellation.

    Raises
    ------
    CarinaError
        If the target has no plan, the folder of the CT is not known, or the disk refuses writes.
    """
    materials: PlanMaterials = session.ask(PlanToTakeAway(target_id))
    archive = _Archive(session.ask(CtFolder()), identity)
    return [
        _write_file(session, materials, target_id, folder / f"plan{suffix}", kind="report", archive=archive, job=job)
        for suffix in suffixes
    ]


def _write_file(
    session: Session,
    materials: PlanMaterials,
    target_id: str,
    path: Path,
    *,
    kind: ReportKind,
    archive: _Archive | None,
    job: Job,
) -> Path:
    """Write one report or plan file by its suffix, and return its path."""

    def rendering(_step: str, share: float | None) -> None:
        job.progress("rendering the pictures", SHEET_SHARE * (share or 0.0))

    def writing(what: str, share: float | None) -> None:
        job.progress(what, SHEET_SHARE + (1.0 - SHEET_SHARE) * (share or 0.0))

    if path.name.endswith(PLAN_SUFFIXES):
        airways = materials.airways
        return export_plan(path, materials.plan, airways.tree, badges=badges_of(materials.volume, airways))
    if archive is not None and not path.name.endswith(".pdf.dcm"):
        return archive.export(path, materials, job)
    with_verdicts = _with_verdicts(session, materials, target_id, job)
    plays = path.suffix == ".html" and kind == "report"
    sheet = whole_sheet(with_verdicts, clips=plays, progress=rendering, cancel=job.cancel)
    pages = path if archive is None else path.with_suffix("").with_suffix(".pdf")
    made = write_report(pages, sheet, kind=kind, progress=writing, cancel=job.cancel)
    return made if archive is None else archive.wrap(path, made.read_bytes(), materials, job)


@dataclass(frozen=True, slots=True)
class _Archive:
    """Writer of a plan's DICOM files, with the CT folder and the setting for the patient identity."""

    ct: Path
    identity: Literal["none", "from the CT"]

    def export(self, path: Path, materials: PlanMaterials, job: Job) -> Path:
        """Write the plan as DICOM segmentation or measurements, and return the path.

        The content has the target's name.
        """
        job.progress("comparing the CT", None)
        name = materials.notes[0] if materials.notes else "Target"
        return export_plan(
            path,
            {name: materials.plan},
            materials.airways.tree,
            volume=materials.volume,
            ct=self.ct,
            identity=self.identity,
            cancel=job.cancel,
        )

    def wrap(self, path: Path, pdf: bytes, materials: PlanMaterials, job: Job) -> Path:
        """Write the report as DICOM PDF, whose pages never name the patient, and return the path."""
        from carina.export.plan_dicom_pdf import write_plan_pdf

        return write_plan_pdf(
            path,
            pdf,
            names_patient=False,
            identity=self.identity,
            volume=materials.volume,
            ct=self.ct,
            cancel=job.cancel,
        )


def _with_verdicts(session: Session, materials: PlanMaterials, target_id: str, job: Job) -> PlanMaterials:
    """Return the planning data after all instrument verdicts are ready, because an incomplete report misleads."""
    waited = False
    while session.ask(PlanningOf()).verdicts_standing == "making":
        waited = True
        job.progress("waiting for the verdicts on the instruments", None)
        time.sleep(POLL_INTERVAL_S)
    return session.ask(PlanToTakeAway(target_id)) if waited else materials
