"""The renderer on each machine of a cluster, which renders strips; it uses neither Ray nor the network."""

from __future__ import annotations

import dataclasses
import os
import pickle
import platform
import socket
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.cluster.byte_messages import Counts, Strip, open_order, pack_answer
from carina.cluster.scene_data import open_parcel
from carina.errors import ClusterError
from carina.render import Backend, Picture, Renderer, RenderStats, build_info
from carina.version import VERSION


def available_bytes() -> int | None:
    """Return the memory available on this machine in bytes, limited by the container; None if it is not reported."""
    found: list[int] = []
    try:
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                found.append(int(line.split()[1]) * 1024)
        limit = Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii").strip()
        if limit != "max":
            used = int(Path("/sys/fs/cgroup/memory.current").read_text(encoding="ascii"))
            found.append(max(0, int(limit) - used))
    except (OSError, ValueError):
        pass
    return min(found, default=None)


def bare_picture(picture: Picture) -> Picture:
    """Return a picture without pixels and optics (the console has the optics), to be sent with a strip."""
    return dataclasses.replace(picture, rgb=np.empty((0, 0, 3), np.uint8), optics=None)


def counts_of(stats: RenderStats) -> Counts:
    """Return the statistics of a rendered picture as a tuple, in the order of ``Counts``."""
    return (
        stats.num_rays,
        stats.num_samples,
        stats.num_lookups,
        stats.num_leaps,
        stats.num_skipped,
        stats.num_shaded,
        stats.num_loads,
    )


class RendererHost:
    """Renderer of one machine, called by the console; it has no content at first and after every restart.

    Parameters
    ----------
    mixed
        Whether the renderer may use a graphics device; its pictures may then differ by one grey level.
    simd
        Instruction set of the kernels, for tests.
    """

    def __init__(self, *, mixed: bool = False, simd: str | None = None) -> None:
        self._backend = Backend("auto") if mixed else Backend("cpu")
        self._simd = simd
        self._content: int | None = None
        self._arrays: dict[int, NDArray[Any]] = {}
        self._renderer: Renderer | None = None
        self._lock = threading.Lock()

    def ping(self) -> dict[str, Any]:
        """Return the versions, the host, the process and the loaded content of this renderer."""
        info = build_info()
        return {
            "version": VERSION,
            "python": platform.python_version(),
            "host": socket.gethostname(),
            "pid": os.getpid(),
            "threads": info["threads"],
            "simd": self._simd or info["simd"],
            "content": self._content,
            "tokens": sorted(self._arrays),
            "memory_bytes": available_bytes(),
        }

    def load(
        self, content: int, skeleton: bytes, known_tokens: list[int], tokens: list[int], *arrays: NDArray[Any]
    ) -> int:
        """Load the volume and the scene from which this renderer renders pictures.

        Parameters
        ----------
        content
            Number of the content, which every strip names.
        skeleton
            See :class:`carina.cluster.scene_data.Parcel`.
        known_tokens
            Tokens of arrays that this host already has.
        tokens, arrays
            Tokens and values of the other arrays.

        Returns
        -------
        int
            Number of the content.

        Raises
        ------
        ClusterError
            ``cluster.lost`` if this host lacks an array of ``known_tokens``, because it was restarted; all arrays must
            be sent again.
        """
        with self._lock:
            known = {**self._arrays, **dict(zip(tokens, arrays, strict=True))}
            wanted = [*known_tokens, *tokens]
            if any(token not in known for token in wanted):
                raise ClusterError("the renderer was restarted and no longer has the volume", code="cluster.lost")
            self._arrays = {token: known[token] for token in wanted}
            volume, scene = open_parcel(skeleton, self._arrays)
            if self._renderer is None or self._renderer.volume.hu_zyx is not volume.hu_zyx:
                shown = self._renderer
                # Volumes with the same array of values keep their renderer, with its X-ray projections.
                if shown is None or not _share_memory(shown.volume.hu_zyx, volume.hu_zyx):
                    self._renderer = Renderer(volume, simd=self._simd, backend=self._backend)
            assert self._renderer is not None
            self._renderer.adopt_scene(scene)
            self._content = content
            return content

    def strip(self, frame_id: int, content: int, view: bytes, rows: tuple[int, int] | None) -> Strip:
        """Render rows of a view; the view is pickled once for all strips of a frame.

        Parameters
        ----------
        frame_id, content
            Numbers of the frame and of its content.
        view
            The pickled view.
        rows
            First row and row after the last; None for the whole picture.

        Raises
        ------
        ClusterError
            ``cluster.lost`` if the loaded content is not that of the strip.
        """
        began_s = time.perf_counter()
        with self._lock:
            renderer, loaded = self._renderer, self._content
            scene = None if renderer is None else renderer.scene
        if renderer is None or loaded != content:
            raise ClusterError(f"the renderer has content {loaded}; expected {content}", code="cluster.lost")
        shown = pickle.loads(view)
        first_row, end_row = rows or (0, shown.height)
        picture = renderer.render(shown, rows=rows, scene=scene)
        first = bare_picture(picture) if first_row == 0 else None
        stats = picture.stats
        seconds = time.perf_counter() - began_s
        counts = counts_of(stats)
        return frame_id, content, first_row, end_row - first_row, seconds, stats.method, counts, first, picture.rgb

    def answer(self, order: bytes) -> bytes:
        """Render the strip of a packed order and return the packed answer; see :mod:`carina.cluster.byte_messages`."""
        return pack_answer(self.strip(*open_order(order)))


def _share_memory(a: NDArray[Any], b: NDArray[Any]) -> bool:
    return a.shape == b.shape and a.__array_interface__["data"][0] == b.__array_interface__["data"][0]
