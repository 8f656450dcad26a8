"""Tests of the report in a real browser without network: no requests, no errors, and a tree with correct sides."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from phantom_plan import clip, sheet, still

from carina.plan.report import write_report
from find_browser import find_browser

sync_api = pytest.importorskip("playwright.sync_api")
pytestmark = pytest.mark.browser

FLAGS = ["--no-sandbox", "--disable-quic", "--disable-background-networking", "--disable-component-update"]
WHERE = """() => {
  const canvas = document.getElementById('tree'), {width, height} = canvas;
  const data = canvas.getContext('2d').getImageData(0, 0, width, height).data;
  const found = {orange: [], blue: [], grey: 0};
  for (let n = 0; n < data.length; n += 4) {
    const [r, g, b] = data.slice(n, n + 3), x = (n / 4) % width;
    if (r > 190 && g > 60 && g < 205 && b < g - 15 && r - b > 60) found.orange.push(x / width);
    else if (b - r > 60) found.blue.push(x / width);
    else if (r < 230) found.grey += 1;
  }
  const mean = (values) => values.reduce((a, b) => a + b, 0) / Math.max(values.length, 1);
  return {orange: mean(found.orange), num_orange: found.orange.length, num_blue: found.blue.length, grey: found.grey};
}"""
"""Script that returns the mean position of orange pixels (target, last leg) and of blue pixels (route).

The positions are fractions of the canvas width.
"""
SIZES = """() => [...document.querySelectorAll('svg text')].filter((one) => one.getClientRects().length).map((text) => {
  const svg = text.ownerSVGElement, scale = svg.getBoundingClientRect().height / svg.viewBox.baseVal.height;
  return parseFloat(getComputedStyle(text).fontSize) * scale * 72 / 96;
})"""
"""Script that returns the font sizes of all visible text in drawings, in points."""
TEXT_SIZES = """() => [...document.body.querySelectorAll('*')]
  .filter((one) => !one.closest('svg') && one.getClientRects().length)
  .filter((one) => [...one.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim()))
  .map((one) => parseFloat(getComputedStyle(one).fontSize) * 72 / 96)"""
"""Script that returns the font sizes of all visible text outside drawings, in points."""
DRAWN = "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
"""Script that waits until the page has drawn a frame."""


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    path = find_browser()
    if path is None:
        pytest.skip("needs a Chromium or Chrome (Debian package: chromium)")
    with sync_api.sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=path, args=FLAGS)
        yield running
        running.close()


@cache
def report(folder: Path) -> Path:
    return write_report(folder / "plan.html", sheet())


@cache
def filmed_report(folder: Path) -> Path:
    listed = sheet().turns
    assert listed is not None
    pictures, clips = [still(turn, shade=250) for turn in listed.turns], [clip(turn) for turn in listed.turns]
    return write_report(folder / "filmed.html", sheet(turns=listed, turn_pictures=pictures, turn_clips=clips))


@cache
def tracing_sheet(folder: Path) -> Path:
    return write_report(folder / "sheet.html", sheet(), kind="tracing")


@pytest.fixture(scope="module")
def tab(browser) -> Iterator[Any]:
    """Yield a browser page without network, which all tests of the file share.

    A new process for each test would take most of the time.
    """
    context = browser.new_context(offline=True)
    yield context.new_page()
    context.close()


@pytest.fixture
def opened(tab, tmp_path_factory) -> Iterator[Any]:
    with shown(tab, report(tmp_path_factory.getbasetemp())):
        yield tab


@pytest.fixture
def filmed(tab, tmp_path_factory) -> Iterator[Any]:
    with shown(tab, filmed_report(tmp_path_factory.getbasetemp())):
        yield tab


@contextmanager
def shown(page: Any, path: Path) -> Iterator[None]:
    """Load a file in the page, and assert that it makes no requests and causes no errors."""
    requested: list[str] = []
    troubles: list[str] = []
    heard = {
        "request": lambda request: requested.append(request.url),
        "console": lambda message: troubles.append(message.text),
        "pageerror": lambda error: troubles.append(str(error)),
    }
    page.set_viewport_size({"width": 1280, "height": 800})
    # The emulated media are reset, because they would also apply to printing.
    page.emulate_media(media="null", reduced_motion="no-preference")
    for name, hear in heard.items():
        page.on(name, hear)
    page.goto(path.as_uri())
    page.evaluate(DRAWN)
    yield
    assert [url for url in requested if not url.startswith("data:")] == [path.as_uri()]
    assert troubles == []
    for name, hear in heard.items():
        page.remove_listener(name, hear)
    page.mouse.move(0, 0)


def letters(page: Any) -> dict[str, list[float]]:
    found: dict[str, list[float]] = json.loads(page.locator("#tree").get_attribute("data-letters"))
    return found


def test_tree_drawing_of_the_report_has_the_patient_right_on_the_left(opened) -> None:
    where = opened.evaluate(WHERE)
    assert where["grey"] > 2000 and where["num_blue"] > 500 and where["num_orange"] > 50
    # The target is in the right lung, so its LPS x is less than that of the middle of the tree.
    points = [point for one in sheet().shape.branches for point in one.points_lps]
    middle = 0.5 * (min(p[0] for p in points) + max(p[0] for p in points))
    assert sheet().plan.nodule.centre_lps[0] < middle - 20.0
    assert where["orange"] < 0.45
    seen = letters(opened)
    assert set(seen) == {"R", "L", "S", "I"}
    assert seen["R"][0] < seen["L"][0] and seen["S"][1] < seen["I"][1]


@pytest.mark.parametrize(
    ("name", "key", "sides"),
    [
        ("Front", "a", "RLSI"),
        ("Back", "p", "LRSI"),
        ("Left", "l", "APSI"),
        ("Right", "r", "PASI"),
        ("Above", "s", "RLPA"),
        ("Below", "i", "RLAP"),
    ],
)
def test_letters_and_pixels_of_the_tree_drawing_are_correct_from_every_side(opened, name, key, sides) -> None:
    left, right, up, down = sides
    opened.get_by_role("button", name=name).click()
    opened.evaluate(DRAWN)
    by_button = letters(opened)
    assert by_button[left][0] < by_button[right][0] and by_button[up][1] < by_button[down][1]
    assert set(by_button) == {left, right, up, down}
    opened.locator("#tree").focus()
    opened.keyboard.press("0")
    opened.keyboard.press(key)
    opened.evaluate(DRAWN)
    assert letters(opened) == by_button
    # The pixels agree with the letters: seen from the back, the target is on the other side.
    if name == "Back":
        assert opened.evaluate(WHERE)["orange"] > 0.55


def test_pointer_and_keys_rotate_the_tree_drawing_in_their_direction(opened) -> None:
    tree = opened.locator("#tree")
    tree.scroll_into_view_if_needed()
    box = tree.bounding_box()
    x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]
    opened.mouse.move(x, y)
    opened.mouse.down()
    opened.mouse.move(x + 60, y, steps=4)
    opened.mouse.up()
    opened.evaluate(DRAWN)
    dragged = json.loads(tree.get_attribute("data-view"))
    # The front of the tree moves with the pointer to the right, so the camera moves to the patient's right.
    assert dragged["azimuth"] == pytest.approx(-30.0) and dragged["elevation"] == pytest.approx(0.0)
    seen = letters(opened)
    assert seen["A"][0] > seen["P"][0]
    opened.keyboard.press("Home")
    opened.keyboard.press("ArrowRight")
    opened.keyboard.press("+")
    opened.evaluate(DRAWN)
    turned = json.loads(tree.get_attribute("data-view"))
    assert turned["azimuth"] == pytest.approx(-5.0) and turned["zoom"] == pytest.approx(1.15)


@pytest.mark.parametrize("width", [1280, 390])
def test_no_element_of_the_report_is_wider_than_the_screen(opened, width) -> None:
    opened.set_viewport_size({"width": width, "height": 844})
    opened.evaluate(DRAWN)
    assert opened.evaluate("document.documentElement.scrollWidth") <= width


@pytest.mark.parametrize("paper", ["A4", "Letter"])
def test_every_printed_page_of_the_report_has_header_and_footer_and_no_cut_element(opened, paper) -> None:
    pypdf = pytest.importorskip("pypdf", reason="needs pypdf")
    printed = pypdf.PdfReader(io.BytesIO(opened.pdf(format=paper, print_background=True)))
    texts = [page.extract_text() for page in printed.pages]
    assert all(
        "Not a medical device." in text and "in the procedure the target may lie up to" in text for text in texts
    )
    assert all(sheet().plan.nodule.words in text for text in texts)
    assert "Tracing sheet" in texts[-1] and "Notes" in texts[-1], "the tracing sheet is one page"
    assert "Airways and route" in texts[0], "target and route are on the first page"
    # Printing lays the page out at paper width; no element may be wider.
    opened.emulate_media(media="print")
    mm = {"A4": 210.0, "Letter": 215.9}[paper] - 24.0
    opened.set_viewport_size({"width": round(mm / 25.4 * 96), "height": 1000})
    assert opened.evaluate("document.documentElement.scrollWidth") <= round(mm / 25.4 * 96) + 1
    sizes = [*opened.evaluate(SIZES), *opened.evaluate(TEXT_SIZES)]
    assert len(sizes) > 100 and min(sizes) >= 7.99, "text on paper has at least 8 points"
    opened.emulate_media(media="null")


@pytest.mark.parametrize("paper", ["A4", "Letter"])
def test_tracing_sheet_is_printed_on_one_page_with_text_of_at_least_8_points(tab, tmp_path_factory, paper) -> None:
    pypdf = pytest.importorskip("pypdf", reason="needs pypdf")
    with shown(tab, tracing_sheet(tmp_path_factory.getbasetemp())):
        printed = pypdf.PdfReader(io.BytesIO(tab.pdf(format=paper, print_background=True)))
        tab.emulate_media(media="print")
        sizes = tab.evaluate(SIZES)
        tab.emulate_media(media="null")
    (page,) = printed.pages
    text = " ".join(page.extract_text().split())
    assert all(name in text for name in ("Tracing sheet", "Patient label", "Date", "Not a medical device."))
    for reason in sheet().reasons:
        assert all(word in text for word in reason.words.split())
    assert sizes and min(sizes) >= 8.0


# Script that returns the grey level of the first clip's canvas, rounded to tens because of JPEG; None while the still
# is shown.
SHADE = """() => {
  const canvas = document.querySelector('.picture canvas');
  if (canvas.offsetParent === null) return null;
  const probe = document.createElement('canvas').getContext('2d', { willReadFrequently: true });
  probe.drawImage(canvas, 0, 0, 1, 1);
  return Math.round(probe.getImageData(0, 0, 1, 1).data[0] / 10) * 10;
}"""
# Script that records this grey level in each animation frame.
NOTED = f"""() => {{
  window.seen = [];
  const note = () => {{ window.seen.push(({SHADE})()); requestAnimationFrame(note); }};
  note();
}}"""
# Script that waits for the end of the clip. Playwright's own wait needs evaluated text, which the page's policy
# forbids.
PLAYED = """() => new Promise((done) => {
  const look = () => {
    if (window.seen.some((shade) => shade !== null) && window.seen.at(-1) === null) done();
    else requestAnimationFrame(look);
  };
  look();
})"""


def test_video_of_a_turn_plays_over_its_picture_on_a_click_and_stops_at_its_end(filmed) -> None:
    first = filmed.locator(".clip").first
    button, slider = first.get_by_role("button"), first.get_by_role("slider")
    assert filmed.evaluate(SHADE) is None and slider.input_value() == "3"
    assert slider.get_attribute("aria-valuetext") == "at the fork"
    filmed.evaluate(NOTED)
    button.click()
    filmed.evaluate(PLAYED)
    assert slider.input_value() == "3" and button.inner_text() == "Play the way there"
    # The frames are in order; a busy machine may omit some.
    played = [shade for shade in filmed.evaluate("window.seen") if shade is not None]
    assert played == sorted(played) and set(played) <= {0, 100, 200}


def test_slider_selects_a_frame_of_a_turn_video_and_print_shows_the_picture(filmed) -> None:
    slider = filmed.locator(".clip").first.get_by_role("slider")
    slider.focus()
    shades = []
    for key in ("Home", "ArrowRight", "ArrowRight", "ArrowRight"):
        filmed.keyboard.press(key)
        shades.append(filmed.evaluate(SHADE))
    assert shades == [0, 100, 200, None]
    filmed.keyboard.press("ArrowLeft")
    assert filmed.evaluate(SHADE) == 200
    assert slider.get_attribute("aria-valuetext") == "picture 3 of 3"
    filmed.emulate_media(media="print")
    assert filmed.evaluate(SHADE) is None
    assert not filmed.locator(".clip").first.is_visible()
    assert filmed.locator(".picture svg").first.is_visible()


def test_reduced_motion_setting_hides_the_play_button_of_turn_videos(filmed) -> None:
    button, slider = (filmed.locator(".clip").first.locator(name) for name in ("button", "input"))
    button.click()
    filmed.emulate_media(reduced_motion="reduce")
    button.wait_for(state="hidden")
    assert slider.is_visible() and slider.input_value() == "3" and filmed.evaluate(SHADE) is None
    slider.focus()
    filmed.keyboard.press("Home")
    assert filmed.evaluate(SHADE) == 0
    filmed.emulate_media(reduced_motion="no-preference")
    button.wait_for(state="visible")
