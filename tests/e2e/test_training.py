"""Browser journey of a task: start it, fly with the names hidden, end it, read and print the score."""

from __future__ import annotations

import io
import re
import zipfile

import pypdf
import pytest
from workstation import assert_accessible

pytestmark = pytest.mark.browser

WALL_MS = 900_000
"""Limit for computing the wall distances of a case, ms."""
FLIGHT_MS = 300_000
"""Limit for a movement of the scope and for its score, ms."""


@pytest.fixture
def home(tmp_path):
    return str(tmp_path / "home")


def test_task_is_started_in_two_clicks_and_its_score_is_shown_and_printed(host, workstation, home):
    running = host.open(demo="phantom", home=home)
    page = workstation.page
    page.set_viewport_size({"width": 1280, "height": 720})
    workstation.open(running)
    workstation.wait_ready()
    page.get_by_role("button", name="Train", exact=True).click()
    # A learner, to whom the score is stored.
    page.get_by_test_id("new-learner").click()
    page.get_by_test_id("learner-name").fill("Blue heron")
    page.get_by_test_id("learner-name").press("Enter")
    workstation.wait_for("window.__carina.state.training.course.chosen === 'Blue heron'")
    workstation.picture("training-tasks")
    # A breathing of this step ends with the step; that of the live flight goes on.
    page.get_by_test_id("breathing-switch").click()
    workstation.wait_for("window.__carina.state.session.breathing.on")
    page.locator("[data-step=airways]").click()
    workstation.wait_for("!window.__carina.state.session.breathing.on")
    page.get_by_test_id("breathing-menu").click()
    page.get_by_test_id("breathing-switch").click()
    workstation.wait_for("window.__carina.state.session.breathing.on")
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Train", exact=True).click()
    page.locator("[data-step=airways]").click()
    page.get_by_role("button", name="Train", exact=True).click()
    workstation.settle()
    assert workstation.state("session.breathing.on")
    page.get_by_test_id("breathing-switch").click()
    workstation.wait_for("!window.__carina.state.session.breathing.on")
    # The layout of a task ends the full view of a slice, which would hide the airway view.
    page.locator("canvas[data-view=axial]").dblclick()
    workstation.wait_for("window.__carina.state.ui.full === 'axial'")
    page.get_by_test_id("start-inspect-all").click()
    page.wait_for_function("() => window.__carina.state.training.running !== null", timeout=WALL_MS)
    page.wait_for_function("() => window.__carina.state.pose.mode === 'scope'", timeout=FLIGHT_MS)
    # A task without names shows neither the names nor the other views.
    page.get_by_test_id("stop-task").wait_for()
    assert page.get_by_test_id("hud").inner_text() == ""
    assert page.locator(".path-bar").count() == 0
    assert not page.locator(".side-views").is_visible()
    assert page.locator("canvas[data-view=airway]").is_visible()
    # No key ends the attempt, flies, or shows what the task hides, and no button names a branch.
    for key in ("Backspace", "m", "Space", ",", ";", "/", "F2", "Control+z"):
        page.keyboard.press(key)
    workstation.settle()
    assert page.get_by_test_id("stop-task").is_visible()
    assert workstation.state("training.running !== null")
    assert workstation.state("pose.mode") == "scope"
    assert page.locator(".undo button").count() == 0
    assert page.locator("[data-step=airways]").is_disabled()
    workstation.hold_until("w", "() => window.__carina.state.pose.scope.insertion_mm > 40")
    page.wait_for_function("() => window.__carina.state.training.running.num_steps === 18", timeout=FLIGHT_MS)
    assert "next: RB1" in page.get_by_test_id("attempt-progress").inner_text()
    workstation.wait_still()
    workstation.picture("training-attempt")
    page.keyboard.press("z")
    page.get_by_test_id("attempt-paused").wait_for()
    inserted_mm = workstation.state("pose.scope.insertion_mm")
    page.keyboard.press("w", delay=300)
    workstation.settle()
    assert workstation.state("pose.scope.insertion_mm") == inserted_mm
    workstation.picture("training-paused")
    page.get_by_test_id("pause-task").click()
    page.get_by_test_id("attempt-paused").wait_for(state="detached")
    page.get_by_test_id("stop-task").click()
    dialog = page.get_by_test_id("score-dialog")
    dialog.wait_for(timeout=FLIGHT_MS)
    text = dialog.inner_text()
    assert "Not completed" in text
    assert "the attempt was paused once" in text
    assert "Diagnostic completeness" in text
    assert "not directly comparable" in text
    workstation.picture("training-score")
    shown = page.locator(".score-dialog > section")
    assert shown.evaluate("(box) => box.scrollHeight <= box.clientHeight"), "complete at 1280 x 720"
    pages = pypdf.PdfReader(io.BytesIO(page.pdf(format="A4"))).pages
    assert len(pages) == 1
    printed = pages[0].extract_text()
    assert "Structured progress" in printed
    assert "Rehearse" not in printed
    with page.expect_download() as waiting:
        page.get_by_test_id("save-log").click()
    with zipfile.ZipFile(waiting.value.path()) as archive:
        assert sorted(archive.namelist()) == ["events.csv", "poses.csv", "scores.csv", "xapi.json"]
    page.keyboard.press("Escape")
    dialog.wait_for(state="detached")
    page.get_by_test_id("scores").get_by_role("button", name="Score", exact=True).click()
    dialog.wait_for()
    page.keyboard.press("Escape")
    dialog.wait_for(state="detached")
    page.get_by_test_id("quiz-name-opening").click()
    page.get_by_test_id("quiz-number").wait_for()
    workstation.wait_still()
    workstation.picture("training-quiz")
    assert_accessible(workstation.page, "training-quiz")
    assert page.locator(".reading").count() == 0
    page.get_by_test_id("quiz-choice").first.click()
    page.get_by_test_id("quiz-answer").get_by_text(re.compile(r"^(Right: |No: this is )")).wait_for()
    page.get_by_test_id("quiz-next").click()
    workstation.wait_for("window.__carina.state.training.quiz.number === 2")
    page.get_by_test_id("quiz-stop").click()
    page.get_by_test_id("tasks").wait_for()
    page.get_by_test_id("quiz-slices").click()
    page.get_by_test_id("quiz-number").wait_for()
    workstation.wait_still()
    assert page.locator("canvas[data-view=axial]").is_visible()
    assert not page.locator("[data-cell=outside]").is_visible()
    workstation.picture("training-slices")
    page.get_by_test_id("quiz-stop").click()
    # The first flight becomes the expert's; a second one is compared with it, and its replay shows the expert's tip.
    page.get_by_role("button", name="Rehearse", exact=True).click()
    page.get_by_test_id("flight-more").click()
    page.get_by_test_id("flight-expert").click()
    workstation.wait_for("window.__carina.state.ui.expertPath !== null")
    page.get_by_role("button", name="Train", exact=True).click()
    page.get_by_test_id("start-hold-rul").click()
    page.wait_for_function("() => window.__carina.state.pose.mode === 'scope'", timeout=FLIGHT_MS)
    page.get_by_test_id("stop-task").wait_for()
    workstation.hold_until("w", "() => window.__carina.state.pose.scope.insertion_mm > 20")
    page.get_by_test_id("stop-task").click()
    dialog.wait_for(timeout=FLIGHT_MS)
    assert "Not seen" not in dialog.inner_text(), "a task other than an inspection does not ask for the other segments"
    page.get_by_test_id("compare-expert").click()
    page.get_by_test_id("comparison").wait_for(timeout=FLIGHT_MS)
    workstation.picture("training-comparison")
    assert_accessible(workstation.page, "training-comparison")
    page.keyboard.press("Escape")
    dialog.wait_for(state="detached")
    page.get_by_role("button", name="Rehearse", exact=True).click()
    page.get_by_test_id("flight").nth(1).get_by_test_id("flight-play").click()
    workstation.wait_for("window.__carina.state.pose.flight?.number === window.__carina.state.flights[1].number")
    workstation.wait_still()
    workstation.picture("training-ghost")
    page.get_by_role("button", name="Train", exact=True).click()
    # The stored attempts, their export, and the deletion of the learner.
    workstation.wait_for("window.__carina.state.training.course.attempts.length === 2")
    page.get_by_test_id("open-course").click()
    page.get_by_test_id("course-attempts").wait_for()
    workstation.picture("training-course")
    with page.expect_download() as waiting:
        page.get_by_test_id("export-learner").click()
    with zipfile.ZipFile(waiting.value.path()) as archive:
        assert sorted(archive.namelist()) == ["attempts.csv", "xapi.json"]
    page.get_by_test_id("delete-learner").click()
    page.get_by_test_id("delete-learner-now").click()
    workstation.wait_for("window.__carina.state.training.course.learners.length === 0")
    assert workstation.faults == []
    host.close(running)
