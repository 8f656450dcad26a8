"""Tests of the command ``carina course``: learners, export and deletion."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from carina.cli import course as command
from carina.training import Course


class Settings:
    def __init__(self, folder: Path) -> None:
        self.learners_dir = folder


@pytest.fixture
def learners(tmp_path, monkeypatch):
    monkeypatch.setattr(command, "load_settings", lambda: Settings(tmp_path / "learners"))
    made = Course(tmp_path / "learners")
    made.add("Blue heron")
    return made


def test_learners_are_listed_as_text_and_json(carina, learners):
    text = carina("course")
    assert text.code == 0
    assert "Blue heron: 0 attempts; no verdict: it needs 6 attempts that count" in text.out
    found = json.loads(carina("course", "--json").out)
    assert [one["name"] for one in found["learners"]] == ["Blue heron"]
    assert json.loads(carina("course", "blue heron", "--json").out)["attempts"] == []


def test_learner_is_exported_and_deleted_after_a_confirmation(carina, learners, tmp_path):
    refused = carina("course", "Blue heron", "--delete")
    assert refused.code == 2
    assert "this deletes Blue heron and 0 attempts from this machine permanently; add --yes to confirm" in refused.err
    assert len(learners.learners()) == 1
    done = carina("course", "Blue heron", "--export", tmp_path / "out", "--delete", "--yes")
    assert done.code == 0
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["attempts.csv", "xapi.json"]
    assert learners.learners() == ()


def test_unknown_learner_and_options_without_effect_are_refused(carina, learners):
    unknown = carina("course", "Nobody")
    assert unknown.code == 2
    assert "learner: expected one of Blue heron; found 'Nobody'" in unknown.err
    assert carina("course", "--delete").code == 2
    assert carina("course", "Blue heron", "--yes").code == 2


def test_learner_is_added_under_a_pseudonym(carina, learners):
    added = carina("course", "  Grey   owl ", "--add")
    assert added.code == 0
    assert "added Grey owl" in added.err
    assert "Grey owl: 0 attempts" in added.out
    assert [one.name for one in learners.learners()] == ["Blue heron", "Grey owl"]
    found = json.loads(carina("course", "Teal", "--add", "--json").out)
    assert (found["name"], found["attempts"]) == ("Teal", [])


def test_second_learner_of_a_name_and_options_without_effect_on_a_new_learner_are_refused(carina, learners, tmp_path):
    assert carina("course", "blue heron", "--add").code == 2
    assert carina("course", "x" * 41, "--add").code == 2
    assert carina("course", "--add").code == 2
    for option in (["--delete", "--yes"], ["--export", tmp_path / "out"]):
        refused = carina("course", "Grey owl", "--add", *option)
        assert refused.code == 2
        assert "only applies to a learner who is not new" in refused.err
    assert [one.name for one in learners.learners()] == ["Blue heron"]
