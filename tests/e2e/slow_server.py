"""``carina`` with an airway view that takes long for as long as a file exists: ``slow_server.py FILE ARGUMENTS...``."""

from __future__ import annotations

import importlib
import sys
import time
from pathlib import Path
from typing import Any

from carina import cli, render
from carina.render import AirwayView

SLOW = Path(sys.argv.pop(1))
PER_PIXEL_S = 0.4 / (150 * 150)
"""The coarsest picture of a cell of 600 pixels takes 0.4 s: too slow for 5 pictures a second."""


class SlowRenderer(render.Renderer):
    """Takes its time for every ray of an airway view, and can be stopped meanwhile."""

    def render(self, view: Any, *, stop: Any = None, **options: Any) -> Any:
        if isinstance(view, AirwayView) and SLOW.exists():
            end_s = time.monotonic() + min(PER_PIXEL_S * view.width * view.height, 1.5)
            while time.monotonic() < end_s and not (stop is not None and stop.cancelled):
                time.sleep(0.002)
        return super().render(view, stop=stop, **options)


def slow_factory() -> Any:
    """In the place of ``carina.server.serve._renderer_factory``."""
    return lambda volume, transfer: SlowRenderer(volume, transfer=transfer)


if __name__ == "__main__":
    # The package hands on a function of the module's name.
    importlib.import_module("carina.server.serve")._renderer_factory = slow_factory
    cli.main()
