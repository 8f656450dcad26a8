"""Tests of ``carina fly --breathing``: the frames of a chest that breathes and coughs."""

from __future__ import annotations

import json

import numpy as np
import pytest

from carina.breathing import MOVED_TEXT, Breathing, ChestFrame, ChestMotion
from carina.cli.fly import parse_breathing
from carina.display.dot_letters import with_text_lines
from carina.errors import UsageError
from carina.export.flight_film import FrameOptions, distinct_images, frame_view
from carina.navigate.recording import ReplayedPose
from carina.scopes import Pose

av = pytest.importorskip("av", reason="PyAV is not installed")
CHEST = ChestFrame(110.0, -130.0)
HOW = ["--size", "160x160", "--rate", "4", "--step-vox", "1", "--speed", "100", "--pause", "0", "--json"]


@pytest.fixture
def tree(phantom_folder):
    """Return the true tree's file; its route needs no search."""
    return phantom_folder / "truth.json"


def test_frame_has_the_deformation_of_its_time_and_a_tip_that_the_tissue_carries():
    still = FrameOptions((64, 48), None, 1.0)
    moving = FrameOptions((64, 48), None, 1.0, ChestMotion(Breathing(), CHEST))
    pose = Pose.looking((0.0, 0.0, -60.0), (0.0, 0.1, -1.0))
    settings: dict[str, object] = {}
    frames = [ReplayedPose(time_s, pose, settings) for time_s in (0.0, 0.9, 1.8, 3.6)]
    shown = [frame_view(frame, moving) for frame in frames]
    assert shown[0].pose is pose
    assert shown[0].lps_from_rest is None
    assert shown[3].lps_from_rest is None
    for frame, view in zip(frames[1:3], shown[1:3], strict=True):
        deformation = Breathing().at(frame.time_s, CHEST)
        assert np.array_equal(view.lps_from_rest, deformation.lps_from_rest)
        assert np.allclose(view.pose.position_lps, deformation.points(pose.position_lps)[0])
    # A still camera in a breathing chest gives a new picture for each time.
    assert len(distinct_images(frames, still)[0]) == 1
    assert len(distinct_images(frames, moving)[0]) == 4


def test_video_with_amplitude_0_equals_the_video_without_breathing_except_its_text(
    carina, ct, tree, tmp_path, pictures_of
):
    plain, still, moving = (tmp_path / name for name in ("plain.mp4", "still.mp4", "moving.mp4"))
    flight = ["fly", ct, "--tree", tree, "--to", "RMB"]
    assert carina(*flight, "-o", plain, *HOW).code == 0
    ended = carina(*flight, "-o", still, *HOW, "--breathing", "0,3.6")
    assert ended.code == 0, ended.err
    assert json.loads(ended.out)["breathing"]["craniocaudal_mm"] == 0.0
    ended = carina(*flight, "-o", moving, *HOW, "--breathing", "quiet", "--cough", "0.5")
    assert ended.code == 0, ended.err
    assert json.loads(ended.out)["breathing"]["coughs_s"] == [0.5]
    films = [pictures_of(path) for path in (plain, still, moving)]
    assert len(films[0]) == len(films[1]) == len(films[2]) >= 3
    written = with_text_lines(np.zeros((160, 160, 3), np.uint8), [MOVED_TEXT]).any(axis=2)
    assert written.any()
    places = np.argwhere(written)
    (top_row, left), (low_row, right) = places.min(axis=0) - 16, places.max(axis=0) + 16
    rows = np.ones(written.shape, dtype=bool)
    rows[max(top_row, 0) : low_row, max(left, 0) : right] = False
    assert rows.mean() > 0.4
    off = [np.abs(a[rows].astype(int) - b[rows]) for a, b in zip(films[0], films[1], strict=True)]
    assert np.max(off) == 0
    moved = [np.abs(a[rows].astype(int) - b[rows]).mean() for a, b in zip(films[0], films[2], strict=True)]
    assert max(moved) > 1.0
    top = [np.abs(a[written].astype(int) - b[written]).mean() for a, b in zip(films[0], films[1], strict=True)]
    assert min(top) > 10.0


@pytest.mark.parametrize(
    ("text", "cough", "message"),
    [
        ("deep", None, "--breathing: expected quiet"),
        ("12", None, "--breathing: expected quiet"),
        ("400,3", None, "movement_mm"),
        ("12,0.1", None, "period_s"),
        ("quiet", "now", "--cough: expected times"),
    ],
)
def test_impossible_breathing_is_refused_with_the_option(text, cough, message):
    with pytest.raises(UsageError, match=message):
        parse_breathing(text, cough)


def test_cough_without_breathing_is_refused(carina, ct, tmp_path):
    ended = carina("fly", ct, "--to", "RMB", "-o", tmp_path / "film.mp4", "--cough", "2")
    assert ended.code == 2
    assert "--breathing" in ended.err
