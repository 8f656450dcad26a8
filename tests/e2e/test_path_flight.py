"""Tests of the complete product: a real server, a real browser, and a flight along a path in the phantom."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from server_process import Server, start_server, stop_server
from workstation import assert_accessible

pytestmark = pytest.mark.browser

MOVING_VIEWS = ("airway", "cut-plane", "axial", "coronal", "sagittal")


@pytest.fixture(scope="module")
def server(tmp_path_factory) -> Iterator[Server]:
    """Run ``carina demo phantom``, as a user starts it."""
    running = start_server(["demo", "phantom"], tmp_path_factory.mktemp("home"))
    yield running
    code = stop_server(running)
    assert code == 0, "Ctrl-C is how a workstation is closed"
    assert running.errors() == []


def test_flight_along_a_path_updates_every_view_to_the_newest_pose(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    workstation.picture("flight-start")
    assert workstation.state("pose.mode") == "path"

    before_pixels = {view: workstation.pixels(view) for view in MOVING_VIEWS}
    before_pose = workstation.state("pose.pose_id")
    before_mm = workstation.state("pose.path_mm")

    # While W is held, the tip advances along the path.
    workstation.hold_until("w", "(mm) => window.__carina.state.pose.path_mm > mm", before_mm + 20.0)
    workstation.wait_still()
    workstation.picture("flight-on-the-way")
    newest = workstation.state("pose.pose_id")
    assert newest > before_pose
    for view in MOVING_VIEWS:
        assert workstation.frame_answers(view, newest), f"{view} shows an older pose than {newest}"
        assert workstation.pixels(view) != before_pixels[view], f"{view} did not change"
    assert workstation.faults == []


def test_pictures_of_a_flight_never_show_an_older_pose_than_before(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    workstation.watch_pose_ids("airway")
    workstation.hold("w", 800)
    workstation.hold("s", 800)
    # The flight continues until several pictures were shown.
    workstation.fly_until("window.__poses.length >= 10", 120.0)
    workstation.wait_still()
    shown = workstation.watched_pose_ids()
    assert shown == sorted(shown)
    assert workstation.faults == []


def test_mode_key_leaves_the_path_and_returns_to_it_with_an_equal_pose(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    before = workstation.state("pose.lps_from_camera")
    workstation.page.keyboard.press("m")
    workstation.page.wait_for_function("() => window.__carina.state.pose.mode === 'free'")
    after = workstation.state("pose.lps_from_camera")
    # The tolerance is 1e-9: the pose is stored, not computed again, and JSON transfers doubles exactly.
    assert max(abs(a - b) for a, b in zip(before, after, strict=True)) < 1e-9
    workstation.page.keyboard.press("m")
    workstation.page.wait_for_function("() => window.__carina.state.pose.mode === 'path'")
    assert workstation.faults == []


def test_tip_marker_moves_in_x_ray_and_external_views(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    shown = workstation.shown_views()
    assert {"airway", "axial", "coronal", "sagittal", "cut-plane"} <= set(shown)
    assert any(view.startswith("xray-") for view in shown)
    assert {"tree", "tri-plane"} & set(shown)
    xray = next(view for view in shown if view.startswith("xray-"))
    before = workstation.overlay(xray)
    workstation.hold("w", 1500)
    workstation.wait_still()
    assert workstation.overlay(xray) != before, "the tip's mark moves over the X-ray"
    assert workstation.faults == []


def test_question_mark_opens_the_keyboard_card_and_escape_closes_it(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    workstation.page.keyboard.press("?")
    workstation.page.wait_for_selector("[role=dialog]")
    workstation.picture("keyboard-card")
    assert_accessible(workstation.page, "keyboard-card")
    workstation.page.keyboard.press("Escape")
    workstation.page.wait_for_selector("[role=dialog]", state="detached")
    assert workstation.faults == []


def test_space_key_flies_to_the_stop_before_the_carina_where_both_branches_are_labelled(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    workstation.go_to(0.0)
    lookout_mm, fork_mm = workstation.state("route.lookouts_mm[0]"), workstation.state("route.forks_mm[0]")
    workstation.page.keyboard.press("Space")
    workstation.page.wait_for_function(
        "(mm) => Math.abs(window.__carina.state.pose.path_mm - mm) < 0.1", arg=lookout_mm
    )
    workstation.wait_still()
    workstation.picture("look-out-at-the-carina")
    assert fork_mm - lookout_mm > 8.0, "a trachea's width in front of the carina, not at it"
    ways = workstation.page.locator(".reading .way").all_inner_texts()
    # For an operator at the head end, the patient's left is on the left of the picture.
    assert ways == ["LMB, 9 o\u2019clock", "RMB, 3 o\u2019clock"]
    assert workstation.faults == []


def test_value_and_position_of_the_voxel_under_the_cursor_are_shown(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    workstation.page.locator("canvas[data-view=axial]").hover()
    text = workstation.page.locator("[data-testid=cursor]")
    workstation.page.wait_for_function(
        "() => / HU$/.test(document.querySelector('[data-testid=cursor]')?.textContent ?? '')"
    )
    assert text.inner_text()[0] in "LR"
    assert workstation.faults == []


def test_rehearsal_states_how_far_the_scope_fits_along_the_route(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    page = workstation.page
    page.get_by_role("button", name="Rehearse", exact=True).click()
    fits = page.get_by_test_id("fits")
    workstation.wait_for("window.__carina.state.route?.narrowest_mm !== null")
    page.wait_for_function("!document.querySelector('[data-testid=fits]').innerText.startsWith('not known')")
    name, stated = workstation.state("session.look.scope"), workstation.state("route.scope_fits")
    fit = next(one["fit"] for one in stated if one["scope"] == name)
    assert fits.inner_text().startswith("the end, ") == (fit == "fits")
    assert page.get_by_test_id("rehearse").is_enabled()
    workstation.picture("rehearse")
    assert workstation.faults == []


def test_long_error_message_can_be_scrolled_to_its_end(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    page = workstation.page
    path = "/no/such/folder/" + "/".join(f"of-a-patient-who-was-scanned-often-{n}" for n in range(8))
    page.get_by_role("button", name="Open", exact=True).click()
    for typed in (path, "/no/such/file.nii.gz"):
        field = page.get_by_placeholder("/", exact=False).first
        field.fill(typed)
        field.press("Enter")
        page.locator(".message.error", has_text=typed[-12:]).wait_for()
    workstation.picture("long-refusal")
    texts = page.locator(".message p")
    shown = texts.evaluate_all("(texts) => texts.every((p) => p.scrollHeight <= p.clientHeight + 1)")
    assert shown, "no sentence is cut"
    assert any(path in text for text in texts.all_inner_texts())
    page.get_by_role("button", name="I have read this").first.wait_for()
    assert workstation.faults == []


def test_airways_are_downloaded_as_a_file(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    workstation.wait_for("() => window.__carina.state.tree !== null")
    page = workstation.page
    page.get_by_role("button", name="Share", exact=True).click()
    with page.expect_download() as waiting:
        page.get_by_test_id("take.json").click()
    assert waiting.value.suggested_filename == "airways.json"
    tree = json.loads(Path(waiting.value.path()).read_text())
    assert len(tree["branches"]) == page.evaluate("() => window.__carina.state.tree.byId.size")
    assert workstation.faults == []
