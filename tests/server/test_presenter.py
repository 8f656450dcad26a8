"""What the session holds, as messages."""

from __future__ import annotations

import pytest

from carina.scopes import scope_preset
from carina.server.presenter import start_message


def test_every_instrument_says_the_lumen_that_it_needs_and_not_only_its_stated_tip():
    told = start_message(notice_accepted=True, recent=(), patient_citation=None).scopes
    assert len(told) > 10
    for scope in told:
        assert scope.fit_mm == pytest.approx(scope_preset(scope.name).fit_mm, abs=0.005)
        assert scope.fit_mm > scope.tip_mm
