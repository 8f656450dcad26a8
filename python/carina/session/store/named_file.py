"""Named case files: the content that a window last read or wrote, and a replacement that loses no content."""

from __future__ import annotations

import contextlib
import hashlib
import os
import secrets
import stat
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from carina.case import CaseFile
from carina.case.error_texts import unusable_file_error
from carina.case.save_mark import SaveMark
from carina.case.sqlite_journals import JOURNALS, companion_path
from carina.disk import Placement
from carina.disk.move_files import copy_to_new_name, move_to_new_name
from carina.display import one_line
from carina.errors import CarinaError
from carina.session.store.find_scan import CASE_SUFFIX
from carina.session.store.named_file_lock import LockedElsewhereError, NamedLock

CopyWriter = Callable[[Path, SaveMark, Placement], None]
"""``write(path, mark, placement)`` writes a whole case with a save mark; the placement moves it to its path."""
ConflictKind = Literal["changed", "other-case", "not-a-case", "missing", "open-elsewhere"]
NOT_A_FILE: Final = "not a regular file"
"""Stored in place of a digest for a file that is not regular; no digest equals this value."""
MAX_LABEL = 80
OPEN_TRIES = 4
MAX_NAME_BYTES = 247
"""Maximum bytes in a file name beside the named file: most file systems allow 255, and a journal adds 8."""


@one_line
@dataclass(frozen=True, slots=True)
class FileMark:
    """Identity of the content that a window last read or wrote at a path: its digest and its save mark."""

    digest: str
    """BLAKE2b-256 of the whole file, hexadecimal."""
    save_id: str | None = None
    """Id of the save that wrote the content; None for a file of an earlier version of Carina."""
    generation: int = 0
    """Generation of the save that wrote the content; 0 without a save mark."""


class NamedFileConflictError(CarinaError):
    """A named file was not written, because its content is not the content that this window last read or wrote.

    ``code`` is ``case.changed``, or ``case.read-only`` while another window or program has the file open.
    """

    code = "case.changed"
    exit_code = 3

    def __init__(self, message: str, path: Path, kind: ConflictKind) -> None:
        super().__init__(message, code="case.read-only" if kind == "open-elsewhere" else "case.changed")
        self.path = path
        self.kind: ConflictKind = kind


class NamedFile:
    """A case file under a name that a user chose, as one window or program reads and writes it.

    The content is compared by its digest before each write, never by a time. The comparison and the replacement
    happen under one lock. Where locks do not work, the current file is first moved aside and compared there.

    Parameters
    ----------
    path
        Path of the file. A symbolic link is followed once, so that the link stays.
    mark
        Mark of the content that this window last read or wrote; None for a new name.
    ct_digest
        Digest of the case's CT. A message states whether other content belongs to the same CT.
    next_digest
        Digest of a save that a crash may have interrupted: the file may have this content instead.
    where_work_is
        Sentence in messages that states where the user's changes are while the file cannot be written.
    """

    def __init__(
        self,
        path: Path,
        mark: FileMark | None = None,
        *,
        ct_digest: str | None = None,
        next_digest: str | None = None,
        where_work_is: str = "Your changes are saved in the case on this computer",
    ) -> None:
        self.path = path
        self.mark = mark
        self._ct_digest = ct_digest
        self._next_digest = next_digest
        self._where_work_is = where_work_is
        self._lock: NamedLock | None = None
        self._is_closed = False
        self._writing = threading.Lock()

    def __repr__(self) -> str:
        """Describe the file by its path and its mark."""
        return f"NamedFile({str(self.path)!r}, mark={self.mark!r})"

    @property
    def is_locked(self) -> bool:
        """Whether this window holds the lock of the named file, so that no other window writes it."""
        return self._lock is not None

    def has_path(self, path: Path) -> bool:
        """Return whether a path names this file, also by another spelling or a symbolic link.

        A hard link is another file here, because a save replaces one of the two names.
        """
        if path == self.path:
            return True
        with contextlib.suppress(OSError):
            is_same = os.path.realpath(path) == os.path.realpath(self.path) or path.stat().st_nlink == 1
            return is_same and path.samefile(self.path)
        return False

    def check(self) -> None:
        """Take the lock of the named file if it is free, and compare the file's content with :attr:`mark`.

        Raises
        ------
        NamedFileConflictError
            If another window has the file open, or the file has other content than this window last read or wrote.
        OSError
            If the disk refuses to read the file.
        """
        with self._exclusive_access():
            self._take_lock()
            self._refuse_other_content(_digest_of(self._resolved_path()), may_be_missing=False)

    def write(
        self,
        write: CopyWriter,
        *,
        replace: bool = False,
        may_be_missing: bool = False,
        before_placing: Callable[[FileMark], None] | None = None,
    ) -> Path | None:
        """Write the case to the named file, unless this would overwrite content that Carina has not read or written.

        Parameters
        ----------
        write
            Writes the whole case as a draft, and calls the placement.
        replace
            Replace other content, after that content was stored as ``NAME (replaced DATE).carina``.
        may_be_missing
            Write the file even if it was moved, renamed or deleted since the last save.
        before_placing
            Called with the new mark when the draft is complete, before it replaces the file, so that a record can store
            the mark before a crash.

        Returns
        -------
        Path | None
            Path of the replaced content; None if no content was replaced.

        Raises
        ------
        NamedFileConflictError
            If another window has the file open, or the file has other content (see :meth:`check`). The file is
            unchanged.
        DiskError, OSError
            If the disk refuses the write; the file is unchanged.
        """
        with self._exclusive_access():
            self._take_lock()
            place = self._resolved_path()
            if not replace:
                # This early check avoids a useless draft; the deciding check follows when the draft is complete.
                self._refuse_other_content(_digest_of(place), may_be_missing=may_be_missing)
            parent = self._replaced_save(place, replace=replace)
            save = SaveMark.successor(
                None if parent is None else parent.save_id, 0 if parent is None else parent.generation
            )
            stored_paths: list[Path] = []

            def put(draft: Path, target: Path) -> None:
                digest = _digest_of(draft)
                assert digest is not None
                mark = FileMark(digest, save.save_id, save.generation)
                # A network share may report a failure although it has replaced the file, which then has this digest.
                self._next_digest = digest
                if before_placing is not None:
                    before_placing(mark)
                if replace:
                    stored_paths.extend(_replace_and_keep(draft, target, is_locked=self._lock is not None))
                elif self._lock is not None:
                    self._replace_locked(draft, target, may_be_missing=may_be_missing)
                else:
                    self._replace_unlocked(draft, target, may_be_missing=may_be_missing)
                self.mark, self._next_digest = mark, None

            write(place, save, put)
            return stored_paths[0] if stored_paths else None

    def close(self) -> None:
        """Release the lock; if a write waits for a disk, that write releases the lock at its end."""
        self._is_closed = True
        if self._writing.acquire(blocking=False):
            try:
                self._release()
            finally:
                self._writing.release()

    # ------------------------------------------------------------ steps that need the lock

    @contextlib.contextmanager
    def _exclusive_access(self) -> Iterator[None]:
        """Exclude other threads while the block runs, and release the file's lock if the file cannot be written.

        A window that waits for the decision of its user must not block the other windows.
        """
        try:
            with self._writing:
                try:
                    yield
                except NamedFileConflictError:
                    self._release()
                    raise
        finally:
            if self._is_closed:
                self.close()

    def _resolved_path(self) -> Path:
        return self.path.resolve() if self.path.is_symlink() else self.path

    def _release(self) -> None:
        lock, self._lock = self._lock, None
        if lock is not None:
            lock.release()

    def _take_lock(self) -> None:
        if self._lock is not None or self._is_closed:
            return
        try:
            self._lock = NamedLock.take(self._resolved_path())
        except LockedElsewhereError as error:
            by = "" if error.owner is None else f" (by {error.owner})"
            raise NamedFileConflictError(
                f"The file {self.path.name} is open for editing elsewhere{by}. {self._where_work_is}, and not in "
                f"{self.path.name}: close it there, or save under another name",
                self.path,
                "open-elsewhere",
            ) from error

    def _replaced_save(self, place: Path, *, replace: bool) -> FileMark | None:
        """Return the mark of the content that the next save replaces; the new save mark refers to this content."""
        if not replace:
            return self.mark
        found = read_mark(place)
        if found is None or (self.mark is not None and self.mark.generation > found.generation):
            return self.mark
        return found

    def _refuse_other_content(self, found: str | None, *, may_be_missing: bool) -> None:
        journal = _journal_of(self._resolved_path())
        if journal is not None:
            raise NamedFileConflictError(
                f"The file {self.path.name} has changes of another program that are not written into it yet: they are "
                f"in {journal.name} beside it. Nothing was written. {self._where_work_is}: close the file in the other "
                "program, save as a new file, or replace it (the replaced file is renamed)",
                self.path,
                "changed",
            )
        if found is None:
            if self.mark is None or may_be_missing:
                return
            raise NamedFileConflictError(
                f"The file {self.path.name} is no longer in {self.path.parent}: it was moved, renamed or deleted. "
                f"{self._where_work_is}: save again to write the file",
                self.path,
                "missing",
            )
        if self.mark is not None and found == self.mark.digest:
            return
        if found != self._next_digest:
            raise self._conflict(self._resolved_path())
        # The save that was interrupted has replaced the file.
        self.mark = FileMark(found)
        marked = read_mark(self._resolved_path())
        if marked is not None and marked.digest == found:
            self.mark = marked

    def _replace_locked(self, draft: Path, target: Path, *, may_be_missing: bool) -> None:
        found = _digest_of(target)
        self._refuse_other_content(found, may_be_missing=may_be_missing)
        if found is None:
            self._move_or_refuse(draft, target)
        else:
            draft.replace(target)

    def _replace_unlocked(self, draft: Path, target: Path, *, may_be_missing: bool) -> None:
        """Replace the file without a lock: move it aside and compare it there, which two windows cannot do at once."""
        aside = _free_name(target, f"being replaced {secrets.token_hex(4)}")
        try:
            target.rename(aside)
        except FileNotFoundError:
            self._refuse_other_content(None, may_be_missing=may_be_missing)
            self._move_or_refuse(draft, target)
            return
        try:
            self._refuse_other_content(_digest_of(aside), may_be_missing=may_be_missing)
            self._move_or_refuse(draft, target)
        except BaseException:
            _restore_or_rename(aside, target)
            raise
        # A program that reads the moved file can prevent its deletion (Windows); the save is complete nevertheless.
        with contextlib.suppress(OSError):
            aside.unlink()

    def _move_or_refuse(self, draft: Path, target: Path) -> None:
        try:
            move_to_new_name(draft, target)
        except FileExistsError as error:
            raise self._conflict(target) from error

    def _conflict(self, place: Path) -> NamedFileConflictError:
        kind, found = _describe_content(place, self._ct_digest)
        now = "already exists: it contains" if self.mark is None else "was changed elsewhere: it now contains"
        return NamedFileConflictError(
            f"The file {self.path.name} {now} {found}. Nothing was written to it. {self._where_work_is}: save as a "
            "new file, open the other version, or replace it (the replaced file is renamed)",
            self.path,
            kind,
        )


def read_mark(path: Path) -> FileMark | None:
    """Return the mark of the content of any file; None if there is no file at the path.

    Raises
    ------
    OSError
        If the file cannot be read.
    """
    digest = _digest_of(path)
    if digest is None:
        return None
    with contextlib.suppress(CarinaError), CaseFile.open(path, read_only=True) as case:
        save = case.save_mark
        if save is not None and _digest_of(path) == digest:
            return FileMark(digest, save.save_id, save.generation)
    return FileMark(digest)


def open_marked(path: Path) -> tuple[CaseFile, FileMark]:
    """Open a case file for reading, with the mark of exactly the content that is read.

    Raises
    ------
    CaseFileError
        If the file cannot be opened (see :meth:`carina.case.CaseFile.open`); ``case.read-only`` if another program
        keeps replacing the file.
    OSError
        If the file cannot be read.
    """
    for _ in range(OPEN_TRIES):
        digest = _digest_of(path)
        case = CaseFile.open(path, read_only=True)
        try:
            if digest is not None and _digest_of(path) == digest:
                save = case.save_mark
                return case, FileMark(digest) if save is None else FileMark(digest, save.save_id, save.generation)
        except BaseException:
            case.close()
            raise
        case.close()
    raise unusable_file_error(path, "another program keeps replacing it; try again in a moment", code="case.read-only")


def free_path_beside(path: Path) -> Path:
    """Return the first free name of the form ``NAME (2).carina`` in the folder of a case file."""
    for number in range(2, 10_000):
        free = _path_with_note(path, str(number), CASE_SUFFIX)
        if not os.path.lexists(free):
            return free
    return _path_with_note(path, secrets.token_hex(4), CASE_SUFFIX)


def _digest_of(path: Path) -> str | None:
    """Return the digest of a regular file; None if there is no file. A pipe or a device is never read."""
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except FileNotFoundError:
        return None
    with os.fdopen(descriptor, "rb", buffering=0) as file:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            return NOT_A_FILE
        return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=32)).hexdigest()


def _replace_and_keep(draft: Path, target: Path, *, is_locked: bool) -> list[Path]:
    """Replace a file, store the former file under a free name, and return the paths of the replaced content.

    With the lock, the current file keeps its name until the new file replaces it. Without a lock, the current file is
    moved first, so that a file which another window writes in between is detected and stored as well. Journals of the
    former file follow it, because they would be replayed on the new file. If the disk refuses, the former file gets its
    name back.
    """
    stored_paths: list[Path] = []
    try:
        while True:
            free = _free_name(target, f"replaced {time.strftime('%Y-%m-%d %H%M')}")
            try:
                is_there = target.exists()
                if is_there:
                    (copy_to_new_name if is_locked else move_to_new_name)(target, free)
                    stored_paths.append(free)
                _move_journals(target, free)
                if is_there and is_locked:
                    draft.replace(target)
                else:
                    move_to_new_name(draft, target)
            except (FileExistsError, FileNotFoundError):
                # Another program has used the name, or removed the file, since the check.
                if not draft.exists():
                    raise
                continue
            return stored_paths
    except BaseException:
        if stored_paths:
            with contextlib.suppress(OSError):
                _move_back(stored_paths[-1], target)
        raise


def _move_back(stored_path: Path, target: Path) -> None:
    """Move a replaced file and its journals back to the former name, unless another file has this name."""
    if not os.path.lexists(target):
        move_to_new_name(stored_path, target)
    elif stored_path.samefile(target):
        stored_path.unlink()
    else:
        return
    _move_journals(stored_path, target)


def _journal_of(path: Path) -> Path | None:
    """Return a journal beside a file, with changes that are not in the file yet; None without one."""
    for tail in JOURNALS:
        journal = companion_path(path, tail)
        with contextlib.suppress(OSError):
            if journal.lstat().st_size > 0:
                return journal
    return None


def _move_journals(path: Path, target: Path) -> None:
    for tail in JOURNALS:
        with contextlib.suppress(FileNotFoundError):
            move_to_new_name(companion_path(path, tail), companion_path(target, tail))


def _restore_or_rename(aside: Path, target: Path) -> None:
    """Move a file that was moved aside back to its name; if another file has the name by now, use a free name."""
    name = target
    while True:
        try:
            move_to_new_name(aside, name)
        except FileExistsError:
            name = _free_name(target, f"found {time.strftime('%Y-%m-%d %H%M')}")
        else:
            return


def _free_name(path: Path, note: str) -> Path:
    free, number = _path_with_note(path, note, path.suffix), 2
    while any(os.path.lexists(one) for one in (free, *(companion_path(free, tail) for tail in JOURNALS))):
        free, number = _path_with_note(path, f"{note}, {number}", path.suffix), number + 1
    return free


def _path_with_note(path: Path, note: str, suffix: str) -> Path:
    """Return the path ``NAME (note).carina`` in the folder of a file; a long name is shortened."""
    stem, tail = path.stem, f" ({note}){suffix}"
    while len(os.fsencode(stem + tail)) > MAX_NAME_BYTES and stem:
        stem = stem[:-1]
    return path.with_name(stem + tail)


def _describe_content(path: Path, ct_digest: str | None) -> tuple[ConflictKind, str]:
    """Return the kind and a description of the content of a file, for a message."""
    by = _owner_of(path)
    try:
        if not path.is_file():
            return "not-a-case", "something that is not a file"
        with CaseFile.open(path, read_only=True) as case:
            steps = [step for step in case.history() if step.holds]
            changes = "no changes" if not steps else "1 change" if len(steps) == 1 else f"{len(steps)} changes"
            last = "" if not steps else f", the last: “{_shortened_label(steps[-1].label)}”"
            if ct_digest is not None and case.digest != ct_digest:
                return "other-case", f"a case of another CT{by}, with {changes}{last}"
            return "changed", f"another version of this case{by}, with {changes}{last}"
    except (CarinaError, OSError):
        return "not-a-case", f"a file{by} that is not a Carina case, or cannot be read"


def _shortened_label(label: str) -> str:
    shown = "".join(c if c.isprintable() else " " for c in label)
    return shown if len(shown) <= MAX_LABEL else shown[: MAX_LABEL - 1] + "…"


def _owner_of(path: Path) -> str:
    """Return ``by USER`` after a space if the file belongs to another user of this computer; else an empty text."""
    with contextlib.suppress(OSError, KeyError, ImportError, AttributeError):
        import pwd  # The module exists on POSIX only.

        owner = path.stat().st_uid
        if owner != os.geteuid():
            return f" by {pwd.getpwuid(owner).pw_name}"
    return ""
