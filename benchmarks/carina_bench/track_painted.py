"""CTs painted from patients' masks; each patient is painted under each condition of one table."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from carina.volume import Volume
from carina_bench.paint import Painted, PaintOptions, paint
from carina_bench.paint_scene import mask_folders, masks_of, scene_of_masks
from carina_bench.track_truth import TrueBranch, Truth, sampled

__all__ = ["CONDITIONS", "PATIENTS", "QUICK_CONDITIONS", "Condition", "painted_cases", "truth_of_painted"]


@dataclass(frozen=True, slots=True)
class Condition:
    """Scan parameters of a painted CT, and the kind of limits by which its result is judged."""

    kind: str
    """Key of the limits in ``track_quality.AIMS``."""
    options: PaintOptions


CONDITIONS: dict[str, Condition] = {
    "soft-25": Condition("painted", PaintOptions(kernel="soft", noise_hu=25.0)),
    "soft-45": Condition("painted", PaintOptions(kernel="soft", noise_hu=45.0)),
    "medium-25": Condition("painted", PaintOptions(kernel="medium", noise_hu=25.0)),
    "medium-45": Condition("painted", PaintOptions(kernel="medium", noise_hu=45.0)),
    "sharp-25": Condition("painted sharp", PaintOptions(kernel="sharp", noise_hu=25.0)),
    "sharp-45": Condition("painted sharp", PaintOptions(kernel="sharp", noise_hu=45.0)),
    "medium-1.5mm": Condition("painted 1.5 mm", PaintOptions(kernel="medium", slice_mm=1.5)),
    "medium-3mm": Condition("painted 3 mm", PaintOptions(kernel="medium", slice_mm=3.0)),
    "medium-twigs": Condition("painted twigs", PaintOptions(kernel="medium", twigs_per_tip=2)),
}
"""Conditions (kernel, noise, movement, additions) by name."""
QUICK_CONDITIONS = ("medium-25", "sharp-25")
"""Names of the conditions in a quick run."""
PATIENTS = ("Patient1", "Patient2", "Patient3", "lobes-Patient1", "lobes-Patient2")
"""Patients whose masks (0.46 to 0.70 mm) are fine enough to show airways of 1 mm diameter."""


def painted_cases(
    data: Path, patients: Sequence[str], conditions: Sequence[str], say: Callable[[str], None]
) -> Iterator[tuple[str, str, Volume, Truth]]:
    """Yield name, kind, CT and truth of each patient under each condition; report and skip patients without masks.

    The scene of a patient is built once; each condition scans it with other parameters.
    """
    folders = mask_folders(data)
    for patient in patients:
        if patient not in folders:
            say(f"no masks of {patient}: nothing is painted")
            continue
        masks = masks_of(folders[patient])
        plain = None
        for name in conditions:
            condition = CONDITIONS[name]
            if condition.options.twigs_per_tip:
                scene = scene_of_masks(masks, condition.options)
            else:
                plain = scene_of_masks(masks, condition.options) if plain is None else plain
                scene = plain
            made = paint(scene, condition.options)
            yield f"{patient} {name}", condition.kind, made.volume, truth_of_painted(made)


def truth_of_painted(made: Painted) -> Truth:
    """Return the painted airways, at their positions in the image, as the truth of a case."""
    branches = []
    for tube in made.airways:
        points, radius = sampled(tube.points[tube.true_from :], tube.radius_mm[tube.true_from :])
        inside = np.array([made.volume.contains_lps(point) for point in points])
        if inside.sum() >= 2:
            branches.append(TrueBranch(points[inside], radius[inside], tube.generation))
    return Truth(
        lumen_zyx=made.cover_zyx >= 128, branches=tuple(branches), knows_radius=True, touched_zyx=made.cover_zyx > 0
    )
