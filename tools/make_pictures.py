"""Make the pictures of the window for the README and the start page, in a real browser.

Run after a visible change: ``.venv/bin/python tools/make_pictures.py``, then look at every picture before a commit.
Each picture of the window contains a stamp, in a comment that no viewer shows: the positions and colours of the
window's elements. ``tests/e2e/test_documentation_pictures.py`` compares the stamp with the present window.
Pictures show only the bundled CC BY case or the phantom, never another patient. (The gallery's pictures are golden
images of ``examples/02_gallery``, and those of ``docs/cluster.md`` come from ``carina bench cluster``.)
"""

from __future__ import annotations

import base64
import json
import struct
import sys
import tempfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [
    path for path in (str(ROOT / "tests"), str(ROOT / "tests" / "e2e"), str(ROOT / "tools")) if path not in sys.path
]

from playwright.sync_api import sync_playwright  # noqa: E402
from server_process import Host  # noqa: E402
from workstation import FLAGS, Workstation, open_page  # noqa: E402

from find_browser import find_browser  # noqa: E402

COMMAND = ".venv/bin/python tools/make_pictures.py"
"""Command that makes the pictures again; it is named in the message about pictures that are out of date."""
MAX_BYTES = 400_000
"""Maximum size of a picture of the window, bytes."""
QUALITY = 90
"""JPEG quality of the pictures, 0 to 100."""


@dataclass(frozen=True)
class Shot:
    """Picture of the whole window that is made for a page."""

    path: str
    """Path of the picture's file in the repository."""
    case: str
    ahead_mm: float
    """Distance of the scope's tip before the first fork of the route, mm."""


SHOTS = (Shot("docs/pictures/workstation-patient.jpg", "patient", 25.0),)
"""Pictures of the whole window that are made for the documentation."""

DEMOS = ("phantom", "patient")
"""Bundled cases for which the start page shows the view of their carina."""
DEMO_SIZE = (392, 294)
"""Width and height of a picture of the start page, pixels."""
DEMO_MAX_BYTES = 60_000
"""Maximum size of a picture of the start page, bytes."""
CARD = """([width, height]) => {
    const from = document.querySelector('canvas[data-view=airway]');
    const card = document.createElement('canvas');
    card.width = width;
    card.height = height;
    const w = 0.72 * from.width, h = w * height / width;
    const context = card.getContext('2d');
    context.imageSmoothingQuality = 'high';
    context.drawImage(from, (from.width - w) / 2, (from.height - h) / 2, w, h, 0, 0, width, height);
    return card.toDataURL('image/jpeg', 0.86).split(',')[1];
}"""
"""Script that returns the centre of the airway view, inside its round edge, scaled to a card of the start page."""

PARTS = """() => {
    const withoutNumbers = (words) => words.replace(/(?<![A-Za-z\\d+.])\\d+(\\.\\d+)?/g, '#');
    const inSight = (element) => {
        const box = element.getBoundingClientRect();
        let [left, top, right, bottom] = [box.left, box.top, box.right, box.bottom];
        for (let outer = element.parentElement; outer !== null; outer = outer.parentElement) {
            if (getComputedStyle(outer).overflow === 'visible') continue;
            const clip = outer.getBoundingClientRect();
            [left, top] = [Math.max(left, clip.left), Math.max(top, clip.top)];
            [right, bottom] = [Math.min(right, clip.right), Math.min(bottom, clip.bottom)];
        }
        // Half of it: a row that is cut at the list's end may be so by one pixel more or less.
        return right - left > box.width / 2 && bottom - top > box.height / 2 && box.width > 1 && box.height > 1;
    };
    const parts = [];
    for (const element of document.querySelectorAll('body *')) {
        const icon = element instanceof SVGSVGElement;
        if (!icon && !(element instanceof HTMLElement)) continue;
        const own = [...element.childNodes].filter((node) => node.nodeType === Node.TEXT_NODE);
        const text = icon ? '' : withoutNumbers(own.map((node) => node.data).join(' ').trim());
        const kind = icon ? 'icon' : element.dataset.view ?? element.getAttribute('role') ?? element.localName;
        const speaks = text !== '' || icon || ['canvas', 'button', 'input', 'select'].includes(element.localName);
        // The code in the title is random, and the button beside the title moves with it.
        if (!speaks || element.closest('.status-bar, .case-title, .saved') || element.dataset.overlay) continue;
        if (!element.checkVisibility({opacityProperty: true, visibilityProperty: true}) || !inSight(element)) continue;
        const { x, y, width, height } = element.getBoundingClientRect();
        const { color, backgroundColor, fontSize, fontWeight } = getComputedStyle(element);
        const drawn = icon ? element.innerHTML.length : 0;
        const label = withoutNumbers(element.getAttribute('aria-label') ?? '');
        parts.push({
            what: [kind, text || label, drawn || ''].join(' ').trim(),
            look: [color, backgroundColor, fontSize, fontWeight].join(' '),
            box: [x, y, width, height].map(Math.round),
        });
    }
    return parts;
}"""
"""Script that returns position and text of every visible element that a user reads or presses.

Numbers outside names (RB10 is a name) are replaced, because they are measured and their last digit may differ between
processors. The status bar is excluded because it describes the machine.
"""
FONT = """() => {
    const context = document.createElement('canvas').getContext('2d');
    context.font = `100px ${getComputedStyle(document.body).fontFamily}`;
    return Math.round(context.measureText('Left lower lobe 0123456789').width);
}"""
"""JavaScript that returns the width of a sample text; pictures made with other fonts on another machine differ."""
BOX_TOLERANCE_PX = 12
"""Maximum change in pixels of an element's position or size that counts as no change: the width of one digit."""
COLOUR_TOLERANCE = 10
"""Maximum change of an element's mean colour (0 to 255) that counts as no change: the effect of rounding."""


def at_rest(station: Workstation, shot: Shot) -> None:
    """Put a new window with the shot's case into the state of the picture, and wait until its views are final."""
    station.wait_ready()
    station.go_to(station.state("route.spans[0].to_mm") - shot.ahead_mm)
    wait_pictures(station)


def wait_pictures(station: Workstation) -> None:
    """Wait until the pictures of every view are final, also those of small views, which follow the tip with a delay."""
    station.wait_still()
    before = None
    while True:
        for view in station.shown_views():
            station.wait_picture(view)
        frames = [station.frame(view)["frame_id"] for view in station.shown_views()]
        if frames == before:
            return
        before = frames
        station.settle()


def stamp_of(station: Workstation) -> dict[str, Any]:
    """Return the stamp of the present window: its elements, and the colours of each view on a grid of 4 x 4."""
    page = station.page
    colours = {view: coarse(station.pixels(view)) for view in station.shown_views()}
    return {"font": page.evaluate(FONT), "parts": page.evaluate(PARTS), "colours": colours}


def coarse(pixels: list[int]) -> list[int]:
    """Return the mean red, green and blue of each field of 8 x 8 pixels in an RGBA picture of 32 x 32 pixels."""
    cells = [(row, column) for row in range(4) for column in range(4)]
    inner = [(y, x) for y in range(8) for x in range(8)]
    return [
        round(sum(pixels[4 * (32 * (8 * row + y) + 8 * column + x) + channel] for y, x in inner) / 64)
        for row, column in cells
        for channel in range(3)
    ]


def changes(then: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """Return a line for each visible change between two stamps; no line if the picture is current."""
    lines = []
    old, new = ([(part["what"], part["look"]) for part in stamp["parts"]] for stamp in (then, now))
    if old != new:
        lines += [f"gone: {what} ({look})" for what, look in old if (what, look) not in new]
        lines += [f"new: {what} ({look})" for what, look in new if (what, look) not in old]
        return lines or ["the parts of the window stand in another order or number"]
    if then["font"] == now["font"]:
        for was, part in zip(then["parts"], now["parts"], strict=True):
            if max(abs(a - b) for a, b in zip(was["box"], part["box"], strict=True)) > BOX_TOLERANCE_PX:
                lines.append(f"moved: {part['what']}, from {was['box']} to {part['box']}")
    if set(then["colours"]) != set(now["colours"]):
        return [*lines, f"views: {sorted(then['colours'])} before, {sorted(now['colours'])} now"]
    for view, seen in now["colours"].items():
        most = max(abs(a - b) for a, b in zip(then["colours"][view], seen, strict=True))
        if most > COLOUR_TOLERANCE:
            lines.append(f"the picture of the view {view!r} differs by {most} of 255 in places")
    return lines


# Kinds of two JPEG segments: start of the pixels, and comment (ITU-T T.81, B.1.1.4 and B.2.4.5).  Before the pixels a
# JPEG consists of segments: 0xFF, a kind, a length that includes its own two bytes, and data.
START_OF_SCAN, COMMENT = 0xDA, 0xFE
KEYWORD = b"Carina window\0"
"""Start of the JPEG comment that contains the stamp of a picture."""


def segments(jpeg: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Yield the kind, the position and the data of each segment of a JPEG before its pixels."""
    at = 2
    while jpeg[at + 1] != START_OF_SCAN:
        (size,) = struct.unpack_from(">H", jpeg, at + 2)
        yield jpeg[at + 1], at, jpeg[at + 4 : at + 2 + size]
        at += 2 + size


def with_stamp(jpeg: bytes, stamp: dict[str, Any]) -> bytes:
    """Return a JPEG with a stamp as a comment after the JFIF header, which must be the first segment."""
    data = KEYWORD + zlib.compress(json.dumps(stamp, separators=(",", ":")).encode(), 9)
    _, at, header = next(segments(jpeg))
    end = at + 4 + len(header)
    return jpeg[:end] + struct.pack(">BBH", 0xFF, COMMENT, len(data) + 2) + data + jpeg[end:]


def stamp_in(jpeg: bytes) -> dict[str, Any] | None:
    """Return the stamp of a JPEG; None if it has none."""
    for kind, _, data in segments(jpeg):
        if kind == COMMENT and data.startswith(KEYWORD):
            stamp: dict[str, Any] = json.loads(zlib.decompress(data[len(KEYWORD) :]))
            return stamp
    return None


def save(path: Path, data: bytes, max_bytes: int) -> None:
    """Write a picture; raise an error if it has more than ``max_bytes`` bytes."""
    if len(data) > max_bytes:
        sys.exit(f"{path} would take {len(data)} bytes, more than {max_bytes}")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    print(path.relative_to(ROOT), len(data))


def main() -> int:
    """Make the pictures of ``SHOTS`` and ``web/public/demo-*.jpg`` and write them."""
    browser_path = find_browser()
    if browser_path is None:
        sys.exit("no Chromium or Chrome found")
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as home:
        browser = playwright.chromium.launch(executable_path=browser_path, args=FLAGS)
        host = Host(Path(home))
        for shot in SHOTS:
            server = host.open(demo=shot.case)
            station = open_page(browser)
            station.open(server)
            at_rest(station, shot)
            jpeg = station.page.screenshot(type="jpeg", quality=QUALITY)
            save(ROOT / shot.path, with_stamp(jpeg, stamp_of(station)), MAX_BYTES)
            station.page.context.close()
            host.close(server)
        for case in DEMOS:
            server = host.open(demo=case)
            station = open_page(browser)
            station.open(server)
            station.wait_ready()
            station.go_to(station.state("route.lookouts_mm[0]"))
            station.wait_still()
            card = base64.b64decode(station.page.evaluate(CARD, DEMO_SIZE))
            save(ROOT / "web" / "public" / f"demo-{case}.jpg", card, DEMO_MAX_BYTES)
            station.page.context.close()
            host.close(server)
        browser.close()
        return host.end()


if __name__ == "__main__":
    sys.exit(main())
