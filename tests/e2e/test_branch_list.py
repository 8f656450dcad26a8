"""Tests of the list of branches and other lists with keys and fingers: which inputs choose, and which only move."""

from __future__ import annotations

import re

import pytest
from workstation import scroll_list_to

pytestmark = pytest.mark.browser

ROUTE_END = "window.__carina.state.route.spans.at(-1).branch_id"
FOCUSED_ROW = "document.activeElement?.closest('[role=row]')?.querySelector('[data-branch]')?.dataset.branch"


@pytest.fixture
def opened(server, workstation):
    workstation.open(server)
    workstation.wait_ready()
    return workstation


def route_end(workstation) -> int:
    """Return the branch at the end of the route, after all messages have arrived."""
    workstation.settle()
    return workstation.page.evaluate(f"() => {ROUTE_END}")


def test_enter_in_the_search_chooses_the_first_match_and_returns_the_keys_to_the_flight(opened):
    page = opened.page
    page.keyboard.press("/")
    field = page.locator(".branch-filter input")
    field.fill("LB3")
    # The row that Enter chooses is outlined.
    outlined = """() => [...document.querySelectorAll('.branch-tree .react-aria-TreeItem')]
        .filter((row) => getComputedStyle(row).outlineStyle === 'dashed')
        .map((row) => Number(row.querySelector('[data-branch]').dataset.branch))
        .map((id) => window.__carina.state.tree.byId.get(id).label)
    """
    assert page.evaluate(outlined) == ["LB3"]
    opened.picture("search-enter")
    page.keyboard.press("Enter")
    opened.wait_for("window.__carina.state.session.can_undo === 'route to LB3'")
    label = f"window.__carina.state.tree.byId.get({ROUTE_END}).label"
    opened.wait_for(f"{label} === 'LB3'")
    assert page.evaluate("() => document.activeElement === document.body")
    # Without a match Enter does nothing.
    end = route_end(opened)
    field.fill("nothing of the kind")
    page.keyboard.press("Enter")
    assert route_end(opened) == end
    assert opened.faults == []


def test_tab_and_arrow_keys_in_the_list_choose_no_route_and_add_no_undo_step_and_enter_chooses(opened):
    page = opened.page
    end = route_end(opened)
    field = page.locator(".branch-filter input")
    for text in ("", "LB"):
        field.fill(text)
        field.focus()
        for key in ("Tab", "Tab", "ArrowDown", "ArrowDown", "ArrowUp", "ArrowDown", "Home", "End"):
            page.keyboard.press(key)
            opened.refreshes(1)
        assert route_end(opened) == end, f"search {text!r}"
        assert opened.state("session.can_undo") is None
    field.fill("")
    page.locator(".branch-tree [role=row]").first.focus()
    page.keyboard.press("ArrowDown")
    opened.wait_for(f"Number({FOCUSED_ROW}) > 0")
    row = int(page.evaluate(f"() => {FOCUSED_ROW}"))
    assert route_end(opened) == end
    page.keyboard.press("Enter")
    opened.wait_for(f"(id) => window.__carina.state.tree.byId.get({ROUTE_END}).row[0].branch.id === id", row)
    assert re.match(r"route to \w+", opened.state("session.can_undo"))
    assert opened.faults == []


def test_arrow_keys_after_a_choice_of_the_scope_do_not_change_the_scope(opened):
    page = opened.page
    page.get_by_test_id("scope").click()
    page.get_by_role("option", name="Standard (BF-P160)").click()
    opened.wait_for("window.__carina.state.look.scope === 'standard'")
    # The list returns the focus to its button, and the page removes it from there.
    opened.wait_for("document.activeElement === document.body")
    page.keyboard.press("ArrowRight")
    page.get_by_test_id("scope").focus()
    for key in ("ArrowRight", "ArrowLeft", "ArrowRight"):
        page.keyboard.press(key)
    opened.settle()
    assert opened.state("look.scope") == "standard"
    assert opened.state("session.can_undo").startswith(("scope: Standard", "route to"))
    assert opened.faults == []


def test_list_and_panel_state_the_same_number_of_branches(opened):
    page = opened.page
    page.get_by_role("button", name="Airways", exact=True).first.click()
    count = page.evaluate("() => window.__carina.state.tree.byId.size")
    assert page.locator(".list-head .numbers").inner_text() == f"{count} branches"
    assert page.locator(".step-body summary").first.inner_text() == f"{count} branches found"
    page.locator(".branch-filter input").fill("g2")
    rows = page.evaluate(
        """() => [...window.__carina.state.tree.byId.values()]
            .filter((node) => node.row[0] === node && node.row.some(({ branch }) => branch.generation === 2)).length"""
    )
    assert page.locator(".list-head .numbers").inner_text() == f"{rows} matches"
    assert opened.faults == []


def test_tap_on_a_branch_in_list_or_tree_chooses_the_route_to_it(server, browser, workstation):
    workstation.open(server)
    workstation.wait_ready()
    context = browser.new_context(viewport={"width": 820, "height": 1180}, has_touch=True)
    try:
        context.add_cookies(server.cookies)
        page = context.new_page()
        page.goto(server.url.split("?")[0])
        page.wait_for_function("() => window.__carina?.state.tree != null && window.__carina.state.route !== null")
        before = page.evaluate(f"() => {ROUTE_END}")
        page.get_by_role("button", name="Airways", exact=True).first.tap()
        row = page.locator(".branch-tree [data-branch]").nth(3)
        chosen = int(row.get_attribute("data-branch"))
        scroll_list_to(row).tap()
        page.wait_for_function(
            f"(id) => window.__carina.state.tree.byId.get({ROUTE_END}).row[0].branch.id === id", arg=chosen
        )
        assert page.evaluate(f"() => {ROUTE_END}") != before
        canvas = page.locator("canvas[data-view=tree]")
        page.get_by_test_id("view-tab-outside").tap()
        page.wait_for_function(
            """() => {
                const tree = document.querySelector('canvas[data-view=tree]');
                return tree.dataset.full === 'true' && tree.getBoundingClientRect().right <= innerWidth + 1;
            }"""
        )
        trachea = 0
        box = canvas.bounding_box()
        page.touchscreen.tap(box["x"] + 0.5 * box["width"], box["y"] + 0.25 * box["height"])
        page.wait_for_function(f"(id) => {ROUTE_END} === id", arg=trachea)
    finally:
        context.close()
