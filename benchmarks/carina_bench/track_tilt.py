"""``carina bench track --only tilt``: the airway tree of CTs with a tilted gantry, beside that of the straight CT.

A phantom is scanned with a gantry that is tilted about the patient's left-right axis: the slices are tilted, the table
moves along the patient. Each scan is written as a DICOM series, opened (Carina corrects the tilt) and searched. The
straight CT is scanned in the same way, without tilt. TD and BD of all scans are computed on the same true airways:
those that every scan covers.

Thick slices at another angle show other airways, whatever the correction does. The case ``aligned`` scans the planes of
the tilted slices on a rectangular grid, as a correction without any interpolation would give them.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.errors import CarinaError
from carina.phantom import Phantom, generate_phantom
from carina.track import find_airways
from carina.volume import Volume, open_volume
from carina_bench.track_quality import DETECTED_SHARE, is_near
from carina_bench.track_truth import TrueBranch, truth_of_phantom
from carina_bench.written_series import write_stack

__all__ = ["Scanner", "covered_branches", "detection", "opened", "rows_of", "run"]

Say = Callable[[str], None]
Row = dict[str, Any]

TILTS_DEG = (0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0)
"""Tilts of the gantry in degrees; the first is the straight CT. The case ``negative`` tilts the other way."""
THICK_MM = 3.0
"""Slice thickness and table feed of the case ``3mm``."""
SEEDS = (21, 22)
"""Seeds of the phantoms."""
SAMPLED_MM, PIXEL_MM, SLICE_MM, NOISE_HU = 0.6, 1.0, 1.25, 20.0
"""Voxels of the phantom that is scanned, pixels, thickness and table feed of the scans (mm), and noise (HU)."""
ANTERIOR_MM, CAUDAL_MM, CRANIAL_MM = 125.0, 205.0, 95.0
"""Half of the scanned depth, and heights of the lowest and the highest slice below and above the carina, mm."""
NUM_LAYERS = 3
"""Number of planes whose mean is a slice."""
MAX_DIFFERENCE = 0.01
"""Largest allowed difference of TD and BD from the straight CT."""


@dataclasses.dataclass(frozen=True, slots=True)
class Scanner:
    """Geometry of a scan with a tilted gantry, and its noise."""

    tilt_deg: float
    """Rotation of the slices about the patient's left-right axis, degrees."""
    pixel_mm: float = PIXEL_MM
    """Distance of pixels along the columns; along the rows it is that of the phantom's voxels."""
    slice_mm: float = SLICE_MM
    """Thickness of the slices, and table feed from slice to slice."""
    noise_hu: float = NOISE_HU
    """Standard deviation of the white noise."""
    is_aligned: bool = False
    """Whether the rows of all slices lie on one rectangular grid, as in a corrected series."""

    @property
    def half_mm(self) -> float:
        """Half of the width of a slice along its columns."""
        return ANTERIOR_MM / float(np.cos(np.radians(self.tilt_deg)))

    @property
    def shifts_mm(self) -> NDArray[np.float64]:
        """Shift (slices,) of each slice along its columns against the rectangular grid."""
        return self.heights_mm * float(np.sin(np.radians(self.tilt_deg)))

    @property
    def along_mm(self) -> NDArray[np.float64]:
        """Position (rows,) of each row in the slice at the carina, from the axis of the tilt."""
        half_mm = self.half_mm + (float(np.abs(self.shifts_mm).max()) if self.is_aligned else 0.0)
        return np.arange(-half_mm, half_mm, self.pixel_mm)

    @property
    def heights_mm(self) -> NDArray[np.float64]:
        """Height (slices,) of each slice at the axis of the tilt, above the carina."""
        return np.arange(-CAUDAL_MM, CRANIAL_MM, self.slice_mm)

    def lps_from_ijk(self, phantom: Volume) -> NDArray[np.float64]:
        """Return the transform (4, 4) from column, row and slice to LPS mm, which is sheared unless it is aligned."""
        sine, cosine = np.sin(np.radians(self.tilt_deg)), np.cos(np.radians(self.tilt_deg))
        column = np.array([0.0, cosine, sine])
        table = np.array([0.0, 0.0, 1.0])
        if self.is_aligned:
            table -= column * sine  # the slices are as far apart, but not displaced within their planes
        matrix = phantom.lps_from_ijk.copy()
        matrix[:3, 1] = column * self.pixel_mm
        matrix[:3, 2] = table * self.slice_mm
        matrix[1:3, 3] = (table * self.heights_mm[0] + column * self.along_mm[0])[1:]
        return matrix

    def scan(self, phantom: Volume, *, seed: int) -> NDArray[np.int16]:
        """Return the slices (slices, rows, columns) of a phantom, HU.

        A slice is the mean of planes within its thickness. The values of a plane are interpolated (Keys, a = -0.5)
        between voxels, which should be about half as large as the pixels. Below and above the phantom its outer slices
        continue. Aligned slices have air where tilted ones end.

        Parameters
        ----------
        phantom
            Phantom without noise, on a grid along the patient's axes.
        seed
            Seed of the noise.
        """
        sine, cosine = np.sin(np.radians(self.tilt_deg)), np.cos(np.radians(self.tilt_deg))
        matrix, (nz, ny, nx) = phantom.lps_from_ijk, phantom.shape_zyx
        voxels = np.ascontiguousarray(phantom.hu_zyx).reshape(nz * ny, nx)
        along_mm = self.along_mm
        rng = np.random.default_rng((seed, round(100 * self.tilt_deg) % 36_000))  # a seed is not negative
        slices = []
        for height_mm, shift_mm in zip(self.heights_mm, self.shifts_mm, strict=True):
            rows_mm = along_mm - shift_mm if self.is_aligned else along_mm
            values = np.float32(self.noise_hu) * rng.standard_normal((len(along_mm), nx), dtype=np.float32)
            for layer in range(NUM_LAYERS):
                off_mm = ((layer + 0.5) / NUM_LAYERS - 0.5) * self.slice_mm
                y_mm, z_mm = rows_mm * cosine - off_mm * sine, height_mm + rows_mm * sine + off_mm * cosine
                at_y, weight_y = _taps((y_mm - matrix[1, 3]) / matrix[1, 1], ny)
                at_z, weight_z = _taps((z_mm - matrix[2, 3]) / matrix[2, 2], nz)
                for z, y in np.ndindex(4, 4):
                    weight = (weight_z[:, z] * weight_y[:, y] / NUM_LAYERS).astype(np.float32)
                    values += weight[:, None] * voxels[at_z[:, z] * ny + at_y[:, y]]
            values[np.abs(rows_mm) > self.half_mm] = -1024.0
            slices.append(np.clip(np.rint(values), -1024, 3071).astype(np.int16))
        return np.stack(slices)


def _taps(at: NDArray[np.float64], count: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the four voxels (n, 4) around positions on an axis, and their weights; the outer voxels are repeated."""
    low = np.floor(at).astype(np.int64)
    t = at - low
    weights = np.stack(
        [
            -0.5 * t + t * t - 0.5 * t**3,
            1.0 - 2.5 * t * t + 1.5 * t**3,
            0.5 * t + 2.0 * t * t - 1.5 * t**3,
            -0.5 * t * t + 0.5 * t**3,
        ],
        axis=-1,
    )
    return np.clip(low[:, None] + np.arange(-1, 3), 0, count - 1), weights


def opened(hu_zyx: NDArray[np.int16], lps_from_ijk: NDArray[np.float64]) -> Volume:
    """Return a scan as Carina opens its DICOM series, with the tilt corrected."""
    with tempfile.TemporaryDirectory(prefix="carina-bench-") as folder:
        return open_volume(write_stack(hu_zyx, lps_from_ijk, Path(folder) / "series"), progress=False)


def covered_branches(phantom: Phantom, scanners: Sequence[Scanner]) -> list[TrueBranch]:
    """Return the parts of the true airways of a phantom that the slices of all scans contain."""
    found = []
    columns = phantom.volume.shape_zyx[2]
    for branch in truth_of_phantom(phantom.truth, phantom.lumen_zyx, phantom.volume).branches:
        inside = np.ones(len(branch.points), dtype=np.bool_)
        for one in scanners:
            sizes = np.array([columns, len(one.along_mm), len(one.heights_mm)])
            places = np.linalg.solve(one.lps_from_ijk(phantom.volume), np.c_[branch.points, np.ones(len(inside))].T)
            inside &= ((places[:3].T > 0.0) & (sizes - 1.0 > places[:3].T)).all(axis=1)
        if inside.sum() >= 2:
            found.append(dataclasses.replace(branch, points=branch.points[inside], radius_mm=branch.radius_mm[inside]))
    return found


def detection(found_zyx: NDArray[np.bool_], volume: Volume, branches: Sequence[TrueBranch]) -> tuple[float, float]:
    """Return TD and BD (``track_quality``) of a found lumen, on true airways with even distances of their points."""
    hits = np.array([is_near(found_zyx, volume, one.points, 0.5 * max(volume.spacing_mm)).mean() for one in branches])
    lengths_mm = np.array([np.linalg.norm(np.diff(one.points, axis=0), axis=1).sum() for one in branches])
    return float((hits * lengths_mm).sum() / lengths_mm.sum()), float((hits >= DETECTED_SHARE).mean())


def run(quick: bool, say: Say, cases: Sequence[str] = ()) -> list[Row]:
    """Return rows of TD and BD for each phantom and tilt, with their difference from the straight CT.

    Parameters
    ----------
    quick
        One phantom and every third tilt.
    say
        Function that receives a line about each CT.
    cases
        Phantoms by ``phantom-SEED``; ``negative`` for negative tilts; ``3mm`` for thick slices; ``aligned`` for the
        planes of the tilted slices on a rectangular grid.
    """
    seeds = tuple(int(case.removeprefix("phantom-")) for case in cases if case.startswith("phantom-"))
    slice_mm = THICK_MM if "3mm" in cases else SLICE_MM
    sign = -1.0 if "negative" in cases else 1.0
    rows: list[Row] = []
    for seed in seeds or (SEEDS[:1] if quick else SEEDS):
        scanners = [
            Scanner(sign * tilt_deg + 0.0, slice_mm=slice_mm, is_aligned="aligned" in cases) for tilt_deg in TILTS_DEG
        ]
        rows += rows_of(seed, scanners, say, step=3 if quick else 1)
    return rows


def rows_of(seed: int, scanners: Sequence[Scanner], say: Say, *, step: int = 1) -> list[Row]:
    """Return the rows of the phantom of a seed.

    Parameters
    ----------
    seed
        Seed of the phantom.
    scanners
        All scans, which decide the airways that count; the first is the straight CT.
    say
        Function that receives a line about each CT.
    step
        Only every ``step``-th scan is searched.
    """
    phantom = generate_phantom(seed=seed, spacing_mm=(PIXEL_MM, SAMPLED_MM, SAMPLED_MM), noise_hu=0.0, progress=False)
    branches = covered_branches(phantom, scanners)
    rows: list[Row] = []
    straight: tuple[float, float] | None = None
    for scanner in scanners[::step]:
        thick = f", {scanner.slice_mm:g} mm slices" if scanner.slice_mm != SLICE_MM else ""
        aligned = ", aligned" if scanner.is_aligned else ""
        case = f"phantom {seed}, {scanner.tilt_deg:g} degrees{thick}{aligned}"
        volume = opened(scanner.scan(phantom.volume, seed=seed), scanner.lps_from_ijk(phantom.volume))
        try:
            airways = find_airways(volume, progress=False)
        except CarinaError as error:
            say(f"{case}: {error}")
            rows.append({"what": "difference of TD", "case": case, "figure": None, "limit": 0.0, "note": str(error)})
            continue
        figures = detection(airways.lumen_zyx != 0, volume, branches)
        straight = figures if straight is None else straight
        codes = ", ".join(note.code for note in airways.badges) or "none"
        say(
            f"{case}: corrected tilt {volume.source.tilt_deg}, TD {figures[0]:.4f}, BD {figures[1]:.4f} of "
            f"{len(branches)}, badges: {codes}"
        )
        for name, figure, base in zip(("TD", "BD"), figures, straight, strict=True):
            rows.append(
                {
                    "what": f"difference of {name} from the straight CT",
                    "case": case,
                    "figure": abs(figure - base),
                    "limit": MAX_DIFFERENCE,
                    "better": "lower",
                    "note": f"{name} {figure:.4f}; badges: {codes}; slices {volume.spacing_mm[2]:.2f} mm apart",
                }
            )
    return rows
