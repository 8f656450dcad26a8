"""Notes and errors as an observer may read them: without names of files and texts of series, which may be a patient's.

The words of a note about the scan may name slices by their files. Only codes whose words are known to hold no name pass
as they are; every other code, also one that is added later, is replaced by a sentence that names the code.
"""

from __future__ import annotations

from collections.abc import Sequence

from msgspec.structs import replace

from carina.server import messages as wire

__all__ = ["observer_error", "observer_notes"]

ABOUT_THE_SCAN = "import."
WITHOUT_NAMES = frozenset(
    {
        "import.clipped",
        "import.lossy",
        "import.not-numbers",
        "import.orientation-doubted",
        "import.part-of-stack",
        "import.rescale-absent",
        "import.scaling",
        "import.two-patients",
    }
)
"""Codes whose words hold numbers and fixed text alone."""
FIXED_WORDS = {"import.not-hu": "the values of this volume are not in Hounsfield units"}
"""The words of these codes quote tags of the file."""
ERRORS_WITHOUT_NAMES = frozenset({"session.watching", "session.pick", "session.no-case"})


def observer_notes(notes: Sequence[wire.CaseNote]) -> tuple[wire.CaseNote, ...]:
    """Return the lasting notes, in words without names of files."""
    return tuple(replace(note, words=_words(note)) for note in notes if note.badge)


def _words(note: wire.CaseNote) -> str:
    if not note.code.startswith(ABOUT_THE_SCAN) or note.code in WITHOUT_NAMES:
        return note.words
    asks = f"the scan check found a problem ({note.code}): ask the person at the workstation for the details"
    return FIXED_WORDS.get(note.code, asks)


def observer_error(error: wire.Error) -> wire.Error:
    """Return an error with its code, and with its text where that holds no name."""
    if error.code in ERRORS_WITHOUT_NAMES:
        return error
    return replace(error, message=f"this is not available to observers ({error.code})", action=None)
