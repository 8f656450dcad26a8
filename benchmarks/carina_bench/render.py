"""Measurements of ``carina bench render``; each function runs in a separate process and returns rows of the report."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

import carina
from carina.cli.console import print_note, progress_printer
from carina.errors import RenderError
from carina.render import AirwayView, Picture, Renderer, TransferFunction, build_info
from carina.scopes import DEFAULT_SCOPE, Pose, scope_preset
from carina.volume import Volume
from carina_bench.alternating_timer import Times, median_ratio, take_turns
from carina_bench.cases import Case, open_case
from carina_bench.compared_scene import FOV_DEG, STEP_VOX, STOP_TRANSPARENCY, TRANSFER, VTK_STOP_TRANSPARENCY
from carina_bench.machine import load_average
from carina_bench.pictures import difference, save

__all__ = ["first_frame", "frames", "small_frames"]

Request = dict[str, Any]
SIZE = 512
"""Width and height in pixels of the pictures that are timed."""
METHODS: tuple[Literal["brute"], Literal["leap"]] = ("brute", "leap")
"""Methods of casting rays that are compared: brute force, and empty-space skipping."""
BASELINE_REPEATS = 3
"""Number of pictures of the numba baseline for each pose; one takes 2 to 3 s in the largest case."""
WORST = {"decorated_over_shipped": max}
"""Function that selects the worst of several ratios, by the ratio's name; `min` for other names."""


def instruction_sets() -> list[str]:
    """Return ``avx2`` and the machine's fastest instruction set; only one if equal or if AVX2 is missing."""
    best = str(build_info()["simd"])
    if best != "avx512":
        return [best]
    return ["avx2", best]


def _view(pose: Pose, method: Literal["leap", "brute"], size: int, *, stop: float = STOP_TRANSPARENCY) -> AirwayView:
    return AirwayView(
        pose, fov_deg=FOV_DEG, width=size, height=size, step_vox=STEP_VOX, method=method, stop_transparency=stop
    )


def _shown(pose: Pose, method: Literal["leap", "brute"]) -> AirwayView:
    """Return the airway view as the window shows it: with the default instrument's lens and Carina's stop limit."""
    scope = scope_preset(DEFAULT_SCOPE)
    return AirwayView.of_scope(scope, pose, width=SIZE, height=SIZE, step_vox=STEP_VOX, method=method)


def shipped(case: Case, simd: str | None = None) -> tuple[Renderer, Renderer]:
    """Return two renderers of a case with Carina's default appearance: without and with drawn features such as rings.

    Both use the wall and the tree that were found. The plain renderer draws no decoration from the tree, no droplets,
    and no second rays on silhouettes: these have a separate gate.
    """
    lumen, tree = case.lumen_zyx, case.tree
    if lumen is None or tree is None:
        airways = carina.find_airways(case.volume)
        lumen, tree = airways.lumen_zyx, airways.tree
    look = Renderer(case.volume).transfer
    if look.appearance is None:
        raise RenderError(f"{case.name} is not shown with light and texture", code="render.setting")
    bare = replace(look.appearance, rings=0.0, membrane=0.0, hue=0.0, spurs=0.0, specks=0.0, silhouettes=False)
    both = []
    for appearance in (bare, look.appearance):
        renderer = Renderer(case.volume, transfer=replace(look, appearance=appearance), simd=simd)
        renderer.set_lumen(lumen, tree)
        renderer.prepare()
        both.append(renderer)
    return both[0], both[1]


def num_loads(picture: Picture) -> int:
    """Return the number of loads from the volume and the maps by the scalar algorithm, which is deterministic."""
    stats = picture.stats
    return stats.num_loads


def prepared(volume: Volume, transfer: TransferFunction, simd: str | None = None) -> Renderer:
    """Return a renderer whose radius maps are built and not stored in a cache."""
    renderer = Renderer(volume, transfer=transfer, simd=simd)
    renderer.prepare()
    return renderer


def frames(request: Request) -> list[dict[str, Any]]:
    """Compare the CPU times of frames of 512 x 512 with VTK and the numba baseline, alternately on one thread.

    Carina renders the benchmark's scene and the default look of the window. VTK has no such look, so VTK renders the
    benchmark's scene in both comparisons.
    """
    from carina_bench.numba_reference import numba_caster
    from carina_bench.vtk_reference import VtkCaster

    rows = []
    for name in request["cases"]:
        case = open_case(name, poses=request["poses"], progress=progress_printer())
        print_note(f"{case.name}: {case.volume!r}")
        sets = instruction_sets()
        renderers = {simd: prepared(case.volume, TRANSFER, simd) for simd in sets}
        whole = shipped(case, sets[0])
        looks = {sets[0]: whole}
        for simd in sets[1:]:
            looks[simd] = (Renderer(case.volume, simd=simd), Renderer(case.volume, simd=simd))
            for renderer, made in zip(looks[simd], whole, strict=True):
                renderer.adopt_scene(made.scene)
        vtk = VtkCaster(case.volume, TRANSFER, step_vox=STEP_VOX, size=SIZE)
        print_note(f"{case.name}: the first picture of VTK is made")
        baseline = numba_caster(case.volume, TRANSFER, step_vox=STEP_VOX, size=SIZE)
        poses = [("trachea", case.trachea), *((f"flight-{n}", pose) for n, pose in enumerate(case.flight))]
        measured = []
        for label, pose in poses:
            print_note(f"{case.name}: {label}")
            measured.append(_frame_at(request, case, label, pose, (renderers, looks), vtk, baseline))
        vtk.close()
        rows.append({"case": case.name, "view": "trachea", **measured[0]})
        rows.append({"case": case.name, "view": "flight", **_over_poses(measured[1:])})
    return rows


def _frame_at(
    request: Request,
    case: Case,
    label: str,
    pose: Pose,
    both: tuple[dict[str, Renderer], dict[str, tuple[Renderer, Renderer]]],
    vtk: Any,
    baseline: Callable[[Pose], NDArray[np.uint8]],
) -> dict[str, Any]:
    """Measure the times of one pose alternately, with ratios within rounds; save and compare the pictures."""
    renderers, looks = both
    vtk.look(pose)
    functions: dict[str, Callable[[], object]] = {"vtk": vtk.cast}
    for simd, renderer in renderers.items():
        for method in METHODS:
            view = _view(pose, method, SIZE, stop=VTK_STOP_TRANSPARENCY)
            functions[f"{method}-{simd}"] = partial(renderer.render, view)
    best = next(reversed(renderers))
    # For the comparison with VTK rays stop at VTK's limit of transparency; this picture uses Carina's limit.
    functions["leap-own-stop"] = partial(renderers[best].render, _view(pose, "leap", SIZE))
    for simd, (bare, decorated) in looks.items():
        for method in METHODS:
            functions[f"shipped-{method}-{simd}"] = partial(bare.render, _shown(pose, method))
        functions[f"decorated-leap-{simd}"] = partial(decorated.render, _shown(pose, "leap"))
    times = take_turns(functions, request["repeats"])
    shown = {
        simd: [decorated.render(_shown(pose, method)).rgb for method in METHODS]
        for simd, (_, decorated) in looks.items()
    }
    brute, leap = (renderers[best].render(_view(pose, method, SIZE)) for method in METHODS)
    row: dict[str, Any] = {
        "cpu_ms": {key: value.to_json() for key, value in times.items()},
        "ratio": _ratios(times, best),
        "leap_minus_brute": difference(leap.rgb, brute.rgb),
        "shipped_leap_minus_brute": difference(shown[best][1], shown[best][0]),
        "per_ray": {
            "samples_brute": round(brute.stats.num_samples / brute.stats.num_rays, 2),
            "samples_leap": round(leap.stats.num_samples / leap.stats.num_rays, 2),
            "lookups": round(leap.stats.num_lookups / leap.stats.num_rays, 2),
            "leaps": round(leap.stats.num_leaps / leap.stats.num_rays, 2),
        },
        "loads_ratio": round(num_loads(leap) / max(num_loads(brute), 1), 4),
    }
    others = {simd: r.render(_view(pose, "leap", SIZE)).rgb for simd, r in renderers.items() if simd != best}
    row["instruction_sets_agree"] = all(np.array_equal(rgb, leap.rgb) for rgb in others.values()) and all(
        np.array_equal(leaped, shown[best][1]) for _, leaped in shown.values()
    )
    # The baseline and VTK's window are slow, so they render one picture each; their times are measured only in the
    # trachea.
    expected = baseline(pose)
    row["brute_minus_baseline"] = difference(brute.rgb, expected)
    peer = vtk.picture()
    row["brute_minus_vtk"] = difference(brute.rgb, peer)
    if label == "trachea":
        slow = take_turns({"numba": lambda: baseline(pose), "vtk-window": vtk.cast_and_show}, BASELINE_REPEATS)
        row["cpu_ms"] |= {key: value.to_json() for key, value in slow.items()}
        row["pictures"] = [
            save(request["folder"], f"{case.name}-{label}-{who}", rgb)
            for who, rgb in (
                ("carina", leap.rgb),
                ("vtk", peer),
                ("baseline", expected),
                ("shipped", shown[best][1]),
            )
        ]
    else:
        row["pictures"] = [
            save(request["folder"], f"{case.name}-{label}-{who}", rgb)
            for who, rgb in (("carina", leap.rgb), ("vtk", peer), ("shipped", shown[best][1]))
        ]
    return row


def _ratios(times: dict[str, Times], best: str) -> dict[str, Any]:
    """Return two values of each ratio of two times: its median over the rounds, and the ratio of the least times."""

    def both(slow: str, fast: str) -> dict[str, float]:
        return {
            "median": round(median_ratio(times[slow], times[fast]), 3),
            "min": round(times[slow].min_ms / times[fast].min_ms, 3),
        }

    ratios = {
        "leap_over_vtk": both("vtk", f"leap-{best}"),
        "brute_over_vtk": both("vtk", f"brute-{best}"),
        "leap_over_brute": both(f"brute-{best}", f"leap-{best}"),
        "leap_with_own_stop_over_vtk": both("vtk", "leap-own-stop"),
        "shipped_over_vtk": both("vtk", f"shipped-leap-{best}"),
        "shipped_leap_over_brute": both(f"shipped-brute-{best}", f"shipped-leap-{best}"),
        "shipped_over_leap": both(f"leap-{best}", f"shipped-leap-{best}"),
        "decorated_over_shipped": both(f"decorated-leap-{best}", f"shipped-leap-{best}"),
    }
    if "leap-avx2" in times:
        ratios["avx2_leap_over_vtk"] = both("vtk", "leap-avx2")
        ratios["avx2_leap_over_brute"] = both("brute-avx2", "leap-avx2")
        ratios["avx2_shipped_over_vtk"] = both("vtk", "shipped-leap-avx2")
        ratios["avx2_share"] = both(f"leap-{best}", "leap-avx2")
    return ratios


def _over_poses(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return a summary of a flight: the medians over its poses, and the worst pose."""
    ratio = {
        key: {
            "median": round(statistics.median(row["ratio"][key]["median"] for row in rows), 3),
            "min": round(statistics.median(row["ratio"][key]["min"] for row in rows), 3),
            "worst_pose": round(WORST.get(key, min)(row["ratio"][key]["median"] for row in rows), 3),
        }
        for key in rows[0]["ratio"]
    }
    cpu = {
        key: {
            "median": round(statistics.median(row["cpu_ms"][key]["median"] for row in rows), 3),
            "min": round(statistics.median(row["cpu_ms"][key]["min"] for row in rows), 3),
            "repeats": rows[0]["cpu_ms"][key]["repeats"],
        }
        for key in rows[0]["cpu_ms"]
    }
    worst = {
        key: {what: max(row[key][what] for row in rows) for what in rows[0][key]}
        for key in ("leap_minus_brute", "shipped_leap_minus_brute", "brute_minus_baseline", "brute_minus_vtk")
    }
    return {
        "poses": len(rows),
        "cpu_ms": cpu,
        "ratio": ratio,
        **worst,
        "per_ray": {
            key: round(statistics.median(row["per_ray"][key] for row in rows), 2) for key in rows[0]["per_ray"]
        },
        "loads_ratio": max(row["loads_ratio"] for row in rows),
        "instruction_sets_agree": all(row["instruction_sets_agree"] for row in rows),
        "pictures": [name for row in rows for name in row["pictures"]],
        "each_pose": [{"ratio": row["ratio"], "per_ray": row["per_ray"]} for row in rows],
    }


def small_frames(request: Request) -> list[dict[str, Any]]:
    """Measure the wall time of frames of 256 x 256 along a flight on two threads, for two looks."""
    rows = []
    for name in request["cases"]:
        case = open_case(name, poses=request["poses"], progress=progress_printer())
        looks = {"bench": prepared(case.volume, TRANSFER)}
        if case.lumen_zyx is not None:
            looks["as shipped"] = shipped(case)[1]
        views = [_view(pose, "leap", 256) for pose in (case.trachea, *case.flight)]
        for look, renderer in looks.items():
            rows.append({"case": case.name, "look": look, **_pace(renderer, views, max(request["repeats"], 7))})
        for row, renderer in zip(rows[-len(looks) :], looks.values(), strict=True):
            shown = f"{case.name}-256-{row['look'].replace(' ', '-')}"
            row["picture"] = save(request["folder"], shown, renderer.render(views[-1]).rgb)
    return rows


def _pace(renderer: Renderer, views: list[AirwayView], rounds: int) -> dict[str, Any]:
    for view in views:
        renderer.render(view)
    wall, cpu = [], []
    for _ in range(rounds):
        for view in views:
            started, started_cpu = time.perf_counter(), time.process_time()
            renderer.render(view)
            wall.append(time.perf_counter() - started)
            cpu.append(time.process_time() - started_cpu)
    return {
        "frames": len(wall),
        "wall_ms": {"median": round(1000 * statistics.median(wall), 3), "min": round(1000 * min(wall), 3)},
        "cpu_ms": {"median": round(1000 * statistics.median(cpu), 3), "min": round(1000 * min(cpu), 3)},
        "frames_per_s": round(1 / statistics.median(wall), 1),
        # Other load on the cores makes the wall time longer, so this value is computed from the CPU time.
        "frames_per_s_on_two_free_cores": round(2 / statistics.median(cpu), 1),
        "cores": os.cpu_count(),
        "load_average": load_average(),
    }


def first_frame(request: Request) -> list[dict[str, Any]]:
    """Measure the time from a volume in memory to the first picture with empty-space skipping, on all threads.

    The time includes that of building all structures.
    """
    rows = []
    for name in request["cases"]:
        case = open_case(name, poses=2, progress=progress_printer())
        view = _view(case.trachea, "leap", SIZE)
        int(case.volume.hu_zyx.sum(dtype=np.int64))
        parts: dict[str, list[float]] = {"look_at_values": [], "prepare": [], "picture": [], "whole": [], "cpu": []}
        for _ in range(request["repeats"]):
            # Create a new volume for each repetition, because a volume caches its range of values.
            volume = Volume(case.volume.hu_zyx, case.volume.lps_from_ijk)
            marks, cpu = [time.perf_counter()], time.process_time()
            renderer = Renderer(volume, transfer=TRANSFER)
            marks.append(time.perf_counter())
            renderer.prepare()
            marks.append(time.perf_counter())
            picture = renderer.render(view)
            marks.append(time.perf_counter())
            for key, a, b in zip(("look_at_values", "prepare", "picture"), marks, marks[1:], strict=False):
                parts[key].append(1000 * (b - a))
            parts["whole"].append(1000 * (marks[-1] - marks[0]))
            parts["cpu"].append(1000 * (time.process_time() - cpu))
            if picture.stats.method != "leap":
                raise RenderError(f"the first frame did not leap ({picture.stats.method})", code="render.setting")
            del renderer
        threads = os.cpu_count() or 1
        rows.append(
            {
                "case": case.name,
                "wall_ms": {
                    k: {"median": round(statistics.median(v), 2), "min": round(min(v), 2)} for k, v in parts.items()
                },
                "cpu_ms_over_threads": round(statistics.median(parts["cpu"]) / threads, 2),
                "first_round_ms": round(parts["whole"][0], 2),
                "threads": threads,
                "repeats": len(parts["whole"]),
                "load_average": load_average(),
            }
        )
    return rows
