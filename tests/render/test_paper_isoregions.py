"""Comparisons of IsoRegion map and leaping caster with an implementation from the text of the paper (4.1 to 4.3)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from paper_isoregions import CastImage, Rays, cast, isoregions_by_definition, isoregions_by_iteration
from render_grids import place, rotation

import carina
from carina.render import AirwayView, Renderer, TransferFunction
from carina.scopes import Pose
from carina.volume import Volume
from volumes_of_the_paper import headsq, in_8_bits, lidc2, random_blocks

BIN = 16
"""Width of the bins of values that count as equal in a volume with more than 256 values."""
STOP = 1.0 / 65536.0
"""Transparency below which a ray of Carina may end; the paper's rays do not end early."""
TOLERANCE = 0.5 + 0.02
"""Tolerance of a colour in grey levels, for rounding to 8 bits and for rays that end early."""
NEAR = 2e-5
"""Distance in voxels from a face between voxels at which float32 may select the voxel on the other side."""


def numbers_of(volume: Volume) -> NDArray[np.int64]:
    """Return the numbers whose equality defines regions: voxel values, or bins of 16 if there are more than 256."""
    values = volume.hu_zyx.astype(np.int64)
    return values if len(np.unique(values)) <= 256 else values // BIN


@pytest.fixture(scope="module", params=["LIDC2", "headsq in 8 bits", "headsq in bins"])
def real(request, data_dir) -> Volume:
    """Return parts of the real volumes with large and with small regions."""
    if request.param == "LIDC2":
        return lidc2(data_dir, (90, 70, 40), (72, 60, 40))
    head = headsq(data_dir, (0, 0, 0), (64, 64, 93))
    return head if request.param == "headsq in bins" else in_8_bits(head)


@pytest.mark.data
def test_map_of_a_real_volume_equals_definition_and_iteration_of_the_paper(real):
    numbers = numbers_of(real)
    built = carina.isoregion_map(real)
    assert np.array_equal(isoregions_by_iteration(numbers), built)
    part = tuple(slice(n // 4, n // 4 + 24) for n in numbers.shape)
    cut = Volume(np.ascontiguousarray(real.hu_zyx[part]), real.lps_from_ijk)
    equal_by = "values" if len(np.unique(real.hu_zyx)) <= 256 else "bins"
    assert np.array_equal(isoregions_by_definition(numbers[part]), carina.isoregion_map(cut, equal_by=equal_by))
    assert built.max() >= 2


@pytest.fixture(scope="module")
def coarse_airway(airway) -> Volume:
    """Return the phantom in steps of 96 HU, which hide its noise, so that lumen and tissue have regions."""
    return Volume(((airway.volume.hu_zyx + 1056) // 96).astype(np.int16), airway.volume.lps_from_ijk)


def test_map_of_the_phantom_equals_definition_and_iteration_of_the_paper(airway, coarse_airway):
    for volume in (airway.volume, coarse_airway):
        built = carina.isoregion_map(volume)
        numbers = numbers_of(volume)
        assert np.array_equal(isoregions_by_iteration(numbers), built)
        assert np.array_equal(isoregions_by_definition(numbers[8:32, 10:40, 10:40]), _map_of_part(volume))
    assert built.max() >= 4


def _map_of_part(volume: Volume) -> NDArray[np.uint8]:
    """Return the map of a part of the phantom, by values or by bins as the map of the whole phantom."""
    equal_by = "values" if len(np.unique(volume.hu_zyx)) <= 256 else "bins"
    part = Volume(np.ascontiguousarray(volume.hu_zyx[8:32, 10:40, 10:40]), volume.lps_from_ijk)
    return carina.isoregion_map(part, equal_by=equal_by)


shapes = st.tuples(*[st.integers(1, 15)] * 3)


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), shapes, st.sampled_from([1, 2, 4, 256]))
def test_map_of_random_blocks_equals_definition_and_iteration_of_the_paper(seed, shape, num_values):
    values = random_blocks(seed, shape, num_values)
    found = isoregions_by_definition(values)
    assert np.array_equal(isoregions_by_iteration(values), found)
    assert np.array_equal(carina.isoregion_map(Volume(values, np.eye(4)), equal_by="values"), found)


def test_map_of_256_values_equals_the_definition_of_the_paper(rng):
    values = np.kron(rng.integers(0, 256, (7, 7, 7)), np.ones((4, 4, 5))).astype(np.int16)
    values.flat[:256] = np.arange(256)
    built = carina.isoregion_map(Volume(values, np.eye(4)))
    assert np.array_equal(isoregions_by_definition(values), built)


def test_map_of_figure_5_has_the_dimensions_that_the_definition_gives():
    """Check the definition itself: a block of 7 x 7 x 5 voxels has its largest cubes in the middle."""
    values = np.zeros((9, 9, 7), dtype=np.int16)
    values[1:8, 1:8, 1:6] = 1
    dimensions = isoregions_by_definition(values)
    assert dimensions[4, 4].tolist() == [0, 0, 1, 2, 1, 0, 0]
    assert dimensions[2, 4].tolist() == [0, 0, 1, 1, 1, 0, 0]


# ---- pictures ----


def rays_of(volume: Volume, view: AirwayView, step_mm: float) -> tuple[Rays, NDArray[np.bool_]]:
    """Return the rays of a picture, and which of them have no sample within `NEAR` of the face of a voxel.

    Camera and samples as in ``docs/conventions.md`` and ``docs/algorithms.md``: samples in the middle of steps of equal
    length from the camera.
    """
    assert view.fov_deg is not None
    focal = min(view.width, view.height) / 2.0 / np.tan(np.radians(view.fov_deg) / 2.0)
    row, column = np.mgrid[: view.height, : view.width] + 0.5
    across = np.stack([column - view.width / 2.0, row - view.height / 2.0, np.full(row.shape, focal)], axis=-1)
    across = across.reshape(-1, 3) / np.linalg.norm(across, axis=-1).reshape(-1, 1)
    ijk_from_camera = np.linalg.inv(volume.lps_from_ijk) @ view.pose.lps_from_camera
    step = across @ ijk_from_camera[:3, :3].T * step_mm
    origin = ijk_from_camera[:3, 3]
    shape = np.array(volume.shape_zyx[::-1])
    # A ray enters and leaves the box of the volume at the last entry and the first exit of its three slabs.
    with np.errstate(divide="ignore", invalid="ignore"):
        faces = np.stack([(-0.5 - origin) / step, (shape - 0.5 - origin) / step])
    entry = np.maximum(faces.min(axis=0).max(axis=1), 0.0)
    leave = faces.max(axis=0).min(axis=1)
    first = np.ceil(entry - 0.5)
    count = np.maximum(np.floor(leave - 0.5) - first + 1, 0).astype(np.int64)
    is_safe = np.minimum(np.abs(entry - 0.5 - np.rint(entry - 0.5)), np.abs(leave - 0.5 - np.rint(leave - 0.5))) > NEAR
    start = origin + (first + 0.5)[:, None] * step
    for n in range(int(count.max(initial=0))):
        points = start + n * step
        near = (np.abs(points - np.floor(points) - 0.5) < NEAR).any(axis=1)
        is_safe &= ~(near & (n < count))
    return Rays(start, step, count), is_safe


def colours_of(transfer: TransferFunction, volume: Volume, step_mm: float) -> tuple[NDArray[np.int64], ...]:
    """Return the index of each voxel in the tables, and colour and opacity of one sample by this index.

    A bin has the colour of its middle. The opacity of a transfer function is that of ``reference_mm``.
    """
    numbers, index = np.unique(numbers_of(volume), return_inverse=True)
    is_binned = len(np.unique(volume.hu_zyx)) > 256
    at = numbers * BIN + (BIN - 1) / 2.0 if is_binned else numbers.astype(np.float64)
    points = transfer.points
    red, green, blue, alpha = (np.interp(at, points[:, 0], points[:, c]) for c in range(1, 5))
    opacity = 1.0 - (1.0 - alpha) ** (step_mm / transfer.reference_mm)
    return index.reshape(volume.shape_zyx), np.stack([red, green, blue], axis=1), opacity


def compare_pictures(volume: Volume, transfer: TransferFunction, view: AirwayView) -> tuple[CastImage, CastImage]:
    """Compare pictures by brute force and by leaps with those of the paper; return the latter two."""
    step_mm = float(min(volume.spacing_mm))
    rays, is_safe = rays_of(volume, view, step_mm)
    assert is_safe.mean() > 0.9
    index, colours, opacities = colours_of(transfer, volume, step_mm)
    brute = cast(index, rays, colours, opacities)
    leaping = cast(index, rays, colours, opacities, isoregions_by_iteration(index))
    # "The resulting image is identical": the caster of the paper agrees with its brute force to the last bits of f64.
    assert np.abs(leaping.colour - brute.colour).max() < 1e-12
    assert np.abs(leaping.transparency - brute.transparency).max() < 1e-12
    renderer = Renderer(volume, transfer=transfer)
    renderer.prepare(progress=False)
    for method in ("brute", "leap-always"):
        picture = renderer.render(replace(view, method=method))
        levels = picture.rgb.reshape(-1, 3)[is_safe].astype(np.float64)
        assert np.abs(levels - 255.0 * brute.colour[is_safe]).max() <= TOLERANCE, method
        if method == "brute":
            assert picture.stats.num_leaps == 0
        elif leaping.reads.sum() < 0.7 * brute.reads.sum():
            assert picture.stats.num_leaps + picture.stats.num_samples < 0.9 * brute.reads.sum()
    return brute, leaping


def transfer_of(points: list[list[float]]) -> TransferFunction:
    """Return a transfer function that is sampled as in the paper: nearest voxel, one step per voxel, no shading."""
    return TransferFunction(points=np.array(points), unit="raw", name="paper's", sampling="nearest")


def view_of(volume: Volume, from_mm: tuple[float, float, float], towards: tuple[float, float, float]) -> AirwayView:
    """Return a view of 48 x 40 pixels from a position relative to the centre of the volume."""
    pose = Pose.looking(volume.centre_lps + np.array(from_mm), towards)
    return AirwayView(pose, fov_deg=60.0, width=48, height=40, shading=False, stop_transparency=STOP)


SKIN = [[48.0, 0.9, 0.6, 0.5, 0.0], [96.0, 0.9, 0.6, 0.5, 0.3], [255.0, 1.0, 0.95, 0.9, 0.9]]
"""Transfer function whose low values are transparent."""
FOG = [[0.0, 0.1, 0.2, 0.9, 0.004], [64.0, 0.8, 0.5, 0.4, 0.02], [255.0, 1.0, 1.0, 0.9, 0.2]]
"""Transfer function in which every value is visible, so that each skipped segment adds colour."""


@pytest.mark.data
@pytest.mark.parametrize("points", [SKIN, FOG], ids=["skin", "fog"])
@pytest.mark.parametrize("view", ["outside", "inside"])
def test_pictures_of_a_real_volume_equal_those_of_the_paper(real, points, view):
    width = float(real.hu_zyx.max()) / 255.0
    transfer = transfer_of([[value * width, *rgba] for value, *rgba in points])
    size = float(np.linalg.norm(np.array(real.shape_zyx[::-1]) * real.spacing_mm))
    away, towards = np.array([0.0, -0.9 * size, 0.1]), (0.05, 1.0, 0.1)
    if view == "inside":
        # The camera is in the middle of the largest region, beside the centre of a voxel.
        radii = carina.isoregion_map(real)
        middle = np.array(np.unravel_index(int(radii.argmax()), radii.shape)[::-1]) + np.array([0.1, 0.2, -0.1])
        away, towards = real.to_lps(middle) - real.centre_lps, tuple(real.centre_lps - real.to_lps(middle))
    brute, leaping = compare_pictures(real, transfer, view_of(real, tuple(away), towards))
    assert brute.colour.std() > 0.02
    assert leaping.reads.sum() < 0.98 * brute.reads.sum()


def test_pictures_of_the_phantom_equal_those_of_the_paper(airway, coarse_airway):
    view = AirwayView(airway.pose, fov_deg=80.0, width=48, height=40, shading=False, stop_transparency=STOP)
    points = [[-1000.0, 0.2, 0.3, 0.9, 0.01], [-600.0, 0.9, 0.5, 0.4, 0.1], [700.0, 1.0, 1.0, 0.9, 0.9]]
    compare_pictures(airway.volume, transfer_of(points), view)
    points = [[0.0, 0.2, 0.3, 0.9, 0.01], [4.0, 0.9, 0.5, 0.4, 0.03], [18.0, 1.0, 1.0, 0.9, 0.9]]
    brute, leaping = compare_pictures(coarse_airway, transfer_of(points), view)
    assert leaping.reads.sum() < 0.7 * brute.reads.sum()


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 5, 256]))
def test_pictures_of_random_blocks_equal_those_of_the_paper(seed, num_values):
    rng = np.random.default_rng(seed)
    shape = tuple(int(n) for n in rng.integers(8, 33, 3))
    axes = rotation(*rng.uniform(-0.5, 0.5, 3))
    spacing = tuple(rng.uniform(0.7, 1.6, 3))
    volume = Volume(random_blocks(seed, shape, num_values), place(axes, spacing, (3.0, -4.0, 5.0), shape))
    last = float(num_values - 1)
    points = [[last * x, *rng.random(3), rng.choice([0.0, 0.01, 0.3, 1.0])] for x in (0.0, 0.3, 0.7, 1.0)]
    offset, towards = rng.normal(0.0, 12.0, 3), rng.normal(0.0, 1.0, 3)
    compare_pictures(volume, transfer_of(points), view_of(volume, tuple(offset), tuple(towards)))
