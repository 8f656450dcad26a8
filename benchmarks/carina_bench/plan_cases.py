"""Chests with random nodules whose airways and nodules are known, on which planned routes are measured.

Patients are painted from their masks (``track_painted``): the nodules are in the scene before it is scanned. In
phantoms the nodules are added to the finished CT, with their own blur and noise. If a folder is given, the slow results
(the CT with its found airways) are stored there.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.phantom import generate_phantom, lumen_distance_at
from carina.scopes import WallField
from carina.track import Airways, find_airways, lumen_mesh
from carina.volume import Volume

__all__ = ["PlanCase", "Target", "TrueTree", "found_case", "patient_cases", "phantom_case", "true_wall"]

Floats = NDArray[np.float64]
Lumen = Callable[[Floats], Floats]
"""Function of points (n, 3), LPS mm, that returns their exact distances (n,) to a lumen in mm, negative inside."""
Say = Callable[[str], None]

RADII_MM = (4.0, 9.0)
"""Minimum and maximum radius in mm of a nodule that a case contains."""
APART_MM = 5.0
"""Minimum distance between the surfaces of two nodules, so that each can be segmented alone, mm."""
NODULE_HU = 30.0
"""CT value of a generated nodule, HU."""
SIGMA_MM = 0.6
"""Standard deviation of the blur of a nodule's edge in a phantom, mm."""
STEP_MM = 0.3
"""Distance in mm between two points of a true centreline."""
WALL_STEP_MM, WALL_MARGIN_MM = 0.6, 6.0
"""Voxel size of the field of the true wall, and distance to which it extends beyond the lumen, mm."""
WIDE_MM = 2.5
"""Minimum radius in mm of a lumen that must not be inside a nodule."""
LUNG_HU = (-990.0, -600.0)
"""Minimum and maximum CT value of lung in which a nodule is placed, HU."""
NEAR_SHARE, NEAR_MM, NEAR_RADIUS_MM = 0.75, 18.0, (1.2, 3.5)
"""Share of the nodules that are near airways; distance of their surface from an airway; radii of these airways.

The distance is the largest one in mm, the radii are the least and the largest one in mm. A scope may reach these
nodules; the other nodules are anywhere in the lung, mostly out of reach.
"""


@dataclass(frozen=True, slots=True, eq=False)
class TrueTree:
    """True centrelines of a case; the points of all branches are in one array, parents before children."""

    points: Floats
    """Points (n, 3) of all branches, LPS mm."""
    forward: Floats
    radius_mm: Floats
    narrowest_mm: Floats
    """Diameter (n,) of the largest ball that passes from the trachea to each point, mm."""
    branch: NDArray[np.int64]
    """Index (n,) of the branch of each point."""
    parents: tuple[int, ...]
    """Index of the parent of each branch; -1 for the trachea."""

    @classmethod
    def of(cls, branches: list[tuple[Floats, Floats, int]]) -> TrueTree:
        """Return the tree of branches, each given by points, radii and the parent's index; parents come first."""
        points, forward, radii, narrowest, numbers = [], [], [], [], []
        diameter_mm: list[float] = []
        with_children = {parent for _, _, parent in branches}
        for number, (line, radius, parent) in enumerate(branches):
            even, own = _even(line, radius)
            ahead = np.gradient(even, axis=0)
            wide = 2.0 * np.minimum.accumulate(own) if parent >= 0 else np.full(len(own), 2.0 * float(np.median(own)))
            is_stub = number in with_children and STEP_MM * len(own) < 2.0 * float(np.median(own))
            if parent >= 0:
                # A branch that is shorter than wide is inside the lumens of its neighbours, so it does not narrow the
                # path.
                wide = np.minimum(np.inf if is_stub else wide, np.full(len(own), diameter_mm[parent]))
            diameter_mm.append(float(wide[-1]))
            points.append(even)
            forward.append(ahead / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9))
            radii.append(own)
            narrowest.append(wide)
            numbers.append(np.full(len(even), number))
        return cls(
            np.concatenate(points),
            np.concatenate(forward),
            np.concatenate(radii),
            np.concatenate(narrowest),
            np.concatenate(numbers),
            tuple(parent for _, _, parent in branches),
        )

    def lineage(self, branch: int) -> tuple[int, ...]:
        """Return the indices of the branches from the trachea to ``branch``, both included."""
        found = [branch]
        while self.parents[found[-1]] >= 0:
            found.append(self.parents[found[-1]])
        return tuple(found[::-1])


def true_wall(truth: TrueTree) -> WallField:
    """Return the wall of the true airways: the union of balls of the true radius on the true centrelines."""
    points, radii = truth.points, truth.radius_mm
    low = (points - radii[:, None]).min(axis=0) - WALL_MARGIN_MM
    high = (points + radii[:, None]).max(axis=0) + WALL_MARGIN_MM
    size = np.ceil((high - low) / WALL_STEP_MM).astype(int) + 1
    inside = np.full(size[::-1], -WALL_MARGIN_MM, dtype=np.float32)
    for point, radius in zip(points, radii, strict=True):
        half = radius + 0.5 * WALL_MARGIN_MM
        begin = np.maximum(np.floor((point - half - low) / WALL_STEP_MM).astype(int), 0)
        end = np.minimum(np.ceil((point + half - low) / WALL_STEP_MM).astype(int) + 1, size)
        x, y, z = (low[a] + WALL_STEP_MM * np.arange(begin[a], end[a]) - point[a] for a in range(3))
        ball = radius - np.sqrt(z[:, None, None] ** 2 + y[None, :, None] ** 2 + x[None, None, :] ** 2)
        part = inside[begin[2] : end[2], begin[1] : end[1], begin[0] : end[0]]
        np.maximum(part, ball.astype(np.float32), out=part)
    place = np.diag([WALL_STEP_MM, WALL_STEP_MM, WALL_STEP_MM, 1.0])
    place[:3, 3] = low
    return WallField.from_distances(inside, place)


@dataclass(frozen=True, slots=True)
class Target:
    """Round nodule of a case, the target of a planned route: centre and radius."""

    centre_lps: tuple[float, float, float]
    radius_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class PlanCase:
    """CT with its true airways and nodules, and the airways that were found in it."""

    name: str
    volume: Volume
    truth: TrueTree
    targets: tuple[Target, ...]
    airways: Airways | None = None
    wall: WallField | None = None
    lumen: Lumen | None = None
    """Exact distances to the lumen from which the CT was made, with its rounded carinas; None if they are not known."""


def found_case(folder: Path | None, name: str, make: Callable[[], PlanCase], say: Say) -> PlanCase:
    """Return the case ``name`` with its found airways and their wall, from ``folder`` if they are stored there."""
    stored = None if folder is None else folder / f"{name}.pickle"
    if stored is not None and stored.exists():
        found, vertices, triangles = pickle.loads(stored.read_bytes())
        read: PlanCase = found
        return replace(read, wall=WallField.from_mesh(vertices, triangles))
    made = make()
    say(f"{name}: {len(made.targets)} nodules; finding airways")
    airways = find_airways(made.volume, progress=False)
    mesh = lumen_mesh(made.volume, airways)
    found = replace(made, airways=airways)
    if stored is not None:
        stored.parent.mkdir(parents=True, exist_ok=True)
        draft = stored.with_suffix(".draft")
        draft.write_bytes(pickle.dumps((found, mesh.vertices_lps, mesh.triangles)))
        draft.rename(stored)
    return replace(found, wall=WallField.from_mesh(mesh.vertices_lps, mesh.triangles))


def phantom_case(seed: int, *, num: int, spacing_mm: float = 1.1, generations: int = 6) -> PlanCase:
    """Return a generated chest with ``num`` nodules in its lungs.

    Chests of even seeds also have a stenosis of a main airway.
    """
    made = generate_phantom(
        seed=seed, spacing_mm=spacing_mm, generations=generations, noise_hu=25.0, stenosis=seed % 2 == 0
    )
    truth = _phantom_truth(made.truth)
    rng = np.random.default_rng((seed, 11))
    targets = _places(made.volume, truth, num, rng)
    volume = _with_nodules(made.volume, made.lumen_zyx != 0, targets, rng)
    lumen = partial(lumen_distance_at, seed=seed, generations=generations, stenosis=seed % 2 == 0)
    return PlanCase(f"phantom-{seed}", volume, truth, targets, lumen=lumen)


def patient_cases(
    data: Path, patients: list[str], condition: str, num: int, say: Say
) -> Iterator[tuple[str, Callable[[], PlanCase]]]:
    """Yield the name of each patient, and a function that paints the patient's CT with ``num`` nodules.

    Patients without masks are reported and skipped.
    """
    from carina_bench.paint_scene import mask_folders

    folders = mask_folders(data)
    for seed, patient in enumerate(patients):
        if patient not in folders:
            say(f"no masks of {patient}: nothing is painted")
            continue
        yield f"{patient}-{condition}", partial(_painted, folders[patient], condition, num, seed)


def _painted(folder: Path, condition: str, num: int, seed: int) -> PlanCase:
    from carina_bench.paint import Scene, paint
    from carina_bench.paint_scene import masks_of, scene_of_masks
    from carina_bench.paint_tubes import lumen_distance_at as lumen_distance_of_tubes
    from carina_bench.track_painted import CONDITIONS

    options = CONDITIONS[condition].options
    masks = masks_of(folder)
    scene = scene_of_masks(masks, options)
    tubes = [tube for tube in scene.tubes if not tube.is_artery]
    numbers = {tube.id: number for number, tube in enumerate(tubes)}
    truth = TrueTree.of(
        [(tube.points, tube.radius_mm, -1 if tube.parent is None else numbers[tube.parent]) for tube in tubes]
    )
    rng = np.random.default_rng((seed, 13))
    tissue = Volume(scene.hu_zyx, scene.lps_from_ijk)
    targets = _places(tissue, truth, num, rng)
    hu_zyx = scene.hu_zyx.copy()
    for at, share in _covers(tissue, targets, sigma_mm=0.0):
        hu_zyx[at] = np.rint(hu_zyx[at] + share * (NODULE_HU - hu_zyx[at])).astype(np.int16)
    made = paint(Scene(hu_zyx, scene.lps_from_ijk, scene.tubes), options)
    lumen = partial(lumen_distance_of_tubes, tubes=tuple(tubes))
    return PlanCase(f"{folder.name}-{condition}", made.volume, truth, targets, lumen=lumen)


def _phantom_truth(document: dict[str, Any]) -> TrueTree:
    rows = sorted(document["branches"], key=lambda row: row["generation"])
    numbers = {row["id"]: number for number, row in enumerate(rows)}
    return TrueTree.of(
        [
            (np.array(row["points"]), np.array(row["radius"]), -1 if row["parent"] is None else numbers[row["parent"]])
            for row in rows
        ]
    )


def _even(line: Floats, radius: Floats) -> tuple[Floats, Floats]:
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], max(int(np.ceil(along[-1] / STEP_MM)) + 1, 2))
    points = np.stack([np.interp(at, along, line[:, axis]) for axis in range(3)], axis=1)
    return points, np.interp(at, along, radius)


def _places(volume: Volume, truth: TrueTree, num: int, rng: np.random.Generator) -> tuple[Target, ...]:
    """Return ``num`` random balls in the lung.

    The surface of each ball is inside the lung, and no wide airway is inside a ball. The balls do not touch each other.
    """
    shape = np.array(volume.shape_zyx[::-1])
    n = np.arange(60) + 0.5
    turn, z = np.pi * (1.0 + np.sqrt(5.0)) * n, 1.0 - 2.0 * n / 60
    sphere = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)
    small = np.flatnonzero((truth.radius_mm > NEAR_RADIUS_MM[0]) & (truth.radius_mm < NEAR_RADIUS_MM[1]))
    found: list[Target] = []
    for _ in range(200_000):
        if len(found) == num:
            break
        centre = volume.to_lps((rng.random(3) * (shape - 1))[None])[0]
        radius = float(rng.uniform(*RADII_MM))
        if len(found) < NEAR_SHARE * num:
            way = rng.normal(size=3)
            far = rng.uniform(0.0, NEAR_MM + radius)
            centre = truth.points[rng.choice(small)] + far * way / np.linalg.norm(way)
        if not _is_lung(volume, centre[None])[0]:
            continue
        if _is_lung(volume, centre + (radius + 2.0) * sphere).mean() < 0.85:
            continue
        off = np.linalg.norm(truth.points - centre, axis=1)
        if ((off < radius + truth.radius_mm + 1.0) & (truth.radius_mm > WIDE_MM)).any():
            continue
        if any(np.linalg.norm(centre - one.centre_lps) < radius + one.radius_mm + APART_MM for one in found):
            continue
        found.append(Target((float(centre[0]), float(centre[1]), float(centre[2])), radius))
    return tuple(found)


def _is_lung(volume: Volume, points: Floats) -> NDArray[np.bool_]:
    ijk = np.rint(volume.to_ijk(points)).astype(int)
    shape = np.array(volume.shape_zyx[::-1])
    i, j, k = np.clip(ijk, 0, shape - 1).T
    hu = volume.hu_zyx[k, j, i]
    inside: NDArray[np.bool_] = ((ijk >= 0) & (ijk < shape)).all(axis=1) & (hu > LUNG_HU[0]) & (hu < LUNG_HU[1])
    return inside


def _covers(volume: Volume, targets: tuple[Target, ...], *, sigma_mm: float) -> Iterator[tuple[Any, Floats]]:
    """Yield the array index of each nodule's box, and the nodule's share of each voxel in the box.

    The edge of the nodule is blurred by ``sigma_mm``.
    """
    spacing = np.array(volume.spacing_mm)
    width = np.hypot(2.5 * sigma_mm, float(np.cbrt(np.prod(spacing))))
    shape = np.array(volume.shape_zyx[::-1])
    for target in targets:
        middle = volume.to_ijk(np.array([target.centre_lps]))[0]
        reach = np.ceil((target.radius_mm + 2.0 * width) / spacing).astype(int) + 1
        low = np.maximum(np.floor(middle).astype(int) - reach, 0)
        high = np.minimum(np.floor(middle).astype(int) + reach + 2, shape)
        k, j, i = np.meshgrid(*(np.arange(a, b) for a, b in zip(low[::-1], high[::-1], strict=True)), indexing="ij")
        points = volume.to_lps(np.stack([i, j, k], axis=-1).reshape(-1, 3).astype(np.float64))
        off = np.linalg.norm(points - target.centre_lps, axis=1).reshape(i.shape)
        share = np.clip(0.5 + (target.radius_mm - off) / width, 0.0, 1.0)
        yield tuple(slice(a, b) for a, b in zip(low[::-1], high[::-1], strict=True)), share


def _with_nodules(
    volume: Volume, lumen_zyx: NDArray[np.bool_], targets: tuple[Target, ...], rng: np.random.Generator
) -> Volume:
    hu_zyx = volume.hu_zyx.astype(np.float32)
    for at, cover in _covers(volume, targets, sigma_mm=SIGMA_MM):
        share = np.where(lumen_zyx[at], 0.0, cover)
        noise = rng.normal(0.0, 25.0, share.shape)
        hu_zyx[at] += share * (NODULE_HU + noise - hu_zyx[at])
    return Volume(np.rint(hu_zyx).astype(np.int16), volume.lps_from_ijk)
