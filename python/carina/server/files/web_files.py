"""Paths of the files of the built web client."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path


def web_folder() -> Path | None:
    """Return the folder of the built web client, or None if it was not built."""
    folder = Path(str(files("carina"))) / "_web"
    return folder if (folder / "index.html").is_file() else None


def asset_path(web: Path | None, name: str) -> Path | None:
    """Return the path of a file in the folder of the web client; None for any other name."""
    if web is None or "\0" in name:
        return None
    try:
        path = (web / name).resolve()
        return path if path.is_relative_to(web.resolve()) and path.is_file() else None
    except OSError:
        # The file system rejects the name, for example because it is too long.
        return None
