"""What a window is told of plans: none without a case, and the same text until they change."""

from __future__ import annotations

import json
from typing import get_args

from carina.commands import CloseCase, MapLungs
from carina.plan.lung_map import LungMap
from carina.server.outbox import TOPICS, Outbox
from carina.server.shared_texts import SharedTexts
from carina.session.snapshot import Topic
from small_case import small_bench


def test_there_are_no_plans_without_a_case_and_empty_ones_before_a_target() -> None:
    bench = small_bench()
    texts = SharedTexts(bench.session, None, print)
    nothing = texts.plans()
    bench.open()
    told = texts.plans()
    assert texts.plans() is told
    message = json.loads(told)
    assert (message["type"], message["targets"], message["standing"]) == ("plans", [], "unwanted")
    assert message["tools"]
    bench.session.do(CloseCase())
    # Whoever asks while the case is being closed is told of none, and the sender goes on.
    assert texts.plans() == nothing != told


def test_what_was_mapped_of_the_lungs_is_told_as_it_changes() -> None:
    bench = small_bench(
        wall_field=lambda *_given, **_options: object(), map_lungs=lambda *_given, **_options: LungMap()
    )
    texts = SharedTexts(bench.session, None, print)
    bench.open()
    told = [json.loads(texts.lungs())["standing"]]
    for step in (lambda: bench.session.do(MapLungs()), bench.background.run_all):
        step()
        told.append(json.loads(texts.lungs())["standing"])
    assert told == ["unwanted", "making", "had"]


def test_every_topic_of_a_session_has_its_turn_in_what_is_sent() -> None:
    outbox = Outbox()
    # Pictures answer to the views.
    sent = set(get_args(Topic)) - {"views"}
    outbox.mark(*get_args(Topic))
    topics, _, _ = outbox.take()
    assert set(topics) == sent
    assert topics == [topic for topic in TOPICS if topic in sent]
