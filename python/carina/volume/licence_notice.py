"""Citation of a case that others published: authors, source and licence."""

from __future__ import annotations

from carina.value import FrozenValue


class Citation(FrozenValue, frozen=True):
    """Source and licence of a case; ``str()`` of a citation is one line of text."""

    authors: str
    year: int
    title: str
    publisher: str
    doi: str
    licence: str
    changes: str
    """Changes made to the original data."""
    collection: str
    """Short title."""

    def __str__(self) -> str:
        """Return the citation as one line of text."""
        return (
            f"{self.authors} ({self.year}). {self.title}. {self.publisher}. https://doi.org/{self.doi} \u00b7 "
            f"Licence: {self.licence}. Changed: {self.changes}."
        )
