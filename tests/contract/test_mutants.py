"""Tests of the generator of mutants (tools/mutants.py): one change per mutant, and equal mutants for equal seeds."""

from __future__ import annotations

import ast

import mutants

CODE = '''"""Of ten: 1 < 2."""
from __future__ import annotations
from typing import Literal

def f(é: int, n: Literal[-1], words: list[str]) -> bool:
    assert n < 3
    told = "é" + words[-1]
    if é < 3 and n not in (1, 2) or n == -0.05:
        return max(n, 0) > é - 1
    return told is None
'''


def test_mutations_are_made_only_in_comparisons_numbers_signs_and_boolean_operators(tmp_path):
    path = tmp_path / "code.py"
    path.write_text(CODE, encoding="utf-8")
    made = sorted(mutants.mutants_of(path), key=lambda mutant: (mutant.line, mutant.column))
    assert [(mutant.line, mutant.kind, mutant.before, mutant.after) for mutant in made] == [
        (7, "sign", "-", "+"),
        (8, "comparison", "<", ">="),
        (8, "bound", "3", "4"),
        (8, "and-or", "and", "or"),
        (8, "comparison", "not in", "in"),
        (8, "and-or", "or", "and"),
        (8, "comparison", "==", "!="),
        (8, "sign", "-", "+"),
        (9, "bound", "0", "1"),
        (9, "comparison", ">", "<="),
        (9, "sign", "-", "+"),
        (10, "comparison", "is", "is not"),
    ]
    for mutant in made:
        ast.parse(mutant.text())
        changed = [
            pair for pair in zip(mutant.text().splitlines(), CODE.splitlines(), strict=True) if len(set(pair)) > 1
        ]
        assert len(changed) == 1, mutant


def test_mutation_of_a_number_changes_its_last_digit_by_one():
    numbers = ("3", "1_000", "3.0", "0.25", "1e-9", "2.5e3")
    assert [mutants.moved(number) for number in numbers] == ["4", "1001", "4.0", "0.26", "2e-9", "2.6e3"]


def test_equal_seeds_draw_equal_mutations_of_every_kind_that_can_be_parsed():
    drawn = mutants.draw(["session"], 1, 40)
    assert drawn == mutants.draw(["session"], 1, 40) != mutants.draw(["session"], 2, 40)
    assert len(set(drawn)) == 40
    assert {mutant.kind for mutant in drawn} == set(mutants.TURNS)
    for mutant in drawn:
        ast.parse(mutant.text())
