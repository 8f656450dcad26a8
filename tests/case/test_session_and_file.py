"""A session over a real case file: real edits, folded steps, a crash, and undo as if nothing had happened."""

from __future__ import annotations

import sqlite3

import numpy as np
import pytest
from edit_case import edit_case
from kept_case import assert_same_document, assert_same_measures

from carina.case import CaseFile, KeptAirways
from carina.case.recordings import RecordingTable
from carina.commands import (
    AddTarget,
    BeginAnew,
    CloseCase,
    DescribeFlight,
    EditTree,
    FlightToTakeAway,
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
from carina.session import Said, Session, Trouble
from carina.session.case_files import case_files
from carina.session.editing import NUM_EDITS_WHOLE
from carina.session.records import CaseRecords
from carina.session.snapshot import FlightPlace
from carina.track import CutBranch, PaintLumen, RenameBranch, edit_airways, measure_tree
from small_case import Background, Clock, SmallRenderer, small_parts

EVENTS = []
"""Of each session, in turn."""


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
    assert [e.message for e in events if isinstance(e, Trouble)] == []
    return session, background


def worked(session, background):
    """More steps than are kept whole."""
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
def test_undo_after_reopening_comes_to_every_step_as_it_does_without(tmp_path, is_killed):
    session, background = started(tmp_path)
    worked(session, background)
    assert session._saving.write_now()
    if is_killed:
        # Nothing more is written; the system gives the lock back, and the journal stays.
        kept = session._saving._kept
        kept.held.release()
        session._saving._kept = None
        kept.file._connection = None
    else:
        # It stays open to be compared with; its file goes.
        kept = session._saving._kept
        session._saving._kept = None
        kept.file.close()
        kept.held.release()
    again, other_background = started(tmp_path)
    assert again.history() == session.history()
    assert any(isinstance(d.airways, KeptAirways) for d in again._core.case.history.documents())
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


# ------------------------------------------------------------ measures


class Measuring:
    """Measures, and counts how often."""

    def __init__(self):
        self.asked = []

    def __call__(self, volume, airways, **options):
        self.asked.append(airways)
        return measure_tree(volume, airways, **options)


def measures_of_steps(session, background):
    """What each step shows that undo comes to, the newest first."""
    found = [session.snapshot().measures]
    while session.snapshot().undo_label is not None:
        session.undo()
        background.run_all()
        found.append(session.snapshot().measures)
    return found


def test_what_was_measured_is_not_measured_again_by_undo_or_after_reopening(tmp_path):
    measuring = Measuring()
    session, background = started(tmp_path, measuring)
    worked(session, background)
    num_edits = NUM_EDITS_WHOLE + 4
    # Names change no measure.
    assert num_edits // 2 < len(measuring.asked) <= 1 + num_edits
    measuring.asked.clear()
    session.close()
    again, background = started(tmp_path, measuring)
    found = measures_of_steps(again, background)
    assert measuring.asked == []
    assert all(measures is not None for measures in found)
    for _ in range(num_edits):
        again.redo()
        background.run_all()
    assert measuring.asked == []
    assert_same_measures(again.snapshot().measures, found[2])
    # An edit goes on from them: what it leaves alone is as it was.
    again.do(EditTree(CutBranch(again.snapshot().document.airways.tree.tips()[0].id)))
    background.run_all()
    newest, before = again.snapshot().measures, found[2]
    assert len(measuring.asked) == 1
    left = {b.branch_id for b in newest.branches}
    edges = {b.branch_id: b.edge_mm for b in before.branches}
    assert sum(np.array_equal(b.edge_mm, edges[b.branch_id], equal_nan=True) for b in newest.branches) == len(left)
    again.close()


def test_measures_that_are_damaged_are_made_again_and_that_is_said(tmp_path):
    measuring = Measuring()
    session, background = started(tmp_path, measuring)
    worked(session, background)
    expected = session.snapshot().measures
    session.close()
    measuring.asked.clear()
    (live,) = tmp_path.glob("cases/*/case.carina")
    connection = sqlite3.connect(live)
    connection.execute("UPDATE measures SET facts = '{}'")
    connection.commit()
    connection.close()
    again, background = started(tmp_path, measuring)
    assert len(measuring.asked) == 1
    told = [e.message for e in EVENTS[-1] if isinstance(e, Said)]
    assert any(
        "the saved measurements of the airways cannot be read, so the airways will be measured" in words
        for words in told
    )
    # Made from nothing; edits had gone on from those before.
    found = again.snapshot().measures
    assert [b.branch_id for b in found.branches] == [b.branch_id for b in expected.branches]
    assert again._saving.write_now()
    again.close()
    measuring.asked.clear()
    again, background = started(tmp_path, measuring)
    assert measuring.asked == []
    again.close()


def test_a_live_case_of_an_older_carina_goes_on_and_lies_beside_as_it_was(tmp_path):
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
    measuring.asked.clear()
    again, background = started(tmp_path, measuring)
    assert again.snapshot().undo_label == label
    assert_same_document(document(again), before, edit_case())
    assert len(measuring.asked) == 1
    assert (live.parent / "case-schema-1.carina").exists()
    again.close()
    measuring.asked.clear()
    again, background = started(tmp_path, measuring)
    assert measuring.asked == []
    again.close()


# ------------------------------------------------------------ recordings


def flown(session, clock, seconds):
    """Ten moves a second."""
    for _ in range(10 * seconds):
        clock.now_s += 0.1
        session.do(Steer(0.5, 0.01, 0.02, 0.0))


def live_file(tmp_path):
    (live,) = tmp_path.glob("cases/*/case.carina")
    return live


def test_a_flight_is_recorded_into_the_case_and_flown_again_bit_for_bit(tmp_path):
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
    # A case that is closed ends its recording.
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
    # Numbers go on where they were.
    again, _ = started(tmp_path)
    again.do(RecordFlight())
    assert again.devices.recording_name == "Flight 4"
    again.close()


def test_of_a_recording_that_a_crash_ended_all_but_the_last_moments_is_there(tmp_path, monkeypatch):
    session, _ = started(tmp_path)
    session.do(RecordFlight())
    flown(session, session._core.clock, 4)
    assert session._saving.write_now()
    # Nothing more is written, however long it takes until the file is read.
    monkeypatch.setattr(session._saving._kept, "changed", lambda _topics: None)
    flown(session, session._core.clock, 1)
    with CaseFile.open(live_file(tmp_path), read_only=True) as file:
        (told,) = file.recordings()
        assert (told.name, told.complete) == ("Flight 1", False)
        assert told.length_s == pytest.approx(4.0)
        recording = file.recording(told.recording_id)
        assert not recording.complete
        assert all(same for _, same in recording.replay(edit_case().volume))
    session.close()


def test_another_case_ends_the_recording_of_the_one_that_was_open(tmp_path):
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


def test_a_recording_that_the_disk_refuses_waits_in_memory(tmp_path, monkeypatch):
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
        (told,) = file.recordings()
        assert (told.complete, round(told.length_s, 6)) == (True, 4.0)
    session.close()


def test_a_case_that_is_not_kept_holds_no_recording(tmp_path):
    session = Session(SmallRenderer, parts=small_parts(), submit=(background := Background()), clock=Clock())
    session.do(OpenPath("case"))
    background.run_all()
    with pytest.raises(UsageError, match="not stored on this machine"):
        session.do(RecordFlight())
    assert session.devices.recording_name is None


# ------------------------------------------------------------ the list of flights


def listed(session):
    return [(one.number, one.name, one.words, one.state) for one in session.snapshot().flights]


def recorded(session, seconds=1):
    session.do(RecordFlight())
    flown(session, session._core.clock, seconds)
    session.do(StopRecording())


def test_flights_are_named_described_ordered_and_deleted_and_so_they_are_when_the_case_is_opened_again(tmp_path):
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
    # The one that is being recorded can be named, and not be deleted.
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
    text = session.ask(FlightToTakeAway(1))
    with pytest.raises(UsageError, match="has been removed"):
        session.ask(FlightToTakeAway(2))
    before = session.snapshot().flights
    session.close()
    with CaseFile.open(live_file(tmp_path), read_only=True) as file:
        assert [(one.recording_id, one.name, one.words) for one in file.recordings()] == [f[:3] for f in found]
        assert file.recording_text(1) == text
    again, _ = started(tmp_path)
    assert listed(again) == found
    assert [one.begun_s for one in again.snapshot().flights] == pytest.approx([one.begun_s for one in before])
    # A number is never given twice, though the flight that had it has gone.
    recorded(again)
    assert listed(again)[-1] == (5, "Flight 5", "", "complete")
    again.do(CloseCase())
    assert listed(again) == []
    again.close()


def test_a_flight_that_a_crash_cut_off_is_listed_as_such_and_taken_away_as_far_as_it_came(tmp_path):
    session, _ = started(tmp_path)
    session.do(RecordFlight())
    flown(session, session._core.clock, 2)
    assert session._saving.write_now()
    # Nothing more is written; the system gives the lock back, and the journal stays.
    kept = session._saving._kept
    kept.held.release()
    session._saving._kept = None
    kept.file._connection = None
    again, _ = started(tmp_path)
    (flight,) = again.snapshot().flights
    assert (flight.name, flight.state) == ("Flight 1", "cut-off")
    assert flight.length_s == pytest.approx(2.0)
    (tmp_path / "flight.jsonl").write_text(again.ask(FlightToTakeAway(1)))
    assert not open_recording(tmp_path / "flight.jsonl").complete
    recorded(again)
    assert [one.number for one in again.snapshot().flights] == [1, 2]
    again.close()


def test_a_flight_is_flown_again_where_it_went_until_a_hand_moves_the_tip(tmp_path):
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
    assert session.pose_info().pose is last, "nothing is under way that could go on"
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


def test_a_hand_that_moves_while_a_flight_is_read_is_not_thrown_back(tmp_path):
    session, background = started(tmp_path)
    recorded(session)
    session.do(FlyFlight(1, 0.0))
    session.do(Steer(0.5, 0.0, 0.0, 0.0))
    here = session.pose_info()
    background.run_all()
    assert session.pose_info() == here
    session.close()


def test_what_is_done_to_flights_while_the_disk_refuses_is_written_later(tmp_path, monkeypatch):
    session, _ = started(tmp_path)
    recorded(session)
    recorded(session)
    assert session._saving.write_now()
    with monkeypatch.context() as broken:
        broken.setattr(RecordingTable, "become", refused)
        broken.setattr(RecordingTable, "add", refused)
        recorded(session)
        session.do(RemoveFlight(1))
        session.do(RenameFlight(2, "kept"))
        # Before any of it came to the disk.
        session.do(RemoveFlight(3))
        assert not session._saving.write_now()
        with pytest.raises(CarinaError, match="the disk is full"):
            session.ask(FlightToTakeAway(2))
    session._core.clock.now_s += 60.0
    assert session._saving.write_now()
    with CaseFile.open(live_file(tmp_path), read_only=True) as file:
        assert [(one.recording_id, one.name) for one in file.recordings()] == [(2, "kept")]
    session.close()
