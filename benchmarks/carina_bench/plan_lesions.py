"""``python -m carina_bench.plan_lesions``: volumes of lesions in whole CTs, segmented from one click.

``segmentations CT FOLDER`` clicks at the common centre of the DICOM SEG files of one lesion (every ``*.dcm`` below the
folder), and prints volume and error beside the range of the segmentations. A volume is *in range* if it lies within
the range widened by 15 % on each side; *covered* if the interval contains the median of the segmentations. Then up to
three strokes of the brush correct the boundary towards the voxels that most segmentations contain (`best_stroke`).

``implanted CT`` paints lesions of exact shape (a ball with lobes and spicules, in the lung, on its surface or at the
hilum) into a CT, and clicks at the centre of each. The lung of the CT itself states where the wall is.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray

import carina
from carina.errors import NoResultError
from carina.plan import Nodule, brushed, grow_nodule, nodule_from_mask, target_from_file
from carina.volume import Volume, open_mask
from carina.volume.mask_distances import ball_distance, distance_from

__all__ = [
    "BrushStroke",
    "Implanted",
    "Segmented",
    "best_stroke",
    "depth_mm",
    "implanted_lesions",
    "lung_of",
    "overlap",
    "segmented_lesion",
]

Mask = NDArray[np.bool_]

WIDENED = 0.15
"""Share by which the volume range of the readers' segmentations is widened on each side before the comparison."""
LUNG_HU, CLOSING_MM, MIN_LUNG_ML = -400.0, 5.0, 300.0
"""Threshold and closing that find the lung of a CT, and least volume of a lung."""
RADII_MM = (6.0, 9.0, 13.0, 18.0, 22.0, 26.0)
MAX_FREE_MM = 18.0
"""Maximum radius in mm of an implanted lesion that does not touch the chest wall."""
BRUSHES_MM: Final = (2.0, 3.0, 4.0, 6.0, 8.0, 12.0)
"""Radii in mm of the window's brush (``web/src/state/tools.ts``) that a stroke may use."""
MAX_STROKES, MAX_POINTS = 3, 2000
SLACK_MM = 1.0
"""Distance in mm by which a brush stroke may cross the boundary that it follows."""
HALF_MM = 78.0
"""Half side length in mm of the part of the CT round an implanted lesion."""


@dataclass(frozen=True, slots=True)
class Segmented:
    """Segmentations of one lesion, and the nodule from a click at their common centre."""

    volumes_mm3: tuple[float, ...]
    agreed_zyx: Mask
    """Voxels of the CT that at least half of the segmentations contain."""
    nodule: Nodule | None
    """Nodule from the click; None if the click was refused."""
    refusal: str

    @property
    def is_in_range(self) -> bool:
        """Whether the volume from the click lies in the widened range of the segmentations."""
        low, high = min(self.volumes_mm3) * (1.0 - WIDENED), max(self.volumes_mm3) * (1.0 + WIDENED)
        return self.nodule is not None and low <= self.nodule.volume_mm3 <= high

    @property
    def is_covered(self) -> bool:
        """Whether the stated interval of the volume contains the median volume of the readers' segmentations."""
        if self.nodule is None:
            return False
        off = abs(self.nodule.volume_mm3 - float(np.median(self.volumes_mm3)))
        return off <= self.nodule.volume_error_mm3


def segmented_lesion(volume: Volume, files: list[Path]) -> Segmented:
    """Return the volumes of the segmentations of a lesion, and the nodule from a click at their common centre."""
    num = np.zeros(volume.shape_zyx, dtype=np.uint8)
    volumes = []
    for file in files:
        mask = open_mask(file, volume, progress=False)
        num += mask.inside_zyx
        volumes.append(nodule_from_mask(volume, mask).volume_mm3)
    agreed = num >= 0.5 * len(files)
    middle = np.argwhere(agreed).mean(axis=0)[::-1]
    try:
        return Segmented(tuple(volumes), agreed, grow_nodule(volume, volume.to_lps(middle), progress=False), "")
    except NoResultError as error:
        return Segmented(tuple(volumes), agreed, None, error.code)


@dataclass(frozen=True, slots=True)
class BrushStroke:
    """Brush stroke, as in the window, in one axial, coronal or sagittal slice; it adds to or removes from a nodule."""

    points_lps: tuple[tuple[float, float, float], ...]
    radius_mm: float
    takes_away: bool

    def applied(self, nodule: Nodule, volume: Volume) -> Nodule:
        """Return the nodule after the stroke."""
        return brushed(nodule, volume, self.points_lps, self.radius_mm, add=not self.takes_away)


def best_stroke(nodule: Nodule, volume: Volume, wanted_zyx: Mask) -> BrushStroke | None:
    """Return the stroke in one slice that corrects most voxels of a boundary; None if no stroke corrects any.

    Parameters
    ----------
    nodule, volume
        The nodule and its CT.
    wanted_zyx
        Voxels of the CT inside the boundary that the user wants.
    """
    step, inside, matrix, wanted = _on_one_grid(nodule, volume, wanted_zyx)
    best, most = None, 0
    for takes_away in (False, True):
        # An added ball must lie in the boundary that the user wants, a removed ball outside.
        clearance_mm = ball_distance(~wanted if takes_away else wanted, step)
        change, keep = (inside & ~wanted, inside & wanted) if takes_away else (wanted & ~inside, ~wanted & ~inside)
        for radius_mm in BRUSHES_MM:
            centres = clearance_mm >= radius_mm - SLACK_MM
            # Only balls near the error change anything, and an added ball must touch the nodule.
            centres &= (distance_from(change, step, radius_mm + step) <= radius_mm) | change
            if not takes_away:
                centres &= (distance_from(inside, step, radius_mm + step) <= radius_mm) | inside
            # The window sends points that are a quarter of the radius apart.
            apart = max(int(0.25 * radius_mm / step), 1)
            sent = (np.indices(centres.shape) % apart == 0).sum(axis=0) >= 2
            centres &= sent
            for axis in range(3):
                occupied = np.flatnonzero(centres.any(axis=tuple(k for k in range(3) if k != axis)))
                for n in map(int, occupied):
                    reach = int(np.ceil(radius_mm / step)) + 1
                    slab = tuple(
                        slice(max(n - reach, 0), n + reach + 1) if k == axis else slice(None) for k in range(3)
                    )
                    at = tuple(slice(n, n + 1) if k == axis else slice(None) for k in range(3))
                    one = np.zeros_like(centres[slab])
                    own = n - max(n - reach, 0)
                    one[tuple(slice(own, own + 1) if k == axis else slice(None) for k in range(3))] = centres[at]
                    balls = one | (distance_from(one, step, radius_mm) + 0.5 * step <= radius_mm)
                    gain = int((balls & change[slab]).sum()) - int((balls & keep[slab]).sum())
                    if gain > most:
                        best, most = (axis, n, radius_mm, takes_away, centres[at]), gain
    if best is None:
        return None
    axis, n, radius_mm, takes_away, one = best
    places = np.argwhere(one)
    places[:, axis] += n
    places = places[:MAX_POINTS, ::-1]
    points = places @ matrix[:3, :3].T + matrix[:3, 3]
    return BrushStroke(tuple((float(x), float(y), float(z)) for x, y, z in points), radius_mm, takes_away)


def overlap(nodule: Nodule, volume: Volume, wanted_zyx: Mask) -> float:
    """Return the Dice coefficient of a nodule and a mask of the CT."""
    _, inside, _, wanted = _on_one_grid(nodule, volume, wanted_zyx)
    return float(2.0 * (inside & wanted).sum() / (inside.sum() + wanted.sum()))


def _on_one_grid(nodule: Nodule, volume: Volume, wanted_zyx: Mask) -> tuple[float, Mask, NDArray[np.float64], Mask]:
    """Return voxel size, mask and transform of a nodule on a grid that also contains a mask of the CT, and the mask."""
    step = float(np.linalg.norm(nodule.lps_from_ijk[:3, 0]))
    corners = np.argwhere(wanted_zyx)[:, ::-1]
    corners = np.array(np.meshgrid(*zip(corners.min(axis=0), corners.max(axis=0), strict=True))).reshape(3, -1).T
    placed = (volume.to_lps(corners.astype(float)) - nodule.lps_from_ijk[:3, 3]) @ np.linalg.inv(
        nodule.lps_from_ijk[:3, :3]
    ).T
    size = np.array(nodule.inside_zyx.shape[::-1])
    margin = 3
    before = np.maximum(np.ceil(-placed.min(axis=0)), 0).astype(int) + margin
    after = np.maximum(np.ceil(placed.max(axis=0) - size + 1), 0).astype(int) + margin
    inside = np.pad(nodule.inside_zyx, [(int(before[a]), int(after[a])) for a in (2, 1, 0)])
    matrix = nodule.lps_from_ijk.copy()
    matrix[:3, 3] -= matrix[:3, :3] @ before
    zyx = np.moveaxis(np.indices(inside.shape), 0, -1)
    at = np.rint(volume.to_ijk(zyx[..., ::-1].reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3])).astype(int)
    known = ((at >= 0) & (at < np.array(volume.shape_zyx[::-1]))).all(axis=1)
    wanted = np.zeros(len(at), dtype=bool)
    wanted[known] = wanted_zyx[at[known, 2], at[known, 1], at[known, 0]]
    return step, inside, matrix, wanted.reshape(inside.shape)


def lung_of(volume: Volume) -> Mask:
    """Return the lungs of a CT with their vessels, by a threshold and a closing; independent of Carina's own lungs."""
    air = volume.hu_zyx < LUNG_HU
    labels = sitk.GetArrayFromImage(sitk.ConnectedComponent(_image(air, volume)))
    sides = (labels[:, 0], labels[:, -1], labels[:, :, 0], labels[:, :, -1])
    inside = air & ~np.isin(labels, np.unique(np.concatenate([side.reshape(-1) for side in sides])))
    labels = sitk.GetArrayFromImage(sitk.RelabelComponent(sitk.ConnectedComponent(_image(inside, volume))))
    ml = np.bincount(labels.reshape(-1)) * float(np.prod(volume.spacing_mm)) / 1000.0
    lung = np.isin(labels, [n for n in range(1, len(ml)) if ml[n] >= MIN_LUNG_ML])
    grown = depth_mm(~lung, volume) <= CLOSING_MM
    return lung | (depth_mm(grown, volume) > CLOSING_MM)


def _image(mask: Mask, volume: Volume) -> Any:
    image = sitk.GetImageFromArray(mask.astype(np.uint8))
    image.SetSpacing([float(mm) for mm in volume.spacing_mm])
    return image


def depth_mm(mask: Mask, volume: Volume) -> NDArray[np.float32]:
    """Return the distance of each voxel in a mask from its surface in mm; negative outside."""
    away = sitk.SignedMaurerDistanceMap(_image(mask, volume), True, False, True)
    found: NDArray[np.float32] = sitk.GetArrayFromImage(away)
    return found


@dataclass(frozen=True, slots=True)
class Implanted:
    """Lesion of exact shape in a part of a CT."""

    volume: Volume
    kind: str
    radius_mm: float
    centre_lps: NDArray[np.float64]
    true_mm3: float


def implanted_lesions(volume: Volume, kind: str, num: int, seed: int) -> Iterator[Implanted]:
    """Yield lesions in the lung (kind *free*) or on its surface (*wall*)."""
    lung = lung_of(volume)
    depth = depth_mm(lung, volume)
    for n in range(num):
        rng = np.random.default_rng([seed + n, *kind.encode()])
        radius_mm = RADII_MM[n % len(RADII_MM)] * rng.uniform(0.9, 1.1)
        if kind == "free":
            radius_mm = min(radius_mm, MAX_FREE_MM)
        yield _implanted(volume, lung, depth, kind, radius_mm, rng)


def _implanted(
    volume: Volume, lung: Mask, depth: NDArray[np.float32], kind: str, radius_mm: float, rng: np.random.Generator
) -> Implanted:
    spacing = np.array(volume.spacing_mm)
    allowed = depth > radius_mm + 4.0 if kind == "free" else (depth > 0.15 * radius_mm) & (depth < 0.75 * radius_mm)
    margin = int(np.ceil(1.6 * radius_mm / spacing[2]))
    allowed[:margin] = allowed[allowed.shape[0] - margin :] = False
    places = np.flatnonzero(allowed)
    at = np.array(np.unravel_index(places[rng.integers(len(places))], allowed.shape))[::-1].astype(float)
    low = np.maximum(np.floor(at - HALF_MM / spacing), 0).astype(int)
    high = np.minimum(np.ceil(at + HALF_MM / spacing) + 1, volume.shape_zyx[::-1]).astype(int)
    part = tuple(slice(a, b) for a, b in zip(low[::-1], high[::-1], strict=True))
    hu, here = volume.hu_zyx[part].astype(np.float32), lung[part]
    zyx = np.moveaxis(np.indices(hu.shape), 0, -1)
    off = ((zyx[..., ::-1] + low - at) * spacing).astype(np.float32)
    away = [np.linalg.norm(off, axis=-1) - 0.8 * radius_mm]
    for _ in range(int(rng.integers(0, 6))):
        toward = _direction(rng)
        lobe_mm = radius_mm * rng.uniform(0.3, 0.6)
        away.append(np.linalg.norm(off - toward * radius_mm * rng.uniform(0.6, 1.1), axis=-1) - lobe_mm)
    # A smooth maximum joins the balls, so that the lesion has no creases.
    blend = 0.08 * radius_mm
    union = -blend * np.log(sum(np.exp(-np.clip(one / blend, -60.0, 60.0)) for one in away))
    own = np.clip(0.5 - union / spacing[0], 0.0, 1.0) * here
    for _ in range(int(rng.integers(0, 6))):
        toward = _direction(rng)
        along = off @ toward
        across = np.linalg.norm(off - along[..., None] * toward, axis=-1)
        width = np.where((along > 0.0) & (along < 1.8 * radius_mm), 1.2 * (1.0 - along / (1.8 * radius_mm)), -5.0)
        spicule = -860.0 + 700.0 * np.clip(0.5 - (across - width) / spacing[0], 0.0, 1.0)
        hu = np.where(here, np.maximum(hu, spicule), hu)
    grain = sitk.GetArrayFromImage(
        sitk.DiscreteGaussian(sitk.GetImageFromArray(rng.normal(size=hu.shape)), [0.5, 0.5, 1e-4])
    )
    level = rng.uniform(20.0, 60.0)
    blur = [0.36, 0.36, 0.36 if spacing[2] < 1.5 else 1e-4]
    image = sitk.GetImageFromArray(own.astype(np.float32))
    image.SetSpacing([float(mm) for mm in spacing])
    soft = sitk.GetArrayFromImage(sitk.DiscreteGaussian(image, blur))
    painted = hu * (1.0 - soft) + soft * (level + 15.0 * grain / grain.std())
    # Vessels with contrast medium stay visible in the lesion.
    painted = np.where((hu > level) & here & (soft > 0.5), hu, painted)
    matrix = volume.lps_from_ijk.copy()
    matrix[:3, 3] = volume.to_lps(low.astype(float))
    made = Volume(np.clip(np.rint(painted), -1024, 3000).astype(np.int16), matrix)
    middle = np.argwhere(own > 0.5).mean(axis=0)[::-1]
    voxel_mm3 = abs(float(np.linalg.det(matrix[:3, :3])))
    return Implanted(made, kind, radius_mm, made.to_lps(middle), float(own.sum()) * voxel_mm3)


def _direction(rng: np.random.Generator) -> NDArray[np.float32]:
    toward = rng.normal(size=3)
    return (toward / np.linalg.norm(toward)).astype(np.float32)


def _print_segmented(place: Path, folder: Path) -> None:
    volume = carina.open_volume(place, progress=False)
    files = sorted(folder.rglob("*.dcm"))
    found = segmented_lesion(volume, files)
    ml = np.array(found.volumes_mm3) / 1000.0
    print(f"{len(files)} segmentations: {ml.min():.2f} to {ml.max():.2f} ml, median {np.median(ml):.2f}")
    for file in files:
        target = target_from_file(file, volume, ct=place, progress=False)
        print(f"  {file.name}: {target.nodule.words}")
    if found.nodule is None:
        print(f"  click: refused ({found.refusal})")
        return
    nodule = found.nodule
    print(
        f"  click: {nodule.words}, +- {nodule.volume_error_mm3 / 1000.0:.2f} ml; "
        f"{'in range' if found.is_in_range else 'OUT OF RANGE'}, {'covered' if found.is_covered else 'NOT COVERED'}; "
        f"touches {', '.join(nodule.touches) or 'nothing'}"
    )
    for note in nodule.notes:
        print(f"  note: {note}")
    _print_strokes(volume, found)


def _print_strokes(volume: Volume, found: Segmented) -> None:
    """Print volume and overlap after each of at most `MAX_STROKES` strokes of the brush."""
    nodule = found.nodule
    assert nodule is not None
    low, high = min(found.volumes_mm3), max(found.volumes_mm3)
    for num in range(MAX_STROKES + 1):
        ml, dice = nodule.volume_mm3 / 1000.0, overlap(nodule, volume, found.agreed_zyx)
        is_in = low <= nodule.volume_mm3 <= high
        print(
            f"  {num} strokes: {ml:.2f} ml, {'in' if is_in else 'out of'} the range itself, Dice {dice:.3f}", flush=True
        )
        stroke = best_stroke(nodule, volume, found.agreed_zyx) if num < MAX_STROKES else None
        if stroke is None:
            return
        what = "remove" if stroke.takes_away else "add"
        print(f"    {what}, radius {stroke.radius_mm:g} mm, {len(stroke.points_lps)} points", flush=True)
        nodule = stroke.applied(nodule, volume)


def _print_implanted(place: Path, num: int, seed: int) -> None:
    volume = carina.open_volume(place, progress=False)
    for kind in ("free", "wall"):
        off, stated, refused = [], [], 0
        for lesion in implanted_lesions(volume, kind, num, seed):
            began = time.process_time()
            line = f"{kind:4s} radius {lesion.radius_mm:4.1f} mm, true {lesion.true_mm3:6.0f} mm3: "
            try:
                nodule = grow_nodule(lesion.volume, lesion.centre_lps, progress=False)
            except NoResultError as error:
                refused += 1
                print(f"{line}refused ({error.code})", flush=True)
                continue
            off.append(nodule.volume_mm3 / lesion.true_mm3 - 1.0)
            stated.append(nodule.volume_error_mm3 / lesion.true_mm3)
            print(
                f"{line}{100.0 * off[-1]:+4.0f} % +- {100.0 * stated[-1]:3.0f} %, {', '.join(nodule.touches)}, "
                f"{len(nodule.notes)} notes, {time.process_time() - began:.1f} s",
                flush=True,
            )
        apart, stated_errors = np.abs(off), np.array(stated)
        print(
            f"{kind}: {num}, refused {refused}, within 15 %: {(apart <= WIDENED).mean():.2f}, "
            f"median {100.0 * np.median(apart):.1f} %, worst {100.0 * apart.max():.0f} %, "
            f"stated {100.0 * np.median(stated_errors):.0f} %, held {(apart <= stated_errors).mean():.2f}",
            flush=True,
        )


def main() -> None:
    """Run the command line: compare the volumes of each lesion and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    of_files = commands.add_parser("segmentations", help="compare a click with DICOM SEG files of one lesion")
    of_files.add_argument("ct", type=Path)
    of_files.add_argument("folder", type=Path, help="folder of the SEG files")
    painted = commands.add_parser("implanted", help="compare clicks with lesions painted into a CT")
    painted.add_argument("ct", type=Path)
    painted.add_argument("--num", type=int, default=12, help="lesions of each kind")
    painted.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    if args.command == "segmentations":
        _print_segmented(args.ct, args.folder)
    else:
        _print_implanted(args.ct, args.num, args.seed)


if __name__ == "__main__":
    main()
