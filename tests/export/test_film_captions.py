"""Tests of the captions of a flight's video: the doubts of a branch are written beside its name."""

from __future__ import annotations

import numpy as np
import pytest

from carina.export.film_captions import FilmCaptions
from carina.navigate.recording import ReplayedPose
from carina.plan import DistanceOrigin
from carina.scopes import Pose
from carina.track import AirwayTree, Branch


def tree_with_tip(kind: str, confidence: float | None, name: str | None = "LB6") -> AirwayTree:
    trunk = Branch(0, None, (1,), 0, "Trachea", "tracked", np.array([[0.0, 0, 0], [0, 0, -30]]), np.full(2, 8.0))
    points = np.array([[0.0, 0, -30], [0, 0, -60]])
    tip = Branch(1, 0, (), 1, name, kind, points, np.full(2, 3.0), name_confidence=confidence)
    return AirwayTree((trunk, tip))


@pytest.mark.parametrize(
    ("kind", "confidence", "name", "expected"),
    [
        ("tracked", 0.9, "LB6", "LB6"),
        ("tracked", 0.6, "LB6", "LB6"),
        ("tracked", 0.59, "LB6", "LB6?"),
        ("manual", None, "LB6", "LB6, drawn by hand"),
        ("bridge", 0.5, "LB6", "LB6?, bridge"),
        ("manual", None, None, "generation 1, drawn by hand"),
    ],
)
def test_caption_states_the_doubts_of_the_branch(kind, confidence, name, expected):
    captions = FilmCaptions(tree_with_tip(kind, confidence, name), DistanceOrigin())
    pose = Pose.looking((0.0, 0.0, -58.0), (0.0, 0.0, -1.0), (0.0, -1.0, 0.0))
    (line,) = captions.lines(ReplayedPose(0.0, pose, {}), 61.0)
    assert line.split("  ")[:2] == ["1:01", expected]
