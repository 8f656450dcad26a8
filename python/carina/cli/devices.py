"""``carina devices``: list the input devices and print their samples."""

from __future__ import annotations

import dataclasses
import threading
import time
from typing import Any

from msgspec import structs

from carina.cli.console import print_json, print_note, print_result
from carina.commands import DeviceControls
from carina.errors import UsageError
from carina.navigate import HandleSample, PoseSample, Sample, SampleFilter, filter_latency_ms
from carina.navigate.devices import KINDS, Listener, SourceStatus, found_ports, open_source

IN_THE_WINDOW = (
    "mouse, keyboard, gamepads, SpaceMouse, USB scope handles (HID), headsets and phones connect through the window "
    "(`carina open`, Devices)"
)
REFRESH_S = 0.25


def report(addresses: list[str], *, seconds: float, as_json: bool) -> int:
    """List the devices; with addresses, connect and print their samples. Return 4 if a device sends nothing."""
    if not 0.0 < seconds <= 86_400.0:
        raise UsageError(f"--seconds: expected more than 0 and at most 86400; found {seconds:g}")
    ports, error = found_ports()
    live = _LatestSamples()
    sources = [open_source(address, live.listener) for address in addresses]
    statuses: list[SourceStatus] = []
    shown: dict[str, str] = {}
    try:
        for source in sources:
            source.start()
        end_s = time.monotonic() + seconds
        while sources and time.monotonic() < end_s:
            threading.Event().wait(min(REFRESH_S, max(0.0, end_s - time.monotonic())))
            if not as_json:
                for source in sources:
                    line = _status_line(source.status(), live.latest_sample(source.address))
                    if shown.get(source.address) != line:
                        print_note(line)
                    shown[source.address] = line
        statuses = [source.status() for source in sources]
    finally:
        for source in sources:
            source.stop()
    if as_json:
        print_json(
            {
                "serial_ports": ports,
                "serial_problem": error,
                "window": IN_THE_WINDOW,
                "filter_latency_ms": filter_latency_ms(DeviceControls()),
                "devices": [
                    {**dataclasses.asdict(status), "samples": live.samples(status.address)} for status in statuses
                ],
            }
        )
    elif not sources:
        for port in ports:
            print_result(f"{port['port']}  {port['title']}")
        if error is not None:
            print_result(error)
        elif not ports:
            print_result("no serial port was found")
        print_result(IN_THE_WINDOW)
        print_result(
            f"To see what a device sends: carina devices --device DEVICE, where DEVICE is one of {', '.join(KINDS)}"
        )
    return 0 if all(status.num_samples > 0 for status in statuses) else 4


def _status_line(status: SourceStatus, latest_sample: tuple[str, Sample] | None) -> str:
    newest_text = "" if latest_sample is None else _sample_text(latest_sample[1])
    bad = sum(status.num_bad.values())
    ignored = f", {bad} invalid" if bad else ""
    return f"{status.address}: {status.state}, {status.rate_hz:.0f} Hz{ignored}  {newest_text or status.words}"


def _sample_text(sample: Sample) -> str:
    match sample:
        case PoseSample(position_mm=at, orientation_wxyz=turn):
            place = "no position" if at is None else " ".join(f"{v:8.1f}" for v in at) + " mm"
            return f"{place}  wxyz {' '.join(f'{v:6.3f}' for v in turn)}  buttons {sample.buttons:b}"
        case HandleSample():
            return (
                f"insertion {sample.insertion_mm:7.1f} mm  roll {sample.roll_rad:6.2f} rad  lever {sample.lever:5.2f}  "
                f"buttons {sample.buttons:b}"
            )
        case _:
            return " ".join(f"{v:5.2f}" for v in sample.axes)


class _LatestSamples:
    """Newest sample of each device, filtered in the same way as for the movement of the tip."""

    def __init__(self) -> None:
        self._filters: dict[str, SampleFilter] = {}
        self._newest: dict[str, Sample] = {}
        self.listener = Listener(self._receive_sample, lambda _device: None)

    def _receive_sample(self, device: str, sample: Sample) -> None:
        if device not in self._filters:
            self._filters[device] = SampleFilter(DeviceControls())
        self._newest[device] = self._filters[device].apply(sample)

    def latest_sample(self, address: str) -> tuple[str, Sample] | None:
        return next(((d, s) for d, s in sorted(self._newest.items()) if d.startswith(address)), None)

    def samples(self, address: str) -> list[dict[str, Any]]:
        return [
            {"device": device, "kind": type(sample).__name__, **structs.asdict(sample)}
            for device, sample in sorted(self._newest.items())
            if device.startswith(address)
        ]
