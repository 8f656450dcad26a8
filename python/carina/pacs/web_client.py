"""Requests to a PACS by DICOMweb: QIDO-RS, WADO-RS and STOW-RS."""

from __future__ import annotations

import contextlib
import io
import logging
import re
import ssl
import struct
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from pydicom.dataset import Dataset

from carina.errors import CarinaError, PacsError
from carina.pacs.answer_values import text_value, value_of, whole_value
from carina.pacs.connections import PacsConnection
from carina.pacs.limits import MAX_ANSWER_BYTES, too_large
from carina.pacs.reasons import certificate_error, missing_library, offline
from carina.pacs.results import CheckStep
from carina.pacs.retrieval_folder import RetrievalFolder
from carina.volume.progress import Watch
from carina.volume.without_warnings import without_warnings

__all__ = ["WebClient"]

_TIMEOUT_S = (10.0, 120.0)
for _name in ("dicomweb_client", "urllib3", "requests", "retrying"):
    logging.getLogger(_name).setLevel(logging.CRITICAL + 1)  # URLs and messages may contain a patient


class WebClient:
    """Requests to one DICOMweb service."""

    def __init__(self, connection: PacsConnection) -> None:
        try:
            import requests
            from dicomweb_client.api import DICOMwebClient
        except ImportError:
            raise missing_library() from None
        self._connection = connection
        self._requests = requests
        session = requests.Session()
        session.trust_env = False  # a proxy must not see patient data, and .netrc no password of this service
        session.max_redirects = 0
        if connection.user:
            session.auth = (connection.user, connection.password)
        if connection.ca_file:
            session.verify = connection.ca_file
        adapter = _limited_adapter(requests, self._check_received)
        session.mount("http://", adapter)
        session.mount("https://", adapter)
        self._limit_bytes, self._gets_images, self._watch = MAX_ANSWER_BYTES, False, Watch(None, None)
        self.is_shortened = False
        """Whether the service stated that the last answer to a search is incomplete."""
        self._client: Any = DICOMwebClient(url=connection.url.rstrip("/"), session=session)
        self._client.set_http_retry_params(retry=False)

    @property
    def name(self) -> str:
        """Name of the connection, for messages."""
        return self._connection.name

    def _check_received(self, num_bytes: int, *, is_shortened: bool) -> None:
        """Check the number of bytes of an answer so far, and whether the user cancelled."""
        self.is_shortened |= is_shortened
        if self._watch.cancel is not None and self._watch.cancel():
            self._watch.step("Retrieving the images")
        if num_bytes > self._limit_bytes:
            if self._gets_images:
                raise too_large(self.name, f"an image of the series has more than {self._limit_bytes >> 20} MiB")
            raise PacsError(
                f"{self.name}: the answer to the search is too long; search for less, such as one patient ID",
                code="pacs.search",
            )

    @contextlib.contextmanager
    def _request(self) -> Iterator[None]:
        """Convert the errors of a request to one message with one remedy."""
        exceptions = self._requests.exceptions
        try:
            yield
        except exceptions.SSLError as error:
            raise certificate_error(self._connection, _cause(error, ssl.SSLError)) from None
        except exceptions.HTTPError as error:
            raise self._http_error(getattr(error.response, "status_code", 0)) from None
        except exceptions.TooManyRedirects:
            raise self._http_error(404) from None
        except exceptions.RequestException as error:
            cause = _cause(error, OSError)
            raise offline(self._connection, None if isinstance(cause, exceptions.RequestException) else cause) from None
        except OSError as error:
            if isinstance(error, CarinaError):
                raise
            raise PacsError(
                f"{self.name}: {self._connection.ca_file} is not a certificate file (PEM); get it again from the "
                "administrator of the PACS",
                code="pacs.certificate",
            ) from None
        except (ValueError, LookupError, TypeError, AttributeError, NotImplementedError, struct.error):
            raise PacsError(
                f"{self.name}: the answer of {self._connection.url} is not DICOMweb; check the URL", code="pacs.url"
            ) from None

    def _http_error(self, status: int) -> PacsError:
        if status in (401, 403):
            return PacsError(
                f"{self.name}: the PACS does not accept the user and password; enter them again with `carina pacs add`",
                code="pacs.login",
            )
        if status in (404, 405, 301, 302, 307, 308):
            return PacsError(
                f"{self.name}: there is no DICOMweb service at {self._connection.url} (HTTP {status}); check the URL",
                code="pacs.url",
            )
        return PacsError(f"{self.name}: the PACS refused the request (HTTP {status}); try later", code="pacs.refused")

    def check(self) -> list[CheckStep]:
        """Test the connection by a search for one study."""
        try:
            with self._request():
                self._client.search_for_studies(limit=1)
        except CarinaError as error:
            return [CheckStep("DICOMweb", False, str(error))]
        return [CheckStep("DICOMweb", True, f"{self._connection.url} answers searches")]

    def find(self, level: str, keys: dict[str, str], *, limit: int, watch: Watch) -> list[Dataset]:
        """Return the matches of a query (QIDO-RS), at most ``limit``."""
        watch.step("Searching the PACS")
        self._limit_bytes, self._gets_images, self._watch = MAX_ANSWER_BYTES, False, watch
        self.is_shortened = False
        study, series = keys.get("StudyInstanceUID", ""), keys.get("SeriesInstanceUID", "")
        filters = {
            key: _unescaped(value)
            for key, value in keys.items()
            if value and key not in ("StudyInstanceUID", "SeriesInstanceUID")
        }
        with self._request():
            if level == "STUDY":
                if study:
                    filters["StudyInstanceUID"] = study
                fields = ["StudyDescription", "ModalitiesInStudy", "NumberOfStudyRelatedSeries"]
                found = self._client.search_for_studies(limit=limit, search_filters=filters, fields=fields)
            elif level == "SERIES":
                fields = ["SeriesDescription", "NumberOfSeriesRelatedInstances"]
                found = self._client.search_for_series(study, limit=limit, search_filters=filters, fields=fields)
            else:
                found = self._all_instances(study, series, limit, watch)
            with without_warnings():
                return [Dataset.from_json(one) for one in found]

    def _all_instances(self, study: str, series: str, limit: int, watch: Watch) -> list[Any]:
        """Return all images of a series; a service may limit the number in one answer."""
        found: dict[str, Any] = {}
        while len(found) < limit:
            watch.step("Searching the PACS")
            # Only the last page decides whether images are missing; each page before it states that there are more.
            self.is_shortened = False
            page = self._client.search_for_instances(study, series, limit=min(limit, 1000), offset=len(found))
            new = {str(one["00080018"]["Value"][0]): one for one in page}
            if not new.keys() - found.keys():
                break
            found.update(new)
        return list(found.values())

    def retrieve(
        self,
        study_uid: str,
        series_uid: str,
        images: Sequence[str],
        folder: RetrievalFolder,
        watch: Watch,
        *,
        are_all: bool = True,  # Unused: a service sends the images one by one.
    ) -> None:
        """Retrieve the images of a series that are not in the folder yet (WADO-RS)."""
        self._limit_bytes, self._gets_images, self._watch = folder.max_image_bytes, True, watch
        for index, uid in enumerate(images):
            watch.step("Retrieving the images", index / len(images))
            if uid in folder:
                continue
            # The library parses the image in this call.
            with self._request(), without_warnings():
                image = self._client.retrieve_instance(
                    study_uid, series_uid, uid, media_types=(("application/dicom", "*"),)
                )
            if text_value(image, "SeriesInstanceUID") != series_uid or text_value(image, "SOPInstanceUID") != uid:
                raise PacsError(f"{self.name}: the PACS sent another image than requested", code="pacs.refused")
            buffer = io.BytesIO()
            with self._request(), without_warnings():
                image.save_as(buffer, enforce_file_format=True)
            folder.add(uid, buffer.getvalue())

    def store(self, files: Sequence[tuple[Path, Dataset]], watch: Watch) -> tuple[int, list[tuple[str, str]]]:
        """Send files (STOW-RS); return the number of stored files and the refused ones with reasons."""
        refused: list[tuple[str, str]] = []
        for index, (path, dataset) in enumerate(files):
            watch.step("Sending to the PACS", index / len(files))
            # The library parses the answer in this call, and pydicom quotes invalid values of it.
            with self._request(), without_warnings():
                answer = self._client.store_instances([dataset])
            failed = value_of(answer, "FailedSOPSequence")
            if failed:
                code = whole_value(failed[0], "FailureReason") or 0
                refused.append((path.name, f"the PACS did not store it (status {code:04X})"))
        return len(files) - len(refused), refused


def _unescaped(value: str) -> str:
    """Return a filter in which ``*`` stands for characters that a URL escapes, because Orthanc does not decode them."""
    return re.sub(r"[^A-Za-z0-9*?._~-]+", "*", value)


def _limited_adapter(requests: Any, check: Callable[..., None]) -> Any:
    """Return an adapter whose requests have a limit of time, and which calls ``check`` while it reads an answer."""

    class LimitedAdapter(requests.adapters.HTTPAdapter):  # type: ignore[misc]
        """Adapter of the session."""

        def send(self, request: Any, **options: Any) -> Any:
            # Orthanc does not decode %2A; an asterisk may stand in a query as it is (RFC 3986).
            request.url = request.url.replace("%2A", "*")
            options["timeout"] = options.get("timeout") or _TIMEOUT_S
            response = super().send(request, **options)
            # 299 states that the service has more results (PS3.18 8.3.4.4).
            is_shortened = response.headers.get("Warning", "").startswith("299")
            raw = response.raw
            stream = raw.stream

            def checked(num_bytes: int) -> None:
                try:
                    check(num_bytes, is_shortened=is_shortened)
                except BaseException:
                    raw.close()  # The rest of the answer is not read, so the connection cannot be used again.
                    raise

            def limited(*arguments: Any, **named: Any) -> Iterator[bytes]:
                num_bytes = 0
                for part in stream(*arguments, **named):
                    num_bytes += len(part)
                    checked(num_bytes)
                    yield part

            checked(0)

            raw.stream = limited
            return response

    return LimitedAdapter()


def _cause(error: BaseException, kind: type[Any]) -> Any:
    """Return the innermost cause of an error that has a type, or None."""
    found, seen = None, set()
    stack: list[Any] = [error]
    while stack:
        one = stack.pop()
        if not isinstance(one, BaseException) or id(one) in seen:
            continue
        seen.add(id(one))
        if isinstance(one, kind):
            found = one
        stack += [one.__cause__, one.__context__, getattr(one, "reason", None), *one.args]
    return found
