"""Functions that search a PACS, retrieve series, and store files, by DIMSE or DICOMweb."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

from pydicom.dataset import Dataset

from carina.argument_checks import check_arguments, file_path, flag, function, instance, text_of, whole_from
from carina.display.progress import ProgressChoice, progress_function, shows_progress
from carina.errors import PacsError, UsageError
from carina.pacs.answer_values import text_list, text_value, whole_value
from carina.pacs.connections import PacsConnection
from carina.pacs.dimse_client import DimseClient
from carina.pacs.limits import MAX_SERIES_IMAGES, too_large
from carina.pacs.results import ConnectionCheck, PacsSeries, PacsStudies, PacsStudy, Retrieved, Stored
from carina.pacs.retrieval_folder import RetrievalFolder
from carina.pacs.web_client import WebClient
from carina.volume.dicom_files import files_below
from carina.volume.dicom_headers import read_dataset
from carina.volume.dicom_signature import looks_like_dicom
from carina.volume.progress import Watch
from carina.volume.read_limits import MAX_FILES
from carina.volume.without_warnings import without_warnings

__all__ = ["check_connection", "client_of", "find_series", "find_studies", "retrieve_series", "store_files"]

_DATE = re.compile(r"(\d{4})-?(\d{2})-?(\d{2})")
_UID = re.compile(r"[0-9.]{1,64}")
_connection = instance(PacsConnection, "create a carina.pacs.PacsConnection")


def client_of(connection: PacsConnection) -> DimseClient | WebClient:
    """Return the client for the protocol of a connection."""
    return WebClient(connection) if connection.is_web else DimseClient(connection)


@check_arguments(connection=_connection)
def check_connection(connection: PacsConnection) -> ConnectionCheck:
    """Test a connection step by step: network, AE titles (C-ECHO), the second port of C-MOVE, or DICOMweb.

    Parameters
    ----------
    connection
        The connection.

    Returns
    -------
    ConnectionCheck
        The steps; the last one states a reason and a remedy if it failed.
    """
    return ConnectionCheck(tuple(client_of(connection).check()))


@shows_progress
@check_arguments(
    connection=_connection, patient_id=text_of(64, least=0), patient_name=text_of(64, least=0),
    date=text_of(32, least=0), modality=text_of(16, least=0), limit=whole_from(1, 10_000), cancel=function,
)  # fmt: skip
def find_studies(
    connection: PacsConnection,
    *,
    patient_id: str = "",
    patient_name: str = "",
    date: str = "",
    modality: str = "CT",
    limit: int = 200,
    progress: ProgressChoice = None,
    cancel: Callable[[], bool] | None = None,
) -> PacsStudies:
    """Search the studies of a PACS by patient or date.

    Parameters
    ----------
    connection
        The connection.
    patient_id, patient_name
        Patient; ``*`` stands for any characters. A name without ``*`` also matches names that begin with it.
    date
        Date ``2026-11-30``, or range ``2026-11-01..2026-11-30``.
    modality
        Modality in the study; empty for all.
    limit
        Largest number of studies; ``has_more`` of the result states whether the PACS has more.
    progress
        False, True or ``f(what, fraction)``. True or None shows a progress bar in a terminal or a notebook. The
        fraction is None where it is unknown.
    cancel
        Called often; the work stops when it returns True.

    Returns
    -------
    PacsStudies
        The newest study first.

    Raises
    ------
    UsageError
        If neither patient nor date is given, or the date is invalid.
    PacsError
        If the PACS cannot be reached or refuses the request.
    """
    if not (patient_id or patient_name or date):
        raise UsageError("find_studies: give a patient or a date, so that the PACS need not list everything")
    name = patient_name if not patient_name or "*" in patient_name else f"{patient_name}*"
    keys = {
        "PatientID": patient_id, "PatientName": name, "StudyDate": _date_range(date), "ModalitiesInStudy": modality,
        "StudyInstanceUID": "", "StudyDescription": "", "NumberOfStudyRelatedSeries": "",
    }  # fmt: skip
    watch = Watch(progress_function(progress), cancel)
    client = client_of(connection)
    found = client.find("STUDY", keys, limit=limit + 1, watch=watch)
    studies = [
        PacsStudy(
            uid=text_value(one, "StudyInstanceUID"),
            patient_name=text_value(one, "PatientName"),
            patient_id=text_value(one, "PatientID"),
            date=_iso(text_value(one, "StudyDate")),
            description=text_value(one, "StudyDescription"),
            modalities=text_list(one, "ModalitiesInStudy"),
            num_series=whole_value(one, "NumberOfStudyRelatedSeries"),
        )
        for one in found[:limit]
    ]
    # Some PACS ignore the modality.
    wanted = [study for study in studies if not modality or not study.modalities or modality in study.modalities]
    newest_first = tuple(sorted(wanted, key=lambda study: study.date, reverse=True))
    return PacsStudies(newest_first, has_more=len(found) > limit or client.is_shortened)


@check_arguments(connection=_connection, study_uid=text_of(64), cancel=function)
def find_series(
    connection: PacsConnection, study_uid: str, *, cancel: Callable[[], bool] | None = None
) -> tuple[PacsSeries, ...]:
    """Return the series of a study in a PACS, by number.

    Parameters
    ----------
    connection
        The connection.
    study_uid
        UID of the study, from :func:`find_studies`.
    cancel
        Called often; the work stops when it returns True.

    Raises
    ------
    PacsError
        If the PACS cannot be reached or refuses the request.
    """
    keys = {
        "StudyInstanceUID": _checked_uid(study_uid), "SeriesInstanceUID": "", "Modality": "", "SeriesNumber": "",
        "SeriesDescription": "", "NumberOfSeriesRelatedInstances": "",
    }  # fmt: skip
    found = client_of(connection).find("SERIES", keys, limit=MAX_FILES, watch=Watch(None, cancel))
    series = [
        PacsSeries(
            uid=text_value(one, "SeriesInstanceUID"),
            study_uid=study_uid,
            modality=text_value(one, "Modality"),
            description=text_value(one, "SeriesDescription"),
            number=whole_value(one, "SeriesNumber"),
            num_images=whole_value(one, "NumberOfSeriesRelatedInstances"),
        )
        for one in found
    ]
    return tuple(sorted(series, key=lambda one: (one.number is None, one.number or 0, one.uid)))


@shows_progress
@check_arguments(
    connection=_connection, study_uid=text_of(64), series_uid=text_of(64), folder=file_path(), reuse=flag,
    cancel=function,
)  # fmt: skip
def retrieve_series(
    connection: PacsConnection,
    study_uid: str,
    series_uid: str,
    folder: str | Path,
    *,
    reuse: bool = False,
    progress: ProgressChoice = None,
    cancel: Callable[[], bool] | None = None,
) -> Retrieved:
    """Retrieve a series into a new folder, which then opens like every scan.

    The folder appears only when the series is complete. An interrupted or cancelled retrieval continues, when it is
    repeated, with the images that are missing. A series may have 20,000 images, 2 GiB in one image and 8 GiB.

    Parameters
    ----------
    connection
        The connection.
    study_uid, series_uid
        UIDs, from :func:`find_series`.
    folder
        Folder to create; without ``reuse`` it must not exist.
    reuse
        Whether the folder of an earlier retrieval is returned unchanged if it has exactly the images that the PACS
        lists now. If the images differ, the series is retrieved again and replaces them.
    progress
        False, True or ``f(what, fraction)``. True or None shows a progress bar in a terminal or a notebook. The
        fraction is None where it is unknown.
    cancel
        Called often; the work stops when it returns True.

    Raises
    ------
    PacsError
        If the PACS cannot be reached or refuses the request; ``pacs.incomplete``: some images did not arrive, or the
        PACS has shortened its list of images; ``pacs.too-large``: the series exceeds a limit, and nothing was stored;
        ``pacs.busy``: another job or process retrieves into this folder.
    UsageError
        ``pacs.folder``: the folder exists.
    CancelledError
        If ``cancel()`` returned true.
    """
    watch = Watch(progress_function(progress), cancel)
    client = client_of(connection)
    keys = {
        "StudyInstanceUID": _checked_uid(study_uid), "SeriesInstanceUID": _checked_uid(series_uid),
        "SOPInstanceUID": "",
    }  # fmt: skip
    with RetrievalFolder(Path(folder).expanduser().absolute(), series_uid, replaces=reuse) as place:
        try:
            found = client.find("IMAGE", keys, limit=MAX_SERIES_IMAGES + 1, watch=watch)
            images = list(dict.fromkeys(uid for one in found if (uid := text_value(one, "SOPInstanceUID"))))
            if not images:
                raise PacsError(
                    f"{connection.name}: the PACS has no images of this series; search again", code="pacs.no-images"
                )
            if len(images) > MAX_SERIES_IMAGES:
                raise too_large(connection.name, f"the series has more than {MAX_SERIES_IMAGES} images")
            _check_list(connection, study_uid, series_uid, len(images), cancel, is_shortened=client.is_shortened)
            if place.is_up_to_date(images):
                return Retrieved(place.target, len(images), len(images))
            resumed = sum(uid in place for uid in images)
            client.retrieve(study_uid, series_uid, images, place, watch)
            place.complete(images)
        except PacsError as error:
            if error.code == "pacs.too-large":
                place.discard()  # the same request would fail again
            raise
    return Retrieved(place.target, len(images), resumed)


@shows_progress
@check_arguments(connection=_connection, cancel=function)
def store_files(
    connection: PacsConnection,
    files: Sequence[str | Path],
    *,
    progress: ProgressChoice = None,
    cancel: Callable[[], bool] | None = None,
) -> Stored:
    """Send DICOM files to a PACS, such as the segmentations (SEG), reports (SR) and PDF files of a plan.

    Parameters
    ----------
    connection
        The connection.
    files
        DICOM files, or folders of them.
    progress
        False, True or ``f(what, fraction)``. True or None shows a progress bar in a terminal or a notebook. The
        fraction is None where it is unknown.
    cancel
        Called often; the work stops when it returns True. Files that were sent before stay in the PACS.

    Raises
    ------
    PacsError
        If the PACS cannot be reached.
    UsageError
        ``usage.pacs``: a file is not a complete DICOM file; then nothing is sent.
    CancelledError
        If ``cancel()`` returned true.
    """
    watch = Watch(progress_function(progress), cancel)
    paths = [path for one in files for path in files_below(Path(one).expanduser(), watch=watch)]
    if not paths:
        raise UsageError("store_files: no files; name DICOM files or a folder of them", code="usage.pacs")
    client = client_of(connection)
    stored, refused = client.store([(path, _sendable(path)) for path in paths], watch)
    return Stored(stored, tuple(refused))


def _check_list(
    connection: PacsConnection,
    study_uid: str,
    series_uid: str,
    num_listed: int,
    cancel: Callable[[], bool] | None,
    *,
    is_shortened: bool,
) -> None:
    """Refuse a list of images that the PACS has shortened, because a part of a series would open as the whole."""
    stated = next(
        (one.num_images for one in find_series(connection, study_uid, cancel=cancel) if one.uid == series_uid), None
    )
    if stated is None and is_shortened:
        raise PacsError(
            f"{connection.name}: the PACS lists only the first {num_listed} images of this series; ask its "
            "administrator to raise the limit of search results",
            code="pacs.incomplete",
        )
    if stated is not None and stated > num_listed:
        raise PacsError(
            f"{connection.name}: the PACS lists only {num_listed} of {stated} images of this series; ask its "
            "administrator to raise the limit of search results",
            code="pacs.incomplete",
        )


def _sendable(path: Path) -> Dataset:
    try:
        if not looks_like_dicom(path):
            raise ValueError
        dataset = read_dataset(path, pixels=True)
        with without_warnings():
            complete = (
                dataset.get("SOPClassUID")
                and dataset.get("SOPInstanceUID")
                and "TransferSyntaxUID" in dataset.file_meta
            )
    except (ValueError, AttributeError):
        complete = False
    if not complete:
        raise UsageError(
            f"{path.name} is not a complete DICOM file, so nothing was sent; leave it out", code="usage.pacs"
        )
    return dataset


def _checked_uid(uid: str) -> str:
    if not _UID.fullmatch(uid):
        raise UsageError("pacs: expected a UID of digits and points, as the search prints it", code="usage.pacs")
    return uid


def _date_range(date: str) -> str:
    """Return a date or range in the form of DICOM."""
    if not date:
        return ""
    parts = [_DATE.fullmatch(part.strip()) for part in date.split("..")]
    if len(parts) > 2 or None in parts:
        raise UsageError(f"date: expected 2026-11-30 or 2026-11-01..2026-11-30; found {date!r}", code="usage.pacs")
    return "-".join("".join(part.groups()) for part in parts if part is not None)


def _iso(date: str) -> str:
    match = _DATE.fullmatch(date)
    return "-".join(match.groups()) if match else ""
