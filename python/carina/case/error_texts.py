"""Errors of case files, with their messages."""

from __future__ import annotations

from pathlib import Path

from carina.errors import VolumeImportError

MAX_FOUND_CHARS = 120
"""Maximum number of characters of a file's content that an error message quotes."""


class CaseFileError(VolumeImportError):
    """Error for a case file that cannot be opened; the message names the file and a remedy.

    ``code`` is ``case.not-a-case``, ``case.newer``, ``case.older``, ``case.damaged``, ``case.other-scan``,
    ``case.empty``, ``case.read-only``, ``case.closed`` or ``case.sqlite``.
    """

    code = "case"


def unusable_file_error(path: Path | str, why: str, *, code: str) -> CaseFileError:
    """Return the error for a file that is not a case file, or for a case file that cannot be used.

    Parameters
    ----------
    path
        The file.
    why
        Expected and found content, and a remedy.
    code
        Code of the error.
    """
    return CaseFileError(f"{path}: this case cannot be opened: {why}", code=code)


def damage_error(where: str, expected: str, found: str) -> CaseFileError:
    """Return the error for damage in one part of a case file; long content is shortened in the message.

    Parameters
    ----------
    where
        Name of the damaged part.
    expected, found
        Expected and found content.
    """
    if len(found) > MAX_FOUND_CHARS:
        found = f"{found[:MAX_FOUND_CHARS]}… ({len(found)} characters)"
    return CaseFileError(
        f"the case file is damaged ({where}: expected {expected}, found {found}); open an earlier copy, or rescue the "
        "intact parts of this one",
        code="case.damaged",
    )
