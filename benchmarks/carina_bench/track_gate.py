"""``carina bench track --only gate``: quality gate (assessment of a CT) on phantoms with one degradation each.

Each phantom is degraded in one way. The assessment must name this degradation and no other, and the trusted generation
must differ from the true one by at most one. The true one is the last generation up to which the search finds at least
:data:`FOUND` of the true length of every generation. The cases of :data:`PATIENTS` judge CTs that are painted from the
masks of patients in the same way.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from carina.config import load_settings
from carina.errors import CarinaError
from carina.phantom import Phantom, generate_phantom
from carina.track import assess_ct, find_airways
from carina.volume import Finding, Volume
from carina_bench.paint import PaintOptions, paint
from carina_bench.paint_scene import mask_folders, masks_of, scene_of_masks
from carina_bench.track_disturbed_cases import Step, noisy, stepped, stepped_points, with_clips
from carina_bench.track_painted import PATIENTS, truth_of_painted
from carina_bench.track_quality import is_near
from carina_bench.track_truth import Truth, truth_of_phantom

__all__ = ["DEGRADATIONS", "OPTIONS", "SEEDS", "degraded", "run", "true_generation"]

Say = Callable[[str], None]
Row = dict[str, Any]

SEEDS = {"fit": (301, 302, 303), "held": (411, 412, 413, 414)}
"""Seeds of the phantoms for the calibration of the limits, and of those that are only judged."""
PIXEL_MM, NOISE_HU, NOISE_MM = 1.1, 20.0, 0.6
"""Spacing of the phantoms in mm, noise of an undegraded one in HU, and the sigma of its correlation in mm."""
GENERATIONS = 9
BOX_LPS = ((-174.0, -126.0, -232.0), (174.0, 126.0, 112.0))
"""Box that contains the whole lungs, LPS mm."""
OPTIONS: dict[str, Any] = {"spacing_mm": PIXEL_MM, "noise_hu": 0.0, "generations": GENERATIONS, "box_lps": BOX_LPS}
"""Options of a phantom before its degradation."""
FOUND = 0.8
"""Minimum share of the true length of a generation that is found, for a generation that can be trusted."""
STEP = Step(above_lps_z=-30.0, shift_mm=(0.0, 3.3, 6.6))


def _sharpened(volume: Volume) -> Volume:
    """Return the CT with an overshoot in plane, as a sharp kernel makes."""
    values = volume.hu_zyx.astype(np.float32)
    wide = values
    for axis in (1, 2):
        wide = 0.25 * np.roll(wide, -1, axis) + 0.5 * wide + 0.25 * np.roll(wide, 1, axis)
    return _with(volume, values + 1.6 * (values - wide))


def _with(volume: Volume, values: Any) -> Volume:
    return dataclasses.replace(volume, hu_zyx=np.clip(np.rint(values), -1024, 3071).astype(np.int16))


def _thick(volume: Volume, count: int = 3) -> Volume:
    """Return the CT with slices that average a number of slices."""
    num = volume.shape_zyx[0] // count
    values = volume.hu_zyx[: num * count].reshape(num, count, *volume.shape_zyx[1:]).mean(axis=1)
    matrix = volume.lps_from_ijk.copy()
    matrix[:3, 3] += matrix[:3, 2] * (count - 1) / 2
    matrix[:3, 2] *= count
    return Volume(np.rint(values).astype(np.int16), matrix, source=volume.source)


def _cropped(volume: Volume, from_mm: float, to_mm: float) -> Volume:
    heights = volume.lps_from_ijk[2, 3] + volume.lps_from_ijk[2, 2] * np.arange(volume.shape_zyx[0])
    inside = np.flatnonzero((heights >= from_mm) & (heights <= to_mm))
    matrix = volume.lps_from_ijk.copy()
    matrix[:3, 3] += matrix[:3, 2] * inside[0]
    return Volume(np.ascontiguousarray(volume.hu_zyx[inside[0] : inside[-1] + 1]), matrix, source=volume.source)


def _expired(volume: Volume) -> Volume:
    """Return the CT with denser lungs; air and tissue stay the same."""
    density = volume.hu_zyx.astype(np.float32) + 1000.0
    factor = 1.0 + 0.9 * np.clip((600.0 - density) / 400.0, 0.0, 1.0) * (density > 60.0)
    return _with(volume, density * factor - 1000.0)


def _enhanced(volume: Volume) -> Volume:
    """Return the CT with enhanced blood in a heart of about 0.4 litres."""
    z, y, x = np.ogrid[tuple(slice(n) for n in volume.shape_zyx)]
    dx, dy, dz = volume.spacing_mm
    ox, oy, oz = volume.lps_from_ijk[:3, 3]
    shape = ((ox + dx * x - 5) / 45) ** 2 + ((oy + dy * y + 35) / 40) ** 2 + ((oz + dz * z + 75) / 50) ** 2
    values = volume.hu_zyx.copy()
    values[(shape < 1.0) & (values > -20) & (values < 110)] = 300
    return _with(volume, values)


def _scaled(volume: Volume, factor: float) -> Volume:
    matrix = volume.lps_from_ijk.copy()
    matrix[:3] *= factor
    return Volume(volume.hu_zyx, matrix, source=volume.source)


def _noisy(volume: Volume, seed: int) -> Volume:
    return noisy(volume, NOISE_HU, seed=seed, sigma_mm=NOISE_MM)


Degrade = Callable[[Volume, int], Volume]
DEGRADATIONS: dict[str, Degrade] = {
    "none": _noisy,
    "noise": lambda volume, seed: noisy(volume, 85.0, seed=seed, sigma_mm=NOISE_MM),
    "slices": lambda volume, seed: _noisy(_thick(volume), seed),
    "kernel": lambda volume, seed: _noisy(_sharpened(volume), seed),
    "cut-top": lambda volume, seed: _noisy(_cropped(volume, -1e9, 55.0), seed),
    "cut-bottom": lambda volume, seed: _noisy(_cropped(volume, -90.0, 1e9), seed),
    "motion": lambda volume, seed: stepped(_noisy(volume, seed), STEP),
    "expiration": lambda volume, seed: _noisy(_expired(volume), seed),
    "contrast": lambda volume, seed: _noisy(_enhanced(volume), seed),
    "tube": _noisy,
    "metal": lambda volume, seed: with_clips(_noisy(volume, seed), (35.0, 5.0, -45.0), seed=seed),
    "small-patient": lambda volume, seed: _noisy(_scaled(volume, 0.6), seed),
    "large-patient": lambda volume, seed: _noisy(_scaled(volume, 1.35), seed),
}
"""Functions that degrade a noiseless phantom, by the code of the finding that the quality gate must report for it."""


def degraded(name: str, phantom: Phantom, seed: int) -> tuple[Volume, Truth]:
    """Return the degraded CT of a phantom, and its true airways in it."""
    volume = DEGRADATIONS[name](phantom.volume, seed)
    truth = truth_of_phantom(phantom.truth, phantom.lumen_zyx, phantom.volume)
    factor = {"small-patient": 0.6, "large-patient": 1.35}.get(name, 1.0)
    branches = []
    for branch in truth.branches:
        points, inside = branch.points * factor, np.ones(len(branch.points), dtype=np.bool_)
        if name == "motion":
            points, inside = stepped_points(points, STEP, phantom.volume)
        ijk = volume.to_ijk(points)
        inside &= ((ijk > -0.5) & (ijk < np.array(volume.shape_zyx[::-1]) - 0.5)).all(axis=1)
        if inside.sum() >= 2:
            radius = branch.radius_mm[inside] * factor
            branches.append(dataclasses.replace(branch, points=points[inside], radius_mm=radius))
    return volume, dataclasses.replace(truth, branches=tuple(branches))


def true_generation(volume: Volume, truth: Truth, found_zyx: np.ndarray[Any, Any]) -> tuple[int, list[float]]:
    """Return the last generation up to which at least :data:`FOUND` of the length is found, and all shares."""
    length, hits = np.zeros(32), np.zeros(32)
    for branch in truth.branches:
        inside = is_near(found_zyx, volume, branch.points, 0.5 * max(volume.spacing_mm))
        length[branch.generation] += len(branch.points)
        hits[branch.generation] += inside.sum()
    known = np.flatnonzero(length)
    shares = (hits[known] / length[known]).tolist()
    trusted = 0
    for generation, share in zip(known.tolist(), shares, strict=True):
        if share < FOUND:
            break
        trusted = generation
    return trusted, shares


PAINTED: dict[str, PaintOptions] = {
    "none": PaintOptions(kernel="medium", noise_hu=25.0),
    "noise": PaintOptions(kernel="medium", noise_hu=85.0),
    "slices": PaintOptions(kernel="medium", noise_hu=25.0, slice_mm=3.0),
    "kernel": PaintOptions(kernel="sharp", noise_hu=25.0),
}
"""Settings of the scanner for the degradations of painted patients."""


def _painted(patients: Sequence[str], names: Sequence[str], say: Say) -> Iterator[Row]:
    """Yield codes, trusted generations and measured properties of each painted patient."""
    data = load_settings().data_dir
    folders = {} if data is None else mask_folders(data)
    for patient in patients:
        if patient not in folders:
            say(f"no masks of {patient}: nothing is painted")
            continue
        scene = scene_of_masks(masks_of(folders[patient]), PAINTED["none"])
        for name in names:
            made = paint(scene, PAINTED[name])
            yield _judged(f"{patient} {name}", name, made.volume, truth_of_painted(made), say)


def named_codes(findings: Sequence[Finding]) -> list[str]:
    """Return the degradations that findings report; those on thick slices count as one, cut lungs name the face."""
    codes = []
    for finding in findings:
        if finding.code in ("spacing", "uneven"):
            codes.append("slices")
        elif finding.code == "cut":
            codes += [
                f"cut-{face}" for face in ("top", "bottom", "left", "right", "front", "back") if face in finding.words
            ]
        else:
            codes.append(finding.code)
    return sorted(set(codes))


def cases(seeds: Sequence[int], names: Sequence[str], say: Say) -> Iterator[Row]:
    """Yield codes, trusted generations and measured properties of each degraded phantom."""
    for seed in seeds:
        plain = generate_phantom(**OPTIONS, seed=seed)
        for name in names:
            made = plain
            if name == "tube":
                made = generate_phantom(**OPTIONS, seed=seed, tube="endotracheal")
            volume, truth = degraded(name, made, seed)
            yield _judged(f"{seed} {name}", name, volume, truth, say)


def _judged(title: str, name: str, volume: Volume, truth: Truth, say: Say) -> Row:
    """Return codes, trusted generations and measured properties of one CT."""
    try:
        airways = find_airways(volume, progress=False)
        found = airways.lumen_zyx != 0
    except CarinaError as error:
        say(f"{title}: {error}")
        airways, found = None, np.zeros(volume.shape_zyx, np.bool_)
    generation, shares = true_generation(volume, truth, found)
    judged = assess_ct(volume, airways)
    row = {
        "case": name,
        "ct": title,
        "codes": named_codes(judged.findings),
        "trusted": judged.trusted_generation,
        "true": generation,
        "shares": [round(share, 2) for share in shares],
        "pixel_mm": sorted(volume.spacing_mm)[1],
        "slice_mm": max(volume.spacing_mm),
        **{key: value for key, value in judged.to_json().items() if key.endswith(("_hu", "_mm", "_litres"))},
    }
    say(f"{row}")
    return row


def run(quick: bool, say: Say, names: Sequence[str] = ()) -> list[Row]:
    """Return a row for each degradation, and one for the trusted generation of all judged CTs.

    Parameters
    ----------
    quick
        One phantom, or two degradations of each painted patient.
    say
        Function that receives a line about each CT.
    names
        Degradations; a name of :data:`PATIENTS` judges this painted patient instead of the phantoms.
    """
    patients = [name for name in names if name in PATIENTS]
    kinds = [name for name in names if name not in PATIENTS] or list(PAINTED if patients else DEGRADATIONS)
    if patients:
        painted = [name for name in kinds if name in PAINTED]
        found = list(_painted(patients, painted[:2] if quick else painted, say))
    else:
        found = list(cases(SEEDS["held"][:1] if quick else SEEDS["held"], kinds, say))
    if not found:
        return []
    rows: list[Row] = []
    for name in dict.fromkeys(row["case"] for row in found):
        own = [row for row in found if row["case"] == name]
        expected = [] if name == "none" else [name]
        others = sorted({code for row in own for code in row["codes"]} - set(expected))
        rows.append(
            {
                "what": "CTs whose degradation alone is named",
                "case": name,
                "figure": sum(row["codes"] == expected for row in own) / len(own),
                "limit": 1.0,
                "aim": True,
                "note": f"{len(own)} CTs; others named: {', '.join(others) or 'none'}; trusted generation "
                + ", ".join(f"{row['trusted']} (true {row['true']})" for row in own),
            }
        )
    near = [abs(row["trusted"] - row["true"]) <= 1 for row in found]
    rows.append(
        {"what": "CTs whose trusted generation is right within one", "figure": sum(near) / len(near), "limit": 0.9,
         "aim": True, "note": f"{sum(near)} of {len(near)}"}
    )  # fmt: skip
    return rows
