"""Painted CTs with exactly known diameters: phantoms and patients with several kernels and slice thicknesses.

The generator of phantoms blurs the wall of an airway as if the wall were flat, so its image of a thin lumen is wider
than a scanner's. Here the generator gives only the anatomy; the painter makes the image (:mod:`carina_bench.paint`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.phantom import generate_phantom
from carina.volume import Volume
from carina_bench.paint import PaintOptions, Scanned, Scene, scanned
from carina_bench.paint_tubes import Tube
from carina_bench.track_hard_cases import KERNELS, SLICES, cached, hard_cases, imaged
from carina_bench.track_truth import Truth

__all__ = ["KERNEL_NAMES", "SLICE_NAMES", "DiameterCase", "painted_patients", "painted_phantoms"]

Say = Callable[[str], None]

KERNEL_NAMES = tuple(KERNELS)
"""Names of the kernels with which CTs are painted."""
SLICE_NAMES = ("0.7mm", "1mm", "1.5mm", "2mm", "2.5mm", "3mm")
"""Names of the slice thicknesses with which CTs are painted."""
SPACING_MM = 0.7
"""Spacing of the painted phantoms, mm."""
BESIDE_MM = 8.0
"""Width of the tissue around the airways of a phantom that is painted, mm."""
BEYOND_WALL_MM = 1.1
"""Distance from an airway's wall up to which the generator's image shows the airway, mm."""


@dataclass(frozen=True, slots=True, eq=False)
class DiameterCase:
    """Painted CT with the true centrelines and radii of its airways."""

    subject: str
    """Subject of the CT: ``phantom N`` or the name of a patient."""
    kernel: str
    slices: str
    volume: Volume
    truth: Truth

    @property
    def condition(self) -> str:
        """Kernel and slice thickness of the CT, as text for the report."""
        return f"{self.kernel} {self.slices}"


def painted_phantoms(
    seeds: Sequence[int], kernels: Sequence[str], slices: Sequence[str], say: Say
) -> Iterator[DiameterCase]:
    """Yield the painted phantoms of each seed, kernel and slice thickness."""
    for seed in seeds:
        made: list[Scene] = []
        for kernel in kernels:
            options = PaintOptions(kernel=KERNELS[kernel], seed=seed)

            def paint_thin(options: PaintOptions = options, seed: int = seed, made: list[Scene] = made) -> Scanned:
                if not made:
                    made.append(_scene(seed))
                return scanned(made[0], options, lambda _step: None)

            say(f"phantom {seed} {kernel}")
            thin = cached(_key(seed, options), paint_thin)
            for name in slices:
                volume, truth, _clean = imaged(thin, options, SLICES[name])
                yield DiameterCase(f"phantom {seed}", kernel, name, volume, truth)


def painted_patients(
    data: Path, patients: Sequence[str], kernels: Sequence[str], slices: Sequence[str], say: Say
) -> Iterator[DiameterCase]:
    """Yield the painted patients whose masks are in ``data``, with each kernel and slice thickness."""
    for case in hard_cases(data, patients, kernels, slices, say):
        yield DiameterCase(case.patient, case.kernel, case.slices, case.volume, case.truth)


def _key(seed: int, options: PaintOptions) -> str:
    """Return a key of all inputs of a painted phantom, under which it is cached."""
    digest = hashlib.sha256(repr((seed, options, SPACING_MM)).encode())
    for path in (*sorted(Path(__file__).parent.glob("paint*.py")), Path(__file__)):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:24]


def _scene(seed: int) -> Scene:
    """Return the scene of a phantom: its tissue without airways, and its airways as tubes."""
    phantom = generate_phantom(seed=seed, spacing_mm=SPACING_MM, noise_hu=0.0, with_distance=True)
    assert phantom.lumen_distance_mm is not None
    tubes = [
        Tube(
            np.array(row["points"], dtype=np.float64),
            np.array(row["radius"], dtype=np.float64),
            id=row["id"],
            parent=row["parent"],
            generation=row["generation"],
            thickness_mm=float(row["wall_mm"]),
        )
        for row in phantom.truth["branches"]
    ]
    lumen = phantom.lumen_zyx != 0
    box = []
    for others in ((1, 2), (0, 2), (0, 1)):
        used, margin = np.flatnonzero(lumen.any(axis=others)), round(BESIDE_MM / SPACING_MM)
        box.append(slice(max(int(used[0]) - margin, 0), int(used[-1]) + margin + 1))
    part = tuple(box)
    lps_from_ijk = phantom.volume.lps_from_ijk.copy()
    lps_from_ijk[:3, 3] += lps_from_ijk[:3, :3] @ [axis.start for axis in part[::-1]]
    hu = _without_airways(phantom.volume.hu_zyx[part], phantom.lumen_distance_mm[part], lps_from_ijk, tubes)
    return Scene(hu, lps_from_ijk, tuple(tubes))


def _without_airways(
    hu_zyx: NDArray[np.int16],
    distance_zyx: NDArray[np.float32],
    lps_from_ijk: NDArray[np.float64],
    tubes: Sequence[Tube],
) -> NDArray[np.int16]:
    """Return the tissue in which each voxel of an airway has the value of the nearest voxel outside the airways."""
    ndimage: Any = import_module("scipy.ndimage")
    spatial: Any = import_module("scipy.spatial")
    near = np.argwhere(distance_zyx < 4.5)
    points = near[:, ::-1] @ lps_from_ijk[:3, :3].T + lps_from_ijk[:3, 3]
    axes = spatial.cKDTree(np.concatenate([tube.points for tube in tubes]))
    walls = np.concatenate([np.full(len(tube.points), tube.thickness_mm) for tube in tubes])
    _, nearest = axes.query(points, workers=1)
    shown = distance_zyx[tuple(near.T)] < walls[nearest] + BEYOND_WALL_MM
    airway = np.zeros(hu_zyx.shape, np.bool_)
    airway[tuple(near[shown].T)] = True
    place = ndimage.distance_transform_edt(airway, return_distances=False, return_indices=True)
    result: NDArray[np.int16] = np.ascontiguousarray(hu_zyx[tuple(place)])
    return result
