"""Tests of a second CT that is chosen from the list of cases, or that is in an uploaded case file."""

from __future__ import annotations

import itertools
import shutil

import numpy as np
import pytest

import carina
from cached_test_data import cached_phantom
from carina import commands as c
from carina.phantom import write_phantom
from carina.session import ErrorEvent, UserMessage, case_files
from carina.session.attach.select import program_session
from carina.session.store.registry import CaseRecords
from second_scan import write_second_ct

CHEST = {"seed": 4, "spacing_mm": 1.8, "generations": 5, "nodule": True}


class Station:
    """Session of a user with stored cases."""

    def __init__(self, folder) -> None:
        times = itertools.count(1_800_000_000)
        self.records = CaseRecords(folder / "cases", lambda: float(next(times)))
        self.session = program_session(records=self.records, files=case_files(None, self.records))
        self.events: list[object] = []
        self.session.subscribe(self.events.append)

    def do(self, *commands) -> list[object]:
        self.events.clear()
        for command in commands:
            self.session.do(command)
            self.session.jobs.wait_idle(None)
        return list(self.events)

    def movement(self):
        (target,) = self.session.snapshot().document.targets
        return target.lesion.options.movement


@pytest.fixture
def station(tmp_path):
    made = Station(tmp_path / "user")
    yield made
    made.session.close()


@pytest.fixture
def second(tmp_path):
    """Write a CT to the folder ``scan``, and a second CT of the patient to another folder; return the second path."""
    chest = cached_phantom(**CHEST)
    write_phantom(chest, tmp_path / "scan")
    (tmp_path / "other").mkdir()
    return write_second_ct(chest.volume, tmp_path / "other" / "second.nii.gz")


def open_with_target(station, tmp_path) -> str:
    """Open the first CT, add its nodule as a target, and return the ID of the target."""
    centre = tuple(cached_phantom(**CHEST).truth["nodule"]["centre_lps"])
    station.do(c.OpenPath(str(tmp_path / "scan" / "ct.nii.gz")), c.AddTarget(centre))
    (target,) = station.session.snapshot().document.targets
    return target.target_id


def test_movement_is_measured_from_a_case_of_the_list_which_the_message_names(station, second, tmp_path):
    station.do(c.OpenPath(str(second)), c.SetFov(80.0))
    (record,) = station.records.all()
    target_id = open_with_target(station, tmp_path)
    events = station.do(c.MeasureMovementFromCase(target_id, record.case_id))
    assert not [one for one in events if isinstance(one, ErrorEvent)]
    movement = station.movement()
    assert 0.5 < np.linalg.norm(movement.shift_lps) < 20.0
    (text,) = [one.message for one in events if isinstance(one, UserMessage)]
    assert f"the second CT was case {record.shown_title}" in text


def test_uploaded_case_file_is_not_read_from_the_path_that_it_states(station, second, tmp_path):
    target_id = open_with_target(station, tmp_path)
    for folder in ("saved", "upload"):
        (tmp_path / folder).mkdir()
    with carina.Case.open(second) as case:
        saved = case.save(tmp_path / "saved" / "other.carina")
    # The path of the CT relative to the file is also valid in the folder of the upload.
    uploaded = shutil.copy(saved, tmp_path / "upload" / "other.carina")
    events = station.do(c.MeasureMovementFromFiles(target_id, str(uploaded)))
    assert [one.code for one in events if isinstance(one, ErrorEvent)] == ["case.no-scan"]
    assert station.movement() is None
    events = station.do(c.MeasureMovement(target_id, str(uploaded)))
    assert not [one for one in events if isinstance(one, ErrorEvent)]
    assert station.movement() is not None
