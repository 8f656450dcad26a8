"""The first picture of a volume that is in memory: from the renderer to an endoscopic frame, every structure built.

No cache on disk. Wall and CPU time of each part, minimum and median of several rounds with a new renderer each; quote
it with the machine's load. Run: ``python benchmarks/first_frame.py [FILE | --spacing-mm S]``.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from carina import render
from carina.phantom import generate_phantom
from carina.scopes import Pose
from carina.volume import Volume, open_volume

SHAPE_ZYX = (400, 512, 512)


def chest(spacing_mm: float = 0.7) -> Volume:
    """A phantom chest laid into 512 x 512 x 400 voxels of noisy air."""
    volume = generate_phantom(seed=0, spacing_mm=(spacing_mm, spacing_mm, spacing_mm + 0.1)).volume
    noise = np.random.default_rng(0).normal(-1000.0, 20.0, SHAPE_ZYX[1:])
    values = np.repeat(np.rint(noise).astype(np.int16)[None], SHAPE_ZYX[0], axis=0)
    take, put = [], []
    for found, wanted in zip(volume.shape_zyx, SHAPE_ZYX, strict=True):
        count = min(found, wanted)
        take.append(slice((found - count) // 2, (found - count) // 2 + count))
        put.append(slice((wanted - count) // 2, (wanted - count) // 2 + count))
    values[tuple(put)] = volume.hu_zyx[tuple(take)]
    place = volume.lps_from_ijk.copy()
    place[:3, 3] = volume.to_lps(np.array([t.start - p.start for t, p in zip(take, put, strict=True)][::-1], float))
    return Volume(values, place)


def measure(volume: Volume, pose: Pose, *, rounds: int, size: int) -> dict[str, Any]:
    """Milliseconds of each part."""
    parts: dict[str, list[tuple[float, float]]] = {}
    picture = None
    for _ in range(rounds):
        # As it comes from a reader: its range is not known yet.
        fresh = Volume(volume.hu_zyx, volume.lps_from_ijk)

        def timed(name: str, work: Callable[[], Any]) -> Any:
            wall, cpu = time.perf_counter(), time.process_time()
            result = work()
            took = 1e3 * (time.perf_counter() - wall), 1e3 * (time.process_time() - cpu)
            parts.setdefault(name, []).append(took)
            return result

        def first_frame(fresh: Volume = fresh) -> Any:
            renderer = timed("renderer", lambda: render.Renderer(fresh))
            timed("map", renderer.prepare)
            return timed("picture", lambda: renderer.render(render.AirwayView(pose, width=size, height=size)))

        picture = timed("all", first_frame)
    assert picture is not None
    assert picture.stats.method == "leap"
    assert picture.rgb.max() > 60
    return {
        name: {
            "wall_min_ms": round(min(w for w, _ in times), 1),
            "wall_median_ms": round(statistics.median(w for w, _ in times), 1),
            "cpu_min_ms": round(min(c for _, c in times), 1),
            "cpu_median_ms": round(statistics.median(c for _, c in times), 1),
        }
        for name, times in parts.items()
    }


def main() -> int:
    """Print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("path", nargs="?", help="a CT; a phantom unless given")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--size", type=int, default=512)
    options = parser.parse_args()
    volume = open_volume(options.path) if options.path else chest()
    # The carina of the phantom lies at the origin; in another volume, the middle will do.
    at = (0.0, 1.5, 30.0) if not options.path else tuple(float(v) for v in volume.center_lps)
    pose = Pose.looking(at, (0.0, 0.0, -1.0))
    result = measure(volume, pose, rounds=options.rounds, size=options.size)
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    print(json.dumps({"shape_zyx": volume.shape_zyx, "cores": os.cpu_count(), "load": load, "parts": result}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
