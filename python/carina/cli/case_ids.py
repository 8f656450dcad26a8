"""Lookup of stored cases by the ID that a command receives instead of a path."""

from __future__ import annotations

import os
import re
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from carina.cli.console import print_note
from carina.config import load_settings
from carina.errors import UsageError

if TYPE_CHECKING:
    from carina.session import CaseRecord, CaseRecords

MIN_ID_CHARS: Final = 4
"""Minimum length of an ID prefix: shorter ones would match by accident. `carina case list` shows at least six."""
_ID: Final = re.compile(rf"[0-9a-f]{{{MIN_ID_CHARS},64}}", re.IGNORECASE)


def stored_case(path: Path) -> CaseRecord | None:
    """Find the stored case whose id begins with the argument; a file or folder of that name takes precedence.

    Returns
    -------
    CaseRecord or None
        None if the argument is a path.

    Raises
    ------
    UsageError
        ``case.unknown``: if the argument is not a path, and no stored case or several cases match.
    """
    text = str(path)
    if _ID.fullmatch(text) is None or os.path.lexists(path):
        return None
    found = [one for one in _records().all() if one.case_id.startswith(text.lower())]
    exact = [one for one in found if one.case_id == text.lower()]
    if len(exact or found) == 1:
        return (exact or found)[0]
    if found:
        raise UsageError(
            f"{len(found)} cases on this machine have an id that begins with {text}; give more of its characters "
            "(`carina case list` shows the ids)",
            code="case.unknown",
        )
    raise UsageError(
        f"{text} is neither a file or folder nor the id of a case on this machine; check the path, or choose an id "
        "that `carina case list` shows",
        code="case.unknown",
    )


def path_or_case(path: Path | None) -> Path | None:
    """Return an argument that is a path, or the live file of the stored case that the argument names.

    A command only reads the live file, also while a window writes the file: :class:`carina.case.CaseFile` reads the
    last saved state from a copy.

    Raises
    ------
    UsageError
        ``case.unknown``: if the argument is not a path, and no stored case or several cases match.
    """
    record = None if path is None else stored_case(path)
    if record is None:
        return path
    records = _records()
    open_now = "; it is open in Carina, so its last saved state is used" if records.is_held(record) else ""
    print_note(f"note: stored case {record.case_id}, {record.shown_title}{open_now}")
    return records.path_of(record)


def _records() -> CaseRecords:
    from carina.session import CaseRecords  # slow import, and few arguments are IDs

    return CaseRecords(load_settings().cases_dir, time.time)
