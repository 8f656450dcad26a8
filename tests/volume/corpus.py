"""Corpus of generated input files, each with the answer that the importer must give.

``test_corpus.py`` and the page ``docs/import-answers.md`` use this table. The files ``corpus_*.py``
contain the entries; no entry contains data of a patient.

``python tests/volume/corpus.py`` rewrites the tables of the page.
"""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

__all__ = ["PAGE", "Input", "all_inputs", "numbered_remedies", "page_with_tables", "sentences", "tables"]

PAGE = Path(__file__).resolve().parents[2] / "docs" / "import-answers.md"
_SOURCES = ("corpus_dicom", "corpus_enhanced", "corpus_archives", "corpus_grids")


@dataclass(frozen=True)
class Input:
    """One input file or folder: how it is made, and the answer that the importer must give."""

    name: str
    """Description of the input: a cell of the page."""
    family: str
    """Heading of the page ``docs/import-answers.md`` under which the input is listed."""
    make: Callable[[Path], Path]
    """Function that writes the input into an empty folder and returns the path to open."""
    expected: str
    """Error code with which the input must be refused, or ``opens``."""
    notes: tuple[str, ...] = ()
    """Codes of all notes that the importer must give; any other note fails the test."""
    is_hu: bool = True
    do: str = ""
    """Remedy that the page shows, in sentences; empty if the input needs none."""
    voxels: Callable[[], np.ndarray] | None = None
    """Function that returns the exact HU values [z, y, x] of an input that opens."""
    series: int | None = None
    """Number of series that ``carina info`` lists, for inputs that test the listing."""
    names: tuple[str, ...] = ()
    """Words that the message of the refusal or the notes must contain, such as names of files."""


def all_inputs() -> tuple[Input, ...]:
    """Return every input, by source module and in the order of its list."""
    found: list[Input] = []
    for source in _SOURCES:
        if (Path(__file__).parent / f"{source}.py").exists():
            found.extend(importlib.import_module(source).INPUTS)
    return tuple(found)


def _answer(entry: Input) -> str:
    if entry.expected != "opens":
        return f"refused, `{entry.expected}`"
    text = "opens" if entry.is_hu else "opens, not in HU"
    if entry.series is not None:
        text += f", {entry.series} series"
    return text + (f"; notes {', '.join(f'`{code}`' for code in entry.notes)}" if entry.notes else "")


REMEDIES = (
    "To open another series, use `--series`.",
    "Choose another series.",
    "Check that this is the right scan.",
    "Check that the file contains the whole scan.",
    "Copy the file again.",
    "Copy the series again.",
    "Copy the missing slices.",
    "Export the file again.",
    "Export the file again with its spacing in mm.",
    "Export the series again.",
    "Export the series again without compression.",
    "Export the series again from its original archive.",
    "Export the series again with a rescale and without a Modality LUT.",
    "Export the series with one file for each slice (classic CT images).",
    "Open the DICOM series from which the file was made, or convert that series again.",
    "Open the folder of the scan.",
    "Save the file again with only one of the two positions.",
    "Save the scan again, with both files in one folder.",
    "Save the scan again with its position before you import masks or targets.",
    "Save each volume as a separate file.",
    "Resample the file to a rectangular grid first.",
    "Decompress the file and open the result.",
    "Correct the header, or export the file again.",
    "Check left and right by the heart and the liver, or open the DICOM series.",
    "Check the edge of the slices.",
    "Check these voxels before you trust a measure near them.",
    "Compare a known tissue with its HU.",
)
"""Remedies that the page uses more than once; the page states each in full once, with a number."""


def numbered_remedies() -> dict[str, str]:
    """Return each remedy that the page uses more than once, with its number on the page."""
    return {remedy: f"A{number}" for number, remedy in enumerate(REMEDIES, 1)}


def sentences(advice: str) -> list[str]:
    """Return the sentences of a remedy."""
    return re.split(r"(?<=\.) (?=[A-Z])", advice) if advice else []


def _advice(entry: Input) -> str:
    """Return the cell of an input's remedies: numbers, then remedies that only this input needs."""
    numbers = numbered_remedies()
    found = [numbers[one] for one in sentences(entry.do) if one in numbers]
    single = [one for one in sentences(entry.do) if one not in numbers]
    return ". ".join([", ".join(found)] * bool(found) + [" ".join(single)] * bool(single)) or "-"


def tables() -> str:
    """Return the list of remedies and the tables of inputs, with a heading for each family."""
    inputs = all_inputs()
    lines = [
        "## What to do",
        "",
        "Several inputs need the same remedy. The tables state the numbers of these remedies.",
        "",
    ]
    lines += ["| number | what to do |", "|---|---|"]
    lines += [f"| {number} | {remedy} |" for remedy, number in numbered_remedies().items()]
    for family in dict.fromkeys(entry.family for entry in inputs):
        lines += ["", f"## {family}", "", "| input | answer | what to do |", "|---|---|---|"]
        lines += [f"| {one.name} | {_answer(one)} | {_advice(one)} |" for one in inputs if one.family == family]
    return "\n".join(lines)


_BEGIN, _END = "<!-- tables: begin -->", "<!-- tables: end -->"


def page_with_tables(page: str) -> str:
    """Return the page with its tables replaced by the generated ones."""
    return re.sub(f"{_BEGIN}.*{_END}", lambda _: f"{_BEGIN}\n\n{tables()}\n\n{_END}", page, flags=re.DOTALL)


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parent))
    PAGE.write_text(page_with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
