"""Repair of unreadable records: each record is moved aside, and its case stays in the list."""

from __future__ import annotations

import contextlib
import logging
import os
import sqlite3
from pathlib import Path
from typing import Final

from carina.case import CaseFile
from carina.disk.locks import try_lock
from carina.errors import CarinaError
from carina.installation import carina_command
from carina.session.store.registry import FILE, LOCK, RECORD, CaseRecord, CaseRecords, is_damaged_record, write_record

logger = logging.getLogger(__name__)

ASIDE: Final = ".damaged"
"""Name of the folder of damaged cases, beside the folders of the other cases; Carina does not list its content."""


def repair_records(records: CaseRecords) -> tuple[str, ...]:
    """Move unreadable records aside and make new records of their cases; no file is deleted.

    The new record is made from the live case file, which is not moved. If that file is unreadable too, the whole folder
    of the case is moved to :data:`ASIDE`. A case that another process has open is not changed.

    Returns
    -------
    tuple of str
        A message for the user for each case.
    """
    messages = []
    for path in sorted(records.folder.glob(f"*/{RECORD}")):
        if is_damaged_record(path):
            try:
                message = _repair(records, path.parent)
            except (OSError, CarinaError) as error:
                # If the disk refuses, the case is missing from the list, and Carina starts.
                logger.warning("an unreadable record could not be moved aside (%s)", type(error).__name__)
                continue
            if message is not None:
                messages.append(message)
    return tuple(messages)


def _repair(records: CaseRecords, folder: Path) -> str | None:
    descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o600)
    try:
        # The owner of an open case writes its record again. The lock also excludes a repair by a second process.
        if try_lock(descriptor) is False or not is_damaged_record(folder / RECORD):
            return None
        made = _record_of(folder)
        if made is not None:
            _move_aside(folder / RECORD, folder, "record.damaged", ".json")
            write_record(folder, made)
            return (
                f"The record of the saved case {made.case_id} was damaged. The case is in the list again, under the "
                "name Restored case; its name, the date of its last use and the location of its scan are lost. The "
                "damaged record is kept beside the case."
            )
    finally:
        os.close(descriptor)
    aside = records.folder / ASIDE
    aside.mkdir(mode=0o700, exist_ok=True)
    moved = _move_aside(folder, aside, folder.name, "")
    command = carina_command("case", "rescue")
    return (
        f"The record of the saved case {folder.name} and its case file are damaged. Its files were moved to the folder "
        f"{ASIDE}/{moved.name} of the stored cases; nothing was deleted. Use `{command}` on {FILE} there to "
        "recover its intact parts."
    )


def _record_of(folder: Path) -> CaseRecord | None:
    """Return a record made from the live case file; None if that file is unreadable."""
    path = folder / FILE
    try:
        used_s = path.stat().st_mtime
        with CaseFile.open(path, read_only=True) as case:
            digest, steps, holds_ct = case.digest, case.history(), case.holds_ct
    except (OSError, CarinaError, sqlite3.Error):
        return None
    last_s = max((step.at_s for step in steps), default=0.0)
    with contextlib.suppress(ValueError):
        return CaseRecord(
            case_id=folder.name,
            digest=digest,
            place=None,
            begun_s=used_s - last_s,
            used_s=used_s,
            num_changes=sum(step.holds for step in steps),
            alias="Restored case",
            holds_ct=holds_ct,
        )
    return None


def _move_aside(path: Path, folder: Path, stem: str, suffix: str) -> Path:
    """Move a file or folder into another folder, under a free name, and return the new path."""
    number = 1
    while (target := folder / f"{stem}-{number}{suffix}").exists():
        number += 1
    path.rename(target)
    return target
