"""A real browser, and a page that remembers every error it logged."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from workstation import FLAGS, PICTURE_MS, Workstation

from find_browser import find_browser

sync_api = pytest.importorskip("playwright.sync_api")

OUT = Path(__file__).resolve().parents[1] / "out" / "e2e"


@pytest.fixture(scope="module")
def browser() -> Iterator[object]:
    """One browser a file: Playwright keeps an event loop in this thread, which later tests must find free."""
    path = find_browser()
    if path is None:
        pytest.skip("needs a Chromium or Chrome (Debian package: chromium)")
    sync_api.expect.set_options(timeout=PICTURE_MS)
    with sync_api.sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=path, args=FLAGS)
        yield launched
        launched.close()


@pytest.fixture
def workstation(browser, request) -> Iterator[Workstation]:
    """A page at the pinned size and pixel ratio; a screenshot is left where the test failed or asked for one."""
    context = browser.new_context(viewport={"width": 1440, "height": 900}, device_scale_factor=1)
    context.set_default_timeout(PICTURE_MS)
    OUT.mkdir(parents=True, exist_ok=True)
    station = Workstation(context.new_page(), OUT)
    yield station
    station.picture(f"{request.node.name}-end")
    context.close()
