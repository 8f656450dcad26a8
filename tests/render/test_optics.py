"""Tests of the airway view through lenses, outlines and scopes."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from carina.errors import RenderError
from carina.render import AirwayView, Renderer, TransferFunction, transfer_preset
from carina.scopes import PINHOLE, DepthOfField, ImageField, Lens, Pose, scope_preset
from carina.volume import Volume

SIZE = {"width": 120, "height": 96}
LENSES = {
    "pinhole": PINHOLE,
    "equidistant": Lens.equidistant(),
    "brown": Lens.brown(-0.12, 0.02, p1=2e-3),
    "generic": scope_preset("generic").lens,
}


@pytest.fixture(scope="module")
def renderer(airway):
    made = Renderer(airway.volume)
    made.set_lumen(airway.lumen_zyx)
    made.prepare()
    return made


@pytest.fixture(scope="module")
def balls():
    """Return a volume of white balls of 1.5 mm radius in air on a sheared lattice, and their centres."""
    spacing = (0.9, 0.7, 1.1)
    shape = (60, 90, 80)
    place = np.diag([*spacing, 1.0])
    place[:3, 3] = (-36.0, -31.0, -8.0)
    middles = [
        (12.0 * i + 2 * j, 11.0 * j, 16.0 + 11 * k + i) for i, j, k in itertools.product((-2, 0, 1), (-2, 1), (0, 1))
    ]
    z, y, x = np.indices(shape)
    lps = np.stack([x, y, z], axis=-1) * spacing + place[:3, 3]
    away = np.min([np.linalg.norm(lps - np.array(m), axis=-1) for m in middles], axis=0)
    hu = np.where(away < 2.1, 1000.0 - 1900.0 * np.clip((away - 1.1) / 1.0, 0, 1), -1000.0)
    return Volume(np.ascontiguousarray(hu.astype(np.int16)), place), middles


@pytest.mark.parametrize("name", LENSES)
def test_points_appear_at_their_projected_position(balls, name):
    volume, middles = balls
    white = TransferFunction([[-400, 1, 1, 1, 0], [0, 1, 1, 1, 0.95]])
    renderer = Renderer(volume, transfer=white)
    pose = Pose.looking((1.0, -2.0, -6.0), (0.1, 0.05, 1.0))
    count_cpu_picture = 0
    for middle in middles:
        picture = renderer.render(
            AirwayView(pose, fov_deg=100.0, lens=LENSES[name], shading=False, width=300, height=260)
        )
        column, row = picture.pixel_of(middle)
        if not (8 < column < 292 and 8 < row < 252):
            continue
        count_cpu_picture += 1
        around = picture.rgb[int(row) - 7 : int(row) + 8, int(column) - 7 : int(column) + 8, 0].astype(float)
        rows, columns = np.indices(around.shape) + 0.5
        at = [(around * v).sum() / around.sum() for v in (columns, rows)]
        # The tolerance covers the few pixels of a ball, which is cut by the window and stretched by the lens.
        assert at == pytest.approx([column - int(column) + 7, row - int(row) + 7], abs=0.8)
    assert count_cpu_picture >= 6


@pytest.mark.parametrize("name", LENSES)
@pytest.mark.parametrize("outline", ["none", "round", "octagon"])
def test_leap_brute_force_and_strips_give_one_picture_through_every_lens(airway, renderer, name, outline):
    view = AirwayView(airway.pose, fov_deg=110.0, lens=LENSES[name], field=ImageField(outline, vignette=0.6), **SIZE)
    whole = renderer.render(view)
    assert whole.stats.method == "leap"
    assert np.array_equal(whole.rgb, renderer.render(dataclasses.replace(view, method="brute")).rgb)
    strips = [renderer.render(view, rows=rows).rgb for rows in ((0, 17), (17, 18), (18, 96))]
    assert np.array_equal(np.concatenate(strips), whole.rgb)
    for simd in ("portable", None):
        other = Renderer(airway.volume, simd=simd)
        other.set_lumen(airway.lumen_zyx)
        assert np.array_equal(other.render(view).rgb, whole.rgb)


def test_picture_through_a_pinhole_lens_equals_that_of_the_pinhole_formula(airway, renderer):
    plain = renderer.render(AirwayView(airway.pose, fov_deg=100.0, **SIZE)).rgb.astype(int)
    # A vignette of almost zero selects the code path of the lenses.
    lens = renderer.render(AirwayView(airway.pose, fov_deg=100.0, field=ImageField(vignette=1e-9), **SIZE)).rgb
    # Directions are stored as float32, so few pixels differ by one level.
    off = np.abs(plain - lens)
    assert off.max() <= 2 and (off > 0).mean() < 0.01


def test_picture_is_black_outside_the_outline_and_not_inside(airway, renderer):
    picture = renderer.render(AirwayView.of_scope(scope_preset("generic"), airway.pose, **SIZE)).rgb
    rows, columns = np.indices(picture.shape[:2]) + 0.5
    away = np.hypot(columns - 60, rows - 48)
    assert not picture[away > 48].any()
    # The far end of the lumen is excluded, because it is dark.
    assert picture[(away > 20) & (away < 46)].any(axis=-1).all()


def test_wide_lens_shows_the_bifurcation_larger_than_a_pinhole_of_the_same_field(airway):
    fork = (-5.0, 1.0, -8.0)
    pose = airway.pose
    place = {}
    for name in ("pinhole", "generic", "equidistant"):
        optics = LENSES[name].optics(400, 400, 120.0)
        column, row = optics.pixels_of(((np.array(fork) - pose.position_lps) @ pose.lps_from_camera[:3, :3])[None])[0]
        place[name] = np.hypot(column - 200, row - 200)
    assert place["pinhole"] < place["generic"] < place["equidistant"]


def test_picture_of_a_forward_oblique_scope_looks_up_from_the_shaft(airway, renderer):
    picture = renderer.render(AirwayView.of_scope(scope_preset("ebus"), airway.pose, **SIZE))
    ahead = airway.pose.position_lps + 20.0 * airway.pose.forward_lps
    column, row = picture.pixel_of(ahead)
    assert column == pytest.approx(60.0) and row > 80.0


def test_depth_of_field_blurs_near_objects_only(airway):
    # This transfer function shows voxel blocks, whose edges can be blurred.
    renderer = Renderer(airway.volume, transfer=transfer_preset("paper"))
    view = AirwayView(airway.pose, fov_deg=120.0, lens=LENSES["generic"], field=ImageField("round"), **SIZE)
    plain = renderer.render(view).rgb.astype(int)
    depth_mm = renderer.surface(view).depth_mm
    assert np.nanmin(depth_mm) < 7.5
    sharp = renderer.render(dataclasses.replace(view, depth_of_field=DepthOfField(0.5, 1000.0))).rgb.astype(int)
    blurred = renderer.render(dataclasses.replace(view, depth_of_field=DepthOfField(40.0, 80.0))).rgb.astype(int)
    rows, columns = np.indices(depth_mm.shape) + 0.5
    inside = np.hypot(columns - 60, rows - 48) < 42
    assert np.abs(sharp - plain)[inside].max() <= 3
    near = (inside & (depth_mm < 9.0))[:, 1:-1]

    def roughness(rgb):
        """Return the contrast of neighbouring pixels on the wall nearer than the depth of field."""
        return np.abs(np.diff(rgb[..., 0], n=2, axis=1))[near].mean()

    assert roughness(blurred) < 0.7 * roughness(plain)
    # Pixels outside the outline stay black, and its edge is not blurred into the picture.
    assert not blurred[np.hypot(columns - 60, rows - 48) > 48].any()
    with pytest.raises(RenderError, match="whole image"):
        renderer.render(dataclasses.replace(view, depth_of_field=DepthOfField(3.0, 60.0)), rows=(0, 10))


def test_surface_points_are_on_the_rays_of_the_lens(airway, renderer):
    view = AirwayView(airway.pose, fov_deg=120.0, lens=LENSES["equidistant"], field=ImageField("round"), **SIZE)
    surface = renderer.surface(view)
    picture = renderer.render(view)
    for column, row in ((60, 48), (30, 60), (84, 20)):
        found = picture.pixel_of(surface.position_lps[row, column])
        assert found == pytest.approx((column + 0.5, row + 0.5), abs=1e-2)
        assert renderer.pick(view, column, row).depth_mm == surface.depth_mm[row, column]
    assert np.isnan(surface.depth_mm[0, 0]) and renderer.pick(view, 0, 0) is None


@pytest.mark.parametrize(
    "changes",
    [
        {"lens": Lens.brown(-0.3), "fov_deg": 120.0},
        {"lens": Lens.equidistant(), "fov_deg": 171.0},
        {"fov_deg": 0.5},
        {"lens": Lens.equidistant(), "fov_deg": float("nan")},
    ],
)
def test_view_with_an_incompatible_lens_is_refused_before_casting(airway, changes):
    with pytest.raises(RenderError) as refusal:
        AirwayView(airway.pose, **changes, **SIZE)
    assert refusal.value.code == "render.camera" and refusal.value.exit_code == 2
