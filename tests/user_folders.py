"""Environment for a Carina process in a test, with temporary user folders."""

from __future__ import annotations

import os
from pathlib import Path

KINDS = ("CACHE", "CONFIG", "DATA", "STATE")


def user_folders(home: Path) -> dict[str, str]:
    """Return the environment variables that ``platformdirs`` reads, with folders below ``home``."""
    return {f"XDG_{kind}_HOME": str(home / kind.lower()) for kind in KINDS}


def environment_in(home: Path) -> dict[str, str]:
    """Return the environment of the test process with user folders below ``home``."""
    return {**os.environ, **user_folders(home)}
