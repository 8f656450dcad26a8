"""Assessment of a CT for the airway search: the findings of the quality gate, kernel, motion, metal and tubes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from carina.display import one_line
from carina.errors import UsageError, check_type
from carina.track.find.artefact_regions import METAL
from carina.track.find.axis_order import CanonicalOrder
from carina.track.find.breathing_step import find_steps
from carina.track.find.kernel_sharpness import edge_undershoot_hu
from carina.track.find.metal_streaks import find_streaks
from carina.track.find.result import Airways
from carina.track.find.top_of_trachea import TUBE
from carina.track.intensity_levels import air_scale
from carina.volume.model import Volume
from carina.volume.quality import Finding, Quality, quality_gate

SHARP_HU = 30.0
"""Undershoot in HU beside edges above which a finding states that the kernel is sharp."""


@one_line
@dataclass(frozen=True, slots=True)
class CtAssessment:
    """Properties of a CT that decide which airways can be seen in it."""

    findings: tuple[Finding, ...]
    """Findings of the quality gate, and ``kernel``, ``motion``, ``metal`` and ``tube``."""
    quality: Quality
    """Result of the quality gate."""
    undershoot_hu: float | None
    """Darkening of lung beside tissue by the kernel; None if it is not measurable."""

    @property
    def trusted_generation(self) -> int:
        """Generation (trachea 0) to which airways can be trusted, within about one."""
        return self.quality.trusted_generation

    def to_json(self) -> dict[str, Any]:
        """Return the assessment as plain JSON types."""
        return {
            **self.quality.to_json(),
            "findings": [{"code": finding.code, "words": finding.words} for finding in self.findings],
            "undershoot_hu": None if self.undershoot_hu is None else round(self.undershoot_hu, 1),
        }


def assess_ct(volume: Volume, airways: Airways | None = None) -> CtAssessment:
    """Return what limits the airway search in a CT, and the generation to which airways can be trusted.

    Parameters
    ----------
    volume
        A chest CT in HU.
    airways
        The airways found in the CT; without them a tube in the trachea is not recognised.

    Raises
    ------
    UsageError
        ``usage.not-hu``: the volume is not in HU.

    Examples
    --------
    The grid of the phantom ends above the lower tips of its lungs.

    >>> import carina
    >>> made = carina.generate_phantom(spacing_mm=2.5, generations=3)
    >>> [finding.code for finding in carina.track.assess_ct(made.volume).findings]
    ['spacing', 'cut']
    """
    check_type("assess_ct", "volume", volume, Volume, "open a volume with carina.open_volume")
    if not volume.is_hu:
        raise UsageError("assess_ct: the volume is not in HU, so its values cannot be judged", code="usage.not-hu")
    ct = CanonicalOrder.of(volume).volume
    scale = air_scale(ct)
    quality = quality_gate(volume)
    undershoot_hu = edge_undershoot_hu(ct, scale)
    notes = set() if airways is None else {note.code for note in airways.badges}
    streaks = find_streaks(ct, scale)
    steps = find_steps(ct, scale, None if streaks is None else np.asarray(streaks.any(axis=(1, 2))))
    findings = list(quality.findings)
    if undershoot_hu is not None and undershoot_hu > SHARP_HU:
        words = f"the kernel is sharp: lung beside vessels is {undershoot_hu:.0f} HU too dark and looks like airways"
        findings.append(Finding("kernel", words))
    if steps:
        numbers = ", ".join(str(step + 1) for step in steps)
        findings.append(Finding("motion", f"the chest moved after slice {numbers}, counted from the feet"))
    if streaks is not None or METAL in notes:
        findings.append(Finding("metal", "metal causes streaks that look like airways"))
    if TUBE in notes:
        findings.append(Finding("tube", "a tube is in the trachea, or the trachea is open through the neck"))
    return CtAssessment(tuple(findings), quality, undershoot_hu)
