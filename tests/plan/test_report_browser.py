"""The report in a real browser with the network off: nothing is asked for, nothing fails, and the tree stands right."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from reported import sheet

from carina.plan.report import write_report
from find_browser import find_browser

sync_api = pytest.importorskip("playwright.sync_api")
pytestmark = pytest.mark.browser

FLAGS = ["--no-sandbox", "--disable-quic", "--disable-background-networking", "--disable-component-update"]
# Orange is the target and the last leg, blue the route: where on the canvas they lie, as shares of its width.
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
DRAWN = "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"


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


@pytest.fixture
def opened(browser, tmp_path_factory) -> Iterator[Any]:
    context = browser.new_context(viewport={"width": 1280, "height": 800}, offline=True)
    page = context.new_page()
    asked: list[str] = []
    troubles: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.on("console", lambda message: troubles.append(message.text))
    page.on("pageerror", lambda error: troubles.append(str(error)))
    path = report(tmp_path_factory.getbasetemp())
    page.goto(path.as_uri())
    page.evaluate(DRAWN)
    yield page
    assert [url for url in asked if not url.startswith("data:")] == [path.as_uri()]
    assert troubles == []
    context.close()


def letters(page: Any) -> dict[str, list[float]]:
    found: dict[str, list[float]] = json.loads(page.locator("#tree").get_attribute("data-letters"))
    return found


def test_the_tree_is_drawn_and_the_patients_right_is_on_the_left(opened) -> None:
    where = opened.evaluate(WHERE)
    assert where["grey"] > 2000 and where["num_blue"] > 500 and where["num_orange"] > 50
    # The target lies in the right lung: LPS x below the middle of the tree.
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
def test_from_every_side_the_letters_are_right_and_nothing_is_mirrored(opened, name, key, sides) -> None:
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
    # The pixels agree with the letters: from behind the target lies on the other side.
    if name == "Back":
        assert opened.evaluate(WHERE)["orange"] > 0.55


def test_pointer_and_keys_turn_the_tree_the_way_the_hand_goes(opened) -> None:
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
    # What is in front goes to the right with the hand, so the camera goes to the patient's right.
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
def test_nothing_is_wider_than_the_screen(opened, width) -> None:
    opened.set_viewport_size({"width": width, "height": 844})
    opened.evaluate(DRAWN)
    assert opened.evaluate("document.documentElement.scrollWidth") <= width


@pytest.mark.parametrize("paper", ["A4", "Letter"])
def test_on_paper_every_page_has_its_head_and_foot_and_nothing_is_cut(opened, paper) -> None:
    pypdf = pytest.importorskip("pypdf", reason="needs pypdf")
    printed = pypdf.PdfReader(io.BytesIO(opened.pdf(format=paper, print_background=True)))
    texts = [page.extract_text() for page in printed.pages]
    assert all(
        "Not a medical device." in text and "in the procedure the target may lie up to" in text for text in texts
    )
    assert all(sheet().plan.nodule.words in text for text in texts)
    assert "Tracing sheet" in texts[-1] and "Notes" in texts[-1], "the tracing sheet is one page"
    assert "Airways and route" in texts[0], "target and way stand on the first page"
    # Printing lays the page out for paper; in that width no element may stick out.
    opened.emulate_media(media="print")
    mm = {"A4": 210.0, "Letter": 215.9}[paper] - 24.0
    opened.set_viewport_size({"width": round(mm / 25.4 * 96), "height": 1000})
    assert opened.evaluate("document.documentElement.scrollWidth") <= round(mm / 25.4 * 96) + 1
    opened.emulate_media(media="screen")
