"""Appearance of the airway wall through a scope: light guides, exposure, gloss, texture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, get_args

import numpy as np

from carina.display import one_line
from carina.errors import RenderError

DecorationName = Literal["texture", "vessels", "rings", "membrane", "hue", "spurs", "specks", "secretions", "fog"]
DECORATIONS: tuple[DecorationName, ...] = get_args(DecorationName)
FROM_TREE: frozenset[DecorationName] = frozenset(("rings", "membrane", "hue", "spurs"))
"""Names of the decorations (drawn features that the CT does not show) that need the airway tree."""

# Ends of the two light guides of a common video bronchoscope in camera space, mm: a little above the lens's centre.
TWO_GUIDES_MM = ((-1.9, -0.5, 0.0), (1.9, -0.5, 0.0))


def check_guides(guides_mm: tuple[tuple[float, float, float], ...]) -> None:
    """Raise :class:`RenderError` unless the value is one or two points (x, y, z) within 100 mm of the lens."""
    guides = np.array(guides_mm, dtype=np.float64)
    if guides.ndim != 2 or guides.shape[1:] != (3,) or len(guides) not in {1, 2} or not np.isfinite(guides).all():
        raise RenderError(f"expected one or two light guides [x, y, z] in mm; found {guides_mm}")
    if np.abs(guides).max() > 100:
        raise RenderError(f"light guides must lie within 100 mm of the lens; found {guides_mm}")


@one_line
@dataclass(frozen=True, slots=True)
class Appearance:
    """Light, gloss and texture that are applied to the first wall of each pixel after casting.

    The model and its sources: docs/decisions/0133.
    """

    guides_mm: tuple[tuple[float, float, float], ...] = TWO_GUIDES_MM
    """Positions of the ends of the one or two light guides in camera space, mm."""
    exposure: float | None = None
    """Brightness of the guides; None for automatic exposure."""
    ambient: float = 0.12
    """Ambient light from surrounding walls, as a fraction of the guides' light at perpendicular incidence."""
    wrap: float = 0.15
    """Scattering of light below the surface, 0..1."""
    gloss: float = 0.7
    """Strength of the highlights on the film of mucus that covers the wall; 0 for none."""
    shininess_log2: int = 7
    """Base-2 logarithm of the highlight's exponent: the exponent is ``2 ** shininess_log2``."""
    paleness: float = 0.5
    """Paleness of the mucosa over dense tissue, 0..1."""
    pale_hu: tuple[float, float] = (0.0, 300.0)
    """HU below the surface at which paleness begins and at which it is complete."""
    texture: float = 1.0
    """Strength of mottling and micro relief; 0 for none."""
    vessels: float = 0.0
    """Strength of vessels in the mucosa that are drawn without a basis in the CT; 0 for none.

    No CT shows such vessels, and many of them would be a sign of disease.
    """
    silhouettes: bool = True
    """Whether a pixel at the edge of a near wall in front of a far wall takes two rays, which smooths the edge.

    This is not decoration: both rays show the CT.
    """
    specks: float = 0.0
    """Strength of highlights on droplets of mucus, also far away; 0 for none. Drawn, not from the CT."""
    secretions: float = 0.0
    """Strength of glossy pools and bubbles of secretions on the posterior wall, 0..1. Decoration.

    The posterior wall is the lowest of a supine patient. No CT shows these secretions.
    """
    fog: float = 0.0
    """Strength of mist on the lens, 0..1. Drawn, not from the CT."""
    rings: float = 0.0
    """Strength of the cartilage rings of trachea and main bronchi and the plates of lobar bronchi; 0 for none.

    Rings and plates are drawn from the airway tree.
    """
    membrane: float = 0.0
    """Strength of the flat, folded membranous wall at the back of trachea and main bronchi; 0 for none.

    The membranous wall is drawn from the airway tree.
    """
    hue: float = 0.0
    """Strength of the colour by region, from the airway tree: a pale trachea, redder bronchi; 0 for one colour."""
    spurs: float = 0.0
    """Strength of pale ridges at forks, from the airway tree, 0..1."""

    def __post_init__(self) -> None:
        """Raise an error if a field of this `Appearance` has an invalid value."""
        check_guides(self.guides_mm)
        if self.exposure is not None and not 0 <= self.exposure <= 1e6:
            raise RenderError(f"exposure must be between 0 and 1000000; found {self.exposure}")
        for what, most in (
            ("ambient", 10),
            ("wrap", 1),
            ("gloss", 100),
            ("paleness", 1),
            ("texture", 4),
            ("vessels", 4),
            ("specks", 4),
            ("secretions", 1),
            ("fog", 1),
            ("rings", 2),
            ("membrane", 2),
            ("hue", 2),
            ("spurs", 1),
        ):
            if not 0 <= getattr(self, what) <= most:
                raise RenderError(f"appearance: {what} must be between 0 and {most}; found {getattr(self, what)}")
        if not isinstance(self.shininess_log2, int) or not 0 <= self.shininess_log2 <= 10:
            raise RenderError(f"shininess (log2) must be a whole number from 0 to 10; found {self.shininess_log2}")
        if not isinstance(self.silhouettes, bool):
            raise RenderError(f"appearance: silhouettes must be true or false; found {self.silhouettes!r}")
        low, high = self.pale_hu
        if not (np.isfinite(self.pale_hu).all() and low < high):
            raise RenderError(f"pale tissue: expected two values, the lower first; found {self.pale_hu}")

    @property
    def decorations(self) -> tuple[DecorationName, ...]:
        """Names of the drawn features (decorations) whose strength in this appearance is above 0."""
        return tuple(name for name in DECORATIONS if getattr(self, name) > 0)

    def undecorated(self) -> Appearance:
        """Return a copy of the appearance without drawn features (decorations)."""
        dry = replace(self, specks=0.0, secretions=0.0, fog=0.0)
        return replace(dry, texture=0.0, vessels=0.0, rings=0.0, membrane=0.0, hue=0.0, spurs=0.0)

    def to_json(self) -> dict[str, Any]:
        """Return the appearance as a JSON object."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return {**values, "guides_mm": [list(guide) for guide in self.guides_mm], "pale_hu": list(self.pale_hu)}

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> Appearance:
        """Create an appearance from a JSON object; ignore unknown keys, use defaults for missing keys."""
        known = {f.name: document[f.name] for f in fields(cls) if f.name in document}
        if "guides_mm" in known:
            known["guides_mm"] = tuple(tuple(float(v) for v in guide) for guide in known["guides_mm"])
        if "pale_hu" in known:
            low, high = known["pale_hu"]
            known["pale_hu"] = (float(low), float(high))
        return cls(**known)
