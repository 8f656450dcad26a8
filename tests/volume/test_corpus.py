"""Every input of the corpus gets the answer of the table, and the page shows that table."""

from __future__ import annotations

import numpy as np
import pytest
from corpus import PAGE, Input, all_inputs, page_with_tables

from carina.errors import VolumeImportError
from carina.volume import open_volume

INPUTS = all_inputs()


@pytest.mark.parametrize("entry", INPUTS, ids=[f"{entry.family}: {entry.name}" for entry in INPUTS])
def test_each_input_gets_the_answer_of_the_table(tmp_path, capfd, entry: Input):
    path = entry.make(tmp_path)
    if entry.expected != "opens":
        with pytest.raises(VolumeImportError) as caught:
            open_volume(path)
        assert caught.value.code == entry.expected, str(caught.value)
        assert caught.value.exit_code == 3
        words = str(caught.value)
    else:
        volume = open_volume(path)
        assert [note.code for note in volume.source.notes] == list(entry.notes), volume.source.notes
        assert volume.is_hu is entry.is_hu, volume.not_hu_reason
        words = " ".join([*volume.source.warnings, volume.not_hu_reason or ""])
        if entry.voxels is not None:
            np.testing.assert_array_equal(volume.hu_zyx, entry.voxels())
        if entry.series is not None:
            assert 1 + len(volume.source.other_series) == entry.series
    for name in entry.names:
        assert name in words
    assert capfd.readouterr().err == ""  # a decoder's own words are for us, not for the person


def test_every_refusal_tells_what_a_person_can_do():
    assert [entry.name for entry in INPUTS if entry.expected != "opens" and not entry.do] == []


def test_names_are_told_apart():
    names = [(entry.family, entry.name) for entry in INPUTS]
    assert len(names) == len(set(names))


def test_the_page_shows_the_table():
    page = PAGE.read_text(encoding="utf-8")
    assert page == page_with_tables(page), "run python tests/volume/corpus.py"
