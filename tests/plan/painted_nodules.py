"""Synthetic CTs of a piece of lung with a nodule of exact shape: the reference for nodule segmentation."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray

from carina.volume import Volume

Values = NDArray[np.float64]

FINE_MM = 0.4
LUNG_HU, TISSUE_HU = -860.0, 40.0
HALF_MM = 28.0


Point = tuple[float, float, float]


@dataclass(frozen=True)
class Scene:
    """Description of a synthetic CT of a nodule in lung; lengths in mm, with the origin in the middle of the volume."""

    radii_mm: Point = (5.0, 5.0, 5.0)
    level_hu: float = 30.0
    core_mm: float = 0.0
    """Radius of a denser core in the middle of the nodule, mm; 0 for no core."""
    core_hu: float = 30.0
    vessels: tuple[tuple[Point, Point, float], ...] = ()
    """Point of the axis, direction and radius (mm) of each vessel."""
    pleura_mm: float | None = None
    """Distance of the chest wall on the patient's left from the middle of the volume, mm; None for no wall."""
    wall_radius_mm: float = 110.0
    spacing_mm: Point = (0.7, 0.7, 0.8)
    sigma_mm: float = 0.6
    noise_hu: float = 25.0
    seed: int = 1
    shift_mm: Point = (0.0, 0.0, 0.0)


def cover(distance: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the fraction of each fine voxel inside a surface, from the voxel's signed distance to the surface."""
    return np.clip(0.5 - distance / FINE_MM, 0.0, 1.0).astype(np.float32)


def ellipsoid(x: Values, y: Values, z: Values, radii: Point) -> Values:
    """Return the first-order signed distance to the surface of an ellipsoid."""
    a, b, c = radii
    k0 = np.sqrt((x / a) ** 2 + (y / b) ** 2 + (z / c) ** 2)
    k1 = np.sqrt((x / a**2) ** 2 + (y / b**2) ** 2 + (z / c**2) ** 2)
    return np.where(k1 > 0, k0 * (k0 - 1.0) / np.maximum(k1, 1e-9), -min(radii))


def painted(scene: Scene) -> tuple[Volume, float, NDArray[np.float64]]:
    """Return the CT of a scene, the true volume of the nodule in mm3, and the middle of the nodule, LPS mm."""
    num_fine = int(2 * HALF_MM / FINE_MM) + 1
    axis = (np.arange(num_fine) - (num_fine - 1) / 2) * FINE_MM
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij", sparse=True)
    sx, sy, sz = scene.shift_mm
    nodule = cover(ellipsoid(x - sx, y - sy, z - sz, scene.radii_mm))
    hu = np.full(nodule.shape, LUNG_HU, np.float32)
    wall = np.zeros_like(nodule)
    if scene.pleura_mm is not None:
        # The lung is the inside of a large sphere, whose middle is far to the patient's right.
        far = np.sqrt((x - scene.pleura_mm + scene.wall_radius_mm) ** 2 + y**2 + z**2) - scene.wall_radius_mm
        wall = cover(-far)
    dense = wall.copy()
    for point, direction, radius in scene.vessels:
        d = np.array(direction) / np.linalg.norm(direction)
        px, py, pz = x - point[0], y - point[1], z - point[2]
        along = px * d[0] + py * d[1] + pz * d[2]
        off = np.sqrt(np.maximum(px**2 + py**2 + pz**2 - along**2, 0.0))
        dense = np.maximum(dense, cover(off - radius))
    own = nodule * (1.0 - wall)
    level = np.full(nodule.shape, scene.level_hu, np.float32)
    if scene.core_mm > 0:
        core = cover(np.sqrt((x - sx) ** 2 + (y - sy) ** 2 + (z - sz) ** 2) - scene.core_mm)
        level += core * (scene.core_hu - scene.level_hu)
    hu += own * (level - LUNG_HU)
    hu = np.maximum(hu, LUNG_HU + dense * (TISSUE_HU - LUNG_HU))
    image = sitk.GetImageFromArray(hu)
    image.SetSpacing([FINE_MM] * 3)
    image.SetOrigin([axis[0]] * 3)
    smooth = sitk.SmoothingRecursiveGaussian(image, [scene.sigma_mm] * 3)
    # A slice shows the mean over its thickness.
    width = max(round(scene.spacing_mm[2] / FINE_MM), 1)
    total = np.cumsum(np.pad(sitk.GetArrayFromImage(smooth), ((width, width), (0, 0), (0, 0)), mode="edge"), axis=0)
    first = width - (width - 1) // 2 - 1
    thick = (total[first + width : first + width + num_fine] - total[first : first + num_fine]) / width
    smooth = sitk.GetImageFromArray(thick.astype(np.float32))
    smooth.SetSpacing([FINE_MM] * 3)
    smooth.SetOrigin([axis[0]] * 3)
    num = [int((2 * HALF_MM - 4.0) / s) for s in scene.spacing_mm]
    origin = [-0.5 * (k - 1) * s for k, s in zip(num, scene.spacing_mm, strict=True)]
    out = sitk.Resample(
        smooth, num, sitk.Transform(), sitk.sitkLinear, origin, scene.spacing_mm, [1, 0, 0, 0, 1, 0, 0, 0, 1], LUNG_HU
    )
    values = sitk.GetArrayFromImage(out)
    rng = np.random.default_rng(scene.seed)
    noise = rng.normal(size=values.shape)
    g = sitk.GetArrayFromImage(sitk.DiscreteGaussian(sitk.GetImageFromArray(noise), [0.5, 0.5, 0.0001]))
    values = values + g / g.std() * scene.noise_hu
    matrix = np.diag([*scene.spacing_mm, 1.0])
    matrix[:3, 3] = origin
    own_volume = float(own.sum()) * FINE_MM**3
    return Volume(np.clip(np.rint(values), -1024, 3000).astype(np.int16), matrix), own_volume, np.array(scene.shift_mm)


def random_scene(kind: str, rng: np.random.Generator) -> Scene:
    """Return a random scene with a nodule of the kind ``kind`` and random scan parameters."""
    least_mm = 3.0 if kind == "solid" else 6.0 if kind == "part-solid" else 4.0
    longest_mm = rng.uniform(least_mm, 10.0)
    x, y, z = np.maximum(longest_mm * rng.uniform(0.75, 1.0, 3), least_mm)
    in_plane_mm = rng.uniform(0.55, 0.8)
    scene = Scene(
        radii_mm=(x, y, z),
        level_hu=rng.uniform(-20.0, 60.0),
        spacing_mm=(in_plane_mm, in_plane_mm, rng.uniform(0.6, 1.0)),
        sigma_mm=rng.uniform(0.45, 0.8),
        noise_hu=rng.uniform(10.0, 45.0),
        seed=int(rng.integers(1_000_000)),
        shift_mm=tuple(rng.uniform(-0.5, 0.5, 3)),
    )
    match kind:
        case "vessel":
            vessel = (
                tuple(rng.uniform(-0.9, 0.9, 3) * x),
                tuple(rng.normal(size=3)),
                rng.uniform(0.6, 0.3 * longest_mm),
            )
            return dataclasses.replace(scene, vessels=(vessel,))
        case "pleura":
            wall_mm = rng.uniform(70.0, 150.0)
            return dataclasses.replace(scene, pleura_mm=x * rng.uniform(0.0, 0.9), wall_radius_mm=wall_mm)
        case "ground-glass":
            return dataclasses.replace(scene, level_hu=rng.uniform(-650.0, -450.0))
        case "part-solid":
            core_mm = rng.uniform(0.4, 0.6) * min(x, y, z)
            return dataclasses.replace(scene, level_hu=rng.uniform(-650.0, -450.0), core_mm=core_mm)
        case "2 mm" | "3 mm":
            return dataclasses.replace(scene, spacing_mm=(in_plane_mm, in_plane_mm, float(kind[0])))
    return scene
