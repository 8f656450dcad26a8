"""Tests of the limits of data from a PACS, and of the listener that only the PACS may use."""

from __future__ import annotations

import contextlib
import socket
from types import SimpleNamespace

import numpy as np
import pytest
from dicom_writer import series
from orthanc_server import PLUGIN, free_port, require_orthanc, running_orthanc
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import ImplicitVRLittleEndian

from carina.errors import CancelledError, PacsError
from carina.pacs import PacsConnection, find_series, find_studies, likeliest_series, preview_series, retrieve_series
from carina.pacs.client import client_of
from carina.pacs.dimse_client import DimseClient, _Receiver, listening_address
from carina.pacs.limits import MAX_PDU_BYTES, limit_socket
from carina.pacs.retrieval_folder import RetrievalFolder
from carina.volume.progress import Watch

pynetdicom = pytest.importorskip("pynetdicom", reason="needs the extra dicom")
pytest.importorskip("dicomweb_client", reason="needs the extra dicom")

STUDY, SERIES, SCOUT, LARGE = "1.2.3.4.5", "1.2.3.77.1", "1.2.3.77.2", "1.2.3.79.1"
CT_IMAGE = "1.2.840.10008.5.1.4.1.1.2"


def thorax(dataset, index):
    dataset.StudyDate, dataset.InstanceNumber = "20261103", index + 1
    dataset.SliceThickness, dataset.ConvolutionKernel = 1.25, "B70f"


def scout(dataset, index):
    thorax(dataset, index)
    dataset.SeriesDescription, dataset.SeriesNumber = "Scout", 1


def other_study(dataset, index):
    thorax(dataset, index)
    dataset.StudyInstanceUID = "1.2.3.4.6"


def large_study(dataset, index):
    thorax(dataset, index)
    dataset.StudyInstanceUID, dataset.PatientID = "1.2.3.4.7", "SECRET-7"


@pytest.fixture(scope="module")
def orthanc(tmp_path_factory):
    require_orthanc()
    folder = tmp_path_factory.mktemp("orthanc")
    with running_orthanc(folder) as server:
        server.upload(series(folder / "scan", thorax, uid=SERIES))
        server.upload(series(folder / "scout", scout, uid=SCOUT))
        server.upload(series(folder / "other", other_study, uid="1.2.3.78.1"))
        large = np.zeros((3, 96, 96), dtype=np.int16)
        server.upload(series(folder / "large", large_study, uid=LARGE, hu=large))
        yield server


@pytest.fixture(params=["get", "move", "web"])
def connection(request, orthanc):
    if request.param == "web":
        if not PLUGIN.exists():
            pytest.skip("the DICOMweb plugin of Orthanc is not installed (Debian package orthanc-dicomweb)")
        return PacsConnection("test", url=orthanc.url)
    port = orthanc.listen_port if request.param == "move" else None
    return PacsConnection("test", host="127.0.0.1", port=orthanc.dicom_port, called_ae="ORTHANC", listen_port=port)


def test_series_with_too_many_images_is_refused_and_nothing_is_stored(connection, tmp_path, monkeypatch):
    monkeypatch.setattr("carina.pacs.client.MAX_SERIES_IMAGES", 19)
    with pytest.raises(PacsError, match=r"more than 19 images.*choose another series") as found:
        retrieve_series(connection, STUDY, SERIES, tmp_path / "scan")
    assert found.value.code == "pacs.too-large"
    assert list(tmp_path.iterdir()) == []


def test_series_with_too_many_bytes_is_refused_and_nothing_is_stored(connection, tmp_path, monkeypatch):
    monkeypatch.setattr("carina.pacs.retrieval_folder.MAX_SERIES_BYTES", 40_000)
    with pytest.raises(PacsError, match="more than") as found:
        retrieve_series(connection, STUDY, SERIES, tmp_path / "scan")
    assert found.value.code == "pacs.too-large"
    assert list(tmp_path.iterdir()) == []


def test_image_with_too_many_bytes_ends_the_retrieval_before_it_is_complete(connection, tmp_path):
    # The limit is above the size of the messages that begin the connection, and below that of an image of 18 kB.
    client, watch = client_of(connection), Watch(None, None)
    keys = {"StudyInstanceUID": "1.2.3.4.7", "SeriesInstanceUID": LARGE, "SOPInstanceUID": ""}
    found = client.find("IMAGE", keys, limit=99, watch=watch)
    images = [str(one.SOPInstanceUID) for one in found]
    with RetrievalFolder(tmp_path / "scan", LARGE, max_image_bytes=12_000) as place:
        with pytest.raises(PacsError) as refused:
            client.retrieve("1.2.3.4.7", LARGE, images, place, watch)
        assert refused.value.code == "pacs.too-large"
        assert len(place) == 0


def test_cancellation_ends_a_web_answer_while_it_arrives(tmp_path, orthanc):
    if not PLUGIN.exists():
        pytest.skip("the DICOMweb plugin of Orthanc is not installed (Debian package orthanc-dicomweb)")
    client = client_of(PacsConnection("test", url=orthanc.url))
    calls = []

    def cancel():
        calls.append(len(calls))
        return len(calls) > 1  # the first call precedes the request

    with pytest.raises(CancelledError):
        client.find("STUDY", {"PatientID": "SECRET-1"}, limit=5, watch=Watch(None, cancel))


def test_search_states_whether_the_pacs_has_more_studies(connection):
    found = find_studies(connection, patient_id="SECRET-1", limit=1)
    assert (len(found), found.has_more) == (1, True)
    assert found.to_json()["has_more"] is True
    found = find_studies(connection, patient_id="SECRET-1", limit=2)
    assert (len(found), found.has_more) == (2, False)
    assert "SECRET" not in repr(found)


def test_preview_states_the_facts_of_the_images_and_the_thin_chest_is_preselected(connection):
    found = find_series(connection, STUDY)
    previews = {one.uid: preview_series(connection, one) for one in found}
    preview = previews[SERIES]
    info = preview.info
    assert (info.thickness_mm, info.kernel, info.acquired_on) == (1.25, "b70f", "2026-11-03")
    assert preview.picture.startswith(b"\x89PNG")
    chosen, reason = likeliest_series(found, previews)
    if found[0].num_images is None:  # a DICOMweb service need not count the images
        assert chosen is None
    else:
        assert chosen.uid == SERIES
        assert reason == "the likeliest chest CT: 20 images of 1.25 mm, named as a chest"


# -- listener ----------------------------------------------------------------------------------------------------------


def test_listener_is_on_the_one_address_that_reaches_the_pacs():
    assert (
        listening_address(PacsConnection("test", host="127.0.0.1", called_ae="PACS", listen_port=11112)) == "127.0.0.1"
    )
    chosen = PacsConnection("test", host="127.0.0.1", called_ae="PACS", listen_port=11112, listen_host="0.0.0.0")
    assert listening_address(chosen) == "0.0.0.0"
    with pytest.raises(PacsError, match="host name"):
        listening_address(PacsConnection("test", host="pacs.invalid", called_ae="PACS", listen_port=11112))


def test_listener_accepts_only_the_ae_titles_of_the_connection(tmp_path):
    port = free_port()
    connection = PacsConnection("test", host="127.0.0.1", called_ae="PACS", calling_ae="CARINA", listen_port=port)
    client = DimseClient(connection)
    folder = RetrievalFolder(tmp_path / "scan", SERIES)
    receiver = _Receiver("test", SERIES, folder, frozenset(), Watch(None, None))
    with folder, client._listener(receiver):
        for calling, called, accepted in (
            ("PACS", "CARINA", True),
            ("EVIL", "CARINA", False),
            ("PACS", "OTHER", False),
        ):
            sender = pynetdicom.AE(calling)
            sender.add_requested_context(CT_IMAGE)
            association = sender.associate("127.0.0.1", port, ae_title=called)
            assert association.is_established == accepted, (calling, called)
            if accepted:
                association.release()
    error = client._failed(0xA702, "EVIL")
    assert error.code == "pacs.ae-title"
    assert "AE title EVIL tried to send images" in str(error)


def send_claim(port, num_bytes):
    """Send a damaged request with a number of bytes, before any AE title, and wait until the listener has read it."""
    with socket.create_connection(("127.0.0.1", port), timeout=20) as other, contextlib.suppress(ConnectionResetError):
        other.sendall(b"\x01\x00" + num_bytes.to_bytes(4, "big") + bytes(num_bytes))
        while other.recv(100):
            pass


def image_of(num_bytes):
    image = Dataset()
    image.SOPClassUID, image.SOPInstanceUID, image.SeriesInstanceUID = CT_IMAGE, "1.2.3.1", SERIES
    image.add_new("PixelData", "OW", bytes(num_bytes))
    image.file_meta = FileMetaDataset()
    image.file_meta.TransferSyntaxUID = ImplicitVRLittleEndian
    return image


def test_bytes_of_a_program_that_is_not_the_pacs_do_not_end_a_retrieval(tmp_path):
    port = free_port()
    connection = PacsConnection("test", host="127.0.0.1", called_ae="PACS", calling_ae="CARINA", listen_port=port)
    folder = RetrievalFolder(tmp_path / "scan", SERIES, max_image_bytes=4_000)
    receiver = _Receiver("test", SERIES, folder, frozenset(), Watch(None, None))
    with folder, DimseClient(connection)._listener(receiver):
        send_claim(port, 8_000)
        assert not receiver.has_problem()
        sender = pynetdicom.AE("PACS")
        sender.add_requested_context(CT_IMAGE)
        association = sender.associate("127.0.0.1", port, ae_title="CARINA")
        assert association.is_established
        # Below the limit for itself, but above the limit together with the image of the PACS.
        send_claim(port, 3_000)
        assert association.send_c_store(image_of(2_500)).Status == 0x0000
        assert not receiver.has_problem()
        # An image of the PACS above the limit ends the retrieval.
        association.send_c_store(image_of(6_000))
        assert receiver.has_problem()
        with pytest.raises(PacsError) as found:
            receiver.raise_problem()
        assert found.value.code == "pacs.too-large"
        association.abort()


def test_test_of_a_listener_limits_the_bytes_of_every_program(monkeypatch):
    monkeypatch.setattr("carina.pacs.dimse_client.MAX_ANSWER_BYTES", 4_000)
    port = free_port()
    connection = PacsConnection("test", host="127.0.0.1", called_ae="PACS", calling_ae="CARINA", listen_port=port)
    listener = DimseClient(connection)._listener(None)
    with listener, socket.create_connection(("127.0.0.1", port), timeout=20) as other:
        other.sendall(b"\x01\x00" + (8_000).to_bytes(4, "big"))
        # The listener closes the connection instead of waiting for the rest.
        with contextlib.suppress(ConnectionResetError):
            assert other.recv(1) == b""


def test_longer_message_part_than_offered_closes_the_connection_before_it_is_read():
    reads = []
    transport = SimpleNamespace(recv=lambda num_bytes: reads.append(num_bytes) or b"")
    limit_socket(SimpleNamespace(dul=SimpleNamespace(socket=transport)), lambda _: None)
    transport.recv(MAX_PDU_BYTES + 6)
    with pytest.raises(OSError, match="longer PDU"):
        transport.recv(MAX_PDU_BYTES + 7)
    assert reads == [MAX_PDU_BYTES + 6]


def test_listener_port_is_free_after_the_retrieval(orthanc, tmp_path):
    connection = PacsConnection(
        "test", host="127.0.0.1", port=orthanc.dicom_port, called_ae="ORTHANC", listen_port=orthanc.listen_port
    )
    retrieve_series(connection, STUDY, SERIES, tmp_path / "scan")
    with socket.socket() as other:
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        other.bind(("127.0.0.1", orthanc.listen_port))
