"""Settings of Carina, read from the environment and the user's choices; the only module that knows the user's folders.

Other modules receive a :class:`Settings`, or a folder from it, as an argument.
"""

from __future__ import annotations

import json
import logging
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import platformdirs

from carina.display import one_line
from carina.errors import UsageError

__all__ = ["BACKENDS", "LOG_LEVELS", "PROCESSOR_NAME", "Settings", "load_settings"]

logging.addLevelName(5, "TRACE")  # Below DEBUG: messages once per frame.
LOG_LEVELS = ("TRACE", "DEBUG", "INFO", "WARNING", "ERROR")
BACKENDS = ("cpu", "gpu", "auto")
PROCESSOR_NAME = "processor.json"
"""File name, in the settings folder, of the user's choice of the processor."""
MAX_CHOICE_BYTES = 4096


@one_line
@dataclass(frozen=True, slots=True)
class Settings:
    """Settings from the environment and the machine; the folders may not exist until a writer creates them."""

    log_level: str
    """Log level, one of :data:`LOG_LEVELS`: ``CARINA_LOG_LEVEL``, else WARNING."""
    data_dir: Path | None
    """Folder of real cases for tests and benchmarks: ``CARINA_DATA_DIR``, else None."""
    backend: str
    """Processor of airway views, one of :data:`BACKENDS`: ``CARINA_BACKEND``, else the user's choice, else auto.

    ``auto`` uses a graphics device if it was measured to be faster than the CPU.
    """
    config_dir: Path
    """Folder of the user's choices (the safety notice, recent cases)."""
    cases_dir: Path
    """Folder of the user's cases, which are never deleted automatically."""
    learners_dir: Path
    """Folder of the learners of the training's course and of their attempts: ``CARINA_LEARNERS_DIR``, else local.

    Several machines of a classroom may use one folder on a file server.
    """
    tasks_dir: Path
    """Folder of the tasks of the training that teachers write."""
    retrieved_dir: Path
    """Folder of the series that the window retrieved from a PACS; never deleted automatically."""
    documents_dir: Path
    """Suggested folder for copies of a case."""
    state_dir: Path
    """Folder of unfinished work that must survive a crash (autosaves)."""
    cache_dir: Path
    """Folder of data that can be computed again (the phantom, IsoRegion maps, opened CTs).

    May be deleted at any time.
    """
    is_backend_forced: bool = False
    """Whether ``CARINA_BACKEND`` is set, so that the user's choice has no effect."""
    volume_cache_bytes: int | None = None
    """Limit of the cached CTs in bytes, ``CARINA_CACHE_GB``.

    0 caches none; None uses the default of ``VolumeCache``.
    """


def load_settings(environ: Mapping[str, str] | None = None) -> Settings:
    """Read the settings of this process.

    Parameters
    ----------
    environ
        Mapping to read instead of ``os.environ``, for tests.

    Raises
    ------
    UsageError
        If ``CARINA_LOG_LEVEL`` is not a level, ``CARINA_BACKEND`` not a backend, or ``CARINA_CACHE_GB`` not a size.
    """
    values = os.environ if environ is None else environ
    level = values.get("CARINA_LOG_LEVEL", "").strip().upper() or "WARNING"
    if level not in LOG_LEVELS:
        msg = f"CARINA_LOG_LEVEL must be one of {', '.join(LOG_LEVELS)}; found {level!r}"
        raise UsageError(msg, code="usage.log-level")
    forced = values.get("CARINA_BACKEND", "").strip().lower()
    dirs = platformdirs.PlatformDirs("carina", appauthor=False)
    backend = forced or _chosen_backend(dirs.user_config_path / PROCESSOR_NAME)
    if backend not in BACKENDS:
        msg = f"CARINA_BACKEND must be one of {', '.join(BACKENDS)}; found {backend!r}"
        raise UsageError(msg, code="usage.backend")
    data_dir = values.get("CARINA_DATA_DIR", "").strip()
    learners = values.get("CARINA_LEARNERS_DIR", "").strip()
    return Settings(
        log_level=level,
        data_dir=Path(data_dir).expanduser() if data_dir else None,
        backend=backend,
        is_backend_forced=bool(forced),
        config_dir=dirs.user_config_path,
        cases_dir=dirs.user_data_path / "cases",
        learners_dir=Path(learners).expanduser() if learners else dirs.user_data_path / "learners",
        tasks_dir=dirs.user_data_path / "tasks",
        retrieved_dir=dirs.user_data_path / "retrieved",
        documents_dir=dirs.user_documents_path,
        state_dir=dirs.user_state_path,
        cache_dir=dirs.user_cache_path,
        volume_cache_bytes=_gigabytes(values.get("CARINA_CACHE_GB", "").strip()),
    )


def _chosen_backend(path: Path) -> str:
    """Return the processor that the user has chosen in the window; ``auto`` without a readable choice."""
    try:
        with path.open("rb") as file:
            value = json.loads(file.read(MAX_CHOICE_BYTES))
    except (OSError, ValueError, RecursionError):
        return "auto"
    chosen = value.get("processor") if isinstance(value, dict) else None
    return chosen if chosen in BACKENDS else "auto"


def _gigabytes(text: str) -> int | None:
    if not text:
        return None
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not 0 <= number <= 1e6:
        msg = f"CARINA_CACHE_GB must be a number of gigabytes from 0 (no cache) to 1000000; found {text!r}"
        raise UsageError(msg, code="usage.cache")
    return round(number * 1e9)
