"""Tests of the choice of the processor of airway views in the window."""

from __future__ import annotations

import json

import pytest
from live_server import running

from carina.config import PROCESSOR_NAME, load_settings
from carina.render import Backend
from carina.server.wire import messages as wire


def choice(window):
    return window.until(lambda m: isinstance(m, wire.ProcessorChoice))


def has_problem(message):
    return isinstance(message, wire.ProcessorChoice) and message.problem == "no usable graphics adapter"


def test_chosen_processor_reaches_all_windows_and_is_stored(tmp_path):
    backend = Backend("auto", find=tuple)
    with running(tmp_path, backend=backend) as live, live.window() as window, live.window() as other:
        assert (choice(window).choice, choice(other).choice) == ("auto", "auto")
        window.send(wire.SetProcessor("cpu"))
        assert (choice(window).choice, choice(other).choice) == ("cpu", "cpu")
        assert backend.mode == "cpu"
    stored = json.loads((tmp_path / "config" / PROCESSOR_NAME).read_text())
    assert stored == {"format": "carina-processor", "version": 1, "processor": "cpu"}


def test_windows_receive_a_message_and_the_reason_when_a_graphics_device_is_given_up(tmp_path):
    backend = Backend("gpu", find=tuple)
    with running(tmp_path, backend=backend) as live, live.window() as window:
        assert choice(window).problem is None
        backend.stop_using(None, "no usable graphics adapter")
        words = "Rendering on the CPU from now on: no usable graphics adapter."
        assert window.until(lambda m: isinstance(m, wire.Notice)).message == words
        assert window.received(has_problem)
        with live.window() as later:
            assert has_problem(choice(later))
        window.send(wire.SetProcessor("auto"))
        assert choice(window).problem is None


@pytest.mark.parametrize(
    ("options", "words"), [({"backend": Backend("gpu"), "is_backend_forced": True}, "CARINA_BACKEND"), ({}, "cluster")]
)
def test_processor_cannot_be_chosen_where_the_environment_or_a_cluster_decides(tmp_path, options, words):
    with running(tmp_path, **options) as live, live.window() as window:
        window.send(wire.SetProcessor("cpu"))
        error = window.until(lambda m: isinstance(m, wire.Error))
        assert error.code == "session.processor"
        assert words in error.message
    assert not (tmp_path / "config" / PROCESSOR_NAME).exists()


@pytest.mark.parametrize("text", ["", "[]", "{", '{"processor": "tpu"}', '{"processor": 3}'])
def test_settings_without_a_readable_choice_select_the_processor_automatically(tmp_path, monkeypatch, text):
    monkeypatch.setattr("platformdirs.PlatformDirs.user_config_path", tmp_path)
    (tmp_path / PROCESSOR_NAME).write_text(text)
    assert load_settings({}).backend == "auto"


def test_environment_overrides_the_choice_of_the_user(tmp_path, monkeypatch):
    monkeypatch.setattr("platformdirs.PlatformDirs.user_config_path", tmp_path)
    (tmp_path / PROCESSOR_NAME).write_text('{"format": "carina-processor", "version": 1, "processor": "cpu"}')
    chosen, forced = load_settings({}), load_settings({"CARINA_BACKEND": "gpu"})
    assert (chosen.backend, chosen.is_backend_forced) == ("cpu", False)
    assert (forced.backend, forced.is_backend_forced) == ("gpu", True)
