"""Tests of the export of a plan as DICOM: only with a known folder of the CT, and without patient data by default."""

from __future__ import annotations

import asyncio
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from carina.commands import CtFolder, PlanningOf, PlanToTakeAway
from carina.errors import CarinaError, UsageError
from carina.export import plan_dicom_pdf
from carina.server.files import plan_reports
from carina.server.files.plan_reports import Reports
from carina.volume import Note, Volume, VolumeSource


class SmallSession:
    """Replacement of a session: a plan, and a CT whose folder is known or unknown."""

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        self.jobs = SimpleNamespace(start=self.start)

    def start(self, _kind, _title, work):
        work(SimpleNamespace(progress=lambda *_given: None, cancel=lambda: False))

    def ask(self, question):
        match question:
            case PlanToTakeAway():
                return SimpleNamespace(
                    notes=("Left lower", "a remark"), plan="plan", airways=SimpleNamespace(tree="tree"), volume="volume"
                )
            case CtFolder():
                if self.folder is None:
                    raise UsageError("the CT was dropped into the window", code="plan.not-dicom")
                return self.folder
            case PlanningOf():
                return SimpleNamespace(verdicts_standing="had")


def answered(session, suffix, **options):
    response = asyncio.run(Reports(session).answer("target-1", suffix, "report", **options))
    return Path(response.path)


@pytest.fixture
def written(monkeypatch):
    """Return a list that records the arguments of the exports."""
    found = {}

    def export(path, plan, tree, **options):
        found.update(plan=plan, tree=tree, **options)
        path.write_bytes(b"DICM")
        return path

    def sheet(_materials, **_options):
        return "sheet"

    def pages(path, _sheet, **_options):
        path.write_bytes(b"%PDF-1.4 %%EOF")
        return path

    def wrap(path, pdf, **options):
        found.update(pdf=pdf, **options)
        path.write_bytes(b"DICM")
        return path

    monkeypatch.setattr(plan_reports, "export_plan", export)
    monkeypatch.setattr(plan_reports, "whole_sheet", sheet)
    monkeypatch.setattr(plan_reports, "write_report", pages)
    monkeypatch.setattr(plan_dicom_pdf, "write_plan_pdf", wrap)
    return found


@pytest.mark.parametrize("suffix", [".seg.dcm", ".sr.dcm"])
def test_segmentation_and_measurements_refer_to_the_folder_of_the_ct(tmp_path, written, suffix):
    path = answered(SmallSession(tmp_path), suffix)
    assert path.name == f"plan{suffix}"
    assert written["plan"] == {"Left lower": "plan"}
    assert (written["ct"], written["volume"], written["identity"]) == (tmp_path, "volume", "none")
    answered(SmallSession(tmp_path), suffix, identity="from the CT")
    assert written["identity"] == "from the CT"


def test_plan_files_for_slicer_get_the_lasting_notes_of_the_ct_and_of_the_airways(tmp_path, written):
    notes = [Note(code, "words", badge=True) for code in ("import.tilt-corrected", "track.search-stopped")]
    hu, source = np.zeros((2, 2, 2), dtype=np.int16), VolumeSource(format="dicom", title="Chest", notes=(notes[0],))
    volume = Volume(hu, np.eye(4), is_hu=True, source=source)
    airways = SimpleNamespace(tree="tree", badges=(notes[1],))
    session = SmallSession(tmp_path)
    session.ask = lambda _question: SimpleNamespace(plan="plan", airways=airways, volume=volume)
    answered(session, ".mrk.json")
    assert list(written["badges"]) == notes


def test_dicom_report_contains_the_pdf_unchanged_and_no_patient_name(tmp_path, written):
    path = answered(SmallSession(tmp_path), ".pdf.dcm")
    assert path.name == "plan.pdf.dcm"
    assert written["pdf"].startswith(b"%PDF")
    assert (written["names_patient"], written["identity"], written["ct"]) == (False, "none", tmp_path)


def test_export_without_the_folder_of_the_ct_is_refused_before_it_starts(written):
    for suffix in (".seg.dcm", ".sr.dcm", ".pdf.dcm"):
        with pytest.raises(UsageError, match="dropped into the window"):
            answered(SmallSession(None), suffix)
    assert written == {}
    with pytest.raises(CarinaError, match="can write a plan as"):
        answered(SmallSession(None), ".dcm")
