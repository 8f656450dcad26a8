"""Tests of the check of decisions: headings, length, file name, and the list of all decisions."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from check_repository import decision_problems

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "docs" / "decisions").glob("[0-9]*.md"))
CORRECT = """# 0999: Store scans in one file

2026-11

## Context

A scan has many slices.

## Decision

One file.

## Reasons

- Simple.

## Alternatives

- *Many files*: slow.

## What would change this

Larger scans.
"""


def test_check_accepts_a_page_with_five_headings() -> None:
    assert decision_problems("0999-store-scans-in-one-file.md", CORRECT) == []


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (CORRECT.replace("## Reasons\n", ""), "the headings are"),
        (CORRECT.replace("## Reasons", "## Measured"), "the headings are"),
        (CORRECT + "\n## Measured\n", "the headings are"),
        (CORRECT + "word " * 600, "words, at most 600"),
        (
            CORRECT.replace("one file", "two files", 1),
            "the file name of this title is 0999-store-scans-in-two-files.md",
        ),
        (CORRECT.removeprefix("# 0999: "), "the first line is not"),
    ],
)
def test_check_rejects_a_page_that_breaks_a_rule(text: str, problem: str) -> None:
    found = decision_problems("0999-store-scans-in-one-file.md", text)
    assert len(found) == 1
    assert problem in found[0]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name[:4])
def test_decision_has_five_headings_and_fits_on_a_page(page: Path) -> None:
    assert decision_problems(page.name, page.read_text(encoding="utf-8")) == []


def test_index_lists_every_decision_once_with_its_title() -> None:
    listed = re.findall(
        r"^- \[(\d{4})\]\((.+?)\) (.+)$", (ROOT / "docs/decisions/index.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    titles = [
        (page.name[:4], page.name, page.read_text(encoding="utf-8").partition("\n")[0].partition(": ")[2])
        for page in PAGES
    ]
    assert sorted(listed) == titles


@pytest.mark.parametrize("page", [*PAGES, ROOT / "docs" / "decisions" / "index.md"], ids=lambda page: page.name[:4])
def test_links_of_a_decision_lead_to_a_file(page: Path) -> None:
    links = re.findall(r"\]\(([^)#:]+)\)", page.read_text(encoding="utf-8"))
    assert [link for link in links if not (page.parent / link).is_file()] == []
