"""Tests of the path of a case's CT: comparison with the file of a target, and references in exported DICOM files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from carina import plan
from carina.commands import CtFolder, OpenFiles, OpenPath, PlanningOf, TakeTarget
from carina.errors import UsageError, VolumeImportError
from carina.session import ErrorEvent
from carina.volume import dicom_structures
from carina.volume.dicom_references import References
from small_case import session_fixture, small_volume

OURS = References(frozenset({"1.2.3"}), frozenset({"4.5"}), frozenset({"6"}), frozenset({"7"}))


def dicom_volume(*_given):
    volume = small_volume()
    return replace(volume, source=replace(volume.source, format="dicom"))


@pytest.fixture
def taken(monkeypatch):
    """Return a list of the CTs with which the file of a target is compared; the file itself is refused."""
    found = []

    def refuse(path, volume, *, ct, **_options):
        found.append(ct)
        raise VolumeImportError(f"reading {Path(path).name}: it was drawn on another CT", code="import.other-ct")

    monkeypatch.setattr(plan, "target_from_file", refuse)
    return found


def take(fixture):
    fixture.session.do(TakeTarget("nodule.dcm"))
    fixture.background.run_all()
    return fixture.of_type(ErrorEvent)[-1]


def test_target_file_drawn_on_another_ct_is_refused_by_comparison_with_the_folder_of_the_opened_ct(tmp_path, taken):
    fixture = session_fixture(open_volume=dicom_volume)
    fixture.session.do(OpenPath(str(tmp_path)))
    fixture.background.run_all()
    error = take(fixture)
    assert taken == [tmp_path]
    assert (error.code, "drawn on another CT" in error.message) == ("import.other-ct", True)
    assert fixture.session.ask(CtFolder()) == tmp_path
    assert fixture.session.ask(PlanningOf()).dicom_problem is None


def test_dicom_references_of_a_dropped_ct_are_available_while_its_case_is_open(monkeypatch, taken, tmp_path):
    read = []

    def references(path, volume, watch):
        read.append(path)
        return OURS

    monkeypatch.setattr(dicom_structures, "ct_references", references)
    fixture = session_fixture(open_volume=dicom_volume)
    fixture.session.do(OpenFiles(str(tmp_path)))
    fixture.background.run_all()
    take(fixture)
    assert (read, taken) == ([tmp_path], [OURS])
    # A DICOM export needs the images of the CT; the message names the missing ones.
    with pytest.raises(UsageError, match="open the CT by its folder"):
        fixture.session.ask(CtFolder())
    assert "was dropped" in fixture.session.ask(PlanningOf()).dicom_problem
    # Another case does not use the CT's path.
    fixture.session.do(OpenPath(str(tmp_path)))
    fixture.background.run_all()
    take(fixture)
    assert taken[-1] == tmp_path


def test_source_path_without_dicom_files_and_missing_source_path_are_reported(tmp_path, taken):
    fixture = session_fixture()
    fixture.session.do(OpenPath(str(tmp_path)))
    fixture.background.run_all()
    assert "was not opened from DICOM" in fixture.session.ask(PlanningOf()).dicom_problem
    without_disk = session_fixture(open_volume=dicom_volume)
    without_disk.session.do(OpenPath(str(tmp_path / "stick")))
    without_disk.background.run_all()
    assert "no longer there" in without_disk.session.ask(PlanningOf()).dicom_problem
    take(without_disk)
    assert taken == [None]
