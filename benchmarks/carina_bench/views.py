"""Measurements of ``carina bench render`` that compare empty-space skipping with brute force in different views."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from carina.cli.console import print_note, progress_printer
from carina.render import AirwayView, Renderer, TransferFunction, transfer_preset
from carina.scopes import Pose
from carina.volume import Volume
from carina_bench.alternating_timer import median_ratio, take_turns
from carina_bench.cases import Case, open_case
from carina_bench.compared_scene import STEP_VOX, TRANSFER
from carina_bench.machine import load_average
from carina_bench.pictures import difference, save
from carina_bench.render import Request, num_loads, prepared

__all__ = ["never_slower"]

PAIRS = 30
"""Number of pairs of pictures (with skipping, by brute force) that are measured for each view."""
SIZE = 256
"""Width and height in pixels of the pictures with skipping and by brute force."""


def _noisy(volume: Volume) -> Volume:
    """Return the chest with added noise of 300 HU, so that the lumen's values belong to many classes."""
    noise = np.random.default_rng(7).normal(0.0, 300.0, volume.shape_zyx)
    values = np.clip(volume.hu_zyx + noise, -1024, 3000).astype(np.int16)
    return replace(volume, hu_zyx=values)


def _static(volume: Volume) -> Volume:
    """Return a volume of random values, so that neighbouring voxels are in different classes."""
    values = np.random.default_rng(7).integers(-1000, -400, volume.shape_zyx).astype(np.int16)
    return replace(volume, hu_zyx=values)


def _scenes(case: Case) -> Iterator[tuple[str, Renderer, AirwayView]]:
    """Yield name, renderer and view of each scene: inside, in the wall, outside, dense, noisy, nearly clear."""

    def view(pose: Pose, **options: Any) -> AirwayView:
        return AirwayView(pose, **{"width": SIZE, "height": SIZE, "step_vox": STEP_VOX, **options})

    centre = case.volume.centre_lps
    at = case.trachea.position_lps
    front = Pose.looking(centre + np.array([0.0, -600.0, 0.0]), (0.0, 1.0, 0.0))
    oblique = Pose.looking(centre + np.array([350.0, -350.0, 250.0]), (-350.0, 350.0, -250.0))
    clear = prepared(case.volume, TRANSFER)
    yield "trachea", clear, view(case.trachea)
    yield "trachea, fisheye-wide 150 degrees", clear, view(case.trachea, fov_deg=150.0)
    yield "segmental bronchus", clear, view(case.flight[-1])
    yield "step 1 voxel", clear, view(case.trachea, step_vox=1.0)
    yield "step 2 voxels", clear, view(case.flight[-1], step_vox=2.0)
    yield "shading off", clear, view(case.trachea, shading=False)
    yield "across the trachea, at the wall", clear, view(Pose.looking(at, (1.0, 0.2, 0.0)))
    yield "in the middle of tissue", clear, view(Pose.looking(centre + np.array([0.0, 40.0, 0.0]), (0.0, 0.0, -1.0)))
    yield "in the lung", clear, view(Pose.looking(centre + np.array([70.0, 0.0, 0.0]), (0.0, 0.0, -1.0)))
    yield "from in front of the chest", clear, view(front, fov_deg=40.0)
    yield "from outside, oblique", clear, view(oblique, fov_deg=40.0)
    through = prepared(case.volume, transfer_preset("see-through"))
    yield "see-through wall", through, view(case.trachea)
    yield "see-through, from in front", through, view(front, fov_deg=40.0)
    # Every value has a low opacity, so nothing can be leaped and no ray ends early.
    fog_points = np.array([[-2000.0, 0.6, 0.6, 0.7, 0.004], [3000.0, 0.9, 0.8, 0.7, 0.01]])
    fog = prepared(case.volume, TransferFunction(points=fog_points, name="fog"))
    yield "dense: nothing is clear", fog, view(case.trachea)
    yield "dense, shading off", fog, view(case.trachea, shading=False)
    noisy = prepared(_noisy(case.volume), TRANSFER)
    yield "noisy lumen (300 HU)", noisy, view(case.trachea)
    yield "noisy, from in front", noisy, view(front, fov_deg=40.0)
    static = prepared(_static(case.volume), TRANSFER)
    yield "random values", static, view(case.trachea)
    yield "random values, shading off", static, view(case.trachea, shading=False)


def never_slower(request: Request) -> list[dict[str, Any]]:
    """Measure memory reads and times with and without skipping for each view, in 30 alternating pairs on one thread."""
    rows = []
    for name in request["cases"]:
        case = open_case(name, poses=2, progress=progress_printer())
        for label, renderer, view in _scenes(case):
            leaping, brute = view, replace(view, method="brute")
            turns = {"brute": partial(renderer.render, brute), "leap": partial(renderer.render, leaping)}
            times = take_turns(turns, request["pairs"])
            a, b = renderer.render(brute), renderer.render(leaping)
            picture = save(
                request["folder"], f"view-{label.replace(' ', '-').replace(',', '').replace(':', '')}", b.rgb
            )
            rows.append(
                {
                    "case": case.name,
                    "view": label,
                    "loads_ratio": round(num_loads(b) / max(num_loads(a), 1), 4),
                    "time_ratio": round(times["leap"].median_ms / times["brute"].median_ms, 4),
                    "time_ratio_of_pairs": round(median_ratio(times["leap"], times["brute"]), 4),
                    "cpu_ms": {key: value.to_json() for key, value in times.items()},
                    "leap_minus_brute": difference(a.rgb, b.rgb),
                    "load_average": load_average(),
                    "picture": picture,
                }
            )
            print_note(f"{label}: loads {rows[-1]['loads_ratio']}, time {rows[-1]['time_ratio']}")
    return rows
