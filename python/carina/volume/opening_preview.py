"""Preview of a CT that is being opened: the series of its folder, and one slice, which is decoded before all others."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from carina.display import one_line
from carina.volume.model import SeriesInfo

if TYPE_CHECKING:
    from carina.volume.dicom import FoundSeries

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

    series: tuple[SeriesInfo, ...]
    """All series of the folder or archive, the likeliest chest CT first."""
    chosen_key: str
    """Key of the series that is being opened."""
    num_patients: int
    """Number of patients whose images the folder contains, according to the tags."""
    found: tuple[FoundSeries, ...] = field(default=(), repr=False)
    """The same series with the headers of their slices, from which pictures are made."""
    slice: PreviewSlice | None = None
    """A slice of the chosen series near the middle.

    None before the slice is decoded, if it is not axial, and if it cannot be decoded with certainty.
    """


# A context variable, because no function between the session and the reader of a series needs the listener.
_listener: ContextVar[Callable[[OpeningPreview], None] | None] = ContextVar("carina_opening_preview", default=None)


@contextmanager
def previews_to(listener: Callable[[OpeningPreview], None]) -> Iterator[None]:
    """Call ``listener`` with the preview of each DICOM series that is opened in the block, in the opening thread.

    The first call is made after the headers are sorted, the second call after the slice is decoded.
    """
    before = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(before)


def preview_listener() -> Callable[[OpeningPreview], None] | None:
    """Return the listener of the current block of :func:`previews_to`; None outside such a block."""
    return _listener.get()
