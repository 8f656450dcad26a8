"""Tests of the messages about PACS with a real Orthanc on loopback: connections, search, retrieval, privacy."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from dicom_writer import series
from live_server import open_case
from nodules import ellipsoid
from orthanc_server import free_port, require_orthanc, running_orthanc

import carina.pacs
from carina.errors import UsageError
from carina.export.plan_dicom_seg import write_target_seg
from carina.server import pacs_requests
from carina.server.pacs_requests import FOR_WINDOW, PacsRequests, text_for_window
from carina.server.wire import messages as wire
from carina.volume import open_volume

pytest.importorskip("pynetdicom", reason="needs the extra dicom")
pytest.importorskip("dicomweb_client", reason="needs the extra dicom")

STUDY, SERIES = "1.2.3.4.5", "1.2.3.77.1"


def dated(dataset, index):
    dataset.StudyDate, dataset.PatientName, dataset.InstanceNumber = "20261103", "Muster^Erika", index + 1


@pytest.fixture(scope="module")
def orthanc(tmp_path_factory):
    require_orthanc()
    folder = tmp_path_factory.mktemp("orthanc")
    with running_orthanc(folder) as server:
        server.upload(series(folder / "scan", dated, uid=SERIES))
        yield server


@pytest.fixture(autouse=True)
def settings(tmp_path, monkeypatch):
    """Store connections and retrieved series in temporary folders, and passwords in a file."""
    monkeypatch.setitem(sys.modules, "keyring", None)
    real = pacs_requests.load_settings()
    folders = SimpleNamespace(retrieved_dir=tmp_path / "retrieved", config_dir=tmp_path / "config")
    monkeypatch.setattr(pacs_requests, "load_settings", lambda: folders)
    monkeypatch.setattr("carina.config.load_settings", lambda *_: folders)
    return real


def fields(**values):
    first = {
        "name": "hospital", "host": "127.0.0.1", "port": 104, "called_ae": "ORTHANC", "calling_ae": "CARINA",
        "listen_port": None, "listen_host": "", "tls": False, "url": "", "user": "", "ca_file": "",
    }  # fmt: skip
    return wire.PacsFields(**(first | values))


def answer(window, kind):
    found = window.until(lambda m: isinstance(m, (kind, wire.PacsProblemMessage)))
    assert isinstance(found, kind), found
    return found


def problem(window):
    return window.until(lambda m: isinstance(m, wire.PacsProblemMessage))


def connected(window, orthanc):
    window.send(wire.SavePacs(fields(port=orthanc.dicom_port), None))
    return answer(window, wire.PacsConnectionsMessage)


def test_connection_is_added_edited_tested_and_deleted(live, orthanc):
    with live.window() as window:
        assert [one.name for one in connected(window, orthanc).connections] == ["hospital"]
        window.send(wire.TestPacs("hospital"))
        test = answer(window, wire.PacsTestMessage)
        assert test.passed
        assert [step.name for step in test.steps] == ["network", "C-ECHO"]
        window.send(wire.SavePacs(fields(name="clinic", port=orthanc.dicom_port, called_ae="NOBODY"), None, "hospital"))
        assert [one.name for one in answer(window, wire.PacsConnectionsMessage).connections] == ["clinic"]
        window.send(wire.TestPacs("clinic"))
        failed = answer(window, wire.PacsTestMessage)
        assert not failed.passed
        assert "does not have the AE title NOBODY; ask its administrator" in failed.steps[-1].finding
        window.send(wire.RemovePacs("clinic"))
        assert answer(window, wire.PacsConnectionsMessage).connections == ()


def test_edited_connection_has_its_former_password_unless_a_new_one_is_given(live):
    web = {"host": "", "url": "https://pacs.example.org/dicom-web", "user": "erika"}
    with live.window() as window:
        window.send(wire.SavePacs(fields(**web), "geheim-1"))
        saved = answer(window, wire.PacsConnectionsMessage)
        assert "geheim" not in wire.encode_message(saved)
        window.send(wire.SavePacs(fields(name="clinic", **web), None, "hospital"))
        answer(window, wire.PacsConnectionsMessage)
        assert carina.pacs.PacsConnections().get("clinic").password == "geheim-1"
        window.send(wire.SavePacs(fields(name="clinic", **web), "geheim-2", "clinic"))
        answer(window, wire.PacsConnectionsMessage)
        assert carina.pacs.PacsConnections().get("clinic").password == "geheim-2"


@pytest.mark.parametrize(("change", "words"), [({"host": ""}, "expected the host name"), ({"name": "a/b"}, "a name")])
def test_invalid_connection_is_refused_with_the_reason(live, change, words):
    with live.window() as window:
        window.send(wire.SavePacs(fields(**change), None))
        found = problem(window)
        assert (found.task, found.code) == ("settings", "usage.pacs")
        assert words in found.problem


def test_new_connection_does_not_replace_one_of_its_name(live, orthanc):
    with live.window() as window:
        connected(window, orthanc)
        window.send(wire.SavePacs(fields(host="other.example"), None))
        assert "choose another name" in problem(window).problem


def test_series_is_found_retrieved_and_opened_as_a_case_without_a_name_in_its_path(live, orthanc, tmp_path, caplog):
    caplog.set_level(logging.DEBUG)
    with live.window() as window:
        connected(window, orthanc)
        window.send(wire.SearchPacs("hospital", "Muster", "", ""))
        found = answer(window, wire.PacsStudiesMessage)
        (study,) = found.studies
        assert (study.patient_name, study.date, found.has_more) == ("Muster^Erika", "2026-11-03", False)
        window.send(wire.AskPacsSeries("hospital", study.study_uid))
        listed = answer(window, wire.PacsSeriesMessage)
        assert (listed.preselected, listed.series[0].num_images) == (SERIES, 20)
        assert listed.reason.startswith("the likeliest chest CT: 20 images")
        preview = answer(window, wire.PacsPreviewMessage)
        assert (preview.series_uid, preview.scanned_on) == (SERIES, "2026-11-03")
        assert preview.picture is not None
        window.send(wire.GetPacsSeries("hospital", study.study_uid, SERIES))
        window.until_state(lambda state: state.case is not None)
        (opened,) = live.opened
        place = Path(opened)
        assert place.parent == tmp_path / "retrieved"
        assert len(list(place.iterdir())) == 20
        assert not any(text in str(place) for text in ("Muster", STUDY, SERIES))
        window.send(wire.EmptyPacs())
        assert "close the case first" in problem(window).problem
        window.send(wire.CloseCase())
        window.until_state(lambda state: state.case is None)
        window.send(wire.EmptyPacs())
        assert answer(window, wire.PacsConnectionsMessage).num_retrieved == 0
        assert not place.exists()
    # The WebSocket library logs every frame at DEBUG, on both sides of this process.
    logged = [record.getMessage() for record in caplog.records if not record.name.startswith("websockets")]
    assert not any(text in line for line in logged for text in ("Muster", STUDY, SERIES))
    stored = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert not any(b"Muster" in path.read_bytes() for path in stored)


def test_files_of_a_plan_are_stored_with_the_name_of_the_patient(live, tmp_path, monkeypatch):
    scan = series(tmp_path / "scan", dated, uid=SERIES)
    volume = open_volume(scan)
    target = ellipsoid([4.0, 3.0, 5.0], volume.centre_lps, step_mm=0.4)
    asked = []

    def write(_session, target_id, suffixes, folder, *, identity, job):
        asked.append((target_id, suffixes, identity))
        job.progress("writing", 0.5)
        return [write_target_seg(folder / "plan.seg.dcm", target, volume=volume, ct=scan, identity=identity)]

    monkeypatch.setattr(pacs_requests, "write_archive_files", write)
    (tmp_path / "server").mkdir()
    with running_orthanc(tmp_path / "server", DicomAlwaysAllowStore=True) as server, live.window() as window:
        connected(window, server)
        window.send(wire.SendPlanToPacs("hospital", "target-1", ("seg", "sr")))
        sent = answer(window, wire.PacsSentMessage)
        assert (sent.name, sent.num_stored, sent.refused) == ("hospital", 1, ())
        assert asked == [("target-1", [".seg.dcm", ".sr.dcm"], "from the CT")]
        (study,) = server.request("/studies?expand")
        assert study["PatientMainDicomTags"]["PatientName"] == "Muster^Erika"


def test_plan_without_a_dicom_folder_is_refused_and_nothing_is_sent(live, orthanc):
    with live.window() as window:
        open_case(window)
        connected(window, orthanc)
        before = orthanc.num_instances()
        window.send(wire.SendPlanToPacs("hospital", "target-1", ("seg",)))
        found = problem(window)
        assert found.task == "send"
        assert orthanc.num_instances() == before


def test_other_windows_and_observers_receive_no_search_result(live, orthanc):
    with live.window() as window, live.window() as other:
        connected(window, orthanc)
        window.send(wire.SearchPacs("hospital", "", "", "2026-11-03"))
        answer(window, wire.PacsStudiesMessage)
        other.send(wire.AskPacs())
        answer(other, wire.PacsConnectionsMessage)
        assert not any("Muster" in wire.encode_message(message) for message in other.seen)


def test_window_on_another_machine_may_not_use_the_pacs(live):
    requests = PacsRequests(live.session)
    away = SimpleNamespace(number=1, at_machine=False, send=lambda _: None)
    with pytest.raises(UsageError, match="only in a browser on the machine") as found:
        requests.handle(wire.AskPacs(), away)
    assert found.value.code == "pacs.other-machine"
    assert requests.handle(wire.AskStorage(), away) is False


# pynetdicom leaves the socket of a refused connection to the garbage collector.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_failed_search_and_retrieval_state_the_reason_and_the_open_case_stays(live):
    with live.window() as window:
        before = open_case(window)
        window.send(wire.SavePacs(fields(port=free_port()), None))
        answer(window, wire.PacsConnectionsMessage)
        window.send(wire.SearchPacs("hospital", "", "17", ""))
        found = problem(window)
        assert (found.task, found.code) == ("search", "pacs.offline")
        assert "no program answers" in found.problem
        window.send(wire.GetPacsSeries("hospital", STUDY, SERIES))
        assert problem(window).task == "get"
        window.send(wire.SearchPacs("hospital", "", "", "yesterday"))
        assert "expected 2026-11-30" in problem(window).problem
        assert live.session.snapshot().case_number == before.case.number


def test_closing_the_list_stops_search_and_previews(live):
    kinds = []
    requests = PacsRequests(SimpleNamespace(jobs=SimpleNamespace(cancel_kinds=lambda *names: kinds.extend(names))))
    assert requests.handle(wire.StopPacs(), SimpleNamespace(number=1, at_machine=True))
    assert kinds == ["pacs-test", "pacs-search", "pacs-series"]


def test_actions_of_the_command_line_are_replaced_by_those_of_the_window():
    sources = " ".join(path.read_text() for path in Path(carina.pacs.__file__).parent.glob("*.py"))
    plain = "".join(sources.replace('"\n', "\x00").split("\x00"))
    joined = " ".join(plain.replace('"', " ").split())
    for command, action in FOR_WINDOW:
        assert command in joined, command
        assert action in text_for_window(f"text; {command}")
    assert "--" not in text_for_window("give it with --ca-file")
