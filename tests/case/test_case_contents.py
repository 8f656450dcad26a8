"""Tests of the content of a case file beside its history: copies, recordings, plans, reports and the packed scan."""

from __future__ import annotations

import sqlite3
import stat

import numpy as np
import pytest
from sample_case import ActiveCase, act, assert_same_moment, source_of, whole

import carina
from carina.case import CaseFile, CaseFileError, SourceFacts
from carina.commands import Steer
from carina.errors import DiskError, UsageError
from carina.navigate import Navigator, Pilot, Recorder
from carina.scopes import Pose
from carina.session import CaseScans
from carina.volume import Volume, badges_of, ct_digest, write_grid
from carina.volume.inserted_structures import INSERTED, with_inserted


def some_case(num_acts=6, seed=5):
    active_case = ActiveCase()
    rng = np.random.default_rng(seed)
    for name in ("cut", "target", "key", "look", "paint", "undo", "target", "rename")[:num_acts]:
        act(active_case, name, lambda n: int(rng.integers(n)))
    return active_case


@pytest.fixture
def active_case():
    return some_case()


@pytest.fixture
def file(active_case, tmp_path):
    with CaseFile.create(tmp_path / "one.carina", source_of(active_case.case)) as file:
        file.save(active_case.moment())
        yield file


# Copies of a case file


def test_copy_of_a_case_file_is_one_file_with_equal_content(file, active_case, tmp_path):
    target = tmp_path / "named.carina"
    file.write_copy(target, ct_place="../ct")
    assert sorted(p.name for p in tmp_path.iterdir() if "named" in p.name) == ["named.carina"]
    # This version of the file format states that no WAL journal is used.
    assert target.read_bytes()[18:20] == b"\x01\x01"
    with CaseFile.open(target, read_only=True) as copy:
        assert_same_moment(copy.load(active_case.case.volume), active_case.moment(), active_case.case)
        assert copy.source.path == "../ct"
        with pytest.raises(CaseFileError, match="open for reading only"):
            copy.save(active_case.moment())
    # The original stays writable, and the copy can be overwritten.
    file.save(active_case.moment())
    file.write_copy(target)
    with CaseFile.open(target) as copy:
        assert copy.source.path is None


def test_copy_of_a_case_file_contains_no_deleted_undo_steps(tmp_path, active_case):
    with CaseFile.create(tmp_path / "one.carina", source_of(active_case.case)) as file:
        other = some_case(8, seed=9)
        file.save(other.moment())
        # The steps are replaced, so that the values used only by the first content become unreachable.
        file.save(active_case.moment())
        file.write_copy(tmp_path / "copy.carina")
    with CaseFile.create(tmp_path / "fresh.carina", source_of(active_case.case)) as fresh:
        fresh.save(active_case.moment())
    tables = ("value", "array", "branch", "tree", "tile", "lumen", "tracker", "airways", "route", "document", "step")
    counts = []
    for name in ("one", "copy", "fresh"):
        connection = sqlite3.connect(tmp_path / f"{name}.carina")
        counts.append([connection.execute(f"SELECT count(*) FROM {t}").fetchone()[0] for t in tables])
        connection.close()
    assert counts[0] == counts[1] == counts[2]
    with CaseFile.open(tmp_path / "one.carina") as file:
        assert_same_moment(file.load(active_case.case.volume), active_case.moment(), active_case.case)


def test_failed_copy_of_a_case_leaves_the_existing_file_unchanged(file, tmp_path):
    target = tmp_path / "named.carina"
    file.write_copy(target)
    before = target.read_bytes()
    with pytest.raises(DiskError, match="no such folder"):
        file.write_copy(tmp_path / "missing" / "named.carina")
    (tmp_path / "folder.carina").mkdir()
    with pytest.raises(DiskError, match="already exists"):
        file.write_copy(tmp_path / "folder.carina")
    assert target.read_bytes() == before


def test_new_case_file_is_readable_by_its_owner_only_and_never_replaces_a_file(file):
    assert stat.S_IMODE(file.path.stat().st_mode) == 0o600
    with pytest.raises(DiskError, match="already exists"):
        CaseFile.create(file.path, file.source)


def test_private_copy_of_a_case_is_readable_by_its_owner_only(file, tmp_path):
    file.write_copy(tmp_path / "live.carina", private=True)
    assert stat.S_IMODE((tmp_path / "live.carina").stat().st_mode) == 0o600


def test_path_of_the_scan_is_stored_relative_to_the_case_file(file, active_case):
    for absolute in ("/data/ct", "C:\\data\\ct", "\\\\share\\ct"):
        with pytest.raises(UsageError, match="relative"):
            SourceFacts.of(active_case.case.volume, "00", path=absolute)
    file.set_source_path("elsewhere/ct")
    assert file.source.path == "elsewhere/ct"
    assert file.source.choices == {"series": "1"}


# Recordings


def flown(file, active_case, *, num_seconds=5, closes=True):
    """Record a flight with ten moves per second in the case file; ``closes`` ends the recording."""
    pilot = Pilot(Navigator(Pose.looking((0.0, 0.0, 0.0), (0.0, 0.0, -1.0)), volume=active_case.case.volume))
    sink = file.record("first flight", begun_s=12.0)
    recorder = Recorder(pilot, sink, case={"digest": "00"}, carina="1", now_s=100.0, view={"shading": True})
    for n in range(10 * num_seconds):
        recorder.tick(100.0 + 0.1 * n)
        pilot.apply(Steer(0.5 + n, 0.01, 0.02, 0.0), dt_s=0.1)
        if n % 20 == 19:
            sink.keep()
    if closes:
        recorder.close()
    return recorder


def test_recording_is_stored_in_parts_of_one_second_and_can_be_replayed(file, active_case, tmp_path):
    flown(file, active_case)
    (facts,) = file.recordings()
    assert (facts.name, facts.begun_s, facts.complete) == ("first flight", 12.0, True)
    assert facts.length_s == pytest.approx(4.9)
    recording = file.recording(facts.recording_id)
    assert recording.complete
    replayed = list(recording.replay(active_case.case.volume))
    assert all(same for _, same in replayed)
    assert len(replayed) > 40
    connection = sqlite3.connect(file.path)
    assert 5 <= connection.execute("SELECT count(*) FROM recording_chunk").fetchone()[0] <= 8
    connection.close()


def test_interrupted_recording_contains_all_moves_up_to_its_last_stored_part(file, active_case):
    flown(file, active_case, closes=False)
    (facts,) = file.recordings()
    assert not facts.complete
    recording = file.recording(facts.recording_id)
    assert not recording.complete
    assert recording.length_s >= 3.9


def test_recordings_can_be_renamed_ordered_and_deleted(file, active_case):
    flown(file, active_case, num_seconds=1)
    flown(file, active_case, num_seconds=1)
    one, two = file.recordings()
    file.change_recording(one.recording_id, name="RB3, second try")
    file.change_recording(one.recording_id, words="the lens was fogged")
    file.order_recordings((2, 1))
    assert [r.recording_id for r in file.recordings()] == [2, 1]
    with pytest.raises(UsageError, match="each recording once"):
        file.order_recordings((2, 2))
    file.forget_recording(two.recording_id)
    assert [(r.recording_id, r.name, r.words) for r in file.recordings()] == [
        (1, "RB3, second try", "the lens was fogged")
    ]
    for call in (file.recording, file.forget_recording):
        with pytest.raises(UsageError, match="no recording 2"):
            call(2)
    file.write_copy(file.path.with_name("copy.carina"))
    with CaseFile.open(file.path.with_name("copy.carina"), read_only=True) as copy:
        assert copy.recording(1).complete


# Plans and reports


def test_plans_and_reports_are_read_back_from_the_case_file(file):
    assert file.extra("report") == ()
    file.set_extra("report", ({"words": "größer"}, [1.5, None]))
    file.set_extra("plan", ("one",))
    assert file.extra("report") == ({"words": "größer"}, [1.5, None])
    file.set_extra("report", ())
    assert (file.extra("report"), file.extra("plan")) == ((), ("one",))


# Scans with another order of the axes


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1), (1, 0, 2)])
def test_case_opened_with_permuted_axes_of_its_scan_has_equal_airways(file, active_case, order):
    volume = active_case.case.volume
    # The axes i, j, k of the new volume are permuted axes of the old one; the first is reversed.
    shape = volume.shape_zyx[::-1]
    columns = [volume.lps_from_ijk[:3, axis].copy() for axis in order]
    origin = volume.lps_from_ijk[:3, 3] + columns[0] * (shape[order[0]] - 1)
    columns[0] *= -1.0
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = np.column_stack(columns), origin
    values = volume.hu_zyx.transpose(tuple(2 - axis for axis in order[::-1]))[:, :, ::-1]
    turned = Volume(np.ascontiguousarray(values), matrix)
    moment = file.load(turned)
    found, expected = moment.history().current, active_case.document
    one, other = whole(found.airways, active_case.case), active_case.airways
    lumen_lps = [
        {tuple(p) for p in np.round(v.to_lps(np.argwhere(a.lumen_zyx)[:, ::-1].astype(float)), 3).tolist()}
        for v, a in ((turned, one), (volume, other))
    ]
    assert lumen_lps[0] == lumen_lps[1]
    for branch in other.tree.branches:
        np.testing.assert_array_equal(one.tree.branch(branch.id).points, branch.points)
    tip = expected.airways.tree.tips()[0].points[-1]
    ways = [a.tracker.path_to(tip) for a in (one, other)]
    np.testing.assert_allclose(ways[0].voxel_path_lps[[0, -1]], ways[1].voxel_path_lps[[0, -1]], atol=1e-6)
    # Of nearly equal paths through neighbouring voxels the search may choose another one.
    assert ways[0].length_mm == pytest.approx(ways[1].length_mm, rel=0.02)


def test_case_opened_with_another_scan_is_refused(file, active_case):
    volume = active_case.case.volume
    moved = volume.lps_from_ijk.copy()
    moved[0, 3] += 0.5
    for other in (Volume(volume.hu_zyx, moved), Volume(np.ascontiguousarray(volume.hu_zyx[:-1]), volume.lps_from_ijk)):
        with pytest.raises(CaseFileError, match="belongs to another scan") as refusal:
            file.load(other)
        assert refusal.value.code == "case.other-scan"
    moved[0, 3] -= 0.4999
    assert file.load(Volume(volume.hu_zyx, moved)) is not None


# Packed scan


def packed(active_case, folder, volume):
    source = SourceFacts.of(volume, ct_digest(volume))
    with CaseFile.create(folder / "live.carina", source) as file:
        file.save(active_case.moment())
        assert file.packed_volume() is None
        file.write_copy(folder / "packed.carina", volume=volume)
    return folder / "packed.carina"


def test_scan_stored_inside_a_case_file_is_restored_voxel_by_voxel(active_case, tmp_path, monkeypatch):
    monkeypatch.setattr("carina.case.packed_ct.CHUNK_BYTES", 5000)
    values = active_case.case.volume.hu_zyx.copy()
    values[0, 0, :4] = (-32768, 32767, -32768, 32767)  # The differences of these values exceed 16 bits.
    volume = Volume(values, active_case.case.volume.lps_from_ijk)
    with CaseFile.open(packed(active_case, tmp_path, volume), read_only=True) as file:
        found = file.packed_volume()
        np.testing.assert_array_equal(found.hu_zyx, volume.hu_zyx)
        np.testing.assert_array_equal(found.lps_from_ijk, volume.lps_from_ijk)
        assert found.is_hu
        assert_same_moment(file.load(found), active_case.moment(), active_case.case, deep=False)
    connection = sqlite3.connect(tmp_path / "packed.carina")
    assert connection.execute("SELECT count(*) FROM ct").fetchone()[0] == 12
    connection.close()


def test_packed_scan_with_an_inserted_nodule_opens_with_its_note(active_case, tmp_path):
    texts = ("solid nodule, 8.0 mm, at -41.0 12.0 -180.0", "ground-glass nodule, 6.0 mm, at 1.0 2.0 3.0")
    scan = active_case.case.volume
    marked = Volume(scan.hu_zyx, scan.lps_from_ijk, source=with_inserted(scan.source, texts))
    path = packed(active_case, tmp_path, marked)
    with CaseFile.open(path, read_only=True) as file:
        found = file.packed_volume()
    assert found.source.inserted == texts
    assert [note.code for note in badges_of(found)] == [INSERTED]
    assert found.source.title == "Inserted nodule: packed scan"


def test_case_without_its_scan_marks_a_copy_that_has_lost_the_mark(active_case, tmp_path):
    texts = ("solid nodule, 8.0 mm, at -41.0 12.0 -180.0",)
    scan = active_case.case.volume
    marked = Volume(scan.hu_zyx, scan.lps_from_ijk, source=with_inserted(scan.source, texts))
    with CaseFile.create(tmp_path / "one.carina", SourceFacts.of(marked, ct_digest(marked))) as file:
        file.write_copy(tmp_path / "named.carina")
    # Other software does not write the mark.
    write_grid(tmp_path / "copy.nii", scan.hu_zyx, scan.lps_from_ijk, what="the CT")
    assert carina.open_volume(tmp_path / "copy.nii", progress=False).source.inserted == ()
    with CaseFile.open(tmp_path / "named.carina", read_only=True) as file:
        assert file.inserted == texts
        found = CaseScans().open(file, ct=tmp_path / "copy.nii", progress=False).volume
    assert found.source.inserted == texts
    assert [note.code for note in badges_of(found)].count(INSERTED) == 1


def test_damaged_list_of_inserted_nodules_is_reported(active_case, tmp_path):
    scan = active_case.case.volume
    path = packed(active_case, tmp_path, Volume(scan.hu_zyx, scan.lps_from_ijk, source=with_inserted(scan.source, "a")))
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE extra SET json = '[1]' WHERE kind = 'inserted'")
    connection.close()
    with CaseFile.open(path, read_only=True) as file, pytest.raises(CaseFileError, match="inserted structures"):
        file.packed_volume()


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE ct SET data = substr(data, 1, 100)",
        "UPDATE ct SET digest = x'00'",
        "UPDATE ct SET num_k = 30000000",
        "UPDATE ct SET first_k = 1",
        "UPDATE source SET nz = 60000",
        "UPDATE source SET nx = 60000, ny = 60000",
    ],
)
def test_damaged_scan_inside_a_case_file_is_reported_before_memory_is_allocated(active_case, tmp_path, statement):
    path = packed(active_case, tmp_path, active_case.case.volume)
    connection = sqlite3.connect(path)
    connection.execute(statement)
    connection.commit()
    connection.close()
    with CaseFile.open(path, read_only=True) as file, pytest.raises(CaseFileError, match="the scan"):
        file.packed_volume()


def test_case_file_stores_no_other_scan_than_that_of_the_case(file, active_case, tmp_path):
    with pytest.raises(UsageError, match="only the scan"):
        file.write_copy(tmp_path / "packed.carina", volume=active_case.case.volume)  # this volume has another digest
    assert not (tmp_path / "packed.carina").exists()
