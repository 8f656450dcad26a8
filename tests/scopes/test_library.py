"""Tests of the library of bronchoscopes: each row of the table in docs with its figures."""

from __future__ import annotations

import numpy as np
import pytest

from carina.errors import UsageError
from carina.scopes import DEFAULT_SCOPE, Pose, scope_preset, scope_presets


def test_every_row_of_the_scope_table_is_in_the_library_with_its_basis():
    presets = scope_presets()
    assert presets[0].name == DEFAULT_SCOPE
    assert len({p.name for p in presets}) == len({p.title for p in presets}) == len(presets) == 18
    for preset in presets:
        assert 2.8 <= preset.tip_mm <= 6.9 and 1.2 <= preset.channel_mm <= 2.8
        assert preset.basis and any(part in preset.basis for part in ("s", "k"))
        assert preset.fit_mm >= preset.tip_mm + 0.4
        # Every lens gives a picture, even if the field of view of the scope is not known.
        assert preset.lens.optics(64, 64, preset.usual_fov_deg).fov_deg == preset.usual_fov_deg
        assert all(np.hypot(x, y) < preset.tip_mm / 2 for x, y, _ in preset.guides_mm)


def test_figures_of_the_scope_library_equal_those_of_the_table():
    standard = scope_preset("standard")
    assert (standard.tip_mm, standard.channel_mm, standard.fov_deg, standard.flexion_deg) == (
        4.9,
        2.0,
        120.0,
        (180, 130),
    )
    assert scope_preset("therapeutic").fit_mm == pytest.approx(6.4)
    assert scope_preset("ebus").view_up_deg == 35.0
    assert scope_preset("monarch").fov_deg is None and scope_preset("ion").length_mm is None


def test_unknown_scope_is_refused_with_the_known_names():
    with pytest.raises(UsageError, match=r"ultrathin.*found 'BF-1000'"):
        scope_preset("BF-1000")


def test_forward_oblique_scope_looks_up_from_its_shaft():
    tip = Pose.looking((1.0, 2.0, 3.0), (0.2, 0.4, -1.0))
    assert scope_preset("standard").camera_pose(tip) is tip
    camera = scope_preset("ebus").camera_pose(tip)
    assert np.allclose(camera.position_lps, tip.position_lps)
    assert np.allclose(camera.right_lps, tip.right_lps)
    assert float(camera.forward_lps @ tip.forward_lps) == pytest.approx(np.cos(np.deg2rad(35.0)))
    assert float(camera.forward_lps @ -tip.down_lps) == pytest.approx(np.sin(np.deg2rad(35.0)))
