"""Search, retrieval and storage in a PACS, by DICOM's own network protocol (DIMSE) or by DICOMweb (extra ``dicom``).

Saved connections are in the settings folder (:class:`PacsConnections`). Names of patients in search results are for the
user of this machine: they are neither logged nor stored.
"""

from __future__ import annotations

from carina.pacs.client import check_connection, find_series, find_studies, retrieve_series, store_files
from carina.pacs.connections import PacsConnection, PacsConnections
from carina.pacs.results import ConnectionCheck, PacsSeries, PacsStudies, PacsStudy, Retrieved, Stored
from carina.pacs.series_preview import SeriesPreview, likeliest_series, preview_series

__all__ = [
    "ConnectionCheck",
    "PacsConnection",
    "PacsConnections",
    "PacsSeries",
    "PacsStudies",
    "PacsStudy",
    "Retrieved",
    "SeriesPreview",
    "Stored",
    "check_connection",
    "find_series",
    "find_studies",
    "likeliest_series",
    "preview_series",
    "retrieve_series",
    "store_files",
]
