"""Tests of first walls along the rays in Python: the surface of a picture, one pixel, and the file.

Tests of the casters are in Rust.
"""

from __future__ import annotations

import numpy as np
import pytest

import carina
from carina.errors import RenderError, UsageError
from carina.render import AirwayView, Renderer, transfer_preset
from carina.render.wall import grow_one_voxel

SIZE = {"width": 56, "height": 44}


@pytest.fixture
def renderer(airway):
    made = Renderer(airway.volume)
    made.set_lumen(airway.lumen_zyx)
    return made


def test_surface_points_are_at_their_depth_on_the_rays_of_their_pixels(renderer, airway):
    view = AirwayView(airway.pose, fov_deg=100.0, **SIZE)
    surface = renderer.surface(view)
    picture = renderer.render(view)
    assert surface.depth_mm.shape == (44, 56)
    assert surface.depth_mm.dtype == surface.normal_lps.dtype == np.float32
    count_cpu_picture = np.isfinite(surface.depth_mm)
    assert count_cpu_picture.mean() > 0.9
    for row, column in np.argwhere(count_cpu_picture)[::97]:
        point = surface.position_lps[row, column]
        # Directions are float32, which causes an error of 1e-3 of a pixel.
        assert picture.pixel_of(point) == pytest.approx((column + 0.5, row + 0.5), abs=1e-3)
        depth = np.linalg.norm(point - airway.pose.position_lps)
        assert depth == pytest.approx(surface.depth_mm[row, column], abs=1e-3)
        normal = surface.normal_lps[row, column]
        assert np.linalg.norm(normal) == pytest.approx(1, abs=1e-5)
        assert normal @ (point - airway.pose.position_lps) < 0, "a wall faces the camera"
    assert (np.isnan(surface.position_lps).any(axis=2) == ~count_cpu_picture).all()
    assert (np.isnan(surface.normal_lps).any(axis=2) == ~count_cpu_picture).all()


def test_surface_is_at_the_border_of_the_lumen(renderer, airway):
    surface = renderer.surface(AirwayView(airway.pose, fov_deg=100.0, **SIZE))
    count_cpu_picture = np.isfinite(surface.depth_mm)
    nearest_ijk = np.rint(airway.volume.to_ijk(surface.position_lps[count_cpu_picture])).astype(int)
    near_lumen = grow_one_voxel(airway.lumen_zyx != 0) & grow_one_voxel(airway.lumen_zyx == 0)
    # The other rays leave the volume through the open top of the trachea.
    assert near_lumen[tuple(nearest_ijk.T[::-1])].mean() > 0.98


def test_surface_is_equal_after_prepare_and_in_strips(renderer, airway):
    view = AirwayView(airway.pose, fov_deg=100.0, **SIZE)
    before = renderer.surface(view)
    renderer.prepare()
    after = renderer.surface(view)
    strips = [renderer.surface(view, rows=rows) for rows in ((0, 7), (7, 44))]
    for name in ("depth_mm", "position_lps", "normal_lps"):
        np.testing.assert_array_equal(getattr(before, name), getattr(after, name))
        np.testing.assert_array_equal(np.concatenate([getattr(s, name) for s in strips]), getattr(after, name))


def test_picked_pixel_has_the_values_of_the_surface(renderer, airway):
    view = AirwayView(airway.pose, fov_deg=100.0, **SIZE)
    surface = renderer.surface(view)
    for column, row in ((0, 0), (28, 22), (55, 43)):
        hit = renderer.pick(view, column, row)
        if hit is None:
            assert np.isnan(surface.depth_mm[row, column])
            continue
        assert hit.depth_mm == surface.depth_mm[row, column]
        np.testing.assert_array_equal(hit.position_lps, surface.position_lps[row, column])
        np.testing.assert_array_equal(hit.normal_lps, surface.normal_lps[row, column])
    for column, row in ((56, 0), (0, 44)):
        with pytest.raises(RenderError):
            renderer.pick(view, column, row)
    for column, row in ((-1, 0), (0, -1)):
        with pytest.raises(UsageError, match="expected a whole number from 0"):
            renderer.pick(view, column, row)


def test_ray_that_meets_no_wall_has_no_surface_point(airway):
    everything_clear = carina.TransferFunction(points=np.array([[0.0, 1.0, 1.0, 1.0, 0.0]]))
    renderer = Renderer(airway.volume, transfer=everything_clear)
    view = AirwayView(airway.pose, **SIZE)
    assert np.isnan(renderer.surface(view).depth_mm).all()
    assert renderer.pick(view, 3, 4) is None


def test_picture_in_paper_mode_has_a_surface(airway):
    renderer = Renderer(airway.volume, transfer=transfer_preset("paper"))
    view = AirwayView(airway.pose, **SIZE)
    surface = renderer.surface(view)
    assert np.isfinite(surface.depth_mm).mean() > 0.9
    renderer.prepare()
    np.testing.assert_array_equal(renderer.surface(view).depth_mm, surface.depth_mm)


def test_surface_is_saved_completely_and_read_back(airway, tmp_path):
    surface = carina.render_surface(airway.volume, pose=airway.pose, lumen_zyx=airway.lumen_zyx, **SIZE)
    path = surface.save(tmp_path / "wall.npz")
    assert [p.name for p in tmp_path.iterdir()] == ["wall.npz"]
    with np.load(path) as archive:
        np.testing.assert_array_equal(archive["depth_mm"], surface.depth_mm)
        np.testing.assert_array_equal(archive["position_lps"], surface.position_lps)
        np.testing.assert_array_equal(archive["normal_lps"], surface.normal_lps)
        np.testing.assert_array_equal(archive["lps_from_camera"], airway.pose.lps_from_camera)
        assert archive["fov_deg"] == 90.0
    with pytest.raises(RenderError, match=r"\.npz"):
        surface.save(tmp_path / "wall.exr")
    with pytest.raises(OSError, match="no such folder"):
        surface.save(tmp_path / "nowhere" / "wall.npz")
