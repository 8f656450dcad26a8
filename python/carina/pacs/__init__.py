"""Search, retrieval and storage in a PACS, by DICOM's own network protocol (DIMSE) or by DICOMweb (extra ``dicom``).

Saved connections are in the settings folder (:class:`PacsConnections`). Names of patients in search results are for the
user of this machine: they are neither logged nor stored.
"""

from __future__ import annotations

from carina.pacs.client import check_connection, find_series, find_studies, retrieve_series, store_files
from carina.pacs.connections import PacsConnection, PacsConnections
from carina.pacs.results import ConnectionCheck, PacsSeries, PacsStudy, Retrieved, Stored

__all__ = [
    "ConnectionCheck",
    "PacsConnection",
    "PacsConnections",
    "PacsSeries",
    "PacsStudy",
    "Retrieved",
    "Stored",
    "check_connection",
    "find_series",
    "find_studies",
    "retrieve_series",
    "store_files",
]
