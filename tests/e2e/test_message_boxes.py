"""Tests of the boxes with errors and notices: what they cover, and their advice."""

from __future__ import annotations

import pytest

pytestmark = pytest.mark.browser

SIZES = [(1280, 720), (1440, 900), (1920, 1080), (820, 1180)]
COVERED = """() => {
    const list = document.querySelector('.messages').getBoundingClientRect();
    return [...document.querySelectorAll('.top-bar, .cell > header, .tools, .plan-answer, .path-bar, .status-bar')]
        .filter((bar) => {
            const one = bar.getBoundingClientRect();
            return one.height > 0 && one.left < list.right && list.left < one.right
                && one.top < list.bottom && list.top < one.bottom;
        }).map((bar) => bar.closest('.cell')?.dataset.cell ?? bar.className);
}"""
"""Script that returns the bars and headers that the list of messages covers."""


def test_messages_with_their_advice_cover_no_header_in_any_window_size(server, workstation):
    page = workstation.page
    page.set_viewport_size({"width": SIZES[0][0], "height": SIZES[0][1]})
    workstation.open(server)
    workstation.wait_ready()
    page.get_by_role("button", name="Open", exact=True).click()
    field = page.get_by_placeholder("/", exact=False).first
    for n in range(3):
        field.fill(f"/no/such/folder/{n}")
        field.press("Enter")
        page.locator(".message.error", has_text=f"folder/{n}").wait_for(state="attached")
    assert all("check the path" in text for text in page.locator(".message.error").all_inner_texts())
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        workstation.refreshes(3)
        assert page.evaluate(COVERED) == [], (width, height)
        workstation.picture(f"messages-{width}")
        if width < 1024:
            continue
        for name in ("Axial", "Airway view"):
            if name == "Axial":
                page.get_by_role("region", name=name).get_by_role("button", name="Full view").click()
            else:
                workstation.click_airway(0.5, 0.2, twice=True)
            workstation.wait_for("window.__carina.state.ui.full !== null")
            workstation.refreshes(2)
            assert page.evaluate(COVERED) == [], (width, height, name)
            workstation.picture(f"messages-{width}-{name}")
            page.evaluate("() => document.activeElement.blur()")
            page.keyboard.press("Escape")
            workstation.wait_for("window.__carina.state.ui.full === null")
    for _ in range(3):
        page.get_by_role("button", name="I have read this").first.click()
    assert page.locator(".message").count() == 0

    # A notice disappears after some seconds; until then clicks reach the picture below it.
    page.keyboard.press("o")
    page.keyboard.press("Control+z")
    notice = page.locator(".message.notice").first
    notice.wait_for()
    below = notice.evaluate(
        """(notice) => {
            const { x, y, width, height } = notice.getBoundingClientRect();
            return document.elementFromPoint(x + width / 2, y + height / 2).closest('.message') === null;
        }"""
    )
    assert below
    assert workstation.faults == []
