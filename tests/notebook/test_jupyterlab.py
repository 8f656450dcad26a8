"""`carina.show` in a real JupyterLab: pictures, mouse and keyboard, and a change by another cell.

``make soak`` installs JupyterLab in a separate environment and sets ``CARINA_JUPYTER`` to the path of ``jupyter``.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from find_browser import find_browser

sync_api = pytest.importorskip("playwright.sync_api")

JUPYTER = os.environ.get("CARINA_JUPYTER")
pytestmark = [
    pytest.mark.soak,
    pytest.mark.skipif(JUPYTER is None, reason="CARINA_JUPYTER does not name a program jupyter"),
]

TOKEN = "token-of-this-test"
WAIT_MS = 180_000
CELLS = (
    "import carina\nphantom = carina.generate_phantom(spacing_mm=3.0, generations=3)\n"
    "view = carina.show(phantom.volume)\nview",
    "from carina.commands import SetTexture\nview.case.do(SetTexture(on=False))",
)


@pytest.fixture
def lab(tmp_path):
    """Start JupyterLab with a notebook on loopback, and return the address of the notebook."""
    folder = tmp_path / "work"
    folder.mkdir()
    cells = [
        {"cell_type": "code", "execution_count": None, "id": f"c{n}", "metadata": {}, "outputs": [], "source": text}
        for n, text in enumerate(CELLS)
    ]
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    content = {"cells": cells, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}
    (folder / "show.ipynb").write_text(json.dumps(content))
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    folders = {name: str(tmp_path / name) for name in ("JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR")}
    # The kernel's environment has only JupyterLab and anywidget; it reads Carina from the environment of the tests.
    paths = os.pathsep.join(path for path in sys.path if path)
    words = [
        str(JUPYTER), "lab", "--no-browser", "--allow-root", "--ip=127.0.0.1", f"--port={port}",
        "--ServerApp.port_retries=0", f"--IdentityProvider.token={TOKEN}", "--notebook-dir", str(folder),
    ]  # fmt: skip
    with (tmp_path / "lab.log").open("w") as log:
        server = subprocess.Popen(
            words, env=os.environ | folders | {"PYTHONPATH": paths}, stdout=log, stderr=subprocess.STDOUT
        )
    try:
        until = time.monotonic() + WAIT_MS / 1000
        while True:
            try:
                urllib.request.urlopen(f"http://127.0.0.1:{port}/api", timeout=5.0).close()
                break
            except (urllib.error.URLError, ConnectionError, TimeoutError):
                assert time.monotonic() < until, Path(tmp_path / "lab.log").read_text()
                assert server.poll() is None, Path(tmp_path / "lab.log").read_text()
                time.sleep(0.2)
        yield f"http://127.0.0.1:{port}/lab/tree/show.ipynb?token={TOKEN}"
    finally:
        server.terminate()
        server.wait(60)


@pytest.fixture
def page():
    browser = find_browser()
    if browser is None:
        pytest.skip("no Chromium or Chrome is installed")
    with sync_api.sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=browser, args=["--no-sandbox"])
        yield opened.new_page(viewport={"width": 1440, "height": 1000})
        opened.close()


def answers(page):
    return int(page.locator(".carina-case-view").get_attribute("data-shown"))


def wait_for_answer(page, before):
    page.wait_for_function(
        "n => Number(document.querySelector('.carina-case-view').dataset.shown) > n", arg=before, timeout=WAIT_MS
    )
    # The still picture follows the last movement.
    page.wait_for_timeout(1000)


def pixels(page, view):
    """Return the picture of a view as a data URL."""
    return page.evaluate(f"document.querySelector('[data-view={view}] canvas').toDataURL()")


def test_views_show_the_case_and_follow_mouse_keyboard_and_other_cells(lab, page):
    page.goto(lab, timeout=WAIT_MS)
    page.locator(".jp-Cell").first.click(timeout=WAIT_MS)
    page.keyboard.press("Shift+Enter")
    page.locator(".carina-case-view[data-shown]").wait_for(timeout=WAIT_MS)
    page.locator(".carina-case-view").scroll_into_view_if_needed()
    page.wait_for_timeout(1000)
    assert "Trachea" in page.locator(".carina-case-view .line").inner_text()

    before, number = {view: pixels(page, view) for view in ("airway", "axial")}, answers(page)
    box = page.locator("[data-view=airway] canvas").bounding_box()
    page.mouse.move(box["x"] + 100, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 140, box["y"] + 110, steps=4)
    page.mouse.up()
    wait_for_answer(page, number)
    turned = pixels(page, "airway")
    assert turned != before["airway"]

    number = answers(page)
    page.keyboard.press("w")
    page.keyboard.press("w")
    wait_for_answer(page, number)
    assert pixels(page, "axial") != before["axial"]

    number = answers(page)
    box = page.locator("[data-view=coronal] canvas").bounding_box()
    coronal, sagittal = pixels(page, "coronal"), pixels(page, "sagittal")
    page.mouse.click(box["x"] + 0.6 * box["width"], box["y"] + 0.6 * box["height"])
    wait_for_answer(page, number)
    assert pixels(page, "sagittal") != sagittal
    assert pixels(page, "coronal") != coronal

    airway, number = pixels(page, "airway"), answers(page)
    page.locator(".jp-Cell").nth(1).click()
    page.keyboard.press("Shift+Enter")
    wait_for_answer(page, number)
    assert pixels(page, "airway") != airway
    assert page.locator(".carina-case-view .message").inner_text() == ""
