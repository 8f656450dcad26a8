"""How the wall of an airway looks through a scope: light guides, exposure, gloss, texture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, get_args

import numpy as np

from carina.display import one_line
from carina.errors import RenderError

__all__ = ["DECORATIONS", "FROM_TREE", "Appearance", "DecorationName", "check_guides"]

DecorationName = Literal["texture", "vessels", "rings", "membrane", "hue", "spurs", "specks", "secretions", "fog"]
DECORATIONS: tuple[DecorationName, ...] = get_args(DecorationName)
FROM_TREE: frozenset[DecorationName] = frozenset(("rings", "membrane", "hue", "spurs"))
"""Parts that need to know where on the airway a wall is."""

# Beside the lens of a common video bronchoscope, a little above its middle.
TWO_GUIDES_MM = ((-1.9, -0.5, 0.0), (1.9, -0.5, 0.0))


def check_guides(guides_mm: tuple[tuple[float, float, float], ...]) -> None:
    """Refuse what cannot be the ends of one or two light guides."""
    guides = np.array(guides_mm, dtype=np.float64)
    if guides.ndim != 2 or guides.shape[1:] != (3,) or len(guides) not in {1, 2} or not np.isfinite(guides).all():
        raise RenderError(f"expected one or two light guides [x, y, z] in mm; found {guides_mm}")
    if np.abs(guides).max() > 100:
        raise RenderError(f"light guides must lie within 100 mm of the lens; found {guides_mm}")


@one_line
@dataclass(frozen=True, slots=True)
class Appearance:
    """Light, gloss and texture that are laid on the first wall of each pixel after casting.

    The model and where it comes from: docs/decisions/0105.
    """

    guides_mm: tuple[tuple[float, float, float], ...] = TWO_GUIDES_MM
    """Ends of the light guides in camera space, one or two; they share the light."""
    exposure: float | None = None
    """Light of the guides; None for automatic exposure."""
    ambient: float = 0.12
    """Light from the walls round about, as part of what the guides give head on."""
    wrap: float = 0.15
    """How far light creeps beneath the surface, 0..1."""
    gloss: float = 0.7
    """Highlights of the film of mucus."""
    shininess_log2: int = 7
    """The highlight's exponent is ``2 ** shininess_log2``."""
    paleness: float = 0.5
    """How far the mucosa pales over dense tissue, 0..1."""
    pale_hu: tuple[float, float] = (0.0, 300.0)
    """Values beneath the surface at which it begins to pale and at which it is palest."""
    texture: float = 1.0
    """Mottling and micro relief; 0 for none."""
    vessels: float = 0.0
    """Invented vessels in the mucosa; 0 for none. No CT shows them, and many of them would be a sign of disease."""
    silhouettes: bool = True
    """Two rays for a pixel where a near wall ends before a far one. No decoration: both rays show the CT."""
    specks: float = 0.0
    """Highlights on droplets of mucus, at a distance as well; 0 for none. Decoration."""
    secretions: float = 0.0
    """Glossy pools and bubbles of secretions on the posterior wall (the lowest of a supine patient), 0..1. Decoration;
    no CT shows them."""
    fog: float = 0.0
    """Mist on the lens, 0..1; decoration."""
    rings: float = 0.0
    """Cartilage rings of trachea and main bronchi, plates of lobar bronchi, from the airway tree; 0 for none."""
    membrane: float = 0.0
    """The flat, folded membranous wall at the back of trachea and main bronchi, drawn from the tree; 0 for none."""
    hue: float = 0.0
    """Colour by region, from the tree: a pale trachea, redder bronchi; 0 for one colour."""
    spurs: float = 0.0
    """Pale ridges of forks, from the tree, 0..1."""

    def __post_init__(self) -> None:
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
        """The parts that are on and not the patient's, by the names of their fields."""
        return tuple(name for name in DECORATIONS if getattr(self, name) > 0)

    def undecorated(self) -> Appearance:
        """The same without them."""
        dry = replace(self, specks=0.0, secretions=0.0, fog=0.0)
        return replace(dry, texture=0.0, vessels=0.0, rings=0.0, membrane=0.0, hue=0.0, spurs=0.0)

    def to_json(self) -> dict[str, Any]:
        """As a JSON object."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return {**values, "guides_mm": [list(guide) for guide in self.guides_mm], "pale_hu": list(self.pale_hu)}

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> Appearance:
        """From a JSON object; unknown keys are left alone, missing ones take their defaults."""
        known = {f.name: document[f.name] for f in fields(cls) if f.name in document}
        if "guides_mm" in known:
            known["guides_mm"] = tuple(tuple(float(v) for v in guide) for guide in known["guides_mm"])
        if "pale_hu" in known:
            low, high = known["pale_hu"]
            known["pale_hu"] = (float(low), float(high))
        return cls(**known)
