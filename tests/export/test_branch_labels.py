"""Tests of the labels of branches in saved pictures and videos: drawn branches and uncertain names are marked."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from carina.display.dot_letters import GLYPHS
from carina.export.film_captions import FilmCaptions
from carina.session.scene.branch_names import path_spans
from carina.track import AirwayTree, Branch
from carina.track.tree.branch_labels import UNCERTAIN_NAME, branch_label

POINTS = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -10.0], [0.0, 0.0, -20.0]])
BRANCH = Branch(1, None, (), 0, "RB9", "tracked", POINTS, np.full(3, 4.0), name_confidence=0.9, name_from="anatomy")


@pytest.mark.parametrize(
    ("changed", "label"),
    [
        ({}, "RB9"),
        ({"name_confidence": UNCERTAIN_NAME}, "RB9"),
        ({"name_confidence": UNCERTAIN_NAME - 0.01}, "RB9?"),
        ({"name_confidence": None, "name_from": "person"}, "RB9"),
        ({"kind": "manual"}, "RB9, drawn by hand"),
        ({"kind": "bridge", "name_confidence": 0.1}, "RB9?, bridge"),
        ({"name": None, "name_confidence": None, "name_from": None, "generation": 0}, "generation 0"),
    ],
)
def test_label_states_an_uncertain_name_and_a_branch_that_the_ct_does_not_show(changed, label):
    assert branch_label(dataclasses.replace(BRANCH, **changed)) == label
    assert set(label) <= set(GLYPHS)


def test_limit_of_an_uncertain_name_is_that_of_the_list_in_the_window():
    text = (Path(__file__).parents[2] / "web/src/state/branch-text.ts").read_text()
    assert float(re.search(r"DOUBTFUL = \{ name: ([\d.]+)", text).group(1)) == UNCERTAIN_NAME


def test_captions_and_views_along_a_path_show_the_label():
    branch = dataclasses.replace(BRANCH, name_confidence=0.3)
    tree = AirwayTree([branch])
    origin = SimpleNamespace(past_mm=lambda mm: mm, words=lambda mm: f"{mm:.0f} mm")
    frame = SimpleNamespace(pose=SimpleNamespace(position_lps=(0.0, 0.0, -10.0)), view={})
    assert FilmCaptions(tree, origin).lines(frame, 61.0) == ("1:01  RB9?  10 mm",)
    span = SimpleNamespace(branch_id=1, name="RB9", generation=0, from_mm=0.0, to_mm=20.0, kind="tracked")
    (named,) = path_spans(SimpleNamespace(spans=(span,)), SimpleNamespace(tree=tree))
    assert (named.name, named.drawn) == ("RB9?", False)
    # A name of an earlier tree stays without a mark.
    (earlier,) = path_spans(SimpleNamespace(spans=(span,)), None)
    assert earlier.name == "RB9"
