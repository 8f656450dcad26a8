"""Fixtures of the cluster tests: a small noisy airway, consoles, and connections (lanes) that fail on demand."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from carina.cluster import ClusterRenderer, ClusterSettings, Console, LocalLane
from carina.render import Renderer
from carina.scopes import Pose
from carina.volume import Volume


@dataclass(frozen=True)
class SmallCase:
    """Bent tube on an oblique, anisotropic grid, with its lumen and a camera inside."""

    volume: Volume
    lumen_zyx: np.ndarray
    pose: Pose

    def renderer(self, simd: str | None = None, *, prepared: bool = True) -> Renderer:
        """Return a renderer of the case, as on a single machine."""
        renderer = Renderer(self.volume, simd=simd)
        renderer.set_lumen(self.lumen_zyx)
        if prepared:
            renderer.prepare()
        return renderer


@pytest.fixture(scope="session")
def case() -> SmallCase:
    """Return the bent tube with its lumen and camera; it is equal in every run."""
    shape = (40, 34, 36)
    z, y, x = np.meshgrid(*(np.arange(n, dtype=float) for n in shape), indexing="ij")
    off = np.hypot((x - 17 - 3 * np.sin(z / 9)) * 0.9, (y - 16) * 1.1)
    noise = np.random.default_rng(3).normal(0.0, 15.0, shape)
    hu = np.where(off < 7, -980.0, np.where(off < 9, -50.0, -820.0)) + noise
    turn = 0.3
    place = np.eye(4)
    place[:3, :3] = np.array(
        [[np.cos(turn), -np.sin(turn), 0.1], [np.sin(turn), np.cos(turn), 0.0], [-0.1, 0.0, 1.0]]
    ) * np.array([0.9, 1.1, 1.4])
    volume = Volume(np.ascontiguousarray(np.rint(hu).astype(np.int16)), place)
    at = volume.to_lps((17.0, 16.0, 33.0))
    ahead = volume.to_lps((18.0, 15.5, 10.0)) - at
    pose = Pose.looking(tuple(at), tuple(ahead / np.linalg.norm(ahead)))
    return SmallCase(volume, np.ascontiguousarray((off < 7).astype(np.uint8)), pose)


@pytest.fixture
def consoles() -> Iterator[Callable[..., Console]]:
    """Return a function that creates consoles, and close them after the test."""
    made: list[Console] = []

    def make(settings: ClusterSettings | None = None, **options) -> Console:
        made.append(Console(settings, **options))
        return made[-1]

    yield make
    for console in made:
        console.close()


@dataclass
class ErrorEvent:
    """Faults in the replies of a lane, which a test can change while the lane runs."""

    drops: bool = False
    raises: BaseException | None = None
    wrong_shape: bool = False
    old_frame: bool = False
    other_rows: bool = False
    garbles: bool = False
    twice: bool = False
    refuses: bool = False
    held: list[Callable[[], None]] = field(default_factory=list)
    holds: bool = False
    num_orders: int = 0


class FaultyLane(LocalLane):
    """Connection to a renderer (lane) whose replies have the faults of its ``trouble``."""

    def __init__(self, renderer: Renderer, *, name: str) -> None:
        self.trouble = ErrorEvent()
        self._guard = threading.Lock()
        super().__init__(renderer, name=name)

    def submit(self, order, done):
        """Render a strip and reply with the present faults."""
        error = self.trouble
        error.num_orders += 1
        if error.refuses:
            raise ConnectionError("the order cannot be sent")

        def answered(answer):
            if error.raises is not None:
                done(error.raises)
            elif error.garbles:
                done(("no", "answer"))
            elif error.twice:
                done(answer)
                done(replace(answer, rgb=answer.rgb * 0))
            elif error.wrong_shape:
                done(replace(answer, rgb=answer.rgb[:-1]))
            elif error.old_frame:
                done(replace(answer, frame_id=answer.frame_id - 1, rgb=answer.rgb * 0))
            elif error.other_rows:
                # The frame number and the height are correct, but the rows are shifted by one.
                shift = 1 if answer.first_row == 0 else -1
                done(replace(answer, first_row=answer.first_row + shift, rgb=np.roll(answer.rgb, shift, axis=0)))
            elif error.holds:
                with self._guard:
                    error.held.append(lambda: done(answer))
            else:
                done(answer)

        super().submit(order, answered)

    def release(self) -> None:
        """Send all replies that a fault has delayed."""
        self.trouble.holds = False
        with self._guard:
            held, self.trouble.held = self.trouble.held, []
        for say in held:
            say()


@dataclass
class Cluster:
    """Console with lanes that can fail, one case, and a renderer outside the cluster (``truth``)."""

    console: Console
    renderer: ClusterRenderer
    lanes: list[FaultyLane]
    truth: Renderer


@pytest.fixture
def cluster(case, consoles) -> Callable[..., Cluster]:
    """Return a function that creates clusters whose lanes are threads."""

    def make(simds=(None, None, None), settings: ClusterSettings | None = None) -> Cluster:
        console = consoles(settings)
        truth, own = case.renderer(), case.renderer()
        lanes = [FaultyLane(case.renderer(simd), name=f"lane-{n}") for n, simd in enumerate(simds)]
        for lane in lanes:
            console.add_lane(lane)
        return Cluster(console, ClusterRenderer(own, console, spread_all=True), lanes, truth)

    return make
