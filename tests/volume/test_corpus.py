"""Tests of the importer's answer to every input of the corpus, and of the page that lists the inputs."""

from __future__ import annotations

import numpy as np
import pytest
from corpus import PAGE, Input, all_inputs, page_with_tables

from carina.errors import VolumeImportError
from carina.volume import open_volume

INPUTS = all_inputs()


@pytest.mark.parametrize("entry", INPUTS, ids=[f"{entry.family}: {entry.name}" for entry in INPUTS])
def test_each_input_of_the_import_corpus_opens_or_is_refused_as_expected(tmp_path, capfd, entry: Input):
    path = entry.make(tmp_path)
    if entry.expected != "opens":
        with pytest.raises(VolumeImportError) as caught:
            open_volume(path)
        assert caught.value.code == entry.expected, str(caught.value)
        assert caught.value.exit_code == 3
        text = str(caught.value)
    else:
        volume = open_volume(path)
        assert [note.code for note in volume.source.notes] == list(entry.notes), volume.source.notes
        assert volume.is_hu is entry.is_hu, volume.not_hu_reason
        text = " ".join([*volume.source.warnings, volume.not_hu_reason or ""])
        if entry.voxels is not None:
            np.testing.assert_array_equal(volume.hu_zyx, entry.voxels())
        if entry.series is not None:
            assert 1 + len(volume.source.other_series) == entry.series
    for name in entry.names:
        assert name in text
    assert capfd.readouterr().err == ""  # messages of a decoder must not reach the user's terminal


def test_every_refused_input_of_the_import_corpus_has_a_remedy():
    assert [entry.name for entry in INPUTS if entry.expected != "opens" and not entry.do] == []


def test_names_of_import_corpus_inputs_are_unique():
    names = [(entry.family, entry.name) for entry in INPUTS]
    assert len(names) == len(set(names))


def test_documentation_page_contains_the_generated_import_tables():
    page = PAGE.read_text(encoding="utf-8")
    assert page == page_with_tables(page), "run python tests/volume/corpus.py"
