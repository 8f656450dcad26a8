"""Tests that odd but honest inputs open with the right voxels and positions.

The voxels are compared with those from which an input was made. Voxels and positions are also compared with those of
other readers (``other_readers.py``). ``OTHERWISE_READ`` names every reader that does not read an input in the same way.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from corpus import Input
from other_readers import DICOM_ONLY, NO_READER, READERS, compared, missing_program
from unusual_valid_inputs import KINDS, OTHERWISE_READ, REPORTED

from carina.volume import open_volume

NAMED_READERS = {"pydicom", "SimpleITK", "nibabel", "dcm2niix"}
AGREEING: dict[tuple[str, str], set[str]] = {}
"""Readers that found the voxels of an input, filled by the test of each input."""


@pytest.mark.parametrize("entry", KINDS, ids=[f"{entry.family}: {entry.name}" for entry in KINDS])
def test_honest_input_opens_with_the_right_voxels_and_positions(tmp_path, entry: Input):
    folder = tmp_path / "input"
    folder.mkdir()
    path = entry.make(folder)
    volume = open_volume(path)
    assert volume.is_hu
    assert [note.code for note in volume.source.notes] == list(entry.notes)
    np.testing.assert_array_equal(volume.hu_zyx, entry.voxels())
    same = AGREEING[entry.family, entry.name] = set()
    for reader in READERS:
        if missing_program(reader) is None:
            found = compared(reader, path, volume, tmp_path / reader)
            expected = OTHERWISE_READ.get(reader, {}).get(entry.name, ("same", ""))[0]
            assert found in (*expected.split(" or "), DICOM_ONLY, NO_READER), reader
            if found == "same":
                same.add(reader)


def test_table_has_enough_kinds():
    families = Counter(entry.family for entry in KINDS)
    assert len(KINDS) >= 48
    assert len({(entry.family, entry.name) for entry in KINDS}) == len(KINDS)
    assert len(families) >= 10
    assert sum(bool(report) for _, _, report in REPORTED.values()) >= 12


def test_enough_kinds_are_confirmed_by_two_other_readers():
    if len(AGREEING) < len(KINDS):
        pytest.skip("only a part of the inputs was tested")
    confirmed = sum(len(found & NAMED_READERS) >= 2 for found in AGREEING.values())
    # Without dcm2niix, which few machines have, pydicom and SimpleITK confirm nearly as many.
    assert confirmed >= 110
    alone = [kind for kind, found in AGREEING.items() if not found]
    assert missing_program("VTK") is not None or len(alone) <= 4, alone


def test_every_exception_of_a_reader_names_an_input_and_a_reason():
    names = {entry.name for entry in KINDS}
    for reader, exceptions in OTHERWISE_READ.items():
        assert reader in READERS
        for name, (answer, reason) in exceptions.items():
            assert name in names
            assert answer != "same"
            assert reason
