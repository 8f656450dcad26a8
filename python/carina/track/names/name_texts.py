"""Texts for the names of bronchi: numbers (Boyden), names (Jackson and Huber), lobes."""

from __future__ import annotations

import re
from dataclasses import dataclass

from carina.display import one_line

MIRRORED = "track.mirrored"
"""Code of the permanent note on a tree whose three-lobed lung is on the left."""
MIRRORED_CHEST = "mirrored"
"""First word of the variant of a trachea if the three-lobed lung is on the left."""

ISOMERISM = "track.isomerism"
"""Code of the permanent note on a tree in which both lungs have the pattern of the left one."""
LEFT_ISOMERISM = "left isomerism"
"""First words of the variant of a trachea if both lungs have the pattern of the left one."""

# Segment: (name by Jackson and Huber, lobe).
_SEGMENTS = {
    "RB1": ("apical segment", "RUL"),
    "RB2": ("posterior segment", "RUL"),
    "RB3": ("anterior segment", "RUL"),
    "RB4": ("lateral segment", "RML"),
    "RB5": ("medial segment", "RML"),
    "RB6": ("superior segment", "RLL"),
    "RB*": ("subsuperior segment", "RLL"),
    "RB7": ("medial basal segment", "RLL"),
    "RB8": ("anterior basal segment", "RLL"),
    "RB9": ("lateral basal segment", "RLL"),
    "RB10": ("posterior basal segment", "RLL"),
    "LB1+2": ("apicoposterior segment", "LUL"),
    "LB1": ("apical segment", "LUL"),
    "LB2": ("posterior segment", "LUL"),
    "LB3": ("anterior segment", "LUL"),
    "LB4": ("superior lingular segment", "LUL"),
    "LB5": ("inferior lingular segment", "LUL"),
    "LB6": ("superior segment", "LLL"),
    "LB*": ("subsuperior segment", "LLL"),
    "LB7": ("medial basal segment", "LLL"),
    "LB8": ("anteromedial basal segment", "LLL"),
    "LB9": ("lateral basal segment", "LLL"),
    "LB10": ("posterior basal segment", "LLL"),
}
_TRUNKS = {
    "Trachea": ("trachea", None, None),
    "RMB": ("right main bronchus", "right", None),
    "LMB": ("left main bronchus", "left", None),
    "BI": ("bronchus intermedius", "right", None),
    "RUL": ("right upper lobe bronchus", "right", "RUL"),
    "RML": ("middle lobe bronchus", "right", "RML"),
    "RLL": ("right lower lobe bronchus", "right", "RLL"),
    "LUL": ("left upper lobe bronchus", "left", "LUL"),
    "LML": ("left-sided middle lobe bronchus", "left", "LML"),
    "LLL": ("left lower lobe bronchus", "left", "LLL"),
    "Upper division": ("upper division of the left upper lobe", "left", "LUL"),
    "Lingula": ("lingular bronchus", "left", "LUL"),
    "Right basal trunk": ("basal trunk of the right lower lobe", "right", "RLL"),
    "Left basal trunk": ("basal trunk of the left lower lobe", "left", "LLL"),
    "Accessory cardiac bronchus": ("accessory cardiac bronchus", "right", None),
}
_LOBE_WORDS = {
    "RUL": "right upper lobe",
    "RML": "right middle lobe",
    "RLL": "right lower lobe",
    "LUL": "left upper lobe",
    "LML": "left-sided middle lobe",
    "LLL": "left lower lobe",
}
_NAME = re.compile(
    r"^(?P<side>[RL])B?\s*(?P<numbers>\*|\d{1,2}(?:\+(?:\d{1,2}|\*))*)\s*(?P<letter>[a-e])?(?P<roman>iv|i{1,3}|v)?$",
    re.IGNORECASE,
)


@one_line
@dataclass(frozen=True, slots=True)
class NameWords:
    """Forms of the anatomical name of one bronchus."""

    short: str
    """Short name of the bronchus, such as RB6."""
    long: str
    """Long name of the bronchus, such as superior segment, RLL."""
    jackson_huber: str
    """Name by Jackson and Huber, such as superior segment."""
    boyden: str | None
    """Number by Boyden, such as B6; None for a trunk without a number."""
    side: str | None
    """Side of the bronchus: right or left; None for the trachea."""
    lobe: str | None
    """Lobe, such as RLL; None for trunks of several lobes."""

    @property
    def full(self) -> str:
        """Short and long name, such as RB6 (superior segment, RLL)."""
        return f"{self.short} ({self.long})"


def bare_name(name: str) -> str:
    """Return a name in the spelling of the tables; case and blanks are ignored."""
    text = " ".join(name.split())
    for known in (*_TRUNKS, *_SEGMENTS):
        if text.casefold() == known.casefold():
            return known
    found = _NAME.match(text.replace(" ", ""))
    if found is None:
        return text
    numbers = "+".join(part if part == "*" else str(int(part)) for part in found["numbers"].split("+"))
    base = f"{found['side'].upper()}B{numbers}"
    if base == "LB7+8":
        base = "LB8"
    return base + (found["letter"] or "").lower() + (found["roman"] or "").lower()


def segment_of(name: str) -> str | None:
    """Return the segment of a segmental or subsegmental name (RB6 for RB6a); None for any other name."""
    found = _NAME.match(bare_name(name).replace(" ", ""))
    if found is None:
        return None
    base = f"{found['side'].upper()}B{found['numbers']}"
    return base if base in _SEGMENTS else None


def name_words(name: str) -> NameWords | None:
    """Return the forms of an airway's name.

    Parameters
    ----------
    name
        Short name as returned by :func:`name_tree`: Trachea, RMB, BI, RUL, RB6, RB9+10, RB6a, LB1+2 ...

    Returns
    -------
    NameWords or None
        None for a name outside the nomenclature (users may choose any name).

    Examples
    --------
    >>> name_words("RB6").full
    'RB6 (superior segment, RLL)'
    >>> name_words("LB8").boyden
    'B7+8'
    >>> name_words("LB1+2a").long
    'apicoposterior segment, LUL, subsegment a'
    >>> name_words("my favourite") is None
    True

    References
    ----------
    Boyden's numbers; Jackson and Huber 1943, names of segments (reference: features 5.4).
    """
    bare = bare_name(name)
    if bare in _TRUNKS:
        words, side, lobe = _TRUNKS[bare]
        return NameWords(bare, words, words, None, side, lobe)
    found = _NAME.match(bare.replace(" ", ""))
    if found is None:
        return None
    side = "right" if found["side"].upper() == "R" else "left"
    letters = (found["letter"] or "") + (found["roman"] or "")
    base = f"{found['side'].upper()}B{found['numbers']}"
    boyden = f"B{'7+8' if base == 'LB8' else found['numbers']}{letters}"
    if base in _SEGMENTS:
        words, lobe = _SEGMENTS[base]
        long = f"{words}, {lobe}" + (f", subsegment {letters}" if letters else "")
        return NameWords(bare, long, words, boyden, side, lobe)
    parts = [f"{base[:2]}{number}" for number in found["numbers"].split("+")]
    if letters or any(part not in _SEGMENTS for part in parts):
        return None
    lobes = {_SEGMENTS[part][1] for part in parts}
    words = "common stem of " + " and ".join([", ".join(parts[:-1]), parts[-1]])
    if len(lobes) != 1:
        return NameWords(bare, words, words, boyden, side, None)
    lobe = lobes.pop()
    return NameWords(bare, f"{words}, {lobe}", words, boyden, side, lobe)


def lobe_words(lobe: str) -> str:
    """Return the lobe in words, such as right upper lobe for RUL."""
    return _LOBE_WORDS[lobe]
