"""Types of the compiled module; contracts are in the Python facade, algorithms in the crates' documentation."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from carina.render.appearance import Appearance
from carina.render.wall_texture import Decoration

def build_info() -> dict[str, Any]:
    """Return the build settings and capabilities: version, profile, simd, threads, target, gpu."""

# ---- DICOM slices ----

def scan_dicom_headers(
    paths: Sequence[Path],
    *,
    shared: Sequence[int],
    single: Sequence[int],
    refused: Sequence[int],
    max_inflated: int,
) -> list[tuple[bytes, list[bytes | None], int | None] | None]:
    """Return key, single elements and offset of the pixels of each file that is plainly readable."""

def decode_dicom_slices(
    sources: Sequence[tuple[Path, int, int]],
    out_zyx: NDArray[np.int16],
    *,
    coding: str,
    bits_allocated: int,
    bits_stored: int,
    high_bit: int,
    signed: bool,
    intercept: int,
    padding: Sequence[tuple[int, int]] | None,
    max_inflated: int,
    cancel: Callable[[], bool] | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[bool]:
    """Read slices (path, offset of the pixels, index) into a volume in place; return which were read."""

def place_dicom_words(
    words_yx: NDArray[np.uint16],
    out_zyx: NDArray[np.int16],
    *,
    level: int,
    bits: int,
    bits_allocated: int,
    bits_stored: int,
    high_bit: int,
    signed: bool,
    intercept: int,
    padding: Sequence[tuple[int, int]] | None,
) -> bool:
    """Write decoded words into one slice of a volume in place; return whether nothing about them is remarkable."""

def lossless_jpeg_problem(frame: bytes, *, start: int) -> str | None:
    """Return the problem of a lossless grey JPEG stream that begins at an offset; None for intact and other streams."""

def slice_excesses(values_zyx: NDArray[np.int16], *, tile: int | None, step: int, allowed: float) -> list[float]:
    """Return the excess in HU of each slice between two neighbours."""

# ---- scope ----

@final
class FlightCurve:
    """Smooth curve with camera frames along a polyline."""

    def __new__(
        cls, points_lps: NDArray[np.float64], up_lps: tuple[float, ...] | None, max_deviation_mm: float
    ) -> FlightCurve: ...
    @property
    def length_mm(self) -> float: ...
    def pose_at(self, path_mm: float) -> NDArray[np.float64]:
        """Return lps_from_camera, 4x4, at a position along the polyline."""
    def nearest(self, point_lps: tuple[float, float, float]) -> tuple[float, float]:
        """Return the nearest position on the curve as (path_mm, distance_mm)."""
    def knots_lps(self) -> NDArray[np.float64]:
        """Return the knots as a new array (m, 3)."""
    def tangent_frames(self) -> NDArray[np.float64]:
        """Return the frames at the knots, (m, 4, 4); +z is the curve's own direction."""

# ---- scope: the wall and the drive ----

@final
class WallField:
    """Signed distance to the wall of a lumen."""

    @staticmethod
    def from_distances(distance_mm_zyx: NDArray[np.float32], lps_from_ijk: NDArray[np.float64]) -> WallField:
        """Create a field from a grid of signed distances, positive in the lumen."""
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
    def with_tube(
        self, axis_lps: NDArray[np.float64], radius_mm: Sequence[float], excess_mm: Sequence[float]
    ) -> WallField:
        """Return a field whose lumen also contains a tube, near which the sampled wall is moved inwards."""
    def deformed(self, lps_from_rest: NDArray[np.float64]) -> WallField:
        """Return the field of the same wall after an affine deformation of the tissue."""
    @property
    def is_deformed(self) -> bool: ...
    def with_ridges(self, plates_lps: NDArray[np.float64], half_mm: float) -> WallField:
        """Return a field whose wall also contains plates (n, 3, 3): middle, and the vectors to two of its edges."""
    @property
    def is_sampled(self) -> bool: ...
    def distance_mm(self, points_lps: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distances (n,) of points (n, 3)."""
    @property
    def num_bytes(self) -> int: ...
    def to_bytes(self) -> bytes:
        """Return lattice and samples as little-endian bytes."""
    def digest(self) -> str:
        """Return the BLAKE3 digest of all data of the field, hexadecimal."""

@final
class ScopeDrive:
    """Simulated scope in a lumen."""

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
        """Set the controls; return the state."""
    def place(self, path_lps: NDArray[np.float64], insertion_mm: float) -> dict[str, Any]:
        """Place the scope along a path; return the state."""
    def copy(self) -> ScopeDrive:
        """Return a copy in the same position."""
    def shaft_lps(self) -> NDArray[np.float64]:
        """Return the axis of the shaft as a new array (n, 3)."""
    def wall_depths_mm(self) -> tuple[float, float]:
        """Return the penetration of the wall by (tip, shaft)."""

@final
class ReservedThread:
    """Thread that renders no pictures until it is released."""

    def __new__(cls) -> ReservedThread: ...
    def release(self) -> None:
        """Let pictures use the thread again; a second call does nothing."""

def picture_clock_s() -> float | None:
    """Return the mean processor time in s of the threads that render pictures now; None if it is not known (yet)."""

def picture_threads() -> int:
    """Return the number of threads that render a picture."""

# ---- phantom ----

def chest_lumen_distances(
    seed: int, generations: int, stenosis: bool, neck: bool, points_lps: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the signed distances (n,) in mm of points to the lumen, negative inside."""

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
    variant: str | None,
    box_lps: list[list[float]] | None,
    with_distance: bool,
    proceed: Callable[[float], bool],
) -> dict[str, Any]:
    """Generate a phantom chest.

    The result contains hu_zyx, lumen_zyx, lps_from_ijk, branches, and the optional parts that were requested: nodule,
    stenosis, tube, variants, cricoid_lps with upper_airway_zyx, lumen_distance_mm.
    """

# ---- isoregion ----

_Classes = list[tuple[int, int, int, bool]]
"""Classes as (first value, last value, number of voxels, fully transparent)."""

def value_range(hu_zyx: NDArray[np.int16]) -> tuple[int, int]:
    """Return the smallest and the largest value."""

def content_digest(voxels: NDArray[np.int16] | NDArray[np.uint8]) -> str:
    """Return the BLAKE3 digest of the bytes of a [z, y, x] array, hexadecimal; the shape is not included."""

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
    """Compute the radius map of a label volume, by default with one slab for each thread."""

def build_cell_map(
    hu_zyx: NDArray[np.int16],
    runs: Sequence[tuple[int, int]],
    *,
    cancel: Callable[[], bool] | None = None,
    simd: str | None = None,
    num_slabs: int | None = None,
) -> NDArray[np.uint8]:
    """Compute the cell map of disjoint runs of values (first, last); 0 for a voxel whose value is in no run.

    Leaps over transparent samples use this map.
    """

# ---- optics ----

@final
class Optics:
    """Lens model for a picture of a given size: ``brown`` (k1 k2 p1 p2 k3 k4 k5 k6) or ``fisheye`` (k1 to k4)."""

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

        The directions are NaN where the lens has none.
        """

    def pixels(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return points of the picture (n, 2) of directions in camera space.

        The points are NaN for directions that the lens does not see.
        """

    def rays(self, *, shape: str, edge_px: float, vignette: float) -> LensRays:
        """Compute the rays of all pixels inside an outline."""

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
    """Rays of all pixels of a picture behind a lens, and the relative brightness of each pixel."""

def defocus(
    rgb: NDArray[np.uint8],
    depth_mm: NDArray[np.float32],
    *,
    near_mm: float,
    far_mm: float,
    lens: LensRays | None = None,
) -> NDArray[np.uint8]:
    """Return a whole picture (h, w, 3) blurred by its depth map (h, w), then darkened as its lens does."""

# ---- gpu ----

def gpu_adapters() -> list[tuple[str, str, str, str]] | None:
    """Return name, interface, driver and kind, the likely fastest first; None in a build without GPU support."""

@final
class Gpu:
    """Opened graphics device."""

    def __new__(cls, adapter: int) -> Gpu: ...
    def upload(self, hu_zyx: NDArray[np.int16], radius_zyx: NDArray[np.uint8] | None = None) -> GpuScene:
        """Copy a volume to the device, and its radius map if there is one."""
    def lose(self) -> None:
        """Make the device lost, for tests."""

@final
class GpuScene:
    """Volume on a graphics device, with or without a radius map."""

    def with_map(self, radius_zyx: NDArray[np.uint8] | None = None) -> GpuScene:
        """Return the same volume with another map, or without one."""

# ---- raycast ----

@final
class TransferTable:
    """Colour and opacity of one ray step for each value."""

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
        """Return the premultiplied colour and opacity of one step at a value."""

@final
class CancelToken:
    """Token that cancels the cast of one picture, from any thread; a cancelled token stays cancelled."""

    def __new__(cls) -> CancelToken: ...
    def cancel(self) -> None:
        """Cancel the cast that uses this token."""

    @property
    def cancelled(self) -> bool:
        """Whether the token was cancelled."""

@final
class Bricks:
    """Cache that pictures of one array of values share: wall normals, samples with gradients.

    The values must not change.
    """

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
    leap: NDArray[np.uint8]
    | tuple[NDArray[np.uint8], NDArray[np.uint8], list[int]]
    | tuple[NDArray[np.uint16], list[int], bool]
    | None = None,
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
    lps_from_rest: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.uint8], tuple[int, int, int, int, int, int, int]]:
    """Cast rows of a picture; return (rows, width, 3) colours and statistics.

    The statistics are the numbers of rays, samples, look-ups, leaps, skipped samples, shaded samples and reads.
    A cancelled cast raises CancelledError.
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
    lps_from_rest: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.float32]]:
    """Find the first walls of rows, or of one pixel (column, row); return depths in mm, positions and normals in LPS.

    The values are NaN where a ray meets no wall.
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
    """Sample rows of a plane; return grey levels and a mask of the pixels inside the volume."""

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
    """Render rows of the tri-plane view in occlusion order, (rows, width, 3)."""

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
    """Return the water-equivalent length of each ray of some rows, (rows, width) mm."""

def sample_lines(
    hu_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    lines: NDArray[np.float64],
    *,
    width: int,
    window_hu: tuple[float, float],
    slab: tuple[float, str] | None = None,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Sample rows given by start, step and direction through the picture, (rows, 9).

    Return grey levels and a mask of the pixels inside the volume.
    """

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
    """Raise the values round a lumen, in place, in a copy of a volume.

    The heights are those of lumen, shell and backing.
    """

def smooth_mask(mask_zyx: NDArray[np.uint8]) -> NDArray[np.int16]:
    """Return a smooth field with values 0 to 1024 of a mask."""

def best_instruction_set() -> str:
    """Return the name of the instruction set that the casters use by default."""

# ---- cross-sections ----

@final
class SectionCasts:
    """Rays cast in many planes, and the edges found on them."""

    def __len__(self) -> int: ...
    def blur(self) -> tuple[float, float] | None:
        """Return the scan's blur within and across slices in mm; None if too few rays met thick tissue."""
    def measure(self, blur: tuple[float, float] | None) -> dict[str, Any]:
        """Measure all planes; without a blur, edges are at half maximum.

        The result contains centre_lps (n, 3); area, diameters, wall, shift, their errors and shares (n,); edge_mm and
        outer_mm (n, 64).
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
    """Return the two unit vectors that span the plane across a direction."""

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
    """Find the trachea.

    The result contains voxels_ijk (n, 3) from the top down, diameters_mm (n,), length_mm, carina_lps (3,) and doubts
    (list of names).
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
    """Flood the airway from seed voxels; return the lumen (1 or 0) and a description.

    The description contains num_voxels, num_without_wall and leaks [(point_lps, level)].
    """

def lumen_mesh(
    values_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    lumen_zyx: NDArray[np.uint8],
    *,
    levels: tuple[float, float, float] | None,
    cancel: Callable[[], bool] | None = None,
    progress: Callable[[float], None] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.uint32]]:
    """Return the closed mesh of the lumen: vertices (n, 3) LPS mm, triangles (m, 3), counterclockwise from outside."""

def lumen_mask(
    values_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    lumen_zyx: NDArray[np.uint8],
    *,
    levels: tuple[float, float, float] | None,
) -> NDArray[np.uint8]:
    """Return the voxels whose centres are inside the mesh of the lumen, 1 inside."""

@final
class LumenSurface:
    """Surface of one lumen that planes can cut; the arrays must not change."""

    def __new__(
        cls,
        values_zyx: NDArray[np.int16],
        lps_from_ijk: NDArray[np.float64],
        lumen_zyx: NDArray[np.uint8],
        *,
        levels: tuple[float, float, float] | None,
    ) -> LumenSurface: ...
    def cut(self, lps_from_pixel: NDArray[np.float64], *, width: int, height: int) -> list[NDArray[np.float64]] | None:
        """Return lines in a picture, (n, 2) column and row each; None if there are too many to show."""

    def encoded(self, lps_from_pixel: NDArray[np.float64], *, width: int, height: int) -> bytes | None:
        """Return the lines of a cut, clipped to the picture, as the bytes of the wire format."""

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
    """Follow airways beyond the flood; in place, added voxels of the lumen (1) get the value 2.

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
    least_mean_dip: float,
    blur_mm: float,
    min_length_mm: float,
    min_side_mm: float,
    most_reached: float,
    cancel: Callable[[], bool] | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Follow the thinnest airways; in place, added voxels of the lumen (1) get the value 2.

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
    """Return the pieces of air that share no face with the lumen, the largest piece first.

    A piece is an array of indices in the flat volume.
    """

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
    """Set clipped voxels of airway lumens to the value of air, in place; return the number of changed voxels.

    The sharp volume has clipped these voxels at its lowest value (floor).
    """

@final
class GraphTracker:
    """Graph with a cost, and the tree of least-cost paths from one root."""

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
        """Count the undirected edges one by one."""
    def place(
        self, point_lps: tuple[float, float, float], reach_mm: float
    ) -> tuple[int, tuple[float, float, float], float] | None:
        """Return the node for a point, the centre of the voxel chosen for the point, and their distance in mm."""
    def solve_to(
        self,
        node: int,
        *,
        cancel: Callable[[], bool] | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> bool:
        """Settle nodes until the given node is settled; return True if a path exists."""
    def cost(self, node: int) -> float | None:
        """Return the least cost of a settled node."""
    def path(self, node: int) -> tuple[NDArray[np.float64], NDArray[np.uint32]] | None:
        """Return the voxel centres (n, 3) LPS from the root, and their nodes."""

@final
class LumenTracker:
    """Graph of the lumen's voxels and the tree of least-cost paths from one root."""

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
        """Settle nodes until the given node is settled; return True if a path exists."""
    def solve_all(
        self, *, cancel: Callable[[], bool] | None = None, progress: Callable[[float], None] | None = None
    ) -> None:
        """Settle all nodes that a path can reach."""
    def cost(self, node: int) -> float | None:
        """Return the least cost of a settled node."""
    def path(self, node: int) -> tuple[NDArray[np.float64], NDArray[np.uint32]] | None:
        """Return the voxel centres (n, 3) LPS from the root, and their nodes."""
    def smooth(
        self, points_lps: Sequence[tuple[float, float, float]] | NDArray[np.float64], *, step_mm: float, keep_end: bool
    ) -> NDArray[np.float64]:
        """Return evenly spaced, smooth (n, 3) points that stay in lumen voxels."""
    def radius_mm(self, points_lps: Sequence[tuple[float, float, float]] | NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distances (n,) to the wall."""
    def section_radii(
        self, lines_lps: Sequence[NDArray[np.float64]], parents: Sequence[int | None], wanted: Sequence[bool]
    ) -> list[NDArray[np.float64] | None]:
        """Return, for each wanted branch, the radii (n,) of circles with the area of the lumen's cross-sections."""
    def inside(self, points_lps: Sequence[tuple[float, float, float]] | NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return (n,) whether the voxel of each point is lumen."""
    def branches(
        self, *, cancel: Callable[[], bool] | None = None, progress: Callable[[float], None] | None = None
    ) -> list[dict[str, Any]]:
        """Return the automatic tree, parents first.

        Each branch has parent, generation, points, radius_mm, wall_mm, cost and nodes.
        """
    def branches_to(
        self,
        nodes: Sequence[int],
        branch_nodes: Sequence[NDArray[np.uint32]],
        parents: Sequence[int | None],
    ) -> list[dict[str, Any]]:
        """Return the part of the automatic tree that leads to the given settled nodes."""
    def branch_of_nodes(
        self, branch_nodes: Sequence[NDArray[np.uint32]], parents: Sequence[int | None]
    ) -> NDArray[np.int32]:
        """Return for each node the branch whose tube contains the node, (num_nodes,).

        The value is -1 for a node that is connected to no branch.
        """

def edit_lumen(
    tracker: LumenTracker,
    values_zyx: NDArray[np.int16],
    added_ijk: NDArray[np.uint16],
    removed_ijk: NDArray[np.uint16],
    *,
    cancel: Callable[[], bool] | None = None,
) -> tuple[LumenTracker, tuple[tuple[int, int, int], tuple[int, int, int]] | None]:
    """Build the tracker of a lumen after voxels were added and removed.

    Also return the box (first, shape) of the changes.
    """

def fresh_lumen(
    tracker: LumenTracker,
    values_zyx: NDArray[np.int16],
    lumen_zyx: NDArray[np.uint8],
    root_ijk: tuple[int, int, int],
    *,
    cancel: Callable[[], bool] | None = None,
) -> LumenTracker:
    """Build the tracker of a whole lumen from scratch, with the wall levels of another tracker."""

def reroot_lumen(
    tracker: LumenTracker, root_ijk: tuple[int, int, int], *, cancel: Callable[[], bool] | None = None
) -> LumenTracker:
    """Build the tracker of the same lumen with another root."""

def lumen_array(tracker: LumenTracker) -> NDArray[np.uint8]:
    """Return a (nz, ny, nx) array that is 1 inside the lumen."""

def lumen_states(
    tracker: LumenTracker, first_ijk: tuple[int, int, int], shape_ijk: tuple[int, int, int]
) -> NDArray[np.uint8]:
    """Return the states of a box, (nz, ny, nx).

    The states are 0 no lumen, 1 lumen that no path reaches, 2 lumen that a path reaches.
    """

def nodes_at(tracker: LumenTracker, points_lps: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the node (n,) whose voxel contains each point, -1 outside the lumen."""

def voxels_of(tracker: LumenTracker, nodes_of: NDArray[np.uint32]) -> NDArray[np.uint16]:
    """Return the voxels (n, 3) of nodes."""

def reached(tracker: LumenTracker, nodes_of: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Return (n,) whether a path reaches each node."""

def sees(tracker: LumenTracker, from_lps: NDArray[np.float64], to_lps: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return (n,) whether the straight line between two points stays in lumen voxels."""

def pulled_inside(tracker: LumenTracker, points_lps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (n, 3) points; each point outside the lumen is moved to the nearest position inside."""

def newly_reached(tracker: LumenTracker, other: LumenTracker) -> NDArray[np.uint16]:
    """Return the voxels (n, 3) that a path reaches in one tracker but not in the other."""

def cut_voxels(tracker: LumenTracker, cut: NDArray[np.uint32], kept: NDArray[np.uint32]) -> NDArray[np.uint16]:
    """Return the voxels (n, 3) in the tubes of the branches that were cut off, but not of the remaining branches.

    Branches are given by the nodes of their centrelines.
    """

def more_tips(
    tracker: LumenTracker,
    tree_nodes: NDArray[np.uint32],
    candidates_ijk: NDArray[np.uint16],
    *,
    cancel: Callable[[], bool] | None = None,
) -> NDArray[np.uint32]:
    """Return the nodes (n,) at tips of branches that a tree does not contain yet, longest path first.

    Only tips among the candidate voxels are returned.
    """

def cheapest_way(
    weights_zyx: NDArray[np.float32],
    goals_zyx: NDArray[np.uint8],
    spacing_mm: tuple[float, float, float],
    start_ijk: tuple[int, int, int],
    *,
    cancel: Callable[[], bool] | None = None,
) -> NDArray[np.uint16] | None:
    """Return the voxels (n, 3) of a box on the least-cost path from the nearest goal to a start.

    Weights are per mm; no path passes a voxel of weight 0.
    """

# ---- evidence of airways ----

@final
class Enclosures:
    """Volume without its finest noise, and measures of how much brighter voxels enclose each voxel."""

    def __new__(cls, values_zyx: NDArray[np.int16], lps_from_ijk: NDArray[np.float64]) -> Enclosures: ...
    def at(self, voxels_ijk: NDArray[np.uint16]) -> NDArray[np.int16]:
        """Return (n,) the rise of the values on all but a fifth of 48 rays of 3 mm from each voxel."""

    def values_at(self, points_lps: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return (n,) trilinear values without the finest noise at (n, 3) points.

        Outside the volume the nearest edge value is used.
        """

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
        """Find for each voxel (n, 3) the path with the most wall to any voxel ``away_mm`` away.

        Each path is (m, 3) voxels, or None.
        """

    def way(
        self,
        tracker: LumenTracker,
        start_ijk: tuple[int, int, int],
        toward_ijk: tuple[int, int, int],
        tips_ijk: NDArray[np.uint16],
        *,
        tip_allowance: float,
        enclosed: float,
        dark: float,
        bright: float,
        closed: float,
        cancel: Callable[[], bool] | None = None,
    ) -> NDArray[np.uint16] | None:
        """Find the path with the most wall round it from the lumen to a voxel: (n, 3) voxels, or None.

        A path from one of the (n, 3) voxels ``tips_ijk`` is preferred if its cost exceeds that of the best path by at
        most ``tip_allowance``.
        """

# ---- tracker over a volume of weights ----

@final
class FieldTracker:
    """Tree of least-cost paths in a volume of weights."""

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
        """Settle voxels until the given voxel is settled; return True if a path exists."""
    def solve_all(
        self, *, cancel: Callable[[], bool] | None = None, progress: Callable[[float], None] | None = None
    ) -> None:
        """Settle all voxels that a path can reach."""
    def cost(self, target_ijk: tuple[int, int, int]) -> float | None:
        """Return the least cost of a settled voxel."""
    def path(self, target_ijk: tuple[int, int, int]) -> NDArray[np.int64] | None:
        """Return the voxels (n, 3) i, j, k from the root."""
    def time_paths(self, targets_ijk: Sequence[tuple[int, int, int]]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return the time in ns of one query of each path, and its number of voxels."""

def ball_distances(inside_zyx: NDArray[np.bool_], *, step_mm: float, reach_mm: float) -> NDArray[np.float32]:
    """Return the distance in mm from each inside voxel to the nearest outside voxel, less half a voxel."""

def squared_distances(inside_zyx: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the squared distance in voxels from each inside voxel to the nearest outside voxel."""

def numbered_parts(mask_zyx: NDArray[np.bool_], *, corners: bool) -> tuple[NDArray[np.uint32], int]:
    """Return the number of the connected part of each voxel, from 1 in the order of first voxels, and their number."""

def arrival_times(speed_zyx: NDArray[np.float32], starts_ijk: Sequence[tuple[int, int, int]]) -> NDArray[np.float32]:
    """Return the time at which a front from some voxels reaches each voxel; infinite where it does not."""

def resampled(
    hu_zyx: NDArray[np.int16],
    lps_from_ijk: NDArray[np.float64],
    *,
    lps_from_voxel: NDArray[np.float64],
    shape_zyx: tuple[int, int, int],
    outside: float,
) -> NDArray[np.float32]:
    """Return the trilinear values of a volume on another grid, ``outside`` beyond the volume."""

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
    """Find the least-cost path to one target; return its voxels, its cost and the number of settled voxels.

    The voxels are (n, 3) i, j, k. The result is None if no path leads there.
    """

def time_lumen_paths(
    tracker: LumenTracker, nodes: Sequence[int] | NDArray[np.uint32]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the time in ns of one query of each path, and its number of voxels."""
