"""Values that requests to a PACS return."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from carina.display import one_line

__all__ = ["CheckStep", "ConnectionCheck", "PacsSeries", "PacsStudies", "PacsStudy", "Retrieved", "Stored"]


@one_line
@dataclass(frozen=True, slots=True)
class PacsStudy:
    """A study that a search found; its repr omits the patient."""

    uid: str = field(repr=False)
    patient_name: str = field(repr=False)
    patient_id: str = field(repr=False)
    date: str
    """ISO date; empty if the PACS states none."""
    description: str
    modalities: tuple[str, ...]
    num_series: int | None

    def to_json(self) -> dict[str, Any]:
        """Return the study as plain JSON types."""
        return {
            "uid": self.uid, "patient_name": self.patient_name, "patient_id": self.patient_id, "date": self.date,
            "description": self.description, "modalities": list(self.modalities), "num_series": self.num_series,
        }  # fmt: skip


@one_line
@dataclass(frozen=True, slots=True)
class PacsStudies:
    """Studies that a search found, the newest first: a sequence, with a field that states whether there are more.

    Examples
    --------
    >>> found = PacsStudies((), has_more=False)
    >>> len(found), list(found), found.has_more
    (0, [], False)
    """

    studies: tuple[PacsStudy, ...]
    has_more: bool
    """Whether the PACS has further matches that are not in ``studies``; narrow the search to see them."""

    def __iter__(self) -> Iterator[PacsStudy]:
        """Iterate over the studies."""
        return iter(self.studies)

    def __len__(self) -> int:
        """Return the number of the studies."""
        return len(self.studies)

    def __getitem__(self, index: int) -> PacsStudy:
        """Return a study by its index."""
        return self.studies[index]

    def to_json(self) -> dict[str, Any]:
        """Return the studies as plain JSON types."""
        return {"studies": [study.to_json() for study in self.studies], "has_more": self.has_more}


@one_line
@dataclass(frozen=True, slots=True)
class PacsSeries:
    """A series of a study in a PACS."""

    uid: str = field(repr=False)
    study_uid: str = field(repr=False)
    modality: str
    description: str
    number: int | None
    num_images: int | None
    """Number of images; None if the PACS does not state the number."""

    def to_json(self) -> dict[str, Any]:
        """Return the series as plain JSON types."""
        return {
            "uid": self.uid, "study_uid": self.study_uid, "modality": self.modality, "description": self.description,
            "number": self.number, "num_images": self.num_images,
        }  # fmt: skip


@one_line
@dataclass(frozen=True, slots=True)
class CheckStep:
    """One step of a connection test."""

    name: str
    passed: bool
    message: str
    """Result or reason, with a remedy after a failure."""


@one_line
@dataclass(frozen=True, slots=True)
class ConnectionCheck:
    """Result of a connection test."""

    steps: tuple[CheckStep, ...]

    @property
    def passed(self) -> bool:
        """Whether all steps passed."""
        return all(step.passed for step in self.steps)

    def to_json(self) -> dict[str, Any]:
        """Return the test as plain JSON types."""
        steps = [{"name": step.name, "passed": step.passed, "message": step.message} for step in self.steps]
        return {"passed": self.passed, "steps": steps}


@one_line
@dataclass(frozen=True, slots=True)
class Retrieved:
    """Result of a retrieval."""

    folder: Path
    num_retrieved: int
    num_resumed: int
    """Number of images that an earlier retrieval had already stored."""

    def to_json(self) -> dict[str, Any]:
        """Return the result as plain JSON types."""
        return {"folder": str(self.folder), "num_retrieved": self.num_retrieved, "num_resumed": self.num_resumed}


@one_line
@dataclass(frozen=True, slots=True)
class Stored:
    """Result of sending files to a PACS."""

    num_stored: int
    refused: tuple[tuple[str, str], ...]
    """Name of each file that the PACS did not store, with the reason."""

    def to_json(self) -> dict[str, Any]:
        """Return the result as plain JSON types."""
        return {
            "num_stored": self.num_stored,
            "refused": [{"file": name, "reason": reason} for name, reason in self.refused],
        }
