"""The environment of a Carina that a test starts, in which the person's own folders are temporary."""

from __future__ import annotations

import os
from pathlib import Path

KINDS = ("CACHE", "CONFIG", "DATA", "STATE")


def own_folders(home: Path) -> dict[str, str]:
    """What ``platformdirs`` reads, below ``home``."""
    return {f"XDG_{kind}_HOME": str(home / kind.lower()) for kind in KINDS}


def environment_in(home: Path) -> dict[str, str]:
    """This process's environment, with own folders."""
    return {**os.environ, **own_folders(home)}
