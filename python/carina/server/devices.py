"""Connections to input devices, the thread that moves the tip by them, and the device status sent to windows."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from msgspec.structs import replace

from carina import commands
from carina.commands import Command
from carina.config import load_settings
from carina.errors import CarinaError, UsageError
from carina.navigate import AxesSample, DeviceState, HandleSample, PenState, PoseSample, filter_latency_ms
from carina.navigate.devices import IgtlServer, Listener, Source, found_ports, open_source
from carina.render import LEAD_VIEW
from carina.server.wire import messages as wire
from carina.session import Session
from carina.session.jobs.background_jobs import log_fault

logger = logging.getLogger(__name__)

# Minimum seconds between two device frames: twice the rate of screens, below the rate of trackers.
FRAME_S = 1.0 / 125.0
SHOWN_EVERY_S = 0.2
MAX_SOURCES = 16
PICTURE_PX = 512


class Phone(Protocol):
    """Interface to start and stop the phone page (:class:`carina.phone.PhoneSwitch`)."""

    changed: Callable[[], None]
    """Callback that is called, from any thread, after a phone has connected or disconnected."""

    @property
    def problem(self) -> str | None:
        """Reason, as a message for the user, why the phone page cannot be started; None if it can."""
        ...

    def start(self) -> wire.PhoneInfo:
        """Start the phone page; do nothing if it runs already."""
        ...

    def stop(self) -> None:
        """Stop the phone page and return when its port is closed."""
        ...

    def info(self) -> wire.PhoneInfo | None:
        """Return the state of the phone page for the wire; None while it is stopped."""
        ...


class DeviceConnections:
    """Owner of the device connections and of the thread that moves the tip by their samples.

    Parameters
    ----------
    session
        Session whose tip the devices move.
    push
        Sends a message to all windows; called from any thread.
    recordings
        Folder for recordings of cases that are not saved.
    phone
        Switch of the phone page; None if this build has no phone page.
    """

    def __init__(
        self,
        session: Session,
        push: Callable[[Any], None],
        *,
        recordings: Path | None = None,
        phone: Phone | None = None,
    ) -> None:
        self._session = session
        self._push = push
        self._recordings = recordings
        self._phone = phone
        self._phone_wanted = False
        self._phone_switching = threading.Lock()
        if phone is not None:
            phone.changed = self._send_status
        self._sources: dict[str, Source] = {}
        self._publisher: IgtlServer | None = None
        self._watching: set[int | None] = set()
        """Numbers of the windows that receive the device values a few times a second."""
        self._shown_s = 0.0
        self._sent_pen: wire.Pen | None = None
        self._ports: tuple[tuple[str, ...], str | None] = ((), None)
        self._fault_logged = False
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="carina-devices", daemon=True)

    def start(self) -> None:
        """Start the thread that moves the tip by device samples."""
        self._thread.start()

    def stop(self) -> None:
        """Close all connections, stop the phone page and end the thread."""
        self._ended.set()
        self._session.devices.woken.set()
        for source in self._sources.values():
            source.stop()
        self._sources.clear()
        if self._publisher is not None:
            self._publisher.stop()
        if self._phone is not None:
            self._phone.changed = lambda: None
            self._phone.stop()
        if self._thread.is_alive():
            self._thread.join()

    # ------------------------------------------------------------ commands and connections of devices

    def handle(self, message: Any, window: int | None = None) -> bool:
        """Handle a message of a window about devices; return False if the message is not about devices."""
        session = self._session
        match message:
            case wire.DeviceSampleMessage():
                session.devices.receive_sample(message.device, _sample_from_message(message))
                return True
            case wire.ConnectDevice():
                self._connect(message.address)
            case wire.DisconnectDevice():
                source = self._sources.pop(message.address, None)
                if source is not None:
                    source.stop()
                    session.do(commands.DeviceGone(message.address))
            case wire.PublishTip():
                self._publish_tip(message.port)
            case wire.SetPhone():
                if self._phone is None:
                    raise UsageError("this build of Carina does not include the phone page", code="phone.missing")
                self._phone_wanted = message.on
                # Starting the page creates keys, sockets and threads, which would delay the event loop.
                threading.Thread(target=self._switch_phone, args=(message.on,), daemon=True).start()
            case wire.WatchDevices():
                self._watching.discard(window)
                if message.on:
                    self._watching.add(window)
                    self._ports = _ports()
                session.devices.woken.set()
            case wire.StartRecording():
                folder = self._recordings or load_settings().state_dir / "recordings"
                file = folder / time.strftime("flight-%Y%m%d-%H%M%S.jsonl")
                session.do(commands.RecordFlight(None if session.snapshot().saving.keeps else file))
            case _:
                return False
        self._send_status()
        return True

    def done(self, command: Command) -> None:
        """Send the device status to all windows after a command about devices has run."""
        if type(command).__module__ == commands.devices.__name__:
            self._send_status()

    def add_window(self) -> None:
        """Schedule the pen state for a new window; the window subscribes to device values by a message."""
        self._sent_pen = None
        self._session.devices.woken.set()

    def remove_window(self, window: int) -> None:
        """Cancel the device subscription of a closed window."""
        self._watching.discard(window)

    def _remove_device(self, device: str) -> None:
        self._session.do(commands.DeviceGone(device))

    def _connect(self, address: str) -> None:
        source = open_source(address, Listener(self._session.devices.receive_sample, self._remove_device))
        # The source's own address is the key: the typed address may omit a port or contain more than the address.
        if source.address in self._sources:
            raise UsageError(f"{source.address} is already connected", code="devices.address")
        if len(self._sources) >= MAX_SOURCES:
            raise UsageError(f"at most {MAX_SOURCES} devices can be connected at once", code="devices.address")
        self._sources[source.address] = source
        source.start()

    def _switch_phone(self, on: bool) -> None:
        assert self._phone is not None
        try:
            with self._phone_switching:
                if on != self._phone_wanted:
                    return  # a later request has changed the wanted state; its thread may run before this one
                if on:
                    self._phone.start()
                else:
                    self._phone.stop()
        except CarinaError as error:
            self._push(wire.Error(error.code, str(error), None))
        except Exception as error:
            log_fault(logger, "the phone page could not be opened or closed", error)
            words = f"the phone page failed: internal error in Carina ({type(error).__name__})"
            self._push(wire.Error("carina.fault", words, None))

    def _publish_tip(self, port: int | None) -> None:
        if self._publisher is not None:
            self._publisher.stop()
            self._publisher = None
        if port is None:
            return

        def pose() -> Any:
            info = self._session.pose_info()
            return None if info is None else info.pose.lps_from_camera

        self._publisher = IgtlServer(pose, picture=self._render_picture, port=port)
        self._publisher.start()

    def _render_picture(self) -> Any:
        """Render the airway view for an OpenIGTLink client that requested an image; None without a case."""
        scene = self._session.scene()
        return None if scene is None else scene.renderer.render(scene.spec(LEAD_VIEW, PICTURE_PX, PICTURE_PX, 1.0)).rgb

    # ------------------------------------------------------------ messages to the windows

    def message(self) -> wire.DevicesMessage | None:
        """Return the device status for the wire; None without a case."""
        info = self._session.devices.info()
        if info is None:
            return None
        controls = info.controls
        recording = self._session.devices.recording_name
        return wire.DevicesMessage(
            control=info.control,
            filter_latency_ms=round(filter_latency_ms(controls), 2),
            controls=controls,
            devices=tuple(_device_message(state) for state in info.devices)[:200],
            sources=tuple(_source_message(source) for source in self._sources.copy().values()),
            serial_ports=self._ports[0],
            serial_problem=self._ports[1],
            published_port=None if self._publisher is None else self._publisher.port,
            recording=recording,
            phone=None if self._phone is None else self._phone.info(),
            phone_problem="this build of Carina does not include the phone page"
            if self._phone is None
            else self._phone.problem,
        )

    def _send_status(self) -> None:
        message = self.message()
        if message is not None:
            self._push(message)
        self._send_pen_state()

    def _send_pen_state(self) -> None:
        """Send the pen state to all windows if it has changed."""
        state = self._session.devices.pen()
        message, last_sent = _pen_message(state), self._sent_pen or NO_PEN
        if state is not None and not state.is_armed and state.off_mm is None and last_sent.lps is not None:
            # The position of a pen that is not armed and has no offset is not displayed, so it causes no message.
            message = replace(message, lps=None if message.lps is None else last_sent.lps)
        if message != last_sent:
            self._sent_pen = message
            self._push(message)

    def _run(self) -> None:
        woken, moving = self._session.devices.woken, False
        while not self._ended.is_set():
            # Without samples and without a subscribed window, the thread sleeps until it is woken.
            woken.wait(1.0 / 60.0 if moving else SHOWN_EVERY_S if self._watching else None)
            if self._ended.is_set():
                return
            began_s = time.monotonic()
            try:
                moving = self._session.devices.frame()
                self._send_pen_state()
                if self._watching and began_s - self._shown_s >= SHOWN_EVERY_S:
                    self._shown_s = began_s
                    self._send_status()
            except Exception as error:
                # The thread continues after an error, because no other thread processes device input.
                moving = False
                if not self._fault_logged:
                    self._fault_logged = True
                    log_fault(logger, "processing the device input of one frame failed; input continues", error)
            # The wait limits the rate at which the tip moves, however many samples arrive.
            self._ended.wait(max(0.0, FRAME_S - (time.monotonic() - began_s)))


def _ports() -> tuple[tuple[str, ...], str | None]:
    ports, error = found_ports()
    return tuple(port["port"] for port in ports)[:200], error


def _sample_from_message(message: wire.DeviceSampleMessage) -> PoseSample | AxesSample | HandleSample:
    if message.orientation_wxyz is not None:
        w, x, y, z = message.orientation_wxyz
        at = None if message.position_mm is None else _three_floats(message.position_mm)
        return PoseSample(message.time_s, at, (w, x, y, z), message.buttons, message.advance)
    if message.handle is not None:
        insertion_mm, roll_rad, lever = message.handle
        return HandleSample(message.time_s, insertion_mm, roll_rad, lever, message.buttons)
    assert message.axes is not None
    forward, right, up, yaw, pitch, roll = message.axes
    return AxesSample(message.time_s, (forward, right, up, yaw, pitch, roll), message.buttons)


def _device_message(state: DeviceState) -> wire.DeviceInfo:
    sample = state.sample
    pen = sample if isinstance(sample, PoseSample) else None
    axes: tuple[float, ...] = ()
    if isinstance(sample, AxesSample):
        axes = sample.axes
    elif isinstance(sample, HandleSample):
        axes = (sample.insertion_mm, sample.roll_rad, sample.lever)
    return wire.DeviceInfo(
        device=state.device[:200],
        holds=state.holds,
        registered=state.registered,
        residual_mm=None if state.rms_mm is None else round(state.rms_mm, 3),
        latency_ms=round(state.latency_ms, 2),
        num_used=state.num_used,
        num_ignored=sum(state.num_ignored.values()),
        ignored_words=", ".join(f"{why} ({num})" for why, num in state.num_ignored.items()),
        position_mm=None if pen is None else pen.position_mm,
        orientation_wxyz=None if pen is None else pen.orientation_wxyz,
        axes=axes,
        buttons=0 if sample is None else sample.buttons,
    )


NO_PEN = wire.Pen(device=None, tracked=False, lps=None, off_mm=None, off_deg=None)


def _pen_message(state: PenState | None) -> wire.Pen:
    if state is None:
        return NO_PEN
    # Rounding hides the noise of a tracker, which would otherwise cause a message per sample.
    lps = None if state.lps is None else _three_floats([round(v, 3) for v in state.lps])
    return wire.Pen(
        device=state.device[:200],
        tracked=state.is_tracked,
        lps=lps,
        off_mm=None if state.off_mm is None else round(state.off_mm, 2),
        off_deg=None if state.off_rad is None else round(math.degrees(state.off_rad), 1),
    )


def _source_message(source: Source) -> wire.DeviceSource:
    status = source.status()
    return wire.DeviceSource(
        status.address, status.title, status.state, status.words[:4000], status.rate_hz, sum(status.num_bad.values())
    )


def _three_floats(values: Any) -> tuple[float, float, float]:
    x, y, z = values
    return float(x), float(y), float(z)
