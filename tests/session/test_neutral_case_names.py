"""Tests of the shown names of cases: a neutral alias unless the user gave a name, never the file name of the CT."""

from __future__ import annotations

import json
import os
import random

import pytest

from carina import commands as c
from carina.session import LocalStore
from carina.session.store.case_names import neutral_alias
from carina.session.store.registry import CaseRecords
from restartable_workstation import RestartableWorkstation

NAME = "SURNAME_FIRSTNAME_1951.nii.gz"


def write_old_record(folder, case_id, **values):
    """Write a case record as an earlier version wrote it, with the file name of the CT."""
    (folder / case_id).mkdir(parents=True)
    record = {
        "format": "carina-record",
        "version": 1,
        "case_id": case_id,
        "digest": "ab" * 32,
        "place": None,
        "title": NAME,
        "begun_s": 1.0,
        "used_s": 2.0,
        "alias": None,
        "num_changes": 4,
    } | values
    (folder / case_id / "record.json").write_text(json.dumps(record), encoding="utf-8")
    (folder / case_id / "case.carina").write_bytes(b"the case")
    return folder / case_id / "record.json"


@pytest.fixture
def records(tmp_path):
    return CaseRecords(tmp_path / "cases", lambda: 1_800_000_000.0)


def test_neutral_case_name_has_six_legible_digits_and_depends_only_on_the_case_id():
    rng = random.Random(4)
    ids = [f"{rng.getrandbits(64):016x}" for _ in range(2000)]
    aliases = [neutral_alias(one) for one in ids]
    assert len(set(aliases)) == len(ids)
    assert all(one.startswith("Case ") and len(one) == 11 for one in aliases)
    assert set("".join(one[5:] for one in aliases)) == set("0123456789ABCDEFGHJKMNPQRSTVWXYZ")
    assert neutral_alias("00112233aabbccdd") == neutral_alias("00112233AABBCCDD") == "Case TJM0Z7"


def test_new_case_has_the_given_id_unless_its_neutral_name_is_in_use(records):
    first = records.begin("ab" * 32, None, case_id="00112233aabbccdd")
    first.path.write_bytes(b"the case")
    assert first.record.case_id == "00112233aabbccdd"
    first.note(alias=neutral_alias("aa" * 8).upper())
    second = records.begin("cd" * 32, None, case_id="aa" * 8)
    assert second.record.case_id != "aa" * 8, "its alias is the name of the first case"
    assert second.record.shown_title != first.record.shown_title
    third = records.begin("cd" * 32, None, case_id="00112233aabbccde")
    assert third.record.case_id == "00112233aabbccde"
    for held in (first, second, third):
        held.release()


def test_new_case_does_not_have_the_neutral_name_of_a_deleted_case(records):
    held = records.begin("ab" * 32, None, case_id="00112233aabbccdd")
    held.path.write_bytes(b"the case")
    held.release()
    assert records.forget(held.record)
    again = records.begin("ab" * 32, None, case_id="00112233aabbccdd")
    assert again.record.case_id != "00112233aabbccdd"
    again.release()


def test_case_records_of_earlier_versions_are_rewritten_without_the_file_name(records, tmp_path):
    listed = write_old_record(tmp_path / "cases", "00112233aabbccdd")
    named = write_old_record(tmp_path / "cases", "00112233aabbccde", alias="Nodule in RB4")
    gone = write_old_record(tmp_path / "cases" / ".forgotten", "00112233aabbccdf", forgotten_s=5.0)
    assert records.remove_titles() == 3
    for path in (listed, named, gone):
        assert NAME not in path.read_text(encoding="utf-8")
        assert json.loads(path.read_text(encoding="utf-8"))["num_changes"] == 4
        assert os.name == "nt" or path.stat().st_mode & 0o777 == 0o600
    assert {one.shown_title for one in records.all()} == {"Case TJM0Z7", "Nodule in RB4"}
    assert [one.case_id for one in records.forgotten()] == ["00112233aabbccdf"]
    assert records.remove_titles() == 0


def test_record_of_a_case_open_in_another_process_is_rewritten_after_it_is_closed(records, tmp_path):
    path = write_old_record(tmp_path / "cases", "00112233aabbccdd")
    held = records.hold(records.find("00112233aabbccdd"))
    before = path.read_bytes()
    assert CaseRecords(tmp_path / "cases", lambda: 0.0).remove_titles() == 0
    assert path.read_bytes() == before
    held.release()
    assert records.remove_titles() == 1


def test_case_records_after_an_unreadable_record_are_rewritten(records, tmp_path):
    write_old_record(tmp_path / "cases", "00112233aabbccdd").write_text("[" * 100_000, encoding="utf-8")
    write_old_record(tmp_path / "cases", "00112233aabbccde", used_s="never")
    path = write_old_record(tmp_path / "cases", "00112233aabbccdf")
    assert records.remove_titles() == 1
    assert NAME not in path.read_text(encoding="utf-8")


def test_recent_ct_list_of_earlier_versions_is_rewritten_without_titles(tmp_path):
    entry = {"recent_id": "11ff", "date": "2026-01-31", "title": NAME, "path": "/scans/a"}
    file = tmp_path / "recent.json"
    file.write_text(json.dumps({"format": "carina-recent", "version": 1, "cases": [entry, 3]}), encoding="utf-8")
    store = LocalStore(tmp_path)
    assert store.remove_titles()
    assert NAME not in file.read_text(encoding="utf-8")
    (listed,) = store.recent()
    assert (listed.path, listed.date) == ("/scans/a", "2026-01-31")
    assert listed.title == neutral_alias(listed.recent_id)
    assert listed.recent_id != "11ff", "the id was a digest of the path"
    assert not store.remove_titles()


def test_no_stored_file_contains_the_title_of_the_ct(tmp_path):
    workstation = RestartableWorkstation(tmp_path)
    workstation.store = LocalStore(tmp_path / "config")
    session = workstation.start()
    workstation.open()
    session.do(c.SetFov(80.0))
    workstation.saved()
    title = session.snapshot().case.volume.source.title
    assert title == "Thorax 1.5"
    shown = session.snapshot().neutral_title
    (listed,) = session.cases.listed()
    assert listed.title == shown, "the name in the list is the name in the window"
    session.close()
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert {"record.json", "recent.json"} <= {path.name for path in files}
    assert not [path for path in files if title.encode() in path.read_bytes()]


def test_case_opened_again_has_the_name_of_its_first_opening(tmp_path):
    workstation = RestartableWorkstation(tmp_path)
    session = workstation.start()
    workstation.open()
    session.do(c.SetFov(80.0))
    workstation.saved()
    shown = session.snapshot().neutral_title
    session.close()
    again = workstation.start()
    workstation.open()
    assert again.snapshot().neutral_title == shown
    again.close()
