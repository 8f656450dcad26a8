"""Journeys of the training: a trainee to mastery, a teacher with three learners, touch, a simulated handle, a reload.

The flights of the trainee are flown by a script of the host in compressed time: it places the tip at 60 mm/s of the
session's clock, which it advances. Everything else is done in the window.
"""

from __future__ import annotations

import io
import itertools
import json
import struct
from dataclasses import replace

import pypdf
import pytest
from test_devices import HID_MOCK
from workstation import PICTURE_MS, Workstation, assert_accessible

from carina.training import find_task, task_to_json

pytestmark = pytest.mark.browser

WALL_MS = 900_000
"""Limit for computing the wall distances of a case, ms."""
FLIGHT_MS = 300_000
"""Limit for a movement of the scope and for its score, ms."""
LARGE, SMALL, TABLET = (
    {"width": 1440, "height": 900},
    {"width": 1280, "height": 720},
    {"width": 820, "height": 1180},
)
SIZES = [(size["width"], size["height"]) for size in (LARGE, SMALL, TABLET)]
PUSH = """async (reports) => {
  for (const bytes of reports) {
    window.testHid.handle.report(1, bytes);
    await new Promise((done) => setTimeout(done, 20));
  }
}"""
VOICES = """
window.spoken = [];
class Utterance { constructor(text) { this.text = text; } }
Object.defineProperty(window, 'SpeechSynthesisUtterance', {value: Utterance});
const voices = [{localService: false, lang: 'en-GB', name: 'far'}, {localService: true, lang: 'en-US', name: 'near'}];
Object.defineProperty(window, 'speechSynthesis', {value: {
  getVoices: () => voices, addEventListener: () => {}, removeEventListener: () => {}, cancel: () => {},
  speak: ({text, voice}) => window.spoken.push(`${voice.name}: ${text}`),
}});
"""
"""Script that replaces the voices of the browser by one that sends the text away and one of this computer."""
FITS = "(box) => box.scrollHeight <= box.clientHeight && box.scrollWidth <= box.clientWidth"


@pytest.fixture
def home(tmp_path):
    return tmp_path / "home"


def add_learner(page, name):
    page.get_by_test_id("new-learner").click()
    page.get_by_test_id("learner-name").fill(name)
    page.get_by_test_id("learner-name").press("Enter")
    page.wait_for_function("(name) => window.__carina.state.training.course.chosen === name", arg=name)


def start(page, task, click="click"):
    """Start a task, and wait until the scope is in the trachea."""
    getattr(page.get_by_test_id(f"start-{task}"), click)()
    page.wait_for_function("() => window.__carina.state.training.running !== null", timeout=WALL_MS)
    page.wait_for_function("() => window.__carina.state.pose.mode === 'scope'", timeout=FLIGHT_MS)
    page.get_by_test_id("stop-task").wait_for()


def end(page, click="click"):
    """End the task, and wait for its score."""
    getattr(page.get_by_test_id("stop-task"), click)()
    page.get_by_test_id("score-dialog").wait_for(timeout=FLIGHT_MS)


def close_score(page):
    # The button, because Escape first hides the tooltip of a button under the pointer.
    page.get_by_test_id("score-dialog").get_by_role("button", name="Close", exact=True).click()
    page.get_by_test_id("score-dialog").wait_for(state="detached")


def test_trainee_reaches_mastery_from_the_start_page(host, workstation, home):
    running = host.open(home=str(home))
    page = workstation.page
    page.set_viewport_size(LARGE)
    workstation.open(running)
    page.get_by_test_id("demo-phantom").click()
    workstation.wait_ready()
    page.get_by_role("button", name="Train", exact=True).click()
    add_learner(page, "Blue heron")
    for number in range(6):
        start(page, "inspect-all")
        assert page.get_by_test_id("attempt-learner").inner_text() == "Score stored for Blue heron"
        assert host.drive(running, 0.1 * number) > 300
        end(page)
        published = workstation.state("training.scores.at(-1).published")
        assert (published["num_seen"], published["num_progressions"]) == (18, 18)
        assert published["time_s"] < 120.0
        assert page.get_by_test_id("score-doubt").count() == 0
        if number == 5:
            workstation.picture("journey-mastery-score")
            assert_accessible(workstation.page, "journey-mastery-score")
        close_score(page)
    workstation.wait_for("window.__carina.state.training.course.attempts.length === 6")
    page.get_by_test_id("open-course").click()
    verdict = page.get_by_test_id("course-verdict").inner_text()
    assert verdict.startswith("Mastery"), verdict
    assert workstation.state("training.course.learners[0].mastery") is True
    workstation.pictures("journey-mastery", SIZES)
    page.keyboard.press("Escape")
    assert workstation.faults == []
    host.close(running)


def test_reloaded_page_returns_to_the_running_task_and_mode_buttons_cannot_end_it(host, workstation, home):
    (home / "tasks").mkdir(parents=True)
    own = replace(find_task("find-rb6"), name="arrow-task", title="Find RB6 with the arrow", hints=("arrow",))
    (home / "tasks" / "own.json").write_text(json.dumps(task_to_json(own)))
    (home / "tasks" / "wrong.json").write_text(json.dumps({**task_to_json(own), "kind": "fly"}))
    running = host.open(demo="phantom", home=str(home))
    page = workstation.page
    page.set_viewport_size(SMALL)
    workstation.open(running)
    workstation.wait_ready()
    page.get_by_role("button", name="Train", exact=True).click()
    problem = page.get_by_test_id("task-problem").inner_text()
    assert "wrong.json: kind: expected" in problem
    assert "found 'fly'" in problem
    page.get_by_test_id("task-problem").scroll_into_view_if_needed()
    workstation.picture("journey-own-tasks")
    start(page, "arrow-task")
    for mode in ("Path", "Free"):
        assert page.get_by_role("radio", name=mode, exact=True).is_disabled()
    assert page.get_by_test_id("scope").first.is_disabled()
    # A program, or an old page, gets a message, and the attempt continues.
    page.evaluate("() => window.__socket.send(JSON.stringify({type: 'set_mode', mode: 'free'}))")
    page.get_by_text("a task is running, and this would end the attempt").first.wait_for()
    assert workstation.state("training.running !== null")
    page.wait_for_function("() => window.__carina.state.training.running.arrow_branches.length > 0", timeout=FLIGHT_MS)
    workstation.hold_until("w", "() => window.__carina.state.pose.scope.insertion_mm > 70")
    page.get_by_test_id("arrow-mark").wait_for()
    workstation.wait_still()
    words = page.get_by_test_id("arrow-text").inner_text()
    kind = page.get_by_test_id("arrow-mark").get_attribute("data-kind")
    assert {"ahead": "Straight", "turn": "Turn to", "back": "Withdraw"}[kind] in words
    workstation.picture("journey-arrow")
    page.reload()
    page.get_by_test_id("stop-task").wait_for(timeout=FLIGHT_MS)
    assert workstation.state("ui.step") == "train"
    workstation.wait_still()
    workstation.picture("journey-reloaded")
    end(page)
    close_score(page)
    assert workstation.state("ui.step") == "train"
    page.get_by_test_id("tasks").wait_for()
    host.close(running)


@pytest.fixture
def watcher(browser):
    context = browser.new_context(viewport=SMALL, device_scale_factor=1, ignore_https_errors=True)
    context.set_default_timeout(PICTURE_MS)
    station = Workstation(context.new_page())
    yield station
    context.close()


def test_teacher_follows_three_learners_and_sees_their_scores(host, workstation, watcher, home):
    running = host.open(demo="phantom", home=str(home), phone_address="127.0.0.1")
    page = workstation.page
    page.set_viewport_size(LARGE)
    workstation.open(running)
    workstation.wait_ready()
    page.get_by_role("button", name="Train", exact=True).click()
    for name in ("Blue heron", "Grey wagtail"):
        add_learner(page, name)
        start(page, "hold-rul")
        workstation.hold_until("w", "() => window.__carina.state.pose.scope.insertion_mm > 20")
        end(page)
        close_score(page)
    add_learner(page, "Red kite")
    page.get_by_test_id("open-devices").click()
    page.get_by_test_id("watch-switch").click()
    url = page.get_by_test_id("watch-url").inner_text()
    watcher.page.goto(url)
    watcher.wait_ready()
    watcher.page.get_by_test_id("watched-training").wait_for(state="attached")
    assert "heron" not in watcher.page.content(), "learners are not shared unless the user shares them"
    assert watcher.state("training.classroom") == []
    page.get_by_test_id("watch-learners").click()
    workstation.wait_for("window.__carina.state.watching.page.learners === true")
    watcher.wait_for("window.__carina.state.training.classroom.length === 3")
    watcher.page.get_by_test_id("classroom").wait_for()
    page.get_by_test_id("watch-learners").scroll_into_view_if_needed()
    workstation.picture("journey-share-learners")
    page.get_by_test_id("open-devices").click()
    start(page, "find-rb6")
    watcher.wait_for("window.__carina.state.training.running?.learner === 'Red kite'")
    watcher.wait_for("window.__carina.state.training.classroom[2].running?.startsWith('Find RB6: 0 of 1') === true")
    workstation.hold_until("w", "() => window.__carina.state.pose.scope.insertion_mm > 30")
    workstation.wait_still()
    watcher.wait_still()
    texts = watcher.page.get_by_test_id("class-learner").all_inner_texts()
    assert [text.splitlines()[0] for text in texts] == ["Blue heron", "Grey wagtail", "Red kite"]
    assert "Flying now: Find RB6: 0 of 1 steps" in texts[2]
    assert "of 1 steps" in texts[0]
    watcher.pictures("journey-teacher", SIZES)
    end(page)
    watcher.wait_for("window.__carina.state.training.classroom[2].attempts.length === 1")
    close_score(page)
    page.get_by_test_id("open-devices").click()
    page.get_by_test_id("watch-learners").click()
    watcher.wait_for("window.__carina.state.training.classroom.length === 0")
    assert workstation.faults == watcher.faults == []
    host.close(running)


def test_touch_screen_flies_a_task_on_a_tablet(host, browser, home, workstation):
    running = host.open(demo="phantom", home=str(home))
    context = browser.new_context(viewport=TABLET, has_touch=True)
    context.set_default_timeout(PICTURE_MS)
    tablet = Workstation(context.new_page())
    page = tablet.page
    tablet.open(running)
    tablet.wait_ready()
    page.get_by_role("button", name="Train", exact=True).tap()
    assert page.get_by_test_id("voice").count() == 0, "this browser has no voice of this computer"
    tablet.picture("journey-touch-tasks")
    start(page, "inspect-all", click="tap")
    stick = page.get_by_test_id("stick-left").bounding_box()
    x, y = stick["x"] + stick["width"] / 2, stick["y"] + stick["height"] / 2
    client = context.new_cdp_session(page)
    client.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [{"x": x, "y": y, "id": 0}]})
    up = [{"x": x, "y": y - 0.45 * stick["height"], "id": 0}]
    client.send("Input.dispatchTouchEvent", {"type": "touchMove", "touchPoints": up})
    page.wait_for_function("() => window.__carina.state.pose.scope.insertion_mm > 30", timeout=FLIGHT_MS)
    client.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    tablet.wait_still()
    tablet.picture("journey-touch-flight")
    end(page, click="tap")
    page.wait_for_timeout(100)
    tablet.picture("journey-touch-score")
    assert_accessible(tablet.page, "journey-touch-score")
    assert tablet.faults == []
    context.close()
    host.close(running)


def test_simulated_handle_flies_a_task_and_its_loss_is_reported(host, workstation, home):
    running = host.open(demo="phantom", home=str(home))
    page = workstation.page
    page.set_viewport_size(LARGE)
    page.add_init_script(HID_MOCK)
    page.add_init_script(VOICES)
    workstation.open(running)
    workstation.wait_ready()
    page.get_by_role("button", name="Train", exact=True).click()
    page.get_by_test_id("open-devices").click()
    page.get_by_test_id("ask-handle").click()
    page.wait_for_function("() => window.testHid.handle.opened")
    page.get_by_test_id("open-devices").click()
    start(page, "inspect-all")
    clock = itertools.count(1000, 20)
    for _ in range(60):
        # A busy machine drops some pushes, because a device that is silent for 250 ms counts as released.
        reports = [list(struct.pack("<Iiihb", next(clock), 100 * mm, 0, 0, 0)) for mm in range(0, 40, 1)]
        page.evaluate(PUSH, reports)
        if workstation.state("pose.scope.insertion_mm") > 30.0:
            break
        next(itertools.islice(clock, 50, None))
    assert workstation.state("pose.scope.insertion_mm") > 30.0
    workstation.wait_still()
    workstation.picture("journey-handle")
    assert page.evaluate("window.spoken") == [], "the voice is off by default"
    page.get_by_test_id("voice").click()
    page.evaluate("() => window.plug('handle', 'disconnect')")
    page.get_by_text("was disconnected: the task continues").first.wait_for()
    assert workstation.state("training.running !== null")
    workstation.picture("journey-handle-lost")
    # A fault may be spoken first, and an event together with the step.
    page.wait_for_function("() => window.spoken.some((text) => text.includes('Next: RB1'))", timeout=FLIGHT_MS)
    assert page.evaluate("window.spoken.every((text) => text.startsWith('near: '))")
    end(page)
    close_score(page)
    assert workstation.faults == []
    host.close(running)


def test_comparison_with_the_expert_is_complete_without_scrolling_and_printed_on_one_page(host, workstation, home):
    running = host.open(demo="phantom", home=str(home))
    page = workstation.page
    page.set_viewport_size(SMALL)
    workstation.open(running)
    workstation.wait_ready()
    page.get_by_role("button", name="Train", exact=True).click()
    for number in range(2):
        start(page, "inspect-all")
        # The second tip is 6 mm beside the first one.
        host.drive(running, 6.0 * number)
        end(page)
        close_score(page)
    first, second = (flight["number"] for flight in workstation.state("flights"))
    page.evaluate("(number) => window.__socket.send(JSON.stringify({type: 'mark_expert', number}))", first)
    workstation.wait_for("window.__carina.state.flights[0].is_expert")
    page.get_by_test_id(f"score-{second}").click()
    page.get_by_test_id("compare-expert").click()
    page.get_by_test_id("comparison").wait_for(timeout=FLIGHT_MS)
    box = page.locator(".score-dialog > section")
    for name, size in (("small", SMALL), ("large", LARGE)):
        page.set_viewport_size(size)
        workstation.picture(f"journey-comparison-{name}")
        assert box.evaluate(FITS), f"the comparison is complete at {size}"
    pages = pypdf.PdfReader(io.BytesIO(page.pdf(format="A4"))).pages
    assert len(pages) == 1
    printed = " ".join(pages[0].extract_text().split())
    assert "local variance" in printed
    assert "High-error events (over 5 mm for 0.5 s or longer): " in printed
    assert "Number of segments seen" in printed, "a printed page contains the definitions"
    # Every row has its definition one click away, and all other texts have theirs behind one button.
    rows = page.get_by_test_id("score-row")
    for number in range(rows.count()):
        definition = rows.nth(number).locator("xpath=following-sibling::span")
        assert not definition.is_visible()
        rows.nth(number).click()
        assert definition.is_visible()
        assert len(definition.inner_text()) > 20
        rows.nth(number).click()
    page.get_by_test_id("definitions-key").click()
    text = page.get_by_test_id("definitions").inner_text()
    assert "Konge 2011" in text
    assert "Deng, ICRA 2026" in text
    assert "High-error events" in text
    workstation.picture("journey-definitions")
    # The high-error events with the largest deviations can be replayed.
    moments = page.get_by_test_id("high-error-moment")
    assert moments.count() == len(workstation.state("training.scores.at(-1).comparison_moments")) == 3
    moments.first.click()
    page.get_by_test_id("score-dialog").wait_for(state="detached")
    workstation.wait_for(f"window.__carina.state.pose.flight?.number === {second}")
    assert workstation.faults == []
    host.close(running)
