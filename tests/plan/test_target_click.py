"""Test of a target that is created by a click in a CT."""

from __future__ import annotations

import numpy as np
import pytest
from painted_nodules import Scene, painted

from carina.plan import target_from_click


def test_click_on_a_nodule_gives_a_target_with_its_anatomical_region():
    volume, _, middle = painted(Scene(pleura_mm=3.0))
    at = middle + np.array([-1.5, 0.0, 0.5])
    target = target_from_click(volume, at, target_id="t7", name="nodule in RB2")
    assert (target.target_id, target.source, target.where) == ("t7", "click", "beside pleura")
    assert target.seed_lps == pytest.approx(at)
    assert target.nodule.contains([target.aims[0]])[0]
    assert target.words.startswith("nodule in RB2: solid nodule")
    assert target.words.endswith("beside the pleura")
