"""A chest CT painted from tubes: every lumen continuous and known to a fraction of a voxel.

A scene is what there is (values of tissue on a grid, tubes over it); painting is what a scanner makes of it. The image
is linear in the scene, so the grid is blurred as it is, and only what tubes change is painted in cells of at most
0.15 mm, tile by tile where a tube is near.
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
"""50 % of the transfer at 3.4 and 4.7 line pairs per cm (body and lung standard), and an edge-enhancing lung kernel."""

FINE_MM = 0.15
"""Cells of tubes are at most this wide: half a sigma of the sharpest kernel. With 0.2 thin lumens are 12 HU off."""
TILE_CELLS = 64
"""About as many fine cells along each side of a tile."""


@dataclass(frozen=True, slots=True)
class PaintOptions:
    """All that decides a painted CT beside the masks. The defaults are fixed: figures are compared across time."""

    seed: int = 1
    # The scanner.
    kernel: str = "medium"
    noise_hu: float = 25.0
    slice_mm: float | None = None
    """Slice thickness and distance; None: the masks' own."""
    slice_sigma_mm: float = 0.3
    """Blur along z beside the slice's thickness."""
    breathing_mm: float = 0.0
    """Slices lie up to this far from where they are told: the chest moved along z during the scan."""
    breathing_period_mm: float = 60.0
    motion_blur_mm: float = 0.0
    """Sigma of a blur along z, half of it from front to back, by movement within a slice."""
    # Tissue.
    air_hu: float = -1000.0
    wall_hu: float = 20.0
    vessel_hu: float = 40.0
    tissue_hu: float = 40.0
    nodule_hu: float = 30.0
    fissure_hu: float = -650.0
    mucus_hu: float = 15.0
    parenchyma_hu: float = -860.0
    gravity_hu: float = 50.0
    """Lung at the back above lung at the front."""
    lobule_hu: float = 14.0
    """Standard deviation of texture of about 6 mm."""
    grain_hu: float = 26.0
    """Standard deviation of texture of about 2 mm."""
    # What is added to the masks.
    emphysema_share: float = 0.0
    """Of the lung's volume, as holes of 2 to 9 mm across."""
    emphysema_hu: float = -975.0
    vessels_beside: bool = True
    """An artery beside each airway along which the masks have none."""
    twigs_per_tip: int = 0
    twig_diameter_mm: tuple[float, float] = (1.0, 1.5)
    twig_length_mm: tuple[float, float] = (8.0, 25.0)
    plugs: int = 0
    """Airways that mucus closes over 5 to 10 mm."""
    half_filled: int = 0
    """Airways along which fluid fills the lower half of the lumen."""
    terminal_share_per_mm2: float = 0.0
    """Share of the airways possible beyond the masks' tips that grow, for each mm2 of the square of their lumen's
    radius (:mod:`carina_bench.paint_terminal`)."""
    fine_vessels_per_ml: float = 0.0
    """Vessels of 0.3 to 0.6 mm radius in each millilitre of lung (:mod:`carina_bench.paint_fine_vessels`)."""

    def scanner(self) -> Kernel:
        """The kernel by its name."""
        return KERNELS[self.kernel]


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What there is to be scanned."""

    hu_zyx: NDArray[np.int16]
    """(nz, ny, nx) tissue on a grid, each value that of a whole cell; without the airways."""
    lps_from_ijk: Floats
    """4x4, of that grid; its axes are at right angles."""
    tubes: tuple[Tube, ...]
    """In LPS, mm."""
    fine_vessels: tuple[FineVessel, ...] = ()
    """In LPS, mm; thinner than the blur, so that only their sections' areas matter."""


@dataclass(frozen=True, slots=True, eq=False)
class Painted:
    """A painted CT and all that is true of it."""

    volume: Volume
    airways: tuple[Tube, ...]
    """True centrelines and radii where the image shows them: LPS mm, breathing included. No arteries."""
    cover_zyx: NDArray[np.uint8]
    """Share of each voxel that is lumen (wall to wall, fluid included), 255 the whole of it."""


@dataclass(frozen=True, slots=True, eq=False)
class Scanned:
    """A scene as blurred by the scanner, without the kernel's overshoot and without noise."""

    values_zyx: NDArray[np.float32]
    """HU."""
    lps_from_ijk: Floats
    airways: tuple[Tube, ...]
    """As :attr:`Painted.airways`."""
    cover_zyx: NDArray[np.uint8]
    """As :attr:`Painted.cover_zyx`."""


@dataclass(slots=True)
class _Axis:
    """One axis of source cells and of output voxels, in mm from the first source cell's centre."""

    cell_mm: float
    num_cells: int
    voxel_mm: float
    sigma_mm: float
    at_mm: Floats = field(default_factory=lambda: np.empty(0))
    """Where each output voxel looks."""

    @property
    def fine(self) -> int:
        return max(math.ceil(self.cell_mm / FINE_MM - 1e-9), 1)

    @property
    def tile(self) -> int:
        """Source cells of a tile."""
        return max(round(TILE_CELLS / self.fine), 4)

    @property
    def pad(self) -> int:
        """Source cells beyond the grid that its voxels still see."""
        return math.ceil(reach_mm(self.voxel_mm, self.sigma_mm) / self.cell_mm) + 1

    def voxels_near(self, low_mm: float, high_mm: float) -> slice:
        """Output voxels that see anything between two places."""
        reach = reach_mm(self.voxel_mm, self.sigma_mm)
        first = int(np.searchsorted(self.at_mm, low_mm - reach))
        return slice(first, int(np.searchsorted(self.at_mm, high_mm + reach)))


def paint(scene: Scene, options: PaintOptions, say: Callable[[str], None] | None = None) -> Painted:
    """The CT of a scene.

    Parameters
    ----------
    scene
        Tissue and tubes; what ``options`` say of tissue and additions was used for it (``scene_of_masks``).
    options
        Kernel, noise, slices, movement; values of air, wall, vessels and mucus.
    say
        Told of each step.

    Returns
    -------
    Painted
        The volume, the airways where the image shows them, and the lumen's share of each voxel. The same scene and
        options give the same voxels.
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
    """Return a scene blurred by the kernel's Gaussian and the slice profile; see :func:`paint`."""
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
    """x, y and z."""
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
    """How far from where it is told to lie a slice lies in the chest. Less than a fifth of the way between slices."""
    wave = 2.0 * math.pi / options.breathing_period_mm
    result: Floats = options.breathing_mm * np.sin(wave * z_mm + options.seed)
    return result


def _where_shown(points: Floats, z: _Axis, options: PaintOptions) -> Floats:
    """Places of the scene, moved to where the image shows them."""
    if options.breathing_mm == 0.0:
        return points
    told = np.arange(-20.0, z.cell_mm * z.num_cells + 20.0, 0.1)
    shown = points.copy()
    shown[:, 2] = np.interp(points[:, 2], told + _breath(told, options), told)
    return shown


def _blurred_tissue(hu_zyx: NDArray[np.int16], axes: tuple[_Axis, _Axis, _Axis]) -> NDArray[np.float32]:
    """The grid's cells as voxels; beyond the grid its last cells go on."""
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
    """Add what tubes change to the blurred tissue, and the lumen's share to the cover."""
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
    """Which segments have a say in which tile (x, y, z); tiles beyond the grid count as far as its voxels see."""
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
