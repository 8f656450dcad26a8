"""Corpus of generated input files, each with the answer that the importer must give.

``test_corpus.py`` and the page ``docs/import-answers.md`` use this table. ``corpus_dicom.py`` and ``corpus_grids.py``
contain the entries; no entry contains data of a patient.

``python tests/volume/corpus.py`` rewrites the tables of the page.
"""

from __future__ import annotations

import importlib
import re
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

__all__ = ["PAGE", "Input", "all_inputs", "page_with_tables", "repeated_advice", "tables"]

PAGE = Path(__file__).resolve().parents[2] / "docs" / "import-answers.md"
_SOURCES = ("corpus_dicom", "corpus_grids")


@dataclass(frozen=True)
class Input:
    """One input file or folder: how it is made, and the answer that the importer must give."""

    name: str
    """Description of the input in plain words: a cell of the page."""
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
    """Remedy that the page shows; empty if the input needs none."""
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
    words = "opens" if entry.is_hu else "opens, not HU"
    if entry.series is not None:
        words += f", {entry.series} series"
    return words + (f"; notes {', '.join(f'`{code}`' for code in entry.notes)}" if entry.notes else "")


def repeated_advice() -> dict[str, str]:
    """Return each remedy of two or more inputs with its number on the page, the most frequent first."""
    counted = Counter(entry.do for entry in all_inputs() if entry.do)
    repeated = [advice for advice, count in counted.most_common() if count > 1]
    return {advice: f"A{number}" for number, advice in enumerate(repeated, 1)}


def tables() -> str:
    """Return the list of remedies and the tables of inputs, with a heading for each family."""
    inputs, numbers = all_inputs(), repeated_advice()
    lines = ["## What to do", "", "Several inputs need the same remedy. The tables name these remedies by number.", ""]
    lines += ["| number | what to do |", "|---|---|"]
    lines += [f"| {number} | {advice} |" for advice, number in numbers.items()]
    for family in dict.fromkeys(entry.family for entry in inputs):
        lines += ["", f"## {family}", "", "| input | answer | what to do |", "|---|---|---|"]
        lines += [
            f"| {e.name} | {_answer(e)} | {numbers.get(e.do, e.do) or '-'} |" for e in inputs if e.family == family
        ]
    return "\n".join(lines)


_BEGIN, _END = "<!-- tables: begin -->", "<!-- tables: end -->"


def page_with_tables(page: str) -> str:
    """Return the page with its tables replaced by the generated ones."""
    return re.sub(f"{_BEGIN}.*{_END}", lambda _: f"{_BEGIN}\n\n{tables()}\n\n{_END}", page, flags=re.DOTALL)


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parent))
    PAGE.write_text(page_with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
