from collections.abc import Sequence
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

@final
class ForceLoop:
    """Loop that evaluates the force law 1,000 times a second on its own thread."""

    def __new__(
        cls,
        wall: bytes,
        numbers: tuple[float, float, float, float, float, float, float],
        path_lps: NDArray[np.float64],
        *,
        udp_port: int | None = None,
        simulated: tuple[Sequence[float], float, float] | None = None,
        lps_from_device: NDArray[np.float64] | None = None,
    ) -> ForceLoop: ...
    @property
    def port(self) -> int | None: ...
    def put(self, at_lps: Sequence[float], velocity_mm_s: Sequence[float], forward_lps: Sequence[float]) -> bool:
        """Pass a sample; return False if it is rejected."""
    def felt(self) -> dict[str, Any]:
        """Return the latest force."""
    def figures(self) -> dict[str, Any]:
        """Return the timing statistics."""
    def stop(self) -> None:
        """Stop the loop."""

def forces_along(
    wall: bytes,
    numbers: tuple[float, float, float, float, float, float, float],
    samples: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return forces (n, 3) of samples (n, 9), one per millisecond."""

def force_limits() -> tuple[float, float, float]:
    """Return the limits of the force law: N, N per ms, N per mm."""
