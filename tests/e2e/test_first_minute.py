"""Tests of the first minute: hints that appear once, the tour, the report of a wrong branch, and the start page."""

from __future__ import annotations

import pytest
from workstation import assert_accessible, open_page

from cached_test_data import cached_phantom

pytestmark = pytest.mark.browser

CHEST = {"seed": 4, "spacing_mm": 1.2, "generations": 5, "nodule": True}


@pytest.fixture
def opens(shared_chest):
    """Return a chest with a nodule, opened by a user who has not read the hints."""
    return shared_chest(**CHEST) | {"first_use": True}


def test_hints_tour_and_wrong_branch_guide_a_new_user(server, workstation):
    page = workstation.page
    workstation.open(server)
    workstation.wait_ready()
    guide = page.get_by_test_id("guide")
    assert "Hint 1 of 3" in guide.inner_text()
    # The hint leaves the keys to the flight.
    at_mm = workstation.state("pose.path_mm")
    page.keyboard.press("Space")
    workstation.wait_for("(mm) => window.__carina.state.pose.path_mm > mm + 5", at_mm)
    page.keyboard.press("Escape")
    workstation.picture("hint-1")
    page.get_by_test_id("guide-next").click()
    assert "Hint 2 of 3" in guide.inner_text()
    page.get_by_test_id("guide-next").click()
    assert "Hint 3 of 3" in guide.inner_text()
    # The tour is read by keyboard alone, shows the steps that it explains, and can be left in between.
    step = workstation.state("ui.step")
    page.get_by_test_id("start-tour").click()
    assert "Tour, 1 of" in guide.inner_text()
    for _ in range(4):
        page.keyboard.press("Enter")
    workstation.wait_for("window.__carina.state.ui.step === 'target'")
    workstation.picture("tour-target")
    page.keyboard.press("Escape")
    workstation.wait_for("window.__carina.state.ui.tourAt === null")
    assert workstation.state("ui.step") == step
    assert guide.count() == 0

    # The hints do not return, neither in this window nor after a reload.
    page.reload()
    workstation.wait_ready()
    assert workstation.state("start.hints_read") is True
    assert guide.count() == 0

    # A rehearsal in a branch that is not on the route is reported, with the distance back to the fork.
    right, left = workstation.deepest_tip(-1.0)["id"], workstation.deepest_tip(1.0)["id"]
    workstation.choose_branch(right)
    carina_mm = workstation.state("route.forks_mm[0]")
    workstation.go_to(carina_mm + 20.0)
    page.get_by_role("button", name="Rehearse", exact=True).first.click()
    page.get_by_role("button", name="From here").click()
    workstation.wait_while_working("window.__carina.state.pose?.mode === 'scope'")
    wrong = page.get_by_test_id("wrong-branch")
    assert wrong.count() == 0
    workstation.choose_branch(left)
    wrong.wait_for()
    back_mm = workstation.state("pose.back_to_route_mm")
    assert back_mm == pytest.approx(20.0, abs=3.0)
    assert wrong.inner_text() == f"Wrong branch: you are in RMB; back {back_mm:.0f}\u202fmm"
    assert page.get_by_test_id("announcer").inner_text().startswith("Wrong branch: you are in RMB.")
    workstation.picture("wrong-branch")
    workstation.choose_branch(right)
    wrong.wait_for(state="detached")
    assert workstation.faults == []


def test_start_page_lists_nodules_and_a_closed_browser_opens_the_same_link_again(
    browser, server, workstation, request, has_failed
):
    page = workstation.page
    workstation.open(server)
    workstation.wait_ready()
    page.get_by_test_id("guide-leave").click()
    nodule = cached_phantom(**CHEST).truth["nodule"]["centre_lps"]
    page.get_by_role("button", name="Target", exact=True).first.click()
    field = page.locator("[data-testid=coordinates] input")
    field.fill(", ".join(f"{v:.3f}" for v in nodule))
    field.press("Enter")
    grow = page.get_by_role("button", name="Segment as nodule")
    lesion = page.get_by_test_id("lesion")
    grow.or_(lesion).first.wait_for()
    if grow.count():
        grow.click()
    lesion.wait_for()
    workstation.wait_for("window.__carina.state.session.saving.saved_s !== null")

    # A browser without the session cookie (browsers delete it when they close) can use the start link again.
    other = open_page(browser)
    try:
        other.page.goto(server.url)
        other.wait_ready()
        assert other.faults == []
        other.page.get_by_role("button", name="Open", exact=True).first.click()
        other.page.get_by_role("button", name="Start page").click()
        recent = other.page.get_by_test_id("recent")
        recent.wait_for()
        assert "1 nodule" in recent.inner_text()
        other.picture("start-page")
        assert_accessible(other.page, "start-page")
    finally:
        if has_failed():
            other.failed(request.node.name)
        other.page.context.close()
