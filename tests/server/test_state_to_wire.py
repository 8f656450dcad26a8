"""Tests of the conversion of the session's state to messages."""

from __future__ import annotations

from typing import Any

import pytest

from carina.scopes import scope_preset
from carina.server.to_wire.session import start_message, state_message
from carina.volume import Note
from small_case import small_bench


def test_message_of_every_instrument_has_the_lumen_it_needs_and_its_nominal_tip():
    told = start_message(notice_accepted=True, recent=(), patient_citation=None).scopes
    assert len(told) > 10
    for scope in told:
        assert scope.fit_mm == pytest.approx(scope_preset(scope.name).fit_mm, abs=0.005)
        assert scope.fit_mm > scope.tip_mm


def test_state_message_contains_the_badges_of_the_case_and_its_airways():
    bench = small_bench()
    assert state_message(bench.session.snapshot(), frame_rate_hz=60.0).badges == ()
    bench.open()
    shown = state_message(bench.session.snapshot(), frame_rate_hz=60.0)
    assert [(note.code, note.words, note.badge) for note in shown.badges] == [("import.lossy", "a test", True)]
    assert shown.case.notes == shown.badges
    thick = Note("track.thick-slices", "slices of 3 mm: a test", badge=True)
    snapshot = bench.session.snapshot()
    assert snapshot.document is not None
    airways: Any = snapshot.document.airways
    airways.badges = (thick,)
    shown = state_message(snapshot, frame_rate_hz=60.0)
    assert [(note.code, note.words) for note in shown.badges][1:] == [(thick.code, thick.words)]
    bench.open("raw")
    shown = state_message(bench.session.snapshot(), frame_rate_hz=60.0)
    assert [note.code for note in shown.badges] == ["import.not-hu", "import.lossy"]
    assert [note.code for note in shown.case.notes] == ["import.lossy"]
