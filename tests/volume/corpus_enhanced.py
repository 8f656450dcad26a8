"""Enhanced (multi-frame) DICOM files of the corpus."""
# ruff: noqa: E501 (a table: one input a line)

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path

from corpus import Input
from dicom_writer import chest
from enhanced_writer import Frame, chest_frames, enhanced

__all__ = ["INPUTS"]

FAMILY = "DICOM: enhanced multi-frame files"
CHOOSE = "To open another series, use `--series`."
WHOLE = {"expected": "opens", "voxels": chest}


def _file(frames: Callable[[], list[Frame]]) -> Callable[[Path], Path]:
    return lambda folder: enhanced(folder / "IM1", frames())


def _shuffled() -> list[Frame]:
    frames = chest_frames()
    random.Random(1).shuffle(frames)
    return frames


def _own_rescale() -> list[Frame]:
    return chest_frames(slope=lambda index: (0.5, 1.0, 0.25)[index % 3], intercept=lambda index: -1200.0 + 7 * index)


def _phases() -> list[Frame]:
    return chest_frames(content={"TemporalPositionIndex": 1}) + chest_frames(
        chest(seed=6), content={"TemporalPositionIndex": 2}
    )


def _files(folder: Path) -> Path:
    frames = _shuffled()
    for number, begin in enumerate(range(0, 20, 5)):
        enhanced(folder / f"part{number}", frames[begin : begin + 5])
    return folder


def _two_phases_in_two_files(folder: Path) -> Path:
    enhanced(folder / "a", chest_frames())
    enhanced(folder / "b", chest_frames(chest(seed=6)))
    return folder


def _twice() -> list[Frame]:
    frames = chest_frames()
    frames[7].z_mm = frames[6].z_mm
    return frames


INPUTS = [
    Input("one file, frames in any order", FAMILY, _file(_shuffled), **WHOLE),
    Input("a different slope and intercept in every frame", FAMILY, _file(_own_rescale), **WHOLE),
    Input("a series of four files with five frames each", FAMILY, _files, **WHOLE),
    Input("two phases in one file", FAMILY, _file(_phases), "opens", ("import.several-series", "import.series-parted"), voxels=chest, series=2, do=CHOOSE),
    Input("two files at the same positions", FAMILY, _two_phases_in_two_files, "opens", ("import.several-series", "import.series-parted"), voxels=chest, series=2, do=CHOOSE),
    Input("two frames at one position that do not differ in any tag", FAMILY, _file(_twice), "import.geometry.duplicate", names=("frame 7", "frame 8"), do="Export the series again."),
]  # fmt: skip
