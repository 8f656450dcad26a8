"""Replacement for the packages anywidget and traitlets, which only a notebook needs.

The test in JupyterLab (``tests/notebook/test_jupyterlab.py``) uses the real packages.
"""

from __future__ import annotations

import sys
from types import SimpleNamespace

import pytest


class FakeWidget:
    """Widget that no page displays."""

    def __init__(self, **traits):
        self.traits, self.handlers, self.is_closed = traits, [], False

    def on_msg(self, handler):
        self.handlers.append(handler)

    def send(self, content, buffers=None):
        pass

    def close(self):
        self.is_closed = True


class FakeTrait:
    def __init__(self, *_default):
        pass

    def tag(self, *, sync):
        assert sync
        return self


def install(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let imports of both packages return the replacements during a test."""
    monkeypatch.setitem(sys.modules, "anywidget", SimpleNamespace(AnyWidget=FakeWidget))
    monkeypatch.setitem(sys.modules, "traitlets", SimpleNamespace(List=FakeTrait, Int=FakeTrait))
