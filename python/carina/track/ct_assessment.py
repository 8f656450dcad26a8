"""Assessment of a CT for the airway search: the findings of the quality gate, kernel, motion, metal and tubes.

:attr:`CtAssessment.statement` is the one statement about a CT that the window, the commands and the reports repeat.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from carina.display import one_line
from carina.errors import UsageError, check_type
from carina.track.find.artefact_regions import METAL
from carina.track.find.axis_order import CanonicalOrder
from carina.track.find.breathing_step import similarity_drops, steps_of
from carina.track.find.chest_size import usual_trachea_mm
from carina.track.find.kernel_sharpness import edge_undershoot_hu
from carina.track.find.metal_streaks import find_streaks
from carina.track.find.result import Airways
from carina.track.find.top_of_trachea import LARYNX, TUBE
from carina.track.intensity_levels import air_scale
from carina.volume.digest import canonical_geometry
from carina.volume.model import Volume
from carina.volume.quality import Finding, Quality, quality_gate

SHARP_HU = 30.0
"""Undershoot in HU of lung beside tissue, above which the assessment states that the kernel is sharp."""
_TOP_MM = 3.0
"""Distance in mm of the tree's start from the face of the CT within which the face cuts the trachea."""

PropertyName = Literal[
    "kernel", "noise", "slices", "coverage", "motion", "inspiration", "contrast", "tube", "metal", "patient size"
]
_CODES: dict[PropertyName, tuple[str, ...]] = {
    "kernel": ("kernel",),
    "noise": ("noise",),
    "slices": ("spacing", "uneven"),
    "coverage": ("cut", "no-lungs", "padding"),
    "motion": ("motion",),
    "inspiration": ("expiration",),
    "contrast": ("contrast",),
    "tube": ("tube",),
    "metal": ("metal",),
    "patient size": ("small-patient", "large-patient"),
}
"""Codes of the findings that belong to each property of the statement."""


@one_line
@dataclass(frozen=True, slots=True)
class CtProperty:
    """One property of a CT in the statement of its assessment."""

    name: PropertyName
    """Name of the property."""
    words: str
    """Measurement or finding about the property, as a text for the user."""
    limits: bool
    """Whether a finding names this property, because it limits the airway search."""

    def to_json(self) -> dict[str, Any]:
        """Return the property as plain JSON types."""
        return {"name": self.name, "words": self.words, "limits": self.limits}


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
    statement: tuple[CtProperty, ...] = ()
    """Every property in words, also those that limit nothing; all outputs repeat this statement."""
    compared_pairs: tuple[int, int] = (0, 0)
    """Number of pairs of neighbouring slices compared to find a movement of the chest, and number of all pairs."""

    @property
    def trusted_generation(self) -> int:
        """Generation (trachea 0) to which airways can be trusted, within about one."""
        return self.quality.trusted_generation

    @property
    def trusted_words(self) -> str:
        """Sentence about the trusted generation, which ends the statement."""
        return f"airways can be trusted to about generation {self.trusted_generation} (the trachea is 0)"

    @property
    def lines(self) -> tuple[str, ...]:
        """The statement as lines of text: one for each property, and the trusted generation."""
        return (*(f"{one.name}: {one.words}" for one in self.statement), self.trusted_words)

    @property
    def summary(self) -> str:
        """The statement in one line: the trusted generation, and the properties that limit it."""
        limits = [f"{one.name} ({one.words})" for one in self.statement if one.limits]
        return self.trusted_words + (f"; limits: {'; '.join(limits)}" if limits else "")

    def to_json(self) -> dict[str, Any]:
        """Return the assessment as plain JSON types."""
        return {
            **self.quality.to_json(),
            "findings": [{"code": finding.code, "words": finding.words} for finding in self.findings],
            "undershoot_hu": None if self.undershoot_hu is None else round(self.undershoot_hu, 1),
            "statement": [one.to_json() for one in self.statement],
            "summary": self.summary,
        }


def assess_ct(volume: Volume, airways: Airways | None = None) -> CtAssessment:
    """Return what limits the airway search in a CT, and the generation to which airways can be trusted.

    The part that does not depend on the airways is cached with the volume.

    Parameters
    ----------
    volume
        A chest CT in HU.
    airways
        The airways found in the CT; without them a tube in the trachea and the cricoid are not recognised.

    Raises
    ------
    UsageError
        ``usage.not-hu``: the volume is not in HU.

    Examples
    --------
    The grid of the phantom ends above the lower tips of its lungs.

    >>> import carina
    >>> made = carina.generate_phantom(spacing_mm=2.5, generations=3)
    >>> found = carina.track.assess_ct(made.volume)
    >>> [finding.code for finding in found.findings]
    ['spacing', 'cut']
    >>> found.lines[-1]
    'airways can be trusted to about generation 5 (the trachea is 0)'
    """
    check_type("assess_ct", "volume", volume, Volume, "open a volume with carina.open_volume")
    if not volume.is_hu:
        raise UsageError("assess_ct: the volume is not in HU, so its values cannot be judged", code="usage.not-hu")
    if volume._assessment is None:
        object.__setattr__(volume, "_assessment", _assess(volume))
    found: CtAssessment = volume._assessment
    return found if airways is None else _with_airways(found, volume, airways)


def _assess(volume: Volume) -> CtAssessment:
    """Return the assessment of a CT without its airways."""
    ct = CanonicalOrder.of(volume).volume
    scale = air_scale(ct)
    quality = quality_gate(volume)
    undershoot_hu = edge_undershoot_hu(ct, scale)
    streaks = find_streaks(ct, scale)
    drops = similarity_drops(ct, scale, None if streaks is None else np.asarray(streaks.any(axis=(1, 2))))
    steps = steps_of(drops)
    findings = list(quality.findings)
    if undershoot_hu is not None and undershoot_hu > SHARP_HU:
        words = f"the kernel is sharp: lung beside vessels is {undershoot_hu:.0f} HU too dark and looks like airways"
        findings.append(Finding("kernel", words))
    if steps:
        numbers = ", ".join(str(step + 1) for step in steps)
        findings.append(Finding("motion", f"the chest moved after slice {numbers}, counted from the feet"))
    if streaks is not None:
        findings.append(Finding("metal", "metal causes streaks that look like airways"))
    pairs = int(np.isfinite(drops).sum()), len(drops)
    found = CtAssessment(tuple(findings), quality, undershoot_hu, compared_pairs=pairs)
    return dataclasses.replace(found, statement=_statement(found, volume, None))


def _with_airways(found: CtAssessment, volume: Volume, airways: Airways) -> CtAssessment:
    """Return an assessment with the findings that need the airways."""
    notes = {note.code for note in airways.badges}
    codes = {finding.code for finding in found.findings}
    findings = list(found.findings)
    if METAL in notes and "metal" not in codes:
        findings.append(Finding("metal", "metal causes streaks that look like airways"))
    if TUBE in notes:
        findings.append(Finding("tube", "a tube is in the trachea, or the trachea is open through the neck"))
    found = dataclasses.replace(found, findings=tuple(findings))
    return dataclasses.replace(found, statement=_statement(found, volume, airways))


def _statement(found: CtAssessment, volume: Volume, airways: Airways | None) -> tuple[CtProperty, ...]:
    """Return the properties of a CT in words; a finding replaces the words of its property."""
    quality, codes = found.quality, {finding.code: finding.words for finding in found.findings}
    across, _, apart = (float(np.linalg.norm(column)) for column in canonical_geometry(volume).lps_from_ijk[:3, :3].T)
    thick_mm = volume.source.slice_thickness_mm
    undershoot_hu, lung_hu = found.undershoot_hu, quality.lung_hu
    has_lungs = lung_hu is not None
    after = "judged after the airways are found"
    usual: dict[PropertyName, str] = {
        "kernel": "not measurable in these slices"
        if undershoot_hu is None
        else "not sharp: lung beside vessels is not darker"
        if undershoot_hu < 0.5
        else f"not sharp: lung beside vessels is {undershoot_hu:.0f} HU darker",
        "noise": "not measurable: too little soft tissue"
        if quality.noise_hu is None
        else f"{quality.noise_hu:.0f} HU in soft tissue",
        "slices": f"{apart:.2f} mm apart, pixels of {across:.2f} mm"
        + ("" if thick_mm is None else f", {thick_mm:g} mm thick"),
        "coverage": "the lungs are complete, down to the diaphragm" if has_lungs else "no lungs found",
        "motion": _motion_words(*found.compared_pairs),
        "inspiration": "not measurable without lungs"
        if lung_hu is None
        else f"lungs of {quality.lung_litres or 0.0:.1f} litres with a mean of {lung_hu:.0f} HU",
        "contrast": "none in the heart and the large vessels" if has_lungs else "not measurable without lungs",
        "tube": after
        if airways is None
        else "not examined: the airways come from a file"
        if airways.wall_levels is None
        else "none in the trachea",
        "metal": "no streaks of metal",
        "patient size": "not measurable without lungs"
        if quality.body_mm is None
        else f"chest {quality.body_mm / 10:.0f} cm across",
    }
    rows = []
    for name, words in usual.items():
        named = [codes[code] for code in _CODES[name] if code in codes]
        shown = "; ".join(named) or words
        if name == "coverage":
            shown = f"{f'cricoid {after}' if airways is None else _top_words(volume, airways)}; {shown}"
        # Padding is stated, but does not limit the search.
        rows.append(CtProperty(name, shown, bool(set(_CODES[name]) & codes.keys() - {"padding"})))
    return tuple(rows)


def _motion_words(num: int, num_all: int) -> str:
    """Return the statement about movements of the chest where none was found."""
    if num == 0:
        return "not measurable: no two neighbouring slices can be compared"
    if 2 * num < num_all:
        return f"no movement of the chest in the {num} of {num_all} pairs of slices that can be compared"
    return "no movement of the chest between two slices"


def _top_words(volume: Volume, airways: Airways) -> str:
    """Return whether the CT includes the cricoid, from the upper end of the tree."""
    if any(note.code == LARYNX for note in airways.badges):
        return "the cricoid is in the CT"
    root = airways.tree.root
    line = root.points[np.argsort(-root.points[:, 2])]
    top, carina = line[0], line[-1]
    ijk = volume.to_ijk(top)
    sizes = np.array(volume.shape_zyx[::-1])
    to_face_mm = np.minimum(ijk + 0.5, sizes - 0.5 - ijk) * np.array(volume.spacing_mm)
    if to_face_mm.min() > _TOP_MM + max(volume.spacing_mm):
        return "the upper end of the trachea was not recognised"
    length_mm = float(top[2] - carina[2])
    begins = f"the CT begins {length_mm:.0f} mm above the carina"
    if length_mm < 0.8 * usual_trachea_mm(2.0 * float(np.median(root.radius))):
        return f"{begins}, below the cricoid"
    return f"{begins}, near the cricoid"
