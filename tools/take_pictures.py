"""Take the README's screenshots and the start page's pictures from the bundled cases, in a real browser.

Run after a visible change: ``.venv/bin/python tools/take_pictures.py``, then look at every picture before a commit.
Pictures show the bundled CC BY case or the phantom only, never another patient.
"""

from __future__ import annotations

import base64
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests" / "e2e"), str(ROOT / "tools")]

from playwright.sync_api import Playwright, sync_playwright  # noqa: E402
from server_process import start_server, stop_server  # noqa: E402
from workstation import FLAGS, Workstation  # noqa: E402

from find_browser import find_browser  # noqa: E402

# Case, place along the first route (share of its length), picture.
SHOTS = (("patient", 0.36, "workstation-patient"),)
# The start page shows each bundled case as the tip sees its carina.
DEMOS = ("phantom", "patient")
DEMO_SIZE = (392, 294)
DEMO_MAX_BYTES = 60_000
# The middle of the airway view's picture, scaled into the card; JPEG at the quality that the card needs.
CARD = """([width, height]) => {
    const from = document.querySelector('canvas[data-view=airway]');
    const card = document.createElement('canvas');
    card.width = width;
    card.height = height;
    const scale = Math.max(width / from.width, height / from.height);
    const [w, h] = [width / scale, height / scale];
    const context = card.getContext('2d');
    context.imageSmoothingQuality = 'high';
    context.drawImage(from, (from.width - w) / 2, (from.height - h) / 2, w, h, 0, 0, width, height);
    return card.toDataURL('image/jpeg', 0.86).split(',')[1];
}"""


@contextmanager
def open_case(playwright: Playwright, browser_path: str, case: str, out: Path) -> Iterator[Workstation]:
    """A bundled case in a fresh browser and a fresh home."""
    with tempfile.TemporaryDirectory() as home:
        server = start_server(["demo", case], Path(home))
        browser = playwright.chromium.launch(executable_path=browser_path, args=FLAGS)
        try:
            station = Workstation(browser.new_page(viewport={"width": 1440, "height": 900}, device_scale_factor=1), out)
            station.open(server)
            station.wait_ready()
            yield station
        finally:
            browser.close()
            stop_server(server)


def main() -> int:
    """Write ``docs/pictures/*.png`` and ``web/public/demo-*.jpg``."""
    browser_path = find_browser()
    if browser_path is None:
        sys.exit("no Chromium or Chrome found")
    out = ROOT / "docs" / "pictures"
    out.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        for case, share, name in SHOTS:
            with open_case(playwright, browser_path, case, out) as station:
                station.go_to(share * station.state("route.length_mm"))
                station.wait_still()
                # The small views follow the tip a moment later.
                station.page.wait_for_timeout(1500)
                print(station.picture(name))
        for case in DEMOS:
            with open_case(playwright, browser_path, case, out) as station:
                station.go_to(station.state("route.lookouts_mm[0]"))
                station.wait_still()
                data = base64.b64decode(station.page.evaluate(CARD, DEMO_SIZE))
                if len(data) > DEMO_MAX_BYTES:
                    sys.exit(f"the picture of {case} takes {len(data)} bytes, more than {DEMO_MAX_BYTES}")
                path = ROOT / "web" / "public" / f"demo-{case}.jpg"
                path.write_bytes(data)
                print(path, len(data))
    return 0


if __name__ == "__main__":
    sys.exit(main())
