"""Tests of ``carina.pacs`` with a server that answers wrongly: hidden images, unrequested and damaged images."""

from __future__ import annotations

import struct
import threading
import time
import warnings
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace

import pytest
from orthanc_server import free_port
from pydicom import dcmread
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian

from carina.errors import PacsError, UsageError
from carina.pacs import PacsConnection, PacsSeries, SeriesPreview, find_studies, preview_series, retrieve_series
from carina.pacs.dimse_client import DimseClient, _Receiver
from carina.pacs.retrieval_folder import RetrievalFolder
from carina.pacs.web_client import WebClient
from carina.volume.progress import Watch

pynetdicom = pytest.importorskip("pynetdicom", reason="needs the extra dicom")
decode = pytest.importorskip("pynetdicom.dsutils").decode
pytest.importorskip("dicomweb_client", reason="needs the extra dicom")

STUDY, SERIES = "1.2.3", "1.2.3.4"
FIND, GET = "1.2.840.10008.5.1.4.1.2.2.1", "1.2.840.10008.5.1.4.1.2.2.3"


def image(uid: str) -> Dataset:
    dataset = Dataset()
    dataset.file_meta = FileMetaDataset()
    dataset.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    dataset.SOPClassUID, dataset.SOPInstanceUID = CTImageStorage, uid
    dataset.StudyInstanceUID, dataset.SeriesInstanceUID = STUDY, SERIES
    return dataset


class Server:
    """A PACS with one series, whose lists and answers a test changes."""

    def __init__(self) -> None:
        self.listed, self.sent, self.stated = ["1.2.3.4.1"], ["1.2.3.4.1"], None
        self.studies: list[Dataset] = []
        self.entity = pynetdicom.AE("PACS")
        self.entity.add_supported_context(FIND)
        self.entity.add_supported_context(CTImageStorage, scu_role=True, scp_role=True)
        self.port = free_port()

    def start(self, *, sends: bool = True) -> PacsConnection:
        if sends:
            self.entity.add_supported_context(GET)
        events = pynetdicom.evt
        handlers = [(events.EVT_C_FIND, self.find), (events.EVT_C_GET, self.get)]
        self.entity.start_server(("127.0.0.1", self.port), block=False, evt_handlers=handlers)
        return PacsConnection("test", host="127.0.0.1", port=self.port, called_ae="PACS")

    def find(self, event):
        level = event.identifier.QueryRetrieveLevel
        if level == "STUDY":
            answers = self.studies
        elif level == "SERIES":
            answer = Dataset()
            answer.SeriesInstanceUID, answer.NumberOfSeriesRelatedInstances = SERIES, self.stated
            answers = [answer]
        else:
            answers = [image(uid) for uid in self.listed]
        for answer in answers:
            yield 0xFF00, answer
        yield 0x0000, None

    def get(self, _event):
        yield len(self.sent)
        for uid in self.sent:
            yield 0xFF00, image(uid)


@pytest.fixture
def server():
    one = Server()
    yield one
    one.entity.shutdown()


def test_pacs_without_c_get_is_named_with_the_remedy(server, tmp_path):
    with pytest.raises(PacsError, match="--listen-port") as found:
        retrieve_series(server.start(sends=False), STUDY, SERIES, tmp_path / "scan")
    assert found.value.code == "pacs.no-service"
    assert list(tmp_path.iterdir()) == []


def test_images_that_the_pacs_does_not_list_are_not_in_the_folder(server, tmp_path):
    server.sent = ["1.2.3.4.1", "1.2.3.4.99"]
    found = retrieve_series(server.start(), STUDY, SERIES, tmp_path / "scan")
    assert (found.num_retrieved, len(list(found.folder.iterdir()))) == (1, 1)


def test_images_of_an_earlier_retrieval_that_the_pacs_has_deleted_are_removed(server, tmp_path):
    with RetrievalFolder(tmp_path / "scan", SERIES) as folder:
        folder.add("1.2.3.4.99", b"withdrawn")
    found = retrieve_series(server.start(), STUDY, SERIES, tmp_path / "scan")
    assert (found.num_retrieved, len(list(found.folder.iterdir()))) == (1, 1)
    assert b"withdrawn" not in next(found.folder.iterdir()).read_bytes()


def test_shortened_list_of_images_does_not_open_as_the_whole_series(server, tmp_path):
    server.stated = 2
    with pytest.raises(PacsError, match="lists only 1 of 2 images") as found:
        retrieve_series(server.start(), STUDY, SERIES, tmp_path / "scan")
    assert found.value.code == "pacs.incomplete"
    assert list(tmp_path.iterdir()) == []


def test_series_with_the_images_that_the_pacs_lists_is_not_retrieved_again(server, tmp_path):
    connection = server.start()
    first = retrieve_series(connection, STUDY, SERIES, tmp_path / "scan", reuse=True)
    before = {path: path.stat().st_ino for path in first.folder.iterdir()}
    server.sent = []
    again = retrieve_series(connection, STUDY, SERIES, tmp_path / "scan", reuse=True)
    assert (again.num_retrieved, again.num_resumed) == (1, 1)
    assert {path: path.stat().st_ino for path in again.folder.iterdir()} == before
    with pytest.raises(UsageError, match="name a new folder"):
        retrieve_series(connection, STUDY, SERIES, tmp_path / "scan")


@pytest.mark.parametrize("now", [["1.2.3.4.1", "1.2.3.4.2"], ["1.2.3.4.2"]])
def test_series_whose_images_have_changed_in_the_pacs_is_retrieved_again(server, tmp_path, now):
    connection = server.start()
    place = retrieve_series(connection, STUDY, SERIES, tmp_path / "scan", reuse=True).folder
    (place / "plan.seg.dcm").write_bytes(b"of the user")
    server.listed, server.sent = now, now
    found = retrieve_series(connection, STUDY, SERIES, tmp_path / "scan", reuse=True)
    assert (found.num_retrieved, found.num_resumed) == (len(now), 0)
    images = {dcmread(path).SOPInstanceUID for path in place.glob("*.dcm") if path.name != "plan.seg.dcm"}
    assert images == set(now)
    assert (place / "plan.seg.dcm").read_bytes() == b"of the user"
    assert list(tmp_path.iterdir()) == [place]


def test_failed_retrieval_of_a_changed_series_leaves_the_former_images(server, tmp_path):
    connection = server.start()
    place = retrieve_series(connection, STUDY, SERIES, tmp_path / "scan", reuse=True).folder
    before = sorted(place.iterdir())
    server.listed = ["1.2.3.4.1", "1.2.3.4.2"]
    with pytest.raises(PacsError, match="1 of 2 images did not arrive") as found:
        retrieve_series(connection, STUDY, SERIES, tmp_path / "scan", reuse=True)
    assert found.value.code == "pacs.incomplete"
    assert sorted(place.iterdir()) == before


def test_damaged_image_is_refused_and_the_retrieval_continues(tmp_path):
    folder = RetrievalFolder(tmp_path / "scan", SERIES)
    receiver = _Receiver("test", SERIES, folder, frozenset({"1.2.3.4.1"}), Watch(None, None))
    assert receiver.store(SimpleNamespace(assoc=None, dataset=Dataset())) == 0xC000
    assert not receiver.has_problem()
    receiver.raise_problem()


def test_connections_of_the_listener_end_with_the_retrieval():
    port = free_port()
    connection = PacsConnection("test", host="127.0.0.1", called_ae="SENDER", listen_port=port)
    sender = pynetdicom.AE("SENDER")
    sender.add_requested_context(CTImageStorage)
    with DimseClient(connection)._listener(None):
        association = sender.associate("127.0.0.1", port, ae_title="CARINA")
        assert association.is_established
    association.join(20)
    assert association.is_aborted


@pytest.mark.parametrize("is_late", [False, True])
def test_rejected_ae_title_is_named_also_if_the_connection_is_closed_first(server, monkeypatch, is_late):
    """The thread that opens an association may wake up after the other thread has read the rejection and closed."""
    server.entity.require_called_aet = True
    connection = replace(server.start(), called_ae="NOBODY")
    late = []

    class LateEvent(threading.Event):
        """Event whose wait ends after the connection was closed."""

        def __init__(self, transport):
            super().__init__()
            self._transport = transport

        def wait(self, timeout=None):
            super().wait(timeout)
            late.append(self._transport)
            while self._transport._is_connected:
                time.sleep(0.001)
            return True

    class LateSocket(pynetdicom.transport.AssociationSocket):
        def __init__(self, *given, **options):
            super().__init__(*given, **options)
            self._ready = LateEvent(self)

    if is_late:
        monkeypatch.setattr("pynetdicom.ae.AssociationSocket", LateSocket)
    with pytest.raises(PacsError, match="does not have the AE title NOBODY") as found:
        find_studies(connection, date="2026-11-03")
    assert found.value.code == "pacs.ae-title"
    assert len(late) == is_late


def test_numbers_and_texts_of_a_damaged_answer_are_left_out(server, recwarn):
    study = Dataset()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        study.StudyInstanceUID, study.ModalitiesInStudy = "1.2.3", ["CT", "A\x1b[2J"]
        study.add_new(0x00201206, "LO", "many")
        study.StudyDate = "Muster"
    server.studies = [study]
    warnings.simplefilter("always")
    (found,) = find_studies(server.start(), date="2026-11-03", modality="")
    assert (found.num_series, found.modalities, found.date) == (None, ("CT", "A[2J"), "")
    assert not any("Muster" in str(one.message) for one in recwarn)


def web_pages(monkeypatch, pages, *, series=()):
    """Answer the queries for images with pages, each with the statement whether the service has more images."""
    calls = []

    def client(connection):
        made = WebClient(connection)

        def instances(*_, **__):
            page, is_shortened = pages[min(len(calls), len(pages) - 1)]
            calls.append(page)
            made._check_received(0, is_shortened=is_shortened)
            return [{"00080018": {"vr": "UI", "Value": [uid]}} for uid in page]

        made._client = SimpleNamespace(
            search_for_instances=instances,
            search_for_series=lambda *_, **__: list(series),
            retrieve_instance=lambda _study, _series, uid, **_: image(uid),
        )
        return made

    monkeypatch.setattr("carina.pacs.client.WebClient", client)
    return PacsConnection("test", url="http://127.0.0.1:9/")


def stated_series(num_images):
    return {
        "0020000E": {"vr": "UI", "Value": [SERIES]},
        "00201209": {"vr": "IS", "Value": [num_images]},
    }


A, B = "1.2.3.4.1", "1.2.3.4.2"


def test_list_of_images_that_a_web_service_shortens_does_not_open_as_the_whole_series(tmp_path, monkeypatch):
    # This service ignores the offset and repeats its first images.
    connection = web_pages(monkeypatch, [([A], True)])
    with pytest.raises(PacsError, match="lists only the first 1 images") as found:
        retrieve_series(connection, STUDY, SERIES, tmp_path / "scan")
    assert found.value.code == "pacs.incomplete"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("pages", "series"),
    [
        # The first page of several states that there are more images; the last one does not.
        ([([A], True), ([B], False), ([], False)], ()),
        # The stated number of images proves that the list is whole.
        ([([A, B], True)], (stated_series(2),)),
    ],
)
def test_whole_list_of_images_of_a_web_service_is_accepted(tmp_path, monkeypatch, pages, series):
    found = retrieve_series(web_pages(monkeypatch, pages, series=series), STUDY, SERIES, tmp_path / "scan")
    assert found.num_retrieved == 2


def test_values_of_a_web_answer_are_not_quoted_in_warnings(monkeypatch, recwarn):
    study = {
        "0020000D": {"vr": "UI", "Value": ["1.2.3"]},
        "00100030": {"vr": "DA", "Value": ["1970-Muster"]},
        "00080020": {"vr": "DA", "Value": ["2026-Muster"]},
    }
    with pytest.warns(UserWarning, match="Muster"):
        Dataset.from_json(study)  # the library warns, so the test below can fail
    number = len(recwarn)

    def client(connection):
        made = WebClient(connection)
        made._client = SimpleNamespace(search_for_studies=lambda *_, **__: [study])
        return made

    monkeypatch.setattr("carina.pacs.client.WebClient", client)
    warnings.simplefilter("always")
    (found,) = find_studies(PacsConnection("test", url="http://127.0.0.1:9/"), date="2026-11-03", modality="")
    assert (found.uid, found.date) == ("1.2.3", "")
    assert len(recwarn) == number


def test_warning_of_another_thread_is_shown_while_a_file_is_sent(recwarn):
    def send(_datasets):
        warnings.warn("quotes a value of the answer", stacklevel=1)
        other = threading.Thread(target=warnings.warn, args=("of another job",))
        other.start()
        other.join()
        return Dataset()

    client = WebClient(PacsConnection("test", url="http://127.0.0.1:9/"))
    client._client = SimpleNamespace(store_instances=send)
    warnings.simplefilter("always")
    assert client.store([(Path("a.dcm"), Dataset())], Watch()) == (1, [])
    assert [str(one.message) for one in recwarn] == ["of another job"]


def received_image():
    """Return a data set as it arrives, with an invalid UID that pydicom converts, and quotes, at its first use."""
    return decode(BytesIO(struct.pack("<HHL", 0x0008, 0x0018, 8) + b"1.2.3.04"), True, True)


def test_values_of_the_images_of_a_preview_are_not_quoted_in_warnings(monkeypatch, recwarn):
    warnings.simplefilter("always")
    assert received_image().SOPInstanceUID == "1.2.3.04"
    assert len(recwarn) == 1  # the library warns, so this test can fail
    client = SimpleNamespace(find=lambda *_, **__: [received_image()], retrieve=lambda *_, **__: None)
    monkeypatch.setattr("carina.pacs.series_preview.client_of", lambda _: client)
    series = PacsSeries(SERIES, STUDY, "CT", "Thorax", 1, 1)
    assert preview_series(PacsConnection("test", url="http://127.0.0.1:9/"), series) == SeriesPreview()
    assert len(recwarn) == 1


@pytest.mark.parametrize("page", [[{"00080018": {"vr": "UI", "Value": []}}], {"error": 1}, [7]])
def test_answer_of_a_web_service_that_is_not_dicomweb_is_named(page, tmp_path, monkeypatch):
    def client(connection):
        made = WebClient(connection)
        made._client = SimpleNamespace(search_for_instances=lambda *_, **__: page)
        return made

    monkeypatch.setattr("carina.pacs.client.WebClient", client)
    with pytest.raises(PacsError) as found:
        retrieve_series(PacsConnection("test", url="http://127.0.0.1:9/"), STUDY, SERIES, tmp_path / "scan")
    assert found.value.code == "pacs.url"
    assert list(tmp_path.iterdir()) == []
