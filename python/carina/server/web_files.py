"""The built client's files."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

__all__ = ["asset_path", "web_folder"]


def web_folder() -> Path | None:
    """Where the built client lies, or None if it was not built."""
    folder = Path(str(files("carina"))) / "_web"
    return folder if (folder / "index.html").is_file() else None


def asset_path(web: Path | None, name: str) -> Path | None:
    """A file below the client's folder; None for anything else."""
    if web is None or "\0" in name:
        return None
    try:
        path = (web / name).resolve()
        return path if path.is_relative_to(web.resolve()) and path.is_file() else None
    except OSError:
        # A name that no file system takes: too long, or of too many parts.
        return None
