"""Tests of the airway wall of a recording: reconstruction from the stored search settings and edits, or a refusal."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from carina import track
from carina.errors import NoResultError, UsageError, VolumeImportError
from carina.session.flights.film_flights import wall_builder
from carina.track import CutBranch, edits_to_json


@pytest.fixture
def searches(monkeypatch):
    """Replace search, edits and wall by texts that list their inputs, and return the calls of the search."""
    seen = []

    def find(volume, *, root_lps=None, lumen_threshold=None, progress):
        seen.append((root_lps, lumen_threshold))
        return f"found {root_lps} {lumen_threshold}"

    monkeypatch.setattr(track, "find_airways", find)
    monkeypatch.setattr(track, "edit_airways", lambda volume, airways, edit, *, progress: f"{airways}, {edit}")
    monkeypatch.setattr(
        track, "wall_field", lambda volume, airways, *, progress: SimpleNamespace(digest=lambda: airways, of=airways)
    )
    return seen


def test_replay_uses_the_wall_of_airways_found_with_the_stored_settings_and_edits(searches):
    edit = CutBranch(3)
    stored = {"digest": f"found [1.0, 2.0, 3.0] -800.0, {edit}", "root_lps": [1.0, 2.0, 3.0], "lumen_threshold": -800.0}
    stored["edits"] = edits_to_json([edit])
    wall = wall_builder(None, None)
    assert wall(stored).of == stored["digest"]
    assert searches == [(None, None), (None, -800.0), ([1.0, 2.0, 3.0], -800.0)]
    # The wall is computed only once for the same recording.
    assert wall(stored) is wall(stored)
    assert len(searches) == 3


def test_failed_automatic_search_does_not_prevent_a_search_from_the_recorded_root(searches, monkeypatch):
    find = track.find_airways

    def by_root_alone(volume, *, root_lps=None, lumen_threshold=None, progress):
        found = find(volume, root_lps=root_lps, lumen_threshold=lumen_threshold, progress=progress)
        if root_lps is None and lumen_threshold is None:
            raise NoResultError("no trachea was found")
        return found

    def no_such_branch(volume, airways, edit, *, progress):
        if "None" in airways:
            raise UsageError("the tree has no branch 3")
        return f"{airways}, {edit}"

    monkeypatch.setattr(track, "find_airways", by_root_alone)
    monkeypatch.setattr(track, "edit_airways", no_such_branch)
    edit = CutBranch(3)
    stored = {"digest": f"found [1.0, 2.0, 3.0] -800.0, {edit}", "root_lps": [1.0, 2.0, 3.0], "lumen_threshold": -800.0}
    stored["edits"] = edits_to_json([edit])
    assert wall_builder(None, None)(stored).of == stored["digest"]
    with pytest.raises(VolumeImportError, match="the airways that guided the scope in this recording differ"):
        wall_builder(None, None)({**stored, "root_lps": None})
    with pytest.raises(NoResultError, match="no trachea"):
        wall_builder(None, None)({})


def test_recording_whose_airways_differ_from_the_found_ones_is_refused_with_a_message(searches):
    with pytest.raises(
        VolumeImportError, match=("the airways that guided the scope in this recording differ")
    ) as refused:
        wall_builder(None, None)({"digest": "a mask", "root_lps": [0.0, 0.0, 0.0], "lumen_threshold": None})
    assert refused.value.code == "navigate.recording"


def test_recording_without_search_settings_uses_the_found_airways(searches):
    assert wall_builder(None, None)({}).of == "found None None"
