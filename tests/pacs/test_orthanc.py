"""Tests of ``carina.pacs`` with a real Orthanc on loopback: search, retrieval by three ways, storage, refusals."""

from __future__ import annotations

import logging
import socket
import subprocess
import sys
from dataclasses import asdict, replace

import numpy as np
import pytest
from dicom_writer import chest, packed, series
from nodules import ellipsoid
from orthanc_server import PLUGIN, free_port, require_orthanc, running_orthanc
from pydicom import dcmread

import carina
from carina.errors import CancelledError, PacsError, UsageError
from carina.export.plan_dicom_pdf import write_plan_pdf
from carina.export.plan_dicom_seg import write_target_seg
from carina.export.plan_dicom_sr import write_target_report
from carina.pacs import (
    PacsConnection,
    check_connection,
    find_series,
    find_studies,
    retrieve_series,
    store_files,
)

pytest.importorskip("pynetdicom", reason="needs the extra dicom")
pytest.importorskip("dicomweb_client", reason="needs the extra dicom")

SERIES = "1.2.3.77.1"
STUDY = "1.2.3.4.5"


def dated(dataset, _index):
    dataset.StudyDate, dataset.StudyDescription, dataset.InstanceNumber = "20261103", "Chest", 1
    dataset.PatientName = "Muster^Erika"


@pytest.fixture(scope="module")
def orthanc(tmp_path_factory):
    require_orthanc()
    folder = tmp_path_factory.mktemp("orthanc")
    with running_orthanc(folder) as server:
        scan = series(folder / "scan", dated, uid=SERIES)
        server.upload(scan)
        other = series(
            folder / "other",
            lambda d, i: (dated(d, i), packed(d, folder, "JPEG"), setattr(d, "PatientID", "SECRET-2"),
                          setattr(d, "StudyInstanceUID", "1.2.3.99"), setattr(d, "StudyDate", "20250101")),
            uid="1.2.3.99.1", hu=chest()[:5],
        )  # fmt: skip
        server.upload(other)
        yield server


@pytest.fixture(params=["get", "move", "web"])
def connection(request, orthanc):
    return connection_of(request.param, orthanc)


def connection_of(kind, orthanc):
    if kind == "web":
        if not PLUGIN.exists():
            pytest.skip("the DICOMweb plugin of Orthanc is not installed (Debian package orthanc-dicomweb)")
        return PacsConnection("test", url=orthanc.url)
    return PacsConnection(
        "test",
        host="127.0.0.1",
        port=orthanc.dicom_port,
        called_ae="ORTHANC",
        listen_port=orthanc.listen_port if kind == "move" else None,
        listen_host="127.0.0.1",
    )


def test_connection_test_passes_every_step(connection):
    check = check_connection(connection)
    assert check.passed, check
    expected = ["DICOMweb"] if connection.is_web else ["network", "C-ECHO"]
    assert [step.name for step in check.steps] == [*expected, *(["C-MOVE"] if connection.listen_port else [])]


@pytest.mark.parametrize(
    ("search", "studies"),
    [
        ({"patient_id": "SECRET-1"}, [STUDY]),
        ({"patient_name": "Muster"}, [STUDY, "1.2.3.99"]),
        ({"patient_name": "Muster^Er"}, [STUDY, "1.2.3.99"]),
        ({"patient_id": "SECRET-*"}, [STUDY, "1.2.3.99"]),
        ({"date": "2026-11-03"}, [STUDY]),
        ({"date": "2025-01-01..2026-12-31"}, [STUDY, "1.2.3.99"]),
        ({"date": "2020-01-01"}, []),
        ({"patient_id": "SECRET-1", "modality": "MR"}, []),
    ],
)
def test_search_by_patient_or_date_finds_the_studies(connection, search, studies):
    found = find_studies(connection, **search)
    assert [study.uid for study in found] == studies
    assert all(study.patient_name.startswith("Muster") for study in found)
    assert "Muster" not in repr(found)


def test_series_of_a_study_have_number_description_and_count(connection):
    (found,) = find_series(connection, STUDY)
    assert (found.uid, found.modality, found.description, found.number) == (SERIES, "CT", "Thorax", 3)
    assert found.num_images in (20, None)


def test_retrieved_series_opens_with_the_right_voxels(connection, tmp_path):
    steps = []
    found = retrieve_series(
        connection, STUDY, SERIES, tmp_path / "scan", progress=lambda what, share: steps.append((what, share))
    )
    assert (found.num_retrieved, found.num_resumed) == (20, 0)
    np.testing.assert_array_equal(carina.open_volume(tmp_path / "scan").hu_zyx, chest())
    shares = [share for what, share in steps if what == "Retrieving the images" and share is not None]
    assert shares == sorted(shares) and len(set(shares)) > 5
    assert list(tmp_path.iterdir()) == [tmp_path / "scan"]


def test_compressed_series_is_retrieved_with_the_right_voxels(connection, tmp_path):
    retrieve_series(connection, "1.2.3.99", "1.2.3.99.1", tmp_path / "scan")
    np.testing.assert_array_equal(carina.open_volume(tmp_path / "scan").hu_zyx, chest()[:5])


def test_cancelled_retrieval_shows_no_folder_and_resumes_with_the_missing_images(connection, tmp_path):
    received = []

    def cancel():
        received.append(len(list(tmp_path.glob(".scan.*/*.dcm"))))
        return received[-1] >= 7

    with pytest.raises(CancelledError):
        retrieve_series(connection, STUDY, SERIES, tmp_path / "scan", cancel=cancel)
    assert not (tmp_path / "scan").exists()
    before = len(list(tmp_path.glob(".scan.*/*.dcm")))
    assert 7 <= before < 20
    found = retrieve_series(connection, STUDY, SERIES, tmp_path / "scan")
    assert (found.num_retrieved, found.num_resumed) == (20, before)
    np.testing.assert_array_equal(carina.open_volume(tmp_path / "scan").hu_zyx, chest())


def test_killed_retrieval_is_resumed(connection, tmp_path):
    script = (
        "import os, sys, carina.pacs as p, pathlib\n"
        f"c = p.PacsConnection(**{asdict(connection)!r})\n"
        f"f = pathlib.Path({str(tmp_path)!r})\n"
        "def progress(*_):\n"
        "    if len(list(f.glob('.scan.*/*.dcm'))) >= 5: os.kill(os.getpid(), 9)\n"
        f"p.retrieve_series(c, {STUDY!r}, {SERIES!r}, f / 'scan', progress=progress)\n"
    )
    ended = subprocess.run([sys.executable, "-c", script], check=False, capture_output=True, timeout=120)
    assert ended.returncode == -9, ended.stderr[-2000:]
    assert not (tmp_path / "scan").exists()
    found = retrieve_series(connection, STUDY, SERIES, tmp_path / "scan")
    assert found.num_retrieved == 20
    assert found.num_resumed >= 5
    np.testing.assert_array_equal(carina.open_volume(tmp_path / "scan").hu_zyx, chest())


def test_existing_folder_is_refused(connection, tmp_path):
    with pytest.raises(UsageError) as found:
        retrieve_series(connection, STUDY, SERIES, tmp_path)
    assert found.value.code == "pacs.folder"


def test_unknown_series_is_refused_and_leaves_nothing(connection, tmp_path):
    with pytest.raises(PacsError) as found:
        retrieve_series(connection, STUDY, "1.2.3.404", tmp_path / "scan")
    assert found.value.code in ("pacs.no-images", "pacs.url")
    assert list(tmp_path.iterdir()) == []


# -- refusals: one message with one action -----------------------------------------------------------------------------


def test_pacs_that_is_off_is_named(orthanc):
    closed = free_port()
    for one in (
        PacsConnection("test", host="127.0.0.1", port=closed, called_ae="ORTHANC"),
        PacsConnection("test", url=f"http://127.0.0.1:{closed}/dicom-web"),
    ):
        with pytest.raises(PacsError, match=r"no program answers at .*; check the port") as found:
            find_studies(one, date="2026-11-03")
        assert found.value.code == "pacs.offline"


def test_unknown_host_is_named():
    one = PacsConnection("test", host="pacs.invalid", called_ae="ORTHANC")
    with pytest.raises(PacsError, match=r"host name of pacs\.invalid, port 104 is unknown") as found:
        find_studies(one, date="2026-11-03")
    assert found.value.code == "pacs.offline"


def test_wrong_ae_titles_are_distinguished(orthanc):
    right = connection_of("get", orthanc)
    check = check_connection(replace(right, called_ae="WRONG"))
    assert "does not have the AE title WRONG" in check.steps[-1].message
    check = check_connection(replace(right, calling_ae="UNKNOWN"))
    assert not check.passed
    assert "enter the AE title UNKNOWN" in check.steps[-1].message
    with pytest.raises(PacsError) as found:
        find_studies(replace(right, called_ae="WRONG"), date="2026-11-03")
    assert found.value.code == "pacs.ae-title"


def test_blocked_listener_port_is_named(orthanc, tmp_path):
    right = connection_of("move", orthanc)
    with socket.socket() as other:
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # the listener of an earlier test
        other.bind(("127.0.0.1", right.listen_port))
        other.listen()
        assert "is used by another program" in check_connection(right).steps[-1].message
        with pytest.raises(PacsError, match="choose another port") as found:
            retrieve_series(right, STUDY, SERIES, tmp_path / "scan")
    assert found.value.code == "pacs.listener"


def test_listener_port_that_the_pacs_cannot_reach_is_named(orthanc, tmp_path):
    # This machine listens on another port than the one that the PACS has for it, as behind a firewall.
    wrong = replace(connection_of("move", orthanc), listen_port=free_port())
    with pytest.raises(PacsError, match="open this port in the firewall") as found:
        retrieve_series(wrong, STUDY, SERIES, tmp_path / "scan")
    assert found.value.code == "pacs.listener"
    assert list(tmp_path.iterdir()) == []


def test_dicomweb_at_a_wrong_url_is_named(orthanc):
    one = PacsConnection("test", url=f"http://127.0.0.1:{orthanc.http_port}/nothing")
    with pytest.raises(PacsError, match="check the URL") as found:
        find_studies(one, date="2026-11-03")
    assert found.value.code == "pacs.url"


def test_neither_names_nor_identifiers_are_logged(connection, tmp_path, caplog):
    caplog.set_level(logging.DEBUG)
    find_studies(connection, patient_name="Muster")
    retrieve_series(connection, STUDY, SERIES, tmp_path / "scan")
    assert not any(text in caplog.text for text in ("Muster", "SECRET", STUDY, SERIES))


# -- storage of plans --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def plan_files(tmp_path_factory):
    """Return a segmentation, a report and a PDF of a target in a CT, as `carina plan` writes them."""
    folder = tmp_path_factory.mktemp("plan")
    scan = series(folder / "scan", dated, uid=SERIES)
    volume = carina.open_volume(scan)
    target = ellipsoid([4.0, 3.0, 5.0], volume.centre_lps, step_mm=0.4)
    source = {"volume": volume, "ct": scan, "identity": "from the CT"}
    pdf = b"%PDF-1.4\n%%EOF\n"
    return (
        write_target_seg(folder / "seg.dcm", target, **source),
        write_target_report(folder / "report.dcm", target, **source),
        write_plan_pdf(folder / "pdf.dcm", pdf, names_patient=False, **source),
    )


@pytest.mark.parametrize("kind", ["get", "web"])
def test_files_of_a_plan_are_stored_and_read_again(kind, plan_files, tmp_path):
    (tmp_path / "server").mkdir()
    with running_orthanc(tmp_path / "server", DicomAlwaysAllowStore=True) as server:
        connection = connection_of(kind, server)
        found = store_files(connection, plan_files)
        assert (found.num_stored, found.refused) == (3, ())
        assert server.num_instances() == 3
        for path in plan_files:
            original = dcmread(path)
            one = connection_of("get", server)
            place = tmp_path / f"again-{path.stem}"
            retrieve_series(one, original.StudyInstanceUID, original.SeriesInstanceUID, place)
            again = dcmread(next(place.iterdir()))
            assert again.SOPClassUID == original.SOPClassUID
            assert again.to_json_dict() == original.to_json_dict()


def test_file_that_is_not_dicom_is_refused_before_anything_is_sent(connection, orthanc, tmp_path):
    (tmp_path / "a.txt").write_text("no image")
    before = orthanc.num_instances()
    with pytest.raises(UsageError, match=r"a\.txt is not a complete DICOM file"):
        store_files(connection, [tmp_path])
    assert orthanc.num_instances() == before
