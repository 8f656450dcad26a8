"""Preview of a CT that is being opened: one slice, which is decoded before all others."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field

from carina.display import one_line

__all__ = ["OpeningPreview", "PreviewSlice", "preview_listener", "previews_to"]


@one_line
@dataclass(frozen=True, slots=True)
class PreviewSlice:
    """One axial slice of a CT that is being opened, seen from the feet: the patient's right is on the left."""

    png: bytes = field(repr=False)
    """Grey PNG of at most 256x256 pixels: HU in a lung window, other values in their own range."""
    number: int
    """Number of the slice from 1 to ``num_slices``, in the order of the volume."""
    num_slices: int
    height_lps_mm: float
    """Position of the slice's centre along the axis to the head, LPS mm."""
    size_mm: tuple[float, float]
    """Width and height of the picture in mm."""
    is_hu: bool
    """Whether the values of the slice are HU in the lung window."""


@one_line
@dataclass(frozen=True, slots=True)
class OpeningPreview:
    """What is known about a CT before its voxels are read."""

    slice: PreviewSlice | None = None
    """A slice near the middle; None if it is not axial, or cannot be decoded with certainty."""


# A context variable, because no function between the session and the reader of a series needs the listener.
_listener: ContextVar[Callable[[OpeningPreview], None] | None] = ContextVar("carina_opening_preview", default=None)


@contextmanager
def previews_to(listener: Callable[[OpeningPreview], None]) -> Iterator[None]:
    """Call ``listener`` with the preview of each DICOM series that is opened in the block, in the opening thread."""
    before = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(before)


def preview_listener() -> Callable[[OpeningPreview], None] | None:
    """Return the listener of the current block of :func:`previews_to`; None outside such a block."""
    return _listener.get()
