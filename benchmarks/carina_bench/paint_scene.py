"""Scenes of painted CTs, made from a patient's masks: smooth tubes, lung texture, vessels, added structures."""

from __future__ import annotations

import importlib
import math
import shutil
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import carina
from carina.volume import Volume
from carina_bench.paint import PaintOptions, Scene
from carina_bench.paint_fine_vessels import FineVessel, fine_vessels
from carina_bench.paint_terminal import terminal_airways
from carina_bench.paint_tubes import Tube, wall_mm
from carina_bench.track_truth import truth_of_mask

__all__ = ["Masks", "mask_folders", "masks_of", "opened", "scene_of_masks", "tubes_of_mask"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

SMOOTH_CENTRE_MM = 1.5
"""Standard deviation of the smoothing of centrelines along an airway, mm."""
SMOOTH_RADIUS_MM = 2.5
"""Standard deviation of the smoothing of radii along an airway, mm."""
STEP_MM = 0.5
"""Distance in mm between two points on the axis of a painted tube."""

AIRWAY_FILES = ("bronchialTree.nii.gz", "BronchialTree.nii.gz", "BronchialTree.gz")
"""Names that the file of the airway mask may have in a patient's folder."""
LUNG_FILES = ("pleuralBoundary.nii.gz",)
"""File names under which a data set may contain the lung mask."""
LOBE_FILES = ("LLL.nii.gz", "LUL.nii.gz", "RLL.nii.gz", "RML.nii.gz", "RUL.nii.gz")
"""File names of the masks of the five lobes."""


@dataclass(frozen=True, slots=True, eq=False)
class Masks:
    """Masks of a patient, all (nz, ny, nx) on one grid; None for a structure without a mask."""

    lps_from_ijk: Floats
    airways: Mask
    lungs: Mask
    vessels: Mask | None = None
    nodule: Mask | None = None
    fissures: Mask | None = None


def mask_folders(data: Path) -> dict[str, Path]:
    """Return the folders below ``data`` with an airway and a lung mask of a patient, by a short name."""
    found = {}
    for kind, letter in (("thin_slice_airways", ""), ("thin_slice_lobes", "lobes-")):
        for folder in sorted((data / "masks" / kind).glob("Patient*")):
            if any((folder / name).is_file() for name in AIRWAY_FILES):
                found[letter + folder.name] = folder
    return found


def masks_of(folder: Path) -> Masks:
    """Read the masks of a patient's folder; the lungs are read from a lung mask or are the union of the five lobes."""
    airways = next(volume for name in AIRWAY_FILES if (volume := opened(folder / name)) is not None)

    def mask(name: str) -> Mask | None:
        volume = opened(folder / name)
        if volume is None:
            return None
        if volume.shape_zyx != airways.shape_zyx or not np.allclose(
            volume.lps_from_ijk, airways.lps_from_ijk, atol=1e-3
        ):
            message = f"{name} of {folder.name} is not on the grid of its airways"
            raise ValueError(message)
        inside: Mask = volume.hu_zyx != 0
        return inside

    lungs = mask(LUNG_FILES[0])
    for name in LOBE_FILES if lungs is None else ():
        lobe = mask(name)
        if lobe is not None:
            lungs = lobe if lungs is None else lungs | lobe
    if lungs is None:
        message = f"{folder.name} has no mask of the lungs"
        raise ValueError(message)
    return Masks(
        airways.lps_from_ijk,
        airways.hu_zyx != 0,
        lungs,
        mask("vessels.nii.gz"),
        mask("nodule.nii.gz"),
        mask("fissures.nii.gz"),
    )


def opened(path: Path) -> Volume | None:
    """Open the file of a mask as a volume, so that all masks are converted from their files' axes in the same way."""
    if not path.is_file():
        return None
    if path.name.endswith(".nii.gz"):
        return carina.open_volume(path)
    # The file is a NIfTI without the usual suffix, so it is copied under another name.
    with tempfile.TemporaryDirectory() as folder:
        named = Path(folder) / "mask.nii.gz"
        shutil.copyfile(path, named)
        return carina.open_volume(named)


def tubes_of_mask(mask_zyx: Mask, lps_from_ijk: Floats) -> tuple[Tube, ...]:
    """Return the airways of a mask as tubes with smoothed centrelines and radii.

    A skeleton is exact to a voxel only, and the distance to the mask's edge is less than the radius by up to half a
    voxel. The volume of the mask's voxels along a branch gives a more exact radius, that of a circle with the mean area
    of its sections. At forks, where two branches share voxels, the distance to the edge limits the radius.
    """
    grid = Volume(np.zeros(mask_zyx.shape, np.int16), lps_from_ijk)
    truth = truth_of_mask(mask_zyx, grid)
    spatial: Any = importlib.import_module("scipy.spatial")
    voxel_mm3 = float(np.prod(grid.spacing_mm))
    voxel_mm = float(np.cbrt(voxel_mm3))
    points = np.concatenate([branch.points for branch in truth.branches])
    steps = np.concatenate([_shares(branch.points) for branch in truth.branches])
    voxels = grid.to_lps(np.argwhere(mask_zyx)[:, ::-1].astype(np.float64))
    away, nearest = spatial.cKDTree(points).query(voxels)
    edge = np.concatenate([branch.radius_mm for branch in truth.branches])
    # The condition excludes voxels of spurs, which were removed from the skeleton.
    own = away <= 1.5 * edge[nearest] + 2.0 * voxel_mm
    volume = np.bincount(nearest[own], minlength=len(points)) * voxel_mm3
    tubes = []
    first = 0
    for place, branch in enumerate(truth.branches):
        part = slice(first, first + len(branch.points))
        first = part.stop
        step = float(np.linalg.norm(branch.points[1] - branch.points[0]))
        area = _smooth(np.asarray(volume[part], np.float64), step, SMOOTH_RADIUS_MM) / np.maximum(
            _smooth(steps[part], step, SMOOTH_RADIUS_MM), 1e-6
        )
        depth = _smooth(edge[part], step, SMOOTH_RADIUS_MM)
        radius = np.clip(np.sqrt(area / math.pi), depth, 1.5 * depth + 0.5 * voxel_mm)
        radius = _smooth(np.maximum(radius, 0.45 * voxel_mm), step, SMOOTH_RADIUS_MM)
        centre = np.stack([_smooth(axis, step, SMOOTH_CENTRE_MM, pinned=True) for axis in branch.points.T], axis=1)
        keep = np.unique(np.append(np.arange(0, len(centre), max(round(STEP_MM / step), 1)), len(centre) - 1))
        tubes.append(Tube(centre[keep], radius[keep], place, branch.parent, branch.generation))
    return tuple(tubes)


def _shares(points: Floats) -> Floats:
    """Return, for each point of a line, the length in mm of the part of the line that is nearest to this point."""
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    result: Floats = 0.5 * (np.append(step, 0.0) + np.insert(step, 0, 0.0))
    return result


def _smooth(values: Floats, step: float, sigma_mm: float, *, pinned: bool = False) -> Floats:
    """Return values along a line of even steps, smoothed by a Gaussian.

    The values are mirrored at both ends of the line; with ``pinned`` they are point-reflected, so that the values of
    the ends stay.
    """
    sigma = min(sigma_mm / step, 0.25 * len(values))
    reach = min(math.ceil(3.0 * sigma), len(values) - 1)
    if reach < 1:
        return values
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    before, after = values[reach:0:-1], values[-2 : -2 - reach : -1]
    if pinned:
        before, after = 2.0 * values[0] - before, 2.0 * values[-1] - after
    result: Floats = np.convolve(np.concatenate([before, values, after]), kernel / kernel.sum(), mode="valid")
    return result


def scene_of_masks(masks: Masks, options: PaintOptions) -> Scene:
    """Return the scene of a patient; structures that ``options`` adds are random with the seed of ``options``."""
    grid = Volume(np.zeros((1, 1, 1), np.int16), masks.lps_from_ijk)
    rng = np.random.default_rng((options.seed, 1))
    tubes = list(tubes_of_mask(masks.airways, masks.lps_from_ijk))
    space = _Space(masks, grid)
    if options.twigs_per_tip:
        tubes += _twigs(tubes, space, options, rng)
    if options.terminal_share_per_mm2 > 0.0:
        of_terminal = np.random.default_rng((options.seed, 4))
        tubes += terminal_airways(tubes, space, options.terminal_share_per_mm2, of_terminal)
    if options.plugs or options.half_filled:
        tubes = _filled(tubes, options, rng)
    arteries = _arteries(tubes, space, rng) if options.vessels_beside else []
    every = (*tubes, *arteries)
    thin: tuple[FineVessel, ...] = ()
    if options.fine_vessels_per_ml > 0.0:
        lung_lps = _places_in(masks.lungs, grid, np.random.default_rng((options.seed, 5)))
        lung_ml = 1e-3 * float(masks.lungs.sum() * np.prod(grid.spacing_mm))
        num = round(options.fine_vessels_per_ml * lung_ml)
        thin = fine_vessels(every, space, lung_lps, num, np.random.default_rng((options.seed, 6)))
    return Scene(_tissue(masks, grid, options), masks.lps_from_ijk, every, thin)


def _places_in(mask: Mask, grid: Volume, rng: np.random.Generator, num: int = 50_000) -> Floats:
    """Return ``num`` random points (n, 3), LPS mm, evenly distributed in a mask."""
    voxels = np.flatnonzero(mask)
    chosen = np.stack(np.unravel_index(voxels[rng.integers(len(voxels), size=num)], mask.shape)[::-1], axis=1)
    result: Floats = grid.to_lps(chosen + rng.uniform(-0.5, 0.5, chosen.shape))
    return result


class _Space:
    """Masks with tests whether points (LPS mm) are in lung or near a vessel."""

    def __init__(self, masks: Masks, grid: Volume) -> None:
        self._masks = masks
        self._grid = grid
        self._sphere = _sphere(26)

    def _ask(self, mask: Mask, points: Floats) -> Mask:
        ijk = np.rint(self._grid.to_ijk(points)).astype(int)
        shape = np.array(mask.shape[::-1])
        inside = ((ijk >= 0) & (ijk < shape)).all(axis=1)
        i, j, k = np.clip(ijk, 0, shape - 1).T
        result: Mask = mask[k, j, i] & inside
        return result

    def in_lung(self, points: Floats, margin_mm: float, *, num: int = 26) -> Mask:
        """Return a mask (n,) of points in the lung, ``margin_mm`` or more from its border in ``num`` directions."""
        sphere = self._sphere if num == len(self._sphere) else _sphere(num)
        around = points[:, None, :] + margin_mm * sphere[None]
        inside = self._ask(self._masks.lungs, around.reshape(-1, 3)).reshape(len(points), -1)
        return np.asarray(inside.all(axis=1), np.bool_)

    def at_vessel(self, points: Floats, reach_mm: float) -> Mask:
        """Return for each point whether a vessel of the masks is within ``reach_mm``."""
        if self._masks.vessels is None:
            return np.zeros(len(points), np.bool_)
        shells = np.concatenate([reach_mm * share * self._sphere for share in (1.0, 0.75, 0.5, 0.25)])
        around = points[:, None, :] + shells[None]
        inside = self._ask(self._masks.vessels, around.reshape(-1, 3)).reshape(len(points), -1)
        return np.asarray(inside.any(axis=1), np.bool_)


def _sphere(num: int) -> Floats:
    n = np.arange(num) + 0.5
    turn, z = math.pi * (1.0 + math.sqrt(5.0)) * n, 1.0 - 2.0 * n / num
    flat = np.sqrt(1.0 - z * z)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)


def _across(direction: Floats, rng: np.random.Generator) -> Floats:
    """Return a random unit vector perpendicular to a direction."""
    other = rng.standard_normal(3)
    other -= (other @ direction) * direction
    result: Floats = other / np.linalg.norm(other)
    return result


def _twigs(tubes: list[Tube], space: _Space, options: PaintOptions, rng: np.random.Generator) -> list[Tube]:
    """Return additional small airways (twigs) at the tips of tubes.

    Each twig stays in the lung and clear of vessels and other airways.
    """
    spatial: Any = importlib.import_module("scipy.spatial")
    parents = {tube.parent for tube in tubes}
    found: list[Tube] = []
    for tip in [tube for tube in tubes if tube.id not in parents]:
        towards = tip.points[-1] - tip.points[max(len(tip.points) - 8, 0)]
        towards = towards / np.linalg.norm(towards)
        side = _across(towards, rng)
        for n in range(options.twigs_per_tip):
            radius = min(0.5 * rng.uniform(*options.twig_diameter_mm), 0.9 * float(tip.radius_mm[-1]))
            if radius < 0.5 * options.twig_diameter_mm[0]:
                continue
            others = [tube for tube in (*tubes, *found) if tube.id != tip.id]
            there = np.concatenate([tube.points for tube in others])
            reach = np.concatenate([tube.radius_mm + wall_mm(tube.radius_mm) for tube in others])
            outer = radius + float(wall_mm(np.array(radius)))
            tree = spatial.cKDTree(there)
            turn = 2.0 * math.pi * n / options.twigs_per_tip
            away = math.cos(turn) * side + math.sin(turn) * np.cross(towards, side)
            for _ in range(6):
                angle = math.radians(rng.uniform(25.0, 50.0))
                heading = math.cos(angle) * towards + math.sin(angle) * away
                points = _wandering(tip.points[-1], heading, rng.uniform(*options.twig_length_mm), rng)
                along = STEP_MM * np.arange(len(points))
                clear = space.in_lung(points, outer + 2.0) & ~space.at_vessel(points, outer + 0.3)
                gap, nearest = tree.query(points)
                clear &= gap > outer + reach[nearest] + 0.5
                # The twigs of one tip overlap near the tip, so no distance between them is required there.
                clear |= along < tip.radius_mm[-1] + 3.0
                end = len(points) if clear.all() else int(np.argmin(clear))
                if along[end - 1] >= options.twig_length_mm[0]:
                    found.append(
                        Tube(
                            points[:end],
                            np.linspace(radius, max(0.9 * radius, 0.5 * options.twig_diameter_mm[0]), end),
                            id=len(tubes) + len(found),
                            parent=tip.id,
                            generation=tip.generation + 1,
                            true_from=min(math.ceil(tip.radius_mm[-1] / STEP_MM), end - 2),
                        )
                    )
                    break
                away = _across(towards, rng)
    return found


def _wandering(start: Floats, heading: Floats, length_mm: float, rng: np.random.Generator) -> Floats:
    """Return a line (n, 3) from ``start`` that bends slightly and evenly, with points :data:`STEP_MM` apart."""
    num = max(math.ceil(length_mm / STEP_MM), 2) + 1
    bend = _across(heading, rng) * rng.uniform(0.0, 0.02)
    points = [start]
    for _ in range(num - 1):
        points.append(points[-1] + STEP_MM * heading)
        heading = heading + STEP_MM * bend
        heading = heading / np.linalg.norm(heading)
    return np.array(points)


def _filled(tubes: list[Tube], options: PaintOptions, rng: np.random.Generator) -> list[Tube]:
    """Return the tubes with mucus in some airways that are segmental or smaller and have child branches."""
    parents = {tube.parent for tube in tubes}
    fit = [
        n
        for n, tube in enumerate(tubes)
        if tube.id in parents
        and tube.generation >= 3
        and 0.8 <= float(np.median(tube.radius_mm)) <= 4.0
        and len(tube.points) * STEP_MM >= 8.0
    ]
    chosen = rng.permutation(fit)[: options.plugs + options.half_filled]
    for count, n in enumerate(chosen):
        tube = tubes[n]
        along = STEP_MM * np.arange(len(tube.points))
        middle = 0.5 * along[-1]
        if count < options.plugs:
            half, most = 0.5 * rng.uniform(5.0, 10.0), 1.0
        else:
            half, most = middle, 0.0
        share = np.clip((half - np.abs(along - middle)) / 1.0, 0.0, 1.0)
        tubes[n] = replace(tube, filled_from=-1.0 + share * (most + 1.0))
    return tubes


def _arteries(tubes: list[Tube], space: _Space, rng: np.random.Generator) -> list[Tube]:
    """Return an artery beside each small airway that has no vessel of the masks beside it.

    The artery is as wide as the airway with its wall.
    """
    found: list[Tube] = []
    for tube in tubes:
        outer = tube.outer_mm()
        if tube.generation < 3 or len(tube.points) < 6 or float(np.median(tube.radius_mm)) > 2.5:
            continue
        if space.at_vessel(tube.points, float(np.median(outer)) + 2.5).mean() > 0.5:
            continue
        radius = 0.9 * outer
        directions = np.gradient(tube.points, axis=0)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        side = _across(directions[0], rng)
        beside = []
        for point, direction, away in zip(tube.points, directions, outer + radius + 0.1, strict=True):
            side = side - (side @ direction) * direction
            side = side / np.linalg.norm(side)
            beside.append(point + away * side)
        points = np.array(beside)
        # An artery starts beyond the fork, because at the fork it would be inside the parent airway; all its points
        # must be in the lung.
        usable = space.in_lung(points, 1.0) & (STEP_MM * np.arange(len(points)) >= 2.0)
        if usable.sum() >= 5:
            run = np.flatnonzero(usable)
            part = slice(int(run[0]), int(run[-1]) + 1)
            found.append(Tube(points[part], radius[part], id=-1 - len(found), is_artery=True))
    return found


def _tissue(masks: Masks, grid: Volume, options: PaintOptions) -> NDArray[np.int16]:
    """Return the CT values (HU) of body, lungs, vessels and nodule on the masks' grid, without the airways."""
    shape = masks.airways.shape
    spacing = np.array(grid.spacing_mm)
    lungs = _with_holes_closed(masks, spacing)
    hu = np.where(_body(masks, spacing), np.int16(options.tissue_hu), np.int16(-1000))
    # Lung is denser at the back, which is the lowest part of a patient who lies on the back.
    back = grid.lps_from_ijk[1, :3]
    ijk_mm = [np.arange(n) * back[axis] for axis, n in enumerate(shape[::-1])]
    low, high = (sum(float(f(part)) for part in ijk_mm) for f in (np.min, np.max))
    rng = np.random.default_rng((options.seed, 2))
    lobules = _Texture(shape, spacing, 6.0, rng)
    grain = _Texture(shape, spacing, 2.0, rng)
    holes = _emphysema(masks.lungs, spacing, options) if options.emphysema_share > 0.0 else None
    for k in range(shape[0]):
        behind = (ijk_mm[0][None, :] + ijk_mm[1][:, None] + ijk_mm[2][k] - low) / (high - low) - 0.5
        plane = options.parenchyma_hu + options.gravity_hu * behind
        plane = plane + options.lobule_hu * lobules.at(k) + options.grain_hu * grain.at(k)
        if holes is not None:
            plane += holes[k] * (options.emphysema_hu - plane)
        lung = lungs[k]
        hu[k][lung] = np.clip(plane[lung], -1000.0, 0.0)
        for mask, value in (
            (masks.fissures, options.fissure_hu),
            (masks.vessels, options.vessel_hu),
            (masks.nodule, options.nodule_hu),
        ):
            if mask is not None:
                hu[k][mask[k] & lung] = value
    return hu


class _Texture:
    """Smooth random field of variance 1: random values on a coarse grid, interpolated slice by slice."""

    def __init__(self, shape: tuple[int, ...], spacing_xyz: Floats, size_mm: float, rng: np.random.Generator) -> None:
        knot_mm = 0.5 * size_mm
        coarse = [math.ceil((n - 1) * s / knot_mm) + 5 for n, s in zip(shape, spacing_xyz[::-1], strict=True)]
        self._knots = rng.standard_normal(coarse, dtype=np.float32)
        self._weights = [
            _spline(np.arange(n) * s / knot_mm + 1.0, m).astype(np.float32)
            for n, s, m in zip(shape, spacing_xyz[::-1], coarse, strict=True)
        ]

    def at(self, k: int) -> NDArray[np.float32]:
        z, y, x = self._weights
        used = np.flatnonzero(z[k])
        plane = np.tensordot(z[k][used], self._knots[used], 1)
        result: NDArray[np.float32] = y @ plane @ x.T
        return result


def _spline(at: Floats, num: int) -> Floats:
    """Return the weights (m, num) of the knots of a cubic B-spline at m positions.

    The weights are scaled so that random knots of variance 1 give values of variance 1.
    """
    base = np.floor(at).astype(int)
    t = at - base
    parts = ((1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3)
    weights = np.zeros((len(at), num))
    for n, part in enumerate(parts):
        weights[np.arange(len(at)), base - 1 + n] = part / 6.0
    result: Floats = weights / np.linalg.norm(weights, axis=1, keepdims=True)
    return result


def _with_holes_closed(masks: Masks, spacing: Floats) -> Mask:
    """Return the lung mask with its holes closed, which are the airways (painted again) and the vessels."""
    sitk: Any = importlib.import_module("SimpleITK")
    coarse = masks.lungs[::2, ::2, ::2]
    image = sitk.GetImageFromArray(coarse.astype(np.uint8))
    image.SetSpacing([float(2.0 * s) for s in spacing])
    grown = sitk.GetArrayFromImage(sitk.SignedMaurerDistanceMap(image, False, False, True)) <= 4.0
    image = sitk.GetImageFromArray(grown.astype(np.uint8))
    image.SetSpacing([float(2.0 * s) for s in spacing])
    closed = sitk.GetArrayFromImage(sitk.SignedMaurerDistanceMap(image, False, False, True)) <= -4.0
    return masks.lungs | _repeated(closed, masks.lungs.shape, 2) & _near_tubes(masks)


def _near_tubes(masks: Masks) -> Mask:
    """Return the voxels of airways and vessels, dilated by two voxels in plane."""
    inside = masks.airways if masks.vessels is None else masks.airways | masks.vessels
    for axis in (1, 2):
        grown = inside.copy()
        for step in (-2, -1, 1, 2):
            grown |= np.roll(inside, step, axis=axis)
        inside = grown
    return inside


def _repeated(mask: Mask, shape: tuple[int, ...], factor: int) -> Mask:
    for axis in range(3):
        mask = np.repeat(mask, factor, axis=axis)
    pad = [(0, max(n - m, 0)) for n, m in zip(shape, mask.shape, strict=True)]
    result: Mask = np.pad(mask, pad, mode="edge")[: shape[0], : shape[1], : shape[2]]
    return result


def _body(masks: Masks, spacing: Floats) -> Mask:
    """Return the mask of the body: 18 mm around the lungs, the region between them, and a neck around the trachea."""
    sitk: Any = importlib.import_module("SimpleITK")
    factor = 4
    coarse = masks.lungs[::factor, ::factor, ::factor] | masks.airways[::factor, ::factor, ::factor]
    column = np.asarray(masks.airways.any(axis=0), np.bool_)[::factor, ::factor]
    image = sitk.GetImageFromArray(coarse.astype(np.uint8))
    image.SetSpacing([float(factor * s) for s in spacing])
    body = sitk.GetArrayFromImage(sitk.SignedMaurerDistanceMap(image, False, False, True)) <= 18.0
    seen = np.logical_or.accumulate
    body = seen(body, axis=2) & seen(body[:, :, ::-1], axis=2)[:, :, ::-1]
    flat = sitk.GetImageFromArray(column.astype(np.uint8))
    flat.SetSpacing([float(factor * s) for s in spacing[:2]])
    body |= (sitk.GetArrayFromImage(sitk.SignedMaurerDistanceMap(flat, False, False, True)) <= 35.0)[None]
    return _repeated(body, masks.lungs.shape, factor)


def _emphysema(lungs: Mask, spacing: Floats, options: PaintOptions) -> NDArray[np.float32]:
    """Return for each cell the share (0 to 1) that is occupied by round holes with soft edges."""
    rng = np.random.default_rng((options.seed, 3))
    result = np.zeros(lungs.shape, np.float32)
    places = np.argwhere(lungs[::3, ::3, ::3]) * 3
    wanted = options.emphysema_share * float(lungs.sum() * np.prod(spacing))
    size = spacing[::-1]
    while wanted > 0.0:
        radius = 0.5 * rng.uniform(2.0, 9.0)
        middle = places[rng.integers(len(places))]
        reach = np.ceil((radius + 1.0) / size).astype(int)
        low, high = np.maximum(middle - reach, 0), np.minimum(middle + reach + 1, lungs.shape)
        axes = [(np.arange(a, b) - m) * s for a, b, m, s in zip(low, high, middle, size, strict=True)]
        away = np.sqrt(axes[0][:, None, None] ** 2 + axes[1][None, :, None] ** 2 + axes[2][None, None, :] ** 2)
        at = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        result[at] = np.maximum(result[at], np.clip(0.5 + radius - away, 0.0, 1.0))
        wanted -= 4.0 / 3.0 * math.pi * radius**3
    return result
