"""Notes and errors for observers, without file names and series texts, which may contain the patient's name.

The text of a note about the scan may contain file names of slices. A text passes unchanged only if its code is known
to have a text without names. The text of every other code, also of future codes, is replaced by a sentence with the
code.
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
"""Codes whose texts contain only numbers and fixed text."""
FIXED_WORDS = {"import.not-hu": "the values of this volume are not in Hounsfield units"}
"""Replacement texts of codes whose original texts quote DICOM tags of the file."""
ERRORS_WITHOUT_NAMES = frozenset({"session.watching", "session.pick", "session.no-case"})


def observer_notes(notes: Sequence[wire.CaseNote]) -> tuple[wire.CaseNote, ...]:
    """Return the notes that are shown permanently, without file names in their texts."""
    return tuple(replace(note, words=_words(note)) for note in notes if note.badge)


def _words(note: wire.CaseNote) -> str:
    if not note.code.startswith(ABOUT_THE_SCAN) or note.code in WITHOUT_NAMES:
        return note.words
    asks = f"the scan check found a problem ({note.code}): ask the person at the workstation for the details"
    return FIXED_WORDS.get(note.code, asks)


def observer_error(error: wire.Error) -> wire.Error:
    """Return an error with its code; its text stays only if it cannot contain a file name."""
    if error.code in ERRORS_WITHOUT_NAMES:
        return error
    return replace(error, message=f"this is not available to observers ({error.code})", action=None)
