"""Painted CTs with structures that are hard to see: terminal airways, fine vessels, kernels with overshoot.

Each patient is cropped around the carina, painted once for each kernel in slices as thin as those of the masks, and
stored in a temporary folder. CTs of all slice thicknesses are computed from these thin slices.
"""

from __future__ import annotations

import hashlib
import io
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.disk import write_whole
from carina.volume import Volume, VolumeSource
from carina_bench.paint import PaintOptions, Scanned, scanned
from carina_bench.paint_scene import Masks, mask_folders, masks_of, scene_of_masks
from carina_bench.paint_slices import Slices, noisy_slices, slice_weights, sliced
from carina_bench.paint_tubes import Tube
from carina_bench.track_truth import TrueBranch, Truth, sampled

__all__ = ["KERNELS", "QUICK", "SLICES", "HardCase", "around_carina", "cached", "hard_cases", "imaged"]

Say = Callable[[str], None]

OPTIONS = PaintOptions(terminal_share_per_mm2=0.3, fine_vessels_per_ml=2.4)
"""Additions to the scenes: terminal airways and fine vessels."""
KERNELS = {"soft": "soft", "medium": "rimmed-medium", "sharp": "sharp"}
"""Kernels of :data:`carina_bench.paint.KERNELS`, by their names in the cases."""
SLICES: dict[str, Slices] = {
    "0.7mm": Slices(0.7),
    "1mm": Slices(1.0),
    "1.5mm": Slices(1.5),
    "2mm": Slices(2.0),
    "2.5mm": Slices(2.5),
    "3mm": Slices(3.0),
    "5mm": Slices(5.0),
    "3mm-every-2mm": Slices(3.0, 2.0),
    "5mm-every-2.5mm": Slices(5.0, 2.5),
    **{f"{mm:g}mm-resampled": Slices(mm, is_resampled=True) for mm in (1.0, 1.5, 2.0, 2.5, 3.0, 5.0)},
}
"""Slice thicknesses and distances between slices of the painted CTs, by their names in the cases."""
ABOVE_MM, BELOW_MM = 30.0, 55.0
"""Lengths of the painted part of the airways above and below the carina, mm."""
QUICK_MM = (25.0, 25.0)
"""Lengths in mm above and below the carina that a quick run paints."""
QUICK = ("medium", "0.7mm")
"""Kernel and slices of a quick run."""
BESIDE_MM = 8.0
"""Width in mm of the tissue outside the lungs that is included in a painted CT."""
HU_STEPS = 16.0
"""Number of steps per HU of stored values, which are multiples of 1/16 HU."""
MIN_BRONCHUS_MM2 = 25.0
"""Minimum area in mm2 of a piece of lumen in a slice that counts as a main bronchus."""


@dataclass(frozen=True, slots=True, eq=False)
class HardCase:
    """Painted CT with its truth and the same CT without noise."""

    patient: str
    kernel: str
    slices: str
    volume: Volume
    truth: Truth
    clean_zyx: NDArray[np.int16]

    @property
    def name(self) -> str:
        """Name of the case: patient, kernel and slices."""
        return f"{self.patient} {self.kernel} {self.slices}"


def hard_cases(
    data: Path,
    patients: Sequence[str],
    kernels: Sequence[str],
    slices: Sequence[str],
    say: Say,
    *,
    is_quick: bool = False,
    options: PaintOptions = OPTIONS,
) -> Iterator[HardCase]:
    """Yield the cases of each patient, kernel and slice thickness; patients without masks are reported and skipped."""
    folders = mask_folders(data)
    extent = QUICK_MM if is_quick else (ABOVE_MM, BELOW_MM)
    for patient in patients:
        if patient not in folders:
            say(f"{patient} has no masks in {data}: left out")
            continue
        scene_masks: list[Masks] = []
        for kernel in kernels:
            own = replace(options, kernel=KERNELS[kernel])

            def paint_thin(
                own: PaintOptions = own, patient: str = patient, masks: list[Masks] = scene_masks
            ) -> Scanned:
                if not masks:
                    masks.append(around_carina(masks_of(folders[patient]), *extent))
                return scanned(scene_of_masks(masks[0], own), own, lambda _step: None)

            thin = cached(_key(folders[patient], own, extent), paint_thin)
            for name in slices:
                volume, truth, clean = imaged(thin, own, SLICES[name])
                yield HardCase(patient, kernel, name, volume, truth, clean)


def imaged(thin: Scanned, options: PaintOptions, slices: Slices) -> tuple[Volume, Truth, NDArray[np.int16]]:
    """Return the CT of slices of the given thickness, its truth, and its CT values (nz, ny, nx) without noise, HU."""
    spacing = np.linalg.norm(thin.lps_from_ijk[:3, :3], axis=0)
    weights, first_mm, step_mm = slice_weights(len(thin.values_zyx), float(spacing[2]), slices)
    kernel, pixel_mm = options.scanner(), float(spacing[0])
    values = sliced(thin.values_zyx, weights)
    seed = (options.seed, 7)
    resampled = slices.is_resampled
    clean = noisy_slices(values, weights, kernel, pixel_mm, 0.0, seed)
    hu = noisy_slices(values, weights, kernel, pixel_mm, options.noise_hu, seed, is_resampled=resampled)
    hu.flags.writeable = False
    lps_from_ijk = thin.lps_from_ijk.copy()
    along = lps_from_ijk[:3, 2] / spacing[2]
    lps_from_ijk[:3, 2] = along * step_mm
    lps_from_ijk[:3, 3] += along * first_mm
    volume = Volume(hu, lps_from_ijk, source=VolumeSource(format="array", title="painted chest"))
    share = sliced(thin.cover_zyx.astype(np.float32), weights)
    branches = []
    for tube in thin.airways:
        points, radius = sampled(tube.points[tube.true_from :], tube.radius_mm[tube.true_from :])
        inside = np.array([volume.contains_lps(point) for point in points])
        if inside.sum() >= 2:
            branches.append(TrueBranch(points[inside], radius[inside], tube.generation))
    truth = Truth(share >= 127.5, tuple(branches), knows_radius=True, touched_zyx=share > 0.5)
    return volume, truth, clean


def around_carina(masks: Masks, above_mm: float, below_mm: float) -> Masks:
    """Return the masks cropped to ``above_mm`` above and ``below_mm`` below the carina, and in plane to the lungs."""
    up = float(masks.lps_from_ijk[2, 2])
    spacing = np.linalg.norm(masks.lps_from_ijk[:3, :3], axis=0)
    at = _carina_slice(masks.airways, float(spacing[0] * spacing[1]), is_upwards=up > 0.0)
    upper, lower = round(above_mm / spacing[2]), round(below_mm / spacing[2])
    low, high = (at - lower, at + upper) if up > 0.0 else (at - upper, at + lower)
    low, high = max(low, 0), min(high + 1, len(masks.airways))
    inside = masks.lungs[low:high] | masks.airways[low:high]
    box = [slice(low, high)]
    for axis, others in ((1, (0, 2)), (2, (0, 1))):
        used = np.flatnonzero(inside.any(axis=others))
        margin = round(BESIDE_MM / spacing[2 - axis])
        box.append(slice(max(int(used[0]) - margin, 0), int(used[-1]) + margin + 1))
    part = tuple(box)
    lps_from_ijk = masks.lps_from_ijk.copy()
    lps_from_ijk[:3, 3] += lps_from_ijk[:3, :3] @ [axis.start for axis in part[::-1]]

    def cut(mask: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
        return None if mask is None else np.ascontiguousarray(mask[part])

    return Masks(
        lps_from_ijk,
        np.ascontiguousarray(masks.airways[part]),
        np.ascontiguousarray(masks.lungs[part]),
        cut(masks.vessels),
        cut(masks.nodule),
        cut(masks.fissures),
    )


def _carina_slice(airways: NDArray[np.bool_], pixel_mm2: float, *, is_upwards: bool) -> int:
    """Return the index of the highest slice in which the airways are two main bronchi."""
    ndimage: Any = import_module("scipy.ndimage")
    used = np.flatnonzero(airways.any(axis=(1, 2)))
    for k in used[::-1] if is_upwards else used:
        labels, num = ndimage.label(airways[k])
        areas = np.bincount(labels.ravel(), minlength=num + 1)[1:] * pixel_mm2
        if (areas >= MIN_BRONCHUS_MM2).sum() >= 2:
            return int(k)
    message = "the mask of the airways does not show two main bronchi"
    raise ValueError(message)


def _key(folder: Path, options: PaintOptions, extent: tuple[float, float]) -> str:
    """Return a key of all inputs of a painted volume: masks, options, extent, and the painter's source code."""
    digest = hashlib.sha256(repr((options, extent)).encode())
    for path in sorted(folder.iterdir()):
        status = path.stat()
        digest.update(repr((path.parent.parent.name, folder.name, path.name, status.st_size)).encode())
    for path in sorted(Path(__file__).parent.glob("paint*.py")):
        digest.update(path.read_bytes())
    digest.update(Path(__file__).read_bytes())
    return digest.hexdigest()[:24]


def cached(key: str, paint_thin: Callable[[], Scanned], folder: Path | None = None) -> Scanned:
    """Return the volume stored under ``key`` in ``folder`` (default: a temporary folder), or paint and store it."""
    folder = Path(tempfile.gettempdir()) / "carina-bench-hard" if folder is None else folder
    path = folder / f"{key}.npz"
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        _keep(path, paint_thin())
    with np.load(path) as archive:
        ends = np.cumsum(archive["num_points"])[:-1]
        airways = tuple(
            Tube(points, radius, id=int(own), generation=int(generation), true_from=int(true_from))
            for points, radius, own, generation, true_from in zip(
                np.split(archive["points"], ends),
                np.split(archive["radius"], ends),
                archive["id"],
                archive["generation"],
                archive["true_from"],
                strict=True,
            )
        )
        values = archive["values"].astype(np.float32) / np.float32(HU_STEPS)
        return Scanned(values, archive["lps_from_ijk"], airways, archive["cover"])


def _keep(path: Path, thin: Scanned) -> None:
    buffer = io.BytesIO()
    tubes = thin.airways
    np.savez(
        buffer,
        values=np.clip(np.rint(thin.values_zyx * HU_STEPS), -32768, 32767).astype(np.int16),
        cover=thin.cover_zyx,
        lps_from_ijk=thin.lps_from_ijk,
        points=np.concatenate([tube.points for tube in tubes]),
        radius=np.concatenate([tube.radius_mm for tube in tubes]),
        num_points=np.array([len(tube.points) for tube in tubes]),
        id=np.array([tube.id for tube in tubes]),
        generation=np.array([tube.generation for tube in tubes]),
        true_from=np.array([tube.true_from for tube in tubes]),
    )
    write_whole(path, buffer.getvalue(), what="a painted CT")
