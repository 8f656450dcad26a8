"""Tests of planes, projections and outside views: laterality, scale, and the transform between pixels and LPS."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from render_grids import place, rotation

from carina.errors import RenderError, UsageError
from carina.navigate import FlightPath
from carina.render import (
    VIEW_NAMES,
    CutPlaneView,
    Renderer,
    Slab,
    SliceView,
    TreeView,
    TriPlaneView,
    XrayView,
    mark_tip,
    render_view,
)
from carina.render.pictures import ignored_settings
from carina.scopes import Pose
from carina.volume import Volume

SHAPE = (24, 30, 36)
SPACING = (1.3, 0.8, 2.1)
MIDDLE = (12.0, -30.0, 55.0)


def permutations_of_axes():
    """Return grids whose axes i, j, k are permuted or reversed axes of the patient, and oblique grids."""
    eye = np.eye(3)
    yield "identity", eye
    yield "flipped", np.diag([-1.0, -1.0, 1.0])
    yield "mirrored", np.diag([-1.0, 1.0, 1.0])
    yield "coronal", np.column_stack([eye[:, 0], -eye[:, 2], eye[:, 1]])
    yield "sagittal", np.column_stack([eye[:, 1], -eye[:, 2], -eye[:, 0]])
    yield "turned", np.column_stack([-eye[:, 2], eye[:, 0], eye[:, 1]])
    yield "oblique", rotation(0.25, -0.2, 0.3)
    yield "oblique-sagittal", rotation(0.2, 0.15, -0.25) @ np.column_stack([eye[:, 1], -eye[:, 2], -eye[:, 0]])


GRIDS = [pytest.param(axes, id=name) for name, axes in permutations_of_axes()]


def volume_with_blob(axes, point_lps):
    """Return a dark volume with one bright blob of about 3 mm at the point ``point_lps``."""
    matrix = place(axes, SPACING, MIDDLE, SHAPE)
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in SHAPE), indexing="ij"), axis=-1)[..., ::-1].astype(float)
    lps = grid @ matrix[:3, :3].T + matrix[:3, 3]
    distance = np.linalg.norm(lps - np.array(point_lps), axis=-1)
    hu = np.where(distance < 3.0, 1000, -1000).astype(np.int16)
    assert (hu > 0).any()
    return Volume(np.ascontiguousarray(hu), matrix)


def bright_centre(rgb):
    """Return the centre (column, row) of the bright pixels in pixel corner coordinates."""
    rows, columns = np.nonzero(rgb[..., 0] > 127)
    assert len(rows) > 0
    return columns.mean() + 0.5, rows.mean() + 0.5


OFFSETS = {"left": (7.0, 0, 0), "posterior": (0, 7.0, 0), "superior": (0, 0, 7.0)}


@pytest.mark.parametrize("axes", GRIDS)
@pytest.mark.parametrize(
    ("plane", "right", "up"),
    [("axial", "left", "anterior"), ("coronal", "left", "superior"), ("sagittal", "posterior", "superior")],
)
def test_slices_and_x_ray_views_have_radiological_orientation(axes, plane, right, up):
    for name, offset in OFFSETS.items():
        point = np.array(MIDDLE) + offset
        renderer = Renderer(volume_with_blob(axes, point))
        views = [XrayView(axis=plane, width=90, height=80, window_hu=(1500.0, -600.0))]
        hidden = {"axial": "superior", "coronal": "posterior", "sagittal": "left"}[plane]
        if name != hidden:
            views.append(SliceView(plane=plane, centre_lps=tuple(point), width=90, height=80))
        for view in views:
            picture = renderer.render(view)
            column, row = bright_centre(picture.rgb)
            middle = picture.pixel_of(MIDDLE)
            mm_per_px = np.linalg.norm(picture.lps_from_pixel[:3, 0])
            across, along = (column - middle[0]) * mm_per_px, (row - middle[1]) * mm_per_px
            expected_across = 7.0 if name == right else 0.0
            expected_along = -7.0 if name == up else 7.0 if (name, up) == ("posterior", "anterior") else 0.0
            # The largest voxel is 2.1 mm. The rays of an X-ray of an oblique grid are parallel to the grid, about 20
            # degrees off the patient's axis, so a depth of 7 mm moves the blob by another 2.6 mm.
            tolerance_mm = 2.1 if np.abs(axes).max(axis=0).min() == 1.0 else 4.7
            assert abs(across - expected_across) < tolerance_mm
            assert abs(along - expected_along) < tolerance_mm


@pytest.mark.parametrize("axes", GRIDS)
def test_pixels_of_every_view_convert_to_points_and_back(axes):
    point = np.add(MIDDLE, (5.0, -6.0, 4.0))
    renderer = Renderer(volume_with_blob(axes, point))
    pose = Pose.looking(point, (0.2, 0.3, -1.0))
    # The camera is shifted in its plane, so that the blob is not in the middle of the cut.
    pose = Pose.looking(point + 4.0 * pose.right_lps, pose.forward_lps)
    views = [
        *(SliceView(plane=p, centre_lps=tuple(point), width=100, height=90) for p in ("axial", "coronal", "sagittal")),
        SliceView(plane="coronal", centre_lps=tuple(point), width=100, height=90, mm_per_px=0.4),
        *(XrayView(axis=p, width=100, height=90, window_hu=(1500.0, -600.0)) for p in ("axial", "coronal", "sagittal")),
        CutPlaneView(pose, width=100, height=90),
    ]
    for view in views:
        picture = renderer.render(view)
        expected = picture.pixel_of(point)
        found = bright_centre(picture.rgb)
        mm_per_px = np.linalg.norm(picture.lps_from_pixel[:3, 0])
        # The blob consists of whole voxels, at most 2.1 mm, so its drawn centre is within a voxel of the true centre.
        assert np.hypot(found[0] - expected[0], found[1] - expected[1]) * mm_per_px < 2.1, view
        # The transform of the picture gives the position of the point within the plane, without the depth.
        column, row = expected
        back = picture.lps_from_pixel @ np.array([column, row, 0.0, 1.0])
        depth = picture.lps_from_pixel[:3, 2]
        off = point - back[:3]
        np.testing.assert_allclose(off - (off @ depth) * depth, 0.0, atol=1e-9)
        assert np.linalg.det(picture.lps_from_pixel[:3, :3]) > 0, "depth points into the screen"


def test_slices_of_an_anisotropic_volume_have_true_proportions():
    renderer = Renderer(volume_with_blob(np.eye(3), MIDDLE))
    for view in (
        XrayView(axis="coronal", width=140, height=60),
        SliceView(plane="sagittal", centre_lps=MIDDLE, width=60, height=140),
    ):
        matrix = renderer.render(view).lps_from_pixel
        across, along = np.linalg.norm(matrix[:3, 0]), np.linalg.norm(matrix[:3, 1])
        assert across == pytest.approx(along)
    # The picture shows the whole volume: 36 x 1.3 = 46.8 mm wide and 24 x 2.1 = 50.4 mm high, in 140 x 60 pixels.
    matrix = renderer.render(XrayView(axis="coronal", width=140, height=60)).lps_from_pixel
    assert np.linalg.norm(matrix[:3, 1]) == pytest.approx(50.4 / 60)


def test_pixel_of_an_x_ray_view_is_the_largest_value_along_its_ray():
    rng = np.random.default_rng(11)
    hu = rng.integers(-1000, 1500, SHAPE).astype(np.int16)
    volume = Volume(hu, place(np.eye(3), (1.0, 1.0, 1.0), MIDDLE, SHAPE))
    # With one pixel per voxel and a window of 2550 HU a grey level is ten HU.
    picture = Renderer(volume).render(XrayView(axis="coronal", width=36, height=24, window_hu=(2550.0, 0.0)))
    expected = np.floor(np.clip((hu.max(axis=1)[::-1] + 1275.0) / 10.0, 0, 255) + 0.5)
    np.testing.assert_allclose(picture.rgb[..., 0], np.minimum(expected, 255), atol=1)


def test_default_grey_window_of_an_x_ray_view_separates_bone_from_tissue():
    hu = np.full(SHAPE, -1000, dtype=np.int16)
    hu[4:20, 5:25, 5:31] = 40
    hu[8:12, 10:20, 10:20] = 700
    renderer = Renderer(Volume(hu, place(np.eye(3), (1.0, 1.0, 1.0), MIDDLE, SHAPE)))
    grey = renderer.render(XrayView(axis="coronal", width=36, height=24)).rgb[..., 0]
    assert len({int(grey[2, 2]), int(grey[12, 25]), int(grey[14, 14])}) == 3
    assert grey[2, 2] < grey[12, 25] < grey[14, 14]


def test_cut_plane_has_the_requested_width_and_is_black_outside_the_volume():
    volume = Volume(np.full(SHAPE, 100, dtype=np.int16), place(np.eye(3), (1.0, 1.0, 1.0), MIDDLE, SHAPE))
    picture = Renderer(volume).render(
        CutPlaneView(Pose.looking(MIDDLE, (0, 0, -1)), width=72, height=72, extent_mm=72.0)
    )
    # The volume covers the middle 36 x 30 mm of 72 x 72 mm, with one pixel per mm.
    assert (picture.rgb[..., 0] > 0).sum() == 36 * 30
    assert picture.rgb[36, 36, 0] > 0
    assert picture.rgb[0, 0, 0] == 0
    # In a caudal view with anterior up, the patient's right is on the right, so lps_from_pixel leads to -x.
    assert picture.lps_from_pixel[0, 0] == pytest.approx(-1.0)


def test_planes_of_the_tri_plane_view_meet_at_the_given_point_and_the_nearest_plane_is_in_front():
    hu = np.zeros(SHAPE, dtype=np.int16)
    hu[:, :, 18:] = 400
    volume = Volume(hu, place(np.eye(3), (1.0, 1.0, 1.0), MIDDLE, SHAPE))
    renderer = Renderer(volume)
    spec = TriPlaneView(MIDDLE, azimuth_deg=0.0, elevation_deg=0.0, width=81, height=81, window_hu=(1000.0, 0.0))
    picture = renderer.render(spec)
    assert picture.pixel_of(MIDDLE) == (pytest.approx(40.5), pytest.approx(40.5))
    # The coronal plane is perpendicular to the view: dark on the left of the picture (patient's right), bright on the
    # right.
    assert picture.rgb[30, 30, 0] < picture.rgb[30, 50, 0]
    side = renderer.render(TriPlaneView(MIDDLE, azimuth_deg=90.0, elevation_deg=0.0, width=81, height=81))
    assert side.lps_from_camera[0, 3] > MIDDLE[0], "azimuth 90 looks from the patient's left"
    above = renderer.render(TriPlaneView(MIDDLE, elevation_deg=90.0, width=81, height=81))
    assert above.lps_from_camera[2, 3] > MIDDLE[2]


def test_tree_view_from_the_front_has_the_patients_left_on_the_right(airway):
    renderer = Renderer(airway.volume)
    with pytest.raises(RenderError, match="have not been segmented"):
        renderer.render(TreeView())
    renderer.set_lumen(airway.lumen_zyx)
    picture = renderer.render(TreeView(width=120, height=120))
    ground = picture.rgb[0, 0].astype(int)
    drawn = np.abs(picture.rgb.astype(int) - ground).sum(axis=2) > 60
    for point in ((0.0, 0.0, 25.0), (-11.0, 2.0, -17.0), (15.0, 3.0, -13.0)):
        column, row = picture.pixel_of(point)
        assert drawn[int(row), int(column)], point
    assert picture.pixel_of((15.0, 3.0, -13.0))[0] > picture.pixel_of((-11.0, 2.0, -17.0))[0]
    # The tree fills a large part of the picture and touches no edge.
    assert 0.03 < drawn.mean() < 0.6
    assert not drawn[[0, -1]].any()
    assert not drawn[:, [0, -1]].any()
    renderer.set_lumen(np.zeros_like(airway.lumen_zyx))
    with pytest.raises(RenderError, match="have not been segmented"):
        renderer.render(TreeView())


def test_branch_one_voxel_thick_is_visible_in_the_tree_view():
    lumen = np.zeros((20, 22, 24), dtype=np.uint8)
    lumen[:, 11, 12] = 1
    volume = Volume(np.zeros(lumen.shape, dtype=np.int16), place(np.eye(3), (1.0, 1.0, 1.0), MIDDLE, lumen.shape))
    renderer = Renderer(volume)
    renderer.set_lumen(lumen)
    picture = renderer.render(TreeView(width=64, height=64))
    column, _ = (int(v) for v in picture.pixel_of(volume.to_lps(np.array([12.0, 11.0, 10.0]))))
    assert (picture.rgb[10:54, column].max(axis=1) > 60).all()


def test_tip_marker_is_a_small_cross_at_the_tip_only():
    volume = volume_with_blob(np.eye(3), MIDDLE)
    picture = Renderer(volume).render(XrayView(axis="coronal", width=128, height=128))
    point = (MIDDLE[0] + 9.0, MIDDLE[1], MIDDLE[2] - 8.0)
    marked = mark_tip(picture, point)
    rows, columns = np.nonzero((marked.rgb != picture.rgb).any(axis=2))
    column, row = picture.pixel_of(point)
    assert abs(columns.mean() - column) < 1.5
    assert abs(rows.mean() - row) < 1.5
    assert len(rows) < 0.02 * 128 * 128
    far = mark_tip(picture, (9999.0, 0.0, 0.0))
    np.testing.assert_array_equal(far.rgb, picture.rgb)


def test_every_view_of_the_command_line_is_rendered(airway):
    path = FlightPath([(0.0, 0.0, 50.0), (0.0, 0.0, 0.0), (-20.0, 4.0, -30.0)]).frames()
    settings = {"orbit": (10.0, 5.0), "path": path}
    for name in VIEW_NAMES:
        picture = render_view(
            airway.volume,
            view=name,
            pose=airway.pose,
            width=40,
            height=30,
            lumen_zyx=airway.lumen_zyx,
            **{key: value for key, value in settings.items() if key not in ignored_settings(name)},
        )
        assert picture.view == name
        assert picture.rgb.shape == (30, 40, 3)
        assert picture.rgb.std() > 1
        assert picture.stats.seconds > 0
    with pytest.raises(UsageError, match="drone"):
        render_view(airway.volume, view="drone", pose=airway.pose)
    with pytest.raises(UsageError, match="path"):
        render_view(airway.volume, view="straightened", pose=airway.pose)
    with pytest.raises(UsageError, match="orbit"):
        render_view(airway.volume, view="tri-plane", pose=airway.pose, orbit=(1.0,))


@pytest.mark.parametrize("axes", GRIDS)
def test_slab_combines_values_on_both_sides_of_its_plane(axes):
    renderer = Renderer(volume_with_blob(axes, np.add(MIDDLE, (0.0, 9.0, 0.0))))
    for view in (
        SliceView("coronal", MIDDLE, width=60, height=60),
        CutPlaneView(Pose.looking(MIDDLE, (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), width=60, height=60),
    ):
        assert renderer.render(view).rgb.max() < 100
        assert renderer.render(dataclasses.replace(view, slab=Slab(10.0, "max"))).rgb.max() < 100
        thick = renderer.render(dataclasses.replace(view, slab=Slab(20.0, "max")))
        assert bright_centre(thick.rgb) == pytest.approx(thick.pixel_of(np.add(MIDDLE, (0.0, 9.0, 0.0))), abs=1.5)
        least = renderer.render(dataclasses.replace(view, slab=Slab(20.0, "min")))
        assert least.rgb.max() < 100
        # A slab of zero thickness equals the plane in every mode.
        thin = renderer.render(dataclasses.replace(view, slab=Slab(0.0, "mean")))
        assert np.abs(thin.rgb.astype(int) - renderer.render(view).rgb).max() <= 1


def test_invalid_grey_windows_and_planes_are_refused():
    with pytest.raises(RenderError):
        SliceView(plane="oblique", centre_lps=MIDDLE)
    with pytest.raises(RenderError):
        SliceView(plane="axial", centre_lps=MIDDLE, window_hu=(0.0, 0.0))
    with pytest.raises(RenderError):
        SliceView(plane="axial", centre_lps=(0.0, float("nan"), 0.0))
    with pytest.raises(RenderError):
        TreeView(distance_mm=-1.0)
