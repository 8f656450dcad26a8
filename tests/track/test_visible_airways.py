"""Tests of the readings of airways in real CTs, and of the rule by which a listed airway counts as found."""

from __future__ import annotations

import json
from dataclasses import dataclass, field

import numpy as np
import pytest

from carina_bench import track
from carina_bench.track_visible import CTS, READINGS, SEGMENTS, Listed, found_share, listed_airways

LEVELS = {"lobar", "segment", "subsegment", "deeper"}


def line(start, end):
    return np.linspace(np.array(start, dtype=float), np.array(end, dtype=float), 41)


def listed(points):
    return Listed("RB1", "segment", np.array(points, dtype=float), 3.0, (1, 9), "A")


@dataclass
class FakeBranch:
    id: int
    points: np.ndarray
    parent: int | None = None
    children: tuple[int, ...] = ()


@dataclass
class FakeTree:
    """Tree of straight branches, with the attributes that the rule of found airways reads."""

    branches: list[FakeBranch] = field(default_factory=list)

    def tips(self):
        return [branch for branch in self.branches if not branch.children]

    def branch(self, branch_id):
        return self.branches[branch_id]


def forked(*ends):
    """Return a trunk along z to the origin, and a branch from there to each end."""
    children = tuple(range(1, len(ends) + 1))
    trunk = FakeBranch(0, line((0, 0, 40), (0, 0, 0)), None, children)
    return FakeTree([trunk, *(FakeBranch(n, line((0, 0, 0), end), 0) for n, end in enumerate(ends, start=1))])


def entries():
    for path in sorted(READINGS.glob("*.json")):
        yield path.name, json.loads(path.read_text())


@pytest.mark.parametrize("ct", CTS)
def test_airways_listed_by_readers_have_an_entry_for_each_segment_of_each_ct(ct):
    for path in READINGS.glob(f"{ct}.*.json"):
        named = " ".join(entry["airway"] for entry in json.loads(path.read_text()))
        assert [name for name in SEGMENTS if name not in named] == [], path.name


def test_each_visible_listed_airway_has_a_centreline_without_gaps_and_each_invisible_one_a_reason():
    for name, reading in entries():
        for entry in reading:
            where = name, entry["airway"]
            assert entry["level"] in LEVELS, where
            low, high = entry["slices"]
            assert low <= high, where
            if not entry["visible"]:
                assert entry["comment"], where
                continue
            points = np.array(entry["points_lps"])
            assert len(points) >= 2, where
            assert np.linalg.norm(np.diff(points, axis=0), axis=1).max() <= 10.0, where


def test_airway_listed_by_both_readers_is_in_the_combined_list_once(tmp_path):
    def entry(name, points):
        return {"airway": name, "level": "segment", "visible": True, "slices": [1, 2], "points_lps": points}

    upper, same, other = ([[0, 0, 0], [0, 0, 20]], [[1, 0, 1], [1, 0, 19]], [[9, 0, 0], [9, 0, 20]])
    (tmp_path / "CT.A.json").write_text(json.dumps([entry("RB1", upper)]))
    hidden = {"airway": "RB7", "level": "segment", "visible": False, "slices": [1, 2], "comment": "no lumen"}
    (tmp_path / "CT.B.json").write_text(json.dumps([entry("RB1x", same), entry("RB2", other), hidden]))
    union = listed_airways("CT", tmp_path)
    assert [(one.airway, one.reader) for one in union] == [("RB1", "A"), ("RB2", "B")]


def test_listed_airway_within_3_mm_of_a_found_branch_counts_as_found():
    tree = forked((20, 0, 0))
    assert found_share(listed(line((0, 2.9, 0), (20, 2.9, 0))), tree) == 1.0
    assert found_share(listed(line((0, 3.1, 0), (20, 3.1, 0))), tree) == 0.0
    half = found_share(listed(line((0, 0, 0), (40, 0, 0))), tree)
    assert half == pytest.approx(23 / 40, abs=0.02)


def test_listed_airway_along_two_branches_of_a_fork_counts_only_half_as_found():
    both = line((-20, 0, 0), (20, 0, 0))
    assert found_share(listed(both), forked((20, 0, 0), (-20, 0, 0))) == pytest.approx(23 / 40, abs=0.02)


def test_cases_of_the_visible_airways_benchmark_are_the_cts():
    assert track.PARTS["visible"].cases == CTS
