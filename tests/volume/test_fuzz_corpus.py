"""Tests that every input of the fuzzing corpus opens or is refused with an error of Carina."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest
from fuzz_targets import TARGETS, once

CORPUS = Path(__file__).parent / "fuzz_corpus"


@pytest.mark.parametrize("target", TARGETS)
def test_stored_inputs_of_the_fuzzer_cause_no_unexpected_error(target, capfd):
    with zipfile.ZipFile(CORPUS / f"{target}.zip") as archive:
        names = archive.namelist()
        assert len(names) >= 10
        for name in names:
            once(target, archive.read(name))
