"""Tests of long text in a report: lines are broken, so that no page is wider than its paper."""

from __future__ import annotations

import pytest

from carina.plan.report.wording import lines_of, text_width


@pytest.mark.parametrize("text", ["x" * 10_000, "W" * 500 + " short " + "i" * 3_000, "患" * 400, "/a/very-long" * 300])
def test_word_longer_than_a_text_line_is_broken(text):
    lines = lines_of(text, 8.5, 300.0)
    assert max(text_width(line, 8.5) for line in lines) <= 300.0
    assert "".join("".join(lines).split()) == "".join(text.split())


def test_text_line_is_broken_at_spaces_where_possible():
    lines = lines_of("a right upper lobe nodule " * 20, 8.5, 200.0)
    assert set(" ".join(lines).split()) == {"a", "right", "upper", "lobe", "nodule"}
    assert max(text_width(line, 8.5) for line in lines) <= 200.0


def test_text_width_below_one_character_gives_one_character_per_line():
    assert lines_of("abc", 8.5, 0.1) == ["a", "b", "c"]
