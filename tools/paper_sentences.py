"""Check that every sentence of the paper has a row, or a mark *no claim*, in ``docs/paper-map.md``.

The text of the paper is not part of this repository. The script reads the text from a file, numbers the sentences of
each section, and compares the numbers with those in the tables of the document:

    python tools/paper_sentences.py PAPER.txt            # lists what is missing; exit code 1 if anything is missing
    python tools/paper_sentences.py PAPER.txt --list 4.2 # prints the numbers and first six words of a section

A sentence is written as ``4.2:3`` (section 4.2, sentence 3), several as ``4.2:3-5,7``. Captions of figures and tables
are sentences; equations, the content of tables, algorithms and pictures are not.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
MAP = ROOT / "docs" / "paper-map.md"
MAX_WORDS = 6
"""Number of words of a sentence that a message shows, so that no text of the paper is copied."""
_SECTION = re.compile(r"^(\d(?:\.\d)?)\.? +(?:3D )?[A-Z]")
_END = re.compile(r"(?<=[.!?:])(?:\*\*)? +(?=[A-Z\"“*-])")
_NO_END = re.compile(r"(?:\b(?:et al|Fig|vs|e\.g|i\.e)\.|\b[A-Z]\.)\*?$|^Figure \d+(?:\([a-c]\))?:$")
_REFERENCE = re.compile(r"(abstract|\d(?:\.\d)?):(\d+(?:-\d+)?(?:, ?\d+(?:-\d+)?(?!\.?\d*:))*)")


@dataclass(frozen=True, slots=True)
class Sentence:
    """A sentence of the paper with its number in its section."""

    section: str
    number: int
    text: str

    @property
    def name(self) -> str:
        """Section and number, as in the document."""
        return f"{self.section}:{self.number}"

    @property
    def start(self) -> str:
        """First words, at most :data:`MAX_WORDS`."""
        return " ".join(self.text.split()[:MAX_WORDS])


@dataclass(frozen=True, slots=True)
class Row:
    """A row of a table of the document."""

    line: int
    title: str
    sentences: tuple[tuple[str, int], ...]
    names_sentences: bool
    evidence: str | None
    """Content of the column for tests and commands; None in the table of sentences without a claim."""


def split_sentences(text: str) -> list[Sentence]:
    """Return the sentences of the paper's text, numbered in each section."""
    section, found = "abstract", []
    numbers: dict[str, int] = {}
    fenced = in_formula = continues = False
    for raw in text.splitlines():
        line = raw.strip()
        if line.startswith("```"):
            fenced = not fenced
            continue
        if line.startswith("$$"):
            in_formula = not (line.endswith("$$") and len(line) > 2) and not in_formula
            continues = False
            continue
        if fenced or not line or "\t" in line:
            continue
        if in_formula:
            in_formula = not line.endswith("$$")
            continue
        heading = _SECTION.match(line)
        if heading and len(line) < 80 and not line.endswith("."):
            section = heading.group(1)
            continue
        parts = _split_line(line)
        if continues and line[0].islower():
            # A page break divides this sentence.
            last = found.pop()
            found.append(Sentence(last.section, last.number, f"{last.text} {parts.pop(0)}"))
        continues = line[-1] not in ".!?:"
        for sentence in parts:
            # Headings, labels of pictures and single words are not sentences.
            short = len(re.findall(r"[A-Za-z]{2,}", sentence)) < 4
            if short and not sentence.endswith(".") and not sentence.startswith(("- ", "Figure", "Table")):
                continues = False
                continue
            numbers[section] = numbers.get(section, 0) + 1
            found.append(Sentence(section, numbers[section], sentence))
    return found


def _split_line(line: str) -> list[str]:
    parts: list[str] = []
    for part in _END.split(line):
        if parts and _NO_END.search(parts[-1]):
            parts[-1] += " " + part
        elif part.strip():
            parts.append(part.strip())
    return parts


def read_references(text: str) -> tuple[tuple[str, int], ...]:
    """Return the sentences that a cell names: ``4.2:3-5,7`` are four sentences of section 4.2."""
    found = []
    for section, numbers in _REFERENCE.findall(text):
        for part in numbers.split(","):
            first, _, last = part.strip().partition("-")
            found += [(section, number) for number in range(int(first), int(last or first) + 1)]
    return tuple(found)


def read_rows(document: str) -> list[Row]:
    """Return the rows of the document's tables; the names of the columns state what a table contains."""
    rows: list[Row] = []
    columns: list[str] = []
    for number, line in enumerate(document.splitlines(), start=1):
        if not line.startswith("|"):
            columns = []
            continue
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if line.startswith("|---"):
            continue
        if not columns:
            columns = cells
            continue
        row = dict(zip(columns, cells, strict=False))
        evidence = None if "reason" in row else row.get("shown by", row.get("test", ""))
        references = read_references(row.get("sentences", ""))
        rows.append(Row(number, cells[0], references, "sentences" in row, evidence))
    return rows


def find_faults(sentences: Iterable[Sentence], rows: Iterable[Row]) -> list[str]:
    """Return a message for each sentence without a row, and for each row with an unknown sentence or without a test."""
    known = {(sentence.section, sentence.number): sentence for sentence in sentences}
    rows = list(rows)
    named = [reference for row in rows for reference in row.sentences]
    faults = [
        f"{sentence.name} ({sentence.start} ...): has no row and no mark *no claim*"
        for reference, sentence in known.items()
        if reference not in named
    ]
    faults += [
        f"{section}:{number}: is in {named.count((section, number))} rows"
        for section, number in sorted(set(named))
        if named.count((section, number)) > 1
    ]
    for row in rows:
        title = f"line {row.line} ({' '.join(row.title.split()[:MAX_WORDS])})"
        faults += [
            f"{title}: names {section}:{number}, which the paper does not have"
            for section, number in row.sentences
            if (section, number) not in known
        ]
        if row.names_sentences and not row.sentences:
            faults.append(f"{title}: names no sentence")
        faults += [f"{title}: {fault}" for fault in find_evidence_faults(row.evidence)]
    return faults


def find_evidence_faults(evidence: str | None) -> list[str]:
    """Return a message if a cell names no test and no command, and one for each path that does not exist."""
    if evidence is None or "no claim" in evidence:
        return []
    names = re.findall(r"`([^`]+)`", evidence)
    if not names:
        return ["has no test and no command"]
    return [
        f"names {name}, which does not exist"
        for cell in names
        for name in _expand_braces(cell)
        if "/" in name and " " not in name and "*" not in name and not (ROOT / name).exists()
    ]


def _expand_braces(name: str) -> list[str]:
    """Return the paths that a name with braces stands for: ``a/{b,c}.rs`` are two paths."""
    found = re.fullmatch(r"(.*)\{(.*)\}(.*)", name)
    return [name] if found is None else [f"{found[1]}{middle}{found[3]}" for middle in found[2].split(",")]


def main(arguments: list[str] | None = None) -> int:
    """Print the faults of the rows of the paper map, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("paper", type=Path, help="text of the paper")
    parser.add_argument("--list", metavar="SECTION", help="print the sentences of a section (all: every section)")
    options = parser.parse_args(arguments)
    if not options.paper.is_file():
        print(f"skipped: there is no text of the paper at {options.paper}; the repository does not contain it")
        return 0
    sentences = split_sentences(options.paper.read_text(encoding="utf-8"))
    if options.list:
        for sentence in sentences:
            if options.list in ("all", sentence.section):
                print(f"{sentence.name:<12} {sentence.start}")
        return 0
    document = MAP.read_text(encoding="utf-8")
    faults = find_faults(sentences, read_rows(document))
    print("\n".join(faults))
    print(f"{len(sentences)} sentences, {len(faults)} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
