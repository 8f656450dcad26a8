"""The force loop: position and speed of the hand to a force, 1,000 times a second.

The loop runs in the compiled module on its own thread, without the interpreter's lock. A device feeds the loop in
process, or through a bridge over binary UDP on loopback.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carina.display import one_line
from carina.errors import UsageError
from carina.render import reserved_thread
from carina.scopes import WallField
from carina_haptics import _force

__all__ = [
    "FORCE_LIMIT_N",
    "FORCE_SLEW_N_PER_MS",
    "MAX_STIFFNESS_N_PER_MM",
    "ForceFigures",
    "ForceLaw",
    "ForceLoop",
    "HandForce",
    "forces_along",
]

Point = tuple[float, float, float]

FORCE_LIMIT_N, FORCE_SLEW_N_PER_MS, MAX_STIFFNESS_N_PER_MM = _force.force_limits()


@one_line
@dataclass(frozen=True, slots=True)
class ForceLaw:
    """Parameters of the force law; a loop checks their ranges when it starts."""

    tip_radius_mm: float = 2.45
    """Radius in mm of the simulated tip that touches the wall."""
    grip_mm: float = 40.0
    """Distance in mm from the tip back to the hand, which is the lever of the torque."""
    stiffness_n_per_mm: float = 0.4
    """Stiffness of the wall, at most `MAX_STIFFNESS_N_PER_MM`."""
    damping_ns_per_mm: float = 0.001
    """Damping of movement across the wall."""
    friction: float = 0.15
    """Ratio of the force along the wall to the force across the wall."""
    guidance_n_per_mm: float = 0.0
    """Stiffness of the pull towards the path; 0 switches guidance off. The pull is at most 1 N."""
    watchdog_ms: float = 20.0
    """Time in ms without a sample after which the force is released to 0 within 30 ms."""

    @property
    def numbers(self) -> tuple[float, float, float, float, float, float, float]:
        """All parameters in the order of the compiled module."""
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
    """The force and the torque that a hand feels."""

    force_n: Point
    """Force in LPS, at most `FORCE_LIMIT_N` long."""
    torque_n_mm: Point
    """Torque about the grip, in LPS."""
    touches: bool
    """Whether the simulated tip touches the wall."""
    limited: bool
    """Whether the wall's force exceeds the force limit and is reduced to it."""
    silent: bool
    """Whether the watchdog released the force because no sample arrived in time."""
    at_lps: Point | None
    """Position of the tip in the sample that this force answers."""


@one_line
@dataclass(frozen=True, slots=True)
class ForceFigures:
    """Timing statistics of a force loop."""

    num_ticks: int
    """Number of ticks (milliseconds of the loop) that were due since the start."""
    num_missed: int
    """Number of ticks that were not finished within their millisecond."""
    late_us: Point
    """Delay of the start of a tick: median, 99th percentile, maximum."""
    work_us: Point
    """Duration of a tick from start to end: median, 99th percentile, maximum."""
    latency_us: Point
    """Time in us from a sample to its force: median, 99th percentile, maximum."""
    cpu_s: float
    """Processor time of the loop's thread (Linux; 0 on other systems)."""
    wall_s: float
    """Time in s since the start of the loop."""
    num_samples: int
    """Number of samples of the hand that the loop received from another process."""
    num_refused: int
    """Number of samples that the loop refused as invalid."""
    is_real_time: bool
    """Whether the loop's thread runs before all threads of ordinary programs (Linux, with the user's permission)."""
    max_force_n: float
    """Largest force on the hand since the start, N."""
    max_change_n: float
    """Largest change of the force between two ticks, N."""


class ForceLoop:
    """The force law, evaluated 1,000 times a second on its own thread from construction to `stop`.

    A context manager that ends the loop. While the loop runs, pictures are rendered by one thread less.

    Parameters
    ----------
    field
        Signed distance to the wall.
    law
        Parameters of the force law.
    path_lps
        (n, 3) path that guidance pulls towards.
    udp_port
        UDP port of 127.0.0.1 for a bridge; 0 takes a free port (`port`).
    lps_from_device
        (4, 4) transform from the bridge's space to LPS: rotation, translation and one scale from 0.05 to 1; no mirror.
    simulated
        A hand that moves without a device, for tests and benchmarks: centre (LPS mm), radius (mm), turns per second.

    Raises
    ------
    UsageError
        If a number is out of range or the port is in use (code ``scope.force``).

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
        self._core = _force.ForceLoop(
            field.to_bytes(), self._law.numbers, path, udp_port=udp_port, simulated=simulated, lps_from_device=matrix
        )
        self._thread = ExitStack()
        self._thread.enter_context(reserved_thread())

    def __repr__(self) -> str:
        """Return a short description for the interpreter."""
        return f"ForceLoop({self._law!r}, port={self.port})"

    def __enter__(self) -> Self:
        """Return the object itself; the loop already runs."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop the loop at the end of the ``with`` block."""
        self.stop()

    @property
    def law(self) -> ForceLaw:
        """Parameters of the force law that the loop applies."""
        return self._law

    @property
    def port(self) -> int | None:
        """UDP port of the loop; None without UDP."""
        return self._core.port

    def put(
        self,
        at_lps: Sequence[float],
        velocity_mm_s: Sequence[float] = (0.0, 0.0, 0.0),
        forward_lps: Sequence[float] = (0.0, 0.0, -1.0),
    ) -> bool:
        """Pass a sample to the loop: position of the tip (LPS mm), velocity, direction; return False if invalid.

        A sample is invalid if a number is not finite or impossible for a hand.
        """
        return self._core.put(list(at_lps), list(velocity_mm_s), list(forward_lps))

    def felt(self) -> HandForce:
        """Return the force of the latest tick."""
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
        """Return the timing statistics since the start."""
        found = self._core.figures()
        values: dict[str, Any] = {n: tuple(v) if isinstance(v, list) else v for n, v in found.items()}
        return ForceFigures(**values)

    def stop(self) -> None:
        """Stop the loop and wait for its thread; a second call does nothing."""
        self._core.stop()
        self._thread.close()


def forces_along(field: WallField, samples: ArrayLike, law: ForceLaw | None = None) -> NDArray[np.float64]:
    """Return the forces of a recorded movement, without thread and clock; equal samples give equal forces.

    Parameters
    ----------
    field
        Signed distance to the wall.
    samples
        (n, 9), one row per millisecond: centre of the tip (LPS mm), velocity (mm/s) and direction (unit length).
        A row with invalid numbers counts as a missing sample.
    law
        Parameters of the force law.

    Returns
    -------
    numpy.ndarray
        (n, 3) N, LPS.

    Raises
    ------
    UsageError
        If a parameter of the law is out of range, or the samples have another shape (code ``scope.force``).

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
    return _force.forces_along(field.to_bytes(), (law or ForceLaw()).numbers, rows)
