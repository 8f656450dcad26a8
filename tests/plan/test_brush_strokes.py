"""Tests that few strokes of the window's brush correct the boundary of a lesion at the chest wall."""

from __future__ import annotations

import numpy as np
import pytest
from test_masses import WALL_X_MM, chest_part

import carina
from carina.commands import AddTarget, BrushTarget
from carina_bench.plan_lesions import MAX_STROKES, best_stroke, overlap

RADIUS_MM = 16.0


def test_three_strokes_add_the_part_of_a_lesion_that_lies_in_the_chest_wall() -> None:
    middle = (WALL_X_MM - 5.0, 0.0, 0.0)
    volume, in_lung_mm3 = chest_part(((*middle, RADIUS_MM),), slice_mm=3.0)
    # The CT does not show where a tumour in the chest wall ends, so the user paints the rest of the ball.
    zyx = np.moveaxis(np.indices(volume.shape_zyx), 0, -1)
    points = volume.to_lps(zyx[..., ::-1].reshape(-1, 3).astype(float)).reshape(zyx.shape)
    wanted = np.linalg.norm(points - np.array(middle), axis=-1) <= RADIUS_MM
    wanted_mm3 = 4.0 / 3.0 * np.pi * RADIUS_MM**3
    assert wanted_mm3 > 1.2 * in_lung_mm3
    with carina.Case.open(volume) as case:
        case.do(AddTarget((WALL_X_MM - 12.0, 2.0, -1.0)))
        (target,) = case.state.document.targets
        clicked = target.lesion.nodule
        before = overlap(clicked, volume, wanted)
        for _ in range(MAX_STROKES):
            stroke = best_stroke(case.state.document.targets[0].lesion.nodule, volume, wanted)
            assert stroke is not None
            case.do(BrushTarget(target.target_id, stroke.points_lps, stroke.radius_mm, stroke.takes_away))
            nodule = case.state.document.targets[0].lesion.nodule
        assert nodule.volume_mm3 == pytest.approx(wanted_mm3, rel=0.1)
        assert overlap(nodule, volume, wanted) > max(0.92, before)
        # Each stroke is one undo step.
        for _ in range(MAX_STROKES):
            case.undo()
        assert case.state.document.targets[0].lesion.nodule is clicked
