"""Tests of all controls of the window: height of rows and buttons, contrast of texts, and rules of accessibility."""

from __future__ import annotations

import pytest
from test_plan import CHEST
from test_target_and_plan_display import mark_nodule
from workstation import assert_accessible

pytestmark = pytest.mark.browser

STEPS = ("Open", "Check", "Airways", "Target", "Route", "Rehearse", "Train", "Share")
OPEN_PARTS = "() => document.querySelectorAll('details:not([name])').forEach((part) => { part.open = true; })"
SMALL = """(least) => {
    const controls = 'button, [role=row], [role=option], [role=radio], a[href], summary, select, textarea, label, '
        + 'input:not([type=range]):not(label input)';
    return [...document.querySelectorAll(controls)].filter((one) => {
        const { width, height } = one.getBoundingClientRect();
        const hidden = one.closest('[aria-hidden=true], .visually-hidden') !== null
            || getComputedStyle(one.parentElement).clipPath.startsWith('inset')
            || !one.checkVisibility({ visibilityProperty: true });
        if (one.matches('label') && one.querySelector('input, select, textarea') === null) return false;
        return !hidden && width > 1 && height > 0 && height < least;
    }).map((one) => `${one.tagName}.${one.className} ${one.textContent || one.ariaLabel}`.slice(0, 90));
}"""
"""Script that returns the visible controls below a height in CSS px."""
PALE = """(least) => {
    const ink = document.createElement('canvas').getContext('2d', { willReadFrequently: true });
    const colour = (css) => {
        ink.clearRect(0, 0, 1, 1);
        ink.fillStyle = css;
        ink.fillRect(0, 0, 1, 1);
        return [...ink.getImageData(0, 0, 1, 1).data].map((part) => part / 255);
    };
    const over = (below, above) => below.map((part, n) => part * (1 - above[3]) + above[n] * above[3]);
    const luminance = (parts) => {
        const [r, g, b] = parts.map((part) => part <= 0.03928 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4);
        return 0.2126 * r + 0.7152 * g + 0.0722 * b;
    };
    const texts = [...document.querySelectorAll('body *')].filter((one) =>
        [...one.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim() !== '')
        && one.checkVisibility({ visibilityProperty: true, opacityProperty: true })
        && one.getBoundingClientRect().width > 1
        && one.closest('[data-disabled], [aria-disabled], [aria-hidden=true], .picture-host, option') === null);
    return texts.map((one) => {
        const layers = [];
        for (let at = one; at !== null; at = at.parentElement) {
            layers.unshift(colour(getComputedStyle(at).backgroundColor));
        }
        const below = layers.reduce(over, [0, 0, 0]);
        const shown = over(below, colour(getComputedStyle(one).color));
        const [light, dark] = [luminance(shown), luminance(below)].sort((a, b) => b - a);
        return [(light + 0.05) / (dark + 0.05), `${one.className} ${one.textContent}`.slice(0, 60)];
    }).filter(([contrast]) => contrast < least);
}"""
"""Script that returns the visible texts below a contrast with their background (WCAG 2), with the contrast."""


@pytest.fixture
def opens(shared_chest):
    """Return a chest with a nodule, as the opened file."""
    return shared_chest(**CHEST)


def assert_controls(workstation, state: str) -> None:
    """Check all controls and texts that are visible now."""
    workstation.page.evaluate(OPEN_PARTS)
    workstation.refreshes(2)
    assert workstation.page.evaluate(SMALL, 23.9) == [], state
    assert workstation.page.evaluate(PALE, 4.5) == [], state
    assert_accessible(workstation.page, state)


@pytest.mark.parametrize("size", [(1280, 720), (1920, 1080)])
def test_rows_and_buttons_are_24_px_high_and_texts_have_contrast_in_all_steps(server, workstation, size):
    page = workstation.page
    page.set_viewport_size({"width": size[0], "height": size[1]})
    workstation.open(server)
    workstation.wait_ready()
    assert page.locator(".branch-tree [data-selected]").count() == 1
    for step in STEPS:
        page.get_by_role("button", name=step, exact=True).first.click()
        assert_controls(workstation, step)
    mark_nodule(workstation)
    page.get_by_test_id("answer-take-route").click()
    workstation.wait_for("window.__carina.state.plans.verdicts.length > 1")
    for step in ("Target", "Route", "Rehearse"):
        page.get_by_role("button", name=step, exact=True).first.click()
        assert_controls(workstation, f"{step} with a plan")
        workstation.picture(f"controls-{step}-{size[0]}")
    label = page.get_by_test_id("all-verdicts")
    if label.count():
        page.get_by_role("button", name="Route", exact=True).first.click()
        assert "other instrument" in label.inner_text()
        label.click()
        assert_controls(workstation, "all verdicts")
    page.get_by_test_id("machine").click()
    assert_controls(workstation, "details of the machine")
    page.get_by_test_id("machine").click()
    page.get_by_test_id("open-devices").click()
    assert_controls(workstation, "devices")
    page.get_by_test_id("open-devices").click()
    workstation.show_tab("history")
    assert_controls(workstation, "history")
    workstation.show_tab("airways")
    box = page.locator("canvas[data-view=coronal]").bounding_box()
    page.mouse.click(box["x"] + 0.3 * box["width"], box["y"] + 0.7 * box["height"])
    workstation.wait_for("window.__carina.state.session.sight.crosshair_lps !== null")
    assert_controls(workstation, "slices that do not follow the tip")
    assert workstation.faults == []
