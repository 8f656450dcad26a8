"""The public door: what is done is done when the call returns, and trouble is raised where it was caused."""

from __future__ import annotations

import numpy as np
import pytest

import carina
from carina import commands as c
from carina.errors import NoResultError, UsageError


@pytest.fixture(scope="module")
def phantom():
    return carina.generate_phantom(spacing_mm=3.0, generations=3)


def test_a_case_is_opened_changed_taken_back_and_looked_at(phantom):
    with carina.Case.open(phantom.volume) as case:
        assert "found" in repr(case)
        assert case.airways.tree.tips()
        tip = case.airways.tree.tips()[0]
        case.do(c.AddTarget(tuple(tip.points[-1])))
        case.do(c.EditTree(c.RenameBranch(tip.id, "here")))
        assert case.history()[-1].startswith("rename ")
        assert case.airways.tree.branch(tip.id).name == "here"
        case.undo()
        assert case.airways.tree.branch(tip.id).name != "here"
        case.redo()
        assert case.airways.tree.branch(tip.id).name == "here"
        case.do(c.GoTo(path_mm=20.0))
        assert case.render("axial", width=40, height=30).rgb.shape == (30, 40, 3)
        assert case.ask(c.VoxelAt(tuple(case.pose.position_lps))) is not None


def test_trouble_is_raised_where_it_was_caused(phantom):
    with carina.Case.open(phantom.volume) as case:
        before = case.history()
        with pytest.raises(UsageError, match=r"set_fov\.fov_deg must be at least 60"):
            case.do(c.SetFov(1.0))
        far = tuple(float(v) for v in np.add(phantom.volume.centre_lps, (60.0, 60.0, 0.0)))
        with pytest.raises(NoResultError):
            case.do(c.EditTree(c.AddBranch(far)))
        with pytest.raises(UsageError, match="view"):
            case.render("oblique")
        assert case.history() == before


def test_what_is_no_scan_is_refused_in_words():
    with pytest.raises(UsageError, match=r"Case\.open: source: expected str, Path or Volume; found int"):
        carina.Case.open(3)
    with pytest.raises(carina.VolumeImportError):
        carina.Case.open("/nowhere/at/all")
