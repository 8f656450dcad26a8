"""Tests of key frames in the browser: added, flown, interrupted, undone, saved to a file and opened again."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from carina.navigate import open_key_frames

pytestmark = pytest.mark.browser


def wait(page, condition: str) -> None:
    page.wait_for_function(f"() => {condition}")


def wait_keys(page, num: int) -> None:
    wait(page, f"window.__carina.state.keyFrames?.frames.length === {num}")


def test_key_frame_flight_stops_on_user_movement_and_is_restored_from_a_downloaded_file(server, workstation, tmp_path):
    workstation.open(server)
    workstation.wait_ready()
    page = workstation.page
    state = workstation.state
    right, left = workstation.deepest_tip(-1.0), workstation.deepest_tip(1.0)

    # One key frame is added in the trachea by a key, and one at the end of a branch on each side by the button.
    workstation.go_to(30.0)
    page.keyboard.press(".")
    wait_keys(page, 1)
    page.get_by_test_id("key-panel").wait_for()
    for n, tip in enumerate((right, left), 2):
        workstation.choose_branch(tip["id"])
        workstation.go_to(state("route.length_mm") - 3.0)
        page.get_by_test_id("add-key").click()
        wait_keys(page, n)
    assert [key["through_airways"] for key in state("keyFrames.frames")] == [False, True, True]
    assert state("keyFrames.frames")[0]["name"] == "Trachea"
    lasts = state("keyFrames.duration_s")
    assert page.get_by_test_id("keys-clock").inner_text().endswith(f"of 0:{lasts:04.1f}")
    workstation.wait_still()
    workstation.picture("key-frames")

    # The flight starts at the first key frame, passes every one, and has the chosen speed.
    page.get_by_test_id("stop-keys").click()
    wait(page, "window.__carina.state.pose.key_frames_s === 0")
    before = {view: workstation.pixels(view) for view in ("airway", "axial", "coronal", "sagittal", "cut-plane")}
    page.get_by_test_id("play-keys").click()
    wait(page, "window.__carina.state.pose.key_frames_s > 1.0 && window.__carina.state.speedMmS > 1")
    page.get_by_test_id("speed").wait_for()
    assert state("pose.inside")
    workstation.picture("key-frames-flying")

    # A movement by the user interrupts the flight at once, and the flight does not move the tip back.
    workstation.hold("s", 300)
    wait(page, "!window.__carina.state.playing.on && window.__carina.state.pose.key_frames_s === null")
    workstation.wait_still()
    newest = state("pose.pose_id")
    workstation.let_pass(500)
    assert state("pose.pose_id") == newest
    for view, pixels in before.items():
        assert workstation.frame_answers(view, newest)
        assert workstation.pixels(view) != pixels, f"{view} did not change"

    # The slider moves to the end; then a change of the list is undone and redone.
    page.get_by_role("slider", name="Time in the flight (seconds)").press("End")
    wait(page, f"Math.abs(window.__carina.state.pose.key_frames_s - {lasts}) < 1e-6")
    third = state("keyFrames.frames")[2]["key_id"]
    rows = page.get_by_test_id("key")
    rows.nth(2).get_by_test_id("key-more").click()
    page.get_by_test_id("key-up").click()
    wait(page, f"window.__carina.state.keyFrames.frames[1].key_id === '{third}'")
    page.get_by_test_id("key-name").click()
    page.get_by_test_id("key-rename").fill("the tumour")
    page.get_by_test_id("key-rename").press("Enter")
    wait(page, "window.__carina.state.keyFrames.frames[1].name === 'the tumour'")
    workstation.picture("key-frames-changed")
    page.set_viewport_size({"width": 1280, "height": 720})
    workstation.wait_still()
    workstation.picture("key-frames-small")
    page.set_viewport_size({"width": 1440, "height": 900})
    for _ in range(2):
        page.keyboard.press("Control+z")
    wait(page, f"window.__carina.state.keyFrames.frames[2].key_id === '{third}'")
    assert state("keyFrames.duration_s") == lasts

    # The downloaded file is the same flight; opening it replaces the list in one undo step.
    with page.expect_download() as waiting:
        page.get_by_test_id("save-keys").click()
    assert waiting.value.suggested_filename == "key-frames.json"
    saved = tmp_path / "key-frames.json"
    waiting.value.save_as(saved)
    assert open_key_frames(saved).flight().duration_s == lasts
    assert page.get_by_test_id("keys-video").is_enabled()
    rows.nth(0).get_by_test_id("key-more").click()
    page.get_by_test_id("key-remove").click()
    wait_keys(page, 2)
    with page.expect_file_chooser() as choosing:
        page.get_by_test_id("open-keys").click()
    choosing.value.set_files(str(saved))
    wait_keys(page, 3)
    assert state("keyFrames.duration_s") == lasts
    assert state("can_undo") == "open key frames"

    # A reload shows the same key frames; a file of another case is refused with a message and changes nothing.
    page.reload()
    workstation.wait_ready()
    wait_keys(page, 3)
    page.keyboard.press(",")
    page.get_by_test_id("key-panel").wait_for()
    other = json.loads(saved.read_text())
    other["case"]["digest"] = "0" * 32
    foreign = Path(tmp_path / "other.json")
    foreign.write_text(json.dumps(other))
    with page.expect_file_chooser() as choosing:
        page.get_by_test_id("open-keys").click()
    choosing.value.set_files(str(foreign))
    page.get_by_text("belong to another scan").wait_for()
    assert len(state("keyFrames.frames")) == 3
    assert workstation.faults == []


def test_automatic_flight_along_key_frames_has_the_selected_speed(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    page = workstation.page
    workstation.go_to(1.0)
    wait(page, "window.__carina.state.pose.mode === 'path' && window.__carina.state.pose.path_mm < 2")
    page.get_by_test_id("auto-speed").click()
    page.get_by_role("option", name="5 mm/s").first.click()
    # The list is closed and receives no keys, so the space bar flies and does not open the list.
    wait(page, "document.activeElement === document.body")
    page.keyboard.press("Space")
    # The speed display uses the poses, because pictures may be late on a busy machine.
    wait(page, "Math.abs(window.__carina.state.speedMmS - 5) < 1.5")
    page.get_by_test_id("speed").wait_for()
    page.keyboard.press("Space")
    wait(page, "window.__carina.state.speedMmS === null")
    page.get_by_test_id("speed").wait_for(state="detached")
    assert workstation.faults == []
