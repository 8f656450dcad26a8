"""Test of the pose of the first pictures of a case."""

from __future__ import annotations

import numpy as np
import pytest

from carina.session.open_case.start_pose import pose_before_airways
from carina.volume import Volume


def test_start_pose_without_airways_is_a_fifth_below_the_top_of_a_tilted_volume() -> None:
    nz, ny, nx = 40, 20, 24
    turn = np.deg2rad(20.0)
    matrix = np.eye(4)
    matrix[:3, :3] = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    volume = Volume(np.zeros((nz, ny, nx), dtype=np.int16), matrix)
    # In this volume z decreases along i, so the highest voxel is the last of k and the first of i.
    top, bottom = np.cos(turn) * (nz - 1), -np.sin(turn) * (nx - 1)
    x, y, _ = volume.centre_lps
    assert pose_before_airways(volume).position_lps == pytest.approx([x, y, top - 0.2 * (top - bottom)])
