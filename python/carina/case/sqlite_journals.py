"""SQLite journals beside a case file: checks before a journal is copied or replayed, and the copy."""

from __future__ import annotations

import errno
import logging
import os
import shutil
import stat
from pathlib import Path
from typing import Final

from carina.case.error_texts import CaseFileError, unusable_file_error
from carina.disk import check_regular, disk_trouble, open_regular, say_size, special_kind
from carina.errors import VolumeImportError

logger = logging.getLogger(__name__)

JOURNALS: Final = ("-wal", "-journal")
MAX_JOURNAL_BYTES: Final = 16 << 30
"""Maximum size of a journal in bytes.

The journal of a live case is truncated to 16 MB after each checkpoint, unless a CT was stored through it.
"""
MAX_CASE_BYTES: Final = 32 << 30
"""Maximum size in bytes of a case file that is copied: at most 2 GB of work and a packed CT."""
COPY_AGAIN: Final = 5
"""Maximum number of attempts to copy a case file that another program changes during the copy."""
WAL_MAGIC: Final = (b"\x37\x7f\x06\x82", b"\x37\x7f\x06\x83")
WAL_VERSION: Final = (3_007_000).to_bytes(4, "big")
WAL_HEADER_BYTES: Final = 32
FRAME_HEADER_BYTES: Final = 24
JOURNAL_MAGIC: Final = b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7"
PAGE_BYTES: Final = tuple(1 << power for power in range(9, 17))


def companion_path(path: Path, tail: str) -> Path:
    """Return the path of a file that SQLite creates beside a database, such as a journal."""
    return path.with_name(path.name + tail)


def has_journal(path: Path) -> bool:
    """Return whether a case file has a journal, which contains the last changes of a case that was not closed."""
    return any(companion_path(path, tail).exists() for tail in JOURNALS)


def check_files(path: Path) -> None:
    """Raise an error for a file that is not regular, a journal that is too large, or one that names another file.

    Only a few bytes of the files are read. A journal with a damaged beginning passes, because SQLite does not replay
    it.

    Raises
    ------
    CaseFileError
        ``case.not-a-case`` if the path is not a file; ``case.damaged`` for a journal.
    OSError
        If a file cannot be read.
    """
    for tail in ("", *JOURNALS, "-shm"):
        part = companion_path(path, tail)
        special = special_kind(part)
        if special is not None:
            raise unusable_file_error(
                path, f"{part.name}: expected a file, found {special}; choose a .carina file", code="case.not-a-case"
            )
    for tail in JOURNALS:
        journal = companion_path(path, tail)
        try:
            file = open_regular(journal)
        except FileNotFoundError:
            continue
        except VolumeImportError:
            found = special_kind(journal) or "a folder"
            raise _not_a_journal_error(path, journal, f"expected a file, found {found}") from None
        with file:
            size = os.fstat(file.fileno()).st_size
            file.seek(max(0, size - len(JOURNAL_MAGIC)))
            end = file.read(len(JOURNAL_MAGIC))
        if size > MAX_JOURNAL_BYTES:
            raise _not_a_journal_error(
                path, journal, f"expected at most {say_size(MAX_JOURNAL_BYTES)}, found {say_size(size)}"
            )
        if tail == "-journal" and end == JOURNAL_MAGIC:
            # The end of this journal names a super-journal, a file of any name that SQLite deletes after the replay.
            raise _not_a_journal_error(
                path, journal, "expected the journal of one database, found one that names a file of another"
            )


def rename_foreign_file(path: Path) -> None:
    """Rename a file that has the name of a journal but is not one, because SQLite would overwrite it.

    A power cut can also leave such a file: a journal whose beginning the disk did not store.
    """
    for tail in JOURNALS:
        journal = companion_path(path, tail)
        try:
            with open_regular(journal) as file:
                head = file.read(WAL_HEADER_BYTES)
        except FileNotFoundError:
            continue
        if not head.strip(b"\x00") or _is_replayed(tail, head):
            continue
        number = 1
        while (target := companion_path(journal, f".not-a-journal-{number}")).exists():
            number += 1
        journal.rename(target)
        logger.warning("a file beside a case was not its journal; it was renamed")


def _is_replayed(tail: str, head: bytes) -> bool:
    """Return whether SQLite replays a journal with these first bytes."""
    if tail == "-journal":
        return head[:8] == JOURNAL_MAGIC
    is_log = len(head) == WAL_HEADER_BYTES and head[:4] in WAL_MAGIC and head[4:8] == WAL_VERSION
    return is_log and int.from_bytes(head[8:12], "big") in PAGE_BYTES


def copied_with_journal(path: Path, folder: Path) -> Path:
    """Copy a case file and its journals, in a consistent state, into a private folder.

    Parameters
    ----------
    path
        The case file.
    folder
        Folder for the copy.

    Returns
    -------
    Path
        The copied case file; its journals are beside it.

    Raises
    ------
    CaseFileError
        As in :func:`check_files`; ``case.damaged`` if the file is too large, ``case.read-only`` if another program
        keeps changing the file.
    DiskError
        ``disk.full``, before anything is copied, if the folder's disk has too little space.
    """
    check_files(path)
    parts = [path, *(companion_path(path, tail) for tail in JOURNALS)]
    for _ in range(COPY_AGAIN):
        before = [_file_state(part) for part in parts]
        sizes = [
            0 if stamp is None else _num_used_bytes(part, part.name[len(path.name) :], stamp[1])
            for part, stamp in zip(parts, before, strict=True)
        ]
        _check_free_space(path, sum(sizes), folder)
        for part, size in zip(parts, sizes, strict=True):
            target = folder / ("case.carina" + part.name[len(path.name) :])
            target.unlink(missing_ok=True)
            if size or part is path:
                _copy(part, target, size)
        if [_file_state(part) for part in parts] == before:
            # The copy is checked again, because the original may have changed between its check and the copy.
            check_files(folder / "case.carina")
            return folder / "case.carina"
        check_files(path)
    raise unusable_file_error(
        path,
        "another program keeps changing it; close the case in that program, or try again in a moment",
        code="case.read-only",
    )


def _num_used_bytes(part: Path, tail: str, size: int) -> int:
    """Return the number of bytes of a database or journal that SQLite reads.

    Of a write-ahead log, only the frames of the latest run count.
    """
    if not tail:
        return size
    with open_regular(part) as file:
        head = file.read(WAL_HEADER_BYTES)
        if not _is_replayed(tail, head):
            return 0
        if tail == "-journal":
            return size
        salts, frame_bytes = head[16:24], FRAME_HEADER_BYTES + int.from_bytes(head[8:12], "big")
        end = WAL_HEADER_BYTES
        while end + frame_bytes <= size:
            file.seek(end)
            # Frames of an earlier run have other salt values; SQLite stops at the first such frame.
            if file.read(FRAME_HEADER_BYTES)[8:16] != salts:
                break
            end += frame_bytes
    return end


def _copy(part: Path, target: Path, size: int) -> None:
    """Copy the first ``size`` bytes of a file; if the file grows meanwhile, the caller copies it again."""
    with open_regular(part) as source, target.open("wb") as copy:
        left = size
        while left > 0 and (piece := source.read(min(left, 1 << 20))):
            copy.write(piece)
            left -= len(piece)


def _check_free_space(path: Path, size: int, folder: Path) -> None:
    """Raise an error if a case with its journals is too large, or larger than the free space of a folder."""
    if size > MAX_CASE_BYTES:
        raise unusable_file_error(
            path,
            f"expected at most {say_size(MAX_CASE_BYTES)} with its journal, found {say_size(size)}; "
            "open an earlier copy",
            code="case.damaged",
        )
    if size > shutil.disk_usage(folder).free:
        full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        raise disk_trouble(full, "cannot make a temporary copy of the case in", folder, needed_bytes=size)


def _file_state(path: Path) -> tuple[int, int, int] | None:
    """Return inode, size and time of change of a file, to detect changes; None if the file is missing."""
    try:
        found = path.stat()
    except FileNotFoundError:
        return None
    if not stat.S_ISREG(found.st_mode):
        check_regular(path)
    return found.st_ino, found.st_size, found.st_mtime_ns


def _not_a_journal_error(path: Path, journal: Path, why: str) -> CaseFileError:
    return unusable_file_error(
        path,
        f"the file {journal.name} beside it is not the journal of a case: {why}; move that file to another folder "
        "and open the case again",
        code="case.damaged",
    )
