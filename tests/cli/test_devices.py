"""``carina devices``."""

from __future__ import annotations

import json
import sys

import pytest

from carina.cli.devices import report

pytest.importorskip("serial", reason="pyserial is not installed")
if sys.platform == "win32":
    pytest.skip("there are no pseudo-terminals on Windows", allow_module_level=True)

from carina.navigate.devices.scope_handle import format_line
from simulated_serial import PseudoPort, sending


def test_live_values_of_a_handle_are_shown(capsys):
    port = PseudoPort()
    try:
        with sending(lambda n: format_line(n, 10 * n, 12.5, lever=0.5, buttons=1), port, rate_hz=100.0):
            code = report([f"handle:{port.path}"], seconds=1.0, as_json=True)
    finally:
        port.unplug()
    said = json.loads(capsys.readouterr().out)
    assert code == 0
    (device,) = said["devices"]
    assert device["state"] == "live"
    assert device["rate_hz"] > 50
    assert device["samples"][0]["insertion_mm"] == pytest.approx(12.5)
    assert device["samples"][0]["buttons"] == 1
    assert said["filter_latency_ms"] <= 10.0


def test_a_device_that_says_nothing_is_no_success(capsys):
    assert report(["handle:/dev/there-is-none"], seconds=0.3, as_json=True) == 4
    assert "there-is-none" in json.loads(capsys.readouterr().out)["devices"][0]["words"]


def test_without_a_name_what_is_found_is_listed(capsys):
    assert report([], seconds=1.0, as_json=False) == 0
    assert "found by the window" in capsys.readouterr().out
