"""What is wrong with a case file, in words."""

from __future__ import annotations

from pathlib import Path

from carina.errors import VolumeImportError

__all__ = ["CaseFileError", "damaged", "refused"]


MAX_FOUND_CHARS = 120
"""Longest content of a file that a message quotes."""


class CaseFileError(VolumeImportError):
    """A case file that is not opened; the message names it and says what to do.

    ``code`` is ``case.not-a-case``, ``case.newer``, ``case.older``, ``case.damaged``, ``case.other-scan``,
    ``case.empty``, ``case.read-only``, ``case.closed`` or ``case.sqlite``.
    """

    code = "case"


def refused(path: Path | str, why: str, *, code: str) -> CaseFileError:
    """A file that is none of ours, or cannot be used: ``why`` says what was expected and found, and what to do."""
    return CaseFileError(f"{path}: this case cannot be opened: {why}", code=code)


def damaged(where: str, expected: str, found: str) -> CaseFileError:
    """Return the refusal of a case file because of one part; long content is shortened in the message."""
    if len(found) > MAX_FOUND_CHARS:
        found = f"{found[:MAX_FOUND_CHARS]}… ({len(found)} characters)"
    return CaseFileError(
        f"the case file is damaged ({where}: expected {expected}, found {found}); open an earlier copy, or rescue the "
        "intact parts of this one",
        code="case.damaged",
    )
