"""Measurements in the paper's setting (4.3): nearest voxel, one step per voxel, no shading, equal values skipped."""

from __future__ import annotations

import statistics
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import carina
from carina.cli.console import print_note
from carina.render import AirwayView, Renderer, TransferFunction
from carina.render.value_labels import equal_by_name
from carina.scopes import Pose
from carina.volume import Volume
from carina_bench.alternating_timer import Times, median_ratio, take_turns
from carina_bench.machine import load_average
from carina_bench.pictures import difference, save
from carina_bench.render import Request

__all__ = ["FILES", "paper_mode"]

FOLDER = "ct/head_and_lidc2_8bit"
"""Folder of the volumes below CARINA_DATA_DIR."""
FILES = {"LIDC2": "LIDC2_256x256x133_uint8.mha", "headsq, 8 bit": "headsq_64x64x93_int16.mha"}
"""Files of the volumes, by the name in the report."""
SIZE = 256
"""Width and height in pixels of the pictures in the paper's measurements (section 3.1)."""


def _eight_bit(volume: Volume) -> Volume:
    low, high = int(volume.hu_zyx.min()), int(volume.hu_zyx.max())
    if low >= 0 and high <= 255:
        return volume
    scaled = np.rint((volume.hu_zyx.astype(np.float64) - low) * (255.0 / (high - low))).astype(np.int16)
    return replace(volume, hu_zyx=scaled)


def _transfers() -> dict[str, TransferFunction]:
    """Return two transfer functions by name, chosen here because the paper prints none.

    *skin* is opaque from a quarter of the range of values; *veil* shows tissue as a thin fog in front of bone.
    """
    skin = [[48.0, 0.9, 0.6, 0.5, 0.0], [96.0, 0.9, 0.6, 0.5, 0.7], [255.0, 1.0, 0.95, 0.9, 0.98]]
    veil = [
        [32.0, 0.8, 0.5, 0.4, 0.0],
        [64.0, 0.8, 0.5, 0.4, 0.01],
        [160.0, 0.8, 0.5, 0.4, 0.01],
        [208.0, 1, 1, 0.9, 0.6],
    ]
    return {
        name: TransferFunction(points=np.array(points), unit="raw", name=name, sampling="nearest")
        for name, points in (("skin", skin), ("veil", veil))
    }


def _poses(volume: Volume) -> dict[str, Pose]:
    centre = volume.centre_lps
    size_mm = float(np.linalg.norm(np.array(volume.shape_zyx[::-1]) * volume.spacing_mm))
    front, side, above = np.array([0.0, -1.0, 0.0]), np.array([0.8, -0.6, 0.1]), np.array([0.3, -0.3, 0.9])
    poses = {
        name: Pose.looking(centre + 0.9 * size_mm * out / np.linalg.norm(out), -out)
        for name, out in (("front", front), ("side", side), ("above", above))
    }
    # The second pose is in the largest dark region, where the users of the paper fly.
    poses["inside, down"] = Pose.looking(_hollow(volume), (0.0, 0.0, -1.0))
    poses["inside, across"] = Pose.looking(_hollow(volume), (0.0, 1.0, 0.2))
    return poses


def _hollow(volume: Volume) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the darkest point of the inner half of a volume that is smoothed over 8^3 voxels, LPS mm."""
    values = volume.hu_zyx
    nz, ny, nx = (n // 8 for n in values.shape)
    coarse = values[: 8 * nz, : 8 * ny, : 8 * nx].reshape(nz, 8, ny, 8, nx, 8).mean(axis=(1, 3, 5))
    inner = tuple(slice(n // 4, n - n // 4) for n in coarse.shape)
    at = np.unravel_index(int(coarse[inner].argmin()), coarse[inner].shape)
    k, j, i = (8 * (int(a) + s.start) + 4 for a, s in zip(at, inner, strict=True))
    return volume.to_lps(np.array([i, j, k], dtype=np.float64))


def paper_mode(request: Request) -> list[dict[str, Any]]:
    """Measure how skipping differs from brute force: ratios of times and of steps, and difference of the pictures."""
    rows = []
    for name, file in FILES.items():
        volume = _eight_bit(carina.open_volume(Path(request["data_dir"]) / FOLDER / file))
        poses = _poses(volume)
        equal_by = equal_by_name(volume.hu_zyx)
        for transfer in _transfers().values():
            renderer = Renderer(volume, transfer=transfer)
            renderer.prepare()
            for where, pose in poses.items():
                fov_deg = 90.0 if where.startswith("inside") else 45.0
                leaping = AirwayView(pose, fov_deg=fov_deg, width=SIZE, height=SIZE, shading=False)
                brute = replace(leaping, method="brute")
                always = replace(leaping, method="leap-always")
                turns = {
                    "brute": partial(renderer.render, brute),
                    "leap": partial(renderer.render, leaping),
                    "always": partial(renderer.render, always),
                }
                times = take_turns(turns, request["repeats"])
                # Steps and pictures are compared for forced leaping. The time is also measured with the automatic
                # choice, which does not leap where leaping is slower.
                a, b, c = renderer.render(brute), renderer.render(always), renderer.render(leaping)
                steps_leap = b.stats.num_leaps + b.stats.num_samples
                better = min(times["brute"], times["always"], key=lambda measured: measured.median_ms)
                rows.append(
                    {
                        "volume": name,
                        "shape_zyx": list(volume.shape_zyx),
                        "transfer": transfer.name,
                        "view": where,
                        "method": b.stats.method,
                        "equal_by": equal_by,
                        "speed_up_time": round(median_ratio(times["brute"], times["leap"]), 3),
                        "speed_up_time_always": round(median_ratio(times["brute"], times["always"]), 3),
                        "automatic_over_better": round(median_ratio(better, times["leap"]), 3),
                        "automatic_leaps": c.stats.num_leaps > 0,
                        "speed_up_wall_always": round(_wall_ratio(times["brute"], times["always"]), 3),
                        "automatic_over_better_wall": round(_wall_ratio(better, times["leap"]), 3),
                        "speed_up_steps": round(a.stats.num_samples / max(steps_leap, 1), 3),
                        "steps_per_ray": {
                            "brute": round(a.stats.num_samples / a.stats.num_rays, 2),
                            "leap": round(steps_leap / b.stats.num_rays, 2),
                        },
                        "cpu_ms": {key: value.to_json() for key, value in times.items()},
                        "load_average": load_average(),
                        "leap_minus_brute": difference(a.rgb, b.rgb),
                        "pictures": [
                            save(
                                request["folder"],
                                f"paper-{name.split(',')[0]}-{transfer.name}-{where.replace(', ', '-')}-{who}",
                                picture.rgb,
                            )
                            for who, picture in (("leap", b), ("brute", a))
                        ],
                    }
                )
                print_note(f"{name}, {transfer.name}, {where}: {rows[-1]['speed_up_time']}x")
    return rows


def _wall_ratio(slow: Times, fast: Times) -> float:
    """Return the median over the rounds of the ratio of wall times within a round."""
    return statistics.median(a / b for a, b in zip(slow.wall_ms, fast.wall_ms, strict=True))
