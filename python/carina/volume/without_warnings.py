"""Suppression of warnings in one thread only, because warnings of pydicom quote values of patients."""

from __future__ import annotations

import contextlib
import threading
import warnings
from collections.abc import Iterator
from contextvars import ContextVar
from typing import Any

__all__ = ["without_warnings"]

_is_quiet = ContextVar("_is_quiet", default=False)


class _InQuietBlock:
    """Pattern of a filter of warnings that matches every message within a block of :func:`without_warnings`."""

    def match(self, _message: str) -> bool:
        """Return whether this thread is in such a block."""
        return _is_quiet.get()


_FILTER: Any = ("ignore", _InQuietBlock(), Warning, None, 0)
_lock = threading.Lock()


@contextlib.contextmanager
def without_warnings() -> Iterator[None]:
    """Suppress warnings of this thread during the block; threads that the block starts are not included.

    ``warnings.catch_warnings`` replaces the filters of all threads: a block in one thread would silence the others, and
    its end would remove a filter that another thread still needs. So one filter is installed permanently, and matches
    only in threads that are in such a block.

    Examples
    --------
    >>> import warnings
    >>> from carina.volume.without_warnings import without_warnings
    >>> with without_warnings():
    ...     warnings.warn("a value of a patient")
    """
    filters: Any = warnings.filters
    if not filters or filters[0] is not _FILTER:
        with _lock:
            # Other code may have inserted a filter before this one, or removed all filters.
            filters[:] = [_FILTER, *(one for one in filters if one is not _FILTER)]
    token = _is_quiet.set(True)
    try:
        yield
    finally:
        _is_quiet.reset(token)
