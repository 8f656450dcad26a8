"""Messages about PACS: saved connections, connection test, search, retrieval, and storage of a plan.

The server answers only the window that sent the request, and only a window on the machine that runs Carina. Search
results name patients: the server neither stores nor logs them.
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from carina.commands.fields import Count, Identifier, Words
from carina.commands.value import FrozenValue
from carina.server.wire.codec import ClientMessage, ServerMessage
from carina.value import TEXT

PacsName = Annotated[str, Meta(max_length=40, pattern=TEXT)]
PacsText = Annotated[str, Meta(max_length=2000, pattern=TEXT)]
PacsPort = Annotated[int, Meta(ge=1, le=65535)]
PacsUid = Annotated[str, Meta(min_length=1, max_length=64, pattern=TEXT)]
SearchText = Annotated[str, Meta(max_length=64, pattern=TEXT)]
Picture = Annotated[str, Meta(max_length=100_000)]
"""PNG in base64, at most 96 pixels wide and high."""
PacsTask = Literal["settings", "test", "search", "series", "get", "send"]
PlanFile = Literal["seg", "sr", "pdf"]


class PacsFields(FrozenValue, frozen=True):
    """Fields of a saved connection, without its password."""

    name: PacsName
    host: PacsText
    port: PacsPort
    called_ae: PacsText
    """AE title of the PACS."""
    calling_ae: PacsText
    """AE title of this machine."""
    listen_port: PacsPort | None
    """Port on which this machine receives images (C-MOVE); null retrieves through the same connection (C-GET)."""
    listen_host: PacsText
    """Address on which this machine receives images; empty for the address from which it reaches the PACS."""
    tls: bool
    url: PacsText
    """URL of a DICOMweb service; empty for DIMSE."""
    user: PacsText
    ca_file: PacsText


class AskPacs(ClientMessage, frozen=True):
    """Request the saved connections; the answer is ``pacs_connections``."""


class SavePacs(ClientMessage, frozen=True):
    """Save a connection; the answer is ``pacs_connections``."""

    connection: PacsFields
    password: PacsText | None
    """New password; null does not change the stored password."""
    replaces: PacsName | None = None
    """Former name of an edited connection; null adds a connection."""


class RemovePacs(ClientMessage, frozen=True):
    """Delete a saved connection and its password; the answer is ``pacs_connections``."""

    name: PacsName


class TestPacs(ClientMessage, frozen=True):
    """Test a saved connection step by step, by a job; the answer is ``pacs_test``."""

    name: PacsName


class SearchPacs(ClientMessage, frozen=True):
    """Search studies by patient or date, by a job; the answer is ``pacs_studies``."""

    name: PacsName
    patient_name: SearchText
    """Beginning of the name; ``*`` stands for any characters."""
    patient_id: SearchText
    date: SearchText
    """ISO date, or range ``2026-11-01..2026-11-30``; empty for any date."""


class StudyInPacs(FrozenValue, frozen=True):
    """A study, with the connection to its PACS."""

    name: PacsName
    """Name of the connection."""
    study_uid: PacsUid


class AskPacsSeries(StudyInPacs, ClientMessage, frozen=True, tag="ask_pacs_series"):
    """Request the series of a study, by a job; the answers are ``pacs_series``, then a ``pacs_preview`` for each."""


class GetPacsSeries(StudyInPacs, ClientMessage, frozen=True, tag="get_pacs_series"):
    """Retrieve a series and open it as a case, by a job; an interrupted retrieval continues."""

    series_uid: PacsUid


class StopPacs(ClientMessage, frozen=True):
    """Stop test, search and previews, because the window has closed their list; a retrieval continues."""


class EmptyPacs(ClientMessage, frozen=True):
    """Delete all series that were retrieved from a PACS from this machine; the answer is ``pacs_connections``."""


class PlanInPacs(FrozenValue, frozen=True):
    """The plan of a target, with the connection to a PACS."""

    name: PacsName
    """Name of the connection."""
    target_id: Identifier


class SendPlanToPacs(PlanInPacs, ClientMessage, frozen=True, tag="send_plan_to_pacs"):
    """Store files of a target's plan in a PACS, by a job; the answer is ``pacs_sent``.

    The files contain name and number of the CT's patient, so that the PACS files them with the CT.
    """

    files: Annotated[tuple[PlanFile, ...], Meta(min_length=1, max_length=3)]


class PacsConnectionsMessage(ServerMessage, frozen=True):
    """The saved connections, and the retrieved series on this machine."""

    connections: Annotated[tuple[PacsFields, ...], Meta(max_length=200)]
    num_retrieved: Count
    retrieved_bytes: Annotated[int, Meta(ge=0, le=2**53)]
    folder: Words
    """Folder of the retrieved series; its name contains no patient data."""
    problem: Words | None
    """Reason why a PACS cannot be used, with the remedy; null if it can."""


class PacsStep(FrozenValue, frozen=True):
    """One step of a connection test."""

    name: Words
    passed: bool
    finding: Words
    """What was found; for a failed step its reason and what to do."""


class PacsTestMessage(ServerMessage, frozen=True):
    """Result of a connection test."""

    name: PacsName
    passed: bool
    steps: Annotated[tuple[PacsStep, ...], Meta(max_length=10)]


class PacsStudyEntry(FrozenValue, frozen=True):
    """A study of a search result, with the name of its patient for the user of this machine."""

    study_uid: PacsUid
    patient_name: Words
    patient_id: Words
    date: Words
    description: Words
    modalities: Words
    num_series: Count | None


class PacsStudiesMessage(ServerMessage, frozen=True):
    """Result of a search, the newest study first."""

    name: PacsName
    studies: Annotated[tuple[PacsStudyEntry, ...], Meta(max_length=200)]
    has_more: bool
    """Whether the PACS has more matches; the user has to narrow the search."""


class PacsSeriesEntry(FrozenValue, frozen=True):
    """A series of a study in a PACS."""

    series_uid: PacsUid
    modality: Words
    description: Words
    number: int | None
    num_images: Count | None


class PacsSeriesMessage(StudyInPacs, ServerMessage, frozen=True, tag="pacs_series"):
    """Series of a study."""

    series: Annotated[tuple[PacsSeriesEntry, ...], Meta(max_length=2000)]
    preselected: PacsUid | None
    """The likeliest chest CT; null without one. The server sends the message again when the previews change it."""
    reason: Words
    """Why this series is the likeliest chest CT; empty without one."""


class PacsPreviewMessage(ServerMessage, frozen=True):
    """Properties and picture of a series, read from its middle image."""

    series_uid: PacsUid
    slice_mm: float | None
    """Thickness of the slices."""
    kernel: Words
    phase: Words
    scanned_on: Words | None
    """ISO date of the scan."""
    picture: Picture | None
    """Null if the image cannot be shown."""


class PacsSentMessage(PlanInPacs, ServerMessage, frozen=True, tag="pacs_sent"):
    """Files of a plan that the PACS has stored, and those that it refused."""

    num_stored: Count
    refused: Annotated[tuple[Words, ...], Meta(max_length=3)]


class PacsProblemMessage(ServerMessage, frozen=True):
    """Failure of a request, with its reason and what to do."""

    task: PacsTask
    code: Identifier
    problem: Words
    target_id: Identifier | None = None
    """Target whose plan could not be sent (task ``send``); null for other tasks."""
