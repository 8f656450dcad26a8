"""Tests of messages about the airway tree: full names, measures, open ends, and airways that were not found."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from carina.server.to_wire.tree import branch_detail_message, branch_measures, tree_message
from carina.server.wire import messages as wire
from carina.track import AirwayTree, Branch, Uncertainty, find_absent
from small_case import small_airways, small_volume


def measured(branch_id, *, usable=(False, True, True, True), **summary):
    """Return measures of four sections, of which the first is at a fork and the last could not be measured."""
    values = {
        "length_mm": 30.004,
        "angle_deg": 35.04,
        "mean_mm": 6.1,
        "mean_error_mm": 0.2,
        "min_mm": 5.0,
        "min_error_mm": None,
        "min_at_mm": 20.0,
        "taper": -0.02,
        "wall_mm": None,
        "wall_error_mm": float("nan"),
        "stenosis": SimpleNamespace(percent=31.04, percent_error=6.0, at_mm=20.0),
    }
    widths = np.array([9.0, 7.0, 5.0, np.nan])
    return SimpleNamespace(
        branch_id=branch_id,
        is_by_earlier_method=summary.pop("is_by_earlier_method", False),
        at_mm=np.array([0.0, 10.0, 20.0, 30.0]),
        equivalent_mm=widths,
        equivalent_error_mm=np.array([0.1, 0.2, 0.3, np.nan]),
        min_mm=widths - 1,
        max_mm=widths + 1,
        wall_mm=np.full(4, np.nan),
        at_junction=np.array([True, False, False, False]),
        at_edge=np.array([False, False, False, True]),
        is_usable=np.array(usable) & np.isfinite(widths),
        summary=SimpleNamespace(**(values | summary)),
    )


def test_branch_figures_in_the_tree_message_exclude_cross_sections_at_forks():
    sent = branch_measures(measured(4))
    assert (sent.branch_id, sent.length_mm, sent.lumen_mm, sent.angle_deg) == (4, 30.0, 6.1, 35.0)
    assert (sent.max_lumen_mm, sent.max_lumen_error_mm) == (7.0, 0.2)
    assert (sent.min_lumen_mm, sent.min_lumen_error_mm, sent.min_at_mm) == (5.0, 0.3, 20.0)
    assert (sent.wall_mm, sent.wall_error_mm) == (None, None)
    assert (sent.stenosis_percent, sent.stenosis_error_percent, sent.stenosis_at_mm) == (31.0, 6.0, 20.0)


def test_narrowest_diameter_is_sent_with_its_own_error_and_measurements_by_an_earlier_method_are_marked():
    sent = branch_measures(measured(4, min_error_mm=0.4, is_by_earlier_method=True))
    assert (sent.min_lumen_error_mm, sent.by_earlier_method) == (0.4, True)
    assert not branch_measures(measured(4)).by_earlier_method


def test_branch_with_only_cross_sections_at_forks_is_sent_without_diameters():
    nothing = {"mean_mm": None, "mean_error_mm": None, "min_mm": None, "min_at_mm": None, "stenosis": None}
    sent = branch_measures(measured(4, usable=(False, False, False, False), **nothing))
    assert (sent.lumen_mm, sent.min_lumen_mm, sent.max_lumen_mm, sent.stenosis_percent) == (None, None, None, None)


def test_unmeasured_cross_sections_are_sent_as_null():
    answer = branch_detail_message(wire.AskBranchDetail(7, 4), measured(4))
    assert (answer.request_id, answer.branch_id, answer.measures.branch_id) == (7, 4, 4)
    assert answer.profile.lumen_mm == (9.0, 7.0, 5.0, None)
    assert answer.profile.at_junction == (True, False, False, True)
    again = wire.parse_server_message(wire.encode_message(answer))
    assert again == answer


def test_tree_is_sent_first_without_measurements_and_again_when_they_are_ready():
    airways = small_airways(small_volume())
    assert tree_message(airways).measures is None
    sent = tree_message(airways, SimpleNamespace(of=measured))
    assert [m.branch_id for m in sent.measures] == [b.id for b in airways.tree.branches]
    wire.parse_server_message(wire.encode_message(sent))
    assert tree_message(None) == wire.Tree(None, (), None, (), ())


@pytest.mark.parametrize("branch_id", [3, None])
def test_uncertain_airway_ends_are_sent_with_or_without_a_branch(branch_id):
    airways = small_airways(small_volume())
    airways.uncertain = (
        Uncertainty(
            lps=(1.0, 2.0, 3.0),
            kind="leak",
            branch_id=branch_id,
            width_mm=1.8,
            confidence=None,
            num_ends=None,
            voxel_mm=None,
        ),
    )
    message = tree_message(airways)
    (sent,) = message.uncertain
    assert (sent.lps, sent.kind, sent.branch_id, sent.width_mm) == ((1.0, 2.0, 3.0), "leak", branch_id, 1.8)
    assert sent.statement == airways.uncertain[0].statement
    assert sent.explanation == "its wall is too thin here, and the search would have leaked into the lung"
    assert wire.parse_server_message(wire.encode_message(message)) == message


def test_absent_airways_are_sent_with_the_reason():
    airways = small_airways(small_volume())
    trunk = Branch(0, None, (1,), 0, "Trachea", "tracked", np.array([[0.0, 0, 0], [0, 0, -90]]), np.full(2, 8.0))
    right = Branch(1, 0, (), 1, "RMB", "tracked", np.array([[0.0, 0, -90], [-30, 0, -130]]), np.full(2, 6.0))
    airways.tree = AirwayTree((trunk, right))
    airways.absent = find_absent(airways.tree)
    message = tree_message(airways)
    assert [one.name for one in message.absent][:2] == [
        "RUL (right upper lobe bronchus)",
        "RML (middle lobe bronchus)",
    ]
    assert [one.reason for one in message.absent] == [one.reason for one in airways.absent]
    assert wire.parse_server_message(wire.encode_message(message)) == message
