"""Decision whether numbers are Hounsfield units, and conversion of numbers to int16.

Numbers in files that do not state their unit (NIfTI, NRRD, MetaImage) are HU if all of these conditions are met:

1. The lowest value is -800 or below: every chest CT contains air or lung, and no other common scale has such negative
values.
2. At least 0.2 % of the voxels are in -1100..-600 (air, lung) and at least 2 % in -200..300 (fat, water, muscle,
blood): water is 0 by definition, so values of soft tissue are near it.
3. At least a quarter of the voxels that are neither air nor padding (above -200) are in -200..300: in HU, most of them
are soft tissue; a z-score times 1000 or a phase image fills its range evenly.

A DICOM CT with rescale tags and no other unit is HU, with two exceptions. First, it has 8 bits or fewer or spans fewer
than 300 values: it is then a CT windowed for display. Second, it has no value below -200 and meets the conditions above
after subtraction of 1024: its tags then lost the offset.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.volume.model import Note

HU_TYPES = ("", "HU", "HU_MOD")
"""Values of RescaleType for Hounsfield units, including a missing tag."""

_INT16 = np.iinfo(np.int16)
# Maximum number of samples of the histogram. A share of 0.2 % is then 8,000 samples, and its error is about 1 % of it.
_MAX_SAMPLES = 4_000_000
MAX_DOUBTFUL_SHARE = 0.01
"""Maximum share of voxels that were clipped, or are in the body and not finite; above it, the values are not HU."""
_TISSUE = -300  # above lung and air, below fat
_STRETCHED_TOP = 4095  # 12 bits, as CT and MR scanners use


@dataclass(frozen=True, slots=True)
class HuVerdict:
    """Whether the values of a volume are HU, and the reason for messages if they are not."""

    is_hu: bool
    reason: str | None


@dataclass(frozen=True, slots=True)
class Int16Values:
    """Values of a volume converted to int16, with notes on the conversion."""

    values: NDArray[np.int16]
    stretched: str | None
    """Description of the linear mapping of values that did not fit into int16; None without one.

    Mapped values are not HU.
    """
    notes: tuple[Note, ...]
    doubt: str | None
    """Reason why the values are not treated as HU although they look like HU; None if there is none."""


def _sample(values: NDArray[np.int16]) -> NDArray[np.int16]:
    flat = values.reshape(-1)
    # An odd stride visits all columns and rows in turn; an even one would visit only a few.
    return flat[:: (flat.size // _MAX_SAMPLES) | 1]


def judge_values(values: NDArray[np.int16]) -> HuVerdict:
    """Decide by the values whether they are HU; this module's docstring states the conditions."""
    lowest, highest = int(values.min()), int(values.max())
    if lowest >= 0 and highest <= 255:
        return HuVerdict(
            False, f"its values are {lowest} to {highest} (8 bits); Hounsfield units range from -1000 (air) to above 0"
        )
    if lowest > -800:
        # Scanners store HU + 1024; some converters do not subtract the offset.
        shifted = lowest >= 0 and judge_values(values - np.int16(1024)).is_hu
        hint = "; they look like HU with an offset of 1024" if shifted else ""
        return HuVerdict(False, f"its values are {lowest} to {highest}; expected air near -1000{hint}")
    sample = _sample(values)
    air = float(np.mean((sample >= -1100) & (sample <= -600)))
    soft = float(np.mean((sample >= -200) & (sample <= 300)))
    dense = float(np.mean(sample > -200))
    if air < 0.002 or soft < 0.02 or soft < 0.25 * dense:
        return HuVerdict(
            False,
            f"its values ({lowest} to {highest}) do not cluster near -1000 (air) and 0 (soft tissue): only "
            f"{100 * air:.1f} % and {100 * soft:.1f} % of the voxels do",
        )
    return HuVerdict(True, None)


def judge_dicom(
    values: NDArray[np.int16], *, modality: str, has_rescale: bool, rescale_type: str, bits_stored: int
) -> HuVerdict:
    """Decide whether a DICOM series is in HU: by its tags if they are sufficient, otherwise by its values.

    Parameters
    ----------
    values
        (nz, ny, nx) int16, after the rescale.
    modality
        Modality of the series, such as ``CT``.
    has_rescale
        Whether all slices have a slope and an intercept.
    rescale_type
        Unit that the tags state; empty without one.
    bits_stored
        Smallest number of bits of a stored value.
    """
    if modality != "CT":
        return HuVerdict(False, f"its modality is {modality or 'unknown'}, not CT")
    if rescale_type not in HU_TYPES:
        return HuVerdict(False, f"its tags state the unit {rescale_type}, not HU")
    if bits_stored <= 8:
        return HuVerdict(False, "its pixels have only 8 bits, probably windowed for display")
    lowest, highest = int(values.min()), int(values.max())
    if highest - lowest < 300:
        return HuVerdict(False, f"its values span only {lowest} to {highest}")
    if not has_rescale:
        verdict = judge_values(values)
        return verdict if verdict.is_hu else HuVerdict(False, f"it has no rescale tags, and {verdict.reason}")
    if lowest > -200 and judge_values(values - np.int16(1024)).is_hu:
        return HuVerdict(
            False,
            f"its values are {lowest} to {highest}; they look like HU with an offset of 1024 that its tags do "
            "not state",
        )
    return HuVerdict(True, None)


def _clip_to_int16(values: NDArray[np.generic]) -> tuple[NDArray[np.int16], int]:
    numbers = np.asarray(values)
    out = np.clip(np.rint(numbers) if numbers.dtype.kind == "f" else numbers, _INT16.min, _INT16.max).astype(np.int16)
    num_clipped = int(np.count_nonzero((numbers < _INT16.min) | (numbers > _INT16.max)))
    return out, num_clipped


def clipped_note(num_clipped: int) -> Note:
    """Return the note that states the number of clipped voxels."""
    words = f"{num_clipped} voxels lie outside -32768 to 32767 and were clipped"
    return Note("import.clipped", words, badge=True)


def to_int16(values: NDArray[np.generic]) -> Int16Values:
    """Convert a file's numbers to int16.

    Whole numbers within int16 stay unchanged, HU are rounded, and other numbers are mapped to 0..4095. NaN and minus
    infinity become the lowest finite value, infinity the highest, and a note counts them.

    Parameters
    ----------
    values
        (nz, ny, nx), any real number type. Not modified.

    Returns
    -------
    Int16Values
        The converted values with notes.

    Raises
    ------
    ValueError
        If no value is finite.
    """
    notes: tuple[Note, ...] = ()
    doubts: list[str] = []
    if values.dtype.kind == "f" and not np.isfinite([values.min(), values.max()]).all():
        values, note, share = _without_non_finite(values)
        notes = (note,)
        if share > MAX_DOUBTFUL_SHARE:
            doubts.append(f"{100 * share:.1f} % of the voxels in the body are not finite (NaN or infinite)")
    low, high = float(values.min()), float(values.max())
    whole = values.dtype.kind in "iu" or bool(np.all(values == np.rint(values)))
    if whole and low >= _INT16.min and high <= _INT16.max:
        int16_values = np.ascontiguousarray(values, dtype=np.int16)
        return Int16Values(int16_values, None, notes, "; ".join(doubts) or None)
    clipped, num_clipped = _clip_to_int16(values)
    if judge_values(clipped).is_hu:
        if num_clipped:
            notes += (clipped_note(num_clipped),)
        if num_clipped > MAX_DOUBTFUL_SHARE * values.size:
            share = num_clipped / values.size
            doubts.append(
                f"{100 * share:.1f} % of its voxels lie outside -32768 to 32767, which no Hounsfield value can reach"
            )
        return Int16Values(clipped, None, notes, "; ".join(doubts) or None)
    # Halved before the subtraction, because the difference of two large numbers may overflow.
    span = high / 2 - low / 2
    factor = _STRETCHED_TOP / 2 / span if span > 0 else 1.0
    stretched = np.rint((values.astype(np.float64) - low) * factor).astype(np.int16)
    words = f"the values in the file, {low:.6g} to {high:.6g}, were mapped to 0 to {stretched.max()}"
    return Int16Values(stretched, words, notes, None)


def _without_non_finite(values: NDArray[np.generic]) -> tuple[NDArray[np.generic], Note, float]:
    """Return a copy without NaN and infinities, a note that counts them, and their share of the body's voxels."""
    lowest, highest, num_low, num_high = np.inf, -np.inf, 0, 0
    for plane in values:  # slice by slice, without a second volume of booleans
        finite = np.isfinite(plane)
        lowest = min(lowest, plane.min(where=finite, initial=np.inf))
        highest = max(highest, plane.max(where=finite, initial=-np.inf))
        above = int(np.count_nonzero(plane == np.inf))
        num_high += above
        num_low += plane.size - int(np.count_nonzero(finite)) - above
    if num_low + num_high == values.size:
        msg = "no voxel has a finite value"
        raise ValueError(msg)
    share = _share_of_body(values)
    out = values.copy()
    for plane in out:
        plane[plane == np.inf] = highest
        plane[~np.isfinite(plane)] = lowest
    parts = []
    if num_low:
        parts.append(f"{num_low} became the lowest value ({lowest:g})")
    if num_high:
        parts.append(
            f"{num_high} the highest ({highest:g})" if parts else f"{num_high} became the highest value ({highest:g})"
        )
    words = f"{num_low + num_high} voxels are not finite (NaN or infinite): {' and '.join(parts)}"
    return out, Note("import.not-numbers", words, badge=True), share


def _share_of_body(values: NDArray[np.generic]) -> float:
    """Return the share of the body's voxels that are not finite, 0 to 1; 0 if nothing looks like a body in HU.

    The body in a slice consists of the voxels with tissue (above -300) on both sides in their row and in their column,
    so it includes the lungs and excludes the air around the patient. A slice without tissue between slices with tissue
    is lost completely; its body is the common part of the bodies in the two neighbouring slices.
    """
    bodies: list[NDArray[np.uint8] | None] = []
    for plane in values:
        tissue = np.isfinite(plane) & (plane > _TISSUE)
        bodies.append(np.packbits(_is_enclosed(tissue, 0) & _is_enclosed(tissue, 1)) if tissue.any() else None)
    known = [k for k, body in enumerate(bodies) if body is not None]
    num_body = num_lost = 0
    for k, plane in enumerate(values):
        if not known or not known[0] <= k <= known[-1]:
            continue
        body = bodies[k]
        if body is None:
            before, after = bodies[max(n for n in known if n < k)], bodies[min(n for n in known if n > k)]
            assert before is not None
            assert after is not None
            body = before & after
        inside = np.unpackbits(body, count=plane.size).reshape(plane.shape).astype(np.bool_)
        num_body += int(np.count_nonzero(inside))
        num_lost += int(np.count_nonzero(inside & ~np.isfinite(plane)))
    return num_lost / num_body if num_body else 0.0


def _is_enclosed(tissue: NDArray[np.bool_], axis: int) -> NDArray[np.bool_]:
    """Return where tissue is on both sides along an axis, or where the voxel itself is tissue."""
    lines = tissue if axis == 1 else tissue.T
    first = lines.argmax(axis=1)
    last = lines.shape[1] - 1 - lines[:, ::-1].argmax(axis=1)
    last[~lines.any(axis=1)] = -1
    places = np.arange(lines.shape[1])
    inside = (places >= first[:, None]) & (places <= last[:, None])
    return np.asarray(inside if axis == 1 else inside.T, dtype=np.bool_)
