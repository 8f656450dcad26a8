"""Tests of the FASTRAK tracker and the scope handle on a pseudo-terminal, including damaged data."""

from __future__ import annotations

import itertools
import math
import struct
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carina.errors import UsageError
from carina.navigate import HandleSample, PoseSample
from carina.navigate.devices import FastrakSource, HandleSource, Listener, open_source
from carina.navigate.devices.crc import crc8
from carina.navigate.devices.fastrak import FastrakStream
from carina.navigate.devices.scope_handle import HandleStream, format_line
from carina.navigate.devices.source import StampSpreader
from carina.navigate.rotation import rotation_from_wxyz

if sys.platform == "win32":
    pytest.skip("there are no pseudo-terminals on Windows", allow_module_level=True)
serial = pytest.importorskip("serial", reason="pyserial is not installed")

from simulated_serial import PseudoPort, sending, wait_for  # noqa: E402


def ascii_record(x_cm: float, wxyz=(1.0, 0.0, 0.0, 0.0), error: str = " ", button: int = 0, station: int = 1) -> bytes:
    place = "".join(f"{v:7.2f}" for v in (x_cm, 2.0, -3.0))
    turn = "".join(f"{v:7.4f}" for v in wxyz)
    return f"0{station}{error}{place}{turn} {button}\r\n".encode()


def binary_record(x_cm: float, wxyz=(1.0, 0.0, 0.0, 0.0), error: bytes = b" ", button: int = 0) -> bytes:
    return b"01" + error + struct.pack("<7f", x_cm, 2.0, -3.0, *wxyz) + b" %d\r\n" % button


FORMS = {False: ascii_record, True: binary_record}


class SampleRecorder:
    def __init__(self):
        self.samples: list = []
        self.gone: list[str] = []
        self.listener = Listener(lambda _device, sample: self.samples.append(sample), self.gone.append)


@pytest.mark.parametrize("binary", [False, True])
@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_fastrak_records_are_read_in_any_fragmentation(binary, data):
    record = FORMS[binary]
    stream, whole = FastrakStream(binary=binary), b"".join(record(float(n)) for n in range(8))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(whole)), max_size=12)))
    found = []
    for a, b in zip([0, *cuts], [*cuts, len(whole)], strict=True):
        found += stream.feed(whole[a:b])
    assert [r.position_mm for r in found] == [(10.0 * n, 20.0, -30.0) for n in range(8)]
    assert not stream.num_bad


@pytest.mark.parametrize("binary", [False, True])
@settings(max_examples=25, deadline=None)
@given(noise=st.binary(max_size=120))
def test_fastrak_records_are_found_after_noise(binary, noise):
    record = FORMS[binary]
    stream = FastrakStream(binary=binary)
    stream.feed(noise)
    found = [r for n in range(8) for r in stream.feed(record(float(n)))]
    assert found[-1].position_mm == (70.0, 20.0, -30.0)
    assert len(found) >= 5


@pytest.mark.parametrize("binary", [False, True])
def test_only_incomplete_and_out_of_range_fastrak_records_are_dropped(binary):
    record = FORMS[binary]
    stream = FastrakStream(binary=binary)
    letter = "Y" if not binary else b"Y"
    found = stream.feed(record(1.0) + record(2.0)[:17] + record(3.0) + record(4.0, error=letter) + record(5.0))
    assert [r.position_mm[0] for r in found][-1] == 50.0
    assert 40.0 not in [r.position_mm[0] for r in found]
    assert stream.num_bad["measurements outside the tracker's range"] == 1


def test_forward_axis_of_a_fastrak_stylus_is_the_x_axis_of_the_receiver():
    (record,) = FastrakStream().feed(ascii_record(0.0))
    pen = rotation_from_wxyz(record.orientation_wxyz)
    np.testing.assert_allclose(pen[:, 2], [1, 0, 0], atol=1e-12)  # forward
    np.testing.assert_allclose(pen[:, 1], [0, 0, 1], atol=1e-12)  # down: the z axis of the tracker
    assert np.linalg.det(pen) == pytest.approx(1.0)


def test_fastrak_records_with_non_finite_numbers_are_skipped():
    stream = FastrakStream(binary=True)
    assert stream.feed(binary_record(math.nan) + binary_record(1.0, (0.0, 0.0, 0.0, 0.0))) == []
    assert stream.num_bad["invalid position"] == 2


def test_serial_records_that_arrive_together_get_increasing_times():
    spread = StampSpreader(1 / 120)
    first, second = spread.stamps(4, 10.0), spread.stamps(3, 10.001)
    stamps = first + second
    assert all(b > a for a, b in itertools.pairwise(stamps))
    assert first[-1] == 10.0


@pytest.mark.parametrize("binary", [False, True])
def test_fastrak_is_read_at_its_rate_and_reconnects_after_unplugging(binary, tmp_path):
    record, port, recorder = FORMS[binary], PseudoPort(), SampleRecorder()
    link = tmp_path / "ttyPen"
    link.symlink_to(port.path)
    source = FastrakSource(str(link), recorder.listener, binary=binary)
    source.RETRY_S = 0.05
    source.start()
    try:
        requests = b""

        def are_all_requested() -> bool:
            nonlocal requests
            requests += port.received()
            return requests.endswith(b"C")

        wait_for(are_all_requested)
        assert requests == b"cuO1,2,11,16,1\r" + (b"f" if binary else b"F") + b"C"
        with sending(lambda n: record(n / 10.0, button=int(n == 60)), port):
            wait_for(lambda: len(recorder.samples) >= 100)
        assert source.status().state == "live"
        assert source.status().rate_hz > 60
        xs = [s.position_mm[0] for s in recorder.samples]
        np.testing.assert_allclose(np.diff(xs), 1.0, atol=1e-3)  # No record is lost or repeated.
        assert sum(s.buttons for s in recorder.samples) == 1
        assert all(isinstance(s, PoseSample) for s in recorder.samples)
        port.send(record(50.0)[:11] + b"\x00\xff noise \r\n" + record(51.0) + record(52.0))
        wait_for(lambda: any(s.position_mm[0] == 520.0 for s in recorder.samples))
        assert source.num_bad["bytes outside any record"] > 0
        port.unplug()
        wait_for(lambda: recorder.gone == [source.address])
        assert source.status().state in {"lost", "connecting"}
        port = PseudoPort()
        link.unlink()
        link.symlink_to(port.path)
        wait_for(port.received)
        with sending(lambda n: record(float(n)), port):
            before = len(recorder.samples)
            wait_for(lambda: len(recorder.samples) > before + 10)
    finally:
        source.stop()
        port.unplug()


def test_missing_serial_port_is_reported_and_the_source_can_be_stopped_at_once():
    recorder = SampleRecorder()
    source = FastrakSource("/dev/there-is-none", recorder.listener)
    source.start()
    wait_for(lambda: source.status().state == "lost")
    assert source.status().words == "no such port; check that the device is plugged in and switched on"
    source.stop()


def test_line_of_a_scope_handle_is_read_as_three_controls_and_two_buttons():
    stream = HandleStream()
    (line,) = stream.feed(format_line(7, 1500, 123.45, roll_deg=-90.0, lever=0.5, buttons=3))
    assert (line.time_s, line.insertion_mm, line.lever, line.buttons) == (1.5, 123.45, 0.5, 3)
    assert line.roll_rad == pytest.approx(-math.pi / 2)


def test_scope_handle_line_in_the_documentation_is_valid():
    # docs/scope-handle.md contains this line.
    (line,) = HandleStream().feed(b"S,41,20533,12345,-9000,500,1*%02X\n" % crc8(b"S,41,20533,12345,-9000,500,1"))
    assert line.insertion_mm == 123.45


def test_damaged_and_lost_scope_handle_lines_are_counted_also_after_a_clock_overflow():
    stream = HandleStream()
    lines = [format_line(n, 2**32 - 20 + 10 * n, float(n)) for n in range(6)]
    found = stream.feed(lines[0] + lines[1].replace(b"S,1", b"S,9") + b"# a word\n" + lines[3] + lines[4])
    assert [line.insertion_mm for line in found] == [0.0, 3.0, 4.0]
    times = [line.time_s for line in found]
    assert all(b > a for a, b in itertools.pairwise(times))
    assert stream.num_bad == {"damaged lines": 1, "lost lines": 2}


@settings(max_examples=50, deadline=None)
@given(st.binary(max_size=300))
def test_scope_handle_is_read_after_any_noise(noise):
    stream = HandleStream()
    stream.feed(noise + b"\n")
    assert len(stream.feed(format_line(0, 10, 1.0))) == 1


def test_scope_handle_on_a_serial_port_moves_the_tip():
    port, recorder = PseudoPort(), SampleRecorder()
    source = HandleSource(port.path, recorder.listener)
    source.start()
    try:
        wait_for(lambda: b"G\n" in port.received())
        with sending(lambda n: format_line(n, 10 * n, 0.5 * n), port, rate_hz=100.0):
            wait_for(lambda: len(recorder.samples) >= 50)
        assert all(isinstance(s, HandleSample) for s in recorder.samples)
        np.testing.assert_allclose(np.diff([s.insertion_mm for s in recorder.samples]), 0.5)
        assert source.status().num_bad.get("lost lines", 0) == 0
    finally:
        source.stop()
        port.unplug()


@pytest.mark.parametrize("address", ["", "pen", "fastrak:", "openigtlink:host:0", "openigtlink:host:x", "usb:1"])
def test_invalid_device_address_is_refused(address):
    with pytest.raises(UsageError, match="expected a device address such as"):
        open_source(address, SampleRecorder().listener)
