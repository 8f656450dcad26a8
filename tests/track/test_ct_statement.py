"""Tests of the statement on a CT: all properties, the same words as the findings, and the cricoid."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from cached_test_data import cached_phantom
from carina.track import assess_ct, find_airways
from carina.volume import Note, Volume

NAMES = ["kernel", "noise", "slices", "coverage", "motion", "inspiration", "contrast", "tube", "metal", "patient size"]


@pytest.fixture(scope="module")
def small():
    return cached_phantom(spacing_mm=2.5, generations=3, noise_hu=0).volume


@pytest.fixture(scope="module")
def airways(small):
    return find_airways(small, progress=False)


def words_of(volume, airways=None):
    return {one.name: one.words for one in assess_ct(volume, airways).statement}


def test_statement_has_every_property_and_ends_with_the_trusted_generation(small):
    found = assess_ct(small)
    assert [one.name for one in found.statement] == NAMES
    assert (
        found.lines[-1] == f"airways can be trusted to about generation {found.trusted_generation} (the trachea is 0)"
    )
    assert [one.name for one in found.statement if one.limits] == ["slices", "coverage"]
    for finding in found.findings:
        assert any(finding.words in one.words for one in found.statement if one.limits), finding
        assert finding.words in found.summary
    assert found.to_json()["statement"][0]["name"] == "kernel"


def test_tube_and_cricoid_are_judged_after_the_airways_are_found(small, airways):
    before, after = words_of(small), words_of(small, airways)
    assert before["tube"] == "judged after the airways are found"
    assert before["coverage"].startswith("cricoid judged after the airways are found")
    assert after["tube"] == "none in the trachea"
    assert "above the carina, " in after["coverage"]


def test_ct_that_begins_low_in_the_trachea_begins_below_the_cricoid(small, airways):
    """The same tree in a CT that ends 50 mm above the carina."""
    last = int(np.floor(small.to_ijk(np.array([0.0, 0.0, 50.0]))[2]))
    cut = Volume(np.ascontiguousarray(small.hu_zyx[: last + 1]), small.lps_from_ijk)
    root = airways.tree.root
    inside = small.to_ijk(root.points)[:, 2] <= last
    branch = dataclasses.replace(root, points=root.points[inside], radius=root.radius[inside])
    tree = dataclasses.replace(airways.tree, branches=(branch, *airways.tree.branches[1:]))
    assert (
        "mm above the carina, below the cricoid" in words_of(cut, dataclasses.replace(airways, tree=tree))["coverage"]
    )


@pytest.mark.parametrize(
    ("code", "name", "text"),
    [("track.larynx", "coverage", "the cricoid is in the CT"), ("track.tube", "tube", "a tube is in the trachea")],
)
def test_notes_of_the_search_are_part_of_the_statement(small, airways, code, name, text):
    tree = dataclasses.replace(airways.tree, notes=(Note(code, "a note of the search", badge=True),))
    assert text in words_of(small, dataclasses.replace(airways, tree=tree))[name]


def test_assessment_without_airways_is_cached_with_the_volume(small):
    assert assess_ct(small) is assess_ct(small)
