"""Pictures rendered beside the force loop: those of a window while the tip moves, and full ones at a fixed pose."""

from __future__ import annotations

import statistics
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from carina.commands import Look
from carina.navigate import FlightPath
from carina.render import AirwayView, Renderer, Sight
from carina.server.frames.pump import FramePump
from carina.server.wire.messages import PictureHeader, parse_picture
from carina.session import ShownCase

__all__ = ["Pictures", "full_pictures", "moving_pictures", "summed"]

SIZE_PX = 512
PICTURES_HZ = 30.0
# Rate of a gamepad or of a screen.
HAND_HZ = 60.0
SPEED_MM_S = 20.0


@dataclass(frozen=True, slots=True)
class Pictures:
    """Rate, resolution and cost of the pictures in a period."""

    per_s: float
    scale: float
    """Mean side length relative to 512 pixels."""
    step_vox: float
    """Mean ray step."""
    render_ms: float
    """Median time of a picture."""
    finder_per_s: float = 0.0
    """Rate of view finder pictures, which replace airway pictures that are too slow; not part of the other values."""

    def to_json(self) -> dict[str, Any]:
        """Return the values as JSON."""
        return {
            "per_s": self.per_s,
            "scale": self.scale,
            "step_vox": self.step_vox,
            "render_ms": self.render_ms,
            "finder_per_s": self.finder_per_s,
        }


def moving_pictures(renderer: Renderer, path: FlightPath, seconds: float) -> Pictures:
    """Render 30 pictures of 512x512 pixels a second while the tip moves to and fro.

    The frame pump of ``carina open`` chooses the resolution that keeps the rate and encodes the pictures. A picture
    counts as shown when the pump delivers it; there is no socket and no browser.
    """
    shown: list[tuple[float, PictureHeader]] = []

    def deliver(data: bytes) -> None:
        header, _ = parse_picture(data)
        shown.append((time.monotonic(), header))
        pump.acknowledge(header.frame_id)

    tip = _Tip(renderer, path)
    pump = FramePump(lambda: tip.scene, deliver, lambda _: None, clock=time.monotonic)
    pump.set_rate(PICTURES_HZ)
    pump.set_layout({"airway": (SIZE_PX, SIZE_PX)})
    thread = threading.Thread(target=pump.run, name="bench-pump")
    thread.start()
    start = time.monotonic()
    try:
        _at_rate(HAND_HZ, seconds, lambda: tip.move(pump))
    finally:
        pump.stop()
        thread.join()
    return summed(shown, start, seconds)


def summed(shown: Sequence[tuple[float, PictureHeader]], start_s: float, seconds: float) -> Pictures:
    """Summarise the pictures of a period without its first second, in which the pump learns the cost of pictures."""
    steady = [header for shown_s, header in shown if start_s + 1.0 <= shown_s <= start_s + seconds]
    airway = [(header, header.step_vox) for header in steady if header.step_vox is not None]
    finder_per_s = (len(steady) - len(airway)) / (seconds - 1.0)
    if not airway:
        return Pictures(0.0, 0.0, 0.0, 0.0, finder_per_s)
    return Pictures(
        per_s=len(airway) / (seconds - 1.0),
        scale=statistics.fmean(header.width / SIZE_PX for header, _ in airway),
        step_vox=statistics.fmean(step_vox for _, step_vox in airway),
        render_ms=statistics.median(header.render_ms for header, _ in airway),
        finder_per_s=finder_per_s,
    )


def full_pictures(renderer: Renderer, path: FlightPath, seconds: float) -> Pictures:
    """Render full pictures of 512x512 pixels, as at rest, at up to 30 a second."""
    view = AirwayView(path.pose_at(20.0), width=SIZE_PX, height=SIZE_PX)
    times_ms: list[float] = []

    def render() -> None:
        began = time.monotonic()
        renderer.render(view)
        times_ms.append(1e3 * (time.monotonic() - began))

    took = _at_rate(PICTURES_HZ, seconds, render)
    return Pictures(len(times_ms) / took, 1.0, view.step_vox, statistics.median(times_ms))


class _Tip:
    """A tip that moves to and fro on a path, and the scene of its current pose."""

    def __init__(self, renderer: Renderer, path: FlightPath) -> None:
        self._renderer = renderer
        self._path = path
        self._num = 0
        self.scene = self._scene()

    def move(self, pump: FramePump) -> None:
        """Move by one step of the hand and announce the new scene to the pump."""
        self._num += 1
        self.scene = self._scene()
        pump.content_changed()

    def _scene(self) -> ShownCase:
        # From 10 to 30 mm along the path and back.
        turn = (self._num * SPEED_MM_S / HAND_HZ) % 40.0
        return ShownCase(
            case_number=1,
            content_number=1,
            renderer=self._renderer,
            pose=self._path.pose_at(10.0 + min(turn, 40.0 - turn)),
            pose_id=self._num,
            pose_s=time.monotonic(),
            look=Look(scope=None, outline="none", fov_deg=90.0),
            sight=Sight(),
            has_lumen=False,
        )


def _at_rate(hz: float, seconds: float, work: Callable[[], None]) -> float:
    """Call a function at a rate for a period and return the duration; late calls do not increase the rate."""
    start = due = time.monotonic()
    while (now := time.monotonic()) - start < seconds:
        time.sleep(max(0.0, due - now))
        work()
        due = max(due + 1.0 / hz, time.monotonic() - 1.0 / hz)
    return time.monotonic() - start
