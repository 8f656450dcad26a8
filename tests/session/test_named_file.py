"""Tests of named case files: Carina overwrites only content that the window has read or written itself."""

from __future__ import annotations

import errno
import os
import shutil
import stat
import threading

import pytest

from carina.session.store import named_file
from carina.session.store.named_file import FileMark, NamedFile, NamedFileConflictError, free_path_beside, read_mark
from carina.session.store.named_file_lock import NamedLock, lock_path
from restartable_workstation import put_text

WAIT_S = 60.0


def write(named, text, **options):
    """Save the text as the content of a window's case."""
    return named.write(lambda path, _mark, placement: put_text(path, text, placement), **options)


def refusal(named, text="ours", **options):
    with pytest.raises(NamedFileConflictError) as refused:
        write(named, text, **options)
    return refused.value


def names(folder):
    return sorted(path.name for path in folder.iterdir() if not path.name.endswith(".lock"))


@pytest.fixture(params=["locks", "no locks", "no hard links", "neither"])
def disk(request, monkeypatch):
    """Provide a local disk, a network share without locks, and a disk without hard links."""
    if request.param in {"no locks", "neither"}:
        monkeypatch.setattr(named_file.NamedLock, "take", staticmethod(lambda _path: None))
    if request.param in {"no hard links", "neither"}:

        def link(_source, _target):
            raise OSError(errno.EPERM, "Operation not permitted")

        monkeypatch.setattr(os, "link", link)
    return request.param


@pytest.fixture
def path(tmp_path):
    return tmp_path / "team.carina"


# ---------------------------------------------------------------- changed content


def test_window_overwrites_the_named_file_that_it_wrote(disk, path):
    named = NamedFile(path)
    marks = []
    for text in ("one", "two", "three"):
        assert write(named, text) is None
        assert path.read_text() == text
        marks.append(named.mark)
    assert [mark.generation for mark in marks] == [1, 2, 3]
    assert len({mark.save_id for mark in marks}) == 3
    assert names(path.parent) == ["team.carina"]


def test_save_under_a_new_name_does_not_overwrite_an_existing_file(disk, path):
    path.write_text("a letter")
    conflict = refusal(NamedFile(path))
    assert (conflict.code, conflict.kind, conflict.exit_code) == ("case.changed", "not-a-case", 3)
    assert "already exists" in str(conflict)
    assert (path.read_text(), names(path.parent)) == ("a letter", ["team.carina"])


@pytest.mark.parametrize("change", ["rewritten", "replaced", "shortened", "emptied"])
def test_save_does_not_overwrite_content_that_another_program_wrote_before(disk, path, change):
    named = NamedFile(path)
    write(named, "ours, the first")
    before = path.stat()
    if change == "replaced":
        (path.parent / "new").write_text("ours, the other")
        (path.parent / "new").replace(path)
    else:
        path.write_text({"rewritten": "ours, the other", "shortened": "ours", "emptied": ""}[change])
    # The times are unchanged, as with a slow clock or a copy that has the times of its original.
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    content = path.read_bytes()
    assert refusal(named).kind == "not-a-case"
    with pytest.raises(NamedFileConflictError):
        named.check()
    assert (path.read_bytes(), names(path.parent)) == (content, ["team.carina"])


def test_named_file_of_an_earlier_version_is_overwritten_only_if_its_digest_is_recorded(disk, path):
    path.write_text("schema 1")
    refusal(NamedFile(path, FileMark("00" * 32)))
    named = NamedFile(path, read_mark(path))
    assert named.mark.save_id is None
    write(named, "ours")
    assert path.read_text() == "ours"


def test_replace_moves_the_content_of_another_program_to_a_new_file(disk, path, monkeypatch):
    monkeypatch.setattr(named_file.time, "strftime", lambda _format: "2026-11-27 1405")
    for n in range(3):
        path.write_text(f"theirs {n}")
        named = NamedFile(path)
        stored_paths = write(named, f"ours {n}", replace=True)
        named.close()
        assert stored_paths.read_text() == f"theirs {n}"
        assert path.read_text() == f"ours {n}"
    assert names(path.parent) == [
        "team (replaced 2026-11-27 1405).carina",
        "team (replaced 2026-11-27 1405, 2).carina",
        "team (replaced 2026-11-27 1405, 3).carina",
        "team.carina",
    ]


def test_replace_of_a_deleted_file_creates_no_copy(disk, path):
    assert write(NamedFile(path), "ours", replace=True) is None
    assert names(path.parent) == ["team.carina"]


def test_replacing_save_has_a_generation_number_above_that_of_the_replaced_content(disk, path):
    named = NamedFile(path, FileMark("00" * 32, "ab" * 8, 7))
    path.write_text("theirs")
    write(named, "ours", replace=True)
    assert named.mark.generation == 8


def test_named_file_that_was_moved_away_is_not_recreated_automatically(disk, path):
    named = NamedFile(path)
    write(named, "one")
    path.rename(path.with_name("elsewhere.carina"))
    conflict = refusal(named)
    assert (conflict.kind, "moved, renamed or deleted" in str(conflict)) == ("missing", True)
    assert names(path.parent) == ["elsewhere.carina"]
    write(named, "two", may_be_missing=True)
    assert names(path.parent) == ["elsewhere.carina", "team.carina"]


def test_named_file_of_a_save_interrupted_by_a_crash_is_recognised_by_its_digest(disk, path):
    named = NamedFile(path)
    write(named, "one")
    recorded = named.mark
    noted = []
    write(named, "two", before_placing=noted.append)
    # The record contains the digest of the interrupted save, but not yet the digest of the file.
    named.close()
    again = NamedFile(path, recorded, next_digest=noted[0].digest)
    write(again, "three")
    assert path.read_text() == "three"
    again.close()
    refusal(NamedFile(path, recorded, next_digest="00" * 32))


def test_save_through_a_symbolic_link_writes_its_target_and_the_link_remains(disk, path, tmp_path):
    real = tmp_path / "share" / "team.carina"
    real.parent.mkdir()
    path.symlink_to(real)
    named = NamedFile(path)
    write(named, "one")
    write(named, "two")
    assert path.is_symlink()
    assert real.read_text() == "two"
    assert named.has_path(real)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes")
def test_pipe_with_the_name_of_a_case_file_is_refused_without_being_read(path):
    named = NamedFile(path, FileMark("00" * 32))
    os.mkfifo(path)
    with pytest.raises(NamedFileConflictError):
        named.check()
    assert stat.S_ISFIFO(path.stat().st_mode)


# ---------------------------------------------------------------- between the check and the replacement


def changed_meanwhile(path, monkeypatch, do):
    """Run ``do`` after the draft is complete and before the content is compared the second time."""
    done = []
    found = named_file._digest_of

    def digest_of(place):
        digest = found(place)
        if place.name.endswith(".draft") and not done:
            done.append(True)
            do()
        return digest

    monkeypatch.setattr(named_file, "_digest_of", digest_of)


def test_save_does_not_overwrite_content_that_another_program_wrote_meanwhile(disk, path, monkeypatch):
    named = NamedFile(path)
    write(named, "one")
    changed_meanwhile(path, monkeypatch, lambda: path.write_text("theirs"))
    refusal(named, "two")
    assert path.read_text() == "theirs"
    assert [name for name in names(path.parent) if name.endswith(".carina")] == ["team.carina"]


def test_save_does_not_overwrite_a_file_that_another_program_created_meanwhile(disk, path, monkeypatch):
    changed_meanwhile(path, monkeypatch, lambda: path.write_text("theirs"))
    refusal(NamedFile(path), "ours")
    assert path.read_text() == "theirs"


def test_save_without_locks_does_not_overwrite_a_file_created_after_the_old_file_was_moved(path, monkeypatch):
    monkeypatch.setattr(named_file.NamedLock, "take", staticmethod(lambda _path: None))
    named = NamedFile(path)
    write(named, "one")
    found = named_file._digest_of

    def digest_of(place):
        if "being replaced" in place.name:
            path.write_text("theirs")
        return found(place)

    monkeypatch.setattr(named_file, "_digest_of", digest_of)
    refusal(named, "two")
    texts = {p.read_text() for p in path.parent.glob("*.carina")}
    assert path.read_text() == "theirs"
    assert texts == {"theirs", "one"}, "the moved file is stored under a new name"


def test_replace_without_locks_loses_no_file_created_meanwhile(path, monkeypatch):
    monkeypatch.setattr(named_file.NamedLock, "take", staticmethod(lambda _path: None))
    path.write_text("theirs 1")
    moved = named_file.move_to_new_name

    def move(source, target):
        moved(source, target)
        if "replaced" in target.name and not path.with_name("once").exists():
            path.with_name("once").touch()
            path.write_text("theirs 2")

    monkeypatch.setattr(named_file, "move_to_new_name", move)
    write(NamedFile(path), "ours", replace=True)
    assert {p.read_text() for p in path.parent.glob("*.carina")} == {"ours", "theirs 1", "theirs 2"}
    assert path.read_text() == "ours"


def test_replace_on_a_disk_that_becomes_full_leaves_the_named_file_unchanged(path, monkeypatch):
    path.write_text("theirs")

    def link(_source, _target):
        raise OSError(errno.EPERM, "Operation not permitted")

    def full(_source, target, _size):
        target.write(b"th")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "link", link)
    monkeypatch.setattr(shutil, "copyfileobj", full)
    with pytest.raises(OSError, match="No space left"):
        write(NamedFile(path), "ours", replace=True)
    assert path.read_text() == "theirs"
    assert list(path.parent.glob("*replaced*")) == []


# ---------------------------------------------------------------- locks


def test_second_window_with_one_named_file_is_warned_and_writes_nothing(path):
    first, second = NamedFile(path), NamedFile(path)
    write(first, "one")
    second.mark = first.mark
    with pytest.raises(NamedFileConflictError, match="open for editing elsewhere") as refused:
        second.check()
    assert (refused.value.code, refused.value.kind) == ("case.read-only", "open-elsewhere")
    refusal(second, replace=True)
    assert path.read_text() == "one"
    first.close()
    write(second, "two")
    assert path.read_text() == "two"
    second.close()
    assert names(path.parent) == ["team.carina"]
    assert not lock_path(path).exists()


def test_warning_about_a_named_file_open_elsewhere_names_its_user(path, monkeypatch):
    monkeypatch.setattr("getpass.getuser", lambda: "anna\x1b[31m")
    monkeypatch.setattr("socket.gethostname", lambda: "ward-3")
    first = NamedFile(path)
    write(first, "one")
    message = str(refusal(NamedFile(path, first.mark)))
    assert "by anna[31m on ward-3" in message
    first.close()


def test_lock_of_a_named_file_is_detected_by_a_user_without_write_permission(path, monkeypatch):
    lock = NamedLock.take(path)
    opened = os.open

    def without_rights(place, flags, *mode, **where):
        if str(place).endswith(".lock") and flags & os.O_RDWR:
            raise PermissionError(errno.EACCES, "Permission denied")
        return opened(place, flags, *mode, **where)

    monkeypatch.setattr(os, "open", without_rights)
    refusal(NamedFile(path))
    lock.release()


def test_named_file_is_closed_while_its_network_share_does_not_respond(path):
    named = NamedFile(path)
    has_begun, goes_on = threading.Event(), threading.Event()

    def stalls(place, _mark, placement):
        has_begun.set()
        assert goes_on.wait(WAIT_S)
        put_text(place, "one", placement)

    writer = threading.Thread(target=named.write, args=(stalls,))
    writer.start()
    assert has_begun.wait(WAIT_S)
    named.close()
    assert lock_path(path).exists(), "the writer still uses the lock"
    goes_on.set()
    writer.join(WAIT_S)
    assert not lock_path(path).exists()


def test_suggested_new_path_is_not_in_use(path):
    assert free_path_beside(path).name == "team (2).carina"
    free_path_beside(path).touch()
    assert free_path_beside(path).name == "team (3).carina"


# ---------------------------------------------------------------- journals, long names, partial failures


@pytest.mark.parametrize("tail", ["-wal", "-journal"])
def test_save_is_refused_if_another_program_left_a_journal_beside_the_named_file(disk, path, tail):
    """Use a program that has the file open as a database and has written its changes only into the journal."""
    named = NamedFile(path)
    write(named, "one")
    journal = path.with_name(path.name + tail)
    journal.write_bytes(b"theirs")
    refusal(named)
    with pytest.raises(NamedFileConflictError):
        named.check()
    assert (path.read_text(), journal.read_bytes()) == ("one", b"theirs")
    # An empty journal contains no change.
    journal.write_bytes(b"")
    write(named, "two")
    assert path.read_text() == "two"


@pytest.mark.parametrize("tail", ["-wal", "-journal"])
def test_replace_moves_the_journal_together_with_the_replaced_file(disk, path, tail):
    """Check that no journal stays beside the new file, where it would be replayed on that file."""
    path.write_text("theirs")
    journal = path.with_name(path.name + tail)
    journal.write_bytes(b"their changes")
    stored_paths = write(NamedFile(path), "ours", replace=True)
    assert (path.read_text(), stored_paths.read_text()) == ("ours", "theirs")
    assert stored_paths.with_name(stored_paths.name + tail).read_bytes() == b"their changes"
    assert not journal.exists()


def test_move_that_fails_during_replace_leaves_the_named_file_unchanged(disk, path, monkeypatch):
    path.write_text("theirs")
    moved = named_file.move_to_new_name

    def fails(source, target):
        if source.name.endswith(".draft"):
            raise OSError(errno.EIO, "Input/output error")
        moved(source, target)

    def replaced(source, target):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(named_file, "move_to_new_name", fails)
    with monkeypatch.context() as patched:
        if disk in {"locks", "no hard links"}:
            patched.setattr("pathlib.Path.replace", replaced)
        with pytest.raises(OSError, match="Input/output"):
            write(NamedFile(path), "ours", replace=True)
    assert path.read_text() == "theirs"


def test_replacement_that_the_network_share_wrongly_reports_as_failed_is_recognised(disk, path, monkeypatch):
    """Use a network share that repeats a request whose answer was lost, and reports the repetition as failed."""
    named = NamedFile(path)
    write(named, "one")
    for owner, name in ((named_file, "move_to_new_name"), (type(path), "replace")):
        done = getattr(owner, name)

        def twice(source, target, done=done):
            done(source, target)
            if target == path:
                raise OSError(errno.EIO, "Input/output error")

        monkeypatch.setattr(owner, name, twice)
    with pytest.raises(OSError, match="Input/output"):
        write(named, "two")
    monkeypatch.undo()
    write(named, "three")
    assert path.read_text() == "three"


def test_old_file_that_cannot_be_removed_after_a_save_does_not_fail_the_save(path, monkeypatch):
    monkeypatch.setattr(named_file.NamedLock, "take", staticmethod(lambda _path: None))
    named = NamedFile(path)
    write(named, "one")
    removed = type(path).unlink

    def held(place, *, missing_ok=False):
        if "being replaced" in place.name:
            raise PermissionError(errno.EACCES, "a virus scanner reads it")
        removed(place, missing_ok=missing_ok)

    with monkeypatch.context() as patched:
        patched.setattr(type(path), "unlink", held)
        write(named, "two")
    write(named, "three")
    assert path.read_text() == "three"


@pytest.mark.parametrize("letter", ["a", "\u00e4"])
def test_suggested_paths_for_a_long_file_name_are_within_the_length_limit(disk, tmp_path, letter, monkeypatch):
    path = tmp_path / f"{letter * (240 // len(letter.encode()))}.carina"
    path.write_text("theirs")
    beside = free_path_beside(path)
    beside.touch()
    assert beside.name.endswith(" (2).carina")
    stored_paths = write(NamedFile(path), "ours", replace=True)
    assert "(replaced " in stored_paths.name
    assert (path.read_text(), stored_paths.read_text()) == ("ours", "theirs")


def test_hard_link_to_a_saved_file_is_treated_as_a_separate_path(path):
    """Use a file with several hard links, of which a save replaces one name."""
    named = NamedFile(path)
    write(named, "one")
    other = path.with_name("other.carina")
    os.link(path, other)
    assert not named.has_path(other)
    assert named.has_path(path)
    link = path.with_name("link.carina")
    link.symlink_to(path)
    assert named.has_path(link)


def test_lock_on_a_network_share_with_unstable_inode_numbers_does_not_hang(path, monkeypatch):
    monkeypatch.setattr(os.path, "samestat", lambda _one, _other: False)
    assert NamedLock.take(path) is None
