"""Test of the way from a CT to a printed plan in the browser, in six clicks and without scrolling."""

from __future__ import annotations

import json

import pytest
from page_positions import show_slices_at

from cached_test_data import cached_phantom

pytestmark = pytest.mark.browser

CHEST = {"seed": 4, "spacing_mm": 1.2, "generations": 5, "nodule": True}
MAX_CLICKS = 6
SMALL = {"width": 1280, "height": 720}
OUTSIDE = """() => ['plan-answer', 'answer-reach', 'answer-needle', 'answer-vessel', 'print-plan'].filter((name) => {
    const shown = document.querySelector(`[data-testid=${name}]`);
    if (shown === null) return name !== 'print-plan' || !document.querySelector('[data-testid=answer-take-route]');
    const { left, right, top, bottom } = shown.getBoundingClientRect();
    const hit = document.elementFromPoint((left + right) / 2, (top + bottom) / 2);
    return left < 0 || top < 0 || right > innerWidth || bottom > innerHeight || !shown.contains(hit);
})"""
"""Script that returns the parts of the answer that are missing, covered or outside the window."""

CROSSHAIR = """() => window.__carina.state.session.sight.crosshair_lps
    ?? [3, 7, 11].map((n) => window.__carina.state.pose.lps_from_camera[n])"""
"""Script that returns the point where the slices intersect, LPS mm."""


@pytest.fixture
def opens(shared_chest):
    """Return a chest with a nodule, as the opened file."""
    return shared_chest(**CHEST)


def scroll_to(workstation, lps) -> None:
    """Scroll through the axial slices with the wheel until the slice of the target is shown."""
    canvas = workstation.page.locator("canvas[data-view=axial]")
    box = canvas.bounding_box()
    workstation.page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 0.6 * box["height"])
    for _ in range(400):
        at = workstation.page.evaluate("() => window.__carina.state.frames.axial.lps_from_pixel[11]")
        if abs(at - lps[2]) < 1.0:
            return
        workstation.page.mouse.wheel(0, 100 if at > lps[2] else -100)
        workstation.wait_for("(at) => Math.abs(window.__carina.state.frames.axial.lps_from_pixel[11] - at) > 0.01", at)
    raise AssertionError("the wheel does not lead to the slice")


def place_in_slice(workstation, view: str, lps) -> list[float]:
    """Return the position of a point in a slice, in page coordinates."""
    return workstation.page.evaluate(
        """([view, p]) => {
            const { lps_from_pixel: m, width, height } = window.__carina.state.frames[view];
            const d = [p[0] - m[3], p[1] - m[7], p[2] - m[11]];
            const along = (c) => (d[0] * m[c] + d[1] * m[4 + c] + d[2] * m[8 + c])
                / (m[c] ** 2 + m[4 + c] ** 2 + m[8 + c] ** 2);
            const box = document.querySelector(`canvas[data-view=${view}]`).getBoundingClientRect();
            return [box.x + (along(0) / width) * box.width, box.y + (along(1) / height) * box.height];
        }""",
        [view, [float(v) for v in lps]],
    )


def test_plan_is_printed_six_clicks_after_opening_the_ct_with_the_answer_on_the_screen(server, workstation):
    workstation.page.set_viewport_size(SMALL)
    workstation.open(server)
    workstation.wait_ready()
    page, truth = workstation.page, cached_phantom(**CHEST).truth["nodule"]
    pose = workstation.state("pose.lps_from_camera")
    clicks = 1  # The first click opens the CT.
    page.get_by_role("button", name="Target", exact=True).first.click()
    page.get_by_test_id("arm-target").click()
    clicks += 2
    scroll_to(workstation, truth["centre_lps"])
    page.mouse.click(*place_in_slice(workstation, "axial", truth["centre_lps"]))
    clicks += 1
    lesion = page.get_by_test_id("lesion")
    lesion.wait_for()
    workstation.wait_for("window.__carina.state.plans.targets[0].routes.length > 0")
    assert "solid nodule" in page.get_by_test_id("lesion-size").inner_text().lower()
    # The tip does not jump to the new target or to the plan's route.
    assert workstation.state("pose.lps_from_camera") == pose
    assert page.evaluate(OUTSIDE) == []
    workstation.picture("plan-target")

    page.get_by_test_id("answer-take-route").click()
    clicks += 1
    workstation.wait_while_working("window.__carina.state.plans.verdicts_standing === 'had'")
    assert page.evaluate(OUTSIDE) == []
    verdict = page.get_by_test_id("verdict").first
    assert verdict.inner_text().strip()
    # The page shows a new state with its next picture.
    workstation.wait_for(
        "document.querySelectorAll('.routes thead th').length === "
        "1 + window.__carina.state.plans.targets[0].routes.length"
    )
    routes = workstation.state("plans.targets[0].routes")
    outlook = page.get_by_role("row").filter(has=page.get_by_role("rowheader", name="Outlook"))
    assert outlook.get_by_role("cell").all_inner_texts() == [route["outlook"] for route in routes]
    assert workstation.state("route.needle.ends_lps[1]") == pytest.approx(routes[0]["leg"]["aim_lps"], abs=0.01)
    # The tip is in the trachea, which is part of every route, so it stays there.
    assert workstation.state("pose.lps_from_camera")[3::4][:3] == pytest.approx(pose[3::4][:3], abs=0.5)
    workstation.picture("plan-routes")

    with page.context.expect_page() as opened:
        page.get_by_test_id("print-plan").click()
    clicks += 1
    report = opened.value
    report.wait_for_load_state("load")
    assert clicks <= MAX_CLICKS
    text = report.locator("body").inner_text()
    assert "Not a medical device" in text and "CT taken at inspiration" in text
    assert "patient's name" not in text
    listed = report.locator("#against li").all_inner_texts()
    assert len(report.locator("img").all()) + len(report.locator("svg").all()) >= 3
    report.close()

    with page.expect_download() as taken:
        page.get_by_test_id("take-plan.json").click()
    document = json.loads(taken.value.path().read_text())
    assert (document["format"], document["report"]["route"]) == ("carina-plan", 1)
    # The window, its report and the file list the same reasons against the plan in the same order.
    reasons = [reason["words"] for reason in document["report"]["reasons"]]
    assert reasons and [one.strip() for one in page.get_by_test_id("reason").all_inner_texts()] == reasons
    assert [" ".join(one.split()) for one in listed] == reasons
    assert len(document["verdicts"]) == len(workstation.state("plans.verdicts"))
    assert workstation.faults == []


def tab_to(page, selector: str) -> None:
    """Press Tab until an element, or a part of it, has the focus."""
    for _ in range(300):
        if page.evaluate("(wanted) => document.activeElement.closest(wanted) !== null", selector):
            return
        page.keyboard.press("Tab")
    raise AssertionError(f"Tab does not reach {selector}")


def move_crosshair_by_keys(workstation, lps) -> None:
    """Move the crosshair of the focused axial slice to a point, in steps of slices and of 1 mm."""
    page = workstation.page
    for axis, back, ahead in (
        (2, "PageDown", "PageUp"),
        (0, "Shift+ArrowLeft", "Shift+ArrowRight"),
        (1, "Shift+ArrowUp", "Shift+ArrowDown"),
    ):
        start = page.evaluate(CROSSHAIR)[axis]
        key = ahead if start < lps[axis] else back
        page.keyboard.press(key)
        workstation.wait_for(f"([axis, start]) => ({CROSSHAIR})()[axis] !== start", [axis, start])
        here = page.evaluate(CROSSHAIR)[axis]
        for _ in range(round(abs(lps[axis] - here) / abs(here - start))):
            page.keyboard.press(key)
        workstation.wait_for(f"([axis, wanted]) => Math.abs(({CROSSHAIR})()[axis] - wanted) <= 0.7", [axis, lps[axis]])


def test_keyboard_alone_leads_from_the_opened_ct_to_the_printed_plan(server, workstation):
    workstation.page.set_viewport_size(SMALL)
    workstation.open(server)
    workstation.wait_ready()
    page, truth = workstation.page, cached_phantom(**CHEST).truth["nodule"]
    page.keyboard.press("n")
    tab_to(page, ".picture-host:has([data-view=axial])")
    move_crosshair_by_keys(workstation, truth["centre_lps"])
    page.keyboard.press("Enter")
    workstation.wait_for("window.__carina.state.plans.targets[0]?.routes.length > 0")
    tab_to(page, "[data-testid=answer-take-route]")
    workstation.picture("plan-by-keyboard")
    page.keyboard.press("Enter")
    workstation.wait_while_working("window.__carina.state.plans.verdicts_standing === 'had'")
    tab_to(page, "[data-testid=print-plan]")
    with page.context.expect_page() as opened:
        page.keyboard.press("Enter")
    report = opened.value
    report.wait_for_load_state("load")
    assert report.locator("#against li").count() == page.get_by_test_id("reason").count()
    report.close()
    assert workstation.faults == []


def test_pair_of_route_and_instrument_is_selected_and_instruments_are_marked_as_available(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    page, truth = workstation.page, cached_phantom(**CHEST).truth["nodule"]
    show_slices_at(workstation, truth["centre_lps"])
    page.get_by_role("button", name="Target", exact=True).first.click()
    page.get_by_test_id("arm-target").click()
    page.mouse.click(*place_in_slice(workstation, "axial", truth["centre_lps"]))
    workstation.wait_for("window.__carina.state.plans.targets[0].routes.length > 0")
    page.get_by_test_id("take-route").click()
    workstation.wait_while_working("window.__carina.state.plans.pairs_standing === 'had'")
    pairs = page.get_by_test_id("pairs")
    pairs.wait_for()
    pairs.locator("summary").click()
    first = workstation.state("plans.pairs[0]")
    assert page.get_by_test_id("pair-table").locator("tbody th").first.inner_text().strip() == first["title"]
    workstation.picture("plan-pairs")

    # An instrument that is not available here is listed separately, and stays so for other cases.
    page.get_by_test_id(f"pair-row-{first['scope']}").locator("input").click()
    workstation.wait_for("window.__carina.state.plans.available !== null")
    assert first["scope"] not in workstation.state("plans.available")
    workstation.wait_for("(scope) => window.__carina.state.plans.pairs[0].scope !== scope", first["scope"])
    assert page.get_by_text("Not available here", exact=True).is_visible()
    page.get_by_test_id(f"pair-row-{first['scope']}").locator("input").click()
    workstation.wait_for("window.__carina.state.plans.available === null")

    # A click on a pair chooses scope and route.
    other = next(one for one in workstation.state("plans.pairs") if one["scope"] != "thin")
    routes = workstation.state("plans.targets[0].routes")
    number = next(n for n, route in enumerate(routes, 1) if route["key"] == other["route"])
    page.get_by_test_id(f"pair-{other['scope']}-{number}").click()
    workstation.wait_for("(scope) => window.__carina.state.plans.targets[0].options.scope === scope", other["scope"])
    workstation.wait_while_working("window.__carina.state.plans.standing === 'had'")
    place = workstation.state("plans.targets[0].options.place")
    assert place["branch_id"] == next(route["branch_id"] for route in routes if route["key"] == other["route"])
    assert place["branch_id"] in [route["branch_id"] for route in workstation.state("plans.targets[0].routes")]
    workstation.picture("plan-pair-taken")
