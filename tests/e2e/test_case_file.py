"""Tests of restored work in the browser: after closing, after a crash, and from a named case file."""

from __future__ import annotations

import json
import re
import sys
import time

import pytest
from server_process import start_server, stop_server
from workstation import PICTURE_MS, assert_accessible

from cached_test_data import cached_phantom
from carina.case import CaseFile
from carina.volume import write_grid
from faulty_disk import FAULTS, FaultyDisk, has_compiler

pytestmark = pytest.mark.browser

SHOWN = """() => {
  const { session, pose, route, history } = window.__carina.state;
  const { can_undo, can_redo, look, sight, targets, mode } = session;
  const steps = history.steps.map(({ label }) => label);
  return { can_undo, can_redo, look, sight, targets, mode, steps,
    step: history.step, route: route.route_id, place: pose.lps_from_camera };
}"""


def shown(workstation):
    return workstation.page.evaluate(SHOWN)


def work(workstation):
    """Choose another branch as the route, change the outline, undo that change, and move along the route."""
    workstation.page.get_by_test_id("list-airways").click()
    rows = workstation.page.get_by_role("row")
    rows.nth(3).click()
    workstation.wait_for("window.__carina.state.session.can_undo.startsWith('route to')")
    workstation.page.keyboard.press("o")
    workstation.wait_for("window.__carina.state.session.can_undo === 'image outline'")
    workstation.page.keyboard.press("Control+z")
    workstation.wait_for("window.__carina.state.session.can_redo === 'image outline'")
    workstation.page.keyboard.press("PageDown")
    workstation.wait_still()


def wait_saved(workstation, home):
    """Change the slab thickness, and wait until this change (and so every earlier one) is saved."""

    def written_s():
        return max((json.loads(path.read_text())["used_s"] or 0.0 for path in home.rglob("record.json")), default=0.0)

    since_s = time.time()
    workstation.page.keyboard.press("i")
    workstation.wait_still()
    while written_s() <= since_s:
        assert time.time() < since_s + PICTURE_MS / 1e3, "the change is not on the disk"
        workstation.page.wait_for_timeout(50)
    # A write that began before the key press may end after it; the write that contains the change follows within 1.5 s.
    last_s = 0.0
    while written_s() > last_s:
        last_s = written_s()
        workstation.page.wait_for_timeout(3000)


@pytest.fixture
def home(tmp_path):
    return str(tmp_path / "home")


@pytest.fixture
def opens(home):
    return {"demo": "phantom", "home": home}


def test_closed_case_is_restored_when_it_is_opened_again(host, workstation, home):
    first = host.open(demo="phantom", home=home)
    workstation.open(first)
    workstation.wait_ready()
    work(workstation)
    before = shown(workstation)
    assert re.fullmatch(r"saved \d\d:\d\d", workstation.page.get_by_test_id("saved").inner_text())
    host.close(first)
    again = host.open(demo="phantom", home=home)
    try:
        workstation.page.goto("about:blank")
        workstation.open(again)
        workstation.wait_ready()
        assert shown(workstation) == before
        workstation.page.keyboard.press("Shift+h")
        workstation.page.get_by_test_id("history").get_by_role("button", name="Image outline").click()
        workstation.wait_for("window.__carina.state.session.can_undo === 'image outline'")
        workstation.page.get_by_test_id("history").get_by_role("button", name="Case opened").click()
        workstation.wait_for("window.__carina.state.session.can_undo === null")
    finally:
        host.close(again)
        workstation.faults.clear()


def test_case_is_saved_under_a_name_that_the_top_bar_shows(server, workstation, tmp_path):
    workstation.open(server)
    workstation.wait_ready()
    work(workstation)
    steps = shown(workstation)["steps"]
    workstation.page.keyboard.press("Control+s")
    workstation.page.get_by_test_id("save-path").fill(str(tmp_path / "copies" / "mine"))
    workstation.page.get_by_test_id("save-now").click()
    # For a folder that does not exist a message is shown, and the user chooses another folder.
    workstation.page.get_by_text("copies").first.wait_for()
    workstation.page.get_by_test_id("saved").click()
    workstation.page.get_by_test_id("save-path").fill(str(tmp_path / "mine"))
    workstation.page.get_by_test_id("save-now").click()
    # The top bar shows the path at once, and the saved copy when it is written.
    workstation.page.get_by_test_id("saved").filter(has_text="copy from").wait_for()
    assert workstation.state("session.saving.copy_name") == "mine.carina"
    with CaseFile.open(tmp_path / "mine.carina", read_only=True) as case:
        assert [step.label for step in case.history()] == steps


def test_named_file_changed_by_another_program_is_written_only_after_a_choice(server, workstation, tmp_path):
    workstation.open(server)
    workstation.wait_ready()
    work(workstation)
    page, path = workstation.page, tmp_path / "team.carina"

    page.get_by_test_id("saved").click()
    page.get_by_test_id("save-path").fill(str(path))
    page.get_by_test_id("save-now").click()
    page.get_by_test_id("saved").filter(has_text="copy from").wait_for()
    path.write_text("a letter")
    page.keyboard.press("Control+s")
    page.get_by_test_id("saved").filter(has_text="not in team.carina").wait_for()
    assert path.read_text() == "a letter"
    page.keyboard.press("Control+s")
    conflict = page.get_by_test_id("save-conflict")
    conflict.wait_for()
    assert "not a Carina case" in conflict.inner_text()
    assert page.get_by_test_id("open-theirs").count() == 0, "it is not a case"
    workstation.picture("save-conflict")
    assert_accessible(workstation.page, "save-conflict")
    page.get_by_test_id("save-beside").click()
    page.get_by_test_id("saved").filter(has_text="copy from").wait_for()
    assert workstation.state("session.saving.copy_name") == "team (2).carina"
    # Another program edits a copy of the file, which replaces the file.
    with CaseFile.open(path.with_name("team (2).carina"), read_only=True) as case:
        case.write_copy(path.with_name("theirs.carina"))
    path.with_name("theirs.carina").replace(path.with_name("team (2).carina"))
    page.keyboard.press("Control+s")
    page.get_by_test_id("saved").filter(has_text="not in team (2).carina").wait_for()
    page.keyboard.press("Control+s")
    page.get_by_test_id("open-theirs").wait_for()
    workstation.picture("save-conflict-case")
    page.get_by_test_id("save-replace").click()
    page.get_by_test_id("saved").filter(has_text="copy from").wait_for()
    assert len(list(tmp_path.glob("team (2) (replaced *).carina"))) == 1
    assert path.read_text() == "a letter"


@pytest.mark.slow
def test_case_of_a_killed_workstation_is_restored_to_two_seconds_before(workstation, tmp_path):
    first = start_server(["demo", "phantom"], tmp_path)
    workstation.open(first)
    workstation.wait_ready()
    work(workstation)
    wait_saved(workstation, tmp_path)
    before = shown(workstation)
    first.child.process.kill()
    first.child.wait()
    again = start_server(["demo", "phantom"], tmp_path)
    workstation.page.goto("about:blank")
    workstation.open(again)
    workstation.wait_ready()
    assert shown(workstation) == before
    assert stop_server(again) == 0
    workstation.faults.clear()


def test_case_is_continued_from_the_list_restarted_deleted_and_restored_from_deletion(server, workstation):
    page = workstation.page
    workstation.open(server)
    workstation.wait_ready()
    work(workstation)
    steps = shown(workstation)["steps"]

    def close():
        page.get_by_role("button", name="Open", exact=True).click()
        page.get_by_role("button", name="Start page").click()
        page.get_by_test_id("start").wait_for()

    def listed(test_id):
        return page.get_by_test_id(test_id).get_by_role("listitem")

    close()
    recent = listed("recent")
    assert "1 change \u00b7 last used" in recent.inner_text()
    workstation.wait_for("[...document.querySelectorAll('.case-picture img')].every((img) => img.naturalWidth === 320)")
    recent.get_by_role("button").click()
    workstation.wait_ready()
    assert shown(workstation)["steps"] == steps
    continued = page.get_by_test_id("continued")
    assert "1 change" in continued.inner_text()
    assert "this work stays in the list" in continued.inner_text()
    assert continued.evaluate("(card) => card.scrollWidth <= card.clientWidth"), "the complete text can be read"
    workstation.picture("continued-or-new")
    page.get_by_test_id("begin-anew").click()
    workstation.wait_for("window.__carina.state.session.saving.continued_s === null")
    page.get_by_test_id("continued").wait_for(state="detached")
    workstation.wait_ready()
    assert shown(workstation)["steps"] == []
    workstation.wait_for("window.__carina.state.session.saving.saved_s !== null")
    close()
    assert listed("recent").count() == 2
    page.get_by_test_id("open-storage").click()
    listed("stored").first.get_by_test_id("rename-case").click()
    page.get_by_test_id("case-name").fill("Second look")
    page.keyboard.press("Enter")
    named = listed("stored").filter(has_text="Second look")
    named.wait_for()
    listed("stored").filter(has_text="1 change").get_by_test_id("forget-case").click()
    listed("forgotten").wait_for()
    assert listed("stored").count() == 1
    page.get_by_test_id("restore-case").click()
    page.get_by_test_id("forgotten").wait_for(state="detached")
    # The pressed button has disappeared, so for a moment no element has the focus.
    page.evaluate(
        """() => {
            document.activeElement.blur();
            document.body.dispatchEvent(new KeyboardEvent('keydown', {key: 'Escape', bubbles: true}));
        }"""
    )
    page.get_by_test_id("storage").wait_for(state="detached")
    listed("recent").filter(has_text="1 change").get_by_role("button").click()
    workstation.wait_ready()
    assert shown(workstation)["steps"] == steps


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux" or not has_compiler(), reason="needs Linux and a C compiler")
def test_full_disk_is_reported_while_the_flight_continues_and_the_case_is_saved_to_another_disk(
    workstation, tmp_path, monkeypatch
):
    page, stick = workstation.page, tmp_path / "stick"
    stick.mkdir()
    disk = FaultyDisk(tmp_path)
    with monkeypatch.context() as preloaded:
        for name, value in disk.environment.items():
            preloaded.setenv(name, value)
        server = start_server(["demo", "phantom"], tmp_path)
    workstation.open(server)
    workstation.wait_ready()
    work(workstation)
    wait_saved(workstation, tmp_path)
    disk.begin(FAULTS["full"], 1, tmp_path / "data")
    page.keyboard.press("o")
    workstation.wait_for("window.__carina.state.session.saving.problem !== null")
    saved = page.get_by_test_id("saved")
    assert saved.inner_text().startswith("cannot save: last saved")
    place = workstation.state("pose.pose_id")
    workstation.hold_until("w", "(before) => window.__carina.state.pose.pose_id > before", place)
    workstation.wait_still()
    saved.click()
    dialog = page.get_by_test_id("save-dialog")
    assert "the disk is full" in dialog.inner_text()
    assert dialog.evaluate("(dialog) => dialog.scrollWidth <= dialog.clientWidth"), "the complete text can be read"
    workstation.picture("disk-full-dialog")
    page.get_by_test_id("save-path").fill(str(stick / "mine"))
    page.get_by_test_id("save-now").click()
    workstation.wait_for("window.__carina.state.session.saving.copy_name === 'mine.carina'")
    assert saved.inner_text().endswith("in stick")
    workstation.picture("disk-full-saved-elsewhere")
    with CaseFile.open(stick / "mine.carina", read_only=True) as case:
        assert [step.label for step in case.history()] == shown(workstation)["steps"]
    disk.heal()
    workstation.wait_for("window.__carina.state.session.saving.problem === null")
    assert re.match(r"saved \d\d:\d\d", saved.inner_text())
    workstation.picture("disk-well-again")
    assert stop_server(server) == 0
    workstation.faults.clear()


def test_case_whose_ct_was_moved_requests_the_ct_and_refuses_a_different_ct(host, workstation, home, tmp_path):
    page = workstation.page
    chest, other = (cached_phantom(spacing_mm=3.0, generations=n).volume for n in (3, 4))
    ct, moved = tmp_path / "ct.nii.gz", tmp_path / "moved.nii.gz"
    write_grid(ct, chest.hu_zyx, chest.lps_from_ijk, what="the phantom")
    server = host.open(path=str(ct), home=home)
    try:
        workstation.open(server)
        workstation.wait_ready()
        work(workstation)
        steps = shown(workstation)["steps"]
        page.get_by_role("button", name="Open", exact=True).click()
        page.get_by_role("button", name="Start page").click()
        page.get_by_test_id("start").wait_for()
        ct.rename(moved)
        recent = page.get_by_test_id("recent").get_by_role("listitem").filter(has_text="1 change")
        recent.get_by_role("button").first.click()
        workstation.wait_for("window.__carina.state.messages.some(({ code }) => code === 'case.no-ct')")
        workstation.picture("ct-gone")
        # Another CT has replaced the original one.
        write_grid(ct, other.hu_zyx, other.lps_from_ijk, what="another phantom")
        recent.get_by_role("button").first.click()
        workstation.wait_for("window.__carina.state.messages.some(({ code }) => code === 'case.other-ct')")
        workstation.picture("ct-is-another")
        page.locator(".path-form input").fill(str(moved))
        page.keyboard.press("Enter")
        workstation.wait_ready()
        assert shown(workstation)["steps"] == steps
        workstation.picture("ct-found-again")
    finally:
        host.close(server)
        workstation.faults.clear()


def test_dropped_case_file_requests_its_ct_and_opens_when_the_ct_is_dropped_without_its_path(
    host, workstation, home, tmp_path
):
    page = workstation.page
    chest = cached_phantom(spacing_mm=3.0, generations=3).volume
    ct, given = tmp_path / "ct.nii.gz", tmp_path / "given.carina"
    write_grid(ct, chest.hu_zyx, chest.lps_from_ijk, what="the phantom")
    theirs = host.open(path=str(ct), home=str(tmp_path / "their home"))
    workstation.open(theirs)
    workstation.wait_ready()
    work(workstation)
    steps = shown(workstation)["steps"]
    page.keyboard.press("Control+s")
    page.get_by_test_id("save-path").fill(str(given))
    page.get_by_test_id("save-now").click()
    workstation.wait_for("window.__carina.state.session.saving.copy_name === 'given.carina'")
    host.close(theirs)
    mine = host.open(home=home)
    try:
        page.goto("about:blank")
        workstation.open(mine)
        page.get_by_test_id("start").wait_for()
        files = page.locator(".drop input[type=file]:not([webkitdirectory])")
        files.set_input_files(str(given))
        workstation.wait_for("window.__carina.state.messages.some(({ code }) => code === 'case.no-ct')")
        waiting = page.get_by_test_id("recent").get_by_role("listitem")
        waiting.filter(has_text="Open its CT to continue.").wait_for()
        assert "1 change" in waiting.inner_text()
        workstation.picture("dropped-case-waits")
        files.set_input_files(str(ct))
        workstation.wait_ready()
        assert shown(workstation)["steps"] == steps
        assert workstation.state("session.saving.copy_name") is None
        page.keyboard.press("Control+s")
        page.get_by_test_id("save-dialog").wait_for()
        workstation.picture("dropped-case-open")
    finally:
        host.close(mine)
        workstation.faults.clear()
