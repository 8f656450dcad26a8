"""Tests of the commands ``carina pacs`` with a real Orthanc on loopback."""

from __future__ import annotations

import io
import json

import pytest
from dicom_writer import chest, series
from orthanc_server import running_orthanc

pytest.importorskip("pynetdicom", reason="needs the extra dicom")


def test_series_is_found_retrieved_and_opened_by_commands(carina, tmp_path):
    (tmp_path / "server").mkdir()
    with running_orthanc(tmp_path / "server") as server:
        server.upload(series(tmp_path / "scan", lambda d, _: setattr(d, "StudyDate", "20261103"), uid="1.2.3.77.1"))
        address = ("--host", "127.0.0.1", "--port", server.dicom_port, "--ae", "ORTHANC")
        assert "Test it with" in carina("pacs", "add", "hospital", *address).out
        assert carina("pacs", "test", "hospital", "--json").json()["passed"]
        (study,) = carina("pacs", "search", "hospital", "--date", "2026-11-03", "--json").json()["studies"]
        listed = carina("pacs", "search", "hospital", "--study", study["uid"], "--json").json()
        (one,) = listed["series"]
        found = carina("pacs", "get", "hospital", one["study_uid"], one["uid"], "-o", tmp_path / "got", "--json").json()
        assert found["num_retrieved"] == 20
        assert carina("info", tmp_path / "got", "--json").json()["shape_zyx"] == list(chest().shape)
        wrong = carina("pacs", "add", "wrong", *address[:-1], "NOBODY")
        assert wrong.code == 0
        tested = carina("pacs", "test", "wrong")
        assert tested.code == 1
        assert "does not have the AE title NOBODY" in tested.out
        refused = carina("pacs", "search", "wrong", "--date", "2026-11-03", "--json")
        assert (refused.code, refused.json()["error"]["code"]) == (1, "pacs.ae-title")


def test_connections_are_added_listed_and_removed(carina, tmp_path, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO("geheim-1\n"))
    added = carina("pacs", "add", "web", "--url", "https://pacs.example.org/dicom-web", "--user", "erika", "--json")
    assert "geheim" not in added.out + added.err
    (one,) = carina("pacs", "list", "--json").json()["connections"]
    assert one["url"] == "https://pacs.example.org/dicom-web"
    assert carina("pacs", "remove", "web").code == 0
    assert json.loads(carina("pacs", "list", "--json").out) == {"connections": []}
    assert carina("pacs", "test", "web").code == 2
