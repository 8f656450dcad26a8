"""Texts of the notes on a scan that contain no file names, which may contain names of patients."""

from __future__ import annotations

__all__ = ["WITHOUT_NAMES", "words_without_names"]

ABOUT_THE_SCAN = "import."
"""Beginning of the codes of notes that the import of a scan writes."""
WITHOUT_NAMES = frozenset(
    {
        "import.clipped",
        "import.inserted",
        "import.lossy",
        "import.not-numbers",
        "import.orientation-doubted",
        "import.part-of-stack",
        "import.rescale-absent",
        "import.scaling",
        "import.slices-interpolated",
        "import.slices-resampled",
        "import.tilt-corrected",
        "import.two-patients",
    }
)
"""Note codes whose texts contain only numbers and fixed text."""
FIXED_WORDS = {"import.not-hu": "the values of this volume are not in Hounsfield units"}
"""Replacement texts, by note code, for notes whose original texts quote DICOM tags of the file."""


def words_without_names(code: str, words: str) -> str | None:
    """Return the text of a note, or a fixed text instead; None if the text may contain a file name.

    Parameters
    ----------
    code, words
        Code and text of the note.
    """
    if not code.startswith(ABOUT_THE_SCAN) or code in WITHOUT_NAMES:
        return words
    return FIXED_WORDS.get(code)
