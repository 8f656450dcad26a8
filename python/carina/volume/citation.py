"""What a case that others gave away must be shown with: who made it, where it is from, and under which licence."""

from __future__ import annotations

from carina.value import FrozenValue

__all__ = ["Citation"]


class Citation(FrozenValue, frozen=True):
    """Source and licence of a case; the window is sent it as it is. As text it is one line."""

    authors: str
    year: int
    title: str
    publisher: str
    doi: str
    licence: str
    changes: str
    """What was done to the original."""
    collection: str
    """The title in short."""

    def __str__(self) -> str:
        return (
            f"{self.authors} ({self.year}). {self.title}. {self.publisher}. https://doi.org/{self.doi} \u00b7 "
            f"Licence: {self.licence}. Changed: {self.changes}."
        )
