"""What is found in one volume when it is first asked for, and kept for the next who asks."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from carina.volume.model import Volume

__all__ = ["KeptForVolume"]

Found = TypeVar("Found")


class KeptForVolume(Generic[Found]):
    """Something that was found in a volume; shared by the airways that edits make of each other."""

    __slots__ = ("_found", "_lock", "_values")

    def __init__(self) -> None:
        self._found: Found | None = None
        self._values: NDArray[np.int16] | None = None
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[Any, ...]:
        # What was found is computed again where it is needed: it is large.
        return KeptForVolume, ()

    def of(self, volume: Volume, find: Callable[[], Found]) -> Found:
        """What was found in a volume, or is found now; of another volume it is never kept."""
        with self._lock:
            if self._found is None or self._values is not volume.hu_zyx:
                self._found = find()
                self._values = volume.hu_zyx
            return self._found
