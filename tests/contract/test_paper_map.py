"""Tests of the document that maps the paper to tests, and of the script that numbers the paper's sentences.

The text of the paper is not in the repository: the complete check reads the file that ``CARINA_PAPER`` names.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def tool():
    """Return the script as a module."""
    spec = importlib.util.spec_from_file_location("paper_sentences", ROOT / "tools" / "paper_sentences.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["paper_sentences"] = module
    spec.loader.exec_module(module)
    return module


TEXT = """
ABSTRACT

One sentence of Ney et al. about lungs. Another sentence follows here:

1. First Section

- Short item
It is especially advantageous

when a page break divides it. The end.

$$a = b$$

where a is the first value

1.1 3D PARTS

Figure 2 A caption without a full stop
Table\tof\tnumbers
"""


def test_sentences_are_numbered_in_each_section_without_formulas_and_tables(tool):
    found = {sentence.name: sentence.text for sentence in tool.split_sentences(TEXT)}
    assert found == {
        "abstract:1": "One sentence of Ney et al. about lungs.",
        "abstract:2": "Another sentence follows here:",
        "1:1": "- Short item",
        "1:2": "It is especially advantageous when a page break divides it.",
        "1:3": "The end.",
        "1:4": "where a is the first value",
        "1.1:1": "Figure 2 A caption without a full stop",
    }


def test_references_name_single_sentences_and_ranges(tool):
    assert tool.read_references("abstract:2; 4.2:3-5,7") == (
        ("abstract", 2), ("4.2", 3), ("4.2", 4), ("4.2", 5), ("4.2", 7)
    )  # fmt: skip


DOCUMENT = """
| paper | content | module | test |
|---|---|---|---|
| 1 | purpose | `carina` | `tests/e2e` |
| 2 | goals | `carina` | |

| sentences | claim, in our words | shown by |
|---|---|---|
| abstract:1-2; 1:1 | a claim | `carina bench render` |
| 1:2,9 | another claim | by hand |
| 1:1 | the same again | `tests/missing/test_nothing.py` |

| sentences | reason |
|---|---|
| 1:3-4 | describes something |
"""


def test_missing_sentences_unknown_sentences_and_rows_without_a_test_are_reported(tool):
    faults = tool.find_faults(tool.split_sentences(TEXT), tool.read_rows(DOCUMENT))
    assert faults == [
        "1.1:1 (Figure 2 A caption without a ...): has no row and no mark *no claim*",
        "1:1: is in 2 rows",
        "line 5 (2): has no test and no command",
        "line 10 (1:2,9): names 1:9, which the paper does not have",
        "line 10 (1:2,9): has no test and no command",
        "line 11 (1:1): names tests/missing/test_nothing.py, which does not exist",
    ]


def test_every_row_of_the_paper_map_names_a_test_or_a_command(tool):
    rows = tool.read_rows(tool.MAP.read_text(encoding="utf-8"))
    assert sum(len(row.sentences) for row in rows) == 310
    assert [(row.line, fault) for row in rows for fault in tool.find_evidence_faults(row.evidence)] == []


def test_every_sentence_of_the_paper_has_a_row(tool, capsys):
    paper = os.environ.get("CARINA_PAPER")
    if not paper:
        pytest.skip("the repository does not contain the text of the paper; name its file in CARINA_PAPER")
    assert tool.main([paper]) == 0, capsys.readouterr().out


def test_script_skips_without_the_text_of_the_paper(tool, tmp_path, capsys):
    assert tool.main([str(tmp_path / "paper.txt")]) == 0
    assert "skipped: there is no text of the paper" in capsys.readouterr().out
