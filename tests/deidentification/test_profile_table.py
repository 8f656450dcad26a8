"""Tests of the table of the profile against another implementation, and against rows of the standard."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

from carina.deidentification.profile_table import ACTIONS, RETAINED_BINARY, RETAINED_TEXT

CODES = {
    "D_TAGS": "D",
    "Z_TAGS": "Z",
    "X_TAGS": "X",
    "U_TAGS": "U",
    "Z_D_TAGS": "Z/D",
    "X_Z_TAGS": "X/Z",
    "X_D_TAGS": "X/D",
    "X_Z_D_TAGS": "X/Z/D",
    "X_Z_U_STAR_TAGS": "X/Z/U*",
}


def test_table_equals_that_of_the_library_dicom_anonymizer():
    # The module of the table is loaded alone, because the package needs a progress bar that Carina does not use.
    found = importlib.util.find_spec("dicomanonymizer")
    if found is None or not found.submodule_search_locations:
        pytest.skip("dicom-anonymizer is not installed (development group)")
    path = Path(found.submodule_search_locations[0], "dicom_anonymization_databases", "dicomfields_2026c.py")
    spec = importlib.util.spec_from_file_location("dicomfields_2026c", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    sys.modules.pop("dicomfields_2026c", None)
    expected = {
        group << 16 | element: code
        for name, code in CODES.items()
        for group, element, *mask in getattr(module, name)
        if not mask
    }
    assert expected == ACTIONS


@pytest.mark.parametrize(
    ("tag", "action"),
    [
        (0x00080050, "Z"), (0x00184000, "X"), (0x00400555, "X/Z"), (0x0008002A, "X/Z/D"), (0x00181400, "X/D"),
        (0x001021B0, "X"), (0x00120081, "D"), (0x00209161, "U"), (0x00700084, "Z/D"), (0x0040A730, "D"),
        (0x00080023, "Z/D"), (0x00181000, "X/Z/D"), (0x00181002, "U"), (0xFFFAFFFA, "X"), (0x300A0013, "U"),
        (0x00081140, "X/Z/U*"),
    ],
)  # fmt: skip
def test_actions_equal_rows_of_the_standard(tag, action):
    assert ACTIONS[tag] == action


def test_attributes_that_stay_are_not_in_the_table():
    assert not (RETAINED_TEXT | RETAINED_BINARY) & ACTIONS.keys()
