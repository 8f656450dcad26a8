"""Tests of unreadable case records: they are moved aside with a message, prevent no start, and are not deleted."""

from __future__ import annotations

import json
import math
import os

import msgspec
import pytest

from carina.case import CaseFile, Document, Moment, SourceFacts, Step
from carina.cli.case import list_cases
from carina.config import load_settings
from carina.render import Sight, transfer_preset
from carina.session import LocalStore
from carina.session.cases.case_list import CaseList
from carina.session.core import SessionCore
from carina.session.saving.autosave import Autosave
from carina.session.state.snapshot import ErrorEvent
from carina.session.store.attach_endpoint import read_endpoint
from carina.session.store.registry import VERSION, CaseRecord, CaseRecords
from carina.session.store.registry_repair import ASIDE, repair_records
from small_case import small_volume
from user_folders import user_folders

NOW_S = 1.7e9

BAD_RECORDS = {
    "infinity": '{"format": "carina-record", "version": 1, "begun_s": -Infinity}',
    "nan": '{"format": "carina-record", "version": 1, "used_s": NaN}',
    "empty": "",
    "zeros": "\x00" * 4096,
    "a list": "[1, 2]",
    "a number": "7",
    "no version": '{"format": "carina-record"}',
    "nested": "[" * 100_000,
    "a long number": '{"format": "carina-record", "version": 1, "begun_s": ' + "9" * 5000 + "}",
    "too large": " " * (2 << 20),
}


@pytest.fixture
def records(tmp_path):
    return CaseRecords(tmp_path / "cases", lambda: NOW_S)


@pytest.fixture
def case_id(records):
    """Store a case with two steps, of which one is undone, and return its ID."""
    held = records.begin("ab" * 32, "/scans/ct")
    document = Document(transfer=transfer_preset("endoscopic"))
    steps = (Step("one", document, None, 5.0), Step("two", document, None, 60.0))
    with CaseFile.create(held.path, SourceFacts.of(small_volume(), "ab" * 32)) as file:
        file.save(Moment(document, steps, 1, Sight(), {}))
    held.release()
    return held.record.case_id


def spoil(records, case_id, text):
    path = records.folder / case_id / "record.json"
    path.write_text(text)
    return path


def listed(records, store=None):
    """Return the cases that the start page lists, and the messages that it shows."""
    core = SessionCore(lambda *_: None, store=store)
    events = []
    core.subscribe(events.append)
    cases = CaseList(core, Autosave(core, records, None))
    return cases.listed(), [event for event in events if isinstance(event, ErrorEvent)], cases, events


@pytest.mark.parametrize("what", BAD_RECORDS)
def test_unreadable_case_record_is_moved_aside_and_its_case_is_listed_again(records, case_id, what):
    path = spoil(records, case_id, BAD_RECORDS[what])
    before = (path.parent / "case.carina").read_bytes()
    rows, messages, cases, events = listed(records)
    assert [row.recent_id for row in rows] == [case_id]
    assert (rows[0].title, rows[0].num_changes) == ("Restored case", 1)
    (message,) = messages
    assert message.code == "case.record"
    assert case_id in message.message
    assert len(message.message) < 600
    assert path.with_name("record.damaged-1.json").read_text() == BAD_RECORDS[what]
    assert (path.parent / "case.carina").read_bytes() == before
    record = records.find(case_id)
    assert record.digest == "ab" * 32
    assert record.used_s - record.begun_s == pytest.approx(60.0)
    # The message is shown once.
    events.clear()
    assert [row.recent_id for row in cases.listed()] == [case_id]
    assert events == []


def test_case_record_damaged_again_is_moved_to_a_second_file(records, case_id):
    for number in (1, 2):
        path = spoil(records, case_id, f"{number}")
        repair_records(records)
        assert path.with_name(f"record.damaged-{number}.json").read_text() == f"{number}"


def test_case_without_any_readable_file_is_moved_with_all_its_files(records, case_id):
    path = spoil(records, case_id, "[]")
    (path.parent / "case.carina").write_bytes(b"SQLite format 3\x00" + bytes(4000))
    rows, (message,), _, _ = listed(records)
    assert rows == ()
    moved = records.folder / ASIDE / f"{case_id}-1"
    assert sorted(p.name for p in moved.iterdir()) == ["case.carina", "lock", "record.json"]
    assert f"{ASIDE}/{case_id}-1" in message.message
    assert listed(records)[1] == []


def test_unreadable_record_of_a_case_open_in_another_process_is_unchanged(records, case_id):
    held = records.hold(records.find(case_id))
    path = spoil(records, case_id, "[]")
    # The locks of two file descriptors of one process exclude each other like those of two processes.
    assert repair_records(records) == ()
    assert path.read_text() == "[]"
    held.release()
    assert len(repair_records(records)) == 1


def test_case_record_of_a_newer_carina_is_unchanged(records, case_id):
    text = json.dumps({"format": "carina-record", "version": VERSION + 1, "anything": [1]})
    path = spoil(records, case_id, text)
    assert repair_records(records) == ()
    assert path.read_text() == text


def test_case_record_with_unknown_fields_of_a_newer_carina_is_readable(records, case_id):
    path = records.folder / case_id / "record.json"
    plain = json.loads(path.read_text())
    path.write_text(json.dumps({**plain, "colour": "red"}))
    assert records.find(case_id).place == "/scans/ct"
    assert repair_records(records) == ()


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="modes of POSIX, and not for root")
def test_case_record_without_read_permission_is_unchanged(records, case_id):
    path = spoil(records, case_id, "[]")
    path.chmod(0)
    assert repair_records(records) == ()


NUMBERS = ("begun_s", "used_s", "copied_s", "pictured_s", "forgotten_s")


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan, 1e300, -1.0])
def test_case_record_written_with_extreme_values_can_be_read_again(records, case_id, name, value):
    held = records.hold(records.find(case_id))
    held.note(**{name: value}, alias="x" * 5000 + "\x1b[2J")
    held.release()
    text = (records.folder / case_id / "record.json").read_text()
    json.loads(text, parse_constant=pytest.fail)
    record = records.find(case_id)
    assert getattr(record, name) == (1e11 if value == 1e300 else 0.0)
    assert len(record.alias) == 1000
    assert repair_records(records) == ()


@pytest.mark.parametrize("name", [field for field in CaseRecord.__struct_fields__ if field != "holds_ct"])
@pytest.mark.parametrize("value", [1e300, -1, "x" * 5000, [], {}, True])
def test_case_whose_record_has_a_field_out_of_bounds_is_listed_with_one_message(records, case_id, name, value):
    path = records.folder / case_id / "record.json"
    plain = json.loads(path.read_text())
    path.write_text(json.dumps({**plain, name: value}))
    rows, messages, _, _ = listed(records)
    assert [row.recent_id for row in rows] == [case_id]
    assert len(messages) == 1


@pytest.mark.parametrize("text", ["", "[]", "7", "{", "[" * 100_000, '{"cases": NaN}', " " * (5 << 20), "\ud800"])
@pytest.mark.parametrize("name", ["recent.json", "notice.json", "storage.json"])
def test_unreadable_settings_file_is_moved_aside_with_one_message(records, tmp_path, name, text):
    store = LocalStore(tmp_path)
    content = text.encode(errors="surrogatepass")
    (tmp_path / name).write_bytes(content)
    rows, messages, _, _ = listed(records, store)
    assert rows == ()
    (message,) = messages
    assert name in message.message
    stem = name.removesuffix(".json")
    assert (tmp_path / f"{stem}.damaged-1.json").read_bytes() == content
    assert not (tmp_path / name).exists()
    assert (store.notice_accepted(), store.keeps_cts()) == (False, True)
    store.accept_notice()
    store.keep_cts(False)
    store.remember("/scans/ct", "2026-01-31")
    assert listed(records, LocalStore(tmp_path))[1] == []
    assert [one.path for one in LocalStore(tmp_path).recent()] == ["/scans/ct"]


@pytest.mark.parametrize("cases", [5, "text", None, {"a": 1}, [5], [None], [[]], [{"recent_id": 1}]])
def test_recent_list_file_with_unexpected_content_gives_an_empty_list(tmp_path, cases):
    (tmp_path / "recent.json").write_text(json.dumps({"cases": cases}))
    assert LocalStore(tmp_path).recent() == ()


def test_recent_ct_with_a_too_long_text_is_omitted_from_the_list(tmp_path):
    store = LocalStore(tmp_path)
    store.remember("/scans/ct", "2026-01-31")
    plain = json.loads((tmp_path / "recent.json").read_text())
    plain["cases"].append({**plain["cases"][0], "path": "x" * 20_000_000})
    (tmp_path / "recent.json").write_text(json.dumps(plain)[: 4 << 20])
    assert LocalStore(tmp_path).recent() == ()
    plain["cases"][-1]["path"] = "x" * 5000
    (tmp_path / "recent.json").write_text(json.dumps(plain))
    assert len(LocalStore(tmp_path).recent()) == 1


@pytest.mark.parametrize("text", ["", "[]", "[" * 100_000, '{"format": "carina-door", "version": 1, "url": 5}'])
def test_damaged_connection_details_of_a_case_are_ignored(tmp_path, text):
    (tmp_path / "door.json").write_text(text)
    assert read_endpoint(tmp_path) is None


def test_cases_command_lists_the_repaired_case_with_the_message(monkeypatch, tmp_path, capfd):
    for name, folder in user_folders(tmp_path).items():
        monkeypatch.setenv(name, folder)
    records = CaseRecords(load_settings().cases_dir, lambda: NOW_S)
    held = records.begin("ab" * 32, None)
    with CaseFile.create(held.path, SourceFacts.of(small_volume(), "ab" * 32)):
        pass
    held.release()
    spoil(records, held.record.case_id, BAD_RECORDS["infinity"])
    assert list_cases(as_json=True) == 0
    out, err = capfd.readouterr()
    assert [one["id"] for one in json.loads(out)["cases"]] == [held.record.case_id]
    assert "was damaged" in err


def test_every_number_and_text_of_a_case_record_has_a_type_with_limits():
    for field in msgspec.structs.fields(CaseRecord):
        assert field.type not in {int, float, str}, field.name
