"""Grey scale of a volume: how its values are shown and searched, and which features need Hounsfield units."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from carina.render import GreyWindow, TransferFunction
from carina.value import FrozenValue, Words

if TYPE_CHECKING:
    from carina.session.engines import Parts
    from carina.volume import Volume

LUNG_WINDOW = GreyWindow(1500.0, -600.0)
HISTOGRAM_PRESET = "from histogram"


class FeatureOff(FrozenValue, frozen=True):
    """A feature that this volume does not support, and the reason."""

    what: Words
    why: Words


@dataclass(frozen=True, slots=True)
class GreyScale:
    """Display and search settings that follow from the unit of a volume's values."""

    presets: tuple[str, ...]
    """Names of the transfer functions that suit the values."""
    threshold: float | None
    """Lumen threshold from the histogram; None for HU, for which the airway search determines its own threshold."""
    window: GreyWindow
    transfer: TransferFunction
    """Transfer function that a new case of this volume gets."""
    off: tuple[FeatureOff, ...] = ()
    """Features that are unavailable because the volume has no HU; empty for a volume in HU."""


def grey_scale(volume: Volume, parts: Parts) -> GreyScale:
    """Return the initial display settings of a volume."""
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
