"""Which images a DICOM file belongs to; without the readers of DICOM, for whoever only passes it on."""

from __future__ import annotations

from dataclasses import dataclass, field

from carina.display import one_line

__all__ = ["References"]


@one_line
@dataclass(frozen=True, slots=True)
class References:
    """Which images something belongs to; empty where its file does not say. Never printed: UIDs."""

    frames: frozenset[str] = field(default=frozenset(), repr=False)
    """Frames of reference: what has one in common lies in one coordinate system."""
    studies: frozenset[str] = field(default=frozenset(), repr=False)
    series: frozenset[str] = field(default=frozenset(), repr=False)
    images: frozenset[str] = field(default=frozenset(), repr=False)
