"""Tests of messages about plans and lungs: empty without a case, and sent again only after a change."""

from __future__ import annotations

import json
from typing import get_args

import numpy as np
import pytest

from carina.commands import AddTarget, CloseCase, MapLungs, RemoveTarget
from carina.plan.lungs.lung_map import LungMap
from carina.plan.lungs.vessels import VesselBranch, VesselTree
from carina.server.to_wire.lungs import _fissures_seen
from carina.server.windows.broadcast_cache import SharedTexts
from carina.server.windows.outbox import TOPICS, Outbox
from carina.session.state.snapshot import Topic
from small_case import session_fixture


def test_plans_message_is_absent_without_a_case_and_empty_before_a_target() -> None:
    fixture = session_fixture()
    texts = SharedTexts(fixture.session, None, print)
    nothing = texts.plans()
    fixture.open()
    text = texts.plans()
    assert texts.plans() is text
    message = json.loads(text)
    assert (message["type"], message["targets"], message["standing"]) == ("plans", [], "unwanted")
    assert message["tools"]
    fixture.session.do(CloseCase())
    # A request while a case is being closed returns no plans and raises no error.
    assert texts.plans() == nothing != text


def test_targets_without_a_plan_are_listed_in_the_comparison_message_after_each_change() -> None:
    fixture = session_fixture()
    texts = SharedTexts(fixture.session, None, print)
    fixture.open()
    fixture.background.run_all()
    sent = [json.loads(texts.plans())["comparison"]]
    lumen = fixture.session.snapshot().document.airways.tree.tips()[0].points
    for point in (lumen[0], lumen[-1]):
        fixture.session.do(AddTarget((float(point[0]), float(point[1]), float(point[2]))))
        fixture.background.run_all()
        sent.append(json.loads(texts.plans())["comparison"])
    assert sent[:2] == [None, None]
    assert sent[2]["targets"] == []
    assert [one["target_id"] for one in sent[2]["unplanned"]] == ["target-1", "target-2"]
    assert all(one["why"].startswith("not planned") for one in sent[2]["unplanned"])
    fixture.session.do(RemoveTarget("target-1"))
    assert json.loads(texts.plans())["comparison"] is None


def test_lung_maps_are_sent_only_after_a_change() -> None:
    fixture = session_fixture(
        wall_field=lambda *_given, **_options: object(), map_lungs=lambda *_given, **_options: LungMap()
    )
    texts = SharedTexts(fixture.session, None, print)
    fixture.open()
    states = [json.loads(texts.lungs())["standing"]]
    for step in (lambda: fixture.session.do(MapLungs()), fixture.background.run_all):
        step()
        states.append(json.loads(texts.lungs())["standing"])
    assert states == ["unwanted", "making", "had"]


@pytest.mark.parametrize(
    ("shares", "text"),
    [
        ((0.79, 0.68), "seen along about 80 % of the borders on the right and 70 % of the borders on the left"),
        ((0.0, 0.02), "hardly any seen"),
        ((0.5, None), "seen along about 50 % of the borders on the right"),
        ((None, None), "as far as the CT shows them"),
        (None, "as far as the CT shows them"),
    ],
)
def test_text_about_visible_fissures_names_each_side_with_lobe_borders(shares, text) -> None:
    assert _fissures_seen(shares) == text


def test_lung_vessels_are_sent_as_lines_without_short_side_branches() -> None:
    def line(num: int, at: float, sure: float, parent: int | None) -> VesselBranch:
        points = np.stack([np.full(num, at), np.zeros(num), np.arange(float(num))], axis=1)
        return VesselBranch(points, np.full(num, 1.2), parent, sure)

    # The tree has a trunk, a short piece between the trunk and another vessel, that vessel, and a short side branch.
    tree = VesselTree((line(40, 0.0, 1.0, None), line(4, 1.0, 1.0, 0), line(30, 2.0, 0.6, 1), line(4, 3.0, 1.0, 0)))
    fixture = session_fixture(
        wall_field=lambda *_given, **_options: object(), map_lungs=lambda *_given, **_options: LungMap(vessel_tree=tree)
    )
    texts = SharedTexts(fixture.session, None, print)
    fixture.open()
    fixture.session.do(MapLungs())
    fixture.background.run_all()
    vessels = json.loads(texts.lungs())["vessels"]
    assert [(one["points_lps"][0][0], one["sure"], one["diameter_mm"]) for one in vessels] == [
        (0.0, True, 2.4),
        (1.0, True, 2.4),
        (2.0, False, 2.4),
    ]
    # The line is thinned and has both ends of the vessel.
    assert vessels[0]["points_lps"][0] == [0.0, 0.0, 0.0]
    assert vessels[0]["points_lps"][-1] == [0.0, 0.0, 39.0]
    assert len(vessels[0]["points_lps"]) == 17


def test_every_event_topic_of_a_session_has_a_message() -> None:
    outbox = Outbox()
    # Pictures, not messages, answer the topic ``views``.
    sent = set(get_args(Topic)) - {"views"}
    outbox.mark(*get_args(Topic))
    topics, _, _ = outbox.take_all()
    assert set(topics) == sent
    assert topics == [topic for topic in TOPICS if topic in sent]
