"""Memory that jobs have freed goes back to the system."""

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
        # Another C library than glibc, which need not keep what is freed.
        return None


def give_freed_memory_back() -> None:
    """Give back what glibc keeps of freed memory: after a large job that is half a volume, which the next would add to.

    Takes a few milliseconds.
    """
    trim = _trim()
    if trim is not None:
        trim(0)
