"""Volumes on which benchmarks run, with camera poses in their airways."""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import carina
from carina.config import load_settings
from carina.errors import NoResultError
from carina.navigate import FlightPath
from carina.phantom import GENERATOR_VERSION, generate_phantom
from carina.scopes import Pose
from carina.track import AirwayTree
from carina.volume import Volume, VolumeSource

__all__ = ["PHANTOMS", "Case", "open_case", "open_phantom"]

Progress = Callable[[str, float | None], None]

PHANTOMS: dict[str, dict[str, Any]] = {
    "phantom-128": {"spacing_mm": 1.8, "box_lps": ((-115.2, -117.0, -120.4), (115.1, 113.3, 110.0))},
    "phantom-256": {"spacing_mm": 0.9, "box_lps": ((-115.2, -117.0, -119.6), (114.4, 112.6, 110.0))},
    "phantom-512": {"spacing_mm": 0.7, "box_lps": ((-179.2, -181.2, -169.4), (178.6, 176.6, 110.0))},
}
"""Phantoms by name: spacing in mm and box in LPS mm, chosen so that the volume has the number of voxels in the name."""


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """Volume with a pose in the middle of its trachea and a flight from this pose into a segmental bronchus."""

    name: str
    volume: Volume
    trachea: Pose
    flight: tuple[Pose, ...]
    lumen_zyx: NDArray[np.uint8] | None = None
    """Voxels (nz, ny, nx) of the lumen that was found in a CT; None for a phantom."""
    tree: AirwayTree | None = None
    """Airway tree that was found in a CT; None for a phantom."""


@dataclass(frozen=True, slots=True, eq=False)
class _Branch:
    id: int
    parent: int | None
    generation: int
    points: NDArray[np.float64]
    radius_mm: float


def open_case(name: str, *, poses: int, progress: Progress | None = None) -> Case:
    """Open a phantom by name, ``patient`` (the bundled case), or a CT by its path.

    Raises
    ------
    VolumeImportError
        If the path cannot be opened.
    NoResultError
        If no airway is found in the CT.
    """
    lumen = tree = None
    if name in PHANTOMS:
        volume, branches = _phantom(name, progress)
    else:
        volume = carina.demo_patient() if name == "patient" else carina.open_volume(Path(name), progress=progress)
        airways = carina.find_airways(volume, progress=progress)
        lumen, tree = airways.lumen_zyx, airways.tree
        branches = [
            _Branch(b.id, b.parent, b.generation, np.asarray(b.points), float(np.median(b.radius)))
            for b in airways.tree.branches
        ]
        name = name if name == "patient" else _name_of(Path(name).resolve())
    trachea, flight = _poses(branches, poses)
    return Case(name, volume, trachea, flight, lumen, tree)


def open_phantom(name: str, progress: Progress | None = None) -> tuple[Volume, list[NDArray[np.float64]]]:
    """Return the phantom ``name`` of :data:`PHANTOMS`, the top of its trachea and its airway tips (points, LPS mm)."""
    volume, branches = _phantom(name, progress)
    parents = {branch.parent for branch in branches}
    trunk = next(branch for branch in branches if branch.parent is None)
    tips = [branch.points[-1] for branch in branches if branch.id not in parents]
    # The box may cut off the top of the trachea, so the first point inside the volume is used.
    top = next(point for point in trunk.points if volume.contains_lps(point))
    return volume, [top, *(tip for tip in tips if volume.contains_lps(tip))]


def _name_of(path: Path) -> str:
    """Return a display name for a CT's path; a folder with a generic name is preceded by its parent's name."""
    return f"{path.parent.name}-{path.name}" if path.name.lower() in {"dicom", "ct", "images"} else path.name


def _poses(branches: Sequence[_Branch], count: int) -> tuple[Pose, tuple[Pose, ...]]:
    by_id = {b.id: b for b in branches}
    root = next(b for b in branches if b.parent is None)
    # Generations: trachea 0, main bronchi 1, lobar 2, segmental 3 (4 on the right, because of the intermediate
    # bronchus).
    segmental = [b for b in branches if 3 <= b.generation <= 4] or [max(branches, key=lambda b: b.generation)]
    target = max(segmental, key=lambda b: (b.radius_mm, b.id))
    chain = [target]
    while chain[0].parent is not None:
        chain.insert(0, by_id[chain[0].parent])
    if len(chain) < 2:
        raise NoResultError("the airways of this volume have no branch to fly into", code="track.no-result")
    # The flight ends in the middle of the segmental bronchus; the first point of a child is the last point of its
    # parent.
    half = target.points[: max(len(target.points) // 2, 2)]
    points = np.concatenate([chain[0].points, *(b.points[1:] for b in chain[1:-1]), half[1:]])
    path = FlightPath(points)
    middle = 0.5 * FlightPath(root.points).length_mm
    stops = np.linspace(middle, path.length_mm, count)
    return path.pose_at(middle), tuple(path.pose_at(float(mm)) for mm in stops)


def _phantom(name: str, progress: Progress | None) -> tuple[Volume, list[_Branch]]:
    options = {"seed": 0, "generations": 7, **PHANTOMS[name]}
    key = hashlib.sha256(json.dumps([GENERATOR_VERSION, options]).encode()).hexdigest()[:12]
    folder = load_settings().cache_dir / "bench"
    values_file, truth_file = folder / f"{name}-{key}.npy", folder / f"{name}-{key}.json"
    if not (values_file.is_file() and truth_file.is_file()):
        made = generate_phantom(**options, progress=progress)
        folder.mkdir(parents=True, exist_ok=True)
        # The files are written to a temporary folder and then renamed, so that an interrupted run leaves no incomplete
        # file. The file of the truth is renamed last.
        with tempfile.TemporaryDirectory(dir=folder) as scratch:
            part = Path(scratch) / "values.npy"
            np.save(part, made.volume.hu_zyx, allow_pickle=False)
            part.replace(values_file)
            part = Path(scratch) / "truth.json"
            truth = {"lps_from_ijk": made.volume.lps_from_ijk.tolist(), "branches": made.truth["branches"]}
            part.write_text(json.dumps(truth), encoding="utf-8")
            part.replace(truth_file)
    values = np.load(values_file, allow_pickle=False)
    truth = json.loads(truth_file.read_text(encoding="utf-8"))
    values.flags.writeable = False
    source = VolumeSource(format="phantom", title=f"{name}: generated, no patient")
    branches = [
        _Branch(b["id"], b["parent"], b["generation"], np.array(b["points"]), float(np.median(b["radius"])))
        for b in truth["branches"]
    ]
    return Volume(values, np.array(truth["lps_from_ijk"]), source=source), branches
