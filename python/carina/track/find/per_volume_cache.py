"""Cache of a value that is computed from one volume at first use."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from carina.volume.model import Volume

Found = TypeVar("Found")


class PerVolumeCache(Generic[Found]):
    """Cached value that was computed from a volume; the airways before and after an edit share the cache."""

    __slots__ = ("_found", "_lock", "_values")

    def __init__(self) -> None:
        self._found: Found | None = None
        self._values: NDArray[np.int16] | None = None
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[Any, ...]:
        """Return an empty cache: the value is not pickled."""
        # The cached value is large, so it is not pickled but computed again when needed.
        return PerVolumeCache, ()

    def of(self, volume: Volume, find: Callable[[], Found]) -> Found:
        """Return the value for a volume: the cached one, or the result of ``find``, which is then cached.

        A value that was computed from another volume is replaced.
        """
        with self._lock:
            if self._found is None or self._values is not volume.hu_zyx:
                self._found = find()
                self._values = volume.hu_zyx
            return self._found
