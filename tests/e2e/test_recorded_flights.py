"""Test of recorded flights: recorded, named, restored when the case is opened again, downloaded and deleted."""

from __future__ import annotations

import pytest

from carina.navigate import open_recording

pytestmark = pytest.mark.browser


@pytest.fixture
def home(tmp_path):
    return str(tmp_path / "home")


def record(workstation, num, *, leaves=0):
    """Record a flight in which the tip flies forward."""
    page = workstation.page
    page.get_by_test_id("record").click()
    workstation.wait_for(f"window.__carina.state.flights.length === {num}")
    workstation.wait_for("window.__carina.state.devices?.recording !== null")
    if leaves:
        workstation.picture("flights-recording")
    workstation.hold("w", 600)
    page.get_by_test_id("record").click()
    workstation.wait_for("window.__carina.state.flights.at(-1).state === 'complete'")
    # The flights arrive before the devices, whose state decides whether the button begins or ends a recording.
    workstation.wait_for("window.__carina.state.devices?.recording === null")


def names(workstation):
    return [flight["name"] for flight in workstation.state("flights")]


def test_flights_are_recorded_named_restored_downloaded_and_deleted(host, workstation, home, tmp_path):
    first = host.open(demo="phantom", home=home)
    workstation.open(first)
    workstation.wait_ready()
    page = workstation.page
    page.keyboard.press(";")
    page.get_by_test_id("device-panel").wait_for()
    workstation.go_to(20.0)
    record(workstation, 1, leaves=1)
    record(workstation, 2)
    rows = page.get_by_test_id("flight")
    rows.nth(1).get_by_test_id("flight-more").click()
    page.get_by_test_id("flight-name").fill("To the nodule")
    page.get_by_test_id("flight-name").press("Enter")
    workstation.wait_for("window.__carina.state.flights[1].name === 'To the nodule'")
    page.get_by_test_id("flight-words").fill("Second attempt, without contact")
    page.get_by_test_id("flight-words").press("Enter")
    workstation.wait_for("window.__carina.state.flights[1].words.startsWith('Second attempt')")
    page.get_by_test_id("flight-up").click()
    workstation.wait_for("window.__carina.state.flights[0].number === 2")
    page.get_by_test_id("flight-words").scroll_into_view_if_needed()
    workstation.wait_still()
    workstation.picture("flights")
    assert names(workstation) == ["To the nodule", "Flight 1"]

    with page.expect_download() as waiting:
        page.get_by_test_id("flight-download").click()
    assert waiting.value.suggested_filename == "flight-2.jsonl"
    waiting.value.save_as(tmp_path / "flight.jsonl")
    taken = open_recording(tmp_path / "flight.jsonl")
    assert taken.complete
    assert taken.length_s == pytest.approx(workstation.state("flights")[0]["length_s"], abs=1e-5)
    before = workstation.state("flights")

    # The replay takes the recorded time, and any movement by the user interrupts it at once.
    length_s = before[1]["length_s"]
    rows.nth(1).get_by_test_id("flight-play").click()
    workstation.wait_for("window.__carina.state.pose.flight?.number === 1 && window.__carina.state.replaying.atS > 0.3")
    workstation.picture("flights-flown-again")
    workstation.wait_for(f"Math.abs(window.__carina.state.pose.flight.time_s - {length_s}) < 1e-6")
    workstation.wait_for("!window.__carina.state.replaying.on")
    rows.nth(1).get_by_test_id("flight-play").click()
    workstation.wait_for("window.__carina.state.pose.flight.time_s > 0 && window.__carina.state.replaying.on")
    workstation.hold("s", 100)
    workstation.wait_for("!window.__carina.state.replaying.on && window.__carina.state.pose.flight === null")
    host.close(first)

    again = host.open(demo="phantom", home=home)
    try:
        page.goto("about:blank")
        workstation.open(again)
        workstation.wait_ready()
        page.get_by_role("button", name="Rehearse", exact=False).first.click()
        workstation.choose_branch(workstation.deepest_tip(1.0)["id"])
        rows.first.wait_for()
        found = workstation.state("flights")
        assert [(f["number"], f["name"], f["words"]) for f in found] == [
            (f["number"], f["name"], f["words"]) for f in before
        ]
        # Permanent deletion of a flight needs a confirmation.
        rows.nth(1).get_by_test_id("flight-more").click()
        page.get_by_test_id("flight-remove").click()
        page.get_by_text("This cannot be undone").wait_for()
        workstation.picture("flights-asked")
        page.get_by_test_id("flight-delete").click()
        workstation.wait_for("window.__carina.state.flights.length === 1")
        assert names(workstation) == ["To the nodule"]
    finally:
        host.close(again)
        workstation.faults.clear()
