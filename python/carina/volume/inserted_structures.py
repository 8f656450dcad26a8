"""Structures that were inserted into a CT: their permanent note, and the mark in the header of a saved file.

A CT with an inserted nodule must never be mistaken for the patient's. The mark is a fixed text in the header, which
NIfTI (``descrip``), NRRD and MetaImage (``note``) store; a file with the mark opens with the note.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from carina.volume.model import Note, VolumeSource

INSERTED = "import.inserted"
"""Code of the permanent note on a CT into which structures were inserted."""
INSERTED_TITLE = "Inserted nodule: "
"""Beginning of the title of a CT with inserted structures."""
INSERTED_BEGINNING = "inserted: "
"""Beginning of the text of the permanent note on inserted structures."""
SECOND_CT_WORDS = (
    f"{INSERTED_BEGINNING}Carina inserted a nodule into the second CT for training, not the patient's: do not use this "
    "movement for a patient"
)
"""Note of a movement that was measured with a second CT with inserted structures."""
MAX_INSERTED = 999
"""Maximum number of structures that are read from a file; a larger number in a header or a case counts as this one."""
PICTURE_TEXT = "INSERTED NODULE: NOT THE PATIENT'S"
"""Text in saved pictures of a CT with inserted structures."""
_TAG = "CARINA-INSERTED"
_MARK = re.compile(rb"CARINA-INSERTED (\d{1,9}): ([ -~]{0,2000})")
_NUMBER = r"-?\d{1,5}\.\d"
_STRUCTURE = re.compile(rf"[a-z]+(?:-[a-z]+)? nodule, {_NUMBER} mm, at {_NUMBER} {_NUMBER} {_NUMBER}")
_NOT_DESCRIBED = "nodule that the file does not describe"
_MAX_NAMED = 6


def structure_text(kind: str, diameter_mm: float, centre_lps: Sequence[float]) -> str:
    """Return the description of an inserted nodule, such as ``solid nodule, 8.0 mm, at -41.0 12.0 -180.0``."""
    x, y, z = (float(v) + 0.0 for v in centre_lps)
    return f"{kind} nodule, {diameter_mm:.1f} mm, at {x:.1f} {y:.1f} {z:.1f}"


def inserted_note(structures: Sequence[str]) -> Note:
    """Return the permanent note of a CT with these inserted structures."""
    shown = "; ".join(structures[:_MAX_NAMED])
    more = f"; and {len(structures) - _MAX_NAMED} more" if len(structures) > _MAX_NAMED else ""
    many = f"{len(structures)} nodules were" if len(structures) > 1 else "a nodule was"
    words = (
        f"{INSERTED_BEGINNING}{many} inserted into this CT by Carina for training, not the patient's "
        f"({shown}{more}; LPS mm): do not use this CT for a patient"
    )
    return Note(INSERTED, words, badge=True)


def with_inserted(source: VolumeSource, structures: Sequence[str]) -> VolumeSource:
    """Return the origin of a CT after structures were inserted into it, with one note for all and a title.

    Parameters
    ----------
    source
        Origin of the CT before the insertion; it may already have inserted structures.
    structures
        Descriptions by :func:`structure_text`.
    """
    if not structures:
        return source
    every = (*source.inserted, *structures)
    notes = (inserted_note(every), *(note for note in source.notes if note.code != INSERTED))
    title = source.title if source.title.startswith(INSERTED_TITLE) else INSERTED_TITLE + source.title
    return replace(source, title=title, notes=notes, inserted=every)


def picture_mark(source: VolumeSource) -> str | None:
    """Return the text for each picture and each frame of a video of a CT; None without inserted structures."""
    return PICTURE_TEXT if source.inserted else None


def file_mark(source: VolumeSource) -> str | None:
    """Return the text that marks a saved CT with inserted structures; None for a CT without them."""
    if not source.inserted:
        return None
    return f"{_TAG} {len(source.inserted)}: {'; '.join(source.inserted)}"


def marked_structures(head: bytes) -> tuple[str, ...]:
    """Return the structures that the mark in a file's header names; empty without a mark.

    A header may cut the text off. Then the number of structures is right, and some have no description.
    """
    found = _MARK.search(head)
    if found is None:
        return ()
    count = min(max(int(found[1]), 1), MAX_INSERTED)
    named = [one for one in found[2].decode("ascii").split("; ") if _STRUCTURE.fullmatch(one)][:count]
    return (*named, *([_NOT_DESCRIBED] * (count - len(named))))
