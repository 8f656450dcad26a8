"""Force feedback: the hand's place and speed to a force, 1,000 times a second (`docs/haptics.md`).

The loop runs in the compiled module on a thread of its own, without the interpreter's lock. A device is fed in
process, or by a bridge over binary UDP on loopback.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carina import _core
from carina.display import one_line
from carina.errors import UsageError
from carina.scopes.wall_field import WallField

__all__ = [
    "FORCE_LIMIT_N",
    "FORCE_SLEW_N_PER_MS",
    "MAX_STIFFNESS_N_PER_MM",
    "ForceFigures",
    "ForceLaw",
    "ForceLoop",
    "HandForce",
    "forces_along",
    "picture_threads",
    "rumble",
]

Point = tuple[float, float, float]

FORCE_LIMIT_N, FORCE_SLEW_N_PER_MS, MAX_STIFFNESS_N_PER_MM = _core.force_limits()


@one_line
@dataclass(frozen=True, slots=True)
class ForceLaw:
    """The numbers of the law; ranges are checked when a loop starts."""

    tip_radius_mm: float = 2.45
    """Radius of the tip that feels."""
    grip_mm: float = 40.0
    """From the tip back to the hand: the lever of the torque."""
    stiffness_n_per_mm: float = 0.4
    """Of the wall, to `MAX_STIFFNESS_N_PER_MM`."""
    damping_ns_per_mm: float = 0.001
    """Of the wall, against movement across it."""
    friction: float = 0.15
    """Force along the wall per force across it."""
    guidance_n_per_mm: float = 0.0
    """Towards the path; 0 for none. Guidance never draws harder than 1 N."""
    watchdog_ms: float = 20.0
    """A hand that is silent for longer feels nothing, after at most 30 ms."""

    @property
    def numbers(self) -> tuple[float, float, float, float, float, float, float]:
        """In the compiled module's order."""
        return (
            self.tip_radius_mm,
            self.grip_mm,
            self.stiffness_n_per_mm,
            self.damping_ns_per_mm,
            self.friction,
            self.guidance_n_per_mm,
            self.watchdog_ms,
        )


@one_line
@dataclass(frozen=True, slots=True)
class HandForce:
    """What the hand feels."""

    force_n: Point
    """LPS, at most `FORCE_LIMIT_N` long."""
    torque_n_mm: Point
    """About the grip, LPS."""
    touches: bool
    """The tip is at the wall."""
    limited: bool
    """The wall would push harder than the limit lets it."""
    silent: bool
    """No hand was heard of in time."""
    at_lps: Point | None
    """The tip that it answers."""


@one_line
@dataclass(frozen=True, slots=True)
class ForceFigures:
    """How a loop kept time."""

    num_ticks: int
    """Ticks that were due."""
    num_missed: int
    """Of which not done within their millisecond."""
    late_us: Point
    """How late ticks began: median, 99th percentile, worst."""
    work_us: Point
    """How long ticks took, from begin to end: median, 99th percentile, worst."""
    latency_us: Point
    """From when a sample was put to its force: median, 99th percentile, worst."""
    cpu_s: float
    """Time of its thread on cores (Linux; else 0)."""
    wall_s: float
    """Time since the start."""
    num_samples: int
    """Samples from outside."""
    num_refused: int
    """Of them no sane ones."""
    is_real_time: bool
    """The system lets the loop go before all threads of ordinary programs (Linux, where the user may have that)."""
    max_force_n: float
    """The strongest force so far."""
    max_change_n: float
    """The largest change in a tick."""


class ForceLoop:
    """The force law 1,000 times a second; a context manager that starts at once and ends the loop.

    Parameters
    ----------
    field
        Signed distance to the wall.
    law
        Its numbers.
    path_lps
        (n, 3), what guidance draws to.
    udp_port
        Listen for a bridge on this port of 127.0.0.1; 0 takes a free one (`port`).
    lps_from_device
        (4, 4) the bridge's space in LPS: turned, shifted and scaled alike on all axes, by 0.05 to 1; not mirrored.
    simulated
        A hand that moves by itself, for tests and benches: round which place (LPS mm), how far (mm), how often a
        second.

    Raises
    ------
    UsageError
        If a number is out of range or the port is taken (code ``scope.force``).

    Examples
    --------
    >>> z, y, x = np.mgrid[0:40, -10:11, -10:11].astype(np.float32)
    >>> field = WallField.from_distances(6.0 - np.hypot(x, y), np.array(
    ...     [[1.0, 0, 0, -10], [0, 1.0, 0, -10], [0, 0, 1.0, -40], [0, 0, 0, 1.0]]))
    >>> with ForceLoop(field) as loop:
    ...     loop.put((0.0, 0.0, -20.0))
    True
    """

    def __init__(
        self,
        field: WallField,
        law: ForceLaw | None = None,
        *,
        path_lps: ArrayLike | None = None,
        udp_port: int | None = None,
        lps_from_device: NDArray[np.float64] | None = None,
        simulated: tuple[Point, float, float] | None = None,
    ) -> None:
        if udp_port is not None and not 0 <= udp_port <= 65535:
            raise UsageError(f"expected a port from 0 to 65535; found {udp_port}", code="scope.force")
        self._law = law or ForceLaw()
        path = np.zeros((0, 3)) if path_lps is None else np.ascontiguousarray(path_lps, dtype=np.float64)
        matrix = None if lps_from_device is None else np.ascontiguousarray(lps_from_device, dtype=np.float64)
        self._core = _core.ForceLoop(
            field.core, self._law.numbers, path, udp_port=udp_port, simulated=simulated, lps_from_device=matrix
        )

    def __repr__(self) -> str:
        return f"ForceLoop({self._law!r}, port={self.port})"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    @property
    def law(self) -> ForceLaw:
        """The numbers of the law."""
        return self._law

    @property
    def port(self) -> int | None:
        """The UDP port, if it listens."""
        return self._core.port

    def put(
        self,
        at_lps: Sequence[float],
        velocity_mm_s: Sequence[float] = (0.0, 0.0, 0.0),
        forward_lps: Sequence[float] = (0.0, 0.0, -1.0),
    ) -> bool:
        """Hand over where the tip is (LPS mm), its velocity and direction; False for numbers that no hand makes."""
        return self._core.put(list(at_lps), list(velocity_mm_s), list(forward_lps))

    def felt(self) -> HandForce:
        """The newest force."""
        found = self._core.felt()
        at = found["at_lps"]
        return HandForce(
            force_n=tuple(found["force_n"]),
            torque_n_mm=tuple(found["torque_n_mm"]),
            touches=found["touches"],
            limited=found["limited"],
            silent=found["silent"],
            at_lps=None if at is None else tuple(at),
        )

    def figures(self) -> ForceFigures:
        """How it keeps time."""
        found = self._core.figures()
        values: dict[str, Any] = {n: tuple(v) if isinstance(v, list) else v for n, v in found.items()}
        return ForceFigures(**values)

    def stop(self) -> None:
        """End the loop and wait for it; it may be called again."""
        self._core.stop()


def picture_threads() -> int:
    """How many threads a picture is made by now: one less while a :class:`ForceLoop` runs."""
    return _core.picture_threads()


def forces_along(field: WallField, samples: ArrayLike, law: ForceLaw | None = None) -> NDArray[np.float64]:
    """What a hand would feel along a movement, without thread and clock: the same samples give the same forces.

    Parameters
    ----------
    field
        Signed distance to the wall.
    samples
        (n, 9), one for each millisecond: the tip's centre (LPS mm), its velocity (mm/s) and direction (unit length).
        A row with numbers that no hand makes is a hand that was not heard of.
    law
        The numbers of the law.

    Returns
    -------
    numpy.ndarray
        (n, 3) N, LPS.

    Raises
    ------
    UsageError
        If a number of the law is out of range, or the samples have another shape (code ``scope.force``).

    Examples
    --------
    >>> z, y, x = np.mgrid[0:40, -10:11, -10:11].astype(np.float32)
    >>> field = WallField.from_distances(6.0 - np.hypot(x, y), np.array(
    ...     [[1.0, 0, 0, -10], [0, 1.0, 0, -10], [0, 0, 1.0, -40], [0, 0, 0, 1.0]]))
    >>> pressed = np.array([[x, 0.0, -20.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0] for x in np.linspace(0.0, 5.0, 100)])
    >>> bool(forces_along(field, pressed)[-1, 0] < -0.4)
    True
    """
    rows = np.ascontiguousarray(samples, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != 9:
        raise UsageError(f"expected samples of shape (n, 9); found {rows.shape}", code="scope.force")
    return _core.forces_along(field.core, (law or ForceLaw()).numbers, rows)


def rumble(depth_mm: float) -> tuple[float, float]:
    """The everyday fallback: the strengths (strong, weak) of a gamepad's motors for a contact of a depth, 0 to 1.

    The weak motor says that the tip touches, the strong one how hard.

    Examples
    --------
    >>> rumble(0.0), rumble(50.0)
    ((0.0, 0.0), (1.0, 1.0))
    """
    if not math.isfinite(depth_mm) or depth_mm <= 0.0:
        return 0.0, 0.0
    return min(depth_mm / 10.0, 1.0), min(0.2 + depth_mm / 4.0, 1.0)
