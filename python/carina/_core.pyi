"""Types of the compiled module; contracts are in the Python facade, algorithms in the crates' documentation."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

def build_info() -> dict[str, Any]:
    """version, profile, simd, threads, target."""

# ---- scope ----

class FlightCurve:
    """A smooth curve with camera frames along a polyline."""

    def __new__(
        cls, points_lps: NDArray[np.float64], up_lps: tuple[float, ...] | None, max_deviation_mm: float
    ) -> FlightCurve: ...
    @property
    def length_mm(self) -> float: ...
    def pose_at(self, path_mm: float) -> NDArray[np.float64]:
        """lps_from_camera, 4x4."""
    def nearest(self, point_lps: tuple[float, float, float]) -> tuple[float, float]:
        """(path_mm, distance_mm)."""
    def knots_lps(self) -> NDArray[np.float64]:
        """(m, 3), a copy."""
