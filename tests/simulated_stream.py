"""Simulation of a renderer, a hand and a client in simulated time, for tests of the frame pump's scheduler."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field

from carina.server.frames.pacing import FrameScheduler, RenderOrder

AIRWAY = {"airway": (800, 640)}
ALL_VIEWS = {
    **AIRWAY,
    "axial": (300, 250),
    "coronal": (300, 250),
    "sagittal": (300, 250),
    "cut-plane": (300, 250),
    "tri-plane": (300, 250),
}


@dataclass
class Machine:
    """Cost model of a renderer: costs per picture, per ray and per sample, which the scheduler does not know."""

    full_s: float
    """Time of a full airway picture of 800 x 640 pixels, in seconds."""
    each_s: float = 0.001
    samples: float = 0.5
    """Fraction of the time of a full picture that is proportional to its number of samples."""
    slices_s: float = 0.002
    """Time of a slice of 300 x 250 pixels, in seconds."""
    slowed: Callable[[float], float] = lambda _now_s: 1.0
    waits_s: Callable[[], float] = lambda: 0.0
    """Function that returns the time for which a picture waits for a core, seconds."""
    shared: Callable[[float], float] = lambda _now_s: 1.0
    """Function that returns the factor by which other programs slow the machine down at a time."""
    counts: bool = True
    """Whether the renderer reports the CPU time of its rays, as on Linux."""

    def cost(self, order: RenderOrder, now_s: float) -> tuple[float, float | None]:
        """Return the time of a picture, and the processor time of its rays or None, in seconds."""
        slowed = self.slowed(now_s)
        rays_s = self._rays_s(order) * slowed
        seconds = (self.each_s * slowed + rays_s) * self.shared(now_s) + self.waits_s()
        return seconds, rays_s if self.counts else None

    def seconds(self, order: RenderOrder, now_s: float) -> float:
        """Return the time that the machine needs for a picture, seconds."""
        return self.cost(order, now_s)[0]

    def _rays_s(self, order: RenderOrder) -> float:
        pixels = order.width * order.height
        if order.view == "airway" and order.purpose != "finder":
            per_ray = (self.full_s - self.each_s) / (800 * 640)
            return per_ray * pixels * (1.0 - self.samples + self.samples * 0.5 / order.step_vox)
        return self.slices_s * pixels / (300 * 250)


@dataclass
class Simulation:
    """Simulated pump, renderer and client for one scheduler; a hand moves the tip ``hand_per_s`` times a second."""

    machine: Machine
    layout: dict[str, tuple[int, int]] = field(default_factory=lambda: dict(AIRWAY))
    rate_hz: float = 60.0
    hand_per_s: float = 60.0
    ack_s: float = 0.005
    now_s: float = 10.0
    pose: int = 0
    sent: list[tuple[float, RenderOrder]] = field(default_factory=list)
    probes: list[tuple[float, float]] = field(default_factory=list)
    """Start and duration of each probe, in seconds."""
    spent_s: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.scheduler = FrameScheduler(rate_hz=self.rate_hz)
        self.scheduler.set_layout(self.layout)
        self._acks: list[tuple[float, int]] = []
        self._frame_id = 0

    def fly(self, seconds: float, *, moves: bool = True) -> list[tuple[float, RenderOrder]]:
        """Return the pictures that were sent during ``seconds``, while the hand moved (``moves``) or rested."""
        first, end_s = len(self.sent), self.now_s + seconds
        start_s, start_pose = self.now_s, self.pose
        while self.now_s < end_s:
            if moves:
                self.pose = start_pose + 1 + math.floor((self.now_s - start_s) * self.hand_per_s + 1e-9)
            for due_s, frame_id in [a for a in self._acks if a[0] <= self.now_s]:
                self._acks.remove((due_s, frame_id))
                self.scheduler.acknowledge(frame_id)
            self.scheduler.observe(dict.fromkeys(self.layout, self.pose), self.now_s)
            order = self.scheduler.next_order(self.now_s)
            if order is not None:
                self._render(order)
                continue
            times = [end_s, *(due_s for due_s, _ in self._acks)]
            wake_s = self.scheduler.wake_s(self.now_s)
            if wake_s is not None:
                assert wake_s > self.now_s, "an immediate wake-up was requested without a picture to render"
                times.append(wake_s)
            if moves:
                times.append(start_s + (self.pose - start_pose) / self.hand_per_s)
            self.now_s = max(min(times), self.now_s + 1e-6)
        return self.sent[first:]

    def rest(self, seconds: float) -> list[tuple[float, RenderOrder]]:
        """Return the pictures that were sent during ``seconds``, while the hand rested."""
        return self.fly(seconds, moves=False)

    def _render(self, order: RenderOrder) -> None:
        seconds, rays_s = self.machine.cost(order, self.now_s)
        if order.purpose == "probe":
            self.probes.append((self.now_s, seconds))
        self.now_s += seconds
        self._frame_id += 1
        name = order.purpose if order.view == "airway" else order.view
        self.spent_s[name] = self.spent_s.get(name, 0.0) + seconds
        if self.scheduler.rendered(order, self._frame_id, seconds, self.now_s, rays_s=rays_s):
            self.sent.append((self.now_s, order))
            self._acks.append((self.now_s + self.ack_s, self._frame_id))


def airway(sent: list[tuple[float, RenderOrder]]) -> list[tuple[float, RenderOrder]]:
    """Return the airway pictures among the sent ones."""
    return [entry for entry in sent if entry[1].view == "airway"]


def rate_hz(sent: list[tuple[float, RenderOrder]]) -> float:
    """Return the number of airway pictures per second."""
    times = [time_s for time_s, _ in airway(sent)]
    return (len(times) - 1) / (times[-1] - times[0])


def num_changes(sent: list[tuple[float, RenderOrder]]) -> int:
    """Return how often the level of resolution changed."""
    levels = [order.level for _, order in airway(sent)]
    return sum(a != b for a, b in itertools.pairwise(levels))


def num_coarser(sent: list[tuple[float, RenderOrder]]) -> int:
    """Return how often the level of resolution changed to a coarser one."""
    levels = [order.level for _, order in airway(sent)]
    return sum(a < b for a, b in itertools.pairwise(levels))
