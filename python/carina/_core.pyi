"""Types of the compiled module; contracts are in the Python facade, algorithms in the crates' documentation."""

from collections.abc import Callable, Sequence
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from carina.render.appearance import Appearance
from carina.render.decoration import Decoration

def build_info() -> dict[str, Any]:
    """version, profile, simd, threads, target, gpu."""

# ---- scope ----

@final
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
    def tangent_frames(self) -> NDArray[np.float64]:
        """(m, 4, 4), at the knots: +z is the curve's own direction."""

# ---- scope: the wall and the drive ----

@final
class WallField:
    """Signed distance to the lumen's wall."""

    @staticmethod
    def from_distances(distance_mm_zyx: NDArray[np.float32], lps_from_ijk: NDArray[np.float64]) -> WallField:
        """From a grid."""
    @staticmethod
    def from_mesh(
        vertices_lps: NDArray[np.float64],
        triangles: NDArray[np.uint32],
        spacing_mm: float,
        *,
        cancel: Callable[[], bool] | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> WallField:
        """From a closed mesh."""
    def distance_mm(self, points_lps: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) of (n, 3)."""
    @property
    def num_bytes(self) -> int: ...
    def to_bytes(self) -> bytes:
        """Lattice and samples, little-endian."""
    def digest(self) -> str:
        """BLAKE3 of all that it holds, hexadecimal."""

@final
class ScopeDrive:
    """A scope in a lumen."""

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
        """Set the controls."""
    def place(self, path_lps: NDArray[np.float64], insertion_mm: float) -> dict[str, Any]:
        """Lay along a path."""
    def copy(self) -> ScopeDrive:
        """Another that lies as this one does."""
    def shaft_lps(self) -> NDArray[np.float64]:
        """(n, 3), a copy."""
    def wall_depths_mm(self) -> tuple[float, float]:
        """(tip, shaft)."""

@final
class ReservedThread:
    """A thread that renders no pictures until it is released."""

    def __new__(cls) -> ReservedThread: ...
    def release(self) -> None:
        """Let pictures use the thread again; a second call does nothing."""

def picture_clock_s() -> float | None:
    """Mean processor time of the threads which make pictures now, in s; None where it cannot be told (yet)."""

def picture_threads() -> int:
    """Number of threads that render a picture."""

# ---- phantom ----

def chest_lumen_distances(
    seed: int, generations: int, stenosis: bool, neck: bool, points_lps: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n,) signed mm, negative in the lumen."""

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
    """hu_zyx, lumen_zyx, lps_from_ijk, branches, and what else was asked for: nodule, stenosis, tube, cricoid_lps with
    upper_airway_zyx, lumen_distance_mm."""

# ---- isoregion ----

_Classes = list[tuple[int, int, int, bool]]
"""First value, last value, voxels, fully transparent."""

def value_range(hu_zyx: NDArray[np.int16]) -> tuple[int, int]:
    """The smallest and the largest value."""

def content_digest(voxels: NDArray[np.int16] | NDArray[np.uint8]) -> str:
    """BLAKE3 over the bytes of a [z, y, x] array, hexadecimal; not of its shape."""

def label_classes(
    hu_zyx: NDArray[np.int16], points: NDArray[np.float64], *, reference_mm: float = 1.0, bin_hu: int = 1
) -> tuple[NDArray[np.uint8], _Classes]:
    """Labels of the classes of a transfer function, and the classes."""

def label_values(hu_zyx: NDArray[np.int16]) -> tuple[NDArray[np.uint8], _Classes]:
    """Labels of the paper's 16-HU bins, and the bins."""

def transparent_runs(
    points: NDArray[np.float64], *, reference_mm: float = 1.0, bin_hu: int = 1
) -> list[tuple[int, int]]:
    """The transparent runs of a transfer function over all int16 values."""

def build_radius_map(
    labels_zyx: NDArray[np.uint8],
    *,
    cancel: Callable[[], bool] | None = None,
    simd: str | None = None,
    num_slabs: int | None = None,
) -> NDArray[np.uint8]:
    """The radius map of a label volume; one slab for each thread unless told."""

def build_cell_map(
    hu_zyx: NDArray[np.int16],
    runs: Sequence[tuple[int, int]],
    *,
    cancel: Callable[[], bool] | None = None,
    simd: str | None = None,
    num_slabs: int | None = None,
) -> NDArray[np.uint8]:
    """The map of cells of disjoint runs of values (first, last), which leaps over clear samples read; 0 where a
    value is in none."""

# ---- optics ----

@final
class Optics:
    """A lens in front of a picture of a size; ``brown`` (k1 k2 p1 p2 k3 k4 k5 k6) or ``fisheye`` (k1 to k4)."""

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
        """Unit directions (n, 3) in camera space of points of the picture; NaN where the lens has none."""

    def pixels(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points of the picture (n, 2) of directions in camera space; NaN where the lens does not see them."""

    def rays(self, *, shape: str, edge_px: float, vignette: float) -> LensRays:
        """The rays of all pixels inside an outline."""

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
    """The rays of all pixels of a picture behind a lens, and how bright each pixel is."""

def defocus(
    rgb: NDArray[np.uint8],
    depth_mm: NDArray[np.float32],
    *,
    near_mm: float,
    far_mm: float,
    lens: LensRays | None = None,
) -> NDArray[np.uint8]:
    """A whole picture (h, w, 3) blurred by its depth (h, w), then darkened by its lens."""

# ---- gpu ----

def gpu_adapters() -> list[tuple[str, str, str, str]] | None:
    """Name, interface, driver and kind, the likely fastest first; None in a build without GPU support."""

@final
class Gpu:
    """An opened graphics device."""

    def __new__(cls, adapter: int) -> Gpu: ...
    def upload(self, hu_zyx: NDArray[np.int16], radius_zyx: NDArray[np.uint8] | None = None) -> GpuScene:
        """Copy a volume to the device, and its radius map."""
    def lose(self) -> None:
        """Give the device up, for tests."""

@final
class GpuScene:
    """A volume on a graphics device, with a radius map or without."""

    def with_map(self, radius_zyx: NDArray[np.uint8] | None = None) -> GpuScene:
        """The same volume with another map, or without one."""

# ---- raycast ----

@final
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

@final
class CancelToken:
    """Gives up a picture under way, from any thread; for one picture, since it stays set."""

    def __new__(cls) -> CancelToken: ...
    def cancel(self) -> None:
        """The picture is no longer wanted."""

    @property
    def cancelled(self) -> bool:
        """Whether it was cancelled."""

@final
class Bricks:
    """What pictures of one array of values share, which must not change: slopes of walls, lit samples."""

    def __new__(cls) -> Bricks: ...
    def __len__(self) -> int:
        """Bricks kept."""

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
    """(rows, width, 3) colours; rays, samples, look-ups, leaps, skipped samples, shaded samples, reads.

    CancelledError once stopped.
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
    """First walls of rows, or of one pixel (column, row): depth in mm, positions and normals in LPS; NaN for none."""

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
    """Grey levels of rows of a plane and where the volume is."""

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
    """Rows of three planes in occlusion order, (rows, width, 3)."""

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
    """Water-equivalent length of each ray of some rows, (rows, width) mm."""

def sample_lines(
    hu_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    lines: NDArray[np.float64],
    *,
    width: int,
    window_hu: tuple[float, float],
    slab: tuple[float, str] | None = None,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Grey levels of rows of start, step and through, (rows, 9), and where the volume is."""

def project_maximum(
    hu_zyx: NDArray[np.int16],
) -> tuple[NDArray[np.int16], NDArray[np.int16], NDArray[np.int16]]:
    """Maximum intensity projections along i [k, j], j [k, i] and k [j, i]."""

def raise_wall(
    values_zyx: NDArray[np.int16],
    lumen_zyx: NDArray[np.uint8],
    part_zyx: Sequence[tuple[int, int]],
    open_below: int,
    heights: Sequence[Sequence[int]],
) -> None:
    """Raises the values of a copy of a volume round a lumen, in place; heights of lumen, shell, backing."""

def smooth_mask(mask_zyx: NDArray[np.uint8]) -> NDArray[np.int16]:
    """A smooth field 0..1024 from a mask."""

def best_instruction_set() -> str:
    """Name of the instruction set that casters use unless told."""

# ---- cross-sections ----

@final
class SectionCasts:
    """Rays of many planes and the edges they met."""

    def __len__(self) -> int: ...
    def blur(self) -> tuple[float, float] | None:
        """The scan's blur within and across slices, mm; None where too few rays met thick tissue."""
    def measure(self, blur: tuple[float, float] | None) -> dict[str, Any]:
        """centre_lps (n, 3); area, diameters, wall, shift, their errors and shares (n,); edge_mm, outer_mm (n, 64)."""

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
    """The two unit vectors that span the plane across a direction."""

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
    """voxels_ijk (n, 3) from the top down, diameters_mm (n,), length_mm, carina_lps (3,), doubts (list of words)."""

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
    """The lumen (1 or 0), and num_voxels, num_without_wall, leaks [(point_lps, level)]."""

def lumen_mesh(
    values_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    lumen_zyx: NDArray[np.uint8],
    *,
    levels: tuple[float, float, float] | None,
    cancel: Callable[[], bool] | None = None,
    progress: Callable[[float], None] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.uint32]]:
    """Closed mesh: vertices (n, 3) LPS mm, triangles (m, 3), counterclockwise from outside."""

def lumen_mask(
    values_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    lumen_zyx: NDArray[np.uint8],
    *,
    levels: tuple[float, float, float] | None,
) -> NDArray[np.uint8]:
    """Voxels whose centres lie inside that mesh, 1 inside."""

@final
class LumenSurface:
    """The surface of one lumen, to be cut by planes; the arrays must not change."""

    def __new__(
        cls,
        values_zyx: NDArray[np.int16],
        lps_from_ijk: NDArray[np.float64],
        lumen_zyx: NDArray[np.uint8],
        *,
        levels: tuple[float, float, float] | None,
    ) -> LumenSurface: ...
    def cut(self, lps_from_pixel: NDArray[np.float64], *, width: int, height: int) -> list[NDArray[np.float64]] | None:
        """Lines in a picture, (n, 2) column and row each; None where there are more than can be shown."""

    def encoded(self, lps_from_pixel: NDArray[np.float64], *, width: int, height: int) -> bytes | None:
        """The same as the wire has it."""

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
    """Adds 2 to a lumen of 1 in place; num_voxels, num_reached, ran_out, enclosed, followed [points_lps, ...]."""

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
    """Adds 2 to a lumen of 1 in place; num_reached, ran_out, followed [points_lps, length_mm, contrast]."""

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
    """Places in the flat volume of the pieces of air that share no face with the lumen, the largest piece first."""

def mix_with_blurs(
    values_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    *,
    own: float,
    blurs: Sequence[tuple[float, float]],
    axes_ijk: tuple[bool, bool, bool],
) -> NDArray[np.int16]:
    """``own`` times each value, and blurs of the volume (weight, sigma in mm) along the chosen axes."""

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
    """Makes air, in place, of airways' lumen that a sharp volume has cut off at its floor; how many voxels."""

@final
class GraphTracker:
    """A graph with a cost, and the least-cost tree from one root."""

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
        """Undirected edges, counted one by one."""
    def place(
        self, point_lps: tuple[float, float, float], reach_mm: float
    ) -> tuple[int, tuple[float, float, float], float] | None:
        """Node, centre of the voxel taken for the point, mm from there to the node."""
    def solve_to(
        self,
        node: int,
        *,
        cancel: Callable[[], bool] | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> bool:
        """True if a path exists."""
    def cost(self, node: int) -> float | None:
        """Least cost of a settled node."""
    def path(self, node: int) -> tuple[NDArray[np.float64], NDArray[np.uint32]] | None:
        """Voxel centres (n, 3) LPS from the root, and their nodes."""

@final
class LumenTracker:
    """Lumen graph and least-cost tree from one root."""

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
        """Nearest node and its distance in mm."""
    def solve_to(
        self,
        node: int,
        *,
        cancel: Callable[[], bool] | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> bool:
        """True if a path exists."""
    def solve_all(
        self, *, cancel: Callable[[], bool] | None = None, progress: Callable[[float], None] | None = None
    ) -> None:
        """Settle everything reachable."""
    def cost(self, node: int) -> float | None:
        """Least cost of a settled node."""
    def path(self, node: int) -> tuple[NDArray[np.float64], NDArray[np.uint32]] | None:
        """Voxel centres (n, 3) LPS from the root, and their nodes."""
    def smooth(
        self, points_lps: Sequence[tuple[float, float, float]] | NDArray[np.float64], *, step_mm: float, keep_end: bool
    ) -> NDArray[np.float64]:
        """Even, smooth (n, 3) points that stay in lumen voxels."""
    def radius_mm(self, points_lps: Sequence[tuple[float, float, float]] | NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) distance to the wall."""
    def section_radii(
        self, lines_lps: Sequence[NDArray[np.float64]], parents: Sequence[int | None], wanted: Sequence[bool]
    ) -> list[NDArray[np.float64] | None]:
        """For each wanted branch, (n,) radius of the circle with the area of the lumen across it."""
    def inside(self, points_lps: Sequence[tuple[float, float, float]] | NDArray[np.float64]) -> NDArray[np.bool_]:
        """(n,) whether the voxel is lumen."""
    def branches(
        self, *, cancel: Callable[[], bool] | None = None, progress: Callable[[float], None] | None = None
    ) -> list[dict[str, Any]]:
        """parent, generation, points, radius_mm, wall_mm, cost, nodes; parents first."""
    def branches_to(
        self,
        nodes: Sequence[int],
        branch_nodes: Sequence[NDArray[np.uint32]],
        parents: Sequence[int | None],
    ) -> list[dict[str, Any]]:
        """The part of the automatic tree that leads to settled nodes."""
    def branch_of_nodes(
        self, branch_nodes: Sequence[NDArray[np.uint32]], parents: Sequence[int | None]
    ) -> NDArray[np.int32]:
        """(num_nodes,) branch in whose tube each node lies, -1 where none is connected to it."""

def edit_lumen(
    tracker: LumenTracker,
    values_zyx: NDArray[np.int16],
    added_ijk: NDArray[np.uint16],
    removed_ijk: NDArray[np.uint16],
    *,
    cancel: Callable[[], bool] | None = None,
) -> tuple[LumenTracker, tuple[tuple[int, int, int], tuple[int, int, int]] | None]:
    """The tracker of a lumen with voxels added and taken away, and the box (first, shape) of what changed in it."""

def fresh_lumen(
    tracker: LumenTracker,
    values_zyx: NDArray[np.int16],
    lumen_zyx: NDArray[np.uint8],
    root_ijk: tuple[int, int, int],
    *,
    cancel: Callable[[], bool] | None = None,
) -> LumenTracker:
    """The tracker of a whole lumen from scratch, with the wall levels of another one."""

def reroot_lumen(
    tracker: LumenTracker, root_ijk: tuple[int, int, int], *, cancel: Callable[[], bool] | None = None
) -> LumenTracker:
    """The tracker of the same lumen with another root."""

def lumen_array(tracker: LumenTracker) -> NDArray[np.uint8]:
    """(nz, ny, nx) 1 inside the lumen."""

def lumen_states(
    tracker: LumenTracker, first_ijk: tuple[int, int, int], shape_ijk: tuple[int, int, int]
) -> NDArray[np.uint8]:
    """(nz, ny, nx) of a box: 0 no lumen, 1 lumen that no path reaches, 2 lumen."""

def nodes_at(tracker: LumenTracker, points_lps: NDArray[np.float64]) -> NDArray[np.int64]:
    """(n,) the node whose voxel holds each point, -1 outside the lumen."""

def voxels_of(tracker: LumenTracker, nodes_of: NDArray[np.uint32]) -> NDArray[np.uint16]:
    """(n, 3) voxels of nodes."""

def reached(tracker: LumenTracker, nodes_of: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """(n,) whether a path reaches each node."""

def sees(tracker: LumenTracker, from_lps: NDArray[np.float64], to_lps: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(n,) whether the straight line between two points stays in lumen voxels."""

def pulled_inside(tracker: LumenTracker, points_lps: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) points, each moved to the nearest place inside the lumen where it lies outside."""

def newly_reached(tracker: LumenTracker, other: LumenTracker) -> NDArray[np.uint16]:
    """(n, 3) voxels that a path reaches in one tracker and not in another."""

def cut_voxels(tracker: LumenTracker, cut: NDArray[np.uint32], kept: NDArray[np.uint32]) -> NDArray[np.uint16]:
    """(n, 3) voxels in the tubes of a cut piece rather than of what is kept: nodes on centrelines."""

def more_tips(
    tracker: LumenTracker,
    tree_nodes: NDArray[np.uint32],
    candidates_ijk: NDArray[np.uint16],
    *,
    cancel: Callable[[], bool] | None = None,
) -> NDArray[np.uint32]:
    """(n,) nodes: tips of branches among candidate voxels that a tree does not hold yet, longest path first."""

def cheapest_way(
    weights_zyx: NDArray[np.float32],
    goals_zyx: NDArray[np.uint8],
    spacing_mm: tuple[float, float, float],
    start_ijk: tuple[int, int, int],
    *,
    cancel: Callable[[], bool] | None = None,
) -> NDArray[np.uint16] | None:
    """(n, 3) voxels of a box on the cheapest way from the nearest goal to a start; weights are per mm, 0 is closed."""

# ---- evidence of airways ----

@final
class Enclosures:
    """A volume without its finest noise, and how enclosed its voxels are by brighter ones."""

    def __new__(cls, values_zyx: NDArray[np.int16], lps_from_ijk: NDArray[np.float64]) -> Enclosures: ...
    def at(self, voxels_ijk: NDArray[np.uint16]) -> NDArray[np.int16]:
        """(n,) how far the values rise on all but a fifth of 48 rays of 3 mm from each voxel."""

    def values_at(self, points_lps: NDArray[np.float64]) -> NDArray[np.float32]:
        """(n,) trilinear values without the finest noise at (n, 3) points, edge-clamped."""

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
        """For each (n, 3) voxel the way with most wall to anywhere so far from it: (m, 3) voxels, or None."""

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
        """(n, 3) voxels of the way with most wall round it, from a lumen that a path reaches; None if there is none."""

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
        """True if a path exists."""
    def solve_all(
        self, *, cancel: Callable[[], bool] | None = None, progress: Callable[[float], None] | None = None
    ) -> None:
        """Settle everything reachable."""
    def cost(self, target_ijk: tuple[int, int, int]) -> float | None:
        """Least cost of a settled voxel."""
    def path(self, target_ijk: tuple[int, int, int]) -> NDArray[np.int64] | None:
        """Voxels (n, 3) i, j, k from the root."""
    def time_paths(self, targets_ijk: Sequence[tuple[int, int, int]]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Nanoseconds and voxels of each path."""

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
    """Voxels (n, 3) i, j, k from the root to one target, cost, voxels settled; None if no path leads there."""

def time_lumen_paths(
    tracker: LumenTracker, nodes: Sequence[int] | NDArray[np.uint32]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Nanoseconds and voxels of each path."""
