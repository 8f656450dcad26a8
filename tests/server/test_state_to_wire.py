"""Tests of the conversion of the session's state to messages."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest
from exact_measures import exact_measures

from carina.case.routes import route_to_branch
from carina.plan import DistanceOrigin
from carina.plan.routes.main_carina import RouteScale
from carina.plan.routes.route_width import widths_on_the_way
from carina.scopes import scope_preset, scope_presets
from carina.server.to_wire.session import route_message, start_message, state_message
from carina.track import AirwayTree, Branch
from carina.volume import Note
from small_case import session_fixture


def test_scope_list_message_has_the_required_lumen_and_nominal_tip_of_every_scope():
    scopes = start_message(notice_accepted=True, recent=(), patient_citation=None).scopes
    assert len(scopes) > 10
    for scope in scopes:
        assert scope.fit_mm == pytest.approx(scope_preset(scope.name).fit_mm, abs=0.005)
        assert scope.fit_mm > scope.tip_mm


def test_state_message_contains_the_badges_of_the_case_and_its_airways():
    fixture = session_fixture()
    assert state_message(fixture.session.snapshot(), frame_rate_hz=60.0).badges == ()
    fixture.open()
    shown = state_message(fixture.session.snapshot(), frame_rate_hz=60.0)
    assert [(note.code, note.words, note.badge) for note in shown.badges] == [("import.lossy", "a test", True)]
    assert shown.case.notes == shown.badges
    thick = Note("track.thick-slices", "slices of 3 mm: a test", badge=True)
    snapshot = fixture.session.snapshot()
    assert snapshot.document is not None
    airways: Any = snapshot.document.airways
    airways.badges = (thick,)
    shown = state_message(snapshot, frame_rate_hz=60.0)
    assert [(note.code, note.words) for note in shown.badges][1:] == [(thick.code, thick.words)]
    fixture.open("raw")
    shown = state_message(fixture.session.snapshot(), frame_rate_hz=60.0)
    assert [note.code for note in shown.badges] == ["import.not-hu", "import.lossy"]
    assert [note.code for note in shown.case.notes] == ["import.lossy"]


def three_branches() -> AirwayTree:
    """Return a trachea and two branches below it in a straight line, each 41.3 mm long."""
    branches = []
    for n in range(3):
        points = np.zeros((60, 3))
        points[:, 2] = -0.7 * (59 * n + np.arange(60))
        children = (n + 1,) if n < 2 else ()
        branches.append(Branch(n, n - 1 if n else None, children, n, None, "tracked", points, np.full(60, 3.0)))
    return AirwayTree(tuple(branches))


def test_route_message_has_the_same_narrowest_diameter_as_plans():
    tree = three_branches()
    widths = 5.0 + 0.001 * np.square(np.arange(60.0) - 30.0)
    measures = exact_measures(tree, widths_mm={0: np.full(60, 14.0), 1: np.full(60, 6.0), 2: widths}, error_mm=0.3)
    sent = route_message(route_to_branch(tree, 2), measures).route
    planned = widths_on_the_way(tree, None, measures, 1.0)[2][-1]
    assert sent is not None and sent.narrowest_mm is not None and sent.narrowest_mm < 6.0
    assert sent.narrowest_mm == pytest.approx(planned.mm, abs=1e-3)
    assert {one.scope: one.fit for one in sent.scope_fits} == {one.name: planned.fit(one) for one in scope_presets()}
    assert sent.narrowest_error_mm == pytest.approx(planned.error_mm, abs=1e-3)
    assert sent.narrowest_at_mm == pytest.approx(planned.at_mm, abs=1e-2)


def test_route_message_has_distances_along_the_centrelines_and_their_origin():
    route = route_to_branch(three_branches(), 2)
    plain = route_message(route).route
    assert msgspec.to_builtins(plain.origin) == {"kind": "root", "along_mm": 0.0}
    assert plain.centreline_mm == plain.cumulative_mm
    sent = route_message(route, None, RouteScale(DistanceOrigin("ridge", 52.31, 41.3), 1.1 * route.cumulative_mm)).route
    assert msgspec.to_builtins(sent.origin) == {"kind": "ridge", "along_mm": 52.31}
    assert sent.centreline_mm == pytest.approx(1.1 * route.cumulative_mm, abs=1e-3)


def test_route_message_without_measured_airways_has_no_narrowest_diameter():
    tree = three_branches()
    route = route_to_branch(tree, 2)
    other = AirwayTree((replace(tree.branches[0], children=()),))
    for measures in (None, exact_measures(tree, method=1), exact_measures(other)):
        sent = route_message(route, measures).route
        assert sent is not None and sent.narrowest_mm is None and sent.narrowest_error_mm is None
