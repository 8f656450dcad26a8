"""Tests of saving recorded flights to another file while the disk of the case fails."""

from __future__ import annotations

import threading

import pytest
from sample_case import ActiveCase, assert_same_moment
from test_case_contents import flown

from carina.case import CaseFile, SourceFacts
from carina.case.recordings import RecordingFacts, RecordingWriter
from carina.errors import DiskError
from carina.session import case_files
from carina.session.store.flight_copies import whole_flights
from carina.session.store.interfaces import WholeCase
from carina.volume import ct_digest

WITHIN_S = 60.0


class Refusing:
    """Case file on a disk that refuses all writes; reads wait for the event ``may_read``."""

    def __init__(self, file):
        self._file = file
        self.may_read = threading.Event()
        self.may_read.set()

    def recording_text(self, recording_id):
        self.may_read.wait()
        return self._file.recording_text(recording_id)


@pytest.fixture
def active_case():
    return ActiveCase()


@pytest.fixture
def file(active_case, tmp_path):
    source = SourceFacts.of(active_case.case.volume, ct_digest(active_case.case.volume))
    with CaseFile.create(tmp_path / "live.carina", source) as file:
        file.save(active_case.moment())
        yield file


def facts_of(writer, number):
    return RecordingFacts(number, writer.name, "", writer.begun_s, 4.9, complete=writer.closed)


def test_flights_in_the_file_and_flights_in_memory_are_written_to_another_file(file, active_case, tmp_path):
    flown(file, active_case)
    (recording,) = file.recordings()
    lines = file.recording_text(recording.recording_id).splitlines(keepends=True)
    # The file has half of the second flight; the rest of it, and all of the third, are in memory.
    half = RecordingWriter("half", 20.0, number=2)
    half.write("".join(lines[:20]))
    file.keep_recording(half)
    half.write("".join(lines[20:]))
    half.close()
    waiting = RecordingWriter("waiting", 30.0, number=3)
    waiting.write("".join(lines))
    waiting.close()
    listed = [facts_of(waiting, 3), recording, facts_of(half, 2)]

    flights, num_missing = whole_flights(Refusing(file), listed, [half, waiting], WITHIN_S)
    assert num_missing == 0
    place = tmp_path / "elsewhere.carina"
    whole = WholeCase(active_case.case.volume, file.source.digest, active_case.moment(), flights)
    case_files().write(place, whole, None, None, None)
    with CaseFile.open(place, read_only=True) as copy:
        assert_same_moment(copy.load(active_case.case.volume), active_case.moment(), active_case.case, deep=False)
        assert [(one.recording_id, one.name, one.complete) for one in copy.recordings()] == [
            (3, "waiting", True),
            (1, "first flight", True),
            (2, "half", True),
        ]
        for number in (1, 2, 3):
            assert copy.recording_text(number) == "".join(lines)
            assert copy.recording(number).complete


def test_flights_on_an_unresponsive_disk_are_counted_as_missing_without_waiting(file, active_case):
    flown(file, active_case)
    (recording,) = file.recordings()
    waiting = RecordingWriter("waiting", 30.0, number=2)
    waiting.write("a line\n")
    refusing = Refusing(file)
    refusing.may_read.clear()
    flights, num_missing = whole_flights(refusing, [recording, facts_of(waiting, 2)], [waiting], 0.2)
    refusing.may_read.set()
    assert [(one.facts.name, one.text) for one in flights] == [("waiting", "a line\n")]
    assert num_missing == 1


def test_flight_parts_written_to_the_disk_during_the_copy_are_not_duplicated(file, active_case):
    writer = RecordingWriter("flight", 1.0, number=1)
    writer.write('{"t": 0.0}\n')
    file.keep_recording(writer)
    writer.write('{"t": 1.5}\n')

    class Healing(Refusing):
        def recording_text(self, recording_id):
            # The disk accepts the buffered rest after the list of buffered pieces was read.
            self._file.keep_recording(writer)
            return self._file.recording_text(recording_id)

    ((whole,), num_missing) = whole_flights(Healing(file), [facts_of(writer, 1)], [writer], WITHIN_S)
    assert whole.text == '{"t": 0.0}\n{"t": 1.5}\n'
    assert num_missing == 0


def test_readable_flights_are_copied_despite_an_unreadable_flight(file, active_case):
    class Damaged(Refusing):
        def recording_text(self, recording_id):
            raise DiskError("cannot read the case", code="disk.error")

    waiting = RecordingWriter("waiting", 30.0, number=2)
    lost = RecordingFacts(1, "lost", "", 1.0, 2.0, complete=True)
    flights, num_missing = whole_flights(Damaged(file), [lost, facts_of(waiting, 2)], [waiting], WITHIN_S)
    assert ([one.facts.name for one in flights], num_missing) == (["waiting"], 1)
    assert whole_flights(None, [lost], [], WITHIN_S) == ((), 1)
