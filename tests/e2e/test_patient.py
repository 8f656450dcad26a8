"""Tests of a DICOM folder in the browser: first picture, then a flight to a segmental bronchus in each lung."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from server_process import Server, start_server, stop_server

pytestmark = [pytest.mark.browser, pytest.mark.data, pytest.mark.slow]

# Segmental bronchi are the third generation or beyond (trachea 0, main 1, lobar 2; the segmental bronchi of the right
# upper lobe have generation 3).
SEGMENTAL = 3


@pytest.fixture(scope="module")
def server(patient_dicom, tmp_path_factory) -> Iterator[Server]:
    """Run ``carina open FOLDER`` on the DICOM folder of the patient, and stop it at the end."""
    running = start_server(["open", str(patient_dicom)], tmp_path_factory.mktemp("home"))
    yield running
    code = stop_server(running)
    assert code == 0, "Ctrl-C is how a workstation is closed"
    assert running.errors() == []


def test_flight_reaches_a_segmental_bronchus_in_each_lung_of_the_patient(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    for side, sign in (("right", -1.0), ("left", 1.0)):
        tip = workstation.deepest_tip(sign)
        assert tip["generation"] >= SEGMENTAL
        assert sign * tip["end_lps"][0] > 20.0, f"the {side} lung lies at {'-' if sign < 0 else '+'}x in LPS"
        workstation.choose_branch(tip["id"])
        # The flight stops 8 mm before the end, because the last millimetres of a tip are a closed wall.
        workstation.go_to(workstation.state("route.length_mm") - 8.0)
        workstation.wait_still()
        workstation.picture(f"patient-{side}")
        assert workstation.state("pose.generation") >= SEGMENTAL
        assert workstation.state("pose.inside")
        position = workstation.state("pose.lps_from_camera")[3::4][:3]
        assert sign * position[0] > 15.0
        assert workstation.brightness("airway") > 20, "the lens is in a lit lumen, not in the dark"
    assert workstation.faults == []


def test_flight_through_the_patient_shows_poses_in_order_and_reports_the_frame_rate(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    workstation.choose_branch(workstation.deepest_tip(-1.0)["id"])
    workstation.go_to(5.0)
    workstation.wait_still()
    workstation.page.get_by_test_id("machine").click()
    workstation.watch_pose_ids("airway")
    held_s = workstation.hold("w", 4000)
    shown = workstation.watched_pose_ids()
    assert shown == sorted(shown)
    seen_hz = len(shown) / held_s
    workstation.page.keyboard.down("w")
    status_words = "document.querySelector('[data-testid=machine-details]').innerText"
    status, frame = workstation.once(
        f"!window.__carina.state.frames.airway.full && /\\d\\/s\\s+of|viewfinder/.test({status_words})",
        f"[{status_words}, window.__carina.state.frames.airway]",
    )
    workstation.picture("patient-flying")
    workstation.page.keyboard.up("w")
    print(f"{seen_hz:.1f} pictures a second, {frame['width']} pixels wide; status: {status!r}")
    if frame["stands_for"] is None:
        rate = int(re.search(r"Frames\s+(\d+)/s", status)[1])
        # The reported rate agrees with the rate of shown pictures; it is that of the last second, in which the load may
        # change.
        assert 0.3 < rate / seen_hz < 3.0
        assert re.search(r"Latency\s+(\d+ ms|\u2013)", status)
    else:
        assert "viewfinder" in status, "the details report the load"
    workstation.wait_still()
    assert workstation.faults == []
