"""Painter of chest CTs from tubes, whose true lumen is continuous and known to a fraction of a voxel.

A scene is the anatomy: CT values of tissue on a grid, and tubes over it. Painting simulates the scanner. The image
depends linearly on the scene, so the grid is blurred as a whole. Only the changes by tubes are painted in cells of at
most 0.15 mm, in tiles near a tube.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from carina.volume import Volume, VolumeSource
from carina_bench.paint_fine_vessels import FineVessel, add_fine_vessels
from carina_bench.paint_scanner import Kernel, noise_of_slice, reach_mm, sampled_weights, sharpened_slice, step_weights
from carina_bench.paint_tubes import Segment, Tube, covers_of, segments_of

__all__ = ["KERNELS", "PaintOptions", "Painted", "Scanned", "Scene", "paint", "scanned"]

Floats = NDArray[np.float64]

KERNELS = {
    "soft": Kernel(sigma_mm=0.55),
    "medium": Kernel(sigma_mm=0.40),
    "sharp": Kernel(sigma_mm=0.28, overshoot=0.18, surround_mm=0.65),
    "rimmed-medium": Kernel(sigma_mm=0.40, overshoot=0.027, surround_mm=0.65),
}
"""Reconstruction kernels by name.

The soft and the medium one correspond to a body and a lung standard kernel, with 50 % of the transfer at 3.4 and 4.7
line pairs per cm; the sharp one is an edge-enhancing lung kernel.
"""

FINE_MM = 0.15
"""Maximum width of the fine cells in which tubes are painted, mm: half a sigma of the sharpest kernel.

With 0.2 mm the values of thin lumens would be wrong by 12 HU.
"""
TILE_CELLS = 64
"""Approximate number of fine cells along each edge of a tile."""


@dataclass(frozen=True, slots=True)
class PaintOptions:
    """All inputs of a painted CT except the masks; the defaults are fixed, so that figures stay comparable."""

    seed: int = 1
    # Settings of the scanner:
    kernel: str = "medium"
    noise_hu: float = 25.0
    slice_mm: float | None = None
    """Slice thickness and distance of slices, mm; None uses the spacing of the masks."""
    slice_sigma_mm: float = 0.3
    """Standard deviation of a Gaussian blur along z, in addition to the slice thickness, mm."""
    breathing_mm: float = 0.0
    """Maximum difference, caused by breathing, between a slice's true and its stated position along z, mm."""
    breathing_period_mm: float = 60.0
    motion_blur_mm: float = 0.0
    """Standard deviation in mm of a blur along z by movement within a slice; from front to back it is half."""
    # CT values of tissue:
    air_hu: float = -1000.0
    wall_hu: float = 20.0
    vessel_hu: float = 40.0
    tissue_hu: float = 40.0
    nodule_hu: float = 30.0
    fissure_hu: float = -650.0
    mucus_hu: float = 15.0
    parenchyma_hu: float = -860.0
    gravity_hu: float = 50.0
    """Difference in HU between lung at the back and lung at the front of the chest, caused by gravity."""
    lobule_hu: float = 14.0
    """Standard deviation of a lung texture with details of about 6 mm, HU."""
    grain_hu: float = 26.0
    """Standard deviation of a lung texture with details of about 2 mm, HU."""
    # Structures that are added to the masks:
    emphysema_share: float = 0.0
    """Fraction of the lung's volume, 0 to 1, in holes of 2 to 9 mm diameter."""
    emphysema_hu: float = -975.0
    vessels_beside: bool = True
    """Whether an artery is added beside each airway that has no vessel beside it in the masks."""
    twigs_per_tip: int = 0
    twig_diameter_mm: tuple[float, float] = (1.0, 1.5)
    twig_length_mm: tuple[float, float] = (8.0, 25.0)
    plugs: int = 0
    """Number of airways that a plug of mucus closes over 5 to 10 mm."""
    half_filled: int = 0
    """Number of airways along which fluid fills the lower half of the lumen."""
    terminal_share_per_mm2: float = 0.0
    """Share of the possible terminal airways that grow, for each mm2 of the square of their lumen's radius.

    Terminal airways grow beyond the tips of the masks' airways (:mod:`carina_bench.paint_terminal`).
    """
    fine_vessels_per_ml: float = 0.0
    """Number of vessels of 0.3 to 0.6 mm radius per millilitre of lung (:mod:`carina_bench.paint_fine_vessels`)."""

    def scanner(self) -> Kernel:
        """Reconstruction kernel of :data:`KERNELS` with the name ``kernel``."""
        return KERNELS[self.kernel]


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Anatomy that the simulated scanner images: CT values of tissue, and tubes."""

    hu_zyx: NDArray[np.int16]
    """(nz, ny, nx) CT values of the cells of a grid, HU, without the airways."""
    lps_from_ijk: Floats
    """4x4 matrix from indices of the grid ``hu_zyx`` to LPS mm; the axes of the grid are perpendicular."""
    tubes: tuple[Tube, ...]
    """Airways and arteries, LPS mm."""
    fine_vessels: tuple[FineVessel, ...] = ()
    """Fine vessels, LPS mm. They are thinner than the blur, so only the areas of their cross-sections matter."""


@dataclass(frozen=True, slots=True, eq=False)
class Painted:
    """Painted CT with its true airways and its true lumen."""

    volume: Volume
    airways: tuple[Tube, ...]
    """True centrelines and radii of the airways, without arteries, at their positions in the image; LPS mm."""
    cover_zyx: NDArray[np.uint8]
    """(nz, ny, nx) share of each voxel in the lumen (inside the wall, fluid included), 0 to 255 (whole voxel)."""


@dataclass(frozen=True, slots=True, eq=False)
class Scanned:
    """Image of a scene with the blur of the scanner, but without the kernel's overshoot and without noise."""

    values_zyx: NDArray[np.float32]
    """(nz, ny, nx) CT values, HU."""
    lps_from_ijk: Floats
    airways: tuple[Tube, ...]
    """True centrelines and radii of the airways, see :attr:`Painted.airways`."""
    cover_zyx: NDArray[np.uint8]
    """(nz, ny, nx) share of each voxel that is lumen, see :attr:`Painted.cover_zyx`."""


@dataclass(slots=True)
class _Axis:
    """Cells of the scene and voxels of the image along one axis, in mm from the centre of the first cell."""

    cell_mm: float
    num_cells: int
    voxel_mm: float
    sigma_mm: float
    at_mm: Floats = field(default_factory=lambda: np.empty(0))
    """Position of the centre of each voxel of the image, mm."""

    @property
    def fine(self) -> int:
        return max(math.ceil(self.cell_mm / FINE_MM - 1e-9), 1)

    @property
    def tile(self) -> int:
        """Number of the scene's cells along the edge of a tile (computed at once) on this axis."""
        return max(round(TILE_CELLS / self.fine), 4)

    @property
    def pad(self) -> int:
        """Number of cells beyond each end of the scene's grid that contribute to voxels of the image."""
        return math.ceil(reach_mm(self.voxel_mm, self.sigma_mm) / self.cell_mm) + 1

    def voxels_near(self, low_mm: float, high_mm: float) -> slice:
        """Return the voxels of the image to which the scene between two positions contributes."""
        reach = reach_mm(self.voxel_mm, self.sigma_mm)
        first = int(np.searchsorted(self.at_mm, low_mm - reach))
        return slice(first, int(np.searchsorted(self.at_mm, high_mm + reach)))


def paint(scene: Scene, options: PaintOptions, say: Callable[[str], None] | None = None) -> Painted:
    """Return the painted CT of a scene; the same scene and options give the same voxels.

    Parameters
    ----------
    scene
        Tissue and tubes; ``scene_of_masks`` has already applied the tissue and additions of ``options``.
    options
        Kernel, noise, slices, movement; CT values of air, wall, vessels and mucus.
    say
        Function that receives a message at each step.

    Returns
    -------
    Painted
        Volume, airways at their positions in the image, and share of lumen in each voxel.
    """
    tell = say or (lambda _words: None)
    kernel = options.scanner()
    made = scanned(scene, options, tell)
    tell("kernel and noise")
    hu = np.empty(made.values_zyx.shape, np.int16)
    pixel_mm = float(np.linalg.norm(scene.lps_from_ijk[:3, 0]))
    for k in range(len(hu)):
        plane = sharpened_slice(made.values_zyx[k], kernel, pixel_mm)
        if options.noise_hu > 0.0:
            plane = plane + noise_of_slice(plane.shape, kernel, pixel_mm, options.noise_hu, (options.seed, 7, k))
        hu[k] = np.clip(np.rint(plane), -1024, 3071)
    hu.flags.writeable = False
    source = VolumeSource(format="array", title="painted chest")
    return Painted(Volume(hu, made.lps_from_ijk, source=source), made.airways, made.cover_zyx)


def scanned(scene: Scene, options: PaintOptions, say: Callable[[str], None]) -> Scanned:
    """Return the image of a scene blurred by the kernel's Gaussian and the slice profile; see :func:`paint`."""
    spacing = np.linalg.norm(scene.lps_from_ijk[:3, :3], axis=0)
    axes = _axes(scene, options, spacing)
    frame = scene.lps_from_ijk.copy()
    frame[:3, :3] /= spacing
    into = np.linalg.inv(frame)
    tubes = [tube.moved(tube.points @ into[:3, :3].T + into[:3, 3]) for tube in scene.tubes]
    say("tissue")
    values = _blurred_tissue(scene.hu_zyx, axes)
    cover = np.zeros(values.shape, np.uint8)
    if scene.fine_vessels:
        say(f"{len(scene.fine_vessels)} fine vessels")
        vessels = [FineVessel(v.points @ into[:3, :3].T + into[:3, 3], v.radius_mm) for v in scene.fine_vessels]
        add_fine_vessels(values, scene.hu_zyx, vessels, axes, options.vessel_hu)
    say(f"{len(tubes)} tubes")
    _add_tubes(values, cover, scene.hu_zyx, tubes, axes, options, down=into[:3, :3] @ np.array([0.0, 1.0, 0.0]))
    lps_from_ijk = scene.lps_from_ijk.copy()
    lps_from_ijk[:3, 2] *= axes[2].voxel_mm / axes[2].cell_mm
    lps_from_ijk[:3, 3] = frame[:3, :3] @ [0.0, 0.0, _first_mm(axes[2])] + frame[:3, 3]
    airways = tuple(
        replace(tube, points=_where_shown(tube.points, axes[2], options) @ frame[:3, :3].T + frame[:3, 3])
        for tube in tubes
        if not tube.is_artery
    )
    return Scanned(values, lps_from_ijk, airways, cover)


def _first_mm(axis: _Axis) -> float:
    return 0.5 * (axis.voxel_mm - axis.cell_mm)


def _axes(scene: Scene, options: PaintOptions, spacing: Floats) -> tuple[_Axis, _Axis, _Axis]:
    """Return the mappings from cells of the scene to voxels of the image along x, y and z."""
    sigma = options.scanner().sigma_mm
    sigmas = (
        sigma,
        math.hypot(sigma, 0.5 * options.motion_blur_mm),
        math.hypot(options.slice_sigma_mm, options.motion_blur_mm),
    )
    widths = (spacing[0], spacing[1], spacing[2] if options.slice_mm is None else options.slice_mm)
    axes = []
    for n, (cell, width, sigma_mm) in enumerate(zip(spacing, widths, sigmas, strict=True)):
        num_cells = scene.hu_zyx.shape[2 - n]
        axis = _Axis(float(cell), num_cells, float(width), sigma_mm)
        num = num_cells if n < 2 or options.slice_mm is None else max(int(num_cells * cell / width + 1e-6), 1)
        axis.at_mm = np.asarray(_first_mm(axis) + np.arange(num) * axis.voxel_mm, np.float64)
        axes.append(axis)
    axes[2].at_mm = axes[2].at_mm + _breath(axes[2].at_mm, options)
    return axes[0], axes[1], axes[2]


def _breath(z_mm: Floats, options: PaintOptions) -> Floats:
    """Return the displacement by breathing of the slices at positions ``z_mm``, mm.

    The displacements of two neighbouring slices differ by less than a fifth of the distance between the slices.
    """
    wave = 2.0 * math.pi / options.breathing_period_mm
    result: Floats = options.breathing_mm * np.sin(wave * z_mm + options.seed)
    return result


def _where_shown(points: Floats, z: _Axis, options: PaintOptions) -> Floats:
    """Return points of the scene moved to the positions at which breathing shows them in the image."""
    if options.breathing_mm == 0.0:
        return points
    heights_mm = np.arange(-20.0, z.cell_mm * z.num_cells + 20.0, 0.1)
    shown = points.copy()
    shown[:, 2] = np.interp(points[:, 2], heights_mm + _breath(heights_mm, options), heights_mm)
    return shown


def _blurred_tissue(hu_zyx: NDArray[np.int16], axes: tuple[_Axis, _Axis, _Axis]) -> NDArray[np.float32]:
    """Return the blurred tissue at the voxels of the image; beyond the grid the values of its last cells continue."""
    matrices = []
    for axis in axes:
        cells = np.arange(-axis.pad, axis.num_cells + axis.pad)
        places = np.asarray(cells * axis.cell_mm, np.float64)
        weights = step_weights(axis.at_mm, places, axis.cell_mm, axis.voxel_mm, axis.sigma_mm)
        inside = np.zeros((len(axis.at_mm), axis.num_cells))
        np.add.at(inside.T, np.clip(cells, 0, axis.num_cells - 1), weights.T)
        matrices.append((inside / inside.sum(axis=1, keepdims=True)).astype(np.float32))
    x, y, z = matrices
    result = np.empty((len(z), len(y), len(x)), np.float32)
    right = np.ascontiguousarray(x.T)
    for k, row in enumerate(z):
        used = np.flatnonzero(np.abs(row) > 1e-7)
        plane = np.zeros(hu_zyx.shape[1:], np.float32)
        for n in used:
            plane += row[n] * hu_zyx[n]
        result[k] = y @ plane @ right
    return result


def _add_tubes(
    values: NDArray[np.float32],
    cover: NDArray[np.uint8],
    hu_zyx: NDArray[np.int16],
    tubes: list[Tube],
    axes: tuple[_Axis, _Axis, _Axis],
    options: PaintOptions,
    down: Floats,
) -> None:
    """Add the tubes' change of the blurred tissue to ``values``, and their share of lumen to ``cover``."""
    fine_mm = [axis.cell_mm / axis.fine for axis in axes]
    segments = segments_of(tubes, float(np.cbrt(np.prod(fine_mm))))
    for tile, near in _tiles(segments, axes).items():
        firsts = [n * axis.tile for n, axis in zip(tile, axes, strict=True)]
        cells = [first + np.arange(axis.tile) for first, axis in zip(firsts, axes, strict=True)]
        centres = [
            (first - 0.5 + (np.arange(axis.tile * axis.fine) + 0.5) / axis.fine) * axis.cell_mm
            for first, axis in zip(firsts, axes, strict=True)
        ]
        covers = covers_of(
            [segments[n] for n in near], tubes, (centres[0], centres[1], centres[2]), float(np.mean(fine_mm)), down
        )
        if not (covers.airway.any() or covers.artery.any()):
            continue
        below = hu_zyx[
            np.ix_(*(np.clip(c, 0, axis.num_cells - 1) for c, axis in zip(cells[::-1], axes[::-1], strict=True)))
        ].astype(np.float32)
        for n, axis in enumerate(axes[::-1]):
            below = np.repeat(below, axis.fine, axis=n)
        there = below + covers.artery * (np.float32(options.vessel_hu) - below)
        there += covers.airway * (np.float32(options.wall_hu) - there)
        inside = options.air_hu + covers.fluid * np.float32(options.mucus_hu - options.air_hu)
        there += covers.lumen * (inside - there)
        there -= below
        spans = [
            axis.voxels_near(centre[0] - axis.cell_mm, centre[-1] + axis.cell_mm)
            for axis, centre in zip(axes, centres, strict=True)
        ]
        at = (spans[2], spans[1], spans[0])
        parts = list(zip(axes, spans, centres, fine_mm, strict=True))
        weights = [sampled_weights(a.at_mm[s], c, f, a.voxel_mm, a.sigma_mm) for a, s, c, f in parts]
        values[at] += _product(there, weights)
        if covers.lumen.any():
            boxes = [step_weights(a.at_mm[s], c, f, a.voxel_mm, 0.0) for a, s, c, f in parts]
            share = np.clip(np.rint(255.0 * _product(covers.lumen, boxes)), 0, 255) + cover[at]
            cover[at] = np.minimum(share, 255).astype(np.uint8)


def _tiles(segments: list[Segment], axes: tuple[_Axis, _Axis, _Axis]) -> dict[tuple[int, int, int], list[int]]:
    """Return the indices of the segments that contribute to each tile, by the tile's position (x, y, z).

    Tiles beyond the grid are included if they contribute to voxels of the image.
    """
    tiles: dict[tuple[int, int, int], list[int]] = {}
    for place, segment in enumerate(segments):
        ranges = []
        for n, axis in enumerate(axes):
            size = axis.tile * axis.cell_mm
            first = math.floor(max(segment.low[n] + 0.5 * axis.cell_mm, -axis.pad * axis.cell_mm) / size)
            end = (axis.num_cells + axis.pad) * axis.cell_mm
            last = math.floor(min(segment.high[n] + 0.5 * axis.cell_mm, end) / size)
            ranges.append(range(first, last + 1))
        for i in ranges[0]:
            for j in ranges[1]:
                for k in ranges[2]:
                    tiles.setdefault((i, j, k), []).append(place)
    return tiles


def _product(cells_zyx: NDArray[np.float32], weights_xyz: list[Floats]) -> NDArray[np.float32]:
    x, y, z = (part.astype(np.float32) for part in weights_xyz)
    nz, ny, nx = cells_zyx.shape
    along_z = (z @ cells_zyx.reshape(nz, ny * nx)).reshape(len(z), ny, nx)
    result: NDArray[np.float32] = y @ along_z @ np.ascontiguousarray(x.T)
    return result
