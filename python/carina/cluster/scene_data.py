"""Packing of the content of a renderer (volume and scene), so that each large array is sent to a machine once."""

from __future__ import annotations

import io
import itertools
import pickle
import threading
import weakref
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from carina.render.scene import Scene
from carina.volume import Volume

Array = np.ndarray[Any, Any]
# Size in bytes from which an array is sent apart; smaller arrays are sent within the skeleton (the pickled content).
LARGE_BYTES = 1 << 16


@dataclass(frozen=True, slots=True, eq=False)
class Parcel:
    """A volume and a scene as bytes and arrays, without any name, UID or path of the case."""

    content: int
    """Number of the content; later content has a larger number."""
    skeleton: bytes
    arrays: Mapping[int, Array]
    """Large arrays by token. An array keeps its token, so that it is sent to each machine once."""

    @property
    def num_bytes(self) -> int:
        """Memory in bytes that a renderer needs for the content."""
        return len(self.skeleton) + sum(array.nbytes for array in self.arrays.values())


class _ScenePickler(pickle.Pickler):
    """Pickler that replaces each large array by its token."""

    def __init__(self, file: io.BytesIO, parcels: Parcels) -> None:
        super().__init__(file, protocol=5)
        self._parcels = parcels
        self.arrays: dict[int, Array] = {}

    def persistent_id(self, found: Any) -> int | None:
        if not isinstance(found, np.ndarray) or found.nbytes < LARGE_BYTES:
            return None
        token = self._parcels.token(found)
        self.arrays.setdefault(token, found)
        return token


class _SceneUnpickler(pickle.Unpickler):
    """Unpickler that replaces each token by its array."""

    def __init__(self, file: io.BytesIO, arrays: Mapping[int, Array]) -> None:
        super().__init__(file)
        self._arrays = arrays

    def persistent_load(self, token: Any) -> Array:
        return self._arrays[token]


class Parcels:
    """Factory of parcels (packed volumes and scenes) that stores the tokens of arrays still in use."""

    def __init__(self) -> None:
        self._contents = itertools.count(1)
        self._tokens = itertools.count(1)
        self._known: dict[tuple[int, ...], tuple[weakref.ref[Array], int]] = {}
        self._lock = threading.Lock()

    def pack(self, volume: Volume, scene: Scene) -> Parcel:
        """Return a volume and its scene packed as a parcel with a new content number."""
        bare = Volume(volume.hu_zyx, volume.lps_from_ijk, volume.is_hu, volume.not_hu_reason)
        file = io.BytesIO()
        packer = _ScenePickler(file, self)
        packer.dump((bare, scene))
        return Parcel(next(self._contents), file.getvalue(), packer.arrays)

    def token(self, array: Array) -> int:
        """Return the token (identification number) of an array; views of the same values have the same token."""
        # Views of the same memory count as one array; the owner of the memory shows whether it still exists.
        owner = array
        while isinstance(owner.base, np.ndarray):
            owner = owner.base
        key = (array.__array_interface__["data"][0], *array.shape, array.dtype.num)
        with self._lock:
            cached = self._known.get(key)
            if cached is not None and cached[0]() is owner:
                return cached[1]
            token = next(self._tokens)
            self._known[key] = (weakref.ref(owner), token)
            self._known = {k: v for k, v in self._known.items() if v[0]() is not None}
            return token


def open_parcel(skeleton: bytes, arrays: Mapping[int, Array]) -> tuple[Volume, Scene]:
    """Return the volume and the scene of a parcel without copying arrays.

    A parcel is a pickle, so only parcels of the console that this process joined with a token may be opened.
    """
    volume, scene = _SceneUnpickler(io.BytesIO(skeleton), arrays).load()
    return volume, scene
