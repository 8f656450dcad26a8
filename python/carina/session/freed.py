"""Return of freed memory to the operating system."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from functools import cache

__all__ = ["give_freed_memory_back"]


@cache
def _trim() -> Callable[[int], int] | None:
    if not sys.platform.startswith("linux"):
        return None
    try:
        return ctypes.CDLL(None).malloc_trim
    except (OSError, AttributeError):
        # C libraries other than glibc have no malloc_trim.
        return None


def give_freed_memory_back() -> None:
    """Return freed memory to the operating system (malloc_trim).

    After a large job glibc retains half a volume of freed memory, to which the next job would add. The call takes a
    few milliseconds.
    """
    trim = _trim()
    if trim is not None:
        trim(0)
