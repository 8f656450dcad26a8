"""Make the pictures of the guides (``docs/guides``) in a real browser, by doing what the guides describe.

Run after a visible change: ``.venv/bin/python tools/make_guide_pictures.py``, then look at every picture before a
commit. Every picture shows a generated chest, never a patient. A guide whose steps no longer work in the window makes
the script fail.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

from make_pictures import ROOT, save, wait_pictures  # extends the import path by the folders of the tests

from page_positions import named, place_in_slice, place_on_tree, show_slices_at, tree_is_shown  # isort: skip
from server_process import Host, Server  # isort: skip
from workstation import FLAGS, Workstation, open_page  # isort: skip

import carina
from find_browser import find_browser

FOLDER = ROOT / "docs" / "pictures" / "guides"
SIZE = {"width": 1440, "height": 900}
MAX_BYTES = 260_000
"""Largest size of a picture of a guide, bytes."""
QUALITY = 82
"""JPEG quality of the pictures, 0 to 100."""
CHEST = {"seed": 4, "spacing_mm": 1.2, "generations": 5, "nodule": True}
"""Options of the generated chest (:func:`carina.generate_phantom`) with a nodule."""


def shoot(station: Workstation, name: str, *, part: str | None = None) -> None:
    """Save a picture of the window, or of the first element that the CSS selector ``part`` finds, as ``name``.jpg."""
    where: Any = station.page if part is None else station.page.locator(part).first
    save(FOLDER / f"{name}.jpg", where.screenshot(type="jpeg", quality=QUALITY), MAX_BYTES)


def first_flight(station: Workstation) -> None:
    """Do the steps of the guide *First flight*."""
    page = station.page
    wait_pictures(station)
    shoot(station, "flight-window")
    page.keyboard.press("Space")
    station.wait_for("window.__carina.state.pose.path_mm > window.__carina.state.route.lookouts_mm[0] - 1")
    wait_pictures(station)
    shoot(station, "flight-carina")
    branch = named(station, "LLL")
    tree_is_shown(station)
    page.mouse.click(*place_on_tree(station, branch, 0.8))
    station.wait_for("(id) => window.__carina.state.route.branch_ids?.includes(id) ?? true", branch)
    wait_pictures(station)
    shoot(station, "flight-branch")
    page.keyboard.press("?")
    station.settle()
    shoot(station, "flight-keys")
    page.keyboard.press("Escape")


def plan_a_nodule(station: Workstation, nodule_lps: list[float]) -> None:
    """Do the steps of the guide *Plan a nodule*."""
    page = station.page
    page.get_by_role("button", name="Target", exact=True).first.click()
    show_slices_at(station, nodule_lps)
    wait_pictures(station)
    page.get_by_test_id("arm-target").click()
    x, y = place_in_slice(station, "axial", nodule_lps)
    page.mouse.move(x, y)
    station.settle()
    shoot(station, "plan-nodule")
    page.mouse.click(x, y)
    station.wait_for("window.__carina.state.plans.targets[0].routes.length > 0")
    wait_pictures(station)
    shoot(station, "plan-answer")
    page.get_by_test_id("answer-take-route").click()
    station.wait_while_working("window.__carina.state.plans.verdicts_standing === 'had'")
    wait_pictures(station)
    shoot(station, "plan-route")
    with page.context.expect_page() as opened:
        page.get_by_test_id("print-plan").click()
    report = opened.value
    report.wait_for_load_state("load")
    report.set_viewport_size({"width": 900, "height": 1200})
    save(FOLDER / "plan-sheet.jpg", report.screenshot(type="jpeg", quality=QUALITY), MAX_BYTES)
    report.close()


def edit_a_tree(station: Workstation) -> None:
    """Do the steps of the guide *Edit a tree*: cut a branch, add it again, and undo."""
    page = station.page
    tree_is_shown(station)
    branch = named(station, "LB6")
    points = page.evaluate("(id) => window.__carina.state.tree.byId.get(id).branch.points", branch)
    page.keyboard.press("k")
    x, y = place_on_tree(station, branch, 0.6)
    page.mouse.move(x, y)
    station.wait_for("window.__carina.state.ui.hovered?.branchId != null")
    wait_pictures(station)
    shoot(station, "edit-cut-preview")
    page.mouse.click(x, y)
    station.wait_for("() => (window.__carina.state.can_undo ?? '') !== ''")
    page.keyboard.press("Escape")
    show_slices_at(station, points[-1])
    page.keyboard.press("j")
    x, y = place_in_slice(station, "axial", points[-1])
    page.mouse.move(x, y)
    station.wait_for("() => window.__carina.state.preview?.answer?.problem === null")
    wait_pictures(station)
    shoot(station, "edit-add-preview")
    page.mouse.click(x, y)
    station.wait_for("() => (window.__carina.state.can_undo ?? '').startsWith('add')")
    page.keyboard.press("Escape")
    wait_pictures(station)
    shoot(station, "edit-done")


def main() -> int:
    """Make the pictures of the guides that the arguments name, such as ``edit-a-tree``; without arguments, of all."""
    browser_path = find_browser()
    if browser_path is None:
        sys.exit("no Chromium or Chrome found")
    chest = carina.generate_phantom(**CHEST)
    nodule_lps = [float(v) for v in chest.truth["nodule"]["centre_lps"]]
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as home:
        carina.write_phantom(chest, Path(home) / "chest")
        scan = Path(home) / "chest" / "ct.nii.gz"
        browser = playwright.chromium.launch(executable_path=browser_path, args=FLAGS)
        host = Host(Path(home))

        def on_page(server: Server, steps: Callable[[Workstation], None]) -> None:
            station = open_page(browser)
            station.page.set_viewport_size(SIZE)
            station.open(server)
            station.wait_ready()
            steps(station)
            station.page.context.close()
            host.close(server)

        guides: dict[str, Callable[[], None]] = {
            "first-flight": lambda: on_page(host.open(demo="phantom"), first_flight),
            "plan-a-nodule": lambda: on_page(host.open(path=str(scan)), lambda page: plan_a_nodule(page, nodule_lps)),
            "edit-a-tree": lambda: on_page(host.open(demo="phantom"), edit_a_tree),
        }
        for guide in sys.argv[1:] or guides:
            guides[guide]()
        browser.close()
        return host.end()


if __name__ == "__main__":
    sys.exit(main())
