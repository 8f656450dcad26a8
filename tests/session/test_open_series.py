"""Tests of the choice of another DICOM series of the open folder, and of cases that belong to such a series."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from dicom_writer import chest, series

from carina import commands as c
from carina.session import ErrorEvent, case_files
from carina.session.attach.select import program_session
from carina.session.store.registry import CaseRecords
from carina.volume import VolumeCache


class Workstation:
    """Workstation with a cache of CTs and stored cases in one folder."""

    def __init__(self, folder):
        times = itertools.count(1_800_000_000)
        self.records = CaseRecords(folder / "cases", lambda: float(next(times)))
        self.cache = VolumeCache(folder / "volumes", max_bytes=1 << 30)
        self.session = program_session(records=self.records, files=case_files(self.cache, self.records))
        self.events = []
        self.session.subscribe(self.events.append)

    def do(self, *commands):
        for command in commands:
            self.session.do(command)
            self.session.jobs.wait_idle(None)

    @property
    def voxels(self):
        return self.session.snapshot().case.volume.hu_zyx

    def errors(self):
        return [event.code for event in self.events if isinstance(event, ErrorEvent)]


@pytest.fixture
def workstation(tmp_path):
    made = Workstation(tmp_path / "user")
    yield made
    made.session.close()
    made.cache.close()


@pytest.fixture
def folder(tmp_path):
    """Return a folder with a series of 20 slices and one of 16."""
    series(tmp_path / "scan" / "a", number=3)
    return series(tmp_path / "scan" / "b", number=4, hu=chest(16, seed=6)).parent


def test_other_series_of_the_folder_replaces_the_open_one(workstation, folder):
    workstation.do(c.OpenPath(str(folder)))
    np.testing.assert_array_equal(workstation.voxels, chest())
    workstation.do(c.OpenSeries("4"))
    np.testing.assert_array_equal(workstation.voxels, chest(16, seed=6))
    workstation.do(c.OpenSeries("3"))
    np.testing.assert_array_equal(workstation.voxels, chest())


def test_case_of_another_series_opens_with_its_series_from_the_list(workstation, folder):
    workstation.do(c.OpenPath(str(folder)), c.OpenSeries("4"), c.SetFov(80.0), c.CloseCase())
    record = max(workstation.records.all(), key=lambda one: one.use_number)
    assert record.place == str(folder)
    workstation.cache.empty()
    workstation.do(c.OpenRecent(record.case_id))
    np.testing.assert_array_equal(workstation.voxels, chest(16, seed=6))
    assert workstation.session.snapshot().document.look.fov_deg == 80.0


def test_case_file_of_another_series_finds_its_series(workstation, folder, tmp_path):
    saved = tmp_path / "saved.carina"
    workstation.do(c.OpenPath(str(folder)), c.OpenSeries("4"), c.SetFov(80.0), c.SaveCase(str(saved)), c.CloseCase())
    workstation.cache.empty()
    workstation.do(c.OpenPath(str(saved)))
    np.testing.assert_array_equal(workstation.voxels, chest(16, seed=6))


def test_unknown_series_is_refused_and_the_open_case_stays(workstation, folder):
    workstation.do(c.OpenPath(str(folder)), c.OpenSeries("9"))
    assert workstation.errors()[-1] == "usage.series"
    np.testing.assert_array_equal(workstation.voxels, chest())


def test_other_series_of_dropped_files_opens_and_no_path_of_them_is_stored(workstation, folder):
    workstation.do(c.OpenFiles(str(folder)))
    assert workstation.session.ask(c.SeriesFiles()) == folder
    workstation.do(c.OpenSeries("4"))
    np.testing.assert_array_equal(workstation.voxels, chest(16, seed=6))
    assert workstation.session.ask(c.SeriesFiles()) == folder
    assert all(record.place is None for record in workstation.records.all())


def test_files_of_a_dropped_folder_with_one_series_are_not_needed_later(workstation, tmp_path):
    workstation.do(c.OpenFiles(str(series(tmp_path / "one"))))
    assert workstation.session.ask(c.SeriesFiles()) is None
