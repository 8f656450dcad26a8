"""The quality gate: what a volume can and cannot show, in words, before anybody trusts a tree made from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.volume.model import Volume

__all__ = ["Finding", "Quality", "quality_gate", "trusted_generation"]

# Mean lumen diameter in mm by generation, trachea first (Weibel, Morphometry of the Human Lung, 1963, model A).
_WEIBEL_MM = (18.0, 12.2, 8.3, 5.6, 4.5, 3.5, 2.8, 2.3, 1.86, 1.54, 1.30, 1.09)
# Blur and noise of clinical scans hide lumens below about 1.5 mm, however fine the grid is.
_SMALLEST_VISIBLE_MM = 1.5
_LUNG_HU = (-950, -700)
# Both lungs of an adult hold 2 to 7 litres of air and tissue; half of one small lung is the least that helps.
_MIN_LUNG_L = 0.7
_MAX_LUNG_ON_FACE_CM2 = 10.0  # more lung than this on a face of the grid means that it goes on behind
_PADDING_HU = -1100  # nothing in or around a patient is less dense than air, -1000
_MAX_SAMPLES = 4_000_000
_FACES = {(0, 1): "left", (0, -1): "right", (1, 1): "back", (1, -1): "front", (2, 1): "top", (2, -1): "bottom"}


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that limits what the volume is good for."""

    code: str
    """``spacing``, ``uneven``, ``no-lungs``, ``cut``, ``padding``, ``mask`` or ``not-hu``."""
    words: str
    """A sentence part for the screen and for ``carina info``."""


@dataclass(frozen=True, slots=True)
class Quality:
    """What the quality gate says about a volume."""

    findings: tuple[Finding, ...]
    trusted_generation: int
    """The last generation of airways (trachea 0) that a grid of this spacing can show."""
    lung_litres: float | None
    """Volume of lung-like voxels; None where values are not HU."""

    def to_json(self) -> dict[str, Any]:
        """Plain JSON types."""
        return {
            "findings": [{"code": finding.code, "words": finding.words} for finding in self.findings],
            "trusted_generation": self.trusted_generation,
            "lung_litres": None if self.lung_litres is None else round(self.lung_litres, 3),
        }


def trusted_generation(spacing_mm: tuple[float, float, float]) -> int:
    """The last generation whose mean lumen is at least as wide as the widest voxel spacing, and 1.5 mm.

    A lumen narrower than the distance of two samples may fall between them.
    """
    visible_mm = max(_SMALLEST_VISIBLE_MM, *spacing_mm)
    return max((index for index, width_mm in enumerate(_WEIBEL_MM) if width_mm >= visible_mm), default=0)


def quality_gate(volume: Volume) -> Quality:
    """Judge spacing, coverage and values of a volume.

    Parameters
    ----------
    volume
        Not modified. Large volumes are judged on every n-th voxel.

    Returns
    -------
    Quality
        Findings in the order in which a person should read them; empty where there is nothing to say.
    """
    findings: list[Finding] = []
    if not volume.is_hu:
        findings.append(Finding("not-hu", f"the values are not Hounsfield units: {volume.not_hu_reason}"))
    values = volume.hu_zyx
    if not volume.is_hu and int(values.max()) - int(values.min()) <= 1:
        findings.append(Finding("mask", "the volume holds two values only: this is a mask, not a scan"))
    findings += _spacing_findings(volume.spacing_mm)
    lung_litres: float | None = None
    if volume.is_hu:
        stride = max(1, round((values.size / _MAX_SAMPLES) ** (1 / 3)))
        sample = values[::stride, ::stride, ::stride]
        lung = (sample >= _LUNG_HU[0]) & (sample <= _LUNG_HU[1])
        voxel_l = abs(float(np.linalg.det(volume.lps_from_ijk[:3, :3]))) * 1e-6
        lung_litres = float(np.mean(lung)) * values.size * voxel_l
        if lung_litres < _MIN_LUNG_L:
            words = f"only {lung_litres:.1f} litres look like lung: this may not be a chest CT, or a part of one"
            findings.append(Finding("no-lungs", words))
        cut = _cut_faces(volume)
        if cut:
            words = f"the lungs are cut at the {_listed(cut)} of the volume: airways end there too"
            findings.append(Finding("cut", words))
        padding = float(np.mean(sample < _PADDING_HU))
        if padding > 0.001:
            share = f"{100 * padding:.1f} % of the voxels"
            findings.append(Finding("padding", f"{share} lie below {_PADDING_HU} HU: padding without measured values"))
    return Quality(tuple(findings), trusted_generation(volume.spacing_mm), lung_litres)


def _spacing_findings(spacing_mm: tuple[float, float, float]) -> list[Finding]:
    findings = []
    widest, narrowest = max(spacing_mm), min(spacing_mm)
    generation = trusted_generation(spacing_mm)
    # Up to 1.5 mm the blur of the scan limits what is seen, not the grid.
    if widest > _SMALLEST_VISIBLE_MM:
        what = "slices are" if spacing_mm[2] == widest else "voxels are"
        words = f"{what} {widest:.1f} mm apart: airways beyond about generation {generation} cannot be trusted"
        findings.append(Finding("spacing", words))
    if widest > 3 * narrowest:
        words = (
            f"voxels are {widest / narrowest:.1f} times longer than wide: walls show steps, slanted airways look flat"
        )
        findings.append(Finding("uneven", words))
    return findings


def _cut_faces(volume: Volume) -> list[str]:
    """Names of the faces of the grid that lung touches, by the patient's directions."""
    names = []
    values = volume.hu_zyx
    for axis_ijk in range(3):
        first, second = (axis for axis in range(3) if axis != axis_ijk)
        columns = volume.lps_from_ijk[:3, :3]
        pixel_cm2 = float(np.linalg.norm(np.cross(columns[:, first], columns[:, second]))) * 0.01
        for end in (0, -1):
            face = np.take(values, [end], axis=2 - axis_ijk).squeeze(2 - axis_ijk)
            lung = (face >= _LUNG_HU[0]) & (face <= _LUNG_HU[1])
            if float(np.count_nonzero(_eroded(lung))) * pixel_cm2 > _MAX_LUNG_ON_FACE_CM2:
                outward = columns[:, axis_ijk] * (1 if end == -1 else -1)
                axis_lps = int(np.argmax(np.abs(outward)))
                names.append(_FACES[axis_lps, 1 if outward[axis_lps] > 0 else -1])
    return names


def _eroded(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    # One pixel off every edge: the rim of a body is lung-like by partial volume, but only one pixel wide.
    inner = np.zeros_like(mask)
    if min(mask.shape) > 2:
        inner[1:-1, 1:-1] = mask[1:-1, 1:-1] & mask[:-2, 1:-1] & mask[2:, 1:-1] & mask[1:-1, :-2] & mask[1:-1, 2:]
    return inner


def _listed(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
