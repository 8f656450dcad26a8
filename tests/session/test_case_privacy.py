"""Tests of privacy of a shared case file: no names or dates from the CT's tags, folders, or the file of a mask."""

from __future__ import annotations

import contextlib
import logging
import os
import sqlite3
import zlib

from cached_test_data import cached_phantom
from carina import commands as c
from carina.case import CaseFile
from carina.render import Renderer
from carina.session import CaseRecords, Session, case_files
from carina.volume import Volume, VolumeSource, write_grid

NAMES = (b"MUELLER", b"Mueller", b"mueller", b"19610405", b"1961-04-05")
SCANNED_ON = "2021-05-03"
DATES = (b"2021-05-03", b"20210503", b"3 May 2021")
"""The scan date in three spellings; a date together with a place identifies a patient."""


def texts_of(path):
    """Return all content of a case file, with compressed content unpacked."""
    yield path.read_bytes()
    with sqlite3.connect(path) as case:
        for (table,) in case.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall():
            for row in case.execute(f"SELECT * FROM {table}"):
                for value in row:
                    if isinstance(value, bytes):
                        yield value
                        with contextlib.suppress(zlib.error):
                            yield zlib.decompress(value)
                    elif isinstance(value, str):
                        yield value.encode()
    case.close()


def test_copy_of_a_case_contains_no_name_of_ct_folder_or_mask_and_no_date(tmp_path, caplog):
    chest = cached_phantom(spacing_mm=3.0, generations=3)
    folder = tmp_path / "MUELLER 19610405"
    folder.mkdir()
    mask = folder / "Mueller_airways.nii.gz"
    write_grid(mask, chest.lumen_zyx, chest.volume.lps_from_ijk, what="the mask")
    volume = Volume(
        chest.volume.hu_zyx,
        chest.volume.lps_from_ijk,
        source=VolumeSource("dicom", "MUELLER thorax 1961-04-05", acquired_on=SCANNED_ON),
    )
    caplog.set_level(logging.DEBUG)
    records = CaseRecords(tmp_path / "cases", lambda: 1_800_000_000.0)
    session = Session(lambda v, transfer: Renderer(v, transfer=transfer), records=records, files=case_files())
    session.do(c.OpenVolume(volume))
    session.jobs.wait_idle(None)
    session.do(c.TakeMask(str(mask)))
    session.jobs.wait_idle(None)
    assert "imported segmentation" in session.snapshot().airways_words
    airways = session.snapshot().document.airways
    session.do(c.RecordFlight())
    session.do(c.AddTarget(tuple(airways.tree.tips()[0].points[-1])))
    session.jobs.wait_idle(None)
    session.do(c.GoTo(path_mm=20.0))
    session.do(c.StopRecording())
    session.do(c.SaveCase(str(tmp_path / "given.carina")))
    session.jobs.wait_idle(None)
    assert session.snapshot().saving.copy_name == "given.carina"
    (listed,) = session.cases.listed()
    assert listed.scanned_on == SCANNED_ON, "the list of its user shows the date"
    session.close()
    with CaseFile.open(tmp_path / "given.carina", read_only=True) as case:
        case.write_copy(tmp_path / "packed.carina", volume=volume)
        assert case.recordings()
        recorded = [case.recording_text(one.recording_id).encode() for one in case.recordings()]
    (live,) = (tmp_path / "cases").glob("*/case.carina")
    texts = [text for path in ("given.carina", "packed.carina") for text in texts_of(tmp_path / path)]
    for text in (*texts, *texts_of(live), *recorded, caplog.text.encode()):
        for name in (*NAMES, *DATES):
            assert name not in text
    assert SCANNED_ON not in repr(volume.source)
    (record,) = (tmp_path / "cases").glob("*/record.json")
    assert SCANNED_ON in record.read_text()
    assert os.name == "nt" or record.stat().st_mode & 0o777 == 0o600
