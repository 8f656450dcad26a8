"""Quality gate: checks whether spacing, coverage, noise and values of a volume allow airway detection."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.volume.digest import canonical_axes, canonical_geometry
from carina.volume.mask_parts import numbered_parts, opened
from carina.volume.model import Remark, Volume

# Mean lumen diameter in mm by generation, trachea first (Weibel, Morphometry of the Human Lung, 1963, model A).
_WEIBEL_MM = (18.0, 12.2, 8.3, 5.6, 4.5, 3.5, 2.8, 2.3, 1.86, 1.54, 1.30, 1.09)
# Blur and noise of clinical scans hide lumens below about 1.5 mm, independent of the voxel spacing.
_SMALLEST_VISIBLE_MM = 1.5
_SAMPLING = 0.95  # share of the largest voxel spacing below which a lumen may be missed between samples
_USUAL_NOISE_HU, _MM_PER_NOISE_HU = 25.0, 1 / 54
_DARK_HU = -500  # half-way between lung and soft tissue
_DENSEST_LUNG_HU = -600
_AIR_HU, _PURE_AIR_HU = -1000.0, -980.0
_MIN_REGION_L = 0.1
# Both lungs of an adult contain 2 to 7 litres of air and tissue; half of one small lung is the minimum that is useful.
_MIN_LUNG_L = 0.7
_MAX_LUNG_ON_FACE_CM2 = 10.0  # Area in cm2 of lung on a face of the grid, above which the face cuts the lung off.
_PADDING_HU = -1100  # HU below which values are padding; nothing in a patient is below air, -1000 HU
NOISE_HU = 45.0
"""Standard deviation of the noise in soft tissue above which noise is named."""
DENSE_LUNG_HU = -775.0
"""Mean of the lungs above which the scan is probably not in inspiration."""
CONTRAST_HU, CONTRAST_L = (130.0, 600.0), 0.1
"""Range of enhanced blood in HU, and minimum volume in litres of such a region for a finding of contrast medium."""
PATIENT_MM = (210.0, 390.0)
"""Range for patients of usual size of the diameter of a circle with the area of the chest."""
_LAG_MM = 4.0
_TISSUE_HU = (-20.0, 110.0)
_BODY_HU = -300.0
_CUBE_MM = 30.0
_NUM_PLANES = 24
_MIN_SAMPLES = 2000
_FACES = {(0, 1): "left", (0, -1): "right", (1, 1): "back", (1, -1): "front", (2, 1): "top", (2, -1): "bottom"}


@one_line
@dataclass(frozen=True, slots=True)
class Finding(Remark):
    """One property that limits the use of a volume.

    The code is ``spacing``, ``uneven``, ``no-lungs``, ``cut``, ``padding``, ``mask``, ``not-hu``, ``noise``,
    ``expiration``, ``contrast``, ``small-patient`` or ``large-patient``; of ``carina.track.assess_ct`` also ``kernel``,
    ``motion``, ``metal`` or ``tube``.
    """


@one_line
@dataclass(frozen=True, slots=True)
class Quality:
    """Result of the quality gate for a volume."""

    findings: tuple[Finding, ...]
    trusted_generation: int
    """Generation of airways (trachea 0) to which they can be trusted in a CT of this spacing and noise, within one."""
    lung_litres: float | None
    """Volume of lung-like voxels in litres; None if the values are not HU."""
    noise_hu: float | None = None
    """Standard deviation of the noise in soft tissue; None if there is too little of it."""
    lung_hu: float | None = None
    """Mean of the lungs; None without lungs."""
    body_mm: float | None = None
    """Diameter of a circle with the median area of the chest in the slices with lung; None without lungs."""

    def to_json(self) -> dict[str, Any]:
        """Return the result as plain JSON types."""
        return {
            "findings": [{"code": finding.code, "words": finding.words} for finding in self.findings],
            "trusted_generation": self.trusted_generation,
            "lung_litres": None if self.lung_litres is None else round(self.lung_litres, 3),
            **{
                name: None if (value := getattr(self, name)) is None else round(value, 1)
                for name in ("noise_hu", "lung_hu", "body_mm")
            },
        }


def trusted_generation(spacing_mm: tuple[float, float, float], noise_hu: float | None = None) -> int:
    """Return the last generation whose mean lumen is wide enough for the blur, the sampling and the noise of a CT.

    The three widths are added in quadrature. They were calibrated with degraded phantoms, of which the search finds at
    least 80 % of the length of every trusted generation (``carina bench track --only gate``).

    Parameters
    ----------
    spacing_mm
        Distance of voxel centres along i, j, k.
    noise_hu
        Standard deviation of the noise in soft tissue; None if it is unknown.
    """
    noise_mm = max((noise_hu or 0.0) - _USUAL_NOISE_HU, 0.0) * _MM_PER_NOISE_HU
    visible_mm = math.hypot(_SMALLEST_VISIBLE_MM, _SAMPLING * max(spacing_mm), noise_mm)
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
    """Return the findings of the quality gate for a volume, without the cache.

    Lungs, body and noise are judged in the canonical order of the axes, so that planes k are axial in every file.
    """
    findings: list[Finding] = []
    if not volume.is_hu:
        findings.append(Finding("not-hu", f"not in Hounsfield units: {volume.not_hu_reason}"))
    values = volume.hu_zyx
    if not volume.is_hu and volume.value_range[1] - volume.value_range[0] <= 1:
        findings.append(Finding("mask", "the volume has only two values: this is probably a segmentation, not a scan"))
    lungs = coarse_lungs(volume) if volume.is_hu else None
    noise_hu = None if lungs is None else lungs.noise_hu
    generation = trusted_generation(volume.spacing_mm, noise_hu)
    findings += _spacing_findings(_canonical_spacing_mm(volume), generation)
    if lungs is None:
        return Quality(tuple(findings), generation, None)
    lung_hu = body_mm = None
    if lungs.litres < _MIN_LUNG_L:
        words = f"only {lungs.litres:.1f} litres look like lung: this may not be a chest CT, or may be part of one"
        findings.append(Finding("no-lungs", words))
    else:
        lung_hu, body_mm = float(lungs.hu[lungs.mask].mean()), _body_mm(volume, lungs)
    if lungs.cut_faces:
        words = f"the lungs are cut off at the {_joined_names(lungs.cut_faces)} of the volume, and so are the airways"
        findings.append(Finding("cut", words))
    padding = float(np.count_nonzero(values < _PADDING_HU)) / values.size
    if padding > 0.001:
        share = f"{100 * padding:.1f} % of the voxels"
        findings.append(Finding("padding", f"{share} lie below {_PADDING_HU} HU: padding without measured values"))
    findings += _patient_findings(noise_hu, lung_hu, body_mm)
    if lung_hu is not None and _contrast_l(volume, lungs) > CONTRAST_L:
        findings.append(Finding("contrast", "contrast medium in the heart and the large vessels"))
    return Quality(tuple(findings), generation, lungs.litres, noise_hu, lung_hu, body_mm)


def _patient_findings(noise_hu: float | None, lung_hu: float | None, body_mm: float | None) -> list[Finding]:
    findings = []
    if noise_hu is not None and noise_hu > NOISE_HU:
        findings.append(Finding("noise", f"noise of {noise_hu:.0f} HU in soft tissue: small airways may be missed"))
    if lung_hu is not None and lung_hu > DENSE_LUNG_HU:
        words = f"the lungs are dense (mean {lung_hu:.0f} HU), by expiration or disease: airways are narrow or hidden"
        findings.append(Finding("expiration", words))
    if body_mm is not None and body_mm < PATIENT_MM[0]:
        words = f"the chest is small ({body_mm / 10:.0f} cm across): airways are narrower than an adult's"
        findings.append(Finding("small-patient", words))
    if body_mm is not None and body_mm > PATIENT_MM[1]:
        words = f"the chest is large ({body_mm / 10:.0f} cm across): noise is usually high"
        findings.append(Finding("large-patient", words))
    return findings


def _noise_hu(volume: Volume, coarse: NDArray[np.float32], strides_zyx: tuple[int, int, int]) -> float | None:
    """Return the standard deviation of the noise: of differences between points of soft tissue that are 4 mm apart.

    Noise of one slice is correlated over about a millimetre, and tissue is alike over a few.
    """
    sz, sy, sx = strides_zyx
    lag = max(1, round(_LAG_MM / _canonical_spacing_mm(volume)[0]))
    values = canonical_axes(volume.lps_from_ijk).view(volume.hu_zyx)
    if lag >= values.shape[2]:
        return None
    is_tissue = (coarse > _TISSUE_HU[0]) & (coarse < _TISSUE_HU[1])
    differences = []
    for at in np.unique(np.linspace(0, len(coarse) - 1, _NUM_PLANES).astype(int)):
        mask = np.repeat(np.repeat(is_tissue[at], sy, axis=0), sx, axis=1)
        plane = values[at * sz][: mask.shape[0], : mask.shape[1]].astype(np.float32)
        both = mask[: plane.shape[0], lag : plane.shape[1]] & mask[: plane.shape[0], : plane.shape[1] - lag]
        differences.append((plane[:, lag:] - plane[:, : plane.shape[1] - lag])[both])
    found = np.concatenate(differences)
    if len(found) < _MIN_SAMPLES:
        return None
    return float(1.4826 * np.median(np.abs(found)) / math.sqrt(2.0))


def _body_mm(volume: Volume, lungs: CoarseLungs) -> float:
    """Return the diameter of a circle with the median area of the body in the axial planes with lung."""
    columns = canonical_geometry(volume).lps_from_ijk[:3, :2] * lungs.strides_zyx[:0:-1]
    pixel_mm2 = float(np.linalg.norm(np.cross(columns[:, 0], columns[:, 1])))
    inside = (lungs.hu > _BODY_HU) | lungs.mask
    areas = inside[lungs.mask.any(axis=(1, 2))].sum(axis=(1, 2)) * pixel_mm2
    return 2.0 * math.sqrt(float(np.median(areas)) / math.pi)


def _contrast_l(volume: Volume, lungs: CoarseLungs) -> float:
    """Return the volume in litres of bright regions around cubes of 30 mm, which no bone contains."""
    bright = (lungs.hu > CONTRAST_HU[0]) & (lungs.hu < CONTRAST_HU[1])
    cores: NDArray[np.bool_] = bright
    sizes_mm = np.array(_canonical_spacing_mm(volume))[::-1] * lungs.strides_zyx
    for axis, size_mm in enumerate(sizes_mm):
        reach = round(_CUBE_MM / 2 / size_mm)
        padded = np.pad(cores, [(reach, reach) if n == axis else (0, 0) for n in range(3)])
        cores = np.asarray(np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=axis).all(axis=-1))
    parts = numbered_parts(bright)
    in_parts = np.isin(parts, np.unique(parts[cores])) if cores.any() else np.zeros_like(bright)
    return float(np.count_nonzero(in_parts & bright)) * float(np.prod(sizes_mm)) * 1e-6 if cores.any() else 0.0


def _canonical_spacing_mm(volume: Volume) -> tuple[float, float, float]:
    """Return the distances of voxel centres along L, P and S, mm."""
    i, j, k = canonical_axes(volume.lps_from_ijk).axes_ijk
    spacing_mm = volume.spacing_mm
    return spacing_mm[i], spacing_mm[j], spacing_mm[k]


def _spacing_findings(spacing_mm: tuple[float, float, float], generation: int) -> list[Finding]:
    findings = []
    widest, narrowest = max(spacing_mm), min(spacing_mm)
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


@dataclass(frozen=True, slots=True, eq=False)
class CoarseLungs:
    """Means of blocks of about 4 mm in canonical order of the axes, and a mask of the lungs on them."""

    hu: NDArray[np.float32]
    """(nz, ny, nx) mean of each block."""
    mask: NDArray[np.bool_]
    """(nz, ny, nx) True in the lungs."""
    strides_zyx: tuple[int, int, int]
    """Number of voxels of a block on each canonical axis."""
    litres: float
    """Volume of the lungs."""
    cut_faces: tuple[str, ...]
    """Faces of the grid that cut the lungs, named by the patient's directions."""
    noise_hu: float | None
    """Standard deviation of the noise in soft tissue; None if there are too few samples."""


def coarse_lungs(volume: Volume) -> CoarseLungs:
    """Find the lungs on a grid of about 4 mm: connected dark regions that are not the air around the patient.

    Lung has about -850 HU, because it contains tissue; most of the air outside is near -1000 HU, although couch and
    blankets are in it. The outside air also reaches the edges where two faces of the grid meet. A region that touches
    only a face may be lung, because cropped volumes cut the lungs too.
    """
    strides = [max(1, int(4.0 / spacing)) for spacing in _canonical_spacing_mm(volume)]
    strides_zyx = (strides[2], strides[1], strides[0])
    coarse = _block_means(canonical_axes(volume.lps_from_ijk).view(volume.hu_zyx), strides_zyx)
    noise_hu = _noise_hu(volume, coarse, strides_zyx)
    pure_air_hu = _pure_air_limit_hu(volume, noise_hu)
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
        outside = float(np.mean(coarse[region] < pure_air_hu)) > 0.25 and bool(np.any(region & edges))
        if not outside:
            lung |= region
    columns = canonical_geometry(volume).lps_from_ijk[:3, :3] * strides
    names = []
    for axis_ijk in range(3):
        first, second = (axis for axis in range(3) if axis != axis_ijk)
        pixel_cm2 = float(np.linalg.norm(np.cross(columns[:, first], columns[:, second]))) * 0.01
        for end in (0, -1):
            if np.count_nonzero(np.take(lung, [end], axis=2 - axis_ijk)) * pixel_cm2 > _MAX_LUNG_ON_FACE_CM2:
                outward = columns[:, axis_ijk] * (1 if end == -1 else -1)
                axis_lps = int(np.argmax(np.abs(outward)))
                names.append(_FACES[axis_lps, 1 if outward[axis_lps] > 0 else -1])
    return CoarseLungs(coarse, lung, strides_zyx, float(np.count_nonzero(lung)) * voxel_l, tuple(names), noise_hu)


def _pure_air_limit_hu(volume: Volume, noise_hu: float | None) -> float:
    """Return the mean in HU below which a block of voxels is air without tissue.

    The values of a scan end at a lowest number, commonly -1024 HU. Strong noise of air is cut off there, which raises
    the mean of the air: by 23 HU at a noise of 85 HU.
    """
    if noise_hu is None or noise_hu <= NOISE_HU:
        return _PURE_AIR_HU
    lowest = float(np.min(volume.hu_zyx, initial=_AIR_HU, where=volume.hu_zyx >= _PADDING_HU))
    # Mean of a normal distribution whose values below the lowest number are set to it.
    ratio = (_AIR_HU - lowest) / noise_hu
    density = math.exp(-0.5 * ratio**2) / math.sqrt(2.0 * math.pi)
    mean_hu = lowest + noise_hu * (density + ratio * 0.5 * (1.0 + math.erf(ratio / math.sqrt(2.0))))
    return max(_PURE_AIR_HU, mean_hu + _PURE_AIR_HU - _AIR_HU)


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


def _joined_names(names: tuple[str, ...]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
