"""Tests of case files from untrusted sources: refusal of unknown tables and damage, migration, and rescue."""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
import stat
import zlib
from dataclasses import replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sample_case import ActiveCase, assert_same_moment, load_lazy_parts, save_steps, source_of

from carina.case import CaseFile, CaseFileError, migrate, rescued
from carina.case.migration import migrate_live
from carina.errors import CarinaError


@pytest.fixture(scope="module")
def saved_case(tmp_path_factory):
    """Return a case with all kinds of content, and its file."""
    path = tmp_path_factory.mktemp("made") / "one.carina"
    active_case = ActiveCase()
    with CaseFile.create(path, source_of(active_case.case)) as file:
        save_steps(file, active_case, ("target", "measure", "cut", "measure", "key", "paint", "look", "undo"))
        with file.record("flight", begun_s=1.0) as recording:
            recording.write('{"format":"carina-recording","version":1}\n{"t":0.5,"view":{}}\n{"end":0.5}\n')
    return active_case, path


@pytest.fixture
def foreign_file(saved_case, tmp_path):
    """Return a copy of the case file that the test may damage."""
    return shutil.copy(saved_case[1], tmp_path / "stranger.carina")


def changed(path, *statements):
    connection = sqlite3.connect(path, isolation_level=None)
    for statement in statements:
        connection.execute(*(statement if isinstance(statement, tuple) else (statement,)))
    connection.close()


def looked_through(path, active_case):
    """Read everything that the opening of a case, loading it and undo read."""
    with CaseFile.open(path, read_only=True) as file:
        file.history()
        moment = file.load(active_case.case.volume)
        load_lazy_parts(moment, moment.history().documents(), active_case.case)
        for facts in file.recordings():
            file.recording(facts.recording_id)


# Tables that the schema does not contain


@pytest.mark.parametrize(
    "statement",
    [
        "CREATE VIEW more AS SELECT * FROM step",
        "CREATE TRIGGER more AFTER INSERT ON step BEGIN DELETE FROM moment; END",
        "CREATE TABLE more (id INTEGER PRIMARY KEY, twice INTEGER GENERATED ALWAYS AS (id * 2) VIRTUAL) STRICT",
        "CREATE VIRTUAL TABLE more USING fts5(words)",
        "CREATE INDEX more ON step (label)",
        "CREATE TABLE more (id INTEGER PRIMARY KEY) STRICT",
        "DROP TABLE extra",
        "ALTER TABLE step ADD COLUMN more TEXT",
        "ALTER TABLE step RENAME COLUMN label TO words",
    ],
)
@pytest.mark.parametrize("read_only", [True, False])
def test_database_with_tables_unlike_the_schema_is_refused(foreign_file, statement, read_only):
    changed(foreign_file, statement)
    before = foreign_file.read_bytes()
    with pytest.raises(CaseFileError, match="its tables are not those") as refusal:
        CaseFile.open(foreign_file, read_only=read_only)
    assert refusal.value.code == "case.damaged"
    assert foreign_file.read_bytes() == before


def test_file_that_is_not_a_case_file_is_refused(tmp_path):
    for name, content in (("empty", b""), ("text", b"a letter" * 100), ("header", b"SQLite format 3\x00" + bytes(84))):
        path = tmp_path / f"{name}.carina"
        path.write_bytes(content)
        with pytest.raises(CaseFileError, match=r"not a Carina case|damaged"):
            CaseFile.open(path)
    other = tmp_path / "other.carina"
    changed(other, "CREATE TABLE notes (words TEXT)")
    with pytest.raises(CaseFileError, match="not a Carina case") as refusal:
        CaseFile.open(other)
    assert refusal.value.code == "case.not-a-case"
    with pytest.raises(CarinaError, match="there is no such file"):
        CaseFile.open(tmp_path / "missing.carina")


def test_case_of_a_newer_version_opens_for_reading_and_is_not_changed(saved_case, foreign_file):
    changed(
        foreign_file, "CREATE TABLE scores (id INTEGER PRIMARY KEY, json TEXT NOT NULL) STRICT", "PRAGMA user_version=3"
    )
    before = foreign_file.read_bytes()
    with CaseFile.open(foreign_file) as file:
        assert file.read_only
        assert "newer version of Carina saved this case" in file.note
        assert_same_moment(file.load(saved_case[0].case.volume), saved_case[0].moment(), saved_case[0].case)
    assert foreign_file.read_bytes() == before
    changed(foreign_file, "CREATE VIEW more AS SELECT 1")
    with pytest.raises(CaseFileError, match="update Carina"):
        CaseFile.open(foreign_file, read_only=True)


def as_before_measures(path):
    """Change the file to schema 1, which has no measures, and return its path."""
    changed(
        path, "PRAGMA foreign_keys=OFF", *(f"DROP TABLE {t}" for t in ("measures", "measured_branch", "sections")),
        "PRAGMA user_version=1",
    )  # fmt: skip
    return path


def test_case_of_an_older_version_is_migrated_in_a_copy(saved_case, foreign_file, tmp_path):
    as_before_measures(foreign_file)
    before = foreign_file.read_bytes()
    with pytest.raises(CaseFileError, match="an older version of Carina saved it") as refusal:
        CaseFile.open(foreign_file)
    assert refusal.value.code == "case.older"
    moment = replace(saved_case[0].moment(), measures=())
    with CaseFile.open(foreign_file, read_only=True) as file:
        assert_same_moment(file.load(saved_case[0].case.volume), moment, saved_case[0].case)
    migrate(foreign_file, tmp_path / "now.carina")
    assert foreign_file.read_bytes() == before
    with CaseFile.open(tmp_path / "now.carina") as file:
        assert_same_moment(file.load(saved_case[0].case.volume), moment, saved_case[0].case)
        file.save(saved_case[0].moment())
    with CaseFile.open(tmp_path / "now.carina") as file:
        assert_same_moment(file.load(saved_case[0].case.volume), saved_case[0].moment(), saved_case[0].case)
    # The rescue of a schema 1 file does not report missing measures.
    assert rescued(foreign_file, tmp_path / "rescued.carina") == ()


@pytest.mark.parametrize(
    "statement",
    [
        "CREATE VIEW more AS SELECT * FROM step",
        "CREATE TABLE measures (id INTEGER PRIMARY KEY) STRICT",
        "CREATE TRIGGER more AFTER INSERT ON step BEGIN DELETE FROM moment; END",
        "DROP TABLE extra",
    ],
)
@pytest.mark.parametrize("read_only", [True, False])
def test_older_file_with_tables_unlike_its_schema_is_refused(foreign_file, statement, read_only):
    changed(as_before_measures(foreign_file), statement)
    before = foreign_file.read_bytes()
    with pytest.raises(CaseFileError, match="its tables are not those of schema 1"):
        CaseFile.open(foreign_file, read_only=read_only)
    assert foreign_file.read_bytes() == before


@pytest.mark.parametrize("has_journal", [False, True])
def test_live_case_of_an_older_version_is_migrated_beside_its_original(saved_case, foreign_file, tmp_path, has_journal):
    as_before_measures(foreign_file)
    with contextlib.closing(sqlite3.connect(foreign_file)) as connection:
        before = connection.execute("SELECT n, label FROM step").fetchall()
    if has_journal:
        live = sqlite3.connect(foreign_file, isolation_level=None)
        live.execute("PRAGMA journal_mode=WAL")
        live.execute("UPDATE step SET label = 'cut, in the journal' WHERE n = 2")
        for name in (foreign_file.name, f"{foreign_file.name}-wal"):
            (tmp_path / "taken").mkdir(exist_ok=True)
            shutil.copy(foreign_file.with_name(name), tmp_path / "taken" / name)
        live.close()
        foreign_file, before = tmp_path / "taken" / foreign_file.name, None
    beside = migrate_live(foreign_file)
    assert sorted(p.name for p in foreign_file.parent.iterdir()) == ["stranger-schema-1.carina", "stranger.carina"]
    assert {stat.S_IMODE(p.stat().st_mode) for p in (beside, foreign_file)} == {0o600}
    connection = sqlite3.connect(beside)
    assert connection.execute("PRAGMA user_version").fetchone() == (1,)
    stored = connection.execute("SELECT n, label FROM step").fetchall()
    connection.close()
    with CaseFile.open(foreign_file) as file:
        labels = [step.label for step in file.history()]
        file.load(saved_case[0].case.volume)
    assert [label for _, label in stored[1:]] == labels
    assert stored == before or ("cut, in the journal" in labels and has_journal)


# Journals beside the case file


def test_case_with_a_journal_opened_read_only_is_restored_in_a_copy(saved_case, tmp_path):
    live = tmp_path / "live.carina"
    active_case = saved_case[0]
    with CaseFile.create(live, source_of(active_case.case)) as file:
        file.save(active_case.moment())
        names = sorted(p.name for p in tmp_path.iterdir())
        assert names == ["live.carina", "live.carina-shm", "live.carina-wal"]
        taken = tmp_path / "taken"
        taken.mkdir()
        for name in names[::2]:
            shutil.copy(tmp_path / name, taken / name)
    before = {p.name: p.read_bytes() for p in taken.iterdir()}
    with CaseFile.open(taken / "live.carina", read_only=True) as file:
        assert_same_moment(file.load(active_case.case.volume), active_case.moment(), active_case.case)
        assert {p.name: p.read_bytes() for p in taken.iterdir()} == before
    # Opened for writing, the case continues from the content of the journal.
    with CaseFile.open(taken / "live.carina") as file:
        assert_same_moment(file.load(active_case.case.volume), active_case.moment(), active_case.case)
    assert [p.name for p in taken.iterdir()] == ["live.carina"]


def test_damaged_journal_loses_only_the_changes_that_it_contained(saved_case, tmp_path):
    active_case = saved_case[0]
    live, taken = tmp_path / "live.carina", tmp_path / "taken.carina"
    with CaseFile.create(live, source_of(active_case.case)) as file:
        file.save(active_case.moment())
    with CaseFile.open(live) as file:
        file.load(active_case.case.volume)
        file.set_extra("plan", ("later",))
        shutil.copy(live, taken)
        journal = bytearray(live.with_name("live.carina-wal").read_bytes())
        journal[60] ^= 0xFF
        taken.with_name("taken.carina-wal").write_bytes(journal)
    with CaseFile.open(taken) as file:
        assert_same_moment(file.load(active_case.case.volume), active_case.moment(), active_case.case)
        assert file.extra("plan") == ()


# Damaged content


@pytest.mark.parametrize(
    ("statement", "where"),
    [
        (("UPDATE array SET data = ?", (b"\x00" * 40,)), "array"),
        ("UPDATE array SET count = 8388608", "array"),
        ("UPDATE array SET count = 4611686018427387904", "array"),
        ("UPDATE array SET count = -1", "array"),
        ("UPDATE array SET dtype = 'f4'", "array"),
        ("UPDATE array SET width = 16", "array"),
        ("DELETE FROM tile", "tile"),
        ("UPDATE tree SET size = 67108864", "tree"),
        ("UPDATE tree SET num_branches = 2000000000", "tree"),
        ("UPDATE tree SET branches = x''", "tree"),
        ("UPDATE lumen SET num_tiles = 2000000000", "lumen"),
        ("UPDATE lumen SET nx = 60000", "lumen"),
        ("UPDATE tracker SET root_i = -1", "tracker"),
        ("UPDATE airways SET base = id", "airways"),
        ("UPDATE value SET json = '{' WHERE kind = 'transfer'", "value"),
        ("UPDATE value SET json = replace(json, '1', '1e999')", "value"),
        ("UPDATE route SET facts = ''", "route"),
        ("UPDATE document SET airways = 4000000", "document"),
        ("UPDATE step SET document = 4000000", "row 4000000 of document"),
        ("UPDATE step SET n = n + 5 WHERE n = 3", "history: expected"),
        ("DELETE FROM step", "history: expected"),
        ("UPDATE step SET command = '[1]'", "step"),
        ("UPDATE moment SET position = 99", "position in the history"),
        ("UPDATE moment SET facts = replace(facts, 'sight', 'sigh')", "current state"),
        ("UPDATE source SET nz = 65536", "record of the scan"),
        ("UPDATE source SET lps_from_ijk = zeroblob(128)", "record of the scan"),
        ("UPDATE source SET path = '/etc/passwd'", "record of the scan"),
        ("DELETE FROM sections", "sections"),
        ("UPDATE sections SET num_sections = 2000000000", "sections"),
        ("UPDATE sections SET figures = x'00'", "sections"),
        ("UPDATE measured_branch SET flags = x''", "measured_branch"),
        ("UPDATE measured_branch SET facts = '{}'", "measured_branch"),
        ("UPDATE measures SET branches = x''", "measures"),
        ("UPDATE measures SET facts = '{}'", "measures"),
        ("UPDATE recording_chunk SET size = 1000000000", "recording"),
        ("UPDATE recording_chunk SET n = 7", "recording"),
    ],
)
def test_stored_content_with_a_wrong_digest_or_value_is_reported(saved_case, foreign_file, statement, where):
    changed(foreign_file, "PRAGMA foreign_keys=OFF", statement)
    with pytest.raises(CaseFileError, match=where) as refusal:
        looked_through(foreign_file, saved_case[0])
    assert refusal.value.code == "case.damaged"
    assert "expected" in str(refusal.value)


def test_compressed_array_of_enormous_size_is_refused_before_decompression(saved_case, foreign_file):
    bomb = zlib.compress(bytes(60 << 20), 9)
    changed(foreign_file, "PRAGMA foreign_keys=OFF", ("UPDATE array SET count = 7864320, width = 0, data = ?", (bomb,)))
    with pytest.raises(CaseFileError, match=r"expected content that matches|f8"):
        looked_through(foreign_file, saved_case[0])
    changed(foreign_file, ("UPDATE tile SET data = ?", (bomb,)))
    with pytest.raises(CaseFileError, match="expected"):
        looked_through(foreign_file, saved_case[0])


def _spoilt(path, saved_case, draw):
    content = bytearray(saved_case[1].read_bytes())
    for place, value in draw["flips"]:
        content[place % len(content)] ^= value
    if draw["cut"] is not None:
        del content[draw["cut"] % len(content) :]
    path.write_bytes(content)


spoils = st.fixed_dictionaries(
    {
        "flips": st.lists(st.tuples(st.integers(0, 2**24), st.integers(1, 255)), max_size=6),
        "cut": st.one_of(st.none(), st.none(), st.integers(0, 2**24)),
    }
)


def spoil(saved_case, tmp_path_factory, draw):
    """Damage a case file at random; assert that it is refused or whole, stays unchanged, and its rescue opens."""
    active_case = saved_case[0]
    folder = tmp_path_factory.mktemp("spoilt")
    path = folder / "spoilt.carina"
    _spoilt(path, saved_case, draw)
    before = path.read_bytes()
    with contextlib.suppress(CarinaError):
        looked_through(path, active_case)
    with contextlib.suppress(CaseFileError):
        rescued(path, folder / "rescued.carina")
    if (folder / "rescued.carina").exists():
        looked_through(folder / "rescued.carina", active_case)
    assert path.read_bytes() == before
    shutil.rmtree(folder)


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(draw=spoils)
def test_case_file_with_flipped_bits_or_truncation_is_refused_or_read_completely(saved_case, tmp_path_factory, draw):
    spoil(saved_case, tmp_path_factory, draw)


@pytest.mark.soak
@settings(max_examples=2000, deadline=None, suppress_health_check=list(HealthCheck))
@given(draw=spoils)
def test_2000_case_files_with_flipped_bits_or_truncation_are_refused_or_read_completely(
    saved_case, tmp_path_factory, draw
):
    spoil(saved_case, tmp_path_factory, draw)


# Rescue of a case file


def test_rescue_of_an_undamaged_case_restores_all_content(saved_case, foreign_file, tmp_path):
    assert rescued(foreign_file, tmp_path / "rescued.carina") == ()
    with CaseFile.open(tmp_path / "rescued.carina") as file:
        assert_same_moment(file.load(saved_case[0].case.volume), saved_case[0].moment(), saved_case[0].case)
        assert file.recordings()[0].name == "flight"


def test_rescue_of_a_damaged_case_lists_lost_parts_and_restores_the_rest(saved_case, foreign_file, tmp_path):
    active_case = saved_case[0]
    changed(
        foreign_file,
        "PRAGMA foreign_keys=OFF",
        "UPDATE airways SET facts = '{}' WHERE id = (SELECT max(id) FROM airways)",
        "UPDATE route SET facts = '{}' WHERE id = (SELECT max(id) FROM route)",
        "UPDATE measures SET facts = '{}' WHERE id = 1",
        "DELETE FROM moment",
        "DELETE FROM recording_chunk",
    )
    lost = rescued(foreign_file, tmp_path / "rescued.carina")
    assert "the displayed views and the tip position" in lost
    assert any("the airways" in line for line in lost), lost
    assert "step 0 (the start): the measurements of the airways" in lost
    with CaseFile.open(tmp_path / "rescued.carina") as file:
        moment = file.load(active_case.case.volume)
        assert [s.label for s in moment.steps] == [s.label for s in active_case.history.steps]
        documents = list(zip(moment.history().documents(), active_case.history.documents(), strict=True))
        assert any(found.airways is None for found, _ in documents)
        for found, expected in documents:
            assert [t.lps for t in found.targets] == [t.lps for t in expected.targets]
            assert [k.key_id for k in found.key_frames.frames] == [k.key_id for k in expected.key_frames.frames]
