"""Comparison of vessels, fissures and lobes around targets with the truth, in phantoms and painted CTs.

``python -m carina_bench.plan_surroundings vessels|lungs|fissures|lobes [CASE ...]`` prints a line of JSON per case.
*vessels* compares the vessels around needle lines, *lungs* the vessels of complete lungs. Painting needs scipy and
scikit-image; painted CTs are stored in the folder ``--keep``. Cases: ``phantom-SEED``, ``Patient1`` to ``Patient3``
(painted), and ``lobes-Patient1`` to ``lobes-Patient3`` (masks of lobes).
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import itertools
import json
import pickle
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray

from carina.config import load_settings
from carina.errors import CancelledError
from carina.phantom import generate_phantom
from carina.plan import surroundings
from carina.plan.lungs.lobes import LOBE_NAMES, STEP_MM, lobes, nearest_lobe
from carina.plan.lungs.lung_map import LungMap, map_lungs
from carina.scopes import WallField
from carina.track import Airways, AirwayTree, find_airways, lumen_mesh
from carina.volume import Volume, VolumeSource
from carina.volume.mask_distances import ball_distance

__all__ = ["Known", "fissures_row", "known_case", "lobes_row", "lungs_row", "vessel_row"]

Mask = NDArray[np.bool_]
Points = NDArray[np.float64]
Row = dict[str, Any]

NUM_LINES = 60
"""Number of random needle lines, or boxes, that are tested in a case."""
ROOM_MM = 14.0
"""Margin around the target and the scope's tip, mm; equal to the margin in `carina.plan.routes.plan_route`."""
FINE_MM = 0.5
"""Voxel size in mm of a second, finer volume of a phantom in which the true vessels are marked."""
PHANTOM_SPACING = (0.7, 0.7, 0.8)
"""Spacing of a phantom's CT (x, y, z), mm."""
CLASSES_MM = ((0.0, 1.0), (1.0, 1.5), (1.5, 2.5), (2.5, 4.0), (4.0, 20.0))
"""Classes of vessel diameter (lower and upper limit), mm."""
NEAR_MM = 1.0
"""Maximum distance in mm between a found and a true vessel voxel that count as the same vessel."""


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """CT of a case, the airways found in it, and its true vessels, lungs and fissures."""

    name: str
    volume: Volume
    tree: AirwayTree
    wall: WallField
    tissue: Callable[[Points, float], tuple[Volume, Mask, Mask]]
    """Function that returns the true vessels in a box around a point (LPS mm) with a margin in mm.

    The results are a grid, the mask of vessels, and the mask of the voxels that are judged, which are lung.
    """
    in_lung: Callable[[Points], Mask]
    fissures: Mask | None = None
    lungs: Mask | None = None


def vessel_row(known: Known, num: int = NUM_LINES) -> Row:
    """Return the recall of vessels by diameter, the precision of vessels, and the distances of needle lines.

    The distance of a needle line is that to the nearest vessel.
    """
    rng = np.random.default_rng(5)
    tips = np.concatenate([b.points[b.radius > 0.8] for b in known.tree.branches if b.generation >= 2])
    found_of = dict.fromkeys(CLASSES_MM, 0)
    all_of = dict(found_of)
    right = num_reported = 0
    pairs: list[tuple[float, float]] = []
    seconds = []
    while len(pairs) < num:
        tip = tips[rng.integers(len(tips))]
        way = rng.standard_normal(3)
        way /= np.linalg.norm(way)
        aim = tip + rng.uniform(10.0, 25.0) * way
        at = tip + np.arange(0.0, float(np.linalg.norm(aim - tip)), 0.25)[:, None] * way
        outside = known.wall.distance_mm(at) <= 0.0
        if not known.in_lung(at).all() or outside.sum() < 16 or not outside[-16:].all():
            continue
        first = int(np.argmax(outside))
        at = at[first:]
        middle, half = 0.5 * (tip + aim), 0.5 * float(np.linalg.norm(aim - tip)) + ROOM_MM
        begun = time.perf_counter()
        around = surroundings(known.volume, middle, half, None, known.wall)
        seconds.append(time.perf_counter() - begun)
        grid, vessels, judged = known.tissue(middle, half)
        away = _away(vessels, grid)
        true_mm = float(_read(away, grid, at).min())
        found_mm = float(around.read(around.vessel_mm, at).min())
        pairs.append((true_mm, found_mm))
        places, places_mm = _middle_lines(grid, vessels, judged)
        inside = around.holds(places) & (known.wall.distance_mm(places) < -0.5)
        seen = around.read(around.vessel_mm, places) <= NEAR_MM
        for low, high in CLASSES_MM:
            these = inside & (places_mm >= low) & (places_mm < high)
            all_of[low, high] += int(these.sum())
            found_of[low, high] += int((these & seen).sum())
        k, j, i = np.nonzero(around.vessel)
        points = np.stack([i, j, k], axis=1) * around.box.step_mm + around.box.lps_from_ijk[:3, 3]
        points = points[_read(judged, grid, points) & _holds(grid, points)]
        num_reported += len(points)
        right += int((_read(away, grid, points) <= NEAR_MM).sum())
    true, found = np.array(pairs).T
    near = true <= 5.0
    off = np.abs(np.minimum(found, 12.0) - true)[near]
    signed = (np.minimum(found, 12.0) - true)[near]
    return {
        "case": known.name,
        "lines": len(pairs),
        "recall": {f"{a}-{b} mm": round(found_of[a, b] / max(all_of[a, b], 1), 3) for a, b in CLASSES_MM},
        "num": {f"{a}-{b} mm": all_of[a, b] for a, b in CLASSES_MM},
        "precision": round(right / max(num_reported, 1), 3),
        "line_off_mm": {"median": round(float(np.median(off)), 2), "90 %": round(float(np.quantile(off, 0.9)), 2)},
        "line_bias_mm": round(float(np.median(signed)), 2),
        "danger_missed": f"{int((found[true <= 1.0] > 2.0).sum())} of {int((true <= 1.0).sum())}",
        "false_alarm": f"{int((found[true > 2.0] <= 1.0).sum())} of {int((true > 2.0).sum())}",
        "box_s": round(float(np.median(seconds)), 2),
    }


def _middle_lines(grid: Volume, vessels: Mask, judged: Mask) -> tuple[Points, NDArray[np.float32]]:
    """Return the points (LPS mm) of the centrelines of true vessels, and the diameter of the vessel at each, mm."""
    depth = ball_distance(vessels, float(min(grid.spacing_mm)))
    widest = depth
    for _ in range(4):
        widest = _dilated(widest)
    # The last condition excludes bumps on wide vessels, which would count as thin vessels.
    ridge = vessels & judged & (depth >= _dilated(depth) - 1e-6) & (depth >= 0.6 * widest)
    return grid.to_lps(np.argwhere(ridge)[:, ::-1].astype(np.float64)), 2.0 * depth[ridge]


def lungs_row(known: Known, num: int = NUM_LINES) -> Row:
    """Return the recall and the precision of the vessels of whole lungs, measured in random boxes.

    The vessels are those that the window shows.
    """
    made: list[LungMap] = []

    def stop(lungs: LungMap) -> None:
        made.append(lungs)
        raise CancelledError("the vessels are known")

    begun = time.perf_counter()
    with contextlib.suppress(CancelledError):
        # Of the airways, `map_lungs` uses only the tree.
        map_lungs(known.volume, cast(Airways, SimpleNamespace(tree=known.tree)), known.wall, found=stop)
    seconds = time.perf_counter() - begun
    mask = made[0].vessels
    assert mask is not None
    shown = Volume(np.where(mask.inside_zyx, 1, 0).astype(np.int16), mask.lps_from_ijk)
    shown_mm = _away_mm(mask.inside_zyx, mask.spacing_mm)
    found_of = dict.fromkeys(CLASSES_MM, 0)
    all_of = dict(found_of)
    right = num_reported = 0
    rng = np.random.default_rng(6)
    tips = np.concatenate([b.points[b.radius > 0.8] for b in known.tree.branches if b.generation >= 2])
    half = 20.0
    for middle in tips[rng.choice(len(tips), num)] + rng.normal(0.0, 8.0, (num, 3)):
        if not known.in_lung(middle[None]).all():
            continue
        grid, vessels, judged = known.tissue(middle, half)
        places, places_mm = _middle_lines(grid, vessels, judged)
        inside = known.wall.distance_mm(places) < -0.5
        seen = _holds(shown, places) & (_read(shown_mm, shown, places) <= NEAR_MM)
        for low, high in CLASSES_MM:
            these = inside & (places_mm >= low) & (places_mm < high)
            all_of[low, high] += int(these.sum())
            found_of[low, high] += int((these & seen).sum())
        points = shown.to_lps(np.argwhere(shown.hu_zyx)[:, ::-1].astype(np.float64))
        points = points[_holds(grid, points)]
        points = points[_read(judged, grid, points) != 0]
        num_reported += len(points)
        right += int((_read(_away(vessels, grid), grid, points) <= NEAR_MM).sum())
    return {
        "case": known.name,
        "ml": round(mask.ml, 1),
        "recall": {f"{a}-{b} mm": round(found_of[a, b] / max(all_of[a, b], 1), 3) for a, b in CLASSES_MM},
        "num": {f"{a}-{b} mm": all_of[a, b] for a, b in CLASSES_MM},
        "precision": round(right / max(num_reported, 1), 3),
        "seconds": round(seconds, 1),
    }


def lobes_row(name: str) -> Row:
    """Return the Dice coefficients of lobes from airways alone, and the reliability of their stated certainty."""
    from carina_bench.paint_scene import AIRWAY_FILES, mask_folders, opened

    data = load_settings().data_dir
    assert data is not None
    folder = mask_folders(data)[name]
    airway = next(volume for file in AIRWAY_FILES if (volume := opened(folder / file)) is not None)
    volume = Volume(np.where(airway.hu_zyx != 0, -1000, 0).astype(np.int16), airway.lps_from_ijk)
    tree = find_airways(volume, lumen_zyx=(airway.hu_zyx != 0).astype(np.uint8)).tree
    truth = np.zeros(volume.shape_zyx, np.uint8)
    for lobe in ("RUL", "RML", "RLL", "LUL", "LLL"):
        mask = opened(folder / f"{lobe}.nii.gz")
        assert mask is not None
        truth[mask.hu_zyx != 0] = LOBE_NAMES.index(lobe) + 1
    inside = np.argwhere(truth)
    places = volume.to_lps(inside[[0, -1]][:, ::-1].astype(np.float64))
    corners = volume.to_lps(np.array([inside.min(axis=0), inside.max(axis=0)])[:, ::-1].astype(np.float64))
    low, high = np.concatenate([corners, places]).min(axis=0) - 4.0, np.concatenate([corners, places]).max(axis=0) + 4.0
    matrix = np.diag([STEP_MM, STEP_MM, STEP_MM, 1.0])
    matrix[:3, 3] = low
    num = np.ceil((high - low) / STEP_MM).astype(int)[::-1]
    k, j, i = np.indices(num).reshape(3, -1)
    points = np.stack([i, j, k], axis=1) * STEP_MM + low
    true = np.where(_holds(volume, points), _read(truth, volume, points), 0).reshape(num)
    # The lobe masks exclude airways and vessels, so these holes are closed.
    lungs = ball_distance(ball_distance(~(true > 0), STEP_MM) <= 6.0, STEP_MM) >= 5.0
    begun = time.process_time()
    found = nearest_lobe(lungs | (true > 0), matrix, tree)
    row: Row = {"case": name, "cpu_s": round(time.process_time() - begun, 1), "missing": found.missing}
    row["dice"] = {
        lobe: round(
            2.0
            * float(((true == n) & (found.label_zyx == n)).sum())
            / float((true == n).sum() + (found.label_zyx[true > 0] == n).sum()),
            3,
        )
        for n, lobe in enumerate(LOBE_NAMES, 1)
        if (true == n).any()
    }
    judged = true > 0
    right = (true == found.label_zyx)[judged]
    sure = found.sure_zyx[judged]
    row["right"] = round(float(right.mean()), 3)
    steps = (0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.01)
    row["right_by_sure"] = {
        f"{a}-{b}": [round(float(right[(sure >= a) & (sure < b)].mean()), 2), int(((sure >= a) & (sure < b)).sum())]
        for a, b in itertools.pairwise(steps)
        if ((sure >= a) & (sure < b)).any()
    }
    return row


def fissures_row(known: Known) -> Row:
    """Return the precision and the recall of fissures, and how much the fissures improve the borders of lobes."""
    assert known.fissures is not None
    begun = time.process_time()
    found = lobes(known.volume, known.tree)
    spent = time.process_time() - begun
    assert found.fissure is not None
    alone = nearest_lobe(found.label_zyx > 0, found.lps_from_ijk, known.tree)
    seen = found.fissure
    seen_lps = np.argwhere(seen.mask)[:, ::-1] * seen.box.step_mm + seen.box.lps_from_ijk[:3, 3]
    drawn = known.volume.to_lps(np.argwhere(known.fissures)[::13, ::-1].astype(np.float64))
    far = _away(known.fissures, known.volume)
    to_seen = _at(_away_mm(seen.mask, seen.box.step_mm), seen.box.lps_from_ijk, seen.box.step_mm, drawn)
    return {
        "case": known.name,
        "cpu_s": round(spent, 1),
        "precision_2mm": round(float((_read(far, known.volume, seen_lps) <= 2.0).mean()), 3),
        "recall_2mm": round(float((to_seen <= 2.0).mean()), 3),
        "border_off_mm": {
            what: [
                round(float(v), 1)
                for v in np.quantile(_at(one.border_mm, one.lps_from_ijk, STEP_MM, drawn), (0.5, 0.9))
            ]
            for what, one in (("airways alone", alone), ("with fissures", found))
        },
        "ml": {lobe: round(found.ml(lobe)) for lobe in LOBE_NAMES if found.ml(lobe) > 0.0},
    }


def _at(values: NDArray[Any], lps_from_ijk: Points, step_mm: float, points: Points) -> NDArray[Any]:
    ijk = np.rint((points - lps_from_ijk[:3, 3]) / step_mm).astype(np.intp)
    found: NDArray[Any] = values[tuple(np.clip(ijk, 0, np.array(values.shape[::-1]) - 1).T[::-1])]
    return found


def _away_mm(mask: Mask, step_mm: float) -> NDArray[np.float32]:
    return ball_distance(~mask, step_mm)


def _away(mask: Mask, grid: Volume) -> NDArray[np.float32]:
    """Return the distance of each voxel from a mask, mm, 0 inside it; the axes of the grid must be perpendicular."""
    if not mask.any():
        return np.full(mask.shape, 99.0, np.float32)
    image = sitk.GetImageFromArray(mask.astype(np.uint8))
    image.SetSpacing([float(s) for s in grid.spacing_mm])
    far = sitk.GetArrayFromImage(sitk.SignedMaurerDistanceMap(image, False, False, True))
    return np.maximum(far - 0.5 * float(min(grid.spacing_mm)), 0.0).astype(np.float32)


def _dilated(values: NDArray[np.float32]) -> NDArray[np.float32]:
    out = values.copy()
    for axis in range(3):
        wide = np.pad(out, [(1, 1) if a == axis else (0, 0) for a in range(3)], mode="edge")
        num = out.shape[axis]
        out = np.maximum.reduce([wide.take(range(n, n + num), axis=axis) for n in range(3)])
    return out


def _ijk(grid: Volume, points: Points) -> NDArray[np.intp]:
    ijk: NDArray[np.intp] = np.rint(grid.to_ijk(points)).astype(np.intp)
    return ijk


def _holds(grid: Volume, points: Points) -> Mask:
    ijk = _ijk(grid, points)
    found: Mask = np.asarray(((ijk >= 0) & (ijk < np.array(grid.shape_zyx[::-1]))).all(axis=1))
    return found


def _read(values: NDArray[Any], grid: Volume, points: Points) -> NDArray[Any]:
    found: NDArray[Any] = values[tuple(np.clip(_ijk(grid, points), 0, np.array(values.shape[::-1]) - 1).T[::-1])]
    return found


def known_case(name: str, keep: Path) -> Known:
    """Return the case ``name``; painted CTs are stored in the folder ``keep``."""
    path = keep / f"around-{name}.pickle"
    if path.is_file():
        saved = pickle.loads(path.read_bytes())
    else:
        saved = _phantom(int(name.split("-")[1])) if name.startswith("phantom") else _painted(name)
        volume = Volume(saved["hu"], saved["matrix"], source=VolumeSource(format="array", title=name))
        airways = find_airways(volume)
        mesh = lumen_mesh(volume, airways)
        saved |= {"tree": airways.tree.to_json(), "mesh": (mesh.vertices_lps, mesh.triangles)}
        keep.mkdir(parents=True, exist_ok=True)
        path.write_bytes(pickle.dumps(saved))
    volume = Volume(saved["hu"], saved["matrix"], source=VolumeSource(format="array", title=name))
    tree = AirwayTree.from_json(saved["tree"])
    wall = WallField.from_mesh(*saved["mesh"])
    if "seed" in saved:
        return _known_phantom(name, saved, volume, tree, wall)

    def tissue(middle: Points, half: float) -> tuple[Volume, Mask, Mask]:
        ijk = volume.to_ijk(middle)
        reach = np.ceil(half / np.array(volume.spacing_mm)) + 4
        low = np.maximum(np.floor(ijk - reach), 0).astype(int)
        high = np.minimum(np.ceil(ijk + reach) + 1, np.array(volume.shape_zyx[::-1])).astype(int)
        matrix = volume.lps_from_ijk.copy()
        matrix[:3, 3] = volume.to_lps(low.astype(np.float64))
        part = tuple(slice(a, b) for a, b in zip(low[::-1], high[::-1], strict=True))
        grid = Volume(np.ascontiguousarray(volume.hu_zyx[part]), matrix)
        return grid, saved["vessels"][part], saved["judged"][part]

    def in_lung(points: Points) -> Mask:
        found: Mask = _read(saved["inner"], volume, points)
        return found

    return Known(name, volume, tree, wall, tissue, in_lung, saved["fissures"], saved["lungs"])


def _phantom(seed: int) -> Row:
    made = generate_phantom(seed=seed, spacing_mm=PHANTOM_SPACING, generations=8, noise_hu=25.0)
    return {"hu": made.volume.hu_zyx, "matrix": made.volume.lps_from_ijk, "seed": seed, "truth": made.truth}


def _known_phantom(name: str, saved: Row, volume: Volume, tree: AirwayTree, wall: WallField) -> Known:
    """Return a phantom as a case whose true vessels are the dense voxels of a fine volume without noise.

    Mediastinum and airway walls are excluded from these voxels.
    """
    branches = saved["truth"]["branches"]
    spatial: Any = importlib.import_module("scipy.spatial")
    axes = spatial.cKDTree(np.concatenate([np.array(b["points"]) for b in branches]))
    thick = np.concatenate([np.full(len(b["points"]), b["wall_mm"]) for b in branches])

    def tissue(middle: Points, half: float) -> tuple[Volume, Mask, Mask]:
        box = ((middle - half - 2.0).tolist(), (middle + half + 2.0).tolist())
        made = generate_phantom(
            seed=saved["seed"], spacing_mm=FINE_MM, generations=8, noise_hu=0.0, box_lps=box, with_distance=True
        )
        assert made.lumen_distance_mm is not None
        dense = made.volume.hu_zyx > -400
        solid = ball_distance(dense, FINE_MM) > 7.0
        if solid.any():
            solid = ball_distance(~solid, FINE_MM) < 7.5
        near = made.lumen_distance_mm < 3.0
        walls = np.zeros(dense.shape, np.bool_)
        places = made.volume.to_lps(np.argwhere(near)[:, ::-1].astype(np.float64))
        walls[near] = made.lumen_distance_mm[near] < thick[axes.query(places)[1]] + 0.1
        vessels = dense & ~walls & ~solid
        judged = ball_distance(~solid, FINE_MM) > 3.0
        return made.volume, vessels, judged

    lung = ball_distance(_lung_of(volume), float(np.mean(volume.spacing_mm))) > 6.0

    def in_lung(points: Points) -> Mask:
        found: Mask = _read(lung, volume, points) | (wall.distance_mm(points) > -2.0)
        return found

    return Known(name, volume, tree, wall, tissue, in_lung)


def _lung_of(volume: Volume) -> Mask:
    """Return the mask of the air inside the chest, with small dense parts in it closed."""
    image = sitk.GetImageFromArray((volume.hu_zyx < -500).astype(np.uint8))
    pieces = sitk.RelabelComponent(sitk.ConnectedComponent(image))
    labels = sitk.GetArrayFromImage(pieces)
    edge = set(np.unique(np.concatenate([labels[:, 0].ravel(), labels[:, -1].ravel()])))
    inside = np.isin(labels, [n for n in range(1, 6) if n not in edge])
    radius = [round(5.0 / s) for s in volume.spacing_mm]
    closed = sitk.BinaryMorphologicalClosing(sitk.GetImageFromArray(inside.astype(np.uint8)), radius)
    found: Mask = sitk.GetArrayFromImage(closed) != 0
    return found


def _painted(name: str) -> Row:
    """Return a painted patient with the true vessels: those of the masks and the added arteries, no airways."""
    from carina_bench.paint import PaintOptions, paint
    from carina_bench.paint_scene import masks_of, scene_of_masks
    from carina_bench.paint_tubes import wall_mm

    data = load_settings().data_dir
    assert data is not None
    masks = masks_of(data / "masks" / "thin_slice_airways" / name)
    options = PaintOptions()
    scene = scene_of_masks(masks, options)
    made = paint(scene, options)
    volume = made.volume
    assert masks.vessels is not None
    spacing = np.array(volume.spacing_mm)
    vessels = masks.vessels & masks.lungs
    airway = np.zeros_like(vessels)
    for tube in scene.tubes:
        if tube.is_artery:
            _draw(vessels, volume, tube.points, tube.radius_mm)
        else:
            _draw(airway, volume, tube.points, tube.radius_mm + wall_mm(tube.radius_mm))
    vessels &= ~airway
    closed = masks.lungs | vessels | airway
    inner = _depth(closed, spacing) > 4.0
    return {
        "hu": volume.hu_zyx,
        "matrix": volume.lps_from_ijk,
        "vessels": vessels,
        "judged": inner,
        "inner": inner,
        "fissures": masks.fissures,
        "lungs": masks.lungs,
    }


def _depth(mask: Mask, spacing: Points) -> NDArray[np.float32]:
    image = sitk.GetImageFromArray((~mask).astype(np.uint8))
    image.SetSpacing([float(s) for s in spacing])
    found: NDArray[np.float32] = sitk.GetArrayFromImage(sitk.SignedMaurerDistanceMap(image, False, False, True))
    return found


def _draw(mask: Mask, grid: Volume, points: Points, radius: Points) -> None:
    """Set the voxels of ``mask`` to True in a ball round each point, with its radius."""
    spacing = np.array(grid.spacing_mm)
    for point, r in zip(grid.to_ijk(points), radius, strict=True):
        reach = np.ceil(r / spacing).astype(int) + 1
        low = np.maximum(np.floor(point).astype(int) - reach, 0)
        high = np.minimum(np.floor(point).astype(int) + reach + 2, np.array(mask.shape[::-1]))
        if (high <= low).any():
            continue
        x, y, z = (((np.arange(a, b) - p) * s) ** 2 for a, b, p, s in zip(low, high, point, spacing, strict=True))
        part = tuple(slice(a, b) for a, b in zip(low[::-1], high[::-1], strict=True))
        mask[part] |= z[:, None, None] + y[None, :, None] + x[None, None, :] <= r * r


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line: measure each case and print its row."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["vessels", "lungs", "fissures", "lobes"])
    parser.add_argument("cases", nargs="*")
    parser.add_argument("--keep", type=Path, default=Path("around-cases"))
    parser.add_argument("--lines", type=int, default=NUM_LINES)
    parsed = parser.parse_args(arguments)
    usual = {
        "vessels": ["phantom-3", "Patient1"],
        "lungs": ["phantom-3", "Patient1"],
        "fissures": ["Patient1"],
        "lobes": ["lobes-Patient1", "lobes-Patient2", "lobes-Patient3"],
    }
    for name in parsed.cases or usual[parsed.what]:
        if parsed.what == "lobes":
            row = lobes_row(name)
        elif parsed.what == "fissures":
            row = fissures_row(known_case(name, parsed.keep))
        elif parsed.what == "lungs":
            row = lungs_row(known_case(name, parsed.keep), parsed.lines)
        else:
            row = vessel_row(known_case(name, parsed.keep), parsed.lines)
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
