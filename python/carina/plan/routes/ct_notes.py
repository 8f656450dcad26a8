"""Notes of the CT and of its airways that limit every plan: lasting notes, and slices that are thick for planning."""

from __future__ import annotations

from carina.track import Airways
from carina.volume import Volume, badges_of
from carina.volume.note_privacy import words_without_names

__all__ = ["ct_notes"]

THICK_MM = 1.5
"""Distance in mm between slices above which small airways are hidden and boundaries blurred."""


def ct_notes(volume: Volume, airways: Airways) -> tuple[str, ...]:
    """Return the lasting notes of a CT and of its airways, and a note on thick slices, as texts.

    The texts contain no file names, because plans are shown to observers and printed.

    Parameters
    ----------
    volume, airways
        The CT and the airways in it.
    """
    notes = [
        words_without_names(note.code, note.words)
        or f"the scan check found a problem ({note.code}); the notes of the case state the details"
        for note in badges_of(volume, airways)
    ]
    coarsest = max(volume.spacing_mm)
    if coarsest > THICK_MM:
        notes.append(
            f"slices are {coarsest:.1f} mm apart. Planning needs 1 mm or less: small airways, narrow places and the "
            "target's boundary are less certain than on a thin-slice CT"
        )
    return tuple(dict.fromkeys(notes))
