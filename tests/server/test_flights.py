"""Test of recorded flights over the wire: the list, its changes, and the download of a flight over HTTP."""

from __future__ import annotations

import json
import time

import pytest
from edit_case import edit_case
from live_server import Live, open_case, serving

from carina.navigate import open_recording
from carina.render import transfer_preset
from carina.server.files.uploads import Limits, Uploads
from carina.server.wire import messages as wire
from carina.session import Session
from carina.session.store.disk_storage import case_files
from carina.session.store.registry import CaseRecords
from small_case import SmallRenderer, small_parts


@pytest.fixture
def live(tmp_path):
    """Return a server over a session that stores its cases."""
    case = edit_case()
    parts = small_parts(
        open_volume=lambda _path, _progress, _cancel: case.volume,
        find_airways=lambda _volume, **_options: case.airways,
        transfer_preset=transfer_preset,
    )
    session = Session(
        SmallRenderer, parts=parts, records=CaseRecords(tmp_path / "cases", time.time), files=case_files()
    )
    uploads = Uploads(Limits(num_files=20, total_bytes=10_000, file_bytes=5000))
    with serving(session, uploads) as gate:
        yield Live(gate, session, uploads, [])


def listed(window, wanted):
    return window.until(lambda m: isinstance(m, wire.FlightsMessage) and wanted(m.flights)).flights


def recorded(window, number):
    window.send(wire.StartRecording())
    listed(window, lambda flights: flights and flights[-1].state == "recording")
    for _ in range(5):
        window.send(wire.Steer(0.5, 0.01, 0.0, 0.0))
    window.send(wire.StopRecording())
    return listed(window, lambda flights: len(flights) == number and flights[-1].state == "complete")


def test_flights_are_listed_changed_downloaded_and_deleted(live, tmp_path):
    with live.window() as window, live.http(cookie=live.cookie, origin=live.origin) as http:
        with live.http() as client:
            assert client.get("/api/flights/flight-1.jsonl").status_code == 401
        assert http.get("/api/flights/flight-1.jsonl").status_code == 409
        open_case(window)
        began_s = time.time()
        recorded(window, 1)
        first, second = recorded(window, 2)
        assert (first.number, first.name, second.number, second.name) == (1, "Flight 1", 2, "Flight 2")
        assert began_s - 1.0 <= first.begun_s <= second.begun_s <= time.time() + 1.0
        window.send(wire.RenameFlight(2, "to the nodule"), wire.DescribeFlight(2, "twice"), wire.MoveFlight(2, -1))
        found = listed(window, lambda flights: flights[0].number == 2)
        assert [(one.name, one.words) for one in found] == [("to the nodule", "twice"), ("Flight 1", "")]

        answer = http.get("/api/flights/flight-2.jsonl")
        assert answer.status_code == 200
        assert answer.headers["content-disposition"] == 'attachment; filename="flight-2.jsonl"'
        assert answer.headers["cache-control"] == "no-store"
        assert "nodule" not in answer.text
        (tmp_path / "flight.jsonl").write_text(answer.text)
        assert open_recording(tmp_path / "flight.jsonl").complete
        assert json.loads(answer.text.splitlines()[0])["format"] == "carina-recording"

        missing = http.get("/api/flights/flight-3.jsonl")
        assert (missing.status_code, missing.json()["code"]) == (404, "session.flights")
        assert http.get("/api/flights/flight-0.jsonl").status_code in {404, 409}
        window.send(wire.RemoveFlight(2))
        assert [one.number for one in listed(window, lambda flights: len(flights) == 1)] == [1]
        assert http.get("/api/flights/flight-2.jsonl").status_code == 404
        window.send(wire.RemoveFlight(2))
        assert "has been removed" in window.until(lambda m: isinstance(m, wire.Error)).message
        # Another window receives the flights immediately.
        with live.window() as other:
            assert [one.number for one in listed(other, lambda flights: flights)] == [1]
        window.send(wire.CloseCase())
        listed(window, lambda flights: not flights)
