"""``carina bench track --only shares``: share of airways that the search finds, by slice thickness and diameter.

The calibrated shares of :mod:`carina.track.tree.thick_slices` are the least, mean and largest shares of the length
found in the painted CTs of ``--only hard`` (five patients, three kernels) and in phantoms. One held-out patient and one
held-out phantom validate them. Of real CTs, the rows give the found share of the airways that readers list, by the
calibre that the readers measured.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.config import load_settings
from carina.errors import CarinaError, NoResultError
from carina.phantom import generate_phantom
from carina.track import find_airways
from carina.track.tree.thick_slices import SHARES, calibrated_shares, effective_mm
from carina.volume import Volume
from carina_bench.track_hard_cases import KERNELS, SLICES, hard_cases
from carina_bench.track_painted import PATIENTS
from carina_bench.track_quality import is_near
from carina_bench.track_truth import Truth, truth_of_phantom
from carina_bench.track_visible import CTS, STEP_MM, found_share, listed_airways, opened_ct

__all__ = ["CALIBRES", "CASES", "length_by_calibre", "run", "table_of"]

Say = Callable[[str], None]
Row = dict[str, Any]
Lengths = NDArray[np.float64]

CALIBRES = tuple(SHARES)
"""Classes of airway diameter (calibres), mm."""
HELD_PATIENT = "lobes-Patient3"
"""Patient that is excluded from the fit and used for the validation."""
PHANTOMS = {"fit": (1, 2), "held": (11,)}
"""Seeds of the phantoms from which the shares are fitted, and of those held out for the check."""
PHANTOM_SLICES_MM = (1.5, 2.0, 2.5, 3.0, 5.0)
"""Slice thicknesses of the phantoms, mm."""
PIXEL_MM, NOISE_HU = 0.7, 25.0
"""Spacing in plane (mm) and standard deviation of the noise (HU) of the phantoms."""
OVERLAPPING = ("3mm-every-2mm", "5mm-every-2.5mm")
"""Names of overlapping slices: thickness and distance."""
MIN_LENGTH_MM = 30.0
"""Minimum length in mm of true airways of a calibre in a case for a measured share."""
MAX_OUTSIDE = 0.05
"""Maximum distance of a measured share from the range of the shares in the table."""
CASES = (*PATIENTS, HELD_PATIENT, "phantoms", "real")
"""Values that ``--case`` accepts: patients, phantoms, or real CTs."""


def run(quick: bool, say: Say, cases: Sequence[str] = ()) -> list[Row]:
    """Return a row for each calibre and slice thickness, then one for each held-out case and calibre."""
    fitted: dict[tuple[float, int], list[float]] = {}
    held: list[Row] = []
    for name, part, slices_mm, volume, truth in _cases(quick, say, cases):
        try:
            found_zyx = find_airways(volume, progress=False).lumen_zyx != 0
        except CarinaError as error:
            say(f"{name}: {error}")
            found_zyx = np.zeros(volume.shape_zyx, np.bool_)
        found, whole = length_by_calibre(volume, truth, found_zyx)
        say(f"{name}: " + ", ".join(f"{hit / max(all_mm, 1e-9):.2f}" for hit, all_mm in zip(found, whole, strict=True)))
        for number in np.flatnonzero(whole >= MIN_LENGTH_MM):
            share = float(found[number] / whole[number])
            if part == "fit":
                fitted.setdefault((slices_mm, int(number)), []).append(share)
            else:
                held.append(_held_row(name, int(number), slices_mm, share))
    real = [] if cases and "real" not in cases else list(_real_rows(say))
    return [*table_of(fitted), *held, *real]


def table_of(fitted: dict[tuple[float, int], list[float]]) -> Iterator[Row]:
    """Yield the least, mean and largest share found, by thickness and calibre in %, beside the calibrated shares."""
    for (slices_mm, number), shares in sorted(fitted.items()):
        known = calibrated_shares(slices_mm)[number]
        yield {
            "what": f"share of length found, {_title(number)}",
            "case": f"slices of {slices_mm:g} mm, {len(shares)} CTs",
            "figure": float(np.mean(shares)),
            "min": min(shares),
            "max": max(shares),
            "note": f"calibrated: {known.typical:.2f} ({known.least:.2f} to {known.most:.2f})",
        }


def _held_row(name: str, number: int, slices_mm: float, share: float) -> Row:
    known = calibrated_shares(slices_mm)[number]
    return {
        "what": f"share outside the calibrated range, {_title(number)}",
        "case": name,
        "figure": max(known.least - share, share - known.most, 0.0),
        "limit": MAX_OUTSIDE,
        "better": "lower",
        "aim": True,
        "note": f"{share:.2f}; calibrated: {known.typical:.2f} ({known.least:.2f} to {known.most:.2f})",
    }


def _real_rows(say: Say) -> Iterator[Row]:
    """Yield by calibre the share of the length listed by readers that the search finds in each real CT."""
    data = load_settings().data_dir
    assert data is not None
    for ct in CTS:
        with opened_ct(data / "ct", ct) as volume:
            if volume is None:
                say(f"{ct} is not in {data / 'ct'}")
                continue
            airways = find_airways(volume, progress=False)
        known = airways.calibrated_shares
        assert known is not None
        listed = [one for one in listed_airways(ct) if one.calibre_mm is not None]
        for share in known.shares:
            own = [one for one in listed if share.from_mm <= (one.calibre_mm or 0.0) < (share.to_mm or np.inf)]
            length = sum(len(one.points) for one in own)
            if length * STEP_MM >= MIN_LENGTH_MM:
                found = sum(found_share(one, airways.tree) * len(one.points) for one in own) / length
                yield {
                    "what": f"share of the listed length found, {_title(CALIBRES.index((share.from_mm, share.to_mm)))}",
                    "case": ct,
                    "figure": found,
                    "note": f"stated: {share.typical} ({share.least:.2f} to {share.most:.2f})",
                }


def _title(number: int) -> str:
    from_mm, to_mm = CALIBRES[number]
    return f"over {from_mm:g} mm" if to_mm is None else f"{from_mm:g} to {to_mm:g} mm"


def length_by_calibre(volume: Volume, truth: Truth, found_zyx: NDArray[np.bool_]) -> tuple[Lengths, Lengths]:
    """Return the found and the total length of true airways, mm, for each of :data:`CALIBRES`."""
    lengths = np.zeros((2, len(CALIBRES)))
    for branch in truth.branches:
        inside = is_near(found_zyx, volume, branch.points, 0.5 * max(volume.spacing_mm))
        step = np.linalg.norm(np.diff(branch.points, axis=0), axis=1)
        hits = step * 0.5 * (inside[1:].astype(float) + inside[:-1])
        diameter = branch.radius_mm[1:] + branch.radius_mm[:-1]
        for number, (from_mm, to_mm) in enumerate(CALIBRES):
            own = (diameter >= from_mm) & (diameter < (np.inf if to_mm is None else to_mm))
            lengths[:, number] += hits[own].sum(), step[own].sum()
    return lengths[0], lengths[1]


def _cases(quick: bool, say: Say, cases: Sequence[str]) -> Iterator[tuple[str, str, float, Volume, Truth]]:
    """Yield name, part (fit or held), effective slice thickness, CT and truth of each case.

    Overlapping slices test the effective thickness.
    """
    data = load_settings().data_dir
    if data is None or not data.is_dir():
        raise NoResultError("no masks to paint CTs from: CARINA_DATA_DIR names no folder")
    patients = [name for name in (*PATIENTS, HELD_PATIENT) if not cases or name in cases]
    kernels = ("medium",) if quick else tuple(KERNELS)
    plain = [name for name, slices in SLICES.items() if slices.increment_mm is None and not slices.is_resampled]
    for case in hard_cases(data, patients, kernels, (*plain, *OVERLAPPING), say):
        slices = SLICES[case.slices]
        part = "fit" if case.patient != HELD_PATIENT and slices.increment_mm is None else "held"
        yield case.name, part, effective_mm(slices.thickness_mm, slices.distance_mm), case.volume, case.truth
    if cases and "phantoms" not in cases:
        return
    for part, seeds in PHANTOMS.items():
        for seed in seeds[:1] if quick else seeds:
            for slice_mm in PHANTOM_SLICES_MM:
                made = generate_phantom(seed=seed, spacing_mm=(PIXEL_MM, PIXEL_MM, slice_mm), noise_hu=NOISE_HU)
                truth = truth_of_phantom(made.truth, made.lumen_zyx, made.volume)
                yield f"phantom {seed} {slice_mm:g}mm", part, slice_mm, made.volume, truth
