"""References of a DICOM object to images, in a module that does not load a DICOM library."""

from __future__ import annotations

from dataclasses import dataclass, field

from carina.display import one_line


@one_line
@dataclass(frozen=True, slots=True)
class References:
    """The images that a DICOM object refers to; empty if unknown. The sets contain UIDs, which are never logged."""

    frames: frozenset[str] = field(default=frozenset(), repr=False)
    """Frames of reference: objects with a common frame of reference have a common coordinate system."""
    studies: frozenset[str] = field(default=frozenset(), repr=False)
    series: frozenset[str] = field(default=frozenset(), repr=False)
    images: frozenset[str] = field(default=frozenset(), repr=False)
