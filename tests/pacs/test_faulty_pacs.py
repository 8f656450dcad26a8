"""Tests of ``carina.pacs`` with a server that answers wrongly: hidden images, unrequested and damaged images."""

from __future__ import annotations

import warnings
from types import SimpleNamespace

import pytest
from orthanc_server import free_port
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian

from carina.errors import PacsError
from carina.pacs import PacsConnection, find_studies, retrieve_series
from carina.pacs.dimse_client import DimseClient, _Receiver
from carina.pacs.retrieval_folder import RetrievalFolder
from carina.pacs.web_client import WebClient
from carina.volume.progress import Watch

pynetdicom = pytest.importorskip("pynetdicom", reason="needs the extra dicom")
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
    RetrievalFolder(tmp_path / "scan", SERIES).add("1.2.3.4.99", b"withdrawn")
    found = retrieve_series(server.start(), STUDY, SERIES, tmp_path / "scan")
    assert (found.num_retrieved, len(list(found.folder.iterdir()))) == (1, 1)
    assert b"withdrawn" not in next(found.folder.iterdir()).read_bytes()


def test_shortened_list_of_images_does_not_open_as_the_whole_series(server, tmp_path):
    server.stated = 2
    with pytest.raises(PacsError, match="lists only 1 of 2 images") as found:
        retrieve_series(server.start(), STUDY, SERIES, tmp_path / "scan")
    assert found.value.code == "pacs.incomplete"
    assert list(tmp_path.iterdir()) == []


def test_damaged_image_is_refused_and_the_retrieval_continues(tmp_path):
    folder = RetrievalFolder(tmp_path / "scan", SERIES)
    receiver = _Receiver("test", SERIES, folder, frozenset({"1.2.3.4.1"}), Watch(None, None))
    assert receiver.store(SimpleNamespace(dataset=Dataset())) == 0xC000
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
