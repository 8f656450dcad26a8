"""Quality gate: checks whether the spacing, the coverage and the values of a volume allow airway detection."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.volume.mask_parts import numbered_parts, opened
from carina.volume.model import Remark, Volume

# Mean lumen diameter in mm by generation, trachea first (Weibel, Morphometry of the Human Lung, 1963, model A).
_WEIBEL_MM = (18.0, 12.2, 8.3, 5.6, 4.5, 3.5, 2.8, 2.3, 1.86, 1.54, 1.30, 1.09)
# Blur and noise of clinical scans hide lumens below about 1.5 mm, independent of the voxel spacing.
_SMALLEST_VISIBLE_MM = 1.5
_DARK_HU = -500  # half-way between lung and soft tissue
_DENSEST_LUNG_HU = -600
_PURE_AIR_HU = -980
_MIN_REGION_L = 0.1
# Both lungs of an adult contain 2 to 7 litres of air and tissue; half of one small lung is the minimum that is useful.
_MIN_LUNG_L = 0.7
_MAX_LUNG_ON_FACE_CM2 = 10.0  # Area in cm2 of lung on a face of the grid, above which the face cuts the lung off.
_PADDING_HU = -1100  # HU below which values are padding; nothing in a patient is below air, -1000 HU
_FACES = {(0, 1): "left", (0, -1): "right", (1, 1): "back", (1, -1): "front", (2, 1): "top", (2, -1): "bottom"}


@one_line
@dataclass(frozen=True, slots=True)
class Finding(Remark):
    """One property that limits the use of a volume.

    The code is ``spacing``, ``uneven``, ``no-lungs``, ``cut``, ``padding``, ``mask`` or ``not-hu``.
    """


@one_line
@dataclass(frozen=True, slots=True)
class Quality:
    """Result of the quality gate for a volume."""

    findings: tuple[Finding, ...]
    trusted_generation: int
    """The last generation of airways (trachea 0) that a grid of this spacing can show."""
    lung_litres: float | None
    """Volume of lung-like voxels in litres; None if the values are not HU."""

    def to_json(self) -> dict[str, Any]:
        """Return the result as plain JSON types."""
        return {
            "findings": [{"code": finding.code, "words": finding.words} for finding in self.findings],
            "trusted_generation": self.trusted_generation,
            "lung_litres": None if self.lung_litres is None else round(self.lung_litres, 3),
        }


def trusted_generation(spacing_mm: tuple[float, float, float]) -> int:
    """Return the last generation whose mean lumen is at least 1.5 mm and the largest voxel spacing wide.

    A lumen narrower than the distance of two samples may be missed between them.
    """
    visible_mm = max(_SMALLEST_VISIBLE_MM, *spacing_mm)
    return max((index for index, width_mm in enumerate(_WEIBEL_MM) if width_mm >= visible_mm), default=0)


def quality_gate(volume: Volume) -> Quality:
    """Check the spacing, coverage and values of a volume; the result is cached with the volume.

    Parameters
    ----------
    volume
        Not modified.

    Returns
    -------
    Quality
        Findings in the order for display; empty if there are none.
    """
    if volume._quality is None:
        object.__setattr__(volume, "_quality", _judge(volume))
    found: Quality = volume._quality
    return found


def _judge(volume: Volume) -> Quality:
    """Return the findings of the quality gate for a volume, without the cache."""
    findings: list[Finding] = []
    if not volume.is_hu:
        findings.append(Finding("not-hu", f"not in Hounsfield units: {volume.not_hu_reason}"))
    values = volume.hu_zyx
    if not volume.is_hu and volume.value_range[1] - volume.value_range[0] <= 1:
        findings.append(Finding("mask", "the volume has only two values: this is probably a segmentation, not a scan"))
    findings += _spacing_findings(volume.spacing_mm)
    lung_litres: float | None = None
    if volume.is_hu:
        lungs = _find_lungs(volume)
        lung_litres = lungs.litres
        if lung_litres < _MIN_LUNG_L:
            words = f"only {lung_litres:.1f} litres look like lung: this may not be a chest CT, or may be part of one"
            findings.append(Finding("no-lungs", words))
        if lungs.cut_faces:
            words = (
                f"the lungs are cut off at the {_joined_names(lungs.cut_faces)} of the volume, and so are the airways"
            )
            findings.append(Finding("cut", words))
        padding = float(np.count_nonzero(values < _PADDING_HU)) / values.size
        if padding > 0.001:
            share = f"{100 * padding:.1f} % of the voxels"
            findings.append(Finding("padding", f"{share} lie below {_PADDING_HU} HU: padding without measured values"))
    return Quality(tuple(findings), trusted_generation(volume.spacing_mm), lung_litres)


def _spacing_findings(spacing_mm: tuple[float, float, float]) -> list[Finding]:
    findings = []
    widest, narrowest = max(spacing_mm), min(spacing_mm)
    generation = trusted_generation(spacing_mm)
    # Up to 1.5 mm, the blur of the scan limits the visible lumens, not the grid.
    if widest > _SMALLEST_VISIBLE_MM:
        what = "slices are" if spacing_mm[2] == widest else "voxels are"
        words = (
            f"{what} {widest:.1f} mm apart: beyond about generation {generation}, airways may be missed or measured "
            "inaccurately"
        )
        findings.append(Finding("spacing", words))
    if widest > 3 * narrowest:
        words = (
            f"voxels are {widest / narrowest:.1f} times longer than wide: walls look stepped, and oblique "
            "airways look flattened"
        )
        findings.append(Finding("uneven", words))
    return findings


@dataclass(frozen=True, slots=True)
class _Lungs:
    """Volume of the lungs, and the faces of the grid that cut them."""

    litres: float
    cut_faces: list[str]
    """Faces of the grid that the lungs touch, named by the patient's directions."""


def _find_lungs(volume: Volume) -> _Lungs:
    """Find the lungs on a grid of about 4 mm: connected dark regions that are not the air around the patient.

    Lung has about -850 HU, because it contains tissue; most of the air outside is near -1000 HU, although couch and
    blankets are in it. The outside air also reaches the edges where two faces of the grid meet. A region that touches
    only a face may be lung, because cropped volumes cut the lungs too.
    """
    strides = [max(1, int(4.0 / spacing)) for spacing in volume.spacing_mm]
    coarse = _block_means(volume.hu_zyx, (strides[2], strides[1], strides[0]))
    # Opened by one voxel, because noise and the thin layer between skin and air would connect the lungs to the outside.
    labels = numbered_parts(opened(coarse < _DARK_HU))
    voxel_l = abs(float(np.linalg.det(volume.lps_from_ijk[:3, :3]))) * 1e-6 * float(np.prod(strides))
    lung = np.zeros(labels.shape, dtype=np.bool_)
    kk, jj, ii = (np.isin(np.arange(n), (0, n - 1)).astype(np.uint8) for n in labels.shape)
    edges = kk[:, None, None] + jj[None, :, None] + ii[None, None, :] >= 2
    for label in np.flatnonzero(np.bincount(labels.reshape(-1)) * voxel_l > _MIN_REGION_L):
        region = labels == label
        if label == 0 or float(np.median(coarse[region])) > _DENSEST_LUNG_HU:
            continue
        outside = float(np.mean(coarse[region] < _PURE_AIR_HU)) > 0.25 and bool(np.any(region & edges))
        if not outside:
            lung |= region
    columns = volume.lps_from_ijk[:3, :3] * strides
    names = []
    for axis_ijk in range(3):
        first, second = (axis for axis in range(3) if axis != axis_ijk)
        pixel_cm2 = float(np.linalg.norm(np.cross(columns[:, first], columns[:, second]))) * 0.01
        for end in (0, -1):
            if np.count_nonzero(np.take(lung, [end], axis=2 - axis_ijk)) * pixel_cm2 > _MAX_LUNG_ON_FACE_CM2:
                outward = columns[:, axis_ijk] * (1 if end == -1 else -1)
                axis_lps = int(np.argmax(np.abs(outward)))
                names.append(_FACES[axis_lps, 1 if outward[axis_lps] > 0 else -1])
    return _Lungs(float(np.count_nonzero(lung)) * voxel_l, names)


def _block_means(values: NDArray[np.int16], strides_zyx: tuple[int, int, int]) -> NDArray[np.float32]:
    """Return the means of complete blocks; incomplete blocks at the upper ends are omitted."""
    sz, sy, sx = strides_zyx
    nz, ny, nx = (max(1, n // s) for n, s in zip(values.shape, strides_zyx, strict=True))
    total = np.zeros((nz, ny, nx), dtype=np.float32)
    # Sums over strided views, because a copy of the volume as float would be too large.
    for dz in range(min(sz, values.shape[0])):
        for dy in range(min(sy, values.shape[1])):
            for dx in range(min(sx, values.shape[2])):
                total += values[dz : nz * sz : sz, dy : ny * sy : sy, dx : nx * sx : sx]
    return np.asarray(total / np.float32(sz * sy * sx), dtype=np.float32)


def _joined_names(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
