"""Tests of a session with a real case file: edits, compressed steps, crashes, and undo after reopening."""

from __future__ import annotations

import sqlite3

import numpy as np
import pytest
from edit_case import edit_case
from sample_case import assert_same_document, assert_same_measures

from carina.case import CaseFile, StoredAirways
from carina.case.recordings import RecordingTable
from carina.commands import (
    AddTarget,
    BeginAnew,
    CloseCase,
    DescribeFlight,
    EditTree,
    FlightFileQuery,
    FlyFlight,
    MoveFlight,
    OpenPath,
    RecordFlight,
    RemoveFlight,
    RenameFlight,
    SetFov,
    Steer,
    StopRecording,
)
from carina.errors import CarinaError, DiskError, UsageError
from carina.navigate import open_recording
from carina.render import transfer_preset
from carina.session import ErrorEvent, Session, UserMessage
from carina.session.airways.editing import NUM_EDITS_WHOLE
from carina.session.state.snapshot import FlightPlace
from carina.session.store.disk_storage import case_files
from carina.session.store.registry import CaseRecords
from carina.track import CutBranch, PaintLumen, RenameBranch, edit_airways, measure_tree
from small_case import Background, Clock, SmallRenderer, small_parts

EVENTS = []
"""Lists of received events, one list for each session, in the order in which the sessions started."""


def started(folder, measure=None):
    case = edit_case()
    background = Background()
    session = Session(
        SmallRenderer,
        parts=small_parts(
            open_volume=lambda _path, _progress, _cancel: case.volume,
            find_airways=lambda _volume, **_options: case.airways,
            edit_airways=edit_airways,
            transfer_preset=transfer_preset,
            measure_tree=measure,
        ),
        submit=background,
        clock=Clock(),
        records=CaseRecords(folder / "cases", lambda: 1_800_000_000.0),
        files=case_files(),
    )
    events = []
    EVENTS.append(events)
    session.subscribe(events.append)
    session.do(OpenPath("case"))
    background.run_all()
    assert [e.message for e in events if isinstance(e, ErrorEvent)] == []
    return session, background


def worked(session, background):
    """Perform more edits than the number of steps that are stored uncompressed."""
    case = edit_case()
    for n in range(NUM_EDITS_WHOLE + 4):
        tip = case.tips[n % 4] + 0.4 * n * np.array([0.3, 0.1, 1.0])
        edit = PaintLumen((tuple(float(v) for v in tip),), 1.5, "ball", erase=n % 3 == 2)
        session.do(EditTree(edit if n % 4 else RenameBranch(3, f"mine {n}")))
        background.run_all()
    session.do(AddTarget(tuple(float(v) for v in case.tips[1])))
    background.run_all()
    session.do(SetFov(100.0))


def document(session):
    return session.snapshot().document


@pytest.mark.parametrize("is_killed", [False, True])
def test_undo_steps_after_reopening_equal_those_without_reopening(tmp_path, is_killed):
    session, background = started(tmp_path)
    worked(session, background)
    assert session._saving.write_now()
    if is_killed:
        # Simulate a kill: nothing more is written, the lock is released, and the journal stays.
        saver = session._saving._saver
        saver.held.release()
        session._saving._saver = None
        saver.file._connection = None
    else:
        # Close the file; the session itself stays open for the comparison.
        saver = session._saving._saver
        session._saving._saver = None
        saver.file.close()
        saver.held.release()
    again, other_background = started(tmp_path)
    assert again.history() == session.history()
    assert any(isinstance(d.airways, StoredAirways) for d in again._core.case.history.documents())
    for one in (session, again):
        one.do(EditTree(RenameBranch(2, "after")))
    background.run_all()
    other_background.run_all()
    while session.snapshot().undo_label is not None:
        assert_same_document(document(again), document(session), edit_case())
        assert again.snapshot().undo_label == session.snapshot().undo_label
        for one, others in ((session, background), (again, other_background)):
            one.undo()
            others.run_all()
    assert again.snapshot().undo_label is None
    for _ in range(3):
        session.redo()
        again.redo()
    assert_same_document(document(again), document(session), edit_case())
    assert again._saving.write_now()
    again.close()


# Measures of the airways


class Measuring:
    """Wrapper of ``measure_tree`` that records its calls."""

    def __init__(self):
        self.requested = []

    def __call__(self, volume, airways, **options):
        self.requested.append(airways)
        return measure_tree(volume, airways, **options)


def measures_of_steps(session, background):
    """Return the measures that each undo step shows, newest first."""
    found = [session.snapshot().measures]
    while session.snapshot().undo_label is not None:
        session.undo()
        background.run_all()
        found.append(session.snapshot().measures)
    return found


def test_undo_and_reopening_do_not_repeat_the_measurement_of_branches(tmp_path):
    measuring = Measuring()
    session, background = started(tmp_path, measuring)
    worked(session, background)
    num_edits = NUM_EDITS_WHOLE + 4
    # Renaming a branch needs no measurement.
    assert num_edits // 2 < len(measuring.requested) <= 1 + num_edits
    measuring.requested.clear()
    session.close()
    again, background = started(tmp_path, measuring)
    found = measures_of_steps(again, background)
    assert measuring.requested == []
    assert all(measures is not None for measures in found)
    for _ in range(num_edits):
        again.redo()
        background.run_all()
    assert measuring.requested == []
    assert_same_measures(again.snapshot().measures, found[2])
    # An edit reuses the measures of all branches that it does not change.
    again.do(EditTree(CutBranch(again.snapshot().document.airways.tree.tips()[0].id)))
    background.run_all()
    newest, before = again.snapshot().measures, found[2]
    assert len(measuring.requested) == 1
    left = {b.branch_id for b in newest.branches}
    edges = {b.branch_id: b.edge_mm for b in before.branches}
    assert sum(np.array_equal(b.edge_mm, edges[b.branch_id], equal_nan=True) for b in newest.branches) == len(left)
    again.close()


def test_damaged_stored_measurements_are_computed_again_with_a_message(tmp_path):
    measuring = Measuring()
    session, background = started(tmp_path, measuring)
    worked(session, background)
    expected = session.snapshot().measures
    session.close()
    measuring.requested.clear()
    (live,) = tmp_path.glob("cases/*/case.carina")
    connection = sqlite3.connect(live)
    connection.execute("UPDATE measures SET facts = '{}'")
    connection.commit()
    connection.close()
    again, background = started(tmp_path, measuring)
    assert len(measuring.requested) == 1
    reported = [e.message for e in EVENTS[-1] if isinstance(e, UserMessage)]
    assert any(
        "the saved measurements of the airways cannot be read, so the airways will be measured" in text
        for text in reported
    )
    # All branches were measured again, so only their IDs are compared.
    found = again.snapshot().measures
    assert [b.branch_id for b in found.branches] == [b.branch_id for b in expected.branches]
    assert again._saving.write_now()
    again.close()
    measuring.requested.clear()
    again, background = started(tmp_path, measuring)
    assert measuring.requested == []
    again.close()


def test_live_case_of_an_older_version_is_migrated_and_the_original_file_is_retained(tmp_path):
    measuring = Measuring()
    session, background = started(tmp_path, measuring)
    worked(session, background)
    before, label = document(session), session.snapshot().undo_label
    session.close()
    (live,) = tmp_path.glob("cases/*/case.carina")
    connection = sqlite3.connect(live, isolation_level=None)
    for statement in ("DROP TABLE measures", "DROP TABLE measured_branch", "DROP TABLE sections"):
        connection.execute(statement)
    connection.execute("PRAGMA user_version=1")
    connection.close()
    measuring.requested.clear()
    again, background = started(tmp_path, measuring)
    assert again.snapshot().undo_label == label
    assert_same_document(document(again), before, edit_case())
    assert len(measuring.requested) == 1
    assert (live.parent / "case-schema-1.carina").exists()
    again.close()
    measuring.requested.clear()
    again, background = started(tmp_path, measuring)
    assert measuring.requested == []
    again.close()


# Recordings


def flown(session, clock, seconds):
    """Record a flight of ``seconds`` with ten moves per second in the session."""
    for _ in range(10 * seconds):
        clock.now_s += 0.1
        session.do(Steer(0.5, 0.01, 0.02, 0.0))


def live_file(tmp_path):
    (live,) = tmp_path.glob("cases/*/case.carina")
    return live


def test_flight_is_recorded_into_the_case_and_replayed_bit_for_bit(tmp_path):
    session, _ = started(tmp_path)
    clock = session._core.clock
    for n in (1, 2):
        session.do(RecordFlight())
        assert session.devices.recording_name == f"Flight {n}"
        flown(session, clock, 3)
        session.do(StopRecording())
        assert session.devices.recording_name is None
    session.do(RecordFlight())
    flown(session, clock, 1)
    # Closing the case ends its recording.
    session.do(CloseCase())
    session.close()
    with CaseFile.open(live_file(tmp_path)) as file:
        assert [(r.name, r.complete, round(r.length_s, 6)) for r in file.recordings()] == [
            ("Flight 1", True, 3.0), ("Flight 2", True, 3.0), ("Flight 3", True, 1.0),
        ]  # fmt: skip
        recording = file.recording(1)
        replayed = list(recording.replay(edit_case().volume))
        (tmp_path / "flight.jsonl").write_text(file.recording_text(1))
    assert len(replayed) > 25
    assert all(same for _, same in replayed)
    assert open_recording(tmp_path / "flight.jsonl").lines == recording.lines
    # The numbering of flights continues.
    again, _ = started(tmp_path)
    again.do(RecordFlight())
    assert again.devices.recording_name == "Flight 4"
    again.close()


def test_recording_interrupted_by_a_crash_lacks_only_its_last_seconds(tmp_path, monkeypatch):
    session, _ = started(tmp_path)
    session.do(RecordFlight())
    flown(session, session._core.clock, 4)
    assert session._saving.write_now()
    # Nothing more is written before the file is read.
    monkeypatch.setattr(session._saving._saver, "changed", lambda _topics: None)
    flown(session, session._core.clock, 1)
    with CaseFile.open(live_file(tmp_path), read_only=True) as file:
        (listed,) = file.recordings()
        assert (listed.name, listed.complete) == ("Flight 1", False)
        assert listed.length_s == pytest.approx(4.0)
        recording = file.recording(listed.recording_id)
        assert not recording.complete
        assert all(same for _, same in recording.replay(edit_case().volume))
    session.close()


def test_opening_another_case_ends_the_recording(tmp_path):
    session, background = started(tmp_path)
    session.do(RecordFlight())
    flown(session, session._core.clock, 2)
    session.do(BeginAnew())
    background.run_all()
    assert session.devices.recording_name is None
    session.do(RecordFlight())
    assert session.devices.recording_name == "Flight 1"
    flown(session, session._core.clock, 1)
    session.do(StopRecording())
    session.close()
    lengths = []
    for live in tmp_path.glob("cases/*/case.carina"):
        with CaseFile.open(live, read_only=True) as file:
            lengths += [(one.name, one.complete, round(one.length_s, 6)) for one in file.recordings()]
    assert sorted(lengths) == [("Flight 1", True, 1.0), ("Flight 1", True, 2.0)]


def refused(*_arguments, **_options):
    raise DiskError("the disk is full", code="disk.full")


def test_recording_is_retained_in_memory_if_the_disk_does_not_store_it(tmp_path, monkeypatch):
    session, _ = started(tmp_path)
    session.do(RecordFlight())
    flown(session, session._core.clock, 2)
    with monkeypatch.context() as broken:
        broken.setattr(RecordingTable, "add", refused)
        assert not session._saving.write_now()
        flown(session, session._core.clock, 2)
        session.do(StopRecording())
    session._core.clock.now_s += 60.0
    assert session._saving.write_now()
    with CaseFile.open(live_file(tmp_path), read_only=True) as file:
        (recording,) = file.recordings()
        assert (recording.complete, round(recording.length_s, 6)) == (True, 4.0)
    session.close()


def test_recording_is_unavailable_for_a_case_without_a_file(tmp_path):
    session = Session(SmallRenderer, parts=small_parts(), submit=(background := Background()), clock=Clock())
    session.do(OpenPath("case"))
    background.run_all()
    with pytest.raises(UsageError, match="not stored on this machine"):
        session.do(RecordFlight())
    assert session.devices.recording_name is None


# List of flights


def listed(session):
    return [(one.number, one.name, one.words, one.state) for one in session.snapshot().flights]


def recorded(session, seconds=1):
    session.do(RecordFlight())
    flown(session, session._core.clock, seconds)
    session.do(StopRecording())


def test_names_descriptions_order_and_deletions_of_flights_are_restored_after_reopening(tmp_path):
    session, _ = started(tmp_path)
    assert listed(session) == []
    for seconds in (1, 2, 3):
        recorded(session, seconds)
    session.do(RecordFlight())
    assert [(one.length_s, one.state) for one in session.snapshot().flights] == [
        (pytest.approx(1.0), "complete"),
        (pytest.approx(2.0), "complete"),
        (pytest.approx(3.0), "complete"),
        (0.0, "recording"),
    ]
    # The flight that is being recorded can be renamed but not deleted.
    session.do(RenameFlight(4, "  the fourth "))
    assert session.devices.recording_name == "the fourth"
    with pytest.raises(UsageError, match="the fourth is still being recorded"):
        session.do(RemoveFlight(4))
    with pytest.raises(UsageError, match="needs a name"):
        session.do(RenameFlight(4, "   "))
    session.do(StopRecording())
    label = session.snapshot().undo_label
    session.do(RenameFlight(1, "to the nodule"))
    session.do(DescribeFlight(1, "second attempt,\nwithout contact"))
    session.do(MoveFlight(3, -100))
    session.do(RemoveFlight(2))
    for command in (RenameFlight(2, "gone"), MoveFlight(2, 1), RemoveFlight(2), DescribeFlight(9, "")):
        with pytest.raises(UsageError, match="has been removed"):
            session.do(command)
    assert session.snapshot().undo_label == label, "flights are no steps of the history"
    found = [
        (3, "Flight 3", "", "complete"),
        (1, "to the nodule", "second attempt,\nwithout contact", "complete"),
        (4, "the fourth", "", "complete"),
    ]
    assert listed(session) == found
    text = session.ask(FlightFileQuery(1))
    with pytest.raises(UsageError, match="has been removed"):
        session.ask(FlightFileQuery(2))
    before = session.snapshot().flights
    session.close()
    with CaseFile.open(live_file(tmp_path), read_only=True) as file:
        assert [(one.recording_id, one.name, one.words) for one in file.recordings()] == [f[:3] for f in found]
        assert file.recording_text(1) == text
    again, _ = started(tmp_path)
    assert listed(again) == found
    assert [one.begun_s for one in again.snapshot().flights] == pytest.approx([one.begun_s for one in before])
    # The number of a deleted flight is not used again.
    recorded(again)
    assert listed(again)[-1] == (5, "Flight 5", "", "complete")
    again.do(CloseCase())
    assert listed(again) == []
    again.close()


def test_flight_interrupted_by_a_crash_is_listed_as_incomplete_and_replayed_to_its_end(tmp_path):
    session, _ = started(tmp_path)
    session.do(RecordFlight())
    flown(session, session._core.clock, 2)
    assert session._saving.write_now()
    # Simulate a kill: nothing more is written, the lock is released, and the journal stays.
    saver = session._saving._saver
    saver.held.release()
    session._saving._saver = None
    saver.file._connection = None
    again, _ = started(tmp_path)
    (flight,) = again.snapshot().flights
    assert (flight.name, flight.state) == ("Flight 1", "cut-off")
    assert flight.length_s == pytest.approx(2.0)
    (tmp_path / "flight.jsonl").write_text(again.ask(FlightFileQuery(1)))
    assert not open_recording(tmp_path / "flight.jsonl").complete
    recorded(again)
    assert [one.number for one in again.snapshot().flights] == [1, 2]
    again.close()


def test_flight_is_replayed_from_the_selected_time_until_a_manual_move_of_the_tip(tmp_path):
    session, background = started(tmp_path)
    session.do(RecordFlight())
    first = session.pose_info().pose
    with pytest.raises(UsageError, match="still being recorded"):
        session.do(FlyFlight(1, 0.0))
    flown(session, session._core.clock, 1)
    middle = session.pose_info().pose
    flown(session, session._core.clock, 1)
    session.do(StopRecording())
    last = session.pose_info().pose
    session.do(FlyFlight(1, 0.5, goes_on=True))
    assert session.pose_info().pose is last, "there is no flight that could continue"
    session.do(FlyFlight(1, 0.0))
    background.run_all()
    assert session.pose_info().flight == FlightPlace(1, 0.0)
    assert np.array_equal(session.pose_info().pose.lps_from_camera, first.lps_from_camera)
    session.do(FlyFlight(1, 1.01, goes_on=True))
    assert np.array_equal(session.pose_info().pose.lps_from_camera, middle.lps_from_camera)
    session.do(FlyFlight(1, 99.0, goes_on=True))
    assert np.array_equal(session.pose_info().pose.lps_from_camera, last.lps_from_camera)
    assert session.pose_info().flight == FlightPlace(1, pytest.approx(2.0))
    session.do(Steer(0.5, 0.0, 0.0, 0.0))
    here = session.pose_info()
    assert here.flight is None
    session.do(FlyFlight(1, 1.0, goes_on=True))
    assert session.pose_info() == here
    with pytest.raises(UsageError, match="has been removed"):
        session.do(FlyFlight(2, 0.0))
    session.close()


def test_flight_that_is_still_being_read_does_not_undo_a_manual_move(tmp_path):
    session, background = started(tmp_path)
    recorded(session)
    session.do(FlyFlight(1, 0.0))
    session.do(Steer(0.5, 0.0, 0.0, 0.0))
    here = session.pose_info()
    background.run_all()
    assert session.pose_info() == here
    session.close()


def test_changes_of_flights_made_during_a_disk_failure_are_written_after_it(tmp_path, monkeypatch):
    session, _ = started(tmp_path)
    recorded(session)
    recorded(session)
    assert session._saving.write_now()
    with monkeypatch.context() as broken:
        broken.setattr(RecordingTable, "replace_list", refused)
        broken.setattr(RecordingTable, "add", refused)
        recorded(session)
        session.do(RemoveFlight(1))
        session.do(RenameFlight(2, "kept"))
        # The flight is deleted before any part of it is written to the disk.
        session.do(RemoveFlight(3))
        assert not session._saving.write_now()
        with pytest.raises(CarinaError, match="the disk is full"):
            session.ask(FlightFileQuery(2))
    session._core.clock.now_s += 60.0
    assert session._saving.write_now()
    with CaseFile.open(live_file(tmp_path), read_only=True) as file:
        assert [(one.recording_id, one.name) for one in file.recordings()] == [(2, "kept")]
    session.close()
