"""Take the README's screenshots from the bundled cases, in a real browser.

Run after a visible change: ``.venv/bin/python tools/take_pictures.py``, then look at every picture before a commit.
Pictures show the bundled CC BY case or the phantom only, never another patient.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests" / "e2e"), str(ROOT / "tools")]

from playwright.sync_api import sync_playwright  # noqa: E402
from server_process import start_server, stop_server  # noqa: E402
from workstation import FLAGS, Workstation  # noqa: E402

from find_browser import find_browser  # noqa: E402

# Case, place along the first route (share of its length), picture.
SHOTS = (("patient", 0.36, "workstation-patient"),)


def main() -> int:
    """Write ``docs/pictures/*.png``."""
    browser_path = find_browser()
    if browser_path is None:
        sys.exit("no Chromium or Chrome found")
    out = ROOT / "docs" / "pictures"
    out.mkdir(parents=True, exist_ok=True)
    for case, share, name in SHOTS:
        with tempfile.TemporaryDirectory() as home, sync_playwright() as playwright:
            server = start_server(["demo", case], Path(home))
            browser = playwright.chromium.launch(executable_path=browser_path, args=FLAGS)
            page = browser.new_page(viewport={"width": 1440, "height": 900}, device_scale_factor=1)
            station = Workstation(page, out)
            try:
                station.open(server)
                station.wait_ready()
                station.go_to(share * station.state("route.length_mm"))
                station.wait_still()
                # The small views follow the tip a moment later.
                page.wait_for_timeout(1500)
                print(station.picture(name))
            finally:
                browser.close()
                stop_server(server)
    return 0


if __name__ == "__main__":
    sys.exit(main())
