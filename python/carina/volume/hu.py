"""Whether numbers are Hounsfield units, and how any numbers become int16.

The rule for files that do not say what their numbers mean (NIfTI, NRRD, MetaImage): they are HU if all of these hold.

1. The lowest value is -800 or below: air or lung is in every chest CT, and no other common scale is that negative.
2. At least 0.2 % of the voxels lie in -1100..-600 (air, lung) and at least 2 % in -200..300 (fat, water, muscle,
   blood): water is 0 by definition, so soft tissue must show around it.
3. At least a quarter of the voxels that are neither air nor padding (above -200) lie in -200..300: in HU soft tissue
   is most of what is not air; a z-score times 1000 or a phase image fills its range evenly.

A DICOM CT with rescale tags and no other unit is believed, unless it has 8 bits or fewer or spans fewer than 300
values: then it is a picture of a CT, windowed for the screen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["HuVerdict", "Int16Values", "judge_dicom", "judge_values", "to_int16"]

_INT16 = np.iinfo(np.int16)
_MAX_SAMPLES = 4_000_000  # of the histogram; a share of 0.2 % is then known to better than a thousandth of itself
_STRETCHED_TOP = 4095  # 12 bits, as CT and MR scanners write


@dataclass(frozen=True, slots=True)
class HuVerdict:
    """Is it HU, and if not, why (one sentence part for the badge)."""

    is_hu: bool
    reason: str | None


@dataclass(frozen=True, slots=True)
class Int16Values:
    """Values as int16 and what had to be done for it."""

    values: NDArray[np.int16]
    stretched: str | None
    """How the file's numbers became these, where they were mapped; such values are never HU."""
    warnings: tuple[str, ...]


def _sample(values: NDArray[np.int16]) -> NDArray[np.int16]:
    flat = values.reshape(-1)
    # An odd stride visits all columns and rows in turn, where an even one would keep to a few.
    return flat[:: (flat.size // _MAX_SAMPLES) | 1]


def judge_values(values: NDArray[np.int16]) -> HuVerdict:
    """Judge numbers by themselves, by the rule in this module's docstring."""
    lowest, highest = int(values.min()), int(values.max())
    if lowest >= 0 and highest <= 255:
        return HuVerdict(
            False, f"its values are {lowest} to {highest} (8 bits); Hounsfield units reach from -1000 (air) to above 0"
        )
    if lowest > -800:
        # Scanners store HU + 1024; some converters drop the offset.
        shifted = lowest >= 0 and judge_values(values - np.int16(1024)).is_hu
        hint = "; they look like HU with an offset of 1024 that is missing" if shifted else ""
        return HuVerdict(False, f"its values are {lowest} to {highest}; expected air near -1000{hint}")
    sample = _sample(values)
    air = float(np.mean((sample >= -1100) & (sample <= -600)))
    soft = float(np.mean((sample >= -200) & (sample <= 300)))
    dense = float(np.mean(sample > -200))
    if air < 0.002 or soft < 0.02 or soft < 0.25 * dense:
        return HuVerdict(
            False,
            f"its values ({lowest} to {highest}) do not gather near -1000 (air) and 0 (soft tissue): {100 * air:.1f} "
            f"% and {100 * soft:.1f} % of the voxels do",
        )
    return HuVerdict(True, None)


def judge_dicom(
    values: NDArray[np.int16], *, modality: str, has_rescale: bool, rescale_type: str, bits_stored: int
) -> HuVerdict:
    """Judge a DICOM series: by its tags where they say enough, else by its numbers."""
    if modality != "CT":
        return HuVerdict(False, f"it is a {modality or 'nameless'} series, not CT")
    if rescale_type not in ("", "HU", "HU_MOD"):
        return HuVerdict(False, f"its tags give the unit {rescale_type}, not HU")
    if bits_stored <= 8:
        return HuVerdict(False, "its pixels have 8 bits only, windowed for the screen")
    lowest, highest = int(values.min()), int(values.max())
    if highest - lowest < 300:
        return HuVerdict(False, f"its values span only {lowest} to {highest}")
    if not has_rescale:
        verdict = judge_values(values)
        return verdict if verdict.is_hu else HuVerdict(False, f"it has no rescale tags, and {verdict.reason}")
    return HuVerdict(True, None)


def _clip(values: NDArray[np.generic]) -> tuple[NDArray[np.int16], tuple[str, ...]]:
    numbers = np.asarray(values)
    out = np.clip(np.rint(numbers) if numbers.dtype.kind == "f" else numbers, _INT16.min, _INT16.max).astype(np.int16)
    num_clipped = int(np.count_nonzero((numbers < _INT16.min) | (numbers > _INT16.max)))
    if num_clipped == 0:
        return out, ()
    return out, (f"{num_clipped} voxels lie outside -32768..32767 and were set to the nearest of these",)


def to_int16(values: NDArray[np.generic]) -> Int16Values:
    """Bring a file's numbers into int16: as they are where they fit, rounded where they are HU, else stretched to
    0..4095.

    Parameters
    ----------
    values
        (nz, ny, nx), any real number type. Not modified.

    Raises
    ------
    ValueError
        If no value is finite.
    """
    notes: tuple[str, ...] = ()
    if values.dtype.kind == "f":
        finite = np.isfinite(values)
        if not finite.all():
            if not finite.any():
                msg = "no voxel holds a finite number"
                raise ValueError(msg)
            lowest = values[finite].min()
            notes = (
                f"{int(values.size - np.count_nonzero(finite))} voxels are not numbers (NaN) and were set to the "
                "lowest value",
            )
            values = np.where(finite, values, lowest)
    low, high = float(values.min()), float(values.max())
    whole = values.dtype.kind in "iu" or bool(np.all(values == np.rint(values)))
    if whole and low >= _INT16.min and high <= _INT16.max:
        return Int16Values(np.ascontiguousarray(values, dtype=np.int16), None, notes)
    clipped, clip_notes = _clip(values)
    if judge_values(clipped).is_hu:
        return Int16Values(clipped, None, notes + clip_notes)
    factor = _STRETCHED_TOP / (high - low) if high > low else 1.0
    stretched = np.rint((values.astype(np.float64) - low) * factor).astype(np.int16)
    return Int16Values(stretched, f"the file's {low:.6g} to {high:.6g} were mapped to 0 to {stretched.max()}", notes)
