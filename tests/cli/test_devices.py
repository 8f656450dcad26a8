"""Tests of the command ``carina devices``."""

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


def test_devices_command_shows_live_values_of_a_scope_handle(capsys):
    port = PseudoPort()
    try:
        with sending(lambda n: format_line(n, 10 * n, 12.5, lever=0.5, buttons=1), port, rate_hz=100.0):
            code = report([f"handle:{port.path}"], seconds=1.0, as_json=True)
    finally:
        port.unplug()
    result = json.loads(capsys.readouterr().out)
    assert code == 0
    (device,) = result["devices"]
    assert device["state"] == "live"
    assert device["rate_hz"] > 50
    assert device["samples"][0]["insertion_mm"] == pytest.approx(12.5)
    assert device["samples"][0]["buttons"] == 1
    assert result["filter_latency_ms"] <= 10.0


@pytest.mark.parametrize(
    ("address", "text"),
    [
        ("handle:/dev/there-is-none", "no such port"),
        ("openigtlink:127.0.0.1:1", "no response"),
        ("openigtlink:no-such-machine.invalid:18944", "no machine with this name was found"),
    ],
)
def test_devices_command_exits_with_the_reason_if_a_device_sends_nothing(capsys, address, text):
    assert report([address], seconds=1.0, as_json=True) == 4
    result = json.loads(capsys.readouterr().out)["devices"][0]
    assert result["address"] == address
    assert text in result["words"] and "Errno" not in result["words"]


def test_unchanged_value_of_a_device_is_printed_only_once(capsys):
    assert report(["handle:/dev/there-is-none"], seconds=0.9, as_json=False) == 4
    lines = capsys.readouterr().err.splitlines()
    assert lines and len(set(lines)) == len(lines)


def test_devices_command_without_a_name_lists_the_found_devices(capsys):
    assert report([], seconds=1.0, as_json=False) == 0
    assert "connect through the window" in capsys.readouterr().out
