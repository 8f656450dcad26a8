"""Test of the restored scope when a case is opened again: its contact needs an unchanged mode, tip and airways."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from carina.session.open_case.open_case import PendingScope

AIRWAYS = object()


@pytest.mark.parametrize(
    ("mode", "moved_mm", "airways", "is_due"),
    [
        ("guided", 0.0, AIRWAYS, True),
        ("free", 0.0, AIRWAYS, False),
        ("guided", 0.1, AIRWAYS, False),
        ("guided", 0.0, object(), False),
    ],
    ids=["as it was", "another mode", "moved", "other airways"],
)
def test_scope_contact_is_restored_only_if_mode_tip_and_airways_are_unchanged(mode, moved_mm, airways, is_due):
    def pose(x):
        matrix = np.eye(4)
        matrix[0, 3] = x
        return SimpleNamespace(lps_from_camera=matrix)

    pending = PendingScope(scope=None, airways=AIRWAYS, mode="guided", pose=pose(0.0))
    case = SimpleNamespace(
        navigator=SimpleNamespace(mode=mode, pose=pose(moved_mm)), document=SimpleNamespace(airways=airways)
    )
    assert pending.is_due(case) is is_due
