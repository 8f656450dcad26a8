"""Types of the compiled module.

The Python modules that use it document the contracts, the crates document the algorithms.
"""

from collections.abc import Callable, Sequence
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from carina.render.appearance import Appearance
from carina.render.decoration import Decoration

def build_info() -> dict[str, Any]:
    """Return version, profile, simd, threads, target and gpu."""

# ---- scope ----

@final
class FlightCurve:
    """Smooth curve along a polyline, with camera frames."""

    def __new__(
        cls, points_lps: NDArray[np.float64], up_lps: tuple[float, ...] | None, max_deviation_mm: float
    ) -> FlightCurve: ...
    @property
    def length_mm(self) -> float: ...
    def pose_at(self, path_mm: float) -> NDArray[np.float64]:
        """Return ``lps_from_camera`` (4, 4) at a position along the path."""
    def nearest(self, point_lps: tuple[float, float, float]) -> tuple[float, float]:
        """Return the nearest position along the path and its distance from the point, both in mm."""
    def knots_lps(self) -> NDArray[np.float64]:
        """Return a copy of the knots (m, 3), LPS mm."""
    def tangent_frames(self) -> NDArray[np.float64]:
        """Return the frames (m, 4, 4) at the knots; +z is the tangent of the curve."""

# ---- scope: the wall and the drive ----

@final
class WallField:
    """Signed distance to the lumen's wall."""

    @staticmethod
    def from_distances(distance_mm_zyx: NDArray[np.float32], lps_from_ijk: NDArray[np.float64]) -> WallField:
        """Create a field from signed distances on a grid."""
    @staticmethod
    def from_mesh(
        vertices_lps: NDArray[np.float64],
        triangles: NDArray[np.uint32],
        spacing_mm: float,
        *,
        cancel: Callable[[], bool] | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> WallField:
        """Create a field from a closed mesh."""
    def distance_mm(self, points_lps: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distances (n,) of points (n, 3), mm."""
    @property
    def num_bytes(self) -> int: ...
    def to_bytes(self) -> bytes:
        """Return grid and samples as little-endian bytes."""
    def digest(self) -> str:
        """Return the BLAKE3 digest of the whole field, hexadecimal."""

@final
class ScopeDrive:
    """Bronchoscope in a lumen."""

    def __new__(
        cls,
        field: WallField,
        sizes: tuple[float, float, float, float, float, float, float],
        path_lps: NDArray[np.float64],
        up_lps: Sequence[float] | None,
    ) -> ScopeDrive: ...
    @property
    def state(self) -> dict[str, Any]: ...
    @property
    def entry_mm(self) -> float: ...
    def drive(self, insertion_mm: float, roll_rad: float, flexion_rad: float, dt_s: float) -> dict[str, Any]:
        """Set the three controls and return the new state."""
    def place(self, path_lps: NDArray[np.float64], insertion_mm: float) -> dict[str, Any]:
        """Place the scope along a path and return the new state."""
    def copy(self) -> ScopeDrive:
        """Return an independent copy in the same position."""
    def shaft_lps(self) -> NDArray[np.float64]:
        """Return a copy of the scope's axis (n, 3), LPS mm."""
    def wall_depths_mm(self) -> tuple[float, float]:
        """Return the depths of tip and shaft in the wall, mm."""

@final
class ReservedThread:
    """Thread that renders no pictures until it is released."""

    def __new__(cls) -> ReservedThread: ...
    def release(self) -> None:
        """Return the thread to the rendering of pictures; a second call does nothing."""

def picture_clock_s() -> float | None:
    """Return the mean processor time of the present picture threads in s; None if unknown."""

def picture_threads() -> int:
    """Return the number of threads that render a picture."""

# ---- phantom ----

def chest_lumen_distances(
    seed: int, generations: int, stenosis: bool, neck: bool, points_lps: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return signed distances (n,) to the lumen in mm, negative in the lumen."""

def generate_chest(
    seed: int,
    spacing_mm: Sequence[float],
    generations: int,
    stenosis: bool,
    nodule: bool,
    noise_hu: float,
    neck: bool,
    tube: str | None,
    resected: str | None,
    box_lps: list[list[float]] | None,
    with_distance: bool,
    proceed: Callable[[float], bool],
) -> dict[str, Any]:
    """Return a dictionary of hu_zyx, lumen_zyx, lps_from_ijk and branches, and of the requested extras.

    Extras: nodule, stenosis, tube, cricoid_lps with upper_airway_zyx, lumen_distance_mm.
    """

# ---- isoregion ----

_Classes = list[tuple[int, int, int, bool]]
"""First value, last value, number of voxels, fully transparent; one entry for each class."""

def value_range(hu_zyx: NDArray[np.int16]) -> tuple[int, int]:
    """Return the smallest and the largest value."""

def content_digest(voxels: NDArray[np.int16] | NDArray[np.uint8]) -> str:
    """Return the BLAKE3 digest of the bytes of a [z, y, x] array, without its shape, hexadecimal."""

def label_classes(
    hu_zyx: NDArray[np.int16], points: NDArray[np.float64], *, reference_mm: float = 1.0, bin_hu: int = 1
) -> tuple[NDArray[np.uint8], _Classes]:
    """Return the labels of the classes of a transfer function, and the classes."""

def label_values(hu_zyx: NDArray[np.int16]) -> tuple[NDArray[np.uint8], _Classes]:
    """Return the labels of the paper's 16-HU bins, and the bins."""

def transparent_runs(
    points: NDArray[np.float64], *, reference_mm: float = 1.0, bin_hu: int = 1
) -> list[tuple[int, int]]:
    """Return the transparent runs of a transfer function over all int16 values."""

def build_radius_map(
    labels_zyx: NDArray[np.uint8],
    *,
    cancel: Callable[[], bool] | None = None,
    simd: str | None = None,
    num_slabs: int | None = None,
) -> NDArray[np.uint8]:
    """Return the radius map of a label volume; the default is one slab for each thread."""

def build_cell_map(
    hu_zyx: NDArray[np.int16],
    runs: Sequence[tuple[int, int]],
    *,
    cancel: Callable[[], bool] | None = None,
    simd: str | None = None,
    num_slabs: int | None = None,
) -> NDArray[np.uint8]:
    """Return the map of cells of disjoint runs of values (first, last), for leaps over clear samples.

    The map is 0 for cells whose values are in no run.
    """

# ---- optics ----

@final
class Optics:
    """Lens in front of a picture of a given size: ``brown`` (k1 k2 p1 p2 k3 k4 k5 k6) or ``fisheye`` (k1 to k4)."""

    def __new__(
        cls,
        model: str,
        coefficients: Sequence[float],
        *,
        width: int,
        height: int,
        fov_rad: float | None = None,
        focal_px: tuple[float, float] | None = None,
        centre_px: tuple[float, float] | None = None,
        calibrated_size_px: tuple[int, int] | None = None,
    ) -> Optics: ...
    def directions(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return unit directions (n, 3) in camera space of points of the picture.

        The directions of points outside the lens model are NaN.
        """

    def pixels(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return points (n, 2) of the picture for directions in camera space.

        The points of directions that the lens cannot see are NaN.
        """

    def rays(self, *, shape: str, edge_px: float, vignette: float) -> LensRays:
        """Return the rays of all pixels inside an outline."""

    @property
    def fov_rad(self) -> float: ...
    @property
    def limit_rad(self) -> float: ...
    @property
    def focal_px(self) -> tuple[float, float]: ...
    @property
    def centre_px(self) -> tuple[float, float]: ...

@final
class LensRays:
    """Rays of all pixels of a picture behind a lens, with the brightness of each pixel."""

def defocus(
    rgb: NDArray[np.uint8],
    depth_mm: NDArray[np.float32],
    *,
    near_mm: float,
    far_mm: float,
    lens: LensRays | None = None,
) -> NDArray[np.uint8]:
    """Return a whole picture (h, w, 3) blurred by its depth (h, w), then darkened by its lens."""

# ---- gpu ----

def gpu_adapters() -> list[tuple[str, str, str, str]] | None:
    """Return name, interface, driver and kind of each adapter, fastest first; None in a build without GPU support."""

@final
class Gpu:
    """Opened graphics device."""

    def __new__(cls, adapter: int) -> Gpu: ...
    def upload(self, hu_zyx: NDArray[np.int16], radius_zyx: NDArray[np.uint8] | None = None) -> GpuScene:
        """Copy a volume and its radius map to the device."""
    def lose(self) -> None:
        """Simulate the loss of the device, for tests."""

@final
class GpuScene:
    """Volume on a graphics device, with or without a radius map."""

    def with_map(self, radius_zyx: NDArray[np.uint8] | None = None) -> GpuScene:
        """Return the same volume with another map, or without a map."""

# ---- raycast ----

@final
class TransferTable:
    """Colour and opacity of one ray step, by value."""

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
        """Return the premultiplied colour and the opacity of one step at a value."""

@final
class CancelToken:
    """Token that cancels one picture from any thread; it stays cancelled."""

    def __new__(cls) -> CancelToken: ...
    def cancel(self) -> None:
        """Cancel the rendering of the picture."""

    @property
    def cancelled(self) -> bool:
        """Whether the token is cancelled."""

@final
class Bricks:
    """Cache for all pictures of one unchanged array of values: slopes of walls, lit samples."""

    def __new__(cls) -> Bricks: ...
    def __len__(self) -> int:
        """Return the number of cached bricks."""

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
    stop: CancelToken | None = None,
    lens: LensRays | None = None,
    darken: bool = True,
    gpu: GpuScene | None = None,
    stop_transparency: float | None = None,
    appearance: Appearance | None = None,
    decoration: Decoration | None = None,
    always_leap: bool = False,
    bricks: Bricks | None = None,
) -> tuple[NDArray[np.uint8], tuple[int, int, int, int, int, int, int]]:
    """Return colours (rows, width, 3), and the counts of the cast.

    The counts are rays, samples, look-ups, leaps, skipped samples, shaded samples and reads. A cancelled cast raises
    CancelledError.
    """

def cast_surface(
    hu_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    table: TransferTable,
    lps_from_camera: NDArray[np.float64],
    *,
    fov_rad: float,
    width: int,
    height: int,
    rows: tuple[int, int] | None = None,
    pixel: tuple[int, int] | None = None,
    nearest: bool = False,
    radius_zyx: NDArray[np.uint8] | None = None,
    simd: str | None = None,
    lens: LensRays | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.float32]]:
    """Return the first walls of rows, or of one pixel (column, row): depth in mm, positions and normals in LPS.

    Pixels without a wall are NaN.
    """

def cut_plane(
    hu_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    lps_from_pixel: NDArray[np.float64],
    *,
    width: int,
    height: int,
    window_hu: tuple[float, float],
    rows: tuple[int, int] | None = None,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return the grey levels of rows of a plane, and the mask of the volume."""

def tri_plane(
    hu_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    centre_lps: tuple[float, float, float],
    lps_from_camera: NDArray[np.float64],
    *,
    fov_rad: float,
    width: int,
    height: int,
    window_hu: tuple[float, float],
    clear_below: float | None = None,
    background: tuple[int, int, int] = ...,
    brightness: tuple[float, float, float] = ...,
    rows: tuple[int, int] | None = None,
) -> NDArray[np.uint8]:
    """Return rows (rows, width, 3) of three planes in occlusion order."""

def radiograph(
    hu_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    lps_from_pixel: NDArray[np.float64],
    *,
    width: int,
    height: int,
    rows: tuple[int, int] | None = None,
    source_lps: tuple[float, float, float] | None = None,
    air: float = ...,
    bone: float = 100.0,
    bone_gain: float = 1.0,
    simd: str | None = None,
) -> NDArray[np.float32]:
    """Return the water-equivalent length (rows, width) of the rays of some rows, mm."""

def sample_lines(
    hu_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    lines: NDArray[np.float64],
    *,
    width: int,
    window_hu: tuple[float, float],
    slab: tuple[float, str] | None = None,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return the grey levels of rows given by start, step and through (rows, 9), and the mask of the volume."""

def project_maximum(
    hu_zyx: NDArray[np.int16],
) -> tuple[NDArray[np.int16], NDArray[np.int16], NDArray[np.int16]]:
    """Return the maximum intensity projections along i [k, j], j [k, i] and k [j, i]."""

def raise_wall(
    values_zyx: NDArray[np.int16],
    lumen_zyx: NDArray[np.uint8],
    part_zyx: Sequence[tuple[int, int]],
    open_below: int,
    heights: Sequence[Sequence[int]],
) -> None:
    """Raise the values of a copy of a volume around a lumen, in place; heights of lumen, shell and backing."""

def smooth_mask(mask_zyx: NDArray[np.uint8]) -> NDArray[np.int16]:
    """Return a smooth field 0..1024 of a mask."""

def best_instruction_set() -> str:
    """Return the name of the instruction set that casters use by default."""

# ---- cross-sections ----

@final
class SectionCasts:
    """Rays of many planes, with the edges that they met."""

    def __len__(self) -> int: ...
    def blur(self) -> tuple[float, float] | None:
        """Return the scan's blur within and across slices, mm; None if too few rays met thick tissue."""
    def measure(self, blur: tuple[float, float] | None) -> dict[str, Any]:
        """Return the measures of all planes.

        centre_lps (n, 3); area, diameters, wall, shift, their errors and shares (n,); edge_mm, outer_mm (n, 64).
        """

def cast_sections(
    values_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    centres_lps: Sequence[Sequence[float]] | NDArray[np.float64],
    normals_lps: Sequence[Sequence[float]] | NDArray[np.float64],
    radius_mm: Sequence[float] | NDArray[np.float64],
    *,
    min_contrast: float,
    brightest_wall: float,
    wall_rise: float,
    noise: float,
    cancel: Callable[[], bool] | None = None,
    progress: Callable[[float], None] | None = None,
) -> SectionCasts:
    """Cast the rays of planes across airways."""

def section_axes(normal_lps: Sequence[float] | NDArray[np.float64]) -> tuple[list[float], list[float]]:
    """Return the two unit vectors that span the plane perpendicular to a direction."""

# ---- airpath ----

def find_trachea_voxels(
    values_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    *,
    air: int,
    tissue: int,
    lung: tuple[int, int] | None,
    cancel: Callable[[], bool] | None = None,
) -> dict[str, Any]:
    """Return a dictionary: voxels_ijk (n, 3) from the top down, diameters_mm (n,), length_mm, carina_lps (3,), doubts.

    The doubts are a list of texts.
    """

def flood_lumen(
    values_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    seeds_ijk: Sequence[tuple[int, int, int]],
    *,
    first_level: int,
    core_level: int,
    last_level: int,
    leak_mm3: float,
    small_leak_mm3: float,
    closed_radius_mm: float,
    min_contrast: float,
    cancel: Callable[[], bool] | None = None,
    progress: Callable[[float], None] | None = None,
) -> tuple[NDArray[np.uint8], dict[str, Any]]:
    """Return the lumen (1 or 0), and num_voxels, num_without_wall, leaks [(point_lps, level)]."""

def lumen_mesh(
    values_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    lumen_zyx: NDArray[np.uint8],
    *,
    levels: tuple[float, float, float] | None,
    cancel: Callable[[], bool] | None = None,
    progress: Callable[[float], None] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.uint32]]:
    """Return a closed mesh: vertices (n, 3) LPS mm, triangles (m, 3), counterclockwise from outside."""

def lumen_mask(
    values_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    lumen_zyx: NDArray[np.uint8],
    *,
    levels: tuple[float, float, float] | None,
) -> NDArray[np.uint8]:
    """Return a mask that is 1 in voxels whose centres lie inside the mesh of `lumen_mesh`."""

@final
class LumenSurface:
    """Surface of one lumen, to be cut by planes; the arrays must not change."""

    def __new__(
        cls,
        values_zyx: NDArray[np.int16],
        lps_from_ijk: NDArray[np.float64],
        lumen_zyx: NDArray[np.uint8],
        *,
        levels: tuple[float, float, float] | None,
    ) -> LumenSurface: ...
    def cut(self, lps_from_pixel: NDArray[np.float64], *, width: int, height: int) -> list[NDArray[np.float64]] | None:
        """Return the lines of the cut in a picture, (n, 2) column and row each; None if they exceed the limit."""

    def encoded(self, lps_from_pixel: NDArray[np.float64], *, width: int, height: int) -> bytes | None:
        """Return the lines of the cut in the encoding of the wire."""

def extend_lumen(
    values_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    lumen_zyx: NDArray[np.uint8],
    *,
    air: float,
    lung: tuple[int, int],
    brightest: int,
    least_rise: float,
    gap_mm: float,
    min_length_mm: float,
    raised: float = 1.0,
    most_reached: float = 1.0,
    least_probability: float = 0.0,
    divided: tuple[int, float, float] | None = None,
    cancel: Callable[[], bool] | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Mark additional lumen by the value 2 in a lumen of 1, in place.

    The result contains num_voxels, num_reached, ran_out, enclosed, followed [points_lps, ...].
    """

def extend_thin_lumen(
    values_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    lumen_zyx: NDArray[np.uint8],
    *,
    air: float,
    lung: tuple[int, int],
    brightest: int,
    least_wall: float,
    least_dip: float,
    kept_dip: float,
    blur_mm: float,
    min_length_mm: float,
    min_side_mm: float,
    most_reached: float,
    cancel: Callable[[], bool] | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Mark additional thin lumen by the value 2 in a lumen of 1, in place.

    The result contains num_reached, ran_out, followed [points_lps, length_mm, contrast].
    """

def find_pieces_of_air(
    values_zyx: NDArray[np.int16],
    lumen_zyx: NDArray[np.uint8],
    *,
    darkest: int,
    box_ijk: tuple[tuple[int, int, int], tuple[int, int, int]],
    least_neighbours: int,
    voxels: tuple[int, int],
    most_air: int,
) -> list[NDArray[np.int64]]:
    """Return indices, in the flat volume, of the pieces of air without a common face with the lumen, largest first."""

def mix_with_blurs(
    values_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    *,
    own: float,
    blurs: Sequence[tuple[float, float]],
    axes_ijk: tuple[bool, bool, bool],
) -> NDArray[np.int16]:
    """Return ``own`` times each value plus blurs of the volume (weight, sigma in mm) along the chosen axes."""

def keep_cut_off_air_of(
    sharp_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    soft_zyx: NDArray[np.int16],
    *,
    floor: int,
    air: int,
    certain: int,
    rise: int,
    seam_mm: float,
) -> int:
    """Set to air, in place, airway lumen that a sharp volume cuts off at its floor; return the number of voxels."""

@final
class GraphTracker:
    """Graph with a cost, and the least-cost tree from one root."""

    def __new__(
        cls,
        values_zyx: NDArray[np.int16],
        lps_from_ijk: NDArray[np.float64],
        *,
        cost: str,
        labels: str | None,
        box_ijk: tuple[tuple[int, int, int], tuple[int, int, int]],
        lumen_zyx: NDArray[np.uint8] | None,
        levels: tuple[float, float, float] | None,
        root_lps: tuple[float, float, float],
        reach_mm: float,
        cancel: Callable[[], bool] | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> GraphTracker: ...
    @property
    def build_s(self) -> float: ...
    @property
    def num_nodes(self) -> int: ...
    @property
    def num_centres(self) -> int: ...
    @property
    def num_settled(self) -> int: ...
    @property
    def quantum(self) -> float: ...
    @property
    def root(self) -> int: ...
    def num_edges(self) -> int:
        """Count the undirected edges one by one and return their number."""
    def place(
        self, point_lps: tuple[float, float, float], reach_mm: float
    ) -> tuple[int, tuple[float, float, float], float] | None:
        """Return the node for a point, the centre of the voxel used, and its distance from the node in mm."""
    def solve_to(
        self,
        node: int,
        *,
        cancel: Callable[[], bool] | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> bool:
        """Solve until a node is settled; return whether a path to it exists."""
    def cost(self, node: int) -> float | None:
        """Return the least cost of a settled node; None if it is not settled."""
    def path(self, node: int) -> tuple[NDArray[np.float64], NDArray[np.uint32]] | None:
        """Return the voxel centres (n, 3) LPS of the path from the root, and their nodes."""

@final
class LumenTracker:
    """Graph of a lumen, and the least-cost tree from one root."""

    def __new__(
        cls,
        values_zyx: NDArray[np.int16],
        lps_from_ijk: NDArray[np.float64],
        lumen_zyx: NDArray[np.uint8],
        *,
        levels: tuple[float, float, float] | None,
        root_lps: tuple[float, float, float],
        reach_mm: float,
    ) -> LumenTracker: ...
    @property
    def num_nodes(self) -> int: ...
    @property
    def num_settled(self) -> int: ...
    @property
    def quantum(self) -> float: ...
    @property
    def root(self) -> int: ...
    def nearest(self, point_lps: tuple[float, float, float], reach_mm: float) -> tuple[int, float] | None:
        """Return the nearest node and its distance in mm."""
    def solve_to(
        self,
        node: int,
        *,
        cancel: Callable[[], bool] | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> bool:
        """Solve until a node is settled; return whether a path to it exists."""
    def solve_all(
        self, *, cancel: Callable[[], bool] | None = None, progress: Callable[[float], None] | None = None
    ) -> None:
        """Settle all reachable nodes."""
    def cost(self, node: int) -> float | None:
        """Return the least cost of a settled node; None if it is not settled."""
    def path(self, node: int) -> tuple[NDArray[np.float64], NDArray[np.uint32]] | None:
        """Return the voxel centres (n, 3) LPS of the path from the root, and their nodes."""
    def smooth(
        self, points_lps: Sequence[tuple[float, float, float]] | NDArray[np.float64], *, step_mm: float, keep_end: bool
    ) -> NDArray[np.float64]:
        """Return smooth points (n, 3) at even steps that stay in lumen voxels."""
    def radius_mm(self, points_lps: Sequence[tuple[float, float, float]] | NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distances (n,) to the wall, mm."""
    def section_radii(
        self, lines_lps: Sequence[NDArray[np.float64]], parents: Sequence[int | None], wanted: Sequence[bool]
    ) -> list[NDArray[np.float64] | None]:
        """Return, for each selected branch, the radius (n,) of the circle with the area of the lumen's section."""
    def inside(self, points_lps: Sequence[tuple[float, float, float]] | NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether the voxel of each point is lumen (n,)."""
    def branches(
        self, *, cancel: Callable[[], bool] | None = None, progress: Callable[[float], None] | None = None
    ) -> list[dict[str, Any]]:
        """Return parent, generation, points, radius_mm, wall_mm, cost and nodes of each branch, parents first."""
    def branches_to(
        self,
        nodes: Sequence[int],
        branch_nodes: Sequence[NDArray[np.uint32]],
        parents: Sequence[int | None],
    ) -> list[dict[str, Any]]:
        """Return the part of the automatic tree that leads to settled nodes."""
    def branch_of_nodes(
        self, branch_nodes: Sequence[NDArray[np.uint32]], parents: Sequence[int | None]
    ) -> NDArray[np.int32]:
        """Return the branch (num_nodes,) in whose tube each node lies; -1 for nodes that are connected to none."""

def edit_lumen(
    tracker: LumenTracker,
    values_zyx: NDArray[np.int16],
    added_ijk: NDArray[np.uint16],
    removed_ijk: NDArray[np.uint16],
    *,
    cancel: Callable[[], bool] | None = None,
) -> tuple[LumenTracker, tuple[tuple[int, int, int], tuple[int, int, int]] | None]:
    """Return the tracker of a lumen with voxels added and removed, and the changed box (first, shape)."""

def fresh_lumen(
    tracker: LumenTracker,
    values_zyx: NDArray[np.int16],
    lumen_zyx: NDArray[np.uint8],
    root_ijk: tuple[int, int, int],
    *,
    cancel: Callable[[], bool] | None = None,
) -> LumenTracker:
    """Return a new tracker of a whole lumen, with the wall levels of another tracker."""

def reroot_lumen(
    tracker: LumenTracker, root_ijk: tuple[int, int, int], *, cancel: Callable[[], bool] | None = None
) -> LumenTracker:
    """Return the tracker of the same lumen with another root."""

def lumen_array(tracker: LumenTracker) -> NDArray[np.uint8]:
    """Return an array (nz, ny, nx) that is 1 inside the lumen."""

def lumen_states(
    tracker: LumenTracker, first_ijk: tuple[int, int, int], shape_ijk: tuple[int, int, int]
) -> NDArray[np.uint8]:
    """Return the states (nz, ny, nx) of a box: 0 no lumen, 1 lumen that no path reaches, 2 lumen."""

def nodes_at(tracker: LumenTracker, points_lps: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the node (n,) whose voxel contains each point; -1 outside the lumen."""

def voxels_of(tracker: LumenTracker, nodes_of: NDArray[np.uint32]) -> NDArray[np.uint16]:
    """Return the voxels (n, 3) of nodes."""

def reached(tracker: LumenTracker, nodes_of: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Return whether a path reaches each node (n,)."""

def sees(tracker: LumenTracker, from_lps: NDArray[np.float64], to_lps: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return whether the straight line between two points stays in lumen voxels (n,)."""

def pulled_inside(tracker: LumenTracker, points_lps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the points (n, 3), with each outside point moved to the nearest position inside the lumen."""

def newly_reached(tracker: LumenTracker, other: LumenTracker) -> NDArray[np.uint16]:
    """Return the voxels (n, 3) that a path reaches in one tracker and not in the other."""

def cut_voxels(tracker: LumenTracker, cut: NDArray[np.uint32], kept: NDArray[np.uint32]) -> NDArray[np.uint16]:
    """Return the voxels (n, 3) in the tubes of a cut piece instead of the kept tree; nodes are on centrelines."""

def more_tips(
    tracker: LumenTracker,
    tree_nodes: NDArray[np.uint32],
    candidates_ijk: NDArray[np.uint16],
    *,
    cancel: Callable[[], bool] | None = None,
) -> NDArray[np.uint32]:
    """Return the tips (n,) of branches among candidate voxels that a tree does not contain, longest path first."""

def cheapest_way(
    weights_zyx: NDArray[np.float32],
    goals_zyx: NDArray[np.uint8],
    spacing_mm: tuple[float, float, float],
    start_ijk: tuple[int, int, int],
    *,
    cancel: Callable[[], bool] | None = None,
) -> NDArray[np.uint16] | None:
    """Return the voxels (n, 3) of a box on the least-cost path from the nearest goal to a start.

    Weights are per mm; a voxel of weight 0 is closed.
    """

# ---- evidence of airways ----

@final
class Enclosures:
    """Volume without its finest noise, for the measure of how brighter voxels enclose a voxel."""

    def __new__(cls, values_zyx: NDArray[np.int16], lps_from_ijk: NDArray[np.float64]) -> Enclosures: ...
    def at(self, voxels_ijk: NDArray[np.uint16]) -> NDArray[np.int16]:
        """Return the rise (n,) of the values on all but a fifth of 48 rays of 3 mm from each voxel."""

    def values_at(self, points_lps: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return trilinear values (n,) without the finest noise at points (n, 3), clamped to the edge."""

    def runs(
        self,
        starts_ijk: NDArray[np.uint16],
        *,
        away_mm: float,
        enclosed: float,
        dark: float,
        bright: float,
        closed: float,
    ) -> list[NDArray[np.uint16] | None]:
        """Return for each voxel (n, 3) the path with most wall to any point this far away: voxels (m, 3), or None."""

    def way(
        self,
        tracker: LumenTracker,
        start_ijk: tuple[int, int, int],
        toward_ijk: tuple[int, int, int],
        *,
        enclosed: float,
        dark: float,
        bright: float,
        closed: float,
        cancel: Callable[[], bool] | None = None,
    ) -> NDArray[np.uint16] | None:
        """Return the voxels (n, 3) of the path with most wall, from a lumen that a path reaches.

        The result is None if there is no such path.
        """

# ---- tracker over a volume of weights ----

@final
class FieldTracker:
    """Least-cost tree in a volume of weights."""

    def __new__(
        cls,
        field_zyx: NDArray[np.float32],
        lps_from_ijk: NDArray[np.float64],
        root_ijk: tuple[int, int, int],
        *,
        cost: str,
        region_ijk: tuple[tuple[int, int], tuple[int, int], tuple[int, int]] | None = None,
        mask_zyx: NDArray[np.uint8] | None = None,
    ) -> FieldTracker: ...
    @property
    def num_settled(self) -> int: ...
    @property
    def num_open(self) -> int: ...
    @property
    def quantum(self) -> float: ...
    @property
    def num_bytes(self) -> tuple[int, int]: ...
    def solve_to(
        self,
        target_ijk: tuple[int, int, int],
        *,
        cancel: Callable[[], bool] | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> bool:
        """Solve until a voxel is settled; return whether a path to it exists."""
    def solve_all(
        self, *, cancel: Callable[[], bool] | None = None, progress: Callable[[float], None] | None = None
    ) -> None:
        """Settle all reachable voxels."""
    def cost(self, target_ijk: tuple[int, int, int]) -> float | None:
        """Return the least cost of a settled voxel; None if it is not settled."""
    def path(self, target_ijk: tuple[int, int, int]) -> NDArray[np.int64] | None:
        """Return the voxels (n, 3) i, j, k of the path from the root."""
    def time_paths(self, targets_ijk: Sequence[tuple[int, int, int]]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return the time (ns) and the number of voxels of each path."""

def aimed_field_path(
    field_zyx: NDArray[np.float32],
    lps_from_ijk: NDArray[np.float64],
    root_ijk: tuple[int, int, int],
    target_ijk: tuple[int, int, int],
    *,
    cost: str,
    region_ijk: tuple[tuple[int, int], tuple[int, int], tuple[int, int]] | None = None,
    mask_zyx: NDArray[np.uint8] | None = None,
    cancel: Callable[[], bool] | None = None,
    progress: Callable[[float], None] | None = None,
) -> tuple[NDArray[np.int64], float, int] | None:
    """Return voxels (n, 3) i, j, k from the root to one target, cost, number of settled voxels; None without a path."""

def time_lumen_paths(
    tracker: LumenTracker, nodes: Sequence[int] | NDArray[np.uint32]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the time (ns) and the number of voxels of each path."""
