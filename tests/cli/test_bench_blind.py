"""Tests of the blind reading of pictures: the key states where posterior is, and readers are scored in clock hours."""

from __future__ import annotations

import json

import numpy as np
import pytest

import carina
from carina.errors import UsageError
from carina_bench import blind_reading


def test_posterior_is_at_the_bottom_of_an_upright_picture_and_rotates_with_the_scope():
    upright = carina.Pose.looking((0, 0, 0), (0, 0, -1))
    assert blind_reading.back_hour(upright) == pytest.approx(6.0)
    # A clockwise rotation of the scope, as its operator sees it, rotates the picture counterclockwise.
    assert blind_reading.back_hour(blind_reading.turned(upright, np.pi / 2)) == pytest.approx(3.0)
    # The expected hour of an oblique view is that of a step of 1 mm to posterior, projected into the picture.
    oblique = blind_reading.turned(carina.Pose.looking((0, 0, 0), (0.5, 0.2, -1.0)), 1.0)
    right, down = oblique.lps_from_camera[1, :2]
    assert blind_reading.back_hour(oblique) == pytest.approx(np.degrees(np.arctan2(right, -down)) / 30.0 % 12.0)


def test_clock_hour_errors_are_modulo_12_and_missing_answers_are_refused(tmp_path, capsys):
    key = {
        "00": {"decorated": True, "hour": 11.5},
        "01": {"decorated": True, "hour": 6.0},
        "02": {"decorated": False, "hour": 3.0},
    }
    answers = {"00": 0.5, "01": 6.2, "02": 9.0}
    for name, content in (("key", key), ("told", answers)):
        (tmp_path / f"{name}.json").write_text(json.dumps(content))
    blind_reading.main(["score", str(tmp_path / "key.json"), str(tmp_path / "told.json")])
    rows = json.loads(capsys.readouterr().out)
    assert rows["decorated"] == {"pictures": 2, "median_h": 0.6, "worst_h": 1.0, "within_1_h": 2}
    assert rows["plain"] == {"pictures": 1, "median_h": 6.0, "worst_h": 6.0, "within_1_h": 0}
    with pytest.raises(UsageError, match="02"):
        blind_reading.scores(key, {"00": 0.5, "01": 6.2})


def test_pictures_of_the_blind_test_contain_no_pose_and_each_has_an_answer(tmp_path):
    num = blind_reading.draw(tmp_path, ["patient"], seed=3)
    key = json.loads((tmp_path / "key.json").read_text())
    assert sorted(key) == [f"{n:02d}" for n in range(num)]
    assert {answer["decorated"] for answer in key.values()} == {True, False}
    for picture in key:
        assert b"carina-pose" not in (tmp_path / f"{picture}.png").read_bytes()


def test_blind_test_refuses_cases_whose_trachea_is_too_short(tmp_path, monkeypatch):
    monkeypatch.setattr(blind_reading, "BEFORE_CARINA_MM", (1000.0,))
    with pytest.raises(UsageError, match="trachea"):
        blind_reading.draw(tmp_path, ["patient"])
