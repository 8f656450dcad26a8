"""Find a Chromium or Chrome for the browser tests; ``--install`` installs Debian's Chromium if none is found."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")
"""Names under which a browser is searched on the PATH."""
PLACES = (
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
    "C:/Program Files/Google/Chrome/Application/chrome.exe",
    "C:/Program Files (x86)/Microsoft/Edge/Application/msedge.exe",
)
"""Paths of browsers outside the PATH."""
PACKAGES = ("chromium", "fonts-dejavu-core")
"""Debian packages of the browser and of a font."""


def find_browser() -> str | None:
    """Return the path of an installed browser: ``CARINA_BROWSER``, one on the PATH or in a usual folder; else None."""
    named = os.environ.get("CARINA_BROWSER")
    if named:
        return named
    found = next((path for name in NAMES if (path := shutil.which(name))), None)
    return found or next((place for place in PLACES if Path(place).exists()), None)


def install_browser() -> bool:
    """Install Debian's chromium and return whether it succeeded.

    This needs Debian and the user root; in other cases the function prints what the user can do.
    """
    apt = shutil.which("apt-get")
    if apt is None or not hasattr(os, "geteuid") or os.geteuid() != 0:
        print(
            f"no Chromium or Chrome found: the browser tests will be skipped. Install the package {PACKAGES[0]!r} "
            "(or set CARINA_BROWSER to a browser's path)",
            file=sys.stderr,
        )
        return False
    quiet = {"stdout": subprocess.DEVNULL}
    subprocess.run([apt, "update", "-q"], check=True, **quiet)
    subprocess.run([apt, "install", "-y", "-q", "--no-install-recommends", *PACKAGES], check=True, **quiet)
    return True


if __name__ == "__main__":
    if find_browser() is None and "--install" in sys.argv[1:]:
        install_browser()
    print(find_browser() or "no browser")
