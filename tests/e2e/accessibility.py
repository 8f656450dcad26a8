"""Rules of WCAG 2.2 (levels A and AA) and of good practice, checked in an open page by axe-core."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

AXE = Path(__file__).resolve().parents[2] / "web" / "node_modules" / "axe-core" / "axe.min.js"
"""Script of axe-core, a development dependency of the web client."""
# A tooltip is no part of a landmark; it repeats the description of the button with the focus. The emulated headset adds
# its own element to the page.
RUN = """async () => {
    const exclude = [['[data-overlay-container]:has([role=tooltip])'], ['[data-webxr_runtime]']];
    const found = await window.axe.run({ exclude }, { resultTypes: ['violations'] });
    return found.violations.flatMap(({ id, nodes }) => nodes.map(({ html, failureSummary }) =>
        `${id}: ${html.slice(0, 160)}: ${failureSummary.replace(/\\s+/g, ' ').slice(0, 200)}`));
}"""


@cache
def _script() -> str:
    return AXE.read_text()


def violations(page: Any) -> list[str]:
    """Return the violations in the present state of a page, as texts; the page's script of axe stays loaded."""
    if not page.evaluate("() => 'axe' in window"):
        page.evaluate(_script())
    found: list[str] = page.evaluate(RUN)
    return found
