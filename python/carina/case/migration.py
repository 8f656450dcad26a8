"""Migration of case files of older versions of Carina to the current format."""

from __future__ import annotations

import contextlib
import shutil
from pathlib import Path

from carina.case.database import convert_disk_errors, open_connection
from carina.case.file import CaseFile
from carina.case.sqlite_journals import has_journal
from carina.disk import drafted
from carina.disk.move_files import move_to_new_name


def migrate(path: Path | str, target: Path | str) -> None:
    """Write a case of an older version of Carina to a new file in the current format; the original stays unchanged.

    Parameters
    ----------
    path
        The case of an older version.
    target
        The new file; it must not exist.

    Raises
    ------
    CaseFileError
        As in :meth:`CaseFile.open`.
    DiskError
        If the new file cannot be written, or the target exists.
    """
    with CaseFile.open(path, read_only=True) as case:
        case.write_copy(target, ct_place=case.source.path, placement=move_to_new_name)


def migrate_live(path: Path) -> Path:
    """Migrate a live file of an older version of Carina in place; the caller must own the case.

    The file is first copied to a new name, so a complete case exists at every moment.

    Returns
    -------
    Path
        Copy of the file in the old format.

    Raises
    ------
    CaseFileError
        As in :meth:`CaseFile.open`.
    DiskError
        If a file cannot be written; the live file then stays unchanged.
    """
    with CaseFile.open(path, read_only=True) as case, convert_disk_errors(path):
        if has_journal(path):
            # CaseFile.open has checked the journal in a copy, so it is safe to write the journal into the file.
            with contextlib.closing(open_connection(path, "rw")) as live:
                live.execute("PRAGMA journal_mode=DELETE")
        with contextlib.closing(open_connection(path, "ro", immutable=True)) as old:
            schema = old.execute("PRAGMA user_version").fetchone()[0]
        before = path.with_name(f"{path.stem}-schema-{schema}{path.suffix}")
        size = path.stat().st_size
        with (
            drafted(before, what="the case", needed_bytes=size, private=True, lasting=True) as file,
            path.open("rb") as whole,
        ):
            shutil.copyfileobj(whole, file, 1 << 20)
        case.write_copy(path, ct_place=case.source.path, private=True)
    return before
