"""Tests of commands on unusual files: each file is read, or refused with a message, without a crash."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from contract_sweep import inputs_in, outcome_problem, problems

CASES = os.environ.get("CARINA_CASES_DIR", "")
"""Folder with the files that the case generators wrote; empty if not set."""


@pytest.mark.data
@pytest.mark.soak
def test_commands_follow_the_exit_code_contract_on_every_unusual_file(data_dir: Path) -> None:
    found = list(problems(inputs_in(data_dir / "odd")))
    assert not found, "\n".join(found)


@pytest.mark.soak
@pytest.mark.skipif(not CASES, reason="needs the folder of the generated cases in CARINA_CASES_DIR")
def test_commands_follow_the_exit_code_contract_on_every_generated_case() -> None:
    found = list(problems(inputs_in(Path(CASES), slices=False)))
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("code", "out", "err", "expected"),
    [
        (0, "{}", "wrote tree.json", None),
        (3, '{"error": {"code": "import.tags", "message": "refused"}}', "carina: refused", None),
        (1, '{"error": {"code": "carina.fault", "message": "x"}}', "carina: internal error in Carina", "exit 1"),
        (1, '{"error": {"code": "machine", "message": "x"}}', "Traceback (most recent call last)", "exit 1"),
        (1, '{"error": {"code": "import.x", "message": "x"}}', "", "exit 1 with import.x"),
        (-6, "", "", "exit -6 is not in docs/contracts.md"),
        (3, '{"error": {"code": "import.x", "message": "' + 2001 * "x" + '"}}', "", "a message of 2001 characters"),
        (0, "", "", "stdout is not one JSON object"),
        (0, "{}", "a\x1b[31mb", "a control character"),
    ],
)
def test_command_outcome_that_violates_the_contract_is_described(
    code: int, out: str, err: str, expected: str | None
) -> None:
    found = outcome_problem(code, out, err)
    assert found is None if expected is None else expected in str(found)


def test_folder_of_slices_is_listed_as_one_input_with_its_first_file(tmp_path: Path) -> None:
    for n in range(5):
        (tmp_path / f"{n}.dcm").touch()
    (tmp_path / "notes.txt").touch()
    names = [path.relative_to(tmp_path).as_posix() for path in inputs_in(tmp_path, slices=False)]
    assert names == [".", "0.dcm", "notes.txt"]
    assert len(inputs_in(tmp_path)) == 7
