"""What a window is told of plans: none without a case, and the same text until they change."""

from __future__ import annotations

import json

from carina.commands import CloseCase
from carina.server.shared_texts import SharedTexts
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
