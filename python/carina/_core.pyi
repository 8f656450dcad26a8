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

# ---- isoregion ----

Classes = list[tuple[int, int, int, bool]]
"""First value, last value, voxels, fully transparent."""

def label_classes(
    hu_zyx: NDArray[np.int16], points: NDArray[np.float64], *, reference_mm: float = 1.0, bin_hu: int = 1
) -> tuple[NDArray[np.uint8], Classes]:
    """Labels of the classes of a transfer function, and the classes."""

def label_values(hu_zyx: NDArray[np.int16]) -> tuple[NDArray[np.uint8], Classes]:
    """Labels of the paper's 16-HU bins, and the bins."""

def transparent_runs(
    points: NDArray[np.float64], *, reference_mm: float = 1.0, bin_hu: int = 1
) -> list[tuple[int, int]]:
    """The transparent runs of a transfer function over all int16 values."""

def build_radius_map(labels_zyx: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The radius map of a label volume."""

def build_transparent_map(
    hu_zyx: NDArray[np.int16], points: NDArray[np.float64], *, reference_mm: float = 1.0, bin_hu: int = 1
) -> NDArray[np.uint8]:
    """The radius map of the transparent classes of a transfer function; 0 elsewhere."""

# ---- raycast ----

class TransferTable:
    """What one ray step adds, by value."""

    def __new__(
        cls,
        points: NDArray[np.float64],
        *,
        reference_mm: float,
        step_mm: float,
        lo: int,
        hi: int,
        bin_hu: int = 1,
    ) -> TransferTable: ...
    def entry(self, value: int) -> list[float]:
        """Premultiplied colour and opacity of one step at a value."""

def cast(
    hu_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    table: TransferTable,
    lps_from_camera: NDArray[np.float64],
    *,
    fov_rad: float,
    width: int,
    height: int,
    rows: tuple[int, int] | None = None,
    light: tuple[float, float, float, int, float] | None = None,
    nearest: bool = False,
    background: tuple[float, float, float] = ...,
    leap: NDArray[np.uint8] | tuple[NDArray[np.uint8], NDArray[np.uint8], list[int]] | None = None,
    simd: str | None = None,
) -> tuple[NDArray[np.uint8], tuple[int, int, int, int, int]]:
    """(rows, width, 3) colours and rays, samples, look-ups, leaps, skipped samples."""

def cut_plane(
    hu_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    lps_from_pixel: NDArray[np.float64],
    *,
    width: int,
    height: int,
    window_hu: tuple[float, float],
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Grey levels of a plane and where the volume is."""

def tri_plane(
    hu_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    center_lps: tuple[float, float, float],
    lps_from_camera: NDArray[np.float64],
    *,
    fov_rad: float,
    width: int,
    height: int,
    window_hu: tuple[float, float],
    clear_below: float | None = None,
    background: tuple[int, int, int] = ...,
    brightness: tuple[float, float, float] = ...,
) -> NDArray[np.uint8]:
    """Three planes in occlusion order, (height, width, 3)."""

def project_maximum(
    hu_zyx: NDArray[np.int16],
) -> tuple[NDArray[np.int16], NDArray[np.int16], NDArray[np.int16]]:
    """Maximum intensity projections along i [k, j], j [k, i] and k [j, i]."""

def smooth_mask(mask_zyx: NDArray[np.uint8]) -> NDArray[np.int16]:
    """A smooth field 0..1024 from a mask."""

def best_instruction_set() -> str:
    """Name of the instruction set that casters use unless told."""
