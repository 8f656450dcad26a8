"""What the numbers of a volume stand for: how they are shown and searched, and what they are no good for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from carina.display import one_line
from carina.render import GreyWindow, TransferFunction

if TYPE_CHECKING:
    from carina.session.parts import Parts
    from carina.volume import Volume

__all__ = ["HISTOGRAM_PRESET", "FeatureOff", "GreyScale", "grey_scale"]

LUNG_WINDOW = GreyWindow(1500.0, -600.0)
HISTOGRAM_PRESET = "from histogram"


@one_line
@dataclass(frozen=True, slots=True)
class FeatureOff:
    """What this volume cannot do, and why."""

    what: str
    why: str


@dataclass(frozen=True, slots=True)
class GreyScale:
    """What the numbers of a volume stand for, as far as it says how they are shown and searched."""

    presets: tuple[str, ...]
    """Transfer functions that make sense for them."""
    threshold: float | None
    """Of the lumen, from the histogram; None for HU, where the airway search finds its own."""
    window: GreyWindow
    transfer: TransferFunction
    """To begin with."""
    off: tuple[FeatureOff, ...] = ()
    """What needs HU and has none."""


def grey_scale(volume: Volume, parts: Parts) -> GreyScale:
    """How a volume is shown before a person says anything."""
    if volume.is_hu:
        return GreyScale(parts.presets, None, LUNG_WINDOW, parts.transfer_preset("endoscopic"))
    low, high = volume.value_range
    transfer, threshold = parts.transfer_from_histogram(volume)
    why = volume.not_hu_reason or "this volume is not in HU"
    return GreyScale(
        (HISTOGRAM_PRESET,),
        threshold,
        GreyWindow(float(max(1, high - low)), (high + low) / 2.0),
        transfer,
        (
            FeatureOff("transfer functions and windows in HU", why),
            FeatureOff("the check that the scan covers both lungs", why),
            FeatureOff("a lumen threshold in HU (the threshold shown is in the file's own units)", why),
        ),
    )
