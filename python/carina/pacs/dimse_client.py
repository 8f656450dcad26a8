"""Requests to a PACS by DICOM's network protocol: C-ECHO, C-FIND, C-GET, C-MOVE with a listener, C-STORE."""

from __future__ import annotations

import contextlib
import errno
import logging
import socket
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydicom.dataset import Dataset

from carina.errors import CarinaError, PacsError
from carina.pacs.connections import PacsConnection
from carina.pacs.limits import MAX_ANSWER_BYTES, MAX_PDU_BYTES, limit_socket, too_large
from carina.pacs.reasons import CONNECT_S, check_port, missing_library, offline, tls_context
from carina.pacs.results import CheckStep
from carina.pacs.retrieval_folder import RetrievalFolder, part10
from carina.volume.progress import Watch
from carina.volume.without_warnings import without_warnings

__all__ = ["DimseClient"]

_ECHO = "1.2.840.10008.1.1"
_FIND = "1.2.840.10008.5.1.4.1.2.2.1"
_MOVE = "1.2.840.10008.5.1.4.1.2.2.2"
_GET = "1.2.840.10008.5.1.4.1.2.2.3"
_SERVICES = (_ECHO, _FIND, _MOVE, _GET)
_ROOT = "1.2.840.10008.5.1.4.1.1"
_STORED = tuple(f"{_ROOT}.{kind}" for kind in ("2", "2.1", "4", "4.1", "7", "66.4", "88.33", "88.34", "104.1", "11.1"))
"""SOP classes that can be retrieved: CT and MR, classic and enhanced, captures, SEG, SR, PDF, presentation states."""
_PLAIN = ("1.2.840.10008.1.2.1", "1.2.840.10008.1.2")
_COMPRESSED = tuple(
    f"1.2.840.10008.1.2.{kind}" for kind in ("4.70", "4.57", "4.80", "4.90", "5", "4.50", "4.51", "4.81", "4.91")
)
_IMAGE_CLASSES = _STORED[:4]
_PENDING = (0xFF00, 0xFF01)
_SLOW_S = 120.0
"""Maximum wait in seconds for the next message of a PACS, which may have to load a tape."""
_BATCH = 200
"""Number of images in one request of a resumed retrieval."""
# The library logs the values of identifiers and AE titles; nothing about a patient may be logged.
for _name in ("pynetdicom",):
    logging.getLogger(_name).setLevel(logging.CRITICAL + 1)


def _library() -> Any:
    try:
        import pynetdicom
    except ImportError:
        raise missing_library() from None
    pynetdicom._config.LOG_HANDLER_LEVEL = "none"
    pynetdicom._config.LOG_RESPONSE_IDENTIFIERS = False
    pynetdicom._config.LOG_REQUEST_IDENTIFIERS = False
    pynetdicom.transport.AssociationSocket._shutdown_socket = _close_socket
    return pynetdicom


def _close_socket(association_socket: Any) -> None:
    """Close the socket of an association, in place of the library's method.

    The library does not close a socket whose peer has already disconnected (pynetdicom 3.0), so each refused or aborted
    association would leave a file descriptor open until garbage collection.
    """
    sock = association_socket.socket
    if sock is None:
        return
    with contextlib.suppress(OSError):
        sock.shutdown(socket.SHUT_RDWR)
    with contextlib.suppress(OSError):
        sock.close()


class DimseClient:
    """Requests to one PACS."""

    is_shortened = False
    """Whether the PACS stated that the last answer is incomplete; DIMSE has no such statement."""

    def __init__(self, connection: PacsConnection) -> None:
        self._connection = connection
        self._pynetdicom = _library()

    @property
    def name(self) -> str:
        """Name of the connection, for messages."""
        return self._connection.name

    # -- associations ------------------------------------------------------------------------------------------------

    def _entity(self) -> Any:
        entity = self._pynetdicom.AE(ae_title=self._connection.calling_ae)
        entity.connection_timeout = CONNECT_S
        entity.acse_timeout = 30.0
        entity.dimse_timeout = entity.network_timeout = _SLOW_S
        entity.maximum_pdu_size = MAX_PDU_BYTES
        return entity

    @contextlib.contextmanager
    def _association(
        self, contexts: Sequence[tuple[str, Sequence[str]]], *, roles: Sequence[Any] = (), handlers: Sequence[Any] = ()
    ) -> Iterator[Any]:
        """Open an association, and release it at the end of the block.

        Raises
        ------
        PacsError
            If the PACS cannot be reached, or refuses an AE title or all contexts.
        """
        connection = self._connection
        entity = self._entity()
        service = contexts[0][0] if contexts[0][0] in _SERVICES else None
        for abstract, syntaxes in contexts:
            entity.add_requested_context(abstract, list(syntaxes))
        tls = (tls_context(connection), connection.host) if connection.tls else None
        rejections: list[tuple[int, int]] = []

        def note_rejection(event: Any) -> None:
            if isinstance(event.pdu, self._pynetdicom.pdu.A_ASSOCIATE_RJ):
                rejections.append((event.pdu.source, event.pdu.reason_diagnostic))

        try:
            association = entity.associate(
                connection.host, connection.port, ae_title=connection.called_ae, ext_neg=list(roles) or None,
                evt_handlers=[*handlers, (self._pynetdicom.evt.EVT_PDU_RECV, note_rejection)], tls_args=tls,
            )  # fmt: skip
        except OSError as error:
            raise offline(connection, error) from None
        if not association.is_established:
            raise self._refusal(association, rejections[0] if rejections else None)
        try:
            accepted = {context.abstract_syntax for context in association.accepted_contexts}
            if service is not None and service not in accepted:
                raise self._no_service(service)
            yield association
        except BaseException:
            if association.is_established:
                association.abort()  # a release would wait for a PACS that still sends
            raise
        if association.is_established:
            association.release()

    def _no_service(self, service: str | None) -> PacsError:
        if service == _GET:
            return PacsError(
                f"{self.name}: the PACS does not send images through the connection of the request (C-GET); give the "
                "port on which this machine receives images (--listen-port)",
                code="pacs.no-service",
            )
        return PacsError(f"{self.name}: the PACS offers no service for this request", code="pacs.no-service")

    def _refusal(self, association: Any, rejection: tuple[int, int] | None) -> PacsError:
        """Return the error for an association that is not established.

        Parameters
        ----------
        association
            The association.
        rejection
            Source and reason of the rejection by the PACS; None if it sent none. The association's own state is not
            enough: pynetdicom sets *aborted* instead of *rejected* if its second thread reads the rejection and closes
            the connection before its first thread has checked the connection.
        """
        if rejection is not None:
            if rejection == (1, 7):
                return PacsError(
                    f"{self.name}: the PACS does not have the AE title {self._connection.called_ae}; ask its "
                    "administrator for its AE title",
                    code="pacs.ae-title",
                )
            if rejection == (1, 3):
                return PacsError(
                    f"{self.name}: the PACS does not know this machine; ask its administrator to enter the AE title "
                    f"{self._connection.calling_ae} with the address of this machine",
                    code="pacs.ae-title",
                )
            return PacsError(f"{self.name}: the PACS refuses connections now; try again later", code="pacs.refused")
        try:
            check_port(self._connection)
        except PacsError as error:
            return error
        if association.is_aborted:
            return PacsError(
                f"{self.name}: the PACS closed the connection; check the AE titles and whether this port uses TLS",
                code="pacs.ae-title",
            )
        return self._no_service(None)

    # -- connection test ---------------------------------------------------------------------------------------------

    def check(self) -> list[CheckStep]:
        """Test the connection, step by step, until a step fails."""
        steps: list[CheckStep] = []

        def step(name: str, action: Any) -> bool:
            try:
                steps.append(CheckStep(name, True, action()))
            except CarinaError as error:
                steps.append(CheckStep(name, False, str(error)))
            return steps[-1].passed

        place = f"{self._connection.host}, port {self._connection.port}"

        def network() -> str:
            check_port(self._connection)
            return f"{place} answers"

        if not step("network", network):
            return steps
        if step("C-ECHO", self._echo) and self._connection.listen_port is not None:
            step("C-MOVE", self._check_listener)
        return steps

    def _echo(self) -> str:
        with self._association([(_ECHO, _PLAIN)]) as association:
            status = association.send_c_echo()
        if getattr(status, "Status", None) != 0x0000:
            raise PacsError(f"{self.name}: the PACS refused the test message (C-ECHO)", code="pacs.refused")
        return f"the PACS accepts the AE titles {self._connection.calling_ae} and {self._connection.called_ae}"

    def _check_listener(self) -> str:
        """Listen on the second port, and ask the PACS to send a series that does not exist."""
        with self._listener(None), self._association([(_MOVE, _PLAIN)]) as association:
            query = _query("SERIES", StudyInstanceUID="2.25.1", SeriesInstanceUID="2.25.2")
            for status, _ in association.send_c_move(query, self._connection.calling_ae, _MOVE):
                if getattr(status, "Status", None) == 0xA801:
                    raise self._unknown_destination()
        return (
            f"the PACS knows {self._connection.calling_ae}, and port {self._connection.listen_port} of this machine is "
            f"free at its address {listening_address(self._connection)}. C-MOVE also needs this address and port in "
            "the settings of the PACS, and the port open in the firewall; the first retrieval shows whether they are"
        )

    def _unknown_destination(self) -> PacsError:
        return PacsError(
            f"{self.name}: the PACS has no address for this machine; ask its administrator to enter the AE title "
            f"{self._connection.calling_ae} with the address of this machine and port {self._connection.listen_port}",
            code="pacs.ae-title",
        )

    # -- search ------------------------------------------------------------------------------------------------------

    def find(self, level: str, keys: dict[str, str], *, limit: int, watch: Watch) -> list[Dataset]:
        """Return the matches of a query (C-FIND), at most ``limit``."""
        found: list[Dataset] = []
        with self._association([(_FIND, _PLAIN)], handlers=self._handlers(None)) as association:
            for status, identifier in association.send_c_find(_query(level, **keys), _FIND):
                watch.step("Searching the PACS")
                code = getattr(status, "Status", None)
                if code in _PENDING and identifier is not None:
                    found.append(identifier)
                    if len(found) >= limit:
                        association.abort()
                        break
                elif code != 0x0000:
                    raise PacsError(
                        f"{self.name}: the search failed ({_code_text(code)}); search for less, such as one patient ID",
                        code="pacs.search",
                    )
        return found

    # -- retrieval ---------------------------------------------------------------------------------------------------

    def retrieve(
        self,
        study_uid: str,
        series_uid: str,
        images: Sequence[str],
        folder: RetrievalFolder,
        watch: Watch,
        *,
        are_all: bool = True,
    ) -> None:
        """Retrieve images of a series that are not in the folder yet; ``are_all``: the series has no others."""
        missing = [uid for uid in images if uid not in folder]
        if not missing:
            return
        is_whole = are_all and len(missing) == len(images)
        batches = [missing] if is_whole else [missing[at : at + _BATCH] for at in range(0, len(missing), _BATCH)]
        for batch in batches:
            if is_whole:
                query = _query("SERIES", StudyInstanceUID=study_uid, SeriesInstanceUID=series_uid)
            else:
                wanted = batch if len(batch) > 1 else batch[0]
                query = _query("IMAGE", StudyInstanceUID=study_uid, SeriesInstanceUID=series_uid, SOPInstanceUID=wanted)
            receiver = _Receiver(self.name, series_uid, folder, frozenset(images), watch)
            if self._connection.listen_port is None:
                self._get(query, receiver)
            else:
                self._move(query, receiver)
            receiver.raise_problem()

    def _get(self, query: Dataset, receiver: _Receiver) -> None:
        contexts: list[tuple[str, Sequence[str]]] = [(_GET, _PLAIN)]
        contexts += [(kind, _PLAIN) for kind in _STORED]
        contexts += [(kind, (syntax,)) for kind in _IMAGE_CLASSES for syntax in _COMPRESSED]
        roles = [self._pynetdicom.build_role(kind, scp_role=True) for kind in _STORED]
        handlers = self._handlers(receiver)
        with self._association(contexts, roles=roles, handlers=handlers) as association:
            self._run(association, association.send_c_get(query, _GET), receiver)

    def _handlers(self, receiver: _Receiver | None) -> list[Any]:
        """Return the handlers that limit the bytes and store the images; without a receiver images are refused."""
        events = self._pynetdicom.evt
        if receiver is None:
            return [(events.EVT_CONN_OPEN, lambda event: limit_socket(event.assoc, _limited_count()))]
        return [
            (events.EVT_C_STORE, receiver.store),
            (events.EVT_CONN_OPEN, lambda event: limit_socket(event.assoc, receiver.counter_of(event.assoc))),
            (events.EVT_REJECTED, receiver.note_rejected),
        ]

    def _move(self, query: Dataset, receiver: _Receiver) -> None:
        with self._listener(receiver), self._association([(_MOVE, _PLAIN)]) as association:
            answers = association.send_c_move(query, self._connection.calling_ae, _MOVE)
            self._run(association, answers, receiver)

    def _run(self, association: Any, answers: Any, receiver: _Receiver) -> None:
        """Read the answers to a retrieval until its end, a problem, or a cancellation."""
        for status, _ in answers:
            code = getattr(status, "Status", None)
            if receiver.has_problem():
                association.abort()
                return
            if code in _PENDING:
                continue
            if code is None:
                receiver.raise_problem()
                raise PacsError(
                    f"{self.name}: the connection broke; retrieve again to continue with the missing images",
                    code="pacs.incomplete",
                )
            if code == 0xA801:
                raise self._unknown_destination()
            if code != 0x0000 and receiver.num_received == 0:
                raise self._failed(code, receiver.rejected_title)

    def _failed(self, code: int, rejected_title: str) -> PacsError:
        if rejected_title:
            return PacsError(
                f"{self.name}: a program with the AE title {rejected_title} tried to send images and was refused; if "
                f"it is the PACS, save the connection with this AE title instead of {self._connection.called_ae}",
                code="pacs.ae-title",
            )
        if self._connection.listen_port is not None:
            return PacsError(
                f"{self.name}: the PACS could not send images to port {self._connection.listen_port} of this machine "
                f"at {listening_address(self._connection)} ({_code_text(code)}); open this port in the firewall and "
                "check address and port in the settings of the PACS, or retrieve without --listen-port",
                code="pacs.listener",
            )
        return PacsError(
            f"{self.name}: the PACS does not send images through this connection (C-GET, {_code_text(code)}); give "
            "the port on which this machine receives images (--listen-port)",
            code="pacs.refused",
        )

    @contextlib.contextmanager
    def _listener(self, receiver: _Receiver | None) -> Iterator[None]:
        """Receive images on the second port during the block.

        Raises
        ------
        PacsError
            ``pacs.listener``: the port cannot be opened.
        """
        connection = self._connection
        entity = self._entity()
        # Only the PACS may send images: other programs of the network do not know both AE titles.
        entity.require_called_aet = True
        entity.require_calling_aet = [connection.called_ae]
        entity.add_supported_context(_ECHO)
        for kind in _STORED:
            entity.add_supported_context(kind, [*_PLAIN, *(_COMPRESSED if kind in _IMAGE_CLASSES else ())])
        handlers = self._handlers(receiver)
        try:
            address = listening_address(connection)
            entity.start_server((address, connection.listen_port), block=False, evt_handlers=handlers)
        except OSError as error:
            used = error.errno == errno.EADDRINUSE
            why = "is used by another program" if used else "may not be opened"
            raise PacsError(
                f"{self.name}: port {connection.listen_port} of this machine {why}; choose another port here and in "
                "the settings of the PACS",
                code="pacs.listener",
            ) from None
        try:
            yield
        finally:
            entity.shutdown()  # with the connections that are still open

    # -- storage -----------------------------------------------------------------------------------------------------

    def store(self, files: Sequence[tuple[Path, Dataset]], watch: Watch) -> tuple[int, list[tuple[str, str]]]:
        """Send files (C-STORE); return the number of stored files and the refused ones with reasons."""
        kinds = sorted({(str(d.SOPClassUID), str(d.file_meta.TransferSyntaxUID)) for _, d in files})
        contexts = [(kind, (syntax,) if syntax not in _PLAIN else _PLAIN) for kind, syntax in kinds][:128]
        refused: list[tuple[str, str]] = []
        stored = 0
        with self._association(contexts) as association:
            for index, (path, dataset) in enumerate(files):
                watch.step("Sending to the PACS", index / len(files))
                try:
                    status = getattr(association.send_c_store(dataset), "Status", None)
                except ValueError:
                    refused.append((path.name, "the PACS does not accept files of this kind"))
                    continue
                except RuntimeError:
                    raise PacsError(
                        f"{self.name}: the connection broke after {stored} of {len(files)} files; send them again",
                        code="pacs.incomplete",
                    ) from None
                if status is not None and (status == 0x0000 or status & 0xF000 == 0xB000):
                    stored += 1
                else:
                    refused.append((path.name, f"the PACS did not store it ({_code_text(status)})"))
        return stored, refused


class _Receiver:
    """Handler of received images, which stores each image and records the first error."""

    def __init__(
        self, name: str, series_uid: str, folder: RetrievalFolder, images: frozenset[str], watch: Watch
    ) -> None:
        self._name = name
        self._series_uid = series_uid
        self._folder = folder
        self._images = images
        # Progress is reported from the thread of the connection, where an exception would be lost.
        self._watch = replace(watch)
        self._problem: BaseException | None = None
        self.num_received = 0
        self._num_bytes: dict[Any, int] = {}
        """Number of bytes that each association has received since its last complete image."""
        self.rejected_title = ""
        """AE title of a program whose connection to the listener was refused; empty without one."""

    def note_rejected(self, event: Any) -> None:
        """Store the AE title of a program whose connection was refused."""
        title = str(event.assoc.requestor.ae_title)
        self.rejected_title = "".join(c for c in title if c.isprintable())[:16].strip()

    def counter_of(self, association: Any) -> Callable[[int], None]:
        """Return a function that counts the bytes of an association before they are read.

        The function raises OSError, which closes the connection, if an image is too large. This ends the retrieval only
        if the association was accepted: until then the connection may come from any program of the network.
        """
        limit = self._folder.max_image_bytes
        self._num_bytes[association] = 0

        def count(num_bytes: int) -> None:
            self._num_bytes[association] += num_bytes
            if self._num_bytes[association] <= limit:
                return
            if association.is_established:
                self._problem = self._problem or too_large(
                    self._name, f"an image of the series has more than {limit >> 20} MiB"
                )
            raise OSError("the image is too large")

        return count

    def store(self, event: Any) -> int:
        """Store one image; the result is the status for the PACS."""
        self._num_bytes[event.assoc] = 0
        if self._problem is not None:
            return 0xA700
        try:
            total = len(self._images)
            self._watch.step("Retrieving the images", min(1.0, len(self._folder) / total) if total else None)
        except BaseException as error:
            self._problem = error
            return 0xA700
        try:
            with without_warnings():
                dataset = event.dataset
                sop_uid, syntax = str(dataset.SOPInstanceUID), str(event.context.transfer_syntax)
                series_uid = str(dataset.SeriesInstanceUID)
                content = event.encoded_dataset(include_meta=False)
                file = part10(str(dataset.SOPClassUID), sop_uid, syntax, content)
        except Exception:
            # Any program of the network can send a damaged image, which must not end the retrieval.
            return 0xC000
        if series_uid != self._series_uid or (self._images and sop_uid not in self._images):
            return 0xA900  # an image that was not requested
        try:
            self._folder.add(sop_uid, file)
            self.num_received += 1
        except BaseException as error:
            self._problem = error
            return 0xA700
        return 0x0000

    def has_problem(self) -> bool:
        """Return whether the retrieval has to stop."""
        if self._problem is None:
            try:
                self._watch.step("Retrieving the images")
            except CarinaError as error:
                self._problem = error
        return self._problem is not None

    def raise_problem(self) -> None:
        """Raise the first problem, if there was one."""
        if self._problem is not None:
            raise self._problem


def _limited_count() -> Callable[[int], None]:
    """Return a function that raises OSError when an association sends more bytes than an answer to a search."""
    num_bytes = 0

    def count(num_more: int) -> None:
        nonlocal num_bytes
        num_bytes += num_more
        if num_bytes > MAX_ANSWER_BYTES:
            raise OSError("the answer is too long")

    return count


def listening_address(connection: PacsConnection) -> str:
    """Return the one address on which this machine receives images.

    By default it is the address from which this machine reaches the PACS: loopback for a PACS on this machine.

    Raises
    ------
    PacsError
        ``pacs.offline`` if the host name of the PACS is unknown.
    """
    if connection.listen_host:
        return connection.listen_host
    try:
        family, kind, _, _, place = socket.getaddrinfo(connection.host, connection.port, type=socket.SOCK_DGRAM)[0]
        with socket.socket(family, kind) as probe:
            probe.connect(place)  # chooses a route; a datagram socket sends nothing
            return str(probe.getsockname()[0])
    except OSError as error:
        raise offline(connection, error) from None


def _query(level: str, **keys: str | list[str]) -> Dataset:
    query = Dataset()
    query.QueryRetrieveLevel = level
    with without_warnings():  # a value may be a name that the user searches
        for keyword, value in keys.items():
            setattr(query, keyword, value)
    return query


def _code_text(code: int | None) -> str:
    return "no answer" if code is None else f"status {code:04X}"
